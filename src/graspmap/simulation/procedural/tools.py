"""Hand tools: a handle and a working end."""

from __future__ import annotations

import math
from collections.abc import Callable

from graspmap.simulation.procedural.convex import convex
from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.primitives import ball, block, cylinder, ring, rod
from graspmap.simulation.procedural.revolve import arc, revolve, revolve_ring
from graspmap.simulation.procedural.solid import Solid, join
from graspmap.simulation.procedural.sweep import bend, flat_bar, oval, sweep

_UP = (0.0, 0.0, 1.0)


def _handle(draw: Draw, length: float, radius: float) -> Solid:
    """A handle along x from 0 to -length: round, bellied, flat or with corners."""
    bevel = 0.3 * radius
    kind = draw.integer(0, 3)
    if kind == 0:
        line = [
            (radius - bevel, 0),
            (radius, bevel),
            (0.85 * radius, 0.5 * length),
            (radius, length - bevel),
            (radius - bevel, length),
        ]
    elif kind == 1:
        line = arc((0.3 * radius, length / 2), (0.7 * radius, length / 2), -90, 90, 10)
    elif kind == 2:
        width, thick = 2 * radius, radius * draw.uniform(1, 1.6)
        return block(length, width, thick).moved(-length / 2)
    else:
        corners = draw.choice((6, 8))
        section = [(r, z) for r, z in ((0.9 * radius, 0), (radius, bevel), (radius, length))]
        prism = [ring(r, z, corners) for r, z in section]
        return convex([p for points in prism for p in points]).turned("y", -math.pi / 2)
    return revolve(line).turned("y", -math.pi / 2)


def _hammer(draw: Draw) -> Solid:
    length = draw.longest()
    radius = draw.width(0.03 * length, 0.07 * length) / 2
    head = length * draw.uniform(0.28, 0.45)
    half = head * draw.uniform(0.12, 0.18)
    wood = _handle(draw, length - half, radius).moved(half * 0.2)
    kind = draw.integer(0, 2)
    if kind == 0:  # mallet
        block_head = cylinder(1.6 * half, head).turned("x", math.pi / 2).moved(y=head / 2)
        return join([wood, block_head])
    face = cylinder(half, 0.4 * head).turned("x", math.pi / 2).moved(y=-0.1 * head)
    body = block(1.6 * half, 0.6 * head, 1.6 * half).moved(y=0.05 * head)
    start = 0.3 * head
    if kind == 1:  # a wedge at the back
        edge = 0.12 * half
        back = convex(
            [
                *((i * 0.8 * half, start, k * 0.8 * half) for i in (-1, 1) for k in (-1, 1)),
                *(
                    (i * 0.8 * half, start + 0.35 * head, k * edge)
                    for i in (-1, 1)
                    for k in (-1, 1)
                ),
            ]
        )
        return join([wood, body, face, back])
    claws = []
    for s in (-1, 1):  # claws bend towards the handle
        path = bend(
            (-0.35 * head, start, s * 0.45 * half),
            (0.35 * head, 0, 0),
            (0, 0.38 * head, 0),
            0,
            65,
            6,
        )
        claws.append(
            sweep(
                path,
                flat_bar(0.6 * half, 0.5 * half),
                _UP,
                factors=(1.2, 1.1, 1, 0.9, 0.8, 0.7, 0.6),
            )
        )
    return join([wood, body, face, *claws])


def _screwdriver(draw: Draw) -> Solid:
    length = draw.longest()
    radius = draw.width(0.08 * length, 0.14 * length) / 2
    grip = length * draw.uniform(0.35, 0.5)
    shaft = max(0.3 * radius, 0.001 + 0.0 * radius)
    blade = 0.1 * length
    steel = cylinder(shaft, length - grip - 0.6 * blade).turned("y", math.pi / 2)
    steel = steel.moved(-0.02 * length)
    end = length - grip
    wide = shaft * draw.uniform(1, 1.6)
    tip = convex(
        [
            *((end - blade, j * shaft * 0.7, k * shaft * 0.7) for j in (-1, 1) for k in (-1, 1)),
            *((end - 0.3 * blade, j * wide, k * shaft * 0.5) for j in (-1, 1) for k in (-1, 1)),
            *((end, j * wide, k * shaft * 0.3) for j in (-1, 1) for k in (-1, 1)),
        ]
    )
    return join([_handle(draw, grip, radius), steel, tip])


def _brush(draw: Draw) -> Solid:
    length = draw.longest()
    radius = draw.width(0.04 * length, 0.09 * length) / 2
    wide = length * draw.uniform(0.12, 0.25)
    thick = draw.sturdy(0.04 * length, 0.4)
    ferrule = length * draw.uniform(0.1, 0.15)
    hair = length * draw.uniform(0.15, 0.25)
    handle = _handle(draw, length - ferrule - hair, radius).moved(0.03 * length)
    head = block(ferrule, wide, thick).moved(ferrule / 2)
    flare = wide * draw.uniform(0.9, 1.15)
    bristles = convex(
        [
            *((0.9 * ferrule, j * 0.47 * wide, k * 0.42 * thick) for j in (-1, 1) for k in (-1, 1)),
            *((ferrule + hair, j * flare / 2, k * 0.25 * thick) for j in (-1, 1) for k in (-1, 1)),
        ]
    )
    return join([handle, head, bristles])


def _scrubber(draw: Draw) -> Solid:
    """A brush with its bristles across the handle."""
    length = draw.longest()
    wide, thick = length * draw.uniform(0.12, 0.2), draw.sturdy(0.04 * length, 0.6)
    head = length * draw.uniform(0.35, 0.5)
    back = block(head, wide, thick).moved(head / 2)
    hair = block(0.9 * head, 0.85 * wide, length * draw.uniform(0.06, 0.12))
    hair = hair.moved(head / 2, 0, -hair.extents[2] / 2)
    handle = block(length - head, wide * draw.uniform(0.3, 0.6), thick)
    return join([back, hair, handle.moved(-(length - head) / 2 + 0.02 * length)])


def _knife(draw: Draw) -> Solid:
    length = draw.longest()
    grip = length * draw.uniform(0.35, 0.45)
    high = draw.sturdy(length * draw.uniform(0.06, 0.12), 0.4)
    thick = draw.wall(0.02 * length)
    blade = length - grip
    spine, edge = 0.5 * thick, 0.25 * thick
    profile = [
        (-0.03 * length, 0.5 * high),
        (blade, 0.45 * high),
        (0.8 * blade, -0.1 * high),
        (0.6 * blade, -0.4 * high),
        (-0.03 * length, -0.5 * high),
    ]
    half = [spine, 0.5 * spine, edge, edge, edge]
    corners = [(x, s * t, z) for (x, z), t in zip(profile, half, strict=True) for s in (-1, 1)]
    handle = block(grip, max(3 * thick, 0.25 * high), 0.9 * high).moved(-grip / 2)
    return join([convex(corners), handle])


def _trowel(draw: Draw) -> Solid:
    """A shovel: a flat or pointed blade, a bent neck and a handle above it."""
    length = draw.longest()
    radius = draw.width(0.05 * length, 0.09 * length) / 2
    blade, wide = 0.4 * length, length * draw.uniform(0.18, 0.3)
    thick = draw.wall(0.02 * length)
    grip = 0.4 * length
    corners = [(0, -wide / 2), (0.6 * blade, -wide / 2), (blade, -0.1 * wide)]
    outline = [*corners, *((x, -y) for x, y in corners)]
    plate = convex([(x, y, k * thick / 2) for x, y in outline for k in (-1, 1)])
    lift = 0.12 * length
    neck = max(0.4 * radius, thick)
    path = [
        (0.1 * blade, 0, 0.5 * neck),
        (-0.05 * length, 0, 0.25 * lift),
        (-0.1 * length, 0, 0.75 * lift),
        (-0.2 * length - 0.04 * length, 0, lift),
    ]
    shank = sweep(path, oval(neck, neck, 8), (0, 1, 0))
    return join([plate, shank, _handle(draw, grip, radius).moved(-0.2 * length, 0, lift)])


def _magnifier(draw: Draw) -> Solid:
    length = draw.longest()
    outer = length * draw.uniform(0.17, 0.24)
    rim = draw.sturdy(0.12 * outer)
    thick = draw.sturdy(0.2 * outer, 0.6)
    frame = revolve_ring(
        [
            (outer - rim, -thick / 2),
            (outer, -thick / 2),
            (outer, thick / 2),
            (outer - rim, thick / 2),
        ]
    )
    parts = [frame.moved(outer - 0.3 * rim)]
    if draw.chance(0.5):
        lens = cylinder(outer - 0.5 * rim, 0.4 * thick).moved(outer - 0.3 * rim, 0, -0.2 * thick)
        parts.append(lens)
    radius = draw.width(0.05 * length, 0.09 * length) / 2
    return join([*parts, _handle(draw, length - 2 * outer, radius)])


def _wand(draw: Draw) -> Solid:
    """A handle with a ball, a cube or a disc on it: rattle, drumstick, lollipop, meat mallet."""
    length = draw.longest()
    radius = draw.width(0.03 * length, 0.06 * length) / 2
    size = length * draw.uniform(0.1, 0.2)
    heads = (
        ball(size),
        block(1.6 * size, 1.6 * size, 1.6 * size),
        cylinder(size, 0.5 * size).moved(z=-0.25 * size),
        rod(0.6 * size, 2.4 * size).turned("x", math.pi / 2),
    )
    head = draw.choice(heads)
    half = head.extents[0] / 2
    return join([_handle(draw, length - 2 * half, radius).moved(0.3 * radius), head.moved(half)])


def _roller(draw: Draw) -> Solid:
    """A rolling pin or paint roller."""
    length = draw.longest(0.3)
    radius = length * draw.uniform(0.07, 0.14)
    core = length * draw.uniform(0.5, 0.65)
    grip = radius * draw.uniform(0.35, 0.6)
    side = (length - core) / 2
    line = [(0.6 * grip, 0), (grip, 0.2 * side), (0.8 * grip, side), (radius, side)]
    return revolve([*line, *((r, length - z) for r, z in line[::-1])])


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "hammer": _hammer,
    "screwdriver": _screwdriver,
    "paint-brush": _brush,
    "scrubber": _scrubber,
    "knife": _knife,
    "trowel": _trowel,
    "magnifier": _magnifier,
    "wand": _wand,
    "roller": _roller,
}
"""Shapes of the family by name."""
