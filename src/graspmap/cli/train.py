"""``graspmap train``: from an experiment file to a weights file."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from graspmap.cli.frame import (
    UsageError,
    option,
    output_file,
    output_folder,
    parse_known,
    teller,
    write_json,
)
from graspmap.cli.progress import progress

if TYPE_CHECKING:
    from graspmap.training import Experiment


@dataclass(frozen=True)
class Train:
    """Train a network as an experiment file says; the weights land in OUT/weights.safetensors.

    Example:
      graspmap train experiments/ggcnn2-cornell-rgb.yaml --data.source cornell:DIR --out runs/a

    Every value of the file can be replaced by a flag with its dotted key, for example
    --training.epochs 10 or --network.bins 3. The same command goes on where a stopped run ended.
    OUT also holds experiment.yaml, split.json, metrics.jsonl, metrics.csv and tensorboard/.
    """

    experiment: Annotated[tyro.conf.Positional[Path], option("EXPERIMENT.yaml")]
    """The experiment file."""
    out: Annotated[Path, option("DIR", "needed")]
    """Folder of the run."""
    json: Annotated[Path | None, option("F")] = None
    """Write the card of the weights as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap train``."""
    flags, rest = parse_known(Train, argv, "graspmap train")
    words = [word for word in rest if not word.startswith("--")]
    if rest and not rest[0].startswith("--"):
        raise UsageError("graspmap train", f"{words[0]!r} belongs to no flag")
    from graspmap.training import read_experiment

    experiment = read_experiment(flags.experiment, rest)
    output_folder(flags.out, "--out")
    output_file(flags.json, "--json", keep=[flags.experiment])
    command = shlex.join(["graspmap", "train", *argv])
    write_json(train_network(experiment, flags.out, command, teller(flags.json)), flags.json)
    return 0


def train_network(
    experiment: Experiment, out: Path, command: str, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Train as an experiment says, or go on with it, and tell about it.

    Args:
        experiment: What to do.
        out: Folder of the run.
        command: Command line to record in the card.
        tell: Takes the lines about it.

    Returns:
        The card of the weights, as plain values.

    Raises:
        GraspmapError: As `graspmap.training.train`.
    """
    from graspmap.training import train

    card = train(experiment, out, command=command, progress=progress)
    content = card.model_dump(mode="json")
    tell(f"{out / 'weights.safetensors'}: {card.network}, {card.channels}, {card.bins} bin(s)")
    for part in ("validation", "test"):
        if text := _score(content["metrics"].get(part)):
            tell(f"{part}: {text}")
    return content


def _score(metrics: Any) -> str:
    """The success of one part in words; nothing where it was not measured."""
    if not isinstance(metrics, dict) or "0.25" not in (metrics.get("success") or {}):
        return ""
    text = f"success {metrics['success']['0.25']:.1%} at IoU 0.25"
    if "0.25" in (metrics.get("interval") or {}):
        low, high = metrics["interval"]["0.25"]
        text += f" (95 % interval {low:.1%} to {high:.1%})"
    if "scenes" in metrics:
        text += f", {metrics['scenes']} scenes"
    return text + _tasks(metrics)


def _tasks(metrics: dict[str, Any]) -> str:
    """What was measured of the tasks beside grasping, in words."""
    text = ""
    if "category_accuracy" in metrics:
        most = metrics["category_majority"]
        text += (
            f"; category {metrics['category_accuracy']:.1%} right "
            f"({most['test_share']:.1%} by always saying {most['class']!r})"
        )
    if "saliency_mae" in metrics:
        text += f"; saliency off by {metrics['saliency_mae']:.3f}"
    if "depth_mae" in metrics:
        text += f"; depth off by {1000 * metrics['depth_mae']:.1f} mm"
    return text
