"""Sweeps: a section led along a path (handles, wires, links).

Letters in shapes: M points of the path, K corners of the section.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from graspmap.simulation.procedural.convex import heights, planes
from graspmap.simulation.procedural.solid import (
    MOST_VERTICES,
    TOLERANCE_M,
    Floats,
    Solid,
    snap,
)

_THIN = 0.15  # of its thickness, the most that a thin sweep's hulls may stand off it


def sweep(
    path: ArrayLike,
    section: ArrayLike,
    normal: ArrayLike,
    *,
    factors: Sequence[float] | None = None,
    closed: bool = False,
) -> Solid:
    """The body that a convex section fills on its way.

    Args:
        path: (M, 3) points in a plane; bends must be gentle against the section.
        section: (K, 2) corners, counter-clockwise: (across the path in its plane, along the
            normal).
        normal: (3,) unit normal of the path's plane.
        factors: Size of the section at each point; 1 where None.
        closed: The last point is joined to the first.
    """
    points, shape, up = (np.asarray(a, dtype=np.float64) for a in (path, section, normal))
    sizes = np.ones(len(points)) if factors is None else np.asarray(factors, dtype=np.float64)
    ahead = np.roll(points, -1, axis=0) - points
    behind = points - np.roll(points, 1, axis=0)
    if not closed:
        ahead[-1], behind[0] = behind[-1], ahead[0]
    along = _unit(ahead) + _unit(behind)
    across = _unit(np.cross(up, along))
    rings = snap(
        points[:, None]
        + sizes[:, None, None] * (shape[None, :, :1] * across[:, None] + shape[None, :, 1:] * up)
    )
    faces = _faces(len(points), len(shape), closed=closed)
    off = min(TOLERANCE_M, _THIN * float(np.ptp(shape, axis=0).min() * sizes.min()))
    pieces = _pieces(rings, off, closed=closed)
    return Solid(rings.reshape(-1, 3), faces, tuple(pieces))


def oval(a: float, b: float, count: int = 12) -> Floats:
    """(count, 2) corners of an ellipse with half axes a and b."""
    turns = [2 * math.pi * (i + 0.5) / count for i in range(count)]
    return np.array([(a * math.cos(t), b * math.sin(t)) for t in turns])


def flat_bar(a: float, b: float, bevel: float = 0.3) -> Floats:
    """(8, 2) corners of a rectangle a x b with its corners cut by a share of its shorter side."""
    x, y, cut = a / 2, b / 2, bevel * min(a, b)
    quarter = [(x, y - cut), (x - cut, y)]
    return np.array(
        quarter
        + [(-u, v) for u, v in quarter[::-1]]
        + [(-u, -v) for u, v in quarter]
        + [(u, -v) for u, v in quarter[::-1]]
    )


def bend(
    center: ArrayLike,
    first: ArrayLike,
    second: ArrayLike,
    start_deg: float,
    stop_deg: float,
    steps: int,
) -> Floats:
    """(steps + 1, 3) points center + cos(t) first + sin(t) second."""
    c, u, v = (np.asarray(a, dtype=np.float64) for a in (center, first, second))
    turns = [math.radians(start_deg + (stop_deg - start_deg) * i / steps) for i in range(steps + 1)]
    return np.array([c + math.cos(t) * u + math.sin(t) * v for t in turns])


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.sqrt((vectors**2).sum(axis=-1, keepdims=True)))


def _faces(rings: int, corners: int, *, closed: bool) -> np.ndarray:
    index = np.arange(rings * corners).reshape(rings, corners)
    low = index if closed else index[:-1]
    high = np.roll(index, -1, axis=0) if closed else index[1:]
    low_next, high_next = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    faces = [
        np.stack([low, low_next, high_next], axis=-1).reshape(-1, 3),
        np.stack([low, high_next, high], axis=-1).reshape(-1, 3),
    ]
    if not closed:
        fan = [(0, i, i + 1) for i in range(1, corners - 1)]
        faces += [index[0][np.array(fan)][:, ::-1], index[-1][np.array(fan)]]
    return np.concatenate(faces).astype(np.int32)


def _pieces(rings: Floats, tolerance: float, *, closed: bool) -> list[Floats]:
    """Hulls of runs of rings, as long as no ring sinks below the hull by the tolerance."""
    if closed:
        rings = np.concatenate([rings, rings[:1]])
    most = max(2, MOST_VERTICES // rings.shape[1])
    pieces, first = [], 0
    while first < len(rings) - 1:
        last = first + 1
        while last + 1 < len(rings) and last + 2 - first <= most:
            if _sunk(rings[first : last + 2]) > tolerance:
                break
            last += 1
        pieces.append(rings[first : last + 1].reshape(-1, 3))
        first = last
    return pieces


def _sunk(rings: Floats) -> float:
    """How deep the surface between the first and the last ring lies inside the hull of all."""
    inner = rings[1:-1]
    # On a hollow side the corners may lie on flat ends of the hull; the middles of edges do not.
    points = np.concatenate([inner, (inner + np.roll(inner, 1, axis=1)) / 2]).reshape(-1, 3)
    below = -heights(points, planes(rings.reshape(-1, 3)))
    return float(below.min(axis=1).max())
