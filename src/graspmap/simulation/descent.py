"""Judging a vertical descent on the height map, before any physics.

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


@dataclass(frozen=True, eq=False)
class Descents:
    """What the height map says of N grasps.

    Args:
        tip_m: (N,) height of the finger tips above the table at the end of the descent.
        clearance_m: (N,) least gap between a finger (at the full opening) and what lies below it on
            its way to ``tip_m``; negative where it would touch.
        top_m: (N,) highest point between the fingers.
        needed_m: (N,) least opening, centred on the grasp, with which the fingers would go down to
            ``tip_m`` without touching what lies between them; 0 where nothing does.
        collided: (N,) bool, a finger or the palm touches on the way down, and the gripper does not
            stop for it.
        empty: (N,) bool, nothing above the tips lies between the fingers.
    """

    tip_m: Floats
    clearance_m: Floats
    top_m: Floats
    needed_m: Floats
    collided: NDArray[np.bool_]
    empty: NDArray[np.bool_]


def judge_descents(height_map: HeightMap, grasps: TableGrasps, gripper: Gripper) -> Descents:
    """Lower the open gripper onto the scene, N times.

    Openings beyond the gripper's are taken as its greatest.
    """
    raise NotImplementedError
