"""Objects of the studies: plain shapes with exact convex pieces, and where they stand.

Each stands with its lowest point at z = 0 and keeps the frame that it was built in (the middle of
the shape above the origin), so that the cases of a study can say where to grasp.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from graspmap.geometry.transforms import RigidTransform
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.procedural.convex import convex
from graspmap.simulation.procedural.handled import ear
from graspmap.simulation.procedural.outline import Outline, circle
from graspmap.simulation.procedural.primitives import ball, block, cylinder
from graspmap.simulation.procedural.revolve import revolve, revolve_ring
from graspmap.simulation.procedural.solid import Solid, join
from graspmap.simulation.solids import mass_properties, object_from_solid
from graspmap.simulation.tabletop import PlacedObject, Tabletop

Floats = NDArray[np.float64]

MUG_RADIUS_M, MUG_HEIGHT_M, MUG_WALL_M, MUG_REACH_M = 0.04, 0.09, 0.005, 0.03
RING_RADIUS_M, RING_WALL_M = 0.04, 0.01


@dataclass(frozen=True, eq=False)
class Standing:
    """A solid and how far its centre of mass is from the origin of the frame it was built in."""

    solid: Solid

    def tabletop(self, mass_kg: float, id: str = "object") -> Tabletop:
        """The solid on the table, its frame parallel to the world's, above the origin."""
        solid = self.solid
        low = float(solid.vertices[:, 2].min())
        center = mass_properties(solid.vertices, solid.faces).center_m - [0.0, 0.0, low]
        model = self.model(mass_kg, id)
        return Tabletop.of((PlacedObject(model, RigidTransform(np.eye(3), center)),))

    def model(self, mass_kg: float, id: str = "object") -> ObjectModel:
        """The object itself."""
        solid = self.solid
        return object_from_solid(id, solid.vertices, solid.faces, solid.pieces, mass_kg=mass_kg)


def bar(length_m: float, width_m: float, height_m: float) -> Standing:
    """A block, its length along x."""
    return Standing(block(length_m, width_m, height_m))


def lying_cylinder(radius_m: float, length_m: float) -> Standing:
    """A cylinder along x."""
    solid = cylinder(radius_m, length_m).moved(z=-length_m / 2).turned("y", np.pi / 2)
    return Standing(solid)


def standing_cylinder(radius_m: float, height_m: float) -> Standing:
    """A cylinder along z."""
    return Standing(cylinder(radius_m, height_m))


def sphere(radius_m: float) -> Standing:
    """A sphere."""
    return Standing(ball(radius_m))


def ring(height_m: float = 0.02) -> Standing:
    """A flat ring; the middle of its rim is on a circle of `RING_RADIUS_M`."""
    inner, outer = RING_RADIUS_M - RING_WALL_M / 2, RING_RADIUS_M + RING_WALL_M / 2
    return Standing(
        revolve_ring([(inner, 0.0), (outer, 0.0), (outer, height_m), (inner, height_m)])
    )


def mug() -> Standing:
    """A cup about the z axis with a handle towards x."""
    inside = MUG_RADIUS_M - MUG_WALL_M
    line = [(MUG_RADIUS_M, 0.0), (MUG_RADIUS_M, MUG_HEIGHT_M)]
    body = revolve(line, [(inside, MUG_WALL_M), (inside, MUG_HEIGHT_M)])
    handle = ear(line, 0.015, 0.075, MUG_REACH_M, 0.008, 0.012, MUG_WALL_M)
    return Standing(join([body, handle]))


def wrench() -> Standing:
    """A wrench along x: a bar 16 mm wide, an open end at +x, a ring at -x, 10 mm high."""
    shape = shapely.union_all(
        [
            shapely.box(-0.06, -0.008, 0.06, 0.008),
            circle(0.02, (0.07, 0)),
            circle(0.018, (-0.07, 0)),
        ]
    )
    slot = shapely.affinity.rotate(shapely.box(0.068, -0.009, 0.12, 0.009), 15, origin=(0.07, 0))
    shape = shape.difference(slot).difference(circle(0.010, (-0.07, 0), hole=True))
    return Standing(Outline.of(shape).plate(0.010))


def wedge(slope_rad: float, height_m: float = 0.04, top_m: float = 0.02) -> Standing:
    """A long roof along x whose sides lean inwards from the vertical by ``slope_rad``."""
    bottom = top_m / 2 + height_m * np.tan(slope_rad)
    section = [(-bottom, 0.0), (bottom, 0.0), (top_m / 2, height_m), (-top_m / 2, height_m)]
    return Standing(convex(np.array([(x, y, z) for x in (-0.05, 0.05) for y, z in section])))


Maker = Callable[[], Standing]
