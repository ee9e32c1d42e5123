"""Doing the runs of a plan: in one process or several, shared with whoever works in the folder."""

from __future__ import annotations

import logging
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from graspmap.errors import FolderInUseError, GraspmapError, InvalidInputError, StorageFullError
from graspmap.generation.workers import WorkerPool
from graspmap.reproduction.plan import Plan, Run
from graspmap.reproduction.words import duration
from graspmap.reproduction.work import PROGRESS_FILE, Place, do_run, read_result

if TYPE_CHECKING:
    from graspmap.training.callbacks import Progress

_WAIT_S = 2.0
"""Seconds between two looks at what others do."""
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Crew:
    """Who does the runs.

    Attributes:
        workers: Processes; 1 works in this one.
        threads: Threads of each.
        devices: ``cpu``, or numbers of CUDA devices.
    """

    workers: int
    threads: int
    devices: tuple[str, ...]


def choose_crew(
    workers: int | None = None, threads: int | None = None, devices: str = "auto"
) -> Crew:
    """Who does the runs, from what the user said and what the machine has.

    On a CPU each run has one thread and there is a worker for each core: that is the fastest, and
    the result does not depend on the number of workers. On GPUs there is a worker for each.

    Args:
        workers: Processes; None as above.
        threads: Threads of each; None as above.
        devices: ``auto`` (all CUDA devices, else the CPU), ``cpu``, or numbers: ``0,1``.

    Raises:
        InvalidInputError: A number is below 1, or there is no such device.
    """
    for name, value in (("--workers", workers), ("--threads", threads)):
        if value is not None and value < 1:
            raise InvalidInputError(name, value, "1 or more")
    chosen, cores = _devices(devices), os.cpu_count() or 1
    if chosen == ("cpu",):
        threads = threads or 1
        return Crew(workers or max(1, cores // threads), threads, chosen)
    workers = workers or len(chosen)
    return Crew(workers, threads or max(1, cores // workers), chosen)


def _devices(text: str) -> tuple[str, ...]:
    if text == "cpu":
        return ("cpu",)
    import torch

    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if text == "auto":
        return tuple(map(str, range(count))) or ("cpu",)
    chosen = tuple(text.split(","))
    if not all(number.isdecimal() and int(number) < count for number in chosen):
        there = f"auto, cpu, or numbers from 0 to {count - 1}" if count else "auto, cpu"
        raise InvalidInputError("--devices", repr(text), f"{there} (PyTorch finds {count} GPUs)")
    return chosen


@dataclass(eq=False)
class Outcome:
    """What became of the runs.

    Attributes:
        results: By run.
        failures: Why a run failed, by run.
        made: How many were made now, by this process.
    """

    results: dict[str, dict[str, Any]] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    made: int = 0


def conduct(plan: Plan, root: Path, crew: Crew, progress: Progress | None = None) -> Outcome:
    """Do what is missing of a plan's runs, together with others that work in the same folder.

    A run that fails is told and left; the others go on.

    Args:
        plan: The runs.
        root: Folder of the runs.
        crew: Who does them.
        progress: Told how far it is.

    Raises:
        KeyboardInterrupt: The user stopped it; finished runs and checkpoints are kept.
        StorageFullError, MemoryError: The machine lacks something.
    """
    score = _Score(plan, root)
    if not score.todo:
        return score.outcome
    workers = min(crew.workers, len(score.todo))
    # Which GPU a process sees is settled before it first looks.
    alone = workers == 1 and crew.devices[0] in ("cpu", "0")
    with tempfile.TemporaryDirectory(prefix="graspmap-") as tickets:
        place = Place(root, crew.threads, crew.devices, None if alone else Path(tickets), workers)
        runs = {run.id: run for run in plan.runs}
        job = partial(_do, place, runs, progress if alone else None)
        with WorkerPool(job, 0 if alone else workers) as pool, _watch(score, progress, alone):
            while score.todo:
                for name in score.todo:
                    pool.submit(name)
                for answer in pool.answers():
                    score.take(answer.task, answer.error)
                score.look()
                if score.todo:
                    time.sleep(_WAIT_S)  # others have them
    return score.outcome


def _do(place: Place, runs: Mapping[str, Run], progress: Progress | None, name: str) -> None:
    try:
        do_run(place, runs[name], progress)
    except KeyboardInterrupt:
        if place.tickets is None:
            raise
        os._exit(130)  # a worker that is told to stop has nothing to say


class _Score:
    """What is done, what is left, and how long that may take."""

    def __init__(self, plan: Plan, root: Path) -> None:
        self._runs = {run.id: run for run in plan.runs}
        self._root, self._start = root, time.monotonic()
        self.outcome = Outcome()
        self.todo: list[str] = list(self._runs)
        self.look()
        self._before = self.done
        if self.done:
            _LOG.info("%d of %d runs are there already", self.done, len(self._runs))

    @property
    def done(self) -> int:
        """Runs that are over."""
        return len(self.outcome.results) + len(self.outcome.failures)

    def look(self) -> None:
        """Take over results that are on disk."""
        left = []
        for name in self.todo:
            result = read_result(self._root, self._runs[name])
            if result is not None:
                self.outcome.results[name] = result
            elif name not in self.outcome.failures:
                left.append(name)
        self.todo = left

    def take(self, name: str, error: Exception | None) -> None:
        """Note how a run ended."""
        if isinstance(error, FolderInUseError):
            return  # another process has it; its result is looked for later
        if isinstance(error, StorageFullError | MemoryError):
            raise error
        if error is not None:
            self.outcome.failures[name] = _blame(error)
            _LOG.warning("%s failed: %s", self._runs[name].title, self.outcome.failures[name])
            return
        self.outcome.made += 1
        self.look()
        _LOG.info("run %d of %d: %s: %s%s", self.done, len(self._runs), self._runs[name].title,
                  _words(self.outcome.results.get(name, {})), self._left())  # fmt: skip

    def share(self) -> float:
        """Share of the runs that is done, begun ones as far as they say."""
        begun = 0.0
        for name in list(self.todo):
            try:
                begun += float((self._root / name / PROGRESS_FILE).read_text())
            except (OSError, ValueError):
                continue
        return min(1.0, (self.done + begun) / len(self._runs))

    def _left(self) -> str:
        """Rough time that the rest takes, at the pace so far."""
        made, rest = self.done - self._before, len(self._runs) - self.done
        if not made or not rest:
            return ""
        return f"; about {duration((time.monotonic() - self._start) / made * rest)} left"


def _words(result: Mapping[str, Any]) -> str:
    success = (result.get("test") or {}).get("success", {}).get("0.25")
    return "done" if success is None else f"success {success:.1%}"


def _blame(error: Exception) -> str:
    """Why a run failed, in one line."""
    if isinstance(error, GraspmapError):
        return str(error)
    _LOG.error("a defect of graspmap, please report it: %s", error)
    return f"defect: {str(error).strip().rpartition(chr(10))[2]}"


@contextmanager
def _watch(score: _Score, progress: Progress | None, alone: bool) -> Iterator[None]:
    """Tell how far all runs are while others work on them; alone, the run itself tells."""
    if progress is None or alone:
        yield
        return
    end = threading.Event()
    with progress("runs, percent") as update:
        thread = threading.Thread(target=_tell, args=(score, update, end), daemon=True)
        thread.start()
        try:
            yield
        finally:
            end.set()
            thread.join()


def _tell(score: _Score, update: Callable[[int, int], object], end: threading.Event) -> None:
    while not end.wait(1.0):
        update(int(100 * score.share()), 100)
