"""Counting trials: shares, intervals, groups."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.metrics.intervals import wilson_interval
from graspmap.metrics.trial import first_held, group_scores, score_trials

OUTCOMES = ("held", "collided", "empty", "slipped", "dropped", "no_grasp")
trials = st.lists(st.tuples(st.sampled_from(OUTCOMES), st.sampled_from("abc")), min_size=1)


@settings(max_examples=50)
@given(trials, st.integers(0, 100))
def test_counts_add_up(rows, seed):
    outcomes, objects = [r[0] for r in rows], [r[1] for r in rows]
    score = score_trials(outcomes, objects, rng=np.random.default_rng(seed))
    assert sum(score.outcomes.values()) == score.trials == len(rows)
    assert score.held == score.outcomes.get("held", 0) == sum(o == "held" for o in outcomes)
    assert sum(s.trials for s in score.per_object.values()) == score.trials
    assert sum(s.held for s in score.per_object.values()) == score.held
    low, high = score.interval
    assert 0 <= low <= score.success <= high <= 1


def test_objects_count_once_in_the_mean_over_objects():
    outcomes = ["held"] * 8 + ["empty", "held"]
    score = score_trials(outcomes, ["a"] * 8 + ["b"] * 2, rng=np.random.default_rng(0))
    assert score.success == 0.9
    assert score.object_mean == 0.75


def test_without_groups_the_interval_is_wilsons():
    score = score_trials(["held", "empty"] * 10, ["a"] * 20, rng=np.random.default_rng(0))
    assert score.interval == wilson_interval(10, 20)


def test_groups_that_hang_together_widen_the_interval():
    outcomes = (["held"] * 10 + ["slipped"] * 10) * 5
    groups = [str(i // 10) for i in range(100)]
    alone = score_trials(outcomes, groups, rng=np.random.default_rng(0))
    together = score_trials(outcomes, groups, rng=np.random.default_rng(0), groups=groups)
    assert together.interval[1] - together.interval[0] > alone.interval[1] - alone.interval[0]


def test_groups_come_by_name():
    scores = group_scores(["held", "empty", "held"], ["b", "a", "b"])
    assert list(scores) == ["a", "b"]
    assert (scores["b"].trials, scores["b"].held, scores["b"].success) == (2, 2, 1.0)
    ends = list(wilson_interval(0, 1))
    assert scores["a"].to_dict() == {"trials": 1, "held": 0, "success": 0.0, "interval": ends}


def test_refuses_nothing_and_unequal_lists():
    with pytest.raises(InvalidInputError, match="one object a trial"):
        score_trials([], [], rng=np.random.default_rng(0))
    with pytest.raises(InvalidInputError, match="one object a trial"):
        score_trials(["held"], ["a", "b"], rng=np.random.default_rng(0))


@settings(max_examples=50)
@given(st.lists(st.lists(st.sampled_from(OUTCOMES), min_size=1, max_size=4), min_size=1))
def test_the_first_that_held(scenes):
    rows = [(o, str(s), r) for s, list_ in enumerate(scenes) for r, o in enumerate(list_)]
    first = first_held(*map(list, zip(*rows, strict=True)))
    for number, list_ in enumerate(scenes):
        assert first[str(number)] == (list_.index("held") if "held" in list_ else math.inf)
