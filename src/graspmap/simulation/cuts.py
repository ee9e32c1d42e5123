"""Nearly convex pieces of any closed surface, by cutting it with planes.

A part whose hull stands too far off its surface is cut in two; of a fixed set of planes the one
after which the hulls are smallest. Pieces that are as good together are joined again. In seconds,
with the same bits on every machine however busy, which a search with a time limit cannot promise.

All lengths are in parts of the object's longest side. Letters in shapes: V vertices, F triangles,
N points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from manifold3d import Error, Manifold, Mesh64, OpType
from scipy.spatial import cKDTree

from graspmap.errors import InvalidInputError
from graspmap.simulation.hulls import (
    COMPASS,
    Faces,
    Floats,
    along,
    arrays,
    hull,
    hull_volume,
)

_DIRECTIONS = np.array([d for d in COMPASS if tuple(d) > (0, 0, 0)])
_DIRECTIONS /= np.sqrt((_DIRECTIONS**2).sum(axis=1))[:, None]
_SHARES = (0.15, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85)  # places of the cuts that are tried
_FINALISTS = 4  # cuts that are really made, to choose among them
_COMPACT = 0.15  # see `_size`
_RIM = 0.02  # of the extent of a part: cuts nearer to its end are not tried
_GRID = 2.0**-26  # of coordinates: differences are then exact
_CRUMB = 1e-6  # parts with a smaller volume, of the cube of the longest side, are left out
_SIMPLER, _SIMPLEST = 0.1, 0.4  # of the tolerance: what the surface may move before it is cut
_MOST_FACES = 20_000  # above this it may move more
_SPACING = 0.75  # of the tolerance: distance of the samples on surfaces
_BIASED = 0.45  # of the spacing: what samples add to a distance of 0


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of the body.

    Args:
        body: Its surface.
        samples: (N, 3) points on it.
        depth: How far its hull stands off it.
        deepest: (3,) the point of it below the place where that is so.
        volume: Of its hull.
    """

    body: Manifold
    samples: Floats
    depth: float
    deepest: Floats
    volume: float


def cut_pieces(vertices: Floats, faces: Faces, tolerance: float, most: int) -> list[Floats]:
    """Vertices of nearly convex pieces.

    Args:
        vertices: (V, 3) of a closed surface whose longest side is about 1.
        faces: (F, 3) counter-clockwise seen from outside.
        tolerance: How far the hulls may stand off the surface.
        most: Number of parts after which no more cuts are made.

    Raises:
        InvalidInputError: It is no closed surface that could bound a body.
    """
    # Hollows without a way out are filled, bodies that run into each other are united.
    shells = manifold(vertices, faces).decompose()
    body = Manifold.batch_boolean([s for s in shells if s.volume() > 0], OpType.Add)
    body = _simpler(body, _SIMPLER * tolerance)
    if body.num_tri() > _MOST_FACES:
        body = _simpler(body, _SIMPLEST * tolerance)
    waiting = [_part(part, tolerance) for part in _parts(body)]
    done: list[_Part] = []
    while waiting:
        # The part with the deepest hollow first, so that `most` stops where it harms least.
        part = waiting.pop(max(range(len(waiting)), key=lambda i: waiting[i].depth))
        sides = _cut(part) if len(waiting) + len(done) + 1 < most else []
        if part.depth <= tolerance or not sides:
            done.append(part)
        else:
            waiting += [_part(side, tolerance) for side in sides]
    return _joined(done, tolerance)


def manifold(vertices: Floats, faces: Faces) -> Manifold:
    """A closed surface for manifold3d; vertices at one place are one.

    Raises:
        InvalidInputError: It is no closed surface that could bound a body.
    """
    points = np.round(vertices / _GRID) * _GRID
    unique, place = np.unique(points, axis=0, return_inverse=True)
    corners = place.reshape(-1)[faces]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    mesh: Any = Mesh64(unique, corners.astype(np.uint64))
    body = Manifold(mesh)
    if body.status() != Error.NoError or body.volume() <= 0:
        found = body.status().name if body.status() != Error.NoError else "no volume"
        raise InvalidInputError("surface", found, "a closed surface round a body")
    return body


def _simpler(body: Manifold, tolerance: float) -> Manifold:
    """The body with fewer faces; as it is where that would take a part of it away."""
    fewer = body.simplify(tolerance)
    loss = abs(fewer.volume() - body.volume())
    # Moving all of the surface by the tolerance changes the volume by this much.
    return fewer if loss <= tolerance * body.surface_area() else body


def _parts(body: Manifold) -> list[Manifold]:
    return [part for part in body.decompose() if part.volume() > _CRUMB]


def _part(body: Manifold, tolerance: float) -> _Part:
    spacing = _SPACING * tolerance
    samples = arrays(body.refine_to_length(spacing))[0]
    around = Manifold.hull_points(arrays(body)[0])
    outside = arrays(around.refine_to_length(spacing))[0]
    depth, deepest = _farthest(outside, (cKDTree(samples),))
    return _Part(body, samples, depth - _BIASED * spacing, deepest, around.volume())


def _cut(part: _Part) -> list[Manifold]:
    """The parts on both sides of the best plane; none where every plane misses."""
    vertices, faces = arrays(part.body)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = edges[edges[:, 0] < edges[:, 1]]
    planes: list[tuple[float, Floats, float]] = []
    for normal in _DIRECTIONS:
        places = along(vertices, normal)
        low, high = float(places.min()), float(places.max())
        offsets = [low + share * (high - low) for share in _SHARES]
        through = float(along(part.deepest[None], normal)[0])
        if low + _RIM * (high - low) < through < high - _RIM * (high - low):
            offsets.append(through)
        planes += [(_cost(vertices, edges, places - at), normal, at) for at in offsets]
    planes.sort(key=lambda plane: plane[0])
    best: list[Manifold] = []
    least = np.inf
    for _, normal, at in planes[:_FINALISTS]:
        sides = part.body.split_by_plane(tuple(normal.tolist()), at)
        parts = [p for side in sides for p in _parts(side)]
        total = sum(_size(arrays(p)[0]) for p in parts)
        if len(parts) > 1 and total < least:
            best, least = parts, total
    return best


def _cost(vertices: Floats, edges: Faces, above: Floats) -> float:
    """Size of the hulls of both sides of the plane that vertices lie ``above``."""
    a, b = edges[:, 0], edges[:, 1]
    crossing = above[a] * above[b] < 0
    a, b = a[crossing], b[crossing]
    share = above[a] / (above[a] - above[b])
    section = vertices[a] + share[:, None] * (vertices[b] - vertices[a])
    return sum(_size(np.concatenate([vertices[side], section])) for side in (above < 0, above > 0))


def _size(points: Floats) -> float:
    """Volume of a hull times the diagonal of its box.

    The volume alone would slice a ring into ever thinner rings: that costs the sum of the volumes
    nothing.
    """
    diagonal = float(np.sqrt((np.ptp(points, axis=0) ** 2).sum())) if len(points) else 0.0
    return hull_volume(points) * float(diagonal**_COMPACT)


@dataclass(frozen=True, eq=False)
class _Piece:
    """A part, or several that fit a common hull.

    Args:
        samples: On the surfaces of its parts, for finding the nearest.
        corners: (V, 3) corners of the hull.
        volume: Of the hull.
    """

    samples: tuple[cKDTree, ...]
    corners: Floats
    volume: float


def _joined(parts: list[_Part], tolerance: float) -> list[Floats]:
    """Hull vertices of the parts, after those that fit a common hull have been put together."""
    pieces = {
        i: _Piece((cKDTree(part.samples),), hull(arrays(part.body)[0])[0], part.volume)
        for i, part in enumerate(parts)
    }
    gaps: dict[tuple[int, int], float] = {}
    number = len(parts)
    while True:
        for i, j in combinations(sorted(pieces), 2):
            if (i, j) not in gaps:
                gaps[i, j] = _gap(pieces[i], pieces[j], tolerance)
        gap, (i, j) = min(((g, pair) for pair, g in gaps.items()), default=(np.inf, (0, 0)))
        if gap > tolerance:
            return [piece.corners for piece in pieces.values()]
        pieces[number] = _together(pieces.pop(i), pieces.pop(j))
        gaps = {pair: g for pair, g in gaps.items() if not {i, j} & set(pair)}
        number += 1


def _together(a: _Piece, b: _Piece) -> _Piece:
    around = Manifold.hull_points(np.concatenate([a.corners, b.corners]))
    return _Piece((*a.samples, *b.samples), arrays(around)[0], around.volume())


def _gap(a: _Piece, b: _Piece, tolerance: float) -> float:
    """How far the common hull of two pieces stands off them; infinity where that is too far."""
    low = np.maximum(a.corners.min(axis=0), b.corners.min(axis=0))
    high = np.minimum(a.corners.max(axis=0), b.corners.max(axis=0))
    if (low > high + 4 * _GRID).any():  # they do not touch
        return np.inf
    around = Manifold.hull_points(np.concatenate([a.corners, b.corners]))
    # Cheap looks first: what stands off by little has little more volume, and not only in places.
    if around.volume() - a.volume - b.volume > 2 * tolerance * around.surface_area():
        return np.inf
    samples = (*a.samples, *b.samples)
    spacing = _SPACING * tolerance
    corners, faces = arrays(around)
    if _farthest(corners[faces].mean(axis=1), samples)[0] - _BIASED * spacing > tolerance:
        return np.inf
    return _farthest(arrays(around.refine_to_length(spacing))[0], samples)[0] - _BIASED * spacing


def _farthest(points: Floats, samples: tuple[cKDTree, ...]) -> tuple[float, Floats]:
    """Greatest distance of points to the nearest samples, and the sample there."""
    distances, nearest = zip(*(tree.query(points) for tree in samples), strict=True)
    distance = np.min(distances, axis=0)
    worst = int(np.argmax(distance))
    tree = int(np.argmin([d[worst] for d in distances]))
    return float(distance[worst]), np.asarray(samples[tree].data[nearest[tree][worst]])
