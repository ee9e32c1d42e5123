"""Comparing ways of training over seeds and scenes: coverage, closed forms, laws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.metrics.correlation import correlation_gain
from graspmap.metrics.paired import compare_paired
from graspmap.metrics.seeds import compare_seeds


def draw(rng, seeds, objects, views, gain, *, seed_spread, object_spread):
    """Values of two ways: objects and seeds shift the gain, each scene adds noise of its own."""
    shift = gain + object_spread * rng.uniform(-1, 1, (1, objects)).repeat(views, axis=1)
    shift = shift + seed_spread * rng.uniform(-1, 1, (seeds, 1))
    shape = (seeds, objects * views)
    b = rng.uniform(0.35, 0.45, shape)
    return b + shift + rng.uniform(-0.05, 0.05, shape), b, np.arange(objects).repeat(views)


@pytest.mark.parametrize(
    ("seeds", "seed_spread", "object_spread"),
    [(3, 0.0, 0.2), (3, 0.1, 0.05), (3, 0.05, 0.2), (5, 0.1, 0.1)],
)
def test_the_truth_lies_inside_as_often_as_it_says(seeds, seed_spread, object_spread):
    rng, truth, times = np.random.default_rng(4), 0.05, 300
    inside = 0
    for _ in range(times):
        a, b, groups = draw(rng, seeds, 30, 2, truth, seed_spread=seed_spread,
                            object_spread=object_spread)  # fmt: skip
        low, high = compare_seeds(a, b, groups=groups, rng=rng, resamples=300).interval
        inside += low <= truth <= high
    # Four standard errors of the share below its 95 %; too wide is allowed.
    assert inside / times > 0.95 - 4 * math.sqrt(0.95 * 0.05 / times)


def test_scenes_alone_would_be_too_sure():
    """With seeds that differ, the interval over scenes misses the truth most of the time."""
    rng, truth, times = np.random.default_rng(4), 0.05, 100
    inside = 0
    for _ in range(times):
        a, b, _ = draw(rng, 3, 200, 1, truth, seed_spread=0.1, object_spread=0.02)
        low, high = compare_seeds(a, b, rng=rng, resamples=200).scenes.interval
        inside += low <= truth <= high
    assert inside / times < 0.5


def test_closed_form_where_scenes_agree():
    """No scene differs from another but every seed does: Student's interval, and Wilson's part."""
    gains = np.array([0.1, 0.2, 0.3])
    b = np.full((3, 50), 0.4)
    found = compare_seeds(b + gains[:, None], b, rng=np.random.default_rng(0))
    assert found.by_seed == pytest.approx((0.1, 0.2, 0.3))
    assert found.difference == pytest.approx(0.2)
    student = 4.302652729911275 * 0.1 / math.sqrt(3)
    low, high = found.scenes.interval
    assert found.interval[0] == pytest.approx(0.2 - math.hypot(0.2 - low, student))
    assert found.interval[1] == pytest.approx(0.2 + math.hypot(high - 0.2, student))


@settings(max_examples=40)
@given(st.integers(2, 4), st.integers(2, 12), st.integers(0, 99))
def test_laws(seeds, scenes, seed):
    rng = np.random.default_rng(seed)
    a, b = rng.integers(0, 2, (2, seeds, scenes)).astype(float)
    one = compare_seeds(a, b, rng=np.random.default_rng(1), resamples=50)
    low, high = one.interval
    over = one.scenes.interval
    assert -1 <= low <= max(-1.0, over[0]) <= over[1] <= high <= 1
    assert one.difference == pytest.approx(np.mean(one.by_seed))
    other = compare_seeds(b, a, rng=np.random.default_rng(1), resamples=50)
    assert other.difference == pytest.approx(-one.difference)
    # Seeds that all did the same add nothing.
    same = compare_seeds(a[[0, 0]], b[[0, 0]], rng=np.random.default_rng(1), resamples=50)
    alone = compare_paired(a[0], b[0], rng=np.random.default_rng(1), resamples=50)
    assert same.interval == pytest.approx(alone.interval)


@pytest.mark.parametrize("shape", [(1, 5), (5,), (3, 5, 1)])
def test_refuses(shape):
    with pytest.raises(InvalidInputError, match="two seeds or more"):
        compare_seeds(np.zeros(shape), np.zeros(shape), rng=np.random.default_rng(0))


def with_correlations(r, s, between, models):
    """Numbers of ``models`` models whose correlations are exactly these."""
    rng = np.random.default_rng(0)
    basis = rng.normal(size=(models, 3))
    basis -= basis.mean(axis=0)
    basis, _ = np.linalg.qr(basis)
    root = np.linalg.cholesky(np.array([[1, between, r], [between, 1, s], [r, s, 1]]))
    return (basis @ root.T).T


def test_the_example_that_zou_prints():
    """Zou 2007, overlapping correlations: 0.396 and 0.179 of 66, 0.088 between: -0.093 to 0.517."""
    a, b, outcome = with_correlations(0.396, 0.179, 0.088, 66)
    found = correlation_gain(a, b, outcome)
    assert found.difference == pytest.approx(0.217)
    assert found.interval == pytest.approx((-0.093, 0.517), abs=5e-4)


def test_measures_that_go_together_are_compared_more_closely():
    spans = []
    for between in (0.3, 0.6, 0.9):
        low, high = correlation_gain(*with_correlations(0.6, 0.5, between, 20)).interval
        spans.append(high - low)
    assert spans == sorted(spans, reverse=True)


def test_a_measure_against_itself():
    a, _, outcome = with_correlations(0.6, 0.5, 0.3, 12)
    found = correlation_gain(a, a, outcome)
    assert found.difference == 0
    low, high = found.interval
    assert low == pytest.approx(-high)
    wide = correlation_gain(*with_correlations(0.6, 0.6, 0.3, 12)).interval
    assert high < wide[1] / 2


def test_one_that_never_varies_has_no_correlation():
    a, b, outcome = with_correlations(0.6, 0.5, 0.3, 12)
    found = correlation_gain(np.ones(12), b, outcome)
    assert (found.a, found.difference, found.interval) == (None, None, None)
    assert found.b == pytest.approx(0.5)
    assert correlation_gain(a, b, np.ones(12)).to_dict()["interval"] is None
