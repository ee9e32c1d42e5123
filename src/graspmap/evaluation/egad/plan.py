"""EgadPlan: how a detector is tried on the meshes of EGAD, or on any folder of meshes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, get_args

from graspmap.data.scene import Depth, Rgb
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.evaluation.evaluate import Found
from graspmap.evaluation.trial_plan import TrialPlan
from graspmap.files import file_hash
from graspmap.generation.plan import GenerationPlan
from graspmap.geometry.camera import Camera
from graspmap.gripper import Gripper
from graspmap.simulation.render import Randomisation
from graspmap.simulation.trial import Perturbation, TrialSettings

SensorDepth = Literal["stereo", "perfect"]
"""Depth as a stereo camera measures it, with its errors and holes, or as it is."""

TRIALS = 20
"""Tries of each object, by EGAD's protocol."""

_MOST = 10**6


class GripperDetector(Protocol):
    """A detector that knows what a gripper can open for, as `graspmap.Detector` does."""

    def detect(
        self, rgb: Rgb | None, depth: Depth | None, *, camera: Camera, gripper: Gripper, top: int
    ) -> Found:
        """The ``top`` best grasps of one picture that the gripper can open for.

        Args:
            rgb: (H, W, 3) uint8, red first.
            depth: (H, W) float32 metres, NaN where there is none.
            camera: Intrinsics of the picture.
            gripper: The gripper.
            top: How many grasps at most.
        """


class DetectorSource(Protocol):
    """Where each process gets its detector from; it can be pickled."""

    @property
    def stamp(self) -> str:
        """Changes with the detector, so that a run is not gone on with by another one."""

    def load(self) -> GripperDetector:
        """The detector."""


@dataclass(frozen=True)
class DetectorFile:
    """A detector in a weights file.

    Args:
        weights: The file.
        device: Where its network runs.
    """

    weights: Path
    device: str = "cpu"

    @property
    def stamp(self) -> str:
        """Hash of the file."""
        return file_hash(self.weights)

    def load(self) -> GripperDetector:
        """The detector.

        Raises:
            WeightsError: The file is missing, damaged or not of graspmap.
            InvalidInputError: The device is not available.
        """
        from graspmap.inference import Detector

        return Detector.load(self.weights, device=self.device)


@dataclass(frozen=True)
class EgadPlan:
    """Everything that the result follows from, beside the meshes and the detector.

    Args:
        gripper: What the meshes are scaled to, and what grasps.
        trials: Tries of each object, each with a fall, a camera and a light of its own.
        top: Grasps tried in each, best first, each on the object as it fell; the first one counts.
        depth: What the camera measures: the detector sees it, and it places the grasps.
        candidates: Grasps that are proposed and tried in each, to say what is possible; 0 for none.
        size_px: Side of the pictures.
        randomisation: By how much pictures vary.
        settings: Of the trials.
        perturbation: How unsure pose, friction and mass are.
        repeats: Perturbed repeats of each grasp.
        seed: Try t of mesh m draws from (seed, m, t), whatever else is in the folder.

    Raises:
        InvalidInputError: A number is out of range, or the gripper does not suit the picture.
        UnknownNameError: There is no such depth.
    """

    gripper: Gripper
    trials: int = TRIALS
    top: int = 1
    depth: SensorDepth = "stereo"
    candidates: int = 100
    size_px: int = 1024
    randomisation: Randomisation = field(default_factory=Randomisation)
    settings: TrialSettings = field(default_factory=TrialSettings)
    perturbation: Perturbation | None = None
    repeats: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("trials", 1), ("top", 1), ("candidates", 0)):
            value = getattr(self, name)
            if not least <= value <= _MOST:
                raise InvalidInputError(name, value, f"a whole number from {least} to {_MOST}")
        if self.depth not in get_args(SensorDepth):
            raise UnknownNameError("depth", str(self.depth), get_args(SensorDepth))
        self.preparing(Path())  # it checks gripper, picture and seed
        self.trying(self.seed)

    @property
    def opening_px(self) -> float:
        """About how long an object is in the picture: the opening, seen from the mean distance."""
        camera = self.randomisation.camera
        distance_m = sum(camera.distance_m) / 2
        half_view = math.radians(sum(camera.field_of_view_deg) / 4)
        return self.gripper.max_opening_m * self.size_px / (2 * distance_m * math.tan(half_view))

    def preparing(self, folder: Path) -> GenerationPlan:
        """How the meshes of a folder are prepared: as for a data set, scaled by EGAD's rule."""
        return GenerationPlan(
            scenes=1,
            gripper=self.gripper,
            objects=folder,
            seed=self.seed,
            size_px=self.size_px,
            randomisation=self.randomisation,
            settings=self.settings,
            fit=True,
        )

    def trying(self, seed: int) -> TrialPlan:
        """How the grasps of one try are tried, with a seed for their perturbation."""
        return TrialPlan(
            gripper=self.gripper,
            top=self.top,
            settings=self.settings,
            perturbation=self.perturbation,
            repeats=self.repeats,
            seed=seed,
        )
