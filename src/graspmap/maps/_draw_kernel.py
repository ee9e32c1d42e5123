"""Compiled loops of `graspmap.maps.draw`; imported at the first drawing, never before.

Letters in shapes: K grasps, N orientation bins, (H, W) image. A region is a rotated rectangle, so
the pixels it covers in one image row are contiguous: every loop below first finds these row spans
and then walks them.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

TOLERANCE_PX = 1e-6
"""A pixel centre this far outside the border of a region still counts as covered, so that
rounding does not decide about the pixels that lie on the border itself."""


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _limits(low: float, high: float, slope: float, offset: float, half: float) -> Any:
    """Cut [low, high] down to the x with |slope x + offset| <= half."""
    if slope == 0.0:
        return (low, high) if abs(offset) <= half else (1.0, 0.0)
    first, second = (-half - offset) / slope, (half - offset) / slope
    return max(low, min(first, second)), min(high, max(first, second))


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def row_spans(region: Floats, shape: tuple[int, int], start: Integers, stop: Integers) -> Any:
    """Columns that a region covers in each row of the image.

    Args:
        region: (6,) centre x, centre y, cos a, sin a, half size along the opening, half size
            along the jaw; pixels and radians.
        shape: (H, W).
        start: (H,) out: first covered column of each row in the returned range.
        stop: (H,) out: one past the last covered column; rows without any have stop <= start.

    Returns:
        First row and one past the last row; equal when the region covers no pixel centre of the
        image.
    """
    x, y, c, s, half_u, half_v = region
    rows, columns = shape
    reach = half_u * abs(s) + half_v * abs(c) + TOLERANCE_PX
    top = math.ceil(min(max(y - reach, 0.0), float(rows)))
    bottom = math.floor(max(min(y + reach, rows - 1.0), -1.0)) + 1
    first, last = rows, 0
    for row in range(top, bottom):
        dy = row - y
        low, high = _limits(-x, columns - 1.0 - x, c, -dy * s, half_u + TOLERANCE_PX)
        low, high = _limits(low, high, s, dy * c, half_v + TOLERANCE_PX)
        start[row] = stop[row] = 0
        if low <= high:
            # The limits lie in [-x, columns - 1 - x]; adding x back may round to either side.
            start[row] = max(math.ceil(low + x), 0)
            stop[row] = min(math.floor(high + x) + 1, columns)
            if stop[row] > start[row]:
                first, last = min(first, row), row + 1
    return (first, last) if first < last else (0, 0)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _box(first: int, last: int, start: Integers, stop: Integers) -> Any:
    """Centre and half size of the box around the covered pixels: x, y, half width, half height."""
    left, right = start[first], stop[first] - 1
    for row in range(first, last):
        if stop[row] > start[row]:
            left, right = min(left, start[row]), max(right, stop[row] - 1)
    return (left + right) / 2, (first + last - 1) / 2, (right - left) / 2, (last - 1 - first) / 2


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _frame(region: Floats, published: bool, box: Any) -> Any:
    """The frame in which the relative distance is measured, as u = a dx + b dy, v = c dx + d dy.

    Returns:
        Origin x, origin y, a, b, c, d: our form follows the grasp, the published form the
        axis-aligned box around the covered pixels. A box of one pixel has no extent: 0.
    """
    x, y, c, s, half_u, half_v = region
    if published:
        x, y, half_x, half_y = box
        along_x = 1.0 / half_x if half_x > 0 else 0.0
        along_y = 1.0 / half_y if half_y > 0 else 0.0
        return x, y, along_x, 0.0, 0.0, along_y
    return x, y, c / half_u, -s / half_u, s / half_v, c / half_v


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _distance(frame: Any, row: int, column: int) -> float:
    """u^2 + v^2 at a pixel."""
    x, y, ux, uy, vx, vy = frame
    dx, dy = column - x, row - y
    distance: float = (ux * dx + uy * dy) ** 2 + (vx * dx + vy * dy) ** 2
    return distance


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _nearest(
    region: Floats,
    k: int,
    published: bool,
    limits: tuple[int, int],
    spans: tuple[Integers, Integers],
    distance: Singles,
    winner: Integers,
) -> None:
    """Let grasp k take the pixels of its row spans that lie nearer to it than to their winner."""
    (first, last), (start, stop) = limits, spans
    if first == last:
        return
    x, y, ux, uy, vx, vy = _frame(region, published, _box(first, last, start, stop))
    for row in range(first, last):
        d_row = distance[row, start[row] : stop[row]]
        w_row = winner[row, start[row] : stop[row]]
        u0 = ux * (start[row] - x) + uy * (row - y)
        v0 = vx * (start[row] - x) + vy * (row - y)
        # Both are written whether they change or not, which lets the compiler use vectors.
        for i in range(len(d_row)):
            u, v = u0 + ux * i, v0 + vx * i
            d = np.float32(u * u + v * v)
            nearer = d < d_row[i]
            w_row[i] = k if nearer else w_row[i]
            d_row[i] = d if nearer else d_row[i]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def paint_best(
    regions: Floats,
    bins: Integers,
    values: Singles,
    published: bool,
    maps: Singles,
    covered: Integers,
    distance: Singles,
) -> int:
    """At each pixel the four values of the grasp that lies nearest in its own relative frame.

    Args:
        regions: (K, 6) as in `row_spans`; of two equally near grasps the first one wins.
        bins: (K,) orientation bins.
        values: (K, 4) greatest quality, cos 2a, sin 2a, width divided by the width scale.
        published: Measure in the box around the covered pixels instead of the grasp's frame.
        maps: (4, N, H, W) out: greatest quality, cos, sin, width; untouched where there is no
            grasp.
        covered: (N H W,) out: in its first elements, indices in N H W of the pixels with a grasp.
        distance: (N H W,) out: u^2 + v^2 of the winner at each of these pixels.

    Returns:
        Number of pixels with a grasp.
    """
    count, rows, columns = maps.shape[1:]
    nearest = np.empty((rows, columns), np.float32)
    winner = np.empty((rows, columns), np.int32)
    spans = (np.empty(rows, np.int32), np.empty(rows, np.int32))
    left, right = np.empty(rows, np.int32), np.empty(rows, np.int32)
    found = 0
    for b in range(count):
        nearest[:] = np.inf
        left[:], right[:] = columns, 0
        for k in range(len(regions)):
            if bins[k] == b:
                first, last = row_spans(regions[k], (rows, columns), *spans)
                _nearest(regions[k], k, published, (first, last), spans, nearest, winner)
                for row in range(first, last):
                    left[row] = min(left[row], spans[0][row])
                    right[row] = max(right[row], spans[1][row])
        for row in range(rows):
            for column in range(left[row], right[row]):
                d = nearest[row, column]
                if d < np.inf:
                    k = winner[row, column]
                    for m in range(4):
                        maps[m, b, row, column] = values[k, m]
                    covered[found] = (b * rows + row) * columns + column
                    distance[found] = d
                    found += 1
    return found


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def scale(factors: Singles, indices: Integers, target: Singles) -> None:
    """Multiply a flat map by (P,) factors at (P,) indices."""
    for i in range(len(factors)):
        target[indices[i]] *= factors[i]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def paint_published(
    regions: Floats,
    bins: Integers,
    angles: Floats,
    values: Singles,
    published: bool,
    drop_off: float,
    low: float,
    maps: Singles,
) -> None:
    """Greatest quality, least angle and greatest width, each on its own.

    Args:
        regions: (K, 6) as in `row_spans`.
        bins: (K,) orientation bins.
        angles: (K,) radians in [-pi/2, pi/2).
        values: (K, 4) greatest quality, cos 2a, sin 2a, width divided by the width scale.
        published: Measure in the box around the covered pixels instead of the grasp's frame.
        drop_off: g of the Gaussian.
        low: Least quality inside a region: 1 binary, 0.9 soft, 0 strong.
        maps: (4, N, H, W) out: quality, cos, sin, width.
    """
    count, rows, columns = maps.shape[1:]
    least = np.zeros((count, rows, columns), np.int32)
    start, stop = np.empty(rows, np.int32), np.empty(rows, np.int32)
    for k in range(len(regions)):
        first, last = row_spans(regions[k], (rows, columns), start, stop)
        if first == last:
            continue
        b = bins[k]
        frame = _frame(regions[k], published, _box(first, last, start, stop))
        for row in range(first, last):
            for column in range(start[row], stop[row]):
                q = values[k, 0]
                if low < 1.0:
                    q *= max(math.exp(-_distance(frame, row, column) / drop_off), low)
                other = least[b, row, column]
                if other == 0 or angles[k] < angles[other - 1]:
                    least[b, row, column] = k + 1
                    maps[1, b, row, column] = values[k, 1]
                    maps[2, b, row, column] = values[k, 2]
                maps[0, b, row, column] = max(maps[0, b, row, column], q)
                maps[3, b, row, column] = max(maps[3, b, row, column], values[k, 3])
