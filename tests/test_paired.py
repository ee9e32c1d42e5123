"""Paired comparison: published numbers, other people's code, enumeration, laws."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from graspmap.errors import InvalidInputError
from graspmap.metrics import compare_paired
from graspmap.metrics.paired import mcnemar, sign_flip

seeds = st.integers(0, 2**32)


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def compare(a, b, **options):
    return compare_paired(a, b, rng=generator(), **options)


def test_mcnemar_gives_the_published_numbers():
    """Fagerland et al. 2013, table 3: 1 and 7 of 21 airway measurements."""
    exact, mid_p = mcnemar(1, 7)
    assert exact == pytest.approx(0.0703, abs=5e-5)
    assert mid_p == pytest.approx(0.0391, abs=5e-5)


@given(only_a=st.integers(0, 3000), only_b=st.integers(0, 3000))
def test_mcnemar_agrees_with_the_binomial_test(only_a, only_b):
    total = only_a + only_b
    exact, mid_p = mcnemar(only_a, only_b)
    assert mcnemar(only_b, only_a) == (exact, mid_p)
    if total == 0:
        assert (exact, mid_p) == (1, 1)
        return
    assert exact == pytest.approx(stats.binomtest(only_a, total).pvalue, rel=1e-9)
    # More extreme outcomes, and half of those as extreme.
    counts = np.arange(total + 1)
    far, here = abs(2 * counts - total), abs(only_a - only_b)
    chance = stats.binom.pmf(counts, total, 0.5)
    expected = chance[far > here].sum() + chance[far == here].sum() / 2
    assert mid_p == pytest.approx(expected, rel=1e-9)


@given(seed=seeds, groups=st.integers(1, 9))
def test_sign_flips_near_the_enumeration_of_all_signs(seed, groups):
    rng = generator(seed)
    members = np.r_[np.arange(groups), rng.integers(0, groups, 6)]
    gains = rng.integers(-1, 2, len(members)).astype(float)
    sums = np.bincount(members, weights=gains)
    signs = np.array(list(itertools.product((-1, 1), repeat=groups)))
    exact = (abs(signs @ sums) >= abs(sums.sum())).mean()
    got = sign_flip(gains, groups=members.tolist(), rng=rng, flips=4000)
    assert got == pytest.approx(exact, abs=0.04)


def test_sign_flips_come_in_pieces(monkeypatch):
    gains = generator(1).normal(0.1, 1, 50)
    whole = sign_flip(gains, rng=generator(2), flips=500)
    monkeypatch.setattr("graspmap.metrics.paired._CHUNK", 1000)
    assert sign_flip(gains, rng=generator(2), flips=500) == pytest.approx(whole, abs=0.06)
    assert sign_flip(np.ones(40), rng=generator(3), flips=99) == 0.01


@given(seed=seeds, binary=st.booleans())
def test_the_order_of_the_detectors_only_changes_signs(seed, binary):
    rng = generator(seed)
    a, b = rng.random((2, 25))
    if binary:
        a, b = (a < 0.7), (b < 0.6)
    one = compare_paired(a, b, rng=generator(seed), resamples=100)
    other = compare_paired(b, a, rng=generator(seed), resamples=100)
    assert (one.mean_a, one.mean_b) == (other.mean_b, other.mean_a)
    assert one.difference == pytest.approx(-other.difference, abs=1e-15)
    assert one.interval == pytest.approx((-other.interval[1], -other.interval[0]), abs=1e-12)
    assert (one.only_a, one.only_b) == (other.only_b, other.only_a)
    assert one.p_value == other.p_value
    assert (one.only_a is not None) == binary


def test_shares_are_counted_by_hand():
    a, b = np.array([1, 1, 1, 1, 0, 0, 1, 0]), np.array([1, 0, 0, 0, 0, 1, 1, 0])
    found = compare(a, b)
    assert (found.scenes, found.groups) == (8, 8)
    assert (found.mean_a, found.mean_b, found.difference) == (5 / 8, 3 / 8, 2 / 8)
    assert (found.only_a, found.only_b) == (3, 1)
    assert (found.mcnemar_exact, found.mcnemar_mid_p) == mcnemar(3, 1)
    assert found.p_value == found.mcnemar_exact == pytest.approx(10 / 16)
    by_object = compare(a, b, groups=list("aabbccdd"))
    assert by_object.groups == 4
    assert by_object.p_value == pytest.approx(0.75, abs=0.03)  # sums 1, 2, -1, 0: 6 of 8 signs
    assert by_object.mcnemar_exact == found.mcnemar_exact


def test_the_interval_nears_that_of_a_paired_t_test():
    a = generator(4).beta(5, 2, 3000)
    b = a * generator(5).uniform(0.8, 1, 3000)
    expected = stats.ttest_rel(a, b).confidence_interval(0.95)
    found = compare_paired(a, b, rng=generator(), resamples=10_000)
    half = (expected.high - expected.low) / 2
    assert found.interval == pytest.approx((expected.low, expected.high), abs=0.06 * half)
    # The interval of either alone is far wider.
    assert half < 0.4 * 1.96 * a.std() / np.sqrt(3000)


@given(scenes=st.integers(2, 400), confidence=st.floats(0.5, 0.99))
def test_without_any_difference_the_interval_is_tangos(scenes, confidence):
    """Tango 1998 for no discordant pair: plus and minus z^2 / (n + z^2)."""
    z2 = stats.norm.ppf(0.5 + confidence / 2) ** 2
    same = compare(np.ones(scenes), np.ones(scenes), confidence=confidence)
    end = z2 / (scenes + z2)
    assert same.interval == pytest.approx((-end, end), abs=1e-9)
    assert same.p_value == 1
    apart = compare(np.ones(scenes), np.zeros(scenes), confidence=confidence)
    assert apart.interval == pytest.approx(((scenes - z2) / (scenes + z2), 1), abs=1e-9)
    assert apart.p_value == pytest.approx(2.0 ** (1 - scenes))


@given(scenes=st.integers(2, 60), seed=seeds)
def test_values_without_spread_still_allow_for_other_scenes(scenes, seed):
    overlaps = generator(seed).uniform(0.1, 0.9, scenes)
    same = compare(overlaps, overlaps).interval
    assert same[0] < 0 < same[1]
    # A constant difference shows no spread; the interval still allows for other scenes.
    apart = compare(overlaps, overlaps - 0.1)
    assert apart.interval[0] < 0.1 < apart.interval[1]
    # One scene apart, and the bootstrap sees the spread.
    other = overlaps.copy()
    other[0] += 0.05
    low, high = compare(other, overlaps).interval
    assert -1e-12 <= low <= 0.05 / scenes <= high <= 0.05 + 1e-12


def test_one_object_says_nothing():
    found = compare([1, 1, 0], [0, 1, 0], groups=["a"] * 3)
    assert found.interval == (-1, 1)
    assert found.p_value == 1


def test_the_summary_is_json():
    found = compare([1, 0.5, 0.2], [0, 1, 0])
    assert json.loads(json.dumps(found.to_dict()))["interval"] == list(found.interval)
    assert found.to_dict()["mcnemar_exact"] is None


@pytest.mark.parametrize(
    ("a", "b", "options", "name"),
    [
        ([], [], {}, "shape"),
        ([0.1, 1.2], [0, 0], {}, "values of a"),
        ([0.1, 1.0], [0, -0.1], {}, "values of b"),
        ([0.1, np.nan], [0, 0], {}, "values"),
        ([0.1, 1.0], [0], {}, "number of values of b"),
        ([0.1, 1.0], [0, 0], {"groups": ["a"]}, "group labels"),
        ([0.1, 1.0], [0, 0], {"confidence": 1}, "confidence"),
        ([1.0, 1.0], [0, 0], {"confidence": 1}, "confidence"),
        ([0.1, 1.0], [0, 0], {"resamples": 0}, "resamples"),
    ],
)
def test_refuses(a, b, options, name):
    with pytest.raises(InvalidInputError) as caught:
        compare(a, b, **options)
    assert name in caught.value.name


def test_refuses_impossible_counts():
    with pytest.raises(InvalidInputError, match="discordant"):
        mcnemar(-1, 2)
    with pytest.raises(InvalidInputError, match="sign flips"):
        sign_flip([0.1, 0.2], rng=generator(), flips=0)
