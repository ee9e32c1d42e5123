"""``graspmap evaluate``: weights or predictions against labelled grasps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from graspmap.cli.frame import option, output_file, output_folder, parse, teller, write_json
from graspmap.cli.progress import progress
from graspmap.cli.selection import select
from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.data import Scenes
    from graspmap.data.split import Split
    from graspmap.evaluation import Evaluation
    from graspmap.inference import Detector


@dataclass(frozen=True)
class Evaluate:
    """Measure weights, or any program's predictions, against the labelled grasps of a data set.

    Examples:
      graspmap evaluate --data cornell:DIR --weights runs/a/weights.safetensors --split test
      graspmap evaluate --data jacquard:DIR --predictions predictions.txt --out report

    A grasp is right when it overlaps a label of a similar angle (30 degrees) by more than the
    threshold. A predictions file has two lines a scene: its id, then x;y;theta;opening;jaw with
    theta in degrees clockwise. For jacquard they are pixels of the picture enlarged to 1024 px:
    x = (x_px + 0.5) * 1024 / side - 0.5, opening = opening_px * 1024 / side; for other kinds,
    pixels of the picture itself. --out writes such a file of what weights say:
      0_1a9fa4c269cfcc1b738e43095496b061
      470.15;253.90;68.26;25.50;12.80
    """

    data: Annotated[str, option("KIND:DIR", "needed")]
    """The data set, for example jacquard:~/data/jacquard."""
    weights: Annotated[Path | None, option("W")] = None
    """Weights file to measure."""
    predictions: Annotated[Path | None, option("F")] = None
    """Predictions file to measure instead."""
    split: Annotated[str | None, option("NAME", "default: all scenes")] = None
    """Part of the data: test, validation or train of the split.json beside the weights, or
    FILE.json:NAME."""
    protocol: Annotated[Literal["strict", "ggcnn", "orange"], option("P", "default: strict")] = (
        "strict"
    )
    """How grasps are read and counted: strict, or as others do: ggcnn, orange."""
    depth: Annotated[
        str | None, option("NAME", "default: that of the training, else perfect or z")
    ] = None
    """Which depth: perfect or stereo (jacquard), z or range (cornell)."""
    cluster: Annotated[Literal["scene", "object"], option("scene|object", "default: scene")] = (
        "scene"
    )
    """What the intervals take as independent."""
    baseline: bool = False
    """Also measure a grasp that is always at the picture's centre."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of the intervals."""
    device: Annotated[str, option("NAME", "default: cpu")] = "cpu"
    """Where the network runs: cpu, cuda, ..."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for evaluation.json, per_scene.csv and, of weights, predictions.txt."""
    json: Annotated[Path | None, option("F")] = None
    """Write the summary as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap evaluate``."""
    flags = parse(Evaluate, argv, "graspmap evaluate")
    if (flags.weights is None) == (flags.predictions is None):
        raise InvalidInputError("--weights and --predictions", "not one of the two", "exactly one")
    if flags.out is not None:
        output_folder(flags.out, "--out")
    output_file(flags.json, "--json", keep=[flags.weights, flags.predictions])
    if flags.seed < 0:
        raise InvalidInputError("--seed", flags.seed, "0 or more")
    chosen = select(
        flags.data,
        depth=flags.depth,
        split=flags.split,
        weights=flags.weights,
        device=flags.device,
    )
    scenes, split, detector = chosen.scenes, chosen.split, chosen.detector
    result = _measure(flags, detector, scenes, chosen.everything)
    if flags.out is not None and detector is not None:
        _write_predictions(flags.out / "predictions.txt", result, scenes)
    summary = result.to_dict() if flags.out is None else result.write(flags.out)
    _tell(flags, result)
    if flags.baseline:
        base = _baseline(flags, scenes, chosen.everything, split)
        summary = {**summary, "baseline": base.to_dict()}
    if split is not None:
        summary = {**summary, "split": {"part": chosen.part, "hash": split.hash}}
    write_json(summary, flags.json)
    return 0


def _measure(
    flags: Evaluate, detector: Detector | None, scenes: Scenes, everything: Scenes
) -> Evaluation:
    from graspmap.evaluation import evaluate_detector, evaluate_predictions

    if detector is None:
        from graspmap.data import read_predictions

        assert flags.predictions is not None  # run() saw to it
        with progress("evaluating") as update:
            return evaluate_predictions(
                read_predictions(flags.predictions),
                scenes,
                known_ids=everything.ids,
                protocol=flags.protocol,
                cluster=flags.cluster,
                seed=flags.seed,
                progress=update,
            )
    with progress("evaluating") as update:
        return evaluate_detector(
            detector,
            scenes,
            protocol=flags.protocol,
            cluster=flags.cluster,
            seed=flags.seed,
            progress=update,
        )


def _write_predictions(path: Path, result: Evaluation, scenes: Scenes) -> None:
    """What the detector said, in the format that ``--predictions`` and Jacquard's server take."""
    from graspmap.data import write_predictions
    from graspmap.data.jacquard import JACQUARD_SIDE_PX
    from graspmap.evaluation import to_predictions

    write_predictions(path, to_predictions(result, scenes), size_px=JACQUARD_SIDE_PX)


def _baseline(
    flags: Evaluate, scenes: Scenes, everything: Scenes, split: Split | None
) -> Evaluation:
    """The centre grasp; angle and opening are those of the training labels where a split says."""
    from graspmap.evaluation import center_grasp_baseline, evaluate_detector

    known = split is not None and "train" in split.parts
    training = split.subset(everything, "train") if known and split is not None else scenes
    result = evaluate_detector(
        center_grasp_baseline(training),
        scenes,
        protocol=flags.protocol,
        cluster=flags.cluster,
        seed=flags.seed,
    )
    source = "the training labels" if known else "these very labels"
    _tell(flags, result, f"always the centre, angle and opening from {source}: ")
    return result


def _tell(flags: Evaluate, result: Evaluation, title: str = "") -> None:
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
