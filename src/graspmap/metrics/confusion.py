"""Which class was said of objects of which class: accuracy, and the confusion matrix.

Letters in shapes: P pictures, K classes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import Groups, share_interval
from graspmap.metrics.score import Score


@dataclass(frozen=True)
class ClassScore(Score):
    """How often the class was right.

    Attributes:
        pictures: P.
        accuracy: Share of pictures whose class was right.
        accuracy_interval: Lower and upper end.
        majority: Share of the most frequent true class: the accuracy of always saying that one.
        balanced_accuracy: Recall averaged over the classes that occur, each counted once.
        classes: K names.
        confusion: K rows of K counts: true class by row, said class by column.
        recall: Of the pictures of each class, the share that was said to be of it; None where
            there are none.
        precision: Of the pictures said to be of each class, the share that is; None likewise.
    """

    pictures: int
    accuracy: float
    accuracy_interval: tuple[float, float]
    majority: float
    balanced_accuracy: float
    classes: tuple[str, ...]
    confusion: tuple[tuple[int, ...], ...]
    recall: tuple[float | None, ...]
    precision: tuple[float | None, ...]


def score_classes(
    said: ArrayLike,
    true: ArrayLike,
    classes: Sequence[str],
    *,
    rng: np.random.Generator,
    groups: Groups | None = None,
    confidence: float = 0.95,
) -> ClassScore:
    """Count classes.

    Args:
        said: (P,) numbers of the classes that were said, 0 to K - 1.
        true: (P,) numbers of the true classes.
        classes: K names.
        rng: Source of the bootstrap's resamples.
        groups: P labels of pictures that belong together. Where there are none, or no two
            pictures have the same, the interval is Wilson's.
        confidence: Confidence of the interval.

    Raises:
        InvalidInputError: No pictures, lists of unequal length, a number that is no class, or
            what `share_interval` does not allow.
    """
    count = len(classes)
    named, actual = _numbers(said, count, "said classes"), _numbers(true, count, "true classes")
    if len(named) != len(actual) or not len(actual):
        raise InvalidInputError(
            "number of pictures", f"{len(named)} said, {len(actual)} true", "as many, 1 or more"
        )
    matrix = np.bincount(actual * count + named, minlength=count**2).reshape(count, count)
    right, occurring, answered = np.diag(matrix), matrix.sum(axis=1), matrix.sum(axis=0)
    recall, precision = (
        [int(r) / int(t) if t else None for r, t in zip(right, totals, strict=True)]
        for totals in (occurring, answered)
    )
    hits = named == actual
    return ClassScore(
        pictures=len(hits),
        accuracy=float(hits.mean()),
        accuracy_interval=share_interval(hits, rng=rng, groups=groups, confidence=confidence),
        majority=float(occurring.max()) / len(hits),
        balanced_accuracy=float(np.mean([r for r in recall if r is not None])),
        classes=tuple(classes),
        confusion=tuple(tuple(row) for row in matrix.tolist()),
        recall=tuple(recall),
        precision=tuple(precision),
    )


def _numbers(values: ArrayLike, count: int, name: str) -> np.ndarray[Any, np.dtype[np.int64]]:
    numbers = np.asarray(values)
    if numbers.ndim != 1 or (len(numbers) and numbers.dtype.kind not in "iu"):
        raise InvalidInputError(name, f"{numbers.dtype} {numbers.shape}", "(P,) whole numbers")
    if len(numbers) and not 0 <= numbers.min() <= numbers.max() < count:
        raise InvalidInputError(
            name, f"{numbers.min()} to {numbers.max()}", f"0 to {count - 1}, the known classes"
        )
    return numbers.astype(np.int64)
