"""The claims of a table put to the test: pairs of rows on the same scenes, and what they decide.

The rule is stated once, in `RULE`, and printed with every result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from statistics import fmean
from typing import Any, get_args

import numpy as np

from graspmap.errors import FileError
from graspmap.evaluation.run_folder import MeasuredScene
from graspmap.metrics.correlation import (
    LEAST_MODELS,
    Correlation,
    CorrelationGain,
    correlate,
    correlation_gain,
)
from graspmap.metrics.seeds import SeededComparison, compare_seeds
from graspmap.reproduction.held_out import PARTS_FOLDER, SceneKey, read_parts
from graspmap.reproduction.measures import MEASURES
from graspmap.reproduction.plan import Plan
from graspmap.reproduction.table_file import LEAST_SEEDS, ByScene, Claim, Pair

HOLDS, FAILS, OPEN = "holds", "does not hold", "not decided at this scale"
UNTESTED = "not tested"

MARGIN = 0.02
"""A difference below this, two points of a hundred, is taken for none."""

LEAST_OBJECTS = 20
"""Fewer test objects are too few for the bootstrap to know their spread."""

RULE = (
    "Each interval is a 95 % one, for new objects and new seeds: the bootstrap over objects of "
    "each scene's mean over seeds, widened by what the seeds differ by (Student's t).",
    f"A pair holds where its interval lies above 0. It does not hold where the interval lies below "
    f"{100 * MARGIN:g} points: a gain of that size is excluded. Otherwise it is not decided.",
    f"Of fewer than {LEAST_OBJECTS} test objects nothing is decided.",
    f"Of a claim that nothing differs, a pair holds where the interval lies within "
    f"{100 * MARGIN:g} points of 0, does not hold where it leaves out 0, and is else not decided.",
    "A claim holds where every pair that was tested holds, does not hold where one does not, and "
    "is else not decided.",
    "One measure foretells trials better than another where the interval of the difference of "
    "their correlations with it (Zou's, over rows) lies above 0, and does not where it lies below.",
)


@dataclass(frozen=True, eq=False)
class TestedPair:
    """A pair of a claim.

    Attributes:
        pair: The rows.
        found: The first against the second, by measure; empty where it was not tested.
        verdicts: What that says of the claim, by measure.
        why: Why it was not tested; empty where it was.
    """

    pair: Pair
    found: Mapping[ByScene, SeededComparison] = field(default_factory=dict)
    verdicts: Mapping[ByScene, str] = field(default_factory=dict)
    why: str = ""


@dataclass(frozen=True, eq=False)
class JudgedClaim:
    """A claim and what became of it.

    Attributes:
        claim: The claim.
        verdict: In the measure that it is made in.
        in_trials: The same rule applied to trials; None for claims about correlation.
        pairs: Its pairs; empty for claims about correlation.
        gain: Of a claim about correlation: the two measures; None where there are too few rows.
        correlations: Each measure with the success of trials, over rows.
    """

    claim: Claim
    verdict: str
    in_trials: str | None = None
    pairs: tuple[TestedPair, ...] = ()
    gain: CorrelationGain | None = None
    correlations: Mapping[ByScene, Correlation] = field(default_factory=dict)


def judge(
    plan: Plan, results: Mapping[str, Mapping[str, Any]], root: Path
) -> tuple[JudgedClaim, ...]:
    """Put the claims of a table to the test.

    Args:
        plan: The table, expanded.
        results: Results of its runs, as many as there are.
        root: Folder of the runs.

    Raises:
        FileError: What a run measured is missing or damaged.
    """
    judge = _Judge(plan, results, root)
    return tuple(
        judge.by_pairs(claim) if claim.pairs else judge.by_correlation(claim)
        for claim in plan.table.claims
    )


class _Judge:
    """Compares rows of a plan; what a run measured is read once."""

    def __init__(self, plan: Plan, results: Mapping[str, Mapping[str, Any]], root: Path) -> None:
        self._plan, self._results, self._root = plan, results, root
        self._row = {line.title: row for row, line in enumerate(plan.lines)}
        self._tests = () if plan.parts is None else tuple(plan.parts.tests)
        self._scenes = cache(self._read)

    def by_pairs(self, claim: Claim) -> JudgedClaim:
        pairs = tuple(self._test(claim, pair) for pair in claim.pairs)
        verdict, in_trials = (
            _together([pair.verdicts[name] for pair in pairs if pair.found])
            for name in (claim.by, "sgt")
        )
        return JudgedClaim(claim, verdict, in_trials, pairs)

    def by_correlation(self, claim: Claim) -> JudgedClaim:
        assert claim.foretells is not None  # the table file saw to it
        names: tuple[ByScene, ...] = get_args(ByScene)
        rows = [means for row in self._row.values() if (means := self._means(row, names))]
        if len(rows) < LEAST_MODELS:
            return JudgedClaim(claim, UNTESTED)
        columns = {name: [means[name] for means in rows] for name in names}
        held = columns.pop("sgt")
        first, second = claim.foretells
        gain = correlation_gain(columns[first], columns[second], held)
        correlations = {name: correlate(values, held) for name, values in columns.items()}
        verdict = OPEN
        if gain.interval is not None and gain.interval[0] > 0:
            verdict = HOLDS
        elif gain.interval is not None and gain.interval[1] < 0:
            verdict = FAILS
        return JudgedClaim(claim, verdict, gain=gain, correlations=correlations)

    def _runs(self, row: int) -> tuple[str | None, ...]:
        """Runs of a row by seed; None where one is missing."""
        runs = self._plan.cells.get((row, 0), ())
        return tuple(run if run in self._results else None for run in runs)

    def _means(self, row: int, names: Sequence[ByScene]) -> dict[ByScene, float]:
        """Numbers of a row, each a mean over all its seeds; empty where some are missing."""
        runs = self._runs(row)
        found: dict[ByScene, float] = {}
        for name in names:
            values = [MEASURES[name].get(self._results[run]) for run in runs if run is not None]
            there = [value for value in values if value is not None]
            if not runs or len(there) < len(runs):
                return {}
            found[name] = fmean(there)
        return found

    def _test(self, claim: Claim, pair: Pair) -> TestedPair:
        rows = [self._row.get(title) for title in (pair.better, pair.than)]
        if rows[0] is None or rows[1] is None:
            first = rows[0] is None
            reason = dict(self._plan.left_out).get(pair.better if first else pair.than)
            why = "was not asked for" if reason is None else f"was left out: {reason}"
            return TestedPair(pair, why=f"the {'first' if first else 'second'} row {why}")
        both = zip(self._runs(rows[0]), self._runs(rows[1]), strict=True)
        shared = [(a, b) for a, b in both if a is not None and b is not None]
        if len(shared) < LEAST_SEEDS:
            return TestedPair(pair, why=f"{len(shared)} seeds were trained of both")
        firsts, seconds = (
            [self._scenes(run) for run in runs] for runs in zip(*shared, strict=True)
        )
        found = {name: self._compare(name, firsts, seconds) for name in get_args(ByScene)}
        verdicts = {
            name: OPEN if one.scenes.groups < LEAST_OBJECTS else verdict(one.interval, claim.expect)
            for name, one in found.items()
        }
        return TestedPair(pair, found, verdicts)

    def _compare(
        self,
        name: ByScene,
        firsts: Sequence[Mapping[SceneKey, MeasuredScene]],
        seconds: Sequence[Mapping[SceneKey, MeasuredScene]],
    ) -> SeededComparison:
        """Two rows over the scenes that all their runs have a value of."""
        everyone = (*firsts, *seconds)
        shared = [
            key
            for key in firsts[0]
            if all(key in run and value_of(run[key], name) is not None for run in everyone)
        ]
        if not shared:
            raise FileError(
                self._root,
                f"holds no test scene that all runs of a pair have {MEASURES[name].title} of",
                "delete the runs and make them again",
            )
        a, b = (
            [[value_of(run[key], name) for key in shared] for run in runs]
            for runs in (firsts, seconds)
        )
        groups = [(part, firsts[0][part, scene].object_id or scene) for part, scene in shared]
        return compare_seeds(
            np.array(a, dtype=np.float64),
            np.array(b, dtype=np.float64),
            groups=groups,
            rng=np.random.default_rng(self._plan.request.seed),
        )

    def _read(self, run: str) -> Mapping[SceneKey, MeasuredScene]:
        return read_parts(self._root / run / PARTS_FOLDER, self._tests)


def value_of(scene: MeasuredScene, name: ByScene) -> float | None:
    """What one scene gave in a measure, 0 to 1; None where it was not measured there."""
    if name == "miou":
        return scene.iou
    if name == "sgt":
        return None if scene.held is None else float(scene.held)
    right = scene.right.get({"success": "0.25", "success_75": "0.75"}[name])
    return None if right is None else float(right)


def verdict(interval: tuple[float, float], expect: str) -> str:
    """What the interval of a difference says of a pair, by `RULE`.

    Args:
        interval: Lower and upper end of (first minus second), shares.
        expect: ``"better"`` or ``"alike"``.
    """
    low, high = interval
    if expect == "alike":
        if low > -MARGIN and high < MARGIN:
            return HOLDS
        return FAILS if low > 0 or high < 0 else OPEN
    if low > 0:
        return HOLDS
    return FAILS if high < MARGIN else OPEN


def _together(verdicts: Sequence[str]) -> str:
    """What pairs say of their claim."""
    if not verdicts:
        return UNTESTED
    if FAILS in verdicts:
        return FAILS
    return OPEN if OPEN in verdicts else HOLDS
