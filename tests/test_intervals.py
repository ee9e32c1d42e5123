"""Intervals: published numbers, closed forms, other people's code, and coverage by simulation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from graspmap.errors import InvalidInputError
from graspmap.metrics import bootstrap_interval, wilson_interval
from graspmap.metrics.intervals import bootstrap_means


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


# Newcombe, Statistics in Medicine 17, 1998, table I, method 3.
@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_gives_the_published_numbers(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


@given(
    trials=st.integers(1, 5000),
    share=st.floats(0, 1),
    confidence=st.floats(0.5, 0.999),
)
def test_wilson_agrees_with_scipy(trials, share, confidence):
    successes = round(share * trials)
    expected = stats.binomtest(successes, trials).proportion_ci(confidence, method="wilson")
    got = wilson_interval(successes, trials, confidence)
    assert got == pytest.approx((expected.low, expected.high), abs=1e-9)
    assert 0 <= got[0] <= successes / trials <= got[1] <= 1


@given(trials=st.integers(1, 1000), share=st.floats(0, 1))
def test_wilson_mirrors(trials, share):
    low, high = wilson_interval(share * trials, trials)
    mirrored = wilson_interval(trials - share * trials, trials)
    assert mirrored == pytest.approx((1 - high, 1 - low), abs=1e-9)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ((0, 0), "trials"),
        ((0, np.nan), "trials"),
        ((3, 2), "successes"),
        ((-1, 2), "successes"),
        ((np.nan, 2), "successes"),
        ((1, 2, 1.0), "confidence"),
        ((1, 2, 95), "confidence"),
        ((1, 2, np.nan), "confidence"),
    ],
)
def test_wilson_refuses(arguments, name):
    with pytest.raises(InvalidInputError) as caught:
        wilson_interval(*arguments)
    assert name in caught.value.name


def test_bootstrap_of_a_mean_nears_the_normal_interval():
    values = generator(1).normal(5.0, 2.0, 2000)
    half = stats.norm.ppf(0.975) * values.std() / np.sqrt(len(values))
    expected = (values.mean() - half, values.mean() + half)
    got = bootstrap_interval(values, rng=generator(), resamples=20_000)
    assert got == pytest.approx(expected, abs=0.04 * half)


def test_bootstrap_of_a_share_is_the_binomial():
    """Resampling zeros and ones by scene is drawing from a binomial distribution."""
    trials, successes = 400, 288
    values = np.r_[np.ones(successes), np.zeros(trials - successes)]
    tail = stats.norm.cdf(stats.t.ppf(0.025, trials - 1) * np.sqrt(trials / (trials - 1)))
    expected = stats.binom.ppf([tail, 1 - tail], trials, successes / trials) / trials
    got = bootstrap_interval(values, rng=generator(), resamples=50_000)
    assert got == pytest.approx(tuple(expected), abs=1.01 / trials)


@given(seed=st.integers(0, 2**32), scale=st.floats(0.1, 10), shift=st.floats(-5, 5))
def test_bootstrap_moves_with_the_values(seed, scale, shift):
    values = generator(seed).random(30)
    plain = bootstrap_interval(values, rng=generator(seed), resamples=50)
    moved = bootstrap_interval(scale * values + shift, rng=generator(seed), resamples=50)
    assert moved == pytest.approx(tuple(scale * np.array(plain) + shift), abs=1e-9)
    assert values.min() <= plain[0] <= plain[1] <= values.max()


@given(seed=st.integers(0, 2**32), confidence=st.floats(0.5, 0.9))
def test_more_confidence_is_wider(seed, confidence):
    values = generator(seed).random(20)
    low, high = bootstrap_interval(
        values, rng=generator(seed), confidence=confidence, resamples=200
    )
    wider = bootstrap_interval(values, rng=generator(seed), confidence=0.99, resamples=200)
    assert wider[0] <= low <= high <= wider[1]


def test_any_statistic_and_the_fast_mean_agree():
    values, groups = generator(2).random(60), np.repeat(np.arange(20), 3)
    fast = bootstrap_interval(values, rng=generator(3), groups=groups, resamples=4000)
    slow = bootstrap_interval(
        values, rng=generator(4), groups=groups, resamples=4000, statistic=lambda v: float(v.mean())
    )
    assert slow == pytest.approx(fast, abs=0.006)
    low, high = bootstrap_interval(values, rng=generator(), statistic=np.median, resamples=500)
    assert low <= np.median(values) <= high


def test_groups_of_equal_scenes_count_once():
    """Ten copies of each scene say nothing new: the interval is that of the single scenes."""
    values = generator(5).random(40)
    single = bootstrap_interval(values, rng=generator(6))
    names = [f"object {i}" for i in range(40) for _ in range(10)]
    grouped = bootstrap_interval(np.repeat(values, 10), rng=generator(6), groups=names)
    assert grouped == pytest.approx(single, abs=1e-12)
    alone = bootstrap_interval(np.repeat(values, 10), rng=generator(6))
    assert alone[1] - alone[0] < 0.5 * (single[1] - single[0])


def test_chunks_do_not_matter(monkeypatch):
    values = generator(7).random((50, 2))
    whole = bootstrap_means(values, rng=generator(8), resamples=300)
    monkeypatch.setattr("graspmap.metrics.intervals._CHUNK", 170)
    pieces = bootstrap_means(values, rng=generator(8), resamples=300)
    np.testing.assert_allclose(pieces, whole, rtol=0, atol=1e-15)


def test_the_same_generator_gives_the_same_interval():
    values = generator(9).random(30)
    first = bootstrap_interval(values, rng=generator(10))
    assert first == bootstrap_interval(values, rng=generator(10))
    assert first != bootstrap_interval(values, rng=generator(11))


def test_values_without_spread():
    assert bootstrap_interval([0.4] * 9, rng=generator()) == pytest.approx((0.4, 0.4))
    assert bootstrap_interval([0.4], rng=generator()) == (-np.inf, np.inf)
    ends = bootstrap_means(np.array([[1.0, 0.0, 0.4]] * 9), rng=generator())
    expected = [wilson_interval(9, 9), wilson_interval(0, 9), wilson_interval(3.6, 9)]
    np.testing.assert_allclose(ends, expected)


def test_one_group_alone():
    values = np.array([[0.2, 1.0], [0.6, 1.0]])
    ends = bootstrap_means(values, rng=generator(), groups=["a", "a"])
    np.testing.assert_allclose(ends, [(0, 1), wilson_interval(1, 1)])


@pytest.mark.parametrize(
    ("values", "options", "name"),
    [
        ([], {}, "shape of the values"),
        ([[0.1]], {}, "shape of the values"),
        ([0.1, np.nan], {}, "values"),
        ([0.1, 0.2], {"groups": ["a"]}, "group labels"),
        ([0.1, 0.2], {"resamples": 0}, "resamples"),
        ([0.1, 0.2], {"confidence": 0}, "confidence"),
    ],
)
def test_bootstrap_refuses(values, options, name):
    with pytest.raises(InvalidInputError) as caught:
        bootstrap_interval(values, rng=generator(), **options)
    assert name in caught.value.name


def shares(rng):
    return (rng.random(60) < 0.7).astype(float), None


def overlaps(rng):
    return rng.beta(2.0, 1.5, 60), None


def objects(rng):
    """25 objects with a success rate of their own, 1 to 6 pictures each."""
    rate, pictures = rng.beta(4, 2, 25), rng.integers(1, 7, 25)
    groups = np.repeat(np.arange(25), pictures)
    return (rng.random(len(groups)) < rate[groups]).astype(float), groups


@pytest.mark.parametrize(("draw", "truth"), [(shares, 0.7), (overlaps, 2 / 3.5), (objects, 4 / 6)])
def test_nominal_95_percent_covers_the_truth_in_93_to_97(draw, truth):
    """1,000 experiments; 300 resamples each keep it quick, and cost nothing in coverage."""
    hits = 0
    for experiment in range(1000):
        rng = np.random.default_rng([17, experiment])
        values, groups = draw(rng)
        low, high = bootstrap_interval(values, rng=rng, groups=groups, resamples=300)
        hits += low <= truth <= high
    assert 930 <= hits <= 970


def test_ignoring_the_objects_would_promise_too_much():
    """What groups are for: pictures of one object are not independent."""
    hits = 0
    for experiment in range(300):
        rng = np.random.default_rng([18, experiment])
        rate = rng.beta(1, 0.5, 25)
        values = (rng.random((25, 8)) < rate[:, None]).astype(float).ravel()
        low, high = bootstrap_interval(values, rng=rng, resamples=200)
        hits += low <= 2 / 3 <= high
    assert hits < 0.85 * 300
