"""TrialPlan: how the grasps of a data set are tried."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from graspmap.errors import InvalidInputError
from graspmap.evaluation.tabletops import SceneWorld
from graspmap.gripper import Gripper, check_gripper, load_gripper
from graspmap.simulation.trial import Perturbation, Shake, TrialSettings

Jaw = Literal["nearest", "given"]
DEFAULT_GRIPPER = "jacquard"


def recorded_or_default(recorded: Gripper | None) -> Gripper:
    """The gripper that tries where none is asked for: that of the scene's record, or Jacquard's."""
    return recorded or load_gripper(DEFAULT_GRIPPER)


@dataclass(frozen=True)
class TrialPlan:
    """How grasps of a data set are tried.

    Args:
        gripper: The gripper; None: that of the scene's record, and Jacquard's for other scenes.
        top: How many grasps of a scene are tried, best first; None: all.
        ranked: Whether the grasps of a scene have an order, best first; labels have none.
        jaw: ``nearest``: the gripper's jaw size that is nearest to the predicted height;
            ``given``: the predicted height; a number: this size for all, metres.
        distinct: Try grasps only once that differ in nothing but a jaw that the gripper lacks.
        settings: Of the simulation; None: the record's, or the defaults.
        shake: What a held object must bear after the lift, whatever the settings say; None: as they
            say.
        perturbation: How unsure pose, friction and mass are.
        repeats: Perturbed repeats of each trial.
        seed: Of the perturbation and of the interval.

    Raises:
        InvalidInputError: A number is out of range, or the gripper is none.
    """

    gripper: Gripper | None = None
    top: int | None = 1
    ranked: bool = True
    jaw: Jaw | float = "nearest"
    distinct: bool = False
    settings: TrialSettings | None = None
    shake: Shake | None = None
    perturbation: Perturbation | None = None
    repeats: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.gripper is not None:
            check_gripper(self.gripper)
        if self.top is not None and self.top < 1:
            raise InvalidInputError("top", self.top, "1 or more grasps")
        if self.repeats < 1 or (self.repeats > 1 and self.perturbation is None):
            raise InvalidInputError("repeats", self.repeats, "1 or more; 1 without perturbation")
        if self.jaw not in ("nearest", "given") and not (
            isinstance(self.jaw, int | float) and 0 < self.jaw <= 1
        ):
            raise InvalidInputError("jaw", repr(self.jaw), "nearest, given, or metres up to 1")

    def to_dict(self) -> dict[str, Any]:
        """What of it changes how grasps fare, for JSON; the gripper is told by its name."""
        return {
            "top": self.top,
            "jaw": self.jaw,
            "shake": None if self.shake is None else asdict(self.shake),
            "perturbation": None if self.perturbation is None else asdict(self.perturbation),
            "repeats": self.repeats,
            "seed": self.seed,
        }

    def gripper_for(self, world: SceneWorld) -> Gripper:
        """The gripper that grasps on a scene are tried with."""
        return self.gripper or recorded_or_default(world.gripper)

    def settings_for(self, world: SceneWorld) -> TrialSettings:
        """The settings that grasps on a scene are tried with."""
        settings = self.settings or world.settings or TrialSettings()
        return settings if self.shake is None else replace(settings, shake=self.shake)
