"""GenerationPlan: everything that a generated data set follows from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import TypeAdapter

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.generation.labels import ANTIPODAL_SHARE
from graspmap.gripper import Gripper, check_gripper
from graspmap.simulation.meshes import Unit
from graspmap.simulation.procedural import FAMILIES, ObjectRanges
from graspmap.simulation.render import Randomisation
from graspmap.simulation.settings import TrialSettings

PROCEDURAL: Literal["procedural"] = "procedural"
"""The objects that graspmap makes up, instead of a folder of meshes."""

_LEAST_JAW_PX = 1.0
_MOST = 10**6


@dataclass(frozen=True)
class GenerationPlan:
    """Everything that a generated data set follows from; the same plan gives the same bytes.

    Args:
        scenes: How many.
        gripper: Whose grasps are tried.
        objects: ``"procedural"``, or a folder of meshes (searched with its subfolders).
        views: Scenes of one object (or set of objects), each with a fall, a camera, a light and
            trials of its own.
        clutter: Objects on the table.
        seed: Item i (an object with its views) draws from (seed, i).
        size_px: Side of the pictures.
        candidates: Trials of a scene, over all jaw sizes.
        antipodal_share: Part of the candidates that is antipodal, in [0, 1]; the others are random.
        randomisation: By how much pictures vary.
        photo_samples: Paths through each pixel of colour pictures that are path traced (see
            `graspmap.simulation.render.photo`); 0: they are ray cast. Nothing else changes.
        settings: Of the trials.
        families: Of procedural objects: names of `FAMILIES` or of their shapes; all where empty.
        ranges: Sizes and masses of procedural objects; those that suit the gripper where None.
        unit: Of the meshes; guessed where None.
        fit: Scale each mesh to the gripper by EGAD's rule.

    Raises:
        InvalidInputError: A number is out of range, or the gripper does not suit the picture.
        UnknownNameError: There is no such family.
    """

    scenes: int
    gripper: Gripper
    objects: Path | Literal["procedural"] = "procedural"
    views: int = 5
    clutter: int = 1
    seed: int = 0
    size_px: int = 1024
    candidates: int = 1000
    antipodal_share: float = ANTIPODAL_SHARE
    randomisation: Randomisation = field(default_factory=Randomisation)
    photo_samples: int = 0
    settings: TrialSettings = field(default_factory=TrialSettings)
    families: tuple[str, ...] = ()
    ranges: ObjectRanges | None = None
    unit: Unit | None = None
    fit: bool = False

    def __post_init__(self) -> None:
        limits = {
            "scenes": (1, 10**8),
            "views": (1, 1000),
            "clutter": (1, 50),
            "seed": (0, 2**32 - 1),
            "size_px": (48, 4096),
            "candidates": (1, _MOST),
            "photo_samples": (0, _MOST),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
                raise InvalidInputError(name, repr(value), f"a whole number from {low} to {high}")
        if not 0 <= self.antipodal_share <= 1:
            raise InvalidInputError("antipodal_share", repr(self.antipodal_share), "a part of 1")
        check_gripper(self.gripper)
        self._check_objects()
        self._check_jaws()

    def _check_objects(self) -> None:
        if self.procedural:
            if self.ranges is None:
                object.__setattr__(self, "ranges", ObjectRanges.for_gripper(self.gripper))
            for name in ("unit", "fit"):
                if (value := getattr(self, name)) not in (None, False):
                    raise InvalidInputError(
                        name, repr(value), "for a folder of meshes only, not for procedural objects"
                    )
            self._check_families()
            return
        for name, value in (("families", ", ".join(self.families)), ("ranges", self.ranges)):
            if value:
                raise InvalidInputError(name, value, "for procedural objects only, no meshes")
        if self.unit is not None and self.unit not in get_args(Unit):
            raise UnknownNameError("unit", self.unit, get_args(Unit))

    def _check_families(self) -> None:
        known = [*FAMILIES, *(name for family in FAMILIES.values() for name in family.shapes)]
        for name in self.families:
            if name not in known:
                raise UnknownNameError("family of objects", name, known)
            if self.families.count(name) > 1:
                raise InvalidInputError("families", f"{name} twice", "each name once")

    def _check_jaws(self) -> None:
        """See that the gripper's jaws are neither specks nor larger than the picture."""
        side_m = self.shown_m
        for jaw in self.gripper.jaw_sizes_m:
            jaw_px = jaw / side_m * self.size_px
            if not 1 <= jaw_px <= self.size_px:
                raise InvalidInputError(
                    f"jaw size of gripper {self.gripper.name}",
                    f"{jaw:g} m, {jaw_px:.3g} px of a picture that shows {side_m:.2g} m",
                    f"1 to {self.size_px} px: change the gripper, size_px or the camera's distance",
                )

    @property
    def shown_m(self) -> float:
        """Side of the table that a picture of average distance and view shows, metres."""
        camera = self.randomisation.camera
        half = math.radians(sum(camera.field_of_view_deg) / 4)
        return math.tan(half) * sum(camera.distance_m)

    @property
    def procedural(self) -> bool:
        """Whether the objects are made up."""
        return self.objects == PROCEDURAL

    @property
    def items(self) -> int:
        """Objects (or sets of objects) that the scenes show; the last may have fewer views."""
        return -(-self.scenes // self.views)

    def views_of(self, item: int) -> int:
        """Scenes of item number ``item``."""
        return min(self.views, self.scenes - item * self.views)

    def to_dict(self) -> dict[str, Any]:
        """Plain values; the folder of meshes is not among them, since it tells nothing of them."""
        # A key of its own only where it changes something: other data stay what they are.
        photo = {"photo_samples": self.photo_samples} if self.photo_samples else {}
        return {
            "scenes": self.scenes,
            "objects": PROCEDURAL if self.procedural else "meshes",
            "views": self.views,
            "clutter": self.clutter,
            "seed": self.seed,
            "size_px": self.size_px,
            "candidates": self.candidates,
            "antipodal_share": self.antipodal_share,
            "families": list(self.families),
            "ranges": _plain(ObjectRanges, self.ranges) if self.ranges else None,
            "unit": self.unit,
            "fit": self.fit,
            "gripper": self.gripper.to_dict(),
            "settings": _plain(TrialSettings, self.settings),
            "randomisation": self.randomisation.model_dump(mode="json"),
            **photo,
        }


def _plain(kind: type[Any], value: Any) -> Any:
    return TypeAdapter(kind).dump_python(value, mode="json")
