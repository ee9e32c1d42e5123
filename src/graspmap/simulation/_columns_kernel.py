"""Compiled loops of `graspmap.simulation.columns`; imported at the first use, never before.

Letters in shapes: N cells; A angles; K cuts; L levels.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def mark_profiles(line: Integers, place: Integers, height: Floats, keep: Flags) -> None:
    """Mark cells that are a corner of the concave outline of their line's profile.

    Cells come sorted by line, then place. Of a level run only the two ends are corners; that a
    column has two edges changes nothing, since both give the same outline, shifted.

    Args:
        line: (N,) which line.
        place: (N,) where on it.
        height: (N,) metres.
        keep: (N,) out.
    """
    count = len(line)
    stack = np.empty(count, np.int64)
    start = 0
    while start < count:
        stop = start
        while stop < count and line[stop] == line[start]:
            stop += 1
        used = 0
        for i in range(start, stop):
            while used >= 2:
                a, b = stack[used - 2], stack[used - 1]
                rise = (height[b] - height[a]) * (place[i] - place[a])
                if (place[b] - place[a]) * (height[i] - height[a]) < rise:
                    break
                used -= 1
            stack[used] = i
            used += 1
        for k in range(used):
            keep[stack[k]] = True
        start = stop


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _hull_area(low: Floats, high: Floats, chain: Floats) -> float:
    """Area of the convex hull of the boxes that span low to high in each row."""
    # Right chain and left chain of the row ends, each convex.
    area = 0.0
    for side in range(2):
        used = 0
        for row in range(len(low)):
            if high[row] < low[row]:
                continue
            x = high[row] + 0.5 if side == 0 else -(low[row] - 0.5)
            for edge in range(2):
                y = row - 0.5 + edge
                while used >= 2:
                    x0, y0 = chain[used - 2, 0], chain[used - 2, 1]
                    x1, y1 = chain[used - 1, 0], chain[used - 1, 1]
                    if (y1 - y0) * (x - x0) - (x1 - x0) * (y - y0) < 0:
                        break
                    used -= 1
                chain[used, 0], chain[used, 1] = x, y
                used += 1
        for k in range(used - 1):
            area += (chain[k + 1, 1] - chain[k, 1]) * (chain[k + 1, 0] + chain[k, 0]) / 2
    return area


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def find_runs(height: Floats, levels: Floats, runs: Integers) -> int:
    """Stretches of a row that rise above a level.

    Args:
        height: (R, C) metres.
        levels: (L,) metres.
        runs: (at least R C L, 4) out: level, row, first and last column.

    Returns:
        How many there are.
    """
    count = 0
    rows, columns = height.shape
    for level in range(len(levels)):
        for row in range(rows):
            start = -1
            for column in range(columns + 1):
                above = column < columns and height[row, column] > levels[level]
                if above and start < 0:
                    start = column
                elif not above and start >= 0:
                    runs[count, 0], runs[count, 1] = level, row
                    runs[count, 2], runs[count, 3] = start, column - 1
                    count += 1
                    start = -1
    return count


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _mark_spans(runs: Integers, c: float, s: float, cut: float, low: Floats, high: Floats) -> None:
    """First and last column of each row and level on both sides of a cut.

    Args:
        runs: (K, 4) of `find_runs`.
        c: Direction across the cut, along the row.
        s: Direction across the cut, along the column.
        cut: Where the cut is: cells with c x + s y below it are on its first side.
        low: (2, L, R) out.
        high: (2, L, R) out.
    """
    low[:] = np.inf
    high[:] = -np.inf
    for k in range(len(runs)):
        level, row, start, stop = runs[k]
        if abs(c) < 1e-9:
            border = float(stop + 1) if s * row < cut else float(start)
        else:
            border = math.ceil((cut - s * row) / c)
        # Left of the border is one side, from it on the other; which is which does not matter.
        if start < border:
            low[0, level, row] = min(low[0, level, row], start)
            high[0, level, row] = max(high[0, level, row], min(float(stop), border - 1.0))
        if stop >= border:
            low[1, level, row] = min(low[1, level, row], max(float(start), border))
            high[1, level, row] = max(high[1, level, row], stop)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def score_cuts(
    runs: Integers, rows: int, levels: Floats, angles: Floats, cuts: Floats, out: Floats
) -> None:
    """How large the hulls on both sides of each cut would be: areas of their level sets, summed.

    Args:
        runs: (K, 4) of `find_runs`.
        rows: Number of rows.
        levels: (L + 1,) heights at which the hulls are compared, from 0 up to the highest.
        angles: (A,) directions across the cut.
        cuts: (A, B) where the cuts are in that direction, cells.
        out: (A, B) area times height; infinity where all cells lie on one side.
    """
    steps = len(levels) - 1
    low, high = np.empty((2, steps, rows)), np.empty((2, steps, rows))
    chain = np.empty((2 * rows + 2, 2))
    for a in range(len(angles)):
        c, s = math.cos(angles[a]), math.sin(angles[a])
        for k in range(cuts.shape[1]):
            _mark_spans(runs, c, s, cuts[a, k], low, high)
            total = 0.0
            for side in range(2):
                for level in range(steps):
                    area = _hull_area(low[side, level], high[side, level], chain)
                    if level == 0 and area == 0:
                        total = np.inf
                    total += area * (levels[level + 1] - levels[level])
            out[a, k] = total


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def draw_top(triangles: Floats, top: Floats) -> None:
    """Height of a hull over the middles of cells, from its upward triangles.

    Args:
        triangles: (T, 3, 3) x, y in cells from the middle of top[0, 0], z in metres.
        top: (R, C) raised in place.
    """
    rows, columns = top.shape
    for t in range(len(triangles)):
        x0, y0, z0 = triangles[t, 0]
        x1, y1, z1 = triangles[t, 1]
        x2, y2, z2 = triangles[t, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-9:
            continue
        first = max(math.ceil(min(y0, y1, y2) - 1e-9), 0)
        last = min(math.floor(max(y0, y1, y2) + 1e-9), rows - 1)
        left = max(math.ceil(min(x0, x1, x2) - 1e-9), 0)
        right = min(math.floor(max(x0, x1, x2) + 1e-9), columns - 1)
        for r in range(first, last + 1):
            for c in range(left, right + 1):
                b1 = ((c - x0) * (y2 - y0) - (x2 - x0) * (r - y0)) / area
                b2 = ((x1 - x0) * (r - y0) - (c - x0) * (y1 - y0)) / area
                if b1 >= -1e-9 and b2 >= -1e-9 and b1 + b2 <= 1 + 1e-9:
                    z = z0 + b1 * (z1 - z0) + b2 * (z2 - z0)
                    if z > top[r, c]:
                        top[r, c] = z
