"""Parts of ``graspmap evaluate`` beside the rectangles: tasks, speed, trials, baselines."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from graspmap.cli.frame import teller
from graspmap.cli.progress import progress
from graspmap.cli.selection import Selection
from graspmap.cli.trial_flags import detect_to_try

if TYPE_CHECKING:
    from graspmap.cli.evaluate import Evaluate
    from graspmap.data import Scenes
    from graspmap.evaluation import Evaluation, GraspDetector, TrialEvaluation, TrialPlan
    from graspmap.geometry import Grasps


@dataclass(frozen=True, eq=False)
class Tried:
    """Trials, the scenes that they were made on, and what the summary says of them."""

    trials: TrialEvaluation
    scenes: Scenes
    sections: dict[str, Any]


def task_scores(flags: Evaluate, chosen: Selection) -> dict[str, Any] | None:
    """The tasks beside grasping that the network does; None where it does none of them."""
    from graspmap.evaluation.task_scores import evaluate_tasks
    from graspmap.networks import AUXILIARY_TASKS

    detector = chosen.detector
    if detector is None or not {t.name for t in detector.card.tasks} & set(AUXILIARY_TASKS):
        return None
    with progress("measuring tasks beside grasping") as update:
        found = evaluate_tasks(
            detector, chosen.scenes, cluster=flags.cluster, seed=flags.seed, progress=update
        )
    return found.to_dict()


def time_detection(flags: Evaluate, chosen: Selection) -> dict[str, Any]:
    """Latency of detection in a scene of the data, on one thread and on all."""
    from graspmap.evaluation.latency import measure_speed

    assert chosen.detector is not None  # the flags were checked
    threads = tuple(dict.fromkeys((1, os.cpu_count() or 1)))
    speed = measure_speed({"torch": chosen.detector}, chosen.scenes[0], threads=threads)
    for latency in speed.settings:
        total = latency.to_dict()["total"]
        words = f"{latency.threads} thread" + "s" * (latency.threads > 1)
        teller(flags.json)(
            f"detection, {words}: {total['p50_ms']:.1f} ms "
            f"(90 of 100 within {total['p90_ms']:.1f} ms)"
        )
    return speed.to_dict()


def trial_plan(flags: Evaluate) -> TrialPlan:
    """How grasps are tried.

    Raises:
        InvalidInputError: A flag has a wrong value; the error names it.
        FileError: A file that a flag names is missing or damaged.
    """
    return flags.trial.plan(top=flags.top, seed=flags.seed)


def try_in_physics(
    flags: Evaluate, chosen: Selection, source: GraspDetector | dict[str, Grasps]
) -> Tried:
    """The same scenes in physics: what a detector finds, or finished grasps by scene."""
    from graspmap.evaluation import file_predictions
    from graspmap.evaluation.sections import calibration_section, trials_section

    plan = trial_plan(flags)
    if isinstance(source, dict):
        todo = file_predictions(source, chosen.scenes, chosen.everything.ids)
    else:
        todo = detect_to_try(source, chosen.scenes, plan)
    scenes = flags.trial.scenes(flags.data, chosen.scenes.ids)
    own = source is chosen.detector or isinstance(source, dict)
    start = time.perf_counter()
    folder = flags.out if own else None
    trials = flags.trial.attempt(todo, scenes, plan, cluster=flags.cluster, folder=folder)
    sections = {"trials": trials_section(trials, scenes, time.perf_counter() - start)}
    _tell_trials(flags, sections["trials"])
    # Nobody else's quality is meant to be a probability.
    found = calibration_section(trials) if source is chosen.detector else None
    if found is not None:
        sections["calibration"] = found
        low, high = found["ece_interval"]
        teller(flags.json)(
            f"  quality as the probability that it holds: expected calibration error "
            f"{found['ece']:.3f} ({low:.3f} to {high:.3f}), Brier score {found['brier']:.3f}"
        )
    return Tried(trials, scenes, sections)


def measure_baselines(flags: Evaluate, chosen: Selection) -> dict[str, Any]:
    """What needs no learning, by name: rectangles and, where they are asked for, trials."""
    from graspmap.evaluation import center_grasp_baseline, evaluate_detector
    from graspmap.evaluation.shape_baselines import AntipodalGrasp, MomentsGrasp

    split = chosen.split
    known = split is not None and "train" in split.parts
    training = (
        split.subset(chosen.everything, "train") if known and split is not None else chosen.scenes
    )
    source = "the training labels" if known else "these very labels"
    detectors: dict[str, tuple[str, GraspDetector]] = {
        "centre": (
            f"always the centre, angle and opening from {source}",
            center_grasp_baseline(training),
        ),
    }
    if chosen.scenes[0].depth is not None:
        detectors["moments"] = ("across the outline's short axis, at its centroid", MomentsGrasp())
        detectors["antipodal"] = ("best facing points of the outline", AntipodalGrasp())
    found = {}
    for name, (words, detector) in detectors.items():
        with progress(f"baseline {name}") as update:
            result = evaluate_detector(
                detector,
                chosen.scenes,
                protocol="strict" if flags.protocol == "all" else flags.protocol,
                cluster=flags.cluster,
                seed=flags.seed,
                progress=update,
            )
        tell_rectangles(flags, result, f"{words}: ")
        found[name] = {"summary": words, **result.to_dict()}
        if flags.trials:
            found[name]["trials"] = try_in_physics(flags, chosen, detector).sections["trials"]
    return found


def tell_rectangles(flags: Evaluate, result: Evaluation, title: str = "") -> None:
    """Say how rectangles fared: success, overlap, and what other protocols make of them."""
    tell = teller(flags.json)
    score = result.score
    protocol = f"{result.protocol.name} ({result.protocol.summary})"
    tell(f"{title}{result.scenes} scenes of {flags.data}, protocol {protocol}")
    for threshold, success in score.success.items():
        low, high = score.interval[threshold]
        tell(
            f"  IoU {threshold:.2f}  success {success:6.1%}  "
            f"({score.confidence:.0%} interval {low:.1%} to {high:.1%})"
        )
    tell(f"  mean IoU {score.miou:.3f}, AUC {score.auc:.3f}")
    if result.without_prediction:
        tell(f"  {len(result.without_prediction)} scenes without a prediction count as failures")
    for quirk in result.others:
        share = quirk.score.success[min(quirk.score.success)]
        tell(f"  as {quirk.protocol.name}: {share:.1%} ({quirk.protocol.summary})")


def _tell_trials(flags: Evaluate, section: dict[str, Any]) -> None:
    tell = teller(flags.json)
    several, first = len(section["per_rank"]) > 1, section["best"]
    low, high = first["interval"]
    tell(
        f"in trials: the best grasp held in {first['held']} of {first['trials']} scenes, "
        f"{first['success']:.1%} (95% interval {low:.1%} to {high:.1%}); {section['seconds']:.0f} s"
    )
    if several:
        k, reached = list(section["one_of_first"].items())[-1]
        tell(
            f"  one of the first {k} in {reached['success']:.1%}; "
            f"of all {section['trials']} that were tried {section['success']:.1%} held"
        )
    if first["robust_success"] is not None:
        low, high = first["robust_interval"]
        tell(
            f"  the best grasp, perturbed: {first['robust_success']:.1%} "
            f"(95% interval {low:.1%} to {high:.1%})"
        )
    tell(
        "  outcomes of all: " + ", ".join(f"{name} {n}" for name, n in section["outcomes"].items())
    )
    for level, score in section.get("per_difficulty", {}).items():
        tell(
            f"  best grasps, {level}: {score['held']} of {score['trials']}, {score['success']:.1%}"
        )
