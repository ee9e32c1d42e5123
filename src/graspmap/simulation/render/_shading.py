"""From rays to colours, in batches.

Letters in shapes: n rays; a ray (x, y) is the direction (x, y, 1) in the camera's frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render import (
    _lamp_kernel,
    _light_kernel,
    _surface_kernel,
    _texture_kernel,
)
from graspmap.simulation.render._scene import Eye, Geometry, Scene

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]

_BATCH = 16384  # rays
_BEND = 0.03  # how far glass moves what lies behind it
_SHADOW_BEHIND_GLASS = 0.3


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays meet objects.

    Args:
        rays: (2, n).
        face: (n,) triangles.
        depth: (n,) along z.
        point: (3, n) world.
        back: (3, n) unit direction to the camera.
        flat: (3, n) unit normal of the triangle, on the camera's side.
        smooth: (3, n) unit normal for shading, on the camera's side.
        share: (3, n) shares of the triangle's corners.
    """

    rays: Floats
    face: Integers
    depth: Floats
    point: Floats
    back: Floats
    flat: Floats
    smooth: Floats
    share: Floats


def pixel_rays(
    eye: Eye, pixels: NDArray[np.int64], columns: int, shift: tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """(2, n) rays through pixels, given by their flat numbers, shifted from their centres."""
    rays = np.empty((2, len(pixels)))
    _surface_kernel.pixel_rays(pixels, columns, eye.focal, shift, rays)
    return rays


def meet_objects(geometry: Geometry, eye: Eye, rays: Floats, face: Integers, depth: Floats) -> Hits:
    """Where rays meet the triangles that are known to be first."""
    point, back, flat, smooth, share = np.empty((5, 3, len(face)))
    surface = (geometry.seen, geometry.faces, geometry.normals, geometry.corners)
    _surface_kernel.meet_objects(
        eye.rotation, eye.origin, rays, face, depth, surface, point, back, flat, smooth, share
    )
    return Hits(rays, face, depth, point, back, flat, smooth, share)


def table_colours(scene: Scene, rays: Floats, shadow: float = 1.0) -> Floats:
    """(3, n) linear colour of the table on rays, or of the room where they miss it.

    Args:
        scene: What is seen.
        rays: (2, n), neighbours one after the other.
        shadow: Strength of shadows.
    """
    out = np.empty((3, rays.shape[1]))
    for batch in batches(rays.shape[1]):
        out[:, batch] = _table_batch(scene, np.ascontiguousarray(rays[:, batch]), shadow)
    return out


def object_colours(scene: Scene, hits: Hits) -> Floats:
    """(3, n) linear colour of objects on rays."""
    out = np.empty((3, len(hits.face)))
    for batch in batches(len(hits.face)):
        part = Hits(*(np.ascontiguousarray(array[..., batch]) for array in vars(hits).values()))
        out[:, batch] = _object_batch(scene, part)
    return out


def batches(count: int) -> Iterator[slice]:
    """Parts of so many rays that their numbers stay in the processor's cache."""
    for start in range(0, count, _BATCH):
        yield slice(start, min(start + _BATCH, count))


def _table_batch(scene: Scene, rays: Floats, shadow: float) -> Floats:
    count, eye = rays.shape[1], scene.eye
    point, back, own, out = np.empty((4, 3, count))
    depth, lamp, sky = np.empty((3, count))
    _surface_kernel.meet_table(eye.rotation, eye.origin, rays, point, back, depth)
    row = scene.surfaces.rows[-1]
    # A pixel covers more of the table where the view is flat.
    pixel = np.abs(depth) / (eye.focal[0] * np.maximum(back[2], 0.05))
    _texture_kernel.table_colours(row, point, pixel, own)
    for source, light in ((scene.key, lamp), (scene.sky, sky)):
        _lamp_kernel.table_light(source.pictures, source.poses, source.shares, point, light)
        if shadow != 1.0:
            light[:] = 1.0 - shadow * (1.0 - light)
    finish = (
        row[_texture_kernel.ROUGHNESS],
        row[_texture_kernel.METAL],
        row[_texture_kernel.REFLECTANCE],
    )
    _light_kernel.leave_table(finish, scene.light, own, point, back, lamp, sky, out)
    room = depth < 0
    if room.any():
        out[:, room] = scene.light[_light_kernel.SKY : _light_kernel.SKY + 3, None]
    return out


def _object_batch(scene: Scene, hits: Hits) -> Floats:
    geometry, surfaces = scene.geometry, scene.surfaces
    count, owner = len(hits.face), geometry.owner[hits.face]
    own, out = np.empty((2, 3, count))
    lamp, sky = np.empty((2, count))
    _texture_kernel.object_colours(
        surfaces.rows,
        owner,
        geometry.rotations,
        geometry.translations,
        hits.point,
        hits.depth / scene.eye.focal[0],
        own,
    )
    if len(surfaces.pictures):
        _texture_kernel.picture_colours(
            surfaces.rows,
            owner,
            surfaces.pictures,
            geometry.faces,
            geometry.uv,
            hits.face,
            hits.share,
            own,
        )
    for source, by_cosine, light in ((scene.key, False, lamp), (scene.sky, True, sky)):
        _lamp_kernel.object_light(
            source.pictures,
            source.poses,
            source.shares,
            source.texel,
            hits.point,
            hits.flat,
            hits.smooth,
            by_cosine,
            light,
        )
    _light_kernel.leave_objects(
        surfaces.rows, owner, scene.light, own, hits.point, hits.smooth, hits.back, lamp, sky, out
    )
    glass = np.flatnonzero(surfaces.rows[owner, _texture_kernel.GLASS] > 0)
    if len(glass):
        out[:, glass] = _glass(scene, hits, owner[glass], own, out, glass)
    return out


def _glass(
    scene: Scene,
    hits: Hits,
    owner: NDArray[np.int16],
    own: Floats,
    out: Floats,
    glass: NDArray[np.int64],
) -> Floats:
    """(3, n) colour of those of the rays that meet glass, with what lies behind it."""
    r = scene.eye.rotation
    normal = hits.smooth[:, glass]
    # The normal along the picture's x and y says which way the rays are bent.
    rays = hits.rays[:, glass].copy()
    for axis in range(2):
        along = r[0, axis] * normal[0] + r[1, axis] * normal[1] + r[2, axis] * normal[2]
        rays[axis] -= _BEND * along
    behind = table_colours(scene, rays, _SHADOW_BEHIND_GLASS)
    mixed = np.ascontiguousarray(out[:, glass])
    _light_kernel.see_through(
        scene.surfaces.rows,
        owner,
        scene.light,
        np.ascontiguousarray(own[:, glass]),
        normal,
        np.ascontiguousarray(hits.back[:, glass]),
        behind,
        mixed,
    )
    return mixed
