"""Vessels with handles: what is held by the handle, the rim or the body."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.primitives import block
from graspmap.simulation.procedural.revolutions import Points, bowl_line, cup_line, hollow
from graspmap.simulation.procedural.revolve import arc, revolve
from graspmap.simulation.procedural.solid import Floats, Solid, join
from graspmap.simulation.procedural.sweep import bend, flat_bar, oval, sweep

_SIDE = (0.0, 1.0, 0.0)  # normal of the plane of a handle that leaves the body along x


def radius_at(line: Points, z: float) -> float:
    """Radius of a profile at a height."""
    heights = [p[1] for p in line]
    return float(np.interp(z, heights, [p[0] for p in line]))


def ear(
    line: Points,
    low: float,
    high: float,
    reach: float,
    thick: float,
    wide: float,
    wall: float,
    *,
    square: bool = False,
) -> Solid:
    """A handle from the wall at one height out to ``reach`` from it and back at another.

    Args:
        line: Outside of the body, (radius, z).
        low: Height of its lower end.
        high: Height of its upper end.
        reach: How far its middle line stands off the body.
        thick: Thickness in its plane.
        wide: Width across its plane.
        wall: Thickness of the body's wall, into which its ends go half way.
        square: Its corners are tight.
    """
    bottom, top = radius_at(line, low), radius_at(line, high)
    power = 0.45 if square else 0.8
    turns = [math.pi * i / 14 for i in range(15)]
    path = []
    for t in turns:
        share = (1 - math.copysign(abs(math.cos(t)) ** power, math.cos(t))) / 2
        out = abs(math.sin(t)) ** power if 0 < t < 3.14 else 0.0
        path.append(
            (bottom + (top - bottom) * share + reach * out, 0.0, low + (high - low) * share)
        )
    # The ends enter the wall, but deeper where it is round and the handle wide.
    sink = 0.5 * wall + (wide / 2) ** 2 / (2 * bottom)
    for end in (0, -1):
        x, y, z = path[end]
        path[end] = (x - min(sink, 0.75 * wall), y, z)
    return sweep(_evenly(path), flat_bar(thick, wide), _SIDE)


def _evenly(path: list[tuple[float, float, float]], count: int = 13) -> Floats:
    """Points at equal distances along a path, both ends kept."""
    points = np.array(path)
    steps = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1))
    far = np.concatenate([[0], np.cumsum(steps)])
    at = np.linspace(0, far[-1], count)
    return np.stack([np.interp(at, far, points[:, i]) for i in range(3)], axis=1)


def _mug(draw: Draw) -> Solid:
    height = draw.longest(0.85)
    radius = height * draw.uniform(0.35, 0.48)
    wall = draw.wall(0.2 * radius)
    line = cup_line(draw, height, radius)
    body = hollow(line, wall, 1.3 * wall)
    thick = draw.sturdy(0.06 * height)
    handle = ear(
        line,
        height * draw.uniform(0.15, 0.3),
        height * draw.uniform(0.75, 0.9),
        height * draw.uniform(0.25, 0.38),
        thick,
        thick * draw.uniform(1.2, 2.2),
        wall,
        square=draw.chance(0.4),
    )
    return join([body, handle])


def _teacup(draw: Draw) -> Solid:
    radius = draw.longest(0.6) / 2
    depth = radius * draw.uniform(0.9, 1.2)
    wall = draw.wall(0.12 * radius)
    line = bowl_line(radius, depth, 0.45 * radius, 6)
    body = hollow(line, wall, 1.3 * wall)
    thick = draw.sturdy(0.12 * depth)
    handle = ear(line, 0.4 * depth, 0.88 * depth, 0.4 * depth, thick, thick, wall)
    return join([body, handle])


def _pot(draw: Draw) -> Solid:
    """A pot with two ears."""
    width = draw.longest(0.5)
    radius = width * draw.uniform(0.36, 0.4)
    height = radius * draw.uniform(0.7, 1.4)
    wall = draw.wall(0.15 * radius)
    line = [(0.9 * radius, 0), (radius, 0.1 * radius), (radius, height)]
    reach = width / 2 - radius
    thick = draw.sturdy(0.25 * reach)
    # A flat ear: its plane is horizontal.
    half = radius * draw.uniform(0.25, 0.4)
    x = math.sqrt((radius - 0.5 * wall) ** 2 - half**2)
    path = bend(
        (x, 0, 0.75 * height), (radius + reach - thick / 2 - x, 0, 0), (0, half, 0), -90, 90, 12
    )
    handle = sweep(path, oval(thick / 2, thick / 2, 8), (0, 0, 1))
    other = handle.turned("z", math.pi)
    return join([hollow(line, wall, 1.2 * wall), handle, other])


def _pan(draw: Draw) -> Solid:
    length = draw.longest()
    radius = length * draw.uniform(0.24, 0.3)
    height = draw.sturdy(radius * draw.uniform(0.2, 0.6), 0.33)
    wall = draw.wall(0.15 * height)
    line = [(0.8 * radius, 0), (radius - 0.3 * wall, 0.85 * height), (radius, height)]
    body = hollow(line, wall, 1.2 * wall)
    thick = draw.sturdy(0.02 * length, 0.8)
    lift = draw.uniform(0, 0.12) * length
    z = 0.75 * height
    start = radius_at(line, z) - 0.6 * wall
    path = [
        (start, 0, z),
        (start + 0.12 * length, 0, z + 0.6 * lift),
        (length - radius, 0, z + lift),
    ]
    handle = sweep(
        path, flat_bar(thick, thick * draw.uniform(1, 2.2)), _SIDE, factors=(0.8, 0.9, 1.1)
    )
    return join([body, handle])


def _ladle(draw: Draw) -> Solid:
    length = draw.longest()
    radius = length * draw.uniform(0.12, 0.17)
    wall = draw.wall(0.12 * radius)
    line = bowl_line(radius, radius * 0.8, 0.3 * radius, 6)
    body = hollow(line, wall, 1.2 * wall)
    thick = draw.sturdy(0.018 * length, 0.6)
    x, z = radius - 0.5 * wall, 0.7 * radius
    reach = length - 2 * radius
    steep = math.radians(draw.uniform(20, 80))
    end = (x + reach * math.cos(steep), 0, z + reach * math.sin(steep))
    handle = sweep(
        [(x, 0, z), (x + 0.02 * length, 0, z + 0.03 * length), end],
        flat_bar(0.6 * thick, thick),
        _SIDE,
    )
    return join([body, handle])


def _spoon(draw: Draw) -> Solid:
    length = draw.longest()
    wall = draw.wall(0.012 * length)
    half = length * draw.uniform(0.12, 0.17)
    line = bowl_line(half, max(0.45 * half, 2.2 * wall), 0.35 * half, 5)
    body = hollow(line, wall, 1.1 * wall).stretched(y=draw.uniform(0.6, 0.8))
    depth = line[-1][1]
    thick = draw.sturdy(0.012 * length, 0.7)
    start, stop = half - 0.8 * wall, length - half
    path = [
        (start + (stop - start) * s, 0, depth - 0.6 * thick + 0.05 * length * math.sin(3 * s))
        for s in (0, 0.1, 0.25, 0.5, 0.75, 1)
    ]
    handle = sweep(
        path, flat_bar(thick, 2.2 * thick), _SIDE, factors=(0.9, 0.75, 0.7, 0.85, 1.1, 1.3)
    )
    return join([body, handle])


def _watering_can(draw: Draw) -> Solid:
    height = draw.longest(0.5) * 0.62
    radius = height * draw.uniform(0.35, 0.5)
    wall = draw.wall(0.1 * radius)
    line = [(radius, 0), (radius, height * 0.9), (0.7 * radius, height)]
    body = hollow(line, wall, 1.2 * wall)
    tip = (-(radius + height * draw.uniform(0.5, 0.7)), 0, height * draw.uniform(0.85, 1.1))
    bore = draw.sturdy(0.07 * height, 1.4)
    spout = sweep(
        [(-(radius - 0.6 * wall), 0, 0.25 * height), tip],
        oval(bore, bore),
        _SIDE,
        factors=(1.3, 0.7),
    )
    low = [(radius, 0.0), (radius, height)]
    thick = draw.sturdy(0.07 * height)
    handle = ear(low, 0.25 * height, 0.8 * height, 0.4 * height, thick, 1.3 * thick, wall)
    return join([body, spout, handle])


def _teapot(draw: Draw) -> Solid:
    size = draw.longest(0.6) * 0.55
    radius, height = size / 2, 0.8 * size
    line = arc((0, height / 2), (radius, height / 2), -65, 65, 8)
    low = line[0][1]
    line = [(r, z - low) for r, z in line]
    top = line[-1][1]
    knob = 0.12 * size
    line += [(0.4 * knob, top + 0.03 * size)]
    line += arc((0, top + 0.06 * size + 0.5 * knob), (0.6 * knob, 0.5 * knob), -60, 90, 5)
    wall = 0.1 * radius
    belly = [p for p in line if p[1] <= top]
    handle = ear(belly, 0.25 * top, 0.8 * top, 0.35 * size, 0.07 * size, 0.09 * size, wall)
    start = -(radius_at(belly, 0.3 * top) - wall)
    path = [
        (start, 0, 0.3 * top),
        (start - 0.22 * size, 0, 0.5 * top),
        (start - 0.34 * size, 0, 0.8 * top),
        (start - 0.42 * size, 0, 1.0 * top),
    ]
    spout = sweep(path, oval(0.09 * size, 0.09 * size), _SIDE, factors=(1.3, 0.9, 0.65, 0.5))
    return join([revolve(line), handle, spout])


def _bucket(draw: Draw) -> Solid:
    height = draw.longest(0.7) * 0.6
    radius = height * draw.uniform(0.45, 0.6)
    wall = draw.wall(0.12 * radius)
    line = [(radius * draw.uniform(0.7, 0.95), 0), (radius, height)]
    body = hollow(line, wall, 1.2 * wall)
    thick = draw.sturdy(0.03 * height, 2)
    middle = radius - 0.5 * wall
    rise = height * draw.uniform(0.55, 0.65)
    path = bend((0, 0, height - 0.04 * height), (middle, 0, 0), (0, 0, rise), 0, 180, 16)
    # The feet of the bow stand in the rim.
    return join([body, sweep(path, oval(thick, thick, 8), _SIDE)])


def _basket(draw: Draw) -> Solid:
    """An open box with a bow over it."""
    length = draw.longest(0.5)
    wide, high = length * draw.uniform(0.5, 0.8), length * draw.uniform(0.25, 0.4)
    wall = draw.wall(0.1 * high)
    sides = [block(length, wide, 1.2 * wall).moved(z=0.6 * wall)]
    for s in (-1, 1):
        sides.append(block(wall, wide, high).moved(s * (length - wall) / 2, 0, high / 2))
        sides.append(block(length, wall, high).moved(0, s * (wide - wall) / 2, high / 2))
    path = bend(
        (0, 0, 0.7 * high), (0, (wide - wall) / 2, 0), (0, 0, 0.6 * length - 0.5 * high), 0, 180, 14
    )
    thick = max(wall, 0.03 * length)
    bow = sweep(path, flat_bar(wall, thick), (-1, 0, 0))
    return join([*sides, bow])


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "mug": _mug,
    "teacup": _teacup,
    "pot": _pot,
    "pan": _pan,
    "ladle": _ladle,
    "spoon": _spoon,
    "watering-can": _watering_can,
    "teapot": _teapot,
    "bucket": _bucket,
    "basket": _basket,
}
"""Shapes of the family by name."""
