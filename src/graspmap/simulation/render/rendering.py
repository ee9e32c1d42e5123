"""Rendering: one picture of a tabletop with all its channels.

What each pixel's centre sees is exact; colour alone is a mean over the pixel. Same inputs, same
bytes, on every machine.

Letters in shapes: H rows, W columns.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.simulation.render import _edge_kernel, _film_kernel, _raster_kernel, _shading
from graspmap.simulation.render._pack import pack_eye, pack_geometry, pack_scene
from graspmap.simulation.render._scene import Eye, Geometry, Scene
from graspmap.simulation.render.appearance import Appearance, Film
from graspmap.simulation.render.view import View
from graspmap.simulation.tabletop import Tabletop

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]
Window = tuple[int, int, int, int]

_BRIGHTEST = 4.0  # linear light at one point of a pixel
_WHITE = 2.7  # light of a white sheet at exposure 1; above 0.7 it is pressed together, below 1


@dataclass(frozen=True, eq=False)
class Rendering:
    """A picture with all its channels.

    Args:
        rgb: (H, W, 3) uint8 colour.
        depth: (H, W) float32 metres along the camera's z axis, exact at each pixel's centre; NaN
            where the view goes past the table.
        mask: (H, W) bool, True where an object is seen.
        normals: (H, W, 3) float32 unit normals in the world, on the camera's side of the surface
            and smooth over blunt edges; NaN where the depth is.
        instance: (H, W) int16 number of the object in the tabletop, -1 for the table.
    """

    rgb: NDArray[np.uint8]
    depth: NDArray[np.float32]
    mask: NDArray[np.bool_]
    normals: NDArray[np.float32]
    instance: NDArray[np.int16]


def render(tabletop: Tabletop, view: View, appearance: Appearance) -> Rendering:
    """Take a picture.

    Args:
        tabletop: Objects on the table.
        view: From where; the camera stands above the table.
        appearance: What things look like, as `sample_appearance` gives it.

    Raises:
        InvalidInputError: The appearance is for another number of objects, or the camera is below
            the table.
    """
    if len(appearance.objects) != len(tabletop.objects):
        raise InvalidInputError(
            "objects of the appearance",
            len(appearance.objects),
            f"{len(tabletop.objects)}, one look for each object on the table",
        )
    eye = pack_eye(view)
    if eye.origin[2] <= 0:
        raise InvalidInputError("height of the camera", eye.origin[2], "above the table, > 0 m")
    creases = tuple(look.crease_deg for look in appearance.objects)
    geometry = pack_geometry(tabletop, eye, creases)
    shape = (view.camera.height, view.camera.width)
    window = _raster_kernel.pixel_bounds(geometry.seen, eye.focal, shape)
    depth, triangle = _visible(geometry, eye, shape, window)
    seen, hits = _objects(geometry, eye, shape, window, depth, triangle)
    instance = np.full(shape, -1, np.int16)
    instance.ravel()[seen] = geometry.owner[hits.face]
    normals = np.zeros((*shape, 3), np.float32)
    normals[..., 2] = 1.0
    normals.reshape(-1, 3)[seen] = hits.smooth.T
    missed = np.isinf(depth)
    normals[missed] = np.nan
    scene = pack_scene(tabletop, appearance, geometry, eye)
    light = _colour(scene, shape, seen, hits)
    _smooth_edges(scene, window, instance, light)
    return Rendering(
        rgb=develop(light, appearance),
        depth=np.where(missed, np.nan, depth).astype(np.float32),
        mask=instance >= 0,
        normals=normals,
        instance=instance,
    )


def _objects(
    geometry: Geometry,
    eye: Eye,
    shape: tuple[int, int],
    window: Window,
    depth: Floats,
    triangle: Integers,
) -> tuple[NDArray[np.int64], _shading.Hits]:
    """(n,) flat numbers of the pixels that show an object, and where their rays meet it."""
    top, _, left, _ = window
    rows, columns = np.nonzero(triangle >= 0)
    face = triangle[rows, columns]
    seen = (rows + top) * shape[1] + columns + left
    rays = _shading.pixel_rays(eye, seen, shape[1])
    return seen, _shading.meet_objects(geometry, eye, rays, face, depth.ravel()[seen])


def _visible(
    geometry: Geometry, eye: Eye, shape: tuple[int, int], window: Window
) -> tuple[Floats, Integers]:
    """(H, W) depth of what is seen and, in the window, (h, w) its triangle, -1 for the table."""
    top, bottom, left, right = window
    depth = np.empty(shape)
    _raster_kernel.table_depth(eye.rotation, eye.origin[2], eye.focal, depth)
    triangle = np.full((bottom - top, right - left), -1, np.int32)
    fx, fy, cx, cy = eye.focal
    drawn = np.full(len(geometry.faces), 2, np.uint8)
    inside = np.ascontiguousarray(depth[top:bottom, left:right])
    focal = (fx, fy, cx - left, cy - top)
    _raster_kernel.draw_triangles(geometry.seen, geometry.faces, drawn, focal, inside, triangle)
    depth[top:bottom, left:right] = inside
    return depth, triangle


def _colour(
    scene: Scene, shape: tuple[int, int], seen: NDArray[np.int64], hits: _shading.Hits
) -> Singles:
    """(H, W, 3) linear light at the pixels' centres."""
    out = np.empty((shape[0] * shape[1], 3), np.float32)
    bare = np.ones(len(out), np.bool_)
    bare[seen] = False
    table = np.flatnonzero(bare)
    for batch in _shading.batches(len(table)):
        pixels = table[batch]
        rays = _shading.pixel_rays(scene.eye, pixels, shape[1])
        out[pixels] = _shading.table_colours(scene, rays).T
    out[seen] = _shading.object_colours(scene, hits).T
    return out.reshape(*shape, 3)


def _smooth_edges(
    scene: Scene, window: Window, instance: NDArray[np.int16], light: Singles
) -> None:
    """Replace the colour of pixels on edges by the mean over four points of each."""
    eye, geometry, (top, bottom, left, right) = scene.eye, scene.geometry, window
    fx, fy, cx, cy = eye.focal
    # Twice the resolution: the centre of pixel 0 lies between those of its pixels 0 and 1.
    fine = Eye(
        eye.rotation, eye.origin, (2 * fx, 2 * fy, 2 * (cx - left) + 0.5, 2 * (cy - top) + 0.5)
    )
    size = (2 * (bottom - top), 2 * (right - left))
    fine_depth, fine_face = _visible(geometry, fine, size, (0, size[0], 0, size[1]))
    shape = (instance.shape[0], instance.shape[1])
    marked = np.zeros(instance.size, np.bool_)
    _edge_kernel.mark_edges(instance.ravel(), light.reshape(-1, 3), shape, marked)
    edges = np.flatnonzero(marked)
    light.reshape(-1, 3)[edges] = _mean_of_four(
        scene, window, edges, shape[1], fine_depth, fine_face
    )


def _mean_of_four(
    scene: Scene,
    window: Window,
    pixels: NDArray[np.int64],
    columns: int,
    fine_depth: Floats,
    fine_face: Integers,
) -> Floats:
    """(n, 3) linear colour of pixels, given by flat numbers, from four points of each.

    Args:
        scene: What is seen.
        window: Part of the picture that holds the objects.
        pixels: (n,) flat numbers.
        columns: Of the picture.
        fine_depth: (2h, 2w) depths of the window at twice the resolution.
        fine_face: (2h, 2w) triangles there, -1 for the table.
    """
    top, bottom, left, right = window
    row, column = pixels // columns, pixels % columns
    inside = (row >= top) & (row < bottom) & (column >= left) & (column < right)
    within = np.flatnonzero(inside)
    rays = np.empty((2, 4, len(pixels)))
    face, depth = np.full((4, len(pixels)), -1, np.int32), np.zeros((4, len(pixels)))
    for part, (down, across) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        place = 2 * (row[within] - top) + down, 2 * (column[within] - left) + across
        face[part, within], depth[part, within] = fine_face[place], fine_depth[place]
        shift = (0.5 * across - 0.25, 0.5 * down - 0.25)
        rays[:, part] = _shading.pixel_rays(scene.eye, pixels, columns, shift)
    every, flat = rays.reshape(2, -1), face.ravel()
    table, objects = np.flatnonzero(flat < 0), np.flatnonzero(flat >= 0)
    colour = np.empty((3, len(flat)))
    colour[:, table] = _shading.table_colours(scene, every[:, table])
    hits = _shading.meet_objects(
        scene.geometry, scene.eye, every[:, objects], flat[objects], depth.ravel()[objects]
    )
    # A highlight does not make its whole pixel white.
    colour[:, objects] = np.minimum(_shading.object_colours(scene, hits), _BRIGHTEST)
    first, second, third, fourth = np.moveaxis(colour.reshape(3, 4, -1), 1, 0)
    return 0.25 * (first + second + third + fourth).T


def develop(light: Singles, appearance: Appearance) -> NDArray[np.uint8]:
    """(H, W, 3) bytes from linear light."""
    film, lamps = appearance.film, appearance.light
    # The blur as a share of light for each neighbour: its variance is twice that share.
    variance = (film.blur_px * light.shape[1] / 1024) ** 2
    if variance > 0:
        sharp, across, light = light, np.empty_like(light), np.empty_like(light)
        _film_kernel.blur(sharp, min(variance / 2, 0.25), across, light)
    x, y, z = lamps.position_m
    facing = z / float(np.sqrt(x * x + y * y + z * z))
    full = sum(
        key * facing + fill * lamps.fill_direction[2] + ambient
        for key, fill, ambient in zip(lamps.key, lamps.fill, lamps.ambient, strict=True)
    )
    return _bytes(light, film, _WHITE * film.exposure / full)


def _bytes(light: Singles, film: Film, gain: float) -> NDArray[np.uint8]:
    red, green, blue = film.white_balance
    out = np.empty(light.shape, np.uint8)
    _film_kernel.develop(
        light,
        (gain * red, gain * green, gain * blue),
        film.vignette,
        film.read,
        film.shot,
        film.seed & 0xFFFFFF,
        out,
    )
    return out
