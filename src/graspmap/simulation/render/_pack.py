"""From values to the arrays that the compiled loops read.

Letters in shapes: V vertices, F triangles, N objects, K lamps.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render import (
    _film_kernel,
    _lamp_kernel,
    _light_kernel,
    _raster_kernel,
)
from graspmap.simulation.render import _texture_kernel as texture
from graspmap.simulation.render._scene import Eye, Geometry, Lamp, Scene, Surfaces
from graspmap.simulation.render.appearance import Appearance, Finish, Light, ObjectLook, TableLook
from graspmap.simulation.render.view import View, turn
from graspmap.simulation.tabletop import Tabletop

Floats = NDArray[np.float64]

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
    normals, seen = np.empty((len(faces), 3)), np.empty(world.shape)
    _raster_kernel.face_normals(world, faces, normals)
    _raster_kernel.to_frame(world, eye.rotation, eye.origin, seen)
    uv, corners = np.zeros((len(world), 2)), np.empty((len(faces), 3, 3))
    owner, sides = np.empty(len(faces), np.int16), np.empty(len(faces), np.uint8)
    first = start = 0
    for number, placed in enumerate(tabletop.objects):
        model = placed.model
        end, last = start + len(model.vertices), first + len(model.faces)
        own = faces[first:last] - np.int32(start)
        crease = turn(math.radians(creases_deg[number]))[0]
        _raster_kernel.corner_normals(
            len(model.vertices), own, normals[first:last], crease, corners[first:last]
        )
        owner[first:last] = number
        sides[first:last] = 1 if _raster_kernel.is_closed(world[start:end], own) else 2
        if model.texture is not None:
            uv[start:end] = model.texture.uv
        start, first = end, last
    poses = [placed.T_world_object for placed in tabletop.objects]
    return Geometry(
        world,
        seen,
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


def pack_scene(tabletop: Tabletop, appearance: Appearance, geometry: Geometry, eye: Eye) -> Scene:
    """Everything that a picture's colours follow from."""
    surfaces = pack_surfaces(tabletop, appearance)
    light = _pack_light(appearance)
    if not len(geometry.faces):
        none = Lamp(
            np.empty((0, 2, 2), np.float32),
            np.empty((0, _lamp_kernel.POSE_LENGTH)),
            0.0,
            np.empty(0),
        )
        return Scene(geometry, eye, surfaces, light, none, none)
    low, high = geometry.world.min(axis=0), geometry.world.max(axis=0)
    size = math.sqrt(float(((high - low) ** 2).sum()))
    # Of a pixel of the picture at the objects.
    pixel = float(eye.origin[2]) / eye.focal[0]
    clear = np.array([look.finish.glass > 0.5 for look in appearance.objects])
    solid = np.where(clear[geometry.owner], 0, geometry.sides).astype(np.uint8)
    key_points, dome = _disk(appearance.light), _dome(appearance.light.samples)
    equal, facing = [1 / len(key_points)] * len(key_points), dome[:, 2] / sum(dome[:, 2].tolist())
    key = _lamp(geometry, solid, key_points, size, size / pixel, _KEY_SIDE_PX)
    sky_points = dome + 0.5 * (low + high)
    sky = _lamp(geometry, geometry.sides, sky_points, size, size / (2.5 * pixel), _SKY_SIDE_PX)
    return Scene(geometry, eye, surfaces, light, Lamp(*key, np.array(equal)), Lamp(*sky, facing))


def _lamp(
    geometry: Geometry,
    drawn: NDArray[np.uint8],
    points: Floats,
    size: float,
    wanted: float,
    limits: tuple[int, int],
) -> tuple[NDArray[np.float32], Floats, float]:
    """Pictures, poses and texel of (K, 3) points that give light."""
    side = int(min(max(wanted, limits[0]), limits[1]))
    pictures = np.empty((len(points), side, side), np.float32)
    poses = np.empty((len(points), _lamp_kernel.POSE_LENGTH))
    rotation, seen = np.empty((3, 3)), np.empty(geometry.world.shape)
    depth, triangle = np.empty((side, side)), np.empty((side, side), np.int32)
    for picture, pose, point in zip(pictures, poses, points, strict=True):
        _lamp_kernel.aim(geometry.world, point, side, rotation, pose)
        _raster_kernel.to_frame(geometry.world, rotation, point, seen)
        focal, cx, cy = pose[_lamp_kernel.FOCAL : _lamp_kernel.CENTRE + 2].tolist()
        depth.fill(np.inf)
        _raster_kernel.draw_triangles(
            seen, geometry.faces, drawn, (focal, focal, cx, cy), depth, triangle
        )
        picture[:] = depth
    return pictures, poses, size / (side - 4)


def _pack_light(appearance: Appearance) -> Floats:
    light, out = appearance.light, np.zeros(_light_kernel.LENGTH)
    out[_light_kernel.KEY : _light_kernel.KEY + 3] = light.position_m
    out[_light_kernel.KEY_COLOUR : _light_kernel.KEY_COLOUR + 3] = light.key
    out[_light_kernel.FILL : _light_kernel.FILL + 3] = light.fill_direction
    out[_light_kernel.FILL_COLOUR : _light_kernel.FILL_COLOUR + 3] = light.fill
    out[_light_kernel.SKY : _light_kernel.SKY + 3] = light.ambient
    for channel in range(3):
        first, second, _ = (colour[channel] for colour in appearance.table.colours)
        table = 0.5 * (first + second)
        out[_light_kernel.GROUND + channel] = table * (light.key[channel] + light.ambient[channel])
    return out


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


def _dome(count: int) -> Floats:
    """(K, 3) points over the sky, closer together where it is high."""
    cos, sin = turn(2.399963229728653)
    along, across, points = 1.0, 0.0, []
    for k in range(count):
        square = 0.93 * (k + 0.5) / count
        level, up = math.sqrt(square), math.sqrt(1.0 - square)
        points.append((level * along, level * across, up))
        along, across = along * cos - across * sin, along * sin + across * cos
    return _SKY_DISTANCE_M * np.array(points)
