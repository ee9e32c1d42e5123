"""Correlation over models: the thesis's numbers, other people's code, laws."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import stats

from graspmap.errors import InvalidInputError
from graspmap.metrics import correlate

# Thesis, table 5.2: mean overlap, success at 25 % and simulated trials of nine models.
MIOU = [62.46, 57.40, 64.13, 65.57, 61.16, 66.98, 66.61, 65.05, 67.69]
TRIALS = [85.41, 85.43, 86.58, 85.36, 83.06, 85.89, 85.69, 85.78, 87.94]

seeds = st.integers(0, 2**32)


def test_the_correlation_that_the_thesis_reports():
    """Section 5.2.1: r = 0.541, p = 0.132 (the table is rounded)."""
    found = correlate(MIOU, TRIALS)
    assert found.models == 9
    assert found.pearson == pytest.approx(0.541, abs=5e-4)
    assert found.pearson_p == pytest.approx(0.132, abs=1e-3)
    assert found.pearson_interval == pytest.approx((-0.19, 0.89), abs=0.005)


@given(seed=seeds, models=st.integers(4, 40), confidence=st.floats(0.5, 0.99))
def test_pearson_agrees_with_scipy(seed, models, confidence):
    x, y = np.random.default_rng(seed).normal(size=(2, models))
    found, expected = correlate(x, y, confidence=confidence), stats.pearsonr(x, y)
    assert found.pearson == pytest.approx(expected.statistic, abs=1e-12)
    assert found.pearson_p == pytest.approx(expected.pvalue, rel=1e-6)
    ends = expected.confidence_interval(confidence)
    assert found.pearson_interval == pytest.approx((ends.low, ends.high), abs=1e-9)


@given(values=st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), min_size=4, max_size=20))
def test_spearman_agrees_with_scipy_also_with_ties(values):
    x, y = np.array(values, dtype=float).T
    assume(np.ptp(x) > 0 and np.ptp(y) > 0)
    found, expected = correlate(x, y), stats.spearmanr(x, y)
    assert found.spearman == pytest.approx(expected.statistic, abs=1e-12)
    least = 2 / math.factorial(len(x))
    assert found.spearman_p == pytest.approx(max(expected.pvalue, least), rel=1e-6)
    low, high = found.spearman_interval
    assert -1 <= low <= found.spearman <= high <= 1


def test_the_interval_of_bonett_and_wright_by_hand():
    """r = 0.6 of 9: atanh 0.6 = 0.693147, standard error sqrt(1.18 / 6) = 0.443471."""
    x, y = np.arange(9), np.array([4, 3, 2, 1, 0, 7, 6, 5, 8])
    found = correlate(x, y)
    assert found.spearman == pytest.approx(0.6)
    ends = (math.tanh(0.693147 - 1.959964 * 0.443471), math.tanh(0.693147 + 1.959964 * 0.443471))
    assert found.spearman_interval == pytest.approx(ends, abs=1e-6)


@given(seed=seeds, scale=st.floats(1e-150, 1e150), shift=st.floats(-10, 10))
def test_units_do_not_matter(seed, scale, shift):
    x, y = np.random.default_rng(seed).random((2, 7))
    plain = correlate(x, y)
    moved = correlate(scale * x, y + shift)
    assert moved.pearson == pytest.approx(plain.pearson, abs=1e-9)
    assert moved.spearman == pytest.approx(plain.spearman, abs=1e-12)
    turned = correlate(x, -y)
    assert turned.pearson == pytest.approx(-plain.pearson, abs=1e-12)
    low, high = plain.spearman_interval
    assert turned.spearman_interval == pytest.approx((-high, -low), abs=1e-12)


@pytest.mark.parametrize("models", [4, 5, 9])
def test_a_perfect_order_of_few_models_is_no_proof(models):
    x = np.arange(models, dtype=float)
    found = correlate(x, x**3)
    assert found.spearman == 1
    low, high = found.spearman_interval
    assert low < 0.97
    assert high == 1
    assert found.spearman_p == pytest.approx(2 / math.factorial(models), rel=1e-9)
    assert correlate(x, -(x**3)).spearman_interval == (-1, -low)
    line = correlate(x, 3 * x - 1)
    assert (line.pearson, line.pearson_interval, line.pearson_p) == (1, (1, 1), 0)


def test_a_constant_has_no_correlation():
    found = correlate([0.5] * 5, [1, 2, 3, 4, 5])
    assert found.pearson is found.pearson_interval is found.spearman is found.spearman_p is None
    summary = json.loads(json.dumps(found.to_dict()))
    assert summary["models"] == 5
    assert summary["pearson_interval"] is None


def test_the_summary_is_json():
    found = correlate(MIOU, TRIALS)
    summary = json.loads(json.dumps(found.to_dict()))
    assert summary["pearson_interval"] == list(found.pearson_interval)
    assert summary["spearman"] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("x", "y", "options", "name"),
    [
        ([1, 2, 3], [1, 2, 3], {}, "number of models"),
        ([1, 2, 3, 4], [1, 2, 3], {}, "number of values of y"),
        ([1, 2, 3, np.inf], [1, 2, 3, 4], {}, "values"),
        ([], [], {}, "shape"),
        ([1, 2, 3, 4], [1, 2, 3, 4], {"confidence": 95}, "confidence"),
    ],
)
def test_refuses(x, y, options, name):
    with pytest.raises(InvalidInputError) as caught:
        correlate(x, y, **options)
    assert name in caught.value.name
