"""Compiled lamps: which points of a scene they reach.

A lamp with an extent is several points. From each the objects are drawn once, as from a camera;
a point in the scene is lit when nothing in that picture is nearer.

Letters in shapes: V vertices, F triangles, K points that give light.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Places in the row of a lamp's picture: origin, axes x, y, z, then focal length and centre, then
# least and greatest x and y on the table of the objects' shadow.
FOCAL, CENTRE, _FALLEN = 12, 13, 15
POSE_LENGTH = 19

_BLOCK = 32  # points that are looked at together


@compiled
def aim(points: Floats, lamp: Floats, side: int, rotation: Floats, pose: Floats) -> None:
    """Point a camera at objects so that they just fill its picture.

    Args:
        points: (V, 3) world vertices.
        lamp: (3,) world position of the camera.
        side: Side of its picture, pixels.
        rotation: (3, 3) out: R_world_camera.
        pose: (POSE_LENGTH,) out.
    """
    low_x = low_y = low_z = np.inf
    high_x = high_y = high_z = -np.inf
    for i in range(len(points)):
        low_x, high_x = min(low_x, points[i, 0]), max(high_x, points[i, 0])
        low_y, high_y = min(low_y, points[i, 1]), max(high_y, points[i, 1])
        low_z, high_z = min(low_z, points[i, 2]), max(high_z, points[i, 2])
    zx, zy = 0.5 * (low_x + high_x) - lamp[0], 0.5 * (low_y + high_y) - lamp[1]
    zz = 0.5 * (low_z + high_z) - lamp[2]
    size = math.sqrt(zx * zx + zy * zy + zz * zz)
    zx, zy, zz = zx / size, zy / size, zz / size
    # Any direction across will do.
    xx, xy, xz = (0.0, zz, -zy) if abs(zx) < 0.9 else (-zz, 0.0, zx)
    size = math.sqrt(xx * xx + xy * xy + xz * xz)
    xx, xy, xz = xx / size, xy / size, xz / size
    yx, yy, yz = zy * xz - zz * xy, zz * xx - zx * xz, zx * xy - zy * xx
    left = top = np.inf
    right = bottom = -np.inf
    west = south = np.inf
    east = north = -np.inf
    for i in range(len(points)):
        x, y, z = points[i, 0] - lamp[0], points[i, 1] - lamp[1], points[i, 2] - lamp[2]
        depth = zx * x + zy * y + zz * z
        u, v = (xx * x + xy * y + xz * z) / depth, (yx * x + yy * y + yz * z) / depth
        left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
        # Where the shadow of the vertex falls; far away if it is as high as the lamp.
        reach = lamp[2] / max(-z, 1e-9)
        u, v = lamp[0] + reach * x, lamp[1] + reach * y
        west, east, south, north = min(west, u), max(east, u), min(south, v), max(north, v)
    focal = (side - 4.0) / max(right - left, bottom - top, 1e-9)
    middle = 0.5 * (side - 1.0)
    for k in range(3):
        pose[k] = lamp[k]
    rotation[0, 0], rotation[1, 0], rotation[2, 0] = xx, xy, xz
    rotation[0, 1], rotation[1, 1], rotation[2, 1] = yx, yy, yz
    rotation[0, 2], rotation[1, 2], rotation[2, 2] = zx, zy, zz
    for k in range(9):
        pose[3 + k] = rotation[k % 3, k // 3]
    pose[FOCAL] = focal
    pose[CENTRE] = middle - focal * 0.5 * (left + right)
    pose[CENTRE + 1] = middle - focal * 0.5 * (top + bottom)
    pose[_FALLEN], pose[_FALLEN + 1] = west, east
    pose[_FALLEN + 2], pose[_FALLEN + 3] = south, north


@compiled
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
    focal, cx, cy = pose[FOCAL], pose[CENTRE], pose[CENTRE + 1]
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


@compiled
def table_light(
    pictures: Singles,
    poses: Floats,
    shares: Floats,
    points: Floats,
    out: Floats,
) -> None:
    """Light that reaches points of the table.

    Args:
        pictures: (K, side, side).
        poses: (K, POSE_LENGTH).
        shares: (K,) of each point that gives light; 1 in sum.
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
            _lit(pictures[k], poses[k], 0.0, points, first, end, lit)
            for i in range(first, end):
                out[i] -= shares[k] * (1.0 - lit[i])


@compiled
def object_light(
    pictures: Singles,
    poses: Floats,
    shares: Floats,
    texel: float,
    points: Floats,
    flat: Floats,
    smooth: Floats,
    by_cosine: bool,
    out: Floats,
) -> None:
    """Light that reaches points of objects.

    Args:
        pictures: (K, side, side).
        poses: (K, POSE_LENGTH).
        shares: (K,) of each point in the light on a free surface that faces up.
        texel: Size of the pictures' pixels at the objects, metres.
        points: (3, n) world.
        flat: (3, n) unit normals of the triangles.
        smooth: (3, n) unit normals for shading.
        by_cosine: Whether light counts by the cosine at which it arrives.
        out: (n,) out.
    """
    # Points a little above their surfaces, so that these do not shadow themselves.
    lifted, lit = np.empty(points.shape), np.empty(len(out))
    for k in range(3):
        for i in range(len(out)):
            lifted[k, i] = points[k, i] + 1.5 * texel * flat[k, i]
    for i in range(len(out)):
        out[i] = 0.0
    for k in range(len(poses)):
        _lit(pictures[k], poses[k], 0.5 * texel, lifted, 0, len(out), lit)
        # The axis z of the picture looks from the light down.
        x, y, z = -poses[k, 9], -poses[k, 10], -poses[k, 11]
        if by_cosine:
            share = shares[k] / z
            for i in range(len(out)):
                cosine = x * smooth[0, i] + y * smooth[1, i] + z * smooth[2, i]
                out[i] += share * max(cosine, 0.0) * lit[i]
        else:
            for i in range(len(out)):
                out[i] += shares[k] * lit[i]
