"""Outline: a flat shape with holes, and the plate that it is cut from.

Letters in shapes: N corners of one loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike
from shapely.geometry.base import BaseGeometry

from graspmap.simulation.procedural.polygon_pieces import convex_polygons, triangulate
from graspmap.simulation.procedural.solid import (
    MOST_VERTICES,
    TOLERANCE_M,
    Floats,
    Solid,
    snap,
)

_STEP_M = 0.0003  # corners that lie nearer the line of their neighbours are dropped
_LEAST_HOLE_M2 = 4e-6


@dataclass(frozen=True, eq=False)
class Outline:
    """A polygon with holes.

    Args:
        loops: (N, 2) corners of the outline, counter-clockwise, then of each hole, clockwise.
    """

    loops: tuple[Floats, ...]

    @classmethod
    def of(cls, shape: BaseGeometry, step_m: float = _STEP_M) -> Outline:
        """The largest polygon of a shapely shape, without corners and holes too small to matter."""
        largest = max(shapely.get_parts(shape), key=lambda part: part.area)
        simple = largest.simplify(step_m).normalize()
        holes = [h for h in simple.interiors if shapely.Polygon(h).area > _LEAST_HOLE_M2]
        rings = [simple.exterior, *holes]
        loops = [_corners(np.asarray(ring.coords)[:-1, :2]) for ring in rings]
        turns = [1, *(-1 for _ in holes)]
        return cls(
            tuple(
                loop if _turning(loop) * sign > 0 else loop[::-1]
                for loop, sign in zip(loops, turns, strict=True)
            )
        )

    def plate(self, thickness_m: float) -> Solid:
        """The plate of that thickness, from z = 0 upwards."""
        top = float(snap(thickness_m))
        points = np.concatenate(self.loops)
        cap = triangulate(self.loops)
        count = len(points)
        bottom, start = np.arange(count), 0
        after = np.empty(count, np.int32)
        for loop in self.loops:
            stop = start + len(loop)
            after[start:stop] = np.roll(np.arange(start, stop), -1)
            start = stop
        walls = [
            np.stack([bottom, after, after + count], axis=1),
            np.stack([bottom, after + count, bottom + count], axis=1),
        ]
        faces = np.concatenate([cap[:, ::-1], cap + count, *walls]).astype(np.int32)
        pieces = tuple(
            _prism(part, top) for polygon in self.pieces() for part in _few_corners(polygon)
        )
        return Solid(_prism(points, top), faces, pieces)

    def pieces(self) -> list[Floats]:
        """(K, 2) corners of convex pieces."""
        return convex_polygons(self.loops)


def circle(radius_m: float, center: ArrayLike = (0, 0), *, hole: bool = False) -> shapely.Polygon:
    """A polygon close to a circle: fine, or for a hole (each of its sides costs a piece) coarse."""
    off = TOLERANCE_M if hole else TOLERANCE_M / 4
    count = max(6, math.ceil(math.pi / math.acos(max(0.0, 1 - off / radius_m))))
    # Half the error inside, half outside.
    radius = radius_m * 2 / (1 + math.cos(math.pi / count))
    return regular(count, radius, center)


def regular(count: int, radius_m: float, center: ArrayLike = (0, 0)) -> shapely.Polygon:
    """A regular polygon with its corners on a circle, the first to the right."""
    x, y = np.asarray(center, dtype=np.float64)
    turns = [2 * math.pi * i / count for i in range(count)]
    return shapely.Polygon(
        [(x + radius_m * math.cos(t), y + radius_m * math.sin(t)) for t in turns]
    )


def polygon(corners: Sequence[tuple[float, float]]) -> shapely.Polygon:
    """From corners in either sense."""
    return shapely.Polygon(corners)


def strip(
    points: Sequence[tuple[float, float]],
    width_m: float,
    *,
    round_ends: bool = False,
    round_bends: bool = False,
) -> BaseGeometry:
    """A band of one width along a line."""
    return shapely.LineString(points).buffer(
        width_m / 2,
        cap_style="round" if round_ends else "flat",
        join_style="round" if round_bends else "mitre",
        quad_segs=6,
    )


def rounded(shape: BaseGeometry, radius_m: float) -> BaseGeometry:
    """With its convex corners rounded; hollow corners stay, each arc there would cost pieces."""
    opened = shape.buffer(-radius_m, join_style="mitre").buffer(radius_m, quad_segs=5)
    return shape if opened.is_empty else opened.intersection(shape)


def _corners(points: Floats) -> Floats:
    """On the grid, without repeated corners and those on the line of their neighbours."""
    points = snap(points)
    while True:
        before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        bend = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        straight = np.flatnonzero(bend == 0)
        if not len(straight):
            return points
        points = np.delete(points, straight[0], axis=0)


def _turning(loop: Floats) -> float:
    x, y = (loop - loop[0]).T
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def _few_corners(polygon: Floats) -> list[Floats]:
    """Cut a convex polygon through two corners until its prism has few enough vertices."""
    if 2 * len(polygon) <= MOST_VERTICES:
        return [polygon]
    half = len(polygon) // 2
    first, second = polygon[: half + 1], np.concatenate([polygon[half:], polygon[:1]])
    return _few_corners(first) + _few_corners(second)


def _prism(polygon: Floats, top: float) -> Floats:
    """Corners (2 N, 3), the bottom's first."""
    heights = np.repeat([0.0, top], len(polygon))
    return np.column_stack([np.tile(polygon, (2, 1)), heights])
