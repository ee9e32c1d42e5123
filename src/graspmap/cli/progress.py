"""Progress of long work: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

Update = Callable[[int, int], None]
"""Called with (done, total); a total of 0 says that it is not known."""

LINE_EVERY_S = 10.0
"""Outside a terminal a line is written at most this often, seconds."""


@contextmanager
def progress(title: str, per_hour: str = "") -> Iterator[Update]:
    """Show how far a piece of work is, on standard error.

    Args:
        title: What is done, for example ``"reading scenes"``.
        per_hour: What is counted, where the speed is to be shown: ``"scenes"``. It counts from the
            first call, so that what was done in an earlier run does not make it look faster.

    Yields:
        The function to call with (done, total).
    """
    if sys.stderr.isatty():
        with _bar(title, per_hour) as update:
            yield update
    else:
        yield _lines(title, per_hour)


@contextmanager
def _bar(title: str, per_hour: str) -> Iterator[Update]:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[speed]}"),
    )
    speed = _Speed(per_hour)
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None, speed="")

        def update(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total or None, speed=speed.words(done))

        yield update


def _lines(title: str, per_hour: str) -> Update:
    last = time.monotonic()
    speed = _Speed(per_hour)

    def update(done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        words = speed.words(done)
        if now - last >= LINE_EVERY_S and done < (total or done + 1):
            last = now
            of = f" of {total}" if total else ""
            comma = ", " if words else ""
            print(f"graspmap: {title}: {done}{of}{comma}{words}", file=sys.stderr, flush=True)

    return update


class _Speed:
    """How many of something are done in an hour, at the rate since the first call."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._first: tuple[int, float] | None = None

    def words(self, done: int) -> str:
        """For example ``1,480 scenes an hour``; nothing before there is a rate."""
        now = time.monotonic()
        if self._first is None:
            self._first = done, now
        seconds = now - self._first[1]
        if not self._what or done <= self._first[0] or seconds <= 0:
            return ""
        return f"{(done - self._first[0]) / seconds * 3600:,.0f} {self._what} an hour"
