"""TableGrasps: grasps from above, in metres on the table, and their way to and from pixels.

World frame: the table is the plane z = 0, z up, metres. Letters in shapes: N grasps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.transforms import RigidTransform

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TableGrasps:
    """N grasps of a gripper that comes straight down.

    The fields mean what they mean in `Grasps`, in metres instead of pixels.

    Args:
        center_m: (N, 2) world x, y between the jaws.
        angle: (N,) radians, of the opening, counter-clockwise seen from above from the world's x
            axis, in [-pi/2, pi/2).
        width_m: (N,) opening.
        height_m: (N,) jaw size.
        quality: (N,) in [0, 1].
    """

    center_m: Floats
    angle: Floats
    width_m: Floats
    height_m: Floats
    quality: Floats

    @classmethod
    def from_pixels(
        cls,
        grasps: Grasps,
        depth_m: NDArray[np.float32],
        camera: Camera,
        T_world_camera: RigidTransform,
    ) -> TableGrasps:
        """Where grasps of a picture are, at the height that is seen at their centres.

        The centre is deprojected with the depth at its pixel (the table's where there is none);
        the ends of the opening are where their rays cross the plane at that height; the jaw is
        height_px * z / f with the depth z of the centre (as Jacquard's labels have it).
        """
        raise NotImplementedError

    def to_pixels(
        self, surface_m: Floats, camera: Camera, T_world_camera: RigidTransform
    ) -> Grasps:
        """The inverse of `from_pixels`, given the (N,) heights that are seen at the centres."""
        raise NotImplementedError
