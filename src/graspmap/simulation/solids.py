"""From a closed surface to an ObjectModel: volume, centre of mass and inertia, exactly.

Letters in shapes: V vertices, F triangles, P vertices of one convex piece.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.simulation.objects import ObjectModel, Texture

Floats = NDArray[np.float64]
T = TypeVar("T", bound=np.generic)

_ID = re.compile(r"[A-Za-z0-9_.-]+")
_THINNEST_M = 1e-5  # a piece thinner than this has no hull that physics could use
# A volume below this part of (longest side)^3 is rounding, or a surface without an inside.
_FLATTEST = 1e-7


@dataclass(frozen=True, eq=False)
class MassProperties:
    """What a homogeneous solid of density 1 weighs and where.

    Args:
        volume_m3: Volume; negative where the faces look inwards.
        center_m: (3,) centre of mass.
        moments_m5: (3, 3) inertia about the centre of mass for density 1 kg/m^3.
    """

    volume_m3: float
    center_m: Floats
    moments_m5: Floats


def mass_properties(vertices: Floats, faces: NDArray[np.integer]) -> MassProperties:
    """Volume, centre of mass and inertia of the solid inside a closed surface.

    The integrals over the signed tetrahedra between a point and each face; exact for polyhedra.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3) vertex numbers, counter-clockwise seen from outside.

    References:
        Tonon, "Explicit exact formulas for the 3-D tetrahedron inertia tensor in terms of its
        vertex coordinates", Journal of Mathematics and Statistics 1(1), 2005.
    """
    # Seen from the middle of the box, far-off origins do not cost digits.
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    a, b, c = np.ascontiguousarray((vertices - middle)[faces].transpose(1, 2, 0))
    six_volumes = _dot(a, _cross(b, c))
    total = a + b + c
    volume = float(six_volumes.sum()) / 6
    if volume == 0:
        return MassProperties(0.0, middle, np.zeros((3, 3)))
    center = (six_volumes * total).sum(axis=1) / 24 / volume
    second = np.empty((3, 3))  # integral of x_i x_j
    for i in range(3):
        for j in range(i + 1):
            products = a[i] * a[j] + b[i] * b[j] + c[i] * c[j] + total[i] * total[j]
            second[i, j] = second[j, i] = (six_volumes * products).sum() / 120
    second -= volume * center[:, None] * center
    return MassProperties(volume, middle + center, np.trace(second) * np.eye(3) - second)


def object_from_solid(
    id: str,
    vertices: ArrayLike,
    faces: ArrayLike,
    pieces: Sequence[ArrayLike],
    *,
    mass_kg: float | None = None,
    density_kg_m3: float | None = None,
    texture: Texture | None = None,
) -> ObjectModel:
    """A homogeneous object from its closed surface and its convex pieces.

    Args:
        id: Name; letters, digits, '-', '_' and '.' only.
        vertices: (V, 3) metres, in any frame; the axes of the object's frame stay parallel to it.
        faces: (F, 3) vertex numbers, counter-clockwise seen from outside. Vertices at the same
            place count as one, so a surface may be cut along the seams of its texture.
        pieces: (P, 3) vertices of each convex piece, in the same frame.
        mass_kg: Its mass; either this or the density.
        density_kg_m3: Its density.
        texture: Its own picture, with one ``uv`` for each vertex.

    Returns:
        The object, its origin at the centre of mass.

    Raises:
        InvalidInputError: A number is not finite, the surface is open, flat or inside out, a piece
            is flat, or not exactly one of mass and density is given.
    """
    if not isinstance(id, str) or not _ID.fullmatch(id):
        raise InvalidInputError("object id", repr(id), "letters, digits, '-', '_' and '.'")
    points, triangles = checked_surface(vertices, faces)
    solid = mass_properties(points, triangles)
    longest = float(np.ptp(points, axis=0).max())
    if not solid.volume_m3 > _FLATTEST * longest**3:
        inside_out = solid.volume_m3 < -_FLATTEST * longest**3
        raise InvalidInputError(
            f"volume of {id}",
            f"{solid.volume_m3:.3g} m^3 at {longest:.3g} m of length",
            "a solid; its faces look inwards, reverse them" if inside_out else "a solid, not flat",
        )
    density = _density(solid.volume_m3, mass_kg, density_kg_m3)
    return ObjectModel(
        id=id,
        vertices=_frozen(points - solid.center_m),
        faces=_frozen(triangles),
        pieces=_pieces(pieces, solid.center_m),
        mass_kg=density * solid.volume_m3,
        inertia=_frozen(density * solid.moments_m5),
        texture=_texture(texture, len(points)),
    )


def checked_surface(vertices: ArrayLike, faces: ArrayLike) -> tuple[Floats, NDArray[np.int32]]:
    """Copies of the arrays of a closed surface.

    Closed means that the faces run along each edge as often in one sense as in the other, which is
    what the integrals over the inside need; vertices at the same place count as one.

    Args:
        vertices: (V, 3).
        faces: (F, 3) vertex numbers.

    Raises:
        InvalidInputError: A shape or number is wrong, an edge is open, or neighbouring faces
            disagree about outside.
    """
    points = _points("vertices", vertices)
    triangles = _faces(faces, len(points))
    single = open_edges(points, triangles)
    if single:
        raise InvalidInputError(
            "surface",
            f"open or wound inconsistently along {single} of its edges",
            "a closed surface, its faces counter-clockwise seen from outside",
        )
    return points, triangles


def open_edges(vertices: Floats, faces: NDArray[np.integer]) -> int:
    """Number of edges that the faces do not run along equally often in both senses."""
    place = places(vertices)[faces]
    start, end = place.ravel(), np.roll(place, -1, axis=1).ravel()
    key = np.minimum(start, end) * np.int64(len(vertices)) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    sense = np.sign(end - start)[order]  # 0 for an edge without length
    first = np.flatnonzero(np.diff(key[order], prepend=-1))
    return int(np.count_nonzero(np.add.reduceat(sense, first))) if len(first) else 0


def places(vertices: Floats) -> NDArray[np.int64]:
    """(V,) a number for each place, from 0; the same for vertices at the same place."""
    order = np.lexsort(vertices.T)
    ranked = vertices[order]
    new = (ranked[1:] != ranked[:-1]).any(axis=1)
    place = np.zeros(len(vertices), np.int64)
    place[order[1:]] = np.cumsum(new)
    return place


def _density(volume_m3: float, mass_kg: float | None, density_kg_m3: float | None) -> float:
    if (mass_kg is None) == (density_kg_m3 is None):
        found = "neither" if mass_kg is None else "both"
        raise InvalidInputError("mass_kg, density_kg_m3", found, "exactly one of them")
    for name, value in (("mass_kg", mass_kg), ("density_kg_m3", density_kg_m3)):
        if value is not None and not (0 < value < math.inf):
            raise InvalidInputError(name, value, "a finite number above 0")
    return float(mass_kg / volume_m3 if mass_kg is not None else density_kg_m3 or 0.0)


def _points(name: str, value: ArrayLike) -> Floats:
    try:
        points = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(name, f"{value!r:.80}", "an array of numbers") from error
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise InvalidInputError(f"shape of {name}", points.shape, "(at least 4, 3)")
    if not np.isfinite(points).all():
        raise InvalidInputError(name, "partly NaN or infinite", "finite numbers")
    return points


def _faces(value: ArrayLike, count: int) -> NDArray[np.int32]:
    faces = np.array(value)
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) < 4 or faces.dtype.kind not in "iu":
        raise InvalidInputError(
            "faces", f"{faces.dtype} of shape {faces.shape}", "whole numbers, (at least 4, 3)"
        )
    if faces.min() < 0 or faces.max() >= count:
        raise InvalidInputError(
            "faces", f"numbers from {faces.min()} to {faces.max()}", f"0 to {count - 1}"
        )
    return faces.astype(np.int32)


def _pieces(pieces: Sequence[ArrayLike], center: Floats) -> tuple[Floats, ...]:
    if not len(pieces):
        raise InvalidInputError("pieces", "none", "at least one convex piece")
    moved = []
    for number, piece in enumerate(pieces):
        points = _points(f"piece {number}", piece) - center
        spreads = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        spread = spreads[-1] / math.sqrt(len(points))
        if not spread > _THINNEST_M:
            raise InvalidInputError(
                f"piece {number}", f"flat ({spread:.2g} m thick)", "a body with volume"
            )
        moved.append(_frozen(points))
    return tuple(moved)


def _texture(texture: Texture | None, count: int) -> Texture | None:
    if texture is None:
        return None
    if texture.uv.shape != (count, 2) or not np.isfinite(texture.uv).all():
        raise InvalidInputError(
            "texture", f"uv of shape {texture.uv.shape}", f"({count}, 2) finite numbers"
        )
    if texture.image.dtype != np.uint8 or texture.image.ndim != 3 or texture.image.shape[2] != 3:
        raise InvalidInputError(
            "texture", f"{texture.image.dtype} {texture.image.shape}", "(h, w, 3) uint8"
        )
    return texture


def _frozen(array: NDArray[T]) -> NDArray[T]:
    array.setflags(write=False)
    return array


def _cross(a: Floats, b: Floats) -> Floats:
    """(3, F) cross products of columns."""
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
