"""What hangs in the hand, from when the fingers have closed: does it rest, is it lost?"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.outcomes import Outcome

if TYPE_CHECKING:
    from graspmap.simulation._attempt import Attempt

Floats = NDArray[np.float64]

# An object that turns more slowly than this, rad/s, lies still in the hand.
_CALM_RAD_S = 1.0
# What creeps and turns no faster than this in the hand (contacts are soft: everything creeps) for
# as long as the hold lasts will not fall later: of 1,387 trials that were lifted on to the end,
# none did; at 0.9 mm/s ten did.
_REST_M_S, _REST_RAD_S = 0.0005, 0.1


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


class Motion(NamedTuple):
    """How the pinched point of an object moves in the hand.

    Attributes:
        slip_m: How far it has moved.
        speed_m_s: Its speed.
        turning_rad_s: Greatest of the object's three speeds of turning.
    """

    slip_m: float
    speed_m_s: float
    turning_rad_s: float


class Held:
    """The object in the hand, from the moment that the fingers have closed.

    Args:
        attempt: The attempt that it happens in.
        index: Number of the object.
        heights_m: (B,) heights of the objects' centres of mass before the attempt.
        closed_m: Opening at which the fingers stopped.
        force_n: With which they press.
    """

    def __init__(
        self, attempt: Attempt, index: int, heights_m: Floats, closed_m: float, force_n: float
    ) -> None:
        self._attempt, self._index = attempt, index
        self._world, self._data = attempt.world, attempt.world.data
        self._settings = attempt.settings
        self._heights_m, self._closed_m, self._force_n = heights_m, closed_m, force_n
        body, speeds = int(self._world.bodies[index]), int(self._world.body_v[index])
        # Views of MuJoCo's state, which move on with it.
        self._position, self._turn = self._data.xpos[body], self._data.xmat[body]
        self._speeds = self._data.qvel[speeds : speeds + 6]
        assert self._world.gripper is not None
        self._base, self._base_v = self._world.gripper.base_q, self._world.gripper.base_v
        # The point of the object that lies between the fingers, in the object's own frame.
        self._point = self._turn.reshape(3, 3).T @ (self._pinch() - self._position)
        # Where that is, seen from the gripper.
        self._place, base_m = np.empty(3), self._data.qpos[self._base]
        attempt.kernel.in_hand(self._position, self._turn, self._point, base_m, self._place)
        self._highest_m = -math.inf
        self._motion = self._move()
        self._still = False

    def _pinch(self) -> Floats:
        """Middle of what the fingers hold: the mean of their contacts with the object."""
        data, attempt = self._data, self._attempt
        parts = self._world.gripper
        assert parts is not None
        right, left = data.qpos[parts.finger_q]
        middle = np.array([(right - left) / 2, 0.0, data.qpos[parts.base_q]])
        if data.ncon:
            contact, owner = data.contact, self._world.owner
            attempt.kernel.pinch(
                contact.geom, contact.pos, attempt.finger, owner, self._index, middle
            )
        return middle

    def _move(self) -> Motion:
        """How the pinched point moves now."""
        base = self._data.qpos[self._base], self._data.qvel[self._base_v]
        body = self._position, self._turn, self._speeds
        return Motion(*self._attempt.kernel.motion(*body, self._point, base, self._place))

    def rise(self, index: int | None = None) -> float:
        """How far the centre of mass of this or another object has risen, metres."""
        index = self._index if index is None else index
        body = self._world.bodies[index]
        return float(self._data.xpos[body, 2] - self._heights_m[index])

    def lost(self) -> bool:
        """Whether the verdict is certain already."""
        self._highest_m = max(self._highest_m, self.rise())
        self._motion = self._move()
        self._still = self._calm()
        self._attempt.pace(calm=self._still)
        return self._motion.slip_m > self._settings.max_slip_m

    def hangs(self) -> bool:
        """Whether it rests in the hand, held from both sides and clear of the table."""
        if not self._still or self._highest_m < self._settings.left_table_m:
            return False
        if self._motion.speed_m_s > _REST_M_S or self._motion.turning_rad_s > _REST_RAD_S:
            return False
        pressed = self._attempt.forces()[:, self._index] > 0
        return bool(pressed.all()) and not self._attempt.on_table(self._index)

    def _calm(self) -> bool:
        """Whether the object neither slides nor turns in the hand, nor the fingers move."""
        speeds, still = self._data.qvel, self._settings.stall_speed_m_s
        right, left = speeds[self._attempt.parts.finger_v].tolist()
        if abs(right) >= still or abs(left) >= still:
            return False
        return self._motion.turning_rad_s < _CALM_RAD_S and self._motion.speed_m_s < still

    def verdict(self, when: str = "") -> Ending:
        """Held or not, and why."""
        self._motion = self._move()
        outcome, reason = self._judge()
        return Ending(
            outcome,
            reason + when,
            self._index,
            self._closed_m,
            self._force_n,
            self._motion.slip_m,
            self.rise(),
        )

    def _judge(self) -> tuple[Outcome, str]:
        settings, slip = self._settings, self._motion.slip_m
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
        speed = self._motion.speed_m_s
        if speed > settings.max_speed_m_s:
            return Outcome.SLIPPED, f"it still slides at {speed * 1e3:.0f} mm/s"
        return Outcome.HELD, "it hangs between both fingers" + self._company()

    def _company(self) -> str:
        others = range(len(self._world.bodies))
        rose = [
            i for i in others if i != self._index and self.rise(i) > self._settings.left_table_m
        ]
        return f"; object {', '.join(map(str, rose))} came along" if rose else ""
