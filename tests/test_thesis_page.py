"""docs/thesis.md: each equation, table and figure of the thesis has a line, each link a file."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from graspmap.reproduction.table_file import table_names

PAGE = Path(__file__).parents[1] / "docs" / "thesis.md"
EQUATIONS = [
    *(f"3.{i}" for i in range(1, 18)), *(f"4.{i}" for i in range(1, 6)),
    *(f"5.{i}" for i in range(1, 7)), "B.0.1", "B.0.2", "B.0.3",
]  # fmt: skip
TABLES = [
    "2.1", "2.2", "2.3", "3.1", "3.2", "3.3", "4.1", "4.2", "4.3", "4.4", "5.1", "5.2", "5.3",
    "A.1", "A.2",
]  # fmt: skip
FIGURES = [
    "1.1", *(f"2.{i}" for i in range(1, 9)), *(f"3.{i}" for i in range(1, 13)),
    *(f"4.{i}" for i in range(1, 9)), *(f"5.{i}" for i in range(1, 12)), "B.1", "B.2",
]  # fmt: skip


def named(heading: str) -> list[str]:
    """What stands in the first column below a heading."""
    part = PAGE.read_text(encoding="utf-8").split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [line.split("|")[1].strip() for line in part.splitlines() if line.startswith("|")]
    return [name.strip() for row in rows[2:] for name in row.split(",")]


@pytest.mark.parametrize(
    ("heading", "names"), [("Equations", EQUATIONS), ("Tables", TABLES), ("Figures", FIGURES)]
)
def test_each_has_one_line(heading, names):
    assert sorted(named(heading)) == sorted(names)


def test_links_lead_somewhere():
    targets = re.findall(r"\]\(([^)#]+)\)", PAGE.read_text(encoding="utf-8"))
    assert len(targets) > 50
    for target in targets:
        assert (PAGE.parent / target).exists(), target


def test_every_table_that_is_made_again_is_linked():
    text = PAGE.read_text(encoding="utf-8")
    for name in table_names():
        assert f"experiments/tables/{name}.yaml" in text
