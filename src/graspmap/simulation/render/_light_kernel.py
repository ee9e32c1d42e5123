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
from graspmap.simulation.render._texture_kernel import METAL, REFLECTANCE, ROUGHNESS

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

# Places in the row of a lamp's picture: origin, axes x, y, z, then focal length and centre.
_FOCAL, _CX, _CY = 12, 13, 14

# Places in the numbers of the whole scene's light.
KEY, KEY_COLOUR, FILL, FILL_COLOUR, SKY, GROUND, TO_KEY = 0, 3, 6, 9, 12, 15, 18
_BLOCK = 32  # points that are looked at together

LENGTH = 21
"""Numbers of the scene's light: position of the lamp, its colour, direction to the second lamp, its
colour, colour from above, colour of the table, direction to the lamp from the origin."""


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lamp_pictures(
    points: Floats, faces: Integers, drawn: NDArray[np.bool_], lamps: Floats, side: int
) -> Any:
    """Depths of the objects as seen from each lamp, cut to fit them.

    Args:
        points: (V, 3) world vertices.
        faces: (F, 3) vertex numbers.
        drawn: (F,) triangles that keep light away.
        lamps: (K, 3) world positions.
        side: Side of the pictures, pixels.

    Returns:
        (K, side, side) float32 depths, infinite where there is nothing; (K, 15) where they look.
    """
    pictures = np.full((len(lamps), side, side), np.float32(np.inf), np.float32)
    poses = np.zeros((len(lamps), 15))
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
    return pictures, poses


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _lit(
    picture: Singles, pose: Floats, bias: float, lifted: Floats, boxes: Floats, out: Floats
) -> None:
    """Share of a light that reaches points, between the four nearest pixels of its picture.

    Args:
        picture: (side, side) depths seen from the light.
        pose: (15,) where it looks.
        bias: How much nearer than a point something must be to shadow it, metres.
        lifted: (3, n) world points.
        boxes: (blocks, 6) middle and half size of the box around each block of points.
        out: (n,) out.
    """
    ox, oy, oz = pose[0], pose[1], pose[2]
    focal, cx, cy = pose[_FOCAL], pose[_CX], pose[_CY]
    ax, ay, az = focal * pose[3], focal * pose[4], focal * pose[5]
    bx, by, bz = focal * pose[6], focal * pose[7], focal * pose[8]
    dx, dy, dz = pose[9], pose[10], pose[11]
    last = picture.shape[0] - 1.0
    for block in range(len(boxes)):
        first, end = block * _BLOCK, min((block + 1) * _BLOCK, lifted.shape[1])
        # Most blocks lie wholly on one side of the picture.
        x, y, z = boxes[block, 0] - ox, boxes[block, 1] - oy, boxes[block, 2] - oz
        hx, hy, hz = boxes[block, 3], boxes[block, 4], boxes[block, 5]
        if (
            _greatest(ax + cx * dx, ay + cx * dy, az + cx * dz, x, y, z, hx, hy, hz) < 0.0
            or _greatest(bx + cy * dx, by + cy * dy, bz + cy * dz, x, y, z, hx, hy, hz) < 0.0
            or _greatest(
                (last - cx) * dx - ax,
                (last - cx) * dy - ay,
                (last - cx) * dz - az,
                *(x, y, z, hx, hy, hz),
            )
            < 0.0
            or _greatest(
                (last - cy) * dx - bx,
                (last - cy) * dy - by,
                (last - cy) * dz - bz,
                *(x, y, z, hx, hy, hz),
            )
            < 0.0
        ):
            for i in range(first, end):
                out[i] = 1.0
            continue
        for i in range(first, end):
            x, y, z = lifted[0, i] - ox, lifted[1, i] - oy, lifted[2, i] - oz
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
def _greatest(
    a: float,
    b: float,
    c: float,
    x: float,
    y: float,
    z: float,
    hx: float,
    hy: float,
    hz: float,
) -> float:
    """Greatest value of a x + b y + c z in a box."""
    return a * x + b * y + c * z + abs(a) * hx + abs(b) * hy + abs(c) * hz


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _lifted(point: Floats, normal: Floats, which: Integers, height: float) -> Any:
    """(3, n) points a little above their surfaces, which keeps these from shadowing themselves.

    Returns:
        The points, and (blocks, 6) middle and half size of the box around each block of them.
    """
    out = np.empty((3, len(which)))
    for j in range(len(which)):
        for k in range(3):
            out[k, j] = point[which[j], k] + height * normal[which[j], k]
    boxes = np.empty(((len(which) + _BLOCK - 1) // _BLOCK, 6))
    for block in range(len(boxes)):
        first, end = block * _BLOCK, min((block + 1) * _BLOCK, len(which))
        for k in range(3):
            low = high = out[k, first]
            for i in range(first + 1, end):
                low, high = min(low, out[k, i]), max(high, out[k, i])
            boxes[block, k], boxes[block, 3 + k] = 0.5 * (low + high), 0.5 * (high - low)
    return out, boxes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lamp_light(
    pictures: Singles,
    poses: Floats,
    texel: float,
    point: Floats,
    normal: Floats,
    which: Integers,
    lamp: Floats,
) -> None:
    """Share of the lamp's points that points of surfaces see.

    Args:
        pictures: (K, side, side).
        poses: (K, 15).
        texel: Size of the pictures' pixels at the objects, metres.
        point: (n, 3) world.
        normal: (n, 3) unit normals of their triangles.
        which: Those of the n that count.
        lamp: (n,) out.
    """
    lifted, boxes = _lifted(point, normal, which, 1.5 * texel)
    total, lit = np.zeros(len(which)), np.empty(len(which))
    for k in range(len(poses)):
        _lit(pictures[k], poses[k], 0.5 * texel, lifted, boxes, lit)
        total += lit
    for j in range(len(which)):
        lamp[which[j]] = total[j] / len(poses)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sky_light(
    pictures: Singles,
    poses: Floats,
    texel: float,
    point: Floats,
    normal: Floats,
    up: Floats,
    which: Integers,
    sky: Floats,
) -> None:
    """Light from above that reaches points of surfaces, 1 for a free one that faces up.

    Args:
        pictures: (K, side, side).
        poses: (K, 15) of points all over the sky.
        texel: Size of the pictures' pixels at the objects, metres.
        point: (n, 3) world.
        normal: (n, 3) unit normals of their triangles.
        up: (n, 3) unit normals for shading.
        which: Those of the n that count.
        sky: (n,) out.
    """
    lifted, boxes = _lifted(point, normal, which, 1.5 * texel)
    total, lit = np.zeros(len(which)), np.empty(len(which))
    full = 0.0
    for k in range(len(poses)):
        # The axis z of the picture looks from the sky down.
        dx, dy, dz = -poses[k, 9], -poses[k, 10], -poses[k, 11]
        full += dz
        _lit(pictures[k], poses[k], texel, lifted, boxes, lit)
        for j in range(len(which)):
            i = which[j]
            facing = dx * up[i, 0] + dy * up[i, 1] + dz * up[i, 2]
            total[j] += max(facing, 0.0) * lit[j]
    for j in range(len(which)):
        sky[which[j]] = total[j] / full


@numba.njit(cache=True, nogil=True, error_model="numpy")
def surroundings(light: Floats, x: float, y: float, z: float, rough: float, k: int) -> float:
    """Colour channel k of what a mirror sees in a direction: a bright room, a lamp, the table."""
    sky = light[SKY + k]
    soft = 0.08 + 0.6 * rough
    up = min(max(z / soft * 0.5 + 0.5, 0.0), 1.0)
    above = sky * (0.55 + 0.75 * min(max(z, 0.0), 1.0))
    # Two windows of a room, as bands of azimuth, blurred by the roughness.
    band = min(max((x * 0.8 + y * 0.6 - 0.45) / (0.1 + rough) + 0.5, 0.0), 1.0)
    band *= min(max((0.75 - z) / (0.15 + rough) + 0.5, 0.0), 1.0)
    above *= 0.6 + 1.3 * band
    below = light[GROUND + k] * (0.35 + 0.35 * rough)
    out: float = below + (above - below) * up
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def shaded(
    surface: Floats,
    light: Floats,
    colour: Any,
    p: Any,
    n: Any,
    eye: Any,
    lamp: float,
    sky: float,
) -> Any:
    """Linear red, green, blue that leave a surface towards the eye.

    Args:
        surface: Its row of numbers.
        light: Numbers of the scene's light.
        colour: Its own colour there.
        p: World point.
        n: Unit normal.
        eye: Unit direction to the camera.
        lamp: Share of the lamp that it sees.
        sky: Light from above, of `sky_light`.

    References:
        B. Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007
        (the distribution GGX); C. Schlick, "An inexpensive BRDF model", 1994.
    """
    lx, ly, lz = light[KEY] - p[0], light[KEY + 1] - p[1], light[KEY + 2] - p[2]
    away = math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx / away, ly / away, lz / away
    facing = max(n[0] * lx + n[1] * ly + n[2] * lz, 0.0)
    second = max(n[0] * light[FILL] + n[1] * light[FILL + 1] + n[2] * light[FILL + 2], 0.0)
    view = max(n[0] * eye[0] + n[1] * eye[1] + n[2] * eye[2], 1e-3)
    rough, metal, base = surface[ROUGHNESS], surface[METAL], surface[REFLECTANCE]
    # Highlight of the lamp.
    hx, hy, hz = lx + eye[0], ly + eye[1], lz + eye[2]
    size = math.sqrt(hx * hx + hy * hy + hz * hz)
    shine = 0.0
    if facing > 0.0 and size > 0.0:
        cosine = max((n[0] * hx + n[1] * hy + n[2] * hz) / size, 0.0)
        alpha = rough * rough
        square = alpha * alpha
        width = cosine * cosine * (square - 1.0) + 1.0
        half = alpha * 0.5
        masking = (facing * (1.0 - half) + half) * (view * (1.0 - half) + half)
        shine = min(square / (width * width * 4.0 * masking), 12.0) * facing * lamp
    # What it mirrors.
    twice = 2.0 * (n[0] * eye[0] + n[1] * eye[1] + n[2] * eye[2])
    rx, ry, rz = twice * n[0] - eye[0], twice * n[1] - eye[1], twice * n[2] - eye[2]
    grazing = 1.0 - view
    grazing = grazing * grazing
    grazing = grazing * grazing * (1.0 - view) * (1.0 - 0.7 * rough)
    open_ = 0.35 + 0.65 * min(sky * 1.2, 1.0)
    bounce = 0.5 - 0.5 * n[2]
    out = (0.0, 0.0, 0.0)
    for k in range(3):
        key = light[KEY_COLOUR + k]
        own = colour[k]
        diffuse = key * facing * lamp + light[FILL_COLOUR + k] * second * open_
        diffuse += light[SKY + k] * sky + light[GROUND + k] * bounce * open_ * 0.6
        tint = base + (own - base) * metal
        mirror = tint + (1.0 - tint) * grazing
        seen = surroundings(light, rx, ry, rz, rough, k) * open_
        value = own * (1.0 - metal) * (1.0 - mirror) * diffuse + mirror * seen + tint * shine * key
        if k == 0:
            out = (value, 0.0, 0.0)
        elif k == 1:
            out = (out[0], value, 0.0)
        else:
            out = (out[0], out[1], value)
    return out
