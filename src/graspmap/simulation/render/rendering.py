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
from graspmap.simulation.render import (
    _film_kernel,
    _raster_kernel,
    _scene_kernel,
    _shade_kernel,
)
from graspmap.simulation.render._pack import pack_eye, pack_geometry, pack_lamps, pack_surfaces
from graspmap.simulation.render._scene_kernel import Eye, Geometry
from graspmap.simulation.render.appearance import Appearance, Film
from graspmap.simulation.render.view import View
from graspmap.simulation.tabletop import Tabletop

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]
Window = tuple[int, int, int, int]


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
    normals, instance = np.empty((*shape, 3), np.float32), np.empty(shape, np.int16)
    _scene_kernel.fill_channels(geometry, eye, window, depth, triangle, normals, instance)
    light = _colour(tabletop, appearance, geometry, eye, window, depth, triangle, instance)
    return Rendering(
        rgb=_develop(light, appearance),
        depth=np.where(np.isfinite(depth), depth, np.nan).astype(np.float32),
        mask=instance >= 0,
        normals=normals,
        instance=instance,
    )


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
    inside = depth[top:bottom, left:right]
    focal = (fx, fy, cx - left, cy - top)
    _raster_kernel.draw_triangles(geometry.seen, geometry.faces, drawn, focal, inside, triangle)
    return depth, triangle


def _colour(
    tabletop: Tabletop,
    appearance: Appearance,
    geometry: Geometry,
    eye: Eye,
    window: Window,
    depth: Floats,
    triangle: Integers,
    instance: NDArray[np.int16],
) -> Singles:
    """(H, W, 3) linear light."""
    top, bottom, left, right = window
    pixel_m = float(eye.origin[2]) / eye.focal[0]
    lamps = pack_lamps(geometry, appearance, pixel_m)
    surfaces = pack_surfaces(tabletop, appearance)
    colour = np.empty((*depth.shape, 3), np.float32)
    _shade_kernel.colour_pixels(geometry, eye, lamps, surfaces, window, depth, triangle, colour)
    fx, fy, cx, cy = eye.focal
    # Twice the resolution: the centre of pixel 0 lies between those of its pixels 0 and 1.
    focal = (2 * fx, 2 * fy, 2 * (cx - left) + 0.5, 2 * (cy - top) + 0.5)
    fine_eye = Eye(eye.rotation, eye.origin, focal)
    shape = (2 * (bottom - top), 2 * (right - left))
    fine_depth, fine_triangle = _visible(geometry, fine_eye, shape, (0, shape[0], 0, shape[1]))
    _shade_kernel.smooth_edges(
        geometry, eye, lamps, surfaces, window, fine_depth, fine_triangle, instance, colour
    )
    return colour


def _develop(light: Singles, appearance: Appearance) -> NDArray[np.uint8]:
    """(H, W, 3) bytes from linear light."""
    film, lamps = appearance.film, appearance.light
    # The blur as a share of light for each neighbour: its variance is twice that share.
    variance = (film.blur_px * light.shape[1] / 1024) ** 2
    if variance > 0:
        light = _film_kernel.blurred(light, min(variance / 2, 0.25))
    x, y, z = lamps.position_m
    facing = z / float(np.sqrt(x * x + y * y + z * z))
    full = sum(
        key * facing + fill * lamps.fill_direction[2] + ambient
        for key, fill, ambient in zip(lamps.key, lamps.fill, lamps.ambient, strict=True)
    )
    return _bytes(light, film, 2.7 * film.exposure / full)


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
