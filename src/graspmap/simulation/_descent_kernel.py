"""Compiled loops of `graspmap.simulation.descent`; imported at the first judgement, never before.

A cell counts where its middle lies, so a verdict depends on the cells and on nothing else: no
points are sampled. Lengths inside are in cells, heights in metres. Letters in shapes: N grasps,
R rows, C columns.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

TOLERANCE = 1e-7
"""In cells: a middle this near a border counts as lying on it, so that rounding decides nothing.
The border between the fingers' inner sides and what lies between them belongs to the latter; on
their other borders a middle is outside."""


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _cut(low: float, high: float, slope: float, offset: float, half: float) -> Any:
    """Cut [low, high] down to the x with |slope x + offset| <= half."""
    if abs(slope) < 1e-12:
        return (low, high) if abs(offset) <= half else (1.0, 0.0)
    first, second = (-half - offset) / slope, (half - offset) / slope
    return max(low, min(first, second)), min(high, max(first, second))


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _rows(y: float, c: float, s: float, half_u: float, half_v: float, rows: int) -> Any:
    """First row and one past the last row that a rectangle may cover."""
    reach = half_u * abs(s) + half_v * abs(c)
    first = math.ceil(min(max(y - reach, 0.0), float(rows)))
    return first, math.floor(max(min(y + reach, rows - 1.0), -1.0)) + 1


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _columns(
    x: float, dy: float, c: float, s: float, half_u: float, half_v: float, columns: int
) -> Any:
    """First column and one past the last column that a rectangle covers in a row."""
    low, high = _cut(-x, columns - 1.0 - x, c, s * dy, half_u)
    low, high = _cut(low, high, -s, c * dy, half_v)
    if low > high:
        return 0, 0
    return max(math.ceil(low + x), 0), min(math.floor(high + x) + 1, columns)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _highest(heights: Singles, pose: Any, half: float, finger: float, half_v: float) -> Any:
    """Greatest height between the fingers, under the left and under the right one."""
    x, y, c, s = pose
    rows, columns = heights.shape
    between = left = right = np.float32(0.0)
    half_u, inner = half + finger - TOLERANCE, half + TOLERANCE
    first, last = _rows(y, c, s, half_u, half_v, rows)
    for row in range(first, last):
        dy = row - y
        start, stop = _columns(x, dy, c, s, half_u, half_v, columns)
        u0 = s * dy - c * x
        for column in range(start, stop):
            h = heights[row, column]
            if h > 0.0:
                u = u0 + c * column
                if u < -inner:
                    left = max(left, h)
                elif u > inner:
                    right = max(right, h)
                else:
                    between = max(between, h)
    return float(between), float(left), float(right)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _reach(heights: Singles, pose: Any, half: float, half_v: float, tip: float) -> float:
    """Greatest distance, along the opening, of a cell above the tips from the centre; -1: none."""
    x, y, c, s = pose
    rows, columns = heights.shape
    farthest = -1.0
    half_u = half + TOLERANCE
    first, last = _rows(y, c, s, half_u, half_v, rows)
    for row in range(first, last):
        dy = row - y
        start, stop = _columns(x, dy, c, s, half_u, half_v, columns)
        u0 = s * dy - c * x
        for column in range(start, stop):
            if heights[row, column] > tip:
                farthest = max(farthest, abs(u0 + c * column))
    return farthest


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def judge(
    heights: Singles, top: float, grasps: Floats, resolution: float, gripper: Any, out: Floats
) -> None:
    """Lower the open gripper onto the map, once for each grasp.

    Args:
        heights: (R, C) metres.
        top: The greatest of them.
        grasps: (N, 5) centre as column and row of the map (fractions), angle (radians), opening and
            jaw (metres).
        resolution: Side of a cell, metres.
        gripper: Finger thickness and length, palm along and across the opening, greatest depth,
            clearance of the table, gap kept at a touch (metres), 1.0 if a touch stops the gripper.
        out: (N, 6) out: tip, highest point between the fingers, under the left finger, the right
            finger and the palm (only where something is as high as the fingers are long), and the
            least opening.
    """
    thickness, length, palm_u, palm_v, depth, clear, gap, stops = gripper
    for n in range(len(grasps)):
        x, y, angle, opening, jaw = grasps[n]
        pose = (x, y, math.cos(angle), math.sin(angle))
        half, half_v = opening / resolution / 2, jaw / resolution / 2 - TOLERANCE
        between, left, right = _highest(heights, pose, half, thickness / resolution, half_v)
        # The palm stays above what the hand is meant to hold.
        tip = max(clear, between - depth, between + gap - length)
        palm = 0.0
        if top > clear + length:
            over = palm_v / resolution / 2 - TOLERANCE
            palm = max(_highest(heights, pose, palm_u / resolution / 2, 0.0, over))
        if stops == 1.0:
            touched = max(left, right)
            if touched > tip:
                tip = touched + gap
            if palm > tip + length:
                tip = palm + gap - length
        reach = -1.0
        if between > tip:
            reach = _reach(heights, pose, half, half_v, tip)
        out[n, 0], out[n, 1] = tip, between
        out[n, 2], out[n, 3], out[n, 4] = left, right, palm
        # A cell is there over its whole side.
        out[n, 5] = min((2 * reach + 1) * resolution, opening) if reach >= 0 else 0.0
