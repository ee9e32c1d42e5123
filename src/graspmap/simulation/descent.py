"""Judging a vertical descent on the height map, before any physics.

The gripper comes down open as wide as the grasp says. Each finger is a box as thick as the finger
and as wide as the part of the jaw that the plate really has; the palm is a box above them. The tips
go ``max_depth_m`` below the highest point between the fingers, not nearer to the table than
``table_clearance_m`` and not so deep that the palm would press on that point.

Letters in shapes: N grasps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper
from graspmap.simulation.heightmap import HeightMap

Floats = NDArray[np.float64]

LEAST_GRIP_M = 0.001
"""What rises less than this above the tips is not between the fingers."""


@dataclass(frozen=True, eq=False)
class Descents:
    """What the height map says of N grasps.

    Args:
        tip_m: (N,) height of the finger tips above the table at the end of the descent.
        clearance_m: (N,) least gap between a finger (at the full opening), or the palm, and what
            lies below it on its way to ``tip_m``; negative where it would touch.
        top_m: (N,) highest point between the fingers.
        needed_m: (N,) least opening, centred on the grasp, with which the fingers would go down to
            ``tip_m`` without touching what lies between them; 0 where nothing does.
        collided: (N,) bool, a finger or the palm touches on the way down, and the gripper does not
            stop for it.
        empty: (N,) bool, nothing between the fingers reaches `LEAST_GRIP_M` above the tips.
        under_fingers_m: (N, 2) highest point below each finger: the one against the axis, the one
            along it.
        under_palm_m: (N,) highest point below the palm; 0 where the whole scene is lower than the
            fingers are long.
    """

    tip_m: Floats
    clearance_m: Floats
    top_m: Floats
    needed_m: Floats
    collided: NDArray[np.bool_]
    empty: NDArray[np.bool_]
    under_fingers_m: Floats
    under_palm_m: Floats


def judge_descents(height_map: HeightMap, grasps: TableGrasps, gripper: Gripper) -> Descents:
    """Lower the open gripper onto the scene, N times.

    Openings beyond the gripper's range are taken as the nearest that it has.

    Args:
        height_map: The scene.
        grasps: N grasps; jaws are used at the gripper's ``jaw_contact_share``.
        gripper: The gripper.
    """
    from graspmap.simulation._descent_kernel import judge

    cells = np.column_stack(
        [
            (grasps.center_m - height_map.origin_m) / height_map.resolution_m,
            grasps.angle,
            np.clip(grasps.width_m, gripper.min_opening_m, gripper.max_opening_m),
            grasps.height_m * gripper.jaw_contact_share,
        ]
    )
    sizes = (
        gripper.finger_thickness_m,
        gripper.finger_length_m,
        *gripper.palm_size_m,
        gripper.max_depth_m,
        gripper.table_clearance_m,
        gripper.touch_gap_m,
        gripper.on_touch == "stop",
    )
    out = np.empty((len(grasps), 6))
    judge(
        height_map.heights_m,
        height_map.top_m,
        cells,
        height_map.resolution_m,
        tuple(float(size) for size in sizes),
        out,
    )
    tip, top, left, right, palm, needed = out.T.copy()
    clearance = tip - np.maximum(np.maximum(left, right), palm - gripper.finger_length_m)
    return Descents(
        tip_m=tip,
        clearance_m=clearance,
        top_m=top,
        needed_m=needed,
        collided=clearance < 0,
        empty=top <= tip + LEAST_GRIP_M,
        under_fingers_m=np.stack([left, right], axis=-1),
        under_palm_m=palm,
    )
