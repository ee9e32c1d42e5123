"""Sections of an evaluation's summary that are made of trials."""

from __future__ import annotations

from typing import Any

import numpy as np

from graspmap.data.jacquard_labels import read_class_names
from graspmap.data.scene import Scenes
from graspmap.evaluation.difficulty import LEVELS, rank_by_difficulty
from graspmap.evaluation.trial_results import TrialEvaluation, clusters
from graspmap.generation.scene_file import find_record
from graspmap.metrics.calibration import score_calibration
from graspmap.metrics.trial import HELD


def trials_section(trials: TrialEvaluation, scenes: Scenes, seconds: float) -> dict[str, Any]:
    """What the trials say, as in ``trials.json``, with their time, and by difficulty and family.

    Both of these count the best grasp of each scene, and are known of scenes that graspmap made.

    Args:
        trials: The trials.
        scenes: The scenes that they were made on.
        seconds: How long they took.

    Raises:
        FileError: A label file is damaged.
    """
    section = trials.to_dict()
    section["seconds"] = seconds
    families = _families(trials, scenes)
    if len(set(families.values())) > 1:
        section["per_family"] = {
            name: trials.score_of(tuple(t for t in trials.best() if families.get(t.scene) == name))
            for name in sorted(set(families.values()))
        }
    difficulty = rank_by_difficulty(scenes, list(dict.fromkeys(t.scene for t in trials.tried)))
    if difficulty is not None:
        section["difficulty_bounds"] = list(difficulty.bounds)
        section["per_difficulty"] = {
            level: trials.score_of(
                tuple(t for t in trials.best() if difficulty.level.get(t.scene) == level)
            )
            for level in LEVELS
            if level in difficulty.level.values()
        }
    return section


def calibration_section(trials: TrialEvaluation) -> dict[str, Any] | None:
    """Whether the quality of each best grasp is the probability that it holds.

    Qualities are cut to [0, 1]: networks with a linear head leave it a little.

    Returns:
        For JSON; None where no grasp was predicted at all.
    """
    tried = tuple(t for t in trials.best() if len(t.grasp))
    if not tried:
        return None
    quality = np.array([float(t.grasp.quality[0]) for t in tried])
    held = np.array([t.outcome == HELD for t in tried], dtype=np.float64)
    found = score_calibration(
        np.clip(quality, 0.0, 1.0),
        held,
        rng=np.random.default_rng(trials.plan.seed),
        groups=clusters(tried, trials.cluster),
        confidence=trials.score.confidence,
    )
    return found.to_dict()


def outcomes_by_scene(trials: TrialEvaluation) -> dict[str, str]:
    """How the best grasp of each scene ended, by the scene's id."""
    return {t.scene: t.outcome for t in trials.best()}


def _families(trials: TrialEvaluation, scenes: Scenes) -> dict[str, str]:
    """The family of the one object of each scene, as far as a record tells it."""
    positions = {name: index for index, name in enumerate(scenes.ids)}
    found = {}
    for tried in trials.best():
        record = find_record(scenes.files(positions[tried.scene]))
        labels = {} if record is None else read_class_names(record)
        if "general" in labels:
            found[tried.scene] = labels["general"]
    return found
