"""Making one item of a generated data set: an object, or a set of objects, with its views.

All of it is a function of the plan and of two numbers, the item and the attempt; nothing depends on
what was made before, where, or by how many workers.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graspmap.data.jacquard import write_jacquard
from graspmap.data.scene import Depth, Scene
from graspmap.errors import GraspmapError, storage_errors
from graspmap.files import file_hash
from graspmap.generation.catalogue import Pick, pick_objects
from graspmap.generation.entries import ItemEntry, MeshEntry, SceneEntry
from graspmap.generation.labels import Labels, label_tabletop
from graspmap.generation.ledger import staging_folder
from graspmap.generation.plan import GenerationPlan
from graspmap.generation.scene_file import RecordedObject, SceneRecord, versions, write_record
from graspmap.generation.sources import Fingerprint
from graspmap.simulation.render import (
    Appearance,
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
from graspmap.simulation.render.photo import photo
from graspmap.simulation.settle import UnsettledError, settle
from graspmap.simulation.tabletop import Tabletop

TRIES = 4
"""Falls of one object for one view, before the object is given up."""


@dataclass(frozen=True)
class Attempt:
    """Attempt number ``number`` at item number ``item``; each has objects of its own."""

    item: int
    number: int


@dataclass(frozen=True)
class Rejected:
    """An attempt without result.

    Args:
        reason: Why, in words that can be counted.
        objects: What lay on the table.
        detail: The error, in full.
        rejects: How many tries failed, by reason; this one included.
    """

    reason: str
    objects: tuple[str, ...]
    detail: str
    rejects: dict[str, int]


@dataclass(frozen=True, eq=False)
class GeneratedScene:
    """A scene with everything that is written of it.

    Args:
        scene: Pictures and labels.
        stereo_depth: (H, W) depth as a stereo camera sees it.
        labels: What the trials said.
        record: How to make it again.
    """

    scene: Scene
    stereo_depth: Depth
    labels: Labels
    record: SceneRecord


class NothingHoldsError(GraspmapError):
    """A scene without a label, or without a candidate."""

    def __init__(self, reason: str, trials: int) -> None:
        self.reason = reason
        super().__init__(f"{reason} ({trials} trials)")


def make_item(
    plan: GenerationPlan, root: Path, meshes: Sequence[MeshEntry], attempt: Attempt
) -> ItemEntry | Rejected:
    """Make an item's scenes and write them into its staging folder.

    Args:
        plan: The plan.
        root: Folder of the data set.
        meshes: The usable meshes, in order; none for procedural objects.
        attempt: Which item, and which attempt at it.

    Raises:
        StorageFullError: The disk is full.
        FileError: A file cannot be read or written.
    """
    pick = pick_objects(plan, meshes, root, attempt.item, attempt.number)
    staging = staging_folder(root, attempt.item)
    with storage_errors(staging):
        shutil.rmtree(staging, ignore_errors=True)
    rejects: Counter[str] = Counter()
    scenes = []
    last: UnsettledError | OutOfViewError | NothingHoldsError
    for view in range(plan.views_of(attempt.item)):
        for number in range(TRIES):
            try:
                made = make_scene(plan, pick, attempt, view, number)
            except (UnsettledError, OutOfViewError, NothingHoldsError) as error:
                rejects[_reason(error)] += 1
                last = error
                continue
            scenes.append(_write(made, staging))
            break
        else:
            names = tuple(dict.fromkeys(model.id for model in pick.models))
            return Rejected(_reason(last), names, str(last), dict(rejects))
    return ItemEntry(attempt.item, tuple(scenes), dict(rejects), pick.part)


def make_scene(
    plan: GenerationPlan,
    pick: Pick,
    attempt: Attempt,
    view: int,
    number: int,
) -> GeneratedScene:
    """One scene: drop the objects, look at them, try grasps on them.

    Args:
        plan: The plan.
        pick: The objects.
        attempt: Item and attempt.
        view: Number of the scene within the item.
        number: Of the try.

    Raises:
        UnsettledError: The objects did not come to rest.
        OutOfViewError: The camera does not see all of them.
        NothingHoldsError: No candidate was found, or none held.
    """
    seed = (plan.seed, attempt.item, attempt.number, view, number)
    # Streams of their own: more candidates leave the pictures as they are.
    fall, eye, look, sensor, grasps = np.random.default_rng(seed).spawn(5)
    tabletop = settle(pick.models, fall)
    where = sample_view(plan.randomisation, eye, plan.size_px)
    check_in_view(tabletop, where)
    appearance = sample_appearance(tabletop, plan.randomisation, look)
    picture = _picture(plan, tabletop, where, appearance, seed)
    labels = label_tabletop(
        tabletop,
        where,
        picture.depth,
        plan.gripper,
        plan.candidates,
        grasps,
        antipodal_share=plan.antipodal_share,
        settings=plan.settings,
    )
    if not len(labels.positives):
        raise NothingHoldsError(
            "no grasp holds" if labels.trials else "no candidate", labels.trials
        )
    name = f"{attempt.item * plan.views + view}_{pick.name}"
    return GeneratedScene(
        scene=Scene(
            id=name,
            rgb=picture.rgb,
            depth=picture.depth,
            mask=picture.mask,
            grasps=labels.positives,
            negatives=labels.negatives,
            camera=where.camera,
            T_world_camera=where.T_world_camera,
            object_id=pick.name,
        ),
        stereo_depth=stereo_depth(
            tabletop, where, picture, sample_sensor(plan.randomisation, sensor), sensor
        ),
        labels=labels,
        record=SceneRecord(
            id=name,
            objects=tuple(
                RecordedObject(
                    placed.model.id, source, Fingerprint.of(placed.model), placed.T_world_object
                )
                for source, placed in zip(pick.sources, tabletop.objects, strict=True)
            ),
            view=where,
            gripper=plan.gripper,
            settings=plan.settings,
            seed=seed,
            appearance=appearance,
            versions=versions(photo=plan.photo_samples > 0),
        ),
    )


def _picture(
    plan: GenerationPlan,
    tabletop: Tabletop,
    view: View,
    appearance: Appearance,
    seed: tuple[int, ...],
) -> Rendering:
    """All channels, with the colours that the plan asks for."""
    if not plan.photo_samples:
        return render(tabletop, view, appearance)
    paths = int(np.random.default_rng(seed).integers(2**32))
    return photo(tabletop, view, appearance, samples=plan.photo_samples, seed=paths)


def _write(made: GeneratedScene, staging: Path) -> SceneEntry:
    """Write a scene's files below the staging folder."""
    words = [outcome.value for outcome in made.labels.failures]
    picture = write_jacquard(made.scene, staging, stereo_depth=made.stereo_depth, outcomes=words)
    write_record(made.record, picture.parent)
    files = sorted(picture.parent.glob(f"{made.scene.id}_*"))
    return SceneEntry(
        id=made.scene.id,
        object=picture.parent.name,
        grasps=len(made.labels.positives),
        outcomes={word: count for word, count in made.labels.outcomes.items() if count},
        files={path.relative_to(staging).as_posix(): file_hash(path) for path in files},
    )


def _reason(error: UnsettledError | OutOfViewError | NothingHoldsError) -> str:
    if isinstance(error, OutOfViewError):
        return "larger than the picture"
    return f"unsettled: {error.reason}" if isinstance(error, UnsettledError) else error.reason
