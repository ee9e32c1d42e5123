"""``graspmap trial``: grasps tried in physics."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from graspmap.cli.frame import (
    numbers,
    option,
    output_file,
    output_folder,
    parse,
    teller,
    write_json,
)
from graspmap.cli.progress import progress
from graspmap.cli.selection import Selection, select
from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.evaluation import TrialEvaluation, TrialPlan
    from graspmap.geometry import Grasps


@dataclass(frozen=True)
class Trial:
    """Try grasps in simulated physics: lower the open gripper, close it, lift, and see what holds.

    Examples:
      graspmap trial --data jacquard:DIR --predictions predictions.txt --json trial.json
      graspmap trial --data jacquard:demo/scenes --weights demo/run/weights.safetensors --split test
      graspmap trial --data jacquard:DIR --labels --top 20 --gripper franka --animate films

    Scenes that `graspmap generate` made are rebuilt from their records. Any other scene with depth
    and a camera is rebuilt from its depth and mask (2.5D): what the camera saw, extruded to the
    table. Outcomes: held; collided (a finger touches on the way down); empty (nothing between the
    fingers); slipped (it left the fingers before it left the table, or moved too far in them);
    dropped (it fell during the lift); no_grasp (nothing was predicted).
    A predictions file is read as by `graspmap evaluate`.
    """

    data: Annotated[str, option("KIND:DIR", "needed")]
    """The data set, for example jacquard:~/data/jacquard."""
    weights: Annotated[Path | None, option("W")] = None
    """Weights whose grasps are tried."""
    predictions: Annotated[Path | None, option("F")] = None
    """Predictions file whose grasps are tried instead."""
    labels: bool = False
    """Try the labels themselves instead."""
    gripper: Annotated[str | None, option("G", "default: that of the data, else jacquard")] = None
    """Name of a profile (`graspmap gripper list`) or a YAML file."""
    top: Annotated[int | None, option("K", "default: 1; all with --labels")] = None
    """How many grasps of a scene are tried, best first."""
    jaw: Annotated[Literal["nearest", "given"], option("nearest|given", "default: nearest")] = (
        "nearest"
    )
    """Jaw size: the gripper's nearest to the predicted one, or the predicted one itself."""
    split: Annotated[str | None, option("NAME", "default: all scenes")] = None
    """Part of the data: test, validation or train of the split.json beside the weights, or
    FILE.json:NAME."""
    depth: Annotated[str | None, option("NAME", "default: that of the training")] = None
    """Which depth the network sees: perfect or stereo (jacquard), z or range (cornell)."""
    shake: bool = False
    """Shake the gripper after the lift: weak grips lose."""
    repeats: Annotated[int, option("N", "default: 1")] = 1
    """Repeats with --perturb; their share that held is the robust success."""
    perturb: Annotated[str | None, option("MM,DEG[,FRICTION,MASS]", "default: none")] = None
    """Standard deviations of the grasp's place (mm), its angle (degrees), and, relative, of
    friction and mass: 2,2,0.1,0.1."""
    cluster: Annotated[Literal["scene", "object"], option("scene|object", "default: scene")] = (
        "scene"
    )
    """What the interval takes as independent."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of the perturbation and of the interval."""
    workers: Annotated[int, option("N", "default: number of cores")] = 0
    """Processes; the result does not depend on it."""
    device: Annotated[str, option("NAME", "default: cpu")] = "cpu"
    """Where the network runs: cpu, cuda, ..."""
    animate: Annotated[Path | None, option("DIR")] = None
    """Folder for small animations (.webp) of some grasps that held and some that failed."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for trials.json and per_grasp.csv."""
    json: Annotated[Path | None, option("F")] = None
    """Write the summary as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap trial``."""
    flags = parse(Trial, argv, "graspmap trial")
    _check(flags)
    plan = _plan(flags)
    chosen, predictions = _predictions(flags)
    result = _try(flags, plan, chosen, predictions)
    from graspmap.evaluation import write_trials

    summary = result.to_dict() if flags.out is None else write_trials(result, flags.out)
    if chosen.split is not None:
        summary = {**summary, "split": {"part": chosen.part, "hash": chosen.split.hash}}
    summary["grasps"] = result.rows()
    _tell(flags, result)
    if flags.animate is not None:
        summary["animations"] = _animate(flags, result, chosen)
    write_json(summary, flags.json)
    return 0


def _check(flags: Trial) -> None:
    sources = (flags.weights is not None, flags.predictions is not None, flags.labels)
    if sum(sources) != 1:
        raise InvalidInputError(
            "--weights, --predictions and --labels", f"{sum(sources)} of them", "exactly one"
        )
    for name, value, least in (("--seed", flags.seed, 0), ("--repeats", flags.repeats, 1)):
        if value < least:
            raise InvalidInputError(name, value, f"{least} or more")
    if flags.top is not None and flags.top < 1:
        raise InvalidInputError("--top", flags.top, "1 or more")
    if flags.workers < 0:
        raise InvalidInputError("--workers", flags.workers, "1 or more, 0 for every core")
    if flags.repeats > 1 and flags.perturb is None:
        raise InvalidInputError(
            "--repeats", flags.repeats, "1 without --perturb: unperturbed repeats are all the same"
        )
    for folder, flag in ((flags.out, "--out"), (flags.animate, "--animate")):
        if folder is not None:
            output_folder(folder, flag)
    output_file(flags.json, "--json", keep=[flags.weights, flags.predictions])


def _plan(flags: Trial) -> TrialPlan:
    import math

    from graspmap.evaluation import TrialPlan
    from graspmap.gripper import load_gripper
    from graspmap.simulation.trial import Perturbation, Shake, TrialSettings

    perturbation = None
    if flags.perturb is not None:
        short = len(flags.perturb.split(",")) == 2
        values = numbers(
            flags.perturb + (",0,0" if short else ""), "MM,DEG,FRICTION,MASS", "--perturb"
        )
        perturbation = Perturbation(
            position_m=values[0] / 1000,
            angle_rad=math.radians(values[1]),
            friction=values[2],
            mass=values[3],
        )
    top = flags.top if flags.top is not None or flags.labels else 1
    return TrialPlan(
        gripper=None if flags.gripper is None else load_gripper(flags.gripper),
        top=top,
        jaw=flags.jaw,
        settings=TrialSettings(shake=Shake()) if flags.shake else None,
        perturbation=perturbation,
        repeats=flags.repeats,
        seed=flags.seed,
    )


def _predictions(flags: Trial) -> tuple[Selection, dict[str, Grasps]]:
    """The scenes, and the grasps to try on each in pixels of its picture."""
    from graspmap.evaluation import file_predictions, labelled_grasps, predict_scenes

    if flags.weights is None:
        chosen = select(flags.data, depth=flags.depth, split=flags.split)
        if flags.predictions is None:
            return chosen, labelled_grasps(chosen.scenes)
        from graspmap.data import read_predictions

        given = read_predictions(flags.predictions)
        return chosen, file_predictions(given, chosen.scenes, chosen.everything.ids)
    chosen = select(
        flags.data,
        depth=flags.depth,
        split=flags.split,
        weights=flags.weights,
        device=flags.device,
    )
    assert chosen.detector is not None  # there are weights
    with progress("detecting") as update:
        top = flags.top or 1
        return chosen, predict_scenes(chosen.detector, chosen.scenes, top=top, progress=update)


def _try(
    flags: Trial, plan: TrialPlan, chosen: Selection, predictions: dict[str, Grasps]
) -> TrialEvaluation:
    from graspmap.data import read_scenes
    from graspmap.evaluation import try_grasps

    # The exact depth, whatever the network saw: it says where things really are.
    scenes = read_scenes(flags.data).subset(chosen.scenes.ids)
    workers = flags.workers or os.cpu_count() or 1
    with progress("trying grasps, scenes") as update:
        return try_grasps(
            predictions, scenes, plan, cluster=flags.cluster, workers=workers, progress=update
        )


def _tell(flags: Trial, result: TrialEvaluation) -> None:
    tell = teller(flags.json)
    score = result.score
    low, high = score.interval
    scenes = len({tried.scene for tried in result.tried})
    tell(f"{score.trials} grasps in {scenes} scenes of {flags.data}, {', '.join(result.grippers)}")
    tell(
        f"  held {score.held} of {score.trials}: success {score.success:.1%} "
        f"({score.confidence:.0%} interval {low:.1%} to {high:.1%}), "
        f"averaged over objects {score.object_mean:.1%}"
    )
    tell("  outcomes: " + ", ".join(f"{name} {n}" for name, n in score.outcomes.items()))
    robust = result.to_dict()["robust_success"]
    if robust is not None:
        tell(f"  robust success {robust:.1%} over {flags.repeats} perturbed repeats of each")
    worst = sorted(score.per_object.items(), key=lambda item: item[1].success)
    if len(worst) > 1:
        tell(
            "  hardest objects: "
            + ", ".join(f"{name} {s.held} of {s.trials}" for name, s in worst[:5])
        )
    if result.skipped:
        tell(f"  {len(result.skipped)} scenes could not be rebuilt and count nowhere")


def _animate(flags: Trial, result: TrialEvaluation, chosen: Selection) -> list[str]:
    """Films of some grasps of each outcome."""
    from graspmap.evaluation import animate_trials

    assert flags.animate is not None  # run() saw to it
    with progress("filming") as update:
        files = animate_trials(result, chosen.scenes, flags.animate, progress=update)
    teller(flags.json)(f"  {len(files)} animations in {flags.animate}")
    return [str(file) for file in files]
