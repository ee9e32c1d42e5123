"""Rigid transforms between frames in space.

A transform is named ``T_a_b``: it maps coordinates in frame b to coordinates in frame a, so that
``T_a_c = T_a_b @ T_b_c`` and ``point_a = T_a_b.apply(point_b)``. Metres, right-handed frames.
Letters in shapes: N points.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry._check import numbers

Floats = NDArray[np.float64]

# A rotation from a file with few digits is accepted and made orthonormal; anything farther off
# is a mistake (degrees, a transposed block, a scaled or mirrored frame).
_TOLERANCE = 1e-4
# Points closer to one line than this part of their spread leave the turn about it open.
_LINE = 1e-4


@dataclass(frozen=True, eq=False)
class RigidTransform:
    """A rotation and a translation, ``T_a_b``: x_a = rotation @ x_b + translation.

    Args:
        rotation: (3, 3) rotation R_a_b; its columns are the axes of b seen from a. One that is
            off by rounding (up to 1e-4) is replaced by the nearest true rotation.
        translation: (3,) origin of b in a, metres.

    Raises:
        InvalidInputError: A shape is wrong, a number is not finite, or the matrix is no rotation.
    """

    rotation: Floats
    translation: Floats

    # Else NumPy would take `transform @ array` for a product of its own.
    __array_ufunc__: ClassVar[None] = None

    def __post_init__(self) -> None:
        rotation = _finite("rotation", self.rotation, (3, 3))
        translation = _finite("translation", self.translation, (3,))
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if off > _TOLERANCE or np.linalg.det(rotation) < 0:
            raise InvalidInputError(
                "rotation",
                f"{rotation.tolist()}, {off:.2g} away from orthonormal",
                "an orthonormal matrix with determinant +1 (no scale, no mirror)",
            )
        if off > 1e-14:
            u, _, vt = np.linalg.svd(rotation)
            rotation = u @ vt
        for name, array in (("rotation", rotation), ("translation", translation)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def identity(cls) -> RigidTransform:
        """The transform that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> RigidTransform:
        """From a (4, 4) homogeneous matrix, or its first three rows (3, 4).

        Raises:
            InvalidInputError: Another shape, a last row other than (0, 0, 0, 1), or no rotation.
        """
        m = numbers("matrix", matrix)
        if m.shape not in ((4, 4), (3, 4)):
            raise InvalidInputError("shape of the transform", m.shape, "(4, 4) or (3, 4)")
        if m.shape == (4, 4) and not np.allclose(m[3], (0.0, 0.0, 0.0, 1.0)):
            raise InvalidInputError("last row of the transform", m[3].tolist(), "(0, 0, 0, 1)")
        return cls(m[:3, :3], m[:3, 3])

    @classmethod
    def from_quaternion(
        cls, xyzw: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)
    ) -> RigidTransform:
        """From a unit quaternion in the order (x, y, z, w), the scalar last.

        Args:
            xyzw: (4,) quaternion; its length may differ from 1 by rounding (up to 1 %).
            translation: (3,) origin of b in a, metres.

        Raises:
            InvalidInputError: A wrong shape, a number that is not finite, or a length far from 1.
        """
        q = _finite("quaternion", xyzw, (4,))
        length = float(np.linalg.norm(q))
        if abs(length - 1.0) > 0.01:
            raise InvalidInputError("length of the quaternion", length, "1, in the order x y z w")
        x, y, z, w = (float(v) for v in q / length)
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        return cls(rotation, np.asarray(translation, dtype=np.float64))

    @classmethod
    def fit(cls, points_a: ArrayLike, points_b: ArrayLike) -> RigidTransform:
        """``T_b_a`` that brings points seen in a closest to the same points seen in b.

        Least squares over the distances; the result is always a rotation, never a mirror image.

        Args:
            points_a: (N, 3) points in frame a, metres (for a camera: deprojected, not pixels).
            points_b: (N, 3) the same points, in the same order, in frame b, metres.

        Raises:
            InvalidInputError: Shapes differ, fewer than 3 points, numbers that are not finite,
                or points on one line (the turn about it would be open).

        References:
            S. Umeyama, "Least-squares estimation of transformation parameters between two point
            patterns", IEEE PAMI 13(4), 1991 (without the scale).
        """
        a, b = numbers("points_a", points_a), numbers("points_b", points_b)
        if a.ndim != 2 or a.shape[1:] != (3,) or a.shape != b.shape:
            raise InvalidInputError("shapes of the points", (a.shape, b.shape), "two equal (N, 3)")
        if len(a) < 3:
            raise InvalidInputError("number of point pairs", len(a), "3 or more")
        center_a, center_b = a.mean(axis=0), b.mean(axis=0)
        for name, centred in (("points_a", a - center_a), ("points_b", b - center_b)):
            if not np.isfinite(centred).all():
                raise InvalidInputError(name, "NaN or infinite in some point", "finite metres")
            spread = np.linalg.svd(centred, compute_uv=False)
            if spread[1] <= _LINE * spread[0]:
                raise InvalidInputError(
                    name, "on one line", "points that span a triangle; add one off the line"
                )
        u, _, vt = np.linalg.svd((a - center_a).T @ (b - center_b))
        mirror = np.sign(np.linalg.det(vt.T @ u.T))
        rotation = vt.T @ np.diag([1.0, 1.0, mirror]) @ u.T
        return cls(rotation, center_b - rotation @ center_a)

    @property
    def matrix(self) -> Floats:
        """(4, 4) homogeneous matrix."""
        m = np.eye(4)
        m[:3, :3], m[:3, 3] = self.rotation, self.translation
        return m

    def quaternion(self) -> Floats:
        """(4,) unit quaternion (x, y, z, w) of the rotation, with w >= 0."""
        r = self.rotation
        # Four times the squares of x, y, z, w; the greatest is safe to divide by.
        trace = float(np.trace(r))
        squares = np.append(1.0 + 2.0 * np.diag(r) - trace, 1.0 + trace)
        largest = int(np.argmax(squares))
        if largest == 3:
            q = np.array(
                [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], float(squares[3])]
            )
        else:
            i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
            q = np.zeros(4)
            q[i] = squares[i]
            q[j] = r[i, j] + r[j, i]
            q[k] = r[i, k] + r[k, i]
            q[3] = r[k, j] - r[j, k]
        q /= np.linalg.norm(q)
        return -q if q[3] < 0 else q

    def apply(self, points_b: ArrayLike) -> Floats:
        """Points of frame b in frame a.

        Args:
            points_b: (..., 3) metres; NaN stays NaN.

        Returns:
            (..., 3) metres.

        Raises:
            InvalidInputError: The last axis has another length than 3.
        """
        points = numbers("points", points_b)
        if points.shape[-1:] != (3,):
            raise InvalidInputError("shape of the points", points.shape, "(..., 3)")
        return points @ self.rotation.T + self.translation

    def inverse(self) -> RigidTransform:
        """``T_b_a`` of this ``T_a_b``."""
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation)

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """``T_a_c = T_a_b @ T_b_c``."""
        if not isinstance(other, RigidTransform):
            return NotImplemented
        return RigidTransform(
            self.rotation @ other.rotation, self.rotation @ other.translation + self.translation
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, RigidTransform):
            return NotImplemented
        return np.array_equal(self.matrix, other.matrix)

    __hash__ = None  # type: ignore[assignment]  # arrays inside


def _finite(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Floats:
    array = numbers(name, value)
    if array.shape != shape:
        raise InvalidInputError(f"shape of {name}", array.shape, str(shape))
    if not np.isfinite(array).all():
        raise InvalidInputError(name, array.tolist(), "finite numbers")
    return array
