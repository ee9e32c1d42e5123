"""Smaller versions of the published training, and what was made smaller, in words."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from graspmap.training import Experiment

_SILENT = ("name", "seed", "data.source", "data.validation", "data.test",
           "data.cache_dir", "data.split.fold", "training.workers", "training.device",
           "training.checkpoint_minutes")  # fmt: skip
"""Keys whose change makes nothing smaller."""


def shrink(experiment: Experiment, scale: float, batches: int) -> Experiment:
    """An experiment with ``scale`` times the training steps.

    Epochs and batches an epoch shrink alike, each by the square root of ``scale``, and stay 1 or
    more; everything else stays, the input size too.

    Args:
        experiment: The published one.
        scale: Share of the steps, above 0 and up to 1.
        batches: Batches an epoch where the experiment goes once over its training part.
    """
    if scale == 1:
        return experiment
    training, root = experiment.training, math.sqrt(scale)
    smaller = {
        "epochs": max(1, round(training.epochs * root)),
        "batches_per_epoch": max(1, round((training.batches_per_epoch or batches) * root)),
    }
    return experiment.model_copy(update={"training": training.model_copy(update=smaller)})


def differences(pairs: Iterable[tuple[Experiment, Experiment]]) -> Mapping[str, tuple[Any, Any]]:
    """What the runs change against the thesis, by dotted key: (published, run).

    Args:
        pairs: (published, run) of each cell of a table.
    """
    found: dict[str, tuple[Any, Any]] = {}
    for published, run in pairs:
        before, after = published.flat(), run.flat()
        for key in after.keys() | before.keys():
            if before.get(key) != after.get(key) and not key.startswith(_SILENT):
                found.setdefault(key, (before.get(key), after.get(key)))
    return dict(sorted(found.items()))
