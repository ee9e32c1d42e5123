"""Nearly convex pieces of a blob, by cutting it with planes.

For bodies whose construction gives no pieces, and whose smooth, evenly meshed surface says at each
face how far the hull is: along its normal. Each cut is the one, out of a fixed set, after which the
hulls of both sides are smallest. `graspmap.simulation.cuts` does the same for any mesh, and takes
five times as long.

Letters in shapes: V vertices, F triangles, N points.
"""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from graspmap.simulation.procedural.convex import heights, planes, split
from graspmap.simulation.procedural.solid import Faces, Floats, arrays, manifold

Normal = tuple[float, float, float]

CUTS_VERSION = 1
"""Counts up whenever the same surface would give other pieces, be it for `convex` or `solid`: they
are kept on disk."""

_REFINED = 4  # directions whose halving does best; along these other places are tried too
_SHARES = (0.2, 0.35, 0.65, 0.8)
_DIAGONAL = 0.5**0.5
_DIRECTIONS = (
    (1.0, 0.0, 0.0),
    (0.0, 1.0, 0.0),
    (0.0, 0.0, 1.0),
    (_DIAGONAL, _DIAGONAL, 0.0),
    (_DIAGONAL, -_DIAGONAL, 0.0),
    (_DIAGONAL, 0.0, _DIAGONAL),
    (_DIAGONAL, 0.0, -_DIAGONAL),
    (0.0, _DIAGONAL, _DIAGONAL),
    (0.0, _DIAGONAL, -_DIAGONAL),
)
_GLANCING = 0.05  # slower than this, a normal runs along a face of the hull and not out of it
_LEAST_FACE_M2 = 1e-8  # smaller faces have no sure normal
_ENOUGH = 150  # points on one side of a cut that is only tried
_LEAST_SHARE = 1e-6  # of the whole volume; smaller crumbs are left out


def pieces_by_cuts(vertices: Floats, faces: Faces, tolerance_m: float, most: int) -> list[Floats]:
    """Vertices of nearly convex pieces.

    Args:
        vertices: (V, 3) of a closed surface, metres.
        faces: (F, 3) counter-clockwise seen from outside.
        tolerance_m: How far a vertex of the surface may lie inside its hull.
        most: Number of pieces after which no more cuts are made.
    """
    body = manifold(vertices, faces)
    crumb = _LEAST_SHARE * body.volume()
    waiting = [_part(body)]
    done: list[Manifold] = []
    while waiting:
        # The part with the deepest hollow is cut first, so that `most` stops at the least harm.
        depth, part = waiting.pop(max(range(len(waiting)), key=lambda i: waiting[i][0]))
        if depth <= tolerance_m or len(waiting) + len(done) + 1 >= most:
            done.append(part)
            continue
        normal, offset = _best_cut(*arrays(part))
        sides = part.split_by_plane(normal, offset)
        parts = [p for side in sides for p in side.decompose() if p.volume() > crumb]
        waiting += [_part(p) for p in parts]
    return [piece for part in done for piece in split(arrays(part)[0])]


def _part(body: Manifold) -> tuple[float, Manifold]:
    """How far its faces are, along their normals, from leaving the hull at most; and the body."""
    vertices, faces = arrays(body)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    sizes = np.sqrt((normals**2).sum(axis=1))
    sure = sizes > _LEAST_FACE_M2
    normals = normals[sure] / sizes[sure, None]
    sides = planes(vertices)
    gap = np.maximum(-heights((a + b + c)[sure] / 3, sides), 0)
    speed = heights(normals, sides) - sides[:, 3]
    way = np.where(speed > _GLANCING, gap / np.maximum(speed, _GLANCING), np.inf)
    return float(way.min(axis=1).max()), body


def _best_cut(vertices: Floats, faces: Faces) -> tuple[Normal, float]:
    """Normal and offset of the cut that leaves the smallest hulls."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] < edges[:, 1]]

    def tried(normal: Normal, share: float) -> tuple[float, Normal, float]:
        x, y, z = vertices.T
        along = x * normal[0] + y * normal[1] + z * normal[2]
        low, high = float(along.min()), float(along.max())
        offset = low + share * (high - low)
        section = _section(vertices, edges, along - offset)
        hulls = (
            Manifold.hull_points(np.concatenate([_some(vertices[side]), _some(section)]))
            for side in (along < offset, along > offset)
        )
        return sum(h.volume() for h in hulls), normal, offset

    halves = sorted(tried(normal, 0.5) for normal in _DIRECTIONS)
    others = [tried(normal, s) for _, normal, _ in halves[:_REFINED] for s in _SHARES]
    _, normal, offset = min(halves + others)
    return normal, offset


def _some(points: Floats) -> Floats:
    """Points evenly out of many: enough to compare hulls by."""
    return points[:: max(1, len(points) // _ENOUGH)]


def _section(vertices: Floats, edges: Faces, above: Floats) -> Floats:
    """(N, 3) points at which edges cross the plane that vertices lie ``above``."""
    a, b = edges[:, 0], edges[:, 1]
    crossing = above[a] * above[b] < 0
    a, b = a[crossing], b[crossing]
    share = above[a] / (above[a] - above[b])
    return np.asarray(vertices[a] + share[:, None] * (vertices[b] - vertices[a]))
