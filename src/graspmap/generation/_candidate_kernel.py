"""Compiled loop of `graspmap.generation.candidates`; imported at the first proposal, never before.

Letters in shapes: N rays, (R, C) mask.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

_STEP = 0.25
"""In cells: the places along a ray at which the mask is looked at."""


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _facing(slope: Any, inside: Any, outside: Any, dx: float, dy: float) -> float:
    """Cosine between a direction and the outward normal of the border between two cells."""
    down, right = slope
    nx = -float(right[inside]) - float(right[outside])
    ny = -float(down[inside]) - float(down[outside])
    length = math.sqrt(nx * nx + ny * ny)
    return (nx * dx + ny * dy) / length if length > 0.0 else -1.0


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def opposite_sides(
    mask: Bools,
    slope: tuple[Singles, Singles],
    starts: Floats,
    directions: Floats,
    choice: Floats,
    reach: float,
    cosine: float,
    out: Floats,
) -> None:
    """How far along each ray it leaves the mask through a border that faces along it.

    Args:
        mask: (R, C) what is high enough.
        slope: Two (R, C): how the (blurred) mask grows with the row, and with the column.
        starts: (N, 2) column, row (cells, middles at integers).
        directions: (N, 2) unit vectors column, row.
        choice: (N,) numbers in [0, 1) that choose among several such borders.
        reach: Greatest distance, cells.
        cosine: Least cosine between the ray and the outward normal of the border.
        out: (N,) out: distance in cells, -1 where there is none.
    """
    rows, columns = mask.shape
    found = np.empty(int(reach / _STEP) + 2)
    for n in range(len(starts)):
        x, y = starts[n]
        dx, dy = directions[n]
        count = 0
        was = False
        last = (0, 0)
        for k in range(1, int(reach / _STEP) + 1):
            t = k * _STEP
            column, row = math.floor(x + t * dx + 0.5), math.floor(y + t * dy + 0.5)
            if column < 0 or row < 0 or column >= columns or row >= rows:
                break
            here = (row, column)
            now = mask[row, column]
            if was and not now and _facing(slope, last, here, dx, dy) >= cosine:
                found[count] = t - _STEP / 2
                count += 1
            was, last = now, here
        out[n] = found[int(choice[n] * count)] if count > 0 else -1.0
