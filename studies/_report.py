"""What all studies do at their end: print a table and write it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from graspmap.metrics.intervals import wilson_interval


def table(columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Print rows under their columns, numbers to the right."""
    cells = [[_cell(v) for v in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    right = [all(isinstance(row[i], int | float) for row in rows) for i in range(len(columns))]
    for line in (list(columns), *cells):
        print(
            "  ".join(
                text.rjust(w) if r else text.ljust(w)
                for text, w, r in zip(line, widths, right, strict=True)
            ).rstrip()
        )


def share(count: int, total: int) -> str:
    """A share with its 95 % interval."""
    low, high = wilson_interval(count, total)
    return f"{count / total:.1%} ({low:.1%} to {high:.1%})"


def write(out: Path | None, name: str, result: Mapping[str, Any]) -> None:
    """Write ``OUT/NAME.json`` where a folder is given."""
    if out is None:
        return
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{name}.json").write_text(json.dumps(result, indent=2) + "\n")
    print(f"written: {out / name}.json")


def _cell(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
