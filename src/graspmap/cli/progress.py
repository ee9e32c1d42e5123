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
def progress(title: str) -> Iterator[Update]:
    """Show how far a piece of work is, on standard error.

    Args:
        title: What is done, for example ``"reading scenes"``.

    Yields:
        The function to call with (done, total).
    """
    if sys.stderr.isatty():
        with _bar(title) as update:
            yield update
    else:
        yield _lines(title)


@contextmanager
def _bar(title: str) -> Iterator[Update]:
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
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(title, total=None)

        def update(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total or None)

        yield update


def _lines(title: str) -> Update:
    last = time.monotonic()

    def update(done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= LINE_EVERY_S and done < (total or done + 1):
            last = now
            of = f" of {total}" if total else ""
            print(f"graspmap: {title}: {done}{of}", file=sys.stderr, flush=True)

    return update
