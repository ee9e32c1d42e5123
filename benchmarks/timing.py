"""Two ways of doing the same work, timed in turn so that the machine's mood falls on both."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True)
class Comparison:
    """One row of the table.

    Args:
        work: What was done.
        ours_ms: Median of graspmap, milliseconds.
        usual_ms: Median of the usual way, milliseconds.
        budget_ms: What design asks of graspmap on two cores, or None.
        budget_ratio: The gain that design asks for, or None.
    """

    work: str
    ours_ms: float
    usual_ms: float
    budget_ms: float | None = None
    budget_ratio: float | None = None

    @property
    def ratio(self) -> float:
        """How many times faster graspmap is."""
        return self.usual_ms / self.ours_ms


def compare(
    work: str,
    ours: Callable[[], object],
    usual: Callable[[], object],
    *,
    seconds: float = 2.0,
    budget_ms: float | None = None,
    budget_ratio: float | None = None,
) -> Comparison:
    """Run both in turn for about ``seconds`` after one warm-up of each."""
    ours()
    usual()
    start, a, b = time.perf_counter(), [], []
    while time.perf_counter() - start < seconds or len(b) < 3:
        b.append(_time(usual, 1))
        # The quick side runs several times a turn: one run of 50 us would measure the clock.
        a.append(_time(ours, max(1, min(50, int(b[-1] / max(a[-1] if a else b[-1], 1e-6))))))
    return Comparison(work, median(a) * 1e3, median(b) * 1e3, budget_ms, budget_ratio)


def _time(call: Callable[[], object], repeats: int) -> float:
    start = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - start) / repeats
