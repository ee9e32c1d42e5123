"""``graspmap evaluate``: weights or predictions against labelled grasps, and in trials."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from graspmap.cli.evaluate_sections import (
    Tried,
    measure_baselines,
    task_scores,
    tell_rectangles,
    time_detection,
    trial_plan,
    try_in_physics,
)
from graspmap.cli.frame import (
    UsageError,
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
from graspmap.cli.trial_flags import TrialFlags
from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.evaluation import Evaluation
    from graspmap.geometry import Grasps
    from graspmap.metrics import RectangleProtocol


@dataclass(frozen=True)
class Evaluate:
    """Measure weights, or any program's predictions, against the labelled grasps of a data set.

    Examples:
      graspmap evaluate --data cornell:DIR --weights runs/a/weights.safetensors --split test
      graspmap evaluate --data jacquard:DIR --predictions predictions.txt --out report
      graspmap evaluate --data jacquard:DIR --weights W --split test --trials --top 5 --out report
      graspmap evaluate --data cornell:DIR --weights W --split test --protocol all
      graspmap evaluate egad --help          the trials of EGAD's meshes

    A grasp is right when it overlaps a label of a similar angle (30 degrees) by more than the
    threshold. A predictions file has two lines a scene: its id, then x;y;theta;opening;jaw with
    theta in degrees clockwise; further grasps, best first, follow on lines of their own (--top).
    For jacquard they are pixels of the picture enlarged to 1024 px:
    x = (x_px + 0.5) * 1024 / side - 0.5, opening = opening_px * 1024 / side; for other kinds,
    pixels of the picture itself. --out writes such a file of what weights say:
      0_1a9fa4c269cfcc1b738e43095496b061
      470.15;253.90;68.26;25.50;12.80
    """

    data: Annotated[str, option("KIND:DIR", "needed")]
    """The data set, for example jacquard:~/data/jacquard."""
    weights: Annotated[Path | None, option("W")] = None
    """Weights to measure: a file, or the name of shipped ones (`graspmap weights list`)."""
    predictions: Annotated[Path | None, option("F")] = None
    """Predictions file to measure instead."""
    split: Annotated[str | None, option("NAME", "default: all scenes")] = None
    """Part of the data: test, validation or train of the split.json beside the weights (or in the
    data's folder), or FILE.json:NAME."""
    protocol: Annotated[
        Literal["strict", "ggcnn", "orange", "all"], option("P", "default: strict")
    ] = "strict"
    """How grasps are read and counted: strict, or as others do: ggcnn, orange. all: strict, with
    the others and what each of their habits changes beside it."""
    top: Annotated[int, option("K", "default: 1")] = 1
    """How many grasps of a scene are judged: in how many scenes is one of the first K right?"""
    trials: bool = False
    """Try the grasps in simulated physics as well, as `graspmap trial` does: success, outcomes, by
    object and difficulty, and whether quality is the probability that a grasp holds."""
    depth: Annotated[
        str | None, option("NAME", "default: that of the training, else perfect or z")
    ] = None
    """Which depth: perfect or stereo (jacquard), z or range (cornell)."""
    cluster: Annotated[Literal["scene", "object"], option("scene|object", "default: scene")] = (
        "scene"
    )
    """What the intervals take as independent."""
    baseline: bool = False
    """Also measure what needs no learning: always the picture's centre; across the outline's short
    axis; the best facing points of the outline."""
    speed: bool = False
    """Also time the detection, as `graspmap bench` does."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of the intervals."""
    device: Annotated[str, option("NAME", "default: cpu")] = "cpu"
    """Where the network runs: cpu, cuda, ..."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for the report (report.html, evaluation.json, per_scene.csv), of weights also
    predictions.txt, of trials trials.json and per_grasp.csv. Results of before are replaced."""
    json: Annotated[Path | None, option("F")] = None
    """Write the summary as JSON to this file, - for standard output."""
    trial: Annotated[TrialFlags, tyro.conf.OmitArgPrefixes] = field(default_factory=TrialFlags)


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap evaluate``."""
    if list(argv[:1]) == ["egad"]:
        from graspmap.cli import evaluate_egad

        return evaluate_egad.run(argv[1:])
    flags = parse(Evaluate, argv, "graspmap evaluate")
    write_json(measure(flags, shlex.join(["graspmap", "evaluate", *argv])), flags.json)
    return 0


def measure(flags: Evaluate, command: str) -> dict[str, Any]:
    """Measure as the flags say, write the report where they ask for one, and tell about it.

    Args:
        flags: What to measure, and how.
        command: Command line to record in the summary.

    Returns:
        The summary.

    Raises:
        GraspmapError: The flags contradict each other, or the data or the weights cannot be used.
    """
    _check(flags)
    if flags.trials:
        trial_plan(flags)  # a wrong one is told before any work
    from graspmap.data import KINDS
    from graspmap.data.fingerprint import data_hash
    from graspmap.evaluation.run_folder import check_same_detector

    chosen = select(flags)
    predictions = None if flags.predictions is None else _predictions(flags.predictions)
    detector = describe_measured(chosen.detector, flags.weights, flags.predictions, predictions)
    if flags.out is not None and not flags.trials:
        check_same_detector(flags.out, detector, trials=False)
    result = _measure(flags, chosen, predictions)
    tell_rectangles(flags, result)
    sections: dict[str, Any] = {
        "detector": detector,
        "data_hash": data_hash(chosen.everything),
        "command": command,
        "seed": flags.seed,
    }
    if chosen.detector is not None:  # what another program saw is not known
        sections["depth"] = chosen.depth or KINDS[chosen.everything.kind].depths[0]
    tried = None
    if flags.trials:
        tried = try_in_physics(flags, chosen, chosen.detector or predictions or {})
        sections |= tried.sections
    if flags.baseline:
        sections["baselines"] = measure_baselines(flags, chosen)
    tasks = task_scores(flags, chosen)
    if tasks is not None:
        sections["tasks"] = tasks
    if flags.speed:
        sections["speed"] = time_detection(flags, chosen)
    if chosen.split is not None:
        sections["split"] = {"part": chosen.part, "hash": chosen.split.hash}
    return _write(flags, chosen, result, sections, tried)


def _check(flags: Evaluate) -> None:
    if (flags.weights is None) == (flags.predictions is None):
        raise UsageError("graspmap evaluate", "give exactly one of --weights and --predictions")
    if flags.out is not None:
        output_folder(flags.out, "--out")
    output_file(flags.json, "--json", keep=[flags.weights, flags.predictions, flags.trial.camera])
    at_least(0, seed=flags.seed)
    at_least(1, top=flags.top)
    for name, given in (("--speed", flags.speed), ("--device", flags.device != "cpu")):
        if given and flags.weights is None:
            raise InvalidInputError(name, "given", "only with --weights")
    flags.trial.check()
    changed = {f.name for f in fields(flags.trial) if getattr(flags.trial, f.name) != f.default}
    # The network sees with the camera, too.
    unused = sorted(changed - ({"camera"} if flags.weights is not None else set()))
    if unused and not flags.trials:
        flag = "--" + unused[0].replace("_", "-")
        needed = "--trials or --weights" if unused[0] == "camera" else "--trials"
        raise InvalidInputError(flag, "given", f"only with {needed}")


def _predictions(path: Path) -> dict[str, Grasps]:
    from graspmap.data import read_predictions

    return read_predictions(path)


def _measure(
    flags: Evaluate, chosen: Selection, predictions: dict[str, Grasps] | None
) -> Evaluation:
    from graspmap.evaluation import evaluate_detector, evaluate_predictions

    protocol, also = _protocols(flags, finished=predictions is not None)
    with progress("evaluating") as update:
        if chosen.detector is not None:
            return evaluate_detector(
                chosen.detector,
                chosen.scenes,
                protocol=protocol,
                also=also,
                top=flags.top,
                cluster=flags.cluster,
                seed=flags.seed,
                progress=update,
            )
        assert predictions is not None  # there is one of the two
        return evaluate_predictions(
            predictions,
            chosen.scenes,
            known_ids=chosen.everything.ids,
            protocol=protocol,
            also=also,
            top=flags.top,
            cluster=flags.cluster,
            seed=flags.seed,
            progress=update,
        )


def _protocols(flags: Evaluate, *, finished: bool) -> tuple[str, list[RectangleProtocol]]:
    """The protocol, and what is counted beside it; finished grasps can't be read another way."""
    from graspmap.metrics import PROTOCOLS, QUIRKS

    if flags.protocol != "all":
        return flags.protocol, []
    others = [p for p in PROTOCOLS.values() if p.name != "strict"]
    quirks = [q for q in QUIRKS.values() if not (finished and q.needs_detector)]
    return "strict", [*others, *quirks]


def _write(
    flags: Evaluate,
    chosen: Selection,
    result: Evaluation,
    sections: dict[str, Any],
    tried: Tried | None,
) -> dict[str, Any]:
    """The summary; with ``--out`` the folder with the report, too."""
    if flags.out is None:
        return {**result.to_dict(), **sections}
    from graspmap.evaluation import write_trials
    from graspmap.evaluation.report.gallery import make_gallery
    from graspmap.evaluation.report.page import write_report
    from graspmap.evaluation.sections import outcomes_by_scene

    trials = None if tried is None else tried.trials
    if chosen.detector is not None:
        found = {scene.id: scene.grasp for scene in result.results}
        write_found(flags.out / "predictions.txt", found, chosen.scenes)
    if trials is not None:
        write_trials(trials, flags.out, {"detector": sections["detector"]})
    outcomes = None if trials is None else outcomes_by_scene(trials)
    result.write(flags.out, sections, outcomes)  # pictures may fail; numbers stay
    with progress("drawing the report") as update:
        gallery = make_gallery(
            result,
            chosen.scenes,
            detector=chosen.detector,
            trials=trials,
            trial_scenes=None if tried is None else tried.scenes,
            seed=flags.seed,
            progress=update,
        )
    sections = {**sections, "gallery": [exhibit.to_dict() for exhibit in gallery]}
    summary = result.write(flags.out, sections, outcomes)
    report = write_report(flags.out, summary, gallery)
    teller(flags.json)(f"  see {report}")
    return summary
