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

Kind = Literal["results", "times", "curves", "thresholds", "claims"]

ByScene = Literal["success", "success_75", "miou", "sgt"]
"""Measures that every test scene has, so that two rows can be compared scene by scene."""

LEAST_SEEDS = 2
"""One seed says nothing about others."""

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
        experiment: Name of a file in ``experiments/thesis``, or the place of one below
            ``experiments`` (``claims/ggcnn2``); null for rows that are only quoted.
        use: Settings that all of them apply.
        set: What all of them change, by dotted key.
        panel: Part of the figure that shows them.
        large: Whether their network takes a GPU to train; they are left out unless asked for.
        rows: The rows.
    """

    labels: tuple[str, ...] = ()
    experiment: str | None = None
    use: tuple[str, ...] = ()
    set: dict[str, Any] = Field(default_factory=dict)
    panel: str = ""
    large: bool = False
    rows: tuple[Row, ...]


class Pair(_Section):
    """Two rows of a table that a claim compares.

    Attributes:
        better: Title of the row that is said to be better.
        than: Title of the other.
    """

    better: str
    than: str


class Claim(_Section):
    """Something that is said of the rows of a table, and that their runs can put to the test.

    Attributes:
        name: Short name.
        statement: What is said.
        source: Who says it, and where.
        printed: The numbers that stand there, in words.
        by: Measure in which it is said; the verdict is about that one.
        expect: ``"better"``: the first of each pair gains; ``"alike"``: no pair differs.
        pairs: The rows that are compared.
        foretells: In place of pairs, two measures: over all rows, the first is said to go with the
            success of trials more closely than the second.
    """

    name: str
    statement: str
    source: str
    printed: str
    by: ByScene = "success"
    expect: Literal["better", "alike"] = "better"
    pairs: tuple[Pair, ...] = ()
    foretells: tuple[ByScene, ByScene] | None = None


class Table(_Section):
    """A table or figure of the thesis, or its claims.

    Attributes:
        title: What it shows.
        source: Where it stands.
        kind: Success of trained networks, times, learning curves, success by threshold, or claims,
            whose rows are trained and tested on the parts of a recipe.
        data: Kind of the data that the thesis trained on; None where there is none.
        test_data: Kind of other data that it tested on.
        folds: ``N/K``: N of K folds are run; None runs the experiment's own split once.
        seeds: Each row is trained with so many seeds; None trains it with one.
        labels: Heads of the label columns.
        settings: Changes by name, for rows and groups to use.
        variants: Columns that are runs of their own; none stands for a single one.
        measures: What is reported of each run, see `graspmap.reproduction.measures.MEASURES`.
        also: What is reported of it without a printed number to stand beside.
        groups: The rows.
        claims: What is said of them.
        notes: What a reader has to know.
    """

    title: str
    source: str
    kind: Kind = "results"
    data: Literal["cornell", "jacquard"] | None = None
    test_data: Literal["cornell", "jacquard"] | None = None
    folds: Annotated[str, Field(pattern=_FOLDS)] | None = None
    seeds: Annotated[int, Field(ge=LEAST_SEEDS)] | None = None
    labels: tuple[str, ...]
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict)
    variants: tuple[Variant, ...] = ()
    measures: tuple[str, ...]
    also: tuple[str, ...] = ()
    groups: tuple[Group, ...]
    claims: tuple[Claim, ...] = ()
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
        self._check_claims()
        return self

    def _check_claims(self) -> None:
        if (self.kind == "claims") != bool(self.claims) or (self.claims and self.seeds is None):
            raise ValueError(
                "allowed: claims and seeds in a table of the kind claims, and only there"
            )
        titles = [line.title for line in self.lines]
        for claim in self.claims:
            if bool(claim.pairs) == (claim.foretells is not None):
                raise ValueError(f"allowed: either pairs or foretells in the claim {claim.name}")
            for pair in claim.pairs:
                for title in (pair.better, pair.than):
                    if title not in titles:
                        raise ValueError(f"allowed: rows of the table, not {title} ({claim.name})")

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
        large: Whether its network takes a GPU to train.
    """

    labels: tuple[str, ...]
    experiment: str | None
    changes: dict[str, Any]
    published: tuple[str, ...]
    elsewhere: dict[str, tuple[str, ...]]
    panel: str
    untrained: tuple[str, ...]
    large: bool

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
        group.large,
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
    """Names of what there is: tables, figures, and the claims, each in their order."""
    names = (path.stem for path in (experiments_folder() / "tables").glob("*.yaml"))
    order = ("table", "fig")
    return tuple(sorted(names, key=lambda name: ([not name.startswith(o) for o in order], name)))


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
    return experiments_folder() / f"{name if '/' in name else f'thesis/{name}'}.yaml"
