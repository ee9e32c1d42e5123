"""The figures of the thesis that are made of runs: learning curves, success by threshold."""

from __future__ import annotations

import csv
import io
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from graspmap.files import write_bytes, write_text
from graspmap.pictures.plots import Panel, Plot, Series, line_chart
from graspmap.reproduction.results import Filled

Curve = tuple[list[float], list[float], list[float], list[int]]
"""x, mean, standard deviation and number of folds; percent."""


def draw_figure(filled: Filled, folder: Path) -> list[Path]:
    """Write the picture of a figure and its points; nothing for a table.

    Returns:
        The files: ``NAME.png`` and ``NAME-points.csv``.

    Raises:
        FileError: They cannot be written.
    """
    kind, name = filled.plan.table.kind, filled.plan.request.name
    if kind not in ("curves", "thresholds"):
        return []
    get = _by_epoch if kind == "curves" else _by_threshold
    curves = {row: _mean(filled, row, get) for row in range(len(filled.plan.lines))}
    curves = {row: curve for row, curve in curves.items() if curve[0]}
    points = folder / f"{name}-points.csv"
    write_text(points, _points(filled, curves, "epoch" if kind == "curves" else "threshold"))
    if not curves:
        return [points]
    draw = _learning if kind == "curves" else _thresholds
    picture = folder / f"{name}.png"
    write_bytes(picture, draw(filled, curves).png())
    return [picture, points]


def _by_epoch(result: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    success = result.get("success_by_epoch") or []
    return [float(i) for i in range(1, len(success) + 1)], list(success)


def _by_threshold(result: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    found = result.get("overlaps") or {}
    return list(found.get("thresholds", ())), list(found.get("success", ()))


def _mean(
    filled: Filled, row: int, get: Callable[[Mapping[str, Any]], tuple[list[float], list[float]]]
) -> Curve:
    """Mean and spread over the folds of a row, as far as each has points."""
    runs = filled.plan.cells.get((row, 0), ())
    folds = [get(filled.results[run]) for run in runs if run in filled.results]
    x = max((xs for xs, _ in folds), key=len, default=[])
    columns = [[100 * ys[i] for _, ys in folds if i < len(ys)] for i in range(len(x))]
    return (
        x,
        [statistics.fmean(column) for column in columns],
        [statistics.stdev(column) if len(column) > 1 else 0.0 for column in columns],
        [len(column) for column in columns],
    )


def _points(filled: Filled, curves: Mapping[int, Curve], x_name: str) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*filled.plan.table.labels, x_name, "success mean, %", "spread", "folds"])
    for row, (x, mean, spread, count) in curves.items():
        for values in zip(x, mean, spread, count, strict=True):
            writer.writerow([*filled.plan.lines[row].labels, *map(repr, values)])
    return text.getvalue()


def _learning(filled: Filled, curves: Mapping[int, Curve]) -> Plot:
    """One panel for each part of the figure, one line for each row."""
    lines = filled.plan.lines
    names = dict.fromkeys(lines[row].panel for row in curves)
    panels = [
        Panel(
            name,
            tuple(
                _series(lines[row].title, curve)
                for row, curve in curves.items()
                if lines[row].panel == name
            ),
        )
        for name in names
    ]
    epochs = max(curve[0][-1] for curve in curves.values())
    return line_chart(
        panels,
        columns=3,
        x_label="epoch",
        y_label="validation success, %",
        x_range=(min(1.0, epochs - 1), epochs),
        y_range=_range(curves.values()),
    )


def _thresholds(filled: Filled, curves: Mapping[int, Curve]) -> Plot:
    """One panel for each row: its line over those of all others."""
    panels = []
    for row, curve in curves.items():
        others = (Series("", *other[:2], pale=True) for n, other in curves.items() if n != row)
        panels.append(Panel(filled.plan.lines[row].title, (_series("", curve), *others)))
    return line_chart(
        panels,
        columns=3,
        x_label="IoU threshold",
        y_label="success, %",
        x_range=(0.0, 1.0),
        y_range=(0.0, 100.0),
    )


def _series(name: str, curve: Curve) -> Series:
    """The mean as a line, the spread as a band around it."""
    x, mean, spread, _ = curve
    low = [m - s for m, s in zip(mean, spread, strict=True)]
    high = [m + s for m, s in zip(mean, spread, strict=True)]
    return Series(name, x, mean, low, high)


def _range(curves: Sequence[Curve] | Any) -> tuple[float, float]:
    """Ends of the vertical axis: tens of percent around what is shown."""
    low = min(m - s for _, mean, spread, _ in curves for m, s in zip(mean, spread, strict=True))
    high = max(m + s for _, mean, spread, _ in curves for m, s in zip(mean, spread, strict=True))
    bottom = max(0.0, 10 * math.floor(low / 10))
    return bottom, min(100.0, max(10 * math.ceil(high / 10), bottom + 10))
