"""Bodies of revolution about the z axis, with or without a cavity, and rings.

A profile is a line of points (radius, z). What lies below the cavity is made of whole convex
bodies of revolution; a wall is split into convex polygons, each turned through sectors small
enough that their hulls stand off the round surface by at most the tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from graspmap.simulation.procedural.convex import split
from graspmap.simulation.procedural.polygon_pieces import convex_polygons
from graspmap.simulation.procedural.solid import (
    MOST_VERTICES,
    TOLERANCE,
    TOLERANCE_M,
    Floats,
    Solid,
    snap,
)

Profile = Sequence[tuple[float, float]]

_FINE_M = 0.00015  # how far the drawn surface may lie inside the round one
_BULGE_M = 0.0008  # how far a sector's hull may bulge into a cavity; half is taken back


def revolve(outer: Profile, cavity: Profile | None = None) -> Solid:
    """The body under a line, less its cavity.

    Args:
        outer: Points (radius, z), z never falling; the first and the last are closed by flat discs
            unless their radius is 0.
        cavity: Points (radius, z) of its surface, z never falling, from its flat bottom to the
            rim; its last z is the last of ``outer``.
    """
    line = snap(outer)
    if cavity is None:
        return Solid(*_surface(line, closed=False), tuple(_solid_pieces(line)))
    inner = snap(cavity)
    floor = float(inner[0, 1])
    below, above = _cut(line, floor)
    wall = np.concatenate([above, inner[::-1]])
    vertices, faces = _surface(np.concatenate([line, inner[::-1]]), closed=False)
    return Solid(vertices, faces, (*_solid_pieces(below), *_wall_pieces(wall)))


def revolve_ring(loop: Profile) -> Solid:
    """A ring from its cross-section.

    Args:
        loop: Corners (radius > 0, z), counter-clockwise with the radius to the right.
    """
    corners = snap(loop)
    return Solid(*_surface(corners, closed=True), tuple(_wall_pieces(corners)))


def arc(
    center: tuple[float, float],
    radii: tuple[float, float],
    start_deg: float,
    stop_deg: float,
    steps: int,
) -> list[tuple[float, float]]:
    """Points of an elliptic arc in the (radius, z) plane, both ends included."""
    turns = [math.radians(start_deg + (stop_deg - start_deg) * i / steps) for i in range(steps + 1)]
    # The sine of a half turn is not quite 0, and a radius must not be negative.
    return [
        (max(0.0, center[0] + radii[0] * math.cos(t)), center[1] + radii[1] * math.sin(t))
        for t in turns
    ]


def sides(radius_m: float, sagitta_m: float) -> int:
    """Corners of a polygon on the circle that lies at most ``sagitta_m`` inside it."""
    return max(6, math.ceil(math.pi / math.acos(max(0.0, 1 - sagitta_m / max(radius_m, 1e-9)))))


def _surface(line: Floats, *, closed: bool) -> tuple[Floats, np.ndarray]:
    """Vertices and faces when a line of (radius, z) is turned about the axis."""
    count = min(128, max(32, 4 * math.ceil(sides(float(line[:, 0].max()), _FINE_M) / 4)))
    turns = [2 * math.pi * i / count for i in range(count)]
    around = np.array([(math.cos(t), math.sin(t)) for t in turns])
    vertices: list[Floats] = []
    rings: list[np.ndarray] = []
    points = list(map(tuple, line.tolist()))
    if not closed:  # flat discs close both ends
        points = [(0.0, points[0][1]), *points, (0.0, points[-1][1])]
        points = [p for i, p in enumerate(points) if i == 0 or p != points[i - 1]]
    total = 0
    for radius, z in points:
        size = count if radius > 0 else 1
        ring = np.column_stack([around[:size] * radius, np.full(size, z)])
        vertices.append(ring)
        rings.append(total + (np.arange(count) if size > 1 else np.zeros(count, np.int64)))
        total += size
    pairs = list(zip(rings, [*rings[1:], rings[0]] if closed else rings[1:], strict=False))
    faces = []
    for low, high in pairs:
        low_next, high_next = np.roll(low, -1), np.roll(high, -1)
        if low[0] != low_next[0]:
            faces.append(np.stack([low, low_next, high_next], axis=1))
        if high[0] != high_next[0]:
            faces.append(np.stack([low, high_next, high], axis=1))
    return snap(np.concatenate(vertices)), np.concatenate(faces).astype(np.int32)


def _cut(line: Floats, z: float) -> tuple[Floats, Floats]:
    """The line below and above a height, both with the point at that height."""
    number = int(np.searchsorted(line[:, 1], z, side="right"))
    if number == len(line):
        return line, line[-1:]
    (r0, z0), (r1, z1) = line[number - 1], line[number]
    between = snap((r0 + (r1 - r0) * (z - z0) / (z1 - z0), z))
    below = line[:number] if z0 == z else np.vstack([line[:number], between])
    return below, np.vstack([between, line[number:]])


def _solid_pieces(line: Floats) -> list[Floats]:
    """Whole bodies of revolution, one for each convex stretch of the line."""
    pieces: list[Floats] = []
    first = 0
    for i in range(1, len(line)):
        if i + 1 < len(line) and _convex_at(line[first : i + 2]):
            continue
        if line[i, 1] > line[first, 1]:
            pieces += _round_pieces(line[first : i + 1])
        first = i
    return pieces


def _convex_at(run: Floats) -> bool:
    """Whether the last corner but one of a rising line is convex (turns left)."""
    (ax, ay), (bx, by), (cx, cy) = run[-3:]
    return bool((bx - ax) * (cy - by) - (by - ay) * (cx - bx) >= 0)


def _round_pieces(run: Floats) -> list[Floats]:
    radius = float(run[:, 0].max())
    count = sides(radius, min(TOLERANCE_M, TOLERANCE * radius))
    turns = [2 * math.pi * i / count for i in range(count)]
    rings = [
        [(r * math.cos(t), r * math.sin(t), z) for t in turns] if r > 0 else [(0.0, 0.0, z)]
        for r, z in run.tolist()
    ]
    points = snap([p for ring in rings for p in ring])
    return [points] if len(points) <= MOST_VERTICES else split(points)


@dataclass(frozen=True)
class _Sector:
    """How one convex polygon is turned: the sectors' number, and the steps inside each."""

    count: int
    steps: int

    @classmethod
    def of(cls, polygon: Floats) -> _Sector:
        after = np.roll(polygon, -1, axis=0)
        inward = after[:, 1] < polygon[:, 1]
        radii = np.where(inward, np.maximum(polygon[:, 0], after[:, 0]), 0)
        count = sides(float(radii.max()), _BULGE_M)
        radius = float(polygon[:, 0].max())
        return cls(count, math.ceil(sides(radius, min(TOLERANCE_M, TOLERANCE * radius)) / count))


def _wall_pieces(loop: Floats) -> list[Floats]:
    loop = _bent(loop)
    before, after = np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0)
    falls = (loop[:, 1] < before[:, 1]) | (after[:, 1] < loop[:, 1])
    rises = (loop[:, 1] > before[:, 1]) | (after[:, 1] > loop[:, 1])
    inner = {tuple(p) for p in loop[falls & ~rises].tolist()}
    pieces = []
    for polygon in convex_polygons([loop]):
        sector = _Sector.of(polygon)
        half = math.pi / sector.count
        for number in range(sector.count):
            points = []
            for r, z in polygon.tolist():
                hollow = (r, z) in inner
                # A chord of the inner circle cuts into the cavity: half of that is given back.
                radius = r * (1 + (1 - math.cos(half)) / 2) if hollow else r
                steps = 1 if hollow else sector.steps
                for j in range(steps + 1):
                    t = 2 * half * (number + j / steps)
                    points.append((radius * math.cos(t), radius * math.sin(t), z))
            pieces.append(snap(points))
    return pieces


def _bent(loop: Floats) -> Floats:
    """Without repeated corners."""
    return np.asarray(loop[(loop != np.roll(loop, 1, axis=0)).any(axis=1)])
