"""Convex bodies: from any points, in hulls small enough for physics.

Letters in shapes: N points, P vertices of one hull.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from graspmap.simulation.procedural.solid import (
    MOST_VERTICES,
    TOLERANCE_M,
    Faces,
    Floats,
    Solid,
    hull,
    snap,
)

_THINNEST_M = 1e-5  # of a face

_COMPASS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)], dtype=np.float64)


def convex(points: ArrayLike) -> Solid:
    """The hull of points (N, 3), as one piece or, where that takes more vertices, a few."""
    vertices, faces = hull(points)
    return Solid(vertices, faces, tuple(split(vertices)))


def split(points: ArrayLike) -> list[Floats]:
    """Cut the hull of points (N, 3) until each part has at most `MOST_VERTICES` vertices.

    Vertices are left out as long as the hull loses at most `TOLERANCE_M` by it.
    """
    vertices, faces = hull(points)
    few = _thinned(vertices)
    if few is not None:
        return [few]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    axis = int(np.argmax(high - low))
    middle = (low[axis] + high[axis]) / 2
    section = _section(vertices, faces, axis, middle)
    return [
        part
        for side in (vertices[:, axis] < middle, vertices[:, axis] > middle)
        for part in split(np.concatenate([vertices[side], section]))
    ]


def _thinned(vertices: Floats) -> Floats | None:
    """Some of the vertices, with the same hull to the tolerance; None if that takes too many."""
    if len(vertices) <= MOST_VERTICES:
        return vertices
    reach = vertices @ _COMPASS.T
    chosen = np.unique(reach.argmax(axis=0))
    while len(chosen) < MOST_VERTICES:
        corners, triangles = hull(vertices[chosen])
        outside = heights(vertices, corners, triangles)
        worst = outside.max(axis=0)
        if worst.max() <= TOLERANCE_M:
            return snap(vertices[chosen])
        # The farthest vertex above each face, the worst faces first.
        order = np.argsort(-worst, kind="stable")[: MOST_VERTICES - len(chosen)]
        farthest = outside.argmax(axis=0)[order[worst[order] > TOLERANCE_M]]
        chosen = np.union1d(chosen, farthest)
    corners, triangles = hull(vertices[chosen])
    outside = heights(vertices, corners, triangles)
    return snap(vertices[chosen]) if outside.max() <= TOLERANCE_M else None


def heights(points: Floats, corners: Floats, faces: Faces) -> Floats:
    """(N, F) of each point (N, 3) above the plane of each face (F, 3) of a hull.

    Faces too narrow to have a sure direction count as far above everything.
    """
    a, b, c = (corners[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    sizes = np.sqrt((normals**2).sum(axis=1))
    longest = np.sqrt(
        np.max([((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1), ((a - c) ** 2).sum(1)], 0)
    )
    clear = sizes > _THINNEST_M * longest
    normals = normals / np.where(clear, sizes, 1)[:, None]
    offsets = (normals * a).sum(axis=1)
    x, y, z = points.T
    above = x[:, None] * normals[:, 0] + y[:, None] * normals[:, 1] + z[:, None] * normals[:, 2]
    return np.where(clear, above - offsets, -np.inf)


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
