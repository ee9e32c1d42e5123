"""Convex bodies: from any points, in hulls small enough for physics.

Letters in shapes: N points, P vertices of one hull.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull

from graspmap.simulation.procedural.solid import (
    MOST_VERTICES,
    TOLERANCE,
    TOLERANCE_M,
    Faces,
    Floats,
    Solid,
    hull,
)

_COMPASS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)], dtype=np.float64)


def convex(points: ArrayLike) -> Solid:
    """The hull of points (N, 3), as one piece or, where that takes more vertices, a few."""
    vertices, faces = hull(points)
    return Solid(vertices, faces, tuple(split(vertices)))


def split(points: ArrayLike) -> list[Floats]:
    """Cut the hull of points (N, 3) until each part has at most `MOST_VERTICES` vertices.

    Vertices are left out as long as the hull loses at most the tolerance by it.
    """
    vertices, faces = hull(points)
    slimmest = float(np.ptp(vertices, axis=0).min())
    return _split(vertices, faces, min(TOLERANCE_M, TOLERANCE * slimmest / 2))


def _split(vertices: Floats, faces: Faces, tolerance: float) -> list[Floats]:
    few = _thinned(vertices, tolerance)
    if few is not None:
        return [few]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    axis = int(np.argmax(high - low))
    middle = (low[axis] + high[axis]) / 2
    section = _section(vertices, faces, axis, middle)
    return [
        part
        for side in (vertices[:, axis] < middle, vertices[:, axis] > middle)
        for part in _split(*hull(np.concatenate([vertices[side], section])), tolerance)
    ]


def _thinned(vertices: Floats, tolerance: float) -> Floats | None:
    """Some of the vertices, with the same hull to the tolerance; None if that takes too many."""
    if len(vertices) <= MOST_VERTICES:
        return vertices
    chosen = np.unique((vertices @ _COMPASS.T).argmax(axis=0))
    while True:
        outside = heights(vertices, planes(vertices[chosen]))
        worst = outside.max(axis=0)
        if worst.max() <= tolerance:
            return np.asarray(vertices[chosen])
        room = MOST_VERTICES - len(chosen)
        if room == 0:
            return None
        # The farthest vertex above each face, the worst faces first.
        order = np.argsort(-worst, kind="stable")
        order = order[worst[order] > tolerance]
        _, first = np.unique(outside[:, order].argmax(axis=0), return_index=True)
        chosen = np.union1d(chosen, outside[:, order[np.sort(first)[:room]]].argmax(axis=0))


def planes(points: Floats) -> Floats:
    """(F, 4) outward unit normals and offsets of the faces of a hull: n p + d <= 0 inside."""
    return np.asarray(ConvexHull(points).equations)


def heights(points: Floats, faces: Floats) -> Floats:
    """(N, F) of each point (N, 3) above each plane (F, 4)."""
    x, y, z = points.T
    above = x[:, None] * faces[:, 0] + y[:, None] * faces[:, 1] + z[:, None] * faces[:, 2]
    return np.asarray(above + faces[:, 3])


def _section(vertices: Floats, faces: Faces, axis: int, at: float) -> Floats:
    """(N, 3) points at which the edges cross a plane across an axis."""
    start, end = vertices[faces], vertices[np.roll(faces, -1, axis=1)]
    a, b = start.reshape(-1, 3), end.reshape(-1, 3)
    crossing = (a[:, axis] <= at) & (b[:, axis] >= at) & (a[:, axis] < b[:, axis])
    a, b = a[crossing], b[crossing]
    share = (at - a[:, axis]) / (b[:, axis] - a[:, axis])
    points = a + share[:, None] * (b - a)
    points[:, axis] = at
    return points
