"""Grasps of a data set tried in simulation: what the rectangle metric cannot say.

A scene that graspmap generated is rebuilt from its record, exactly as it was; any other scene that
has depth and a camera is rebuilt from them (2.5D).

Letters in shapes: N grasps.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graspmap.data.scene import Scenes
from graspmap.errors import FileError, GraspmapError, InvalidInputError
from graspmap.evaluation.evaluate import (
    Cluster,
    GraspDetector,
    Progress,
    check_ids,
    detect_in,
    to_picture_frame,
)
from graspmap.evaluation.results import as_csv
from graspmap.evaluation.tabletops import scene_world
from graspmap.files import write_text
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper, load_gripper
from graspmap.metrics.trial import TrialScore, group_scores, score_trials
from graspmap.simulation.trial import (
    Perturbation,
    TrialResult,
    TrialSettings,
    run_trials,
)

Jaw = Literal["nearest", "given"]
NO_GRASP = "no_grasp"
"""Outcome of a scene for which no grasp was predicted."""

DEFAULT_GRIPPER = "jacquard"
SUMMARY_FILE = "trials.json"
PER_GRASP_FILE = "per_grasp.csv"

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrialPlan:
    """How grasps of a data set are tried.

    Args:
        gripper: The gripper; None: that of the scene's record, and Jacquard's for other scenes.
        top: How many grasps of a scene are tried, best first; None: all.
        jaw: ``nearest``: the gripper's jaw size that is nearest to the predicted height;
            ``given``: the predicted height.
        settings: Of the simulation; None: the record's, or the defaults.
        perturbation: How unsure pose, friction and mass are.
        repeats: Perturbed repeats of each trial.
        seed: Of the perturbation and of the interval.
    """

    gripper: Gripper | None = None
    top: int | None = 1
    jaw: Jaw = "nearest"
    settings: TrialSettings | None = None
    perturbation: Perturbation | None = None
    repeats: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.top is not None and self.top < 1:
            raise InvalidInputError("top", self.top, "1 or more grasps")
        if self.repeats < 1:
            raise InvalidInputError("repeats", self.repeats, "1 or more")


@dataclass(frozen=True)
class TriedGrasp:
    """One grasp and what became of it.

    Attributes:
        scene: Id of the scene.
        object_id: Its object, if known.
        rank: 0 for the best grasp of its scene.
        grasp: The grasp (N = 1) in pixels of the scene's picture; empty where none was predicted.
        table: The same on the table, metres; None where none was predicted.
        result: The trial; None likewise.
    """

    scene: str
    object_id: str | None
    rank: int
    grasp: Grasps
    table: TableGrasps | None
    result: TrialResult | None

    @property
    def outcome(self) -> str:
        """The trial's outcome, `NO_GRASP` where there was none to try."""
        return NO_GRASP if self.result is None else str(self.result.outcome)

    def row(self) -> dict[str, Any]:
        """A flat row: pixels and radians as in `Grasps`, metres as in `TableGrasps`."""
        row: dict[str, Any] = {
            "scene": self.scene,
            "object_id": self.object_id,
            "rank": self.rank,
            "outcome": self.outcome,
        }
        if self.table is None or self.result is None:
            return row
        grasp, table = self.grasp, self.table
        row |= {
            "x": float(grasp.center[0, 0]),
            "y": float(grasp.center[0, 1]),
            "angle": float(grasp.angle[0]),
            "width": float(grasp.width[0]),
            "height": float(grasp.height[0]),
            "quality": float(grasp.quality[0]),
            "x_m": float(table.center_m[0, 0]),
            "y_m": float(table.center_m[0, 1]),
            "table_angle": float(table.angle[0]),
            "width_m": float(table.width_m[0]),
            "jaw_m": float(table.height_m[0]),
        }
        return row | {k: v for k, v in asdict(self.result).items() if k != "outcome"}


Tried = tuple[list[TriedGrasp], str]
"""Trials of one scene, and the name of the gripper."""


@dataclass(frozen=True, eq=False)
class TrialEvaluation:
    """Trials over a data set.

    Attributes:
        data: The data set, ``kind:directory``.
        score: Success, interval, outcomes, per object.
        tried: Every grasp, by scene and rank.
        skipped: Scenes that could not be rebuilt, with the reason; they count nowhere.
        plan: How they were tried.
        grippers: Names of the grippers used.
        cluster: What the interval takes as independent.
    """

    data: str
    score: TrialScore
    tried: tuple[TriedGrasp, ...]
    skipped: dict[str, str]
    plan: TrialPlan
    grippers: tuple[str, ...]
    cluster: str

    def to_dict(self, per_grasp: Path | str | None = None) -> dict[str, Any]:
        """The summary for JSON.

        Args:
            per_grasp: Where the rows were written, if they were.
        """
        score = self.score
        ranks = [str(tried.rank) for tried in self.tried]
        robust = [
            tried.result.success_probability
            for tried in self.tried
            if tried.result is not None and tried.result.success_probability is not None
        ]
        return {
            "data": self.data,
            "scenes": len({tried.scene for tried in self.tried}),
            "trials": score.trials,
            "held": score.held,
            "success": score.success,
            "interval": list(score.interval),
            "confidence": score.confidence,
            "cluster": self.cluster,
            "object_mean": score.object_mean,
            "outcomes": score.outcomes,
            "per_object": {name: group.to_dict() for name, group in score.per_object.items()},
            "per_rank": {
                rank: group.to_dict()
                for rank, group in group_scores([t.outcome for t in self.tried], ranks).items()
            },
            "robust_success": float(np.mean(robust)) if robust else None,
            "grippers": list(self.grippers),
            "skipped": self.skipped,
            "per_grasp": None if per_grasp is None else str(per_grasp),
        }

    def rows(self) -> list[dict[str, Any]]:
        """One flat row a grasp."""
        return [tried.row() for tried in self.tried]


def predict_scenes(
    detector: GraspDetector,
    scenes: Scenes,
    *,
    top: int = 1,
    progress: Progress | None = None,
) -> dict[str, Grasps]:
    """The best grasps of a detector in every scene, in pixels of each picture.

    Args:
        detector: Sees colour and depth, never the mask or the labels.
        scenes: With the depth that the detector should see.
        top: How many a scene.
        progress: Called after each scene.

    Raises:
        InvalidInputError: A scene lacks what the detector needs.
        FileError: A file of a scene is missing or damaged.
    """
    found = {}
    for index, name in enumerate(scenes.ids):
        found[name] = detect_in(detector, scenes, index, top=top, method="refined")
        if progress is not None:
            progress(index + 1, len(scenes))
    return found


def file_predictions(
    predictions: Mapping[str, Grasps], scenes: Scenes, known_ids: Collection[str] = ()
) -> dict[str, Grasps]:
    """Grasps of a predictions file, in pixels of each picture.

    Args:
        predictions: As `graspmap.data.read_predictions` gives them.
        scenes: The data set, or a part of it.
        known_ids: Scenes that may be predicted beside those; they are left out.

    Raises:
        InvalidInputError: A prediction is for a scene that is not there.
    """
    check_ids(predictions, scenes, known_ids)
    return {
        name: to_picture_frame(predictions[name], scenes, index)
        for index, name in enumerate(scenes.ids)
        if name in predictions
    }


def labelled_grasps(scenes: Scenes) -> dict[str, Grasps]:
    """The labels themselves, as if they were predicted: what share of them holds?

    Scenes without labels are left out.

    Raises:
        InvalidInputError: No scene has labels.
    """
    labels = {name: scenes.read_grasps(index) for index, name in enumerate(scenes.ids)}
    found = {name: grasps for name, grasps in labels.items() if grasps is not None and len(grasps)}
    if not found:
        data = f"{scenes.kind}:{scenes.root}"
        raise InvalidInputError(f"labels of {data}", "none", "scenes with labelled grasps")
    return found


def try_grasps(
    predictions: Mapping[str, Grasps],
    scenes: Scenes,
    plan: TrialPlan | None = None,
    *,
    cluster: Cluster = "scene",
    workers: int = 1,
    progress: Progress | None = None,
) -> TrialEvaluation:
    """Try predicted grasps in physics.

    Args:
        predictions: Grasps by scene id, best first, in pixels of each picture. A scene of
            ``scenes`` without any counts as a failure.
        scenes: The scenes to judge, with exact depth where there is one: it places the grasps,
            and 2.5D scenes are rebuilt from it.
        plan: How; None: the defaults.
        cluster: What the interval takes as independent, ``scene`` or ``object``.
        workers: Processes; the result does not depend on it.
        progress: Called after each scene.

    Raises:
        InvalidInputError: No scene could be rebuilt, or an option is not allowed.
        FileError: A file of a scene is missing or damaged.
    """
    plan = plan or TrialPlan()
    if cluster not in ("scene", "object"):
        raise InvalidInputError("cluster", repr(cluster), "scene, object")
    if workers < 1:
        raise InvalidInputError("workers", workers, "1 or more")
    job = partial(_try_scene, scenes, plan)
    work = [(i, predictions.get(name, Grasps.empty())) for i, name in enumerate(scenes.ids)]
    tried: list[TriedGrasp] = []
    skipped: dict[str, str] = {}
    grippers: set[str] = set()
    for index, outcome in enumerate(_map(job, work, workers)):
        if isinstance(outcome, str):
            skipped[scenes.ids[index]] = outcome
            _LOG.warning("scene %s is left out: %s", scenes.ids[index], outcome)
        else:
            tried += outcome[0]
            grippers |= {outcome[1]} - {""}
        if progress is not None:
            progress(index + 1, len(scenes))
    data = f"{scenes.kind}:{scenes.root}"
    if not tried:
        reason = next(iter(skipped.values()), "there are no scenes")
        raise InvalidInputError(f"scenes of {data}", f"none can be tried ({reason})", "others")
    groups = [tried.scene for tried in tried]
    objects = [tried.object_id or tried.scene for tried in tried]
    score = score_trials(
        [tried.outcome for tried in tried],
        objects,
        rng=np.random.default_rng(plan.seed),
        groups=objects if cluster == "object" else groups,
    )
    return TrialEvaluation(
        data, score, tuple(tried), skipped, plan, tuple(sorted(grippers)), cluster
    )


def write_trials(evaluation: TrialEvaluation, folder: Path | str) -> dict[str, Any]:
    """Write ``trials.json`` and ``per_grasp.csv`` into a folder, which is made if needed.

    Returns:
        What ``trials.json`` holds.

    Raises:
        FileError: The folder cannot be written to or is a file, or the disk is full.
    """
    root = Path(folder)
    if root.exists() and not root.is_dir():
        raise FileError(root, "is a file, not a folder", "name another folder")
    rows = evaluation.rows()
    names = list(dict.fromkeys(key for row in rows for key in row))
    write_text(root / PER_GRASP_FILE, as_csv([{k: row.get(k) for k in names} for row in rows]))
    summary = evaluation.to_dict(root / PER_GRASP_FILE)
    # Last, so that a summary on disk always has its rows beside it.
    write_text(root / SUMMARY_FILE, json.dumps(summary, indent=2) + "\n")
    return summary


def _map(
    job: Callable[[tuple[int, Grasps]], Tried | str],
    work: Sequence[tuple[int, Grasps]],
    workers: int,
) -> Iterator[Tried | str]:
    """The job's results in the order of the work."""
    if workers == 1 or len(work) < 2:
        yield from map(job, work)
        return
    # Spawned, not forked: the parent may hold the threads of PyTorch.
    with ProcessPoolExecutor(min(workers, len(work)), get_context("spawn")) as pool:
        yield from pool.map(job, work, chunksize=1)


def _try_scene(scenes: Scenes, plan: TrialPlan, work: tuple[int, Grasps]) -> Tried | str:
    """Trials of one scene and the name of the gripper; or why it cannot be rebuilt."""
    index, grasps = work
    name, object_id = scenes.ids[index], scenes.object_id(index)
    grasps = grasps if plan.top is None else grasps[: plan.top]
    if not len(grasps):
        return [TriedGrasp(name, object_id, 0, grasps, None, None)], ""
    try:
        world = scene_world(scenes, index)
    except (FileError, MemoryError):
        raise
    except GraspmapError as error:
        return str(error)
    gripper = plan.gripper or world.gripper or load_gripper(DEFAULT_GRIPPER)
    table = TableGrasps.from_pixels(grasps, world.depth_m, world.camera, world.T_world_camera)
    if plan.jaw == "nearest":
        table = replace(table, height_m=_nearest(table.height_m, gripper.jaw_sizes_m))
    results = run_trials(
        world.tabletop,
        table,
        gripper,
        settings=plan.settings or world.settings,
        perturbation=plan.perturbation,
        repeats=plan.repeats,
        seed=plan.seed,
    )
    return [
        TriedGrasp(name, object_id, rank, grasps[rank : rank + 1], table[rank : rank + 1], result)
        for rank, result in enumerate(results)
    ], gripper.name


def _nearest(sizes_m: NDArray[np.float64], known_m: Sequence[float]) -> NDArray[np.float64]:
    known = np.asarray(known_m)
    return np.asarray(known[np.abs(sizes_m[:, None] - known).argmin(axis=1)])
