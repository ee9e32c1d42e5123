"""Training: one strict experiment file in, one weights file with its card out."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from graspmap.config import parse_overrides
from graspmap.training.experiment import Experiment
from graspmap.training.experiment_file import read_experiment

if TYPE_CHECKING:
    from graspmap.training.run import train

__all__ = ["Experiment", "parse_overrides", "read_experiment", "train"]


def __getattr__(name: str) -> Any:
    """`train` loads PyTorch and Lightning at its first use; reading a file needs neither."""
    if name != "train":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return importlib.import_module("graspmap.training.run").train
