"""A scene as arrays, as the compiled loops read it.

Letters in shapes: V vertices, F triangles, N objects, K lamps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Geometry:
    """The objects' surfaces.

    Args:
        world: (V, 3) vertices.
        seen: (V, 3) the same in the camera's frame.
        faces: (F, 3) vertex numbers.
        normals: (F, 3) world, as long as twice the area.
        corners: (F, 3, 3) world, unit normals for shading at the corners.
        owner: (F,) number of the object.
        sides: (F,) 1 where the object is closed, so that backs are never seen, else 2.
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
    sides: NDArray[np.uint8]
    uv: Floats
    rotations: Floats
    translations: Floats


@dataclass(frozen=True, eq=False)
class Eye:
    """The camera.

    Args:
        rotation: (3, 3) R_world_camera.
        origin: (3,) its place in the world.
        focal: (fx, fy, cx, cy) pixels.
    """

    rotation: Floats
    origin: Floats
    focal: tuple[float, float, float, float]


@dataclass(frozen=True, eq=False)
class Lamp:
    """Points that give light, and what each of them sees.

    Args:
        pictures: (K, s, s) depths of the objects from each point.
        poses: (K, POSE_LENGTH) where these pictures look.
        texel: Size of their pixels at the objects, metres.
        shares: (K,) of each point in the light on a table with nothing on it.
    """

    pictures: Singles
    poses: Floats
    texel: float
    shares: Floats


@dataclass(frozen=True, eq=False)
class Surfaces:
    """What things look like.

    Args:
        rows: (N + 1, LENGTH) numbers of the objects' surfaces and, last, the table's.
        pictures: (pixels, 3) linear colour of the objects' own pictures, one after the other.
    """

    rows: Floats
    pictures: Singles


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a picture's colours follow from.

    Args:
        geometry: The objects' surfaces.
        eye: The camera.
        surfaces: What things look like.
        light: (LENGTH,) numbers of the scene's light, as `_light_kernel` has them.
        key: The lamp.
        sky: Light from above.
    """

    geometry: Geometry
    eye: Eye
    surfaces: Surfaces
    light: Floats
    key: Lamp
    sky: Lamp
