"""The page of a comparison: evaluations side by side."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from graspmap.evaluation.compare import Comparison
from graspmap.evaluation.report.charts import success_curve
from graspmap.evaluation.report.page import render_page
from graspmap.evaluation.results import as_csv
from graspmap.files import write_text
from graspmap.pictures.plots import Bar, Plot, bar_chart

JSON_FILE = "comparison.json"
CSV_FILE = "comparison.csv"
PAGE_FILE = "comparison.html"


def write_comparison(comparison: Comparison, folder: Path | str) -> list[Path]:
    """Write ``comparison.html``, ``comparison.csv`` (one row a run) and ``comparison.json``.

    Args:
        comparison: What was compared.
        folder: Where they are written; made if needed.

    Returns:
        The files.

    Raises:
        StorageFullError: The disk is full.
        FileError: The folder cannot be written to.
    """
    data = comparison.to_dict()
    names = (PAGE_FILE, CSV_FILE, JSON_FILE)
    page, table, values = (Path(folder) / name for name in names)
    write_text(page, render_page("comparison.html.j2", data, _plots(data)))
    write_text(table, as_csv(_rows(data)))
    write_text(values, json.dumps(data, indent=2) + "\n")
    return [page, table, values]


def _rows(data: dict[str, Any]) -> list[dict[str, Any]]:
    """One flat row for each run, all with the same keys."""
    rows = []
    for name, run in data["runs"].items():
        row: dict[str, Any] = {"run": name, "folder": run["folder"]}
        for part, scores in (("", run), ("trials_", run.get("trials") or {})):
            for key in ("scenes", "trials", "success", "interval", "miou", "auc"):
                if isinstance(scores.get(key), dict) and key != "trials":
                    row |= {f"{part}{key}@{at}": value for at, value in scores[key].items()}
                elif key in scores and key != "trials":
                    row[f"{part}{key}"] = scores[key]
        rows.append(row)
    keys = dict.fromkeys(key for row in rows for key in row)
    return [{key: row.get(key) for key in keys} for row in rows]


def _plots(data: dict[str, Any]) -> dict[str, Plot]:
    runs = data["runs"]
    plots = {}
    curves = {name: run["curve"] for name, run in runs.items() if "curve" in run}
    if curves:
        plots["curve"] = success_curve(curves)
    trials = {name: run["trials"] for name, run in runs.items() if "trials" in run}
    if trials:
        bars = [
            Bar(name, t["success"], (t["interval"][0], t["interval"][1]), f"{t['success']:.1%}")
            for name, t in trials.items()
        ]
        plots["trials"] = bar_chart(bars, x_label="share of trials that held", x_range=(0.0, 1.15))
    return plots
