"""Two detectors on the same scenes: how far apart they are, and whether chance explains it.

Scenes differ far more than detectors do. Looking at each scene's difference takes the scenes out,
so a paired comparison sees differences that the intervals of two separate scores hide.

Letters in shapes: S scenes, G groups of scenes, R resamples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import (
    RESAMPLES,
    Groups,
    bootstrap_interval,
    check_confidence,
    check_values,
    group_numbers,
    wilson_interval,
)
from graspmap.metrics.score import Score

Floats = NDArray[np.float64]

SIGN_FLIPS = 10_000
"""Sign changes drawn for a p value: its least is then 0.0001."""

_ROUNDING = 1e-12
"""Differences of scenes that differ by no more are the same."""
_CHUNK = 1 << 22
"""Signs held in memory at once (32 MiB of 64-bit numbers)."""


@dataclass(frozen=True)
class PairedComparison(Score):
    """Detector a against detector b on the same scenes.

    Attributes:
        scenes: Number of scenes.
        groups: Number of groups that were taken as independent; the scenes where none were given.
        mean_a: Mean of a, 0 to 1 (a share, where its values are zeros and ones).
        mean_b: Mean of b.
        difference: ``mean_a - mean_b``, above 0 where a is better.
        interval: Lower and upper end of the interval around the difference.
        confidence: Confidence of the interval.
        p_value: Probability of a difference at least as large, one way or the other, if the
            detectors were alike: `mcnemar`'s exact one for zeros and ones of independent scenes,
            `sign_flip`'s otherwise.
        only_a: Scenes in which a is right and b is not; None unless all values are zeros and ones.
        only_b: The reverse.
        mcnemar_exact: McNemar's exact p value, which takes scenes as independent; None likewise.
        mcnemar_mid_p: Its mid-p value, which is less cautious and closer to its nominal level.
    """

    scenes: int
    groups: int
    mean_a: float
    mean_b: float
    difference: float
    interval: tuple[float, float]
    confidence: float
    p_value: float
    only_a: int | None = None
    only_b: int | None = None
    mcnemar_exact: float | None = None
    mcnemar_mid_p: float | None = None


def compare_paired(
    a: ArrayLike,
    b: ArrayLike,
    *,
    groups: Groups | None = None,
    rng: np.random.Generator,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> PairedComparison:
    """Compare two detectors by what each reached in every scene.

    The interval is the bootstrap's over the scenes' differences (whole groups are drawn). Where no
    two scenes differ in their difference, resampling shows no spread; then the interval allows for
    as many other scenes as Wilson's does. (For two detectors that agree in every scene that is the
    score interval of Tango.)

    Args:
        a: (S,) numbers in [0, 1]: right or wrong, held or not, overlap.
        b: (S,) likewise, the same scenes in the same order.
        groups: S labels of scenes that belong together, such as their objects; None: each alone.
        rng: Source of the resamples and of the sign flips.
        confidence: Confidence of the interval, above 0 and below 1.
        resamples: Number of resamples.

    Raises:
        InvalidInputError: No scenes, numbers outside [0, 1], lists of unequal length, or what
            `bootstrap_interval` does not allow.

    References:
        M. W. Fagerland, S. Lydersen, P. Laake, The McNemar test for binary matched-pairs data:
        mid-p and asymptotic are better than exact conditional, BMC Medical Research Methodology
        13:91, 2013. T. Tango, Equivalence test and confidence interval for the difference in
        proportions for the paired-sample design, Statistics in Medicine 17, 1998.
    """
    first, second = check_shares(a, "values of a"), check_shares(b, "values of b")
    if len(first) != len(second):
        raise InvalidInputError(
            "number of values of b", len(second), f"{len(first)}, one for each scene of a"
        )
    gains = first - second
    count = group_numbers(groups, len(gains))[1]
    binary = bool(np.isin([first, second], (0, 1)).all())
    only_a, only_b = int((gains > 0).sum()), int((gains < 0).sum())
    exact, mid_p = mcnemar(only_a, only_b)
    independent = binary and count == len(gains)
    return PairedComparison(
        scenes=len(gains),
        groups=count,
        mean_a=float(first.mean()),
        mean_b=float(second.mean()),
        difference=float(gains.mean()),
        interval=_interval(gains, groups, count, rng, confidence, resamples),
        confidence=confidence,
        p_value=exact if independent else sign_flip(gains, groups=groups, rng=rng),
        only_a=only_a if binary else None,
        only_b=only_b if binary else None,
        mcnemar_exact=exact if binary else None,
        mcnemar_mid_p=mid_p if binary else None,
    )


def mcnemar(only_a: int, only_b: int) -> tuple[float, float]:
    """McNemar's test: of the scenes that one detector gets right, is it one's more often?

    Args:
        only_a: Scenes that only a gets right, 0 or more.
        only_b: Scenes that only b gets right.

    Returns:
        The exact two-sided p value, and the mid-p value; 1 and 1 where there are no such scenes.

    Raises:
        InvalidInputError: A count below 0.
    """
    if only_a < 0 or only_b < 0:
        raise InvalidInputError("discordant scenes", (only_a, only_b), "counts, 0 or more")
    total, fewer = only_a + only_b, min(only_a, only_b)
    if total == 0:
        return 1.0, 1.0
    from scipy.special import bdtr

    # Whole numbers of any size: their quotient is rounded once.
    point = math.comb(total, fewer) / 2**total
    if only_a == only_b:
        return 1.0, 1 - point / 2
    exact = min(1.0, 2 * float(bdtr(fewer, total, 0.5)))
    return exact, exact - point


def sign_flip(
    gains: ArrayLike,
    *,
    groups: Groups | None = None,
    rng: np.random.Generator,
    flips: int = SIGN_FLIPS,
) -> float:
    """Randomisation test: how often does a coin for each group make the difference as large?

    If the detectors were alike, a group's difference would be as likely with the other sign.

    Args:
        gains: (S,) finite differences.
        groups: S labels; the scenes of one label change their sign together.
        rng: Source of the signs.
        flips: How many are drawn, at least 1.

    Returns:
        The two-sided p value, at least 1 / (flips + 1).

    Raises:
        InvalidInputError: No differences, one that is not finite, no flips, or a number of labels
            other than S.
    """
    values = check_values(gains)
    members, count = group_numbers(groups, len(values))
    if flips < 1:
        raise InvalidInputError("number of sign flips", flips, "1 or more")
    sums = np.bincount(members, weights=values, minlength=count)
    # A sum that differs from the one found by rounding alone is as large.
    least = abs(sums.sum()) - 1e-9 * np.abs(sums).sum()
    sums = sums[sums != 0]
    step, reached = max(1, _CHUNK // max(1, len(sums))), 0
    for start in range(0, flips, step):
        rows = min(step, flips - start)
        bytes_ = rng.integers(0, 256, (rows, -(-len(sums) // 8)), dtype=np.uint8)
        kept = np.unpackbits(bytes_, axis=1, count=len(sums))
        # Those that keep their sign minus the others.
        reached += int((np.abs(2 * (kept @ sums) - sums.sum()) >= least).sum())
    return (reached + 1) / (flips + 1)


def check_shares(values: ArrayLike, name: str) -> Floats:
    """(S,) finite numbers in [0, 1].

    Args:
        values: The numbers.
        name: What they are, for the error.

    Raises:
        InvalidInputError: They are not.
    """
    numbers = check_values(values)
    if numbers.min() < 0 or numbers.max() > 1:
        raise InvalidInputError(name, f"{numbers.min():g} to {numbers.max():g}", "0 to 1")
    return numbers


def _interval(
    gains: Floats,
    groups: Groups | None,
    count: int,
    rng: np.random.Generator,
    confidence: float,
    resamples: int,
) -> tuple[float, float]:
    """Interval of the mean difference, within [-1, 1]."""
    if count > 1 and np.ptp(gains) <= _ROUNDING:
        # As many groups may be unlike those seen as Wilson's interval lets fail; at worst they
        # have the difference -1, or 1.
        other = 1 - wilson_interval(count, count, check_confidence(confidence))[0]
        mean = float(gains[0])
        return mean - other * (1 + mean), mean + other * (1 - mean)
    low, high = bootstrap_interval(
        gains, rng=rng, groups=groups, confidence=confidence, resamples=resamples
    )
    return max(-1.0, low), min(1.0, high)
