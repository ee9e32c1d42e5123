"""Overlap of grasp rectangles as older code counts it: in whole pixels.

It exists to price that habit against the exact area; nothing else uses it. Rectangles under a few
pixels wide are judged by luck here: that is the habit's fault, not a defect of this module.

Letters in shapes: N, M rectangles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.grasps import Grasps

Floats = NDArray[np.float64]

_EDGE = 1e-9
"""Pixels by which a centre may lie outside an edge and still count as on it."""

_MOST_PIXELS = 10**8
"""Pixels in a rectangle's bounding box that are still worth counting."""


def pixel_iou(a: Grasps, b: Grasps) -> Floats:
    """Intersection over union of pixel counts, for all pairs.

    A pixel belongs to a rectangle when its centre lies inside or on the edge.

    Args:
        a: N rectangles, pixels.
        b: M rectangles, pixels.

    Returns:
        (N, M) in [0, 1]; 0 where neither covers a pixel.

    Raises:
        InvalidInputError: A rectangle is too large to be counted pixel by pixel.
    """
    boxes_a, boxes_b = _boxes(a), _boxes(b)
    counts_b = [np.count_nonzero(_covered(b, j, box)) for j, box in enumerate(boxes_b)]
    result = np.zeros((len(a), len(b)))
    for i, box_a in enumerate(boxes_a):
        count_a = np.count_nonzero(_covered(a, i, box_a))
        for j, box_b in enumerate(boxes_b):
            shared_box = np.concatenate(
                [np.maximum(box_a[:2], box_b[:2]), np.minimum(box_a[2:], box_b[2:])]
            )
            if (shared_box[:2] > shared_box[2:]).any():
                continue
            both = _covered(a, i, shared_box) & _covered(b, j, shared_box)
            shared = np.count_nonzero(both)
            union = count_a + counts_b[j] - shared
            result[i, j] = shared / union if union else 0.0
    return result


def _boxes(grasps: Grasps) -> NDArray[np.int64]:
    """(N, 4) first and last pixel (x0, y0, x1, y1) of each rectangle's bounding box."""
    corners = grasps.corners()
    low = np.ceil(corners.min(axis=1) - _EDGE)
    high = np.floor(corners.max(axis=1) + _EDGE)
    sides = np.maximum(high - low + 1, 0)
    if (sides.prod(axis=1) > _MOST_PIXELS).any():
        raise InvalidInputError(
            "rectangle size",
            f"{sides.max():.0f} pixels on a side",
            f"bounding boxes of at most {_MOST_PIXELS:,} pixels when counting pixels",
        )
    return np.concatenate([low, high], axis=1).astype(np.int64)


def _covered(grasps: Grasps, index: int, box: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(rows, columns) of the box: True where the pixel's centre is in rectangle ``index``."""
    x0, y0, x1, y1 = box
    x = np.arange(x0, x1 + 1) - grasps.center[index, 0]
    y = (np.arange(y0, y1 + 1) - grasps.center[index, 1])[:, None]
    c, s = np.cos(grasps.angle[index]), np.sin(grasps.angle[index])
    along, across = np.abs(c * x - s * y), np.abs(s * x + c * y)
    inside = (along <= grasps.width[index] / 2 + _EDGE) & (
        across <= grasps.height[index] / 2 + _EDGE
    )
    return np.asarray(inside)
