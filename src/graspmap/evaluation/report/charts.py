"""The plots of a report: which part of a summary is drawn how."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from graspmap.evaluation.report.numbers import as_text
from graspmap.pictures.heat_maps import confusion_chart, heat_map
from graspmap.pictures.plots import (
    Bar,
    Panel,
    Plot,
    Series,
    bar_chart,
    line_chart,
    reliability_diagram,
)

Data = Mapping[str, Any]


def report_plots(data: Data) -> dict[str, Plot]:
    """The plots of those sections that a summary has, by name.

    Args:
        data: What ``evaluation.json`` holds.
    """
    drawn = {name: draw(data) for name, draw in _PLOTS.items()}
    return {name: plot for name, plot in drawn.items() if plot is not None}


def success_curve(curves: Mapping[str, Data]) -> Plot:
    """Success against the overlap that it takes, a line for each evaluation.

    Args:
        curves: ``thresholds`` and ``success`` by name.
    """
    lines = (Series(name, curve["thresholds"], curve["success"]) for name, curve in curves.items())
    return line_chart(
        [Panel("", tuple(lines))],
        x_label="overlap (IoU) that counts as right",
        y_label="success",
        x_range=(0.0, 1.0),
        y_range=(0.0, 1.0),
    )


def _curve(data: Data) -> Plot | None:
    curve = data.get("curve")
    return None if not curve else success_curve({"": curve})


def _quirks(data: Data) -> Plot | None:
    quirks = data.get("quirks")
    if not quirks:
        return None
    ends = [100 * abs(end) for quirk in quirks for end in quirk["interval"]]
    reach = 1.35 * max([*ends, *(100 * abs(quirk["change"]) for quirk in quirks), 1.0])
    bars = [
        Bar(
            quirk["name"],
            100 * quirk["change"],
            (100 * quirk["interval"][0], 100 * quirk["interval"][1]),
            as_text("change", quirk["change"]),
        )
        for quirk in quirks
    ]
    return bar_chart(bars, x_label="change of success at IoU 0.25, points", x_range=(-reach, reach))


def _outcomes(data: Data) -> Plot | None:
    trials = data.get("trials")
    if not trials or not trials["outcomes"]:
        return None
    outcomes = trials["outcomes"]
    top = 1.15 * max(outcomes.values())
    bars = [Bar(name, count, None, as_text("count", count)) for name, count in outcomes.items()]
    return bar_chart(bars, x_label="trials", x_range=(0.0, top))


def _reliability(data: Data) -> Plot | None:
    bins = (data.get("calibration") or {}).get("bins")
    full = [one for one in bins or () if one["count"]]
    if not full:
        return None
    return reliability_diagram(
        [one["quality"] for one in full],
        [one["held"] for one in full],
        [one["interval"] for one in full],
        [one["count"] for one in full],
    )


def _saliency(data: Data) -> Plot | None:
    saliency = (data.get("tasks") or {}).get("saliency")
    if not saliency or not saliency.get("precision"):
        return None
    line = Series("", saliency["recall"], saliency["precision"])
    return line_chart(
        [Panel("", (line,))],
        x_label="recall",
        y_label="precision",
        x_range=(0.0, 1.02),
        y_range=(0.0, 1.02),
    )


def _confusion(data: Data) -> Plot | None:
    category = (data.get("tasks") or {}).get("category")
    if not category or not category.get("confusion"):
        return None
    return confusion_chart(category["confusion"], category["classes"])


def _grid(data: Data, key: str) -> Plot | None:
    """A cell for each object of EGAD; None where no object has a place in its grid."""
    grid = (data.get("egad") or {}).get("grid")
    if not grid or all(cell is None for row in grid[key] for cell in row):
        return None
    cells = [[math.nan if cell is None else cell for cell in row] for row in grid[key]]
    return heat_map(cells, grid["rows"], grid["columns"])


_PLOTS: dict[str, Callable[[Data], Plot | None]] = {
    "curve": _curve,
    "quirks": _quirks,
    "outcomes": _outcomes,
    "reliability": _reliability,
    "saliency": _saliency,
    "confusion": _confusion,
    "egad": lambda data: _grid(data, "success"),
    "egad_ceiling": lambda data: _grid(data, "ceiling"),
}
