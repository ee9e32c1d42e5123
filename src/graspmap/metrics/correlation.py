"""Does one measure of detectors tell the other? Correlation over models, with intervals.

The thesis asks it of the overlap metrics and of simulated trials (section 5.2.1). Nine models, as
there, say little: its correlation of 0.541 has the interval -0.19 to 0.89.

Letters in shapes: M models.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import check_confidence, check_values
from graspmap.metrics.score import Score

LEAST_MODELS = 4
"""Fewer have no interval: its width goes with 1 / sqrt(M - 3)."""


@dataclass(frozen=True)
class Correlation(Score):
    """How two measures go together over models; all None where a measure is the same for all.

    Attributes:
        models: Number of models.
        pearson: Correlation of the numbers, -1 to 1.
        pearson_interval: Its interval (Fisher's z).
        pearson_p: Probability of one at least as far from 0 if there were none (t test).
        spearman: Correlation of the ranks, -1 to 1; equal numbers share their mean rank.
        spearman_interval: Its interval (Bonett and Wright).
        spearman_p: As ``pearson_p``, of the ranks; at least 2 / M!.
        confidence: Confidence of the intervals.
    """

    models: int
    pearson: float | None
    pearson_interval: tuple[float, float] | None
    pearson_p: float | None
    spearman: float | None
    spearman_interval: tuple[float, float] | None
    spearman_p: float | None
    confidence: float


def correlate(x: ArrayLike, y: ArrayLike, *, confidence: float = 0.95) -> Correlation:
    """Pearson's and Spearman's correlation of two measures of the same models.

    Args:
        x: (M,) finite numbers, one for each model.
        y: (M,) the other measure, the same models in the same order.
        confidence: Confidence of the intervals, above 0 and below 1.

    Raises:
        InvalidInputError: Fewer than 4 models, lists of unequal length, a number that is not
            finite, or a confidence out of range.

    References:
        R. A. Fisher, Metron 1, 1921. D. G. Bonett and T. A. Wright, Sample size requirements for
        estimating Pearson, Kendall and Spearman correlations, Psychometrika 65, 2000.
    """
    first, second = check_values(x), check_values(y)
    check_confidence(confidence)
    if len(first) != len(second):
        raise InvalidInputError("number of values of y", len(second), f"{len(first)}, as of x")
    count = len(first)
    if count < LEAST_MODELS:
        raise InvalidInputError(
            "number of models", count, f"{LEAST_MODELS} or more, for a correlation with an interval"
        )
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return Correlation(count, None, None, None, None, None, None, confidence)
    from scipy.stats import rankdata

    pearson = _pearson(first, second)
    spearman = _pearson(rankdata(first), rankdata(second))
    # A perfect order of a few models is no proof of perfect order: it counts as half a step (the
    # swap of two neighbours) less.
    nearly = 1 - 6 / (count * (count**2 - 1))
    spread = 1 / math.sqrt(count - 3)
    inner = min(abs(spearman), nearly)
    return Correlation(
        models=count,
        pearson=pearson,
        pearson_interval=_interval(pearson, abs(pearson), spread, confidence),
        pearson_p=_p_value(pearson, count),
        spearman=spearman,
        spearman_interval=_interval(
            spearman, inner, spread * math.sqrt(1 + inner**2 / 2), confidence
        ),
        # Of the M! orders only one agrees fully, and one is its reverse.
        spearman_p=max(_p_value(spearman, count), 2 / math.factorial(count)),
        confidence=confidence,
    )


@dataclass(frozen=True)
class CorrelationGain(Score):
    """How much better one measure foretells an outcome than another; None as in `Correlation`.

    Attributes:
        models: Number of models.
        a: Pearson's correlation of the first measure with the outcome.
        b: That of the second.
        difference: ``a - b``, above 0 where the first goes with the outcome more closely.
        interval: Its interval.
        confidence: Confidence of the interval.
    """

    models: int
    a: float | None
    b: float | None
    difference: float | None
    interval: tuple[float, float] | None
    confidence: float


def correlation_gain(
    a: ArrayLike, b: ArrayLike, outcome: ArrayLike, *, confidence: float = 0.95
) -> CorrelationGain:
    """Compare two measures of the same models by how they go with an outcome.

    The two correlations hang together, as the measures do: the interval of their difference is
    Zou's, made of the intervals of both and of the correlation of the measures with each other.

    Args:
        a: (M,) a measure, one number for each model.
        b: (M,) another one, the same models in the same order.
        outcome: (M,) what they are to foretell.
        confidence: Confidence of the interval, above 0 and below 1.

    Raises:
        InvalidInputError: As `correlate`.

    References:
        G. Y. Zou, Toward using confidence intervals to compare correlations, Psychological Methods
        12, 2007, equations 15 and 16.
    """
    first = correlate(a, outcome, confidence=confidence)
    second = correlate(b, outcome, confidence=confidence)
    between = correlate(a, b, confidence=confidence).pearson
    r, s = first.pearson, second.pearson
    if first.pearson_interval is None or second.pearson_interval is None:
        return CorrelationGain(first.models, r, s, None, None, confidence)
    assert r is not None and s is not None and between is not None  # noqa: PT018  # they vary
    interval = _gain_interval(r, s, between, first.pearson_interval, second.pearson_interval)
    return CorrelationGain(first.models, r, s, r - s, interval, confidence)


def _gain_interval(
    r: float,
    s: float,
    between: float,
    of_r: tuple[float, float],
    of_s: tuple[float, float],
) -> tuple[float, float]:
    """Zou's interval of ``r - s``, from the intervals of both."""
    free = (1 - r**2) * (1 - s**2)
    together = 1.0 if between == 1 else 0.0  # where one fits exactly the formula has no limit
    if free > 0:
        apart = (between - r * s / 2) * (1 - r**2 - s**2 - between**2) + between**3
        together = min(1.0, max(-1.0, apart / free))
    return (
        r - s - _reach(r - of_r[0], of_s[1] - s, together),
        r - s + _reach(of_r[1] - r, s - of_s[0], together),
    )


def _reach(first: float, second: float, together: float) -> float:
    return math.sqrt(max(0.0, first**2 + second**2 - 2 * together * first * second))


def _pearson(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    # Scaled first, so that the squares of very small or large numbers do not vanish or overflow.
    x, y = ((v - v.mean()) / np.abs(v - v.mean()).max() for v in (x, y))
    r = float(x @ y / math.sqrt((x @ x) * (y @ y)))
    # Rounding leaves 1 - 1e-16 of a straight line.
    return math.copysign(1.0, r) if abs(r) > 1 - 1e-14 else r


def _interval(value: float, inner: float, spread: float, confidence: float) -> tuple[float, float]:
    """Symmetric in atanh about ``inner`` (with the sign of ``value``), and around ``value``."""
    if inner == 1:
        return value, value
    z = NormalDist().inv_cdf(0.5 + confidence / 2) * spread
    low, high = math.tanh(math.atanh(inner) - z), math.tanh(math.atanh(inner) + z)
    if abs(value) == 1:
        high = 1.0
    return (low, high) if value >= 0 else (-high, -low)


def _p_value(r: float, count: int) -> float:
    """Two-sided, from Student's t with M - 2 degrees of freedom."""
    if abs(r) == 1:
        return 0.0
    from scipy.special import stdtr

    t = abs(r) * math.sqrt((count - 2) / (1 - r**2))
    return 2 * float(stdtr(count - 2, -t))
