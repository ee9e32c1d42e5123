"""The tables and figures of the thesis: expanded to runs, run, and written beside its numbers.

Each name is loaded at its first use: listing the tables needs no PyTorch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspmap.lazy import lazy_names

if TYPE_CHECKING:
    from graspmap.reproduction.claims import JudgedClaim, judge
    from graspmap.reproduction.crew import Crew, Outcome, choose_crew, conduct
    from graspmap.reproduction.plan import Plan, Run, make_plan
    from graspmap.reproduction.request import Request
    from graspmap.reproduction.results import Filled, fill
    from graspmap.reproduction.table_file import Table, read_table, table_names
    from graspmap.reproduction.timing import Estimate, estimate, time_detection
    from graspmap.reproduction.write import to_dict, to_markdown, write_table

__all__ = [
    "Crew",
    "Estimate",
    "Filled",
    "JudgedClaim",
    "Outcome",
    "Plan",
    "Request",
    "Run",
    "Table",
    "choose_crew",
    "conduct",
    "estimate",
    "fill",
    "judge",
    "make_plan",
    "read_table",
    "table_names",
    "time_detection",
    "to_dict",
    "to_markdown",
    "write_table",
]

_HOME = {
    "Crew": "crew",
    "Estimate": "timing",
    "Filled": "results",
    "JudgedClaim": "claims",
    "Outcome": "crew",
    "Plan": "plan",
    "Request": "request",
    "Run": "plan",
    "Table": "table_file",
    "choose_crew": "crew",
    "conduct": "crew",
    "estimate": "timing",
    "fill": "results",
    "judge": "claims",
    "make_plan": "plan",
    "read_table": "table_file",
    "table_names": "table_file",
    "time_detection": "timing",
    "to_dict": "write",
    "to_markdown": "write",
    "write_table": "write",
}

__getattr__, __dir__ = lazy_names(__name__, _HOME)
