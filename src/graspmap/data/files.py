"""Reading and writing of pictures, with errors that name the file and the remedy.

Files are decoded from memory, so a picture is read in one gulp; see `graspmap.files` for how they
are written.

Letters in shapes: H rows, W columns.
"""

from __future__ import annotations

import math
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from graspmap.data.png import SIGNATURE, decode_rgb
from graspmap.data.scene import Depth, Mask, Rgb
from graspmap.errors import FileFormatError, InvalidInputError
from graspmap.files import read_bytes, write_bytes

_DECODER = threading.Lock()
_REPLACE = "replace it with a good copy"
# No camera of a grasping set-up sees further: single numbers above this stand for nothing, and if
# they are the rule they are millimetres.
FARTHEST_M = 100.0
_NO_DEPTH = 65535  # of 16 bits, as some drivers mark what is out of range


def visible_files(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Each folder below ``root``, and ``root``, with the names of its files, in order.

    Hidden ones are left out: scratch (`graspmap generate` keeps unfinished scenes there), what was
    thrown away, and what macOS keeps beside each file.
    """
    for folder, subfolders, names in os.walk(root, followlinks=True):
        subfolders[:] = sorted(name for name in subfolders if not name.startswith("."))
        yield Path(folder), sorted(name for name in names if not name.startswith("."))


def read_image(path: Path) -> NDArray[Any]:
    """A picture as stored: any number of channels (blue first where there are three), any type.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is empty, truncated, damaged or no picture.
        FileError: It may not be read.
    """
    return _decode(path, _read_picture(path))


def read_rgb(path: Path) -> Rgb:
    """(H, W, 3) uint8 colour, red first; grey pictures are spread, transparency is dropped.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is no picture of 8 bits per channel.
        FileError: It may not be read.
    """
    content = _read_picture(path)
    picture = decode_rgb(content) if content.startswith(SIGNATURE) else None
    if picture is not None:
        return picture
    image = _decode(path, content)
    if image.dtype != np.uint8:
        raise FileFormatError(
            path, f"colour has type {image.dtype}", "save it with 8 bits per channel"
        )
    channels = 1 if image.ndim == 2 else image.shape[2]
    conversions = {
        1: cv2.COLOR_GRAY2RGB,
        3: cv2.COLOR_BGR2RGB,
        4: cv2.COLOR_BGRA2RGB,
    }
    if channels not in conversions:
        raise FileFormatError(path, f"has {channels} channels", "save it as RGB")
    return np.asarray(cv2.cvtColor(image, conversions[channels]), dtype=np.uint8)


def read_mask(path: Path) -> Mask:
    """(H, W) bool mask from a picture with 0 and 255, or 0 and 1.

    In a picture of colours whatever is not black is inside. Where it has transparency (a cut-out),
    what is not opaque is outside, whatever its colour.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is no picture of 8 bits, or holds more than two levels.
        FileError: It may not be read.
    """
    image = read_image(path)
    if image.dtype != np.uint8:
        raise FileFormatError(path, f"mask has type {image.dtype}", "save it with 8 bits, 0 or 255")
    plane = image if image.ndim == 2 else image[:, :, :3].max(axis=2)
    if image.ndim == 3 and image.shape[2] == 4 and image[:, :, 3].min(initial=255) < 255:
        plane = image[:, :, 3]
    inside = plane != 0
    if np.count_nonzero(plane == plane.max(initial=0)) < np.count_nonzero(inside):
        raise FileFormatError(
            path, "mask has more than two levels", "save it with 0 outside and 255 on the object"
        )
    return np.asarray(inside)


def read_depth(path: Path) -> Depth:
    """(H, W) float32 metres, NaN where there is none.

    Floating-point pictures (TIFF) and arrays (.npy) hold metres; 16-bit pictures hold millimetres,
    as depth cameras write them, 65535 where there is none. Holes are further as `metres` says.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is no depth picture, has more than one channel, or holds floating-point
            millimetres.
        FileError: It may not be read.
    """
    image = _read_array(path) if path.suffix.lower() == ".npy" else read_image(path)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    image = image.astype(image.dtype.newbyteorder("="), copy=False)
    if image.ndim != 2 or image.size == 0:
        raise FileFormatError(
            path, f"depth has shape {image.shape}", "save it with one channel, (rows, columns)"
        )
    if image.dtype == np.uint16:
        return metres(np.where(image == _NO_DEPTH, np.float32(0), image.astype(np.float32) / 1000))
    if image.dtype not in (np.float32, np.float64):
        raise FileFormatError(
            path,
            f"depth has type {image.dtype}",
            "save metres as float32 or millimetres as 16-bit numbers",
        )
    try:
        return metres(image)
    except InvalidInputError as error:
        remedy = "divide it by 1000: floating-point depth is in metres"
        raise FileFormatError(path, f"depth is {error.found}", remedy) from error


def metres(depth: NDArray[Any]) -> Depth:
    """(H, W) float32 copy of a depth picture in metres, with NaN where nothing was measured.

    That is where it is zero, negative, not finite, or so far away that it stands for nothing.

    Raises:
        InvalidInputError: Its median says that it is in millimetres.
    """
    depth_m = depth.astype(np.float32)
    # The usual picture has no hole, and finding that out is quicker than the masks below. With a
    # NaN in it, min is NaN and the comparison False.
    if depth_m.min(initial=np.inf) > 0 and depth_m.max(initial=0.0) <= FARTHEST_M:
        return depth_m
    depth_m[~((depth_m > 0) & (depth_m < 1000 * FARTHEST_M))] = np.nan
    typical = _median(depth_m)
    if typical > FARTHEST_M:
        raise InvalidInputError(
            "depth", f"{typical:.6g} in the median, which looks like millimetres",
            "metres; divide by 1000",
        )  # fmt: skip
    depth_m[depth_m > FARTHEST_M] = np.nan
    return depth_m


def _median(depth_m: Depth) -> float:
    """Median of about 10,000 pixels spread over the picture, or of all if those are holes."""
    step = max(1, math.isqrt(depth_m.size // 10_000))
    for some in (depth_m[::step, ::step], depth_m):
        seen = some[~np.isnan(some)]
        if seen.size:
            return float(np.median(seen))
    return 0.0


def _read_array(path: Path) -> NDArray[Any]:
    read_bytes(path)  # for its errors
    try:
        return np.asarray(np.load(path, allow_pickle=False))
    except (ValueError, EOFError, OSError) as error:
        raise FileFormatError(path, "is no array of NumPy, or a damaged one", _REPLACE) from error


def write_rgb(path: Path, rgb: Rgb) -> None:
    """Write an (H, W, 3) uint8 picture, red first, in the format of the name's ending.

    Raises:
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed, or the ending names no picture format.
    """
    _write_image(path, cv2.cvtColor(np.ascontiguousarray(rgb), cv2.COLOR_RGB2BGR))


def write_mask(path: Path, mask: Mask) -> None:
    """Write an (H, W) bool mask as a picture with 0 and 255.

    Raises:
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed, or the ending names no picture format.
    """
    _write_image(path, mask.astype(np.uint8) * np.uint8(255))


def write_depth(path: Path, depth_m: Depth, hole: float = -1.0) -> None:
    """Write (H, W) float32 metres as a TIFF with LZW compression; NaN becomes ``hole``.

    Raises:
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed, or the ending is not that of a TIFF.
    """
    filled = np.where(np.isnan(depth_m), np.float32(hole), depth_m).astype(np.float32)
    _write_image(path, filled, [cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_LZW])


def _write_image(path: Path, image: NDArray[Any], options: list[int] | None = None) -> None:
    try:
        done, content = cv2.imencode(path.suffix, image, options or [])
    except cv2.error:
        done = False
    if not done:
        raise FileFormatError(
            path, f"{path.suffix or 'no ending'!r} is no format for this picture", "use .png"
        )
    write_bytes(path, content.tobytes())


def _read_picture(path: Path) -> bytes:
    """The bytes of a picture file; those of a PNG are known to be whole."""
    content = read_bytes(path)
    if content.startswith(SIGNATURE):
        _check_png(path, content)
    return content


def _decode(path: Path, content: bytes) -> NDArray[Any]:
    try:
        with _quiet_decoder():
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise FileFormatError(path, "is no picture, or a truncated or damaged one", _REPLACE)
    return np.asarray(image)


def _check_png(path: Path, content: bytes) -> None:
    # The decoder prints to standard error, and some versions hand out the upper half of a
    # truncated picture; a walk over the checksums costs under a millisecond.
    position = len(SIGNATURE)
    while position + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, position)
        end = position + 12 + length
        if end > len(content):
            break
        (expected,) = struct.unpack_from(">I", content, end - 4)
        if zlib.crc32(memoryview(content)[position + 4 : end - 4]) != expected:
            raise FileFormatError(path, "the picture is damaged (a checksum differs)", _REPLACE)
        if content[position + 4 : position + 8] == b"IEND":
            return
        position = end
    raise FileFormatError(path, "the picture is truncated", _REPLACE)


@contextmanager
def _quiet_decoder() -> Iterator[None]:
    # What OpenCV would print about a damaged file is said by our error, in one line.
    # One thread at a time: the level belongs to the process, and must come back as it was.
    with _DECODER:
        level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            yield
        finally:
            cv2.utils.logging.setLogLevel(level)
