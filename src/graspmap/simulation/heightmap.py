"""HeightMap: how high the scene is above each point of the table.

World frame: the table is the plane z = 0, z up, metres. Letters in shapes: R rows (y grows with the
row), C columns (x grows with the column).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError

Floats = NDArray[np.float64]

RESOLUTION_M = 0.001
"""Side of a cell."""

MOST_CELLS = 9_000_000
"""A scene with more is no tabletop: 3 m x 3 m of cells of 1 mm."""

_ABOVE_TABLE_M = 0.001
"""What is lower than this is not worth grasping."""


@dataclass(frozen=True, eq=False)
class HeightMap:
    """Heights over a grid of square cells; outside the grid is bare table.

    Args:
        heights_m: (R, C) float32 height of the highest surface over the middle of each cell, 0 for
            bare table.
        origin_m: (2,) world x, y of the middle of cell [0, 0].
        resolution_m: Side of a cell.

    Raises:
        InvalidInputError: A shape is wrong, a height is negative or not finite, or the resolution
            is not positive.
    """

    heights_m: NDArray[np.float32]
    origin_m: Floats
    resolution_m: float = RESOLUTION_M

    def __post_init__(self) -> None:
        heights = np.array(self.heights_m, dtype=np.float32, order="C")
        origin = np.array(self.origin_m, dtype=np.float64)
        if heights.ndim != 2:
            raise InvalidInputError("shape of heights_m", heights.shape, "(rows, columns)")
        # Written so that NaN fails too.
        if heights.size and not (heights.min() >= 0 and heights.max() < np.inf):
            raise InvalidInputError(
                "heights_m", "negative, NaN or infinite somewhere", "metres, 0 for bare table"
            )
        if origin.shape != (2,) or not np.isfinite(origin).all():
            raise InvalidInputError("origin_m", origin.tolist(), "two finite numbers x, y")
        _check_resolution(self.resolution_m)
        for name, array in (("heights_m", heights), ("origin_m", origin)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        object.__setattr__(self, "resolution_m", float(self.resolution_m))

    @classmethod
    def from_triangles(cls, triangles: ArrayLike, resolution_m: float = RESOLUTION_M) -> HeightMap:
        """What one sees straight from above: the highest triangle over the middle of each cell.

        Cells lie on one grid for all scenes (cell k covers k to k + 1 times the resolution from the
        world's origin), so a scene moved by whole cells has the same heights. Triangles below the
        table do not count.

        Args:
            triangles: (T, 3, 3) corners in the world, metres; T may be 0.
            resolution_m: Side of a cell.

        Raises:
            InvalidInputError: A shape is wrong, a number is not finite, the resolution is not
                positive, or the scene has more than `MOST_CELLS` cells.
        """
        from graspmap.simulation._heightmap_kernel import draw_heights

        corners = np.array(triangles, dtype=np.float64, order="C")
        if corners.shape[1:] != (3, 3):
            raise InvalidInputError("shape of triangles", corners.shape, "(T, 3, 3)")
        if not np.isfinite(corners).all():
            raise InvalidInputError("triangles", "NaN or infinite somewhere", "finite metres")
        _check_resolution(resolution_m)
        corners = corners[(corners[:, :, 2] > 0).any(axis=1)]
        if not len(corners):
            return cls(np.zeros((0, 0), np.float32), np.zeros(2), resolution_m)
        plan = corners[:, :, :2].reshape(-1, 2) / resolution_m
        first = np.floor(plan.min(axis=0))
        columns, rows = np.floor(plan.max(axis=0)) - first + 1
        if float(rows) * float(columns) > MOST_CELLS:
            raise InvalidInputError(
                "size of the scene",
                f"{columns * resolution_m:.1f} m x {rows * resolution_m:.1f} m",
                f"at most {MOST_CELLS} cells of {resolution_m:g} m; scale the objects",
            )
        heights = np.zeros((int(rows), int(columns)))
        corners[:, :, :2] = corners[:, :, :2] / resolution_m - (first + 0.5)
        draw_heights(corners, heights)
        return cls(heights.astype(np.float32), (first + 0.5) * resolution_m, resolution_m)

    def at(self, points_m: ArrayLike) -> Floats:
        """Heights at points: that of the cell each lies in, 0 outside the grid.

        Args:
            points_m: (..., 2) world x, y.

        Returns:
            (...) metres.

        Raises:
            InvalidInputError: The last axis has another length than 2, or a number is not finite.
        """
        points = np.asarray(points_m, dtype=np.float64)
        if points.shape[-1:] != (2,) or not np.isfinite(points).all():
            raise InvalidInputError("points_m", f"shape {points.shape}", "finite (..., 2)")
        rows, columns = self.heights_m.shape
        column, row = np.moveaxis(
            np.floor((points - self.origin_m) / self.resolution_m + 0.5), -1, 0
        )
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        out = np.zeros(points.shape[:-1])
        out[inside] = self.heights_m[row[inside].astype(np.int64), column[inside].astype(np.int64)]
        return out

    def mask(self, above_m: float = _ABOVE_TABLE_M) -> NDArray[np.bool_]:
        """(R, C) where the scene is higher than ``above_m``."""
        return self.heights_m > above_m

    def middles(self, cells: NDArray[np.integer]) -> Floats:
        """(..., 2) world x, y of the middles of cells (..., 2), given as (row, column)."""
        return self.origin_m + np.asarray(cells)[..., ::-1] * self.resolution_m

    @property
    def top_m(self) -> float:
        """Height of the highest cell; 0 for a bare table."""
        return float(self.heights_m.max(initial=0.0))


def _check_resolution(resolution_m: float) -> None:
    if not (resolution_m > 0 and math.isfinite(resolution_m)):
        raise InvalidInputError("resolution_m", resolution_m, "metres, above 0")
