"""``graspmap trial``: grasps tried in physics."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from graspmap.cli.frame import (
    at_least,
    option,
    output_file,
    output_folder,
    parse,
    teller,
    write_json,
)
from graspmap.cli.predictions_file import write_found
from graspmap.cli.progress import progress
from graspmap.cli.selection import Selection, describe_measured, select
from graspmap.cli.trial_flags import TrialFlags, detect_to_try
from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.data import Scenes
    from graspmap.evaluation import GraspsToTry, TrialEvaluation, TrialPlan
    from graspmap.geometry import Grasps

_LOG = logging.getLogger(__name__)
_RANKS = 10
_WORST = 5
"""Objects that are named as the hardest."""


@dataclass(frozen=True)
class Trial:
    """Try grasps in simulated physics: lower the open gripper, close it, lift, and see what holds.

    Examples:
      graspmap trial --data jacquard:DIR --predictions predictions.txt --json trial.json
      graspmap trial --data examples --weights W --top 3 --animate films
      graspmap trial --data jacquard:DIR --labels --top 20 --gripper franka --animate films
      graspmap trial --data jacquard:DIR --weights W --top 5 --shake --perturb 2,2 --out report

    Scenes that `graspmap generate` made are rebuilt from their records. Any other scene with depth
    and a camera is rebuilt from its depth and mask (2.5D): what the camera saw, extruded to the
    table. Outcomes: held; collided (a finger touches on the way down); empty (nothing between the
    fingers); slipped (it left the fingers before it left the table, or moved too far in them);
    dropped (it fell during the lift); no_grasp (nothing was predicted); off_table (above the
    horizon). A scene that cannot be rebuilt is told, and counts nowhere.
    A predictions file is read as by `graspmap evaluate`. With --out a run that was stopped goes on
    where it was.
    """

    data: Annotated[str, option("KIND:DIR", "needed")]
    """The data set, for example jacquard:~/data/jacquard."""
    weights: Annotated[Path | None, option("W")] = None
    """Weights whose grasps are tried: a file, or the name of shipped ones."""
    predictions: Annotated[Path | None, option("F")] = None
    """Predictions file whose grasps are tried instead."""
    labels: bool = False
    """Try the labels themselves instead."""
    top: Annotated[int | None, option("K", "default: 1; all with --labels")] = None
    """How many grasps of a scene are tried, best first; of labels, drawn by --seed."""
    split: Annotated[str | None, option("NAME", "default: all scenes")] = None
    """Part of the data: test, validation or train of the split.json beside the weights (or in the
    data's folder), or FILE.json:NAME."""
    depth: Annotated[str | None, option("NAME", "default: that of the training")] = None
    """Which depth the network sees: perfect or stereo (jacquard), z or range (cornell)."""
    cluster: Annotated[Literal["scene", "object"], option("scene|object", "default: scene")] = (
        "scene"
    )
    """What the interval takes as independent."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of the perturbation, of the drawn labels and of the interval."""
    device: Annotated[str, option("NAME", "default: cpu")] = "cpu"
    """Where the network runs: cpu, cuda, ..."""
    animate: Annotated[Path | None, option("DIR")] = None
    """Folder for small animations (.webp) of some grasps that held and some that failed."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for trials.json, per_grasp.csv and, of weights, predictions.txt. A run that was
    stopped goes on there; results of before are replaced."""
    json: Annotated[Path | None, option("F")] = None
    """Write the summary and every grasp as JSON to this file, - for standard output."""
    trial: Annotated[TrialFlags, tyro.conf.OmitArgPrefixes] = field(default_factory=TrialFlags)


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap trial``."""
    flags = parse(Trial, argv, "graspmap trial")
    _check(flags)
    plan = flags.trial.plan(
        # Of labels, those to try are drawn before.
        top=None if flags.labels else flags.top or 1,
        seed=flags.seed,
        labels=flags.labels,
    )
    from graspmap.evaluation.run_folder import check_same_detector

    chosen = select(flags)
    given = None if flags.predictions is None else _predictions(flags.predictions)
    detector = describe_measured(chosen.detector, flags.weights, flags.predictions, given)
    if flags.out is not None:
        check_same_detector(flags.out, detector, trials=True)
    todo = _grasps(flags, chosen, plan, given)
    from graspmap.evaluation import write_trials

    scenes = flags.trial.scenes(flags.data, chosen.scenes.ids)
    if flags.out is not None and flags.weights is not None:
        write_found(flags.out / "predictions.txt", todo.grasps, scenes)
    result = flags.trial.attempt(todo, scenes, plan, cluster=flags.cluster, folder=flags.out)
    sections: dict[str, Any] = {"detector": detector, "unknown_predictions": len(todo.unknown)}
    if chosen.split is not None:
        sections["split"] = {"part": chosen.part, "hash": chosen.split.hash}
    if flags.out is None:
        summary = {**result.to_dict(), **sections}
    else:
        summary = write_trials(result, flags.out, sections)
    _tell(flags, result)
    if flags.animate is not None:
        summary["animations"] = _animate(flags, result, scenes)
    write_json({**summary, "grasps": result.entries()}, flags.json)
    return 0


def _check(flags: Trial) -> None:
    sources = (flags.weights is not None, flags.predictions is not None, flags.labels)
    if sum(sources) != 1:
        raise InvalidInputError(
            "--weights, --predictions and --labels", f"{sum(sources)} of them", "exactly one"
        )
    if flags.depth is not None and flags.weights is None:
        raise InvalidInputError(
            "--depth",
            flags.depth,
            "only with --weights: it is what the network sees; see --trial-depth",
        )
    at_least(0, seed=flags.seed)
    at_least(1, top=flags.top)
    flags.trial.check()
    for folder, flag in ((flags.out, "--out"), (flags.animate, "--animate")):
        if folder is not None:
            output_folder(folder, flag)
    output_file(flags.json, "--json", keep=[flags.weights, flags.predictions, flags.trial.camera])


def _predictions(path: Path) -> dict[str, Grasps]:
    from graspmap.data import read_predictions

    return read_predictions(path)


def _grasps(
    flags: Trial, chosen: Selection, plan: TrialPlan, given: dict[str, Grasps] | None
) -> GraspsToTry:
    """The grasps to try on each scene."""
    if chosen.detector is not None:
        return detect_to_try(chosen.detector, chosen.scenes, plan)
    from graspmap.evaluation import file_predictions, labelled_grasps

    if given is None:
        return labelled_grasps(chosen.scenes, top=flags.top, seed=flags.seed)
    todo = file_predictions(given, chosen.scenes, chosen.everything.ids)
    if todo.unknown:
        _LOG.warning(
            "%d of %d predictions are for scenes that %s lacks (first %s); they are left out",
            len(todo.unknown),
            len(given),
            flags.data,
            todo.unknown[0],
        )
    return todo


def _tell(flags: Trial, result: TrialEvaluation) -> None:
    tell = teller(flags.json)
    score, summary = result.score, result.to_dict()
    grippers = ", ".join(result.grippers)
    tell(f"{score.trials} grasps in {result.scenes} scenes of {flags.data}, gripper {grippers}")
    tell(
        f"  held {score.held} of {score.trials}: success {_share(score.success, score.interval)}, "
        f"averaged over objects {score.object_mean:.1%}"
    )
    tell("  outcomes: " + ", ".join(f"{name} {n}" for name, n in score.outcomes.items()))
    for line in (_ranks(summary), _robust(summary), _hardest(summary)):
        if line:
            tell(line)
    if result.skipped:
        tell(f"  {len(result.skipped)} scenes could not be tried and count nowhere")
    if flags.out is not None:
        tell(f"  written: {flags.out / 'trials.json'}, {flags.out / 'per_grasp.csv'}")


def _share(share: float, interval: Sequence[float]) -> str:
    low, high = interval
    return f"{share:.1%} (95% interval {low:.1%} to {high:.1%})"


def _ranks(summary: dict[str, Any]) -> str:
    """Success by rank, where several grasps of a scene were tried."""
    ranks = summary.get("per_rank", {})
    if len(ranks) < 2:
        return ""
    shown = list(ranks.values())[:_RANKS]
    shares = ", ".join(f"{rank}: {s['success']:.1%}" for rank, s in enumerate(shown, start=1))
    shares += ", ..." if len(ranks) > _RANKS else ""
    reached = summary["one_of_first"][str(len(ranks))]["success"]
    return f"  by rank {shares}; one of the first {len(ranks)} holds in {reached:.1%} of the scenes"


def _robust(summary: dict[str, Any]) -> str:
    share = summary["robust_success"]
    if share is None:
        return ""
    return f"  robust success, perturbed: {_share(share, summary['robust_interval'])}"


def _hardest(summary: dict[str, Any]) -> str:
    """The objects with the most failures."""
    failing = {k: s for k, s in summary["per_object"].items() if s["held"] < s["trials"]}
    if not failing or len(summary["per_object"]) < 2:
        return ""
    worst = sorted(failing.items(), key=lambda item: item[1]["success"])[:_WORST]
    return "  hardest objects: " + ", ".join(
        f"{name} {s['held']} of {s['trials']}" for name, s in worst
    )


def _animate(flags: Trial, result: TrialEvaluation, scenes: Scenes) -> list[str]:
    """Films of some grasps of each outcome."""
    from graspmap.evaluation import animate_trials

    assert flags.animate is not None  # run() saw to it
    with progress("filming") as update:
        files = animate_trials(result, scenes, flags.animate, progress=update)
    teller(flags.json)(f"  {len(files)} animations in {flags.animate}")
    return [str(file) for file in files]
