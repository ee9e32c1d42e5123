"""Solid: a closed surface with the convex pieces that fill it, and how solids are joined.

Metres, any right-handed frame, z up where the object has an up. Coordinates lie on a grid of
15 nanometres, so that the last bits of a sine, which differ from processor to processor, do not
reach the object. Letters in shapes: V vertices, F triangles, P vertices of one convex piece.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold, Mesh64, OpType
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

GRID_M = 2.0**-26
"""Side of the grid: 15 nm. Cross products of points below a metre are then exact in doubles."""

TOLERANCE_M = 0.0005
"""How far the hulls of the pieces may stand off the surface."""

TOLERANCE = 0.02
"""The same over the radius, for what is slimmer than 5 cm."""

MOST_VERTICES = 128
"""Of one hull."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A body without inner faces.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) vertex numbers, counter-clockwise seen from outside; closed.
        pieces: (P, 3) vertices of convex pieces whose hulls fill the body, to `TOLERANCE_M`.
    """

    vertices: Floats
    faces: Faces
    pieces: tuple[Floats, ...]

    @property
    def extents(self) -> Floats:
        """(3,) sides of the box along the axes."""
        return np.asarray(np.ptp(self.vertices, axis=0))

    def transformed(self, matrix: ArrayLike, shift: ArrayLike = (0, 0, 0)) -> Solid:
        """The solid under p -> matrix p + shift; a mirror image keeps its faces outwards."""
        m = np.asarray(matrix, dtype=np.float64)
        faces = self.faces if _determinant(m) > 0 else self.faces[:, ::-1]
        moved = tuple(affine(p, m, shift) for p in (self.vertices, *self.pieces))
        return Solid(moved[0], faces, moved[1:])

    def moved(self, x: float = 0, y: float = 0, z: float = 0) -> Solid:
        """Shifted."""
        return self.transformed(np.eye(3), (x, y, z))

    def stretched(self, x: float = 1, y: float = 1, z: float = 1) -> Solid:
        """Each axis multiplied by its factor."""
        return self.transformed(np.diag([x, y, z]))

    def turned(self, axis: str, angle_rad: float) -> Solid:
        """Turned about an axis of the frame, counter-clockwise seen against it."""
        return self.transformed(rotation(axis, angle_rad))


def snap(points: ArrayLike) -> Floats:
    """The points, each coordinate moved to the nearest on the grid."""
    return np.asarray(np.rint(np.asarray(points, dtype=np.float64) / GRID_M) * GRID_M)


def affine(points: Floats, matrix: ArrayLike, shift: ArrayLike) -> Floats:
    """(..., 3) points under p -> matrix p + shift, on the grid; without BLAS, whose bits vary."""
    m, s = np.asarray(matrix, dtype=np.float64), np.asarray(shift, dtype=np.float64)
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return snap(np.stack([m[i, 0] * x + m[i, 1] * y + m[i, 2] * z + s[i] for i in range(3)], -1))


def rotation(axis: str, angle_rad: float) -> Floats:
    """(3, 3) turn about "x", "y" or "z"."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    matrix = np.eye(3)
    matrix[j, j] = matrix[k, k] = c
    matrix[k, j], matrix[j, k] = s, -s
    return matrix


def hull(points: ArrayLike) -> tuple[Floats, Faces]:
    """Vertices (V, 3) and faces (F, 3) of the convex hull of points (N, 3)."""
    return arrays(Manifold.hull_points(snap(points)))


def thickness(points: Floats) -> float:
    """How thick a piece (P, 3) is in its thinnest direction, about."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1]
    return float(spread) / math.sqrt(len(points))


def join(solids: Iterable[Solid]) -> Solid:
    """The union; its pieces are those of all."""
    parts = list(solids)
    if len(parts) == 1:
        return parts[0]
    united = Manifold.batch_boolean([manifold(p.vertices, p.faces) for p in parts], OpType.Add)
    # Not simplified: manifold3d 3.5 then now and then folds a large face over.
    vertices, faces = welded(*arrays(united))
    return Solid(vertices, faces, tuple(piece for p in parts for piece in p.pieces))


def volume(vertices: Floats, faces: Faces) -> float:
    """Volume in m^3 of a closed surface, negative where its faces look inwards."""
    a, b, c = vertices[faces].transpose(1, 2, 0)
    x = a[0] * (b[1] * c[2] - b[2] * c[1])
    y = a[1] * (b[2] * c[0] - b[0] * c[2])
    z = a[2] * (b[0] * c[1] - b[1] * c[0])
    return float((x + y + z).sum() / 6)


def manifold(vertices: Floats, faces: Faces) -> Manifold:
    """The same surface for manifold3d."""
    return Manifold(Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, np.uint64)))


def arrays(body: Manifold) -> tuple[Floats, Faces]:
    """Vertices (V, 3) on the grid and faces (F, 3) of manifold3d's body."""
    mesh = body.to_mesh64()
    return snap(mesh.vert_properties[:, :3]), np.asarray(mesh.tri_verts, dtype=np.int32)


def welded(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    """With vertices at the same place made one, and faces without three places left out."""
    places, number = np.unique(vertices, axis=0, return_inverse=True)
    corners = np.asarray(number.reshape(-1)[faces], dtype=np.int32)
    a, b, c = corners.T
    kept = corners[(a != b) & (b != c) & (c != a)]
    return places, kept


def _determinant(m: Floats) -> float:
    return float(np.dot(m[0], np.cross(m[1], m[2])))
