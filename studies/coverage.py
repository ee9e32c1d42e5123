"""How often do our intervals hold the truth? A nominal 95 % interval should, in 93 to 97 %.

Each row draws data whose truth is known from a closed form or an integral, 1,000 times, and counts
how often the interval that `graspmap.metrics` gives holds it.

Rows that leave the band, always by covering too often, and why:

- ``Spearman, 5 models``: five models have 120 orders, and a perfect one is not rare. The interval
  counts it as less than perfect, so that it holds the truth too often rather than too seldom.
- ``ECE, calibrated``: the truth is 0, the end of the scale. Only one side can miss it, so a
  two-sided 95 % interval covers 97.5 %.
- ``ECE, nearly calibrated``: as above; the upper end is the percentile of resamples, which noise
  has raised.

Few groups are the limit: over 4 objects the bootstrap of a share covers 86 %, over 6 and 8 just
short of 93 %, from 12 on what it says. (``objects(4, (20, 20))`` and so on, 500 resamples.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.metrics import (
    bootstrap_interval,
    compare_paired,
    correlate,
    score_calibration,
    wilson_interval,
)
from graspmap.metrics.intervals import bootstrap_means
from studies._report import table, write

ABOUT = "intervals: how often a nominal 95 % interval holds the truth"

BAND = (0.93, 0.97)

Floats = NDArray[np.float64]
Rng = np.random.Generator
Interval = tuple[float, float]
Curve = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Case:
    """One kind of data and one interval.

    Args:
        name: In words.
        truth: What the interval should hold.
        interval: Draws data and gives the interval; takes a generator and the resamples.
    """

    name: str
    truth: float
    interval: Callable[[Rng, int], Interval]


@dataclass(frozen=True)
class Coverage:
    """What became of one case.

    Attributes:
        name: Of the case.
        truth: What was to be held.
        covered: Share of the experiments whose interval held it.
        below: Share whose interval lay above the truth.
        above: Share whose interval lay below it.
        width: Mean width of the intervals.
    """

    name: str
    truth: float
    covered: float
    below: float
    above: float
    width: float


def wilson(trials: int, rate: float) -> Case:
    """Independent trials."""
    return Case(
        f"Wilson, {trials} trials, {rate:.0%} hold",
        rate,
        lambda rng, _: wilson_interval(int(rng.binomial(trials, rate)), trials),
    )


def overlaps(scenes: int) -> Case:
    """Mean overlap, each scene alone."""
    return Case(
        f"bootstrap, overlap in {scenes} scenes",
        2 / 3.5,
        lambda rng, n: bootstrap_interval(rng.beta(2, 1.5, scenes), rng=rng, resamples=n),
    )


def objects(count: int, pictures: tuple[int, int]) -> Case:
    """Success by object: each has a rate of its own, and several pictures."""

    def interval(rng: Rng, resamples: int) -> Interval:
        groups = np.repeat(np.arange(count), rng.integers(pictures[0], pictures[1] + 1, count))
        held = rng.random(len(groups)) < rng.beta(4, 2, count)[groups]
        ends = bootstrap_means(
            held[:, None].astype(np.float64), rng=rng, groups=groups, resamples=resamples
        )[0]
        return float(ends[0]), float(ends[1])

    low, high = pictures
    many = f"{low}" if low == high else f"{low} to {high}"
    return Case(f"bootstrap by object, {count} objects, {many} each", 4 / 6, interval)


def paired(scenes: int, each: int, rates: tuple[float, float]) -> Case:
    """Two detectors that find the same scenes hard: both fail in a fifth that is hopeless."""
    share = 0.8
    difference = share * (rates[0] - rates[1])

    def interval(rng: Rng, resamples: int) -> Interval:
        groups = np.repeat(np.arange(scenes // each), each)
        hopeless = (rng.random(scenes // each) >= share)[groups]
        a, b = ((rng.random(scenes) < rate) & ~hopeless for rate in rates)
        return compare_paired(
            a, b, rng=rng, groups=groups if each > 1 else None, resamples=resamples
        ).interval

    kind = "" if each == 1 else f" of {scenes // each} objects"
    return Case(f"paired, {scenes} scenes{kind}, difference {difference:.2f}", difference, interval)


def paired_overlap(scenes: int) -> Case:
    """Overlaps of two detectors, one a little worse in every scene."""

    def interval(rng: Rng, resamples: int) -> Interval:
        best = rng.beta(2, 1.5, scenes)
        return compare_paired(
            best, best * rng.uniform(0.8, 1, scenes), rng=rng, resamples=resamples
        ).interval

    return Case(f"paired, overlap in {scenes} scenes", 0.1 * 2 / 3.5, interval)


def correlation(kind: str, models: int, rho: float) -> Case:
    """Two measures of models, normal with correlation rho."""

    def interval(rng: Rng, _: int) -> Interval:
        x, other = rng.normal(size=(2, models))
        found = correlate(x, rho * x + np.sqrt(1 - rho**2) * other)
        ends = found.pearson_interval if kind == "Pearson" else found.spearman_interval
        assert ends is not None
        return ends

    truth = rho if kind == "Pearson" else 6 / np.pi * np.arcsin(rho / 2)
    return Case(f"{kind}, {models} models, {truth:.2f}", float(truth), interval)


def calibration(measure: str, name: str, trials: int, each: int, holds: Curve) -> Case:
    """Qualities from Beta(3, 2), ``each`` trials of one quality in one scene."""

    def interval(rng: Rng, resamples: int) -> Interval:
        groups = np.repeat(np.arange(trials // each), each)
        quality = rng.beta(3, 2, trials // each)[groups]
        found = score_calibration(
            quality,
            rng.random(trials) < holds(quality),
            rng=rng,
            groups=groups if each > 1 else None,
            resamples=resamples,
        )
        return found.ece_interval if measure == "ECE" else found.brier_interval

    kind = "" if each == 1 else f" of {trials // each} scenes"
    return Case(f"{measure}, {name}, {trials} trials{kind}", _truth(measure, holds), interval)


def _truth(measure: str, holds: Curve) -> float:
    """The measure over infinitely many trials, by the midpoint rule."""
    steps = 1_000_000
    q = (np.arange(steps) + 0.5) / steps
    weight = 12 * q**2 * (1 - q) / steps
    p = holds(q)
    if measure == "Brier":
        return float(weight @ (p * (1 - q) ** 2 + (1 - p) * q**2))
    return float(np.abs((weight * (q - p)).reshape(10, -1).sum(axis=1)).sum())


def cases() -> tuple[Case, ...]:
    """All rows."""
    return (
        wilson(20, 0.6),
        wilson(140, 0.58),
        wilson(980, 0.77),
        wilson(1000, 0.95),
        overlaps(60),
        overlaps(500),
        objects(25, (1, 6)),
        objects(49, (20, 20)),
        objects(200, (5, 5)),
        paired(100, 1, (0.8, 0.7)),
        paired(500, 1, (0.9, 0.88)),
        paired(500, 1, (0.85, 0.85)),
        paired(200, 5, (0.8, 0.7)),
        paired_overlap(100),
        *(correlation(kind, m, r) for kind in ("Pearson", "Spearman")
          for m, r in ((5, 0.5), (9, 0.541), (9, 0.0), (12, 0.8), (30, 0.9))),
        calibration("ECE", "calibrated", 500, 1, lambda q: q),
        calibration("ECE", "nearly calibrated", 500, 1, lambda q: np.maximum(q - 0.04, 0)),
        calibration("ECE", "too sure", 500, 1, lambda q: q**2),
        calibration("ECE", "too sure", 2000, 1, lambda q: q**2),
        calibration("ECE", "too sure", 1000, 5, lambda q: q**2),
        calibration("ECE", "far off", 500, 1, lambda q: 0.2 * q),
        calibration("Brier", "calibrated", 500, 1, lambda q: q),
        calibration("Brier", "too sure", 500, 1, lambda q: q**2),
        calibration("Brier", "too sure", 1000, 5, lambda q: q**2),
    )  # fmt: skip


def cover(case: Case, experiments: int, resamples: int, seed: int) -> Coverage:
    """Repeat one case; experiment i draws from (seed, i)."""
    ends = np.array(
        [case.interval(np.random.default_rng((seed, i)), resamples) for i in range(experiments)]
    )
    below, above = case.truth < ends[:, 0] - 1e-12, case.truth > ends[:, 1] + 1e-12
    return Coverage(
        case.name,
        case.truth,
        covered=float((~below & ~above).mean()),
        below=float(below.mean()),
        above=float(above.mean()),
        width=float((ends[:, 1] - ends[:, 0]).mean()),
    )


def run(
    experiments: int = 1000, resamples: int = 1000, seed: int = 0, out: Path | None = None
) -> dict[str, Any]:
    """Count how often intervals hold the truth.

    Args:
        experiments: Data sets drawn for each row.
        resamples: Resamples of each bootstrap.
        seed: Of everything.
        out: Folder for ``coverage.json``.
    """
    found = [cover(case, experiments, resamples, seed) for case in cases()]
    columns = ("interval", "truth", "covered", "below", "above", "width", "")
    table(
        columns,
        [
            (c.name, c.truth, f"{c.covered:.1%}", c.below, c.above, c.width,
             "" if BAND[0] <= c.covered <= BAND[1] else "outside 93 to 97 %")
            for c in found
        ],
    )  # fmt: skip
    result = {
        "experiments": experiments,
        "resamples": resamples,
        "seed": seed,
        "rows": [vars(c) for c in found],
    }
    write(out, "coverage", result)
    return result
