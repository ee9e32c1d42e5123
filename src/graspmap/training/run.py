"""`train`: from an experiment to a weights file, and on from where it was stopped."""

from __future__ import annotations

import logging
import math
import signal
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from lightning.pytorch import Trainer
from lightning.pytorch.utilities.exceptions import SIGTERMException

from graspmap.errors import GraspmapError
from graspmap.files import locked
from graspmap.inference import DataCard, WeightsCard, load_weights, save_weights
from graspmap.metrics import score_rectangles
from graspmap.training.callbacks import (
    Checkpoints,
    MetricsLog,
    Progress,
    Report,
    WholeFiles,
    load_checkpoint,
    no_progress,
)
from graspmap.training.data import DrawSampler, GraspData, Samples
from graspmap.training.experiment import Experiment
from graspmap.training.module import GraspModule
from graspmap.training.setup import Folder, Setup, choose_device, claim_folder, prepare
from graspmap.training.state import RunState
from graspmap.training.tasks import check_experiment, make_experiment_network

_SCORE = 3
"""The stream of random numbers for the intervals of the test."""

_PRECISION: dict[str, Literal["32-true", "bf16-mixed", "16-mixed"]] = {
    "32": "32-true",
    "bf16": "bf16-mixed",
    "16": "16-mixed",
}
_logger = logging.getLogger(__name__)


def train(
    experiment: Experiment,
    out: Path | str,
    *,
    command: str | None = None,
    progress: Progress | None = None,
) -> WeightsCard:
    """Train a network, choose its best epoch on validation, and test that one once.

    The folder then holds ``weights.safetensors`` with its card, ``experiment.yaml``,
    ``split.json``, ``metrics.jsonl``, ``metrics.csv`` and ``tensorboard/``. A run that was stopped,
    by whatever, goes on when it is called again with the same folder, and on a CPU ends in the same
    bits (with the same number of threads); a finished run gives its card at once. To train longer,
    call it again with more epochs.

    Args:
        experiment: What to do.
        out: Folder of the run; it is made where it is missing.
        command: Command line to record in the card.
        progress: Told how far each stage is.

    Returns:
        The card of the weights; its metrics hold the chosen epoch's validation and the test.

    Raises:
        ConfigError: The experiment asks for what this machine cannot do.
        UnknownNameError: There is no such network.
        FileError: The data or the folder cannot be used; see `graspmap.training.setup`.
        GraspmapError: The loss is no longer a number.
        KeyboardInterrupt: The user or a SIGTERM stopped it; all but the last minutes are kept.
    """
    folder, progress = Folder(Path(out)), progress or no_progress
    device = choose_device(experiment)
    # Contradictions are to show before the data are read.
    check_experiment(experiment)
    with locked(folder.root, "training"), _quiet_lightning():
        claim_folder(folder, experiment)
        setup = prepare(experiment, folder, device, progress)
        state = _last_state(folder)
        if folder.last.exists() and state.finished(experiment) and folder.weights.exists():
            return load_weights(folder.weights)[1]
        if folder.last.exists():
            load_checkpoint(folder.best)  # hours later would be too late to find it damaged
        # While the run goes on there is no result: an old one must not pass for the new.
        folder.weights.unlink(missing_ok=True)
        with _opencv_without_threads(experiment.training.workers > 0):
            while not folder.last.exists() or not state.finished(experiment):
                if state.epoch or state.batch:
                    _logger.info("going on after epoch %d, batch %d", state.epoch, state.batch)
                _fit(experiment, setup, folder, progress)
                state = _last_state(folder)
            return _finish(experiment, setup, folder, command, progress)


def _last_state(folder: Folder) -> RunState:
    """Where the run of a folder stands; the beginning where it has no checkpoint."""
    state = RunState()
    if folder.last.exists():
        state.load(load_checkpoint(folder.last)["graspmap"])
    return state


def _module(experiment: Experiment, setup: Setup, state: RunState, held_out: str) -> GraspModule:
    """A fresh network in its module, judged on a part; the weights follow from the seed."""
    network = make_experiment_network(
        experiment,
        max(1, len(setup.classes.names)),
        generator=torch.Generator().manual_seed(experiment.seed),
    )
    return GraspModule(
        network,
        experiment,
        state,
        store=setup.parts[held_out].store,
        width_scale_px=setup.width_scale_px,
        tasks=setup.parts[held_out].tasks,
        steps=experiment.training.epochs
        * DrawSampler(setup.parts["train"].indices, experiment, RunState()).batches,
    )


def _data(experiment: Experiment, setup: Setup, state: RunState) -> GraspData:
    samples = {
        name: Samples(
            part.store,
            experiment,
            setup.width_scale_px,
            tasks=part.tasks,
            classes=setup.classes.names,
        )
        for name, part in setup.parts.items()
    }
    indices = {name: part.indices for name, part in setup.parts.items()}
    return GraspData(samples, indices, state, pin_memory=setup.device != "cpu")


def _fit(experiment: Experiment, setup: Setup, folder: Folder, progress: Progress) -> None:
    """Train from the last checkpoint to the end, or to the end of a half-done epoch."""
    state, fresh = _last_state(folder), not folder.last.exists()
    module = _module(experiment, setup, state, "validation")
    # An epoch that was cut in half has fewer batches left than the others, which Lightning
    # cannot count; it is trained to its end on its own.
    epochs = 1 if state.batch else experiment.training.epochs - state.epoch
    trainer = _trainer(
        setup,
        folder,
        precision=_PRECISION[experiment.training.precision],
        max_epochs=epochs,
        # The untrained network is judged like an epoch: it is what training has to beat.
        num_sanity_val_steps=-1 if fresh else 0,
        callbacks=[
            MetricsLog(module, folder.root, experiment, fresh=fresh),
            Report(module, experiment.training.epochs, progress),
            Checkpoints(module, folder.checkpoints, experiment.training.checkpoint_minutes),
        ],
    )
    with _interruptible(trainer):
        trainer.fit(
            module,
            datamodule=_data(experiment, setup, state),
            ckpt_path=None if fresh else str(folder.last),
        )


def _finish(
    experiment: Experiment,
    setup: Setup,
    folder: Folder,
    command: str | None,
    progress: Progress,
) -> WeightsCard:
    """Test the best epoch's network, and write it with its card."""
    state = RunState()
    module = _module(experiment, setup, state, "test")
    module.load_state_dict(load_checkpoint(folder.best)["state_dict"])
    state.load(load_checkpoint(folder.last)["graspmap"])
    metrics: dict[str, Any] = {
        "epochs": state.epoch,
        "validation": {
            "epoch": state.best_epoch,
            "scenes": len(setup.parts["validation"].indices),
            "success": {"0.25": state.best_success},
            "loss": state.best_loss,
        },
    }
    test = setup.parts["test"]
    if test.indices:
        # In full precision: that is how the weights are used.
        trainer = _trainer(setup, folder, precision="32-true", callbacks=[])
        with progress("testing") as update, _interruptible(trainer):
            update(0, len(test.indices))
            data = _data(experiment, setup, state)
            trainer.test(module, dataloaders=data.test_dataloader(), verbose=False)
        metrics["test"] = _score(experiment, setup, module)
    network, values = module.network.cpu(), experiment.data
    key = {name: part.store.key for name, part in setup.parts.items()}
    card = WeightsCard(
        network=experiment.network.name,
        channels=experiment.network.channels,
        bins=experiment.network.bins,
        size=values.size,
        view=values.view,
        depth_zero=values.depth_zero,
        tasks=network.tasks,
        filters=experiment.network.filters,
        width_scale_px=setup.width_scale_px,
        data=DataCard(
            source=values.source,
            data_hash=setup.data_hash,
            depth=values.depth,
            split=folder.split.name,
            split_hash=setup.split_hash,
            store_key=key["train"],
            scenes={name: len(part.indices) for name, part in setup.parts.items()},
            validation_source=None if values.validation is None else values.validation.source,
            validation_key=None if values.validation is None else key["validation"],
            test_source=None if values.test is None else values.test.source,
            test_key=None if values.test is None else key["test"],
            classes=setup.classes.names,
        ),
        seed=experiment.seed,
        metrics=metrics,
        command=command,
        notes=f"experiment {experiment.name}",
    )
    save_weights(folder.weights, network, card)
    return card


def _score(experiment: Experiment, setup: Setup, module: GraspModule) -> dict[str, Any]:
    """The rectangle metric of the last test, and the metrics of the tasks."""
    score = score_rectangles(
        list(module.overlaps.values()), rng=np.random.default_rng((experiment.seed, _SCORE))
    )
    found = {
        "scenes": score.scenes,
        "success": {f"{t:.2f}": value for t, value in score.success.items()},
        "interval": {f"{t:.2f}": list(ends) for t, ends in score.interval.items()},
        "miou": score.miou,
        "auc": score.auc,
    }
    if math.isfinite(module.loss_value):  # not where the truth of a task is not known
        found["loss"] = module.loss_value
    found |= {name: value for name, value in module.task_means.items() if math.isfinite(value)}
    if "category_accuracy" in found:
        # What a network that has learned nothing would say, and what it would be right in here.
        kind, most = experiment.tasks.category, setup.classes.most
        test = setup.parts["test"]
        labels = [test.store.labels(i) for i in test.indices]
        right = sum(kind is not None and names.get(kind.labels) == most for names in labels)
        found["category_majority"] = {
            "class": most,
            "train_share": setup.classes.share,
            "test_share": right / len(labels),
        }
    return found


def _trainer(setup: Setup, folder: Folder, **options: Any) -> Trainer:
    return Trainer(
        accelerator="gpu" if setup.device == "cuda" else "cpu",
        devices=1,
        logger=False,
        enable_progress_bar=False,
        enable_model_summary=False,
        enable_checkpointing=bool(options["callbacks"]),
        use_distributed_sampler=False,
        default_root_dir=folder.root,
        plugins=[WholeFiles()],
        **options,
    )


@contextmanager
def _quiet_lightning() -> Iterator[None]:
    """Keep Lightning's advice to itself: what it says about workers and loggers is settled here."""
    loggers = [logging.getLogger(f"lightning.{name}") for name in ("pytorch", "fabric")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", module=r"lightning\..*")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@contextmanager
def _opencv_without_threads(wanted: bool) -> Iterator[None]:
    """End OpenCV's threads while workers are forked.

    A forked process inherits the record of the threads but not the threads: once packing has
    started them, a worker would wait for them for ever.
    """
    threads = cv2.getNumThreads()
    if wanted:
        cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


@contextmanager
def _interruptible(trainer: Trainer) -> Iterator[None]:
    """Let Ctrl-C and a scheduler's SIGTERM through: Lightning turns both into an exit code.

    Raises:
        KeyboardInterrupt: One of them came.
        GraspmapError: A process that prepares pictures died.
    """
    main = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    except SystemExit as stop:
        if isinstance(stop, SIGTERMException) or isinstance(stop.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise
    except RuntimeError as error:
        if not str(error).startswith("DataLoader worker"):
            raise
        # A SIGTERM to the whole process group ends the workers first.
        if trainer.received_sigterm or "Terminated" in str(error):
            raise KeyboardInterrupt from None
        raise GraspmapError(
            f"a process that prepares pictures died ({error}), most likely for want of memory; use "
            "fewer --training.workers, or a smaller --training.batch_size"
        ) from error
    finally:
        if main and handler is not None:
            signal.signal(signal.SIGINT, handler)
