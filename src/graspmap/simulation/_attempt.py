"""The physical part of one trial: place, close, lift, hold, shake, judge.

All positions are in the grasp frame: origin on the table under the middle of the opening, x along
the opening, z up, metres. Letters in shapes: B objects.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from graspmap.gripper import Gripper
from graspmap.simulation._held import Ending, Held
from graspmap.simulation._mujoco_model import World
from graspmap.simulation.outcomes import Outcome
from graspmap.simulation.settings import TrialSettings

Floats = NDArray[np.float64]

# Fingers this close to their end stop may have closed on nothing.
_CLOSED_M = 0.0005


@dataclass(frozen=True, eq=False)
class Start:
    """What is different from one attempt to the next.

    Args:
        positions: (B, 3) centre of mass of each object in the grasp frame, metres.
        quaternions: (B, 4) turn of each object, (w, x, y, z) as MuJoCo has it.
        tip_m: Height of the finger tips.
        opening_m: Opening of the grasp.
        needed_m: Least opening that touches nothing.
        jaw_m: Size of the finger plates.
        friction: Factor on the friction of the pads.
        mass: Factor on the mass of the objects.
    """

    positions: Floats
    quaternions: Floats
    tip_m: float
    opening_m: float
    needed_m: float
    jaw_m: float
    friction: float = 1.0
    mass: float = 1.0


Record = Callable[[str], None]


class Attempt:
    """One physical attempt in a world; nothing of it outlives the next `World.reset`.

    Args:
        world: World with a gripper.
        gripper: That gripper.
        settings: Numbers of the trial.
        record: Called with the phase's name whenever the state has moved on.

    Attributes:
        parts: Where the gripper is in MuJoCo's arrays.
        kernel: Compiled looks at MuJoCo's state.
        finger: Of each geometry: 0 if it belongs to the right finger, 1 to the left, -1 neither.
        recent: What the fingers pressed on at the last looks; at a single one a contact may be
            missing.
    """

    def __init__(
        self, world: World, gripper: Gripper, settings: TrialSettings, record: Record | None = None
    ) -> None:
        from graspmap.simulation import _attempt_kernel

        assert world.gripper is not None
        self.kernel = _attempt_kernel
        self.world, self._gripper, self.settings = world, gripper, settings
        self._model, self._data, self.parts = world.model, world.data, world.gripper
        self._right, self._left = self.parts.finger_q.tolist()
        self._record = record
        self.finger = np.full(len(world.owner), -1, dtype=np.intp)
        self.finger[self.parts.geoms] = (0, 1)
        self.recent: deque[Floats] = deque(maxlen=settings.stall_checks)
        self._steps, self._timestep_s = settings.steps_a_check, 0.0
        self._hold_checks = max(1, round(settings.hold_s / settings.check_s))

    def run(self, start: Start) -> Ending:
        """Everything from closing to the verdict."""
        ending = self._place(start) or self._close()
        if ending is not None:
            return ending
        closed_m, (index, force) = self._opening(), self._grasped()
        self.recent.clear()
        if index is None:
            return self._closed_on_nothing()
        held = Held(self, index, start.positions[:, 2], closed_m, force)
        for phase in (self._lift, self._hold, self._shake):
            ending = phase(held)
            if ending is not None:
                return ending
        return held.verdict()

    def _place(self, start: Start) -> Ending | None:
        """Objects on the table, open fingers around them; None where that is possible."""
        margin = 2 * self.settings.start_margin_m
        near = max(self._gripper.min_opening_m, start.needed_m + margin)
        for opening in dict.fromkeys((min(start.opening_m, near), start.opening_m)):
            self._set(start, opening)
            mujoco.mj_fwdPosition(self._model, self._data)
            depth = self._penetration()
            if depth <= self.settings.start_penetration_m:
                return None
        return Ending(
            Outcome.COLLIDED,
            f"convex pieces of the object reach {depth * 1000:.1f} mm into the open gripper",
        )

    def _set(self, start: Start, opening_m: float) -> None:
        world, data, parts = self.world, self._data, self.parts
        world.reset()
        self._timestep_s = 0.0  # another attempt may have set the model's since
        world.set_jaw(start.jaw_m)
        if start.friction != 1.0:
            world.scale_friction(start.friction)
        if start.mass != 1.0:
            world.scale_mass(start.mass)
        for number, at in enumerate(world.body_q):
            data.qpos[at : at + 3] = start.positions[number]
            data.qpos[at + 3 : at + 7] = start.quaternions[number]
        data.qpos[parts.base_q] = start.tip_m
        data.qpos[parts.finger_q] = opening_m / 2
        # They come from further out, at full speed already.
        data.qvel[parts.finger_v] = -self._gripper.closing_speed_m_s
        data.act[0] = start.tip_m
        data.ctrl[:2] = -self._gripper.force_n

    def _penetration(self) -> float:
        """How far anything reaches into the gripper, metres."""
        contact = self._data.contact
        if not self._data.ncon:
            return 0.0
        # The table is not an object either, but it meets only objects.
        gripper = (self.world.owner[contact.geom] < 0).any(axis=1) & (contact.geom > 0).all(axis=1)
        return float(-contact.dist[gripper].min(initial=0.0))

    def advance(self, phase: str) -> None:
        """Time goes on until the next look at the state."""
        mujoco.mj_step(self._model, self._data, self._steps)
        self._look(phase)

    def pace(self, *, calm: bool) -> None:
        """Long time steps from here on where nothing moves in the hand, short ones otherwise."""
        settings = self.settings
        step = settings.timestep_s if calm else settings.fine_timestep_s
        if step != self._timestep_s:
            self._model.opt.timestep = self._timestep_s = step
            self._steps = max(1, round(settings.check_s / step))

    def _look(self, phase: str) -> None:
        if self._record is not None:
            self._record(phase)

    def _close(self) -> Ending | None:
        """Close until both fingers have stopped."""
        settings, data, parts = self.settings, self._data, self.parts
        free_s = data.qpos[parts.finger_q[0]] / self._gripper.closing_speed_m_s
        checks = round((free_s + settings.close_extra_s) / settings.check_s)
        still = 0
        # Of slow fingers a part of their speed, or they would never seem to move.
        stall_m_s = min(settings.stall_speed_m_s, 0.1 * self._gripper.closing_speed_m_s)
        self.pace(calm=True)
        for _ in range(checks):
            self.advance("close")
            self.recent.append(self.forces())
            if self._opening() < self._gripper.min_opening_m + _CLOSED_M:
                if not self.recent[-1].any():
                    return self._closed_on_nothing()
                break
            stopped = max(map(abs, data.qvel[parts.finger_v].tolist())) < stall_m_s
            still = still + 1 if stopped else 0
            if still >= settings.stall_checks:
                break
            # One finger alone pushes an object over the table; it is the pinch that is delicate.
            pinched = any(min(pair) > 0 for pair in zip(*self.recent[-1].tolist(), strict=True))
            self.pace(calm=stopped or not pinched)
        return self._unstable()

    def _closed_on_nothing(self) -> Ending:
        return Ending(Outcome.EMPTY, "the fingers closed on nothing", None, self._opening(), 0.0)

    def _unstable(self) -> Ending | None:
        if self.world.unstable():
            return Ending(Outcome.SLIPPED, "the simulation became unstable")
        return None

    def _lift(self, held: Held) -> Ending | None:
        """Lift until the object hangs still and free, which goes on for ever, or to the end."""
        data, speed, hangs = self._data, 0.0, 0
        ctrl = data.ctrl[2:]
        ending: Ending | None = None
        for rate in self.settings.lift_accelerations():
            step = self._timestep_s
            for _ in range(self._steps if rate else 0):
                ctrl[:] = speed + rate * step / 2
                speed += rate * step
                mujoco.mj_step(self._model, data)
            if not rate:
                ctrl[:] = speed
                mujoco.mj_step(self._model, data, self._steps)
            self._look("lift")
            if ending is not None:
                continue
            if held.lost():
                return self._unstable() or held.verdict()
            hangs = hangs + 1 if held.hangs() else 0
            if hangs >= self._hold_checks and rate <= 0 and self.settings.shake is None:
                ending = self._unstable() or held.verdict()
                if self._record is None:
                    return ending
        ctrl[:] = 0.0
        return ending

    def _hold(self, held: Held) -> Ending | None:
        self.recent.clear()
        for _ in range(self._hold_checks):
            self.advance("hold")
            self.recent.append(self.forces())
            if held.lost():
                return self._unstable() or held.verdict()
        return self._unstable()

    def _shake(self, held: Held) -> Ending | None:
        shake = self.settings.shake
        if shake is None:
            return None
        gravity, check_s = self._model.opt.gravity, self.settings.check_s
        for check in range(round(shake.duration_s / check_s)):
            for number in range(self._steps):
                gravity[:] = shake.gravity((check + number / self._steps) * check_s)
                mujoco.mj_step(self._model, self._data)
            self._look("shake")
            if held.lost():
                return self._unstable() or held.verdict(" when shaken")
        gravity[:] = shake.gravity(0.0)
        return self._hold(held)

    def _opening(self) -> float:
        positions = self._data.qpos
        return float(positions[self._right] + positions[self._left])

    def forces(self) -> Floats:
        """(2, B) normal force of the right and the left finger on each object, newton."""
        total, data, world = np.zeros((2, len(self.world.bodies))), self._data, self.world
        if data.ncon:
            contact = data.contact
            self.kernel.press(
                contact.geom, contact.efc_address, data.efc_force, self.finger, world.owner, total
            )
        return total

    def _grasped(self) -> tuple[int | None, float]:
        """The object that both fingers press on (else the one they press most), and how much."""
        forces = np.sum(self.recent, axis=0) / len(self.recent)
        if not forces.any():
            return None, 0.0
        both = forces.min(axis=0)
        index = int(np.argmax(both if both.any() else forces.sum(axis=0)))
        return index, float(forces[:, index].mean())

    def pressed(self) -> Floats:
        """(2, B) greatest force of each finger on each object at the last looks."""
        return np.asarray(np.max([*self.recent, self.forces()], axis=0))

    def on_table(self, index: int) -> bool:
        """Whether an object touches the table."""
        data = self._data
        return bool(data.ncon) and self.kernel.touches_table(
            data.contact.geom, self.world.owner, index
        )
