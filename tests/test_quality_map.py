"""From quality to probability: laws, a search that shares no code, held-out trials and groups."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.metrics import QualityMap, cross_fitted, fit_quality_map, score_calibration

seeds = st.integers(0, 2**32)


def draw(rng, trials, truth):
    """Qualities as networks give them (many high, some above 1), and what becomes of them."""
    quality = rng.beta(4, 2, trials) + 0.05
    return quality, rng.random(trials) < truth(quality)


def overconfident(quality):
    """Half of what the quality says, but for the surest."""
    return 0.5 * quality + 0.4 * np.clip((quality - 0.6) / 0.3, 0, 1) ** 2


def test_two_knots_by_hand():
    """Log-odds -1 and 1: a logistic curve of slope 2 / 0.4 through (0.5, 1/2)."""
    said = QualityMap(((0.3, 1 / (1 + math.e)), (0.7, 1 / (1 + 1 / math.e))))
    for quality in (-0.2, 0.3, 0.41, 0.7, 1.15):
        expected = 1 / (1 + math.exp(-5 * (quality - 0.5)))
        assert said(quality) == pytest.approx(expected, rel=1e-12)
        assert said.inverse(expected) == pytest.approx(quality, abs=1e-12)
    assert said(np.zeros((2, 3))).shape == (2, 3)
    assert said.inverse([-0.1, 0, 1, 1.1]).tolist() == [-math.inf, -math.inf, math.inf, math.inf]


@given(seed=seeds, trials=st.integers(1, 400), share=st.floats(0, 1), ties=st.booleans())
def test_any_fit_rises_strictly_and_goes_on_beyond_the_data(seed, trials, share, ties):
    rng = np.random.default_rng(seed)
    quality = rng.uniform(-0.1, 1.2, trials)
    if ties:
        quality = np.round(quality, 1)
    said = fit_quality_map(quality, rng.random(trials) < share)
    grid = np.linspace(-0.3, 1.4, 300)
    found = said(grid)
    assert (np.diff(found) > 0).all()
    assert found[0] > 0
    assert found[-1] < 1
    assert said.inverse(found) == pytest.approx(grid, abs=1e-5)
    assert 2 <= len(said.knots) <= 5


@pytest.mark.parametrize("seed", range(3))
def test_few_trials_give_the_most_likely_logistic_curve(seed):
    """Against a search over slope and offset, with Platt's targets written out."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(seed)
    quality, held = draw(rng, 60, lambda q: 1 / (1 + np.exp(-6 * (q - 0.6))))
    good, bad = held.sum(), (~held).sum()
    target = np.where(held, (good + 1) / (good + 2), 1 / (bad + 2))

    def surprise(values):
        p = 1 / (1 + np.exp(-values[0] * quality - values[1]))
        return -(target * np.log(p) + (1 - target) * np.log(1 - p)).sum()

    best = minimize(surprise, (1.0, 0.0), method="Nelder-Mead", options={"xatol": 1e-8})
    grid = np.linspace(0, 1.1, 23)
    expected = 1 / (1 + np.exp(-best.x[0] * grid - best.x[1]))
    assert fit_quality_map(quality, held)(grid) == pytest.approx(expected, abs=1e-3)


def test_a_known_map_is_found():
    rng = np.random.default_rng(0)
    said = fit_quality_map(*draw(rng, 20_000, overconfident))
    grid = np.linspace(0.3, 1, 50)
    wrong = np.abs(said(grid) - overconfident(grid))
    assert wrong.max() < 0.05
    assert wrong.mean() < 0.02
    # Nothing to correct where the quality is the probability.
    honest = fit_quality_map(*draw(rng, 20_000, lambda q: np.clip(q, 0, 1) * 0.98))
    assert np.abs(honest(grid) - 0.98 * grid).max() < 0.035


@pytest.mark.parametrize("trials", [100, 300, 900])
def test_the_error_falls_on_trials_that_were_not_fitted(trials):
    rng = np.random.default_rng(trials)
    said = fit_quality_map(*draw(rng, trials, overconfident))
    quality, held = draw(rng, 20_000, overconfident)

    def ece(values):
        return score_calibration(np.clip(values, 0, 1), held, rng=rng, resamples=10).ece

    assert ece(quality) > 0.14
    assert ece(said(quality)) < 0.07


@pytest.mark.parametrize("trials", [1, 4, 40])
def test_what_always_held_or_failed_promises_no_certainty(trials):
    quality = np.linspace(0.5, 0.9, trials)
    held = fit_quality_map(quality, np.ones(trials))(quality)
    failed = fit_quality_map(quality, np.zeros(trials))(quality)
    assert held == pytest.approx((trials + 1) / (trials + 2), abs=0.02)
    assert failed == pytest.approx(1 / (trials + 2), abs=0.02)


def test_an_outcome_against_the_order_gives_no_falling_map():
    quality = np.linspace(0, 1, 200)
    said = fit_quality_map(quality, quality < 0.5)
    assert 0 < said(1) - said(0) < 0.02
    assert said(0.5) == pytest.approx(0.5, abs=0.01)


def test_a_cross_fit_does_not_look_at_what_it_judges():
    rng = np.random.default_rng(4)
    quality, held = draw(rng, 120, overconfident)
    groups = np.repeat(np.arange(24), 5)

    def fitted(outcomes):
        return cross_fitted(quality, outcomes, rng=np.random.default_rng(1), groups=groups)

    first = fitted(held)
    mine = groups == 7
    second = fitted(np.where(mine, ~held, held))
    assert first[mine].tolist() == second[mine].tolist()
    assert (first != second).sum() >= 60  # most others were fitted with it
    # Fewer groups than folds: each is left out by itself.
    two = quality > np.median(quality)
    low = cross_fitted(quality, held, rng=rng, groups=two)
    assert low[two].tolist() == fit_quality_map(quality[~two], held[~two])(quality[two]).tolist()


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: fit_quality_map([], []), "shape of the values"),
        (lambda: fit_quality_map([0.5, np.nan], [0, 1]), "values"),
        (lambda: fit_quality_map([0.5, 0.6], [1]), "number of outcomes"),
        (lambda: fit_quality_map([0.5], [0.5]), "held"),
        (lambda: QualityMap(((0.1, 0.2),)), "knots"),
        (lambda: QualityMap(((0.1, 0.2), (0.1, 0.3))), "knots"),
        (lambda: QualityMap(((0.1, 0.2), (0.2, 0.2))), "knots"),
        (lambda: QualityMap(((0.1, 0.0), (0.2, 0.2))), "knots"),
        (lambda: QualityMap(((0.1, 0.5), (math.inf, 0.6))), "knots"),
    ],
)
def test_refuses(call, name):
    with pytest.raises(InvalidInputError) as error:
        call()
    assert error.value.name.startswith(name)


def test_cross_fit_refuses():
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidInputError, match="groups of trials is 1"):
        cross_fitted([0.1, 0.2], [0, 1], rng=rng, groups=["a", "a"])
    with pytest.raises(InvalidInputError, match="folds is 1"):
        cross_fitted([0.1, 0.2], [0, 1], rng=rng, folds=1)
