"""The simulated grasp trial: does the gripper lift the object?

Letters in shapes: N grasps, B objects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper, check_gripper
from graspmap.simulation._attempt import Attempt, Record, Start
from graspmap.simulation._held import Ending
from graspmap.simulation._mujoco_model import World, compile_world
from graspmap.simulation.descent import Descents, judge_descents
from graspmap.simulation.numerics import check_range
from graspmap.simulation.outcomes import Outcome, TrialResult
from graspmap.simulation.settings import TrialSettings
from graspmap.simulation.shake import Shake
from graspmap.simulation.tabletop import Tabletop

__all__ = [
    "Outcome",
    "Perturbation",
    "Shake",
    "TrialResult",
    "TrialRunner",
    "TrialSettings",
    "run_trials",
]

Floats = NDArray[np.float64]

_ROUNDING_M = 0.0005  # openings that differ by less are the same in words


@dataclass(frozen=True)
class Perturbation:
    """How unsure pose, friction and mass are; standard deviations of normal errors.

    Args:
        position_m: Of where the gripper comes down, along x and along y.
        angle_rad: Of its turn.
        friction: Of the logarithm of the pads' friction, so about its relative error.
        mass: Of the logarithm of the objects' mass; all are wrong alike.

    Raises:
        InvalidInputError: A number is negative or not finite.
    """

    position_m: float = 0.0
    angle_rad: float = 0.0
    friction: float = 0.0
    mass: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "position_m", 0.0, 1.0)
        check_range(self, "angle_rad", 0.0, np.pi)
        check_range(self, "friction", 0.0, 2.0)
        check_range(self, "mass", 0.0, 2.0)

    def draw(self, rng: np.random.Generator) -> Floats:
        """(5,) one error: x, y in metres, angle in radians, factor of friction, of mass."""
        x, y, angle, friction, mass = rng.standard_normal(5)
        return np.array(
            [
                self.position_m * x,
                self.position_m * y,
                self.angle_rad * angle,
                np.exp(self.friction * friction),
                np.exp(self.mass * mass),
            ]
        )


def run_trials(
    tabletop: Tabletop,
    grasps: TableGrasps,
    gripper: Gripper,
    *,
    settings: TrialSettings | None = None,
    perturbation: Perturbation | None = None,
    repeats: int = 1,
    seed: int = 0,
) -> list[TrialResult]:
    """Try each grasp in physics, from the same state, one by one; the order changes nothing.

    Args:
        tabletop: Objects at rest.
        grasps: N grasps; openings beyond the gripper's are taken as its greatest.
        gripper: The gripper.
        settings: Numbers of the simulation.
        perturbation: Errors of pose, friction and mass; every result then carries the share of the
            repeats that held.
        repeats: Perturbed repeats of each grasp.
        seed: Repeat r of grasp i draws its errors from (seed, i, r).

    Returns:
        N results.

    Raises:
        InvalidInputError: The tabletop is empty, the objects make no bodies, or there are repeats
            without a perturbation.
    """
    runner = TrialRunner(tabletop, gripper, settings)
    return runner.run(grasps, perturbation=perturbation, repeats=repeats, seed=seed)


class TrialRunner:
    """Tries grasps on one tabletop with one gripper; compiles the physics once.

    Args:
        tabletop: Objects at rest.
        gripper: The gripper.
        settings: Numbers of the simulation.

    Raises:
        InvalidInputError: The tabletop is empty or the objects make no bodies.
    """

    def __init__(
        self, tabletop: Tabletop, gripper: Gripper, settings: TrialSettings | None = None
    ) -> None:
        if not tabletop.objects:
            raise InvalidInputError("objects of the tabletop", "none", "one or more")
        check_gripper(gripper)
        self.tabletop, self.gripper = tabletop, gripper
        self.settings = settings or TrialSettings()
        models = [placed.model for placed in tabletop.objects]
        self._world = compile_world(models, gripper, self.settings)
        poses = [placed.T_world_object for placed in tabletop.objects]
        self._positions = np.array([pose.translation for pose in poses])
        # MuJoCo has the scalar first.
        self._quaternions = np.array([np.roll(pose.quaternion(), 1) for pose in poses])

    @property
    def world(self) -> World:
        """The compiled physics; its state is that of the last attempt."""
        return self._world

    def judge(self, grasps: TableGrasps) -> Descents:
        """What the height map says of N grasps."""
        return judge_descents(self.tabletop.height_map, grasps, self.gripper)

    def run(
        self,
        grasps: TableGrasps,
        *,
        perturbation: Perturbation | None = None,
        repeats: int = 1,
        seed: int = 0,
    ) -> list[TrialResult]:
        """Try N grasps; see `run_trials`."""
        if repeats < 1 or (perturbation is None and repeats != 1):
            raise InvalidInputError("repeats", repeats, "1 or more; 1 without a perturbation")
        descents = self.judge(grasps)
        results = [self._one(grasps, descents, i) for i in range(len(grasps))]
        if perturbation is None:
            return results
        held = self._repeat(grasps, perturbation, repeats, seed)
        return [
            replace(result, success_probability=float(share))
            for result, share in zip(results, held.mean(axis=1), strict=True)
        ]

    def try_one(
        self, grasps: TableGrasps, index: int = 0, *, record: Record | None = None
    ) -> TrialResult:
        """Try one of N grasps; ``record`` is called with the phase's name at every look."""
        return self._one(grasps, self.judge(grasps), index, record=record)

    def _repeat(
        self, grasps: TableGrasps, perturbation: Perturbation, repeats: int, seed: int
    ) -> NDArray[np.bool_]:
        """(N, repeats) which perturbed repeats held."""
        count = len(grasps)
        errors = np.array(
            [
                [perturbation.draw(np.random.default_rng((seed, i, r))) for r in range(repeats)]
                for i in range(count)
            ]
        ).reshape(count * repeats, 5)
        again = np.repeat(np.arange(count), repeats)
        moved = TableGrasps(
            center_m=grasps.center_m[again] + errors[:, :2],
            angle=grasps.angle[again] + errors[:, 2],
            width_m=grasps.width_m[again],
            height_m=grasps.height_m[again],
            quality=grasps.quality[again],
        )
        descents = self.judge(moved)
        outcomes = [
            self._one(moved, descents, i, friction=errors[i, 3], mass=errors[i, 4]).outcome
            for i in range(len(moved))
        ]
        return np.array([o is Outcome.HELD for o in outcomes]).reshape(count, repeats)

    def _one(
        self,
        grasps: TableGrasps,
        descents: Descents,
        index: int,
        *,
        friction: float = 1.0,
        mass: float = 1.0,
        record: Record | None = None,
    ) -> TrialResult:
        opening = self._opening(float(grasps.width_m[index]))
        ending = _without_physics(descents, index)
        if ending is None:
            start = self._start(grasps, descents, index, opening, friction, mass)
            ending = Attempt(self._world, self.gripper, self.settings, record).run(start)
        return TrialResult(
            outcome=ending.outcome,
            reason=ending.reason + self._clamped(float(grasps.width_m[index])),
            object_index=ending.object_index,
            opening_m=opening,
            needed_m=float(descents.needed_m[index]),
            tip_m=float(descents.tip_m[index]),
            clearance_m=float(descents.clearance_m[index]),
            closed_m=ending.closed_m,
            grip_force_n=ending.grip_force_n,
            slip_m=ending.slip_m,
            lift_m=ending.lift_m,
        )

    def _opening(self, width_m: float) -> float:
        return min(max(width_m, self.gripper.min_opening_m), self.gripper.max_opening_m)

    def _clamped(self, width_m: float) -> str:
        """What to add to the reason where the gripper has not the opening that was asked for."""
        opening = self._opening(width_m)
        if abs(opening - width_m) < _ROUNDING_M:
            return ""
        end = "most" if opening < width_m else "least"
        return (
            f" (asked to open {width_m * 1e3:.0f} mm, the gripper's {end} is {opening * 1e3:.0f})"
        )

    def _start(
        self,
        grasps: TableGrasps,
        descents: Descents,
        index: int,
        opening_m: float,
        friction: float,
        mass: float,
    ) -> Start:
        """The objects as the gripper sees them: the inverse grasp times their poses."""
        angle = float(grasps.angle[index])
        c, s = np.cos(angle), np.sin(angle)
        offset = self._positions[:, :2] - grasps.center_m[index]
        positions = self._positions.copy()
        positions[:, 0] = c * offset[:, 0] + s * offset[:, 1]
        positions[:, 1] = c * offset[:, 1] - s * offset[:, 0]
        return Start(
            positions=positions,
            quaternions=_turned(self._quaternions, -angle),
            tip_m=float(descents.tip_m[index]),
            opening_m=opening_m,
            needed_m=float(descents.needed_m[index]),
            jaw_m=float(grasps.height_m[index]) * self.gripper.jaw_contact_share,
            friction=friction,
            mass=mass,
        )


def _without_physics(descents: Descents, index: int) -> Ending | None:
    """What the height map alone decides."""
    if descents.collided[index]:
        left, right = descents.tip_m[index] - descents.under_fingers_m[index]
        if min(left, right) >= 0:
            return Ending(Outcome.COLLIDED, "the palm would touch")
        finger = "left" if left < right else "right"
        above = -min(left, right) * 1e3
        return Ending(
            Outcome.COLLIDED, f"the {finger} finger would touch {above:.0f} mm above its goal"
        )
    if descents.empty[index]:
        return Ending(Outcome.EMPTY, "nothing lies between the fingers")
    return None


def _turned(wxyz: Floats, angle: float) -> Floats:
    """(B, 4) quaternions after a further turn about z."""
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    w, x, y, z = wxyz.T
    return np.stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], axis=1)
