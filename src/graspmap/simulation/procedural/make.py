"""Object ``index`` of ``seed``: drawn from a mixture of families, always the same."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from graspmap.errors import GraspmapError, InvalidInputError, UnknownNameError
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.procedural import (
    blobs,
    compositions,
    extrusions,
    handled,
    primitives,
    revolutions,
    shells,
    superquadrics,
    tools,
)
from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.ranges import ObjectRanges
from graspmap.simulation.procedural.solid import Solid, thickness, volume
from graspmap.simulation.solids import object_from_solid

Builder = Callable[[Draw], Solid]

_ATTEMPTS = 50
_THINNEST_PIECE_M = 2e-5  # thinner ones, between nearly straight corners, are left out


@dataclass(frozen=True)
class Family:
    """Shapes of one kind.

    Args:
        weight: Share of the mixture that comes from this family.
        shapes: Builder of each shape, by name; each is as likely as the others.
    """

    weight: float
    shapes: Mapping[str, Builder]


FAMILIES: dict[str, Family] = {
    "primitive": Family(0.15, primitives.SHAPES),
    "extrusion": Family(0.22, extrusions.SHAPES),
    "revolution": Family(0.16, revolutions.SHAPES),
    "handled": Family(0.12, handled.SHAPES),
    "tool": Family(0.1, tools.SHAPES),
    "shell": Family(0.12, shells.SHAPES),
    "composition": Family(0.14, compositions.SHAPES),
    "superquadric": Family(0.06, superquadrics.SHAPES),
    "blob": Family(0.08, blobs.SHAPES),
}
"""The families by name; a new family is one module, and one line here."""


def make_object(
    seed: int, index: int, *, ranges: ObjectRanges | None = None, families: Sequence[str] = ()
) -> ObjectModel:
    """Object ``index`` of ``seed``, whichever were made before, in any process.

    Args:
        seed: Of the whole set, >= 0.
        index: Of the object, >= 0.
        ranges: Sizes and masses; the defaults where None. Other ranges give other objects.
        families: Names of `FAMILIES`, or of their shapes ("mug"), to draw from in proportion to
            their weights; all families where empty.

    Returns:
        The object; its id is the shape's name and the index, such as ``mug-000123``.

    Raises:
        InvalidInputError: Seed or index is not a whole number >= 0.
        UnknownNameError: There is no such family or shape.
    """
    for name, value in (("seed", seed), ("index", index)):
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not whole or value < 0:
            raise InvalidInputError(name, repr(value), "a whole number, >= 0")
    draw = Draw(np.random.default_rng((seed, index)), ranges or ObjectRanges())
    shape, build = _choose(draw, families)
    solid = _built(build, draw)
    return object_from_solid(
        f"{shape}-{index:06d}",
        solid.vertices,
        solid.faces,
        solid.pieces,
        mass_kg=_mass(draw, volume(solid.vertices, solid.faces)),
    )


def family_of(shape: str) -> str:
    """Name of the family that has a shape: ``"handled"`` for ``"mug"``.

    Raises:
        UnknownNameError: There is no such shape.
    """
    for name, family in FAMILIES.items():
        if shape in family.shapes:
            return name
    shapes = [name for family in FAMILIES.values() for name in family.shapes]
    raise UnknownNameError("family or shape", shape, [*FAMILIES, *shapes])


def _choose(draw: Draw, families: Sequence[str]) -> tuple[str, Builder]:
    shares = np.cumsum([_weight(name) for name in families or FAMILIES])
    number = draw.rng.random() * shares[-1]
    place = min(int(np.searchsorted(shares, number, side="right")), len(shares) - 1)
    name = (families or list(FAMILIES))[place]
    if name in FAMILIES:
        return draw.choice(list(FAMILIES[name].shapes.items()))
    return name, FAMILIES[family_of(name)].shapes[name]


def _weight(name: str) -> float:
    """Share of the mixture that a family, or a shape of one, has."""
    if name in FAMILIES:
        return FAMILIES[name].weight
    family = FAMILIES[family_of(name)]
    return family.weight / len(family.shapes)


def _built(build: Builder, draw: Draw) -> Solid:
    """The first sound solid out of the stream; nearly always the first at all."""
    for _ in range(_ATTEMPTS):
        solid = _within(build(draw), draw)
        pieces = tuple(p for p in solid.pieces if thickness(p) > _THINNEST_PIECE_M)
        if _sound(solid) and pieces:
            return replace(solid, pieces=pieces)
    raise GraspmapError(
        f"no sound object in {_ATTEMPTS} attempts with {draw.ranges}; choose wider ranges"
    )


def _sound(solid: Solid) -> bool:
    """Closed, in one part, and with a volume."""
    edges = np.concatenate([solid.faces[:, [i, (i + 1) % 3]] for i in range(3)])
    count = len(solid.vertices)
    there = np.sort(edges[:, 0] * np.int64(count) + edges[:, 1])
    back = np.sort(edges[:, 1] * np.int64(count) + edges[:, 0])
    once = bool((there[1:] != there[:-1]).all())
    links = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    parts = connected_components(links, directed=False, return_labels=False)
    closed = once and bool((there == back).all())
    return closed and parts == 1 and volume(solid.vertices, solid.faces) > 0


def _within(solid: Solid, draw: Draw) -> Solid:
    """Scaled as little as brings its longest side into the range."""
    low, high = draw.ranges.longest_m
    longest = float(solid.extents.max())
    if low <= longest <= high:
        return solid
    factor = min(max(longest, low), high) / longest
    return solid.stretched(factor, factor, factor)


def _mass(draw: Draw, volume_m3: float) -> float:
    low, high = draw.ranges.mass_kg
    return min(max(draw.even_log(*draw.ranges.density_kg_m3) * volume_m3, low), high)
