"""Saliency, depth error and confusion: counts by hand, brute force, laws."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from graspmap.errors import InvalidInputError
from graspmap.metrics import (
    depth_errors,
    saliency_marks,
    score_classes,
    score_depth,
    score_saliency,
    wilson_interval,
)
from graspmap.metrics.saliency import STEPS, f_measure

seeds = st.integers(0, 2**32)


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


# Saliency.


@given(seed=seeds, coarse=st.booleans())
def test_saliency_against_a_loop_over_thresholds(seed, coarse):
    rng = generator(seed)
    said = rng.integers(0, STEPS + 1, (6, 5)) / STEPS if coarse else rng.random((6, 5))
    mask, known = rng.random((6, 5)) < 0.4, rng.random((6, 5)) < 0.8
    mask[2, 2] = known[2, 2] = True
    marks = saliency_marks(said, mask, known)
    p, m = said[known], mask[known]
    assert marks.mae == pytest.approx(sum(abs(p - m)) / len(p))
    for k in range(STEPS + 1):
        positive = p * STEPS >= k
        precision = m[positive].mean() if positive.any() else 1
        assert marks.precision[k] == pytest.approx(precision)
        assert marks.recall[k] == pytest.approx(positive[m].mean())
    reached = p >= min(1, 2 * p.mean())
    hits = (reached & m).sum()
    # The F-measure from counts alone, without precision and recall.
    expected = 1.3 * hits / (reached.sum() + 0.3 * m.sum())
    assert marks.adaptive == pytest.approx(expected)


@given(arrays(np.float64, (2, 7), elements=st.floats(0, 1)))
def test_f_measure_lies_between_precision_and_recall(values):
    precision, recall = values
    found = f_measure(precision, recall)
    assert (found <= np.maximum(precision, recall) + 1e-12).all()
    assert (found >= np.minimum(precision, recall) - 1e-12).all()
    np.testing.assert_allclose(f_measure(recall, recall), recall, atol=1e-12)


def test_saliency_that_is_the_mask_is_perfect_and_its_reverse_is_not():
    masks = [generator(i).random((8, 8)) < 0.3 for i in range(5)]
    best = score_saliency([saliency_marks(m, m) for m in masks], rng=generator())
    assert (best.mae, best.f_measure, best.f_adaptive) == (0, 1, 1)
    assert best.mae_interval == pytest.approx((0, wilson_interval(0, 5)[1]))
    # At threshold 0 everything is said to be the object.
    share = np.mean([m.mean() for m in masks])
    assert best.precision[0] == pytest.approx(share)
    worst = score_saliency([saliency_marks(~m, m) for m in masks], rng=generator())
    assert worst.mae == 1
    assert worst.threshold == 0
    assert worst.f_measure == pytest.approx(np.mean([f_measure(m.mean(), 1) for m in masks]))


def test_saliency_is_a_mean_over_pictures_and_f_over_those_with_an_object():
    rng = generator(1)
    said, masks = rng.random((4, 6, 6)), rng.random((4, 6, 6)) < 0.4
    masks[3] = False
    marks = [saliency_marks(s, m) for s, m in zip(said, masks, strict=True)]
    found = score_saliency(marks, rng=generator(), groups=list("aabc"))
    assert (found.pictures, found.with_object) == (4, 3)
    assert found.mae == pytest.approx(
        np.mean([abs(s - m).mean() for s, m in zip(said, masks, strict=True)])
    )
    curve = np.mean([f_measure(m.precision, m.recall) for m in marks[:3]], axis=0)
    assert found.f_measure == pytest.approx(curve.max())
    assert found.f_mean == pytest.approx(curve.mean())
    assert found.threshold == curve.argmax() / STEPS
    assert found.mae_interval[0] <= found.mae <= found.mae_interval[1]
    assert len(found.precision) == len(found.recall) == STEPS + 1
    assert json.loads(json.dumps(found.to_dict()))["f_mean_interval"] == list(found.f_mean_interval)
    empty = score_saliency(marks[3:], rng=generator())
    assert (empty.with_object, empty.f_measure) == (0, None)
    assert empty.mae_interval == pytest.approx(wilson_interval(empty.mae, 1))
    assert saliency_marks(said[0], masks[0], np.zeros((6, 6), bool)) is None


@pytest.mark.parametrize(
    ("said", "mask", "known", "name"),
    [
        (np.zeros((2, 3)), np.zeros((3, 2)), None, "shapes"),
        (np.zeros((2, 2)), np.zeros((2, 2)), np.ones((2, 3)), "shapes"),
        (np.full((2, 2), 1.1), np.zeros((2, 2)), None, "saliency"),
        (np.full((2, 2), np.nan), np.zeros((2, 2)), None, "saliency"),
    ],
)
def test_saliency_refuses(said, mask, known, name):
    with pytest.raises(InvalidInputError) as caught:
        saliency_marks(said, mask, known)
    assert name in caught.value.name


# Depth.


def test_depth_errors_by_hand():
    said, true = [[1.0, 2.2], [0.0, 9.0]], [[1.0, 2.0], [0.5, np.nan]]
    found = depth_errors(said, true, np.isfinite(true))
    assert found.mae_m == pytest.approx(0.7 / 3)
    assert found.rmse_m == pytest.approx(np.sqrt((0.04 + 0.25) / 3))
    assert found.abs_relative == pytest.approx((0.1 + 1) / 3)
    assert found.within_1_25 == pytest.approx(2 / 3)
    assert depth_errors(said, true, np.zeros((2, 2), bool)) is None


@given(factor=st.floats(0.5, 2), seed=seeds)
def test_a_scaled_depth_has_closed_forms(factor, seed):
    true = generator(seed).uniform(0.3, 2, (5, 4))
    found = depth_errors(factor * true, true)
    assert found.abs_relative == pytest.approx(abs(factor - 1), abs=1e-12)
    assert found.mae_m == pytest.approx(abs(factor - 1) * true.mean(), abs=1e-12)
    assert found.rmse_m >= found.mae_m - 1e-15
    assert found.within_1_25 == float(max(factor, 1 / factor) < 1.25)


def test_depth_scores_are_means_with_intervals():
    rng = generator(2)
    errors = [depth_errors(rng.uniform(0.4, 0.6, (4, 4)), np.full((4, 4), 0.5)) for _ in range(30)]
    found = score_depth(errors, rng=generator())
    for name in ("mae_m", "rmse_m", "abs_relative", "within_1_25"):
        values = np.array([getattr(e, name) for e in errors])
        low, high = getattr(found, f"{name}_interval")
        assert getattr(found, name) == pytest.approx(values.mean())
        half = 2.045 * values.std(ddof=1) / np.sqrt(30)
        assert (low, high) == pytest.approx(
            (values.mean() - half, values.mean() + half), abs=0.25 * half + 1e-12
        )
    alone = score_depth(errors, rng=generator(), groups=["a"] * 30)
    assert alone.mae_m_interval is None
    assert json.loads(json.dumps(alone.to_dict()))["mae_m"] == pytest.approx(found.mae_m)


@pytest.mark.parametrize(
    ("said", "true", "known", "name"),
    [
        ([[1.0]], [[1.0, 2.0]], None, "shapes"),
        ([[1.0, np.nan]], [[1.0, 2.0]], None, "predicted depth"),
        ([[1.0, 1.0]], [[1.0, 0.0]], None, "known depth"),
        ([[1.0, 1.0]], [[1.0, np.nan]], None, "known depth"),
    ],
)
def test_depth_refuses(said, true, known, name):
    with pytest.raises(InvalidInputError) as caught:
        depth_errors(said, true, known)
    assert name in caught.value.name


# Classes.


@given(pairs=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1, max_size=40))
def test_classes_against_loops(pairs):
    found = score_classes(*np.array(pairs).T, "abcd", rng=generator())
    said, true = zip(*pairs, strict=True)
    for i in range(4):
        for j in range(4):
            assert found.confusion[i][j] == sum(p == (j, i) for p in pairs)
        hits = sum(p == (i, i) for p in pairs)
        assert found.recall[i] == (hits / true.count(i) if i in true else None)
        assert found.precision[i] == (hits / said.count(i) if i in said else None)
    right = sum(s == t for s, t in pairs)
    assert found.accuracy == pytest.approx(right / len(pairs))
    assert found.accuracy_interval == wilson_interval(right, len(pairs))
    assert found.majority == max(map(true.count, true)) / len(pairs)
    known = [r for r in found.recall if r is not None]
    assert found.balanced_accuracy == pytest.approx(sum(known) / len(known))


def test_always_the_same_class_is_as_good_as_the_majority():
    true = np.array([0] * 7 + [1] * 2 + [2])
    found = score_classes(np.zeros(10, int), true, ["mug", "pen", "box"], rng=generator())
    assert found.accuracy == found.majority == 0.7
    assert found.balanced_accuracy == pytest.approx(1 / 3)
    assert found.confusion == ((7, 0, 0), (2, 0, 0), (1, 0, 0))
    assert found.precision == (0.7, None, None)
    assert json.loads(json.dumps(found.to_dict()))["confusion"][1] == [2, 0, 0]


def test_pictures_of_one_object_widen_the_interval():
    true = np.repeat(generator(3).integers(0, 2, 20), 10)
    said = np.zeros(200, int)
    alone = score_classes(said, true, "ab", rng=generator())
    grouped = score_classes(said, true, "ab", rng=generator(), groups=np.repeat(np.arange(20), 10))
    assert np.ptp(grouped.accuracy_interval) > 2 * np.ptp(alone.accuracy_interval)
    one = score_classes([0, 1], [0, 0], "ab", rng=generator(), groups=["x", "x"])
    assert one.accuracy_interval == (0, 1)


@pytest.mark.parametrize(
    ("said", "true", "name"),
    [
        ([], [], "number of pictures"),
        ([0, 1], [0], "number of pictures"),
        ([0, 2], [0, 1], "said classes"),
        ([0, 1], [-1, 1], "true classes"),
        ([0.0, 1.0], [0, 1], "said classes"),
    ],
)
def test_classes_refuse(said, true, name):
    with pytest.raises(InvalidInputError) as caught:
        score_classes(said, true, "ab", rng=generator())
    assert name in caught.value.name
