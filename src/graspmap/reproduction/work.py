"""One run of a table: train, test, and whatever else the table wants to know of it.

The folder of a run holds ``train/`` (what `graspmap.training.train` leaves; its checkpoints go
when it is done), ``evaluation.json``, ``per_scene.csv`` and ``trials/`` where they were asked for,
``parts/`` with an evaluation for each test part where the data come in parts, and ``result.json``
with every number that tables are made of. Only one process works in it at a time, and a run that
was stopped goes on from where it was.
"""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graspmap.errors import FolderInUseError, GraspmapError, InvalidInputError, storage_errors
from graspmap.files import locked, read_text, write_text
from graspmap.inference.threads import threads_of
from graspmap.reproduction.held_out import PARTS_FOLDER, measure_parts
from graspmap.reproduction.plan import Run
from graspmap.training import Experiment

if TYPE_CHECKING:
    from graspmap.data import Scenes
    from graspmap.inference import Detector
    from graspmap.training.callbacks import Progress

RESULT_FILE = "result.json"
PROGRESS_FILE = "progress"
_FORMAT = 1
_BEAT_S = 2.0
"""Seconds between two notes of how far a run is."""
_CURVE = tuple(i / 100 for i in range(101))
"""IoU thresholds of a curve."""
_HELD = ExitStack()
"""What this process holds until it ends."""
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Place:
    """Where and with what runs are made.

    Attributes:
        root: Folder of the runs, one inside for each.
        threads: Threads of a run.
        devices: ``cpu``, or numbers of CUDA devices; each worker takes one.
        tickets: Folder in which workers draw theirs; None in the command's own process.
        workers: How many draw.
    """

    root: Path
    threads: int
    devices: tuple[str, ...] = ("cpu",)
    tickets: Path | None = None
    workers: int = 1


def read_result(root: Path, run: Run) -> dict[str, Any] | None:
    """The result of a run; None where some of it is missing or it is not readable."""
    result = _stored(root / run.id)
    return result if result is not None and not _missing(run, result) else None


def _stored(folder: Path) -> dict[str, Any] | None:
    try:
        result = json.loads(read_text(folder / RESULT_FILE))
    except (GraspmapError, ValueError, RecursionError):
        return None
    known = isinstance(result, dict) and result.get("format") == _FORMAT and "test" in result
    return result if known else None


def _missing(run: Run, result: Mapping[str, Any]) -> list[str]:
    """What the run needs and the result lacks."""
    return [need for need in sorted(run.needs) if need not in ("none", *result)]


def do_run(place: Place, run: Run, progress: Progress | None = None) -> None:
    """Do what is missing of a run.

    Args:
        place: Where.
        run: What.
        progress: Told how far each stage is; None notes it in the run's folder.

    Raises:
        FolderInUseError: Another process does this run at the moment.
        GraspmapError: The run cannot be done.
    """
    folder = place.root / run.id
    with locked(folder, "reproduction"), threads_of(place.threads):
        result = _stored(folder)
        device = _device(place)
        tell = progress or _Heartbeat(folder / PROGRESS_FILE)
        if result is None:
            result = _train(run, folder, device, tell)
            _keep(folder, result)
        for need in _missing(run, result):
            result[need] = _stage(need, run, folder, device, tell)
            _keep(folder, result)


def _stage(need: str, run: Run, folder: Path, device: str, tell: Progress) -> dict[str, Any]:
    """What is to be done after the training, and its numbers."""
    if need == "parts":
        return measure_parts(_detector(folder, device), run, folder / PARTS_FOLDER, tell)
    return {"overlaps": _overlaps, "trials": _trials}[need](run.experiment, folder, device, tell)


def _train(run: Run, folder: Path, device: str, progress: Progress) -> dict[str, Any]:
    from graspmap.inference import load_weights
    from graspmap.networks import parameter_count
    from graspmap.training import train
    from graspmap.training.callbacks import read_rows

    training = run.experiment.training.model_copy(update={"device": device})
    experiment = run.experiment.model_copy(update={"training": training})
    with storage_errors(folder):
        if (folder / PARTS_FOLDER).exists():
            shutil.rmtree(folder / PARTS_FOLDER)  # they speak of other weights
    card = train(experiment, folder / "train", progress=progress)
    network, _ = load_weights(folder / "train" / "weights.safetensors")
    rows = read_rows(folder / "train" / "metrics.jsonl")
    return {
        "format": _FORMAT,
        "run": run.id,
        "parameters": parameter_count(network),
        "scenes": {} if card.data is None else dict(card.data.scenes),
        **card.metrics,
        # Row 0 is the untrained network.
        "success_by_epoch": [row["success"] for row in rows if row["epoch"] > 0],
    }


def _keep(folder: Path, result: Mapping[str, Any]) -> None:
    write_text(folder / RESULT_FILE, json.dumps(result, indent=1) + "\n", durable=True)
    # States to go on from are large, and there is nothing to go on with.
    shutil.rmtree(folder / "train" / "checkpoints", ignore_errors=True)
    (folder / PROGRESS_FILE).unlink(missing_ok=True)


def _overlaps(
    experiment: Experiment, folder: Path, device: str, progress: Progress
) -> dict[str, Any]:
    """Success at every threshold."""
    import numpy as np

    from graspmap.evaluation import evaluate_detector

    scenes = _test_scenes(experiment, folder)
    with progress("measuring overlaps") as update:
        evaluation = evaluate_detector(
            _detector(folder, device), scenes, seed=experiment.seed, progress=update
        )
    evaluation.write(folder)
    found = np.array([result.iou for result in evaluation.results])
    success = [float(np.mean(found > threshold)) for threshold in _CURVE]
    return {"thresholds": list(_CURVE), "success": success}


def _trials(
    experiment: Experiment, folder: Path, device: str, progress: Progress
) -> dict[str, Any]:
    """The best grasp of each test scene, tried in simulation."""
    from graspmap.evaluation import TrialPlan, predict_scenes, try_grasps, write_trials

    scenes = _test_scenes(experiment, folder)
    with progress("detecting") as update:
        todo = predict_scenes(_detector(folder, device), scenes, progress=update)
    try:
        with progress("trying grasps") as update:
            found = try_grasps(
                todo.grasps,
                scenes,
                TrialPlan(seed=experiment.seed),
                skipped=todo.skipped,
                folder=folder / "trials",
                progress=update,
            )
    except InvalidInputError as error:  # not one scene could be tried
        _LOG.warning("%s: no simulated trials (%s)", folder.name, error)
        return {"success": None, "why": str(error)}
    summary = write_trials(found, folder / "trials")
    return {key: summary[key] for key in ("scenes", "trials", "held", "success", "outcomes")}


def _detector(folder: Path, device: str) -> Detector:
    from graspmap.inference import Detector

    return Detector.load(folder / "train" / "weights.safetensors", device=device)


def _test_scenes(experiment: Experiment, folder: Path) -> Scenes:
    from graspmap.data import read_scenes, read_split
    from graspmap.training.setup import other_scenes

    values = experiment.data
    if values.test is not None:
        return other_scenes(experiment, values.test)
    scenes = read_scenes(values.source, depth=values.depth)
    return read_split(folder / "train" / "split.json", scenes).subset(scenes, "test")


@cache
def _device(place: Place) -> str:
    """The device of this process; a worker keeps the one that it draws."""
    number = 0
    while place.tickets is not None and number < place.workers:
        try:
            _HELD.enter_context(locked(place.tickets / str(number), "worker"))
            break
        except FolderInUseError:
            number += 1
    device = place.devices[number % len(place.devices)]
    if device == "cpu":
        return "cpu"
    if place.tickets is not None:
        os.environ["CUDA_VISIBLE_DEVICES"] = device  # nothing has used CUDA here yet
    return "cuda"


class _Heartbeat:
    """Notes in a file how far a run is, for whoever waits for it.

    Args:
        path: The file; it holds the share that is done.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._last = path, 0.0

    def __call__(self, title: str) -> AbstractContextManager[Any]:
        match = re.fullmatch(r"epoch (\d+) of (\d+)", title)
        return self._epoch(*map(int, match.groups())) if match else self._epoch(1, 0)

    @contextmanager
    def _epoch(self, epoch: int, of: int) -> Iterator[Any]:
        def update(done: int, total: int) -> None:
            now = time.monotonic()
            if of and total and now - self._last >= _BEAT_S:
                self._last = now
                write_text(self._path, f"{(epoch - 1 + done / total) / of:.4f}\n")

        yield update
