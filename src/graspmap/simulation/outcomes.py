"""What comes out of a grasp trial."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Outcome(StrEnum):
    """How a trial ended.

    held: the object hangs between both fingers after the lift (and the shake).
    collided: a finger or the palm touches on the way down.
    empty: nothing lies between the fingers, or they close on nothing.
    slipped: the fingers closed on it, but slid off before it left the table, or it slid too far
        through them.
    dropped: it left the table and was lost.
    """

    HELD = "held"
    COLLIDED = "collided"
    EMPTY = "empty"
    SLIPPED = "slipped"
    DROPPED = "dropped"


@dataclass(frozen=True)
class TrialResult:
    """What happened to one grasp.

    Args:
        outcome: How it ended.
        reason: Why, in words: "a finger would touch 4 mm above its goal", ...
        object_index: Which object of the tabletop the fingers closed on; None where on none.
        opening_m: Opening that the fingers went down with (the grasp's, at most the gripper's).
        needed_m: Least opening with which the fingers go down there without touching; 0 where
            nothing lies between them.
        tip_m: Height of the finger tips above the table at the end of the descent.
        clearance_m: Least gap between fingers and scene on the way down.
        closed_m: Distance of the fingers after closing; None where they never closed.
        grip_force_n: Mean normal force of a finger after closing, newton; None likewise.
        slip_m: How far the object moved in the hand between closing and the end, where the fingers
            hold it; None likewise.
        lift_m: How far the object's centre of mass rose; None likewise.
        success_probability: Share of the perturbed repeats that held; None without perturbation.
    """

    outcome: Outcome
    reason: str
    object_index: int | None
    opening_m: float
    needed_m: float
    tip_m: float
    clearance_m: float
    closed_m: float | None = None
    grip_force_n: float | None = None
    slip_m: float | None = None
    lift_m: float | None = None
    success_probability: float | None = None
