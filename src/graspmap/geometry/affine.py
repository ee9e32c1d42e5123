"""Similarities of the image plane as 3 x 3 matrices, and the check that a matrix is one.

Each matrix maps homogeneous pixels (x, y, 1) of the old image to the new image; compose with
``@``, the first step on the right. Pixel centres are at integers, so the image of (width, height)
covers [-0.5, width - 0.5] x [-0.5, height - 0.5].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry._check import numbers

Floats = NDArray[np.float64]


def translation(dx: float, dy: float) -> Floats:
    """(3, 3) shift by (dx, dy) pixels."""
    return np.array([[1.0, 0.0, dx], [0.0, 1.0, dy], [0.0, 0.0, 1.0]])


def crop(x: float, y: float) -> Floats:
    """(3, 3) map into the window whose first pixel is (x, y) of the old image."""
    return translation(-x, -y)


def zoom(factor: float, about: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """(3, 3) magnification by ``factor`` that leaves the point ``about`` (x, y) where it is.

    Raises:
        InvalidInputError: The factor is not a positive finite number.
    """
    if not np.isfinite(factor) or factor <= 0:
        raise InvalidInputError("zoom factor", factor, "a positive number")
    x, y = about
    return np.array([[factor, 0.0, x - factor * x], [0.0, factor, y - factor * y], [0.0, 0.0, 1.0]])


def rotation(angle: float, about: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """(3, 3) rotation by ``angle`` radians, counter-clockwise on screen, about (x, y)."""
    c, s = np.cos(angle), np.sin(angle)
    linear = np.array([[c, s], [-s, c]])
    center = np.asarray(about, dtype=np.float64)
    matrix = np.eye(3)
    matrix[:2, :2] = linear
    matrix[:2, 2] = center - linear @ center
    return matrix


def flip(width: int) -> Floats:
    """(3, 3) left-right mirror of an image that is ``width`` pixels wide."""
    return np.array([[-1.0, 0.0, width - 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def resize(factor: float) -> Floats:
    """(3, 3) map of an image onto one that is ``factor`` times as large.

    The outer edges coincide (not the centres of the corner pixels), as in ``cv2.resize``:
    x' = factor (x + 0.5) - 0.5.

    Raises:
        InvalidInputError: The factor is not a positive finite number.
    """
    return zoom(factor, about=(-0.5, -0.5))


def window(x: float, y: float, side: float, size: int) -> Floats:
    """(3, 3) map of the square window with outer corner (x - 0.5, y - 0.5) onto size x size.

    Args:
        x: First column of the window, pixels of the old image.
        y: First row of the window.
        side: Side of the window, pixels of the old image.
        size: Side of the new image, pixels.

    Raises:
        InvalidInputError: A side is not positive.
    """
    if side <= 0 or size <= 0:
        raise InvalidInputError("window side and size", (side, size), "positive numbers")
    return resize(size / side) @ crop(x, y)


def apply(matrix: ArrayLike, points: ArrayLike) -> Floats:
    """(N, 2) points (x, y) mapped by a (2, 3) or (3, 3) affine matrix.

    Raises:
        InvalidInputError: The matrix is not an invertible affine map.
    """
    m = check_affine(matrix)
    return numbers("points", points) @ m[:2, :2].T + m[:2, 2]


def check_affine(matrix: ArrayLike) -> Floats:
    """A finite, invertible affine map as a (3, 3) float64 array.

    Raises:
        InvalidInputError: The shape is not (2, 3) or (3, 3), the last row is not (0, 0, 1), a
            number is not finite, or the map is singular or as good as that.
    """
    m = numbers("affine matrix", matrix)
    if m.shape == (2, 3):
        m = np.vstack([m, [0.0, 0.0, 1.0]])
    if m.shape != (3, 3):
        raise InvalidInputError("shape of the affine matrix", m.shape, "(2, 3) or (3, 3)")
    if not np.isfinite(m).all() or not np.allclose(m[2], (0.0, 0.0, 1.0)):
        raise InvalidInputError("affine matrix", m.tolist(), "finite, last row (0, 0, 1)")
    with np.errstate(over="ignore", invalid="ignore"):
        area = abs(np.linalg.det(m[:2, :2]))
    if not 1e-12 <= area <= 1e24:
        raise InvalidInputError("affine matrix", m.tolist(), "an invertible map")
    return m


def check_similarity(matrix: ArrayLike) -> tuple[Floats, Floats, float]:
    """Split a similarity into its linear part (2, 2), shift (2,) and scale (> 0).

    Raises:
        InvalidInputError: The matrix is not affine or stretches one direction more than another.
    """
    m = check_affine(matrix)
    linear = m[:2, :2]
    scale = float(np.sqrt(abs(np.linalg.det(linear))))
    if not np.allclose(linear @ linear.T, scale**2 * np.eye(2), rtol=1e-6, atol=1e-6 * scale**2):
        raise InvalidInputError(
            "affine matrix", linear.tolist(), "a similarity (rotation, uniform zoom, shift, flip)"
        )
    return linear, m[:2, 2], scale
