"""How far a measured mean may lie from the truth: bootstrap and Wilson intervals.

Letters in shapes: S scenes (one value each), K quantities, G groups of scenes, R resamples.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError

Floats = NDArray[np.float64]
Groups = Sequence[Hashable] | NDArray[Any]

RESAMPLES = 2000
"""Resamples by default: the ends of a 95 % interval then move by about 3 % of its width."""

_CHUNK = 1 << 22
"""Group draws held in memory at once (32 MiB of 64-bit numbers)."""


def bootstrap_interval(
    values: ArrayLike,
    *,
    rng: np.random.Generator,
    statistic: Callable[[Floats], float] = np.mean,
    groups: Groups | None = None,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> tuple[float, float]:
    """Percentile bootstrap interval of a statistic, by scene or by group of scenes.

    Whole groups are drawn with replacement, so scenes that resemble each other (pictures of one
    object) do not count as independent evidence. The percentiles are widened for the number of
    groups: the plain ones are too narrow where groups are few.

    Args:
        values: (S,) one finite number for each scene.
        rng: Source of the resamples; the same state gives the same interval.
        statistic: Number of interest, from (n,) values; the mean is computed without a loop.
        groups: S labels; scenes with one label are drawn together. None: each scene alone.
        confidence: Probability that the interval should hold the truth, above 0 and below 1.
        resamples: Number of resamples, at least 1.

    Returns:
        Lower and upper end. Minus and plus infinity where there is only one group, which says
        nothing about the spread; equal ends where all values are the same.

    Raises:
        InvalidInputError: No values, a value that is not finite, a confidence or a number of
            resamples out of range, or a number of groups other than S.

    References:
        T. Hesterberg, What Teachers Should Know About the Bootstrap, The American Statistician
        69 (4), 2015, section 3.2 (expanded percentiles).
    """
    numbers = check_values(values)
    members, count = group_numbers(groups, len(numbers))
    levels = percentile_levels(count, confidence)
    if resamples < 1:
        raise InvalidInputError("number of resamples", resamples, "1 or more")
    if count == 1:
        return -np.inf, np.inf
    if statistic is np.mean:
        draws = resampled_means(numbers[:, None], members, count, rng, resamples)[:, 0]
    else:
        draws = _resampled(numbers, members, count, statistic, rng, resamples)
    low, high = np.quantile(draws, levels)
    return float(low), float(high)


def bootstrap_means(
    values: Floats,
    *,
    rng: np.random.Generator,
    groups: Groups | None = None,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> Floats:
    """Intervals of several means of values in [0, 1], from one set of resamples.

    As `bootstrap_interval`, with two differences that hold for values in [0, 1] only. Values that
    are all the same (every scene a success) make resamples that are all the same too; then the
    interval is Wilson's, with as many trials as groups: of all values in [0, 1] with a given
    mean, zeros and ones spread most. And one group alone gives [0, 1].

    Args:
        values: (S, K) numbers in [0, 1].
        rng: Source of the resamples.
        groups: S labels, or None.
        confidence: Above 0 and below 1.
        resamples: Number of resamples.

    Returns:
        (K, 2) lower and upper ends.

    Raises:
        InvalidInputError: As `bootstrap_interval`.
    """
    members, count = group_numbers(groups, len(values))
    levels = percentile_levels(count, confidence)
    if resamples < 1:
        raise InvalidInputError("number of resamples", resamples, "1 or more")
    if count == 1:
        ends = np.tile([0.0, 1.0], (values.shape[1], 1))
    else:
        draws = resampled_means(values, members, count, rng, resamples)
        ends = np.quantile(draws, levels, axis=0).T
    for k in np.flatnonzero(np.ptp(values, axis=0) == 0):
        ends[k] = wilson_interval(float(values[0, k]) * count, count, confidence)
    return ends


def share_interval(
    hits: NDArray[np.bool_],
    *,
    rng: np.random.Generator,
    groups: Groups | None = None,
    confidence: float = 0.95,
) -> tuple[float, float]:
    """Interval of a share: Wilson's of independent trials, the bootstrap's of groups of them.

    Args:
        hits: (S,) which trials count, at least one.
        rng: Source of the resamples, if any are drawn.
        groups: S labels of what hangs together; None, or no two the same: each trial alone.
        confidence: Above 0 and below 1.

    Raises:
        InvalidInputError: As `bootstrap_interval`.
    """
    if group_numbers(groups, len(hits))[1] == len(hits):
        return wilson_interval(int(hits.sum()), len(hits), confidence)
    column = hits[:, None].astype(np.float64)
    low, high = bootstrap_means(column, rng=rng, groups=groups, confidence=confidence)[0].tolist()
    return low, high


def wilson_interval(
    successes: float, trials: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Wilson's score interval of a probability, for independent trials.

    Args:
        successes: Number of successes, 0 to ``trials``; need not be whole.
        trials: Number of trials, above 0.
        confidence: Probability that the interval should hold the truth, above 0 and below 1.

    Returns:
        Lower and upper end, within [0, 1].

    Raises:
        InvalidInputError: No trials, more successes than trials, or a confidence out of range.

    References:
        E. B. Wilson, Journal of the American Statistical Association 22, 1927.
    """
    if not (np.isfinite(trials) and trials > 0):
        raise InvalidInputError("number of trials", trials, "more than 0")
    if not 0 <= successes <= trials:
        raise InvalidInputError("number of successes", successes, f"0 to {trials}")
    z = NormalDist().inv_cdf(0.5 + check_confidence(confidence) / 2)
    p, shrink = successes / trials, 1 + z**2 / trials
    middle = (p + z**2 / (2 * trials)) / shrink
    half = z / shrink * np.sqrt(p * (1 - p) / trials + (z / (2 * trials)) ** 2)
    # At 0 and 1 the ends are exact; rounding must not move them inside or beyond.
    low = 0.0 if successes == 0 else max(0.0, float(middle - half))
    high = 1.0 if successes == trials else min(1.0, float(middle + half))
    return low, high


def check_values(values: ArrayLike) -> Floats:
    """(S,) finite float64 numbers, at least one.

    Raises:
        InvalidInputError: Another shape, no values, or one that is not finite.
    """
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.ndim != 1 or not len(numbers):
        raise InvalidInputError("shape of the values", numbers.shape, "(S,), one for each scene")
    if not np.isfinite(numbers).all():
        raise InvalidInputError("values", "NaN or infinite in some scene", "finite numbers")
    return numbers


def check_confidence(confidence: float) -> float:
    """The confidence, if it lies between 0 and 1.

    Raises:
        InvalidInputError: It does not.
    """
    if not 0 < confidence < 1:
        raise InvalidInputError("confidence", confidence, "above 0 and below 1, such as 0.95")
    return confidence


def group_numbers(groups: Groups | None, scenes: int) -> tuple[NDArray[np.int64], int]:
    """(S,) number of each scene's group, and how many groups there are.

    Raises:
        InvalidInputError: The number of labels is not that of the scenes.
    """
    if groups is None:
        return np.arange(scenes), scenes
    if len(groups) != scenes:
        raise InvalidInputError("number of group labels", len(groups), f"{scenes}, one a scene")
    numbers: dict[Hashable, int] = {}
    members = [numbers.setdefault(label, len(numbers)) for label in groups]
    return np.asarray(members, dtype=np.int64), len(numbers)


def percentile_levels(groups: int, confidence: float) -> tuple[float, float]:
    """The two percentiles (0 to 1) of the resamples, widened for a finite number of groups.

    Raises:
        InvalidInputError: The confidence is not between 0 and 1.
    """
    tail = (1 - check_confidence(confidence)) / 2
    if groups > 1:
        from scipy.special import stdtrit

        t = float(stdtrit(groups - 1, tail))
        tail = NormalDist().cdf(t * np.sqrt(groups / (groups - 1)))
    return tail, 1 - tail


def resampled_means(
    values: Floats,
    members: NDArray[np.int64],
    count: int,
    rng: np.random.Generator,
    resamples: int,
) -> Floats:
    """(R, K) means of (S, K) values over drawn groups, each scene of a drawn group weighing 1.

    Args:
        values: (S, K) numbers.
        members: (S,) number of each scene's group, see `group_numbers`.
        count: Number of groups.
        rng: Source of the draws.
        resamples: R.
    """
    sums = np.zeros((count, values.shape[1]))
    np.add.at(sums, members, values)
    sizes = np.bincount(members, minlength=count).astype(np.float64)
    means = np.empty((resamples, values.shape[1]))
    step = max(1, _CHUNK // count)
    for start in range(0, resamples, step):
        rows = min(step, resamples - start)
        drawn = rng.integers(0, count, (rows, count))
        drawn += np.arange(rows)[:, None] * count
        times = np.bincount(drawn.ravel(), minlength=rows * count).reshape(rows, count)
        times = times.astype(np.float64)
        means[start : start + rows] = times @ sums / (times @ sizes)[:, None]
    return means


def _resampled(
    values: Floats,
    members: NDArray[np.int64],
    count: int,
    statistic: Callable[[Floats], float],
    rng: np.random.Generator,
    resamples: int,
) -> Floats:
    """(R,) any statistic over drawn groups."""
    order = np.argsort(members, kind="stable")
    parts = np.split(values[order], np.cumsum(np.bincount(members, minlength=count))[:-1])
    draws = (rng.integers(0, count, count) for _ in range(resamples))
    return np.array([statistic(np.concatenate([parts[g] for g in drawn])) for drawn in draws])
