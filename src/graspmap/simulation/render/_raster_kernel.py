"""Compiled loops that find the triangle behind each pixel, in double precision.

The rays of a pinhole camera are so regular that it is quicker to ask of each triangle which rays
hit it than the reverse. Every step is a sum, a product, a quotient or a root in a fixed order, so
the result has the same bits on every machine. (A ray caster in single precision decides about rays
through edges as its processor's instruction set has it.)

Letters in shapes: V vertices, F triangles, (H, W) pictures, K lamps or cameras.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

_BORDER_PX = 1e-6  # a vertex this far from a pixel's centre is left to the exact test


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def to_world(vertices: Floats, rotation: Floats, translation: Floats, out: Floats) -> None:
    """(V, 3) R v + t into ``out``."""
    r, t = rotation, translation
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for k in range(3):
            out[i, k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z + t[k]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def to_frame(points: Floats, rotation: Floats, translation: Floats) -> Any:
    """(V, 3) transpose of R times (p - t): world points in the frame whose pose is R, t."""
    out = np.empty_like(points)
    r, t = rotation, translation
    for i in range(len(points)):
        x, y, z = points[i, 0] - t[0], points[i, 1] - t[1], points[i, 2] - t[2]
        for k in range(3):
            out[i, k] = r[0, k] * x + r[1, k] * y + r[2, k] * z
    return out


@numba.njit(cache=True, nogil=True, inline="always")  # type: ignore[untyped-decorator, unused-ignore]
def _cross(a: Floats, b: Floats) -> Any:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def plane_depth(a: Floats, b: Floats, c: Floats, x: float, y: float) -> float:
    """Depth at which the ray (x, y, 1) meets a triangle's plane, kept within its corners' depths.

    The plane of a triangle that is seen edge-on is uncertain; the limits are not.
    """
    px, py, pz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    qx, qy, qz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    speed = nx * x + (ny * y + nz)
    least, most = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
    if speed == 0.0:
        return least
    depth: float = (nx * a[0] + (ny * a[1] + nz * a[2])) / speed
    return min(max(depth, least), most)


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def _limits(a: float, b: float, c: float, count: int) -> Any:
    """First and one past the last of ``count`` pixels between three positions."""
    low = math.ceil(max(min(a, b, c) - _BORDER_PX, 0.0))
    high = math.floor(min(max(a, b, c) + _BORDER_PX, count - 1.0)) + 1
    return low, high


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def draw_triangles(
    points: Floats,
    faces: Integers,
    drawn: NDArray[np.bool_],
    focal: Any,
    depth: Any,
    triangle: Integers,
) -> None:
    """Put triangles into a picture of depths where they are nearer than what is there.

    A ray through an edge hits both its triangles, as the two edge values are exactly opposite, so
    closed surfaces have no gaps; the first of equally near triangles wins.

    Args:
        points: (V, 3) vertices in the camera's frame.
        faces: (F, 3) vertex numbers.
        drawn: (F,) triangles to draw.
        focal: (fx, fy, cx, cy) pixels.
        depth: (H, W) in and out: depth along z.
        triangle: (H, W) in and out: number of the triangle; (0, 0) where it is not wanted.
    """
    fx, fy, cx, cy = focal
    rows, columns = depth.shape
    keep = triangle.size > 0
    u, v = np.empty(len(points)), np.empty(len(points))
    for i in range(len(points)):
        z = points[i, 2]
        if z > 0.0:
            u[i], v[i] = points[i, 0] / z * fx + cx, points[i, 1] / z * fy + cy
    ray_x = (np.arange(columns) - cx) / fx
    ray_y = (np.arange(rows) - cy) / fy
    for f in range(len(faces)):
        if not drawn[f]:
            continue
        ia, ib, ic = faces[f, 0], faces[f, 1], faces[f, 2]
        a, b, c = points[ia], points[ib], points[ic]
        if min(a[2], b[2], c[2]) > 0.0:
            left, right = _limits(u[ia], u[ib], u[ic], columns)
            top, bottom = _limits(v[ia], v[ib], v[ic], rows)
        elif max(a[2], b[2], c[2]) <= 0.0:
            continue
        else:
            left, right, top, bottom = 0, columns, 0, rows
        if left >= right or top >= bottom:
            continue
        ax, ay, az = _cross(b, c)
        bx, by, bz = _cross(c, a)
        gx, gy, gz = _cross(a, b)
        volume = a[0] * ax + a[1] * ay + a[2] * az
        if volume == 0.0:
            continue
        if volume < 0.0:
            ax, ay, az, bx, by, bz, gx, gy, gz = -ax, -ay, -az, -bx, -by, -bz, -gx, -gy, -gz
        for row in range(top, bottom):
            y = ray_y[row]
            a0, b0, g0 = ay * y + az, by * y + bz, gy * y + gz
            for column in range(left, right):
                x = ray_x[column]
                if ax * x + a0 >= 0.0 and bx * x + b0 >= 0.0 and gx * x + g0 >= 0.0:
                    z = plane_depth(a, b, c, x, y)
                    if 0.0 < z < depth[row, column]:
                        depth[row, column] = z
                        if keep:
                            triangle[row, column] = f


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def pixel_bounds(points: Floats, focal: Any, shape: Any) -> Any:
    """Window (top, bottom, left, right) of a picture that holds the projected points."""
    fx, fy, cx, cy = focal
    rows, columns = shape
    low_u, high_u, low_v, high_v = np.inf, -np.inf, np.inf, -np.inf
    for i in range(len(points)):
        z = points[i, 2]
        if z <= 0.0:
            return 0, rows, 0, columns
        u, v = points[i, 0] / z * fx + cx, points[i, 1] / z * fy + cy
        low_u, high_u = min(low_u, u), max(high_u, u)
        low_v, high_v = min(low_v, v), max(high_v, v)
    if not low_u <= high_u:
        return 0, 0, 0, 0
    left = int(min(max(math.floor(low_u) - 1.0, 0.0), columns))
    right = int(max(min(math.ceil(high_u) + 2.0, columns), left))
    top = int(min(max(math.floor(low_v) - 1.0, 0.0), rows))
    bottom = int(max(min(math.ceil(high_v) + 2.0, rows), top))
    return top, bottom, left, right


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def table_depth(rotation: Floats, height: float, focal: Any, depth: Floats) -> None:
    """(H, W) depth of the plane z = 0; infinity where a pixel's ray never meets it.

    Args:
        rotation: (3, 3) R_world_camera.
        height: Of the camera above the table.
        focal: (fx, fy, cx, cy) pixels.
        depth: (H, W) out.
    """
    fx, fy, cx, cy = focal
    for row in range(depth.shape[0]):
        y = (row - cy) / fy
        for column in range(depth.shape[1]):
            x = (column - cx) / fx
            down = -(rotation[2, 0] * x + (rotation[2, 1] * y + rotation[2, 2]))
            depth[row, column] = height / down if down > 0.0 and height > 0.0 else np.inf


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def face_normals(points: Floats, faces: Integers) -> Any:
    """(F, 3) normals of triangles, as long as twice their area."""
    out = np.empty((len(faces), 3))
    for f in range(len(faces)):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        out[f, 0], out[f, 1], out[f, 2] = _cross(b - a, c - a)
    return out


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def corner_normals(points: Floats, faces: Integers, normals: Floats, crease: float) -> Any:
    """(F, 3, 3) unit normal at each corner of each triangle: smooth except over sharp edges.

    Args:
        points: (V, 3) vertices.
        faces: (F, 3) vertex numbers.
        normals: (F, 3) of `face_normals`.
        crease: Cosine of the angle beyond which an edge is sharp.
    """
    count = len(faces)
    start = np.zeros(len(points) + 1, np.int64)
    for f in range(count):
        for k in range(3):
            start[faces[f, k] + 1] += 1
    for i in range(len(points)):
        start[i + 1] += start[i]
    around, fill = np.empty(3 * count, np.int32), start[:-1].copy()
    length = np.empty(count)
    for f in range(count):
        n = normals[f]
        length[f] = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        for k in range(3):
            vertex = faces[f, k]
            around[fill[vertex]] = f
            fill[vertex] += 1
    out = np.empty((count, 3, 3))
    for f in range(count):
        n = normals[f]
        for k in range(3):
            vertex = faces[f, k]
            x = y = z = 0.0
            for slot in range(start[vertex], start[vertex + 1]):
                m = normals[around[slot]]
                cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
                if around[slot] == f or cosine > crease * length[f] * length[around[slot]]:
                    x, y, z = x + m[0], y + m[1], z + m[2]
            size = math.sqrt(x * x + y * y + z * z)
            if size > 0.0:
                out[f, k, 0], out[f, k, 1], out[f, k, 2] = x / size, y / size, z / size
            else:
                out[f, k, 0], out[f, k, 1], out[f, k, 2] = 0.0, 0.0, 1.0
    return out
