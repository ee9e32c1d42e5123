"""The table behind a picture, without camera or mask: what objects rise from.

A plane is linear in the inverse depth of the pixels. Where a camera does not measure along its axis
(the range from a robot's base, as in Cornell's pictures; a lens that bends) a table looks like a
bowl, and a polynomial of third order follows it.

Letters in shapes: H rows, W columns of the picture; N sampled pixels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polypow, polyval2d, polyvander
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.affine import check_affine

Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]
"""First and last column, first and last row, pixels."""

_SAMPLES_A_SIDE = 48
_ROUNDS = 8
_PLANES, _COMPARED = 60, 800
_DEVIATIONS = 2.5  # of the table's pixels; what lies nearer than so many is an object
_LEAST_M = 0.003  # objects less high than this cannot be told from the table
_ORDER = 3
_PLANE = ((0, 0), (0, 1), (1, 0))  # powers of y and x
_BOWL = tuple((i, j) for i in range(_ORDER + 1) for j in range(_ORDER + 1 - i))
_BENT = 0.4  # of the plane's deviation that a bowl's must not exceed to be believed
_FARTHEST = 1e-3  # 1 / metres; beyond the horizon of a tilted table there is no depth at all
_BEYOND = 2.0  # what lies behind the table by so many times as much (an edge, a mirror) is none


@dataclass(frozen=True, eq=False)
class Table:
    """A table as a picture shows it: a polynomial in the inverse depth.

    Attributes:
        inverse: (4, 4) C with 1 / depth = sum of C[i, j] y^i x^j at pixel (x, y), depth in metres.
            A plane has only 1, x and y.
        box: First and last column, first and last row that the picture shows, pixels. Beyond them
            a picture repeats its border, and so does the table.
    """

    inverse: Floats
    box: Box

    def inverse_depth(self, x: float, y: float) -> float:
        """1 / depth at a point of the picture, 1 / metres."""
        return max(_FARTHEST, float(polyval2d(y, x, self.inverse)))

    def depth_m(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """(H, W) float32 depth of the table at every pixel, metres."""
        rows, columns = shape
        first_x, last_x, first_y, last_y = self.box
        x = np.clip(np.arange(columns, dtype=np.float64), first_x, last_x)
        y = np.clip(np.arange(rows, dtype=np.float64), first_y, last_y)
        order = _ORDER if self.inverse[2:].any() or self.inverse[:, 2:].any() else 1
        few = self.inverse[: order + 1, : order + 1]
        inverse = (polyvander(y, order) @ few @ polyvander(x, order).T).astype(np.float32)
        np.maximum(inverse, np.float32(_FARTHEST), out=inverse)
        found: NDArray[np.float32] = np.reciprocal(inverse, out=inverse)
        return found

    def transformed(self, matrix: ArrayLike) -> Table:
        """The table in another frame of pixels.

        Args:
            matrix: (3, 3) map from its pixels to the new ones: zoom and shift alone.

        Raises:
            InvalidInputError: The map turns, shears or mirrors.
        """
        m = check_affine(matrix)
        if m[0, 1] or m[1, 0] or m[0, 0] <= 0 or m[1, 1] <= 0:
            raise InvalidInputError("matrix", m.tolist(), "zoom and shift alone")
        x, y = np.array(self.box).reshape(2, 2)
        x, y = m[0, 0] * x + m[0, 2], m[1, 1] * y + m[1, 2]
        return Table(_moved(self.inverse, m), (x[0], x[1], y[0], y[1]))


def _moved(inverse: Floats, m: Floats) -> Floats:
    """(4, 4) coefficients of a table in pixels that were zoomed and shifted."""
    across, down = (_powers(m[axis, axis], m[axis, 2]) for axis in (0, 1))
    return np.asarray(down.T @ inverse @ across)


def _powers(zoom: float, shift: float) -> Floats:
    """(4, 4) row k: coefficients of x^k = ((x' - shift) / zoom)^k in powers of x'."""
    found = np.zeros((_ORDER + 1, _ORDER + 1))
    for k in range(_ORDER + 1):
        found[k, : k + 1] = polypow([-shift / zoom, 1 / zoom], k)[: k + 1]
    return found


def find_table(
    depth_m: NDArray[np.float32], region_xywh: tuple[float, float, float, float] | None = None
) -> Table:
    """The table that a picture, or a region of it, shows most of.

    Of many planes through three pixels each the one that most pixels lie near is fitted again and
    again to those that lie on it, until they stay the same; what stands in front of it is left out
    sooner than what lies behind. The table must fill about half of the picture. Where a bowl
    fits several times as closely, it is taken.

    Where the camera is known and a pose is wanted, `graspmap.simulation` fits with more care.

    Args:
        depth_m: (H, W) metres, NaN in holes.
        region_xywh: Column and row of the first pixel, width and height of the part that shows it;
            None: all of the picture.

    Returns:
        The table; where the fit would lie behind the camera in a part of the picture (of the
        region, where there is one), a level one at the median depth.

    Raises:
        InvalidInputError: There is nothing but holes.
    """
    rows, columns = depth_m.shape
    box = (0.0, columns - 1.0, 0.0, rows - 1.0)
    left, right, top, bottom = box if region_xywh is None else _clipped(box, region_xywh)
    points, seen = _sampled(depth_m, region_xywh)
    # Pixels about the picture's middle, in units of its longer side: numbers of one size.
    side = max(rows, columns)
    unit = np.array(
        [[1 / side, 0, -columns / 2 / side], [0, 1 / side, -rows / 2 / side], [0, 0, 1]]
    )
    level = 1.0 / float(np.median(seen))
    back = np.linalg.inv(unit)
    for inverse in _fits(points @ unit.T, seen):
        table = Table(_moved(inverse, back), box)
        # No table is ten times as far away on one side of a picture as in its middle.
        corners = [table.inverse_depth(x, y) for x in (left, right) for y in (top, bottom)]
        if min(corners) > 0.1 * level:
            return table
    flat = np.zeros((_ORDER + 1, _ORDER + 1))
    flat[0, 0] = level
    return Table(flat, box)


def _clipped(box: Box, region_xywh: tuple[float, float, float, float]) -> Box:
    """First and last column, first and last row of the part of a region that a picture shows."""
    x, y, width, height = region_xywh
    left, right = np.clip((x, x + width - 1), *box[:2]).tolist()
    top, bottom = np.clip((y, y + height - 1), *box[2:]).tolist()
    return left, right, top, bottom


def _sampled(
    depth_m: NDArray[np.float32], region_xywh: tuple[float, float, float, float] | None
) -> tuple[Floats, Floats]:
    """(N, 3) pixels (x, y, 1) on a grid over the picture or its region, and their depths."""
    rows, columns = depth_m.shape
    first_x, first_y, last_x, last_y = 0, 0, columns, rows
    if region_xywh is not None:
        left, top, width, height = region_xywh
        first_x, first_y = max(0, math.ceil(left)), max(0, math.ceil(top))
        last_x, last_y = math.ceil(left + width), math.ceil(top + height)
    part = depth_m[first_y:last_y, first_x:last_x]
    for step in (max(1, min(part.shape) // _SAMPLES_A_SIDE), 1):
        few = part[::step, ::step].astype(np.float64)
        y, x = np.nonzero(np.isfinite(few) & (few > 0))
        if len(y):
            places = np.stack([x * step + first_x, y * step + first_y, np.ones(len(x))], axis=1)
            return places, few[y, x]
    if region_xywh is not None:
        return _sampled(depth_m, None)
    raise InvalidInputError("depth", "nothing but holes", "at least one measured pixel")


def _fits(points: Floats, depth_m: Floats) -> Iterator[Floats]:
    """(4, 4) polynomials of a table, the best first."""
    terms = points[:, [2, 0, 1]]
    plane, deviation = _refined(terms, depth_m, _first(terms, depth_m))
    if deviation > _LEAST_M:
        x, y, _ = points.T
        terms = np.column_stack([x**j * y**i for i, j in _BOWL])
        start = np.zeros(len(_BOWL))
        start[[_BOWL.index(place) for place in _PLANE]] = plane
        bowl, left = _refined(terms, depth_m, start)
        if left < _BENT * deviation:
            yield _polynomial(_BOWL, bowl)
    yield _polynomial(_PLANE, plane)


def _polynomial(places: Sequence[tuple[int, int]], found: Floats) -> Floats:
    """(4, 4) coefficients from those at some places."""
    inverse = np.zeros((_ORDER + 1, _ORDER + 1))
    for place, value in zip(places, found, strict=True):
        inverse[place] = value
    return inverse


def _refined(terms: Floats, depth_m: Floats, start: Floats) -> tuple[Floats, float]:
    """(T,) the p with 1 / depth = p . terms, robustly, and the deviation of what lies on it."""
    inverse = 1.0 / depth_m
    found, deviation = start, 0.0
    kept = np.ones(len(depth_m), dtype=bool)
    for fit in range(_ROUNDS):
        behind = _behind(terms, depth_m, found)
        middle = np.median(behind[kept])
        deviation = 1.4826 * float(np.median(np.abs(behind[kept] - middle)))
        most = max(_DEVIATIONS * deviation, _LEAST_M)
        chosen = (behind > -most) & (behind < _BEYOND * most)
        if not chosen.any() or (fit and np.array_equal(chosen, kept)):
            break
        kept = chosen
        found = _solve(terms[kept], inverse[kept])
    return found, deviation


def _first(points: Floats, depth_m: Floats) -> Floats:
    """(3,) of many planes through three pixels each, the one that most pixels lie near."""
    rng = np.random.default_rng(0)  # the same planes for the same number of pixels
    some = rng.permutation(len(points))[:_COMPARED]
    few, seen = points[some], depth_m[some]
    corners = rng.integers(len(points), size=(_PLANES, 3))
    planes = np.stack(
        [_solve(points, 1.0 / depth_m), *_solve(points[corners], 1.0 / depth_m[corners])]
    )
    there = few @ planes.T
    behind = seen[:, None] - 1.0 / np.where(there > 0, there, np.inf)
    off = np.minimum(np.abs(behind), 2 * _LEAST_M).sum(axis=0)
    return np.asarray(planes[int(np.argmin(off))])


def _behind(terms: Floats, depth_m: Floats, found: Floats) -> Floats:
    """(N,) how far the pixels lie behind the table, metres."""
    there = terms @ found
    return np.asarray(depth_m - 1.0 / np.where(there > 0, there, np.inf))


def _solve(terms: Floats, inverse: Floats) -> Floats:
    """(..., T) least squares of (..., N, T) terms, 1 first; level where pixels lie in a line."""
    turned = np.swapaxes(terms, -1, -2)
    count = terms.shape[-1]
    level = 1e-9 * (np.arange(count) > 0) * terms.shape[-2]
    found = np.linalg.solve(turned @ terms + np.diag(level), turned @ inverse[..., None])
    return np.asarray(found[..., 0], dtype=np.float64)
