"""View: where a picture is taken from.

World: the table is the plane z = 0, z up, metres. The views made here have image x along the
world's x and image y against the world's y, up to the tilt and roll that they add.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.camera import Camera
from graspmap.geometry.transforms import RigidTransform
from graspmap.simulation.render.randomisation import Randomisation
from graspmap.simulation.tabletop import Tabletop

Floats = NDArray[np.float64]

FIELD_OF_VIEW_RAD = math.radians(30.0)
"""Of Jacquard's camera, between the left and the right edge of the picture."""

TILT_RAD = math.radians(10.0)
"""Of Jacquard's camera: its axis and the vertical; it stands on the side of the lower edge."""

DISTANCE_M = 1.5
"""From Jacquard's camera to the table, along its axis."""


class OutOfViewError(InvalidInputError):
    """An object reaches beyond what the camera sees.

    Attributes:
        object_id: The object.
        outside: Share of its surface's vertices that lie outside the picture, in (0, 1].
        beyond_px: How far the farthest of them lies outside, pixels; infinite behind the camera.
    """

    def __init__(self, object_id: str, outside: float, beyond_px: float) -> None:
        self.object_id, self.outside, self.beyond_px = object_id, outside, beyond_px
        far = (
            f", by up to {beyond_px:.0f} px" if math.isfinite(beyond_px) else ", in part behind it"
        )
        super().__init__(
            f"object {object_id}",
            f"{outside:.0%} outside the picture{far}",
            "objects that the camera sees whole: make it smaller, or take the camera farther away",
        )


@dataclass(frozen=True)
class View:
    """A camera and where it stands.

    Args:
        camera: Intrinsics and size of the picture.
        T_world_camera: Pose: maps camera coordinates to world coordinates.
    """

    camera: Camera
    T_world_camera: RigidTransform


def jacquard_view(size_px: int = 1024) -> View:
    """Jacquard's camera, for a picture scaled to ``size_px`` x ``size_px``.

    Its axis meets the table at the world's origin.

    Raises:
        InvalidInputError: The size is not a positive whole number.
    """
    camera = Camera.from_field_of_view(FIELD_OF_VIEW_RAD, size_px, size_px)
    return View(camera, _pose(math.cos(TILT_RAD), math.sin(TILT_RAD)))


def sample_view(randomisation: Randomisation, rng: np.random.Generator, size_px: int) -> View:
    """A camera at random, within the ranges of ``randomisation.camera``.

    Args:
        randomisation: Amounts.
        rng: Source of everything random.
        size_px: Side of the square picture.

    Raises:
        InvalidInputError: The size is not a positive whole number.
    """
    ranges = randomisation.camera
    distance = rng.uniform(*ranges.distance_m)
    tilt, pan, roll, field_of_view = (
        math.radians(rng.uniform(*limits))
        for limits in (ranges.tilt_deg, ranges.pan_deg, ranges.roll_deg, ranges.field_of_view_deg)
    )
    look_at = np.append(rng.uniform(-ranges.look_at_m, ranges.look_at_m, 2), 0.0)
    cos, sin = turn(field_of_view / 2)
    focal = size_px / 2 * cos / sin
    middle = (size_px - 1) / 2
    camera = Camera(focal, focal, middle, middle, size_px, size_px)
    pose = _pose(*turn(tilt), *turn(pan), *turn(roll), distance=distance, look_at=look_at)
    return View(camera, pose)


def check_in_view(tabletop: Tabletop, view: View) -> None:
    """See that the picture shows every object whole.

    Raises:
        OutOfViewError: It does not.
    """
    camera = view.camera
    T_camera_world = view.T_world_camera.inverse()
    for placed in tabletop.objects:
        points = (T_camera_world @ placed.T_world_object).apply(placed.model.vertices)
        pixels = camera.project(points)
        last = np.array([camera.width - 0.5, camera.height - 0.5])
        beyond = np.maximum(-0.5 - pixels, pixels - last).max(axis=1, initial=-math.inf)
        beyond = np.where(np.isnan(beyond), math.inf, beyond)
        outside = beyond > 0
        if outside.any():
            raise OutOfViewError(placed.model.id, float(outside.mean()), float(beyond.max()))


def turn(angle_rad: float) -> tuple[float, float]:
    """Cosine and sine of an angle between -pi and pi, with the same bits on every machine.

    Those of the C library may differ in the last bit with the processor.
    """
    # At a quarter of the angle the series ends quickly; then it is doubled twice.
    x = angle_rad / 4
    square = x * x
    cos = sin = 1.0
    for k in range(22, 0, -2):
        cos = 1.0 - square / (k * (k - 1)) * cos
        sin = 1.0 - square / (k * (k + 1)) * sin
    sin *= x
    for _ in range(2):
        cos, sin = cos * cos - sin * sin, 2.0 * sin * cos
    length = math.sqrt(cos * cos + sin * sin)
    return cos / length, sin / length


def _pose(
    cos: float,
    sin: float,
    pan_cos: float = 1.0,
    pan_sin: float = 0.0,
    roll_cos: float = 1.0,
    roll_sin: float = 0.0,
    *,
    distance: float = DISTANCE_M,
    look_at: Floats | None = None,
) -> RigidTransform:
    """``T_world_camera`` from a tilt about image x, a pan about image y and a roll about the axis.

    Products are written out: those of NumPy may round otherwise on another processor.
    """
    tilted = np.array([[1.0, 0.0, 0.0], [0.0, -cos, sin], [0.0, -sin, -cos]])
    x = pan_cos * tilted[:, 0] - pan_sin * tilted[:, 2]
    z = pan_sin * tilted[:, 0] + pan_cos * tilted[:, 2]
    y = tilted[:, 1]
    rotation = np.stack([roll_cos * x + roll_sin * y, roll_cos * y - roll_sin * x, z], axis=1)
    origin = np.zeros(3) if look_at is None else look_at
    return RigidTransform(rotation, origin - distance * z)
