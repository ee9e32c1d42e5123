"""Convex columns: they cover the map, hardly exceed it, and blocks weigh what their columns do."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial import ConvexHull

from graspmap.errors import InvalidInputError
from graspmap.simulation.block import block_from_heights, column_moments, height_mesh
from graspmap.simulation.columns import ColumnTolerance, convex_columns

SIDE = 0.001


def random_map(seed):
    """Boxes, domes, bars and ramps on one another, with holes in them."""
    rng = np.random.default_rng(seed)
    heights = np.zeros(rng.integers(8, 70, 2))
    rows, columns = np.mgrid[: heights.shape[0], : heights.shape[1]]
    for _ in range(rng.integers(1, 5)):
        y, x = rng.uniform(0, heights.shape)
        angle, top = rng.uniform(0, np.pi), rng.uniform(0.005, 0.06)
        u = np.cos(angle) * (columns - x) + np.sin(angle) * (rows - y)
        v = np.cos(angle) * (rows - y) - np.sin(angle) * (columns - x)
        a, b = rng.uniform(2, 30, 2)
        box = (np.abs(u) < a) & (np.abs(v) < b)
        dome = np.sqrt(np.clip(1 - (u / a) ** 2 - (v / b) ** 2, 0, None))
        ramp = box * (1 + u / a) / 2
        heights = np.maximum(heights, top * (box, dome, ramp)[rng.integers(3)])
    heights[rng.random(heights.shape) < rng.choice([0, 0.002])] = 0
    heights[heights < 0.002] = 0
    if not heights.any():
        heights[2:5, 2:5] = 0.02
    return heights


def planes(piece):
    return ConvexHull(piece).equations


def middles(heights):
    rows, columns = np.nonzero(heights)
    return np.column_stack([columns * SIDE, rows * SIDE, heights[rows, columns]])


@settings(max_examples=30)
@given(st.integers(0, 100_000))
def test_every_column_is_in_a_piece(seed):
    heights = random_map(seed)
    points = middles(heights)
    covered = np.zeros(len(points), bool)
    for piece in convex_columns(heights, SIDE):
        assert piece.shape[1] == 3
        assert piece[:, 2].min() == 0
        normals = planes(piece)
        inside = points @ normals[:, :3].T + normals[:, 3] < 1e-7
        foot = (points * (1, 1, 0)) @ normals[:, :3].T + normals[:, 3] < 1e-7
        covered |= inside.all(axis=1) & foot.all(axis=1)
    assert covered.all()


@settings(max_examples=30)
@given(st.integers(0, 100_000), st.sampled_from([0.001, 0.002, 0.004]))
def test_no_piece_exceeds_the_map_by_more_than_allowed(seed, tolerance_m):
    """Brute force: the height of each hull over every cell, from its planes."""
    heights = random_map(seed)
    tolerance = ColumnTolerance(height_m=tolerance_m, beside_m=tolerance_m)
    reach = round(tolerance_m / SIDE)
    span = np.arange(-reach, reach + 1)
    near = span[:, None] ** 2 + span**2 <= reach**2 + 1
    allowed = ndimage.grey_dilation(np.pad(heights, reach), footprint=near)[
        reach : len(heights) + reach, reach : heights.shape[1] + reach
    ]
    rows, columns = np.indices(heights.shape).reshape(2, -1)
    points = np.column_stack([columns, rows]) * SIDE
    for piece in convex_columns(heights, SIDE, tolerance):
        normals = planes(piece)
        up, side = normals[normals[:, 2] > 1e-9], normals[np.abs(normals[:, 2]) <= 1e-9]
        top = (-(points @ up[:, :2].T + up[:, 3]) / up[:, 2]).min(axis=1)
        over = (points @ side[:, :2].T + side[:, 3] < 1e-9).all(axis=1)
        too_high = over & (top > allowed.ravel() + tolerance_m + 1e-9)
        owned = over & (heights.ravel() > 0)
        # A piece has at least the cells it exceeds by little; of small ones two cells may be off.
        assert too_high.sum() <= max(2, 0.01 * max(owned.sum(), 9)) or owned.sum() < 9


def test_the_same_map_gives_the_same_bits():
    for seed in range(5):
        first, second = (convex_columns(random_map(seed), SIDE) for _ in range(2))
        assert len(first) == len(second)
        assert all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))


def test_what_is_convex_stays_whole():
    rows, columns = np.mgrid[:60, :80]
    box = np.full((20, 30), 0.05)
    dome = 0.03 * np.sqrt(
        np.clip(1 - ((rows - 30) / 28) ** 2 - ((columns - 40) / 38) ** 2, 0, None)
    )
    turned = np.abs(0.8 * (columns - 40) + 0.6 * (rows - 30)) < 20
    turned &= np.abs(0.8 * (rows - 30) - 0.6 * (columns - 40)) < 8
    for heights in (box, dome, 0.04 * turned):
        assert len(convex_columns(heights, SIDE)) == 1


@pytest.mark.parametrize(("angle", "most"), [(0, 2), (20, 4), (45, 4)])
def test_few_pieces_where_few_are_enough(angle, most):
    """An L: two bars that meet in a corner, however it lies."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    rows, columns = np.mgrid[-80:81, -80:81]
    u, v = c * columns + s * rows, c * rows - s * columns
    bars = (np.abs(u) < 70) & (np.abs(v) < 5) | (np.abs(u - 65) < 5) & (v >= 0) & (v < 60)
    assert 2 <= len(convex_columns(0.03 * bars, SIDE)) <= most


def test_a_gap_beside_a_part_stays_open():
    """Two bars 15 mm apart with a bridge at one end: a finger fits between them."""
    heights = np.zeros((80, 40))
    heights[:, :10] = heights[:, 25:35] = 0.03
    heights[:8, :35] = 0.03
    for piece in convex_columns(heights, SIDE):
        normals = planes(piece)
        for row in range(15, 80):
            points = np.array([(x * SIDE, row * SIDE, 0.01) for x in range(13, 22)])
            assert not (points @ normals[:, :3].T + normals[:, 3] < 0).all(axis=1).any()


def test_the_number_of_pieces_is_bounded():
    rng = np.random.default_rng(0)
    noise = rng.uniform(0.01, 0.06, (40, 40))
    few = convex_columns(noise, SIDE, ColumnTolerance(most_pieces=7))
    assert len(few) <= 8
    assert len(convex_columns(noise, SIDE)) > 8


@pytest.mark.parametrize(
    "heights", [np.zeros((3, 3)), np.zeros((0, 0)), [[np.nan, 1.0]], [[-1.0, 1.0]], [1.0, 2.0]]
)
def test_refuses_what_is_no_map(heights):
    with pytest.raises(InvalidInputError):
        convex_columns(np.asarray(heights), SIDE)


@settings(max_examples=30)
@given(st.integers(0, 100_000))
def test_moments_against_boxes_added_one_by_one(seed):
    heights = random_map(seed)[:20, :20]
    heights[0, 0] = 0.01
    volume, center, moments = column_moments(heights, SIDE)
    boxes = []
    for row, column in np.argwhere(heights):
        high = heights[row, column]
        box = trimesh.creation.box((SIDE, SIDE, high))
        box.apply_translation((column * SIDE, row * SIDE, high / 2))
        boxes.append(box)
    whole = trimesh.util.concatenate(boxes)
    assert volume == pytest.approx(whole.volume)
    np.testing.assert_allclose(center, whole.center_mass, atol=1e-9)
    np.testing.assert_allclose(moments, whole.moment_inertia, rtol=1e-6, atol=1e-16)


@settings(max_examples=30)
@given(st.integers(0, 100_000))
def test_the_surface_is_closed_and_holds_the_columns(seed):
    heights = random_map(seed)
    vertices, faces = height_mesh(heights, SIDE)
    surface = trimesh.Trimesh(vertices, faces, process=False)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume > 0
    np.testing.assert_allclose(vertices[:, 2].max(), heights.max(), atol=heights.max() * 0.8)
    # The corners are means of the cells around them: of a level top none is lost.
    level = np.where(heights > 0, 0.02, 0.0)
    flat = trimesh.Trimesh(*height_mesh(level, SIDE), process=False)
    assert flat.volume == pytest.approx(level.sum() * SIDE**2)


def test_mass_stays_within_its_range():
    box = np.full((50, 50), 0.04)  # 100 cm3

    def mass(density, low, high):
        placed = block_from_heights(
            "box", box, np.zeros(2), SIDE, density_kg_m3=density, mass_range_kg=(low, high)
        )
        return placed.model.mass_kg, placed.model.inertia

    assert mass(500, 0.01, 1)[0] == pytest.approx(0.05)
    assert mass(500, 0.1, 1)[0] == pytest.approx(0.1)
    heavy, inertia = mass(5000, 0.1, 0.2)
    assert heavy == pytest.approx(0.2)
    # A cuboid's closed form.
    expected = 0.2 / 12 * np.array([0.05**2 + 0.04**2, 0.05**2 + 0.04**2, 2 * 0.05**2])
    np.testing.assert_allclose(np.diag(inertia), expected, rtol=1e-3)
