"""HeightMap: how high the scene is above each point of the table.

World frame: the table is the plane z = 0, z up, metres. Letters in shapes: R rows (y grows with the
row), C columns (x grows with the column).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RESOLUTION_M = 0.001
"""Side of a cell."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights over a grid of square cells; outside the grid is bare table.

    Args:
        heights_m: (R, C) float32 height of the highest surface over the middle of each cell, 0 for
            bare table.
        origin_m: (2,) world x, y of the middle of cell [0, 0].
        resolution_m: Side of a cell.
    """

    heights_m: NDArray[np.float32]
    origin_m: Floats
    resolution_m: float = RESOLUTION_M

    @classmethod
    def from_triangles(cls, triangles: Floats, resolution_m: float = RESOLUTION_M) -> HeightMap:
        """What rays straight down hit first.

        Args:
            triangles: (T, 3, 3) corners in the world, metres.
            resolution_m: Side of a cell.
        """
        raise NotImplementedError

    def at(self, points_m: Floats) -> Floats:
        """(...) heights at points (..., 2): that of the cell each lies in, 0 outside the grid."""
        raise NotImplementedError
