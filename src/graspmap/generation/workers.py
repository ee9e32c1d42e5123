"""A pool of worker processes that outlives the death of any of them.

Each worker is a process of its own with one task at a time, so when one dies (killed, out of
memory, a crash in a library) it is known which task it had: the others go on, a new worker takes
its place, and the task is done again. Workers use one thread each, ignore Ctrl-C (the parent stops
them), and end when the parent does.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import traceback
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from types import TracebackType
from typing import Any, Generic, TypeVar

from graspmap.errors import GraspmapError

Task = TypeVar("Task", bound=Hashable)
Result = TypeVar("Result")

_REPEATS = 3  # deaths of a worker over one task before the task is given back
_PATIENCE_S = 5.0  # for a worker to end when it is told to
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


class WorkerDiedError(GraspmapError):
    """A worker process ended in the middle of a task, each time that it was tried.

    Attributes:
        exit_code: Of the last one; minus the signal's number where a signal ended it.
    """

    def __init__(self, exit_code: int | None) -> None:
        self.exit_code = exit_code
        super().__init__(f"its worker process ended {_REPEATS} times ({self.cause})")

    @property
    def cause(self) -> str:
        """How it ended, in words."""
        if self.exit_code is None or self.exit_code >= 0:
            return f"exit code {self.exit_code}"
        return f"signal {signal.Signals(-self.exit_code).name}"

    @property
    def killed(self) -> bool:
        """Whether it was ended from outside: by a person, or by a system short of memory."""
        return self.exit_code in (-signal.SIGTERM, -9)


class WorkerError(Exception):
    """A task raised an error that is no `GraspmapError`; the text is its traceback."""


@dataclass(frozen=True)
class Answer(Generic[Task, Result]):
    """What became of a task.

    Args:
        task: The task.
        result: What the job returned; None where it failed.
        error: What it raised: a `GraspmapError` (`WorkerDiedError` for a dead worker),
            `MemoryError`, or a `WorkerError`; None where it returned.
    """

    task: Task
    result: Result | None = None
    error: Exception | None = None


@dataclass(eq=False)
class _Worker(Generic[Task]):
    process: SpawnProcess
    connection: Connection
    task: Task | None = None


@dataclass(eq=False)
class WorkerPool(Generic[Task, Result]):
    """Processes that do one job for many tasks; use it as a context manager.

    Args:
        job: A function that can be pickled; called with one task.
        workers: Processes; 0 does the work in this process.
    """

    job: Callable[[Task], Result]
    workers: int
    _waiting: deque[Task] = field(default_factory=deque)
    _crew: list[_Worker[Task]] = field(default_factory=list)
    _deaths: Counter[Task] = field(default_factory=Counter)

    def submit(self, task: Task, *, first: bool = False) -> None:
        """Queue a task, behind the others or before them."""
        if first:
            self._waiting.appendleft(task)
        else:
            self._waiting.append(task)

    def answers(self) -> Iterator[Answer[Task, Result]]:
        """What becomes of the tasks, in the order in which they end, until none is left.

        More may be submitted in between.
        """
        if self.workers == 0:
            while self._waiting:
                yield _answer(self._waiting[0], _do(self.job, self._waiting.popleft()))
            return
        while self._hand_out():
            busy = [worker for worker in self._crew if worker.task is not None]
            ends = [worker.process.sentinel for worker in busy]
            ready = wait([*(worker.connection for worker in busy), *ends])
            for worker in busy:
                if worker.connection in ready or worker.process.sentinel in ready:
                    answer = self._collect(worker)
                    if answer is not None:
                        yield answer

    def _hand_out(self) -> bool:
        """Give every idle worker a task; whether any work is left."""
        while self._waiting:
            worker = next((w for w in self._crew if w.task is None), None)
            if worker is None:
                if len(self._crew) >= self.workers:
                    break
                worker = _hire(self.job)
                self._crew.append(worker)
            worker.task = self._waiting.popleft()
            # One that has died meanwhile is found out when its answer is collected.
            with suppress(BrokenPipeError, ConnectionResetError):
                worker.connection.send(worker.task)
        return any(worker.task is not None for worker in self._crew)

    def _collect(self, worker: _Worker[Task]) -> Answer[Task, Result] | None:
        """The worker's answer; None where it died and its task was queued again."""
        task = worker.task
        assert task is not None  # only busy workers are asked
        try:
            reply = worker.connection.recv()
        except (EOFError, ConnectionResetError, pickle.UnpicklingError):
            self._crew.remove(worker)
            exit_code = _dismiss(worker)
            self._deaths[task] += 1
            if self._deaths[task] < _REPEATS:
                self.submit(task, first=True)
                return None
            return Answer(task, error=WorkerDiedError(exit_code))
        worker.task = None
        return _answer(task, reply)

    def __enter__(self) -> WorkerPool[Task, Result]:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for worker in self._crew:
            worker.connection.close()  # an idle one ends by itself
            if worker.task is not None:
                worker.process.terminate()
        for worker in self._crew:
            _dismiss(worker)
        self._crew.clear()


def _hire(job: Callable[[Any], Any]) -> _Worker[Any]:
    # Spawned, not forked: the parent may hold threads (OpenCV, PyTorch) that a fork would break.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, job), name="graspmap worker")
    # Libraries read the environment when they are loaded. Ctrl-C goes to every process of the
    # terminal; a worker that has not got as far as to ignore it would die with a traceback.
    _start_tracker()
    with _environment(_ONE_THREAD), _interrupts_held():
        process.start()
    theirs.close()  # so that its end is seen here
    return _Worker(process, ours)


def _start_tracker() -> None:
    """Start multiprocessing's own helper first: it lets Ctrl-C through again when it starts."""
    if hasattr(signal, "pthread_sigmask"):  # there is none on Windows
        resource_tracker.ensure_running()


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back; processes that are started meanwhile never get it."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _dismiss(worker: _Worker[Any]) -> int | None:
    """Wait for the end of a worker, and see to it."""
    worker.connection.close()
    worker.process.join(_PATIENCE_S)
    if worker.process.is_alive():
        worker.process.kill()
        worker.process.join()
    return worker.process.exitcode


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(connection: Connection, job: Callable[[Any], Any]) -> None:
    """What a worker does all its life."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import cv2

    cv2.setNumThreads(1)
    while True:
        try:
            task = connection.recv()
        except (EOFError, ConnectionResetError):
            return
        answer = _do(job, task)
        try:
            connection.send(answer)
        except (BrokenPipeError, ConnectionResetError):
            return  # the parent has stopped, and wants no answer


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _do(job: Callable[[Any], Any], task: Any) -> tuple[Any, Exception | None]:
    try:
        return job(task), None
    except (GraspmapError, MemoryError) as error:
        return None, error
    except Exception:
        return None, WorkerError(traceback.format_exc())


def _answer(task: Task, reply: tuple[Result | None, Exception | None]) -> Answer[Task, Result]:
    return Answer(task, *reply)
