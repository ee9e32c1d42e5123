"""Is a grasp's quality the probability that it holds? Reliability diagram, ECE and Brier score.

Letters in shapes: T trials, B bins, R resamples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import (
    RESAMPLES,
    Groups,
    bootstrap_means,
    group_numbers,
    percentile_levels,
    resampled_means,
    wilson_interval,
)
from graspmap.metrics.paired import check_shares
from graspmap.metrics.score import Score

Floats = NDArray[np.float64]
Binning = Literal["width", "count"]

BINS = 10
"""Bins by default, as is usual for the expected calibration error."""

_HALVINGS = 40
"""Steps that find an end of an interval: to 1e-12."""


@dataclass(frozen=True)
class ReliabilityBin:
    """Trials whose quality lies in [low, high) (the last bin's ``high`` belongs to it).

    Attributes:
        low: Lower edge.
        high: Upper edge.
        count: Trials in the bin, 1 or more.
        quality: Their mean quality: what was promised.
        held: Share of them that held: what came.
        interval: Lower and upper end of the interval around ``held``.
    """

    low: float
    high: float
    count: int
    quality: float
    held: float
    interval: tuple[float, float]


@dataclass(frozen=True)
class Calibration(Score):
    """How far the quality of grasps is from the probability that they hold.

    Attributes:
        trials: Number of trials.
        ece: Expected calibration error: mean over trials of how far the mean quality of their bin
            is from the share that held in it, 0 to 1. Chance makes it positive even for a perfect
            detector.
        ece_interval: Its interval, which reaches 0 where chance alone explains it.
        brier: Mean of (quality - held)^2, 0 to 1; less is better.
        brier_interval: Its interval.
        base_rate: Share of all trials that held.
        reliability: Mean squared gap of the bins; 0 is best.
        resolution: Variance of the share held between bins; more is better.
        uncertainty: base_rate (1 - base_rate): the Brier score of saying the base rate always.
        within_bins: What the qualities inside the bins add, so that ``brier = reliability -
            resolution + uncertainty + within_bins``.
        confidence: Confidence of the intervals.
        bins: The bins that hold trials, in ascending order.
    """

    trials: int
    ece: float
    ece_interval: tuple[float, float]
    brier: float
    brier_interval: tuple[float, float]
    base_rate: float
    reliability: float
    resolution: float
    uncertainty: float
    within_bins: float
    confidence: float
    bins: tuple[ReliabilityBin, ...]


def score_calibration(
    quality: ArrayLike,
    held: ArrayLike,
    *,
    rng: np.random.Generator,
    bins: int = BINS,
    binning: Binning = "width",
    groups: Groups | None = None,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> Calibration:
    """Compare what a detector said of grasps with what became of them.

    Args:
        quality: (T,) quality of each grasp that was tried, in [0, 1]. (A network's maps may
            exceed 1 slightly; what a quality of 1.02 means as a probability is the caller's.)
        held: (T,) whether it held; bool, or zeros and ones.
        rng: Source of the resamples.
        bins: Number of bins, at least 1.
        binning: ``width``: bins of equal width over [0, 1]. ``count``: bins of nearly equal
            counts, between the least and the greatest quality; equal qualities share a bin.
        groups: T labels of trials that hang together (of one scene or object); the intervals are
            then the bootstrap's over groups. Where there are none, or no two trials have the same,
            trials are independent, and the intervals of the bins are Wilson's.
        confidence: Confidence of the intervals, above 0 and below 1.
        resamples: Number of resamples.

    Raises:
        InvalidInputError: No trials, a quality outside [0, 1], an outcome other than 0 and 1,
            lists of unequal length, or an option that is not allowed.

    References:
        A. H. Murphy, A new vector partition of the probability score, Journal of Applied
        Meteorology 12, 1973. D. B. Stephenson et al., Two extra components in the Brier score
        decomposition, Weather and Forecasting 23, 2008. C. Guo et al., On calibration of modern
        neural networks, ICML 2017 (equation 3, the expected calibration error).
    """
    said, came = check_shares(quality, "quality"), check_shares(held, "held")
    if len(said) != len(came):
        raise InvalidInputError("number of outcomes", len(came), f"{len(said)}, one a quality")
    if not np.isin(came, (0, 1)).all():
        raise InvalidInputError("held", "neither 0 nor 1 in some trial", "booleans, or 0 and 1")
    if group_numbers(groups, len(said))[1] == len(said):
        groups = None
    edges = _edges(said, bins, binning)
    place = np.clip(np.searchsorted(edges, said, side="right") - 1, 0, len(edges) - 2)
    found = tuple(
        _bin(said, came, place == b, (edges[b], edges[b + 1]), groups, confidence, rng, resamples)
        for b in np.unique(place)
    )
    gaps = np.zeros((len(said), len(edges) - 1))
    gaps[np.arange(len(said)), place] = said - came
    squares = (said - came) ** 2
    brier_ends = bootstrap_means(
        squares[:, None], rng=rng, groups=groups, confidence=confidence, resamples=resamples
    )[0]
    ece_ends = _ece_interval(gaps, groups, confidence, rng, resamples)
    slack = _slack(came, groups, confidence)
    base, brier = float(came.mean()), float(squares.mean())
    shares = np.array([b.count for b in found]) / len(said)
    rates, means = (np.array([getattr(b, name) for b in found]) for name in ("held", "quality"))
    ece = float(shares @ np.abs(means - rates))
    reliability = float(shares @ (means - rates) ** 2)
    resolution, uncertainty = float(shares @ (rates - base) ** 2), base * (1 - base)
    return Calibration(
        trials=len(said),
        ece=ece,
        ece_interval=_widened(ece_ends, ece, slack),
        brier=brier,
        brier_interval=_widened((float(brier_ends[0]), float(brier_ends[1])), brier, slack),
        base_rate=base,
        reliability=reliability,
        resolution=resolution,
        uncertainty=uncertainty,
        within_bins=brier - (reliability - resolution + uncertainty),
        confidence=confidence,
        bins=found,
    )


def _edges(quality: Floats, bins: int, binning: Binning) -> Floats:
    """Edges of the bins, ascending, two or more."""
    if bins < 1:
        raise InvalidInputError("number of bins", bins, "1 or more")
    if binning not in get_args(Binning):
        raise InvalidInputError("binning", repr(binning), ", ".join(get_args(Binning)))
    if binning == "width":
        return np.arange(bins + 1) / bins
    # A value of the data at each edge, so that no two trials of one quality are told apart.
    edges = np.unique(np.quantile(quality, np.linspace(0, 1, bins + 1), method="higher"))
    return edges if len(edges) > 1 else np.repeat(edges, 2)


def _bin(
    quality: Floats,
    held: Floats,
    inside: NDArray[np.bool_],
    edges: tuple[float, float],
    groups: Groups | None,
    confidence: float,
    rng: np.random.Generator,
    resamples: int,
) -> ReliabilityBin:
    rows = np.flatnonzero(inside)
    if groups is None:
        interval = wilson_interval(float(held[rows].sum()), len(rows), confidence)
    else:
        ends = bootstrap_means(
            held[rows, None],
            rng=rng,
            groups=[groups[i] for i in rows.tolist()],
            confidence=confidence,
            resamples=resamples,
        )
        interval = (float(ends[0, 0]), float(ends[0, 1]))
    return ReliabilityBin(
        low=float(edges[0]),
        high=float(edges[1]),
        count=len(rows),
        quality=float(quality[rows].mean()),
        held=float(held[rows].mean()),
        interval=interval,
    )


def _ece_interval(
    gaps: Floats,
    groups: Groups | None,
    confidence: float,
    rng: np.random.Generator,
    resamples: int,
) -> tuple[float, float]:
    """Interval of the expected calibration error from (T, B) gaps of the trials in their bins.

    The error is a sum of absolute values, which noise only ever enlarges: percentiles of its
    resamples would never reach 0. So the lower end is found by asking what the noise would make of
    smaller errors: all mean gaps are shrunk by one factor until the error found is just the upper
    percentile of what such a detector would show. The upper end is the resamples' percentile.
    """
    members, count = group_numbers(groups, len(gaps))
    upper = percentile_levels(count, confidence)[1]
    if count == 1:
        return 0.0, 1.0
    mean = gaps.mean(axis=0)
    noise = resampled_means(gaps, members, count, rng, resamples) - mean
    found = float(np.abs(mean).sum())

    def highest(factor: float) -> float:
        return float(np.quantile(np.abs(factor * mean + noise).sum(axis=1), upper))

    low, high = 0.0, 1.0
    if highest(low) < found:
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if highest(middle) < found else (low, middle)
    return low * found, max(found, min(1.0, highest(1.0)))


def _slack(held: Floats, groups: Groups | None, confidence: float) -> float:
    """By how much outcomes that never differed may mislead: as Wilson's interval allows."""
    if np.ptp(held) > 0:
        return 0.0
    count = group_numbers(groups, len(held))[1]
    return 1 - wilson_interval(count, count, confidence)[0]


def _widened(ends: tuple[float, float], value: float, slack: float) -> tuple[float, float]:
    """Ends at least ``slack`` away from the value, within [0, 1]."""
    return max(0.0, min(ends[0], value - slack)), min(1.0, max(ends[1], value + slack))
