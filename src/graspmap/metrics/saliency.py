"""How well a picture of probabilities tells an object from what surrounds it.

Letters in shapes: H rows, W columns of a picture; P pictures; K thresholds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import Groups, bootstrap_means
from graspmap.metrics.score import Score

Floats = NDArray[np.float64]

BETA_SQUARED = 0.3
"""Weight of recall in the F-measure, as the field has it: precision counts more."""

STEPS = 255
"""Thresholds are k / 255 for k from 0 to 255: those of an 8-bit picture."""


@dataclass(frozen=True, eq=False)
class SaliencyMarks:
    """Marks of one picture, over its known pixels.

    Attributes:
        mae: Mean absolute error of the probability, 0 to 1.
        precision: (K,) share of the pixels that reach each threshold which are on the object; 1
            where none reaches it. None where no known pixel is on the object.
        recall: (K,) share of the object's pixels that reach it; None likewise.
        adaptive: F-measure at twice the picture's mean probability (at most 1); None likewise.
    """

    mae: float
    precision: Floats | None
    recall: Floats | None
    adaptive: float | None


@dataclass(frozen=True, eq=False)
class SaliencyScore(Score):
    """Means over pictures, with intervals.

    Attributes:
        pictures: P.
        mae: Mean absolute error of the probability, 0 to 1.
        mae_interval: Lower and upper end.
        with_object: Pictures that show a known pixel of the object; what follows is of these, and
            None where there are none.
        f_measure: Mean F-measure at the threshold that is best for all pictures together.
        f_measure_interval: Lower and upper end, at that threshold.
        threshold: That threshold.
        f_mean: Mean F-measure over all thresholds.
        f_mean_interval: Lower and upper end.
        f_adaptive: Mean F-measure at a threshold of each picture's own, see `SaliencyMarks`.
        f_adaptive_interval: Lower and upper end.
        precision: (K,) mean precision at each threshold k / `STEPS`.
        recall: (K,) mean recall.
    """

    pictures: int
    mae: float
    mae_interval: tuple[float, float]
    with_object: int = 0
    f_measure: float | None = None
    f_measure_interval: tuple[float, float] | None = None
    threshold: float | None = None
    f_mean: float | None = None
    f_mean_interval: tuple[float, float] | None = None
    f_adaptive: float | None = None
    f_adaptive_interval: tuple[float, float] | None = None
    precision: tuple[float, ...] = ()
    recall: tuple[float, ...] = ()


def saliency_marks(
    said: ArrayLike, mask: ArrayLike, known: ArrayLike | None = None
) -> SaliencyMarks | None:
    """Marks of one picture.

    Args:
        said: (H, W) probability that the pixel is on the object, 0 to 1.
        mask: (H, W) bool, True on the object.
        known: (H, W) bool, where the mask is known; None for everywhere.

    Returns:
        The marks; None where nothing is known.

    Raises:
        InvalidInputError: The pictures differ in shape, or a probability is outside [0, 1].

    References:
        R. Achanta, S. Hemami, F. Estrada, S. Susstrunk, Frequency-tuned salient region detection,
        CVPR 2009 (F-measure with beta squared 0.3, adaptive threshold).
    """
    probability, truth = np.asarray(said, dtype=np.float64), np.asarray(mask, dtype=bool)
    where = np.ones(truth.shape, dtype=bool) if known is None else np.asarray(known, dtype=bool)
    if not probability.shape == truth.shape == where.shape:
        shapes = (probability.shape, truth.shape, where.shape)
        raise InvalidInputError("shapes of saliency, mask and known", shapes, "equal ones")
    probability, truth = probability[where], truth[where]
    if not len(truth):
        return None
    if not (probability.min() >= 0 and probability.max() <= 1):
        raise InvalidInputError("saliency", "outside 0 to 1 or NaN somewhere", "0 to 1")
    mae = float(np.abs(probability - truth).mean())
    if not truth.any():
        return SaliencyMarks(mae, None, None, None)
    level = np.floor(probability * STEPS).astype(np.int64)
    on, all_ = (
        np.bincount(levels, minlength=STEPS + 1)[::-1].cumsum()[::-1]
        for levels in (level[truth], level)
    )
    precision = np.where(all_ > 0, on / np.maximum(all_, 1), 1.0)
    reached = probability >= min(1.0, 2 * float(probability.mean()))
    hits = int((reached & truth).sum())
    adaptive = f_measure(
        np.array(hits / reached.sum() if reached.any() else 1.0), np.array(hits / truth.sum())
    )
    return SaliencyMarks(mae, precision, on / on[0], float(adaptive))


def f_measure(precision: Floats, recall: Floats) -> Floats:
    """Weighted harmonic mean of precision and recall, with `BETA_SQUARED`; 0 where both are 0."""
    below = BETA_SQUARED * precision + recall
    return np.where(
        below > 0, (1 + BETA_SQUARED) * precision * recall / np.where(below > 0, below, 1), 0.0
    )


def score_saliency(
    marks: Sequence[SaliencyMarks],
    *,
    rng: np.random.Generator,
    groups: Groups | None = None,
    confidence: float = 0.95,
) -> SaliencyScore:
    """Average the marks of pictures.

    Args:
        marks: P pictures' marks.
        rng: Source of the bootstrap's resamples.
        groups: P labels of pictures that belong together; None: each alone.
        confidence: Confidence of the intervals.

    Raises:
        InvalidInputError: No pictures, or what `bootstrap_means` does not allow.
    """

    def means(columns: Floats, names: Groups | None) -> list[tuple[float, tuple[float, float]]]:
        ends = bootstrap_means(columns, rng=rng, groups=names, confidence=confidence).tolist()
        centres = columns.mean(axis=0).tolist()
        return [(mean, (low, high)) for mean, (low, high) in zip(centres, ends, strict=True)]

    if not len(marks):
        raise InvalidInputError("number of pictures", 0, "1 or more")
    ((mae, mae_interval),) = means(np.array([[m.mae] for m in marks]), groups)
    shown = [i for i, m in enumerate(marks) if m.precision is not None]
    if not shown:
        return SaliencyScore(len(marks), mae, mae_interval)
    precision = np.array([marks[i].precision for i in shown])
    recall = np.array([marks[i].recall for i in shown])
    each, names = f_measure(precision, recall), None
    if groups is not None:
        names = [groups[i] for i in shown]
    best = int(each.mean(axis=0).argmax())
    adaptive = np.array([marks[i].adaptive for i in shown], dtype=np.float64)
    greatest, mean_f, own = means(
        np.column_stack([each[:, best], each.mean(axis=1), adaptive]), names
    )
    return SaliencyScore(
        pictures=len(marks),
        mae=mae,
        mae_interval=mae_interval,
        with_object=len(shown),
        f_measure=greatest[0],
        f_measure_interval=greatest[1],
        threshold=best / STEPS,
        f_mean=mean_f[0],
        f_mean_interval=mean_f[1],
        f_adaptive=own[0],
        f_adaptive_interval=own[1],
        precision=tuple(precision.mean(axis=0).tolist()),
        recall=tuple(recall.mean(axis=0).tolist()),
    )
