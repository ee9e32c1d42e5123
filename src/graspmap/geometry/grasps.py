"""Grasps in the image: the value that everything in graspmap takes or gives.

Letters in shapes: N grasps. Image: x right, y down, pixels, pixel centres at integers (see
CONVENTIONS.md).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry._check import numbers
from graspmap.geometry._rows import Rows, checked_grasps
from graspmap.geometry.affine import check_similarity

Floats = NDArray[np.float64]


def wrap_angle(angle: ArrayLike) -> Floats:
    """Bring grasp angles into [-pi/2, pi/2); a grasp turned by pi is the same grasp.

    Args:
        angle: Radians, any shape.

    Returns:
        Radians in [-pi/2, pi/2), same shape; angles already there stay the same to the last bit.
    """
    given = np.array(angle, dtype=np.float64)
    outside = ~((given >= -np.pi / 2) & (given < np.pi / 2))
    if outside.any():
        wrapped = np.mod(given[outside] + np.pi / 2, np.pi) - np.pi / 2
        # np.mod may round up to pi itself for tiny negative arguments.
        given[outside] = np.where(wrapped >= np.pi / 2, -np.pi / 2, wrapped)
    return given


def angle_difference(a: ArrayLike, b: ArrayLike) -> Floats:
    """Smallest turn between two grasp axes, modulo pi.

    Args:
        a: Radians.
        b: Radians, broadcast against ``a``.

    Returns:
        Radians in [0, pi/2].
    """
    turn = np.asarray(a, dtype=np.float64) - np.asarray(b, dtype=np.float64)
    nearest: Floats = np.abs(turn - np.pi * np.rint(turn / np.pi))
    # Rounding may carry a right angle past its bound.
    return np.minimum(nearest, np.pi / 2)


@dataclass(frozen=True, eq=False)
class Grasps(Rows):
    """N planar grasps of a parallel-jaw gripper, seen in an image.

    Args:
        center: (N, 2) centres as (x, y), pixels.
        angle: (N,) direction of the opening, radians counter-clockwise on screen; stored in
            [-pi/2, pi/2). The axis is (cos a, -sin a) in (x right, y down).
        width: (N,) opening between the jaws along the axis, pixels, >= 0.
        height: (N,) jaw (plate) size across the axis, pixels, >= 0.
        quality: (N,) score, finite; 1 where none is given.

    Raises:
        InvalidInputError: A shape is wrong, a number is not finite, a size is negative.
    """

    center: Floats
    angle: Floats
    width: Floats
    height: Floats
    quality: Floats = field(default=None)  # type: ignore[arg-type]  # filled in below

    _fields: ClassVar[tuple[str, ...]] = ("center", "angle", "width", "height", "quality")

    def __post_init__(self) -> None:
        arrays = checked_grasps(self._fields, self._columns(), "pixels")
        arrays[1] = wrap_angle(arrays[1])
        self._keep(arrays)

    @classmethod
    def from_corners(cls, corners: ArrayLike, quality: ArrayLike | None = None) -> Grasps:
        """Grasps from rectangles whose first edge (p0 to p1) is the opening.

        Opposite edges of hand-drawn rectangles differ a little: their mean is used, so the
        result does not depend on where the drawing began or which way round it went.

        Args:
            corners: (N, 4, 2) corners as (x, y), pixels, in order around the rectangle.
            quality: (N,) scores, 1 where none is given.

        Raises:
            InvalidInputError: The shape is not (N, 4, 2) or a number is not finite.
        """
        points = numbers("corners", corners)
        if points.size == 0:
            return cls.empty()
        if points.ndim != 3 or points.shape[1:] != (4, 2):
            raise InvalidInputError("shape of corners", points.shape, "(N, 4, 2)")
        opening = (points[:, 1] - points[:, 0] + points[:, 2] - points[:, 3]) / 2
        jaw = (points[:, 2] - points[:, 1] + points[:, 3] - points[:, 0]) / 2
        # Without an opening the jaw, a quarter turn away, still tells the direction.
        closed = (opening == 0).all(axis=1)[:, None]
        axis = np.where(closed, np.stack([jaw[:, 1], -jaw[:, 0]], axis=-1), opening)
        return cls(
            center=points.mean(axis=1),
            angle=np.arctan2(-axis[:, 1], axis[:, 0]),
            width=np.hypot(opening[:, 0], opening[:, 1]),
            height=np.hypot(jaw[:, 0], jaw[:, 1]),
            quality=quality,  # type: ignore[arg-type]  # checked in __post_init__
        )

    def axis(self) -> Floats:
        """(N, 2) unit vectors along the opening, as (x right, y down)."""
        return np.stack([np.cos(self.angle), -np.sin(self.angle)], axis=-1)

    def corners(self) -> Floats:
        """(N, 4, 2) corners as (x, y), pixels; the first edge is the opening.

        p0 and p1 lie on the jaw's side that is up when the angle is 0; the order is clockwise on
        screen.
        """
        axis = self.axis()
        across = np.stack([-axis[:, 1], axis[:, 0]], axis=-1)
        half_opening = axis * (self.width / 2)[:, None]
        half_jaw = across * (self.height / 2)[:, None]
        return np.stack(
            [
                self.center - half_opening - half_jaw,
                self.center + half_opening - half_jaw,
                self.center + half_opening + half_jaw,
                self.center - half_opening + half_jaw,
            ],
            axis=1,
        )

    def transformed(self, matrix: ArrayLike) -> Grasps:
        """The same grasps after a similarity of the image (crop, zoom, rotation, flip).

        A flip changes the sign of the angle; a zoom scales width and height.

        Args:
            matrix: (2, 3) or (3, 3) matrix that maps (x, y, 1) of the old image to the new one.

        Raises:
            InvalidInputError: The matrix is no similarity (it shears or stretches), so a
                rectangle would not stay one.
        """
        linear, shift, scale = check_similarity(matrix)
        axis = self.axis() @ linear.T
        return Grasps(
            center=self.center @ linear.T + shift,
            angle=np.arctan2(-axis[:, 1], axis[:, 0]),
            width=self.width * scale,
            height=self.height * scale,
            quality=self.quality,
        )

    def __repr__(self) -> str:
        return (
            f"Grasps({len(self)})"
            if len(self) != 1
            else (
                f"Grasps(x={self.center[0, 0]:.2f}, y={self.center[0, 1]:.2f}, "
                f"angle={np.degrees(self.angle[0]):.1f} deg, width={self.width[0]:.2f}, "
                f"height={self.height[0]:.2f}, quality={self.quality[0]:.3f})"
            )
        )
