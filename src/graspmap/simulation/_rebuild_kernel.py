"""Compiled loops of `graspmap.simulation.rebuild`; imported at the first use, never before.

Letters in shapes: (H, W) picture, (R, C) cells.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TOLERANCE = 1e-9
"""Cells; a middle on the border of two footprints belongs to both."""

NARROW = 2.0
"""Sides of a pixel; wider strips between two patches are hidden behind something."""


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _fill(x: Floats, y: Floats, height: float, heights: Floats) -> None:
    """Raise the cells whose middles lie in a convex quadrilateral, whichever way it runs."""
    rows, columns = heights.shape
    area = 0.0
    for k in range(4):
        n = (k + 1) % 4
        area += x[k] * y[n] - x[n] * y[k]
    sense = 1.0 if area >= 0 else -1.0
    first = max(math.ceil(y.min() - TOLERANCE), 0)
    last = min(math.floor(y.max() + TOLERANCE), rows - 1)
    left = max(math.ceil(x.min() - TOLERANCE), 0)
    right = min(math.floor(x.max() + TOLERANCE), columns - 1)
    for row in range(first, last + 1):
        for column in range(left, right + 1):
            if heights[row, column] >= height:
                continue
            inside = True
            for k in range(4):
                n = (k + 1) % 4
                cross = (x[n] - x[k]) * (row - y[k]) - (y[n] - y[k]) * (column - x[k])
                if sense * cross < -TOLERANCE:
                    inside = False
                    break
            if inside:
                heights[row, column] = height


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _corner(u: float, v: float, height: float, view: Any) -> Any:
    """Cell coordinates of where the ray through a point of the picture is at a height."""
    (fx, fy, cx, cy), turn, eye, origin, resolution = view
    a, b = (u - cx) / fx, (v - cy) / fy
    down = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2]
    t = (height - eye[2]) / down
    x = eye[0] + t * (turn[0, 0] * a + turn[0, 1] * b + turn[0, 2])
    y = eye[1] + t * (turn[1, 0] * a + turn[1, 1] * b + turn[1, 2])
    return (x - origin[0]) / resolution, (y - origin[1]) / resolution


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _is_level(pixel_heights: Floats, u: int, v: int, du: int, dv: int, view: Any) -> bool:
    """Whether a pixel and its neighbour lie on one surface that is no wall (below 45 degrees)."""
    rows, columns = pixel_heights.shape
    if not (0 <= u + du < columns and 0 <= v + dv < rows) or pixel_heights[v + dv, u + du] <= 0:
        return False
    here, beside = pixel_heights[v, u], pixel_heights[v + dv, u + du]
    x0, y0 = _corner(float(u), float(v), here, view)
    x1, y1 = _corner(float(u + du), float(v + dv), beside, view)
    return bool(abs(beside - here) <= view[4] * math.hypot(x1 - x0, y1 - y0))


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _goes_on(pixel_heights: Floats, u: int, v: int, du: int, dv: int, view: Any) -> bool:
    """Whether the surface that the lower of two neighbours shows may go on under the higher."""
    if pixel_heights[v, u] < pixel_heights[v + dv, u + du]:
        du, dv = -du, -dv
    else:
        u, v = u + du, v + dv
    # Now (u, v) is the lower, and (du, dv) leads away from the higher.
    across = _is_level(pixel_heights, u, v, dv, du, view)
    across = across or _is_level(pixel_heights, u, v, -dv, -du, view)
    return bool(across and _is_level(pixel_heights, u, v, du, dv, view))


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def splat(pixel_heights: Floats, view: Any, heights: Floats) -> None:
    """Draw the tops that pixels see onto the cells of the table.

    Each pixel is a level patch as large as it sees at its height; so the patches of a level surface
    leave no holes, however large the pixels are. Where two neighbours differ in height, nothing is
    seen of the strip between their patches. It gets the lower height where it is narrow, or where
    the lower one is a surface that may well go on (the bottom of a bowl, behind its rim). It gets
    nothing where the lower one is on a wall: that is how gaps beside a part look.

    Args:
        pixel_heights: (H, W) metres above the table, 0 where a pixel shows no object.
        view: Focal lengths and principal point; rotation and translation of the camera's pose;
            world x, y of the middle of cell [0, 0]; side of a cell.
        heights: (R, C) raised in place.
    """
    rows, columns = pixel_heights.shape
    x, y = np.empty(4), np.empty(4)
    for v in range(rows):
        for u in range(columns):
            here = pixel_heights[v, u]
            if here <= 0:
                continue
            for k in range(4):
                du, dv = (-0.5 if k in (0, 3) else 0.5), (-0.5 if k < 2 else 0.5)
                x[k], y[k] = _corner(u + du, v + dv, here, view)
            _fill(x, y, here, heights)
            for k in range(2):  # the neighbours to the right and below
                du, dv = 1 - k, k
                if v + dv >= rows or u + du >= columns:
                    continue
                beside = pixel_heights[v + dv, u + du]
                if beside <= 0 or beside == here:
                    continue
                for end in range(2):
                    side = end - 0.5
                    a, b = u + 0.5 * du + side * dv, v + 0.5 * dv + side * du
                    x[end], y[end] = _corner(a, b, here, view)
                    x[3 - end], y[3 - end] = _corner(a, b, beside, view)
                gap = math.hypot(x[0] - x[3], y[0] - y[3])
                pixel = math.hypot(x[0] - x[1], y[0] - y[1])
                if gap <= NARROW * pixel or _goes_on(pixel_heights, u, v, du, dv, view):
                    _fill(x, y, min(here, beside), heights)
