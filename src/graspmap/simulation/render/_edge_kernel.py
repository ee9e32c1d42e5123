"""Compiled search for the pixels of a picture that lie on edges.

Letters in shapes: (H, W) picture.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]

_STEP = 0.06  # of brightness, beyond which an edge is drawn smooth
_TABLE_STEP = 0.12  # the same within the table's pattern


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _differ(colour: Singles, a: int, b: int, step: float) -> bool:
    """Whether two pixels are so different that the border between them would look jagged."""
    for k in range(3):
        p, q = min(colour[a, k], np.float32(1)), min(colour[b, k], np.float32(1))
        # The eye sees ratios, less so in the dark.
        if abs(p - q) > step * (0.15 + 0.85 * max(p, q)):
            return True
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy")
def edges(instance: NDArray[np.int16], colour: Singles) -> Any:
    """(n,) flat numbers of the pixels that differ from one of their four neighbours."""
    rows, columns = instance.shape
    marked = np.zeros(rows * columns, np.bool_)
    owner, flat = instance.ravel(), colour.reshape(-1, 3)
    for row in range(rows):
        for column in range(columns):
            here = row * columns + column
            for k in range(2):
                if (row if k else column) + 1 >= (rows if k else columns):
                    continue
                there = here + (columns if k else 1)
                step = _TABLE_STEP if owner[here] < 0 and owner[there] < 0 else _STEP
                if owner[here] != owner[there] or _differ(flat, here, there, step):
                    marked[here] = marked[there] = True
    return np.flatnonzero(marked)
