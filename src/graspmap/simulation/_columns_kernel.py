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
def _hull_area(low: Floats, high: Floats, first: int, last: int, chain: Floats) -> float:
    """Area of the convex hull of the boxes that span low to high in rows first to last."""
    # Right chain and left chain of the row ends, each convex.
    area = 0.0
    for side in range(2):
        used = 0
        for row in range(first, last + 1):
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
def score_cuts(
    column: Integers,
    row: Integers,
    height: Floats,
    angles: Floats,
    shares: Floats,
    levels: Floats,
    out: Floats,
) -> None:
    """How large the hulls on both sides of each cut would be: areas of their level sets, summed.

    Args:
        column: (N,) from 0.
        row: (N,) from 0.
        height: (N,) metres.
        angles: (A,) directions across the cut.
        shares: (K,) where the cut lies between the first and the last cell in that direction.
        levels: (L,) heights at which the hulls are compared, from 0 up.
        out: (A, K) area times height, cells; infinity where all cells lie on one side.
    """
    count, rows = len(column), row.max() + 1
    low, high = np.empty((len(levels), rows)), np.empty((len(levels), rows))
    chain = np.empty((2 * rows + 2, 2))
    along = np.empty(count)
    for a in range(len(angles)):
        c, s = math.cos(angles[a]), math.sin(angles[a])
        for i in range(count):
            along[i] = c * column[i] + s * row[i]
        begin, end = along.min(), along.max()
        for k in range(len(shares)):
            cut = begin + shares[k] * (end - begin)
            total = 0.0
            for side in range(2):
                low[:] = np.inf
                high[:] = -np.inf
                some = False
                for i in range(count):
                    if (along[i] < cut) != (side == 0):
                        continue
                    some = True
                    r, x = row[i], float(column[i])
                    for level in range(len(levels)):
                        if height[i] <= levels[level]:
                            break
                        if x < low[level, r]:
                            low[level, r] = x
                        if x > high[level, r]:
                            high[level, r] = x
                if not some:
                    total = np.inf
                    break
                for level in range(len(levels)):
                    above = levels[level + 1] if level + 1 < len(levels) else height.max()
                    area = _hull_area(low[level], high[level], 0, rows - 1, chain)
                    total += area * (above - levels[level])
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
