"""Shells, rings and frames: hollow things that are held by a wall."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from shapely import box

from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.outline import Outline, regular
from graspmap.simulation.procedural.primitives import block
from graspmap.simulation.procedural.revolutions import bowl_line, hollow
from graspmap.simulation.procedural.revolve import arc, revolve_ring
from graspmap.simulation.procedural.solid import Floats, Solid, join
from graspmap.simulation.procedural.sweep import bend, flat_bar, oval, sweep


def _ring(draw: Draw) -> Solid:
    outer = draw.longest() / 2
    wall = draw.width(0.1 * outer, 0.3 * outer)
    high = wall * draw.uniform(0.4, 2.5)
    inner = outer - wall
    bevel = 0.25 * min(wall, high) if draw.chance(0.5) else 0.0
    if bevel == 0:
        return revolve_ring([(inner, 0), (outer, 0), (outer, high), (inner, high)])
    return revolve_ring(
        [
            (inner, 0),
            (outer - bevel, 0),
            (outer, bevel),
            (outer, high - bevel),
            (outer - bevel, high),
            (inner, high),
        ]
    )


def _torus(draw: Draw) -> Solid:
    outer = draw.longest() / 2
    tube = draw.sturdy(outer * draw.uniform(0.12, 0.35), 1.4)
    path = bend((0, 0, 0), (outer - tube, 0, 0), (0, outer - tube, 0), 0, 360, 48)[:-1]
    return sweep(path, oval(tube, tube * draw.uniform(0.7, 1.3), 16), (0, 0, 1), closed=True)


def _tube(draw: Draw) -> Solid:
    ratio = draw.even_log(0.4, 8)  # length over diameter
    longest = draw.longest(min(1, 1 / ratio))
    outer, high = longest * min(1, 1 / ratio) / 2, longest * min(1, ratio)
    wall = draw.wall(0.5 * outer)
    inner = max(outer - wall, 0.3 * outer)
    return revolve_ring([(inner, 0), (outer, 0), (outer, high), (inner, high)])


def _square_tube(draw: Draw) -> Solid:
    length = draw.longest(0.3)
    wide = length * draw.uniform(0.15, 0.5)
    high = wide * draw.uniform(0.5, 1)
    wall = draw.wall(0.25 * high)
    hole = box(wall, wall, wide - wall, high - wall)
    return Outline.of(box(0, 0, wide, high).difference(hole)).plate(length)


def _half_shell(draw: Draw) -> Solid:
    radius = draw.longest() / 2
    wall = draw.wall(0.15 * radius)
    line = bowl_line(radius, radius * draw.uniform(0.7, 1), 0.15 * radius, 8)
    return hollow(line, wall, 1.1 * wall).turned("x", math.pi)


def _dish(draw: Draw) -> Solid:
    """A boat-like bowl: longer than wide."""
    length = draw.longest()
    wall = draw.wall(0.03 * length)
    line = bowl_line(length / 2, length * draw.uniform(0.15, 0.3), 0.2 * length, 6)
    return hollow(line, 1.3 * wall, 1.3 * wall).stretched(y=draw.uniform(0.6, 0.85))


def _gutter(draw: Draw) -> Solid:
    """A part of a tube's wall."""
    length = draw.longest()
    radius = length * draw.uniform(0.12, 0.4)
    wall = max(draw.wall(0.3 * radius), 0.05 * radius)
    half = draw.uniform(60, 130)
    middle = radius - wall / 2
    path = bend((0, 0, 0), (middle, 0, 0), (0, middle, 0), -half, half, 18)
    section = flat_bar(wall, length, 0.0)
    corners = np.array([section[i] for i in (0, 2, 4, 6)])
    return sweep(path, corners, (0, 0, 1))


def _open_box(draw: Draw) -> Solid:
    length = draw.longest(0.4)
    wide, high = length * draw.uniform(0.4, 1), length * draw.uniform(0.15, 0.7)
    return tray(length, wide, high, draw.wall(0.12 * min(wide, high)), 0)


def tray(length: float, wide: float, high: float, wall: float, inner_walls: int) -> Solid:
    """A box without lid, its bottom at z = 0, divided along its length."""
    parts = [block(length, wide, wall).moved(z=wall / 2)]
    for s in (-1, 1):
        parts.append(block(wall, wide, high).moved(s * (length - wall) / 2, 0, high / 2))
        parts.append(block(length, wall, high).moved(0, s * (wide - wall) / 2, high / 2))
    for i in range(inner_walls):
        x = length * ((i + 1) / (inner_walls + 1) - 0.5)
        parts.append(block(wall, wide - wall, 0.9 * high).moved(x, 0, 0.45 * high))
    return join(parts)


def _divided_tray(draw: Draw) -> Solid:
    length = draw.longest(0.4)
    wide, high = length * draw.uniform(0.3, 0.8), length * draw.uniform(0.12, 0.35)
    wall = draw.wall(0.12 * min(wide, high))
    return tray(length, wide, high, wall, draw.integer(1, 3))


def _frame(draw: Draw) -> Solid:
    length = draw.longest()
    wide = length * draw.uniform(0.4, 1)
    bar = draw.width(0.06 * wide, 0.22 * wide)
    hole = box(bar, bar, length - bar, wide - bar)
    thick = bar * draw.uniform(0.4, 1.5)
    return Outline.of(box(0, 0, length, wide).difference(hole)).plate(thick)


def _polygon_ring(draw: Draw) -> Solid:
    corners = draw.integer(3, 8)
    outer = draw.longest() / 2
    share = draw.uniform(0.5, 0.85)
    shape = regular(corners, outer).difference(regular(corners, share * outer))
    return Outline.of(shape).plate(outer * draw.uniform(0.08, 0.5))


def _link(draw: Draw) -> Solid:
    """A chain link: two half circles joined by straight bars."""
    length = draw.longest()
    wire = draw.width(0.06 * length, 0.14 * length) / 2
    radius = length * draw.uniform(0.2, 0.3) - wire
    straight = length / 2 - wire - radius
    halves: list[Floats] = [
        bend((straight, 0, 0), (radius, 0, 0), (0, radius, 0), -90, 90, 16),
        bend((-straight, 0, 0), (radius, 0, 0), (0, radius, 0), 90, 270, 16),
    ]
    return sweep(np.concatenate(halves), oval(wire, wire), (0, 0, 1), closed=True)


def _arch(draw: Draw) -> Solid:
    """A horseshoe or bridge."""
    outer = draw.longest() / 2
    bar = draw.width(0.15 * outer, 0.4 * outer)
    middle = outer - bar / 2
    half = draw.uniform(80, 140)
    path = bend((0, 0, 0), (middle, 0, 0), (0, middle, 0), 90 - half, 90 + half, 24)
    return sweep(path, flat_bar(bar, bar * draw.uniform(0.4, 1.6), 0.1), (0, 0, 1))


def _lid(draw: Draw) -> Solid:
    """A jar's lid, open side down."""
    radius = draw.longest() / 2
    high = radius * draw.uniform(0.2, 0.6)
    wall = draw.wall(0.25 * high)
    edge = 0.1 * high
    line = [(radius - edge, 0), (radius, edge), (radius, high)]
    return hollow(line, wall, wall + edge).turned("x", math.pi)


def _dome_shell(draw: Draw) -> Solid:
    """A bell: an arched shell with a knob."""
    height = draw.longest(0.7) * 0.8
    radius = height * draw.uniform(0.5, 0.62)
    wall = draw.wall(0.12 * radius)
    line = arc((0, radius), (0.7 * radius, radius), -65, -10, 5)
    line = [(r, z - line[0][1]) for r, z in line]
    line += [(0.75 * radius, 0.8 * height), (radius, height)]
    shell = hollow(line, wall, 1.3 * wall).turned("x", math.pi)
    knob = 0.12 * radius
    path = bend((0, 0, 0.6 * knob), (2 * knob, 0, 0), (0, 0, 2.2 * knob), 0, 180, 12)
    path[[0, -1], 2] = -0.3 * wall
    return join([shell, sweep(path, oval(0.6 * knob, 0.6 * knob, 8), (0, 1, 0))])


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "ring": _ring,
    "torus": _torus,
    "tube": _tube,
    "square-tube": _square_tube,
    "half-shell": _half_shell,
    "dish": _dish,
    "gutter": _gutter,
    "open-box": _open_box,
    "divided-tray": _divided_tray,
    "frame": _frame,
    "polygon-ring": _polygon_ring,
    "link": _link,
    "arch": _arch,
    "lid": _lid,
    "bell": _dome_shell,
}
"""Shapes of the family by name."""
