"""Similarities of the image plane, against OpenCV's resize and whole-pixel operations."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.geometry import affine

numbers = st.floats(-500, 500)
factors = st.floats(0.05, 20)
points = st.tuples(numbers, numbers)


@given(points, factors)
def test_zoom_keeps_its_centre_and_scales_distances(about, factor):
    m = affine.zoom(factor, about)
    assert affine.apply(m, [about])[0] == pytest.approx(about, abs=1e-9)
    ends = affine.apply(m, [(0, 0), (3, 4)])
    assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(5 * factor)


@given(points, st.floats(-7, 7))
def test_rotation_keeps_its_centre_and_turns_counter_clockwise_on_screen(about, angle):
    m = affine.rotation(angle, about)
    assert affine.apply(m, [about])[0] == pytest.approx(about, abs=1e-9)
    right = affine.apply(m, [(about[0] + 1, about[1])])[0] - about
    assert right == pytest.approx([np.cos(angle), -np.sin(angle)], abs=1e-9)


@given(points, st.floats(-7, 7), st.floats(-7, 7))
def test_rotations_about_one_point_add_up(about, a, b):
    both = affine.rotation(a, about) @ affine.rotation(b, about)
    assert both == pytest.approx(affine.rotation(a + b, about), abs=1e-9)


@given(st.integers(1, 2000), points)
def test_flip_twice_changes_nothing(width, point):
    m = affine.flip(width)
    assert (m @ m == np.eye(3)).all()
    assert affine.apply(m, [(0, 5), (width - 1, 5)]).tolist() == [[width - 1, 5], [0, 5]]


@given(numbers, numbers, points)
def test_crop_undoes_translation(x, y, point):
    m = affine.crop(x, y) @ affine.translation(x, y)
    assert affine.apply(m, [point])[0] == pytest.approx(point, abs=1e-9)


@given(st.integers(1, 900), factors)
def test_resize_keeps_the_outer_edges(side, factor):
    edges = affine.apply(affine.resize(factor), [(-0.5, -0.5), (side - 0.5, side - 0.5)])
    assert edges[0] == pytest.approx([-0.5, -0.5])
    assert edges[1] == pytest.approx([side * factor - 0.5] * 2)


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_resize_agrees_with_opencv(factor):
    image = np.random.default_rng(0).random((6, 6)).astype(np.float32)
    expected = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
    got = cv2.warpAffine(
        image,
        affine.resize(factor)[:2],
        (6 * factor, 6 * factor),
        flags=cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # OpenCV's warp may round positions to 1/32 pixel.
    assert np.abs(got - expected).max() < 0.04


@given(numbers, numbers, st.floats(1, 1000), st.integers(1, 640))
def test_window_maps_its_edges_onto_those_of_the_image(x, y, side, size):
    m = affine.window(x, y, side, size)
    corners = [(x - 0.5, y - 0.5), (x + side - 0.5, y + side - 0.5)]
    assert affine.apply(m, corners) == pytest.approx(
        np.array([[-0.5, -0.5], [size - 0.5, size - 0.5]]), abs=1e-6
    )


def test_window_of_the_same_size_is_a_crop():
    assert affine.window(7, 3, 32, 32) == pytest.approx(affine.crop(7, 3))


@given(points, st.floats(-7, 7), factors, st.booleans(), points)
def test_check_similarity_takes_any_product_of_the_parts(about, angle, factor, mirrored, shift):
    m = affine.translation(*shift) @ affine.zoom(factor, about) @ affine.rotation(angle, about)
    if mirrored:
        m = affine.flip(320) @ m
    linear, offset, scale = affine.check_similarity(m)
    assert scale == pytest.approx(factor)
    assert np.sign(np.linalg.det(linear)) == (-1 if mirrored else 1)
    assert np.array_equal(np.column_stack([linear, offset]), m[:2])


def test_apply_takes_two_rows_or_three():
    m = affine.translation(1, 2)
    assert affine.apply(m[:2], [(0, 0)]).tolist() == affine.apply(m, [(0, 0)]).tolist() == [[1, 2]]


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(2),
        np.eye(4),
        np.zeros((3, 3)),
        np.diag([1, 1, 2]),
        [[1, 0, np.nan], [0, 1, 0]],
        [[1, 1, 0], [1, 1, 0]],
        [["a", 0, 0], [0, 1, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0.5, 1]],
    ],
)
def test_check_affine_refuses(matrix):
    with pytest.raises(InvalidInputError):
        affine.check_affine(matrix)


@pytest.mark.parametrize("matrix", [np.diag([2, 1, 1]), [[1, 0.01, 0], [0, 1, 0]]])
def test_check_similarity_refuses(matrix):
    with pytest.raises(InvalidInputError, match="similarity"):
        affine.check_similarity(matrix)


@pytest.mark.parametrize("factor", [0, -1, np.nan, np.inf])
def test_zoom_refuses(factor):
    with pytest.raises(InvalidInputError):
        affine.zoom(factor)
    with pytest.raises(InvalidInputError):
        affine.resize(factor)


@pytest.mark.parametrize(("side", "size"), [(0, 10), (-3, 10), (10, 0), (np.nan, 10), (10, np.inf)])
def test_window_refuses(side, size):
    with pytest.raises(InvalidInputError):
        affine.window(0, 0, side, size)


@pytest.mark.parametrize("factor", [1e-7, 1e13, 1e200])
def test_maps_as_good_as_singular_are_refused(factor):
    with pytest.raises(InvalidInputError):
        affine.check_affine(affine.zoom(factor))
