"""Compiled search for the pixels of a picture that lie on edges.

Letters in shapes: (H, W) picture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled

Singles = NDArray[np.float32]

_STEP = 0.06  # of brightness, beyond which an edge is drawn smooth
_TABLE_STEP = 0.3  # the same within the table's pattern, which leaves fine detail out by itself


@compiled
def _differ(colour: Singles, a: int, b: int, step: float) -> bool:
    """Whether two pixels are so different that the border between them would look jagged."""
    for k in range(3):
        p, q = min(colour[a, k], np.float32(1)), min(colour[b, k], np.float32(1))
        # The eye sees ratios, less so in the dark.
        if abs(p - q) > step * (0.15 + 0.85 * max(p, q)):
            return True
    return False


@compiled
def mark_edges(
    owner: NDArray[np.int16], flat: Singles, shape: tuple[int, int], marked: NDArray[np.bool_]
) -> None:
    """Pixels that differ from one of their four neighbours.

    Args:
        owner: (H W,) object numbers, -1 for the table.
        flat: (H W, 3) linear colour.
        shape: (H, W).
        marked: (H W,) in and out: True is put where an edge is.
    """
    rows, columns = shape
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
