"""Calibration: counts by hand, brute force, scikit-like definitions, laws, coverage."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.metrics import score_calibration, wilson_interval

seeds = st.integers(0, 2**32)


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def score(quality, held, **options):
    return score_calibration(quality, held, rng=generator(), **{"resamples": 200} | options)


def test_five_trials_by_hand():
    found = score([0.1, 0.3, 0.35, 0.9, 1.0], [0, 1, 0, 1, 1], bins=5)
    assert [(b.low, b.high, b.count) for b in found.bins] == [
        (0, 0.2, 1),
        (0.2, 0.4, 2),
        (0.8, 1, 2),
    ]
    assert [b.quality for b in found.bins] == pytest.approx([0.1, 0.325, 0.95])
    assert [b.held for b in found.bins] == [0, 0.5, 1]
    assert found.bins[1].interval == wilson_interval(1, 2)
    assert found.trials == 5
    assert found.base_rate == pytest.approx(0.6)
    assert found.ece == pytest.approx((0.1 + 2 * 0.175 + 2 * 0.05) / 5)
    assert found.brier == pytest.approx((0.01 + 0.49 + 0.1225 + 0.01 + 0) / 5)
    assert found.reliability == pytest.approx((0.01 + 2 * 0.175**2 + 2 * 0.05**2) / 5)
    assert found.resolution == pytest.approx((0.36 + 2 * 0.01 + 2 * 0.16) / 5)
    assert found.uncertainty == pytest.approx(0.24)


@given(
    seed=seeds,
    trials=st.integers(1, 60),
    bins=st.integers(1, 12),
    binning=st.sampled_from(["width", "count"]),
    coarse=st.booleans(),
)
def test_laws(seed, trials, bins, binning, coarse):
    rng = generator(seed)
    quality = rng.random(trials)
    if coarse:
        quality = np.round(quality, 1)  # ties, and values on the edges
    held = rng.random(trials) < quality
    found = score(quality, held, bins=bins, binning=binning, resamples=20)
    assert sum(b.count for b in found.bins) == trials
    assert all(
        b.low <= b.quality <= b.high or b.quality == pytest.approx(b.low) for b in found.bins
    )
    assert all(b.count > 0 and b.interval[0] <= b.held <= b.interval[1] for b in found.bins)
    assert [b.low for b in found.bins] == sorted({b.low for b in found.bins})
    parts = found.reliability - found.resolution + found.uncertainty + found.within_bins
    assert found.brier == pytest.approx(parts, abs=1e-12)
    assert found.brier == pytest.approx(((quality - held) ** 2).mean(), abs=1e-12)
    # The mean absolute gap lies between the gap of all together and the root mean square.
    assert abs(quality.mean() - held.mean()) - 1e-12 <= found.ece
    assert found.ece <= np.sqrt(found.reliability) + 1e-12
    for value, (low, high) in (
        (found.ece, found.ece_interval),
        (found.brier, found.brier_interval),
    ):
        assert 0 <= low <= value + 1e-12
        assert low <= high <= 1
    assert found.ece <= found.ece_interval[1] + 1e-12


@given(seed=seeds, bins=st.integers(1, 20))
def test_equal_widths_against_a_loop(seed, bins):
    rng = generator(seed)
    quality, held = rng.random(80), rng.random(80) < 0.5
    expected = 0.0
    for b in range(bins):
        last = b == bins - 1
        inside = [b / bins <= q < (b + 1) / bins or (last and q == 1) for q in quality]
        if any(inside):
            expected += abs(sum(quality[inside]) - sum(held[inside])) / 80
    assert score(quality, held, bins=bins, resamples=5).ece == pytest.approx(expected, abs=1e-12)


def test_equal_qualities_of_constant_bins_leave_nothing_within():
    """With one quality a bin Murphy's three parts are all there is."""
    quality = np.repeat([0.05, 0.45, 0.85], 20)
    found = score(quality, generator(1).random(60) < quality)
    assert found.within_bins == pytest.approx(0, abs=1e-15)


def test_equal_counts():
    quality = generator(2).beta(5, 2, 103)
    found = score(quality, np.ones(103), bins=5, binning="count")
    assert [b.count for b in found.bins] == pytest.approx([20.6] * 5, abs=1)
    assert found.bins[0].low == quality.min()
    assert found.bins[-1].high == quality.max()
    tied = score([0.5] * 7 + [0.9], [1] * 8, bins=4, binning="count")
    assert [b.count for b in tied.bins] == [8] or [b.count for b in tied.bins] == [7, 1]
    assert len(score([0.5] * 7, [1] * 7, binning="count").bins) == 1


def test_a_detector_that_knows_is_not_told_off():
    rng = generator(3)
    quality = rng.beta(2, 2, 20_000)
    found = score(quality, rng.random(20_000) < quality)
    assert found.ece < 0.02
    assert found.ece_interval[0] == 0
    # Saying the truth: reliability nothing, Brier score the mean of p (1 - p) = 1/2 - 3/10.
    assert found.brier == pytest.approx(0.2, abs=0.006)
    sure = score(np.clip(quality + 0.2, 0, 1), rng.random(20_000) < quality)
    assert sure.ece_interval[0] > 0.15


def test_all_held_is_as_uncertain_as_wilson_says():
    found = score([1.0] * 20, [1] * 20)
    slack = 1 - wilson_interval(20, 20)[0]
    assert found.ece == found.brier == 0
    assert found.ece_interval == pytest.approx((0, slack))
    assert found.brier_interval == pytest.approx((0, slack))


def test_copies_of_a_trial_say_nothing_new():
    rng = generator(4)
    quality = rng.random(60)
    held = rng.random(60) < quality**2
    single = score(quality, held, resamples=2000)
    names = [f"scene {i}" for i in range(60) for _ in range(8)]
    grouped = score(np.repeat(quality, 8), np.repeat(held, 8), groups=names, resamples=2000)
    assert grouped.ece == pytest.approx(single.ece)
    assert grouped.ece_interval == pytest.approx(single.ece_interval, abs=0.02)
    assert grouped.brier_interval == pytest.approx(single.brier_interval, abs=0.01)
    alone = score(np.repeat(quality, 8), np.repeat(held, 8), resamples=2000)
    assert np.ptp(alone.brier_interval) < 0.5 * np.ptp(single.brier_interval)
    assert score(quality, held, groups=range(60)).bins == score(quality, held).bins
    one = score(quality, held, groups=["a"] * 60)
    assert one.ece_interval == one.brier_interval == (0, 1)


def test_the_summary_is_json():
    found = score([0.2, 0.9, 0.8], [False, True, True])
    summary = json.loads(json.dumps(found.to_dict()))
    assert summary["ece_interval"] == list(found.ece_interval)
    assert summary["bins"][0] == {
        "low": 0.2, "high": 0.3, "count": 1, "quality": 0.2, "held": 0.0,
        "interval": list(wilson_interval(0, 1)),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("quality", "held", "options", "name"),
    [
        ([], [], {}, "shape"),
        ([0.5, 1.01], [0, 1], {}, "quality"),
        ([0.5, np.nan], [0, 1], {}, "values"),
        ([0.5, 0.6], [0, 0.5], {}, "held"),
        ([0.5, 0.6], [0], {}, "number of outcomes"),
        ([0.5, 0.6], [0, 1], {"bins": 0}, "number of bins"),
        ([0.5, 0.6], [0, 1], {"binning": "size"}, "binning"),
        ([0.5, 0.6], [0, 1], {"groups": ["a"]}, "group labels"),
        ([0.5, 0.6], [0, 1], {"confidence": 0}, "confidence"),
        ([0.5, 0.6], [0, 1], {"resamples": 0}, "resamples"),
    ],
)
def test_refuses(quality, held, options, name):
    with pytest.raises(InvalidInputError) as caught:
        score(quality, held, **options)
    assert name in caught.value.name
