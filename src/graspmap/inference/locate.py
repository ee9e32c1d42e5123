"""Grasps of a picture placed in the camera's frame, and fitted with a gripper's jaw.

Letters in shapes: H rows, W columns of the picture; N grasps.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.data.images import fill_depth
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.table_grasps import pixel_across, pixel_along
from graspmap.gripper import Gripper

PATCH_PX = 5
"""Side of the patch around a grasp's centre whose median depth places the grasp."""


MARGIN = 0.15
"""How much too wide an opening may be for a gripper, as a part of what it opens."""

CLEARANCE = 0.1
"""How much farther a gripper opens than it is asked to, as a part of what it opens.

A grasp is seen to a few millimetres only, and a finger that comes down on the object ends it. On
the validation scenes of graspmap-v1 24 mm of 240 held 6 of 100 grasps more (docs/results.md).
"""


def locate(
    grasps: Grasps, depth_m: NDArray[np.floating[Any]], camera: Camera
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place grasps in the camera's frame.

    The depth of a grasp is the median over a patch around its centre, so one noisy pixel does not
    move it; holes are filled first.

    Args:
        grasps: N grasps, pixels.
        depth_m: (H, W) metres along z, NaN where there is none.
        camera: Intrinsics.

    Returns:
        (N, 3) centres in metres and (N,) openings in metres.
    """
    filled = fill_depth(np.asarray(depth_m, dtype=np.float32)) if len(grasps) else depth_m
    rows, columns = filled.shape
    half = PATCH_PX // 2
    z = np.zeros(len(grasps))
    for i, (x, y) in enumerate(np.rint(grasps.center).astype(int)):
        x, y = int(np.clip(x, 0, columns - 1)), int(np.clip(y, 0, rows - 1))
        patch = filled[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
        z[i] = np.median(patch)
    half_opening = grasps.axis() * (grasps.width / 2)[:, None]
    ends = [camera.deproject(grasps.center + sign * half_opening, z) for sign in (-1, 1)]
    return camera.deproject(grasps.center, z), np.linalg.norm(ends[1] - ends[0], axis=1)


def fitted(
    grasps: Grasps,
    width_m: NDArray[np.float64],
    depth_m: NDArray[np.float64],
    camera: Camera,
    gripper: Gripper,
) -> tuple[NDArray[np.intp], Grasps, NDArray[np.float64]]:
    """The grasps that a gripper can open for, opened with clearance as far as it goes.

    An opening has a margin beside the object: one that is up to `MARGIN` too wide is narrowed. All
    others are widened by `CLEARANCE`, or less where the gripper opens no farther.

    Args:
        grasps: N grasps, pixels.
        width_m: (N,) their openings.
        depth_m: (N,) depth of their centres.
        camera: Intrinsics.
        gripper: The gripper.

    Returns:
        (M,) numbers of the grasps that are left, these M grasps, and (M,) their openings.
    """
    most = gripper.max_opening_m
    kept = np.flatnonzero(width_m <= (1 + MARGIN) * most)
    given = np.minimum(width_m[kept] + CLEARANCE * most, most)
    chosen = grasps[kept]
    return kept, chosen.replace(width=given / (depth_m[kept] * pixel_along(chosen, camera))), given


def with_jaw(
    grasps: Grasps, depth_m: NDArray[np.float64], camera: Camera, gripper: Gripper
) -> Grasps:
    """Each grasp with the gripper's jaw size that is nearest to the one it has, in pixels.

    Args:
        grasps: N grasps, pixels.
        depth_m: (N,) depth of their centres.
        camera: Intrinsics.
        gripper: The gripper.
    """
    pixel_m = depth_m * pixel_across(grasps, camera)
    sizes_px = np.asarray(gripper.jaw_sizes_m) / pixel_m[:, None]
    nearest = np.abs(sizes_px - grasps.height[:, None]).argmin(axis=1)
    return grasps.replace(height=sizes_px[np.arange(len(grasps)), nearest])
