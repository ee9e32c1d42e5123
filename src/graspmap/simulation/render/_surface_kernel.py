"""Compiled rays: where they meet the table or a triangle, and with which normals.

Letters in shapes: V vertices, F triangles, n rays; a ray (x, y) is the direction (x, y, 1) in the
camera's frame.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

LEAST_DOWN = 1e-3
"""Rays flatter than this see the room and not the table."""

_LEAST_FACING = 0.02  # of a smooth normal's cosine to the camera


@compiled
def _weights(seen: Floats, a: int, b: int, c: int, x: float, y: float) -> Any:
    """Shares of the corners a, b, c at the point of their triangle that the ray (x, y, 1) meets."""
    ax, ay, az = seen[a, 0], seen[a, 1], seen[a, 2]
    bx, by, bz = seen[b, 0], seen[b, 1], seen[b, 2]
    cx, cy, cz = seen[c, 0], seen[c, 1], seen[c, 2]
    p = (by * cz - bz * cy) * x + ((bz * cx - bx * cz) * y + (bx * cy - by * cx))
    q = (cy * az - cz * ay) * x + ((cz * ax - cx * az) * y + (cx * ay - cy * ax))
    r = (ay * bz - az * by) * x + ((az * bx - ax * bz) * y + (ax * by - ay * bx))
    total = p + q + r
    if total == 0.0:
        return 1.0, 0.0, 0.0
    return p / total, q / total, r / total


@compiled
def _towards(x: float, y: float, z: float, eye: Any) -> Any:
    """A unit normal bent, if need be, until it faces the eye."""
    facing = x * eye[0] + y * eye[1] + z * eye[2]
    if facing < _LEAST_FACING:
        lack = _LEAST_FACING - facing
        x, y, z = x + lack * eye[0], y + lack * eye[1], z + lack * eye[2]
        size = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / size, y / size, z / size
    return x, y, z


@compiled
def _normals(normals: Floats, corners: Floats, f: int, eye: Any, share: Any) -> Any:
    """Unit normals at a point of triangle f, flat and smooth, both on the eye's side."""
    nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
    size = math.sqrt(nx * nx + ny * ny + nz * nz)
    if size == 0.0:
        return eye, eye
    nx, ny, nz = nx / size, ny / size, nz / size
    a, b, c = share
    sx = a * corners[f, 0, 0] + b * corners[f, 1, 0] + c * corners[f, 2, 0]
    sy = a * corners[f, 0, 1] + b * corners[f, 1, 1] + c * corners[f, 2, 1]
    sz = a * corners[f, 0, 2] + b * corners[f, 1, 2] + c * corners[f, 2, 2]
    # The back of an open surface is seen as a front.
    if nx * eye[0] + ny * eye[1] + nz * eye[2] < 0.0:
        nx, ny, nz, sx, sy, sz = -nx, -ny, -nz, -sx, -sy, -sz
    long = math.sqrt(sx * sx + sy * sy + sz * sz)
    if long < 1e-6:
        return (nx, ny, nz), (nx, ny, nz)
    return (nx, ny, nz), _towards(sx / long, sy / long, sz / long, eye)


@compiled
def _point(rotation: Floats, origin: Floats, x: float, y: float, depth: float) -> Any:
    """World point at a depth along the ray (x, y, 1), and the unit direction back to the camera."""
    dx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
    dy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
    dz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
    size = math.sqrt(dx * dx + dy * dy + dz * dz)
    point = (origin[0] + depth * dx, origin[1] + depth * dy, origin[2] + depth * dz)
    return point, (-dx / size, -dy / size, -dz / size)


@compiled
def pixel_rays(pixels: Any, columns: int, focal: Any, shift: Any, out: Floats) -> None:
    """Rays through pixels.

    Args:
        pixels: (n,) flat numbers, row by row.
        columns: Of the picture.
        focal: (fx, fy, cx, cy) pixels.
        shift: (x, y) from the pixels' centres.
        out: (2, n) out.
    """
    fx, fy, cx, cy = focal
    for i in range(len(pixels)):
        row, column = pixels[i] // columns, pixels[i] % columns
        out[0, i] = (column + shift[0] - cx) / fx
        out[1, i] = (row + shift[1] - cy) / fy


@compiled
def meet_table(
    rotation: Floats, origin: Floats, rays: Floats, point: Floats, back: Floats, depth: Floats
) -> None:
    """Where rays meet the table.

    Args:
        rotation: (3, 3) R_world_camera.
        origin: (3,) world place of the camera.
        rays: (2, n).
        point: (3, n) out: world.
        back: (3, n) out: unit direction to the camera.
        depth: (n,) out: along z; negative where a ray sees the room instead.
    """
    for i in range(rays.shape[1]):
        x, y = rays[0, i], rays[1, i]
        down = -(rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2])
        z = origin[2] / max(down, LEAST_DOWN)
        p, b = _point(rotation, origin, x, y, z)
        point[0, i], point[1, i], point[2, i] = p
        back[0, i], back[1, i], back[2, i] = b
        depth[i] = z if down > LEAST_DOWN else -z


@compiled
def meet_objects(
    rotation: Floats,
    origin: Floats,
    rays: Floats,
    face: Integers,
    depth: Floats,
    surface: Any,
    point: Floats,
    back: Floats,
    flat: Floats,
    smooth: Floats,
    share: Floats,
) -> None:
    """Where rays meet their triangles.

    Args:
        rotation: (3, 3) R_world_camera.
        origin: (3,) world place of the camera.
        rays: (2, n).
        face: (n,) triangle of each.
        depth: (n,) along z.
        surface: (V, 3) vertices in the camera's frame, (F, 3) vertex numbers, (F, 3) normals and
            (F, 3, 3) normals at the corners in the world.
        point: (3, n) out: world.
        back: (3, n) out: unit direction to the camera.
        flat: (3, n) out: unit normal of the triangle, on the camera's side.
        smooth: (3, n) out: unit normal between those of the corners, on the camera's side.
        share: (3, n) out: shares of the corners at the point.
    """
    seen, faces, normals, corners = surface
    for i in range(rays.shape[1]):
        x, y, f = rays[0, i], rays[1, i], face[i]
        w = _weights(seen, faces[f, 0], faces[f, 1], faces[f, 2], x, y)
        p, b = _point(rotation, origin, x, y, depth[i])
        n, s = _normals(normals, corners, f, b, w)
        point[0, i], point[1, i], point[2, i] = p
        back[0, i], back[1, i], back[2, i] = b
        flat[0, i], flat[1, i], flat[2, i] = n
        smooth[0, i], smooth[1, i], smooth[2, i] = s
        share[0, i], share[1, i], share[2, i] = w
