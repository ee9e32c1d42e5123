"""Bodies of revolution: what stands in a kitchen or comes off a lathe."""

from __future__ import annotations

import math
from collections.abc import Callable

from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.revolve import Profile, arc, revolve
from graspmap.simulation.procedural.solid import Solid

Points = list[tuple[float, float]]

_LEAST_CAVITY = 0.3  # radius of a cavity over the radius outside


def hollow(outer: Profile, wall: float, floor: float) -> Solid:
    """A vessel: the body under ``outer``, emptied down to a floor.

    Args:
        outer: Points (radius, z), z rising from 0.
        wall: Thickness of the wall, across the axis at the rim, about across it elsewhere.
        floor: z of the cavity's flat bottom.
    """
    return revolve(outer, inside(outer, wall, floor))


def inside(outer: Profile, wall: float, floor: float) -> Points:
    """The cavity under a wall of one thickness; its floor lies at most at 0.6 of the height."""
    floor = min(floor, 0.6 * outer[-1][1])
    line: Points = []
    for i, (r, z) in enumerate(outer):
        (r0, z0), (r1, z1) = outer[max(i - 1, 0)], outer[min(i + 1, len(outer) - 1)]
        # Across a slanting wall the horizontal way through it is longer.
        slant = math.hypot(r1 - r0, z1 - z0) / max(z1 - z0, 1e-9)
        line.append((max(r - wall * min(slant, 4), _LEAST_CAVITY * r), z))
    above = [p for p in line if p[1] > floor + 0.001]
    start = next(i for i, p in enumerate(line) if p[1] > floor + 0.001)
    (r0, z0), (r1, z1) = line[max(start - 1, 0)], line[start]
    share = (floor - z0) / (z1 - z0) if z1 > z0 else 0.0
    bottom = r0 + (r1 - r0) * min(max(share, 0), 1)
    return [(bottom, floor), *above]


def cup_line(draw: Draw, height: float, radius: float) -> Points:
    """The outside of a cup: straight, slanting or bellied, on a rounded foot."""
    foot = radius * draw.uniform(0.7, 1)
    round_off = draw.uniform(0.05, 0.3) * radius
    belly = draw.uniform(-0.03, 0.1) * radius
    line = arc((foot - round_off, round_off), (round_off, round_off), -90, 0, 3)
    for i in range(1, 6):
        share = i / 5
        r = foot + (radius - foot) * share + belly * math.sin(math.pi * share)
        line.append((r, round_off + (height - round_off) * share))
    return line


def bowl_line(radius: float, depth: float, foot: float, steps: int = 7) -> Points:
    """The outside of a bowl: a quarter of an ellipse on a flat foot."""
    start = math.degrees(math.asin(min(foot / radius, 0.9)))
    line = arc((0, depth), (radius, depth), -90 + start, 0, steps)
    lowest = line[0][1]
    factor = depth / (depth - lowest)
    return [(r, (z - lowest) * factor) for r, z in line]


def _cup(draw: Draw) -> Solid:
    height = draw.longest(0.8)
    radius = height * draw.uniform(0.3, 0.5)
    wall = draw.wall(0.2 * radius)
    return hollow(cup_line(draw, height, radius), wall, 1.2 * wall)


def _bowl(draw: Draw) -> Solid:
    radius = draw.longest() / 2
    depth = radius * draw.uniform(0.4, 0.95)
    wall = draw.wall(0.15 * radius)
    line = bowl_line(radius, depth, radius * draw.uniform(0.3, 0.5))
    return hollow(line, wall, 1.2 * wall)


def _plate(draw: Draw) -> Solid:
    radius = draw.longest() / 2
    foot = radius * draw.uniform(0.5, 0.65)
    height = draw.sturdy(radius * draw.uniform(0.12, 0.25), 0.33)
    wall = draw.wall(0.33 * height)
    bend = foot + 0.1 * radius
    line = [(foot, 0), (bend, 0.4 * height), (radius, height - wall), (radius, height)]
    # Across its slant the wall would be thinner than straight up.
    well = [
        (foot - 0.3 * wall, wall),
        (bend - 0.3 * wall, 0.4 * height + 1.2 * wall),
        (radius - wall, height),
    ]
    return revolve(line, well)


def _bottle(draw: Draw) -> Solid:
    height = draw.longest(0.35)
    radius = height * draw.uniform(0.13, 0.22)
    neck = radius * draw.uniform(0.25, 0.5)
    shoulder = height * draw.uniform(0.45, 0.65)
    slope = draw.uniform(0.12, 0.25) * height
    foot = 0.12 * radius
    line = arc((radius - foot, foot), (foot, foot), -90, 0, 2)
    line += arc((neck, shoulder), (radius - neck, slope), 0, 75, 4)
    lip = shoulder + slope + 0.55 * (height - shoulder - slope)
    cap = neck * draw.uniform(1.08, 1.3)
    line += [
        (neck, max(lip, line[-1][1] + 0.01 * height)),
        (cap, lip + 0.012 * height),
        (cap, height),
    ]
    if draw.chance(0.5):  # closed by its cap
        return revolve(line)
    wall = draw.wall(0.4 * neck)
    return hollow(line, wall, height * draw.uniform(0.6, 0.97))


def _vase(draw: Draw) -> Solid:
    height = draw.longest(0.5)
    waves = [draw.uniform(-1, 1), draw.uniform(-0.6, 0.6)]
    middle = height * draw.uniform(0.16, 0.26)
    slimmest = 2.5 * draw.ranges.wall_m[0]
    line = []
    for i in range(13):
        share = i / 12
        bulge = waves[0] * math.sin(math.pi * (1.6 * share + 0.1))
        bulge += waves[1] * math.sin(2 * math.pi * share)
        line.append((max(middle * (1 + 0.45 * bulge), slimmest), height * share))
    least = min(r for r, _ in line)
    wall = draw.wall(0.4 * least)
    return hollow(line, wall, max(1.2 * wall, 0.02 * height))


def _goblet(draw: Draw) -> Solid:
    height = draw.longest(0.45)
    radius = height * draw.uniform(0.2, 0.28)
    stem = draw.sturdy(height * draw.uniform(0.02, 0.035), 1.6)
    bowl = height * draw.uniform(0.4, 0.55)  # its height
    foot = radius * draw.uniform(0.7, 1)
    start = height - bowl
    line = [
        (foot, 0),
        (foot, draw.sturdy(0.01 * height)),
        (0.35 * foot, draw.sturdy(0.01 * height) + 0.02 * height),
        (stem, draw.sturdy(0.01 * height) + 0.07 * height),
        (stem, start - 0.05 * height),
    ]
    narrow = draw.uniform(0.8, 1.05)
    for i in range(8):
        t = math.pi / 2 * i / 7
        r = stem + (radius - stem) * math.sin(t) ** 0.8
        share = 1 - math.cos(t)
        line.append((r * (1 - (1 - narrow) * share**2), start + bowl * share**0.9))
    wall = draw.wall(0.1 * radius)
    return hollow(line, wall, start + max(2 * wall, 0.1 * bowl))


def _bulb(draw: Draw) -> Solid:
    height = draw.longest(0.55)
    radius = height * draw.uniform(0.25, 0.33)
    socket = radius * draw.uniform(0.4, 0.5)
    base = 0.27 * height
    line = [(0.5 * socket, 0), (socket, 0.04 * height), (socket, base)]
    start = math.degrees(math.asin((socket * 1.1) / radius))
    line += arc((0, height - radius), (radius, radius), -90 + start, 90, 12)
    return revolve(line)


def _funnel(draw: Draw) -> Solid:
    radius = draw.longest(0.5) / 2
    stem = radius * draw.uniform(0.1, 0.2)
    cone = radius * draw.uniform(0.7, 1.3)
    spout = radius * draw.uniform(0.5, 1)
    wall = draw.wall(0.25 * radius)
    tip = stem + wall
    line = [(tip, 0), (tip * 1.15, spout), (radius, spout + cone), (radius, spout + cone * 1.15)]
    return hollow(line, wall, spout * 0.2)


def _spindle(draw: Draw) -> Solid:
    """A turned leg or a chess pawn: a random lathe profile without cavity."""
    height = draw.longest(0.3)
    middle = height * draw.uniform(0.08, 0.2)
    line: Points = []
    z = 0.0
    for _ in range(draw.integer(3, 6)):
        r, step = middle * draw.uniform(0.45, 1.2), draw.uniform(0.4, 1)
        kind = draw.choice(("bead", "straight", "cone"))
        if kind == "bead":
            line += arc((0.5 * r, z + step), (0.5 * r, step), -90, 90, 6)
            z += 2 * step
        else:
            top = r if kind == "straight" else r * draw.uniform(0.5, 1.5)
            line += [(r, z), (top, z + 2 * step)]
            z += 2 * step
    return revolve([(r, height * at / z) for r, at in line])


def _pawn(draw: Draw) -> Solid:
    height = draw.longest(0.5)
    foot, ball = height * draw.uniform(0.2, 0.27), height * draw.uniform(0.12, 0.17)
    neck = ball * draw.uniform(0.45, 0.6)
    top = height - 2 * ball
    line = [(foot, 0), (foot, 0.07 * height), (0.8 * foot, 0.12 * height)]
    line += [
        (neck + (0.6 * foot - neck) * (1 - s) ** 2, 0.12 * height + s * (top - 0.16 * height))
        for s in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    line += [(1.1 * ball, top - 0.03 * height), (1.1 * ball, top)]
    start = math.degrees(math.asin(neck / ball))
    line += arc((0, height - ball), (ball, ball), -90 + start, 90, 10)
    return revolve(line)


def _spool(draw: Draw) -> Solid:
    height = draw.longest(0.8)
    rim = height * draw.uniform(0.3, 0.5)
    core, flange = rim * draw.uniform(0.35, 0.7), height * draw.uniform(0.08, 0.18)
    return revolve(
        [
            (rim, 0),
            (rim, flange),
            (core, flange),
            (core, height - flange),
            (rim, height - flange),
            (rim, height),
        ]
    )


def _top(draw: Draw) -> Solid:
    """A spinning top, plumb bob or onion dome."""
    height = draw.longest(0.6)
    radius = height * draw.uniform(0.3, 0.45)
    stem = radius * draw.uniform(0.1, 0.25)
    belly = height * draw.uniform(0.3, 0.5)
    return revolve(
        [
            (0.03 * radius, 0),
            (radius, belly),
            (radius, belly * 1.2),
            (stem * 1.5, belly * 1.6),
            (stem, belly * 1.65),
            (stem, height),
        ]
    )


def _dumbbell(draw: Draw) -> Solid:
    length = draw.longest(0.3)
    radius = length * draw.uniform(0.12, 0.2)
    bar, head = radius * draw.uniform(0.3, 0.6), length * draw.uniform(0.15, 0.28)
    edge = 0.15 * radius
    end = [(radius - edge, 0), (radius, edge), (radius, head - edge), (radius - edge, head)]
    return revolve([*end, (bar, head), *((r, length - z) for r, z in [(bar, head), *end[::-1]])])


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "cup": _cup,
    "bowl": _bowl,
    "plate": _plate,
    "bottle": _bottle,
    "vase": _vase,
    "goblet": _goblet,
    "bulb": _bulb,
    "funnel": _funnel,
    "spindle": _spindle,
    "pawn": _pawn,
    "spool": _spool,
    "top": _top,
    "dumbbell": _dumbbell,
}
"""Shapes of the family by name."""
