"""What the compiled loops know of a scene, and the normals of what is seen.

Letters in shapes: V vertices, F triangles, N objects, (H, W) the picture, (h, w) the window of it
that holds the objects.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_LEAST_FACING = 0.02  # of a smooth normal's cosine to the camera


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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weights(seen: Floats, a: int, b: int, c: int, x: float, y: float) -> Any:
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _towards(x: float, y: float, z: float, eye: Any) -> Any:
    """A unit normal bent, if need be, until it faces the eye."""
    facing = x * eye[0] + y * eye[1] + z * eye[2]
    if facing < _LEAST_FACING:
        lack = _LEAST_FACING - facing
        x, y, z = x + lack * eye[0], y + lack * eye[1], z + lack * eye[2]
        size = math.sqrt(x * x + y * y + z * z)
        x, y, z = x / size, y / size, z / size
    return x, y, z


@numba.njit(cache=True, nogil=True, error_model="numpy")
def facing_normals(normals: Floats, corners: Floats, f: int, eye: Any, share: Any) -> Any:
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def point_on(rotation: Floats, origin: Floats, x: float, y: float, depth: float) -> Any:
    """World point at a depth along the ray (x, y, 1), and the unit direction back to the camera."""
    dx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
    dy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
    dz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
    size = math.sqrt(dx * dx + dy * dy + dz * dz)
    point = (origin[0] + depth * dx, origin[1] + depth * dy, origin[2] + depth * dz)
    return point, (-dx / size, -dy / size, -dz / size)


@numba.njit(cache=True, nogil=True, error_model="numpy")
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
    rotation, origin = eye.rotation, eye.origin
    seen, faces, owner = geometry.seen, geometry.faces, geometry.owner
    flat, corners = geometry.normals, geometry.corners
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            known = depth[row, column] < np.inf
            normals[row, column, 0] = normals[row, column, 1] = 0.0 if known else np.nan
            normals[row, column, 2] = 1.0 if known else np.nan
            instance[row, column] = -1
    for row in range(top, bottom):
        for column in range(left, right):
            f = triangle[row - top, column - left]
            if f < 0:
                continue
            x, y = (column - cx) / fx, (row - cy) / fy
            share = weights(seen, faces[f, 0], faces[f, 1], faces[f, 2], x, y)
            _, back = point_on(rotation, origin, x, y, depth[row, column])
            _, smooth = facing_normals(flat, corners, f, back, share)
            for k in range(3):
                normals[row, column, k] = smooth[k]
            instance[row, column] = owner[f]
