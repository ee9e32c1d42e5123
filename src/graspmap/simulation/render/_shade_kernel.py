"""Compiled colours: what a batch of rays sees, and smooth edges.

Work goes in batches and in steps (where, which colour, how much light, what leaves), so that each
step keeps its few numbers at hand.

Letters in shapes: n rays of a batch, (H, W) the picture, (h, w) the window of it that holds the
objects.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._light_kernel import SKY, lamp_light, sky_light, shaded
from graspmap.simulation.render._scene_kernel import (
    Eye,
    Geometry,
    Lamps,
    Surfaces,
    facing_normals,
    point_on,
    weights,
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

_BATCH = 2048
_STEP = 0.06  # of brightness, beyond which an edge is drawn smooth
_TABLE_STEP = 0.12  # the same within the table's pattern
_BEND = 0.03  # how far glass moves what lies behind it
_LEAST_DOWN = 1e-3  # rays flatter than this see the room and not the table


class Batch(NamedTuple):
    """Some rays and what they see.

    Args:
        ray: (n, 2) x, y of the rays (x, y, 1).
        face: (n,) triangle, -1 for the table.
        depth: (n,) along z; of the table it is computed.
        point: (n, 3) world.
        back: (n, 3) unit direction to the camera.
        flat: (n, 3) unit normal.
        smooth: (n, 3) unit normal for shading.
        colour: (n, 3) own colour, then the light that arrives.
        lamp: (n,) share of the lamp.
        sky: (n,) light from above.
    """

    ray: Floats
    face: Integers
    depth: Floats
    point: Floats
    back: Floats
    flat: Floats
    smooth: Floats
    colour: Floats
    lamp: Floats
    sky: Floats


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _new_batch(size: int) -> Any:
    return Batch(
        np.empty((size, 2)),
        np.empty(size, np.int32),
        np.empty(size),
        np.empty((size, 3)),
        np.empty((size, 3)),
        np.empty((size, 3)),
        np.empty((size, 3)),
        np.empty((size, 3)),
        np.empty(size),
        np.empty(size),
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _put(target: Floats, i: int, value: Any) -> None:
    target[i, 0], target[i, 1], target[i, 2] = value


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _get(source: Floats, i: int) -> Any:
    return source[i, 0], source[i, 1], source[i, 2]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _place_table(eye: Eye, surfaces: Surfaces, batch: Batch, count: int) -> None:
    """Point, normal and colour of the rays that see the table."""
    rotation, origin, focal = eye.rotation, eye.origin, eye.focal[0]
    ray, face, depth = batch.ray, batch.face, batch.depth
    point, back, flat, smooth = batch.point, batch.back, batch.flat, batch.smooth
    colour, surface = batch.colour, surfaces.rows[len(surfaces.rows) - 1]
    for i in range(count):
        if face[i] >= 0:
            continue
        x, y = ray[i, 0], ray[i, 1]
        down = -(rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2])
        depth[i] = origin[2] / max(down, _LEAST_DOWN)
        p, b = point_on(rotation, origin, x, y, depth[i])
        _put(point, i, p)
        _put(back, i, b)
        _put(flat, i, (0.0, 0.0, 1.0))
        _put(smooth, i, (0.0, 0.0, 1.0))
        pixel = depth[i] / focal / max(b[2], 0.05)
        _put(colour, i, table_colour(surface, p[0], p[1], pixel))
        if down <= _LEAST_DOWN:
            face[i] = -2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _place_objects(
    geometry: Geometry, eye: Eye, surfaces: Surfaces, batch: Batch, count: int
) -> None:
    """Point, normals and colour of the rays that see an object."""
    rotation, origin, focal = eye.rotation, eye.origin, eye.focal[0]
    ray, face, depth = batch.ray, batch.face, batch.depth
    point, back, flat, smooth, colour = (
        batch.point,
        batch.back,
        batch.flat,
        batch.smooth,
        batch.colour,
    )
    faces, seen, normals, corners = (
        geometry.faces,
        geometry.seen,
        geometry.normals,
        geometry.corners,
    )
    owner, uv, turns, shifts = (
        geometry.owner,
        geometry.uv,
        geometry.rotations,
        geometry.translations,
    )
    rows, pictures = surfaces.rows, surfaces.pictures
    for i in range(count):
        f = face[i]
        if f < 0:
            continue
        x, y = ray[i, 0], ray[i, 1]
        ia, ib, ic = faces[f, 0], faces[f, 1], faces[f, 2]
        share = weights(seen, ia, ib, ic, x, y)
        p, b = point_on(rotation, origin, x, y, depth[i])
        n, s = facing_normals(normals, corners, f, b, share)
        _put(point, i, p)
        _put(back, i, b)
        _put(flat, i, n)
        _put(smooth, i, s)
        k = owner[f]
        row = rows[k]
        if int(row[PATTERN]) == PICTURE:
            u = share[0] * uv[ia, 0] + share[1] * uv[ib, 0] + share[2] * uv[ic, 0]
            v = share[0] * uv[ia, 1] + share[1] * uv[ib, 1] + share[2] * uv[ic, 1]
            start, width, height = int(row[OFFSET]), int(row[WIDTH]), int(row[HEIGHT])
            _put(colour, i, picture_colour(pictures, start, width, height, u, v))
            continue
        px, py, pz = p[0] - shifts[k, 0], p[1] - shifts[k, 1], p[2] - shifts[k, 2]
        own = solid_colour(
            row,
            turns[k, 0, 0] * px + turns[k, 1, 0] * py + turns[k, 2, 0] * pz,
            turns[k, 0, 1] * px + turns[k, 1, 1] * py + turns[k, 2, 1] * pz,
            turns[k, 0, 2] * px + turns[k, 1, 2] * py + turns[k, 2, 2] * pz,
            depth[i] / focal,
        )
        _put(colour, i, own)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _light(
    geometry: Geometry, lamps: Lamps, surfaces: Surfaces, batch: Batch, count: int, shadow: float
) -> None:
    """From own colours to the light that leaves; ``shadow`` below 1 weakens shadows."""
    x, y, radius = lamps.reach
    point, face, lamp, sky = batch.point, batch.face, batch.lamp, batch.sky
    # Which rays end where a shadow may lie.
    near, some = np.empty(count, np.int32), 0
    for i in range(count):
        dx, dy = point[i, 0] - x, point[i, 1] - y
        lamp[i], sky[i] = 1.0, 1.0
        if face[i] >= -1 and (face[i] >= 0 or dx * dx + dy * dy < radius * radius):
            lamp[i], sky[i] = 0.0, 0.0
            near[some] = i
            some += 1
    if some:
        lamp_light(
            lamps.key_pictures, lamps.key_poses, lamps.key_texel, point, batch.flat, near[:some], lamp
        )
        sky_light(
            lamps.sky_pictures,
            lamps.sky_poses,
            lamps.sky_texel,
            point,
            batch.flat,
            batch.smooth,
            near[:some],
            sky,
        )
    rows, owner, light = surfaces.rows, geometry.owner, lamps.light
    back, smooth, colour = batch.back, batch.smooth, batch.colour
    table = len(rows) - 1
    for i in range(count):
        if face[i] == -2:
            _put(colour, i, (light[SKY], light[SKY + 1], light[SKY + 2]))
            continue
        row = rows[owner[face[i]]] if face[i] >= 0 else rows[table]
        out = shaded(
            row,
            light,
            _get(colour, i),
            _get(point, i),
            _get(smooth, i),
            _get(back, i),
            1.0 - shadow * (1.0 - lamp[i]),
            1.0 - shadow * (1.0 - sky[i]),
        )
        _put(colour, i, out)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _see_through(
    geometry: Geometry,
    eye: Eye,
    lamps: Lamps,
    surfaces: Surfaces,
    batch: Batch,
    own: Floats,
    spare: Batch,
    count: int,
) -> None:
    """Add to glass the table behind it, shifted as by a lens, darker where it goes askew.

    Args:
        geometry: Surfaces.
        eye: Camera.
        lamps: Light.
        surfaces: Looks.
        batch: Rays with the light that leaves.
        own: (n, 3) their surfaces' own colours.
        spare: Room for as many rays.
        count: How many rays there are.
    """
    which, some = np.empty(count, np.int32), 0
    r = eye.rotation
    for i in range(count):
        if batch.face[i] < 0 or surfaces.rows[geometry.owner[batch.face[i]], GLASS] <= 0.0:
            continue
        n = _get(batch.smooth, i)
        across = r[0, 0] * n[0] + r[1, 0] * n[1] + r[2, 0] * n[2]
        down = r[0, 1] * n[0] + r[1, 1] * n[1] + r[2, 1] * n[2]
        spare.ray[some, 0] = batch.ray[i, 0] - _BEND * across
        spare.ray[some, 1] = batch.ray[i, 1] - _BEND * down
        spare.face[some] = -1
        which[some] = i
        some += 1
    if not some:
        return
    _place_table(eye, surfaces, spare, some)
    _light(geometry, lamps, surfaces, spare, some, 0.3)
    for j in range(some):
        i = which[j]
        row = surfaces.rows[geometry.owner[batch.face[i]]]
        n, b = _get(batch.smooth, i), _get(batch.back, i)
        facing = n[0] * b[0] + n[1] * b[1] + n[2] * b[2]
        clear, askew = row[GLASS], 1.0 - facing
        through = clear * (0.25 + 0.75 * facing * (2.0 - facing))
        mirror = 0.6 * clear * (askew * askew * askew + row[REFLECTANCE])
        for k in range(3):
            behind = through * spare.colour[j, k] * (0.55 + 0.45 * own[i, k])
            kept = batch.colour[i, k] * (1.0 - 0.85 * clear)
            batch.colour[i, k] = kept + behind + mirror * lamps.light[SKY + k]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _shade(
    geometry: Geometry,
    eye: Eye,
    lamps: Lamps,
    surfaces: Surfaces,
    batch: Batch,
    spare: Batch,
    count: int,
) -> None:
    """Fill in what the first ``count`` rays of a batch see; ``batch.colour`` is the result."""
    _place_table(eye, surfaces, batch, count)
    _place_objects(geometry, eye, surfaces, batch, count)
    own = batch.colour[:count].copy()
    _light(geometry, lamps, surfaces, batch, count, 1.0)
    _see_through(geometry, eye, lamps, surfaces, batch, own, spare, count)


@numba.njit(cache=True, nogil=True, error_model="numpy")
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
    rows, columns = depth.shape
    batch, spare = _new_batch(columns), _new_batch(columns)
    ray, face, deep = batch.ray, batch.face, batch.depth
    for row in range(rows):
        for column in range(columns):
            ray[column, 0], ray[column, 1] = (column - cx) / fx, (row - cy) / fy
            face[column], deep[column] = -1, depth[row, column]
            if top <= row < bottom and left <= column < right:
                face[column] = triangle[row - top, column - left]
        _shade(geometry, eye, lamps, surfaces, batch, spare, columns)
        colour = batch.colour
        for column in range(columns):
            for k in range(3):
                out[row, column, k] = colour[column, k]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _differ(colour: Singles, a: int, b: int, step: float) -> bool:
    """Whether two pixels are so different that the border between them would look jagged."""
    for k in range(3):
        p, q = min(colour[a, k], np.float32(1)), min(colour[b, k], np.float32(1))
        # The eye sees ratios, less so in the dark.
        if abs(p - q) > step * (0.15 + 0.85 * max(p, q)):
            return True
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _edges(instance: NDArray[np.int16], colour: Singles) -> Any:
    """(n,) flat numbers of the pixels that differ from one of their four neighbours."""
    rows, columns = instance.shape
    marked = np.zeros(rows * columns, np.bool_)
    owner, flat = instance.ravel(), colour.reshape(-1, 3)
    for row in range(rows):
        for column in range(columns):
            here = row * columns + column
            for k in range(2):
                if (row if k else column) + 1 >= (rows if k else columns):
                    continue
                there = here + (columns if k else 1)
                step = _TABLE_STEP if owner[here] < 0 and owner[there] < 0 else _STEP
                if owner[here] != owner[there] or _differ(flat, here, there, step):
                    marked[here] = marked[there] = True
    return np.flatnonzero(marked)


@numba.njit(cache=True, nogil=True, error_model="numpy")
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
        colour: (H, W, 3) in and out: linear colour.

    Returns:
        How many pixels were done again.
    """
    top, bottom, left, right = window
    fx, fy, cx, cy = eye.focal
    columns = instance.shape[1]
    edges = _edges(instance, colour)
    batch, spare = _new_batch(_BATCH), _new_batch(_BATCH)
    ray, face, deep, seen = batch.ray, batch.face, batch.depth, batch.colour
    flat = colour.reshape(-1, 3)
    for first in range(0, len(edges), _BATCH // 4):
        some = edges[first : first + _BATCH // 4]
        for i in range(len(some)):
            row, column = some[i] // columns, some[i] % columns
            inside = top <= row < bottom and left <= column < right
            for k in range(4):
                a, b, slot = k >> 1, k & 1, 4 * i + k
                ray[slot, 0] = (column - 0.25 + 0.5 * b - cx) / fx
                ray[slot, 1] = (row - 0.25 + 0.5 * a - cy) / fy
                face[slot] = -1
                if inside:
                    face[slot] = fine_triangle[2 * (row - top) + a, 2 * (column - left) + b]
                    deep[slot] = fine_depth[2 * (row - top) + a, 2 * (column - left) + b]
        _shade(geometry, eye, lamps, surfaces, batch, spare, 4 * len(some))
        for i in range(len(some)):
            for k in range(3):
                total = 0.0
                for slot in range(4 * i, 4 * i + 4):
                    total += min(seen[slot, k], 4.0)
                flat[some[i], k] = 0.25 * total
    return len(edges)
