"""Augmentation: one map moves picture and grasps; the ranges are what they say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.data import images, input_window
from graspmap.data.augment import NONE, PUBLISHED, Augmentation
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry import affine
from graspmap.geometry.affine import check_similarity
from graspmap.geometry.grasps import Grasps

augmentations = st.builds(
    Augmentation,
    rotation=st.sampled_from(["any", "quarter", "none"]),
    zoom=st.tuples(st.floats(0.4, 1), st.floats(1, 1.6)),
    flip=st.booleans(),
    shift=st.floats(0, 0.2),
)


def signed_distance(grasps, x, y):
    (cx, cy), angle = grasps.center[0], grasps.angle[0]
    along = (x - cx) * math.cos(angle) - (y - cy) * math.sin(angle)
    across = (x - cx) * math.sin(angle) + (y - cy) * math.cos(angle)
    return np.maximum(abs(along) - grasps.width[0] / 2, abs(across) - grasps.height[0] / 2)


@given(
    augmentation=augmentations,
    seed=st.integers(0, 2**32),
    shape=st.tuples(st.integers(120, 400), st.integers(120, 400)),
    angle=st.floats(-math.pi / 2, math.pi / 2),
)
def test_scene_and_grasps_move_together(augmentation, seed, shape, angle):
    """A drawn rectangle, warped, is the rectangle drawn from the transformed grasp."""
    size = 100
    unit = max(shape) / size
    center = [(shape[1] - 1) / 2 + 3.3, (shape[0] - 1) / 2 - 4.1]
    grasp = Grasps([center], [angle], [40 * unit], [18 * unit])
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    image = np.clip(0.5 - signed_distance(grasp, x, y), 0, 1).astype(np.float32)
    matrix = augmentation.draw(np.random.default_rng(seed), size)
    matrix = matrix @ input_window(shape, size)
    result = images.warp(image, matrix, size, fill=0)
    y, x = np.mgrid[:size, :size].astype(float)
    expected = signed_distance(grasp.transformed(matrix), x, y)
    inverse = np.linalg.inv(matrix)
    u, v = (inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] for i in (0, 1))
    seen = (u >= 0) & (u <= shape[1] - 1) & (v >= 0) & (v <= shape[0] - 1)
    assert (result[seen & (expected < -1)] > 0.5).all()
    assert (result[seen & (expected > 1)] < 0.5).all()


@given(augmentation=augmentations, seed=st.integers(0, 2**32), size=st.integers(1, 400))
def test_draw_is_a_similarity_in_range(augmentation, seed, size):
    matrix = augmentation.draw(np.random.default_rng(seed), size)
    linear, _, scale = check_similarity(matrix)
    low, high = augmentation.zoom
    assert 1 / high - 1e-9 <= scale <= 1 / low + 1e-9
    if not augmentation.flip:
        assert np.linalg.det(linear) > 0
    middle = np.full((1, 2), (size - 1) / 2)
    moved = affine.apply(matrix, middle) - middle
    assert abs(moved).max() <= augmentation.shift * size + 1e-9
    if augmentation.rotation != "any":
        angle = math.atan2(abs(linear[1, 0]), abs(linear[0, 0]))
        assert min(angle, math.pi / 2 - angle) < 1e-9
    again = augmentation.draw(np.random.default_rng(seed), size)
    np.testing.assert_array_equal(matrix, again)


def test_published_range_is_covered():
    drawn = [PUBLISHED.draw(np.random.default_rng([5, i]), 300) for i in range(400)]
    parts = np.array([1 / check_similarity(m)[2] for m in drawn])
    assert 0.5 <= parts.min() < 0.51
    assert 0.99 < parts.max() <= 1.0
    assert abs(parts.mean() - 0.75) < 0.03
    turns = {tuple(np.rint(m[:2, :2] / check_similarity(m)[2]).ravel()) for m in drawn}
    assert len(turns) == 4


def test_zoom_shows_the_centre():
    """The central f of the picture fills the frame."""
    matrix = Augmentation("none", (0.5, 0.5)).draw(np.random.default_rng(0), 300)
    corners = affine.apply(matrix, [[74.5, 74.5], [224.5, 224.5]])
    np.testing.assert_allclose(corners, [[-0.5, -0.5], [299.5, 299.5]])


def test_none_moves_nothing_and_quarter_turns_do_not_resample():
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(NONE.draw(rng, 300), np.eye(3))
    image = rng.integers(0, 256, (30, 30, 3)).astype(np.uint8)
    turned = {k: np.rot90(image, k).tobytes() for k in range(4)}
    turns = set()
    for _ in range(40):
        matrix = Augmentation("quarter").draw(rng, 30)
        result = images.warp(image, matrix, 30).tobytes()
        turns |= {k for k, expected in turned.items() if result == expected}
        assert result in turned.values()
    assert turns == {0, 1, 2, 3}


def test_options_do_not_disturb_each_other():
    plain = Augmentation("any").draw(np.random.default_rng(1), 100)
    zoomed = Augmentation("any", (0.5, 0.5)).draw(np.random.default_rng(1), 100)
    np.testing.assert_allclose(zoomed[:2, :2], 2 * plain[:2, :2])


@pytest.mark.parametrize(
    "settings",
    [
        {"zoom": (1.0, 0.5)},
        {"zoom": (0.0, 1.0)},
        {"zoom": (0.5, math.nan)},
        {"zoom": (1.0,)},
        {"shift": -0.1},
        {"shift": math.nan},
    ],
)
def test_settings_are_checked(settings):
    with pytest.raises(InvalidInputError):
        Augmentation(**settings)


def test_unknown_rotation_names_the_nearest():
    with pytest.raises(UnknownNameError, match="did you mean 'quarter'"):
        Augmentation("quarters")  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="size"):
        NONE.draw(np.random.default_rng(0), 0)
