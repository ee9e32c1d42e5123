"""Candidate grasps for a scene: some at random on what lies there, some across opposite sides.

Letters in shapes: N grasps, B borders between a cell of the height map and a lower neighbour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper
from graspmap.simulation.heightmap import HeightMap
from graspmap.simulation.tabletop import Tabletop

Floats = NDArray[np.float64]

BESIDE_M = 0.01
"""How far beside what lies there the centre of a random grasp may be."""

MARGIN_M = (0.003, 0.010)
"""Opening of an antipodal grasp beyond the distance of the two sides, least and greatest."""

MARGIN_SHARE = 0.4
"""The margin grows by up to this part of the distance (Jacquard's openings do: by a third)."""

LEVELS = 8
"""Heights at which opposite sides are looked for."""

_DEPTHS = (0.1, 0.3, 0.5, 0.7, 0.9)
_DECIMALS = 7
_LEAST_OPENING_M = 0.005
_PAD_CELLS = 12
_BLUR_CELLS = 1.5
_TRIES = 6
_FULL_EDGE_M = 0.01


def propose_grasps(
    tabletop: Tabletop,
    gripper: Gripper,
    count: int,
    rng: np.random.Generator,
    *,
    antipodal_share: float = 0.5,
    jaws: Sequence[float] | None = None,
) -> TableGrasps:
    """Grasps that are worth trying.

    Random ones have their centre on what lies on the table or up to `BESIDE_M` beside it, any
    angle, and any opening that the gripper has and the scene's size allows, the narrow ones more
    often (uniform in its logarithm). Antipodal ones join two
    sides of the height map, cut at one of `LEVELS` heights that the tips can reach, whose normals
    oppose each other within the friction cone; the centre is in the middle or a little off, the
    opening wider than the distance by a margin, and by more where the jaw stands askew to the
    sides. Where too few pairs are found, random ones take their place. The order is mixed.

    Args:
        tabletop: The scene.
        gripper: Its opening range, jaw sizes and friction are used.
        count: How many.
        rng: What they are drawn from.
        antipodal_share: Part of them that is antipodal, in [0, 1].
        jaws: Jaw sizes (m) to draw from; those of the gripper where none are given.

    Returns:
        Exactly ``count`` grasps; none where the table is bare.

    Raises:
        InvalidInputError: The count is negative, the share is not in [0, 1], or a jaw size is not
            positive.
    """
    sizes = np.array(gripper.jaw_sizes_m if jaws is None else jaws, dtype=np.float64)
    if count < 0:
        raise InvalidInputError("count of grasps", count, "0 or more")
    if not 0 <= antipodal_share <= 1:
        raise InvalidInputError("antipodal share", antipodal_share, "a part of 1")
    if sizes.ndim != 1 or not len(sizes) or not (sizes > 0).all():
        raise InvalidInputError("jaws", sizes.tolist(), "one or more sizes in metres, above 0")
    height_map = tabletop.height_map
    if not count or not height_map.mask().any():
        return TableGrasps.empty()
    pairs = _antipodal(height_map, gripper, sizes, round(count * antipodal_share), rng)
    others = _random(height_map, gripper, sizes, count - len(pairs), rng)
    # Sines differ between machines in their last bits; rounded, the grasps do not.
    rows = np.round(np.concatenate([pairs, others]), _DECIMALS)[rng.permutation(count)]
    width = np.clip(rows[:, 3], gripper.min_opening_m, gripper.max_opening_m)
    return TableGrasps(rows[:, :2], rows[:, 2], width, rows[:, 4])


def _random(
    height_map: HeightMap, gripper: Gripper, jaws: Floats, count: int, rng: np.random.Generator
) -> Floats:
    """(count, 5) x, y, angle, opening, jaw."""
    from scipy.ndimage import distance_transform_edt

    side = height_map.resolution_m
    pad = math.ceil(BESIDE_M / side)
    mask = np.pad(height_map.mask(), pad)
    cells = np.argwhere(distance_transform_edt(~mask) * side <= BESIDE_M) - pad
    within = height_map.middles(cells[rng.integers(len(cells), size=count)])
    extent = float(np.hypot(*height_map.heights_m.shape)) * side + 2 * BESIDE_M
    low = max(gripper.min_opening_m, min(_LEAST_OPENING_M, gripper.max_opening_m))
    high = max(low, min(gripper.max_opening_m, extent))
    return np.column_stack(
        [
            within + rng.uniform(-0.5, 0.5, (count, 2)) * side,
            rng.uniform(-np.pi / 2, np.pi / 2, count),
            np.exp(rng.uniform(np.log(low), np.log(high), count)),
            rng.choice(jaws, count),
        ]
    )


@dataclass(frozen=True)
class _Cut:
    """The height map cut at one height.

    Args:
        mask: (R, C) what is higher.
        slope: Two (R, C) float32: how the blurred mask grows with the row, and with the column.
        borders: (B, 2) column, row of the middle of each border (cells).
        normals: (B, 2) its outward normal.
    """

    mask: NDArray[np.bool_]
    slope: tuple[NDArray[np.float32], NDArray[np.float32]]
    borders: Floats
    normals: Floats


def _cut(heights: NDArray[np.float32], level: float, depth_m: float) -> _Cut:
    """Cut a padded height map; the borders are those less than ``depth_m`` below their top."""
    from scipy.ndimage import gaussian_filter

    mask = heights > level
    down, right = np.gradient(gaussian_filter(mask.astype(np.float32), _BLUR_CELLS))
    reached = mask & (heights <= level + depth_m)
    borders, normals = [], []
    for step in ((0, 1), (0, -1), (1, 0), (-1, 0)):
        row, column = np.nonzero(reached & ~np.roll(mask, (-step[0], -step[1]), axis=(0, 1)))
        beside = (row + step[0], column + step[1])
        # In a wall one cell thick the slope vanishes: its outer neighbour still knows the side.
        normal = np.stack(
            [-right[row, column] - right[beside], -down[row, column] - down[beside]], axis=-1
        ).astype(np.float64)
        borders.append(np.stack([column + step[1] / 2, row + step[0] / 2], axis=-1))
        normals.append(normal)
    points, normal = np.concatenate(borders), np.concatenate(normals)
    length = np.hypot(normal[:, 0], normal[:, 1])
    sure = length > 0
    return _Cut(mask, (down, right), points[sure], normal[sure] / length[sure, None])


def _levels(heights: NDArray[np.float32], gripper: Gripper) -> Floats:
    """(at most LEVELS,) heights that the tips reach beside edges, more where more edges are."""
    low = gripper.table_clearance_m + 0.001
    drop = np.zeros(heights.shape, np.float32)
    for shift, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        np.maximum(drop, heights - np.roll(heights, shift, axis), out=drop)
    edges = (drop > 0) & (heights > low)
    tops = heights[edges].astype(np.float64)
    if not len(tops):
        return np.zeros(0)
    reached = np.maximum(tops - gripper.max_depth_m * np.array(_DEPTHS)[:, None], low).ravel()
    order = np.argsort(reached, kind="stable")
    # A step of a centimetre is as good an edge as any.
    weight = np.tile(np.minimum(drop[edges], _FULL_EDGE_M), len(_DEPTHS))[order]
    passed = np.cumsum(weight, dtype=np.float64)
    wanted = (np.arange(LEVELS) + 0.5) / LEVELS * passed[-1]
    return np.asarray(reached[order][np.searchsorted(passed, wanted)])


def _antipodal(
    height_map: HeightMap, gripper: Gripper, jaws: Floats, count: int, rng: np.random.Generator
) -> Floats:
    """(at most count, 5) x, y, angle, opening, jaw."""
    heights = np.pad(height_map.heights_m, _PAD_CELLS)
    found = [np.zeros((0, 5))]
    levels, repeats = np.unique(_levels(heights, gripper), return_counts=True)
    ends = (count * np.cumsum(repeats) / LEVELS).round().astype(int)
    for level, share in zip(levels, np.diff(ends, prepend=0), strict=True):
        cut = _cut(heights, float(level), gripper.max_depth_m)
        if share and len(cut.borders):
            found.append(_pairs(cut, height_map, gripper, rng.choice(jaws, _TRIES * share), rng))
            found[-1] = found[-1][:share]
    return np.concatenate(found)


def _pairs(
    cut: _Cut, height_map: HeightMap, gripper: Gripper, jaw: Floats, rng: np.random.Generator
) -> Floats:
    """(at most N, 5) x, y, angle, opening, jaw of grasps across opposite sides of a cut.

    Args:
        cut: The height map, padded, cut at one height.
        height_map: The height map itself.
        gripper: The gripper.
        jaw: (N,) jaw sizes, one for each try.
        rng: What the sides and directions are drawn from.
    """
    from graspmap.generation._candidate_kernel import opposite_sides

    side, tries = height_map.resolution_m, len(jaw)
    first = rng.integers(len(cut.borders), size=tries)
    cone = math.atan(gripper.friction)
    turn = rng.triangular(-cone, 0.0, cone, tries)
    inward, c, s = -cut.normals[first], np.cos(turn), np.sin(turn)
    along = np.stack(
        [inward[:, 0] * c - inward[:, 1] * s, inward[:, 0] * s + inward[:, 1] * c], axis=-1
    )
    start, distance = cut.borders[first], np.empty(tries)
    reach = (gripper.max_opening_m - MARGIN_M[0]) / side
    choice = rng.random(tries)
    opposite_sides(cut.mask, cut.slope, start, along, choice, reach, math.cos(cone), distance)
    width = distance * side
    margin = rng.uniform(*MARGIN_M, tries) + rng.uniform(0, MARGIN_SHARE, tries) * width
    askew = jaw * gripper.jaw_contact_share * np.abs(np.tan(turn))
    opening = np.clip(width + margin + askew, gripper.min_opening_m, gripper.max_opening_m)
    middle = (start - _PAD_CELLS + along * (distance / 2)[:, None]) * side
    shift = rng.uniform(-0.25, 0.25, tries) * (opening - width - askew).clip(0)
    center = height_map.origin_m + middle + along * shift[:, None]
    rows = np.column_stack([center, np.arctan2(along[:, 1], along[:, 0]), opening, jaw])
    return rows[distance >= 0]
