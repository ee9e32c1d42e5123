"""The rectangle metric: is a predicted grasp close enough to a labelled one?

A grasp is right when its overlap (intersection over union) with some labelled rectangle exceeds a
threshold and their angles differ by at most 30 degrees, modulo 180. The overlap is the exact area
of the polygons; that of the field's older code, counted in pixels, is an option.

Letters in shapes: N predicted grasps, M labels, S scenes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.grasps import Grasps, angle_difference
from graspmap.geometry.overlap import best_iou
from graspmap.metrics.intervals import RESAMPLES, Groups, bootstrap_means, check_values
from graspmap.metrics.pixel_overlap import pixel_iou

Floats = NDArray[np.float64]
Overlap = Literal["exact", "pixels"]
Rule = Literal["greater", "percent"]

THRESHOLDS = (0.25, 0.30, 0.50, 0.75)
"""Overlaps at which success is reported (thesis, Table 5.2)."""

MAX_ANGLE = float(np.radians(30))
"""Greatest difference of the angles of a right grasp, radians."""

ANGLES_DEG = (5, 10, 15, 20, 30, 45, 90)
"""Tolerances of the angle at which success is reported, degrees; 90 leaves the angle out."""

_ANGLE_SLACK = 1e-9
"""Radians by which rounding may exceed the angle: 30 degrees apart still counts as 30."""


@dataclass(frozen=True)
class RectangleScore:
    """Success over a set of scenes, with intervals.

    Attributes:
        scenes: Number of scenes counted.
        success: Share of scenes whose grasp is right, by overlap threshold.
        interval: Lower and upper end of each share.
        miou: Mean over scenes of the best angle-compatible overlap, 0 to 1.
        miou_interval: Its interval.
        auc: Area under success against threshold, from 0 to 1, exact.
        confidence: Confidence of the intervals.
    """

    scenes: int
    success: dict[float, float]
    interval: dict[float, tuple[float, float]]
    miou: float
    miou_interval: tuple[float, float]
    auc: float
    confidence: float = 0.95


def best_overlap(
    predicted: Grasps,
    labels: Grasps,
    *,
    max_angle: float = MAX_ANGLE,
    overlap: Overlap = "exact",
) -> Floats:
    """Best overlap of each predicted grasp with the labels whose angle fits.

    Args:
        predicted: N grasps, pixels.
        labels: M labelled grasps of the same picture, pixels.
        max_angle: Greatest difference of the angles, radians in [0, pi/2]; inclusive.
        overlap: ``exact`` polygon area, or ``pixels`` as older code counts it.

    Returns:
        (N,) intersection over union in [0, 1]; 0 where no label's angle fits.

    Raises:
        InvalidInputError: ``max_angle`` or ``overlap`` is not allowed.
    """
    return overlap_by_angle(predicted, labels, (max_angle,), overlap=overlap)[:, 0]


def overlap_by_angle(
    predicted: Grasps, labels: Grasps, max_angles: Sequence[float], *, overlap: Overlap = "exact"
) -> Floats:
    """Best overlap of each predicted grasp at several tolerances of the angle.

    Args:
        predicted: N grasps.
        labels: M labelled grasps.
        max_angles: A tolerances, radians in [0, pi/2].
        overlap: See `best_overlap`.

    Returns:
        (N, A) overlaps, as `best_overlap` gives them for each tolerance.

    Raises:
        InvalidInputError: As `best_overlap`.
    """
    for angle in max_angles:
        if not 0 <= angle <= np.pi / 2:
            raise InvalidInputError("max_angle", angle, "radians, 0 to pi/2")
    if overlap not in get_args(Overlap):
        raise InvalidInputError("overlap", repr(overlap), ", ".join(get_args(Overlap)))
    best = np.zeros((len(predicted), len(max_angles)))
    if not len(predicted) or not len(labels):
        return best
    # Pixels are counted once for all tolerances: that is slow, and exact areas are not.
    pixels = pixel_iou(predicted, labels) if overlap == "pixels" else None
    turn = angle_difference(predicted.angle[:, None], labels.angle)
    for a, angle in enumerate(max_angles):
        if pixels is None:
            best[:, a] = best_iou(predicted, labels, angle + _ANGLE_SLACK)
        else:
            best[:, a] = (pixels * (turn <= angle + _ANGLE_SLACK)).max(axis=1)
    return best


def count_right(overlaps: Floats, thresholds: Sequence[float], *, rule: Rule = "greater") -> Floats:
    """Which scenes are right at which threshold.

    Args:
        overlaps: (S,) best overlaps.
        thresholds: T thresholds.
        rule: ``greater``: the overlap exceeds the threshold. ``percent``: the overlap, cut down
            to whole per cent, reaches it.

    Returns:
        (S, T) ones and zeros.
    """
    limits = np.asarray(thresholds, dtype=np.float64)
    if rule == "greater":
        right = overlaps[:, None] > limits
    else:
        # Per cent on both sides: 0.3 * 100 must not count as more than 30.
        right = _whole_percent(overlaps)[:, None] >= np.round(100 * limits, 9)
    return right.astype(np.float64)


def score_rectangles(
    overlaps: ArrayLike,
    *,
    rng: np.random.Generator,
    thresholds: Sequence[float] = THRESHOLDS,
    confidence: float = 0.95,
    groups: Groups | None = None,
    rule: Rule = "greater",
    resamples: int = RESAMPLES,
) -> RectangleScore:
    """Success at each threshold, mean overlap and area under the curve, with intervals.

    The area under success against threshold needs no sampling: the integral over t in [0, 1] of
    the share of overlaps above t is the mean overlap itself, so with the strict rule ``auc``
    equals ``miou``. (Published values differ in the third decimal because they sample the
    curve.) With the rule ``percent`` it is the mean of the overlaps cut down to whole per cent.

    Args:
        overlaps: (S,) best overlap of each scene's grasp, in [0, 1]; 0 where there is none.
        rng: Source of the bootstrap's resamples.
        thresholds: Overlaps, 0 to 1.
        confidence: Confidence of the intervals.
        groups: S labels of scenes that belong together (their objects), for intervals that hold
            for new objects; None: each scene on its own.
        rule: When an overlap reaches a threshold, see `count_right`.
        resamples: Number of resamples.

    Raises:
        InvalidInputError: No scenes, an overlap or a threshold outside [0, 1], or what
            `bootstrap_interval` does not allow.
    """
    values = check_values(overlaps)
    if values.min() < 0 or values.max() > 1 + 1e-9:
        raise InvalidInputError("overlap", f"{values.min()} to {values.max()}", "0 to 1")
    if not len(thresholds) or not all(0 <= t <= 1 for t in thresholds):
        raise InvalidInputError("thresholds", tuple(thresholds), "numbers from 0 to 1")
    if rule not in ("greater", "percent"):
        raise InvalidInputError("rule", repr(rule), "greater, percent")
    values = np.minimum(values, 1.0)
    right = count_right(values, thresholds, rule=rule)
    columns = np.column_stack([right, values])
    ends = bootstrap_means(
        columns, rng=rng, groups=groups, confidence=confidence, resamples=resamples
    )
    pairs = [(float(low), float(high)) for low, high in ends]
    area = values if rule == "greater" else _whole_percent(values) / 100
    return RectangleScore(
        scenes=len(values),
        success={float(t): float(p) for t, p in zip(thresholds, right.mean(axis=0), strict=True)},
        interval={float(t): pair for t, pair in zip(thresholds, pairs[:-1], strict=True)},
        miou=float(values.mean()),
        miou_interval=pairs[-1],
        auc=float(area.mean()),
        confidence=confidence,
    )


def _whole_percent(overlaps: Floats) -> Floats:
    """Overlaps in per cent, cut down to whole numbers."""
    cut: Floats = np.floor(100 * overlaps)
    return cut
