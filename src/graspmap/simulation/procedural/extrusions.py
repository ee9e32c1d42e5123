"""Flat shapes cut from a plate, and bars with a profile."""

from __future__ import annotations

import math
from collections.abc import Callable

import shapely
from shapely import affinity
from shapely.geometry.base import BaseGeometry

from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.letters import GLYPHS, HEIGHT, glyph
from graspmap.simulation.procedural.outline import (
    Outline,
    circle,
    polygon,
    regular,
    rounded,
    strip,
)
from graspmap.simulation.procedural.solid import Solid


def _plate(draw: Draw, shape: BaseGeometry, most: float = 0.15) -> Solid:
    """The shape cut from a plate of at most that share of its length in thickness."""
    left, low, right, high = shape.bounds
    length = max(right - left, high - low)
    return Outline.of(shape).plate(draw.even_log(draw.wall(), max(most * length, draw.wall())))


def _box(x0: float, y0: float, x1: float, y1: float) -> shapely.Polygon:
    return shapely.box(x0, y0, x1, y1)


def _wrench(draw: Draw) -> Solid:
    length = draw.longest()
    head = length * draw.uniform(0.09, 0.13)  # radius
    half = head * draw.uniform(0.35, 0.6)
    jaw = head * draw.uniform(0.8, 1.1)  # opening
    x = length / 2 - head
    turn = draw.choice((0, 15, 15))
    mouth = _box(x - 0.15 * head, -jaw / 2, x + 2 * head, jaw / 2)
    open_end = circle(head, (x, 0)).difference(affinity.rotate(mouth, turn, origin=(x, 0)))
    far = head * draw.uniform(0.8, 1)
    bar = _box(-x, -half, x - 0.6 * head, half)
    if draw.chance(0.5):  # a ring at the other end
        body = shapely.union_all([bar, circle(far, (-x, 0))])
        hole = regular(6, 0.62 * far, (-x, 0))
    else:
        body = shapely.union_all([bar, circle(far, (-x, 0))])
        hole = affinity.rotate(
            _box(-x - 2 * far, -0.4 * far, -x + 0.15 * far, 0.4 * far), turn, origin=(-x, 0)
        )
    return _plate(draw, shapely.union_all([body.difference(hole), open_end]), 0.06)


def _scissors(draw: Draw) -> Solid:
    length = draw.longest()
    half_angle = math.radians(draw.uniform(4, 22))
    blade, grip = 0.52 * length, 0.48 * length
    wide = 0.045 * length
    ring = draw.uniform(0.085, 0.12) * length
    parts: list[BaseGeometry] = []
    holes: list[BaseGeometry] = []
    for side in (-1, 1):
        tip = polygon([(0, -wide), (blade, -0.1 * wide), (blade, 0.1 * wide), (0, wide)])
        shank = strip([(0.02 * length, 0), (-0.3 * grip, 0), (-grip + 1.4 * ring, 0)], 1.3 * wide)
        # The rings lie outside the line of the shanks, or they would meet.
        center = (-grip + ring, -0.55 * side * ring)
        half = [tip, shank, circle(ring, center)]
        parts += [affinity.rotate(p, side * half_angle, (0, 0), use_radians=True) for p in half]
        hole = circle(0.66 * ring, center, hole=True)
        holes.append(affinity.rotate(hole, side * half_angle, (0, 0), use_radians=True))
    pivot = circle(1.4 * wide)
    shape = shapely.union_all([*parts, pivot]).difference(shapely.union_all(holes))
    return _plate(draw, shape, 0.04)


def _pliers(draw: Draw) -> Solid:
    length = draw.longest()
    wide = 0.05 * length
    spread = draw.uniform(0.07, 0.16) * length
    jaw = 0.26 * length
    parts: list[BaseGeometry] = [circle(1.3 * wide)]
    for s in (-1, 1):
        gap = 0.1 * wide
        nose = [(0, s * gap), (jaw, s * 2 * gap), (jaw, s * 0.7 * wide), (0, s * 1.25 * wide)]
        parts.append(polygon(nose))
        points = [(0, s * 0.3 * wide), (-0.25 * length, s * spread), (-0.7 * length, s * spread)]
        parts.append(strip(points, wide, round_bends=True))
    return _plate(draw, shapely.union_all(parts), 0.06)


def _bracket(draw: Draw) -> Solid:
    a = draw.longest()
    b = a * draw.uniform(0.5, 1)
    wide = a * draw.uniform(0.15, 0.3)
    shape: BaseGeometry = shapely.union_all([_box(0, 0, a, wide), _box(0, 0, wide, b)])
    if draw.chance(0.6):
        shape = rounded(shape, 0.3 * wide)
    radius = wide * draw.uniform(0.15, 0.25)
    spots = [(0.55 * a, wide / 2), (0.85 * a, wide / 2), (wide / 2, 0.75 * b)]
    holes = [circle(radius, spot, hole=True) for spot in spots[: draw.integer(0, 3)]]
    return _plate(draw, shape.difference(shapely.union_all(holes)), 0.25)


def _profile(draw: Draw) -> Solid:
    """A bar with the section of an L, T, U, Z, I or cross."""
    length = draw.longest()
    wide = draw.width(0.05 * length, 0.5 * length)
    wall = (
        draw.wall(0.3 * wide) if draw.chance(0.5) else draw.sturdy(wide * draw.uniform(0.15, 0.3))
    )
    high = wide * draw.uniform(0.5, 1)
    left, middle = _box(0, 0, wall, high), _box((wide - wall) / 2, 0, (wide + wall) / 2, high)
    bottom, top = _box(0, 0, wide, wall), _box(0, high - wall, wide, high)
    right = _box(wide - wall, 0, wide, high)
    sections = {
        "L": [left, bottom],
        "T": [middle, top],
        "U": [left, bottom, right],
        "Z": [
            _box(0, 0, (wide + wall) / 2, wall),
            middle,
            _box((wide - wall) / 2, high - wall, wide, high),
        ],
        "I": [bottom, middle, top],
        "cross": [middle, _box(0, (high - wall) / 2, wide, (high + wall) / 2)],
    }
    return Outline.of(shapely.union_all(draw.choice(list(sections.values())))).plate(length)


def _gear(draw: Draw) -> Solid:
    radius = draw.longest(0.6) / 2
    teeth = draw.integer(8, 20)
    root = radius * (1 - min(0.3, draw.uniform(1.2, 2) * 2 / teeth))
    corners = []
    for i in range(teeth):
        for at, r in ((-0.28, root), (-0.16, radius), (0.16, radius), (0.28, root)):
            t = 2 * math.pi * (i + at) / teeth
            corners.append((r * math.cos(t), r * math.sin(t)))
    bore = root * draw.uniform(0.15, 0.6)
    return _plate(draw, polygon(corners).difference(circle(bore, hole=True)), 0.4)


def _star(draw: Draw) -> Solid:
    radius = draw.longest(0.5) / 2
    points = draw.integer(4, 8)
    inner = radius * draw.uniform(0.35, 0.65)
    corners = [
        (
            (inner if i % 2 else radius) * math.cos(math.pi * i / points),
            (inner if i % 2 else radius) * math.sin(math.pi * i / points),
        )
        for i in range(2 * points)
    ]
    return _plate(draw, rounded(polygon(corners), 0.04 * radius), 0.35)


def _letter(draw: Draw) -> Solid:
    character = draw.choice(sorted(GLYPHS))
    size = draw.longest() / HEIGHT
    shape = glyph(character, draw.uniform(0.6, 1.1))
    return _plate(draw, affinity.scale(shape, size, size, origin=(0, 0)), 0.3)


def _smooth(draw: Draw) -> Solid:
    """A random smooth outline."""
    radius = draw.longest(0.4) / 2
    waves = [(n, draw.uniform(0, 0.5) / n, draw.uniform(0, 2 * math.pi)) for n in range(2, 6)]
    corners = []
    for i in range(48):
        t = 2 * math.pi * i / 48
        r = radius * max(0.25, 1 + sum(a * math.cos(n * t + p) for n, a, p in waves))
        corners.append((r * math.cos(t), r * math.sin(t)))
    return _plate(draw, polygon(corners).simplify(0.006 * radius), 0.35)


def _holed(draw: Draw) -> Solid:
    """A plate with a grid of holes."""
    a = draw.longest()
    b = a * draw.uniform(0.3, 1)
    columns = draw.integer(1, 4)
    rows = max(1, round(columns * b / a))
    radius = min(a / columns, b / rows) * draw.uniform(0.2, 0.38)
    holes = []
    for i in range(columns):
        for j in range(rows):
            center = (a * (i + 0.5) / columns, b * (j + 0.5) / rows)
            if draw.chance(0.5):
                holes.append(circle(radius, center, hole=True))
            else:
                holes.append(regular(draw.choice((4, 6)), radius, center))
    plate = rounded(_box(0, 0, a, b), 0.1 * b)
    return _plate(draw, plate.difference(shapely.union_all(holes)), 0.15)


def _washer(draw: Draw) -> Solid:
    outer = draw.longest(0.3) / 2
    nut = draw.chance(0.5)
    body = regular(6, outer) if nut else circle(outer)
    hole = circle(outer * draw.uniform(0.3, 0.6 if nut else 0.75), hole=True)
    return _plate(draw, body.difference(hole), 0.45)


def _key(draw: Draw) -> Solid:
    length = draw.longest()
    bow = length * draw.uniform(0.15, 0.2)
    half = length * draw.uniform(0.03, 0.045)
    start, end = -length / 2, length / 2
    head = circle(bow, (start + bow, 0)) if draw.chance(0.6) else regular(6, bow, (start + bow, 0))
    hole = circle(0.6 * bow, (start + bow, 0), hole=True)
    parts = [head, _box(start + bow, -half, end, half)]
    for i in range(draw.integer(2, 4)):
        x = end - (0.03 + 0.09 * i) * length
        parts.append(_box(x - 0.05 * length, -half - draw.uniform(0.04, 0.1) * length, x, 0))
    return _plate(draw, shapely.union_all(parts).difference(hole), 0.08)


def _hook(draw: Draw) -> Solid:
    length = draw.longest()
    wide = length * draw.uniform(0.06, 0.12)
    radius = length * draw.uniform(0.18, 0.28)
    sweep = draw.uniform(180, 250)
    turns = [math.radians(180 + sweep * i / 10) for i in range(11)]
    bend = [(radius * (1 + math.cos(t)), radius * math.sin(t)) for t in turns]
    top = length - radius - wide / 2
    shape = strip([(0, top), *bend], wide)
    if draw.chance(0.6):
        eye = circle(1.1 * wide, (0, top))
        shape = shape.union(eye).difference(circle(0.6 * wide, (0, top), hole=True))
    return _plate(draw, shape, 0.1)


def _heart(draw: Draw) -> Solid:
    size = draw.longest(0.5) / 2
    turns = [2 * math.pi * i / 40 for i in range(40)]
    corners = [
        (
            size * math.sin(t) ** 3,
            size
            * (13 * math.cos(t) - 5 * math.cos(2 * t) - 2 * math.cos(3 * t) - math.cos(4 * t))
            / 16,
        )
        for t in turns
    ]
    return _plate(draw, polygon(corners).buffer(0), 0.35)


def _crescent(draw: Draw) -> Solid:
    radius = draw.longest(0.3) / 2
    shift = radius * draw.uniform(0.35, 0.7)
    bite = circle(radius * draw.uniform(0.75, 0.95), (shift, 0), hole=True)
    return _plate(draw, circle(radius).difference(bite), 0.3)


def _comb(draw: Draw) -> Solid:
    length = draw.longest()
    teeth = draw.integer(4, 9)
    pitch = length / (teeth - 0.5)
    high = length * draw.uniform(0.2, 0.5)
    back = _box(0, 0.6 * high, length, high)
    prongs = [_box(i * pitch, 0, (i + 0.5) * pitch, 0.7 * high) for i in range(teeth)]
    return _plate(draw, shapely.union_all([back, *prongs]), 0.12)


def _arrow(draw: Draw) -> Solid:
    length = draw.longest()
    half = length * draw.uniform(0.15, 0.3)
    shaft = half * draw.uniform(0.25, 0.5)
    neck = length * draw.uniform(0.5, 0.7)
    right = [(0.0, shaft), (neck, shaft), (neck, half), (length, 0.0)]
    return _plate(draw, polygon([*right, *((x, -y) for x, y in right[-2::-1])]), 0.2)


def _spatula(draw: Draw) -> Solid:
    length = draw.longest()
    half = length * draw.uniform(0.1, 0.2)
    grip = length * draw.uniform(0.03, 0.05)
    blade = length * draw.uniform(0.3, 0.45)
    shape: BaseGeometry = rounded(_box(0, -half, blade, half), 0.4 * half)
    slots = [
        _box(0.25 * blade, y - 0.09 * half, 0.8 * blade, y + 0.09 * half)
        for y in (-0.5 * half, 0, 0.5 * half)
    ]
    if half > 0.015 and draw.chance(0.5):
        shape = shape.difference(shapely.union_all(slots))
    handle = rounded(_box(-(length - blade), -grip, 0.1 * blade, grip), 0.6 * grip)
    return _plate(draw, shape.union(handle), 0.03)


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "wrench": _wrench,
    "scissors": _scissors,
    "pliers": _pliers,
    "bracket": _bracket,
    "profile": _profile,
    "gear": _gear,
    "star": _star,
    "letter": _letter,
    "outline": _smooth,
    "holed-plate": _holed,
    "washer": _washer,
    "key": _key,
    "hook": _hook,
    "heart": _heart,
    "crescent": _crescent,
    "comb": _comb,
    "arrow": _arrow,
    "spatula": _spatula,
}
"""Shapes of the family by name."""
