"""Pictures on their way to a network: holes filled, warped into the input frame, normalised.

Letters in shapes: H rows, W columns of a picture, C channels, size the side of the square input.
Matrices map homogeneous pixels (x, y, 1) of the picture to the input frame, x right, y down,
pixel centres at integers (see `graspmap.geometry.affine` and CONVENTIONS.md).
"""

from __future__ import annotations

import math
from typing import Any, Literal, TypeVar, get_args

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.data._input_kernel import normalise_depth, normalise_rgb
from graspmap.data.files import metres
from graspmap.data.table import Table, find_table
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry import affine

Channels = Literal["depth", "rgb", "rgbd"]
"""What a network sees; ``rgbd`` is depth, red, green, blue."""

DepthZero = Literal["mean", "table"]
"""What depth is measured from: its mean over the input, or the table, see `to_input`."""

TABLE_UNIT_M = 0.05
"""What a network calls 1 of depth above the table: without normalisation it learns from numbers of
about 1."""

Floats = NDArray[np.float64]
Depth = NDArray[np.float32]
Image = TypeVar("Image", bound=NDArray[Any])

_COUNT: dict[str, int] = {"depth": 1, "rgb": 3, "rgbd": 4}
_MOST_RISE = 4.0
_MOST_HOLES = 40_000  # pixels filled at full resolution: about 10 ms


def channel_count(channels: str) -> int:
    """Number of input channels: 1 for ``depth``, 3 for ``rgb``, 4 for ``rgbd``.

    Raises:
        UnknownNameError: Another name.
    """
    if channels not in _COUNT:
        raise UnknownNameError("channels", channels, get_args(Channels))
    return _COUNT[channels]


def check_depth_m(depth: ArrayLike, where: str) -> Depth:
    """A depth picture of a user as float32 metres with NaN where there is none.

    Args:
        depth: (H, W) numbers along the camera's z; holes as `metres` says.
        where: What the picture is, for the error, for example a file name.

    Returns:
        (H, W) float32 metres, holes NaN; a copy.

    Raises:
        InvalidInputError: It is not (H, W), not of numbers, an 8-bit picture, empty or without
            a single measurement, or its median says that it is in millimetres.
    """
    found = np.asarray(depth)
    if found.ndim != 2 or found.size == 0:
        raise InvalidInputError(f"shape of the depth in {where}", found.shape, "(H, W), not empty")
    if found.dtype.kind not in "iuf" or found.dtype.itemsize == 1:
        raise InvalidInputError(
            f"type of the depth in {where}",
            found.dtype,
            "floating-point metres (or 16-bit millimetres divided by 1000)",
        )
    try:
        depth_m = metres(found)
    except InvalidInputError as error:
        raise InvalidInputError(f"depth in {where}", error.found, error.allowed) from error
    if np.isnan(depth_m).all():
        raise InvalidInputError(
            f"depth in {where}", "without a single measurement", "metres above 0 somewhere"
        )
    return depth_m


def fill_depth(depth_m: Depth) -> Depth:
    """Depth without holes: each is continued from its edges (Navier-Stokes, radius 1).

    More than 40,000 missing pixels are filled on a picture of half the size (and that one
    likewise), because the march would take a quarter of a second for a million of them.

    Args:
        depth_m: (H, W) float32 metres, NaN or infinite in holes.

    Returns:
        (H, W) float32 metres, finite; the argument itself where it has no holes.

    Raises:
        InvalidInputError: There is no measurement at all, or the shape or type is wrong.

    References:
        Bertalmio, Bertozzi, Sapiro: Navier-Stokes, fluid dynamics, and image and video
        inpainting, CVPR 2001.
    """
    if depth_m.ndim != 2 or depth_m.dtype != np.float32:
        raise InvalidInputError(
            "depth", f"{depth_m.shape} of {depth_m.dtype}", "(H, W) float32 metres"
        )
    valid = np.isfinite(depth_m)
    if valid.all():
        return depth_m
    if not valid.any():
        raise InvalidInputError("depth", "nothing but holes", "at least one measured pixel")
    return _fill(depth_m, ~valid)


def _fill(depth_m: Depth, holes: NDArray[np.bool_]) -> Depth:
    if np.count_nonzero(holes) > _MOST_HOLES:
        rows, columns = depth_m.shape
        coarse = _shrink_depth(_pad(np.where(holes, np.float32(np.nan), depth_m), 2), 2)
        coarse = _fill(coarse, np.isnan(coarse))
        fine = cv2.resize(coarse, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)
        return np.where(holes, fine[:rows, :columns], depth_m)
    known = np.where(holes, np.float32(0), depth_m)
    # The march compares gradients with a constant: the largest depth as the unit of length makes
    # the result independent of the unit of the input.
    unit = np.float32(np.abs(known).max()) or np.float32(1)
    filled = cv2.inpaint(known / unit, holes.view(np.uint8), 1, cv2.INPAINT_NS)
    known[holes] = filled[holes] * unit
    return known


def warp(
    image: Image, matrix: ArrayLike, size: int | tuple[int, int], *, fill: float | None = None
) -> Image:
    """A picture seen through an affine map.

    Colour and depth are interpolated linearly; where the map shrinks to less than half, areas are
    averaged first, so that nothing is skipped. Masks (bool) take the nearest pixel. NaN spreads to
    its neighbours: use `fill_depth` first.

    Args:
        image: (H, W) or (H, W, 3); uint8, float32 or bool.
        matrix: (2, 3) or (3, 3) map from the picture to the result.
        size: Side of the result, or its (rows, columns), pixels.
        fill: Value outside the picture; None repeats the border (False for a mask).

    Returns:
        The result, (rows, columns) or (rows, columns, 3), same type.

    Raises:
        InvalidInputError: The map is not an invertible affine one, the picture is empty or of
            another type, or the size is not positive.
    """
    m = affine.check_affine(matrix)
    rows, columns = _check_size(size)
    if image.size == 0 or image.ndim not in (2, 3):
        raise InvalidInputError("shape of the picture", image.shape, "(H, W) or (H, W, 3)")
    if image.dtype == np.bool_:
        value = float(bool(fill))
        seen = _warp(image.view(np.uint8), m, (rows, columns), value, cv2.INTER_NEAREST)
        return seen.view(np.bool_)  # type: ignore[return-value]
    if image.dtype not in (np.uint8, np.float32):
        raise InvalidInputError("type of the picture", image.dtype, "uint8, float32 or bool")
    image, m, factor = _cut(image, m, (rows, columns))
    if factor > 1:
        image = _shrink(_pad(image, factor), factor)
    return _warp(image, m, (rows, columns), fill, cv2.INTER_LINEAR)


def warp_depth(depth_m: Depth, matrix: ArrayLike, size: int | tuple[int, int]) -> Depth:
    """Depth seen through an affine map, holes filled; no pixel mixes a hole with a measurement.

    It is shrunk before it is filled, because that is several times faster than the other way round
    and differs from it only inside holes.

    Args:
        depth_m: (H, W) float32 metres, NaN or infinite in holes.
        matrix: (2, 3) or (3, 3) map from the picture to the result.
        size: Side of the result, or its (rows, columns), pixels.

    Returns:
        (rows, columns) float32 metres, finite; the border is repeated outside the picture.

    Raises:
        InvalidInputError: Shape or type is wrong, or there is nothing but holes in the window.
    """
    m = affine.check_affine(matrix)
    shape = _check_size(size)
    depth_m, m, factor = _cut(_need(depth_m, "depth", "depth", np.float32, 2), m, shape)
    if factor > 1:
        depth_m = _shrink_depth(_pad(depth_m, factor), factor)
    valid = np.isfinite(depth_m)
    if not valid.any():
        raise InvalidInputError(
            "depth inside the window", "nothing but holes", "at least one measured pixel"
        )
    if not valid.all():
        depth_m = _fill(depth_m, ~valid)
    return _warp(depth_m, m, shape, None, cv2.INTER_LINEAR)


def to_input(
    rgb: NDArray[np.uint8] | None,
    depth: Depth | None,
    channels: str,
    matrix: ArrayLike,
    size: int,
    *,
    depth_zero: DepthZero = "mean",
    table: Table | None = None,
) -> Depth:
    """What a network sees of a scene.

    Depth: holes filled, its zero subtracted, clipped. Colour: divided by 255, its one mean over all
    three channels subtracted. Means are of the input, after the warp.

    Args:
        rgb: (H, W, 3) uint8, or None.
        depth: (H, W) float32 metres, NaN in holes, or None.
        channels: ``depth``, ``rgb`` or ``rgbd``.
        matrix: (3, 3) map from the picture to the input frame.
        size: Side of the input, pixels.
        depth_zero: ``mean`` subtracts the mean of the depth and clips to [-1, 1] metres, as
            published. ``table`` subtracts the depth of the table behind each pixel, in units of
            5 cm, clipped to [-4, 4]: a tilted camera then shows what a level one does, objects do
            not drown in the tilt, and flat ones are no numbers near nothing.
        table: The table behind the picture, where it was found already (`find_table`).

    Returns:
        (C, size, size) float32, contiguous; the order is depth, red, green, blue.

    Raises:
        InvalidInputError: A picture that the channels ask for is missing, its shape or type is
            wrong, or the depth in the window is nothing but holes.
    """
    count = channel_count(channels)
    m = affine.check_affine(matrix)
    shape = _check_size(size)
    result = np.empty((count, *shape), np.float32)
    if channels != "rgb":
        metres_seen = _need(depth, "depth", channels, np.float32, 2)
        if depth_zero == "table":
            table = find_table(metres_seen) if table is None else table
            risen = warp_depth(metres_seen - table.depth_m(metres_seen.shape), m, shape)
            np.clip(risen / TABLE_UNIT_M, -_MOST_RISE, _MOST_RISE, out=result[0])
        elif depth_zero == "mean":
            normalise_depth(warp_depth(metres_seen, m, shape), result[0])
        else:
            raise UnknownNameError("zero of the depth", str(depth_zero), get_args(DepthZero))
    if channels != "depth":
        picture = _need(rgb, "rgb", channels, np.uint8, 3)
        if depth is not None and channels == "rgbd" and depth.shape != picture.shape[:2]:
            raise InvalidInputError(
                "shape of the depth", depth.shape, f"{picture.shape[:2]}, as the colour picture"
            )
        warped = warp(picture, m, shape)
        normalise_rgb(warped, result[count - 3 :])
    return result


def _need(image: NDArray[Any] | None, name: str, channels: str, dtype: Any, ndim: int) -> Any:
    """The picture, or the error that the channels need it."""
    if image is None:
        raise InvalidInputError(
            f"{name} of the scene", "missing", f"a picture, for channels {channels!r}"
        )
    wanted = "(H, W, 3)" if ndim == 3 else "(H, W)"
    if image.ndim != ndim or image.size == 0 or (ndim == 3 and image.shape[2] != 3):
        raise InvalidInputError(f"shape of {name}", image.shape, wanted)
    if image.dtype != dtype:
        raise InvalidInputError(f"type of {name}", image.dtype, np.dtype(dtype).name)
    return image


def _warp(
    image: Image, m: Floats, shape: tuple[int, int], fill: float | None, interpolation: int
) -> Image:
    if shape == image.shape[:2] and np.array_equal(m, np.eye(3)):
        return image.copy()
    border = cv2.BORDER_REPLICATE if fill is None else cv2.BORDER_CONSTANT
    value = (fill or 0.0,) * 4
    return cv2.warpAffine(  # type: ignore[return-value]
        image, m[:2], shape[::-1], flags=interpolation, borderMode=border, borderValue=value
    )


def _cut(image: Image, m: Floats, shape: tuple[int, int]) -> tuple[Image, Floats, int]:
    """The part of the picture that the map shows, and the factor to shrink it by first.

    Returns:
        The part; the map from the shrunk part to the result; the factor, a power of two.
    """
    height, width = image.shape[:2]
    shrink = 1 / math.sqrt(abs(float(np.linalg.det(m[:2, :2]))))
    most = (max(width, height) - 1).bit_length()  # a block as large as the picture is enough
    factor = 1 << min(max(0, math.floor(math.log2(shrink) + 1e-9)), most)
    rows, columns = shape
    if factor == 1 and width * height <= 4 * rows * columns:
        return image, m, 1  # nothing to shrink, little to gain from cutting
    corners = np.array([[-1, -1], [columns, -1], [columns, rows], [-1, rows]], np.float64)
    seen = affine.apply(np.linalg.inv(m), corners) / factor
    # In whole blocks. The margin keeps the cut's edge out of sight; at least one block stays, also
    # when the map looks past the picture: its border is then what is repeated.
    last = (np.array([width, height]) - 1) // factor
    low = np.clip(np.floor(seen.min(axis=0)) - 2, 0, last)
    high = np.clip(np.ceil(seen.max(axis=0)) + 2, low, last) + 1
    (x0, y0), (x1, y1) = (low * factor).astype(int), (high * factor).astype(int)
    smaller = affine.resize(1 / factor) @ affine.crop(float(x0), float(y0))
    part: Image = image[y0:y1, x0:x1]  # type: ignore[assignment]
    return part, m @ np.linalg.inv(smaller), factor


def _pad(image: Image, factor: int) -> Image:
    """The picture with its border repeated up to whole blocks of ``factor`` pixels."""
    below, right = -image.shape[0] % factor, -image.shape[1] % factor
    if not below and not right:
        return image
    return cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE)  # type: ignore[return-value]


def _shrink(image: Image, factor: int) -> Image:
    """Means over blocks of factor x factor pixels (whole blocks: OpenCV's fast path)."""
    size = (image.shape[1] // factor, image.shape[0] // factor)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)  # type: ignore[return-value]


def _shrink_depth(depth_m: Depth, factor: int) -> Depth:
    """Means over the measured pixels of each block; NaN where a block has none."""
    valid = np.isfinite(depth_m)
    if valid.all():
        return _shrink(depth_m, factor)
    total = _shrink(np.where(valid, depth_m, np.float32(0)), factor)
    share = _shrink(valid.astype(np.float32), factor)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(share > 0, total / share, np.float32(np.nan))


def _check_size(size: int | tuple[int, int]) -> tuple[int, int]:
    rows, columns = (size, size) if isinstance(size, int | np.integer) else size
    if rows <= 0 or columns <= 0:
        raise InvalidInputError("size", size, "pixels, 1 or more")
    return int(rows), int(columns)
