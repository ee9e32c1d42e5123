"""From a network's quality to the probability that a grasp holds: a monotone map, and its fit.

Letters in shapes: T trials, K knots, P pieces (K = P + 1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import Groups, check_values, group_numbers

Floats = NDArray[np.float64]

FOLDS = 5
"""Parts of the cross-fit by default."""

_MOST_PIECES = 4
_RARE_A_PIECE = 50
"""One more piece for each so many trials of the rarer outcome: fewer say little about a bend."""
_LEAST_PIECE = 0.05
"""Share of the range of the qualities that a piece spans at least."""

_LEAST_RISE, _MOST_RISE = 0.05, 20.0
"""Of the log-odds over the range of the qualities: never flat, never a step."""

_STIFFNESS = 0.02
"""Cost of a bend: a change of slope by 10, in the units above, costs a log-likelihood of 1."""


@dataclass(frozen=True)
class QualityMap:
    """A strictly increasing map from quality to probability.

    The log-odds are linear between the knots and go on beyond them as in the piece next to them, so
    that any quality has its own probability between 0 and 1, and an order of grasps stays the same.
    With two knots it is Platt's map.

    Args:
        knots: K >= 2 pairs of quality and probability, both strictly ascending, the probabilities
            above 0 and below 1.

    Raises:
        InvalidInputError: They are not.
    """

    knots: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        pairs = np.asarray(self.knots, dtype=np.float64)
        allowed = "2 or more pairs, both numbers ascending, probabilities above 0 and below 1"
        if pairs.ndim != 2 or pairs.shape[0] < 2 or pairs.shape[1] != 2:
            raise InvalidInputError("knots", self.knots, allowed)
        finite = np.isfinite(pairs).all() and (pairs[:, 1] > 0).all() and (pairs[:, 1] < 1).all()
        if not finite or not (np.diff(pairs, axis=0) > 0).all():
            raise InvalidInputError("knots", self.knots, allowed)

    def __call__(self, quality: ArrayLike) -> Floats:
        """Probability that a grasp of some quality holds.

        Args:
            quality: Any shape; any finite number (a network's may leave [0, 1]).

        Returns:
            The same shape, 0 to 1.
        """
        from scipy.special import expit

        found: Floats = expit(_extended(np.asarray(quality, dtype=np.float64), *self._log_odds()))
        return found

    def inverse(self, probability: ArrayLike) -> Floats:
        """The quality that stands for a probability.

        Args:
            probability: Any shape.

        Returns:
            The same shape; minus and plus infinity where no quality is so improbable or probable:
            up to 0, and from 1 on.
        """
        from scipy.special import logit

        given = np.clip(np.asarray(probability, dtype=np.float64), 0.0, 1.0)
        qualities, odds = self._log_odds()
        inside = (given > 0) & (given < 1)
        found = _extended(logit(np.where(inside, given, 0.5)), odds, qualities)
        return np.where(inside, found, np.where(given > 0, np.inf, -np.inf))

    def _log_odds(self) -> tuple[Floats, Floats]:
        """(K,) qualities and (K,) log-odds of the knots."""
        from scipy.special import logit

        pairs = np.asarray(self.knots, dtype=np.float64)
        return pairs[:, 0], logit(pairs[:, 1])


def fit_quality_map(quality: ArrayLike, held: ArrayLike) -> QualityMap:
    """The map that makes the outcomes most likely, as few trials allow it.

    The knots lie at quantiles of the quality, one piece more for each 50 trials of the rarer
    outcome, four at most. Outcomes count as Platt's: as if one trial more had held and one more had
    failed, so that trials that all held promise no certainty. Bends cost a little, the map rises by
    0.05 to 20 in log-odds over the range of the qualities.

    Args:
        quality: (T,) quality of each grasp that was tried, any finite numbers.
        held: (T,) whether it held; bool, or zeros and ones.

    Raises:
        InvalidInputError: No trials, a quality that is not finite, an outcome other than 0 and 1,
            or lists of unequal length.

    References:
        J. C. Platt, Probabilistic outputs for support vector machines, Advances in Large Margin
        Classifiers, 1999 (two knots, and the targets).
    """
    from scipy.optimize import minimize
    from scipy.special import expit, logit

    said, came = _check(quality, held)
    good = float(came.sum())
    target = np.where(came == 1, (good + 1) / (good + 2), 1 / (len(came) - good + 2))
    knots = _place_knots(said, min(good, len(came) - good))
    share = np.diff(knots) / (knots[-1] - knots[0])  # (P,) of the range, which is 1
    # Log-odds are the design times (log-odds at the first knot, rise of each piece).
    inside = np.clip((said[:, None] - knots[:-1]) / np.diff(knots), 0, 1)
    design = np.column_stack([np.ones(len(said)), inside])
    bends = np.diff(np.diag(1 / share), axis=0)  # (P - 1, P)

    def cost(values: Floats) -> tuple[float, Floats]:
        odds = design @ values
        turn = bends @ values[1:]
        loss = float(np.logaddexp(0, odds).sum() - target @ odds + _STIFFNESS / 2 * turn @ turn)
        slope = design.T @ (expit(odds) - target)
        slope[1:] += _STIFFNESS * bends.T @ turn
        return loss, slope

    start = np.concatenate([[logit(target.mean())], _LEAST_RISE * share])
    bounds = [(None, None), *((_LEAST_RISE * s, _MOST_RISE * s) for s in share)]
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds)
    probability = expit(np.cumsum(found.x))
    return QualityMap(tuple(zip(knots.tolist(), probability.tolist(), strict=True)))


def cross_fitted(
    quality: ArrayLike,
    held: ArrayLike,
    *,
    rng: np.random.Generator,
    groups: Groups | None = None,
    folds: int = FOLDS,
) -> Floats:
    """The probability of each trial by a map that was fitted without it, or its group.

    What a map promises of the very trials that it was fitted to is always too good.

    Args:
        quality: (T,) as in `fit_quality_map`.
        held: (T,) likewise.
        rng: Divides the groups.
        groups: T labels; trials with one label are left out together. None: each trial alone.
        folds: Number of parts, 2 or more; one group each where there are fewer groups.

    Returns:
        (T,) probabilities.

    Raises:
        InvalidInputError: As `fit_quality_map`; all trials are of one group; folds below 2.
    """
    said, came = _check(quality, held)
    members, count = group_numbers(groups, len(said))
    if count < 2:
        raise InvalidInputError("groups of trials", count, "2 or more, to leave some out in turn")
    if folds < 2:
        raise InvalidInputError("folds", folds, "2 or more")
    fold = rng.permutation(count)[members] % min(folds, count)
    found = np.empty(len(said))
    for number in range(min(folds, count)):
        out = fold == number
        found[out] = fit_quality_map(said[~out], came[~out])(said[out])
    return found


def _check(quality: ArrayLike, held: ArrayLike) -> tuple[Floats, Floats]:
    said, came = check_values(quality), check_values(held)
    if len(said) != len(came):
        raise InvalidInputError("number of outcomes", len(came), f"{len(said)}, one a quality")
    if not np.isin(came, (0, 1)).all():
        raise InvalidInputError("held", "neither 0 nor 1 in some trial", "booleans, or 0 and 1")
    return said, came


def _place_knots(quality: Floats, rarer: float) -> Floats:
    """(K,) ascending places of the knots, from the least to the greatest quality."""
    low, high = float(quality.min()), float(quality.max())
    if high - low <= 1e-6 * max(1.0, abs(low), abs(high)):
        return np.array([low - 0.5, high + 0.5])  # one quality for all: nothing tells of others
    pieces = int(min(_MOST_PIECES, 1 + rarer // _RARE_A_PIECE))
    places = [low]
    for place in np.quantile(quality, np.linspace(0, 1, pieces + 1)[1:-1]).tolist():
        # Where many qualities are nearly the same, knots would fall together into a step.
        if min(place - places[-1], high - place) >= _LEAST_PIECE * (high - low):
            places.append(place)
    return np.array([*places, high])


def _extended(x: Floats, xs: Floats, ys: Floats) -> Floats:
    """The line through (xs, ys) at x, gone on with beyond its ends."""
    piece = np.clip(np.searchsorted(xs, x, side="right") - 1, 0, len(xs) - 2)
    slope = np.diff(ys) / np.diff(xs)
    found: Floats = ys[piece] + (x - xs[piece]) * slope[piece]
    return found
