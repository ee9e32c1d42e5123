"""ObjectModel: a rigid object as the simulator knows it.

Object frame: origin at the centre of mass, metres. Letters in shapes: V vertices, F triangles,
P vertices of one convex piece.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture on an object's surface.

    Args:
        image: (h, w, 3) uint8 RGB.
        uv: (V, 2) position of each vertex in the picture, (0, 0) its lower left corner.
    """

    image: NDArray[np.uint8]
    uv: Floats


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid object: its surface for pictures and height maps, convex pieces for physics.

    Args:
        id: Name, unique within a data set; letters, digits, '-', '_' and '.' only.
        vertices: (V, 3) metres, origin at the centre of mass.
        faces: (F, 3) int32 vertex numbers, counter-clockwise seen from outside.
        pieces: Vertices (P, 3) of each convex piece, in the same frame; physics takes their hulls.
        mass_kg: Mass.
        inertia: (3, 3) about the centre of mass, kg m^2.
        texture: Its own picture, where it has one.
    """

    id: str
    vertices: Floats
    faces: NDArray[np.int32]
    pieces: tuple[Floats, ...]
    mass_kg: float
    inertia: Floats
    texture: Texture | None = None

    @property
    def extents_m(self) -> Floats:
        """(3,) sides of the axis-aligned box in the object's own frame, metres."""
        return np.asarray(np.ptp(self.vertices, axis=0))
