"""Simple objects seen from above, with the exact places where a parallel jaw holds them.

Object frame: metres on the table, x right, y down (as in the image), heights above the table.
Letters in shapes: ... the points at which a shape is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.geometry.grasps import Grasps

Floats = NDArray[Any]  # float64, or float32 for the pixels of a picture
Point = tuple[float, float]

JAWS_M = (0.01, 0.02, 0.03, 0.04, 0.06)
"""Jaw sizes with which each grasp is repeated where they fit; Jacquard's."""

MOST_OPENING_M = 0.20
"""Greatest opening; Jacquard's."""

CLEARANCE_M = 0.006
"""Air between an open jaw and the object, each side."""

_AIR_M = 0.003  # between the end of a jaw and a part in its way
_STEP_M = 0.012  # between neighbouring grasps along a bar
_END_M = 0.006  # the outermost grasps stay this far from the end of a bar


@dataclass(frozen=True)
class Bar:
    """A straight part from ``start`` to ``stop`` whose half width goes from one value to another.

    Args:
        start: One end of its middle line, metres.
        stop: The other end.
        half_widths: Half its width at both ends, metres.
        height: Of its flat top, metres; None for a round one (it lies on the table like a pen).
    """

    start: Point
    stop: Point
    half_widths: Point
    height: float | None = None

    def distance(self, x: Floats, y: Floats) -> Floats:
        """(...) below 0 inside, above 0 outside, metres; across the sides where they taper."""
        along, across, length = self._local(x, y)
        sides = np.abs(across) - self._half(along / length)
        return np.asarray(np.maximum(sides, np.abs(along - length / 2) - length / 2))

    def top(self, x: Floats, y: Floats) -> Floats:
        """(...) height of the surface, metres; only meant inside."""
        along, across, length = self._local(x, y)
        half = self._half(along / length)
        if self.height is not None:
            return np.full_like(half, self.height)
        return np.asarray(half + np.sqrt(np.maximum(half**2 - across**2, 0)))

    def _local(self, x: Floats, y: Floats) -> tuple[Floats, Floats, float]:
        (x0, y0), (x1, y1) = self.start, self.stop
        length = math.hypot(x1 - x0, y1 - y0)
        c, s = (x1 - x0) / length, (y1 - y0) / length
        return (x - x0) * c + (y - y0) * s, (y - y0) * c - (x - x0) * s, length

    def _half(self, share: Floats) -> Floats:
        first, last = self.half_widths
        return np.asarray(first + (last - first) * np.clip(share, 0, 1))


@dataclass(frozen=True)
class Disc:
    """A round part: a standing can, a ball, or a ring.

    Args:
        center: Its middle, metres.
        radius: Outer radius, metres.
        hole: Inner radius; 0 for none.
        height: Of its flat top, metres; None for a ball, or a ring with a round section.
    """

    center: Point
    radius: float
    hole: float = 0.0
    height: float | None = None

    def distance(self, x: Floats, y: Floats) -> Floats:
        """(...) below 0 inside, above 0 outside, metres."""
        d = np.hypot(x - self.center[0], y - self.center[1])
        return np.maximum(d - self.radius, self.hole - d) if self.hole else d - self.radius

    def top(self, x: Floats, y: Floats) -> Floats:
        """(...) height of the surface, metres; only meant inside."""
        d = np.hypot(x - self.center[0], y - self.center[1])
        if self.height is not None:
            return np.full_like(d, self.height)
        middle = (self.radius + self.hole) / 2 if self.hole else 0.0
        half = self.radius - middle
        return np.asarray(half + np.sqrt(np.maximum(half**2 - (d - middle) ** 2, 0)))


@dataclass(frozen=True)
class Shape:
    """An object: its parts and its grasps.

    Args:
        name: Kind of object, for example ``"bottle"``.
        parts: Its solid is their union.
        grasps: All that hold, in metres of the object frame, each jaw size that fits.
        radius: Of the circle around the origin that contains the object, metres.
    """

    name: str
    parts: tuple[Bar | Disc, ...]
    grasps: Grasps
    radius: float

    def distance(self, x: Floats, y: Floats) -> Floats:
        """(...) below 0 inside, above 0 outside, metres."""
        return np.asarray(np.min([part.distance(x, y) for part in self.parts], axis=0))

    def top(self, x: Floats, y: Floats) -> Floats:
        """(...) height of the surface above the table, metres; 0 outside."""
        tops = [np.where(p.distance(x, y) <= 0, p.top(x, y), 0.0) for p in self.parts]
        return np.asarray(np.max(tops, axis=0))


def random_shape(rng: np.random.Generator) -> Shape:
    """One object of a random kind and size."""
    return SHAPES[list(SHAPES)[rng.integers(len(SHAPES))]](rng)


def _across(
    start: Point,
    stop: Point,
    width: float,
    *,
    blocked: tuple[bool, bool] = (False, False),
) -> list[tuple[float, ...]]:
    """Rows (x, y, angle, opening, jaw) across a straight piece with parallel sides.

    Args:
        start: One end of the piece's middle line, metres.
        stop: The other end.
        width: Of the piece, metres.
        blocked: Whether something wider than the piece begins at that end: a jaw must then not
            reach past it.
    """
    opening = width + 2 * CLEARANCE_M
    (x0, y0), (x1, y1) = start, stop
    length = math.hypot(x1 - x0, y1 - y0)
    if opening > MOST_OPENING_M or length < 2 * _END_M:
        return []
    # The y axis points down, so the direction on screen is (dx, -dy); the opening crosses it.
    angle = math.atan2(-(y1 - y0), x1 - x0) + math.pi / 2
    count = max(1, round((length - 2 * _END_M) / _STEP_M) + 1)
    ends = (_END_M, length - _END_M) if count > 1 else (length / 2, length / 2)
    rows: list[tuple[float, ...]] = []
    for along in np.linspace(*ends, count):
        room = min(
            along if blocked[0] else math.inf,
            length - along if blocked[1] else math.inf,
        )
        share = along / length
        center = (x0 + (x1 - x0) * share, y0 + (y1 - y0) * share)
        rows += [(*center, angle, opening, jaw) for jaw in JAWS_M if jaw / 2 + _AIR_M <= room]
    return rows


def _grasps(rows: list[tuple[float, ...]]) -> Grasps:
    table = np.array(rows, np.float64).reshape(-1, 5)
    return Grasps(table[:, :2], table[:, 2], table[:, 3], table[:, 4])


def _box(rng: np.random.Generator) -> Shape:
    a, b, height = rng.uniform(0.06, 0.22), rng.uniform(0.04, 0.12), rng.uniform(0.02, 0.08)
    rows = _across((-a / 2, 0), (a / 2, 0), b) + _across((0, -b / 2), (0, b / 2), a)
    part = Bar((-a / 2, 0), (a / 2, 0), (b / 2, b / 2), height)
    return Shape("box", (part,), _grasps(rows), math.hypot(a, b) / 2)


def _stick(rng: np.random.Generator) -> Shape:
    length, half = rng.uniform(0.15, 0.40), rng.uniform(0.008, 0.025)
    height = rng.uniform(0.015, 0.04) if rng.random() < 0.5 else None
    ends = (-length / 2, 0.0), (length / 2, 0.0)
    part = Bar(*ends, (half, half), height)
    return Shape("stick", (part,), _grasps(_across(*ends, 2 * half)), math.hypot(length / 2, half))


def _can(rng: np.random.Generator) -> Shape:
    radius = rng.uniform(0.02, 0.075)
    height = rng.uniform(0.03, 0.12) if rng.random() < 0.7 else None
    return Shape("can", (Disc((0, 0), radius, 0, height),), _grasps(_turns(radius)), radius)


def _turns(radius: float) -> list[tuple[float, ...]]:
    """Rows through the middle of a disc, in twelve directions."""
    angles = np.arange(12) * math.pi / 12
    opening = 2 * (radius + CLEARANCE_M)
    return [(0.0, 0.0, a, opening, jaw) for a in angles for jaw in JAWS_M]


def _ring(rng: np.random.Generator) -> Shape:
    hole, wall = rng.uniform(0.03, 0.07), rng.uniform(0.012, 0.035)
    height = rng.uniform(0.02, 0.05) if rng.random() < 0.5 else None
    middle, opening = hole + wall / 2, wall + 2 * CLEARANCE_M
    rows: list[tuple[float, ...]] = []
    for a in np.arange(24) * math.pi / 12:
        center = (middle * math.cos(a), -middle * math.sin(a))
        for jaw in JAWS_M:
            # The inner plate's corners must stay clear of the curved wall.
            if math.hypot(hole - CLEARANCE_M, jaw / 2) < hole - CLEARANCE_M / 2:
                rows.append((*center, a, opening, jaw))
    return Shape("ring", (Disc((0, 0), hole + wall, hole, height),), _grasps(rows), hole + wall)


def _bottle(rng: np.random.Generator) -> Shape:
    body, neck = rng.uniform(0.025, 0.045), rng.uniform(0.010, 0.016)
    lengths = rng.uniform(0.09, 0.16), rng.uniform(0.02, 0.05), rng.uniform(0.035, 0.07)
    x = np.cumsum([-sum(lengths) / 2, *lengths])
    points: list[Point] = [(float(v), 0.0) for v in x]
    parts = (
        Bar(points[0], points[1], (body, body)),
        Bar(points[1], points[2], (body, neck)),
        Bar(points[2], points[3], (neck, neck)),
    )
    rows = _across(points[0], points[1], 2 * body)
    rows += _across(points[2], points[3], 2 * neck, blocked=(True, False))
    return Shape("bottle", parts, _grasps(rows), math.hypot(x[-1], body))


def _hammer(rng: np.random.Generator) -> Shape:
    length, handle = rng.uniform(0.15, 0.28), rng.uniform(0.009, 0.016)
    width, head = rng.uniform(0.08, 0.14), rng.uniform(0.012, 0.022)
    height = rng.uniform(0.03, 0.05)
    x = length / 2 - head  # the head's middle line
    parts = (
        Bar((-length / 2, 0), (x, 0), (handle, handle), 2 * handle),
        Bar((x, -width / 2), (x, width / 2), (head, head), height),
    )
    rows = _across((-length / 2, 0), (x - head, 0), 2 * handle, blocked=(False, True))
    # On the head, beside the handle; the handle's side of it is in the way.
    for side in (-1, 1):
        rows += _across((x, side * handle), (x, side * width / 2), 2 * head, blocked=(True, False))
    return Shape("hammer", parts, _grasps(rows), math.hypot(length / 2, width / 2))


def _angle_piece(rng: np.random.Generator) -> Shape:
    long, short = rng.uniform(0.12, 0.22), rng.uniform(0.08, 0.14)
    half, height = rng.uniform(0.010, 0.022), rng.uniform(0.02, 0.05)
    x, y = -short / 2 + half, long / 2 - half  # the corner where the middle lines meet
    parts = (
        Bar((x, -long / 2), (x, long / 2), (half, half), height),
        Bar((x - half, y), (short / 2, y), (half, half), height),
    )
    rows = _across((x, -long / 2), (x, y - half), 2 * half, blocked=(False, True))
    rows += _across((x + half, y), (short / 2, y), 2 * half, blocked=(True, False))
    return Shape("angle", parts, _grasps(rows), math.hypot(long / 2, short / 2))


SHAPES: dict[str, Callable[[np.random.Generator], Shape]] = {
    "angle": _angle_piece,
    "bottle": _bottle,
    "box": _box,
    "can": _can,
    "hammer": _hammer,
    "ring": _ring,
    "stick": _stick,
}
"""Kinds of objects; a new one is a function and a line here."""
