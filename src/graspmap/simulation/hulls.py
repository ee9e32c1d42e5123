"""Convex hulls, and hulls of few vertices.

Letters in shapes: N points, V vertices, F triangles.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

_SAME = 1e-9  # relative; sizes nearer to each other are equal

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


def box_sides(points: Floats) -> Floats:
    """(3,) sides, ascending, of the smallest box round points (N, 3) that has a face on their hull.

    Of boxes of the same volume the one with the smallest longest side. The smallest box of all
    need only have two edges on the hull; for bodies with many faces there is no difference.

    References:
        O'Rourke, "Finding minimal enclosing boxes", International Journal of Computer and
        Information Sciences 14, 1985.
    """
    vertices, faces = hull(points)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    areas = np.cross(b - a, c - a) / 2
    sizes = np.sqrt((areas**2).sum(axis=1))
    real = sizes > 1e-9 * sizes.max()
    normals = areas[real] / sizes[real][:, None]
    heights, bounds = np.empty(len(normals)), np.empty(len(normals))
    for i, normal in enumerate(normals):
        places = along(vertices, normal)
        heights[i] = places.max() - places.min()
        # The shadow of the hull along the normal is no larger than a rectangle round it.
        bounds[i] = heights[i] * np.abs(along(areas, normal)).sum() / 2
    best, least = np.zeros(3), np.inf
    for i in np.argsort(bounds, kind="stable"):
        if bounds[i] > least * (1 + _SAME):
            break
        sides = np.array([*_smallest_rectangle(vertices, normals[i]), heights[i]])
        size = float(sides.prod())
        shorter = size <= least * (1 + _SAME) and sides.max() < best.max()
        if size < least * (1 - _SAME) or shorter:
            best, least = sides, min(size, least)
    return np.sort(best)


def _smallest_rectangle(points: Floats, normal: Floats) -> tuple[float, float]:
    """Sides of the smallest rectangle round points (N, 3) seen along a normal."""
    helper = np.eye(3)[int(np.argmin(np.abs(normal)))]
    u = np.cross(normal, helper)
    u /= np.sqrt((u**2).sum())
    flat = np.column_stack([along(points, u), along(points, np.cross(normal, u))])
    corners = flat[ConvexHull(flat).vertices]
    edges = np.roll(corners, -1, axis=0) - corners
    edges /= np.sqrt((edges**2).sum(axis=1))[:, None]
    x, y = corners.T[:, :, None]
    forward = np.ptp(x * edges[:, 0] + y * edges[:, 1], axis=0)
    across = np.ptp(y * edges[:, 0] - x * edges[:, 1], axis=0)
    sizes = forward * across
    # The rectangles on the three sides of a triangle, for one, are all equally large.
    longest = np.where(sizes <= sizes.min() * (1 + _SAME), np.maximum(forward, across), np.inf)
    smallest = int(np.argmin(longest))
    return float(forward[smallest]), float(across[smallest])


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
