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
def splat(pixel_heights: Floats, view: Any, heights: Floats) -> None:
    """Draw the tops that pixels see onto the cells of the table.

    Each pixel is a level patch as large as it sees at its height; where two neighbours differ, the
    strip between their patches, which no pixel sees, gets the lower of their heights. So there are
    no holes however large the pixels are.

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
                beside = 0.0
                if k == 0 and u + 1 < columns:
                    beside = pixel_heights[v, u + 1]
                elif k == 1 and v + 1 < rows:
                    beside = pixel_heights[v + 1, u]
                if beside <= 0 or beside == here:
                    continue
                for end in range(2):
                    du = 0.5 if k == 0 else (-0.5 if end == 0 else 0.5)
                    dv = 0.5 if k == 1 else (-0.5 if end == 0 else 0.5)
                    x[end], y[end] = _corner(u + du, v + dv, here, view)
                    x[3 - end], y[3 - end] = _corner(u + du, v + dv, beside, view)
                _fill(x, y, min(here, beside), heights)
