"""One try: an object falls, the camera sees it, the detector's best grasp is tried.

What comes out follows from the seed, the mesh and the number of the try alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

import numpy as np

from graspmap.errors import GraspmapError
from graspmap.evaluation.egad.plan import EgadPlan, GripperDetector
from graspmap.evaluation.tabletops import SceneWorld
from graspmap.evaluation.trial_results import TriedGrasp
from graspmap.evaluation.trials import try_in_world
from graspmap.generation.item import TRIES
from graspmap.generation.labels import label_tabletop
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.render import (
    OutOfViewError,
    Rendering,
    View,
    check_in_view,
    render,
    sample_appearance,
    sample_sensor,
    sample_view,
    stereo_depth,
)
from graspmap.simulation.settle import UnsettledError, settle
from graspmap.simulation.trial import Outcome


@dataclass(frozen=True, eq=False)
class EgadTry:
    """What became of one try at an object.

    Attributes:
        mesh: Id of the mesh.
        number: Of the try, from 0.
        tried: The grasps, best first; one without a grasp where the detector found none.
        candidates: How many proposed grasps were tried beside them.
        candidates_held: How many of those held.
    """

    mesh: str
    number: int
    tried: tuple[TriedGrasp, ...]
    candidates: int
    candidates_held: int

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "mesh": self.mesh,
            "number": self.number,
            "tried": [tried.to_dict() for tried in self.tried],
            "candidates": self.candidates,
            "candidates_held": self.candidates_held,
        }

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> EgadTry:
        """The inverse of `to_dict`.

        Raises:
            KeyError, TypeError, ValueError: It is no such entry.
        """
        return cls(
            mesh=str(entry["mesh"]),
            number=int(entry["number"]),
            tried=tuple(TriedGrasp.from_dict(tried) for tried in entry["tried"]),
            candidates=int(entry["candidates"]),
            candidates_held=int(entry["candidates_held"]),
        )


def try_object(
    plan: EgadPlan, model: ObjectModel, number: int, detector: GripperDetector
) -> EgadTry:
    """Try number ``number`` at an object.

    An object that does not come to rest, or not where the camera sees it whole, falls again.

    Args:
        plan: How.
        model: The object, scaled to the gripper.
        number: Of the try.
        detector: Sees colour and the measured depth.

    Raises:
        UnsettledError: The object never came to rest.
        OutOfViewError: The camera never saw it whole.
        InvalidInputError: The detector needs something else than the camera gives.
    """
    for fall in range(TRIES):
        try:
            return _fall(plan, model, number, fall, detector)
        except (UnsettledError, OutOfViewError) as error:
            last: GraspmapError = error
    raise last


def _fall(
    plan: EgadPlan, model: ObjectModel, number: int, fall: int, detector: GripperDetector
) -> EgadTry:
    seed = (plan.seed, mesh_number(model.id), number, fall)
    # Streams of their own: more candidates leave the pictures as they are.
    drop, eye, look, sensor, errors, grasps = np.random.default_rng(seed).spawn(6)
    tabletop = settle([model], drop)
    view = sample_view(plan.randomisation, eye, plan.size_px)
    check_in_view(tabletop, view)
    picture = render(tabletop, view, sample_appearance(tabletop, plan.randomisation, look))
    depth = picture.depth
    if plan.depth == "stereo":
        measured = sample_sensor(plan.randomisation, sensor)
        depth = stereo_depth(tabletop, view, picture, measured, sensor)
    found = detector.detect(
        picture.rgb, depth, camera=view.camera, gripper=plan.gripper, top=plan.top
    )
    # A robot knows no other depth than that of its camera: it says where the grasps are, too.
    world = SceneWorld(tabletop, depth, view.camera, view.T_world_camera)
    trying = plan.trying(int(errors.integers(2**32)))
    trials = try_in_world(world, trying, found.grasps[: plan.top], f"{model.id}#{number}", model.id)
    candidates, held = 0, 0
    if plan.candidates:
        candidates, held = _possible(plan, world, picture, grasps)
    return EgadTry(model.id, number, trials.tried, candidates, held)


def _possible(
    plan: EgadPlan, world: SceneWorld, picture: Rendering, rng: np.random.Generator
) -> tuple[int, int]:
    """How many candidates, placed with the exact depth, were tried, and how many of them held."""
    labels = label_tabletop(
        world.tabletop,
        View(world.camera, world.T_world_camera),
        picture.depth,
        plan.gripper,
        plan.candidates,
        rng,
        settings=plan.settings,
    )
    return labels.trials, labels.outcomes[Outcome.HELD.value]


def mesh_number(id: str) -> int:
    """A number that a mesh keeps, whatever other meshes are tried."""
    content = id.encode(errors="surrogateescape")
    return int.from_bytes(blake2b(content, digest_size=8).digest(), "little")
