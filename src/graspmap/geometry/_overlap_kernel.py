"""Compiled area of the intersection of two rotated rectangles (imported at the first overlap).

One rectangle is made an axis-aligned box about the origin. With y restricted to the box, the area
of the other one inside it is the line integral of x, clamped to the box, along the other one's
outline (Green's theorem):

    area = | sum over its edges of  integral clamp(x, -w/2, w/2) dy,  -h/2 <= y <= h/2 |

Each edge has a closed form, so there is no polygon to build and no special case: parallel,
touching, thin and identical rectangles take the same path. Every term is at most the box's own
size, hence the rounding error stays relative to the area of the box; what remains is the rounding
of the corners, about 1e-16 of the rectangles' extent.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Products of sides beyond these are computed in other units, lest they under- or overflow.
_LEAST, _MOST = 1e-250, 1e250


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _edge(xs: float, ys: float, xe: float, ye: float, hx: float, hy: float) -> float:
    """Integral of clamp(x, -hx, hx) dy along the edge (xs, ys) to (xe, ye), |y| <= hy."""
    top = min(max(ys, -hy), hy)
    bottom = min(max(ye, -hy), hy)
    if top == bottom:
        return 0.0
    slope = (xe - xs) / (ye - ys)
    # From the nearer end, so that an end inside the box keeps its x to the last bit.
    a = xs + slope * (top - ys)
    b = xe + slope * (bottom - ye)
    low, high = min(a, b), max(a, b)
    if low >= -hx and high <= hx:
        mean = 0.5 * (low + high)
    elif high <= -hx:
        mean = -hx
    elif low >= hx:
        mean = hx
    else:
        left, right = max(low, -hx), min(high, hx)
        inside = 0.5 * (left + right) * (right - left)
        mean = (inside + hx * ((high - right) - (left - low))) / (high - low)
    return mean * (bottom - top)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _intersection(
    dx: float, dy: float, turn: float, box_angle: float, wa: float, ha: float, wb: float, hb: float
) -> float:
    """Area of b inside a; b's centre lies at (dx, dy) from a's, turned by ``turn`` against a."""
    c, s = math.cos(box_angle), math.sin(box_angle)
    # a's frame: u along its opening (c, -s), v across it (s, c).
    u, v = dx * c - dy * s, dx * s + dy * c
    c, s = math.cos(turn), math.sin(turn)
    ou, ov = 0.5 * wb * c, -0.5 * wb * s
    ju, jv = 0.5 * hb * s, 0.5 * hb * c
    hx, hy = 0.5 * wa, 0.5 * ha
    u0, v0 = u - ou - ju, v - ov - jv
    u1, v1 = u + ou - ju, v + ov - jv
    u2, v2 = u + ou + ju, v + ov + jv
    u3, v3 = u - ou + ju, v - ov + jv
    area = (
        _edge(u0, v0, u1, v1, hx, hy)
        + _edge(u1, v1, u2, v2, hx, hy)
        + _edge(u2, v2, u3, v3, hx, hy)
        + _edge(u3, v3, u0, v0, hx, hy)
    )
    bounded: float = min(max(area, 0.0), min(wa * ha, wb * hb))
    return bounded


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _pair(
    dx: float, dy: float, turn: float, angle: float, wa: float, ha: float, wb: float, hb: float
) -> tuple[float, float, float, float]:
    """Areas of the intersection, of a and of b, in units whose square is the fourth number."""
    unit = 1.0
    if min(wa, ha, wb, hb) <= 0.0:
        return 0.0, wa * ha, wb * hb, unit
    smallest, largest = min(wa * ha, wb * hb), max(wa * ha, wb * hb)
    if smallest < _LEAST or largest > _MOST:
        unit = max(max(wa, ha), max(wb, hb))
        dx, dy, wa, ha, wb, hb = (dx / unit, dy / unit, wa / unit, ha / unit, wb / unit, hb / unit)
    reach = math.sqrt(wa * wa + ha * ha) + math.sqrt(wb * wb + hb * hb)
    # The circles about both rectangles do not meet (with a margin for rounding).
    if 4.0 * (dx * dx + dy * dy) > 1.000001 * reach * reach:
        return 0.0, wa * ha, wb * hb, unit
    return _intersection(dx, dy, turn, angle, wa, ha, wb, hb), wa * ha, wb * hb, unit


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def fill_overlap(
    ca: Floats,
    ta: Floats,
    wa: Floats,
    ha: Floats,
    cb: Floats,
    tb: Floats,
    wb: Floats,
    hb: Floats,
    as_ratio: bool,
    out: Floats,
) -> None:
    """Fill ``out`` (N, M) with intersections over unions, or with areas of intersections.

    Args:
        ca: (N, 2) centres of a, pixels; then its angles (radians), widths and heights (N,).
        ta: See ``ca``.
        wa: See ``ca``.
        ha: See ``ca``.
        cb: (M, 2) centres of b; then its angles, widths and heights (M,).
        tb: See ``cb``.
        wb: See ``cb``.
        hb: See ``cb``.
        as_ratio: Intersection over union; otherwise the area of the intersection, square pixels.
        out: (N, M), written.
    """
    for i in range(len(ta)):
        for j in range(len(tb)):
            dx, dy = cb[j, 0] - ca[i, 0], cb[j, 1] - ca[i, 1]
            both, one, other, unit = _pair(dx, dy, tb[j] - ta[i], ta[i], wa[i], ha[i], wb[j], hb[j])
            if not as_ratio:
                out[i, j] = both * unit * unit
            elif both > 0.0:
                out[i, j] = both / (one + other - both)
            else:
                out[i, j] = 0.0


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def fill_best(
    ca: Floats,
    ta: Floats,
    wa: Floats,
    ha: Floats,
    cb: Floats,
    tb: Floats,
    wb: Floats,
    hb: Floats,
    max_turn: float,
    out: Floats,
) -> None:
    """Fill ``out`` (N,) with the greatest ratio over those of b turned by ``max_turn`` at most.

    Args:
        ca: As for `fill_overlap`, and so on to ``hb``; the angles in [-pi/2, pi/2).
        ta: See ``ca``.
        wa: See ``ca``.
        ha: See ``ca``.
        cb: See ``ca``.
        tb: See ``ca``.
        wb: See ``ca``.
        hb: See ``ca``.
        max_turn: Greatest angle between the two axes, radians; inclusive.
        out: (N,), written.
    """
    for i in range(len(ta)):
        best = 0.0
        for j in range(len(tb)):
            turn = tb[j] - ta[i]
            # The other way round the half circle may be shorter.
            if min(abs(turn), math.pi - abs(turn)) > max_turn:
                continue
            dx, dy = cb[j, 0] - ca[i, 0], cb[j, 1] - ca[i, 1]
            both, one, other, _ = _pair(dx, dy, turn, ta[i], wa[i], ha[i], wb[j], hb[j])
            if both > 0.0:
                best = max(best, both / (one + other - both))
        out[i] = best
