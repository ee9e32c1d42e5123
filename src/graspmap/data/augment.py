"""Random turns, zooms and shifts of the input: one affine map moves picture and grasps together.

A drawn map acts in the input frame (square, x right, y down, pixel centres at integers), after the
map that brought the picture there: ``matrix = augmentation.draw(rng, size) @ window``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry import affine

Rotation = Literal["any", "quarter", "none"]

_LEAST_ZOOM, _MOST_ZOOM = 0.05, 20.0  # beyond this a picture is one pixel, or a speck


@dataclass(frozen=True)
class Augmentation:
    """How a training sample may be moved.

    Args:
        rotation: ``any`` angle, a multiple of 90 degrees (``quarter``), or ``none``.
        zoom: (low, high) of the uniform part f of the picture's side that fills the frame, so
            the picture is magnified by 1 / f; f above 1 shrinks it and repeats its border.
        flip: Mirror left and right half of the time.
        shift: Greatest shift along x and along y, as a share of the side, uniform both ways.

    Raises:
        InvalidInputError: A number is out of range.
        UnknownNameError: The rotation is none of the three.
    """

    rotation: Rotation = "any"
    zoom: tuple[float, float] = (1.0, 1.0)
    flip: bool = False
    shift: float = 0.0

    def __post_init__(self) -> None:
        if self.rotation not in get_args(Rotation):
            raise UnknownNameError("rotation", str(self.rotation), get_args(Rotation))
        zoom = tuple(float(f) for f in self.zoom)
        if len(zoom) != 2 or not _LEAST_ZOOM <= zoom[0] <= zoom[1] <= _MOST_ZOOM:
            raise InvalidInputError(
                "zoom", self.zoom, f"(low, high), {_LEAST_ZOOM} <= low <= high <= {_MOST_ZOOM:g}"
            )
        object.__setattr__(self, "zoom", zoom)
        if not 0 <= self.shift <= 1:
            raise InvalidInputError("shift", self.shift, "a share of the side, 0 to 1")

    def draw(self, rng: np.random.Generator, size: int) -> NDArray[np.float64]:
        """A random map of the input frame onto itself.

        The same count of numbers is drawn whatever the settings, so that switching one of them
        off leaves the others as they were.

        Args:
            rng: Source of randomness; one for each sample.
            size: Side of the input, pixels.

        Returns:
            (3, 3) similarity about the centre of the frame: mirror, turn, zoom, then shift.

        Raises:
            InvalidInputError: The size is not positive.
        """
        if size <= 0:
            raise InvalidInputError("size", size, "pixels, 1 or more")
        turn, part, mirror, dx, dy = rng.random(5)
        center = ((size - 1) / 2, (size - 1) / 2)
        matrix = affine.flip(size) if self.flip and mirror < 0.5 else np.eye(3)
        matrix = _turn(self.rotation, turn, center) @ matrix
        low, high = self.zoom
        matrix = affine.zoom(1 / (low + (high - low) * part), center) @ matrix
        reach = self.shift * size
        return affine.translation((2 * dx - 1) * reach, (2 * dy - 1) * reach) @ matrix


def _turn(rotation: Rotation, turn: float, center: tuple[float, float]) -> NDArray[np.float64]:
    """(3, 3) rotation for ``turn`` in [0, 1)."""
    if rotation == "none":
        return np.eye(3)
    if rotation == "any":
        return affine.rotation(2 * math.pi * turn, center)
    # Exact zeros and ones, so that a quarter turn moves pixels onto pixels without resampling.
    matrix = affine.rotation(math.floor(4 * turn) * math.pi / 2, center)
    matrix[:2, :2] = np.round(matrix[:2, :2])
    matrix[:2, 2] = np.asarray(center) - matrix[:2, :2] @ np.asarray(center)
    return matrix


PUBLISHED = Augmentation(rotation="quarter", zoom=(0.5, 1.0))
"""What the thesis and GG-CNN train with: multiples of 90 degrees, zoom 0.5 to 1.0."""

NONE = Augmentation(rotation="none")
"""Nothing is moved."""
