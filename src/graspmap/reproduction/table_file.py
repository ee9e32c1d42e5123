"""The tables and figures of the thesis as data: rows, the experiment behind each, printed numbers.

A table file names an experiment file for each group of rows and says what each row changes in it;
`experiments/tables/` holds the tables, `experiments/thesis/` the experiments.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

import graspmap
from graspmap.config import read_model
from graspmap.errors import MissingFileError, UnknownNameError
from graspmap.reproduction.measures import MEASURES

Kind = Literal["results", "times", "curves", "thresholds"]

NOTHING = "-"
"""Stands for a number that the thesis does not give."""

_NUMBER = re.compile(r"(~ )?(\d+(?:\.\d+)?)(?: ± (\d+\.\d+))?")
_FOLDS = r"^[1-9]\d*/[1-9]\d*$"


@dataclass(frozen=True)
class Published:
    """A number as the thesis prints it.

    Attributes:
        text: As printed; ``-`` where there is none.
        mean: The number; None where the text is no single number.
        spread: What stands behind its ±; None where nothing does.
    """

    text: str
    mean: float | None
    spread: float | None


def parse_published(text: str) -> Published:
    """``"72.04 ± 3.44"`` as numbers; ranges (``200-500``) and sizes (``72k``) stay text."""
    match = _NUMBER.fullmatch(text)
    if match is None:
        return Published(text, None, None)
    return Published(text, float(match[2]), None if match[3] is None else float(match[3]))


class _Section(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)


class Variant(_Section):
    """A column that is a run of its own.

    Attributes:
        name: Head of the column.
        set: What it changes in the row's experiment, by dotted key.
    """

    name: str
    set: dict[str, Any]


class Row(_Section):
    """One row of a table.

    Attributes:
        labels: What stands at its left, after the labels of its group.
        use: Names of the table's settings that it applies.
        set: What else it changes in the group's experiment, by dotted key.
        published: The numbers as printed, variants outside and measures inside; empty for none.
        elsewhere: Numbers that another table of the thesis prints for the same row, by its name.
        untrained: Measures that say nothing here, because their part is not trained.
    """

    labels: tuple[str, ...]
    use: tuple[str, ...] = ()
    set: dict[str, Any] = Field(default_factory=dict)
    published: tuple[str, ...] = ()
    elsewhere: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    untrained: tuple[str, ...] = ()


class Group(_Section):
    """Rows that share an experiment.

    Attributes:
        labels: What stands at the left of all of them.
        experiment: Name of a file in ``experiments/thesis``; null for rows that are only quoted.
        use: Settings that all of them apply.
        set: What all of them change, by dotted key.
        panel: Part of the figure that shows them.
        rows: The rows.
    """

    labels: tuple[str, ...] = ()
    experiment: str | None = None
    use: tuple[str, ...] = ()
    set: dict[str, Any] = Field(default_factory=dict)
    panel: str = ""
    rows: tuple[Row, ...]


class Table(_Section):
    """A table or figure of the thesis.

    Attributes:
        title: What it shows.
        source: Where it stands.
        kind: Success of trained networks, times, learning curves, or success by threshold.
        data: Kind of the data that the thesis trained on; None where there is none.
        test_data: Kind of other data that it tested on.
        folds: ``N/K``: N of K folds are run; None runs the experiment's own split once.
        labels: Heads of the label columns.
        settings: Changes by name, for rows and groups to use.
        variants: Columns that are runs of their own; none stands for a single one.
        measures: What is reported of each run, see `graspmap.reproduction.measures.MEASURES`.
        also: What is reported of it without a printed number to stand beside.
        groups: The rows.
        notes: What a reader has to know.
    """

    title: str
    source: str
    kind: Kind = "results"
    data: Literal["cornell", "jacquard"] | None = None
    test_data: Literal["cornell", "jacquard"] | None = None
    folds: Annotated[str, Field(pattern=_FOLDS)] | None = None
    labels: tuple[str, ...]
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict)
    variants: tuple[Variant, ...] = ()
    measures: tuple[str, ...]
    also: tuple[str, ...] = ()
    groups: tuple[Group, ...]
    notes: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _check(self) -> Table:
        for name in (*self.measures, *self.also):
            if name not in MEASURES:
                raise ValueError(f"allowed: measures {', '.join(MEASURES)}, not {name}")
        width = max(1, len(self.variants)) * len(self.measures)
        for group in self.groups:
            for row in group.rows:
                where = " / ".join((*group.labels, *row.labels))
                if len(group.labels) + len(row.labels) != len(self.labels):
                    raise ValueError(f"allowed: {len(self.labels)} labels a row, unlike {where}")
                printed = [row.published, *row.elsewhere.values()]
                if any(values and len(values) != width for values in printed):
                    raise ValueError(f"allowed: {width} numbers a row, unlike {where}")
                for name in (*group.use, *row.use):
                    if name not in self.settings:
                        known = ", ".join(self.settings)
                        raise ValueError(f"allowed: settings {known}, not {name} in {where}")
        return self

    @property
    def columns(self) -> tuple[Variant, ...]:
        """Its variants; one that changes nothing where there are none."""
        return self.variants or (Variant(name="", set={}),)

    @property
    def lines(self) -> tuple[Line, ...]:
        """Its rows in order, everything of their group put into them."""
        return tuple(_line(self, group, row) for group in self.groups for row in group.rows)


@dataclass(frozen=True)
class Line:
    """A row of a table, whole.

    Attributes:
        labels: What stands at its left, one for each head.
        experiment: Name of its experiment file; None where it is only quoted.
        changes: What it changes in that, by dotted key.
        published: Numbers as printed, one for each variant and measure; ``-`` for none.
        elsewhere: Other numbers printed for it, by the table that prints them.
        panel: Part of the figure that shows it.
        untrained: Measures that say nothing here.
    """

    labels: tuple[str, ...]
    experiment: str | None
    changes: dict[str, Any]
    published: tuple[str, ...]
    elsewhere: dict[str, tuple[str, ...]]
    panel: str
    untrained: tuple[str, ...]

    @property
    def title(self) -> str:
        """Its labels in one piece, for messages and ``--rows``."""
        return " / ".join(label for label in self.labels if label.strip(NOTHING))


def _line(table: Table, group: Group, row: Row) -> Line:
    changes: dict[str, Any] = {}
    for part in (
        *(table.settings[name] for name in group.use),
        group.set,
        *(table.settings[name] for name in row.use),
        row.set,
    ):
        changes |= part
    count = len(table.columns) * len(table.measures)
    return Line(
        (*group.labels, *row.labels),
        group.experiment,
        changes,
        row.published or (NOTHING,) * count,
        dict(row.elsewhere),
        group.panel,
        row.untrained,
    )


@cache
def experiments_folder() -> Path:
    """The folder ``experiments``: inside an installed package, or at the root of the sources.

    Raises:
        MissingFileError: The installation is incomplete.
    """
    package = Path(graspmap.__file__).parent
    for folder in (package / "experiments", package.parents[1] / "experiments"):
        if (folder / "tables").is_dir():
            return folder
    raise MissingFileError(package / "experiments", "no such folder", "install graspmap again")


def table_names() -> tuple[str, ...]:
    """Names of the tables and figures that there are: tables first, in their order."""
    names = (path.stem for path in (experiments_folder() / "tables").glob("*.yaml"))
    return tuple(sorted(names, key=lambda name: (name.startswith("fig"), name)))


def read_table(name: str) -> Table:
    """The table or figure of that name, for example ``"table-5.1"``.

    Raises:
        UnknownNameError: There is none; the error lists the names, the nearest first.
    """
    if name not in table_names():
        raise UnknownNameError("table", name, table_names())
    return read_model(experiments_folder() / "tables" / f"{name}.yaml", Table, what="table")


def experiment_path(name: str) -> Path:
    """The experiment file that a table names."""
    return experiments_folder() / "thesis" / f"{name}.yaml"
