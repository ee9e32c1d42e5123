"""The table behind a picture, without camera or mask: what objects rise from.

Letters in shapes: H rows, W columns of the picture; N sampled pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.affine import check_affine

Floats = NDArray[np.float64]

_SAMPLES_A_SIDE = 48
_ROUNDS = 8
_PLANES, _COMPARED = 60, 800
_DEVIATIONS = 2.5  # of the table's pixels; what lies nearer than so many is an object
_LEAST_M = 0.003  # objects less high than this cannot be told from the table
_BEYOND = 2.0  # what lies behind the table by so many times as much (an edge, a mirror) is none


@dataclass(frozen=True, eq=False)
class Table:
    """The plane of a table as a picture shows it, linear in the inverse depth.

    Attributes:
        plane: (3,) p with 1 / depth = p . (x, y, 1) for pixel (x, y); depth in metres.
        box: First and last column, first and last row that the picture shows, pixels. Beyond them
            a picture repeats its border, and so does the table.
    """

    plane: Floats
    box: tuple[float, float, float, float]

    def depth_m(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """(H, W) float32 depth of the table at every pixel, metres."""
        rows, columns = shape
        first_x, last_x, first_y, last_y = self.box
        x = np.clip(np.arange(columns, dtype=np.float64), first_x, last_x)
        y = np.clip(np.arange(rows, dtype=np.float64), first_y, last_y)
        a, b, c = self.plane
        inverse = ((b * y + c)[:, None] + (a * x)[None]).astype(np.float32)
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
        return Table(self.plane @ np.linalg.inv(m), (x[0], x[1], y[0], y[1]))


def find_table(depth_m: NDArray[np.float32]) -> Table:
    """The plane that a picture shows most of.

    Of many planes through three pixels each the one that most pixels lie near is fitted again and
    again to those that lie on it, until they stay the same; what stands in front of it is left out
    sooner than what lies behind. The table must fill about half of the picture.

    Where the camera is known and a pose is wanted, `graspmap.simulation` fits with more care.

    Args:
        depth_m: (H, W) metres, NaN in holes.

    Returns:
        The table; where the fit would lie behind the camera in a part of the picture, a level one
        at the median depth.

    Raises:
        InvalidInputError: There is nothing but holes.
    """
    rows, columns = depth_m.shape
    step = max(1, min(rows, columns) // _SAMPLES_A_SIDE)
    part = depth_m[::step, ::step].astype(np.float64)
    y, x = np.nonzero(np.isfinite(part) & (part > 0))
    if not len(y):
        part, step = depth_m.astype(np.float64), 1
        y, x = np.nonzero(np.isfinite(part) & (part > 0))
    if not len(y):
        raise InvalidInputError("depth", "nothing but holes", "at least one measured pixel")
    seen = part[y, x]
    # Pixels about the picture's middle, in units of its longer side: numbers of one size.
    side = max(rows, columns)
    unit = np.array(
        [[1 / side, 0, -columns / 2 / side], [0, 1 / side, -rows / 2 / side], [0, 0, 1]]
    )
    points = np.stack([x * step, y * step, np.ones(len(x))], axis=1) @ unit.T
    plane = _fit(points, seen) @ unit
    corners = np.array([[x, y, 1] for x in (0, columns - 1) for y in (0, rows - 1)])
    # No table is ten times as far away on one side of a picture as in its middle.
    if not (corners @ plane).min() > 0.1 / float(np.median(seen)):
        plane = np.array([0.0, 0.0, 1.0 / float(np.median(seen))])
    return Table(plane, (0.0, columns - 1.0, 0.0, rows - 1.0))


def _fit(points: Floats, depth_m: Floats) -> Floats:
    """(3,) the plane p with 1 / depth = p . point, robustly."""
    inverse = 1.0 / depth_m
    plane = _first(points, depth_m)
    kept = np.ones(len(depth_m), dtype=bool)
    for _ in range(_ROUNDS):
        behind = _behind(points, depth_m, plane)
        middle = np.median(behind[kept])
        deviation = 1.4826 * float(np.median(np.abs(behind[kept] - middle)))
        most = max(_DEVIATIONS * deviation, _LEAST_M)
        chosen = (behind > -most) & (behind < _BEYOND * most)
        if not chosen.any() or np.array_equal(chosen, kept):
            break
        kept = chosen
        plane = _solve(points[kept], inverse[kept])
    return plane


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


def _behind(points: Floats, depth_m: Floats, plane: Floats) -> Floats:
    """(N,) how far the pixels lie behind the plane, metres."""
    there = points @ plane
    return np.asarray(depth_m - 1.0 / np.where(there > 0, there, np.inf))


def _solve(points: Floats, inverse: Floats) -> Floats:
    """(..., 3) least squares of (..., N, 3) points; as level as may be where they lie in a line."""
    turned = np.swapaxes(points, -1, -2)
    level = np.diag([1e-9, 1e-9, 0.0]) * points.shape[-2]
    found: Floats = np.linalg.solve(turned @ points + level, turned @ inverse[..., None])[..., 0]
    return found
