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
from graspmap.maps.grasp_maps import GraspMaps

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int32]

Method = Literal["refined", "ggcnn", "orange"]
"""How maps are decoded, see `find_grasps`."""

PLATEAU_LEVEL = 0.89
"""Part of the smoothed peak that a plateau's pixels reach; just under the 0.9 of soft maps."""
CLEAN_FIT = 0.9999
"""Explained part of the variance from which on a peak counts as a drawn Gaussian."""


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
      peak's quality and the same angle and width. Where the quality is a clean Gaussian, its
      vertex gives the centre. A plateau gives one grasp, however large it is.
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
        Thesis, section 3.3 (Eq. 3.4, garbled: angle = atan2(sin 2a, cos 2a) / 2).
    """
    if method not in get_args(Method):
        raise UnknownNameError("method", str(method), get_args(Method))
    _check_settings(top, width_scale, height, smoothing)
    default = DEFAULTS[method]
    distance = default.min_distance if min_distance is None else float(min_distance)
    least = default.threshold if threshold is None else float(threshold)
    if not distance >= 0 or np.isnan(least):
        found = (min_distance, threshold)
        raise InvalidInputError("min_distance and threshold", found, "numbers, distance >= 0")
    arrays = _arrays(maps)
    allowed = _check_mask(mask, arrays[0].shape[1:])

    if method == "refined":
        rows = _refined(arrays, allowed, top, distance, least, smoothing, width_scale)
    elif method == "ggcnn":
        rows = _local_peaks(arrays, allowed, top, distance, least, smoothing)
    else:
        rows = _raw_peaks(arrays, allowed, top, distance, least)
    return _grasps(rows, width_scale, height)


Row = tuple[float, float, float, float, float, float]
"""One grasp as read from the maps: x, y, cos, sin, scaled width, quality."""


def _refined(
    arrays: list[Singles],
    allowed: Bools | None,
    top: int,
    distance: float,
    threshold: float,
    smoothing: tuple[float, float, float],
    width_scale: float,
) -> list[Row]:
    from graspmap.maps import _find_kernel as kernel

    quality = arrays[0]
    score = _smoothed(quality, smoothing[0])
    seeds = _seeds(score, allowed, top, threshold)
    if not len(seeds):
        return []
    everywhere = np.ones(quality.shape[1:], np.bool_) if allowed is None else allowed
    taken = np.zeros(quality.shape, np.bool_)
    pixels = np.empty((everywhere.size, 2), np.int32)
    found: list[Row] = []
    for seed in seeds:
        b, y, x = (int(i) for i in np.unravel_index(seed, score.shape))
        if taken[b, y, x] or _near(found, x, y, distance):
            continue
        others = (arrays[1][b], arrays[2][b], arrays[3][b])
        c, s, w, agreement = kernel.local_values(quality[b], others, y, x, smoothing[1:])
        if not agreement > 0.7:
            # Several grasps meet here: their mean would be none of them.
            row, column = kernel.strongest_near(quality[b], y, x, 2)
            c, s, w = (float(m[row, column]) for m in others)
        peak = float(score[b, y, x])
        slack = max(kernel.SAME_WIDTH * abs(w), 1.0 / width_scale)
        like = (PLATEAU_LEVEL * peak, c, s, w, slack)
        row, column = _seed_pixel(kernel, quality[b], others, y, x, like)
        count = kernel.plateau(quality[b], others, everywhere, taken[b], row, column, like, pixels)
        if count == 0:
            center = (float(x), float(y))
        else:
            center = _center(
                kernel, quality[b], everywhere, pixels[:count], 0.5 * float(np.arctan2(s, c))
            )
            near = (round(center[1]), round(center[0]))
            values = kernel.local_values(quality[b], others, *near, smoothing[1:])
            if values[3] > 0.7:
                c, s, w = values[:3]
        if _near(found, *center, distance):
            continue
        found.append((*center, c, s, w, peak))
        if len(found) == top:
            break
    return found


def _seed_pixel(
    kernel: Any, quality: Singles, others: tuple[Singles, ...], y: int, x: int, like: Any
) -> tuple[int, int]:
    """Row and column of the peak, or of the strongest pixel beside it if the peak is unlike it.

    The smoothed peak of a thin region may lie on a pixel next to it.
    """
    if kernel.belongs(quality, others, y, x, like):
        return y, x
    row, column = kernel.strongest_near(quality, y, x, 2)
    return int(row), int(column)


def _center(
    kernel: Any, quality: Singles, allowed: Bools, pixels: Integers, angle: float
) -> tuple[float, float]:
    """Centre (x, y) of the plateau's (P, 2) pixels, whose grasp has this angle."""
    x, y = kernel.middle(pixels, allowed, np.cos(angle), np.sin(angle))
    fitted = _gaussian_vertex(kernel, quality, pixels, (x, y), angle)
    if fitted is not None and allowed[round(fitted[1]), round(fitted[0])]:
        return fitted
    return x, y


def _gaussian_vertex(
    kernel: Any, quality: Singles, pixels: Integers, origin: tuple[float, float], angle: float
) -> tuple[float, float] | None:
    """Vertex (x, y) of the Gaussian along the grasp's axes, or None if that is not what it is.

    The logarithm of a Gaussian is a parabola along each axis, so the vertex is exact whichever
    pixels of the region are sampled.
    """
    if len(pixels) < 8:
        return None
    spread = pixels.max(axis=0) - pixels.min(axis=0)
    unit = max(float(spread.max()) / 2, 1.0)
    c, s = float(np.cos(angle)), float(np.sin(angle))
    sums = kernel.gaussian_sums(quality, pixels, (*origin, c, s, unit))
    normal, right = sums[:5, :5], sums[:5, 5]
    variance = sums[5, 5] - sums[0, 5] ** 2 / sums[0, 0]
    if variance < 1e-8 * len(pixels) or np.linalg.cond(normal) > 1e10:
        return None
    p = np.linalg.solve(normal, right)
    unexplained = sums[5, 5] - 2 * p @ right + p @ normal @ p
    if unexplained > (1 - CLEAN_FIT) * variance or p[2] >= 0 or p[4] >= 0:
        return None
    u, v = -p[1] / (2 * p[2]) * unit, -p[3] / (2 * p[4]) * unit
    x, y = origin[0] + c * u + s * v, origin[1] - s * u + c * v
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    inside = low[0] - 0.5 < x < high[0] + 0.5 and low[1] - 0.5 < y < high[1] + 0.5
    return (float(x), float(y)) if inside else None


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
        _smoothed(m, sigma)
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
    _check_finite(float(score.max()))
    return _read(maps, _by_value(score, np.flatnonzero(peaks)), top, reach)


def _raw_peaks(
    arrays: list[Singles], allowed: Bools | None, top: int, distance: float, threshold: float
) -> list[Row]:
    seeds = _seeds(arrays[0], allowed, top, threshold)
    return _read(arrays, seeds, top, distance)


def _read(maps: list[Singles], seeds: NDArray[np.intp], top: int, distance: float) -> list[Row]:
    """The values at the first ``top`` seeds that keep their distance from each other."""
    found: list[Row] = []
    for seed in seeds:
        b, y, x = (int(i) for i in np.unravel_index(seed, maps[0].shape))
        if not _near(found, x, y, distance):
            q, c, s, w = (float(m[b, y, x]) for m in maps)
            found.append((float(x), float(y), c, s, w, q))
            if len(found) == top:
                break
    return found


def _near(found: list[Row], x: float, y: float, distance: float) -> bool:
    return any((x - f[0]) ** 2 + (y - f[1]) ** 2 < distance**2 for f in found)


def _seeds(score: Singles, allowed: Bools | None, top: int, threshold: float) -> NDArray[np.intp]:
    """Flat indices of the peaks above the threshold, best first; only the best if top is 1."""
    if allowed is not None:
        score = np.where(allowed, score, np.float32(-np.inf))
    best = int(score.argmax())  # a NaN counts as the greatest
    peak = float(score.flat[best])
    if np.isnan(peak):
        _check_finite(peak)
    if not peak > threshold:
        return np.zeros(0, np.intp)
    if top == 1:
        return np.array([best])
    import cv2

    square = np.ones((3, 3), np.uint8)
    peaks = np.stack([cv2.dilate(m, square) <= m for m in score]) & (score > threshold)
    return _by_value(score, np.flatnonzero(peaks))


def _by_value(score: Singles, indices: NDArray[np.intp]) -> NDArray[np.intp]:
    """Indices by falling value; of equal ones the first in the image."""
    return indices[np.argsort(-score.reshape(-1)[indices], kind="stable")]


def _smoothed(maps: Singles, sigma: float) -> Singles:
    """(N, H, W) maps after a Gaussian blur; the border's values go on outside."""
    if sigma == 0:
        return maps
    import cv2

    side = 2 * int(4 * sigma + 0.5) + 1
    blurred = np.empty_like(maps)
    for source, target in zip(maps, blurred, strict=True):
        cv2.GaussianBlur(source, (side, side), sigma, dst=target, borderType=cv2.BORDER_REPLICATE)
    return blurred


def _grasps(rows: list[Row], width_scale: float, height: float | None) -> Grasps:
    if not rows:
        return Grasps.empty()
    table = np.array(rows)
    _check_finite(table)
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


def _check_finite(values: Any) -> None:
    if not np.isfinite(values).all():
        raise InvalidInputError(
            "value in the maps", "NaN or infinite", "finite numbers; look at the weights and input"
        )


def _check_settings(
    top: int, width_scale: float, height: float | None, smoothing: tuple[float, float, float]
) -> None:
    if top < 1 or top != int(top):
        raise InvalidInputError("top", top, "a whole number, 1 or more")
    if not np.isfinite(width_scale) or width_scale <= 0:
        raise InvalidInputError("width_scale", width_scale, "a positive number")
    if height is not None and not (np.isfinite(height) and height >= 0):
        raise InvalidInputError("height", height, "pixels, 0 or more, or None")
    if len(smoothing) != 3 or not all(np.isfinite(s) and 0 <= s <= 50 for s in smoothing):
        raise InvalidInputError("smoothing", smoothing, "three numbers of pixels, 0 to 50")
