"""A rigid object from a height map: columns of matter from the table up to the heights.

Letters in shapes: R rows (y), C columns (x) of cells; V vertices, F triangles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graspmap.geometry.transforms import RigidTransform
from graspmap.simulation.columns import ColumnTolerance, convex_columns
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.tabletop import PlacedObject

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Integers = NDArray[np.int64]


def block_from_heights(
    id: str,
    heights_m: Floats,
    origin_m: Floats,
    resolution_m: float,
    *,
    density_kg_m3: float,
    mass_range_kg: tuple[float, float],
    tolerance: ColumnTolerance | None = None,
) -> PlacedObject:
    """The block under a height map, standing on the table.

    Args:
        id: Its name.
        heights_m: (R, C) metres, 0 where there is none of it.
        origin_m: (2,) world x, y of the middle of cell [0, 0].
        resolution_m: Side of a cell.
        density_kg_m3: Of the block, where its mass stays within the range.
        mass_range_kg: Least and greatest mass.
        tolerance: How closely its convex pieces follow the map.
    """
    volume, center, moments = column_moments(heights_m, resolution_m)
    mass = float(np.clip(volume * density_kg_m3, *mass_range_kg))
    vertices, faces = height_mesh(heights_m, resolution_m)
    pieces = convex_columns(heights_m, resolution_m, tolerance)
    model = ObjectModel(
        id=id,
        vertices=vertices - center,
        faces=faces.astype(np.int32),
        pieces=tuple(piece - center for piece in pieces),
        mass_kg=mass,
        inertia=moments * (mass / volume),
    )
    place = np.array([center[0] + origin_m[0], center[1] + origin_m[1], center[2]])
    return PlacedObject(model, RigidTransform(np.eye(3), place))


def column_moments(heights_m: Floats, resolution_m: float) -> tuple[float, Floats, Floats]:
    """Volume, centre of mass and moments of inertia at density 1 of columns with level tops.

    Args:
        heights_m: (R, C) metres.
        resolution_m: Side of a cell.

    Returns:
        Cubic metres; (3,) metres, x and y from the middle of cell [0, 0]; (3, 3) m^5 about the
        centre of mass.
    """
    rows, columns = np.nonzero(heights_m)
    height = heights_m[rows, columns]
    volumes = height * resolution_m**2
    volume = float(volumes.sum())
    middles = np.column_stack([columns * resolution_m, rows * resolution_m, height / 2])
    center = volumes @ middles / volume
    away = middles - center
    second = (volumes[:, None] * away).T @ away
    # What each column adds about its own middle.
    own = volume * resolution_m**2 / 12
    second += np.diag([own, own, float((volumes * height**2).sum()) / 12])
    return volume, center, np.trace(second) * np.eye(3) - second


def height_mesh(heights_m: Floats, resolution_m: float) -> tuple[Floats, Integers]:
    """A closed surface around the columns, its top smoothed over the corners of the cells.

    Args:
        heights_m: (R, C) metres, 0 where there is nothing.
        resolution_m: Side of a cell.

    Returns:
        (V, 3) metres, x and y from the middle of cell [0, 0], the bottom at z = 0, and (F, 3)
        vertex numbers, counter-clockwise seen from outside. Each edge belongs to two triangles.
    """
    solid = heights_m > 0
    corners, places, tops = _corners(heights_m, solid)
    count = len(tops)
    xy = (places - 0.5) * resolution_m
    vertices = np.concatenate([np.column_stack([xy, tops]), np.column_stack([xy, np.zeros(count)])])
    # Corners of a cell in the order (x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1).
    a, b, c, d = corners.T
    top = [np.column_stack([a, b, c]), np.column_stack([a, c, d])]
    bottom = [t[:, ::-1] + count for t in top]
    walls = []
    rows, columns = np.nonzero(solid)
    around = np.pad(solid, 1)
    for (dr, dc), (i, j) in (
        ((-1, 0), (0, 1)),
        ((0, 1), (1, 2)),
        ((1, 0), (2, 3)),
        ((0, -1), (3, 0)),
    ):
        open_side = ~around[rows + 1 + dr, columns + 1 + dc]
        p, q = corners[open_side, i], corners[open_side, j]
        walls += [np.column_stack([p, p + count, q + count]), np.column_stack([p, q + count, q])]
    return vertices, np.concatenate([*top, *bottom, *walls])


def _corners(heights_m: Floats, solid: Mask) -> tuple[Integers, Integers, Floats]:
    """Corner numbers (cells, 4), their places (x, y) in cell sides, and the mean heights there.

    Where two cells touch at a corner only, each has a corner of its own: an edge between them
    would belong to four triangles.
    """
    rows, columns = heights_m.shape
    padded, filled = np.pad(heights_m, 1), np.pad(solid, 1)
    four = [filled[i : i + rows + 1, j : j + columns + 1] for i in (0, 1) for j in (0, 1)]
    high = [padded[i : i + rows + 1, j : j + columns + 1] for i in (0, 1) for j in (0, 1)]
    mean = sum(high) / np.maximum(sum(f.astype(np.int64) for f in four), 1)
    split = (four[0] & four[3] & ~four[1] & ~four[2]) | (four[1] & four[2] & ~four[0] & ~four[3])
    r, c = np.nonzero(solid)
    place = np.stack(
        [np.stack([r + dy, c + dx], -1) for dy, dx in ((0, 0), (0, 1), (1, 1), (1, 0))]
    )
    # At a split corner the cell above it (its lower two corners) takes a second number.
    upper = np.array([False, False, True, True])[:, None]
    second = split[place[..., 0], place[..., 1]] & upper
    key = (place[..., 0] * (columns + 1) + place[..., 1]) * 2 + second
    kept, number = np.unique(key.T.ravel(), return_inverse=True)
    at = kept // 2
    places = np.column_stack([at % (columns + 1), at // (columns + 1)])
    tops = mean.ravel()[at]
    own = split.ravel()[at]
    if own.any():
        # The lower cell starts at the corner's row, the upper one ends there.
        y, x = places[own, 1], places[own, 0]
        upward = kept[own] % 2 == 1
        row = np.where(upward, y, y + 1)
        pair = padded[row, x], padded[row, x + 1]
        tops[own] = np.maximum(*pair)
    return number.reshape(-1, 4).astype(np.int64), places, tops
