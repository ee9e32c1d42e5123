"""Drawn scenes: the grasps are right by a look at the pixels alone, the files repeat exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest

from graspmap.data import JacquardScenes
from graspmap.data.jacquard import smallest_jaws
from graspmap.errors import FileError, InvalidInputError
from graspmap.generation import SHAPES, draw_scene, random_shape, sensor_depth, write_drawn
from graspmap.generation.shapes import CLEARANCE_M, JAWS_M, MOST_OPENING_M


def look_up(mask, points):
    """Mask at the nearest pixels of (..., 2) points; False outside."""
    x, y = np.rint(np.moveaxis(points, -1, 0)).astype(int)
    inside = (x >= 0) & (x < mask.shape[1]) & (y >= 0) & (y < mask.shape[0])
    result = mask[np.clip(y, 0, mask.shape[0] - 1), np.clip(x, 0, mask.shape[1] - 1)]
    return result & inside


def check_grasps(mask, grasps, clearance_px):
    """Each grasp holds: plates free over the whole jaw, object between them, sides opposite."""
    axis = grasps.axis()
    across = np.stack([-axis[:, 1], axis[:, 0]], axis=-1)
    jaw = np.linspace(-0.5, 0.5, 41)
    for side in (-1, 1):
        plate = grasps.center + side * axis * grasps.width[:, None] / 2
        points = plate[:, None] + jaw[:, None] * (across * grasps.height[:, None])[:, None]
        assert not look_up(mask, points).any(), "a plate would touch the object"
    share = np.linspace(-0.5, 0.5, 801)
    line = grasps.center[:, None] + share[:, None] * (axis * grasps.width[:, None])[:, None]
    hit = look_up(mask, line)
    assert hit[:, 400].all(), "the middle of a grasp is beside the object"
    first = np.argmax(hit, axis=1) / 800
    last = 1 - np.argmax(hit[:, ::-1], axis=1) / 800
    free = np.stack([first * grasps.width, (1 - last) * grasps.width])
    assert abs(free - clearance_px).max() < 1.0, "the sides are not where the opening says"
    solid = hit.sum(axis=1) / ((last - first) * 800)
    assert solid.min() > 0.97, "there is a gap between the plates"


@pytest.mark.parametrize("kind", SHAPES)
def test_grasps_hold(kind):
    for seed in range(12):
        rng = np.random.default_rng([1, seed])
        shape = SHAPES[kind](rng)
        scene = draw_scene(rng, size=400, shapes=[shape])
        assert len(scene.grasps) == len(shape.grasps) > 0
        px_per_m = float(np.median(scene.grasps.width / shape.grasps.width))
        check_grasps(scene.mask, scene.grasps, CLEARANCE_M * px_per_m)
        assert shape.grasps.width.max() <= MOST_OPENING_M
        assert set(shape.grasps.height) <= set(JAWS_M)
        assert (scene.grasps.center > 0).all()
        assert (scene.grasps.center < 399).all()


def test_grasps_hold_among_several_objects():
    for seed in range(6):
        rng = np.random.default_rng([2, seed])
        shapes = [random_shape(rng) for _ in range(5)]
        scene = draw_scene(rng, size=400, shapes=shapes)
        assert len(scene.grasps) > len(shapes[0].grasps)
        widths = np.concatenate([shape.grasps.width for shape in shapes])
        px_per_m = scene.grasps.width[0] / shapes[0].grasps.width[0]
        assert widths.min() * px_per_m <= scene.grasps.width.min() * (1 + 1e-9)
        check_grasps(scene.mask, scene.grasps, CLEARANCE_M * px_per_m)


def test_depth_is_the_table_and_the_object_on_it():
    for seed in range(7):
        rng = np.random.default_rng([3, seed])
        shape = list(SHAPES.values())[seed](rng)
        scene = draw_scene(rng, size=200, shapes=[shape])
        y, x = np.mgrid[:200, :200]
        table = np.stack([x, y, np.ones_like(x)], -1).astype(float)
        bare = ~scene.mask
        plane, *_ = np.linalg.lstsq(table[bare], scene.depth[bare], rcond=None)
        height = table @ plane - scene.depth
        assert abs(height[bare]).max() < 1e-4
        assert height[scene.mask].min() > 0.001
        assert height.max() < 0.2
        tilt = math.hypot(*plane[:2]) * scene.camera.fx / scene.depth.mean()
        assert tilt <= math.tan(math.radians(10)) * 1.1


def test_widths_in_metres_come_back_through_the_camera():
    """Within what a parallel projection of a tilted, 10 cm high scene can differ."""
    rng = np.random.default_rng(4)
    shape = SHAPES["stick"](rng)
    scene = draw_scene(rng, shapes=[shape])
    metres = scene.grasps.width / scene.camera.fx * 1.475
    np.testing.assert_allclose(metres, shape.grasps.width, rtol=0.12)


def test_smallest_jaw_is_one_of_each():
    scene = draw_scene(np.random.default_rng(5), shapes=[SHAPES["can"](np.random.default_rng(0))])
    smallest = smallest_jaws(scene.grasps)
    assert len(smallest) == 12
    assert len(scene.grasps) == 12 * len(JAWS_M)


def test_sensor_has_noise_and_holes():
    rng = np.random.default_rng(6)
    scene = draw_scene(rng)
    seen = sensor_depth(rng, scene)
    holes = np.isnan(seen)
    assert seen.dtype == np.float32
    assert 0.0001 < holes.mean() < 0.05
    error = abs(seen - scene.depth)[~holes]
    assert 0.0003 < error.mean() < 0.003


def contents(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_files_repeat_exactly_and_read_back(tmp_path):
    done = []
    write_drawn(tmp_path / "a", 7, 3, size=64, views=3, progress=lambda *a: done.append(a))
    assert done == [(i + 1, 7) for i in range(7)]
    write_drawn(tmp_path / "b", 4, 3, size=64, views=3)
    for path in list((tmp_path / "b").rglob("1_*_RGB.png"))[:1]:
        path.unlink()  # as after an interruption
    write_drawn(tmp_path / "b", 7, 3, size=64, views=3)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")

    scenes = JacquardScenes(tmp_path / "a")
    assert len(scenes) == 7
    objects = [scenes.object_id(i) for i in range(7)]
    assert sorted(objects.count(name) for name in set(objects)) == [1, 3, 3]
    scene = scenes.read(scenes.ids.index(next(n for n in scenes.ids if n.startswith("1_"))))
    assert scene.shape == (64, 64)
    assert scene.camera.fx == pytest.approx(32 / math.tan(math.radians(15)))
    i = int(scene.object_id.rpartition("-")[2])
    shape = random_shape(np.random.default_rng([3, 0, i]))
    drawn = draw_scene(np.random.default_rng([3, 1, 3 * i + 1]), size=64, shapes=[shape])
    np.testing.assert_array_equal(scene.rgb, drawn.rgb)
    np.testing.assert_array_equal(scene.depth, drawn.depth)
    np.testing.assert_array_equal(scene.mask, drawn.mask)
    np.testing.assert_allclose(scene.grasps.corners(), drawn.grasps.corners(), atol=1e-6)
    stereo = JacquardScenes(tmp_path / "a", depth="stereo").read(0)
    assert np.isnan(stereo.depth).any()


def test_views_of_one_object_differ_and_seeds_too(tmp_path):
    write_drawn(tmp_path / "a", 2, 0, size=64)
    write_drawn(tmp_path / "b", 1, 1, size=64)
    pictures = [p.read_bytes() for p in tmp_path.rglob("*_RGB.png")]
    assert len(set(pictures)) == 3


def test_folders_with_something_else_are_left_alone(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "thesis.txt").write_text("mine")
    with pytest.raises(FileError, match="something else"):
        write_drawn(tmp_path / "a", 1)
    write_drawn(tmp_path / "b", 1, 0, size=64)
    with pytest.raises(FileError, match="other settings"):
        write_drawn(tmp_path / "b", 1, 1, size=64)
    (tmp_path / "b" / "drawn.json").write_text("{")
    with pytest.raises(FileError, match="damaged"):
        write_drawn(tmp_path / "b", 1, 0, size=64)


@pytest.mark.parametrize(
    "arguments", [{"scenes": 0}, {"views": 0}, {"objects": 0}, {"seed": -1}, {"size": 10}]
)
def test_numbers_out_of_range(tmp_path, arguments):
    with pytest.raises(InvalidInputError):
        write_drawn(tmp_path / "a", **{"scenes": 1, **arguments})
