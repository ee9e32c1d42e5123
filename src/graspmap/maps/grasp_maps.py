"""The four grasp maps: what a network gives for every pixel, and what it is trained on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError

Array = TypeVar("Array")
"""A NumPy array or a torch tensor; all four maps of one `GraspMaps` are of the same kind."""


@dataclass(frozen=True, eq=False)
class GraspMaps(Generic[Array]):
    """Grasp maps over N orientation bins; (..., N, H, W) each, a batch may lead.

    Bin b of N holds the grasps with angles in [-pi/2 + b pi/N, -pi/2 + (b + 1) pi/N).

    Args:
        quality: How good a grasp centred at the pixel is, 0 to 1.
        cos: cos 2a of its angle a.
        sin: sin 2a of its angle a.
        width: Its opening in pixels, divided by the width scale of the data set.

    Raises:
        InvalidInputError: The four shapes differ or have fewer than three axes.
    """

    quality: Array
    cos: Array
    sin: Array
    width: Array

    def __post_init__(self) -> None:
        shapes = [tuple(getattr(m, "shape", ())) for m in self]
        if len(set(shapes)) != 1 or len(shapes[0]) < 3:
            raise InvalidInputError("shapes of the maps", shapes, "four equal (..., bins, H, W)")

    def __iter__(self) -> Any:
        """Quality, cos, sin, width: the order in which networks and files keep them."""
        return iter((self.quality, self.cos, self.sin, self.width))

    @property
    def bins(self) -> int:
        """Number of orientation bins."""
        return int(self.quality.shape[-3])  # type: ignore[attr-defined]

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of each map."""
        height, width = self.quality.shape[-2:]  # type: ignore[attr-defined]
        return int(height), int(width)

    def item(self, index: int) -> GraspMaps[Array]:
        """The maps of one element of a batch."""
        return GraspMaps(*(m[index] for m in self))


def bin_of(angle: NDArray[np.float64], bins: int) -> NDArray[np.int64]:
    """Orientation bin of each angle.

    Args:
        angle: Radians in [-pi/2, pi/2), any shape.
        bins: Number of bins, >= 1.

    Returns:
        Bin numbers, 0 to ``bins - 1``, same shape.
    """
    position = np.floor((angle + np.pi / 2) * (bins / np.pi)).astype(np.int64)
    return np.clip(position, 0, bins - 1)


def bin_centers(bins: int) -> NDArray[np.float64]:
    """(bins,) angle in the middle of each bin, radians."""
    return (np.arange(bins) + 0.5) * np.pi / bins - np.pi / 2
