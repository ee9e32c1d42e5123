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

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

_WIDE = 6  # pixels from which on it pays to compute where a row of a triangle begins
_BORDER_PX = 1e-6  # a vertex this far from a pixel's centre is left to the exact test


@compiled
def to_world(vertices: Floats, rotation: Floats, translation: Floats, out: Floats) -> None:
    """(V, 3) R v + t into ``out``."""
    r, t = rotation, translation
    for i in range(len(vertices)):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for k in range(3):
            out[i, k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z + t[k]


@compiled
def to_frame(points: Floats, rotation: Floats, translation: Floats, out: Floats) -> None:
    """(V, 3) transpose of R times (p - t): world points in the frame whose pose is R, t."""
    r, t = rotation, translation
    for i in range(len(points)):
        x, y, z = points[i, 0] - t[0], points[i, 1] - t[1], points[i, 2] - t[2]
        for k in range(3):
            out[i, k] = r[0, k] * x + r[1, k] * y + r[2, k] * z


@compiled
def _limits(a: float, b: float, c: float, count: int) -> Any:
    """First and one past the last of ``count`` pixels between three positions."""
    low = math.ceil(max(min(a, b, c) - _BORDER_PX, 0.0))
    high = math.floor(min(max(a, b, c) + _BORDER_PX, count - 1.0)) + 1
    return low, high


@compiled
def _span(slope: float, offset: float, fx: float, cx: float, first: int, end: int) -> Any:
    """Columns among which those with slope x + offset >= 0 lie, with a pixel to spare."""
    if slope == 0.0:
        return first, end
    border = min(max(cx - fx * offset / slope, -2.0), end + 2.0)
    if slope > 0.0:
        return max(first, math.floor(border) - 1), end
    return first, min(end, math.ceil(border) + 2)


@compiled
def _fill(
    corners: Any,
    two_sided: bool,
    f: int,
    window: Any,
    focal: Any,
    ray_x: Floats,
    depth: Floats,
    triangle: Integers,
) -> None:
    """Put triangle f into a window of a picture of depths.

    Args:
        corners: Nine coordinates in the camera's frame.
        two_sided: Whether its back counts.
        f: Its number.
        window: (left, right, top, bottom).
        focal: (fx, fy, cx, cy) pixels.
        ray_x: (W,) x of the rays (x, y, 1) through the columns.
        depth: (H, W) in and out.
        triangle: (H, W) in and out.
    """
    ax, ay, az, bx, by, bz, gx, gy, gz = corners
    left, right, top, bottom = window
    fx, fy, cx, cy = focal
    # A ray's value at the edge from b to c is its product with b x c, and so on.
    px, py, pz = by * gz - bz * gy, bz * gx - bx * gz, bx * gy - by * gx
    volume = ax * px + ay * py + az * pz
    if volume == 0.0 or (volume > 0.0 and not two_sided):
        return
    qx, qy, qz = gy * az - gz * ay, gz * ax - gx * az, gx * ay - gy * ax
    rx, ry, rz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    if volume < 0.0:
        px, py, pz, qx, qy, qz, rx, ry, rz = -px, -py, -pz, -qx, -qy, -qz, -rx, -ry, -rz
    least, most = min(az, bz, gz), max(az, bz, gz)
    # The plane, from differences: with the products above, small triangles would lose digits.
    bx, by, bz, gx, gy, gz = bx - ax, by - ay, bz - az, gx - ax, gy - ay, gz - az
    nx, ny, nz = by * gz - bz * gy, bz * gx - bx * gz, bx * gy - by * gx
    above = nx * ax + (ny * ay + nz * az)
    for row in range(top, bottom):
        y = (row - cy) / fy
        p, q, r, n = py * y + pz, qy * y + qz, ry * y + rz, ny * y + nz
        first, end = left, right
        if right - left > _WIDE:
            first, end = _span(px, p, fx, cx, first, end)
            first, end = _span(qx, q, fx, cx, first, end)
            first, end = _span(rx, r, fx, cx, first, end)
        for column in range(first, end):
            x = ray_x[column]
            if px * x + p >= 0.0 and qx * x + q >= 0.0 and rx * x + r >= 0.0:
                speed = nx * x + n
                # The plane of a triangle seen edge-on is uncertain; its corners are not.
                z = min(max(above / speed, least), most) if speed != 0.0 else least
                if 0.0 < z < depth[row, column]:
                    depth[row, column] = z
                    triangle[row, column] = f


@compiled
def draw_triangles(
    points: Floats,
    faces: Integers,
    drawn: NDArray[np.uint8],
    focal: Any,
    depth: Floats,
    triangle: Integers,
) -> None:
    """Put triangles into a picture of depths where they are nearer than what is there.

    A ray through an edge hits both its triangles, as the two edge values are exactly opposite, so
    closed surfaces have no gaps; the first of equally near triangles wins.

    Args:
        points: (V, 3) vertices in the camera's frame.
        faces: (F, 3) vertex numbers.
        drawn: (F,) which triangles to draw: 0 none, 1 those that face the camera, 2 all.
        focal: (fx, fy, cx, cy) pixels.
        depth: (H, W) in and out: depth along z.
        triangle: (H, W) in and out: number of the triangle.
    """
    fx, fy, cx, cy = focal
    rows, columns = depth.shape
    u, v = np.empty(len(points)), np.empty(len(points))
    for i in range(len(points)):
        z = points[i, 2]
        if z > 0.0:
            u[i], v[i] = points[i, 0] / z * fx + cx, points[i, 1] / z * fy + cy
    ray_x = np.empty(columns)
    for column in range(columns):
        ray_x[column] = (column - cx) / fx
    for f in range(len(faces)):
        if drawn[f] == 0:
            continue
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        az, bz, gz = points[i, 2], points[j, 2], points[k, 2]
        if max(az, bz, gz) <= 0.0:
            continue
        left, right, top, bottom = 0, columns, 0, rows
        # A triangle that reaches behind the camera may be anywhere.
        if min(az, bz, gz) > 0.0:
            left, right = _limits(u[i], u[j], u[k], columns)
            top, bottom = _limits(v[i], v[j], v[k], rows)
        if left < right and top < bottom:
            ax, ay = points[i, 0], points[i, 1]
            bx, by = points[j, 0], points[j, 1]
            gx, gy = points[k, 0], points[k, 1]
            corners = (ax, ay, az, bx, by, bz, gx, gy, gz)
            window = (left, right, top, bottom)
            _fill(corners, drawn[f] == 2, f, window, focal, ray_x, depth, triangle)


@compiled
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


@compiled
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


@compiled
def is_closed(points: Floats, faces: Integers) -> bool:
    """Whether triangles enclose a space and face out of it, so that their backs are never seen.

    Each edge must be passed as often one way as the other: a sum of large numbers, one for each
    edge and of opposite sign for the two ways, is then 0, and hardly ever otherwise.
    """
    total, volume = np.int64(0), 0.0
    for f in range(len(faces)):
        for k in range(3):
            a, b = np.int64(faces[f, k]), np.int64(faces[f, (k + 1) % 3])
            low, high = min(a, b), max(a, b)
            number = low * 6364136223846793 + high * 1442695040888963
            number = (number ^ (number >> 29)) * 3935559000370003
            number = number ^ (number >> 32)
            total += number if a < b else -number
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        x = points[j, 1] * points[k, 2] - points[j, 2] * points[k, 1]
        y = points[j, 2] * points[k, 0] - points[j, 0] * points[k, 2]
        z = points[j, 0] * points[k, 1] - points[j, 1] * points[k, 0]
        volume += points[i, 0] * x + points[i, 1] * y + points[i, 2] * z
    return total == 0 and volume > 0.0


@compiled
def face_normals(points: Floats, faces: Integers, out: Floats) -> None:
    """(F, 3) normals of triangles, as long as twice their area, into ``out``."""
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = points[i, 0], points[i, 1], points[i, 2]
        bx, by, bz = points[j, 0] - ax, points[j, 1] - ay, points[j, 2] - az
        cx, cy, cz = points[k, 0] - ax, points[k, 1] - ay, points[k, 2] - az
        out[f, 0], out[f, 1], out[f, 2] = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx


@compiled
def _around(count: int, faces: Integers, start: Integers, around: Integers) -> None:
    """The triangles around each of ``count`` vertices, one vertex after the other.

    Args:
        count: Number of vertices.
        faces: (F, 3) vertex numbers.
        start: (count + 1,) out: where those of each vertex begin.
        around: (3 F,) out: numbers of triangles.
    """
    fill = np.empty(count, np.int32)
    for i in range(count + 1):
        start[i] = 0
    for f in range(len(faces)):
        for k in range(3):
            start[faces[f, k] + 1] += 1
    for i in range(count):
        start[i + 1] += start[i]
        fill[i] = start[i]
    for f in range(len(faces)):
        for k in range(3):
            vertex = faces[f, k]
            around[fill[vertex]] = f
            fill[vertex] += 1


@compiled
def corner_normals(
    count: int, faces: Integers, normals: Floats, crease: float, out: Floats
) -> None:
    """Unit normal at each corner of each triangle: smooth except over sharp edges.

    Args:
        count: Number of vertices.
        faces: (F, 3) vertex numbers.
        normals: (F, 3) of `face_normals`.
        crease: Cosine of the angle beyond which an edge is sharp.
        out: (F, 3, 3) out.
    """
    start, around = np.empty(count + 1, np.int32), np.empty(3 * len(faces), np.int32)
    _around(count, faces, start, around)
    length = np.empty(len(faces))
    for f in range(len(faces)):
        x, y, z = normals[f, 0], normals[f, 1], normals[f, 2]
        length[f] = math.sqrt(x * x + y * y + z * z)
    for f in range(len(faces)):
        nx, ny, nz, limit = normals[f, 0], normals[f, 1], normals[f, 2], crease * length[f]
        for k in range(3):
            vertex = faces[f, k]
            x = y = z = 0.0
            for slot in range(start[vertex], start[vertex + 1]):
                other = around[slot]
                mx, my, mz = normals[other, 0], normals[other, 1], normals[other, 2]
                if other == f or nx * mx + ny * my + nz * mz > limit * length[other]:
                    x, y, z = x + mx, y + my, z + mz
            size = math.sqrt(x * x + y * y + z * z)
            if size > 0.0:
                x, y, z = x / size, y / size, z / size
            out[f, k, 0], out[f, k, 1], out[f, k, 2] = x, y, z
