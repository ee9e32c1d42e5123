"""Compiled loops of `graspmap.maps.find`; imported at the first decoding, never before.

Letters in shapes: N orientation bins, (H, W) image, P pixels of one plateau. ``maps`` is
(4, N, H, W): quality, cos, sin, width.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

SAME_ANGLE = math.cos(2 * math.radians(5.0)) ** 2
"""Pixels of one plateau have grasp angles within 5 degrees of the one at its seed."""
SAME_WIDTH = 0.1
"""Pixels of one plateau have openings within this part of the one at its seed, or 1 pixel."""


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def local_values(
    quality: Singles, others: tuple[Singles, Singles, Singles], y: int, x: int, sigmas: Any
) -> Any:
    """Mean of cos, sin and width around a pixel, weighted by quality and a Gaussian.

    Weighting by quality keeps out the pixels that show no grasp, whose values mean nothing.

    Args:
        quality: (H, W).
        others: cos, sin and width, (H, W) each.
        y: Row.
        x: Column.
        sigmas: Standard deviations for the angle and for the width, pixels; 0 takes the pixel's
            own value.

    Returns:
        cos, sin, width, each a mean; and the agreement of the angles, |mean| / mean of |.|: 1
        where all agree, near 0 where they cancel. NaN where there is no quality nearby.
    """
    rows, columns = quality.shape
    cos, sin, width = others
    total_a = total_w = sum_c = sum_s = sum_w = length = 0.0
    reach = math.ceil(3.0 * max(sigmas[0], sigmas[1]))
    scale_a = 0.5 / max(sigmas[0], 1e-3) ** 2
    scale_w = 0.5 / max(sigmas[1], 1e-3) ** 2
    for row in range(max(y - reach, 0), min(y + reach + 1, rows)):
        for column in range(max(x - reach, 0), min(x + reach + 1, columns)):
            q = np.float64(quality[row, column])
            if q <= 0.0:
                continue
            d = (row - y) ** 2 + (column - x) ** 2
            weight = q * math.exp(-d * scale_a)
            c, s = np.float64(cos[row, column]), np.float64(sin[row, column])
            total_a += weight
            sum_c += weight * c
            sum_s += weight * s
            length += weight * math.hypot(c, s)
            weight = q * math.exp(-d * scale_w)
            total_w += weight
            sum_w += weight * width[row, column]
    if total_a <= 0.0 or total_w <= 0.0:
        return np.nan, np.nan, np.nan, np.nan
    agreement = math.hypot(sum_c, sum_s) / max(length, 1e-300)
    return sum_c / total_a, sum_s / total_a, sum_w / total_w, agreement


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def strongest_near(quality: Singles, y: int, x: int, reach: int) -> Any:
    """Row and column of the greatest quality within ``reach`` pixels; of equals the nearest."""
    rows, columns = quality.shape
    best_y, best_x, best_d = y, x, 0
    for row in range(max(y - reach, 0), min(y + reach + 1, rows)):
        for column in range(max(x - reach, 0), min(x + reach + 1, columns)):
            d = (row - y) ** 2 + (column - x) ** 2
            q, best = quality[row, column], quality[best_y, best_x]
            if q > best or (q == best and d < best_d):
                best_y, best_x, best_d = row, column, d
    return best_y, best_x


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def belongs(
    quality: Singles, others: tuple[Singles, Singles, Singles], row: int, column: int, seed: Any
) -> bool:
    """Whether a pixel shows the seed's grasp: enough quality, the same angle and width."""
    level, c, s, w, slack, same_angle = seed
    if not quality[row, column] >= level:
        return False
    cos, sin = np.float64(others[0][row, column]), np.float64(others[1][row, column])
    dot = cos * c + sin * s
    if dot < 0.0 or dot * dot < same_angle * (cos * cos + sin * sin) * (c * c + s * s):
        return False
    return bool(abs(np.float64(others[2][row, column]) - w) <= slack)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def plateau(
    quality: Singles,
    others: tuple[Singles, Singles, Singles],
    allowed: Bools,
    taken: Bools,
    y: int,
    x: int,
    seed: Any,
    pixels: NDArray[np.int32],
) -> int:
    """Collect the connected pixels around (y, x) that show one and the same grasp.

    Args:
        quality: (H, W).
        others: cos, sin and width, (H, W) each.
        allowed: (H, W) where centres may lie.
        taken: (H, W) in and out: pixels of earlier plateaus; those of this one are added.
        y: Row of the seed.
        x: Column of the seed.
        seed: Least quality, cos, sin, width; the difference of width, and the squared cosine of
            twice the difference of angle, up to which a pixel still shows the same grasp.
        pixels: (H W, 2) out: (x, y) of the plateau's pixels in its first rows.

    Returns:
        Number P of pixels; 0 when the seed itself does not belong.
    """
    rows, columns = quality.shape
    if taken[y, x] or not allowed[y, x] or not belongs(quality, others, y, x, seed):
        return 0
    taken[y, x] = True
    pixels[0, 0], pixels[0, 1] = x, y
    count, done = 1, 0
    while done < count:
        column, row = pixels[done]
        done += 1
        for r in range(max(row - 1, 0), min(row + 2, rows)):
            for c in range(max(column - 1, 0), min(column + 2, columns)):
                if taken[r, c] or not allowed[r, c]:
                    continue
                if belongs(quality, others, r, c, seed):
                    taken[r, c] = True
                    pixels[count, 0], pixels[count, 1] = c, r
                    count += 1
    return count


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def box_middle(pixels: NDArray[np.int32], shape: tuple[int, int], c: float, s: float) -> Any:
    """Middle of the box around a plateau in the grasp's frame, and how full the box is.

    The middle of a drawn region's box is right to half a pixel, whereas the mean of its pixels is
    not: a slightly tilted narrow strip has more pixels in a row at one end than at the other.

    Args:
        pixels: (P, 2) as (x, y).
        shape: (H, W).
        c: cos a of the grasp's angle.
        s: sin a of the grasp's angle.

    Returns:
        x, y, and the plateau's part of the pixels in the box; 0 when the plateau goes from border
        to border both ways, because then nothing bounds it.
    """
    low_u = low_v = left = top = np.inf
    high_u = high_v = right = bottom = -np.inf
    for i in range(len(pixels)):
        x, y = float(pixels[i, 0]), float(pixels[i, 1])
        u, v = c * x - s * y, s * x + c * y
        low_u, high_u = min(low_u, u), max(high_u, u)
        low_v, high_v = min(low_v, v), max(high_v, v)
        left, right = min(left, x), max(right, x)
        top, bottom = min(top, y), max(bottom, y)
    u, v = (low_u + high_u) / 2, (low_v + high_v) / 2
    x, y = c * u + s * v, c * v - s * u
    if right - left >= shape[1] - 1 and bottom - top >= shape[0] - 1 and len(pixels) > 1:
        return x, y, 0.0
    inside = 0
    for row in range(int(top), int(bottom) + 1):
        for column in range(int(left), int(right) + 1):
            du, dv = c * column - s * row - low_u, s * column + c * row - low_v
            # The extreme pixels lie on the border of the box: rounding must not drop them.
            if -1e-6 <= du <= high_u - low_u + 1e-6 and -1e-6 <= dv <= high_v - low_v + 1e-6:
                inside += 1
    return x, y, len(pixels) / inside


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def mean_pixel(pixels: NDArray[np.int32], allowed: Bools) -> Any:
    """Mean x, y of (P, 2) pixels, or the pixel nearest it where the mean lies beside them."""
    x = y = 0.0
    for i in range(len(pixels)):
        x += pixels[i, 0]
        y += pixels[i, 1]
    x, y = x / len(pixels), y / len(pixels)
    best, least = 0, np.inf
    for i in range(len(pixels)):
        d = (pixels[i, 0] - x) ** 2 + (pixels[i, 1] - y) ** 2
        if d < least:
            best, least = i, d
    if least > 1.0 or not allowed[math.floor(y + 0.5), math.floor(x + 0.5)]:
        return float(pixels[best, 0]), float(pixels[best, 1])
    return x, y


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def gaussian_sums(quality: Singles, pixels: NDArray[np.int32], frame: Any) -> Any:
    """Normal equations of the fit log q = p0 + p1 s + p2 s^2 + p3 t + p4 t^2.

    Args:
        quality: (H, W), positive at the pixels.
        pixels: (P, 2) as (x, y).
        frame: Origin x, origin y, cos a, sin a, unit of length in pixels: s runs along the
            opening, t along the jaw.

    Returns:
        (6, 6) sums of products of (1, s, s^2, t, t^2, log q).
    """
    x, y, c, s, unit = frame
    sums = np.zeros((6, 6))
    row = np.empty(6)
    for i in range(len(pixels)):
        dx, dy = (pixels[i, 0] - x) / unit, (pixels[i, 1] - y) / unit
        u, v = c * dx - s * dy, s * dx + c * dy
        row[0], row[1], row[2], row[3], row[4] = 1.0, u, u * u, v, v * v
        row[5] = math.log(np.float64(quality[pixels[i, 1], pixels[i, 0]]))
        for j in range(6):
            for k in range(j, 6):
                sums[j, k] += row[j] * row[k]
    for j in range(6):
        for k in range(j):
            sums[j, k] = sums[k, j]
    return sums


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def is_flat(quality: Singles, pixels: NDArray[np.int32]) -> bool:
    """Whether the quality at the (P, 2) pixels is the same to a ten-thousandth."""
    low, high = np.inf, -np.inf
    for i in range(len(pixels)):
        q = float(quality[pixels[i, 1], pixels[i, 0]])
        low, high = min(low, q), max(high, q)
    return high - low <= 1e-4 * high
