"""Rebuilding a tabletop from depth: analytic pictures of boxes, planes with noise, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.data.jacquard import JacquardScenes
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry.camera import Camera
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import load_gripper
from graspmap.simulation.rebuild import rebuild_tabletop
from graspmap.simulation.solids import open_edges
from graspmap.simulation.table_plane import fit_table_plane
from graspmap.simulation.trial import Outcome, run_trials

SIDE = 300
CAMERA = Camera(760.0, 760.0, (SIDE - 1) / 2, (SIDE - 1) / 2, SIDE, SIDE)


def pose(tilt=0.2, roll=0.0, distance=0.7):
    """Looks at the world's origin from a distance, tilted about x, then turned about the axis."""
    c, s = np.cos(tilt), np.sin(tilt)
    rotation = np.array([[1.0, 0, 0], [0, -c, s], [0, -s, -c]])
    c, s = np.cos(roll), np.sin(roll)
    rotation = rotation @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return RigidTransform(rotation, -distance * rotation[:, 2])


def render(camera, T, boxes):
    """Depth (H, W) and number of the box of each pixel, -1 for table: rays against slabs.

    A box is x, y of its middle, turn, and its three sides; it stands on the table.
    """
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1)
    rays, eye = rays @ T.rotation.T, T.translation
    depth, number = -eye[2] / rays[..., 2], np.full(u.shape, -1)
    for i, (x, y, turn, a, b, h) in enumerate(boxes):
        c, s = np.cos(turn), np.sin(turn)
        into = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        start, way = into @ (eye - (x, y, h / 2)), rays @ into.T
        with np.errstate(divide="ignore"):
            ends = np.stack([(side * np.array([a, b, h]) / 2 - start) / way for side in (-1, 1)])
        enter, leave = ends.min(axis=0).max(axis=-1), ends.max(axis=0).min(axis=-1)
        hit = (enter < leave) & (enter < depth)
        depth, number = np.where(hit, enter, depth), np.where(hit, i, number)
    return depth.astype(np.float32), number


def place_in(box, points):
    """(N, 2) coordinates along the sides of a box, from its middle."""
    c, s = np.cos(box[2]), np.sin(box[2])
    return (points - box[:2]) @ np.array([[c, -s], [s, c]])


def cells(height_map):
    rows, columns = np.indices(height_map.heights_m.shape)
    return height_map.middles(np.stack([rows, columns], axis=-1)).reshape(-1, 2)


boxes = st.tuples(
    st.floats(-0.03, 0.03),
    st.floats(-0.03, 0.03),
    st.floats(0, np.pi),
    st.floats(0.05, 0.08),
    st.floats(0.05, 0.08),
    st.floats(0.02, 0.06),
)
views = st.builds(pose, st.floats(0, 0.5), st.floats(-3, 3), st.floats(0.6, 0.8))


def one_object(rebuilt):
    (placed,) = rebuilt.tabletop.objects
    return placed


@settings(max_examples=25)
@given(box=boxes, T=views, found=st.booleans())
def test_a_box_comes_back(box, T, found):
    depth, number = render(CAMERA, T, [box])
    rebuilt = rebuild_tabletop(depth, None if found else number == 0, CAMERA, T)
    heights = rebuilt.tabletop.height_map
    x, y, _, a, b, h = box
    u, v = place_in(box, cells(heights)).T
    within = (np.abs(u) < a / 2 - 0.003) & (np.abs(v) < b / 2 - 0.003)
    beyond = (np.abs(u) > a / 2 + 0.003) | (np.abs(v) > b / 2 + 0.003)
    assert within.sum() == pytest.approx((a - 0.006) * (b - 0.006) * 1e6, rel=0.1)
    found_heights = heights.heights_m.ravel()
    np.testing.assert_allclose(found_heights[within], h, atol=1e-3)
    assert (found_heights[beyond] == 0).all()
    volume = found_heights.sum() * 1e-6
    assert volume == pytest.approx(a * b * h, rel=0.05)
    placed = one_object(rebuilt)
    center = placed.T_world_object.translation
    np.testing.assert_allclose(center, (x, y, h / 2), atol=1.5e-3)
    assert open_edges(placed.model.vertices, placed.model.faces) == 0
    assert len(placed.model.pieces) == 1


def test_volumes_are_right_on_average():
    """Steps of pixels and cells at the edges do not add up."""
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(12):
        a, b, h = rng.uniform((0.05, 0.05, 0.02), (0.08, 0.08, 0.05))
        box = (*rng.uniform(-0.02, 0.02, 2), rng.uniform(0, np.pi), a, b, h)
        T = pose(*rng.uniform((0, -3, 0.6), (0.4, 3, 0.7)))
        depth, number = render(CAMERA, T, [box])
        rebuilt = rebuild_tabletop(depth, number == 0, CAMERA, T)
        ratios.append(rebuilt.tabletop.height_map.heights_m.sum() * 1e-6 / (a * b * h))
    assert np.abs(np.array(ratios) - 1).max() < 0.03
    assert np.mean(ratios) == pytest.approx(1, abs=0.01)


@settings(max_examples=25)
@given(T=views, seed=st.integers(0, 1000), given_pose=st.booleans())
def test_the_table_is_found_under_noise_and_among_other_things(T, seed, given_pose):
    rng = np.random.default_rng(seed)
    depth, _ = render(CAMERA, T, [])
    depth = depth + rng.normal(0, 0.001, depth.shape).astype(np.float32)
    other = rng.random(depth.shape) < 0.3
    depth[other] -= rng.uniform(0.01, 0.3, other.sum()).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    rough = T @ RigidTransform.from_quaternion([0.01, -0.01, 0, 1], [0.01, 0, 0.02])
    plane = fit_table_plane(
        depth, np.ones(depth.shape, bool), CAMERA, rough if given_pose else None
    )
    down, true = plane.T_world_camera.rotation[2], T.rotation[2]
    assert np.degrees(np.arccos(min(1, down @ true))) < 0.1
    assert plane.T_world_camera.translation[2] == pytest.approx(T.translation[2], abs=1e-3)
    assert plane.residual_m == pytest.approx(0.001, rel=0.25)
    assert 0.55 < plane.share < 0.85
    if not given_pose:
        middle = CAMERA.deproject([CAMERA.cx, CAMERA.cy], 1.0) * -(
            plane.T_world_camera.translation[2] / plane.T_world_camera.rotation[2, 2]
        )
        np.testing.assert_allclose(plane.T_world_camera.apply(middle), 0, atol=1e-9)
        assert plane.T_world_camera.rotation[0, 0] > 0
        assert plane.T_world_camera.rotation[1, 0] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("side", [64, 128, 500])
def test_no_holes_at_any_size_of_the_picture(side):
    camera = Camera.from_field_of_view(0.5, side, side)
    box = (0.0, 0.0, 0.4, 0.15, 0.1, 0.04)
    depth, number = render(camera, pose(), [box])
    heights = rebuild_tabletop(depth, number == 0, camera, pose()).tabletop.height_map
    u, v = place_in(box, cells(heights)).T
    within = (np.abs(u) < 0.075 - 0.006) & (np.abs(v) < 0.05 - 0.006)
    assert heights.heights_m.ravel()[within].min() > 0.039


def test_the_bottom_of_a_bowl_goes_on_behind_its_rim_and_a_gap_stays_open():
    """Four walls around a bottom; and two bars in a row, the lower part of one hidden."""
    walls = [(0.05, 0, 0, 0.006, 0.1, 0.05), (-0.05, 0, 0, 0.006, 0.1, 0.05)]
    walls += [(0, 0.05, 0, 0.1, 0.006, 0.05), (0, -0.05, 0, 0.1, 0.006, 0.05)]
    bottom = (0.0, 0.0, 0.0, 0.1, 0.1, 0.008)
    T = pose(tilt=0.4)
    depth, number = render(CAMERA, T, [*walls, bottom])
    heights = rebuild_tabletop(depth, number >= 0, CAMERA, T).tabletop.height_map
    inner = heights.at(np.stack(np.meshgrid(*[np.linspace(-0.04, 0.04, 30)] * 2), axis=-1))
    np.testing.assert_allclose(inner, 0.008, atol=1e-3)

    bars = [(0, 0.02, 0, 0.2, 0.012, 0.05), (0, -0.02, 0, 0.2, 0.012, 0.05)]
    depth, number = render(CAMERA, T, bars)
    heights = rebuild_tabletop(depth, number >= 0, CAMERA, T).tabletop.height_map
    gap = heights.at(np.column_stack([np.linspace(-0.08, 0.08, 50), np.full(50, -0.002)]))
    assert gap.max() == 0


def test_holes_get_the_depth_beside_them():
    box = (0.0, 0.0, 0.3, 0.1, 0.06, 0.03)
    depth, number = render(CAMERA, pose(), [box])
    mask = number == 0
    rng = np.random.default_rng(0)
    depth[mask & (rng.random(mask.shape) < 0.3)] = np.nan
    rebuilt = rebuild_tabletop(depth, mask, CAMERA, pose())
    assert rebuilt.filled_share == pytest.approx(0.3, abs=0.02)
    heights = rebuilt.tabletop.height_map.heights_m
    assert heights.sum() * 1e-6 == pytest.approx(0.1 * 0.06 * 0.03, rel=0.05)


def test_one_body_or_one_for_each_part():
    two = [(0.05, 0, 0, 0.04, 0.04, 0.03), (-0.05, 0, 0, 0.04, 0.04, 0.05)]
    depth, number = render(CAMERA, pose(), two)
    whole = rebuild_tabletop(depth, number >= 0, CAMERA, pose(), name="both")
    assert [o.model.id for o in whole.tabletop.objects] == ["both"]
    parts = rebuild_tabletop(depth, None, CAMERA, pose(), bodies="components", name="part")
    assert sorted(o.model.id for o in parts.tabletop.objects) == ["part_0", "part_1"]
    assert {round(o.T_world_object.translation[0], 2) for o in parts.tabletop.objects} == {
        -0.05,
        0.05,
    }
    np.testing.assert_allclose(
        whole.tabletop.height_map.heights_m, parts.tabletop.height_map.heights_m, atol=1e-6
    )
    heavy = sum(o.model.mass_kg for o in parts.tabletop.objects)
    # The lower one would weigh 14 g: below the range.
    assert heavy == pytest.approx(0.02 + 0.04 * 0.04 * 0.05 * 300, rel=0.05)


def test_the_same_picture_gives_the_same_bits():
    depth, number = render(CAMERA, pose(), [(0, 0, 0.3, 0.1, 0.06, 0.03)])
    first, second = (rebuild_tabletop(depth, number == 0, CAMERA) for _ in range(2))
    assert first.T_world_camera == second.T_world_camera
    a, b = (one_object(r).model for r in (first, second))
    np.testing.assert_array_equal(a.vertices, b.vertices)
    assert all(np.array_equal(p, q) for p, q in zip(a.pieces, b.pieces, strict=True))


def test_a_grasp_across_a_rebuilt_box_holds():
    depth, number = render(CAMERA, pose(), [(0.01, 0.0, 0.3, 0.12, 0.05, 0.03)])
    rebuilt = rebuild_tabletop(depth, number == 0, CAMERA, pose())
    grasps = TableGrasps(
        center_m=[[0.01, 0.0], [0.01, 0.0], [0.15, 0.15]],
        angle=[0.3 + np.pi / 2, 0.3 + np.pi / 2, 0.0],
        width_m=[0.08, 0.03, 0.08],
        height_m=[0.02, 0.02, 0.02],
    )
    results = run_trials(rebuilt.tabletop, grasps, load_gripper("jacquard"))
    assert results[0].outcome is Outcome.HELD
    assert Outcome.HELD not in (results[1].outcome, results[2].outcome)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"mask": np.zeros((SIDE, SIDE), bool)}, "mask"),
        ({"mask": np.ones((SIDE, SIDE), bool)}, "table"),
        ({"mask": np.ones((3, 4), bool)}, "shape of mask"),
        ({"mask": np.ones((SIDE, SIDE), np.uint8)}, "type of mask"),
        ({"depth_m": np.ones((3, 4), np.float32)}, "shape of depth_m"),
        ({"depth_m": np.full((SIDE, SIDE), np.nan, np.float32)}, "table"),
        ({"resolution_m": 0.0}, "resolution_m"),
        ({"density_kg_m3": -1.0}, "density_kg_m3"),
        ({"mass_range_kg": (0.2, 0.1)}, "mass_range_kg"),
        ({"T_world_camera": pose(tilt=0.6)}, "T_world_camera"),
        ({"T_world_camera": pose(distance=3)}, "table"),
    ],
)
def test_refuses(change, named):
    depth, number = render(CAMERA, pose(), [(0, 0, 0.3, 0.1, 0.06, 0.03)])
    good = {"depth_m": depth, "mask": number == 0, "camera": CAMERA, "T_world_camera": pose()}
    with pytest.raises(InvalidInputError) as caught:
        rebuild_tabletop(**{**good, **change})
    assert named in caught.value.name


def test_refuses_scenes_without_object_or_table():
    depth, number = render(CAMERA, pose(), [])
    with pytest.raises(InvalidInputError, match="above the table"):
        rebuild_tabletop(depth, None, CAMERA)
    mask = np.zeros((SIDE, SIDE), bool)
    mask[80:120, 80:120] = True
    with pytest.raises(InvalidInputError, match="stands up"):
        rebuild_tabletop(depth, mask, CAMERA)
    hole = np.where(mask, np.nan, depth)
    with pytest.raises(InvalidInputError, match="on the mask"):
        rebuild_tabletop(hole, mask, CAMERA)
    rough = np.random.default_rng(0).uniform(0.3, 3, depth.shape).astype(np.float32)
    with pytest.raises(InvalidInputError, match="table"):
        rebuild_tabletop(rough, mask, CAMERA)
    steep, _ = render(CAMERA, pose(tilt=1.2, distance=1.0), [])
    steep = np.where((steep > 0) & (steep < 10), steep, np.nan).astype(np.float32)
    with pytest.raises(InvalidInputError, match="degrees"):
        rebuild_tabletop(steep, mask, CAMERA)
    with pytest.raises(UnknownNameError):
        rebuild_tabletop(depth, mask, CAMERA, bodies="several")
    assert (number == -1).all()


def test_labels_of_a_real_scene_hold(data_dir):
    """A telephone: its labels hold; turned by a quarter it is longer than the gripper is open."""
    scenes = JacquardScenes(data_dir / "jacquard", jaws="smallest")
    scene = scenes[next(i for i, name in enumerate(scenes.ids) if name.startswith("1_1d7830"))]
    rebuilt = rebuild_tabletop(scene.depth, scene.mask, scene.camera, scene.T_world_camera)
    assert len(one_object(rebuilt).model.pieces) == 1
    labels = TableGrasps.from_pixels(
        scene.grasps, scene.depth, scene.camera, rebuilt.T_world_camera
    )
    gripper = load_gripper("jacquard")
    results = run_trials(rebuilt.tabletop, labels, gripper)
    assert sum(r.outcome is Outcome.HELD for r in results) >= len(labels) - 1
    turned = labels.replace(angle=labels.angle + np.pi / 2)
    assert all(r.outcome is not Outcome.HELD for r in run_trials(rebuilt.tabletop, turned, gripper))
