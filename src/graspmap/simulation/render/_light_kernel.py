"""Compiled light: which lamps a point sees, and what colour it then has.

A lamp with an extent is several points. From each the objects are drawn once, as from a camera;
a point in the scene is lit when nothing in that picture is nearer.

Letters in shapes: V vertices, F triangles, K points that give light.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._raster_kernel import draw_triangles, to_frame
from graspmap.simulation.render._texture_kernel import GLASS, METAL, REFLECTANCE, ROUGHNESS

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

# Places in the row of a lamp's picture: origin, axes x, y, z, then focal length and centre, then
# least and greatest x and y on the table of the objects' shadow.
_FOCAL, _CX, _CY, _FALLEN = 12, 13, 14, 15
POSE_LENGTH = 19

# Places in the numbers of the whole scene's light.
KEY, KEY_COLOUR, FILL, FILL_COLOUR, SKY, GROUND = 0, 3, 6, 9, 12, 15
_BLOCK = 32  # points that are looked at together

LENGTH = 18
"""Numbers of the scene's light: position of the lamp, its colour, direction to the second lamp, its
colour, colour from above, colour of the table."""


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _shadow(points: Floats, lamp: Floats) -> Any:
    """(4,) least and greatest x, then y, on the table of the shadow of points."""
    out = np.array([np.inf, -np.inf, np.inf, -np.inf])
    for i in range(len(points)):
        above = lamp[2] - points[i, 2]
        if above <= 0.0:
            return np.array([-np.inf, np.inf, -np.inf, np.inf])
        for k in range(2):
            place = lamp[k] + (points[i, k] - lamp[k]) * lamp[2] / above
            out[2 * k], out[2 * k + 1] = min(out[2 * k], place), max(out[2 * k + 1], place)
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lamp_pictures(
    points: Floats, faces: Integers, drawn: NDArray[np.uint8], lamps: Floats, side: int
) -> Any:
    """Depths of the objects as seen from each lamp, cut to fit them.

    Args:
        points: (V, 3) world vertices.
        faces: (F, 3) vertex numbers.
        drawn: (F,) which triangles keep light away, as `draw_triangles` has it.
        lamps: (K, 3) world positions.
        side: Side of the pictures, pixels.

    Returns:
        (K, side, side) float32 depths, infinite where there is nothing; (K, POSE_LENGTH) where they look.
    """
    pictures = np.full((len(lamps), side, side), np.float32(np.inf), np.float32)
    poses = np.zeros((len(lamps), POSE_LENGTH))
    none = np.empty((0, 0), np.int32)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(len(points)):
        for k in range(3):
            low[k], high[k] = min(low[k], points[i, k]), max(high[k], points[i, k])
    for lamp in range(len(lamps)):
        axes = np.empty((3, 3))
        z = 0.5 * (low + high) - lamps[lamp]
        z /= math.sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2])
        # Any direction across will do; the world's x unless it is along.
        if abs(z[0]) < 0.9:
            x = np.array([0.0, z[2], -z[1]])
        else:
            x = np.array([-z[2], 0.0, z[0]])
        x /= math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
        axes[:, 0], axes[:, 2] = x, z
        axes[0, 1] = z[1] * x[2] - z[2] * x[1]
        axes[1, 1] = z[2] * x[0] - z[0] * x[2]
        axes[2, 1] = z[0] * x[1] - z[1] * x[0]
        seen = to_frame(points, axes, lamps[lamp])
        left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
        for i in range(len(seen)):
            u, v = seen[i, 0] / seen[i, 2], seen[i, 1] / seen[i, 2]
            left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
        focal = (side - 4.0) / max(right - left, bottom - top, 1e-9)
        middle = 0.5 * (side - 1.0)
        cx, cy = middle - focal * 0.5 * (left + right), middle - focal * 0.5 * (top + bottom)
        draw_triangles(seen, faces, drawn, (focal, focal, cx, cy), pictures[lamp], none)
        pose = poses[lamp]
        pose[:3] = lamps[lamp]
        for k in range(3):
            pose[3 + 3 * k : 6 + 3 * k] = axes[:, k]
        pose[_FOCAL], pose[_CX], pose[_CY] = focal, cx, cy
        pose[_FALLEN:] = _shadow(points, lamps[lamp])
    return pictures, poses


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _lit(
    picture: Singles, pose: Floats, bias: float, points: Floats, first: int, end: int, out: Floats
) -> None:
    """Share of a light that reaches points, between the four nearest pixels of its picture.

    Args:
        picture: (side, side) depths seen from the light.
        pose: (POSE_LENGTH,) where it looks.
        bias: How much nearer than a point something must be to shadow it, metres.
        points: (3, n) world.
        first: Of the points that count.
        end: One past the last of them.
        out: (n,) out, at the same places.
    """
    ox, oy, oz = pose[0], pose[1], pose[2]
    focal, cx, cy = pose[_FOCAL], pose[_CX], pose[_CY]
    ax, ay, az = focal * pose[3], focal * pose[4], focal * pose[5]
    bx, by, bz = focal * pose[6], focal * pose[7], focal * pose[8]
    dx, dy, dz = pose[9], pose[10], pose[11]
    last = picture.shape[0] - 1.0
    for i in range(first, end):
        x, y, z = points[0, i] - ox, points[1, i] - oy, points[2, i] - oz
        depth = dx * x + dy * y + dz * z
        scale = 1.0 / depth
        u = (ax * x + ay * y + az * z) * scale + cx
        v = (bx * x + by * y + bz * z) * scale + cy
        if not (0.0 <= u < last and 0.0 <= v < last):
            out[i] = 1.0
            continue
        column, row = np.uint32(u), np.uint32(v)
        right, below = np.uint32(column + 1), np.uint32(row + 1)
        a, b = u - column, v - row
        limit = np.float32(depth - bias)
        one, two = picture[row, column] >= limit, picture[row, right] >= limit
        three, four = picture[below, column] >= limit, picture[below, right] >= limit
        if one and two and three and four:
            out[i] = 1.0
        elif not (one or two or three or four):
            out[i] = 0.0
        else:
            above = (1.0 - a) * one + a * two
            out[i] = (1.0 - b) * above + b * ((1.0 - a) * three + a * four)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def table_light(
    pictures: Singles,
    poses: Floats,
    shares: Floats,
    bias: float,
    points: Floats,
    out: Floats,
) -> None:
    """Light that reaches points of the table.

    Args:
        pictures: (K, side, side).
        poses: (K, POSE_LENGTH).
        shares: (K,) of each point that gives light; 1 in sum.
        bias: How much nearer than a point something must be to shadow it, metres.
        points: (3, n) world points on the table, neighbours one after the other.
        out: (n,) out, from 0 to 1.
    """
    lit = np.empty(len(out))
    for first in range(0, len(out), _BLOCK):
        end = min(first + _BLOCK, len(out))
        left = right = points[0, first]
        low = high = points[1, first]
        for i in range(first, end):
            out[i] = 1.0
            left, right = min(left, points[0, i]), max(right, points[0, i])
            low, high = min(low, points[1, i]), max(high, points[1, i])
        for k in range(len(poses)):
            # Most neighbours lie wholly beside the shadow.
            if right < poses[k, _FALLEN] or left > poses[k, _FALLEN + 1]:
                continue
            if high < poses[k, _FALLEN + 2] or low > poses[k, _FALLEN + 3]:
                continue
            _lit(pictures[k], poses[k], bias, points, first, end, lit)
            for i in range(first, end):
                out[i] -= shares[k] * (1.0 - lit[i])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def object_light(
    pictures: Singles,
    poses: Floats,
    shares: Floats,
    bias: float,
    points: Floats,
    normals: Floats,
    facing: bool,
    out: Floats,
) -> None:
    """Light that reaches points of objects.

    Args:
        pictures: (K, side, side).
        poses: (K, POSE_LENGTH).
        shares: (K,) of each point that gives light.
        bias: How much nearer than a point something must be to shadow it, metres.
        points: (3, n) world.
        normals: (3, n) unit.
        facing: Whether light counts by the cosine at which it arrives.
        out: (n,) out.
    """
    lit = np.empty(len(out))
    out[:] = 0.0
    for k in range(len(poses)):
        _lit(pictures[k], poses[k], bias, points, 0, len(out), lit)
        share = shares[k]
        # The axis z of the picture looks from the light down.
        dx, dy, dz = -poses[k, 9], -poses[k, 10], -poses[k, 11]
        if facing:
            for i in range(len(out)):
                cosine = dx * normals[0, i] + dy * normals[1, i] + dz * normals[2, i]
                out[i] += share * max(cosine, 0.0) * lit[i]
        else:
            for i in range(len(out)):
                out[i] += share * lit[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def light_numbers(light: Floats) -> Any:
    """The scene's light as six triples: lamp, its colour, second lamp, its colour, sky, ground."""
    return (
        (light[KEY], light[KEY + 1], light[KEY + 2]),
        (light[KEY_COLOUR], light[KEY_COLOUR + 1], light[KEY_COLOUR + 2]),
        (light[FILL], light[FILL + 1], light[FILL + 2]),
        (light[FILL_COLOUR], light[FILL_COLOUR + 1], light[FILL_COLOUR + 2]),
        (light[SKY], light[SKY + 1], light[SKY + 2]),
        (light[GROUND], light[GROUND + 1], light[GROUND + 2]),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _surroundings(x: float, y: float, z: float, rough: float) -> Any:
    """How much of the sky and of the table a mirror sees in a direction, in a room with a window.

    Args:
        x: Unit direction, as are y and z.
        y: See x.
        z: See x.
        rough: Roughness of the mirror; it blurs.
    """
    up = min(max(z / (0.16 + 1.2 * rough) + 0.5, 0.0), 1.0)
    # The window is a band in the walls.
    band = min(max((x * 0.8 + y * 0.6 - 0.45) / (0.1 + rough) + 0.5, 0.0), 1.0)
    band *= min(max((0.75 - z) / (0.15 + rough) + 0.5, 0.0), 1.0)
    sky = (0.55 + 0.75 * min(max(z, 0.0), 1.0)) * (0.6 + 1.3 * band)
    return sky * up, (0.35 + 0.35 * rough) * (1.0 - up)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _highlight(n: Any, to_lamp: Any, eye: Any, facing: float, view: float, rough: float) -> float:
    """How strongly a surface mirrors the lamp."""
    hx, hy, hz = to_lamp[0] + eye[0], to_lamp[1] + eye[1], to_lamp[2] + eye[2]
    size = hx * hx + hy * hy + hz * hz + 1e-12
    cosine = max(n[0] * hx + n[1] * hy + n[2] * hz, 0.0)
    alpha = rough * rough
    square, half = alpha * alpha, alpha * 0.5
    width = cosine * cosine / size * (square - 1.0) + 1.0
    masking = (facing * (1.0 - half) + half) * (view * (1.0 - half) + half)
    return min(square / (width * width * 4.0 * masking), 12.0) * facing


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _channel(
    own: float, base: float, metal: float, diffuse: float, seen: float, shine: float, grazing: float
) -> float:
    """One colour channel of what leaves a surface."""
    tint = base + (own - base) * metal
    mirror = tint + (1.0 - tint) * grazing
    return own * (1.0 - metal) * (1.0 - mirror) * diffuse + mirror * seen + tint * shine


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shaded(
    finish: Any,
    numbers: Any,
    own: Any,
    p: Any,
    n: Any,
    eye: Any,
    lamp: float,
    sky: float,
) -> Any:
    """Linear red, green, blue that leave a surface towards the eye; there is no choice in it.

    Args:
        finish: Roughness, metal and reflectance.
        numbers: The scene's light, of `light_numbers`.
        own: Own colour.
        p: World point.
        n: Unit normal.
        eye: Unit direction to the camera.
        lamp: Share of the lamp that it sees.
        sky: Light from above.

    References:
        B. Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007
        (the distribution GGX); C. Schlick, "An inexpensive BRDF model", 1994.
    """
    rough, metal, base = finish
    place, key, fill, fill_colour, above, ground = numbers
    lx, ly, lz = place[0] - p[0], place[1] - p[1], place[2] - p[2]
    near = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * near, ly * near, lz * near
    facing = max(n[0] * lx + n[1] * ly + n[2] * lz, 0.0)
    second = max(n[0] * fill[0] + n[1] * fill[1] + n[2] * fill[2], 0.0)
    open_ = 0.35 + 0.65 * min(sky * 1.2, 1.0)
    first, second, bounce = facing * lamp, second * open_, (0.3 - 0.3 * n[2]) * open_
    view = max(n[0] * eye[0] + n[1] * eye[1] + n[2] * eye[2], 1e-3)
    shine = _highlight(n, (lx, ly, lz), eye, facing, view, rough) * lamp
    rx, ry, rz = 2.0 * view * n[0] - eye[0], 2.0 * view * n[1] - eye[1], 2.0 * view * n[2] - eye[2]
    up, down = _surroundings(rx, ry, rz, rough)
    up, down = up * open_, down * open_
    grazing = (1.0 - view) * (1.0 - view)
    grazing = grazing * grazing * (1.0 - view) * (1.0 - 0.7 * rough)
    # A surface that mirrors nothing does not do so at an angle either.
    grazing *= min(base * 50.0, 1.0)
    red = first * key[0] + second * fill_colour[0] + sky * above[0] + bounce * ground[0]
    green = first * key[1] + second * fill_colour[1] + sky * above[1] + bounce * ground[1]
    blue = first * key[2] + second * fill_colour[2] + sky * above[2] + bounce * ground[2]
    seen = up * above[0] + down * ground[0]
    red = _channel(own[0], base, metal, red, seen, shine * key[0], grazing)
    seen = up * above[1] + down * ground[1]
    green = _channel(own[1], base, metal, green, seen, shine * key[1], grazing)
    seen = up * above[2] + down * ground[2]
    blue = _channel(own[2], base, metal, blue, seen, shine * key[2], grazing)
    return red, green, blue


@numba.njit(cache=True, nogil=True, error_model="numpy")
def leave_table(
    finish: Any,
    light: Floats,
    colour: Floats,
    point: Floats,
    back: Floats,
    lamp: Floats,
    sky: Floats,
    out: Floats,
) -> None:
    """Light that leaves points of the table towards the camera.

    Args:
        finish: Roughness, metal and reflectance.
        light: Numbers of the scene's light.
        colour: (3, n) own colour.
        point: (3, n) world.
        back: (3, n) unit direction to the camera.
        lamp: (n,) share of the lamp.
        sky: (n,) light from above.
        out: (3, n) out: linear colour.
    """
    numbers = light_numbers(light)
    for i in range(len(lamp)):
        own, p = (colour[0, i], colour[1, i], colour[2, i]), (point[0, i], point[1, i], point[2, i])
        b = (back[0, i], back[1, i], back[2, i])
        out[0, i], out[1, i], out[2, i] = shaded(
            finish, numbers, own, p, (0.0, 0.0, 1.0), b, lamp[i], sky[i]
        )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def leave_objects(
    rows: Floats,
    owner: NDArray[np.int16],
    light: Floats,
    colour: Floats,
    point: Floats,
    smooth: Floats,
    back: Floats,
    lamp: Floats,
    sky: Floats,
    out: Floats,
) -> None:
    """The same of points of objects.

    Args:
        rows: (N + 1, LENGTH) numbers of surfaces.
        owner: (n,) which of them each point is on.
        light: Numbers of the scene's light.
        colour: (3, n) own colour.
        point: (3, n) world.
        smooth: (3, n) unit normal.
        back: (3, n) unit direction to the camera.
        lamp: (n,) share of the lamp.
        sky: (n,) light from above.
        out: (3, n) out: linear colour.
    """
    numbers = light_numbers(light)
    for i in range(len(lamp)):
        k = owner[i]
        finish = (rows[k, ROUGHNESS], rows[k, METAL], rows[k, REFLECTANCE])
        own, p = (colour[0, i], colour[1, i], colour[2, i]), (point[0, i], point[1, i], point[2, i])
        n, b = (smooth[0, i], smooth[1, i], smooth[2, i]), (back[0, i], back[1, i], back[2, i])
        out[0, i], out[1, i], out[2, i] = shaded(finish, numbers, own, p, n, b, lamp[i], sky[i])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def see_through(
    rows: Floats,
    owner: NDArray[np.int16],
    light: Floats,
    own: Floats,
    smooth: Floats,
    back: Floats,
    behind: Floats,
    out: Floats,
) -> None:
    """Add to glass what lies behind it, darker where it goes askew, and what it mirrors.

    Args:
        rows: (N + 1, LENGTH) numbers of surfaces.
        owner: (n,) which of them each point is on.
        light: Numbers of the scene's light.
        own: (3, n) own colour.
        smooth: (3, n) unit normal.
        back: (3, n) unit direction to the camera.
        behind: (3, n) colour of what lies behind.
        out: (3, n) in and out: linear colour.
    """
    for i in range(len(owner)):
        clear, base = rows[owner[i], GLASS], rows[owner[i], REFLECTANCE]
        facing = smooth[0, i] * back[0, i] + smooth[1, i] * back[1, i] + smooth[2, i] * back[2, i]
        askew = 1.0 - facing
        through = clear * (0.25 + 0.75 * facing * (2.0 - facing))
        mirror = 0.6 * clear * (askew * askew * askew + base)
        for k in range(3):
            seen = through * behind[k, i] * (0.55 + 0.45 * own[k, i])
            out[k, i] = out[k, i] * (1.0 - 0.85 * clear) + seen + mirror * light[SKY + k]
