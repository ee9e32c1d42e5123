"""What grasps that are known to hold are worth when pose, friction and mass are a little wrong.

A label held when it was made, with everything known exactly. Here some labels of each scene, drawn
at random, are tried again and again under a perturbation. The best of them, chosen by half of the
repeats and judged by the others, is what a perfect detector could reach under it; one drawn at
random is what a detector reaches that merely tells graspable from not. A detector under the same
errors: ``graspmap evaluate --data D --weights W --trials --perturb 2,2,0.1,0.1 --baseline``.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graspmap.cli.progress import progress
from graspmap.cli.trial_flags import read_perturbation
from graspmap.data import Scenes, read_scenes
from graspmap.evaluation import TrialPlan, labelled_grasps, try_grasps
from graspmap.metrics.intervals import bootstrap_interval
from graspmap.simulation.trial import Perturbation
from studies._report import table, write

ABOUT = "labels under perturbation: what the best detector could reach in trials"

Floats = NDArray[np.float64]


def run(
    data: tuple[str, ...],
    *,
    perturb: str = "2,2,0.1,0.1",
    labels: int = 8,
    repeats: int = 5,
    workers: int = 2,
    seed: int = 0,
    out: Path | None = None,
) -> None:
    """Measure.

    Args:
        data: Data sets with labels and records, such as jacquard:data/v1/test-known.
        perturb: Standard deviations of place (mm), angle (degrees), and, relative, of friction and
            mass.
        labels: Labels of each scene, drawn at random.
        repeats: Perturbed repeats of each that choose, and as many that judge.
        workers: Processes.
        seed: Of labels, errors and intervals.
        out: Where to write the figures as JSON.
    """
    errors = read_perturbation(perturb)
    rows, found = [], {}
    for source in data:
        scenes = read_scenes(source)
        choosing, judging, objects = measure(scenes, errors, labels, repeats, workers, seed)
        best = np.array([j[np.argmax(c)] for c, j in zip(choosing, judging, strict=True)])
        drawn = np.array([j.mean() for j in judging])
        intervals = [
            bootstrap_interval(v, rng=np.random.default_rng(seed), groups=objects)
            for v in (drawn, best)
        ]
        shares = [
            f"{v.mean():.1%} ({low:.1%} to {high:.1%})"
            for v, (low, high) in zip((drawn, best), intervals, strict=True)
        ]
        rows.append([source, len(best), *shares])
        found[source] = {
            "scenes": len(best),
            "drawn": drawn.mean(),
            "drawn_interval": intervals[0],
            "best": best.mean(),
            "best_interval": intervals[1],
        }
    columns = ["data", "scenes", "a label drawn at random holds", f"the best of {labels} holds"]
    table(columns, rows)
    settings = {"perturb": perturb, "labels": labels, "repeats": repeats, "seed": seed}
    write(out, "ceiling", {**settings, "data": found})


def measure(
    scenes: Scenes, errors: Perturbation, labels: int, repeats: int, workers: int, seed: int
) -> tuple[list[Floats], list[Floats], list[str]]:
    """Try some labels of each scene under errors, twice over.

    Returns:
        For each scene (K,) the share of the repeats that held, of those that choose and of those
        that judge, and the scene's object.
    """
    todo = labelled_grasps(scenes, top=labels, seed=seed)
    shares: list[list[Floats]] = []
    objects: dict[str, str] = {}
    for half in range(2):
        plan = TrialPlan(
            top=None,
            ranked=False,
            perturbation=errors,
            repeats=repeats,
            seed=2 * seed + half,  # other errors for those that judge
        )
        with progress(f"{scenes.root.name}, half {half + 1} of 2", per_hour="scenes") as update:
            tried = try_grasps(
                todo.grasps, scenes, plan, skipped=todo.skipped, workers=workers, progress=update
            ).tried
        by_scene: dict[str, list[float]] = defaultdict(list)
        for grasp in tried:
            result = None if grasp.placed is None else grasp.placed.result.success_probability
            by_scene[grasp.scene].append(0.0 if result is None else result)
            objects[grasp.scene] = grasp.object_id or grasp.scene
        shares.append([np.array(held) for held in by_scene.values()])
    return shares[0], shares[1], list(objects.values())
