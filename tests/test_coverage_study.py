"""The study of coverage, scaled down: intervals hold the truth, and the study sees when not."""

from __future__ import annotations

import json

import numpy as np
import pytest

from graspmap.metrics import bootstrap_interval
from studies import coverage

EXPERIMENTS = 250
"""The share covered then strays from 95 % by 4.1 points at most (3 standard errors)."""


@pytest.mark.parametrize(
    "case",
    [
        coverage.wilson(140, 0.58),
        coverage.objects(49, (20, 20)),
        coverage.paired(200, 1, (0.8, 0.7)),
        coverage.paired(200, 5, (0.8, 0.7)),
        coverage.paired_overlap(100),
        coverage.correlation("Pearson", 9, 0.541),
        coverage.correlation("Spearman", 9, 0.541),
        coverage.calibration("ECE", "too sure", 500, 1, lambda q: q**2),
        coverage.calibration("Brier", "too sure", 500, 1, lambda q: q**2),
    ],
    ids=lambda case: case.name,
)
def test_a_nominal_95_percent_interval_holds_the_truth(case):
    found = coverage.cover(case, EXPERIMENTS, 200, seed=3)
    assert 0.909 <= found.covered <= 0.991
    assert found.covered + found.below + found.above == pytest.approx(1)
    assert found.width > 0


def test_the_truth_of_calibration_is_that_of_many_trials():
    rng = np.random.default_rng(0)
    quality = rng.beta(3, 2, 1_000_000)
    held = rng.random(1_000_000) < 0.2 * quality
    case = coverage.calibration("Brier", "", 500, 1, lambda q: 0.2 * q)
    assert case.truth == pytest.approx(((quality - held) ** 2).mean(), abs=2e-3)
    # All qualities are above what comes: the gap is 0.8 of the mean quality, 3/5.
    far = coverage.calibration("ECE", "", 500, 1, lambda q: 0.2 * q)
    assert far.truth == pytest.approx(0.8 * 0.6, abs=1e-6)
    assert coverage.calibration("ECE", "", 500, 1, lambda q: q).truth == 0


def test_an_interval_that_promises_too_much_is_seen():
    """Ten pictures of an object taken as ten objects."""

    def interval(rng, resamples):
        held = rng.random((30, 10)) < rng.beta(4, 2, 30)[:, None]
        return bootstrap_interval(held.ravel(), rng=rng, resamples=resamples)

    found = coverage.cover(coverage.Case("wrong", 4 / 6, interval), 150, 100, seed=0)
    assert found.covered < 0.85
    assert found.below > 0.03
    assert found.above > 0.03


def test_the_study_prints_and_writes_every_row(tmp_path, capsys, monkeypatch):
    few = (coverage.wilson(20, 0.6), coverage.correlation("Pearson", 5, 0.0))
    monkeypatch.setattr(coverage, "cases", lambda: few)
    result = coverage.run(experiments=20, resamples=10, out=tmp_path)
    printed = capsys.readouterr().out
    assert all(case.name in printed for case in few)
    assert json.loads((tmp_path / "coverage.json").read_text()) == result
    assert result == coverage.run(experiments=20, resamples=10)
