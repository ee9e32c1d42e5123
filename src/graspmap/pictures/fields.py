"""Numbers for each pixel as colour: depth and the grasp maps.

Letters in shapes: H rows, W columns, N orientation bins. Pictures are uint8 RGB.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.maps.grasp_maps import GraspMaps
from graspmap.pictures.draw import PAPER, Picture, text_width, write_text

MapKind = Literal["quality", "angle", "width"]
BarKind = Literal["quality", "angle", "width", "depth"]
MAP_KINDS: tuple[MapKind, ...] = ("quality", "angle", "width")
HOLE = (255, 0, 200)
"""Pixels without depth: a colour that no colour map has."""


def map_picture(
    maps: GraspMaps[NDArray[Any]], kind: MapKind, *, width_top: float | None = None
) -> Picture:
    """One of the grasp maps in colour; at each pixel the bin with the best quality counts.

    Quality runs from dark (0) to bright (1). The angle is a hue, cyclic as angles are (-90 and
    90 degrees look the same), and dark where the quality is low, because the angle means nothing
    there. Width runs from dark (0) to bright (``width_top``).

    Args:
        maps: (N, H, W) maps.
        kind: ``"quality"``, ``"angle"`` or ``"width"``.
        width_top: Width (in the maps' own unit) that is brightest; None takes
            `width_range`.

    Returns:
        (H, W, 3) picture.

    Raises:
        InvalidInputError: The kind is unknown, or the maps are not (N, H, W).
    """
    quality, cos, sin, width = (np.asarray(m, dtype=np.float64) for m in maps)
    if quality.ndim != 3:
        raise InvalidInputError("shape of the maps", quality.shape, "(bins, H, W)")
    best = quality.argmax(axis=0)[None]
    quality, cos, sin, width = (
        np.nan_to_num(np.take_along_axis(m, best, axis=0)[0]) for m in (quality, cos, sin, width)
    )
    if kind == "quality":
        return _colored(quality, 0.0, 1.0)
    if kind == "width":
        return _colored(width, 0.0, width_range(maps) if width_top is None else width_top)
    if kind == "angle":
        return _hue(np.arctan2(sin, cos) / 2, 0.15 + 0.85 * np.clip(quality, 0.0, 1.0))
    raise InvalidInputError("kind of map", repr(kind), ", ".join(MAP_KINDS))


def width_range(maps: GraspMaps[NDArray[Any]]) -> float:
    """The greatest width where the quality is above half its greatest; 1 where there is none."""
    width = np.nan_to_num(np.asarray(maps.width, dtype=np.float64))
    quality = np.nan_to_num(np.asarray(maps.quality, dtype=np.float64))
    top = float(width[quality >= quality.max() / 2].max(initial=0.0))
    return top if top > 0 else 1.0


def depth_picture(
    depth_m: NDArray[np.floating[Any]], *, limits_m: tuple[float, float] | None = None
) -> Picture:
    """Depth in colour, near bright and far dark; pixels without depth in magenta.

    Args:
        depth_m: (H, W) metres, NaN where there is none.
        limits_m: Nearest and farthest depth of the colour scale; None takes the 1st and 99th
            percentile, so that a few stray pixels do not wash the picture out.

    Returns:
        (H, W, 3) picture.

    Raises:
        InvalidInputError: The depth is not (H, W).
    """
    depth = np.asarray(depth_m, dtype=np.float64)
    if depth.ndim != 2 or depth.size == 0:
        raise InvalidInputError("shape of depth", depth.shape, "(H, W)")
    known = np.isfinite(depth)
    near, far = depth_limits(depth) if limits_m is None else limits_m
    picture = _colored(np.where(known, -depth, -far), -far, -near)
    picture[~known] = HOLE
    return picture


def depth_limits(depth_m: NDArray[np.floating[Any]]) -> tuple[float, float]:
    """1st and 99th percentile of the known depth, metres; (0, 1) where there is none."""
    known = depth_m[np.isfinite(depth_m)]
    if not known.size:
        return 0.0, 1.0
    near, far = np.percentile(known, [1, 99])
    return float(near), float(far)


def color_bar(kind: BarKind, width: int, low: str, high: str, height: int = 30) -> Picture:
    """The colour scale of a map with the words for its two ends.

    Args:
        kind: Which map; ``"depth"`` for `depth_picture`.
        width: Width of the bar, pixels.
        low: Words at its left end.
        high: Words at its right end.
        height: Height with the words, pixels.

    Returns:
        (height, width, 3) picture.
    """
    ramp = np.linspace(0.0, 1.0, width)[None].repeat(10, axis=0)
    if kind == "angle":
        strip = _hue((ramp - 0.5) * np.pi, np.ones_like(ramp))
    else:
        strip = _colored(1.0 - ramp if kind == "depth" else ramp, 0.0, 1.0)
    bar = np.full((height, width, 3), PAPER, dtype=np.uint8)
    bar[:10] = strip
    write_text(bar, low, (1, height - 5), size=0.4)
    write_text(bar, high, (width - text_width(high, 0.4) - 2, height - 5), size=0.4)
    return bar


def _colored(values: NDArray[np.float64], low: float, high: float) -> Picture:
    """(H, W) numbers between two limits as a colour that grows steadily brighter."""
    import cv2

    span = max(high - low, 1e-9)
    scaled = np.clip((values - low) / span, 0.0, 1.0)
    gray = np.rint(255 * scaled).astype(np.uint8)
    return np.asarray(
        cv2.cvtColor(cv2.applyColorMap(gray, cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB)
    )


def _hue(angle: NDArray[np.float64], brightness: NDArray[np.float64]) -> Picture:
    """(H, W) angles as hues: the circle of hues goes round once in half a turn."""
    import cv2

    hsv = np.empty((*angle.shape, 3), dtype=np.float32)
    hsv[..., 0] = np.mod(angle / np.pi, 1.0) * 360.0
    hsv[..., 1] = 0.9
    hsv[..., 2] = brightness
    return np.rint(255 * cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)).astype(np.uint8)
