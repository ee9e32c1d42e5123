"""Grasps and words on a picture.

Letters in shapes: H rows, W columns. Pictures are uint8 RGB.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.affine import apply, check_affine, resize
from graspmap.geometry.grasps import Grasps

Picture = NDArray[np.uint8]
Color = tuple[int, int, int]

JAW: Color = (40, 90, 255)
"""Where the plates of the gripper stand: blue, as is usual in the field."""
OPENING: Color = (255, 60, 40)
"""The way that the plates close along: red."""
FAILED: Color = (150, 150, 150)
INK: Color = (30, 32, 36)
PAPER: Color = (255, 255, 255)

_SHIFT = 4  # cv2 takes coordinates in 1/16 pixel: grasps are drawn where they are, not rounded
_FAR = 1 << 20  # coordinates beyond this would overflow cv2's integers; nothing of it is visible


def check_picture(rgb: NDArray[np.generic], name: str = "picture") -> None:
    """Check that an array is a picture.

    Raises:
        InvalidInputError: It is not (H, W, 3) uint8, or it is empty.
    """
    if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.size == 0:
        raise InvalidInputError(name, f"{rgb.dtype} {rgb.shape}", "uint8 (H, W, 3)")


def draw_grasps(
    rgb: Picture,
    grasps: Grasps,
    *,
    scale: float = 1.0,
    ranks: bool = False,
    jaw: Color = JAW,
    opening: Color = OPENING,
) -> Picture:
    """A copy of a picture with grasps drawn on it.

    Each grasp is its rectangle: the two jaws as thick lines, the opening between them as thin
    ones, and a dot at the centre. The first grasp is drawn last, so that it lies on top.

    Args:
        rgb: (H, W, 3) picture.
        grasps: Grasps in its pixels, best first.
        scale: The result is this many times as large as ``rgb``; lines stay as thin as they are.
        ranks: Whether to write each grasp's place (1, 2, ...) beside it.
        jaw: Colour of the jaws.
        opening: Colour of the opening.

    Returns:
        (scale H, scale W, 3) picture.

    Raises:
        InvalidInputError: ``rgb`` is no picture, or the scale is not positive.
    """
    import cv2

    check_picture(rgb)
    if not np.isfinite(scale) or scale <= 0:
        raise InvalidInputError("scale", scale, "a positive number")
    picture = rgb.copy()
    if scale != 1.0:
        size = (max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale)))
        mode = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        picture = np.ascontiguousarray(cv2.resize(rgb, size, interpolation=mode))
        grasps = grasps.transformed(resize(scale))
    thin = max(1, round(min(picture.shape[:2]) / 400))
    for rank in range(len(grasps) - 1, -1, -1):
        _draw_one(picture, grasps[rank], thin, jaw, opening)
    for rank in range(len(grasps) if ranks else 0):  # above all rectangles
        _draw_rank(picture, grasps[rank], rank + 1)
    return picture


def _draw_one(picture: Picture, grasp: Grasps, thin: int, jaw: Color, opening: Color) -> None:
    p0, p1, p2, p3 = grasp.corners()[0]
    # Small grasps get thin jaws and no dot: the drawing must not hide what it shows.
    small = float(grasp.width[0])
    jaw_line = int(np.clip(round(small / 10), 1, 2 * thin + 1))
    if grasp.height[0] == 0:  # a jaw without size still shows where it stands
        axis = grasp.axis()[0]
        across = 3.0 * np.array([-axis[1], axis[0]])
        p0, p1, p2, p3 = p0 - across, p1 - across, p2 + across, p3 + across
    # A white rim below the colours keeps the lines legible on dark and on coloured ground.
    for color, extra in ((PAPER, 2), (None, 0)):
        for a, b in ((p0, p1), (p3, p2)):
            _line(picture, a, b, color or opening, thin + extra)
        for a, b in ((p0, p3), (p1, p2)):
            _line(picture, a, b, color or jaw, jaw_line + extra)
    if small < 18:
        return
    _dot(picture, grasp.center[0], 2.0 * thin + 1, PAPER)
    _dot(picture, grasp.center[0], 2.0 * thin, INK)


def _draw_rank(picture: Picture, grasp: Grasps, rank: int) -> None:
    corners = grasp.corners()[0]
    right = corners[np.argmax(corners[:, 0])]
    if np.abs(right).max() >= _FAR:
        return
    rows, columns = picture.shape[:2]
    x = np.clip(right[0] + 5, 2, max(2, columns - text_width(str(rank)) - 2))
    y = np.clip(right[1] + 4, 12, max(12, rows - 3))  # digits are 10 px high
    write_text(picture, str(rank), (float(x), float(y)), rim=True)


def _line(picture: Picture, a: NDArray[np.float64], b: NDArray[np.float64], color: Color,
          thickness: int) -> None:  # fmt: skip
    import cv2

    ends = _fixed(np.stack([a, b]))
    cv2.line(picture, tuple(ends[0]), tuple(ends[1]), color, thickness, cv2.LINE_AA, shift=_SHIFT)


def _dot(picture: Picture, point: NDArray[np.float64], radius: float, color: Color) -> None:
    import cv2

    if np.abs(point).max() >= _FAR:
        return
    x, y = _fixed(point[None])[0]
    cv2.circle(picture, (x, y), round(radius * 2**_SHIFT), color, -1, cv2.LINE_AA, shift=_SHIFT)


def _fixed(points: NDArray[np.float64]) -> list[list[int]]:
    """(N, 2) points in cv2's fixed-point pixels."""
    scaled = np.rint(np.clip(points, -_FAR, _FAR) * 2**_SHIFT)
    return [[int(x), int(y)] for x, y in scaled]


def draw_window(rgb: Picture, matrix: ArrayLike, shape: tuple[int, int]) -> Picture:
    """A copy of a picture in which what the network does not see is darker.

    Args:
        rgb: (H, W, 3) picture.
        matrix: (3, 3) map from its pixels to pixels of the network's input.
        shape: (rows, columns) of the input.
    """
    import cv2

    rows, columns = shape
    outline = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]) - 0.5
    corners = np.clip(apply(np.linalg.inv(check_affine(matrix)), outline), -_FAR, _FAR)
    seen = np.zeros(rgb.shape[:2], dtype=np.uint8)
    cv2.fillConvexPoly(seen, np.rint(corners).astype(np.int32), 1)
    if seen.all():
        return rgb.copy()
    return np.where(seen[..., None] == 1, rgb, rgb // 2)


def write_text(
    picture: Picture,
    text: str,
    at: tuple[float, float],
    *,
    size: float = 0.45,
    color: Color = INK,
    rim: bool = False,
) -> None:
    """Write one line of text into a picture.

    Args:
        picture: (H, W, 3), changed.
        text: The words; characters outside ASCII are replaced, the font has no others.
        at: (x, y) of the left end of the baseline, pixels.
        size: Font scale; 0.45 gives capitals about 10 px high.
        color: Ink.
        rim: Whether to put a white rim round the letters, for text on an image.
    """
    import cv2

    ascii_text = text.encode("ascii", "replace").decode()
    origin = (round(at[0]), round(at[1]))
    for ink, thickness in ((PAPER, 4), (color, 1)) if rim else ((color, 1),):
        cv2.putText(
            picture, ascii_text, origin, cv2.FONT_HERSHEY_SIMPLEX, size, ink, thickness, cv2.LINE_AA
        )


def text_width(text: str, size: float = 0.45) -> int:
    """Width of a line of text, pixels."""
    import cv2

    # As `write_text` writes it; and a name that is no Unicode makes OpenCV crash.
    ascii_text = text.encode("ascii", "replace").decode()
    (width, _), _ = cv2.getTextSize(ascii_text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)
    return int(width)


def encode(rgb: Picture, suffix: str = ".png") -> bytes:
    """A picture as the bytes of an image file.

    Args:
        rgb: (H, W, 3) picture.
        suffix: ``".png"``, ``".jpg"`` or ``".jpeg"``.

    Raises:
        InvalidInputError: ``rgb`` is no picture, or the suffix is another one.
    """
    import cv2

    check_picture(rgb)
    if suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InvalidInputError("suffix of a picture", suffix, ".png, .jpg or .jpeg")
    options = [cv2.IMWRITE_JPEG_QUALITY, 92] if suffix.lower() != ".png" else []
    _, content = cv2.imencode(suffix.lower(), cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), options)
    return bytes(content)
