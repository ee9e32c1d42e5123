"""Compiled loops from visible triangles to a picture: normals, colours, and smooth edges.

Letters in shapes: V vertices, F triangles, N objects, (H, W) the picture, (h, w) the window of it
that holds the objects.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._light_kernel import (
    SKY,
    lamp_light,
    shaded,
    sky_light,
)
from graspmap.simulation.render._texture_kernel import (
    GLASS,
    HEIGHT,
    OFFSET,
    PATTERN,
    PICTURE,
    REFLECTANCE,
    WIDTH,
    picture_colour,
    solid_colour,
    table_colour,
)

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_STEP = 0.06  # of brightness, beyond which an edge is drawn smooth
_TABLE_STEP = 0.12  # the same within the table's pattern


class Geometry(NamedTuple):
    """The objects' surfaces.

    Args:
        world: (V, 3) vertices.
        seen: (V, 3) the same in the camera's frame.
        faces: (F, 3) vertex numbers.
        normals: (F, 3) world, as long as twice the area.
        corners: (F, 3, 3) world, unit normals for shading at the corners.
        owner: (F,) number of the object.
        uv: (V, 2) place in the object's own picture, zeros where it has none.
        rotations: (N, 3, 3) of the objects' poses.
        translations: (N, 3) of the same.
    """

    world: Floats
    seen: Floats
    faces: Integers
    normals: Floats
    corners: Floats
    owner: NDArray[np.int16]
    uv: Floats
    rotations: Floats
    translations: Floats


class Eye(NamedTuple):
    """The camera.

    Args:
        rotation: (3, 3) R_world_camera.
        origin: (3,) its place in the world.
        focal: (fx, fy, cx, cy) pixels.
    """

    rotation: Floats
    origin: Floats
    focal: tuple[float, float, float, float]


class Lamps(NamedTuple):
    """What gives light.

    Args:
        light: Numbers of the scene's light, as `_light_kernel` has them.
        key_pictures: (K, s, s) depths seen from the points of the lamp.
        key_poses: (K, 15).
        key_texel: Size of their pixels at the objects, metres.
        sky_pictures: The same from points of the sky.
        sky_poses: The same.
        sky_texel: The same.
        reach: (x, y, radius) of the table's disk on which a shadow can lie.
    """

    light: Floats
    key_pictures: Singles
    key_poses: Floats
    key_texel: float
    sky_pictures: Singles
    sky_poses: Floats
    sky_texel: float
    reach: tuple[float, float, float]


class Surfaces(NamedTuple):
    """What things look like.

    Args:
        rows: (N + 1, LENGTH) numbers of the objects' surfaces and, last, the table's.
        pictures: (pixels, 3) linear colour of the objects' own pictures, one after the other.
    """

    rows: Floats
    pictures: Singles


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _weights(a: Floats, b: Floats, c: Floats, x: float, y: float) -> Any:
    """Shares of a triangle's corners at the point that the ray (x, y, 1) meets."""
    p = (b[1] * c[2] - b[2] * c[1]) * x + (
        (b[2] * c[0] - b[0] * c[2]) * y + (b[0] * c[1] - b[1] * c[0])
    )
    q = (c[1] * a[2] - c[2] * a[1]) * x + (
        (c[2] * a[0] - c[0] * a[2]) * y + (c[0] * a[1] - c[1] * a[0])
    )
    r = (a[1] * b[2] - a[2] * b[1]) * x + (
        (a[2] * b[0] - a[0] * b[2]) * y + (a[0] * b[1] - a[1] * b[0])
    )
    total = p + q + r
    if total == 0.0:
        return 1.0, 0.0, 0.0
    return p / total, q / total, r / total


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _towards(n: Any, eye: Any) -> Any:
    """A unit normal bent, if need be, until it faces the eye."""
    x, y, z = n
    facing = x * eye[0] + y * eye[1] + z * eye[2]
    if facing < 0.02:
        x, y, z = (
            x + (0.02 - facing) * eye[0],
            y + (0.02 - facing) * eye[1],
            z + (0.02 - facing) * eye[2],
        )
        size = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / size, y / size, z / size
    return x, y, z


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _facing(geometry: Geometry, f: int, eye: Any, share: Any) -> Any:
    """Unit normals at a point of triangle f, flat and smooth, both on the eye's side."""
    g = geometry.normals[f]
    size = math.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
    if size == 0.0:
        return eye, eye
    nx, ny, nz = g[0] / size, g[1] / size, g[2] / size
    c = geometry.corners[f]
    sx = share[0] * c[0, 0] + share[1] * c[1, 0] + share[2] * c[2, 0]
    sy = share[0] * c[0, 1] + share[1] * c[1, 1] + share[2] * c[2, 1]
    sz = share[0] * c[0, 2] + share[1] * c[1, 2] + share[2] * c[2, 2]
    # The back of an open surface is seen as a front.
    if nx * eye[0] + ny * eye[1] + nz * eye[2] < 0.0:
        nx, ny, nz, sx, sy, sz = -nx, -ny, -nz, -sx, -sy, -sz
    long = math.sqrt(sx * sx + sy * sy + sz * sz)
    if long < 1e-6:
        return (nx, ny, nz), (nx, ny, nz)
    return (nx, ny, nz), _towards((sx / long, sy / long, sz / long), eye)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _point(eye: Eye, x: float, y: float, depth: float) -> Any:
    """World point at a depth along the ray (x, y, 1), and the unit direction back to the camera."""
    r = eye.rotation
    dx = r[0, 0] * x + r[0, 1] * y + r[0, 2]
    dy = r[1, 0] * x + r[1, 1] * y + r[1, 2]
    dz = r[2, 0] * x + r[2, 1] * y + r[2, 2]
    size = math.sqrt(dx * dx + dy * dy + dz * dz)
    o = eye.origin
    point = (o[0] + depth * dx, o[1] + depth * dy, o[2] + depth * dz)
    return point, (-dx / size, -dy / size, -dz / size)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _table(eye: Eye, lamps: Lamps, surfaces: Surfaces, x: float, y: float, shadow: float) -> Any:
    """Colour of the table, or of the room beyond it, on the ray (x, y, 1)."""
    light = lamps.light
    r = eye.rotation
    down = -(r[2, 0] * x + r[2, 1] * y + r[2, 2])
    if down <= 1e-3:
        fade = 0.75 + 0.5 * min(max(-down, 0.0), 1.0)
        return light[SKY] * fade, light[SKY + 1] * fade, light[SKY + 2] * fade
    depth = eye.origin[2] / down
    p, back = _point(eye, x, y, depth)
    surface = surfaces.rows[len(surfaces.rows) - 1]
    colour = table_colour(surface, p[0], p[1], depth / eye.focal[0] / max(back[2], 0.05))
    up = (0.0, 0.0, 1.0)
    lamp = sky = 1.0
    dx, dy = p[0] - lamps.reach[0], p[1] - lamps.reach[1]
    if dx * dx + dy * dy < lamps.reach[2] * lamps.reach[2]:
        lamp = lamp_light(lamps.key_pictures, lamps.key_poses, 0.0, p, up)
        sky = sky_light(lamps.sky_pictures, lamps.sky_poses, lamps.sky_texel, p, up, up, True)
        lamp, sky = 1.0 - shadow * (1.0 - lamp), 1.0 - shadow * (1.0 - sky)
    return shaded(surface, light, colour, p, up, back, lamp, sky)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _own_colour(geometry: Geometry, surfaces: Surfaces, f: int, share: Any, p: Any, d: float) -> Any:
    """Colour of an object's surface at a world point of triangle f."""
    owner = geometry.owner[f]
    row = surfaces.rows[owner]
    if int(row[PATTERN]) == PICTURE:
        uv, face = geometry.uv, geometry.faces[f]
        u = share[0] * uv[face[0], 0] + share[1] * uv[face[1], 0] + share[2] * uv[face[2], 0]
        v = share[0] * uv[face[0], 1] + share[1] * uv[face[1], 1] + share[2] * uv[face[2], 1]
        start, width, height = int(row[OFFSET]), int(row[WIDTH]), int(row[HEIGHT])
        return picture_colour(surfaces.pictures, start, width, height, u, v)
    r, t = geometry.rotations[owner], geometry.translations[owner]
    x, y, z = p[0] - t[0], p[1] - t[1], p[2] - t[2]
    return solid_colour(
        row,
        r[0, 0] * x + r[1, 0] * y + r[2, 0] * z,
        r[0, 1] * x + r[1, 1] * y + r[2, 1] * z,
        r[0, 2] * x + r[1, 2] * y + r[2, 2] * z,
        d,
    )


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _object(
    geometry: Geometry,
    eye: Eye,
    lamps: Lamps,
    surfaces: Surfaces,
    f: int,
    x: float,
    y: float,
    depth: float,
) -> Any:
    """Colour of the object whose triangle f the ray (x, y, 1) meets at a depth."""
    face = geometry.faces[f]
    a, b, c = geometry.seen[face[0]], geometry.seen[face[1]], geometry.seen[face[2]]
    share = _weights(a, b, c, x, y)
    p, back = _point(eye, x, y, depth)
    flat, smooth = _facing(geometry, f, back, share)
    colour = _own_colour(geometry, surfaces, f, share, p, depth / eye.focal[0])
    row = surfaces.rows[geometry.owner[f]]
    lamp = lamp_light(lamps.key_pictures, lamps.key_poses, lamps.key_texel, p, flat)
    sky = sky_light(
        lamps.sky_pictures, lamps.sky_poses, lamps.sky_texel, p, flat, smooth, True
    )
    red, green, blue = shaded(row, lamps.light, colour, p, smooth, back, lamp, sky)
    clear = row[GLASS]
    if clear > 0.0:
        # Light through it: the table behind, shifted as by a lens, darker where it goes askew.
        nx, ny = _across(eye, smooth)
        bent = _table(eye, lamps, surfaces, x - 0.03 * nx, y - 0.03 * ny, 0.3)
        facing = smooth[0] * back[0] + smooth[1] * back[1] + smooth[2] * back[2]
        through = clear * (0.25 + 0.75 * facing * (2.0 - facing))
        keep = 1.0 - 0.85 * clear
        red = red * keep + through * bent[0] * (0.55 + 0.45 * colour[0])
        green = green * keep + through * bent[1] * (0.55 + 0.45 * colour[1])
        blue = blue * keep + through * bent[2] * (0.55 + 0.45 * colour[2])
        mirror = (1.0 - facing) * (1.0 - facing) * (1.0 - facing) + row[REFLECTANCE]
        red += 0.6 * clear * mirror * lamps.light[SKY]
        green += 0.6 * clear * mirror * lamps.light[SKY + 1]
        blue += 0.6 * clear * mirror * lamps.light[SKY + 2]
    return red, green, blue


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _across(eye: Eye, n: Any) -> Any:
    """Components of a world direction along the image's x and y."""
    r = eye.rotation
    return (
        r[0, 0] * n[0] + r[1, 0] * n[1] + r[2, 0] * n[2],
        r[0, 1] * n[0] + r[1, 1] * n[1] + r[2, 1] * n[2],
    )


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def fill_channels(
    geometry: Geometry,
    eye: Eye,
    window: Any,
    depth: Floats,
    triangle: Integers,
    normals: Singles,
    instance: NDArray[np.int16],
) -> None:
    """Normals and object numbers from the triangles of the window.

    Args:
        geometry: Surfaces.
        eye: Camera.
        window: (top, bottom, left, right) in the picture.
        depth: (H, W) depths.
        triangle: (h, w) triangles, -1 for the table.
        normals: (H, W, 3) out: unit, world, facing the camera; NaN where there is no depth.
        instance: (H, W) out: -1 where there is no object.
    """
    top, bottom, left, right = window
    fx, fy, cx, cy = eye.focal
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            seen = depth[row, column] < np.inf
            normals[row, column, 0] = normals[row, column, 1] = 0.0 if seen else np.nan
            normals[row, column, 2] = 1.0 if seen else np.nan
            instance[row, column] = -1
    for row in range(top, bottom):
        for column in range(left, right):
            f = triangle[row - top, column - left]
            if f < 0:
                continue
            x, y = (column - cx) / fx, (row - cy) / fy
            face = geometry.faces[f]
            share = _weights(
                geometry.seen[face[0]], geometry.seen[face[1]], geometry.seen[face[2]], x, y
            )
            _, back = _point(eye, x, y, depth[row, column])
            _, smooth = _facing(geometry, f, back, share)
            for k in range(3):
                normals[row, column, k] = smooth[k]
            instance[row, column] = geometry.owner[f]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def colour_pixels(
    geometry: Geometry,
    eye: Eye,
    lamps: Lamps,
    surfaces: Surfaces,
    window: Any,
    depth: Floats,
    triangle: Integers,
    out: Singles,
) -> None:
    """Linear colour at each pixel's centre.

    Args:
        geometry: Surfaces.
        eye: Camera.
        lamps: Light.
        surfaces: Looks.
        window: (top, bottom, left, right) in the picture.
        depth: (H, W) depths.
        triangle: (h, w) triangles, -1 for the table.
        out: (H, W, 3) out.
    """
    top, bottom, left, right = window
    fx, fy, cx, cy = eye.focal
    for row in range(depth.shape[0]):
        y = (row - cy) / fy
        for column in range(depth.shape[1]):
            x = (column - cx) / fx
            f = -1
            if top <= row < bottom and left <= column < right:
                f = triangle[row - top, column - left]
            if f < 0:
                colour = _table(eye, lamps, surfaces, x, y, 1.0)
            else:
                colour = _object(geometry, eye, lamps, surfaces, f, x, y, depth[row, column])
            for k in range(3):
                out[row, column, k] = colour[k]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _differs(colour: Singles, row: int, column: int, other: int, side: int, step: float) -> bool:
    """Whether two pixels are so different that the border between them would look jagged."""
    for k in range(3):
        a, b = min(colour[row, column, k], 1.0), min(colour[other, side, k], 1.0)
        # The eye sees ratios, less so in the dark.
        if abs(a - b) > step * (0.15 + 0.85 * max(a, b)):
            return True
    return False


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def smooth_edges(
    geometry: Geometry,
    eye: Eye,
    lamps: Lamps,
    surfaces: Surfaces,
    window: Any,
    fine_depth: Floats,
    fine_triangle: Integers,
    instance: NDArray[np.int16],
    colour: Singles,
    out: Singles,
) -> int:
    """Pixels on edges again, as the mean of four points of each.

    Args:
        geometry: Surfaces.
        eye: Camera.
        lamps: Light.
        surfaces: Looks.
        window: (top, bottom, left, right) in the picture.
        fine_depth: (2h, 2w) depths of the window at twice the resolution.
        fine_triangle: (2h, 2w) triangles, -1 for the table.
        instance: (H, W) object numbers.
        colour: (H, W, 3) colour at the centres.
        out: (H, W, 3) out; it holds a copy of ``colour``.

    Returns:
        How many pixels were done again.
    """
    top, bottom, left, right = window
    fx, fy, cx, cy = eye.focal
    rows, columns = instance.shape
    done = 0
    for row in range(rows):
        for column in range(columns):
            here = instance[row, column]
            edge = False
            for k in range(4):
                other, side = row + (k == 0) - (k == 1), column + (k == 2) - (k == 3)
                if 0 <= other < rows and 0 <= side < columns:
                    there = instance[other, side]
                    step = _TABLE_STEP if here < 0 and there < 0 else _STEP
                    if here != there or _differs(colour, row, column, other, side, step):
                        edge = True
                        break
            if not edge:
                continue
            done += 1
            red = green = blue = 0.0
            inside = top <= row < bottom and left <= column < right
            for k in range(4):
                i, j = k >> 1, k & 1
                x = (column - 0.25 + 0.5 * j - cx) / fx
                y = (row - 0.25 + 0.5 * i - cy) / fy
                f, z = -1, 0.0
                if inside:
                    f = fine_triangle[2 * (row - top) + i, 2 * (column - left) + j]
                    z = fine_depth[2 * (row - top) + i, 2 * (column - left) + j]
                if f < 0:
                    c = _table(eye, lamps, surfaces, x, y, 1.0)
                else:
                    c = _object(geometry, eye, lamps, surfaces, f, x, y, z)
                red, green, blue = (
                    red + min(c[0], 1.2),
                    green + min(c[1], 1.2),
                    blue + min(c[2], 1.2),
                )
            out[row, column, 0] = 0.25 * red
            out[row, column, 1] = 0.25 * green
            out[row, column, 2] = 0.25 * blue
    return done
