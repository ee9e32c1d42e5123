"""Superquadrics: between a box, a cylinder, a ball and an octahedron; always convex.

References:
    Barr, "Superquadrics and angle-preserving transformations", IEEE CG&A 1981.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from graspmap.simulation.procedural.convex import convex
from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.solid import Floats, Solid

_AROUND = 48
_RINGS = 24


def superquadric(half: tuple[float, float, float], upright: float, around: float) -> Solid:
    """The body |x/a|^(2/n) + ... = 1 about the origin.

    Args:
        half: Half axes a, b, c.
        upright: Exponent of sections through the z axis: near 0 square, 1 round, 2 a rhombus.
        around: Exponent of sections across the z axis.
    """
    # Even steps of the angle crowd the points where a small exponent bends most.
    tilts = [math.pi * (i + 0.5) / _RINGS - math.pi / 2 for i in range(_RINGS)]
    turns = [2 * math.pi * (i + 0.5) / _AROUND for i in range(_AROUND)]
    points = [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
    for tilt in tilts:
        radius, z = _power(math.cos(tilt), upright), _power(math.sin(tilt), upright)
        points += [
            (radius * _power(math.cos(t), around), radius * _power(math.sin(t), around), z)
            for t in turns
        ]
    return convex(np.array(points) * half)


def _power(value: float, exponent: float) -> float:
    return math.copysign(abs(value) ** exponent, value)


def _half(draw: Draw) -> tuple[float, float, float]:
    a, b = draw.uniform(0.2, 1), draw.uniform(0.2, 1)
    half = draw.longest(min(a, b)) / 2
    sides = [half, a * half, b * half]
    first = draw.integer(0, 2)
    return sides[first], sides[(first + 1) % 3], sides[(first + 2) % 3]


def _any(draw: Draw) -> Solid:
    return superquadric(_half(draw), draw.uniform(0.15, 1.9), draw.uniform(0.15, 1.9))


def _soap(draw: Draw) -> Solid:
    return superquadric(_half(draw), draw.uniform(0.4, 0.8), draw.uniform(0.2, 0.8))


def _pillow(draw: Draw) -> Solid:
    return superquadric(_half(draw), draw.uniform(0.8, 1.2), draw.uniform(0.2, 0.5))


def _tapered(draw: Draw) -> Solid:
    """Narrower towards one end; the hull of the tapered points, so still convex."""
    body = superquadric(_half(draw), draw.uniform(0.2, 1.2), draw.uniform(0.2, 1.6))
    points: Floats = np.array(body.vertices)
    half = float(points[:, 2].max())
    points[:, :2] *= 1 - draw.uniform(0.2, 0.7) * (points[:, 2:] / half + 1) / 2
    return convex(points)


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "superellipsoid": _any,
    "soap": _soap,
    "pillow": _pillow,
    "tapered": _tapered,
}
"""Shapes of the family by name."""
