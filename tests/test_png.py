"""The fast PNG decoder against OpenCV's, over every filter, and what it leaves to others."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.data.png import decode_rgb

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(scanlines: np.ndarray, columns: int, *, kind=(8, 2, 0, 0, 0), parts: int = 1) -> bytes:
    """A PNG whose scanlines are given as they are stored, each led by its filter's number."""
    header = struct.pack(">IIBBBBB", columns, len(scanlines), *kind)
    stream = zlib.compress(scanlines.tobytes())
    step = -(-len(stream) // parts)
    data = b"".join(chunk(b"IDAT", stream[i : i + step]) for i in range(0, len(stream), step))
    return SIGNATURE + chunk(b"IHDR", header) + data + chunk(b"IEND", b"")


def opencv(content: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


@given(st.integers(1, 9), st.integers(1, 9), st.integers(1, 3), st.integers(0, 2**32 - 1))
def test_any_mixture_of_filters(rows, columns, parts, seed):
    rng = np.random.default_rng(seed)
    scanlines = rng.integers(0, 256, (rows, 1 + 3 * columns), dtype=np.uint8)
    scanlines[:, 0] = rng.integers(0, 5, rows)
    content = png(scanlines, columns, parts=parts)
    np.testing.assert_array_equal(decode_rgb(content), opencv(content))


def test_a_written_picture_comes_back():
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.integers(0, 256, (64, 80, 3), dtype=np.uint8), (0, 0), 4)
    _, content = cv2.imencode(".png", smooth)
    np.testing.assert_array_equal(decode_rgb(content.tobytes()), smooth[..., ::-1])


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((4, 5), np.uint8),
        np.zeros((4, 5, 4), np.uint8),
        np.zeros((4, 5, 3), np.uint16),
    ],
)
def test_other_kinds_are_left_to_the_general_decoder(picture):
    _, content = cv2.imencode(".png", picture)
    assert decode_rgb(content.tobytes()) is None


def test_damaged_streams_are_left_to_the_general_decoder():
    scanlines = np.zeros((4, 16), np.uint8)
    assert decode_rgb(png(scanlines[:3], 5)) is not None
    too_short = png(scanlines, 5).replace(struct.pack(">II", 5, 4), struct.pack(">II", 5, 9))
    assert decode_rgb(too_short) is None
    unknown_filter = scanlines.copy()
    unknown_filter[2, 0] = 5
    assert decode_rgb(png(unknown_filter, 5)) is None
    interlaced = png(scanlines, 5, kind=(8, 2, 0, 0, 1))
    assert decode_rgb(interlaced) is None
    garbled = png(scanlines, 5).replace(zlib.compress(scanlines.tobytes())[2:6], b"\xff" * 4)
    assert decode_rgb(garbled) is None
    absurd = png(scanlines, 2**31 - 1)
    assert decode_rgb(absurd) is None
