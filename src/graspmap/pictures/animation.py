"""Small films: frames with a caption, as an animated WebP."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from graspmap.errors import InvalidInputError
from graspmap.pictures.draw import INK, PAPER, Color, Picture, check_picture, text_width, write_text

_LINE = 17
_LINES = 3
_MARGIN = 6
_SMALL = 0.4
_TITLE = 0.5


def captioned(
    frames: Sequence[Picture],
    title: str,
    text: str,
    *,
    color: Color = INK,
    corners: Sequence[str] = (),
) -> list[Picture]:
    """Frames with one caption below all of them.

    Args:
        frames: (H, W, 3) pictures of one size.
        title: A few words in ``color``, above the text.
        text: Words, broken into at most three lines.
        color: Of the title.
        corners: A word for the upper left corner of each frame, or none at all.

    Returns:
        (H + h, W, 3) pictures.

    Raises:
        InvalidInputError: There are no frames, or not one corner for each.
    """
    if not frames or len(corners) not in (0, len(frames)):
        raise InvalidInputError("frames", f"{len(frames)}, {len(corners)} corners", "one each")
    for frame in frames:
        check_picture(frame, "frame")
    width = frames[0].shape[1]
    lines = _broken(text, width - 2 * _MARGIN)
    band = np.full((_MARGIN + 20 + _LINE * _LINES, width, 3), PAPER, dtype=np.uint8)
    title = _cut(title, width - 2 * _MARGIN, _TITLE)
    write_text(band, title, (_MARGIN, 18), size=_TITLE, color=color)
    for number, line in enumerate(lines):
        write_text(band, line, (_MARGIN, 20 + _LINE * (number + 1) - 3), size=_SMALL)
    out = []
    for number, frame in enumerate(frames):
        picture = np.concatenate([frame, band])
        if corners:
            write_text(picture, corners[number], (_MARGIN, 16), size=_SMALL, rim=True)
        out.append(picture)
    return out


def encode_animation(
    frames: Sequence[Picture], durations_ms: Sequence[int], *, quality: int = 85
) -> bytes:
    """Frames as the bytes of an animated WebP that plays for ever.

    Args:
        frames: (H, W, 3) pictures of one size.
        durations_ms: How long each is shown.
        quality: From 1, small, to 100.

    Raises:
        InvalidInputError: No frames, frames that are no pictures or of unequal size, or not one
            positive duration for each.
    """
    import cv2

    if not frames or len(durations_ms) != len(frames) or min(durations_ms) <= 0:
        raise InvalidInputError(
            "durations_ms", f"{len(durations_ms)} for {len(frames)} frames", "one above 0 for each"
        )
    for frame in frames:
        check_picture(frame, "frame")
    sizes = {frame.shape for frame in frames}
    if len(sizes) > 1:
        raise InvalidInputError("sizes of the frames", sizes, "one size")
    film: Any = cv2.Animation()
    film.frames = [cv2.cvtColor(frame, cv2.COLOR_RGB2BGR) for frame in frames]
    film.durations = np.array(durations_ms, dtype=np.int32)
    _, content = cv2.imencodeanimation(".webp", film, [cv2.IMWRITE_WEBP_QUALITY, quality])
    return bytes(content)


def _broken(text: str, width: int) -> list[str]:
    """At most `_LINES` lines; what does not fit is cut."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and len(lines) < _LINES and text_width(longer, _SMALL) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return [_cut(line, width, _SMALL) for line in lines]


def _cut(line: str, width: int, size: float) -> str:
    if text_width(line, size) <= width:
        return line
    while line and text_width(f"{line}...", size) > width:
        line = line[:-1]
    return f"{line}..."
