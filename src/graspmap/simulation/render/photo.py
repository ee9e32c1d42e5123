"""Photo: the same picture by path tracing, with light that goes through glass and between things.

Needs the extra ``photo`` (Mitsuba 3). Depth, mask, normals and object numbers are those of
`render`; the colours take seconds to minutes instead of milliseconds, and their last bits may
differ between machines.

References:
    W. Jakob et al., "Mitsuba 3 renderer", 2022, https://mitsuba-renderer.org
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError, MissingExtraError
from graspmap.simulation.render import _film_kernel, _light_kernel, _texture_kernel
from graspmap.simulation.render._pack import pack_eye, pack_geometry, pack_surfaces
from graspmap.simulation.render._scene import Eye, Geometry, Surfaces
from graspmap.simulation.render.appearance import Appearance, Finish, Light
from graspmap.simulation.render.rendering import Rendering, develop, render
from graspmap.simulation.render.view import View
from graspmap.simulation.tabletop import Tabletop

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# The LLVM variants are quicker, but end the whole process where the system's LLVM is too old.
_VARIANT = "scalar_rgb"
_TABLE_M = 6.0  # side of the table
_BAKED_M = 1.6  # side of its part that has a pattern; beyond, the pattern is mirrored
_LONGEST_PX = 3.0  # edges of triangles that carry a pattern
_ROOM = (64, 128)  # rows and columns of the picture of the room
_BOUNCES = 12
_SPECK = 2.5  # times the light around, beyond which a pixel is an error
_DULL = 0.003  # reflectance below which a surface only scatters


def check_photo() -> None:
    """See that photos can be taken here, before long work.

    Raises:
        MissingExtraError: Mitsuba is not installed, or not for this Python.
    """
    _mitsuba()


def _mitsuba() -> Any:
    try:
        import mitsuba
    except ImportError as error:
        raise MissingExtraError("a photo by path tracing", "mitsuba", "photo") from error
    return mitsuba


def photo(
    tabletop: Tabletop,
    view: View,
    appearance: Appearance,
    *,
    samples: int = 128,
    seed: int = 0,
) -> Rendering:
    """Take a picture by path tracing.

    Args:
        tabletop: Objects on the table.
        view: From where; the camera has square pixels.
        appearance: What things look like; glass and metal look like glass and metal.
        samples: Paths through each pixel; the noise falls with their root.
        seed: Of the paths.

    Returns:
        The channels of `render`, with colours of the path tracer.

    Raises:
        MissingExtraError: As `check_photo`.
        InvalidInputError: As `render`; or the pixels are not square, or a number is not positive.
    """
    mitsuba = _mitsuba()
    if samples < 1:
        raise InvalidInputError("samples", samples, "1 or more paths for each pixel")
    if not math.isclose(view.camera.fx, view.camera.fy, rel_tol=1e-9):
        raise InvalidInputError(
            "focal lengths", (view.camera.fx, view.camera.fy), "equal ones (square pixels)"
        )
    picture = render(tabletop, view, appearance)
    before = mitsuba.variant()
    mitsuba.set_variant(_VARIANT)
    # It warns that it rounds the number of samples up.
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    try:
        scene = mitsuba.load_dict(_scene(mitsuba, tabletop, view, appearance, samples))
        light = np.array(
            mitsuba.render(scene, spp=samples, seed=mitsuba.UInt32(seed)), dtype=np.float32
        )
    finally:
        if before is not None:
            mitsuba.set_variant(before)
    light = _without_specks(np.nan_to_num(light[..., :3]))
    return replace(picture, rgb=develop(light, appearance))


def _without_specks(light: Singles) -> Singles:
    """(H, W, 3) light without single pixels that one rare path made far too bright."""
    from scipy.ndimage import median_filter

    around = median_filter(light, size=(3, 3, 1), mode="nearest")
    return np.asarray(np.minimum(light, _SPECK * around + 0.02), dtype=np.float32)


def _scene(
    mi: Any, tabletop: Tabletop, view: View, appearance: Appearance, samples: int
) -> dict[str, Any]:
    """The whole scene as Mitsuba's dictionary."""
    eye = pack_eye(view)
    creases = tuple(look.crease_deg for look in appearance.objects)
    geometry = pack_geometry(tabletop, eye, creases)
    surfaces = pack_surfaces(tabletop, appearance)
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": _BOUNCES, "hide_emitters": True},
        "sensor": _sensor(mi, view, samples),
        "room": _room(mi, appearance.light),
        "table": _table(mi, surfaces, appearance),
    }
    scene |= _lamps(mi, appearance.light)
    for number in range(len(tabletop.objects)):
        texture = tabletop.objects[number].model.texture
        image = None if texture is None else texture.image
        scene[f"object{number}"] = _object(mi, geometry, surfaces, appearance, eye, number, image)
    return scene


def _sensor(mi: Any, view: View, samples: int) -> dict[str, Any]:
    camera = view.camera
    # Mitsuba's camera has x to the left and y up.
    pose = view.T_world_camera.matrix @ np.diag([-1.0, -1.0, 1.0, 1.0])
    width, height = camera.width, camera.height
    return {
        "type": "perspective",
        "fov": math.degrees(2 * math.atan(width / (2 * camera.fx))),
        "fov_axis": "x",
        "near_clip": 0.01,
        "far_clip": 100.0,
        "principal_point_offset_x": ((width - 1) / 2 - camera.cx) / width,
        "principal_point_offset_y": ((height - 1) / 2 - camera.cy) / height,
        "to_world": mi.ScalarTransform4f(pose),
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
        "sampler": {"type": "multijitter", "sample_count": samples},
    }


def _rgb(colour: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(channel) for channel in colour]}


def _lamps(mi: Any, light: Light) -> dict[str, Any]:
    """The lamp as a bright disk that faces the world's origin, and the second lamp."""
    place = np.array(light.position_m)
    distance, radius = float(np.linalg.norm(place)), max(light.radius_m, 0.005)
    # What arrives at the origin is radiance times the disk's area over the square of the distance.
    strength = (distance / radius) ** 2
    upright = [0, 1, 0] if abs(place[1]) < 0.9 * distance else [1, 0, 0]
    look = mi.ScalarTransform4f().look_at(place.tolist(), [0, 0, 0], upright)
    lamps: dict[str, Any] = {
        "lamp": {
            "type": "disk",
            "to_world": look @ mi.ScalarTransform4f().scale([radius, radius, 1]),
            "bsdf": {"type": "null"},
            "emitter": {"type": "area", "radiance": _rgb(strength * np.array(light.key))},
        }
    }
    if max(light.fill) > 0:
        lamps["fill"] = {
            "type": "directional",
            "direction": (-np.array(light.fill_direction)).tolist(),
            "irradiance": _rgb(math.pi * np.array(light.fill)),
        }
    return lamps


def _room(mi: Any, light: Light) -> dict[str, Any]:
    """Light from all around: what `render` takes for the room, so bright on the table as there."""
    rows, columns = _ROOM
    polar = (np.arange(rows) + 0.5) * np.pi / rows
    around = (np.arange(columns) + 0.5) * 2 * np.pi / columns
    seen = np.array(
        [
            _light_kernel.surroundings(
                math.sin(p) * math.cos(a), math.sin(p) * math.sin(a), math.cos(p), 0.1
            )[0]
            for p in polar
            for a in around
        ]
    ).reshape(rows, columns)
    weight = np.maximum(np.cos(polar), 0.0) * np.sin(polar)
    seen /= (seen * weight[:, None]).sum() / (weight.sum() * columns)
    picture = seen[..., None] * np.array(light.ambient)
    # Mitsuba's picture of the room has y up and begins elsewhere in the circle.
    upright = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    bitmap = mi.Bitmap(np.roll(picture, columns // 4, axis=1).astype(np.float32))
    return {"type": "envmap", "bitmap": bitmap, "to_world": upright}


def _material(finish: Finish, colour: dict[str, Any], tint: Any) -> dict[str, Any]:
    """Mitsuba's name for how a surface takes light."""
    if finish.glass > 0.5:
        return {
            "type": "dielectric",
            "int_ior": 1.5,
            "specular_transmittance": _rgb(0.55 + 0.45 * np.asarray(tint)),
        }
    if finish.metal > 0.5:
        return {
            "type": "roughconductor",
            "material": "none",
            "alpha": max(finish.roughness**2, 0.01),
            "specular_reflectance": colour,
        }
    if finish.reflectance < _DULL:
        return {"type": "twosided", "material": {"type": "diffuse", "reflectance": colour}}
    return {
        "type": "twosided",
        "material": {
            "type": "principled",
            "base_color": colour,
            "roughness": max(finish.roughness, 0.05),
            # Of this scale 0.5 stands for a reflectance of 4 percent.
            "specular": min(max(finish.reflectance * 12.5, 0.01), 1.0),
        },
    }


def _table(mi: Any, surfaces: Surfaces, appearance: Appearance) -> dict[str, Any]:
    side = 1024
    place = ((np.arange(side) + 0.5) / side - 0.5) * _BAKED_M
    # Mitsuba's pictures begin below: v = 0 is their first row.
    x, y = np.meshgrid(place, place)
    point = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    colours = np.empty_like(point)
    pixel = np.full(x.size, _BAKED_M / side)
    _texture_kernel.table_colours(surfaces.rows[-1], point, pixel, colours)
    half, reach = _TABLE_M / 2, _TABLE_M / _BAKED_M / 2
    corners = np.array([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)])
    uv = np.array([(-reach, -reach), (reach, -reach), (reach, reach), (-reach, reach)]) + 0.5
    colour = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(colours.T.reshape(side, side, 3).astype(np.float32)),
        "raw": True,
        "wrap_mode": "mirror",
    }
    tint = appearance.table.colours[0]
    bsdf = mi.load_dict(_material(appearance.table.finish, colour, tint))
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    return _mesh(mi, "table", bsdf, corners, faces, uv=uv)  # type: ignore[no-any-return]


def _object(
    mi: Any,
    geometry: Geometry,
    surfaces: Surfaces,
    appearance: Appearance,
    eye: Eye,
    number: int,
    image: NDArray[np.uint8] | None,
) -> Any:
    """A mesh in the world, its corners apart so that sharp edges stay sharp."""
    look, mine = appearance.objects[number], geometry.owner == number
    faces = geometry.faces[mine]
    corners, normals = geometry.world[faces], geometry.corners[mine]
    uv, colours = geometry.uv[faces].reshape(-1, 2) * [1, -1] + [0, 1], None
    colour = _rgb(look.colours[0])
    if look.pattern == "picture" and image is not None:
        light = np.empty((image.shape[0] * image.shape[1], 3), np.float32)
        _film_kernel.linear_pictures(np.ascontiguousarray(image.reshape(-1, 3)), light)
        bitmap = mi.Bitmap(light.reshape(image.shape))
        colour = {"type": "bitmap", "bitmap": bitmap, "raw": True}
    elif look.pattern not in ("plain", "picture"):
        pixel = float(eye.origin[2]) / eye.focal[0]
        corners, normals = _divided(corners, normals, _LONGEST_PX * pixel)
        uv, points = np.zeros((3 * len(corners), 2)), corners.reshape(-1, 3).T.copy()
        own = np.empty_like(points)
        owner, pixels = np.full(points.shape[1], number, np.int16), np.full(points.shape[1], pixel)
        _texture_kernel.object_colours(
            surfaces.rows,
            owner,
            geometry.rotations,
            geometry.translations,
            points,
            pixels,
            own,
        )
        colours, colour = own.T, {"type": "mesh_attribute", "name": "vertex_color"}
    bsdf = mi.load_dict(_material(look.finish, colour, look.colours[0]))
    order = np.arange(3 * len(corners)).reshape(-1, 3)
    points, directions = corners.reshape(-1, 3), normals.reshape(-1, 3)
    return _mesh(
        mi, f"object{number}", bsdf, points, order, normals=directions, uv=uv, colours=colours
    )


def _divided(corners: Floats, normals: Floats, longest: float) -> tuple[Floats, Floats]:
    """(F, 3, 3) corners and normals of triangles halved until no edge is longer."""
    for _ in range(24):
        edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        large = edges.max(axis=1) > longest
        if not large.any():
            break
        # The longest edge comes first, and its middle makes two triangles of one.
        first = edges[large].argmax(axis=1)
        order = (first[:, None] + np.arange(3)) % 3
        parts = []
        for array in (corners, normals):
            a, b, c = np.moveaxis(np.take_along_axis(array[large], order[..., None], axis=1), 1, 0)
            middle = (a + b) / 2
            halves = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
            parts.append(np.concatenate([array[~large], halves]))
        corners, normals = parts
    return corners, normals


def _mesh(
    mi: Any,
    name: str,
    bsdf: Any,
    vertices: Floats,
    faces: NDArray[Any],
    *,
    uv: Floats,
    normals: Floats | None = None,
    colours: Floats | None = None,
) -> Any:
    """A mesh of Mitsuba."""
    properties = mi.Properties()
    properties["mesh_bsdf"] = bsdf
    mesh = mi.Mesh(
        name,
        len(vertices),
        len(faces),
        props=properties,
        has_vertex_normals=normals is not None,
        has_vertex_texcoords=True,
    )
    if colours is not None:
        mesh.add_attribute("vertex_color", 3, colours.ravel().astype(np.float32))
    values = mi.traverse(mesh)
    values["vertex_positions"] = vertices.ravel().astype(np.float32)
    values["faces"] = faces.ravel().astype(np.uint32)
    values["vertex_texcoords"] = uv.ravel().astype(np.float32)
    if normals is not None:
        values["vertex_normals"] = normals.ravel().astype(np.float32)
    values.update()
    return mesh
