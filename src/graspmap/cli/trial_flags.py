"""The flags that say how grasps are tried, and the trials: shared by the commands."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from graspmap.cli.frame import at_least, numbers, option
from graspmap.cli.progress import progress
from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.data import Scenes
    from graspmap.evaluation import GraspDetector, GraspsToTry, TrialEvaluation, TrialPlan
    from graspmap.simulation.trial import Perturbation

REPEATS = 10
"""Perturbed repeats of a grasp where nothing else is asked for."""


@dataclass(frozen=True)
class TrialFlags:
    """How grasps are tried."""

    gripper: Annotated[str | None, option("G", "default: that of the data, else jacquard")] = None
    """Name of a profile (`graspmap gripper list`) or a YAML file."""
    jaw: Annotated[str, option("nearest|given|MM", "default: nearest")] = "nearest"
    """Jaw size: the gripper's nearest to the predicted one, the predicted one itself, or one size
    for all in millimetres."""
    trial_depth: Annotated[str | None, option("NAME", "default: perfect or z")] = None
    """Which depth places the grasps, and rebuilds scenes that have no record."""
    camera: Annotated[Path | None, option("F", "default: that of the data")] = None
    """Camera file (JSON or YAML: fx, fy, cx, cy, width, height) of pictures without a record,
    instead of the camera that their data set says: where nothing generated them, and for what the
    network sees as well as for the trials."""
    shake: bool = False
    """Shake the gripper after the lift: weak grips lose."""
    perturb: Annotated[str | None, option("MM,DEG[,FRICTION,MASS]", "default: none")] = None
    """Standard deviations of the grasp's place (mm), its angle (degrees), and, relative, of
    friction and mass: 2,2,0.1,0.1. Gives the robust success as well."""
    repeats: Annotated[int | None, option("N", f"default: {REPEATS}")] = None
    """Perturbed repeats of each grasp."""
    workers: Annotated[int, option("N", "default: number of cores")] = 0
    """Processes; the result does not depend on it."""

    @property
    def processes(self) -> int:
        """Number of processes, that of the machine's cores where none was given."""
        return self.workers or os.cpu_count() or 1

    def check(self) -> None:
        """Refuse what contradicts itself, before any work.

        Raises:
            InvalidInputError: A number is out of range, or a flag needs another.
        """
        at_least(0, workers=self.workers)
        check_repeats(self.repeats, self.perturb)

    def plan(self, *, top: int | None, seed: int, labels: bool = False) -> TrialPlan:
        """The plan of the trials.

        Args:
            top: How many grasps of a scene are tried; None: all.
            seed: Of the perturbation and of the interval.
            labels: Whether labels are tried, which have no order.

        Raises:
            InvalidInputError: A value is not allowed; the error names its flag.
            FileError: The gripper's file is missing or damaged.
        """
        from graspmap.evaluation import TrialPlan
        from graspmap.gripper import load_gripper
        from graspmap.simulation.trial import Shake

        return TrialPlan(
            gripper=None if self.gripper is None else load_gripper(self.gripper),
            top=top,
            ranked=not labels,
            jaw=_jaw(self.jaw),
            distinct=labels,
            shake=Shake() if self.shake else None,
            perturbation=None if self.perturb is None else read_perturbation(self.perturb),
            repeats=1 if self.perturb is None else self.repeats or REPEATS,
            seed=seed,
        )

    def read(self, data: str, depth: str | None) -> Scenes:
        """The scenes of a data set, as pictures of ``--camera`` where there is one.

        Args:
            data: ``kind:directory``.
            depth: Which depth; None: the default of their kind.

        Raises:
            FileError: Data or camera file are missing or damaged.
            InvalidInputError: They have no such depth.
        """
        from graspmap.data import read_scenes
        from graspmap.evaluation import SeenBy
        from graspmap.geometry import Camera

        scenes = read_scenes(data, depth=depth)
        return scenes if self.camera is None else SeenBy(scenes, Camera.read(self.camera))

    def scenes(self, data: str, ids: Sequence[str]) -> Scenes:
        """Scenes with exact depth, whatever a network saw: it says where things really are.

        Args:
            data: ``kind:directory``.
            ids: Which of its scenes.

        Raises:
            FileError: The data are missing or damaged.
            InvalidInputError: A scene is not among them, or they have no such depth.
        """
        return self.read(data, self.trial_depth).subset(ids)

    def attempt(
        self,
        todo: GraspsToTry,
        scenes: Scenes,
        plan: TrialPlan,
        *,
        cluster: Literal["scene", "object"],
        folder: Path | None = None,
    ) -> TrialEvaluation:
        """Try grasps in physics; arguments and errors as in `graspmap.evaluation.try_grasps`."""
        from graspmap.evaluation import try_grasps

        with progress("trying grasps, scenes", per_hour="scenes") as update:
            return try_grasps(
                todo.grasps,
                scenes,
                plan,
                skipped=todo.skipped,
                cluster=cluster,
                workers=self.processes,
                folder=folder,
                progress=update,
            )


def detect_to_try(detector: GraspDetector, scenes: Scenes, plan: TrialPlan) -> GraspsToTry:
    """The grasps of a detector that a plan tries: those that its gripper can open for."""
    from graspmap.evaluation import predict_scenes

    with progress("detecting what the gripper can open for") as update:
        return predict_scenes(
            detector, scenes, top=plan.top or 1, gripper=plan.gripper, progress=update
        )


def _jaw(text: str) -> Literal["nearest", "given"] | float:
    if text == "nearest":
        return "nearest"
    if text == "given":
        return "given"
    try:
        size_m = float(text) / 1000
    except ValueError:
        size_m = 0.0
    if not 0 < size_m <= 1:
        raise InvalidInputError("--jaw", repr(text), "nearest, given, or millimetres above 0")
    return size_m


def check_repeats(repeats: int | None, perturb: str | None) -> None:
    """Refuse ``--repeats`` that repeat nothing.

    Raises:
        InvalidInputError: There is less than one, or no ``--perturb`` beside it.
    """
    at_least(1, repeats=repeats)
    if repeats is not None and perturb is None:
        raise InvalidInputError(
            "--repeats", repeats, "only with --perturb: repeats are all the same without"
        )


def read_perturbation(text: str) -> Perturbation:
    """What ``--perturb`` says.

    Args:
        text: ``MM,DEG`` or ``MM,DEG,FRICTION,MASS``.

    Raises:
        InvalidInputError: It is something else, or a number is out of range.
    """
    from graspmap.simulation.trial import Perturbation

    names = "MM,DEG" if len(text.split(",")) == 2 else "MM,DEG,FRICTION,MASS"
    values = (*numbers(text, names, "--perturb"), 0.0, 0.0)
    try:
        return Perturbation(
            position_m=values[0] / 1000,
            angle_rad=math.radians(values[1]),
            friction=values[2],
            mass=values[3],
        )
    except InvalidInputError as error:
        problem = f"{text!r}, so {error.name} is {error.found}"
        raise InvalidInputError("--perturb", problem, f"{error.allowed} there") from error
