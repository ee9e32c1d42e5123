"""Grasps of a data set tried in simulation: what the rectangle metric cannot say.

A scene that graspmap generated is rebuilt from its record, exactly as it was; any other scene that
has depth and a camera is rebuilt from them (2.5D).

Letters in shapes: N grasps.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from functools import partial
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graspmap import __version__
from graspmap.data.scene import Scenes
from graspmap.errors import GraspmapError, InvalidInputError, StorageFullError
from graspmap.evaluation.judge import Cluster, Progress
from graspmap.evaluation.tabletops import SceneWorld, scene_world
from graspmap.evaluation.trial_journal import SceneTrials, TrialJournal, open_journal, scene_stamp
from graspmap.evaluation.trial_plan import Jaw, TrialPlan
from graspmap.evaluation.trial_results import Placed, TrialEvaluation, TriedGrasp, clusters
from graspmap.generation.workers import WorkerDiedError, WorkerPool
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.table_grasps import TableGrasps, surface_depth
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import Gripper
from graspmap.metrics.trial import score_trials
from graspmap.simulation.trial import run_trials

SCENES_A_WORKER = 4
"""Less is done before another process has started."""

_SAME_JAW = 1e-3  # relative; labels say jaws in rounded pixels
_TOLD = 5  # reasons for skipped scenes that are told one by one
_LOG = logging.getLogger(__name__)


def try_grasps(
    predictions: Mapping[str, Grasps],
    scenes: Scenes,
    plan: TrialPlan | None = None,
    *,
    skipped: Mapping[str, str] | None = None,
    cluster: Cluster = "scene",
    workers: int = 1,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> TrialEvaluation:
    """Try predicted grasps in physics.

    Scenes that cannot be tried (no depth, no camera, a damaged file, objects that cannot be
    rebuilt) are left out, counted in the result, and told as warnings.

    Args:
        predictions: Grasps by scene id, best first, in pixels of each picture. A scene of
            ``scenes`` without any counts as a failure.
        scenes: The scenes to judge, with exact depth where there is one: it places the grasps,
            and 2.5D scenes are rebuilt from it.
        plan: How; None: the defaults.
        skipped: Scenes to leave out, with the reason.
        cluster: What the interval takes as independent, ``scene`` or ``object``.
        workers: Processes; the result does not depend on it.
        folder: Finished scenes are kept there until `write_trials` writes the results into it, so
            that a run that was stopped goes on where it was; None keeps nothing.
        progress: Called after each scene.

    Raises:
        InvalidInputError: No scene can be tried, or an option is not allowed.
        StorageFullError: The disk is full.
        FileError: Another run is at work in the folder.
    """
    plan = plan or TrialPlan()
    if cluster not in ("scene", "object"):
        raise InvalidInputError("cluster", repr(cluster), "scene, object")
    if workers < 1:
        raise InvalidInputError("workers", workers, "1 or more")
    left_out = dict(skipped or {})
    order = [i for i, name in enumerate(scenes.ids) if name not in left_out]
    made_with = f"{__version__} {scenes.kind}:{scenes.root} {scenes.camera!r} {plan!r}"
    with open_journal(folder, made_with) as journal:
        run = _Run(scenes, plan, predictions, journal, progress)
        found = run.all(order, workers)
    left_out |= run.skipped
    data = f"{scenes.kind}:{scenes.root}"
    tried = tuple(grasp for index in order if index in found for grasp in found[index].tried)
    if not tried:
        raise InvalidInputError(
            f"scenes of {data}",
            f"{len(scenes)}, none of which can be tried ({_why(left_out)})",
            "scenes with depth, and a camera that is known",
        )
    _tell(left_out)
    score = score_trials(
        [grasp.outcome for grasp in tried],
        [grasp.object_id or grasp.scene for grasp in tried],
        rng=np.random.default_rng(plan.seed),
        groups=clusters(tried, cluster),
    )
    return TrialEvaluation(
        data=data,
        score=score,
        tried=tried,
        skipped={name: left_out[name] for name in scenes.ids if name in left_out},
        grippers=tuple(sorted({trials.gripper for trials in found.values()})),
        plan=plan,
        cluster=cluster,
    )


class _Run:
    """The trials of a data set, scene by scene."""

    def __init__(
        self,
        scenes: Scenes,
        plan: TrialPlan,
        predictions: Mapping[str, Grasps],
        journal: TrialJournal,
        progress: Progress | None,
    ) -> None:
        self._scenes, self._plan, self._journal = scenes, plan, journal
        self._progress = progress or (lambda done, total: None)  # noqa: ARG005
        none = Grasps.empty()
        self._grasps = [predictions.get(name, none)[: plan.top] for name in scenes.ids]
        self.skipped: dict[str, str] = {}

    def all(self, order: list[int], workers: int) -> dict[int, SceneTrials]:
        """Trials by number of the scene; scenes that cannot be tried go to ``skipped``."""
        found: dict[int, SceneTrials] = {}
        stamps = {i: scene_stamp(self._scenes, i, self._grasps[i]) for i in order}
        for index in order:
            known = self._journal.find(stamps[index])
            if known is not None:
                found[index] = known
        self._progress(len(found), len(order))
        todo = [index for index in order if index not in found]
        job = partial(_try_scene, self._scenes, self._plan, self._grasps)
        processes = min(workers, len(todo) // SCENES_A_WORKER)
        # One worker is this process: it starts at once.
        processes = 0 if processes < 2 else processes
        with WorkerPool(job, processes) as pool:
            for index in todo:
                pool.submit(index)
            for done, answer in enumerate(pool.answers(), start=len(order) - len(todo) + 1):
                if answer.result is None:
                    self.skipped[self._scenes.ids[answer.task]] = blame(answer.error)
                else:
                    found[answer.task] = answer.result
                    self._journal.add(stamps[answer.task], answer.result)
                self._progress(done, len(order))
        return found


def _try_scene(scenes: Scenes, plan: TrialPlan, grasps_of: list[Grasps], index: int) -> SceneTrials:
    """Trials of one scene."""
    name, object_id, grasps = scenes.ids[index], scenes.object_id(index), grasps_of[index]
    # Before anything else: whether a scene counts must not depend on what was predicted for it.
    world = scene_world(scenes, index)
    return try_in_world(world, plan, grasps, name, object_id)


def try_in_world(
    world: SceneWorld, plan: TrialPlan, grasps: Grasps, scene: str, object_id: str | None
) -> SceneTrials:
    """Try grasps of one picture.

    Args:
        world: What the picture shows, and the depth that places the grasps.
        plan: How; all of the grasps are tried, whatever ``top`` it says.
        grasps: Best first, in pixels of the picture; none: a failure.
        scene: Name of the scene.
        object_id: Its object, if known.
    """
    gripper = plan.gripper_for(world)
    if not len(grasps):
        return SceneTrials((TriedGrasp(scene, object_id, 0, grasps, None),), gripper.name)
    seen = _seen(grasps, world)
    table = TableGrasps.from_pixels(grasps[seen], *_camera(world))
    table = table.replace(height_m=_jaws(table.height_m, plan.jaw, gripper))
    if plan.distinct:
        first = _first_of_each(table)
        grasps, seen, table = grasps[seen[first]], np.arange(len(first)), table[first]
    results = run_trials(
        world.tabletop,
        table,
        gripper,
        settings=plan.settings_for(world),
        perturbation=plan.perturbation,
        repeats=plan.repeats,
        seed=_scene_seed(plan.seed, scene),
    )
    depth, rays = surface_depth(grasps.center[seen], *_camera(world))
    ids = [placed.model.id for placed in world.tabletop.objects]
    placed = {
        int(rank): Placed(
            table[i],
            rays[i] * depth[i],
            results[i],
            None if (at := results[i].object_index) is None else ids[at],
        )
        for i, rank in enumerate(seen)
    }
    return SceneTrials(
        tuple(
            TriedGrasp(scene, object_id, rank, grasps[rank], placed.get(rank))
            for rank in range(len(grasps))
        ),
        gripper.name,
    )


def _scene_seed(seed: int, scene: str) -> int:
    """A seed of its own for each scene: errors that all scenes share would never average out."""
    return int.from_bytes(blake2b(f"{seed} {scene}".encode(), digest_size=8).digest())


def _camera(world: SceneWorld) -> tuple[NDArray[np.float32], Camera, RigidTransform]:
    return world.depth_m, world.camera, world.T_world_camera


def _seen(grasps: Grasps, world: SceneWorld) -> NDArray[np.intp]:
    """Numbers of the grasps that lie on the table, not at or above the horizon."""
    try:
        TableGrasps.from_pixels(grasps, *_camera(world))
    except InvalidInputError:
        if len(grasps) == 1:
            return np.empty(0, dtype=np.intp)
        parts = [rank for rank, grasp in enumerate(grasps) if len(_seen(grasp, world))]
        return np.array(parts, dtype=np.intp)
    return np.arange(len(grasps))


def _jaws(sizes_m: NDArray[np.float64], jaw: Jaw | float, gripper: Gripper) -> NDArray[np.float64]:
    """Jaw sizes that are tried."""
    if jaw == "given":
        return sizes_m
    if jaw != "nearest":
        return np.full_like(sizes_m, jaw)
    known = np.asarray(gripper.jaw_sizes_m)
    nearest = known[np.abs(sizes_m[:, None] - known).argmin(axis=1)]
    # A label of the gripper itself is tried with the very size that it was made with.
    return np.where(np.abs(sizes_m - nearest) <= _SAME_JAW * nearest, sizes_m, nearest)


def _first_of_each(table: TableGrasps) -> NDArray[np.intp]:
    """Numbers of the grasps that equal none before them."""
    columns = (table.center_m, table.angle, table.width_m, table.height_m)
    rows = np.column_stack(columns)
    _, first = np.unique(rows, axis=0, return_index=True)
    return np.sort(first)


def blame(error: Exception | None) -> str:
    """Why a scene is left out.

    Raises:
        InvalidInputError: Workers are killed from outside.
        StorageFullError, MemoryError: The machine lacks something.
    """
    assert error is not None  # an answer without result has one
    if isinstance(error, StorageFullError | MemoryError):
        raise error
    if isinstance(error, WorkerDiedError) and error.killed:
        raise InvalidInputError(
            "memory or patience of the system", f"short: {error}", "fewer workers"
        )
    if isinstance(error, GraspmapError):
        return str(error)
    _LOG.error("a defect of graspmap, please report it: %s", error)
    return f"defect: {str(error).strip().rpartition(chr(10))[2]}"


def _tell(skipped: Mapping[str, str]) -> None:
    """Warn of scenes that are left out, those with one reason together."""
    reasons = Counter(skipped.values())
    for reason, count in reasons.most_common(_TOLD):
        names = [name for name, why in skipped.items() if why == reason]
        scenes = f"scene {names[0]} is" if count == 1 else f"{count} scenes ({names[0]}, ...) are"
        _LOG.warning("%s left out: %s", scenes, reason)
    if len(reasons) > _TOLD:
        rest = sum(count for _, count in reasons.most_common()[_TOLD:])
        _LOG.warning("%d more scenes are left out, for other reasons", rest)


def _why(skipped: Mapping[str, str]) -> str:
    """The commonest reason."""
    reasons = Counter(skipped.values()).most_common(1)
    return reasons[0][0] if reasons else "there are no scenes"
