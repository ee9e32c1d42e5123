"""Pinhole camera without distortion, in OpenCV's frame: x right, y down, z forward, metres.

Pixel centres are at integers. Letters in shapes: ... any leading axes, the same everywhere.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import FileFormatError, InvalidInputError
from graspmap.files import write_text
from graspmap.geometry._check import numbers
from graspmap.geometry.affine import check_affine

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """Intrinsics of a rectified picture: u = fx x / z + cx, v = fy y / z + cy.

    Args:
        fx: Focal length along x, pixels, > 0.
        fy: Focal length along y, pixels, > 0.
        cx: Column of the principal point, pixels (may lie outside a cropped picture).
        cy: Row of the principal point, pixels.
        width: Columns of the picture, >= 1.
        height: Rows of the picture, >= 1.

    Raises:
        InvalidInputError: A number is not finite or out of its range.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy"):
            value = _number(name, getattr(self, name))
            if name.startswith("f") and value <= 0:
                raise InvalidInputError(name, value, "a focal length in pixels, above 0")
            object.__setattr__(self, name, value)
        for name in ("width", "height"):
            value = _number(name, getattr(self, name))
            if value < 1 or value != int(value):
                raise InvalidInputError(name, getattr(self, name), "a whole number of pixels, >= 1")
            object.__setattr__(self, name, int(value))

    @classmethod
    def from_field_of_view(cls, fov_x_rad: float, width: int, height: int) -> Camera:
        """A camera with square pixels that looks through the middle of its picture.

        The picture reaches from -0.5 to width - 0.5, so its middle is cx = (width - 1) / 2.

        Args:
            fov_x_rad: Angle between the left and the right edge of the picture, radians.
            width: Columns.
            height: Rows.

        Raises:
            InvalidInputError: The angle is not between 0 and pi, or a size is not positive.
        """
        angle = _number("field of view", fov_x_rad)
        if not 0 < angle < math.pi:
            raise InvalidInputError("field of view", fov_x_rad, "radians, between 0 and pi")
        focal = width / 2 / math.tan(angle / 2)
        return cls(focal, focal, (width - 1) / 2, (height - 1) / 2, width, height)

    @property
    def matrix(self) -> Floats:
        """(3, 3) matrix K that maps (x, y, z) metres to z (u, v, 1)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points: ArrayLike) -> Floats:
        """Pixels at which points appear.

        Args:
            points: (..., 3) camera coordinates, metres.

        Returns:
            (..., 2) pixels (x, y), which may lie outside the picture; NaN for a point that is
            NaN, or that is not in front of the camera (z <= 0).

        Raises:
            InvalidInputError: The last axis has another length than 3.
        """
        p = _array("points", points, 3)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        return np.stack([p[..., 0] / z * self.fx + self.cx, p[..., 1] / z * self.fy + self.cy], -1)

    def deproject(self, pixels: ArrayLike, depth_m: ArrayLike) -> Floats:
        """Points that appear at pixels, at a depth along the camera's z axis.

        Args:
            pixels: (..., 2) pixels (x, y).
            depth_m: (...,) depth along z (not along the ray), metres; NaN where there is none.

        Returns:
            (..., 3) camera coordinates, metres; NaN where the depth is.

        Raises:
            InvalidInputError: Shapes do not match, or a depth is zero, negative or infinite.
        """
        p = _array("pixels", pixels, 2)
        z = numbers("depth_m", depth_m)
        if z.shape != p.shape[:-1]:
            raise InvalidInputError(
                "shape of depth_m", z.shape, f"{p.shape[:-1]}, one depth for each pixel"
            )
        wrong = (z <= 0) | np.isinf(z)
        if wrong.any():
            raise InvalidInputError("depth_m", z[wrong][0], "metres > 0, NaN where there is none")
        x = (p[..., 0] - self.cx) / self.fx * z
        y = (p[..., 1] - self.cy) / self.fy * z
        # A hole has no point at all, whatever its pixel.
        return np.stack([x, y, z], axis=-1)

    def transformed(self, matrix: ArrayLike, width: int, height: int) -> Camera:
        """The camera of a crop, or of a smaller or larger copy, of its picture.

        Args:
            matrix: (2, 3) or (3, 3) map of old pixels (x, y, 1) to new ones: zoom and shift.
            width: Columns of the new picture.
            height: Rows of the new picture.

        Raises:
            InvalidInputError: The matrix rotates, flips or stretches: no camera in the same place
                and attitude takes such a picture.
        """
        m = check_affine(matrix)
        scale = m[0, 0]
        if scale <= 0 or not np.allclose(m[:2, :2], scale * np.eye(2), rtol=1e-6, atol=1e-9):
            raise InvalidInputError(
                "affine matrix of a camera", m[:2, :2].tolist(), "a zoom by one factor and a shift"
            )
        (cx, cy) = m[:2, :2] @ (self.cx, self.cy) + m[:2, 2]
        return Camera(scale * self.fx, scale * self.fy, cx, cy, width, height)

    def to_dict(self) -> dict[str, float | int]:
        """The six numbers by name, as `from_dict` and `read` take them."""
        return dataclasses.asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Camera:
        """From the usual ways to write intrinsics down.

        Understands graspmap's own names (fx, fy, cx, cy, width, height), a RealSense's (ppx, ppy
        instead of cx, cy) and a ROS camera_info (K or k, or camera_matrix with data; image_width,
        image_height). Other keys are ignored.

        Raises:
            InvalidInputError: A number is missing or wrong.
        """
        from graspmap.geometry._camera_file import intrinsics

        return cls(**intrinsics(values))

    @classmethod
    def read(cls, path: str | Path) -> Camera:
        """From a JSON or YAML file in one of the forms of `from_dict`.

        Raises:
            MissingFileError: There is no such file.
            FileFormatError: It is neither JSON nor YAML, or lacks a number, or has a wrong one.
        """
        from graspmap.geometry._camera_file import load

        values = load(Path(path))
        try:
            return cls.from_dict(values)
        except InvalidInputError as error:
            raise FileFormatError(
                path,
                f"no usable camera ({error})",
                "give fx, fy, cx, cy, width and height, or a ROS camera_info",
            ) from error

    def write(self, path: str | Path) -> None:
        """As JSON that `read` takes; an existing file is replaced only by a whole one.

        Raises:
            FileError: The place cannot be written to, or the disk is full.
        """
        write_text(Path(path), json.dumps(self.to_dict(), indent=2) + "\n")


def _number(name: str, value: Any) -> float:
    try:
        if isinstance(value, bool):
            raise TypeError
        # YAML reads 6e2 as text, so text that is a number counts as one.
        number = float(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInputError(name, f"{value!r:.80}", "a number") from error
    if not math.isfinite(number):
        raise InvalidInputError(name, number, "a finite number")
    return number


def _array(name: str, value: ArrayLike, length: int) -> Floats:
    array = numbers(name, value)
    if array.shape[-1:] != (length,):
        raise InvalidInputError(f"shape of {name}", array.shape, f"(..., {length})")
    return array
