"""Convex pieces of the block under a height map.

The hull of some columns that stand on the table is what lies under the concave outline of their
tops. A block is cut in two, upright, where that shrinks the hulls most, and each half again, until
its hull hardly exceeds the map: beside the block and above it.

Letters in shapes: R rows (y), C columns (x) of cells; N cells; P vertices of a piece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull

from graspmap.errors import InvalidInputError

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class ColumnTolerance:
    """How closely the pieces follow the map.

    Args:
        height_m: By which a hull may exceed the map.
        beside_m: How far beside the block a hull's side may lie, as high as the block there.
        share: Part of a piece's cells that may be exceeded by more.
        most_pieces: Where cutting ends in any case.
    """

    height_m: float = 0.003
    beside_m: float = 0.002
    share: float = 0.01
    most_pieces: int = 250


_ANGLES = np.radians(np.arange(0.0, 180.0, 15.0))
_PLACES = np.linspace(0.0, 1.0, 13)[1:-1]
_FINER_ANGLES = np.radians([-7.5, -3.75, 0.0, 3.75, 7.5])
_FINER_PLACES = np.linspace(-1.0, 1.0, 7) / 16
_MOST_ROWS = 150
_LEVELS = np.array([0.0, 0.2, 0.5, 0.8, 0.95, 1.0])  # of the greatest height
# The hull of whole cells would stand out from the true outline at each step of its edge, and the
# hull of their middles would be too small along the rows: something between them.
_DIAMOND = ((0.25, 0.0), (-0.25, 0.0), (0.0, 0.25), (0.0, -0.25))
_LEAST_CELLS = 9  # a piece of fewer is not cut


def convex_columns(
    heights_m: Floats, resolution_m: float, tolerance: ColumnTolerance | None = None
) -> list[Floats]:
    """Convex pieces whose hulls cover the columns under a height map.

    Args:
        heights_m: (R, C) metres, 0 where there is nothing.
        resolution_m: Side of a cell.
        tolerance: When a piece is close enough.

    Returns:
        Vertices (P, 3) of each piece's hull, metres: x and y from the middle of cell [0, 0], z from
        the table up. The same map gives the same bits.

    Raises:
        InvalidInputError: The map is empty, or a height is negative or not finite.
    """
    heights = np.asarray(heights_m, dtype=np.float64)
    if heights.ndim != 2 or not (heights > 0).any():
        raise InvalidInputError(
            "heights_m", f"shape {heights.shape}, nothing in it", "a map (R, C)"
        )
    if not np.isfinite(heights).all() or heights.min() < 0:
        raise InvalidInputError("heights_m", "negative, NaN or infinite", "metres >= 0")
    return _Cutter(heights, resolution_m, tolerance or ColumnTolerance()).run()


class _Cutter:
    """Cuts one map; cells are (row, column) pairs, lengths across are in cells, up in metres."""

    def __init__(self, heights: Floats, resolution_m: float, tolerance: ColumnTolerance) -> None:
        self._heights, self._side, self._tolerance = heights, resolution_m, tolerance
        reach = round(tolerance.beside_m / resolution_m)
        # What a hull may reach up to: the highest cell nearby, so its sides may lie a bit beside.
        span = np.arange(-reach, reach + 1)
        disc = span[:, None] ** 2 + span**2 <= reach**2 + 1
        self._allowed = np.pad(heights, reach)
        self._allowed = ndimage.grey_dilation(self._allowed, footprint=disc) + tolerance.height_m
        self._allowed = self._allowed[reach:-reach, reach:-reach] if reach else self._allowed

    def run(self) -> list[Floats]:
        labels, count = ndimage.label(self._heights > 0, np.ones((3, 3)))
        stack = [np.argwhere(labels == number) for number in range(count, 0, -1)]
        done: list[Floats] = []
        while stack:
            cells = stack.pop()
            hull = self._hull(cells)
            full = len(done) + len(stack) >= self._tolerance.most_pieces
            if full or len(cells) < _LEAST_CELLS or self._close(hull, cells):
                done.append(hull.points[hull.vertices] * (self._side, self._side, 1.0))
                continue
            first = self._first_half(cells)
            stack += [cells[~first], cells[first]]
        return done

    def _hull(self, cells: Integers) -> ConvexHull:
        """Hull of the columns, from those cells that can be corners of it."""
        from graspmap.simulation._columns_kernel import mark_profiles

        height = self._heights[cells[:, 0], cells[:, 1]]
        corner = np.ones(len(cells), np.bool_)
        for line, place in ((0, 1), (1, 0)):
            order = np.lexsort((cells[:, place], cells[:, line]))
            keep = np.zeros(len(cells), np.bool_)
            mark_profiles(cells[order, line], cells[order, place], height[order], keep)
            corner[order] &= keep
        outline = _line_ends(cells)
        y, x = np.concatenate([cells[corner], cells[outline]]).T.astype(np.float64)
        z = np.concatenate([height[corner], np.zeros(len(outline))])
        points = [np.column_stack([x + dx, y + dy, z]) for dx, dy in _DIAMOND]
        return ConvexHull(np.concatenate(points))

    def _close(self, hull: ConvexHull, cells: Integers) -> bool:
        """Whether the hull exceeds the map at few enough cells."""
        from graspmap.simulation._columns_kernel import draw_top

        low, high = cells.min(axis=0), cells.max(axis=0)
        upward = hull.simplices[hull.equations[:, 2] > 1e-9]
        top = np.zeros(high - low + 1)
        draw_top(hull.points[upward] - (low[1], low[0], 0.0), top)
        allowed = self._allowed[low[0] : high[0] + 1, low[1] : high[1] + 1]
        most = max(2.0, self._tolerance.share * len(cells))
        return bool(np.count_nonzero(top > allowed) <= most)

    def _first_half(self, cells: Integers) -> NDArray[np.bool_]:
        """(N,) the cells on one side of the cut after which the hulls are smallest."""
        low = cells.min(axis=0)
        row, column = (cells - low).T
        height = np.zeros(cells.max(axis=0) - low + 1)
        height[row, column] = self._heights[cells[:, 0], cells[:, 1]]
        score = _Cuts(height)
        angle, place = score.best(_ANGLES, np.broadcast_to(_PLACES, (len(_ANGLES), len(_PLACES))))
        # Once more, finer, around the best.
        angles = angle + _FINER_ANGLES
        angle, place = score.best(angles, np.tile(place + _FINER_PLACES, (len(angles), 1)))
        along = column * np.cos(angle) + row * np.sin(angle)
        first = np.asarray(along < score.cut(angle, place))
        if first.all() or not first.any():  # a single line of cells, and the cut along it
            first = np.arange(len(cells)) < len(cells) // 2
        return first


class _Cuts:
    """Compares cuts through one part of a map.

    A cut is an angle and a place: 0 where the part begins in that direction, 1 where it ends.
    """

    def __init__(self, height: Floats) -> None:
        from graspmap.simulation._columns_kernel import find_runs

        # Some of the rows are enough to compare; what is cut is the whole part.
        self._step = 1 + len(height) // _MOST_ROWS
        rows = np.ascontiguousarray(height[:: self._step])
        self._rows, self._levels = len(rows), _LEVELS * height.max()
        runs = np.empty((rows.size * len(_LEVELS), 4), np.int64)
        self._runs = runs[: find_runs(rows, self._levels[:-1], runs)]
        row, column = np.nonzero(height)
        self._ends = np.column_stack([column, row])[_line_ends(np.column_stack([row, column]))]

    def cut(self, angle: float, place: float) -> float:
        """Where a cut is, in cells from the first cell's row and column."""
        return float(self._where(np.array([angle]), np.array([[place]]))[0, 0])

    def _where(self, angles: Floats, places: Floats) -> Floats:
        along = self._ends @ np.array([np.cos(angles), np.sin(angles)])
        return np.asarray(along.min(axis=0)[:, None] + places * np.ptp(along, axis=0)[:, None])

    def best(self, angles: Floats, places: Floats) -> tuple[float, float]:
        """The best of some cuts; angles (A,), places (A, B)."""
        from graspmap.simulation._columns_kernel import score_cuts

        cuts = self._where(angles, places)
        scores = np.empty(cuts.shape)
        # In the thinned rows a cell is `step` high: the direction is bent to suit.
        c, s = np.cos(angles), np.sin(angles) * self._step
        length = np.hypot(c, s)
        bent = cuts / length[:, None]
        score_cuts(self._runs, self._rows, self._levels, np.arctan2(s, c), bent, scores)
        a, b = np.unravel_index(int(np.argmin(scores)), scores.shape)
        return float(angles[a]), float(places[a, b])


def _line_ends(cells: Integers) -> NDArray[np.intp]:
    """Numbers of the cells that are the first or last of their row and of their column."""
    ends = np.ones(len(cells), np.bool_)
    for line, place in ((0, 1), (1, 0)):
        order = np.lexsort((cells[:, place], cells[:, line]))
        new = np.diff(cells[order, line]) != 0
        end = np.zeros(len(cells), np.bool_)
        end[order[np.r_[True, new]]] = end[order[np.r_[new, True]]] = True
        ends &= end
    return np.flatnonzero(ends)
