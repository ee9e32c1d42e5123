"""What a run leaves behind while it goes on: checkpoints, metrics, and a word to whoever waits.

Checkpoints replace each other whole, and a row of metrics is written before the checkpoint that
contains its epoch; on resuming, rows past the checkpoint are dropped. So a run that is killed at
any moment goes on with no row missing and none doubled.
"""

from __future__ import annotations

import csv
import io
import json
import logging
import math
import re
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins.io import CheckpointIO
from lightning.pytorch.callbacks import Callback, Checkpoint

from graspmap.errors import FileFormatError, MissingFileError
from graspmap.files import read_lines, write_bytes, write_text
from graspmap.training.experiment import Experiment
from graspmap.training.module import GraspModule
from graspmap.training.tasks import METRICS, loss_names, metric_names

Progress = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Called with a title; gives a context whose value is called with (done, total)."""

_REMEDY = "delete the folder and train anew, or restore the file from a backup"
_logger = logging.getLogger(__name__)


def columns(experiment: Experiment | None = None) -> tuple[str, ...]:
    """Columns of metrics.csv; epoch 0 is the untrained network.

    Args:
        experiment: Whose; None for all that there can be.
    """
    return (
        "epoch",
        "step",
        *(f"train_{name}" for name in loss_names(experiment)),
        *(f"validation_{name}" for name in loss_names(experiment)),
        "success",
        "miou",
        *metric_names(experiment),
        "learning_rate",
        "seconds",
    )


def no_progress(title: str) -> AbstractContextManager[Callable[[int, int], None]]:
    """The `Progress` that tells nobody."""
    del title
    return nullcontext(_unheard)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint of `Checkpoints` onto the CPU, without running any code in it.

    Raises:
        MissingFileError: There is none.
        FileFormatError: It is damaged or not one of ours.
    """
    try:
        # A file object, and no memory map: the file may be replaced while tensors are in use.
        with path.open("rb") as file:
            checkpoint = torch.load(file, map_location="cpu", weights_only=True)
    except FileNotFoundError as error:
        raise MissingFileError(path, "no such checkpoint", _REMEDY) from error
    except Exception as error:  # torch.load raises whatever the damaged bytes lead to
        raise FileFormatError(path, "damaged checkpoint", _REMEDY) from error
    if not isinstance(checkpoint, dict) or "graspmap" not in checkpoint:
        raise FileFormatError(path, "is no checkpoint of graspmap", _REMEDY)
    return checkpoint


class WholeFiles(CheckpointIO):
    """Lightning's door to the disk: whole files only, and never code."""

    def save_checkpoint(
        self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None
    ) -> None:
        """Write a checkpoint."""
        del storage_options
        # PyTorch hides a full disk in an error of its own, so its bytes go through memory.
        buffer = io.BytesIO()
        torch.save(checkpoint, buffer)
        write_bytes(Path(path), buffer.getvalue(), durable=True)

    def load_checkpoint(
        self, path: Any, map_location: Any = None, weights_only: bool | None = None
    ) -> dict[str, Any]:
        """Read a checkpoint."""
        del map_location, weights_only
        return load_checkpoint(Path(path))

    def remove_checkpoint(self, path: Any) -> None:
        """Delete a checkpoint."""
        Path(path).unlink(missing_ok=True)


class Checkpoints(Checkpoint):
    """Keeps the last state and the best one, and ends the run when its time has come.

    Args:
        module: The module in training.
        folder: Where ``last.ckpt`` and ``best.ckpt`` go.
        minutes: The last state is also saved inside an epoch, this often.
    """

    def __init__(self, module: GraspModule, folder: Path, minutes: float) -> None:
        super().__init__()
        self._module = module
        self._last, self._best = folder / "last.ckpt", folder / "best.ckpt"
        self._every_s, self._saved = minutes * 60, time.monotonic()

    def on_sanity_check_end(self, *_: Any) -> None:
        """Keep the untrained network: from now on there is always a state to go on from."""
        self._save()

    def on_train_batch_end(self, *_: Any) -> None:
        """Count the step, and save the state when it is time."""
        self._module.end_batch()
        due = time.monotonic() - self._saved >= self._every_s
        if due and not self._module.trainer.is_last_batch:
            self._module.store_sums()
            # A state that is lost already must not replace one that is not.
            if all(map(math.isfinite, self._module.state.sums)):
                self._module.trainer.save_checkpoint(self._last)
                self._saved = time.monotonic()

    def on_train_epoch_end(self, *_: Any) -> None:
        """Save the state after validation."""
        self._save()

    def _save(self) -> None:
        verdict, trainer = self._module.verdict, self._module.trainer
        if verdict is None:
            raise RuntimeError("an epoch ended without validation")
        # The best one first: killed in between, the run repeats the epoch and writes it again.
        if verdict.best:
            trainer.save_checkpoint(self._best)
        trainer.save_checkpoint(self._last)
        self._saved = time.monotonic()
        if verdict.stop:
            _logger.info("training ends: %s", verdict.stop)
            trainer.should_stop = True


class MetricsLog(Callback):
    """Writes each epoch's metrics to ``metrics.jsonl``, ``metrics.csv`` and TensorBoard.

    Args:
        module: The module in training.
        folder: The run's folder.
        experiment: Says what is measured.
        fresh: Whether the run has no state yet, so that row 0 is still to come; otherwise rows
            past the module's state are dropped.
    """

    def __init__(
        self, module: GraspModule, folder: Path, experiment: Experiment, *, fresh: bool
    ) -> None:
        super().__init__()
        self._module, self._columns = module, columns(experiment)
        self._jsonl, self._csv = folder / "metrics.jsonl", folder / "metrics.csv"
        self._board = folder / "tensorboard"
        self._writer: Any = None
        self._first = 0 if fresh else module.state.epoch + 1
        self._rows = [row for row in read_rows(self._jsonl) if row["epoch"] < self._first]
        self._write()

    def on_sanity_check_end(self, *_: Any) -> None:
        """Row 0: the untrained network."""
        self._add(self._module.row)

    def on_train_epoch_end(self, *_: Any) -> None:
        """One more row."""
        self._add(self._module.row)

    def teardown(self, *_: Any, **__: Any) -> None:
        """Close TensorBoard's file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _add(self, row: dict[str, float]) -> None:
        self._rows.append(row)
        self._write()
        if self._writer is None:
            from torch.utils.tensorboard import SummaryWriter

            # purge_step hides what a killed run had written past its last checkpoint.
            self._writer = SummaryWriter(str(self._board), purge_step=self._first)
        for name, value in row.items():
            if name not in ("epoch", "step"):
                # TensorBoard groups by what stands before a slash.
                tag = re.sub("^(train|validation)_", r"\1/", name)
                self._writer.add_scalar(tag, value, int(row["epoch"]))
        self._writer.flush()

    def _write(self) -> None:
        # Some hundred short rows: writing all of them is the simplest way to write them whole.
        lines = "".join(json.dumps(row) + "\n" for row in self._rows)
        write_text(self._jsonl, lines, durable=True)
        table = io.StringIO()
        writer = csv.DictWriter(table, self._columns, restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(self._rows)
        write_text(self._csv, table.getvalue(), durable=True)


def read_rows(path: Path) -> list[dict[str, float]]:
    """The rows of a ``metrics.jsonl``; none where there is no such file.

    Raises:
        FileFormatError: A line is damaged, or it is no text.
    """
    if not path.exists():
        return []
    rows, known = [], set(columns())
    for number, line in read_lines(path):
        try:
            row = json.loads(line)
            row["epoch"] = int(row["epoch"])
            if not row.keys() <= known:
                raise KeyError("unknown key")
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise FileFormatError(path, f"line {number} is damaged", "delete that line") from error
        rows.append(row)
    return rows


class Report(Callback):
    """Tells how far the run is: a bar or a line for each epoch, and its outcome.

    Args:
        module: The module in training.
        epochs: Epochs of the whole run.
        progress: Where to tell it.
    """

    def __init__(self, module: GraspModule, epochs: int, progress: Progress) -> None:
        super().__init__()
        self._module, self._epochs, self._progress = module, epochs, progress
        self._stack = ExitStack()
        self._update: Callable[[int, int], None] = _unheard
        self._total = 0

    def on_sanity_check_end(self, *_: Any) -> None:
        """Tell about the untrained network."""
        self._outcome()

    def on_train_epoch_start(self, *_: Any) -> None:
        """Open a bar."""
        state = self._module.state
        # Lightning counts what is left of an epoch that was cut in half.
        self._total = state.batch + int(self._module.trainer.num_training_batches)
        title = f"epoch {state.epoch + 1} of {self._epochs}"
        self._update = self._stack.enter_context(self._progress(title))

    def on_train_batch_end(self, *_: Any) -> None:
        """Move the bar on."""
        self._update(self._module.state.batch + 1, self._total)

    def on_train_epoch_end(self, *_: Any) -> None:
        """Close the bar, tell the outcome."""
        self._stack.close()
        self._outcome()

    def on_exception(self, *_: Any) -> None:
        """Close the bar."""
        self._stack.close()

    def _outcome(self) -> None:
        row = self._module.row
        trained = f"loss {row['train_loss']:.5f}, " if "train_loss" in row else ""
        tasks = "".join(
            f", {name.replace('_', ' ')} {row[name]:.3f}"
            for name in METRICS.values()
            if name in row
        )
        _logger.info(
            "epoch %d: %svalidation loss %.5f, success at 0.25 %.1f %%%s",
            row["epoch"],
            trained,
            row["validation_loss"],
            100 * row["success"],
            tasks,
        )


def _unheard(done: int, total: int) -> None:
    """Progress that nobody is told of."""
