"""Depth of the table behind a picture, without camera or mask: what objects rise from.

Letters in shapes: H rows, W columns of the picture; N sampled pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError

Floats = NDArray[np.float64]

_SAMPLES_A_SIDE = 48
_ROUNDS = 8
_PLANES, _COMPARED = 60, 800
_DEVIATIONS = 2.5  # of the table's pixels; what lies nearer than so many is an object
_LEAST_M = 0.003  # objects less high than this cannot be told from the table
_BEYOND = 2.0  # what lies behind the table by so many times as much (an edge, a mirror) is none


def table_depth(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Depth of the plane that a picture shows most of, at every pixel.

    A plane is linear in the inverse depth, whatever the camera. Of many planes through three pixels
    each the one that most pixels lie near is fitted again and again to those that lie on it, until
    they stay the same; what stands in front of it is left out sooner than what lies behind. The
    table must fill about half of the picture.

    Where the camera is known and a pose is wanted, `graspmap.simulation` fits with more care.

    Args:
        depth_m: (H, W) metres, NaN in holes.

    Returns:
        (H, W) float32 metres, without holes. Where the fit would lie behind the camera in a part
        of the picture: the median depth everywhere.

    Raises:
        InvalidInputError: There is nothing but holes.
    """
    rows, columns = depth_m.shape
    step = max(1, min(rows, columns) // _SAMPLES_A_SIDE)
    part = depth_m[::step, ::step].astype(np.float64)
    y, x = np.nonzero(np.isfinite(part) & (part > 0))
    if not len(y):
        part, step = depth_m.astype(np.float64), 1
        y, x = np.nonzero(np.isfinite(part) & (part > 0))
    if not len(y):
        raise InvalidInputError("depth", "nothing but holes", "at least one measured pixel")
    seen = part[y, x]
    points = _unit(x * step, y * step, (rows, columns))
    plane = _fit(points, seen)
    columns_of, rows_of = np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64)
    a, b, c = plane
    scaled = _unit(columns_of, np.zeros(columns), (rows, columns))[:, 0] * a
    inverse = (
        scaled[None] + (_unit(np.zeros(rows), rows_of, (rows, columns))[:, 1] * b + c)[:, None]
    )
    # No table is ten times as far away on one side of a picture as in its middle.
    if not inverse.min() > 0.1 / float(np.median(seen)):
        return np.full((rows, columns), np.median(seen), dtype=np.float32)
    table: NDArray[np.float32] = (1.0 / inverse).astype(np.float32)
    return table


def _unit(x: NDArray[Any], y: NDArray[Any], shape: tuple[int, int]) -> Floats:
    """(N, 3) pixels about the picture's middle, in units of its longer side, and 1."""
    rows, columns = shape
    side = max(shape)
    return np.stack([(x - columns / 2) / side, (y - rows / 2) / side, np.ones_like(x)], axis=1)


def _fit(points: Floats, depth_m: Floats) -> Floats:
    """(3,) the plane p with 1 / depth = p . point, robustly."""
    inverse = 1.0 / depth_m
    plane = _first(points, depth_m)
    kept = np.ones(len(depth_m), dtype=bool)
    for _ in range(_ROUNDS):
        behind = _behind(points, depth_m, plane)
        middle = np.median(behind[kept])
        deviation = 1.4826 * float(np.median(np.abs(behind[kept] - middle)))
        most = max(_DEVIATIONS * deviation, _LEAST_M)
        chosen = (behind > -most) & (behind < _BEYOND * most)
        if not chosen.any() or np.array_equal(chosen, kept):
            break
        kept = chosen
        plane = _solve(points[kept], inverse[kept])
    return plane


def _first(points: Floats, depth_m: Floats) -> Floats:
    """(3,) of many planes through three pixels each, the one that most pixels lie near."""
    rng = np.random.default_rng(0)  # the same planes for the same number of pixels
    some = rng.permutation(len(points))[:_COMPARED]
    few, seen = points[some], depth_m[some]
    corners = rng.integers(len(points), size=(_PLANES, 3))
    planes = np.stack(
        [_solve(points, 1.0 / depth_m), *_solve(points[corners], 1.0 / depth_m[corners])]
    )
    there = few @ planes.T
    behind = seen[:, None] - 1.0 / np.where(there > 0, there, np.inf)
    off = np.minimum(np.abs(behind), 2 * _LEAST_M).sum(axis=0)
    return np.asarray(planes[int(np.argmin(off))])


def _behind(points: Floats, depth_m: Floats, plane: Floats) -> Floats:
    """(N,) how far the pixels lie behind the plane, metres."""
    there = points @ plane
    return np.asarray(depth_m - 1.0 / np.where(there > 0, there, np.inf))


def _solve(points: Floats, inverse: Floats) -> Floats:
    """(..., 3) least squares of (..., N, 3) points; as level as may be where they lie in a line."""
    turned = np.swapaxes(points, -1, -2)
    level = np.diag([1e-9, 1e-9, 0.0]) * points.shape[-2]
    found = np.linalg.solve(turned @ points + level, turned @ inverse[..., None])
    return np.asarray(found[..., 0])
