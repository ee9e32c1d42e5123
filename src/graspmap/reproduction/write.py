"""A filled table as Markdown for people, as CSV for spreadsheets, as JSON for programs.

None of them holds a date, a time of the work or a path of the machine beyond the data's name: the
same runs give the same bytes.
"""

from __future__ import annotations

import csv
import io
import json
import os
import platform
from pathlib import Path
from typing import Any

from graspmap import __version__
from graspmap.data.fingerprint import data_hash
from graspmap.files import write_text
from graspmap.reproduction.claims import RULE
from graspmap.reproduction.facts import PartFacts
from graspmap.reproduction.figures import draw_figure
from graspmap.reproduction.measures import MEASURES
from graspmap.reproduction.results import Cell, Column, Filled
from graspmap.reproduction.write_claims import claim_to_dict, claims_to_csv, claims_to_markdown


def write_table(filled: Filled, folder: Path) -> list[Path]:
    """Write ``NAME.md``, ``.csv`` and ``.json``, and of a figure its picture and its points.

    Args:
        filled: The table.
        folder: Where they go; it is made where it is missing.

    Returns:
        The files.

    Raises:
        FileError: They cannot be written.
    """
    name = filled.plan.request.name
    files = draw_figure(filled, folder)
    content = {
        ".csv": to_csv(filled),
        ".json": json.dumps(to_dict(filled), indent=2, ensure_ascii=False) + "\n",
        **({"-pairs.csv": claims_to_csv(filled.claims)} if filled.claims else {}),
        ".md": to_markdown(filled, [path.name for path in files if path.suffix == ".png"]),
    }
    for suffix, text in content.items():
        files.append(folder / f"{name}{suffix}")
        write_text(files[-1], text)
    return files


def to_markdown(filled: Filled, pictures: list[str] | None = None) -> str:
    """The table and all that a reader has to know about it.

    Args:
        filled: The table.
        pictures: Names of pictures beside it.
    """
    plan = filled.plan
    lines = [f"# {plan.request.name}: {plan.table.title}", "", f"Source: {plan.table.source}."]
    if plan.table.measures:
        lines[-1] += " *Thesis* is what it prints, *here* is what was measured."
    lines.append("")
    lines += [f"![{plan.table.title}]({name})\n" for name in pictures or ()]
    if filled.claims:
        lines += [*claims_to_markdown(filled.claims), "## All rows", ""]
    lines += [*_grid(filled), ""]
    notes = [
        *(f"{place} prints for the row \"{plan.lines[row].title}\": {said}."
          for row, place, said in filled.elsewhere),
        *plan.table.notes,
    ]  # fmt: skip
    lines += ["Notes:", *(f"- {note}" for note in notes), ""] if notes else []
    lines += ["How it was made:", *(f"- {line}" for line in describe(filled)), ""]
    return "\n".join(lines)


def _grid(filled: Filled) -> list[str]:
    heads = list(filled.plan.table.labels)
    for column in filled.columns:
        heads += [f"{column.head}, thesis"] if column.printed else []
        heads.append(f"{column.head}, here" if column.printed else column.head)
    right = len(heads) - len(filled.plan.table.labels)
    rows = [heads, ["---"] * len(filled.plan.table.labels) + ["---:"] * right]
    for line, cells in filled.rows:
        row = list(line.labels)
        for column, cell in zip(filled.columns, cells, strict=True):
            row += [cell.published.text] if column.printed else []
            row.append(cell.text(MEASURES[column.measure]))
        rows.append(row)
    return ["| " + " | ".join(text.replace("|", "\\|") for text in row) + " |" for row in rows]


def describe(filled: Filled) -> list[str]:
    """Data, folds, what was made smaller, what was left out: one statement a line."""
    plan, request = filled.plan, filled.plan.request
    said = []
    if plan.facts is not None:
        facts = plan.facts
        said.append(f"Data: {request.data}, {len(facts.scenes)} scenes of {facts.objects} objects.")
        if request.test_data is not None:
            said[-1] += f" Test: {request.test_data}."
    if plan.parts is not None:
        said[-1] = f"Data: {request.data}."
        said += _describe_parts(plan.parts)
        said.append(f"{plan.seeds} seeds a row; ± is the standard deviation over them.")
    if plan.folds is not None:
        run, of = plan.folds
        by = next(iter(plan.experiments.values())).data.split.by
        said.append(
            f"{run} of {of} folds by {by}; each holds 1/{of} of the data out, half of it to choose "
            "the epoch, half to test once. ± is the standard deviation over folds."
        )
        if plan.table.folds not in (None, f"{run}/{of}"):
            said.append(f"By default the table runs {plan.table.folds} folds.")
    said += [
        f"`{key}` is {_short(now)} instead of {_short(before)}."
        for key, (before, now) in filled.changed.items()
        if key != "data.split.folds"
    ]
    if request.scale != 1:
        whole = "published" if plan.parts is None else "full"
        said.append(f"Scale {request.scale:g}: so much of the {whole} training steps.")
    if not filled.changed and plan.table.kind != "times":
        said.append("Nothing of the training was made smaller.")
    said += [f"Row left out: {title}: {why}." for title, why in plan.left_out]
    said += [f"Not measured: {MEASURES[m].title}: {why}." for m, why in plan.unmeasured.items()
             if m in plan.measures]  # fmt: skip
    titles = {run.id: run.title for run in plan.runs}
    said += [f"Run failed: {titles[run]}: {why}" for run, why in filled.failures.items()]
    said.append(f"Seed {request.seed}; graspmap {__version__}.")
    if plan.table.kind == "times":
        said.append(f"Timed on {platform.machine()}, {os.cpu_count()} cores.")
    return said


def _describe_parts(parts: PartFacts) -> list[str]:
    """Each part: its scenes, and what they are in one hash."""
    return [
        f"Part {name}: {len(facts.scenes)} scenes of {facts.objects} objects, "
        f"{data_hash(facts.scenes)}."
        for name, facts in parts.by_name.items()
    ]


def _short(value: Any) -> str:
    return "a whole pass" if value is None else json.dumps(value)


def to_csv(filled: Filled) -> str:
    """One line a row; for each column the printed number and ours: mean, spread, how many."""
    heads = list(filled.plan.table.labels)
    for column in filled.columns:
        heads += [f"{column.head} thesis"] if column.printed else []
        heads += [f"{column.head} {part}" for part in ("mean", "spread", filled.plan.unit)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(heads)
    for line, cells in filled.rows:
        row: list[Any] = list(line.labels)
        for column, cell in zip(filled.columns, cells, strict=True):
            row += [cell.published.text] if column.printed else []
            row += ["" if v is None else repr(v) for v in (cell.mean, cell.spread)]
            row.append(len(cell.values))
        writer.writerow(row)
    return text.getvalue()


def to_dict(filled: Filled) -> dict[str, Any]:
    """The table for JSON."""
    plan, request = filled.plan, filled.plan.request
    return {
        "table": request.name,
        "title": plan.table.title,
        "source": plan.table.source,
        "data": request.data,
        "test_data": request.test_data,
        "scenes": None if plan.facts is None else len(plan.facts.scenes),
        "seed": request.seed,
        "scale": request.scale,
        "folds": None if plan.folds is None else {"run": plan.folds[0], "of": plan.folds[1]},
        "seeds": plan.seeds,
        "parts": None if plan.parts is None else _parts(plan.parts),
        "changed": {k: {"thesis": a, "here": b} for k, (a, b) in filled.changed.items()},
        "labels": list(plan.table.labels),
        "rows": [
            {
                "labels": list(line.labels),
                "cells": [
                    _cell(c, cell, plan.unit) for c, cell in zip(filled.columns, cells, strict=True)
                ],
                "elsewhere": line.elsewhere,
                "runs": [
                    list(plan.cells.get((row, column), ()))
                    for column in range(len(plan.table.columns))
                ],
            }
            for row, (line, cells) in enumerate(filled.rows)
        ],
        "left_out": [{"row": row, "why": why} for row, why in plan.left_out],
        "not_measured": dict(plan.unmeasured),
        "failures": dict(filled.failures),
        "notes": list(plan.table.notes),
        "rule": list(RULE) if filled.claims else None,
        "claims": [claim_to_dict(one) for one in filled.claims],
        "graspmap": __version__,
    }


def _parts(parts: PartFacts) -> dict[str, Any]:
    return {
        name: {
            "scenes": len(facts.scenes),
            "objects": facts.objects,
            "data_hash": data_hash(facts.scenes),
        }
        for name, facts in parts.by_name.items()
    }


def _cell(column: Column, cell: Cell, unit: str) -> dict[str, Any]:
    return {
        "column": column.head,
        "measure": column.measure,
        "thesis": {
            "text": cell.published.text,
            "mean": cell.published.mean,
            "spread": cell.published.spread,
        },
        "mean": cell.mean,
        "spread": cell.spread,
        unit: len(cell.values),
        "values": list(cell.values),
        "missing": cell.missing,
    }
