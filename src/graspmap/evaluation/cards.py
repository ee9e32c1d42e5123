"""What goes into the card of a weights file after training: its calibration, its evaluations.

Letters in shapes: T trials.
"""

from __future__ import annotations

import logging
from collections.abc import Hashable, Mapping
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.data.fingerprint import data_hash
from graspmap.data.kinds import split_spec
from graspmap.data.scene import Scenes
from graspmap.data.split import Split
from graspmap.errors import FileFormatError, InvalidInputError, MissingFileError
from graspmap.evaluation import results
from graspmap.evaluation.compare import best_trials
from graspmap.evaluation.run_folder import RunFolder, read_run_folder
from graspmap.evaluation.trial_results import TrialEvaluation, clusters
from graspmap.inference.measured import (
    CalibrationCard,
    EvaluationCard,
    QualityCard,
    TrialsCard,
)
from graspmap.inference.weights import DataCard
from graspmap.metrics.calibration import score_calibration
from graspmap.metrics.quality_map import cross_fitted, fit_quality_map
from graspmap.metrics.trial import HELD

Floats = NDArray[np.float64]

_LOG = logging.getLogger(__name__)
_AGAIN = "measure these weights: graspmap evaluate --weights W --trials --out DIR"
_ENDS = ("ece_interval", "brier_interval")


def check_not_trained_on(
    trained: DataCard | None, scenes: Scenes, split: Split | None, part: str
) -> None:
    """Refuse scenes that a network was trained on: its quality is too good there.

    Args:
        trained: What its card says of the training; None: nothing.
        scenes: All scenes of the data set.
        split: The split that a part of them was taken by; None: all are looked at.
        part: Name of the part.

    Raises:
        InvalidInputError: The card says that the network learned from some of them.
    """
    if trained is None:
        return
    if trained.test_source is not None and _same(trained.test_source, scenes):
        _LOG.warning("%s are its test scenes: fit on validation, test on others", scenes.root)
    # A copy of the data elsewhere is the same data.
    copied = trained.data_hash is not None and trained.data_hash == data_hash(scenes)
    if not (copied or _same(trained.source, scenes)):
        return
    allowed = "scenes that it did not learn from: on the others its quality is too good"
    if trained.validation_source is not None:
        allowed += f"; it was validated on {trained.validation_source}"
        raise InvalidInputError("--data", f"{trained.source}, its training part", allowed)
    if trained.split_hash is None:
        return
    if split is None or split.hash != trained.split_hash:
        found = "all scenes" if split is None else "by another split"
        allowed += "; --split validation of the split.json of its training"
        raise InvalidInputError("--split", f"{found} of the data that it was trained on", allowed)
    if part == "train":
        raise InvalidInputError("--split", "train, its training part", allowed)
    if part == "test":
        _LOG.warning("these are its test scenes: fit on validation, test on others")


def calibrate(
    trials: TrialEvaluation,
    scenes: Scenes,
    *,
    part: str | None = None,
    depth: str | None = None,
    seed: int = 0,
) -> CalibrationCard:
    """Fit the map from quality to the probability that a grasp holds.

    Where grasps were perturbed, each repeat counts as a trial: the probability is then that of a
    gripper as unsure as that.

    Args:
        trials: Trials of a detector's grasps, with the network's own quality.
        scenes: All scenes of the data set.
        part: Part of them that was tried.
        depth: The depth that the network saw.
        seed: Of the folds and the intervals.

    Raises:
        InvalidInputError: Not one grasp was tried, or all are of one object.
        FileError: The data's manifest cannot be read.
    """
    quality, held, objects = _outcomes(trials)
    if not len(quality):
        raise InvalidInputError("grasps tried", 0, "some: the detector found none")
    after = cross_fitted(quality, held, rng=np.random.default_rng(seed), groups=objects)
    perturbation = trials.plan.perturbation
    return CalibrationCard(
        knots=fit_quality_map(quality, held).knots,
        data=trials.data,
        data_hash=data_hash(scenes),
        part=part,
        depth=depth,
        grippers=trials.grippers,
        perturbation=None if perturbation is None else astuple(perturbation),
        top=trials.plan.top or 1,
        trials=len(quality),
        objects=len(set(objects)),
        held=int(held.sum()),
        before=_score(np.clip(quality, 0.0, 1.0), held, objects, seed),
        after=_score(after, held, objects, seed),
    )


def evaluation_card(folder: Path | str, weights_hash: str) -> EvaluationCard:
    """The headline numbers of an evaluation of some weights.

    Args:
        folder: What ``graspmap evaluate --out`` wrote.
        weights_hash: Of the weights, see `graspmap.inference.weights_hash`.

    Raises:
        MissingFileError: There is no evaluation in the folder.
        FileFormatError: It is damaged, or one of other weights.
    """
    run = read_run_folder(folder)
    path = run.folder / results.SUMMARY_FILE
    if not path.is_file():
        raise MissingFileError(path, "is missing: the folder holds trials alone", _AGAIN)
    found = run.summary.get("detector") or {}
    if found.get("hash") != weights_hash or "data_hash" not in run.summary:
        raise FileFormatError(
            path, "was not measured with these weights, calibrated as they are", _AGAIN
        )
    part = (run.summary.get("split") or {}).get("part")
    interval = {
        key: (float(low), float(high)) for key, (low, high) in run.summary["interval"].items()
    }
    return EvaluationCard(
        data=run.data,
        data_hash=run.summary["data_hash"],
        part=part,
        scenes=run.summary["scenes"],
        protocol=run.summary["protocol"],
        success=run.summary["success"],
        interval=interval,
        miou=run.summary["miou"],
        cluster=run.cluster,
        trials=_trials_card(run),
    )


def evaluation_name(card: EvaluationCard, known: Mapping[str, EvaluationCard]) -> str:
    """What an evaluation is called in a card: the data's folder and, where it was, ``:`` its part.

    Args:
        card: The evaluation.
        known: Those that the card has, by name; as much of the folder's path is taken as tells this
            one apart from those of other data.
    """
    folder = split_spec(card.data)[1]
    # Where "." was, nobody knows any more.
    parts = [p for p in folder.parts if p not in (folder.anchor, "..")] or [card.data_hash]
    part = f":{card.part}" if card.part else ""
    names = ["/".join(parts[-length:]) + part for length in range(1, len(parts) + 1)]
    for name in names:
        other = known.get(name)
        if other is None or other.data == card.data or other.data_hash == card.data_hash:
            return name
    return f"{names[0]} ({card.data_hash})"


def _same(source: str, scenes: Scenes) -> bool:
    """Whether the name of a data set is that of these scenes."""
    return split_spec(source)[1].resolve() == scenes.root.resolve()


def _outcomes(trials: TrialEvaluation) -> tuple[Floats, Floats, list[Hashable]]:
    """(T,) quality, (T,) whether it held, and T objects, of every trial of a grasp."""
    quality: list[float] = []
    held: list[float] = []
    objects: list[Hashable] = []
    for tried, group in zip(trials.tried, clusters(trials.tried, "object"), strict=True):
        if not len(tried.grasp):
            continue
        ends = [float(tried.outcome == HELD)]
        if trials.plan.perturbation is not None:
            share = None if tried.placed is None else tried.placed.result.success_probability
            good = round((share or 0.0) * trials.plan.repeats)
            ends = [1.0] * good + [0.0] * (trials.plan.repeats - good)
        quality += [float(tried.grasp.quality[0])] * len(ends)
        held += ends
        objects += [group] * len(ends)
    return np.array(quality), np.array(held), objects


def _score(quality: Floats, held: Floats, objects: list[Hashable], seed: int) -> QualityCard:
    score = score_calibration(quality, held, rng=np.random.default_rng(seed), groups=objects)
    return _quality_card(score.to_dict())


def _quality_card(score: Mapping[str, Any]) -> QualityCard:
    ends = {key: (float(score[key][0]), float(score[key][1])) for key in _ENDS}
    return QualityCard(ece=score["ece"], brier=score["brier"], **ends)


def _trials_card(run: RunFolder) -> TrialsCard | None:
    """Trials of each scene's best grasp; None where none were made."""
    score = best_trials(run, by_object=run.cluster == "object")
    if score is None:
        return None
    quality = run.summary.get("calibration")
    return TrialsCard(
        trials=score.trials,
        success=score.success,
        interval=score.interval,
        grippers=tuple(run.summary["trials"]["grippers"]),
        quality=None if quality is None else _quality_card(quality),
    )
