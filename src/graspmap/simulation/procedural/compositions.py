"""Things joined from simple bodies: heaps of them without a name, furniture, toys, fittings."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from graspmap.simulation.procedural.convex import convex
from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.primitives import (
    ball,
    block,
    cylinder,
    ellipsoid,
    globe,
    rod,
)
from graspmap.simulation.procedural.revolve import revolve_ring
from graspmap.simulation.procedural.solid import Floats, Solid, join

Point = tuple[float, float, float]


def limb(start: Point, stop: Point, radius: float, stop_radius: float | None = None) -> Solid:
    """A round bar with round ends between two points, tapering where a second radius is given."""
    last = radius if stop_radius is None else stop_radius
    ends = [globe(start, (radius,) * 3), globe(stop, (last,) * 3)]
    return convex(np.concatenate(ends))


def _some_body(draw: Draw, size: float) -> Solid:
    """A simple body about the origin, about as large as ``size``."""
    sides = [size * draw.uniform(0.35, 1) for _ in range(3)]
    kind = draw.integer(0, 4)
    if kind == 0:
        body = block(*sides)
    elif kind == 1:
        body = cylinder(sides[0] / 2, sides[1]).moved(z=-sides[1] / 2)
    elif kind == 2:
        body = ellipsoid(*(s / 2 for s in sides))
    elif kind == 3:
        body = cylinder(sides[0] / 2, sides[1], sides[0] * draw.uniform(0.1, 0.4))
        body = body.moved(z=-sides[1] / 2)
    else:
        body = rod(min(sides) / 3, size)
    for axis in "xyz":
        body = body.turned(axis, draw.choice((0.0, math.pi / 2, draw.uniform(0, math.pi))))
    return body


def _joined(draw: Draw) -> Solid:
    """Two to five bodies, each grown into one of those before."""
    length = draw.longest(0.6)
    size = 0.6 * length
    parts = [_some_body(draw, size)]
    for _ in range(draw.integer(1, 4)):
        other = parts[draw.integer(0, len(parts) - 1)]
        body = _some_body(draw, size * draw.uniform(0.4, 1))
        angle, tilt = draw.uniform(0, 2 * math.pi), draw.uniform(-1, 1)
        flat = math.sqrt(1 - tilt**2)
        way = np.array([flat * math.cos(angle), flat * math.sin(angle), tilt])
        # The middle of the new body lies a little under the other's surface.
        middle = (other.vertices.max(axis=0) + other.vertices.min(axis=0)) / 2
        reach = float(
            (
                other.vertices[:, 0] * way[0]
                + other.vertices[:, 1] * way[1]
                + other.vertices[:, 2] * way[2]
            ).max()
            - (middle * way).sum()
        )
        at = middle + way * 0.8 * reach
        parts.append(body.moved(*at.tolist()))
    body = join(parts)
    factor = length / float(body.extents.max())
    return body.stretched(factor, factor, factor)


def _tower(draw: Draw) -> Solid:
    """Boxes and discs stacked along one line, each wider or narrower than the one below."""
    high = draw.longest(0.5)
    count = draw.integer(2, 4)
    shares = [draw.uniform(0.5, 1.5) for _ in range(count)]
    parts, z = [], 0.0
    for share in shares:
        tall = high * share / sum(shares)
        wide = high * draw.uniform(0.15, 0.5)
        sunk = 0.05 * tall if z else 0.0  # into the one below
        if draw.chance(0.5):
            part = cylinder(wide / 2, tall + sunk)
        else:
            part = block(wide, wide * draw.uniform(0.5, 1), tall + sunk)
            part = part.moved(z=(tall + sunk) / 2)
        parts.append(part.moved(z=z - sunk))
        z += tall
    return join(parts)


def _jack(draw: Draw) -> Solid:
    """Three bars across each other, with or without balls at the ends."""
    length = draw.longest(0.2)
    radius = length * draw.uniform(0.04, 0.09)
    parts = []
    for axis in range(3):
        end: Floats = np.zeros(3)
        end[axis] = length * draw.uniform(0.7, 1) / 2 - radius
        points = [tuple((s * end).tolist()) for s in (-1, 1)]
        parts.append(limb(points[0], points[1], radius))
    if draw.chance(0.5):
        size = length * draw.uniform(0.09, 0.13)
        tips = [(s * (length / 2 - size), 0, 0) for s in (-1, 1)]
        parts += [ball(size).moved(*tip) for tip in tips]
    return join(parts)


def _tee(draw: Draw) -> Solid:
    """A pipe fitting: two or three round arms with collars."""
    length = draw.longest(0.4)
    radius = length * draw.uniform(0.1, 0.18)
    arms = draw.choice(((0, 180, 90), (0, 90), (0, 120, 240), (0, 90, 180, 270)))
    parts = [ball(radius)]
    collar = radius * draw.uniform(1, 1.35)
    reach = length / 2
    for degrees in arms:
        arm = cylinder(radius, reach)
        end = cylinder(collar, 0.3 * reach).moved(z=0.7 * reach)
        turn = math.radians(degrees)
        parts += [p.turned("y", math.pi / 2).turned("z", turn) for p in (arm, end)]
    return join(parts)


def _legs(length: float, wide: float, high: float, thick: float) -> list[Solid]:
    leg = block(thick, thick, high).moved(z=high / 2)
    return [
        leg.moved(i * (length - thick) / 2, j * (wide - thick) / 2)
        for i in (-1, 1)
        for j in (-1, 1)
    ]


def _table(draw: Draw) -> Solid:
    length = draw.longest()
    wide, high = length * draw.uniform(0.5, 1), length * draw.uniform(0.4, 0.8)
    thick = draw.sturdy(length * draw.uniform(0.04, 0.08))
    board = block(length, wide, thick).moved(z=high - thick / 2)
    if draw.chance(0.25):  # one round leg on a foot
        foot = cylinder(0.3 * wide, thick)
        return join([board, cylinder(0.08 * wide, high), foot])
    return join([board, *_legs(0.92 * length, 0.92 * wide, high - thick / 2, 1.2 * thick)])


def _chair(draw: Draw) -> Solid:
    high = draw.longest(0.45)
    seat = high * draw.uniform(0.42, 0.5)
    wide = high * draw.uniform(0.4, 0.5)
    thick = draw.sturdy(high * draw.uniform(0.04, 0.07))
    parts = [block(wide, wide, thick).moved(z=seat), *_legs(wide, wide, seat, thick)]
    x = -(wide - thick) / 2
    if draw.chance(0.5):
        back = block(thick, wide, high - seat).moved(x, 0, (high + seat) / 2)
        return join([*parts, back])
    for j in (-1, 1):
        post = block(thick, thick, high - seat)
        parts.append(post.moved(x, j * (wide - thick) / 2, (high + seat) / 2))
    for z in (0.95, 0.75, 0.55):
        rail = block(thick, wide, 0.08 * high)
        parts.append(rail.moved(x, 0, seat + z * (high - seat) - 0.04 * high))
    return join(parts)


def _stairs(draw: Draw) -> Solid:
    length = draw.longest(0.5)
    steps = draw.integer(2, 5)
    rise = length * draw.uniform(0.5, 0.9) / steps
    wide = length * draw.uniform(0.3, 0.7)
    run = length / steps
    # Each step goes down to the floor, its back in the plane of all backs.
    return join(
        block(length - i * run, wide, (i + 1) * rise).moved(i * run / 2, 0, (i + 1) * rise / 2)
        for i in range(steps)
    )


def _house(draw: Draw) -> Solid:
    length = draw.longest(0.7)
    wide, wall = length * draw.uniform(0.6, 0.9), length * draw.uniform(0.3, 0.5)
    ridge = wall + wide * draw.uniform(0.3, 0.5)
    eaves = 0.56 * wide
    roof = convex(
        [
            *((i * length / 2, j * eaves, wall) for i in (-1, 1) for j in (-1, 1)),
            *((i * length / 2, j * eaves, wall + 0.04 * length) for i in (-1, 1) for j in (-1, 1)),
            *((i * length / 2, 0, ridge) for i in (-1, 1)),
        ]
    )
    chimney = block(0.12 * length, 0.12 * length, ridge)
    spot = chimney.moved(0.25 * length, 0.2 * wide, 0.55 * ridge)
    return join([block(0.92 * length, wide, wall).moved(z=wall / 2), roof, spot])


def _figure(draw: Draw) -> Solid:
    """A standing person."""
    high = draw.longest(0.3)
    head = 0.085 * high * draw.uniform(0.9, 1.3)
    wide = high * draw.uniform(0.09, 0.13)
    bone = draw.sturdy(high * draw.uniform(0.03, 0.045), 2)
    hip, shoulder = 0.48 * high, 0.8 * high
    parts = [
        ball(head).moved(z=high - head),
        limb((0, 0, shoulder), (0, 0, high - head), 0.8 * bone),
        ellipsoid(0.75 * wide, 1.25 * wide, 0.24 * high).moved(z=(hip + shoulder) / 2),
    ]
    for side in (-1, 1):
        lift, stride = draw.uniform(-70, 80), draw.uniform(-0.15, 0.15) * high
        angle = math.radians(lift)
        hand = (
            0.1 * high * draw.uniform(-1, 1),
            side * (wide + 0.32 * high * math.cos(angle)),
            shoulder - 0.02 * high + 0.32 * high * math.sin(angle),
        )
        parts.append(limb((0, side * wide, shoulder - 0.04 * high), hand, bone, 0.75 * bone))
        ankle = (stride, side * (0.7 * wide + 0.03 * high), bone)
        parts.append(limb((0, side * 0.6 * wide, hip), ankle, 1.25 * bone, bone))
        foot = (stride + 0.09 * high, side * (0.7 * wide + 0.03 * high), 0.9 * bone)
        parts.append(limb(ankle, foot, 0.9 * bone))
    return join(parts)


def _animal(draw: Draw) -> Solid:
    """A beast on four legs."""
    length = draw.longest(0.4)
    body, leg = 0.6 * length, length * draw.uniform(0.18, 0.4)
    thick = length * draw.uniform(0.09, 0.15)
    bone = thick * draw.uniform(0.3, 0.5)
    z = leg + 0.6 * thick
    head = thick * draw.uniform(0.6, 0.9)
    neck = (0.36 * length, 0.0, z + length * draw.uniform(0.05, 0.3))
    parts = [
        ellipsoid(body / 2, thick, thick).moved(z=z),
        limb((0.2 * length, 0, z), neck, 0.55 * thick, 0.45 * thick),
        limb(neck, (neck[0] + 1.5 * head, 0, neck[2] - 0.3 * head), head, 0.6 * head),
        limb(
            (-0.26 * length, 0, z),
            (-0.4 * length, 0, z + draw.uniform(-0.1, 0.12) * length),
            0.6 * bone,
            0.4 * bone,
        ),
    ]
    for i in (-1, 1):
        for j in (-1, 1):
            hip = (i * 0.3 * body, j * 0.5 * thick, z)
            parts.append(limb(hip, (i * 0.34 * body, j * 0.6 * thick, bone), 1.2 * bone, bone))
    if draw.chance(0.6):
        for j in (-1, 1):
            ear = (neck[0], j * 0.9 * head, neck[2] + 1.4 * head)
            parts.append(limb((neck[0], j * 0.5 * head, neck[2] + 0.5 * head), ear, 0.3 * head))
    return join(parts)


def _snowman(draw: Draw) -> Solid:
    high = draw.longest(0.5)
    sizes = (0.3, 0.22, 0.15)
    parts, z = [], 0.0
    for share in sizes:
        radius = high * share * draw.uniform(0.75, 0.85)
        z += 0.85 * radius
        parts.append(ball(radius).moved(z=z))
        z += 0.8 * radius
    if draw.chance(0.5):
        brim, hat = 0.16 * high, 0.1 * high
        parts += [
            cylinder(brim, 0.02 * high).moved(z=z - 0.03 * high),
            cylinder(hat, 0.15 * high).moved(z=z - 0.03 * high),
        ]
    return join(parts)


def _mushroom(draw: Draw) -> Solid:
    high = draw.longest(0.8)
    cap, thick = high * draw.uniform(0.35, 0.5), high * draw.uniform(0.25, 0.45)
    points = globe((0, 0, 0), (cap, cap, thick))
    points[:, 2] = np.maximum(points[:, 2], -0.1 * thick)
    stem = cylinder(cap * draw.uniform(0.25, 0.45), high - 0.9 * thick, cap * 0.25)
    return join([stem, convex(points).moved(z=high - thick)])


def _tree(draw: Draw) -> Solid:
    high = draw.longest(0.5)
    trunk = high * draw.uniform(0.04, 0.08)
    parts = [cylinder(trunk, 0.4 * high)]
    tiers = draw.integer(1, 3)
    for i in range(tiers):
        low = high * (0.25 + 0.5 * i / tiers)
        tall = min(0.5 * high, high - low)
        wide = high * (0.3 - 0.06 * i)
        parts.append(cylinder(wide, tall, 0.08 * wide).moved(z=low))
    return join(parts)


def _wheels(x: float, y: float, radius: float, wide: float) -> list[Solid]:
    wheel = cylinder(radius, wide).turned("x", math.pi / 2).moved(y=wide / 2, z=radius)
    return [wheel.moved(i * x, j * y) for i in (-1, 1) for j in (-1, 1)]


def _car(draw: Draw) -> Solid:
    length = draw.longest(0.45)
    wide, radius = length * draw.uniform(0.38, 0.46), length * draw.uniform(0.08, 0.12)
    low, hood = 0.6 * radius, length * draw.uniform(0.2, 0.26)
    body = block(length, wide, hood - low).moved(z=(hood + low) / 2)
    roof = hood + length * draw.uniform(0.1, 0.2)
    front, back = draw.uniform(0.1, 0.25) * length, -draw.uniform(0.3, 0.48) * length
    slant = 0.08 * length
    cabin = convex(
        [
            *((x, j * 0.47 * wide, 0.98 * hood) for x in (front, back) for j in (-1, 1)),
            *(
                (x, j * 0.4 * wide, roof)
                for x in (front - slant, back + 0.5 * slant)
                for j in (-1, 1)
            ),
        ]
    )
    return join([body, cabin, *_wheels(0.3 * length, 0.46 * wide, radius, 0.16 * wide)])


def _plane(draw: Draw) -> Solid:
    length = draw.longest()
    radius = length * draw.uniform(0.06, 0.09)
    span = length * draw.uniform(0.35, 0.48)
    chord, thick = length * draw.uniform(0.12, 0.2), draw.sturdy(0.018 * length)
    sweep = draw.uniform(0, 0.25) * length
    parts = [ellipsoid(length / 2, radius, radius)]

    def wing(x: float, reach: float, wide: float, z: float) -> Solid:
        tip = x - sweep * reach / span
        half = [(x, 0.0), (x - wide, 0.0), (tip, reach), (tip - 0.6 * wide, reach)]
        return convex([(a, b, z + k * thick / 2) for a, b in half for k in (-1, 1)])

    for mirror in (1, -1):
        parts.append(wing(0.12 * length, span, chord, -0.2 * radius).stretched(y=mirror))
        parts.append(wing(-0.36 * length, 0.35 * span, 0.6 * chord, 0).stretched(y=mirror))
    fin = wing(-0.36 * length, 0.3 * span, 0.6 * chord, 0).turned("x", math.pi / 2)
    return join([*parts, fin])


def _lamp(draw: Draw) -> Solid:
    high = draw.longest(0.5)
    foot = high * draw.uniform(0.2, 0.3)
    pole = draw.sturdy(high * draw.uniform(0.02, 0.04), 2)
    shade = high * draw.uniform(0.2, 0.3)
    top = shade * draw.uniform(0.5, 0.8)
    cap = cylinder(shade, 0.35 * high, top).moved(z=0.65 * high)
    return join([cylinder(foot, 0.05 * high), cylinder(pole, 0.7 * high), cap])


def _plug(draw: Draw) -> Solid:
    """A mains plug: a body, prongs and a stub of cable."""
    length = draw.longest(0.4)
    wide, high = length * draw.uniform(0.4, 0.6), length * draw.uniform(0.25, 0.4)
    body = convex(
        [
            *((0.0, j * wide / 2, k * high / 2) for j in (-1, 1) for k in (-1, 1)),
            *((-0.45 * length, j * wide / 3, k * high / 3) for j in (-1, 1) for k in (-1, 1)),
        ]
    )
    prong = draw.sturdy(0.04 * length, 2)
    pins = [
        cylinder(prong, 0.27 * length)
        .turned("y", math.pi / 2)
        .moved(-0.02 * length, j * 0.28 * wide)
        for j in (-1, 1)
    ]
    cable = cylinder(0.5 * prong + 0.1 * high, 0.32 * length).turned("y", -math.pi / 2)
    return join([body, *pins, cable.moved(-0.43 * length)])


def _tap(draw: Draw) -> Solid:
    """A valve: a pipe, a stem and a wheel or a lever."""
    length = draw.longest(0.4)
    radius = length * draw.uniform(0.08, 0.12)
    pipe = cylinder(radius, length).turned("y", math.pi / 2).moved(-length / 2)
    collars = [
        cylinder(1.4 * radius, 0.12 * length).turned("y", math.pi / 2).moved(x)
        for x in (-length / 2, 0.38 * length)
    ]
    rise = length * draw.uniform(0.25, 0.4)
    stem = cylinder(0.45 * radius, rise)
    parts = [pipe, *collars, ball(1.45 * radius), stem]
    if draw.chance(0.5):
        outer = length * draw.uniform(0.17, 0.25)
        bar = draw.sturdy(0.2 * outer)
        rim = revolve_ring(
            [(outer - bar, -bar / 2), (outer, -bar / 2), (outer, bar / 2), (outer - bar, bar / 2)]
        )
        spokes = [block(2 * outer - bar, bar, 0.8 * bar), block(bar, 2 * outer - bar, 0.8 * bar)]
        parts += [p.moved(z=rise) for p in (rim, *spokes)]
    else:
        lever = block(0.45 * length, 0.9 * radius, draw.sturdy(0.3 * radius))
        parts.append(lever.moved(0.15 * length, 0, rise))
    return join(parts)


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "joined": _joined,
    "tower": _tower,
    "jack": _jack,
    "tee": _tee,
    "table": _table,
    "chair": _chair,
    "stairs": _stairs,
    "house": _house,
    "figure": _figure,
    "animal": _animal,
    "snowman": _snowman,
    "mushroom": _mushroom,
    "tree": _tree,
    "car": _car,
    "plane": _plane,
    "lamp": _lamp,
    "plug": _plug,
    "tap": _tap,
}
"""Shapes of the family by name."""
