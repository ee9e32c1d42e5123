"""Exact convex pieces of a polygon with holes.

The polygon is triangulated; then diagonals are taken out while what they part stays convex (Hertel
and Mehlhorn). At most four times the least number of pieces come out, in practice about the least;
several orders of taking out are tried and the one with the fewest pieces is kept.

Letters in shapes: N corners of one loop, T triangles, K corners of one piece.

References:
    Hertel, Mehlhorn, "Fast triangulation of simple polygons", FCT 1983.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import triangulate as _triangulate
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_LEAST_AREA_M2 = 1e-11  # of a piece; smaller ones are slivers between corners on one line


def convex_polygons(loops: Sequence[Floats]) -> list[Floats]:
    """Convex pieces that are disjoint and cover the polygon.

    Args:
        loops: (N, 2) corners of the outline, counter-clockwise, then of each hole, clockwise; on
            the grid of `solid.snap`, where the predicates are exact.

    Returns:
        (K, 2) corners of each piece, counter-clockwise, all of them corners of the polygon.
    """
    points = np.concatenate(loops)
    triangles = triangulate(loops)
    lengths = _Mesh.of(triangles).squared_lengths(points)
    orders: tuple[Callable[[int], float], ...] = (
        lambda edge: -lengths[edge],
        lambda edge: lengths[edge],
        lambda edge: edge,
    )
    best: list[list[int]] | None = None
    for order in orders:
        found = _Mesh.of(triangles).merged(points, order)
        if best is None or len(found) < len(best):
            best = found
    pieces = [points[corners] for corners in best or []]
    return [piece for piece in pieces if _area(piece) > _LEAST_AREA_M2]


def triangulate(loops: Sequence[Floats]) -> NDArray[np.int32]:
    """(T, 3) corners of triangles that cover a polygon, numbered through all its loops."""
    return np.asarray(_triangulate(list(loops)), dtype=np.int32)


@dataclass
class _Mesh:
    """Half-edges: where each starts, which follow and precede it, and its twin (-1: none)."""

    start: list[int]
    after: list[int]
    before: list[int]
    twin: list[int]

    @classmethod
    def of(cls, triangles: NDArray[np.int32]) -> _Mesh:
        start = [int(v) for v in triangles.ravel()]
        count = len(start)
        after = [e - 2 if e % 3 == 2 else e + 1 for e in range(count)]
        before = [e + 2 if e % 3 == 0 else e - 1 for e in range(count)]
        by_ends = {(start[e], start[after[e]]): e for e in range(count)}
        twin = [by_ends.get((start[after[e]], start[e]), -1) for e in range(count)]
        return cls(start, after, before, twin)

    def squared_lengths(self, points: Floats) -> list[float]:
        ends = points[[self.start[e] for e in self.after]] - points[self.start]
        return [float(d) for d in (ends**2).sum(axis=1)]

    def merged(self, points: Floats, order: Callable[[int], float]) -> list[list[int]]:
        """Corners of the polygons that are left when diagonals are taken out in an order."""
        where = points.tolist()
        diagonals = [e for e in range(len(self.start)) if self.twin[e] > e]
        removed = [False] * len(self.start)
        for edge in sorted(diagonals, key=lambda e: (order(e), e)):
            twin = self.twin[edge]
            if self._convex_without(where, edge) and self._convex_without(where, twin):
                for one, other in ((edge, twin), (twin, edge)):
                    behind, ahead = self.before[one], self.after[other]
                    self.after[behind], self.before[ahead] = ahead, behind
                    removed[one] = True
        return self._loops(removed)

    def _convex_without(self, where: list[list[float]], edge: int) -> bool:
        """Whether the corner at the start of the edge stays convex without the edge."""
        behind, ahead = self.before[edge], self.after[self.twin[edge]]
        a, b = where[self.start[behind]], where[self.start[edge]]
        c = where[self.start[self.after[ahead]]]
        return (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0]) >= 0

    def _loops(self, done: list[bool]) -> list[list[int]]:
        loops = []
        for first in range(len(self.start)):
            if done[first]:
                continue
            loop, edge = [], first
            while not done[edge]:
                done[edge] = True
                loop.append(self.start[edge])
                edge = self.after[edge]
            loops.append(loop)
        return loops


def _area(corners: Floats) -> float:
    x, y = (corners - corners[0]).T
    return float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum() / 2)
