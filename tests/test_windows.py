"""Which square a network sees: about the middle, about a region, or a close-up of one scale."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from graspmap.data import input_window, warp
from graspmap.data.windows import View, close_up_m
from graspmap.errors import InvalidInputError
from graspmap.geometry.affine import apply
from graspmap.geometry.camera import Camera
from graspmap.inference import Detector
from graspmap.inference.weights import WeightsCard
from graspmap.networks import make_network

SIZE = 128


def tabletop(
    *, distance: float, focal: float, tilt: float, at: tuple[float, float], half: float, rise: float
) -> tuple[np.ndarray, Camera, np.ndarray]:
    """Depth of a box on a table, its camera, and which pixels show the box.

    The table is tilted about the picture's rows; the box rises along the camera's axis, so that
    its top is the table, moved: every ray is met in closed form.
    """
    rows, columns = 240, 320
    camera = Camera(focal, focal, (columns - 1) / 2, (rows - 1) / 2, columns, rows)
    x = (np.arange(columns)[None] - camera.cx) / focal
    y = (np.arange(rows)[:, None] - camera.cy) / focal
    table = distance / (1 + np.tan(tilt) * y) + 0 * x
    top = (distance - rise) / (1 + np.tan(tilt) * y) + 0 * x
    on = (np.abs(x * top - at[0]) < half) & (np.abs(y * top - at[1]) < half)
    return np.where(on, top, table).astype(np.float32), camera, on


scenes = {
    "distance": st.floats(0.5, 1.2),
    "focal": st.floats(250, 500),
    "tilt": st.floats(0, 0.35),
    "at": st.tuples(st.floats(-0.05, 0.05), st.floats(-0.04, 0.04)),
    "half": st.floats(0.008, 0.04),
    "rise": st.floats(0.01, 0.08),
}


@given(seed=st.integers(0, 2**32), **scenes)
def test_a_close_up_shows_every_object_at_one_scale(seed, **scene):
    depth, camera, on = tabletop(**scene)
    rng = np.random.default_rng(seed)
    depth += rng.normal(0, 0.0004, depth.shape).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = np.nan
    matrix = input_window(depth.shape, SIZE, view="20 cm", depth_m=depth, camera=camera)
    rows, columns = np.nonzero(on)
    seen = apply(matrix, np.column_stack([columns, rows]).astype(np.float64))
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    assert np.abs(middle - (SIZE - 1) / 2).max() < 4
    # A length on the table below the middle of the box, by the closed form of its depth.
    row = (rows.min() + rows.max()) / 2
    below = scene["distance"] / (1 + np.tan(scene["tilt"]) * (row - camera.cy) / camera.fy)
    side_m = SIZE / matrix[0, 0] / camera.fx * below
    assert side_m == pytest.approx(0.20, rel=0.02)
    assert matrix[0, 0] == matrix[1, 1]


def test_far_and_near_cameras_see_the_same():
    """The share of the input that a box fills does not follow from the camera's distance."""
    shares = []
    for distance in (0.5, 0.8, 1.2):
        depth, camera, on = tabletop(
            distance=distance, focal=400, tilt=0.0, at=(0, 0), half=0.03, rise=0.005
        )
        matrix = input_window(depth.shape, SIZE, view="20 cm", depth_m=depth, camera=camera)
        shares.append(warp(on, matrix, SIZE, fill=False).mean())
    assert shares == pytest.approx([0.09] * 3, rel=0.06)


def test_it_grows_where_more_stands_on_the_table_than_fits():
    first, camera, _ = tabletop(
        distance=1.0, focal=300, tilt=0.1, at=(-0.2, 0.1), half=0.03, rise=0.04
    )
    second, _, _ = tabletop(
        distance=1.0, focal=300, tilt=0.1, at=(0.25, -0.1), half=0.03, rise=0.04
    )
    depth = np.minimum(first, second)
    matrix = input_window(depth.shape, SIZE, view="20 cm", depth_m=depth, camera=camera)
    seen = apply(matrix, np.column_stack(np.nonzero(first != second)[::-1]).astype(np.float64))
    assert seen.min() > 5
    assert seen.max() < SIZE - 6


@pytest.mark.parametrize("lower", [0.05, 0.4])
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_a_floor_beside_the_table_hides_nothing(lower, noise):
    depth, camera, on = tabletop(
        distance=0.7, focal=300, tilt=0.0, at=(-0.1, -0.05), half=0.025, rise=0.05
    )
    depth[:, 200:] += lower  # 38 % of the picture
    depth += np.random.default_rng(0).normal(0, noise, depth.shape).astype(np.float32)
    matrix = input_window(depth.shape, SIZE, view="20 cm", depth_m=depth, camera=camera)
    rows, columns = np.nonzero(on)
    middle = apply(matrix, np.array([[columns.mean(), rows.mean()]]))
    assert np.abs(middle - (SIZE - 1) / 2).max() < 4


@pytest.mark.parametrize("shape", [(2, 640), (3, 1000), (1, 400), (640, 2), (1, 1)])
def test_pictures_and_parts_of_few_rows(shape):
    rows, columns = shape
    camera = Camera(300.0, 300.0, (columns - 1) / 2, (rows - 1) / 2, columns, rows)
    depth = np.full(shape, 0.7, np.float32)
    assert np.isfinite(input_window(shape, SIZE, view="20 cm", depth_m=depth, camera=camera)).all()


def test_a_region_that_hangs_over_the_edge():
    depth, camera, _ = tabletop(distance=0.8, focal=300, tilt=0.1, at=(0, 0), half=0.03, rise=0.03)
    for region in ((0, 238.2, 320, 240), (0, 0, 320, 1), (0, -238, 320, 240), (319, 0, 5, 240)):
        matrix = input_window(
            depth.shape, SIZE, view="20 cm", region_xywh=region, depth_m=depth, camera=camera
        )
        assert np.isfinite(matrix).all()


@pytest.mark.parametrize("speck", [False, True])
def test_an_empty_table_is_seen_in_its_middle(speck):
    depth, camera, _ = tabletop(distance=0.8, focal=300, tilt=0.2, at=(0, 0), half=0.0, rise=0.01)
    if speck:
        depth[30:32, 50:52] -= 0.05  # smaller than any object
    matrix = input_window(depth.shape, SIZE, view="20 cm", depth_m=depth, camera=camera)
    middle = apply(matrix, np.array([[(320 - 1) / 2, (240 - 1) / 2]]))
    assert np.abs(middle - (SIZE - 1) / 2).max() < 1e-6


def test_a_region_says_which_thing_is_seen_at_the_scale_of_a_close_up():
    boxes = [
        tabletop(distance=1.0, focal=300, tilt=0.0, at=at, half=0.03, rise=0.03)
        for at in ((0.1, 0.0), (-0.25, 0.1))
    ]
    depth, camera = np.minimum(boxes[0][0], boxes[1][0]), boxes[0][1]
    about = {"view": "20 cm", "depth_m": depth, "camera": camera}
    rows, columns = np.nonzero(boxes[0][2])
    middle = [[(columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2]]
    # Nothing but the top of the box; the box and a part of the table; no more of the other box.
    for region in ((181, 111, 17, 17), (180, 100, 50, 60), (120, 20, 190, 215)):
        matrix = input_window(depth.shape, SIZE, region_xywh=region, **about)
        assert SIZE / matrix[0, 0] == pytest.approx(60, rel=0.02)  # 20 cm at 1 m
        assert np.abs(apply(matrix, np.array(middle)) - (SIZE - 1) / 2).max() < 5
    for region in ((199.3, 119.2, 0.4, 0.3), (316, 230, 40, 40), (400, 10, 5, 5)):  # next to none
        matrix = input_window(depth.shape, SIZE, region_xywh=region, **about)
        assert SIZE / matrix[0, 0] == pytest.approx(60, rel=0.02)
    both = input_window(depth.shape, SIZE, region_xywh=(0, 0, 320, 240), **about)
    assert np.allclose(both, input_window(depth.shape, SIZE, **about), atol=1e-6)
    square = input_window(depth.shape, SIZE, region_xywh=(180, 110, 20, 30))
    assert SIZE / square[0, 0] == pytest.approx(30)


def test_a_region_leaves_out_the_wall():
    """The table that counts is that of the region, not the plane that most of a room lies on."""
    depth, camera, on = tabletop(
        distance=1.0, focal=300, tilt=0.2, at=(0.1, 0.2), half=0.03, rise=0.03
    )
    depth[:140] = 1.6  # more than half of the picture is wall
    matrix = input_window(
        depth.shape,
        SIZE,
        region_xywh=(100, 141, 160, 90),
        view="20 cm",
        depth_m=depth,
        camera=camera,
    )
    on[:141] = False
    rows, columns = np.nonzero(on)
    assert len(rows)
    seen = apply(matrix, np.column_stack([columns, rows]).astype(np.float64))
    assert np.abs((seen.min(axis=0) + seen.max(axis=0)) / 2 - (SIZE - 1) / 2).max() < 5


@pytest.mark.parametrize(
    "view", ["36", "0 cm", "36cm", "-3 cm", "36 mm", "centre", 0, -5, True, 2.5]
)
def test_a_view_that_is_none_is_refused(view):
    with pytest.raises(InvalidInputError, match="36 cm"):
        input_window((40, 60), 32, view=view)
    with pytest.raises(InvalidInputError):
        close_up_m(view)


@pytest.mark.parametrize("view", ["36", "36cm", "-3 cm", "36 mm", "centre", 0, -5, 2.5])
def test_files_refuse_it_too(view):
    with pytest.raises(ValidationError):
        TypeAdapter(View).validate_python(view, strict=True)


def test_a_close_up_needs_depth_and_camera():
    depth, camera, _ = tabletop(distance=1, focal=300, tilt=0, at=(0, 0), half=0.03, rise=0.02)
    with pytest.raises(InvalidInputError, match="without depth"):
        input_window(depth.shape, SIZE, view="20 cm", camera=camera)
    with pytest.raises(InvalidInputError, match="without a camera"):
        input_window(depth.shape, SIZE, view="20 cm", depth_m=depth)


def test_a_detector_assumes_a_common_camera_and_says_so(caplog):
    depth, camera, _ = tabletop(distance=1, focal=300, tilt=0, at=(0, 0), half=0.03, rise=0.02)
    card = WeightsCard(
        network="ggcnn2", channels="depth", size=SIZE, view="20 cm", width_scale_px=20.0
    )
    detector = Detector(make_network("ggcnn2", 1, 1), card)
    with caplog.at_level(logging.WARNING):
        unknown = detector.prepare(None, depth)
        detector.prepare(None, depth)
    told = [record for record in caplog.records if "field of view" in record.getMessage()]
    assert len(told) <= 1  # none where another test has shown such a picture before
    known = detector.prepare(None, depth, camera=camera)
    # 57 degrees across 320 px are a focal length of 295 px.
    assert unknown.matrix[0, 0] / known.matrix[0, 0] == pytest.approx(300 / 294.7, rel=1e-3)
