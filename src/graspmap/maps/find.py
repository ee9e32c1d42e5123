"""Grasps from grasp maps: the decoding of what a network gives.

Letters in shapes: N orientation bins, (H, W) image, K grasps. Pixels (x right, y down), centres
at integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry.grasps import Grasps
from graspmap.maps._peaks import Row, by_value, check_finite, near, seeds, smoothed
from graspmap.maps.grasp_maps import GraspMaps

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

Method = Literal["refined", "ggcnn", "orange"]
"""How maps are decoded, see `find_grasps`."""


@dataclass(frozen=True)
class _Defaults:
    min_distance: float
    threshold: float


DEFAULTS: dict[str, _Defaults] = {
    "refined": _Defaults(10.0, 0.0),
    "ggcnn": _Defaults(20.0, 0.2),
    "orange": _Defaults(10.0, 0.0),
}
"""Peak distance in pixels and quality threshold of each method."""


def find_grasps(
    maps: GraspMaps[Any],
    top: int = 1,
    *,
    width_scale: float = 1.0,
    height: float | None = None,
    method: Method = "refined",
    smoothing: tuple[float, float, float] = (2.0, 2.0, 1.0),
    min_distance: float | None = None,
    threshold: float | None = None,
    mask: ArrayLike | None = None,
) -> Grasps:
    """The best grasps that the maps show, over all bins and pixels.

    How maps can be decoded:

    - ``refined`` (default): the peaks of the smoothed quality. Around a peak, cos, sin and width
      are averaged with the quality as weight, so that pixels without a grasp do not count. The
      centre is the middle of the plateau around the peak: the connected pixels with nearly the
      peak's quality and nearly its angle and width. Where the quality is a clean Gaussian, its
      vertex gives the centre. A plateau gives one grasp, however large it is. A grasp drawn by
      `draw_maps` is found again to half a pixel along each axis; among regions with a side under
      3 pixels about 2 in 10,000 cover so few pixels that these leave up to 0.55 open.
    - ``ggcnn``: as published with GG-CNN. All maps are smoothed; a peak is the greatest value
      in a square of 2 min_distance + 1 pixels and lies at least min_distance from the border.
      cos and sin are smoothed instead of the angle, which jumps at +-90 degrees.
    - ``orange``: as published with ORANGE and in the thesis's chapter 5. The raw values at the
      greatest raw quality, without any smoothing.

    Args:
        maps: (N, H, W) maps of one image, NumPy arrays or torch tensors on the CPU.
        top: Greatest number of grasps K.
        width_scale: Opening in pixels that the width map shows as 1.
        height: Jaw size of the grasps found, pixels; None takes half the opening, as the
            published tests do.
        method: How to decode.
        smoothing: Standard deviations for quality, angle and width, pixels; 0 for none.
        min_distance: Least distance between two centres, whichever their bins, pixels; None:
            10, or 20 for ``ggcnn``.
        threshold: The (smoothed) quality at the peak must exceed this; None: 0, or 0.2 for
            ``ggcnn``.
        mask: (H, W) bool, where centres may lie; None: everywhere.

    Returns:
        At most ``top`` grasps, best first; their quality is the (smoothed) map's value at the
        peak, not cut to [0, 1]. Empty when nothing exceeds the threshold.

    Raises:
        InvalidInputError: The maps are a batch or hold NaN, the mask does not match, or a
            setting is out of range.
        UnknownNameError: There is no such method.

    References:
        Thesis, Eq. 3.4 and 3.7 (garbled there: angle = atan2(sin 2a, cos 2a) / 2).
    """
    if method not in get_args(Method):
        raise UnknownNameError("method", str(method), get_args(Method))
    _check_settings(top, width_scale, height, smoothing)
    default = DEFAULTS[method]
    distance = default.min_distance if min_distance is None else float(min_distance)
    least = default.threshold if threshold is None else float(threshold)
    if not 0 <= distance < np.inf or np.isnan(least):
        found = (min_distance, threshold)
        raise InvalidInputError(
            "min_distance and threshold", found, "numbers, the distance finite and >= 0"
        )
    arrays = _arrays(maps)
    allowed = _check_mask(mask, arrays[0].shape[1:])

    if method == "refined":
        from graspmap.maps._refine import refined_peaks

        rows = refined_peaks(
            arrays, allowed, top, distance, least, smoothing, one_pixel=1.0 / width_scale
        )
    elif method == "ggcnn":
        rows = _local_peaks(arrays, allowed, top, distance, least, smoothing)
    else:
        rows = _raw_peaks(arrays, allowed, top, distance, least)
    return _grasps(rows, width_scale, height)


def _local_peaks(
    arrays: list[Singles],
    allowed: Bools | None,
    top: int,
    distance: float,
    threshold: float,
    smoothing: tuple[float, float, float],
) -> list[Row]:
    import cv2

    sigma_q, sigma_a, sigma_w = smoothing
    maps = [
        smoothed(m, sigma)
        for m, sigma in zip(arrays, (sigma_q, sigma_a, sigma_a, sigma_w), strict=True)
    ]
    score = maps[0]
    reach = int(distance)
    square = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    peaks = np.stack([cv2.dilate(m, square) == m for m in score]) & (score > threshold)
    if reach:
        peaks[:, :reach] = peaks[:, -reach:] = False
        peaks[:, :, :reach] = peaks[:, :, -reach:] = False
    if allowed is not None:
        peaks &= allowed
    check_finite(float(score.max()))
    return _read(maps, by_value(score, np.flatnonzero(peaks)), top, reach)


def _raw_peaks(
    arrays: list[Singles], allowed: Bools | None, top: int, distance: float, threshold: float
) -> list[Row]:
    return _read(arrays, seeds(arrays[0], allowed, top, threshold), top, distance)


def _read(maps: list[Singles], pixels: NDArray[np.intp], top: int, distance: float) -> list[Row]:
    """The values at the first ``top`` pixels that keep their distance from each other."""
    found: list[Row] = []
    for pixel in pixels:
        b, y, x = (int(i) for i in np.unravel_index(pixel, maps[0].shape))
        if not near(found, x, y, distance):
            q, c, s, w = (float(m[b, y, x]) for m in maps)
            found.append((float(x), float(y), c, s, w, q))
            if len(found) == top:
                break
    return found


def _grasps(rows: list[Row], width_scale: float, height: float | None) -> Grasps:
    if not rows:
        return Grasps.empty()
    table = np.array(rows)
    check_finite(table)
    width = np.maximum(table[:, 4], 0.0) * width_scale
    return Grasps(
        center=table[:, :2],
        angle=0.5 * np.arctan2(table[:, 3], table[:, 2]),
        width=width,
        height=width / 2 if height is None else np.full(len(table), float(height)),
        quality=table[:, 5],
    )


def _arrays(maps: GraspMaps[Any]) -> list[Singles]:
    """The four maps as contiguous (N, H, W) float32 arrays."""
    arrays = []
    for m in maps:
        if hasattr(m, "detach"):  # a torch tensor, which this module must not import
            m = m.detach().cpu().float()
        arrays.append(np.ascontiguousarray(m, dtype=np.float32))
    shape = arrays[0].shape
    if len(shape) != 3 or 0 in shape:
        raise InvalidInputError(
            "shape of the maps", shape, "(bins, H, W) of one image; take maps.item(i) of a batch"
        )
    return arrays


def _check_mask(mask: ArrayLike | None, shape: tuple[int, ...]) -> Bools | None:
    if mask is None:
        return None
    allowed = np.ascontiguousarray(mask)
    if allowed.dtype != np.bool_:
        raise InvalidInputError("type of the mask", allowed.dtype, "bool")
    if allowed.shape != shape:
        raise InvalidInputError("shape of the mask", allowed.shape, f"that of the maps, {shape}")
    return allowed


def _check_settings(
    top: int, width_scale: float, height: float | None, smoothing: tuple[float, ...]
) -> None:
    if top < 1 or top != int(top):
        raise InvalidInputError("top", top, "a whole number, 1 or more")
    if not np.isfinite(width_scale) or width_scale <= 0:
        raise InvalidInputError("width_scale", width_scale, "a positive number")
    if height is not None and not (np.isfinite(height) and height >= 0):
        raise InvalidInputError("height", height, "pixels, 0 or more, or None")
    if len(smoothing) != 3 or not all(np.isfinite(s) and 0 <= s <= 50 for s in smoothing):
        raise InvalidInputError("smoothing", smoothing, "three numbers of pixels, 0 to 50")
