"""Grasps that Jacquard's labels say hold, and grasps that presumably do not.

World frame: the table is the plane z = 0, metres. Letters in shapes: N grasps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper
from graspmap.simulation.heightmap import HeightMap

Floats = NDArray[np.float64]

KINDS = ("label", "random", "turned", "shifted", "half")
"""Labels; then what presumably fails: anywhere on the object, a label turned by a quarter, a label
shifted by 3 to 4 cm along its opening, a label half-closed below the object's width."""

NEAR_M, NEAR_RAD = 0.02, np.radians(30.0)
"""A grasp nearer to a label than both may well hold: it is not presumed to fail."""

_SHIFT_M = (0.03, 0.04)
_ON_OBJECT_M = 0.002
_WIDTH_ABOVE_M = 0.003
_NARROWER_M = 0.002
_TRIES = 40  # draws for each negative that is wanted


def with_known_jaws(grasps: TableGrasps, gripper: Gripper) -> TableGrasps:
    """The grasps with the nearest jaw of the gripper (labels are rounded to pixels)."""
    jaws = np.array(gripper.jaw_sizes_m)
    nearest = np.abs(grasps.height_m[:, None] - jaws).argmin(axis=1)
    return grasps.replace(height_m=jaws[nearest])


def presumed(
    labels: TableGrasps, height_map: HeightMap, count: int, rng: np.random.Generator
) -> dict[str, TableGrasps]:
    """At most ``count`` grasps of each kind that presumably fails; fewer where labels are dense."""
    source = labels[rng.integers(len(labels), size=_TRIES * count)]
    cells = np.argwhere(height_map.mask(_ON_OBJECT_M))
    cells = cells[rng.integers(len(cells), size=len(source))]
    angle = rng.uniform(-np.pi / 2, np.pi / 2, len(source))
    away = rng.uniform(*_SHIFT_M, len(source)) * rng.choice([-1.0, 1.0], len(source))
    drawn = {
        "random": source.replace(center_m=height_map.middles(cells), angle=angle),
        "turned": source.replace(angle=source.angle + np.pi / 2),
        "shifted": source.replace(center_m=source.center_m + away[:, None] * source.axis()),
    }
    found = {kind: grasps[far_from(grasps, labels)][:count] for kind, grasps in drawn.items()}
    half = source.replace(width_m=source.width_m / 2)
    too_wide = extent(height_map, source) > half.width_m + _NARROWER_M
    return {**found, "half": half[too_wide][:count]}


def far_from(grasps: TableGrasps, labels: TableGrasps) -> NDArray[np.bool_]:
    """(N,) which grasps have no label within `NEAR_M` and `NEAR_RAD`."""
    place, turn = gaps(grasps, labels)
    return np.asarray(~((place < NEAR_M) & (turn < NEAR_RAD)).any(axis=1))


def gaps(grasps: TableGrasps, labels: TableGrasps) -> tuple[Floats, Floats]:
    """(N, L) distances and angles between grasps and L labels."""
    place = np.linalg.norm(grasps.center_m[:, None] - labels.center_m, axis=2)
    turn = (grasps.angle[:, None] - labels.angle + np.pi / 2) % np.pi - np.pi / 2
    return place, np.abs(turn)


def extent(height_map: HeightMap, grasps: TableGrasps) -> Floats:
    """(N,) how far the object reaches along the middle of each opening, metres."""
    steps = np.linspace(-0.5, 0.5, 101)
    along = steps[:, None] * grasps.width_m[:, None, None] * grasps.axis()[:, None]
    high = height_map.at(grasps.center_m[:, None] + along) > _WIDTH_ABOVE_M
    first, last = high.argmax(axis=1), 100 - high[:, ::-1].argmax(axis=1)
    return np.where(high.any(axis=1), (last - first) / 100 * grasps.width_m, 0.0)
