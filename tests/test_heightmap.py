"""HeightMap: what one sees straight from above, against other ways to compute it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from graspmap.errors import InvalidInputError
from graspmap.simulation.heightmap import MOST_CELLS, HeightMap
from studies._rays import RayCaster

place = st.floats(-0.02, 0.02)
triangle_soups = st.lists(
    st.tuples(*[st.tuples(place, place, st.floats(-0.01, 0.05))] * 3), min_size=1, max_size=6
).map(np.array)


def box(low, high):
    """(12, 3, 3) triangles of an axis-aligned box."""
    corners = np.array([[(low, high)[(i >> k) & 1][k] for k in range(3)] for i in range(8)])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return np.array([corners[[q[0], q[i], q[i + 1]]] for q in quads for i in (1, 2)])


def all_middles(height_map):
    rows, columns = height_map.heights_m.shape
    return height_map.middles(np.stack(np.mgrid[:rows, :columns], axis=-1))


def highest_over(point, triangles):
    """Height over a point by solving for the parts of the corners, triangle by triangle."""
    best = 0.0
    for corners in triangles:
        flat = np.vstack([corners[:, :2].T, np.ones(3)])
        if abs(np.linalg.det(flat)) < 1e-15:
            continue
        parts = np.linalg.solve(flat, [*point, 1.0])
        if parts.min() >= 0:
            best = max(best, float(parts @ corners[:, 2]))
    return best


class TestFromTriangles:
    def test_of_a_box(self):
        h = HeightMap.from_triangles(box((-0.01, 0.002, 0), (0.02, 0.012, 0.03)))
        inside = np.isclose(h.heights_m, 0.03, atol=1e-8)
        assert inside.sum() == 30 * 10
        assert h.heights_m[~inside].max(initial=0) == 0
        middles = all_middles(h)[inside]
        assert middles.min(axis=0) == pytest.approx([-0.0095, 0.0025])
        assert middles.max(axis=0) == pytest.approx([0.0195, 0.0115])
        assert h.top_m == pytest.approx(0.03)
        assert (h.mask() == inside).all()

    @settings(max_examples=12)
    @given(triangle_soups)
    def test_agrees_with_solving_each_triangle(self, triangles):
        h = HeightMap.from_triangles(triangles, 0.004)
        for (row, column), height in np.ndenumerate(h.heights_m):
            point = h.middles(np.array([row, column]))
            # Where a middle lies on an outline, either answer is right.
            around = [
                highest_over(point + np.array([dx, dy]) * 1e-8, triangles)
                for dx in (-1, 0, 1)
                for dy in (-1, 0, 1)
            ]
            steep = np.ptp(triangles[:, :, 2])
            assert min(around) - 1e-6 <= height <= max(around) + 1e-6 + 1e-4 * steep

    @given(triangle_soups)
    def test_nothing_sticks_out_of_the_grid(self, triangles):
        h = HeightMap.from_triangles(triangles, 0.004)
        above = triangles[(triangles[:, :, 2] > 0).any(axis=1)]
        if len(above):
            reach = h.origin_m + 0.004 * (np.array(h.heights_m.shape)[::-1] - 0.5)
            assert (above[..., :2].max(axis=(0, 1)) <= reach + 1e-12).all()
            assert (above[..., :2].min(axis=(0, 1)) >= h.origin_m - 0.002 - 1e-12).all()
        assert h.top_m <= max(above[..., 2].max(initial=0), 0) + 1e-8

    @given(triangle_soups, st.integers(-50, 50), st.integers(-50, 50))
    def test_moving_by_whole_cells_moves_the_grid(self, triangles, dx, dy):
        # Powers of two, so that the move itself rounds nothing.
        cell = 2.0**-8
        triangles = np.round(triangles / 2**-20) * 2**-20
        moved = triangles + np.array([dx * cell, dy * cell, 0])
        here = HeightMap.from_triangles(triangles, cell)
        there = HeightMap.from_triangles(moved, cell)
        if here.heights_m.size:
            assert there.origin_m - here.origin_m == pytest.approx([dx * cell, dy * cell])
        assert np.array_equal(here.heights_m, there.heights_m)

    @settings(max_examples=20)
    @given(st.integers(0, 1000))
    def test_triangles_that_share_edges_leave_no_holes(self, seed):
        rng = np.random.default_rng(seed)
        # Corners on a lattice: many edges run exactly through middles of cells.
        corners = [(0, 0), (0, 40), (40, 0), (40, 40)]
        plan = np.unique(np.concatenate([corners, rng.integers(0, 41, (60, 2))]), axis=0)
        points = np.column_stack([(plan + 0.5) * 0.001, np.full(len(plan), 0.02)])
        h = HeightMap.from_triangles(points[Delaunay(plan).simplices])
        assert np.allclose(h.heights_m, 0.02)
        assert h.heights_m.shape == (41, 41)

    def test_agrees_with_casting_rays(self):
        rng = np.random.default_rng(3)
        triangles = rng.uniform(-0.03, 0.03, (200, 1, 3)) + rng.uniform(-0.01, 0.01, (200, 3, 3))
        triangles[..., 2] += 0.03
        h = HeightMap.from_triangles(triangles)
        middles = all_middles(h).reshape(-1, 2)
        origins = np.column_stack([middles, np.ones(len(middles))])
        down = np.tile([0.0, 0.0, -1.0], (len(middles), 1))
        caster = RayCaster(triangles)
        distance = caster.distances(origins, down, caster.first_hit(origins, down))
        seen = np.maximum(np.where(np.isfinite(distance), 1 - distance, 0), 0)
        # Single-precision rays see the other side of some outlines.
        assert (np.abs(seen - h.heights_m.ravel()) > 1e-6).mean() < 0.001

    def test_counts_only_what_is_above_the_table(self):
        h = HeightMap.from_triangles(box((0, 0, -0.02), (0.01, 0.01, 0.02)))
        assert h.top_m == pytest.approx(0.02)
        assert np.isin(h.heights_m, [0, np.float32(0.02)]).all()
        below = HeightMap.from_triangles(box((0, 0, -0.02), (0.01, 0.01, -0.01)))
        assert below.heights_m.size == 0
        ramp = np.array([[(0, 0, -0.02), (0.04, 0, 0.02), (0.04, 0.04, 0.02)]])
        assert HeightMap.from_triangles(ramp).heights_m.min() == 0

    def test_walls_show_only_their_top(self):
        wall = np.array([[(0, 0.0005, 0), (0.01, 0.0005, 0), (0.01, 0.0005, 0.03)]])
        assert HeightMap.from_triangles(wall).top_m == 0

    def test_of_nothing(self):
        h = HeightMap.from_triangles(np.zeros((0, 3, 3)))
        assert h.at([[0, 0], [1, 1]]).tolist() == [0, 0]
        assert h.top_m == 0
        assert not h.mask().any()

    @pytest.mark.parametrize(
        ("triangles", "resolution", "match"),
        [
            (np.zeros((3, 3)), 0.001, "shape of triangles"),
            (np.full((1, 3, 3), np.nan), 0.001, "NaN"),
            (np.eye(3)[None], 0, "resolution"),
            (np.eye(3)[None], np.nan, "resolution"),
            (np.eye(3)[None] * 100, 0.001, str(MOST_CELLS)),
            (np.eye(3)[None] * 1e300, 0.001, str(MOST_CELLS)),
        ],
    )
    def test_refuses(self, triangles, resolution, match):
        with pytest.raises(InvalidInputError, match=match):
            HeightMap.from_triangles(triangles, resolution)


class TestValue:
    map = HeightMap(np.arange(6, dtype=np.float32).reshape(2, 3), [0.1, -0.2], 0.01)

    def test_at_is_the_cell_that_a_point_lies_in(self):
        inside = [[0.1, -0.2], [0.104, -0.196], [0.106, -0.204], [0.12, -0.19], [0.124, -0.186]]
        assert self.map.at(inside).tolist() == [0, 0, 1, 5, 5]
        outside = [[0.094, -0.19], [0.126, -0.19], [0.12, -0.206], [0.12, -0.184], [9, 9]]
        assert self.map.at(outside).tolist() == [0] * 5
        assert self.map.at([0.12, -0.19]) == 5
        assert self.map.at(np.zeros((4, 0, 2))).shape == (4, 0)

    @given(st.tuples(st.integers(0, 1), st.integers(0, 2)))
    def test_middles_lie_in_their_cells(self, cell):
        assert self.map.at(self.map.middles(np.array(cell))) == self.map.heights_m[cell]

    def test_arrays_cannot_be_written(self):
        with pytest.raises(ValueError, match="read-only"):
            self.map.heights_m[0, 0] = 1
        with pytest.raises(ValueError, match="read-only"):
            self.map.origin_m[0] = 1

    @pytest.mark.parametrize(
        ("heights", "origin", "resolution", "match"),
        [
            ([0, 1], [0, 0], 0.001, "shape of heights_m"),
            ([[0, -1]], [0, 0], 0.001, "heights_m"),
            ([[0, np.nan]], [0, 0], 0.001, "heights_m"),
            ([[0, np.inf]], [0, 0], 0.001, "heights_m"),
            ([[0, 1]], [0, 0, 0], 0.001, "origin_m"),
            ([[0, 1]], [0, np.nan], 0.001, "origin_m"),
            ([[0, 1]], [0, 0], -1, "resolution_m"),
        ],
    )
    def test_refuses(self, heights, origin, resolution, match):
        with pytest.raises(InvalidInputError, match=match):
            HeightMap(heights, origin, resolution)

    @pytest.mark.parametrize("points", [[1, 2, 3], [[np.nan, 0]], [[np.inf, 0]]])
    def test_at_refuses(self, points):
        with pytest.raises(InvalidInputError, match="points_m"):
            self.map.at(points)
