"""From values to the arrays that the compiled loops read.

Letters in shapes: V vertices, F triangles, N objects, K lamps.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render import _film_kernel, _light_kernel, _raster_kernel
from graspmap.simulation.render import _texture_kernel as texture
from graspmap.simulation.render._scene import Eye, Geometry, Lamps, Surfaces
from graspmap.simulation.render.appearance import Appearance, Finish, Light, ObjectLook, TableLook
from graspmap.simulation.render.view import View, turn
from graspmap.simulation.tabletop import Tabletop

Floats = NDArray[np.float64]

_SKY_SAMPLES = 20
_SKY_DISTANCE_M = 3.0
_KEY_SIDE_PX = (64, 768)
_SKY_SIDE_PX = (48, 160)


def pack_eye(view: View) -> Eye:
    """The camera's numbers."""
    camera = view.camera
    return Eye(
        np.array(view.T_world_camera.rotation),
        np.array(view.T_world_camera.translation),
        (camera.fx, camera.fy, camera.cx, camera.cy),
    )


def pack_points(tabletop: Tabletop) -> tuple[Floats, NDArray[np.int32]]:
    """(V, 3) world vertices of all objects, and their (F, 3) triangles."""
    models = [placed.model for placed in tabletop.objects]
    world = np.empty((sum(len(model.vertices) for model in models), 3))
    faces, start = [np.empty((0, 3), np.int32)], 0
    for placed in tabletop.objects:
        model, pose = placed.model, placed.T_world_object
        end = start + len(model.vertices)
        # Not RigidTransform.apply: NumPy's products round as the processor's library has it.
        _raster_kernel.to_world(
            np.ascontiguousarray(model.vertices, dtype=np.float64),
            np.array(pose.rotation),
            np.array(pose.translation),
            world[start:end],
        )
        faces.append(model.faces.astype(np.int32) + np.int32(start))
        start = end
    return world, np.concatenate(faces)


def pack_geometry(tabletop: Tabletop, eye: Eye, creases_deg: tuple[float, ...]) -> Geometry:
    """The objects' surfaces in the world and in the camera's frame."""
    world, faces = pack_points(tabletop)
    normals = _raster_kernel.face_normals(world, faces)
    uv, corners = np.zeros((len(world), 2)), np.empty((len(faces), 3, 3))
    owner, sides = np.empty(len(faces), np.int16), np.empty(len(faces), np.uint8)
    first = start = 0
    for number, placed in enumerate(tabletop.objects):
        model = placed.model
        end, last = start + len(model.vertices), first + len(model.faces)
        own = faces[first:last] - np.int32(start)
        crease = turn(math.radians(creases_deg[number]))[0]
        corners[first:last] = _raster_kernel.corner_normals(
            world[start:end], own, normals[first:last], crease
        )
        owner[first:last] = number
        sides[first:last] = 1 if _raster_kernel.is_closed(world[start:end], own) else 2
        if model.texture is not None:
            uv[start:end] = model.texture.uv
        start, first = end, last
    poses = [placed.T_world_object for placed in tabletop.objects]
    return Geometry(
        world,
        _raster_kernel.to_frame(world, eye.rotation, eye.origin),
        faces,
        normals,
        corners,
        owner,
        sides,
        uv,
        np.array([pose.rotation for pose in poses]).reshape(-1, 3, 3),
        np.array([pose.translation for pose in poses]).reshape(-1, 3),
    )


def pack_surfaces(tabletop: Tabletop, appearance: Appearance) -> Surfaces:
    """What the objects and the table look like."""
    rows = np.zeros((len(appearance.objects) + 1, texture.LENGTH))
    pictures: list[NDArray[np.uint8]] = []
    start = 0
    for row, look, placed in zip(rows[:-1], appearance.objects, tabletop.objects, strict=True):
        _pack_look(row, look)
        row[texture.AXIS : texture.AXIS + 3] = look.axis
        # Away from the origin, where a checker's borders would meet the object's own faces.
        row[texture.OFFSET] = 50.13
        picture = placed.model.texture
        if look.pattern == "picture" and picture is not None:
            height, width, _ = picture.image.shape
            row[texture.WIDTH], row[texture.HEIGHT], row[texture.OFFSET] = width, height, start
            pictures.append(picture.image.reshape(-1, 3))
            start += width * height
        elif look.pattern == "picture":
            row[texture.PATTERN] = texture.PLAIN
    _pack_look(rows[-1], appearance.table)
    cos, sin = turn(math.radians(appearance.table.angle_deg))
    rows[-1, texture.AXIS : texture.AXIS + 2] = cos, sin
    out = np.empty((start, 3), np.float32)
    if pictures:
        _film_kernel.linear_pictures(np.concatenate(pictures), out)
    return Surfaces(rows, out)


def _pack_look(row: Floats, look: ObjectLook | TableLook) -> None:
    row[texture.PATTERN] = texture.PATTERNS.index(look.pattern)
    row[texture.SCALE], row[texture.SEED] = look.scale_m, look.seed & 0xFFFFFF
    row[texture.COLOUR : texture.COLOUR + 9] = np.array(look.colours).ravel()
    finish: Finish = look.finish
    row[texture.ROUGHNESS], row[texture.REFLECTANCE] = finish.roughness, finish.reflectance
    row[texture.METAL], row[texture.GLASS] = finish.metal, finish.glass


def pack_lamps(geometry: Geometry, appearance: Appearance, pixel_m: float) -> Lamps:
    """Where light comes from and what it reaches.

    Args:
        geometry: The objects.
        appearance: The look.
        pixel_m: Size of a pixel of the picture at the objects.
    """
    light = appearance.light
    numbers = np.zeros(_light_kernel.LENGTH)
    numbers[_light_kernel.KEY : _light_kernel.KEY + 3] = light.position_m
    numbers[_light_kernel.KEY_COLOUR : _light_kernel.KEY_COLOUR + 3] = light.key
    numbers[_light_kernel.FILL : _light_kernel.FILL + 3] = light.fill_direction
    numbers[_light_kernel.FILL_COLOUR : _light_kernel.FILL_COLOUR + 3] = light.fill
    numbers[_light_kernel.SKY : _light_kernel.SKY + 3] = light.ambient
    table = np.mean(np.array(appearance.table.colours[:2]), axis=0)
    fall = (np.array(light.key) + np.array(light.ambient)) * table
    numbers[_light_kernel.GROUND : _light_kernel.GROUND + 3] = fall
    key, sky = _disk(light), _dome()
    if not len(geometry.faces):
        none = (np.empty((0, 2, 2), np.float32), np.empty((0, _light_kernel.POSE_LENGTH)), 0.0, np.empty(0))
        return Lamps(numbers, *none, *none)
    low, high = geometry.world.min(axis=0), geometry.world.max(axis=0)
    size = math.sqrt(float(((high - low) ** 2).sum()))
    sides = [
        int(min(max(size / (pixel_m * share), least), most))
        for share, (least, most) in ((0.8, _KEY_SIDE_PX), (2.5, _SKY_SIDE_PX))
    ]
    clear = np.array([look.finish.glass > 0.5 for look in appearance.objects])
    solid = np.where(clear[geometry.owner], 0, geometry.sides).astype(np.uint8)
    points, faces = geometry.world, geometry.faces
    high_sky = sky + 0.5 * (low + high)
    pictures = _light_kernel.lamp_pictures(points, faces, solid, key, sides[0])
    dome = _light_kernel.lamp_pictures(points, faces, geometry.sides, high_sky, sides[1])
    return Lamps(
        numbers,
        *pictures,
        size / (sides[0] - 4),
        np.full(len(key), 1 / len(key)),
        *dome,
        size / (sides[1] - 4),
        sky[:, 2] / sum(sky[:, 2].tolist()),
    )


def _disk(light: Light) -> Floats:
    """(K, 3) points spread evenly over the lamp."""
    place = np.array(light.position_m)
    z = place / math.sqrt(float(place[0] ** 2 + place[1] ** 2 + place[2] ** 2))
    x = np.array([-z[2], 0.0, z[0]]) if abs(z[0]) >= 0.9 else np.array([0.0, z[2], -z[1]])
    x = x / math.sqrt(float(x[0] ** 2 + x[1] ** 2 + x[2] ** 2))
    y = np.array([z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0]])
    cos, sin = turn(2.399963229728653)  # the golden angle
    along, across, points = 1.0, 0.0, []
    for k in range(light.samples):
        radius = light.radius_m * math.sqrt((k + 0.5) / light.samples)
        points.append(place + radius * (along * x + across * y))
        along, across = along * cos - across * sin, along * sin + across * cos
    return np.array(points)


def _dome() -> Floats:
    """(K, 3) points over the sky, closer together where it is high."""
    cos, sin = turn(2.399963229728653)
    along, across, points = 1.0, 0.0, []
    for k in range(_SKY_SAMPLES):
        square = 0.93 * (k + 0.5) / _SKY_SAMPLES
        level, up = math.sqrt(square), math.sqrt(1.0 - square)
        points.append((level * along, level * across, up))
        along, across = along * cos - across * sin, along * sin + across * cos
    return _SKY_DISTANCE_M * np.array(points)
