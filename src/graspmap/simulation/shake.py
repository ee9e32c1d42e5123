"""Shake: what a held object must bear after the lift."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.simulation.numerics import check_range

Floats = NDArray[np.float64]
Direction = Literal["opening", "jaw", "up"]
GRAVITY_M_S2 = 9.81
_AXES = {"opening": 0, "jaw": 1, "up": 2}


@dataclass(frozen=True, kw_only=True)
class Shake:
    """The gripper swings to and fro along one direction after the other, and then tilts.

    Seen from the gripper both are a change of gravity, and so they are simulated: a gripper that
    accelerates by a feels -a, a gripper that tilts feels gravity from the side.

    Args:
        acceleration_m_s2: Greatest acceleration of the swing; its amplitude in metres is this over
            (2 pi frequency_hz) squared.
        frequency_hz: Of the swing.
        cycles: Full swings along each direction.
        directions: Along the opening of the fingers, along the jaw, up.
        tilt_rad: Tilt to either side about each horizontal axis, after the swings; 0 for none.
        tilt_s: Time of a full tilt: to one side, to the other and back.

    Raises:
        InvalidInputError: A number is out of range or a direction unknown.
    """

    acceleration_m_s2: float = 5.0
    frequency_hz: float = 4.0
    cycles: int = 2
    directions: tuple[Direction, ...] = ("opening", "jaw", "up")
    tilt_rad: float = 0.0
    tilt_s: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "acceleration_m_s2", 0.0, 1000.0)
        check_range(self, "frequency_hz", 0.1, 50.0)
        check_range(self, "cycles", 1, 1000)
        check_range(self, "tilt_rad", 0.0, math.pi)
        check_range(self, "tilt_s", 0.1, 100.0)
        unknown = [name for name in self.directions if name not in _AXES]
        if unknown:
            raise InvalidInputError("directions", unknown, ", ".join(_AXES))

    @property
    def duration_s(self) -> float:
        """Time from the beginning to the end."""
        tilts = 2 * self.tilt_s if self.tilt_rad else 0.0
        return len(self.directions) * self._swing_s + tilts

    @property
    def _swing_s(self) -> float:
        return self.cycles / self.frequency_hz

    def gravity(self, time_s: float) -> Floats:
        """(3,) what the gripper feels, m/s2: x along the opening, y along the jaw, z up."""
        felt = np.array([0.0, 0.0, -GRAVITY_M_S2])
        turn = int(time_s / self._swing_s)
        if turn < len(self.directions):
            wave = math.sin(2 * math.pi * self.frequency_hz * time_s)
            felt[_AXES[self.directions[turn]]] -= self.acceleration_m_s2 * wave
            return felt
        tilted = (time_s - len(self.directions) * self._swing_s) / self.tilt_s
        angle = self.tilt_rad * math.sin(2 * math.pi * tilted)
        side = 0 if tilted < 1.0 else 1
        felt[side], felt[2] = GRAVITY_M_S2 * math.sin(angle), -GRAVITY_M_S2 * math.cos(angle)
        return felt
