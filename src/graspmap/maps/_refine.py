"""The refined decoding of `graspmap.maps.find`; imported at its first use, for it needs numba.

Letters in shapes: N orientation bins, (H, W) image, P pixels of a plateau. Pixels (x right,
y down), centres at integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.maps import _find_kernel as kernel
from graspmap.maps._peaks import Row, check_finite, near, seeds, smoothed

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]
Integers = NDArray[np.int32]
Point = tuple[float, float]
Values = tuple[float, float, float]
"""cos, sin and scaled width."""

PLATEAU_LEVEL = 0.89
"""Part of the smoothed peak that a plateau's pixels reach; just under the 0.9 of soft maps."""
UNEXPLAINED = 1e-4
"""Part of the variance that a Gaussian may leave unexplained to give a plateau's centre."""
UNEXPLAINED_DRAWN = 1e-9
"""The same for a drawn region, where only the rounding of single precision is left."""
FILLED = 0.9
"""Part of the box around a plateau that its pixels fill if it is a drawn region."""
AGREEMENT = 0.7
"""Angles around a peak that agree less than this belong to several grasps, not to one."""
SAME_GRASP = 1 - 1e-8
"""As `kernel.SAME_ANGLE`, for pixels whose values were copied from one and the same grasp."""


@dataclass(frozen=True)
class _Bin:
    """The maps of one orientation bin, where centres may lie, and the pixels already used."""

    quality: Singles
    cos: Singles
    sin: Singles
    width: Singles
    allowed: Bools
    taken: Bools

    @property
    def others(self) -> tuple[Singles, Singles, Singles]:
        """cos, sin, width."""
        return self.cos, self.sin, self.width


def refined_peaks(
    arrays: list[Singles],
    allowed: Bools | None,
    top: int,
    distance: float,
    threshold: float,
    smoothing: tuple[float, float, float],
    one_pixel: float,
) -> list[Row]:
    """At most ``top`` grasps by falling smoothed quality, see `graspmap.maps.find_grasps`.

    Args:
        arrays: Quality, cos, sin and width, (N, H, W) each.
        allowed: (H, W) where centres may lie, or None for everywhere.
        top: Greatest number of grasps.
        distance: Least distance between two centres, pixels.
        threshold: Quality that a peak must exceed.
        smoothing: Standard deviations for quality, angle and width, pixels.
        one_pixel: What the width map shows for an opening of one pixel.
    """
    quality = arrays[0]
    score = smoothed(quality, smoothing[0])
    everywhere = np.ones(quality.shape[1:], np.bool_) if allowed is None else allowed
    taken = np.zeros(quality.shape, np.bool_)
    pixels = np.empty((everywhere.size, 2), np.int32)
    found: list[Row] = []
    for seed in seeds(score, allowed, top, threshold):
        b, y, x = (int(i) for i in np.unravel_index(seed, score.shape))
        if taken[b, y, x] or near(found, x, y, distance):
            continue
        q, c, s, w = (m[b] for m in arrays)
        here = _Bin(q, c, s, w, everywhere, taken[b])
        peak = float(score[b, y, x])
        (cx, cy), values = _grasp_at(here, y, x, peak, smoothing[1:], one_pixel, pixels)
        if not near(found, cx, cy, distance):
            found.append((cx, cy, *values, peak))
            if len(found) == top:
                break
    return found


def _grasp_at(
    maps: _Bin,
    y: int,
    x: int,
    peak: float,
    sigmas: tuple[float, float],
    one_pixel: float,
    pixels: Integers,
) -> tuple[Point, Values]:
    """Centre (x, y) and (cos, sin, width) of the grasp that the peak at (y, x) shows."""
    values = _values_at(maps, y, x, sigmas) or _strongest_values(maps, y, x)
    check_finite(values)
    slack = max(kernel.SAME_WIDTH * abs(values[2]), one_pixel)
    like = (PLATEAU_LEVEL * peak, *values, slack, kernel.SAME_ANGLE)
    row, column = y, x
    if not kernel.belongs(maps.quality, maps.others, y, x, like):
        # The smoothed peak of a thin region may lie on a pixel next to it.
        row, column = kernel.strongest_near(maps.quality, y, x, 2)
    count = kernel.plateau(
        maps.quality, maps.others, maps.allowed, maps.taken, row, column, like, pixels
    )
    if count == 0:
        return (float(x), float(y)), values
    angle = 0.5 * float(np.arctan2(values[1], values[0]))
    center = _drawn_center(maps, row, column, values, angle)
    if center is None:
        center = _plateau_center(maps, pixels[:count], angle)
    at_center = _values_at(maps, round(center[1]), round(center[0]), sigmas)
    return center, at_center or values


def _values_at(maps: _Bin, y: int, x: int, sigmas: tuple[float, float]) -> Values | None:
    """Mean cos, sin and width around (y, x); None where the angles there do not agree."""
    c, s, w, agreement = kernel.local_values(maps.quality, maps.others, y, x, sigmas)
    return (c, s, w) if agreement > AGREEMENT else None


def _strongest_values(maps: _Bin, y: int, x: int) -> Values:
    """cos, sin, width of the strongest pixel near (y, x).

    For places where several grasps meet: their mean would be none of them.
    """
    row, column = kernel.strongest_near(maps.quality, y, x, 2)
    c, s, w = (float(m[row, column]) for m in maps.others)
    return c, s, w


def _drawn_center(maps: _Bin, y: int, x: int, values: Values, angle: float) -> Point | None:
    """Centre (x, y) of the whole drawn region around (y, x); None if this is no drawn region.

    Drawn maps show one and the same angle and width at every pixel of a region, and the region
    fills the box around it; what a network gives does neither.
    """
    pixels = np.empty((maps.allowed.size, 2), np.int32)
    like = (np.finfo(np.float32).tiny, *values, 1e-6 * abs(values[2]), SAME_GRASP)
    used = np.zeros_like(maps.taken)
    count = kernel.plateau(maps.quality, maps.others, maps.allowed, used, y, x, like, pixels)
    if count == 0:
        return None
    pixels = pixels[:count]
    cx, cy, filled = kernel.box_middle(pixels, maps.allowed.shape, np.cos(angle), np.sin(angle))
    if filled < FILLED:
        return None
    fitted = _gaussian_vertex(maps.quality, pixels, (cx, cy), angle, UNEXPLAINED_DRAWN)
    if fitted is not None and max(abs(fitted[0] - cx), abs(fitted[1] - cy)) <= 0.5:
        return fitted
    return cx, cy


def _plateau_center(maps: _Bin, pixels: Integers, angle: float) -> Point:
    """Centre (x, y) of the plateau's (P, 2) pixels, whose grasp has this angle."""
    x, y, filled = kernel.box_middle(pixels, maps.allowed.shape, np.cos(angle), np.sin(angle))
    if filled < FILLED:
        x, y = kernel.mean_pixel(pixels, maps.allowed)
    fitted = _gaussian_vertex(maps.quality, pixels, (x, y), angle, UNEXPLAINED)
    if fitted is not None and maps.allowed[round(fitted[1]), round(fitted[0])]:
        return fitted
    return x, y


def _gaussian_vertex(
    quality: Singles, pixels: Integers, origin: Point, angle: float, tolerated: float
) -> Point | None:
    """Vertex (x, y) of the Gaussian along the grasp's axes, or None if that is not what it is.

    The logarithm of a Gaussian is a parabola along each axis, so the vertex is exact whichever
    pixels of the region are sampled.
    """
    if len(pixels) < 8 or kernel.is_flat(quality, pixels):
        return None
    spread = pixels.max(axis=0) - pixels.min(axis=0)
    unit = max(float(spread.max()) / 2, 1.0)
    c, s = float(np.cos(angle)), float(np.sin(angle))
    sums = kernel.gaussian_sums(quality, pixels, (*origin, c, s, unit))
    normal, right = sums[:5, :5], sums[:5, 5]
    variance = sums[5, 5] - sums[0, 5] ** 2 / sums[0, 0]
    if np.linalg.cond(normal) > 1e10:
        return None
    p = np.linalg.solve(normal, right)
    unexplained = sums[5, 5] - 2 * p @ right + p @ normal @ p
    if unexplained > tolerated * variance or p[2] >= 0 or p[4] >= 0:
        return None
    u, v = -p[1] / (2 * p[2]) * unit, -p[3] / (2 * p[4]) * unit
    x, y = origin[0] + c * u + s * v, origin[1] - s * u + c * v
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    inside = low[0] - 0.5 < x < high[0] + 0.5 and low[1] - 0.5 < y < high[1] + 0.5
    return (float(x), float(y)) if inside else None
