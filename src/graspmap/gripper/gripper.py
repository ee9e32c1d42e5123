"""Gripper: a parallel-jaw gripper, as a YAML profile describes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Gripper:
    """A parallel-jaw gripper that comes down with open fingers and closes them.

    The owner of this file may turn it into a pydantic model; the names stay.

    Args:
        name: Name of the profile.
        min_opening_m: Distance of the closed fingers.
        max_opening_m: Distance of the open fingers.
        jaw_sizes_m: Jaw sizes (across the opening) that exist for it, ascending; labels try each.
        jaw_contact_share: Part of the jaw size that the plate really has, in (0, 1].
        finger_thickness_m: Of a finger, along the opening.
        finger_length_m: From the palm to the tips: how deep it can reach over an object.
        palm_size_m: Palm along and across the opening; it must not touch either.
        force_n: Force with which each finger presses.
        friction: Coulomb friction of the finger pads.
        torsional_friction_m: Torsional friction of the pads (MuJoCo's, a length).
        finger_mass_kg: Of one finger.
        closing_speed_m_s: Of each finger.
        max_depth_m: How far below the highest point between them the tips go, at most.
        table_clearance_m: How near the table the tips go, at most.
        on_touch: What happens when a finger would touch on the way down: the grasp fails, or the
            gripper stops ``touch_gap_m`` above what it would touch and closes there.
        touch_gap_m: See ``on_touch``.
    """

    name: str
    min_opening_m: float
    max_opening_m: float
    jaw_sizes_m: tuple[float, ...]
    jaw_contact_share: float
    finger_thickness_m: float
    finger_length_m: float
    palm_size_m: tuple[float, float]
    force_n: float
    friction: float
    torsional_friction_m: float
    finger_mass_kg: float
    closing_speed_m_s: float
    max_depth_m: float
    table_clearance_m: float
    on_touch: Literal["fail", "stop"]
    touch_gap_m: float
