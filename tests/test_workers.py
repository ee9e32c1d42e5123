"""The worker pool: every task is answered, whatever happens to the workers."""

from __future__ import annotations

import os
import signal
import time
from functools import partial
from pathlib import Path

import pytest

from graspmap.errors import InvalidInputError, StorageFullError
from graspmap.generation.workers import WorkerDiedError, WorkerError, WorkerPool


def work(folder: Path, task: int) -> tuple[int, int]:
    """Squares; some tasks misbehave the first time, or each time."""
    marks = folder / str(task)
    first = not marks.exists()
    marks.touch()
    if task == 3 and first:
        os.kill(os.getpid(), signal.SIGKILL)
    if task == 4:
        os.abort()
    if task == 5:
        raise InvalidInputError("task", task, "another")
    if task == 6:
        raise StorageFullError("/disk", "the disk is full", "free some space")
    if task == 7:
        raise KeyError("defect")
    return task * task, os.getpid()


def test_every_task_is_answered(tmp_path):
    with WorkerPool(partial(work, tmp_path), 2) as pool:
        for task in range(10):
            pool.submit(task)
        answers = {answer.task: answer for answer in pool.answers()}
    assert sorted(answers) == list(range(10))
    for task in (0, 1, 2, 3, 8, 9):  # 3 killed its worker once, and was done again
        assert answers[task].result[0] == task * task
        assert answers[task].result[1] != os.getpid()
    assert isinstance(answers[4].error, WorkerDiedError)
    assert not answers[4].error.killed  # it ended itself, three times
    assert "SIGABRT" in str(answers[4].error)
    assert answers[5].error.found == 5
    assert isinstance(answers[6].error, StorageFullError)
    assert answers[6].error.path == Path("/disk")
    assert isinstance(answers[7].error, WorkerError)
    assert "KeyError: 'defect'" in str(answers[7].error)


def test_work_in_this_process_gives_the_same(tmp_path):
    with WorkerPool(partial(work, tmp_path), 0) as pool:
        pool.submit(5)
        pool.submit(2, first=True)
        answers = list(pool.answers())
    assert [answer.task for answer in answers] == [2, 5]
    assert answers[0].result == (4, os.getpid())
    assert answers[1].error.found == 5


def sleep(folder: Path, task: int) -> None:
    (folder / f"{os.getpid()}").touch()
    time.sleep(60)


def stop_when_busy(folder: Path) -> None:
    with WorkerPool(partial(sleep, folder), 1) as pool:
        pool.submit(0)
        pool._hand_out()
        deadline = time.monotonic() + 30
        while not list(folder.iterdir()) and time.monotonic() < deadline:
            time.sleep(0.02)
        raise KeyboardInterrupt


def test_leaving_ends_busy_workers(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        stop_when_busy(tmp_path)
    (name,) = [path.name for path in tmp_path.iterdir()]
    with pytest.raises(ProcessLookupError):
        os.kill(int(name), 0)


def environment(name: str) -> str | None:
    return os.environ.get(name)


def test_workers_use_one_thread_and_leave_our_environment_alone(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with WorkerPool(environment, 1) as pool:
        pool.submit("OMP_NUM_THREADS")
        pool.submit("OPENBLAS_NUM_THREADS")
        assert [answer.result for answer in pool.answers()] == ["1", "1"]
    assert os.environ["OMP_NUM_THREADS"] == "5"
    assert "OPENBLAS_NUM_THREADS" not in os.environ
