"""Normalisation of a warped picture in two passes over it, without temporaries.

With NumPy each step is a pass of its own and a fresh block of memory, which costs more than the
warp itself.

Letters in shapes: H rows, W columns.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def normalise_rgb(rgb: NDArray[np.uint8], out: NDArray[np.float32]) -> None:
    """(H, W, 3) colour to (3, H, W): divided by 255, the one mean over all channels subtracted."""
    rows, columns, _ = rgb.shape
    total = np.int64(0)
    for y in range(rows):
        for x in range(columns):
            total += np.int64(rgb[y, x, 0]) + rgb[y, x, 1] + rgb[y, x, 2]
    scale = np.float32(1 / 255)
    mean = np.float32(total / (rows * columns * 3 * 255))
    for y in range(rows):
        for c in range(3):
            for x in range(columns):
                out[c, y, x] = np.float32(rgb[y, x, c]) * scale - mean


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def normalise_depth(depth_m: NDArray[np.float32], out: NDArray[np.float32]) -> None:
    """(H, W) metres to (H, W): the mean subtracted, clipped to [-1, 1]."""
    rows, columns = depth_m.shape
    total = 0.0
    for y in range(rows):
        for x in range(columns):
            total += depth_m[y, x]
    mean = np.float32(total / (rows * columns))
    one = np.float32(1)
    for y in range(rows):
        for x in range(columns):
            out[y, x] = min(max(depth_m[y, x] - mean, -one), one)
