"""Compiled patterns: the colour of a surface at a point, from integers, products and roots alone.

Nothing here is taken from the C library (sine, power), whose last bits differ between processors.

Letters in shapes: a *surface* is a row of numbers as `graspmap.simulation.render._pack` makes it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled
from graspmap.simulation.render._noise_kernel import (
    cell,
    chance,
    clouds,
    flat_clouds,
    flat_noise,
    hashed,
    noise,
    spots,
    step,
    wave,
)

Floats = NDArray[np.float64]

PATTERNS = (
    "plain",
    "stripes",
    "checker",
    "noise",
    "wood",
    "speckle",
    "marble",
    "patches",
    "picture",
    "planks",
    "cloth",
    "tiles",
)
"""Names of the patterns; their places here are the numbers that the compiled code knows."""

PLAIN, STRIPES, CHECKER, NOISE, WOOD, SPECKLE, MARBLE, PATCHES, PICTURE = range(9)
PLANKS, CLOTH, TILES = range(9, 12)

# Places in the row of a surface.
PATTERN, SCALE, SEED, CONTRAST, COLOUR, SECOND, THIRD = 0, 1, 2, 3, 4, 7, 10
ROUGHNESS, REFLECTANCE, METAL, GLASS, AXIS, WIDTH, HEIGHT, OFFSET = 13, 14, 15, 16, 17, 20, 21, 22
LENGTH = 23
"""Numbers in a row."""


@compiled
def _mix(surface: Floats, t: float, tone: float) -> Any:
    """Between first and second colour, times a tone."""
    c = surface
    return (
        (c[COLOUR] + (c[SECOND] - c[COLOUR]) * t) * tone,
        (c[COLOUR + 1] + (c[SECOND + 1] - c[COLOUR + 1]) * t) * tone,
        (c[COLOUR + 2] + (c[SECOND + 2] - c[COLOUR + 2]) * t) * tone,
    )


@compiled
def _third(surface: Floats) -> Any:
    return surface[THIRD], surface[THIRD + 1], surface[THIRD + 2]


@compiled
def _solid_colour(surface: Floats, x: float, y: float, z: float, pixel: float) -> Any:
    """Linear red, green, blue of an object at a point of its own space.

    Args:
        surface: Row of numbers.
        x: Metres, as are y and z.
        y: See x.
        z: See x.
        pixel: Size of a pixel there, metres; finer detail is left out.
    """
    pattern, seed, scale = int(surface[PATTERN]), int(surface[SEED]), surface[SCALE]
    offset = surface[OFFSET]
    x, y, z, pixel = x / scale + offset, y / scale + offset, z / scale + offset, pixel / scale
    ax, ay, az = surface[AXIS], surface[AXIS + 1], surface[AXIS + 2]
    along = ax * x + ay * y + az * z
    if pattern == STRIPES:
        t = along - math.floor(along)
        soft = max(pixel, 0.02)
        return _mix(surface, step(0.25, soft, t) - step(0.75, soft, t), 1.0)
    if pattern == CHECKER:
        odd = (math.floor(x) + math.floor(y) + math.floor(z)) & 1
        return _mix(surface, float(odd), 1.0)
    if pattern == NOISE:
        t = clouds(x, y, z, seed, pixel)
        return _mix(surface, step(0.5, 0.5, t), 1.0)
    if pattern == WOOD:
        px, py, pz = x - along * ax, y - along * ay, z - along * az
        bend = noise(0.5 * x, 0.5 * y, 0.5 * z, seed)
        rings = math.sqrt(px * px + py * py + pz * pz) * 1.5 + 1.2 * bend
        t = rings - math.floor(rings)
        fibre = noise(6.0 * px + 0.4 * along, 6.0 * py, 6.0 * pz, seed + 1)
        return _mix(surface, 0.85 * t * t, 0.85 + 0.3 * (fibre if pixel < 0.1 else 0.5))
    if pattern == SPECKLE:
        spot, number = spots(2.0 * x, 2.0 * y, 2.0 * z, seed, False)
        if not spot:
            return _mix(surface, 0.0, 1.0)
        return _mix(surface, 1.0, 1.0) if number < 0.6 else _third(surface)
    if pattern == MARBLE:
        t = wave(0.6 * along + 2.2 * clouds(x, y, z, seed, pixel))
        return _mix(surface, t * t * t, 1.0)
    if pattern == PATCHES:
        number = cell(x, y, z, seed)
        if number < 0.4:
            return _mix(surface, 0.0, 1.0)
        return _mix(surface, 1.0, 1.0) if number < 0.75 else _third(surface)
    return _mix(surface, 0.0, 1.0)


@compiled
def _planks(surface: Floats, x: float, y: float, seed: int, pixel: float) -> Any:
    """Boards of wood, side by side, each with a grain of its own."""
    row = math.floor(y)
    board = math.floor(x / 6.0 + chance(int(row), 0, 0, seed))
    number = hashed(int(row), int(board), 1, seed) & 0xFFFF
    shift = float(number & 0xFF)
    away = y - row
    bend = flat_noise(0.45 * x + shift, 1.3 * y, seed + 1)
    grain = wave(3.0 * away + 2.6 * bend + shift)
    fibre = flat_noise(1.6 * x + shift, 34.0 * y, seed + 2) if pixel < 0.03 else 0.5
    t = 0.6 * grain * grain + 0.4 * fibre
    tone = 0.88 + 0.24 * ((number >> 8) / 255.0)
    red, green, blue = _mix(surface, t, tone)
    gap = 0.012 + pixel
    ends = (x / 6.0 + chance(int(row), 0, 0, seed)) - board
    joint = min(away, 1.0 - away) / gap
    butt = min(ends, 1.0 - ends) * 6.0 / gap
    dark = 0.45 + 0.55 * min(joint, butt, 1.0)
    return red * dark, green * dark, blue * dark


@compiled
def _cloth(surface: Floats, x: float, y: float, seed: int, pixel: float) -> Any:
    """Threads over and under each other; where they are finer than pixels, their mean."""
    i, j = math.floor(x), math.floor(y)
    over = (int(i) + int(j)) & 1
    across = y - j if over else x - i
    along = x - i if over else y - j
    round_ = 1.0 - 1.6 * (across - 0.5) * (across - 0.5) * 2.0
    dip = 1.0 - 1.2 * (along - 0.5) * (along - 0.5)
    shade = round_ * dip
    seen = min(max(1.6 - 2.4 * pixel, 0.0), 1.0)
    thread = chance(0 if over else int(i), int(j) if over else 0, over, seed)
    slub = 0.7 + 0.3 * seen * (2.0 * thread - 1.0) * 0.5
    tone = (0.72 + seen * (shade - 0.72)) * slub * 1.55
    wear = flat_clouds(0.02 * x, 0.02 * y, seed + 5, 0.02 * pixel, 3)
    return _mix(surface, 0.35 * wear + (0.65 if over else 0.0) * (0.5 + 0.5 * seen), tone)


@compiled
def _tiles(surface: Floats, x: float, y: float, seed: int, pixel: float) -> Any:
    """Square tiles with joints."""
    i, j = math.floor(x), math.floor(y)
    edge = min(x - i, 1.0 - (x - i), y - j, 1.0 - (y - j))
    joint = step(0.025, 0.012 + pixel, edge)
    tone = 0.93 + 0.14 * chance(int(i), int(j), 0, seed)
    cloud = flat_clouds(
        3.0 * x, 3.0 * y, seed + (hashed(int(i), int(j), 1, seed) & 63), 3.0 * pixel, 3
    )
    red, green, blue = _mix(surface, 0.35 * cloud, tone)
    third_red, third_green, third_blue = _third(surface)
    return (
        third_red + (red - third_red) * joint,
        third_green + (green - third_green) * joint,
        third_blue + (blue - third_blue) * joint,
    )


@compiled
def _veins(x: float, y: float, seed: int, pixel: float) -> Any:
    """How much of a vein of marble a point is, and the tone of the stone around."""
    warp = flat_noise(1.5 * x, 1.5 * y, seed + 31) - 0.5
    total = 0.0
    for k in range(2):
        size = 1.0 + 1.3 * k
        cloud = flat_clouds(size * x + warp, size * y - warp, seed + 50 * k, size * pixel, 4)
        away = abs(2.0 * cloud - 1.0) / (0.05 + 0.16 * flat_noise(x, y, seed + 70 + k))
        total += (0.75 - 0.35 * k) / (1.0 + away * away * away)
    return min(total, 1.0), 0.9 + 0.2 * flat_clouds(0.6 * x, 0.6 * y, seed + 9, pixel, 3)


@compiled
def _table_colour(surface: Floats, x: float, y: float, pixel: float) -> Any:
    """Linear red, green, blue of the table at a point (x, y), metres; see `_solid_colour`."""
    pattern, seed, scale = int(surface[PATTERN]), int(surface[SEED]), surface[SCALE]
    cos, sin = surface[AXIS], surface[AXIS + 1]
    x, y = (cos * x + sin * y) / scale, (cos * y - sin * x) / scale
    x, y, pixel = x + 100.0 + surface[OFFSET], y + 100.0 + surface[OFFSET], pixel / scale
    if pattern == PLANKS:
        return _planks(surface, x, y, seed, pixel)
    if pattern == CLOTH:
        return _cloth(surface, x, y, seed, pixel)
    if pattern == TILES:
        return _tiles(surface, x, y, seed, pixel)
    if pattern == NOISE:
        return _mix(surface, flat_clouds(x, y, seed, pixel, 5), 1.0)
    if pattern == MARBLE:
        return _mix(surface, *_veins(x, y, seed, pixel))
    if pattern == SPECKLE:
        spot, number = spots(x, y, 0.0, seed, True)
        if spot:
            return _mix(surface, 1.0, 0.8 + 0.4 * number) if number < 0.6 else _third(surface)
        return _mix(surface, 0.0, 1.0)
    return _mix(surface, 0.15 * flat_clouds(x, y, seed, pixel, 2), 1.0)


@compiled
def table_colours(row: Floats, point: Floats, pixel: Floats, out: Floats) -> None:
    """Linear colour of the table.

    Args:
        row: Numbers of its surface.
        point: (3, n) world points on it.
        pixel: (n,) size of a pixel there, metres; finer detail is left out.
        out: (3, n) out.
    """
    for i in range(len(pixel)):
        out[0, i], out[1, i], out[2, i] = _table_colour(row, point[0, i], point[1, i], pixel[i])


@compiled
def object_colours(
    rows: Floats,
    owner: NDArray[np.int16],
    rotations: Floats,
    translations: Floats,
    point: Floats,
    pixel: Floats,
    out: Floats,
) -> None:
    """Linear colour of objects, of those that do not wear a picture of their own.

    Args:
        rows: (N + 1, LENGTH) numbers of surfaces.
        owner: (n,) object of each point.
        rotations: (N, 3, 3) of the objects' poses.
        translations: (N, 3) of the same.
        point: (3, n) world points.
        pixel: (n,) size of a pixel there, metres; finer detail is left out.
        out: (3, n) out.
    """
    for i in range(len(pixel)):
        k = owner[i]
        if int(rows[k, PATTERN]) == PICTURE:
            continue
        x, y = point[0, i] - translations[k, 0], point[1, i] - translations[k, 1]
        z, r = point[2, i] - translations[k, 2], rotations[k]
        out[0, i], out[1, i], out[2, i] = _solid_colour(
            rows[k],
            r[0, 0] * x + r[1, 0] * y + r[2, 0] * z,
            r[0, 1] * x + r[1, 1] * y + r[2, 1] * z,
            r[0, 2] * x + r[1, 2] * y + r[2, 2] * z,
            pixel[i],
        )


@compiled
def picture_colours(
    rows: Floats,
    owner: NDArray[np.int16],
    pictures: NDArray[np.float32],
    faces: NDArray[np.int32],
    uv: Floats,
    face: NDArray[np.int32],
    share: Floats,
    out: Floats,
) -> None:
    """Linear colour of objects that wear a picture of their own, between its four nearest pixels.

    Args:
        rows: (N + 1, LENGTH) numbers of surfaces.
        owner: (n,) object of each point.
        pictures: (pixels, 3) all pictures, one after the other, rows from above.
        faces: (F, 3) vertex numbers.
        uv: (V, 2) place of the vertices, (0, 0) the lower left corner; it repeats beyond (1, 1).
        face: (n,) triangle of each point.
        share: (3, n) shares of its corners there.
        out: (3, n) out.
    """
    for i in range(len(owner)):
        k, f = owner[i], face[i]
        if int(rows[k, PATTERN]) != PICTURE:
            continue
        start, width, height = int(rows[k, OFFSET]), int(rows[k, WIDTH]), int(rows[k, HEIGHT])
        u = v = 0.0
        for corner in range(3):
            u += share[corner, i] * uv[faces[f, corner], 0]
            v += share[corner, i] * uv[faces[f, corner], 1]
        x, y = u * width - 0.5, (1.0 - v) * height - 0.5
        fx, fy = math.floor(x), math.floor(y)
        column, row, a, b = int(fx), int(fy), x - fx, y - fy
        left, right = column % width, (column + 1) % width
        top, bottom = start + (row % height) * width, start + ((row + 1) % height) * width
        for channel in range(3):
            above = (1.0 - a) * pictures[top + left, channel] + a * pictures[top + right, channel]
            below = pictures[bottom + left, channel] * (1.0 - a)
            below += pictures[bottom + right, channel] * a
            out[channel, i] = (1.0 - b) * above + b * below
