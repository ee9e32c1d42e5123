"""Pictures on their way to a network: warps against SciPy and closed forms, holes, inputs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from graspmap.data import images, input_window
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry import affine
from graspmap.geometry.grasps import Grasps

MIDDLE = (60.0, 50.0)


def similarity_matrix(angle, factor, dx, dy, mirror):
    """Of a 120 x 100 px picture, about its middle."""
    flip = affine.flip(120) if mirror else np.eye(3)
    turn = affine.rotation(angle, MIDDLE)
    return affine.translation(dx, dy) @ affine.zoom(factor, MIDDLE) @ turn @ flip


def similarities(low, high):
    return st.builds(
        similarity_matrix,
        angle=st.floats(-math.pi, math.pi),
        factor=st.floats(low, high),
        dx=st.floats(-30, 30),
        dy=st.floats(-30, 30),
        mirror=st.booleans(),
    )


def smooth_picture(seed, shape=(100, 120)):
    noise = np.random.default_rng(seed).random((*shape, 3))
    return ndimage.gaussian_filter(noise, (3, 3, 0)).astype(np.float32)


def source_points(matrix, size):
    """(2, size, size) points x, y of the picture that the pixels of the result show."""
    y, x = np.mgrid[:size, :size].astype(float)
    inverse = np.linalg.inv(matrix)
    return np.stack([inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] for i in (0, 1)])


def inside(points, shape, margin):
    (x, y), (rows, columns) = points, shape
    return (x >= margin) & (x <= columns - 1 - margin) & (y >= margin) & (y <= rows - 1 - margin)


@given(matrix=similarities(0.55, 3.0), seed=st.integers(0, 9))
def test_warp_matches_scipy(matrix, seed):
    image = smooth_picture(seed)
    x, y = source_points(matrix, 90)
    expected = np.stack(
        [ndimage.map_coordinates(image[..., c], [y, x], order=1, mode="nearest") for c in range(3)],
        axis=-1,
    )
    result = images.warp(image, matrix, 90)
    # OpenCV interpolates on a grid of 1/32 px.
    np.testing.assert_allclose(result, expected, atol=0.01)
    plane = np.ascontiguousarray(image[..., 0])
    np.testing.assert_allclose(images.warp_depth(plane, matrix, 90), result[..., 0], atol=1e-6)


@given(matrix=similarities(0.06, 4.0), a=st.floats(-2, 2), b=st.floats(-2, 2))
def test_warp_of_a_ramp_is_the_ramp(matrix, a, b):
    """Also when it is shrunk by areas first: pixel centres stay where they are."""
    y, x = np.mgrid[:100, :120].astype(np.float32)
    size = 64
    u, v = source_points(matrix, size)
    shrink = 1 / math.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    seen = inside((u, v), (100, 120), shrink)
    expected = a * u + b * v + 3
    # OpenCV interpolates on a grid of 1/32 px of the shrunk picture.
    tolerance = (abs(a) + abs(b)) * max(1, shrink) / 32 + 1e-3
    for warp in (images.warp, images.warp_depth):
        result = warp((a * x + b * y + 3).astype(np.float32), matrix, size)
        np.testing.assert_allclose(result[seen], expected[seen], atol=tolerance)


@given(matrix=similarities(0.3, 3.0))
def test_mask_takes_the_nearest_pixel(matrix):
    mask = np.random.default_rng(1).random((100, 120)) > 0.5
    u, v = source_points(matrix, 70)
    nearest = mask[np.clip(np.rint(v), 0, 99).astype(int), np.clip(np.rint(u), 0, 119).astype(int)]
    # Where the nearest pixel is not in doubt.
    clear = (abs(u - np.rint(u)) < 0.45) & (abs(v - np.rint(v)) < 0.45)
    clear &= inside((u, v), mask.shape, 0)
    result = images.warp(mask, matrix, 70)
    assert result.dtype == np.bool_
    np.testing.assert_array_equal(result[clear], nearest[clear])
    assert not result[~inside((u, v), mask.shape, -1)].any()


def drawn(grasps, x, y):
    """Signed distance (largest of the two axes) from the edge of one grasp's rectangle."""
    (cx, cy), angle = grasps.center[0], grasps.angle[0]
    along = (x - cx) * math.cos(angle) - (y - cy) * math.sin(angle)
    across = (x - cx) * math.sin(angle) + (y - cy) * math.cos(angle)
    return np.maximum(abs(along) - grasps.width[0] / 2, abs(across) - grasps.height[0] / 2)


@given(
    matrix=similarities(0.2, 3.0),
    angle=st.floats(-math.pi / 2, math.pi / 2),
    width=st.floats(30, 60),
    height=st.floats(18, 28),
)
def test_warped_picture_is_the_picture_of_the_transformed_grasp(matrix, angle, width, height):
    grasp = Grasps([[57.3, 48.9]], [angle], [width], [height])
    y, x = np.mgrid[:100, :120].astype(float)
    image = np.clip(0.5 - drawn(grasp, x, y), 0, 1).astype(np.float32)
    result = images.warp(image, matrix, 96)
    y, x = np.mgrid[:96, :96].astype(float)
    expected = drawn(grasp.transformed(matrix), x, y)
    seen = inside(source_points(matrix, 96), image.shape, 0)
    assert (result[seen & (expected < -1)] > 0.5).all()
    assert (result[seen & (expected > 1)] < 0.5).all()


def test_warp_exact_cases():
    image = np.random.default_rng(0).integers(0, 256, (31, 31, 3)).astype(np.uint8)
    same = images.warp(image, np.eye(3), 31)
    np.testing.assert_array_equal(same, image)
    assert not np.shares_memory(same, image)
    np.testing.assert_array_equal(images.warp(image, affine.flip(31), 31), image[:, ::-1])
    crop = images.warp(image, affine.crop(4, 7), (20, 10))
    np.testing.assert_array_equal(crop, image[7:27, 4:14])
    blocks = image[:28, :28].astype(float).reshape(7, 4, 7, 4, 3).mean(axis=(1, 3))
    shrunk = images.warp(image[:28, :28], affine.resize(0.25), 7)
    np.testing.assert_allclose(shrunk, blocks, atol=0.51)


def test_warp_of_a_fine_pattern_does_not_alias():
    y, x = np.mgrid[:1024, :1024]
    board = ((x + y) % 2).astype(np.float32)
    for size in (300, 320, 100):
        result = images.warp(board, input_window(board.shape, size), size)
        assert abs(result - 0.5).max() < 1e-6


def test_warp_outside_the_picture():
    image = np.full((10, 10), 7, np.uint8)
    away = affine.crop(500, -300)
    assert (images.warp(image, away, 8) == 7).all()
    assert (images.warp(image, away, 8, fill=3) == 3).all()
    assert (images.warp(image, affine.zoom(1e-6), 8) == 7).all()
    mask = np.ones((10, 10), bool)
    assert not images.warp(mask, away, 8).any()
    assert images.warp(mask, away, 8, fill=True).all()


@pytest.mark.parametrize(
    ("image", "matrix", "size"),
    [
        (np.zeros((4, 4)), np.eye(3), 4),
        (np.zeros((0, 4), np.uint8), np.eye(3), 4),
        (np.zeros(4, np.uint8), np.eye(3), 4),
        (np.zeros((4, 4), np.uint8), np.zeros((3, 3)), 4),
        (np.zeros((4, 4), np.uint8), np.eye(3), 0),
    ],
)
def test_warp_refuses(image, matrix, size):
    with pytest.raises(InvalidInputError):
        images.warp(image, matrix, size)


# Holes


def plane_with_holes(shape=(60, 80), share=0.2, seed=0):
    y, x = np.mgrid[: shape[0], : shape[1]]
    depth = (1.4 + 0.002 * x + 0.001 * y).astype(np.float32)
    rng = np.random.default_rng(seed)
    holes = ndimage.binary_dilation(rng.random(shape) < share / 9, np.ones((3, 3)))
    return depth, np.where(holes, np.float32(np.nan), depth)


@given(seed=st.integers(0, 100), share=st.floats(0.01, 0.6))
def test_fill_keeps_measurements_and_continues_a_plane(seed, share):
    depth, given_depth = plane_with_holes(share=share, seed=seed)
    filled = images.fill_depth(given_depth)
    valid = ~np.isnan(given_depth)
    assert filled.dtype == np.float32
    np.testing.assert_array_equal(filled[valid], given_depth[valid])
    np.testing.assert_allclose(filled, depth, atol=0.02)


@given(factor=st.floats(1e-3, 1e3))
def test_fill_does_not_depend_on_the_unit(factor):
    _, given_depth = plane_with_holes()
    scaled = images.fill_depth((given_depth * np.float32(factor)).astype(np.float32))
    np.testing.assert_allclose(scaled, images.fill_depth(given_depth) * factor, rtol=1e-4)


def test_fill_of_wide_holes_stays_between_their_edges():
    depth, _ = plane_with_holes((401, 503))
    wide = depth.copy()
    wide[40:360, 50:450] = np.inf  # 128,000 pixels: filled on coarser pictures
    filled = images.fill_depth(wide)
    assert np.isfinite(filled).all()
    assert filled.min() >= depth.min() - 1e-5
    assert filled.max() <= depth.max() + 1e-5
    assert abs(filled - depth)[38:46, 48:452].max() < 0.02  # near the edge it continues it


def test_fill_of_nothing_and_of_everything():
    depth, _ = plane_with_holes()
    assert images.fill_depth(depth) is depth
    with pytest.raises(InvalidInputError, match="nothing but holes"):
        images.fill_depth(np.full((5, 5), np.nan, np.float32))
    with pytest.raises(InvalidInputError, match="float32"):
        images.fill_depth(np.ones((5, 5)))  # type: ignore[arg-type]
    one = np.full((50, 50), np.nan, np.float32)
    one[3, 4] = 1.5
    np.testing.assert_allclose(images.fill_depth(one), 1.5, rtol=1e-6)


def test_warped_depth_never_mixes_in_a_hole():
    depth = np.full((200, 200), 1.5, np.float32)
    depth[np.random.default_rng(0).random(depth.shape) < 0.5] = np.nan
    for factor in (0.2, 0.7, 1.6):
        result = images.warp_depth(depth, affine.zoom(factor), 30)
        np.testing.assert_allclose(result, 1.5, rtol=1e-6)


def test_depth_of_users_is_cleaned():
    found = [[1.0, np.nan, np.inf], [0.0, -1.0, 2.0]]
    expected = np.float32([[1, np.nan, np.nan], [np.nan, np.nan, 2]])
    np.testing.assert_array_equal(images.check_depth_m(found, "x"), expected)


@pytest.mark.parametrize(
    ("depth", "message"),
    [
        (np.full((4, 4), 1500, np.uint16), "millimetres"),
        (np.full((4, 4), 850.0), "divide by 1000"),
        (np.full((4, 4), np.nan), "without a single measurement"),
        (np.zeros((4, 4)), "without a single measurement"),
        (np.ones((4, 4), np.uint8), "type"),
        (np.ones((4, 4), bool), "type"),
        (np.ones((4, 4, 3)), "shape"),
        (np.ones((0, 4)), "shape"),
    ],
)
def test_depth_of_users_is_refused(depth, message):
    with pytest.raises(InvalidInputError, match=message) as error:
        images.check_depth_m(depth, "depth.tiff")
    assert "depth.tiff" in str(error.value)


# Windows


@given(
    rows=st.integers(1, 2000),
    columns=st.integers(1, 2000),
    size=st.integers(1, 400),
    view=st.one_of(st.sampled_from(["contain", "cover"]), st.integers(1, 3000)),
)
def test_input_window_shows_the_centre_square(rows, columns, size, view):
    matrix = input_window((rows, columns), size, view=view)
    side = {"contain": max(rows, columns), "cover": min(rows, columns)}.get(view, view)
    edges = affine.apply(np.linalg.inv(matrix), [[-0.5, -0.5], [size - 0.5, size - 0.5]])
    np.testing.assert_allclose(edges[1] - edges[0], side)
    middle = edges.mean(axis=0)
    assert abs(middle - [(columns - 1) / 2, (rows - 1) / 2]).max() <= 0.5 + 1e-9
    np.testing.assert_allclose(edges[0] + 0.5, np.rint(edges[0] + 0.5), atol=1e-6)


def test_input_window_of_the_same_size_is_a_crop():
    np.testing.assert_allclose(
        input_window((480, 640), 300, view=300), affine.crop(170, 90), atol=1e-12
    )


def test_input_window_of_a_region():
    matrix = input_window((480, 640), 160, region_xywh=(100, 50, 40, 80))
    corners = affine.apply(matrix, [[99.5, 49.5], [139.5, 129.5]])
    np.testing.assert_allclose(corners, [[39.5, -0.5], [119.5, 159.5]])


@pytest.mark.parametrize("view", ["fill", 0, -3, True, 2.5])
def test_input_window_refuses(view):
    with pytest.raises(InvalidInputError, match="contain"):
        input_window((10, 10), 5, view=view)


@pytest.mark.parametrize("region", [(0, 0, 0, 5), (0, 0, 5, -1), (0, 0, 5), (0, math.nan, 5, 5)])
def test_input_window_of_a_region_refuses(region):
    with pytest.raises(InvalidInputError, match="region"):
        input_window((10, 10), 5, region_xywh=region)


# The input of a network


def test_input_is_what_the_formula_says():
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (20, 20, 3)).astype(np.uint8)
    depth = rng.uniform(0.2, 4, (20, 20)).astype(np.float32)
    x = images.to_input(rgb, depth, "rgbd", np.eye(3), 20)
    assert x.shape == (4, 20, 20)
    assert x.dtype == np.float32
    assert x.flags.c_contiguous
    np.testing.assert_allclose(x[0], np.clip(depth - depth.mean(), -1, 1), atol=1e-5)
    color = rgb / 255 - (rgb / 255).mean()
    np.testing.assert_allclose(x[1:], color.transpose(2, 0, 1), atol=1e-6)
    np.testing.assert_array_equal(images.to_input(rgb, None, "rgb", np.eye(3), 20), x[1:])
    np.testing.assert_array_equal(images.to_input(None, depth, "depth", np.eye(3), 20), x[:1])


@pytest.mark.parametrize("channels", ["depth", "rgb", "rgbd"])
def test_channel_counts(channels):
    rgb, depth = np.zeros((8, 9, 3), np.uint8), np.ones((8, 9), np.float32)
    matrix = input_window((8, 9), 5)
    x = images.to_input(rgb, depth, channels, matrix, 5)
    assert x.shape == (images.channel_count(channels), 5, 5)


def test_input_refuses():
    rgb, depth = np.zeros((8, 8, 3), np.uint8), np.ones((8, 8), np.float32)
    eye = np.eye(3)
    with pytest.raises(InvalidInputError, match="rgb of the scene is missing"):
        images.to_input(None, depth, "rgbd", eye, 8)
    with pytest.raises(InvalidInputError, match="depth of the scene is missing"):
        images.to_input(rgb, None, "depth", eye, 8)
    with pytest.raises(InvalidInputError, match="shape of the depth"):
        images.to_input(rgb, depth[:4], "rgbd", eye, 8)
    with pytest.raises(InvalidInputError, match="type of depth"):
        images.to_input(rgb, depth.astype(float), "rgbd", eye, 8)  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="shape of rgb"):
        images.to_input(rgb[..., 0], depth, "rgb", eye, 8)
    with pytest.raises(InvalidInputError, match="nothing but holes"):
        images.to_input(None, depth * np.float32(np.nan), "depth", eye, 8)
    with pytest.raises(UnknownNameError, match="did you mean 'rgbd'"):
        images.to_input(rgb, depth, "rgb-d", eye, 8)


def test_input_of_real_pictures(data_dir):
    """Filled before or after shrinking: the difference stays inside the holes."""
    from graspmap.data import read_scenes

    scene = read_scenes(f"jacquard:{data_dir / 'jacquard'}", depth="stereo").read(0)
    matrix = input_window(scene.shape, 300)
    x = images.to_input(scene.rgb, scene.depth, "rgbd", matrix, 300)
    assert np.isfinite(x).all()
    full = images.warp(images.fill_depth(scene.depth), matrix, 300)
    holes = images.warp(np.isnan(scene.depth).astype(np.float32), matrix, 300) > 0
    difference = abs((full - full.mean()) - x[0])
    assert np.median(difference) < 1e-4
    assert difference[~holes].max() < 0.01
