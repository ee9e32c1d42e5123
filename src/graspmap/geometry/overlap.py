"""Exact overlap of grasp rectangles.

Letters in shapes: N grasps in a, M in b. Everything in pixels of one image.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.grasps import Grasps

Floats = NDArray[np.float64]


def pairwise_iou(a: Grasps, b: Grasps) -> Floats:
    """Intersection over union of every rectangle of ``a`` with every one of ``b``.

    Areas are exact (no pixel grid). Rectangles without area overlap nothing, not even themselves;
    rectangles that only touch overlap by 0. The angle does not matter to the measure otherwise:
    a rectangle equals the one turned by a quarter with width and height exchanged.

    The rounding error is a few 1e-16 times the longest side over the shortest side, below 1e-12
    for rectangles up to a thousand times as long as they are thin. The compiled code releases the
    interpreter lock, so threads may call this at once.

    Args:
        a: N grasps.
        b: M grasps, in pixels of the same image.

    Returns:
        (N, M) ratios in [0, 1].
    """
    return _overlap(a, b, as_ratio=True)


def intersection_area(a: Grasps, b: Grasps) -> Floats:
    """Area that every rectangle of ``a`` shares with every one of ``b``.

    Args:
        a: N grasps.
        b: M grasps, in pixels of the same image.

    Returns:
        (N, M) areas, square pixels, between 0 and the smaller rectangle's area.
    """
    return _overlap(a, b, as_ratio=False)


def best_iou(a: Grasps, b: Grasps, max_turn: float) -> Floats:
    """Greatest intersection over union of each of ``a`` with those of ``b`` turned little.

    The same as masking the rows of `pairwise_iou`, without looking at the pairs left out.

    Args:
        a: N grasps.
        b: M grasps, in pixels of the same image.
        max_turn: Greatest angle between the two axes modulo pi, radians; inclusive. pi/2 takes
            all of ``b``.

    Returns:
        (N,) ratios in [0, 1]; 0 where none of ``b`` is within the angle.

    Raises:
        InvalidInputError: ``max_turn`` is negative or NaN.
    """
    if not max_turn >= 0:
        raise InvalidInputError("max_turn", max_turn, "radians, 0 or more")
    out = np.empty(len(a))
    _kernels().fill_best(*_fields(a), *_fields(b), float(max_turn), out)
    return out


def _overlap(a: Grasps, b: Grasps, *, as_ratio: bool) -> Floats:
    out = np.empty((len(a), len(b)))
    _kernels().fill_overlap(*_fields(a), *_fields(b), as_ratio, out)
    return out


def _fields(grasps: Grasps) -> tuple[Floats, Floats, Floats, Floats]:
    return grasps.center, grasps.angle, grasps.width, grasps.height


@cache
def _kernels() -> ModuleType:
    """The compiled kernels, loaded at first use because numba is slow to import."""
    from graspmap.geometry import _overlap_kernel

    return _overlap_kernel
