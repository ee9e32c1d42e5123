"""Reading an experiment file: strict YAML, flags over it, and errors that say what is right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from graspmap.config import read_model
from graspmap.training.experiment import Experiment


def read_experiment(
    path: Path | str, overrides: Mapping[str, Any] | Sequence[str] = ()
) -> Experiment:
    """Read an experiment file.

    Args:
        path: YAML file.
        overrides: Values that replace those of the file: by dotted key, or the flags of a command
            line such as ``["--training.epochs", "10"]``.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: The file is no YAML mapping.
        ConfigError: A key or a value is wrong; the error names the nearest key, or what is
            allowed.
    """
    return read_model(
        path, Experiment, what="experiment", example="one in experiments/", overrides=overrides
    )
