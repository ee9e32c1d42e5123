"""Trial success: the share of grasps that held in simulation or on a robot, and how the rest ended.

Letters in shapes: T trials.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import Groups, share_interval, wilson_interval

HELD = "held"


@dataclass(frozen=True)
class GroupScore:
    """Trials of one object.

    Attributes:
        trials: How many were tried.
        held: How many held.
    """

    trials: int
    held: int

    @property
    def success(self) -> float:
        """Share that held, in [0, 1]."""
        return self.held / self.trials

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval around ``success``, which takes its trials as independent."""
        return wilson_interval(self.held, self.trials)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "trials": self.trials,
            "held": self.held,
            "success": self.success,
            "interval": list(self.interval),
        }


@dataclass(frozen=True)
class TrialScore:
    """How many trials held.

    Attributes:
        trials: How many grasps were tried (or were due: a scene without a grasp is a failure).
        held: How many held.
        success: Share that held.
        interval: Lower and upper end of the interval around ``success``.
        confidence: Of the interval.
        object_mean: Success averaged over objects, each counted once.
        outcomes: How often each outcome came, the most frequent first.
        per_object: Score of each object, by name.
    """

    trials: int
    held: int
    success: float
    interval: tuple[float, float]
    confidence: float
    object_mean: float
    outcomes: dict[str, int]
    per_object: dict[str, GroupScore]


def score_trials(
    outcomes: Sequence[str],
    objects: Sequence[str],
    *,
    rng: np.random.Generator,
    groups: Groups | None = None,
    confidence: float = 0.95,
) -> TrialScore:
    """Count trials.

    Args:
        outcomes: T outcomes; ``"held"`` is the one that counts as success.
        objects: T names of the objects that were grasped at.
        rng: Source of the resamples behind the interval.
        groups: T labels of what hangs together (several trials of one scene or object), drawn
            together by the bootstrap. Where there are none, or no two trials have the same,
            trials are independent, and the interval is Wilson's.
        confidence: Of the interval, above 0 and below 1.

    Raises:
        InvalidInputError: No trials, or lists of unequal length.
    """
    if not len(outcomes) or len(objects) != len(outcomes):
        raise InvalidInputError(
            "trials", f"{len(outcomes)} outcomes, {len(objects)} objects", "one object a trial"
        )
    held = np.array([outcome == HELD for outcome in outcomes])
    per_object = group_scores(outcomes, objects)
    return TrialScore(
        trials=len(held),
        held=int(held.sum()),
        success=float(held.mean()),
        interval=share_interval(held, rng=rng, groups=groups, confidence=confidence),
        confidence=confidence,
        object_mean=float(np.mean([score.success for score in per_object.values()])),
        outcomes=dict(Counter(map(str, outcomes)).most_common()),
        per_object=per_object,
    )


def group_scores(outcomes: Sequence[str], groups: Sequence[str]) -> dict[str, GroupScore]:
    """Score of each group of trials, by its name in ascending order.

    Args:
        outcomes: T outcomes.
        groups: T names.
    """
    trials = Counter(groups)
    held = Counter(g for g, outcome in zip(groups, outcomes, strict=True) if outcome == HELD)
    return {name: GroupScore(trials[name], held[name]) for name in sorted(trials)}


def first_held(
    outcomes: Sequence[str], scenes: Sequence[str], ranks: Sequence[int]
) -> dict[str, float]:
    """At which rank a robot succeeds that tries grasp after grasp, by scene.

    Args:
        outcomes: T outcomes.
        scenes: T names of the scenes.
        ranks: T places of the grasps in their scenes, 0 for the best.

    Returns:
        The lowest rank of each scene that held; infinity where none did.
    """
    first = dict.fromkeys(scenes, math.inf)
    for scene, rank, outcome in zip(scenes, ranks, outcomes, strict=True):
        if outcome == HELD:
            first[scene] = min(first[scene], rank)
    return first
