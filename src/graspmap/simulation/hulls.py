"""Convex hulls, and hulls of few vertices.

Letters in shapes: N points, V vertices, F triangles.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

COMPASS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)], dtype=np.float64)
"""(26, 3) directions to the faces, edges and corners of a cube, of length 1 to sqrt(3)."""


def arrays(body: Manifold) -> tuple[Floats, Faces]:
    """Vertices (V, 3) and faces (F, 3) of manifold3d's body."""
    mesh = body.to_mesh64()
    vertices = np.array(mesh.vert_properties[:, :3], dtype=np.float64, order="C")
    return vertices, np.array(mesh.tri_verts, dtype=np.int32, order="C")


def hull(points: Floats) -> tuple[Floats, Faces]:
    """Vertices (V, 3) and faces (F, 3) of the hull of points (N, 3); empty if they are flat."""
    return arrays(Manifold.hull_points(points))


def hull_volume(points: Floats) -> float:
    """Volume of the convex hull of points (N, 3); 0 if they are flat."""
    return float(Manifold.hull_points(points).volume()) if len(points) > 3 else 0.0


def fewer_vertices(points: Floats, most: int) -> tuple[Floats, float]:
    """Some of the vertices of a hull, chosen to lose little of it.

    Starts from the extremes in 26 directions and takes in, again and again, what lies farthest
    outside of the hull so far.

    Args:
        points: (N, 3).
        most: How many may stay, at least 26.

    Returns:
        (at most ``most``, 3) vertices in the order of their coordinates, and how far the farthest
        vertex left out lies outside the new hull.
    """
    vertices = hull(points)[0]
    if len(vertices) <= most:
        return vertices, 0.0
    chosen = np.unique([int(along(vertices, direction).argmax()) for direction in COMPASS])
    while True:
        above = heights(vertices, *hull(vertices[chosen]))
        worst = above.max(axis=0)
        if len(chosen) >= most:
            return vertices[chosen], float(worst.max())
        # The farthest vertex above each face, the worst faces first; not all at once, since
        # neighbouring faces are often mended by one vertex.
        count = min(most - len(chosen), max(1, len(chosen) // 4))
        order = np.argsort(-worst, kind="stable")[:count]
        chosen = np.union1d(chosen, above.argmax(axis=0)[order])


def along(points: Floats, direction: Floats) -> Floats:
    """(N,) scalar products of points (N, 3) with a direction (3,), the same bits everywhere."""
    x, y, z = points.T
    return np.asarray(x * direction[0] + y * direction[1] + z * direction[2])


def heights(points: Floats, corners: Floats, faces: Faces) -> Floats:
    """(N, F) how far each point (N, 3) lies above the plane of each face (F, 3) of a hull.

    Faces without area count as far above everything.
    """
    a, b, c = (corners[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    sizes = np.sqrt((normals**2).sum(axis=1))
    real = sizes > 1e-10 * max(float(sizes.max(initial=0.0)), 1e-300)
    normals = normals / np.where(real, sizes, 1.0)[:, None]
    x, y, z = points.T
    above = x[:, None] * normals[:, 0] + y[:, None] * normals[:, 1] + z[:, None] * normals[:, 2]
    return np.where(real, above - (normals * a).sum(axis=1), -np.inf)
