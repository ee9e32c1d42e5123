"""Two ways of training on the same scenes, each trained with several seeds.

A seed stands for all that chance decides in a training: weights, order, motion of the pictures. A
claim about a way of training is one about new scenes *and* new seeds, so both add to the interval.

Letters in shapes: T seeds, S scenes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import RESAMPLES, Groups
from graspmap.metrics.paired import PairedComparison, compare_paired


@dataclass(frozen=True)
class SeededComparison:
    """Way a of training against way b.

    Attributes:
        seeds: Number of seeds T.
        scenes: Each scene's mean over seeds compared: the difference, its interval over scenes (or
            groups of them) alone.
        by_seed: (T,) the difference of each seed.
        interval: Interval around the difference for new scenes and new seeds.
    """

    seeds: int
    scenes: PairedComparison
    by_seed: tuple[float, ...]
    interval: tuple[float, float]

    @property
    def difference(self) -> float:
        """Mean of a minus mean of b, above 0 where a is better."""
        return self.scenes.difference

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "seeds": self.seeds,
            "difference": self.difference,
            "interval": list(self.interval),
            "by_seed": list(self.by_seed),
            "over_scenes": self.scenes.to_dict(),
        }


def compare_seeds(
    a: ArrayLike,
    b: ArrayLike,
    *,
    groups: Groups | None = None,
    rng: np.random.Generator,
    confidence: float = 0.95,
    resamples: int = RESAMPLES,
) -> SeededComparison:
    """Compare two ways of training by what their networks reached in every scene.

    Over scenes the interval is `compare_paired`'s, of each scene's mean over seeds. Over seeds it
    is Student's, of the seeds' own differences, with T - 1 degrees of freedom. Each reaches some
    way below and above the difference; together they reach the root of the sum of squares (the
    method of variance estimates recovery, MOVER). What scenes and seeds do together (another seed
    fails in other scenes) is in both, so the interval is a little wide.

    Args:
        a: (T, S) numbers in [0, 1], one row a seed.
        b: (T, S) likewise: the same seeds, the same scenes.
        groups: S labels of scenes that belong together, such as their objects; None: each alone.
        rng: Source of the resamples.
        confidence: Confidence of the intervals, above 0 and below 1.
        resamples: Number of resamples.

    Raises:
        InvalidInputError: Fewer than two seeds, which say nothing about others, tables of unequal
            or another shape, or what `compare_paired` does not allow.

    References:
        G. Y. Zou, A. Donner, Construction of confidence limits about effect measures: a general
        approach, Statistics in Medicine 27, 2008.
    """
    first, second = (np.asarray(values, dtype=np.float64) for values in (a, b))
    if first.ndim != 2 or first.shape != second.shape or len(first) < 2:
        found = f"{first.shape} and {second.shape}"
        raise InvalidInputError(
            "shapes of the values", found, "twice (T, S), with two seeds or more"
        )
    from scipy.special import stdtrit

    scenes = compare_paired(
        first.mean(axis=0),
        second.mean(axis=0),
        groups=groups,
        rng=rng,
        confidence=confidence,
        resamples=resamples,
    )
    by_seed = (first - second).mean(axis=1)
    t = float(stdtrit(len(by_seed) - 1, 0.5 + confidence / 2))
    reach = t * float(by_seed.std(ddof=1)) / math.sqrt(len(by_seed))
    middle, (low, high) = scenes.difference, scenes.interval
    low, high = middle - math.hypot(middle - low, reach), middle + math.hypot(high - middle, reach)
    return SeededComparison(
        seeds=len(by_seed),
        scenes=scenes,
        by_seed=tuple(by_seed.tolist()),
        interval=(max(-1.0, low), min(1.0, high)),
    )
