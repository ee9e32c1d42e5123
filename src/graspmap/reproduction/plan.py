"""From a table to the runs that fill it: each row, column, and fold or seed is one experiment.

Runs with one and the same experiment are one run, whichever row or table asks for them: a run is
known by the hash of its experiment.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from hashlib import blake2b
from typing import Any

import torch

from graspmap.errors import InvalidInputError
from graspmap.reproduction.facts import (
    DataFacts,
    PartFacts,
    look_at,
    look_at_parts,
    part_sizes,
)
from graspmap.reproduction.measures import MEASURES, Need
from graspmap.reproduction.request import Request, check_request, chosen_folds, chosen_lines
from graspmap.reproduction.scale import shrink
from graspmap.reproduction.table_file import Line, Table, Variant, experiment_path, read_table
from graspmap.training import Experiment, read_experiment
from graspmap.training.tasks import check_experiment

_FREE = ("workers", "device", "checkpoint_minutes")
"""Keys of the training that change nothing of the result."""


@dataclass(frozen=True)
class Run:
    """One training run.

    Attributes:
        id: Its name, and that of its folder: the network and the hash of the experiment.
        experiment: What is trained.
        title: What it is for, for people.
        needs: What is to be done after the training.
        tests: Data sets that it is tested on scene by scene, by the name of their part.
    """

    id: str
    experiment: Experiment
    title: str
    needs: frozenset[Need]
    tests: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Plan:
    """A table, expanded.

    Attributes:
        request: What was asked for.
        table: The table.
        lines: Its rows that are shown: those asked for that the data can give.
        experiments: Experiment of each (row, column): that of its first fold or seed.
        published: The same as the table has it, on these data, before anything is made smaller.
        cells: Ids of the runs of each (row, column), by fold or seed.
        runs: Every run once, the first fold or seed of all rows first.
        left_out: Rows that the data cannot give, with the reason.
        unmeasured: Measures that the data cannot give, with the reason.
        folds: (run, of) folds; None where the experiments divide the data once.
        seeds: How many seeds each row is trained with; None for one.
        facts: What the data hold; None without data.
        parts: All parts of the data where they come in parts; ``facts`` is that of the training.
    """

    request: Request
    table: Table
    lines: tuple[Line, ...]
    experiments: Mapping[tuple[int, int], Experiment]
    published: Mapping[tuple[int, int], Experiment]
    cells: Mapping[tuple[int, int], tuple[str, ...]]
    runs: tuple[Run, ...]
    left_out: tuple[tuple[str, str], ...]
    unmeasured: Mapping[str, str]
    folds: tuple[int, int] | None = None
    seeds: int | None = None
    facts: DataFacts | None = None
    parts: PartFacts | None = None

    @property
    def unit(self) -> str:
        """What a row is repeated over."""
        return "folds" if self.seeds is None else "seeds"

    @property
    def measures(self) -> tuple[str, ...]:
        """Measures that are reported, printed ones first."""
        return (*self.table.measures, *self.table.also)


def make_plan(request: Request) -> Plan:
    """Expand a table to its runs, and see that they can be made.

    Raises:
        UnknownNameError: There is no such table, or no row matches.
        InvalidInputError: An option contradicts the table or another option, or the data are too
            small for the folds or can give no row at all.
        ConfigError: A key of the experiment is wrong, or one that the table varies itself.
        FileError: The data are missing or damaged.
    """
    table = read_table(request.name)
    check_request(request, table)
    lines = chosen_lines(request, table)
    if table.kind == "times":
        return _without_runs(request, table, lines)
    assert request.data is not None  # check_request saw to it
    changes = request.changes
    _check_keys(lines, changes)
    parts = test = None
    if table.kind == "claims":
        parts = look_at_parts(request.data, changes.get("data.depth"))
        facts = parts.train
    else:
        facts = look_at(request.data, changes.get("data.depth"))
    if request.test_data is not None:
        test = look_at(request.test_data, changes.get("data.test.depth"))
    folds = chosen_folds(request, table, facts)
    builder = _Builder(request, facts, test, folds, request.seeds or table.seeds, parts)
    kept, left_out = [], []
    for line in lines:
        reason = builder.impossible(line, table.columns) if line.experiment else None
        if line.large and not request.large:
            reason = "its network takes a GPU to train; --large trains it, too"
        if reason is None:
            kept.append(line)
        else:
            left_out.append((line.title, reason))
    if not kept:
        reasons = "; ".join(dict.fromkeys(reason for _, reason in left_out))
        raise InvalidInputError(
            f"--data {request.data} for {request.name}",
            f"not enough for any row ({reasons})",
            "data that have what the rows need",
        )
    unmeasured = {}
    if parts is None and not (test or facts).trials:
        unmeasured["sgt"] = "no depth with a camera or a record, so grasps cannot be tried"
    return _filled(builder, table, tuple(kept), tuple(left_out), unmeasured)


def _check_keys(lines: Sequence[Line], changes: Mapping[str, Any]) -> None:
    """See that the user's keys are keys, before any data are looked at."""
    for name in dict.fromkeys(line.experiment for line in lines if line.experiment is not None):
        mine = {k: v for k, v in changes.items() if not k.startswith("data.test.")}
        read_experiment(experiment_path(name), mine)


@dataclass(frozen=True, eq=False)
class _Builder:
    """Makes the experiments of a table."""

    request: Request
    facts: DataFacts
    test: DataFacts | None
    folds: tuple[int, int] | None
    seeds: int | None
    parts: PartFacts | None
    _known: dict[str, Experiment] = field(default_factory=dict)

    @property
    def others(self) -> tuple[DataFacts, ...]:
        """The data sets beside the one that is trained on."""
        if self.parts is not None:
            return (self.parts.validation, *self.parts.tests.values())
        return () if self.test is None else (self.test,)

    def published(self, line: Line, variant: Variant) -> Experiment:
        """As the table has it, on the data of the request; first fold or seed."""
        return self._read(line, variant, {})

    def make(self, line: Line, variant: Variant) -> Experiment:
        """As it is run; first fold or seed.

        Raises:
            ConfigError: It contradicts itself.
        """
        experiment = self._read(line, variant, self.request.changes)
        asked = f"{experiment.network} {experiment.tasks} {experiment.loss}"
        if asked not in self._known:
            with torch.device("meta"):  # the weights are not needed
                check_experiment(experiment)
            self._known[asked] = experiment
        return shrink(experiment, self.request.scale, self._batches(experiment))

    def repeat(self, experiment: Experiment, number: int) -> Experiment:
        """The same for another fold or seed, by the name of its run."""
        if self.seeds is not None:
            one = experiment.model_copy(update={"seed": self.request.seed + number})
        else:
            split = experiment.data.split.model_copy(update={"fold": number})
            data = experiment.data.model_copy(update={"split": split})
            one = experiment.model_copy(update={"data": data})
        return one.model_copy(update={"name": self.identify(one)})

    def impossible(self, line: Line, variants: Sequence[Variant]) -> str | None:
        """Why a row cannot be made from the data; None where it can."""
        for variant in variants:
            experiment = self._read(line, variant, self.request.changes)
            limit = experiment.data.split.limit_objects
            if limit is not None and limit > self.facts.objects:
                return f"{self.facts.source} has {self.facts.objects} objects, not {limit}"
            bare = experiment.model_copy(update={"tasks": type(experiment.tasks)()})
            reason = self.facts.lacks(experiment)
            if reason is None:
                reason = next(filter(None, (other.lacks(bare) for other in self.others)), None)
                if reason is not None and self.test is not None:
                    reason += " (--test-data)"
            if reason is not None:
                return reason
        return None

    def identify(self, experiment: Experiment) -> str:
        """Name of the run: what it trains, and a hash of all that decides its result."""
        values = experiment.model_dump(mode="json")
        del values["name"], values["data"]["cache_dir"]
        for key in _FREE:
            del values["training"][key]
        values["fingerprints"] = [facts.fingerprint for facts in (self.facts, *self.others)]
        text = json.dumps(values, sort_keys=True, separators=(",", ":"))
        digest = blake2b(text.encode(), digest_size=6).hexdigest()
        return f"{experiment.network.name}-{digest}"

    def _read(self, line: Line, variant: Variant, changes: Mapping[str, Any]) -> Experiment:
        assert line.experiment is not None  # quoted rows have no runs
        values = {
            **line.changes,
            **variant.set,
            "seed": self.request.seed,
            "data.source": self.facts.source,
            **changes,
        }
        if self.test is not None:
            values["data.test.source"] = self.test.source
        if self.parts is not None:
            # All parts are seen through the same sensor.
            if "data.depth" in changes:
                depth = changes["data.depth"]
                values = {"data.validation.depth": depth, "data.test.depth": depth, **values}
            values["data.validation.source"] = self.parts.validation.source
            values["data.test.source"] = next(iter(self.parts.tests.values())).source
        if self.folds is not None:
            values |= {"data.split.folds": self.folds[1], "data.split.fold": 0}
        key = f"{line.experiment} {values}"
        if key not in self._known:
            path = experiment_path(line.experiment)
            self._known[key] = read_experiment(path, values)
        return self._known[key]

    def _batches(self, experiment: Experiment) -> int:
        """Batches of one pass over the training part, about."""
        train = part_sizes(experiment, self.facts, self.parts)[0]
        return max(1, math.ceil(train / experiment.training.batch_size))


def _filled(
    builder: _Builder,
    table: Table,
    lines: tuple[Line, ...],
    left_out: tuple[tuple[str, str], ...],
    unmeasured: Mapping[str, str],
) -> Plan:
    runs: dict[str, Run] = {}
    cells: dict[tuple[int, int], tuple[str, ...]] = {}
    experiments: dict[tuple[int, int], Experiment] = {}
    published: dict[tuple[int, int], Experiment] = {}
    needs = _needs(table, unmeasured)
    found = {} if builder.parts is None else builder.parts.tests
    tests = {name: facts.source for name, facts in found.items()}
    places = [
        (row, column)
        for row, line in enumerate(lines)
        for column in range(len(table.columns))
        if line.experiment is not None
    ]
    for row, column in places:
        experiments[row, column] = builder.make(lines[row], table.columns[column])
        published[row, column] = builder.published(lines[row], table.columns[column])
    folds = 1 if builder.folds is None else builder.folds[0]
    # All rows get their first fold or seed before any gets its second.
    for number in range(builder.seeds or folds):
        for row, column in places:
            words = [lines[row].title, table.columns[column].name]
            if builder.seeds is not None:
                words.append(f"seed {number + 1} of {builder.seeds}")
            elif builder.folds is not None:
                words.append(f"fold {number + 1} of {builder.folds[1]}")
            title = ", ".join(word for word in words if word)
            experiment = builder.repeat(experiments[row, column], number)
            run = Run(experiment.name, experiment, title, needs, tests)
            runs.setdefault(run.id, run)
            cells[row, column] = (*cells.get((row, column), ()), run.id)
    return Plan(
        request=builder.request,
        table=table,
        lines=lines,
        experiments=experiments,
        published=published,
        cells=cells,
        runs=tuple(runs.values()),
        left_out=left_out,
        unmeasured=unmeasured,
        folds=builder.folds,
        seeds=builder.seeds,
        facts=builder.facts,
        parts=builder.parts,
    )


def _needs(table: Table, unmeasured: Mapping[str, str]) -> frozenset[Need]:
    if table.kind == "claims":
        return frozenset({"parts"})
    measures = (*table.measures, *table.also)
    needs = {MEASURES[name].need for name in measures if name not in unmeasured}
    if table.kind == "thresholds":
        needs.add("overlaps")
    return frozenset(needs)


def _without_runs(request: Request, table: Table, lines: tuple[Line, ...]) -> Plan:
    """The plan of a table that only times networks."""
    experiments: dict[tuple[int, int], Experiment] = {}
    published: dict[tuple[int, int], Experiment] = {}
    for row, line in enumerate(lines):
        if line.experiment is None:
            continue
        read = partial(read_experiment, experiment_path(line.experiment))
        published[row, 0] = read(line.changes)
        experiments[row, 0] = read({**line.changes, **request.changes})
    return Plan(request, table, lines, experiments, published, {}, (), (), {})
