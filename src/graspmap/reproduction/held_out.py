"""A trained network on each test part of a recipe: rectangles and trials, scene by scene.

``parts/PART`` of the run's folder then holds what ``graspmap evaluate --trials --out`` leaves, so
`graspmap.evaluation.run_folder` reads it back and ``graspmap compare`` can be pointed at it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from graspmap.evaluation.results import SUMMARY_FILE as EVALUATION_FILE
from graspmap.evaluation.run_folder import MeasuredScene, read_run_folder
from graspmap.evaluation.trial_results import SUMMARY_FILE as TRIALS_FILE
from graspmap.reproduction.plan import Run

if TYPE_CHECKING:
    from graspmap.inference import Detector
    from graspmap.training.callbacks import Progress

PARTS_FOLDER = "parts"

SceneKey = tuple[str, str]
"""Test part, and id of the scene in it."""


def measure_parts(detector: Detector, run: Run, folder: Path, progress: Progress) -> dict[str, Any]:
    """Measure a network on the test parts of its run; parts that are finished are only read.

    The network sees the depth that the experiment tests with. Its best grasp is tried in the scene
    that was recorded, placed with exact depth, with the seed of the trials 0: every network is
    tried alike.

    Args:
        detector: The network.
        run: Says the parts.
        folder: One folder inside for each part.
        progress: Told how far it is.

    Returns:
        The numbers of all test scenes together, and in ``by_part`` those of each part.

    Raises:
        GraspmapError: Scenes or files cannot be read or written, or no grasp of a part tried.
    """
    from graspmap.data import read_scenes
    from graspmap.evaluation import (
        TrialPlan,
        evaluate_detector,
        predict_scenes,
        try_grasps,
        write_trials,
    )

    assert run.experiment.data.test is not None  # parts have one
    for name, source in run.tests.items():
        place = folder / name
        seen = read_scenes(source, depth=run.experiment.data.test.depth)
        if not (place / EVALUATION_FILE).is_file():
            with progress(f"measuring overlaps, {name}") as update:
                evaluate_detector(detector, seen, cluster="object", progress=update).write(place)
        if not (place / TRIALS_FILE).is_file():
            with progress(f"detecting, {name}") as update:
                todo = predict_scenes(detector, seen, progress=update)
            with progress(f"trying grasps, {name}") as update:
                tried = try_grasps(
                    todo.grasps,
                    read_scenes(source),
                    TrialPlan(),
                    skipped=todo.skipped,
                    cluster="object",
                    folder=place,
                    progress=update,
                )
            write_trials(tried, place)
    scenes = read_parts(folder, run.tests)
    by_part = {
        name: _numbers(scene for (part, _), scene in scenes.items() if part == name)
        for name in run.tests
    }
    return {**_numbers(scenes.values()), "by_part": by_part}


def read_parts(folder: Path, names: Iterable[str]) -> Mapping[SceneKey, MeasuredScene]:
    """What was measured in each scene of the test parts.

    Args:
        folder: The folder that `measure_parts` filled.
        names: The parts.

    Raises:
        FileError: A file of it is missing or damaged.
    """
    return {
        (name, scene): measured
        for name in names
        for scene, measured in read_run_folder(folder / name).scenes.items()
    }


def _numbers(scenes: Iterable[MeasuredScene]) -> dict[str, Any]:
    """Means over scenes; over no scene, None."""
    found = list(scenes)
    labelled = [scene for scene in found if scene.iou is not None]
    held = [scene.held for scene in found if scene.held is not None]
    thresholds = labelled[0].right if labelled else ()
    return {
        "scenes": len(found),
        "tried": len(held),
        "success": {t: fmean(scene.right[t] for scene in labelled) for t in thresholds},
        "miou": fmean(scene.iou or 0.0 for scene in labelled) if labelled else None,
        "trials": fmean(held) if held else None,
    }
