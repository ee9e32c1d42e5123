"""A table filled: the thesis's numbers beside ours, with mean and spread over folds or seeds."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from graspmap.reproduction.claims import JudgedClaim
from graspmap.reproduction.measures import MEASURES, Measure
from graspmap.reproduction.plan import Plan
from graspmap.reproduction.scale import differences
from graspmap.reproduction.table_file import NOTHING, Line, Published, parse_published

FAILED = "failed"


@dataclass(frozen=True)
class Column:
    """A column of numbers.

    Attributes:
        head: What stands above it.
        variant: Number of its variant.
        measure: Name of its measure.
        printed: Whether the thesis has it, too.
    """

    head: str
    variant: int
    measure: str
    printed: bool


@dataclass(frozen=True)
class Cell:
    """A number of ours and the printed one.

    Attributes:
        published: What the thesis prints.
        values: Ours by fold or seed, in the unit of the table; those that are there.
        missing: Why some or all are not there, in a word; empty where all are.
    """

    published: Published
    values: tuple[float, ...] = ()
    missing: str = ""

    @property
    def mean(self) -> float | None:
        """Mean over folds or seeds."""
        return statistics.fmean(self.values) if self.values else None

    @property
    def spread(self) -> float | None:
        """Standard deviation over folds or seeds (n - 1 in the divisor); None below two."""
        return statistics.stdev(self.values) if len(self.values) > 1 else None

    def text(self, measure: Measure) -> str:
        """Ours as the table writes it: mean and spread."""
        if self.mean is None:
            return self.missing or NOTHING
        text = measure.text(self.mean)
        if self.spread is not None:
            text += f" ± {measure.text(self.spread)}"
        return f"{text} ({self.missing})" if self.missing else text


@dataclass(frozen=True, eq=False)
class Filled:
    """A table with its numbers.

    Attributes:
        plan: What was to be done.
        columns: Its columns.
        cells: A row of cells for each of the plan's lines.
        results: Of the runs.
        failures: Why runs failed, by run.
        changed: What the runs change against the thesis: (published, run) by key.
        claims: What became of the claims of a table of claims.
    """

    plan: Plan
    columns: tuple[Column, ...]
    cells: tuple[tuple[Cell, ...], ...]
    results: Mapping[str, Mapping[str, Any]]
    failures: Mapping[str, str]
    changed: Mapping[str, tuple[Any, Any]]
    claims: tuple[JudgedClaim, ...] = ()

    @property
    def rows(self) -> tuple[tuple[Line, tuple[Cell, ...]], ...]:
        """Each line with its cells."""
        return tuple(zip(self.plan.lines, self.cells, strict=True))

    @property
    def elsewhere(self) -> tuple[tuple[int, str, str], ...]:
        """Rows of which the thesis prints other numbers, too: (row, where, which)."""
        found = []
        for row, line in enumerate(self.plan.lines):
            for place, numbers in line.elsewhere.items():
                heads = [column.head for column in self.columns if column.printed]
                said = [f"{h} {n}" for h, n in zip(heads, numbers, strict=True) if n != NOTHING]
                found.append((row, place, ", ".join(said)))
        return tuple(found)


def fill(
    plan: Plan,
    results: Mapping[str, Mapping[str, Any]],
    failures: Mapping[str, str] | None = None,
    timed: Mapping[int, Mapping[str, float]] | None = None,
    claims: tuple[JudgedClaim, ...] = (),
) -> Filled:
    """Put results into a table.

    Args:
        plan: The table, expanded.
        results: Results of its runs, as many as there are.
        failures: Why runs failed.
        timed: Of a table of times: what was measured, by row.
        claims: What became of its claims.
    """
    columns = _columns(plan)
    failures = failures or {}
    cells = tuple(
        tuple(_cell(plan, row, column, columns, results, failures, timed) for column in columns)
        for row in range(len(plan.lines))
    )
    pairs = [(plan.published[key], plan.experiments[key]) for key in plan.experiments]
    return Filled(plan, columns, cells, results, failures, differences(pairs), claims)


def _columns(plan: Plan) -> tuple[Column, ...]:
    table, columns = plan.table, []
    for number, variant in enumerate(table.columns):
        for name in plan.measures:
            title = MEASURES[name].title
            alone = len(plan.measures) == 1 and variant.name
            head = variant.name if alone else " ".join(filter(None, (variant.name, title)))
            columns.append(Column(head, number, name, name in table.measures))
    return tuple(columns)


def _cell(
    plan: Plan,
    row: int,
    column: Column,
    columns: tuple[Column, ...],
    results: Mapping[str, Mapping[str, Any]],
    failures: Mapping[str, str],
    timed: Mapping[int, Mapping[str, float]] | None,
) -> Cell:
    line, measure = plan.lines[row], MEASURES[column.measure]
    text = NOTHING
    if column.printed:
        text = line.published[[c for c in columns if c.printed].index(column)]
    published = parse_published(text)
    if timed is not None:
        value = measure.get(timed.get(row, {}))
        return Cell(published, () if value is None else (value,))
    runs = plan.cells.get((row, column.variant), ())
    if column.measure in line.untrained:
        return Cell(published, (), "untrained")
    if column.measure in plan.unmeasured:
        return Cell(published, (), "not on these data")
    values = tuple(
        value for run in runs if (value := measure.get(results.get(run, {}))) is not None
    )
    failed = sum(run in failures for run in runs)
    left = sum(run not in results and run not in failures for run in runs)
    said = [f"{failed} {FAILED}"] if failed else []
    said += [f"{left} to do"] if left else []
    return Cell(published, values, ", ".join(said))
