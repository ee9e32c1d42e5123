"""Simple convex bodies."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from graspmap.simulation.procedural.convex import convex
from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.revolve import sides
from graspmap.simulation.procedural.solid import Floats, Solid

_ROUND = 64  # corners of a circle
_FINE_M = 0.00015  # how far a ball's faces may lie inside it


def ring(radius_m: float, z: float = 0, count: int = _ROUND) -> Floats:
    """(count, 3) points on a circle about the z axis."""
    turns = [2 * math.pi * i / count for i in range(count)]
    return np.array([(radius_m * math.cos(t), radius_m * math.sin(t), z) for t in turns])


def globe(center: tuple[float, float, float], radii: tuple[float, float, float]) -> Floats:
    """(N, 3) points on an ellipsoid, as dense as its size needs."""
    rings = min(24, max(8, math.ceil(sides(max(radii), _FINE_M) / 2)))
    tilts = [math.pi * (i + 0.5) / rings for i in range(rings)]
    circles = [ring(math.sin(t), math.cos(t), 2 * rings) for t in tilts]
    unit = np.concatenate([*circles, [(0, 0, 1), (0, 0, -1)]])
    return np.asarray(unit * radii + center)


def block(x: float, y: float, z: float) -> Solid:
    """A box about the origin, by its sides."""
    corners = [(i * x / 2, j * y / 2, k * z / 2) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    return convex(np.array(corners))


def cylinder(radius_m: float, height_m: float, top_radius_m: float | None = None) -> Solid:
    """A cylinder or frustum about the z axis, from z = 0 upwards."""
    top = radius_m if top_radius_m is None else top_radius_m
    return convex(np.concatenate([ring(radius_m), ring(top, height_m)]))


def ball(radius_m: float) -> Solid:
    """A sphere about the origin."""
    return convex(globe((0, 0, 0), (radius_m, radius_m, radius_m)))


def ellipsoid(x: float, y: float, z: float) -> Solid:
    """An ellipsoid about the origin, by its half axes."""
    return convex(globe((0, 0, 0), (x, y, z)))


def rod(radius_m: float, length_m: float) -> Solid:
    """A cylinder with round ends along z, about the origin; the length includes the ends."""
    half = length_m / 2 - radius_m
    ends = [globe((0, 0, s * half), (radius_m, radius_m, radius_m)) for s in (-1, 1)]
    return convex(np.concatenate(ends))


def _box(draw: Draw) -> Solid:
    middle, least = draw.sides()
    length = draw.longest(least)
    return block(length, length * middle, length * least)


def _cube(draw: Draw) -> Solid:
    side = draw.longest(1)
    return block(side, side, side)


def _rounded_box(draw: Draw) -> Solid:
    middle, least = draw.sides()
    length = draw.longest(least)
    sides = np.array([length, length * middle, length * least])
    radius = draw.uniform(0.1, 0.45) * sides.min()
    corners = [
        globe(tuple((sides / 2 - radius) * (i, j, k)), (radius, radius, radius))
        for i in (-1, 1)
        for j in (-1, 1)
        for k in (-1, 1)
    ]
    return convex(np.concatenate(corners))


def _cylinder(draw: Draw) -> Solid:
    ratio = draw.even_log(0.15, 8)  # height over diameter
    length = draw.longest(min(1, 1 / ratio))
    diameter = length * min(1, 1 / ratio)
    return cylinder(diameter / 2, length * min(1, ratio))


def _frustum(draw: Draw) -> Solid:
    ratio = draw.even_log(0.3, 4)
    length = draw.longest(min(1, 1 / ratio))
    radius = length * min(1, 1 / ratio) / 2
    return cylinder(radius, length * min(1, ratio), radius * draw.uniform(0.25, 0.85))


def _cone(draw: Draw) -> Solid:
    ratio = draw.even_log(0.5, 4)
    length = draw.longest(min(1, 1 / ratio))
    radius = length * min(1, 1 / ratio) / 2
    return cylinder(radius, length * min(1, ratio), 0.05 * radius)


def _sphere(draw: Draw) -> Solid:
    return ball(draw.longest(1) / 2)


def _ellipsoid(draw: Draw) -> Solid:
    a, b = sorted((draw.uniform(0.25, 1), draw.uniform(0.25, 1)))
    half = draw.longest(a) / 2
    return ellipsoid(half, b * half, a * half)


def _egg(draw: Draw) -> Solid:
    length = draw.longest(0.75)
    radius = length * draw.uniform(0.3, 0.4)
    blunt, pointed = 0.8 * radius, length - 0.8 * radius
    points = globe((0, 0, 0), (radius, radius, 1))
    points[:, 2] *= np.where(points[:, 2] > 0, pointed, blunt)
    return convex(points)


def _capsule(draw: Draw) -> Solid:
    ratio = draw.uniform(0.15, 0.7)
    length = draw.longest(ratio)
    return rod(ratio * length / 2, length)


def _dome(draw: Draw) -> Solid:
    diameter = draw.longest(draw.uniform(0.4, 1))
    height = diameter * draw.uniform(0.3, 0.6)
    points = globe((0, 0, 0), (diameter / 2, diameter / 2, height))
    flat = np.where(points[:, 2] < 0, 0, points[:, 2])
    return convex(np.column_stack([points[:, :2], flat]))


def _prism(draw: Draw) -> Solid:
    corners = draw.integer(3, 8)
    ratio = draw.even_log(0.2, 6)
    length = draw.longest(min(1, 1 / ratio))
    radius = length * min(1, 1 / ratio) / 2
    height = length * min(1, ratio)
    return convex(np.concatenate([ring(radius, 0, corners), ring(radius, height, corners)]))


def _pyramid(draw: Draw) -> Solid:
    corners = draw.integer(3, 6)
    ratio = draw.even_log(0.5, 2.5)
    length = draw.longest(min(1, 1 / ratio))
    radius = length * min(1, 1 / ratio) / 2
    top = draw.choice((0.02, 0.02, draw.uniform(0.2, 0.6)))
    height = length * min(1, ratio)
    return convex(np.concatenate([ring(radius, 0, corners), ring(top * radius, height, corners)]))


def _wedge(draw: Draw) -> Solid:
    middle, least = draw.sides()
    length = draw.longest(least)
    x, y, z = length / 2, length * middle / 2, length * max(least, 0.1)
    edge = draw.uniform(-x, x) if draw.chance(0.5) else x
    tip = draw.uniform(0.03, 0.3) * z
    low = [(i * x, j * y, 0) for i in (-1, 1) for j in (-1, 1)]
    high = [(edge, j * y, z) for j in (-1, 1)]
    ends = [(i * x, j * y, tip) for i in (-1, 1) for j in (-1, 1)]
    return convex(np.array(low + high + ends))


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "box": _box,
    "cube": _cube,
    "rounded-box": _rounded_box,
    "cylinder": _cylinder,
    "frustum": _frustum,
    "cone": _cone,
    "sphere": _sphere,
    "ellipsoid": _ellipsoid,
    "egg": _egg,
    "capsule": _capsule,
    "dome": _dome,
    "prism": _prism,
    "pyramid": _pyramid,
    "wedge": _wedge,
}
"""Shapes of the family by name."""
