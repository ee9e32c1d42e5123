"""EGAD's grid: 7 by 7 objects, named by row and column, A0 to G6 (Fig. 5.7 of the thesis).

Letters in shapes: R rows, C columns.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from graspmap.metrics.correlation import correlate
from graspmap.metrics.intervals import bootstrap_means, wilson_interval

ROWS = tuple("ABCDEFG")
COLUMNS = tuple("0123456")

PUBLISHED: tuple[dict[str, Any], ...] = (
    {
        "name": "thesis",
        "success": 0.77,
        "trials": 980,
        "source": "Thesis, section 5.2.2 and Fig. 5.7b: U-Net, three bins, on a WidowX arm",
    },
    {
        "name": "original study",
        "success": 0.58,
        "trials": None,
        "source": "Thesis, section 5.2.2 and Fig. 5.7a: GG-CNN, by EGAD's authors",
    },
)
"""Overall success on robots, to stand beside a simulated one; the thesis prints no cell as text."""

_NAME = re.compile(r"([A-G])([0-6])", re.IGNORECASE)

_FEWEST = 4  # objects; fewer show no trend

Held = Mapping[str, Sequence[bool]]
"""For each object: whether each of its tries held."""


def cell_of(id: str) -> tuple[int, int] | None:
    """Row and column of an object by its name; None where it has no place in the grid."""
    match = _NAME.fullmatch(id)
    if match is None:
        return None
    return ROWS.index(match[1].upper()), COLUMNS.index(match[2])


def make_grid(
    held: Held, possible: Held, *, rng: np.random.Generator, confidence: float = 0.95
) -> dict[str, Any] | None:
    """Success of each cell, with the means of rows and columns.

    The mean of a row is that of its cells, each counted once; its interval draws whole objects.

    Args:
        held: Whether the grasp of each try held, by object.
        possible: Whether any candidate of each try held, by object; empty where none were tried.
        rng: Source of the resamples.
        confidence: Of the intervals.

    Returns:
        ``rows`` and ``columns``: their names; ``success``, ``interval`` (Wilson's), ``ceiling``:
        (R, C), None where there is no such object; ``row_means``, ``column_means``,
        ``row_intervals``, ``column_intervals``; ``mean`` over all cells; ``missing`` cells and
        objects ``outside`` the grid, by name. None where no object has a name of the grid.
    """
    names: dict[tuple[int, int], str] = {}
    for name, tries in held.items():
        cell = cell_of(name)
        if cell is not None and tries:
            names[cell] = name
    if not names:
        return None
    success = {cell: float(np.mean(held[name])) for cell, name in names.items()}
    interval = {
        cell: list(wilson_interval(sum(held[name]), len(held[name]), confidence))
        for cell, name in names.items()
    }
    ceiling = {
        cell: float(np.mean(possible[name])) for cell, name in names.items() if possible.get(name)
    }
    rows = [_line([success.get((r, c)) for c in range(7)], rng, confidence) for r in range(7)]
    columns = [_line([success.get((r, c)) for r in range(7)], rng, confidence) for c in range(7)]
    return {
        "rows": list(ROWS),
        "columns": list(COLUMNS),
        "success": _table(success),
        "interval": _table(interval),
        "ceiling": _table(ceiling),
        "row_means": [mean for mean, _ in rows],
        "row_intervals": [ends for _, ends in rows],
        "column_means": [mean for mean, _ in columns],
        "column_intervals": [ends for _, ends in columns],
        "mean": float(np.mean(list(success.values()))),
        "missing": [
            row + column
            for r, row in enumerate(ROWS)
            for c, column in enumerate(COLUMNS)
            if (r, c) not in names
        ],
        "outside": [name for name, tries in held.items() if tries and cell_of(name) is None],
    }


def trends(values: Mapping[str, float], *, confidence: float = 0.95) -> dict[str, Any] | None:
    """Which way of the grid a measure of its objects falls: with the letters, or with the numbers.

    EGAD's grid grows in complexity one way and in difficulty the other; the thesis names both ways
    round (section 5.1.5 and the caption of Fig. 5.5).

    Args:
        values: The measure, by object; those without a place in the grid are left out.
        confidence: Of the intervals.

    Returns:
        ``rows`` and ``columns``: Spearman's correlation with the number of the row and of the
        column (``spearman``, ``interval``; None where all are the same). None where fewer than 4
        objects have a place.
    """
    placed = {cell: value for id, value in values.items() if (cell := cell_of(id)) is not None}
    if len(placed) < _FEWEST:
        return None
    found = {}
    for way, place in (("rows", 0), ("columns", 1)):
        numbers = [cell[place] for cell in placed]
        one = correlate(numbers, list(placed.values()), confidence=confidence)
        ends = one.spearman_interval
        found[way] = {"spearman": one.spearman, "interval": None if ends is None else list(ends)}
    return found


def _table(cells: Mapping[tuple[int, int], Any]) -> list[list[Any]]:
    return [[cells.get((r, c)) for c in range(len(COLUMNS))] for r in range(len(ROWS))]


def _line(
    cells: Sequence[float | None], rng: np.random.Generator, confidence: float
) -> tuple[float | None, list[float] | None]:
    """Mean of a row or column over the objects that there are, and its interval."""
    there = np.array([cell for cell in cells if cell is not None], dtype=np.float64)
    if not len(there):
        return None, None
    ends = bootstrap_means(there[:, None], rng=rng, confidence=confidence)[0]
    return float(there.mean()), ends.tolist()
