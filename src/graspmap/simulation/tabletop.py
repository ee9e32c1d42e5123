"""Tabletop: objects at rest on the table, the one thing that pictures and trials are made of.

World frame: the table is the plane z = 0, z up, metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.geometry.transforms import RigidTransform
from graspmap.simulation.heightmap import HeightMap
from graspmap.simulation.objects import ObjectModel

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlacedObject:
    """An object and where it lies.

    Args:
        model: The object.
        T_world_object: Its pose: maps the object's coordinates to the world's.
    """

    model: ObjectModel
    T_world_object: RigidTransform

    def triangles(self) -> Floats:
        """(F, 3, 3) corners of its faces in the world, metres."""
        corners = self.T_world_object.apply(self.model.vertices)
        return np.asarray(corners[self.model.faces])


@dataclass(frozen=True, eq=False)
class Tabletop:
    """Objects at rest on the table.

    Args:
        objects: The objects with their poses.
        height_map: The scene seen straight from above; what descents are judged on.
    """

    objects: tuple[PlacedObject, ...]
    height_map: HeightMap

    @classmethod
    def of(cls, objects: tuple[PlacedObject, ...]) -> Tabletop:
        """With the height map that the objects' surfaces give."""
        triangles = [placed.triangles() for placed in objects]
        return cls(objects, HeightMap.from_triangles(np.concatenate(triangles)))
