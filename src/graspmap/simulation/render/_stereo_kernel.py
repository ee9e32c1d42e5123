"""Compiled depth camera: what a pair of cameras makes of exact depths.

Letters in shapes: (H, W) picture, (H, C) the second camera's picture, which is wider.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled
from graspmap.simulation.render._film_kernel import bell
from graspmap.simulation.render._noise_kernel import chance, flat_noise

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_BOW = 2.2  # how the pull of whole pixels falls with the distance; fitted to Jacquard's
_JUMP = 1.0  # of disparity between neighbours, from which on it is an edge
_NEARER_M = 0.002  # what is in the way is at least so much nearer
_RARE = 16.0  # times a share of holes: share of the places that are looked at closely
_BLOB_PX = 3.0  # size of holes
_WAVER_PX = 8.0  # size of the waves of edges
_EVEN = 4.662  # makes the variance of the patchy noise 1


@compiled
def mark_hidden(
    depth: Singles, second: Floats, window: Any, shift: float, out: NDArray[np.bool_]
) -> None:
    """Which points the second camera does not see.

    Args:
        depth: (H, W) metres; NaN is not hidden.
        second: (h, w) depths that the second camera sees in a window of its picture.
        window: (top, bottom, left, right) of the window; columns count from the left edge of the
            first camera's picture.
        shift: Focal length times baseline, pixels times metres.
        out: (H, W) out.
    """
    top, bottom, left, right = window
    rows, columns = depth.shape
    for row in range(rows):
        for column in range(columns):
            out[row, column] = False
            z = depth[row, column]
            if not (top <= row < bottom and z > 0.0):
                continue
            place = column - shift / z - left
            if not (0.0 <= place < right - left - 1.0):
                continue
            beside = int(place)
            limit = z - _NEARER_M
            # A steep surface is nearer on one side of the point only.
            a, b = second[row - top, beside], second[row - top, beside + 1]
            out[row, column] = a < limit and b < limit


@compiled
def _spread(row: int, column: int, y: float, x: float, reach: int, out: Floats) -> None:
    """Note around a pixel that an edge lies at (x, y), as squared distance."""
    rows, columns = out.shape
    for a in range(max(row - reach, 0), min(row + reach + 2, rows)):
        for b in range(max(column - reach, 0), min(column + reach + 2, columns)):
            away = (a - y) * (a - y) + (b - x) * (b - x)
            out[a, b] = min(out[a, b], away)


@compiled
def edge_distance(disparity: Floats, reach: int, out: Floats) -> None:
    """(H, W) distance in pixels to the nearest jump of disparity, up to ``reach``; else infinity.

    The jump lies half a pixel from the pixels on its two sides.
    """
    rows, columns = disparity.shape
    for row in range(rows):
        for column in range(columns):
            out[row, column] = np.inf
    for row in range(rows):
        for column in range(columns):
            here = disparity[row, column]
            if column + 1 < columns and abs(here - disparity[row, column + 1]) > _JUMP:
                _spread(row, column, row, column + 0.5, reach, out)
            if row + 1 < rows and abs(here - disparity[row + 1, column]) > _JUMP:
                _spread(row, column, row + 0.5, column, reach, out)
    for row in range(rows):
        for column in range(columns):
            out[row, column] = math.sqrt(out[row, column])


@compiled
def _waved(x: float, y: float, seed: int) -> float:
    """Smooth noise of mean 0 and, about, variance 1; bumps have size 1."""
    return (flat_noise(x, y, seed) - 0.5) * _EVEN


@compiled
def _blob(x: float, y: float, seed: int) -> float:
    """A number in [0, 1), the same all over a small ragged blob."""
    x += 0.8 * flat_noise(1.7 * x, 1.7 * y, seed)
    y += 0.8 * flat_noise(1.7 * x, 1.7 * y, seed + 5)
    return chance(math.floor(x), math.floor(y), 3, seed)


@compiled
def _is_hole(x: float, y: float, loss: float, seed: int) -> bool:
    """Whether a point lies in a hole, where a share ``loss`` of such points does."""
    # Where holes are rare, most places are ruled out by one quick number.
    gate = min(_RARE * loss, 1.0)
    if gate < 1.0 and chance(math.floor(x / 3.0), math.floor(y / 3.0), 5, seed) >= gate:
        return False
    return _blob(x, y, seed) * gate < loss


@compiled
def _at_edge(
    disparity: Floats, row: int, column: int, scale: float, waver: float, fat: float, seed: int
) -> float:
    """Disparity that a matching window near an edge takes for a pixel's own."""
    rows, columns = disparity.shape
    x, y = column / (scale * _WAVER_PX), row / (scale * _WAVER_PX)
    dx, dy = waver * _waved(x, y, seed + 20), waver * _waved(x, y, seed + 40)
    best = -np.inf
    for k in range(5):
        a = row + dy + fat * ((k == 1) - (k == 2))
        b = column + dx + fat * ((k == 3) - (k == 4))
        i = min(max(math.floor(a + 0.5), 0), rows - 1)
        j = min(max(math.floor(b + 0.5), 0), columns - 1)
        # The nearer surface wins, as it has the stronger texture.
        if disparity[i, j] > best:
            best = disparity[i, j]
    return best if best > 0.0 else disparity[row, column]


@compiled
def match(
    disparity: Floats,
    edge: Floats,
    hidden: NDArray[np.bool_],
    scale: float,
    numbers: Floats,
    seed: int,
    out: Floats,
) -> None:
    """Disparities as the pair of cameras finds them.

    Args:
        disparity: (H, W) true, in pixels of a picture 1024 wide; NaN where there is none.
        edge: (H, W) distance to the nearest edge, pixels.
        hidden: (H, W) what the second camera does not see.
        scale: Pixels of this picture in one of a picture 1024 wide.
        numbers: Of the sensor: steps of a pixel, locking, noise, its correlation, fine noise,
            waver, fattening, share of holes in the shadow, dropout, speckle.
        seed: Of everything random.
        out: (H, W) out; NaN in holes.
    """
    steps, locking, noise, patch, fine = numbers[0], numbers[1], numbers[2], numbers[3], numbers[4]
    waver, fat, shadow, dropout = numbers[5], numbers[6], numbers[7], numbers[8]
    speckle = numbers[9]
    rows, columns = disparity.shape
    for row in range(rows):
        for column in range(columns):
            true = disparity[row, column]
            out[row, column] = np.nan
            if not true > 0.0:
                continue
            near = edge[row, column] < np.inf
            loss = speckle
            if near:
                away = edge[row, column] / (1.6 * scale)
                loss += dropout / (1.0 + away * away)
            if hidden[row, column]:
                loss = max(loss, shadow)
            x, y = column / scale, row / scale
            if loss > 0.0 and _is_hole(x / _BLOB_PX, y / _BLOB_PX, loss, seed + 60):
                continue
            found = true
            if near and (waver > 0.0 or fat > 0.0):
                found = _at_edge(disparity, row, column, scale, waver * scale, fat * scale, seed)
            if noise > 0.0:
                found += noise * _waved(x / patch, y / patch, seed)
            whole = math.floor(found + 0.5)
            left = found - whole
            found = whole + left * (1.0 - locking * (1.0 - _BOW * left * left))
            if fine > 0.0:
                found += fine * bell(column, row, 7, seed)
            out[row, column] = math.floor(found * steps + 0.5) / steps
