"""TrialSettings: the numbers of a grasp trial that are not the gripper's."""

from __future__ import annotations

from dataclasses import dataclass

from graspmap.errors import InvalidInputError
from graspmap.simulation.numerics import Numerics, check_range
from graspmap.simulation.shake import Shake


@dataclass(frozen=True, kw_only=True)
class TrialSettings(Numerics):
    """Numbers of the simulation; those of `Numerics` come first.

    Args:
        fine_timestep_s: Time step while both fingers press on an object that has not come to rest
            between them, and while it slides or spins in the hand; ``timestep_s`` is for the calm
            rest.
        start_margin_m: The fingers begin to close this far outside what lies between them (or at
            the grasp's opening, if that is nearer): nothing happens before.
        start_penetration_m: Convex pieces may reach this far into a finger at the start, where
            they are more than the surface that the descent was judged on.
        stall_speed_m_s: Fingers slower than this have stopped.
        stall_checks: They must have, this many looks in a row.
        close_extra_s: Time to close beyond what the free way takes.
        lift_m: Height of the lift, at most: at its full speed it ends as soon as the object hangs
            still and clear of the table for ``hold_s`` (with a shake it does not).
        lift_speed_m_s: Its speed, at most.
        lift_acceleration_m_s2: Its acceleration, at most.
        hold_s: Time that the object must hang still, during the lift or after it.
        max_slip_m: How far the object may slide through the fingers.
        max_speed_m_s: How fast it may still slide at the end.
        left_table_m: An object that rose this far had left the table.
        shake: What it must bear after that; None for nothing.

    Raises:
        InvalidInputError: A number is not finite or out of range.
    """

    fine_timestep_s: float = 0.001
    start_margin_m: float = 0.003
    start_penetration_m: float = 0.002
    stall_speed_m_s: float = 0.004
    stall_checks: int = 3
    close_extra_s: float = 0.4
    lift_m: float = 0.08
    lift_speed_m_s: float = 0.25
    lift_acceleration_m_s2: float = 2.0
    hold_s: float = 0.1
    max_slip_m: float = 0.03
    max_speed_m_s: float = 0.03
    left_table_m: float = 0.01
    shake: Shake | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range(self, "fine_timestep_s", 1e-5, 0.01)
        check_range(self, "start_margin_m", 0.0, 1.0)
        check_range(self, "start_penetration_m", 0.0, 0.1)
        check_range(self, "stall_speed_m_s", 1e-6, 1.0)
        check_range(self, "stall_checks", 1, 100)
        check_range(self, "close_extra_s", 0.0, 10.0)
        check_range(self, "lift_m", 0.001, 10.0)
        check_range(self, "lift_speed_m_s", 0.001, 10.0)
        check_range(self, "lift_acceleration_m_s2", 0.01, 100.0)
        check_range(self, "hold_s", 0.0, 100.0)
        check_range(self, "max_slip_m", 0.0, 1.0)
        check_range(self, "max_speed_m_s", 0.0, 10.0)
        check_range(self, "left_table_m", 0.0, 1.0)
        if self.shake is not None and not isinstance(self.shake, Shake):
            raise InvalidInputError("shake", self.shake, "a Shake, or None")

    def lift_accelerations(self) -> list[float]:
        """Acceleration of the base between each two looks at the state, m/s2.

        Up to speed, on, and down to standstill; the way is `lift_m` exactly.
        """
        step = self.check_s
        ramp = max(1, -int(-self.lift_speed_m_s / self.lift_acceleration_m_s2 // step))
        # Over a short way the speed is never reached: both ramps shrink.
        while ramp > 1 and self.lift_speed_m_s * ramp * step > self.lift_m:
            ramp -= 1
        cruise = max(0, round(self.lift_m / (self.lift_speed_m_s * step)) - ramp)
        while True:
            speed = self.lift_m / ((ramp + cruise) * step)
            if speed / (ramp * step) <= self.lift_acceleration_m_s2 * (1 + 1e-9):
                break
            ramp, cruise = ramp + 1, max(0, cruise - 1)
        rate = speed / (ramp * step)
        return [rate] * ramp + [0.0] * cruise + [-rate] * ramp
