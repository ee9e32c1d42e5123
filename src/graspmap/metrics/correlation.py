"""Does one measure of detectors tell the other? Correlation over models, with intervals.

The thesis asks it of the overlap metrics and of simulated trials (section 5.2.1). Nine models, as
there, say little: its correlation of 0.541 has the interval -0.19 to 0.89.

Letters in shapes: M models.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import check_confidence, check_values

LEAST_MODELS = 4
"""Fewer have no interval: its width goes with 1 / sqrt(M - 3)."""


@dataclass(frozen=True)
class Correlation:
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

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        ends = (self.pearson_interval, self.spearman_interval)
        pearson, spearman = (None if pair is None else list(pair) for pair in ends)
        return asdict(self) | {"pearson_interval": pearson, "spearman_interval": spearman}


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
