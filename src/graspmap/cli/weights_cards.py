"""``graspmap weights list``, ``show`` and ``note``: the cards of weights files."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from graspmap.cli.frame import option, output_file, parse, teller, write_json
from graspmap.errors import FileFormatError, InvalidInputError

if TYPE_CHECKING:
    from graspmap.inference import CalibrationCard, EvaluationCard, WeightsCard

_LOG = logging.getLogger(__name__)
_COLUMNS = ("network", "input", "size", "trial success", "calibration error", "licence")
_UNKNOWN = "-"


@dataclass(frozen=True)
class List:
    """List the weights that ship with graspmap.

    Example:
      graspmap weights list
    """

    json: Annotated[Path | None, option("F")] = None
    """Write their cards as JSON to this file, - for standard output."""


@dataclass(frozen=True)
class Show:
    """Say what the card of a weights file says: what it is for, trained on what, how good it is.

    Example:
      graspmap weights show run/weights.safetensors
    """

    weights: Annotated[tyro.conf.Positional[Path], option("W")]
    """Weights file, or the name of weights that ship."""
    json: Annotated[Path | None, option("F")] = None
    """Write the card as JSON to this file, - for standard output."""


@dataclass(frozen=True)
class Note:
    """Put what was measured of weights, and what is known against them, into their card.

    Example:
      graspmap weights note w.safetensors --evaluation report-known report-tools
      --weakness "openings below 1.5 cm" --licence Apache-2.0 --out noted.safetensors

    An evaluation must be one of these very weights, calibrated as they are. One of a part of data
    that the card has already takes its place.
    """

    weights: Annotated[tyro.conf.Positional[Path], option("W")]
    """Weights file."""
    out: Annotated[Path, option("OUT.safetensors", "needed")]
    """The weights file to write; a readable card is written beside it as .json."""
    evaluation: Annotated[tuple[Path, ...], option("DIR [DIR ...]")] = ()
    """Folders that graspmap evaluate --out wrote."""
    weakness: Annotated[tuple[str, ...], option("TEXT [TEXT ...]")] = ()
    """Where they are known to fail, in words; instead of what the card said."""
    licence: Annotated[str | None, option("SPDX")] = None
    """The licence that they may be used under, for example Apache-2.0."""
    json: Annotated[Path | None, option("F")] = None
    """Write the card as JSON to this file, - for standard output."""


def list_(argv: Sequence[str]) -> None:
    """Run ``graspmap weights list``."""
    flags = parse(List, argv, "graspmap weights list")
    output_file(flags.json, "--json")
    from graspmap.inference import read_card, shipped_weights

    cards = {name: read_card(path) for name, path in shipped_weights().items()}
    tell = teller(flags.json)
    if not cards:
        tell("no weights ship with this graspmap: make some with graspmap train")
    rows: list[tuple[str, ...]] = [
        ("name", "network", "input", "size", "trial success", "calibration error", "licence")
    ]
    rows += [(name, *_row(card)) for name, card in cards.items()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows if cards else []:
        tell("  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip())
    write_json(
        [{"name": name, **card.model_dump(mode="json")} for name, card in cards.items()],
        flags.json,
    )


def show(argv: Sequence[str]) -> None:
    """Run ``graspmap weights show``."""
    flags = parse(Show, argv, "graspmap weights show")
    output_file(flags.json, "--json", keep=[flags.weights])
    from graspmap.inference import load_weights, weights_hash, weights_path
    from graspmap.networks import parameter_count

    path = weights_path(flags.weights)
    network, card = load_weights(path)
    tell = teller(flags.json)
    tell(f"{path}: {card.network}, {parameter_count(network):,} parameters")
    for line in _words(card):
        tell(f"  {line}")
    about: dict[str, Any] = {"file": str(path), "hash": weights_hash(network, card)}
    about["parameters"] = parameter_count(network)
    write_json({**about, **card.model_dump(mode="json")}, flags.json)


def note(argv: Sequence[str]) -> None:
    """Run ``graspmap weights note``."""
    flags = parse(Note, argv, "graspmap weights note")
    if not (flags.evaluation or flags.weakness or flags.licence):
        raise InvalidInputError(
            "what to note", "nothing", "--evaluation DIR, --weakness TEXT, --licence SPDX"
        )
    output_file(flags.out, "--out", (".safetensors",), keep=[flags.weights])
    output_file(flags.json, "--json", keep=[flags.weights, flags.out])
    from graspmap.evaluation.cards import evaluation_card, evaluation_name
    from graspmap.inference import load_weights, save_weights, weights_hash, weights_path

    network, card = load_weights(weights_path(flags.weights))
    measured: dict[str, EvaluationCard] = {}
    for folder in flags.evaluation:
        found = evaluation_card(folder, weights_hash(network, card))
        name = evaluation_name(found, {**card.evaluations, **measured})
        if name in measured:
            problem = f"is of {name}, as an evaluation named before it"
            raise FileFormatError(folder, problem, "name one evaluation for each part of the data")
        measured[name] = found
        fitted = card.calibration
        if fitted is not None and (fitted.data_hash, fitted.part) == (found.data_hash, found.part):
            _LOG.warning("%s: on the scenes of the calibration, so its error is too good", folder)
    card = card.model_copy(
        update={
            "evaluations": {**card.evaluations, **measured},
            "weaknesses": flags.weakness or card.weaknesses,
            "licence": flags.licence or card.licence,
        }
    )
    save_weights(flags.out, network, card)
    tell = teller(flags.json)
    for line in _words(card):
        tell(f"  {line}")
    tell(f"written: {flags.out}")
    write_json(card.model_dump(mode="json"), flags.json)


def _row(card: WeightsCard) -> tuple[str, ...]:
    """A card as one row of the list."""
    success, error = card.trial_success, card.calibration_error
    return (
        card.network,
        card.channels,
        f"{card.size} px",
        _UNKNOWN if success is None else f"{success:.1%}",
        _UNKNOWN if error is None else f"{error:.3f}",
        card.licence or _UNKNOWN,
    )


def _words(card: WeightsCard) -> Iterator[str]:
    """A card in words."""
    view = f"{card.view} px" if isinstance(card.view, int) else card.view
    yield (
        f"sees {card.channels}, {card.size} px square ({view}); {card.bins} orientation bin"
        f"{'s' * (card.bins > 1)}, width scale {card.width_scale_px:g} px"
    )
    if card.tasks:
        yield f"also learned {', '.join(task.name for task in card.tasks)}"
    if card.data is not None:
        data = card.data
        parts = ", ".join(f"{count} {name}" for name, count in data.scenes.items())
        yield (
            f"trained on {data.source}"
            + (f", {data.depth} depth" if data.depth else "")
            + (f" ({parts} scenes)" if parts else "")
            + (f", {data.data_hash}" if data.data_hash else "")
            + ("" if card.seed is None else f", seed {card.seed}")
        )
    if card.command:
        yield f"made by {card.command} ({card.created_by})"
    yield from _calibration(card.calibration)
    for name, measured in card.evaluations.items():
        yield from _evaluation(name, measured)
    for weakness in card.weaknesses:
        yield f"weak: {weakness}"
    if card.notes:
        yield card.notes
    yield f"licence: {card.licence or 'not stated'}"


def _calibration(found: CalibrationCard | None) -> Iterator[str]:
    if found is None:
        yield "quality is the network's own, not a probability (graspmap weights calibrate)"
        return
    low, high = found.after.ece_interval
    unsure = ""
    if found.perturbation is not None:
        unsure = f" of a gripper that errs by {1000 * found.perturbation[0]:g} mm"
    yield (
        f"quality is the probability that the grasp holds: {found.trials} trials{unsure} of "
        f"{found.objects} objects of {found.data} ({found.data_hash}), gripper "
        f"{', '.join(found.grippers)}; expected calibration error {found.after.ece:.3f} "
        f"({low:.3f} to {high:.3f}), {found.before.ece:.3f} before"
    )


def _evaluation(name: str, measured: EvaluationCard) -> Iterator[str]:
    """What was measured on one part of data."""
    yield f"{name} ({measured.scenes} scenes, {measured.data_hash}):"
    trials = measured.trials
    if trials is not None:
        yield (
            f"  trial success {_share(trials.success, trials.interval)} of {trials.trials}, "
            f"gripper {', '.join(trials.grippers)}"
        )
        if trials.quality is not None:
            low, high = trials.quality.ece_interval
            yield f"  expected calibration error {trials.quality.ece:.3f} ({low:.3f} to {high:.3f})"
    rectangles = ", ".join(
        f"{_share(share, measured.interval[threshold])} at {threshold}"
        for threshold, share in measured.success.items()
    )
    yield f"  rectangles ({measured.protocol}): {rectangles}; mean overlap {measured.miou:.3f}"


def _share(share: float, interval: tuple[float, float]) -> str:
    return f"{share:.1%} ({interval[0]:.1%} to {interval[1]:.1%})"
