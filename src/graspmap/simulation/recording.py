"""Recording: where everything was while one grasp was tried, for pictures that move.

World frame: the table is the plane z = 0, z up, metres. Letters in shapes: T moments, B objects.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graspmap.geometry.table_grasps import TableGrasps
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import Gripper
from graspmap.simulation.outcomes import Outcome, TrialResult
from graspmap.simulation.settings import TrialSettings
from graspmap.simulation.tabletop import Tabletop
from graspmap.simulation.trial import TrialRunner

Floats = NDArray[np.float64]
Phase = Literal["descend", "close", "lift", "hold", "shake"]

# The way down is not simulated: nothing moves but the gripper.
_ABOVE_M = 0.04
_DESCENT_M_S = 0.25


@dataclass(frozen=True, eq=False)
class TrialRecording:
    """Where everything was while one grasp was tried; read-only arrays.

    Args:
        result: How it ended.
        times_s: (T,) seconds, evenly spaced.
        phases: (T,) what the gripper was doing.
        object_positions_m: (T, B, 3) centres of mass, world.
        object_quaternions: (T, B, 4) turns (x, y, z, w) of the objects in the world.
        finger_places_m: (T, 2) inner faces of the left and the right finger, along the opening from
            its middle; the left one is negative.
        tips_m: (T,) height of the finger tips above the table.
        center_m: (2,) world x, y of the grasp.
        angle: Of the opening, counter-clockwise from above from the world's x axis, radians.
        jaw_m: Size of the finger plates across the opening.
    """

    result: TrialResult
    times_s: Floats
    phases: tuple[Phase, ...]
    object_positions_m: Floats
    object_quaternions: Floats
    finger_places_m: Floats
    tips_m: Floats
    center_m: Floats
    angle: float
    jaw_m: float

    def __len__(self) -> int:
        return len(self.times_s)

    def T_world_object(self, moment: int, index: int) -> RigidTransform:
        """Pose of an object at one moment."""
        return RigidTransform.from_quaternion(
            self.object_quaternions[moment, index], self.object_positions_m[moment, index]
        )


def record_trial(
    tabletop: Tabletop,
    grasps: TableGrasps,
    gripper: Gripper,
    settings: TrialSettings | None = None,
    *,
    index: int = 0,
) -> TrialRecording:
    """Try one grasp as `run_trials` does and keep what happens.

    Args:
        tabletop: Objects at rest.
        grasps: N grasps.
        gripper: The gripper.
        settings: Numbers of the simulation; ``check_s`` is the time between two moments.
        index: Which of the grasps.

    Raises:
        InvalidInputError: As `run_trials`.
    """
    runner = TrialRunner(tabletop, gripper, settings)
    film = _Film(runner, grasps[index : index + 1])
    result = runner.try_one(film.grasp, record=film.take)
    return film.develop(result)


class _Film:
    """Collects moments while a runner tries one grasp."""

    def __init__(self, runner: TrialRunner, grasp: TableGrasps) -> None:
        self.grasp = grasp
        self._runner = runner
        self._phases: list[Phase] = []
        self._states: list[Floats] = []
        # What the grasp frame's x axis is in the world.
        self._angle = float(grasp.angle[0])

    def take(self, phase: str) -> None:
        """Keep this moment of the simulation."""
        self._phases.append(phase)  # type: ignore[arg-type]
        self._states.append(self._runner.world.data.qpos.copy())

    def develop(self, result: TrialResult) -> TrialRecording:
        """What was kept, in the world, with the way down before it."""
        runner, grasp = self._runner, self.grasp
        step = runner.settings.check_s
        phases, tips, fingers = self._way_down(result, step)
        before = len(phases)
        poses = [placed.T_world_object for placed in runner.tabletop.objects]
        count = before + len(self._states)
        positions = np.tile([pose.translation for pose in poses], (count, 1, 1))
        turns = np.tile([pose.quaternion() for pose in poses], (count, 1, 1))
        world = runner.world
        assert world.gripper is not None
        for moment, state in enumerate(self._states, start=before):
            for number, at in enumerate(world.body_q):
                pose = self._to_world(state[at : at + 7])
                positions[moment, number], turns[moment, number] = (
                    pose.translation,
                    pose.quaternion(),
                )
        if self._states:
            seen = np.array(self._states)
            tips = np.append(tips, seen[:, world.gripper.base_q])
            right, left = seen[:, world.gripper.finger_q].T
            fingers = np.concatenate([fingers, np.stack([-left, right], axis=1)])
        times = np.arange(count, dtype=np.float64) * step
        for array in (times, positions, turns, fingers, tips):
            array.setflags(write=False)
        return TrialRecording(
            result=result,
            times_s=times,
            phases=(*phases, *self._phases),
            object_positions_m=positions,
            object_quaternions=turns,
            finger_places_m=fingers,
            tips_m=tips,
            center_m=grasp.center_m[0],
            angle=self._angle,
            jaw_m=float(grasp.height_m[0]) * runner.gripper.jaw_contact_share,
        )

    def _way_down(self, result: TrialResult, step: float) -> tuple[list[Phase], Floats, Floats]:
        """From above the scene to the goal (or to the touch), and the free part of the closing."""
        top = max(self._runner.tabletop.height_map.top_m, result.tip_m)
        touches = result.outcome is Outcome.COLLIDED
        end = result.tip_m + max(0.0, -result.clearance_m if touches else 0.0)
        start = top + _ABOVE_M
        moments = max(2, round((start - end) / (_DESCENT_M_S * step)) + 1)
        tips = np.linspace(start, end, moments)
        halves = np.full(moments, result.opening_m / 2)
        phases: list[Phase] = ["descend"] * moments
        if self._states and self._runner.world.gripper is not None:
            first = float(self._states[0][self._runner.world.gripper.finger_q[0]])
            way = max(0.0, result.opening_m / 2 - first)
            free = round(way / (self._runner.gripper.closing_speed_m_s * step))
            halves = np.append(halves, np.linspace(result.opening_m / 2, first, free + 1)[1:])
            tips = np.append(tips, np.full(free, end))
            phases += ["close"] * free
        return phases, tips, np.stack([-halves, halves], axis=1)

    def _to_world(self, pose: Floats) -> RigidTransform:
        """From x, y, z and quaternion (w, x, y, z) in the grasp frame."""
        half = self._angle / 2
        place = np.append(self.grasp.center_m[0], 0.0)
        T_world_grasp = RigidTransform.from_quaternion((0, 0, np.sin(half), np.cos(half)), place)
        return T_world_grasp @ RigidTransform.from_quaternion(np.roll(pose[3:], -1), pose[:3])
