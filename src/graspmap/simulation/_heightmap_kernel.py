"""Compiled loop of `graspmap.simulation.heightmap`; imported at the first map, never before.

Looking straight down at cells in rows is drawing triangles: exact in double precision, the same on
every machine, and quicker than casting a ray for each cell. Letters in shapes: T triangles, R rows,
C columns.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

TOLERANCE = 1e-9
"""A middle this far outside an edge, in parts of the triangle, still counts as covered, so that no
middle on an edge that two triangles share falls between them."""


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def draw_heights(triangles: Floats, heights: Floats) -> None:
    """Raise each cell to the highest triangle over its middle.

    Args:
        triangles: (T, 3, 3) corners: column, row (in cells, middles at integers), height.
        heights: (R, C) in and out.
    """
    rows, columns = heights.shape
    for t in range(len(triangles)):
        x0, y0, z0 = triangles[t, 0]
        x1, y1, z1 = triangles[t, 1]
        x2, y2, z2 = triangles[t, 2]
        top = max(z0, z1, z2)
        if top <= 0.0:
            continue
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        bottom = min(z0, z1, z2)
        first = max(math.ceil(min(y0, y1, y2) - TOLERANCE), 0)
        last = min(math.floor(max(y0, y1, y2) + TOLERANCE), rows - 1)
        left = max(math.ceil(min(x0, x1, x2) - TOLERANCE), 0)
        right = min(math.floor(max(x0, x1, x2) + TOLERANCE), columns - 1)
        for row in range(first, last + 1):
            for column in range(left, right + 1):
                # Parts of the three corners in the middle of the cell.
                b1 = ((column - x0) * (y2 - y0) - (x2 - x0) * (row - y0)) / area
                b2 = ((x1 - x0) * (row - y0) - (column - x0) * (y1 - y0)) / area
                if b1 >= -TOLERANCE and b2 >= -TOLERANCE and b1 + b2 <= 1.0 + TOLERANCE:
                    z = z0 + b1 * (z1 - z0) + b2 * (z2 - z0)
                    # A steep triangle must not reach beyond its own corners.
                    z = min(max(z, bottom), top)
                    if z > heights[row, column]:
                        heights[row, column] = z
