"""What is asked of a detector, checked before any work, and where it may answer.

Letters in shapes: H rows, W columns of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.data.windows import Region, checked_region
from graspmap.errors import InvalidInputError
from graspmap.geometry.camera import Camera
from graspmap.gripper import Gripper, check_gripper

_LARGEST_REGION = 100


def check_pictures(
    rgb: NDArray[np.uint8] | None,
    depth: NDArray[np.floating[Any]] | None,
    mask: NDArray[np.bool_] | None,
) -> None:
    """See that each picture is one.

    Raises:
        InvalidInputError: It is no array, or of another type or shape; the error names it.
    """
    for name, image in (("rgb", rgb), ("depth", depth), ("mask", mask)):
        if image is not None and not isinstance(image, np.ndarray):
            raise InvalidInputError(name, f"a {type(image).__name__}", "a NumPy array")
    if rgb is not None and (rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3):
        raise InvalidInputError("rgb", f"{rgb.dtype} {rgb.shape}", "uint8 (H, W, 3)")
    if depth is not None and depth.ndim != 2:
        raise InvalidInputError("shape of depth", depth.shape, "(H, W)")
    if mask is not None and (mask.dtype != np.bool_ or mask.ndim != 2):
        raise InvalidInputError("mask", f"{mask.dtype} {mask.shape}", "bool (H, W)")


def check_request(
    top: int,
    depth: NDArray[np.floating[Any]] | None,
    camera: Camera | None,
    gripper: Gripper | None,
    threshold: float | None,
) -> None:
    """See that everything beside the pictures is there and possible.

    Raises:
        InvalidInputError: Something is not; the error names it.
    """
    if not isinstance(top, int | np.integer) or top < 1:
        raise InvalidInputError("top", top, "a whole number, 1 or more")
    if threshold is not None and not math.isfinite(threshold):
        raise InvalidInputError("threshold", threshold, "a finite number")
    if camera is not None and not isinstance(camera, Camera):
        raise InvalidInputError("camera", repr(camera), "a Camera: Camera.from_dict makes one")
    if gripper is not None:
        check_gripper(gripper)
    if gripper is not None and (camera is None or depth is None):
        missing = "camera" if camera is None else "depth"
        raise InvalidInputError(missing, "missing", "both with a gripper: it works in metres")


def check_region(region: Sequence[float], shape: tuple[int, int]) -> Region:
    """A region of interest, as numbers, of which a picture of that shape shows some.

    Raises:
        InvalidInputError: It is none, too large or too small, or beside the picture.
    """
    x, y, width, height = checked_region(region)
    if max(width, height) < 1 or max(width, height) > _LARGEST_REGION * max(shape):
        allowed = f"a longer side from 1 px to {_LARGEST_REGION} times that of the picture"
        raise InvalidInputError("region", region, allowed)
    if x >= shape[1] or y >= shape[0] or x + width <= 0 or y + height <= 0:
        raise InvalidInputError("region", region, f"inside the {shape[1]} x {shape[0]} picture")
    return x, y, width, height


def allowed_pixels(
    shape: tuple[int, int],
    region: Region | None,
    mask: NDArray[np.bool_] | None,
) -> NDArray[np.bool_]:
    """(H, W) where grasps may be centred: in the picture, the region and the mask.

    Raises:
        InvalidInputError: Nowhere.
    """
    allowed = np.ones(shape, dtype=bool) if mask is None else mask.copy()
    if region is not None:
        x, y, width, height = region
        rows = np.arange(shape[0])[:, None]
        columns = np.arange(shape[1])[None, :]
        allowed &= (rows >= y) & (rows < y + height) & (columns >= x) & (columns < x + width)
    if not allowed.any():
        raise InvalidInputError("mask and region", "empty together", "at least one pixel")
    return allowed


def bounds(mask: NDArray[np.bool_]) -> Region:
    """The smallest region that holds a mask."""
    rows, columns = np.nonzero(mask)
    left, top = int(columns.min()), int(rows.min())
    return left, top, int(columns.max()) - left + 1, int(rows.max()) - top + 1
