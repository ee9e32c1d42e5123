"""Grasps in the image: the value that everything in graspmap takes or gives.

Letters in shapes: N grasps. Image: x right, y down, pixels, pixel centres at integers (see
CONVENTIONS.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry._check import numbers
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
class Grasps:
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

    def __post_init__(self) -> None:
        center = numbers("center", self.center)
        if center.size == 0:
            center = center.reshape(0, 2)
        if center.ndim != 2 or center.shape[1] != 2:
            raise InvalidInputError("shape of center", center.shape, "(N, 2), rows (x, y)")
        count = len(center)
        arrays = [_checked("center", center, (count, 2))]
        for name in _FIELDS[1:]:
            unscored = name == "quality" and self.quality is None
            array = np.ones(count) if unscored else numbers(name, getattr(self, name))
            arrays.append(_checked(name, array, (count,)))
        for name, sizes in zip(("width", "height"), arrays[2:4], strict=True):
            if (sizes < 0).any():
                raise InvalidInputError(name, float(sizes.min()), "pixels, 0 or more")
        arrays[1] = wrap_angle(arrays[1])
        self._keep(arrays)

    def _keep(self, arrays: Iterable[Floats]) -> None:
        for name, array in zip(_FIELDS, arrays, strict=True):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def _trusted(cls, arrays: Iterable[Floats]) -> Grasps:
        """From fresh arrays that come out of checked grasps."""
        grasps = object.__new__(cls)
        grasps._keep(arrays)
        return grasps

    @classmethod
    def empty(cls) -> Grasps:
        """No grasps."""
        return cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0))

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

    @staticmethod
    def concatenate(parts: Iterable[Grasps]) -> Grasps:
        """All grasps of ``parts``, in order."""
        items = [part for part in parts if len(part)]
        if not items:
            return Grasps.empty()
        return Grasps._trusted(
            np.concatenate([getattr(item, name) for item in items]) for name in _FIELDS
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

    def replace(self, **changes: ArrayLike) -> Grasps:
        """A copy with some of center, angle, width, height, quality exchanged.

        One value (for center, one point) serves all grasps.

        Raises:
            InvalidInputError: A name or a shape is wrong, or a value is not allowed in a grasp.
        """
        values: dict[str, Any] = {name: getattr(self, name) for name in _FIELDS}
        unknown = changes.keys() - values.keys()
        if unknown:
            raise InvalidInputError("field", sorted(unknown), ", ".join(_FIELDS))
        for name, value in changes.items():
            array, shape = numbers(name, value), values[name].shape
            try:
                values[name] = np.broadcast_to(array, shape)
            except ValueError as error:
                raise InvalidInputError(f"shape of {name}", array.shape, str(shape)) from error
        return Grasps(**values)

    def __len__(self) -> int:
        return len(self.angle)

    def __getitem__(self, index: int | slice | NDArray[Any] | list[int]) -> Grasps:
        """Some of the grasps; a single integer gives one grasp (N = 1)."""
        if isinstance(index, int | np.integer):
            if not -len(self) <= index < len(self):
                # Python's own protocol: iteration over a sequence ends with an IndexError.
                raise IndexError(f"grasp {index} of {len(self)}")
            index = slice(int(index), int(index) + 1 or None)
        elif not isinstance(index, slice):
            index = np.asarray(index, dtype=None if len(index) else np.int64)
            if index.ndim != 1:
                raise InvalidInputError("shape of the index", index.shape, "one axis")
        # Compiled code wants one kind of array: contiguous ones.
        return Grasps._trusted(np.ascontiguousarray(getattr(self, n)[index]) for n in _FIELDS)

    def __iter__(self) -> Iterator[Grasps]:
        return (self[i] for i in range(len(self)))

    def __reduce__(self) -> tuple[type[Grasps], tuple[Floats, ...]]:
        # Through the constructor: plain unpickling would leave the arrays writeable.
        return Grasps, tuple(getattr(self, name) for name in _FIELDS)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Grasps):
            return NotImplemented
        return all(np.array_equal(getattr(self, n), getattr(other, n)) for n in _FIELDS)

    __hash__ = None  # type: ignore[assignment]  # arrays inside

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


_FIELDS = ("center", "angle", "width", "height", "quality")


def _checked(name: str, array: Floats, shape: tuple[int, ...]) -> Floats:
    if array.shape != shape:
        raise InvalidInputError(f"shape of {name}", array.shape, f"{shape}, one row for each grasp")
    if not np.isfinite(array).all():
        raise InvalidInputError(name, "NaN or infinite in some grasp", "finite numbers")
    return array
