"""How far a predicted depth picture is from the measured one, over the pixels that were measured.

Letters in shapes: H rows, W columns of a picture; P pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import Groups, bootstrap_interval
from graspmap.metrics.score import Score

WITHIN = 1.25
"""A pixel is close where the larger of the two depths is less than this many times the smaller."""


@dataclass(frozen=True)
class DepthErrors:
    """Errors of one picture, over its measured pixels.

    Attributes:
        mae_m: Mean absolute error, metres.
        rmse_m: Root of the mean squared error, metres.
        abs_relative: Mean of the absolute error divided by the measured depth.
        within_1_25: Share of pixels whose depths differ by a factor below `WITHIN`.
    """

    mae_m: float
    rmse_m: float
    abs_relative: float
    within_1_25: float


@dataclass(frozen=True)
class DepthScore(Score):
    """Means of `DepthErrors` over pictures, each with its interval (None from one group alone).

    Attributes:
        pictures: P.
        mae_m: See `DepthErrors`, like all that follow.
        mae_m_interval: Lower and upper end, metres.
        rmse_m: Each picture's root, averaged.
        rmse_m_interval: Lower and upper end, metres.
        abs_relative: Averaged.
        abs_relative_interval: Lower and upper end.
        within_1_25: Averaged.
        within_1_25_interval: Lower and upper end.
    """

    pictures: int
    mae_m: float
    mae_m_interval: tuple[float, float] | None
    rmse_m: float
    rmse_m_interval: tuple[float, float] | None
    abs_relative: float
    abs_relative_interval: tuple[float, float] | None
    within_1_25: float
    within_1_25_interval: tuple[float, float] | None


def depth_errors(
    said_m: ArrayLike, true_m: ArrayLike, known: ArrayLike | None = None
) -> DepthErrors | None:
    """Errors of one predicted depth picture.

    Args:
        said_m: (H, W) predicted depth, finite metres. One of 0 or less is close to nothing.
        true_m: (H, W) measured depth, metres, above 0 where it is known.
        known: (H, W) bool, where it was measured; None for everywhere.

    Returns:
        The errors; None where no pixel was measured.

    Raises:
        InvalidInputError: The pictures differ in shape, or a depth that counts is not finite or,
            as a measured one, not above 0.

    References:
        D. Eigen, C. Puhrsch, R. Fergus, Depth map prediction from a single image using a
        multi-scale deep network, NIPS 2014 (the measures).
    """
    said, true = np.asarray(said_m, dtype=np.float64), np.asarray(true_m, dtype=np.float64)
    where = np.ones(true.shape, dtype=bool) if known is None else np.asarray(known, dtype=bool)
    if not said.shape == true.shape == where.shape:
        shapes = (said.shape, true.shape, where.shape)
        raise InvalidInputError("shapes of said, true and known depth", shapes, "equal ones")
    said, true = said[where], true[where]
    if not len(true):
        return None
    if not np.isfinite(said).all():
        raise InvalidInputError("predicted depth", "NaN or infinite somewhere", "finite metres")
    if not (np.isfinite(true).all() and true.min() > 0):
        raise InvalidInputError("known depth", "0, negative or not finite somewhere", "above 0 m")
    error = np.abs(said - true)
    # Products instead of quotients: what was said may be 0.
    close = (said < WITHIN * true) & (true < WITHIN * said)
    return DepthErrors(
        mae_m=float(error.mean()),
        rmse_m=float(np.sqrt((error**2).mean())),
        abs_relative=float((error / true).mean()),
        within_1_25=float(close.mean()),
    )


def score_depth(
    errors: Sequence[DepthErrors],
    *,
    rng: np.random.Generator,
    groups: Groups | None = None,
    confidence: float = 0.95,
) -> DepthScore:
    """Average the errors of pictures.

    Args:
        errors: P pictures' errors.
        rng: Source of the bootstrap's resamples.
        groups: P labels of pictures that belong together; None: each alone.
        confidence: Confidence of the intervals.

    Raises:
        InvalidInputError: No pictures, or what `bootstrap_interval` does not allow.
    """
    found: dict[str, Any] = {"pictures": len(errors)}
    for name in ("mae_m", "rmse_m", "abs_relative", "within_1_25"):
        values = [getattr(error, name) for error in errors]
        ends = bootstrap_interval(values, rng=rng, groups=groups, confidence=confidence)
        found[name] = float(np.mean(values))
        found[f"{name}_interval"] = ends if np.isfinite(ends).all() else None
    return DepthScore(**found)
