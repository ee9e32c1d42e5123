"""Which scenes a command looks at, and with which depth: shared by those that measure weights."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from graspmap.errors import FileError

if TYPE_CHECKING:
    from graspmap.cli.trial_flags import TrialFlags
    from graspmap.data import Scenes
    from graspmap.data.split import Split
    from graspmap.geometry import Grasps
    from graspmap.inference import Detector

_LOG = logging.getLogger(__name__)


class SelectionFlags(Protocol):
    """Flags that say what a command looks at."""

    @property
    def data(self) -> str:
        """``kind:directory``."""

    @property
    def depth(self) -> str | None:
        """Which depth; None: the one that the detector was trained on, else the default."""

    @property
    def split(self) -> str | None:
        """Which part of the data; None: all scenes.

        ``NAME`` of a part of the split.json beside the weights, else of the one in the data's
        folder, or ``FILE.json:NAME``.
        """

    @property
    def weights(self) -> Path | None:
        """Weights that are measured, if any: a file, or the name of shipped ones."""

    @property
    def device(self) -> str:
        """Where their network runs."""

    @property
    def trial(self) -> TrialFlags:
        """How grasps are tried, and whose camera took the pictures."""


@dataclass(frozen=True, eq=False)
class Selection:
    """What a command looks at.

    Attributes:
        everything: All scenes of the data set.
        scenes: Those of the part that was asked for.
        split: The split; None where all scenes were asked for.
        part: Name of the part.
        depth: Which depth the scenes have; None: the default of their kind.
        detector: The detector of the weights that are measured; None where there are none.
    """

    everything: Scenes
    scenes: Scenes
    split: Split | None
    part: str
    depth: str | None
    detector: Detector | None


def select(flags: SelectionFlags) -> Selection:
    """Open a data set, or a part of it, and the weights that are measured on it.

    Raises:
        FileError: Data, weights or split are missing, damaged, or do not belong together.
        InvalidInputError: The device is not available.
    """
    from graspmap.data import KINDS

    depth, weights, detector = flags.depth, flags.weights, None
    everything = flags.trial.read(flags.data, depth)
    if weights is not None:
        from graspmap.inference import Detector, weights_path

        weights = weights_path(weights)
        detector = Detector.load(weights, device=flags.device)
    if depth is None and detector is not None and detector.card.data is not None:
        trained = detector.card.data.depth
        if trained in KINDS[everything.kind].depths:
            _LOG.info("%s depth, as in the training; --depth takes another", trained)
            depth, everything = trained, flags.trial.read(flags.data, trained)
    chosen, part = _split(flags.split, weights, everything)
    scenes = everything if chosen is None else chosen.subset(everything, part)
    return Selection(everything, scenes, chosen, part, depth, detector)


def describe_measured(
    detector: Detector | None,
    weights: Path | None,
    predictions: Path | None,
    given: Mapping[str, Grasps] | None,
) -> dict[str, Any]:
    """What is measured, for JSON: weights, else a predictions file, else the labels.

    Args:
        detector: The weights, loaded; None where there are none.
        weights: Their file.
        predictions: A predictions file.
        given: What was read from it.
    """
    if detector is not None:
        return {"kind": "weights", "file": str(weights), **detector.describe()}
    if given is not None:
        from graspmap.data.jacquard_predictions import predictions_hash

        return {"kind": "predictions", "file": str(predictions), "hash": predictions_hash(given)}
    return {"kind": "labels"}


def _split(flag: str | None, weights: Path | None, scenes: Scenes) -> tuple[Split | None, str]:
    """The split and the part that were asked for."""
    from graspmap.data import read_split

    beside = None if weights is None else weights.with_name("split.json")
    if flag is None:
        if beside is not None and beside.is_file() and _divides(beside, scenes):
            _LOG.warning(
                "%s lies beside the weights: they may have been trained on some of these scenes; "
                "--split test measures the others alone",
                beside,
            )
        return None, ""
    file, colon, part = flag.rpartition(":")
    if colon:
        return read_split(file, scenes), part
    own = scenes.root / "split.json"
    if beside is not None and beside.is_file():
        return read_split(beside, scenes), flag
    if not own.is_file():
        raise FileError(
            beside or own,
            "there is no such split",
            f"name its file: --split FILE.json:{flag}",
        )
    if beside is not None:
        _LOG.warning(
            "no split.json lies beside the weights: they may have been trained on any part of %s",
            own,
        )
    return read_split(own, scenes), flag


def _divides(path: Path, scenes: Scenes) -> bool:
    """Whether a split may be one of these scenes; a damaged one may."""
    from graspmap.data import read_split
    from graspmap.data.split import fingerprint

    try:
        return read_split(path).source == fingerprint(scenes)
    except FileError:
        return True
