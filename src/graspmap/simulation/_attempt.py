"""The physical part of one trial: place, close, lift, hold, shake, judge.

All positions are in the grasp frame: origin on the table under the middle of the opening, x along
the opening, z up, metres. Letters in shapes: B objects.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from graspmap.gripper import Gripper
from graspmap.simulation._mujoco_model import World
from graspmap.simulation.outcomes import Outcome
from graspmap.simulation.settings import TrialSettings

Floats = NDArray[np.float64]

# Fingers this close to their end stop may have closed on nothing.
_CLOSED_M = 0.0005
# An object that turns more slowly than this, rad/s, lies still in the hand.
_CALM_RAD_S = 1.0
# What creeps and turns no faster than this in the hand (contacts are soft: everything creeps) for
# as long as the hold lasts will not fall later: of 1,387 trials that were lifted on to the end,
# none did; at 0.9 mm/s ten did.
_REST_M_S, _REST_RAD_S = 0.0005, 0.1


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


@dataclass(frozen=True)
class Ending:
    """How an attempt ended; the fields are those of `TrialResult`."""

    outcome: Outcome
    reason: str
    object_index: int | None = None
    closed_m: float | None = None
    grip_force_n: float | None = None
    slip_m: float | None = None
    lift_m: float | None = None


Record = Callable[[str], None]


class Attempt:
    """One physical attempt in a world; nothing of it outlives the next `World.reset`.

    Args:
        world: World with a gripper.
        gripper: That gripper.
        settings: Numbers of the trial.
        record: Called with the phase's name whenever the state has moved on.
    """

    def __init__(
        self, world: World, gripper: Gripper, settings: TrialSettings, record: Record | None = None
    ) -> None:
        assert world.gripper is not None
        self._world, self._gripper, self._settings = world, gripper, settings
        self._model, self._data, self._parts = world.model, world.data, world.gripper
        self._record = record
        # Who belongs to a finger: 0 right, 1 left, -1 neither.
        self._finger = np.full(len(world.owner), -1, dtype=np.intp)
        self._finger[self._parts.geoms] = (0, 1)
        # What the fingers pressed on at the last looks; at a single one a contact may be missing.
        self._recent: deque[Floats] = deque(maxlen=settings.stall_checks)
        self._steps = settings.steps_a_check
        self._hold_checks = max(1, round(settings.hold_s / settings.check_s))

    def run(self, start: Start) -> Ending:
        """Everything from closing to the verdict."""
        ending = self._place(start) or self._close()
        if ending is not None:
            return ending
        closed_m, (index, force) = self._opening(), self._grasped()
        self._recent.clear()
        if index is None:
            return self._closed_on_nothing()
        held = _Held(self, index, start, closed_m, force)
        for phase in (self._lift, self._hold, self._shake):
            ending = phase(held)
            if ending is not None:
                return ending
        return held.verdict()

    def _place(self, start: Start) -> Ending | None:
        """Objects on the table, open fingers around them; None where that is possible."""
        margin = 2 * self._settings.start_margin_m
        near = max(self._gripper.min_opening_m, start.needed_m + margin)
        for opening in dict.fromkeys((min(start.opening_m, near), start.opening_m)):
            self._set(start, opening)
            mujoco.mj_fwdPosition(self._model, self._data)
            depth = self._penetration()
            if depth <= self._settings.start_penetration_m:
                return None
        return Ending(
            Outcome.COLLIDED,
            f"convex pieces of the object reach {depth * 1000:.1f} mm into the open gripper",
        )

    def _set(self, start: Start, opening_m: float) -> None:
        world, data, parts = self._world, self._data, self._parts
        world.reset()
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
        gripper = (self._world.owner[contact.geom] < 0).any(axis=1) & (contact.geom > 0).all(axis=1)
        return float(-contact.dist[gripper].min(initial=0.0))

    def advance(self, phase: str) -> None:
        """Time goes on until the next look at the state."""
        mujoco.mj_step(self._model, self._data, self._steps)
        self._look(phase)

    def pace(self, *, calm: bool) -> None:
        """Long time steps from here on where nothing moves in the hand, short ones otherwise."""
        settings = self._settings
        step = settings.timestep_s if calm else settings.fine_timestep_s
        self._model.opt.timestep = step
        self._steps = max(1, round(settings.check_s / step))

    def _look(self, phase: str) -> None:
        if self._record is not None:
            self._record(phase)

    def _close(self) -> Ending | None:
        """Close until both fingers have stopped."""
        settings, data, parts = self._settings, self._data, self._parts
        free_s = data.qpos[parts.finger_q[0]] / self._gripper.closing_speed_m_s
        checks = round((free_s + settings.close_extra_s) / settings.check_s)
        still = 0
        self.pace(calm=True)
        for _ in range(checks):
            self.advance("close")
            self._recent.append(self.forces())
            if self._opening() < self._gripper.min_opening_m + _CLOSED_M:
                if not self._recent[-1].any():
                    return self._closed_on_nothing()
                break
            stopped = (np.abs(data.qvel[parts.finger_v]) < settings.stall_speed_m_s).all()
            still = still + 1 if stopped else 0
            if still >= settings.stall_checks:
                break
            # One finger alone pushes an object over the table; it is the pinch that is delicate.
            # One finger alone pushes an object over the table; it is the pinch that is delicate.
            self.pace(calm=stopped or not (self._recent[-1] > 0).all(axis=0).any())
        return self._unstable()

    def _closed_on_nothing(self) -> Ending:
        return Ending(Outcome.EMPTY, "the fingers closed on nothing", None, self._opening(), 0.0)

    def _unstable(self) -> Ending | None:
        if self._world.unstable():
            return Ending(Outcome.SLIPPED, "the simulation became unstable")
        return None

    def _lift(self, held: _Held) -> Ending | None:
        """Lift until the object hangs still and free, which goes on for ever, or to the end."""
        data, speed, hangs = self._data, 0.0, 0
        ending: Ending | None = None
        for rate in self._settings.lift_accelerations():
            step = self._model.opt.timestep
            for _ in range(self._steps if rate else 0):
                data.ctrl[2:] = speed + rate * step / 2
                speed += rate * step
                mujoco.mj_step(self._model, data)
            if not rate:
                data.ctrl[2:] = speed
                mujoco.mj_step(self._model, data, self._steps)
            self._look("lift")
            if ending is not None:
                continue
            if held.lost():
                return self._unstable() or held.verdict()
            hangs = hangs + 1 if held.hangs() else 0
            if hangs >= self._hold_checks and rate <= 0 and self._settings.shake is None:
                ending = self._unstable() or held.verdict()
                if self._record is None:
                    return ending
        data.ctrl[2:] = 0.0
        return ending

    def _hold(self, held: _Held) -> Ending | None:
        self._recent.clear()
        for _ in range(self._hold_checks):
            self.advance("hold")
            self._recent.append(self.forces())
            if held.lost():
                return self._unstable() or held.verdict()
        return self._unstable()

    def _shake(self, held: _Held) -> Ending | None:
        shake = self._settings.shake
        if shake is None:
            return None
        gravity, check_s = self._model.opt.gravity, self._settings.check_s
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
        return float(self._data.qpos[self._parts.finger_q].sum())

    def forces(self) -> Floats:
        """(2, B) normal force of the right and the left finger on each object, newton."""
        total = np.zeros((2, len(self._world.bodies)))
        data = self._data
        if not data.ncon:
            return total
        pairs = data.contact.geom
        finger = self._finger[pairs].max(axis=1)
        index = self._world.owner[pairs].max(axis=1)
        active = (finger >= 0) & (index >= 0) & (data.contact.efc_address >= 0)
        address = data.contact.efc_address[active]
        np.add.at(total, (finger[active], index[active]), data.efc_force[address])
        return total

    def _grasped(self) -> tuple[int | None, float]:
        """The object that both fingers press on (else the one they press most), and how much."""
        forces = np.mean(self._recent, axis=0)
        if not forces.any():
            return None, 0.0
        both = forces.min(axis=0)
        index = int(np.argmax(both if both.any() else forces.sum(axis=0)))
        return index, float(forces[:, index].mean())

    def pressed(self) -> Floats:
        """(2, B) greatest force of each finger on each object at the last looks."""
        return np.asarray(np.max([*self._recent, self.forces()], axis=0))

    def on_table(self, index: int) -> bool:
        """Whether an object touches the table."""
        if not self._data.ncon:
            return False
        pairs = self._data.contact.geom
        table = (pairs == 0).any(axis=1)
        return bool((table & (self._world.owner[pairs] == index).any(axis=1)).any())


class _Held:
    """The object in the hand, from the moment that the fingers have closed."""

    def __init__(
        self, attempt: Attempt, index: int, start: Start, closed_m: float, force_n: float
    ) -> None:
        self._attempt, self._index = attempt, index
        self._world, self._data = attempt._world, attempt._data
        self._settings = attempt._settings
        self._start, self._closed_m, self._force_n = start, closed_m, force_n
        self._body = int(self._world.bodies[index])
        assert self._world.gripper is not None
        self._base, self._base_v = self._world.gripper.base_q, self._world.gripper.base_v
        point = self._pinch()
        position, turn = self._data.xpos[self._body], self._data.xmat[self._body].reshape(3, 3)
        # The point of the object that lies between the fingers, in the object's own frame.
        self._point = turn.T @ (point - position)
        self._place = self._in_hand()
        self._highest_m = -math.inf
        self._still = False

    def _pinch(self) -> Floats:
        """Middle of what the fingers hold: the mean of their contacts with the object."""
        data, attempt = self._data, self._attempt
        parts = self._world.gripper
        assert parts is not None
        right, left = data.qpos[parts.finger_q]
        middle = np.array([(right - left) / 2, 0.0, data.qpos[parts.base_q]])
        if not data.ncon:
            return middle
        pairs = data.contact.geom
        finger = attempt._finger[pairs].max(axis=1)
        mine = self._world.owner[pairs].max(axis=1) == self._index
        sides = [data.contact.pos[mine & (finger == side)] for side in (0, 1)]
        touched = [side.mean(axis=0) for side in sides if len(side)]
        return np.asarray(np.mean(touched, axis=0)) if touched else middle

    def _in_hand(self) -> Floats:
        """Where the pinched point is now, seen from the gripper, metres."""
        turn = self._data.xmat[self._body].reshape(3, 3)
        now = self._data.xpos[self._body] + turn @ self._point
        now[2] -= self._data.qpos[self._base]
        return np.asarray(now)

    def slip(self) -> float:
        """How far the pinched point has moved in the hand, metres."""
        x, y, z = (self._in_hand() - self._place).tolist()
        return math.sqrt(x * x + y * y + z * z)

    def rise(self, index: int | None = None) -> float:
        """How far the centre of mass of this or another object has risen, metres."""
        index = self._index if index is None else index
        body = self._world.bodies[index]
        return float(self._data.xpos[body, 2] - self._start.positions[index, 2])

    def lost(self) -> bool:
        """Whether the verdict is certain already."""
        self._highest_m = max(self._highest_m, self.rise())
        self._still = self._calm()
        self._attempt.pace(calm=self._still)
        return self.slip() > self._settings.max_slip_m

    def hangs(self) -> bool:
        """Whether it rests in the hand, held from both sides and clear of the table."""
        if not self._still or self._highest_m < self._settings.left_table_m:
            return False
        if self._speed() > _REST_M_S or self._turning() > _REST_RAD_S:
            return False
        attempt = self._attempt
        attempt._recent.append(attempt.forces())
        pressed = attempt._recent[-1][:, self._index]
        return bool(pressed[0] > 0 and pressed[1] > 0 and not attempt.on_table(self._index))

    def _calm(self) -> bool:
        """Whether the object neither slides nor turns in the hand, nor the fingers move."""
        speeds, still = self._data.qvel, self._settings.stall_speed_m_s
        right, left = speeds[self._attempt._parts.finger_v].tolist()
        if abs(right) >= still or abs(left) >= still:
            return False
        return self._turning() < _CALM_RAD_S and self._speed() < still

    def _turning(self) -> float:
        """Greatest of the three speeds of turning, rad/s."""
        at = self._world.body_v[self._index]
        return float(np.abs(self._data.qvel[at + 3 : at + 6]).max())

    def verdict(self, when: str = "") -> Ending:
        """Held or not, and why."""
        outcome, reason = self._judge()
        return Ending(
            outcome,
            reason + when,
            self._index,
            self._closed_m,
            self._force_n,
            self.slip(),
            self.rise(),
        )

    def _judge(self) -> tuple[Outcome, str]:
        settings, slip = self._settings, self.slip()
        lost = slip > settings.max_slip_m
        forces = self._attempt.forces() if lost else self._attempt.pressed()
        right, left = forces[:, self._index] > 0
        on_table = self._attempt.on_table(self._index)
        if not (right and left):
            if self._highest_m > settings.left_table_m:
                return Outcome.DROPPED, f"it fell after it had risen {self._highest_m * 1e3:.0f} mm"
            return Outcome.SLIPPED, "the fingers slid off before it left the table"
        if lost:
            return Outcome.SLIPPED, f"it slid {slip * 1e3:.0f} mm through the fingers"
        if on_table:
            return Outcome.SLIPPED, "a part of it still lies on the table"
        speed = self._speed()
        if speed > settings.max_speed_m_s:
            return Outcome.SLIPPED, f"it still slides at {speed * 1e3:.0f} mm/s"
        return Outcome.HELD, "it hangs between both fingers" + self._company()

    def _speed(self) -> float:
        """Speed of the pinched point in the hand, m/s."""
        data, at = self._data, self._world.body_v[self._index]
        vx, vy, vz, wx, wy, wz = data.qvel[at : at + 6].tolist()
        x, y, z = self._point.tolist()
        # MuJoCo has the turning speed of a free body in the body's own frame.
        turning = (wy * z - wz * y, wz * x - wx * z, wx * y - wy * x)
        ax, ay, az = (data.xmat[self._body].reshape(3, 3) @ turning).tolist()
        return math.hypot(ax + vx, ay + vy, az + vz - float(data.qvel[self._base_v]))

    def _company(self) -> str:
        others = range(len(self._world.bodies))
        rose = [
            i for i in others if i != self._index and self.rise(i) > self._settings.left_table_m
        ]
        return f"; object {', '.join(map(str, rose))} came along" if rose else ""
