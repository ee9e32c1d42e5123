"""``graspmap weights calibrate``: quality becomes the probability that a grasp holds."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from graspmap.cli.frame import at_least, option, output_file, parse, teller, write_json
from graspmap.cli.selection import Selection, select
from graspmap.cli.trial_flags import TrialFlags, detect_to_try

if TYPE_CHECKING:
    from graspmap.evaluation import TrialEvaluation
    from graspmap.inference import CalibrationCard, Detector, QualityCard

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Calibrate:
    """Make the quality of a detector's grasps the probability that they hold.

    Example:
      graspmap weights calibrate run/weights.safetensors --data jacquard:v1/validation
      --out calibrated.safetensors

    The best grasps of each scene are tried in physics, and a rising map is fitted from the
    network's quality to the share that held. The order of grasps stays as it was. Take scenes that
    the network did not learn from, of the gripper and the depth that it is for. How well it works
    is told by cross-fitting: each object's trials are judged by a map that was fitted to the
    others'. Measure it on test scenes afterwards: graspmap evaluate --trials.
    """

    weights: Annotated[tyro.conf.Positional[Path], option("W")]
    """Weights file, or the name of weights that ship."""
    data: Annotated[str, option("KIND:DIR", "needed")]
    """Scenes that the network did not learn from, for example jacquard:~/v1/validation."""
    out: Annotated[Path, option("OUT.safetensors", "needed")]
    """The weights file to write; a readable card is written beside it as .json."""
    split: Annotated[str | None, option("NAME", "default: all scenes")] = None
    """Part of the data: that of the split.json beside the weights, or FILE.json:NAME."""
    depth: Annotated[str | None, option("NAME", "default: that of the training")] = None
    """Which depth the network sees: perfect or stereo (jacquard), z or range (cornell)."""
    top: Annotated[int, option("K", "default: 1")] = 1
    """How many grasps of a scene are tried, best first."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of the perturbation, of the folds and of the intervals."""
    device: Annotated[str, option("NAME", "default: cpu")] = "cpu"
    """Where the network runs: cpu, cuda, ..."""
    json: Annotated[Path | None, option("F")] = None
    """Write the calibration as JSON to this file, - for standard output."""
    trial: Annotated[TrialFlags, tyro.conf.OmitArgPrefixes] = field(default_factory=TrialFlags)


def calibrate(argv: Sequence[str]) -> None:
    """Run ``graspmap weights calibrate``."""
    flags = parse(Calibrate, argv, "graspmap weights calibrate")
    write_json(calibrate_weights(flags).model_dump(mode="json"), flags.json)


def calibrate_weights(flags: Calibrate) -> CalibrationCard:
    """Calibrate as the flags say, write the weights, and tell about it.

    Raises:
        GraspmapError: The flags contradict each other, the data or the weights cannot be used, or
            the detector finds nothing to try.
    """
    at_least(0, seed=flags.seed)
    at_least(1, top=flags.top)
    flags.trial.check()
    output_file(flags.out, "--out", (".safetensors",), keep=[flags.weights])
    output_file(
        flags.json, "--json", keep=[flags.weights, flags.out, flags.out.with_suffix(".json")]
    )
    from graspmap.evaluation.cards import calibrate as fit
    from graspmap.evaluation.cards import check_not_trained_on
    from graspmap.inference import Detector, save_weights

    chosen = select(flags)
    assert chosen.detector is not None  # there are weights
    card = chosen.detector.card
    check_not_trained_on(card.data, chosen.everything, chosen.split, chosen.part)
    network = chosen.detector.network
    plain = Detector(network, card.model_copy(update={"calibration": None}), device=flags.device)
    found = fit(
        _try(flags, chosen, plain),
        chosen.everything,
        part=chosen.part or None,
        depth=chosen.depth,
        seed=flags.seed,
    )
    if card.evaluations:
        _LOG.warning("what the card notes of evaluations was measured before; it is left out")
    card = card.model_copy(update={"calibration": found, "evaluations": {}})
    save_weights(flags.out, network, card)
    _tell(flags, found)
    return found


def _try(flags: Calibrate, chosen: Selection, detector: Detector) -> TrialEvaluation:
    """The best grasps of each scene in physics."""
    plan = flags.trial.plan(top=flags.top, seed=flags.seed)
    todo = detect_to_try(detector, chosen.scenes, plan)
    scenes = flags.trial.scenes(flags.data, chosen.scenes.ids)
    return flags.trial.attempt(todo, scenes, plan, cluster="object")


def _tell(flags: Calibrate, found: CalibrationCard) -> None:
    tell = teller(flags.json)
    tell(
        f"{found.trials} trials of {found.objects} objects, gripper {', '.join(found.grippers)}: "
        f"{found.held} held"
    )
    tell(f"  quality as it was:  {_errors(found.before)}")
    tell(f"  calibrated:         {_errors(found.after)}, cross-fitted over objects")
    knots = ", ".join(f"{quality:.2f}: {held:.0%}" for quality, held in found.knots)
    tell(f"  quality to probability that it holds: {knots}")
    tell(f"  written: {flags.out}")


def _errors(score: QualityCard) -> str:
    (low, high), (least, most) = score.ece_interval, score.brier_interval
    return (
        f"expected calibration error {score.ece:.3f} ({low:.3f} to {high:.3f}), "
        f"Brier score {score.brier:.3f} ({least:.3f} to {most:.3f})"
    )
