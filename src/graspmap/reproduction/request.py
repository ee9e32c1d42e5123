"""What a user asks of a table, and whether the options fit the table and each other."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from graspmap.config import COMMAND_LINE
from graspmap.data import make_folds
from graspmap.errors import ConfigError, InvalidInputError, UnknownNameError
from graspmap.reproduction.facts import DataFacts
from graspmap.reproduction.table_file import LEAST_SEEDS, Line, Table

_INSTEAD = {
    "name": "it is made from the experiment",
    "seed": "give --seed",
    "data.source": "give --data",
    "data.validation.source": "give --data to claims",
    "data.test.source": "give --test-data",
    "data.split.seed": "give --seed",
    "data.split.folds": "give --folds",
    "data.split.fold": "give --folds",
    "data.split.file": "a table divides the data itself, see --folds",
    "training.device": "give --devices",
}
"""Keys that the command sets itself, and what to do instead."""


@dataclass(frozen=True)
class Request:
    """What the user wants of a table.

    Attributes:
        name: The table.
        data: ``kind:folder`` to train (and test) on; None for tables that need none.
        test_data: ``kind:folder`` to test on, for tables that test on other data.
        folds: ``K`` (all of K folds) or ``N/K``; None as the table says.
        scale: Share of the published training steps.
        rows: Pattern that the titles of rows must contain or match; None for all.
        seed: Seed of weights, order and folds; the first one where there are several.
        seeds: How many seeds each row of the claims is trained with; None as the table says.
        large: Whether networks are trained, too, that take a GPU.
        changes: Further keys of the experiments, dotted.
    """

    name: str
    data: str | None = None
    test_data: str | None = None
    folds: str | None = None
    scale: float = 1.0
    rows: str | None = None
    seed: int = 0
    seeds: int | None = None
    large: bool = False
    changes: Mapping[str, Any] = field(default_factory=dict)


def check_request(request: Request, table: Table) -> None:
    """See that the options fit each other and the table.

    Raises:
        InvalidInputError: An option is missing, out of range, or says nothing to this table.
        ConfigError: A key of the experiments is set by the table or by another option.
    """
    name = request.name
    if table.kind == "times":
        _refuse(f"{name} only times networks", folds=request.folds, scale=request.scale != 1)
    elif request.data is None:
        wanted = f"KIND:DIR to train on; the thesis has {table.data} there"
        if table.kind == "claims":
            wanted = "the folder that graspmap generate --recipe graspmap-v1 --out DIR made"
        raise InvalidInputError("--data", "missing", wanted)
    if table.seeds is None:
        _refuse(f"{name} has one seed, see --folds", seeds=request.seeds, large=request.large)
    elif request.seeds is not None and request.seeds < LEAST_SEEDS:
        raise InvalidInputError("--seeds", request.seeds, f"{LEAST_SEEDS} or more")
    if (request.test_data is None) != (table.test_data is None):
        allowed = f"KIND:DIR to test on; the thesis has {table.test_data} there"
        raise InvalidInputError(
            "--test-data",
            request.test_data or "missing",
            allowed if table.test_data else f"nothing: {name} tests on parts of --data",
        )
    if request.seed < 0:
        raise InvalidInputError("--seed", request.seed, "0 or more")
    if not 0 < request.scale <= 1:
        raise InvalidInputError("--scale", request.scale, "a share above 0, up to 1")
    _check_changes(request, table)


def _refuse(why: str, **given: object) -> None:
    """Refuse options that say nothing to a table."""
    for option, value in given.items():
        if value:
            raise InvalidInputError(f"--{option}", "given", f"nothing: {why}")


def _check_changes(request: Request, table: Table) -> None:
    varied = {key for variant in table.columns for key in variant.set}
    varied |= {key for line in table.lines for key in line.changes}
    for key in request.changes:
        if key in _INSTEAD:
            problem, remedy = "is set by the table", _INSTEAD[key]
        elif key in varied:
            problem, remedy = f"is varied by {request.name} itself", "pick rows with --rows"
        elif request.scale != 1 and key in ("training.epochs", "training.batches_per_epoch"):
            problem, remedy = "contradicts --scale", "give one of the two"
        else:
            continue
        raise ConfigError(COMMAND_LINE, f"--{key}", problem, remedy)


def chosen_lines(request: Request, table: Table) -> tuple[Line, ...]:
    """The rows that the pattern matches: as a part of the title, or as a shell pattern.

    Raises:
        UnknownNameError: It matches none; the error lists the rows.
    """
    if request.rows is None:
        return table.lines
    pattern = request.rows.lower()
    lines = tuple(
        line
        for line in table.lines
        if pattern in line.title.lower() or fnmatch.fnmatchcase(line.title.lower(), pattern)
    )
    if not lines:
        raise UnknownNameError("--rows", request.rows, (line.title for line in table.lines))
    return lines


def chosen_folds(request: Request, table: Table, facts: DataFacts) -> tuple[int, int] | None:
    """(N, K): the first N of K folds are run; None where the experiments divide the data once.

    Raises:
        InvalidInputError: There are no such folds, or the data are too small for them.
    """
    text = request.folds or table.folds
    if text is None:
        return None
    if table.folds is None:
        raise InvalidInputError("--folds", text, f"nothing: {request.name} has one run a row")
    first, slash, last = text.partition("/")
    numbers = (first, last) if slash else (first, first)
    run, of = (int(n) if n.isdecimal() and len(n) < 5 else 0 for n in numbers)
    if of < 2 or not 1 <= run <= of:
        raise InvalidInputError(
            "--folds", repr(text), "K of at least 2, or N/K with N from 1 to K: 1/5 is one of five"
        )
    by = request.changes.get("data.split.by", "object")
    try:
        make_folds(facts.scenes, of, by=by, seed=request.seed)
    except UnknownNameError:
        pass  # the experiment says it better
    except InvalidInputError as error:
        ways = "--folds K or N/K sets them"
        if by == "object":
            ways += ", --data.split.by image divides by image"
        raise InvalidInputError(error.name, error.found, f"{error.allowed} ({ways})") from error
    return run, of
