"""EGAD's protocol: every object of a folder dropped, seen and grasped once, twenty times each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspmap.lazy import lazy_names

if TYPE_CHECKING:
    from graspmap.evaluation.egad.attempt import EgadTry
    from graspmap.evaluation.egad.plan import DetectorFile, EgadPlan
    from graspmap.evaluation.egad.results import EgadEvaluation
    from graspmap.evaluation.egad.run import evaluate_egad, finish

__all__ = ["DetectorFile", "EgadEvaluation", "EgadPlan", "EgadTry", "evaluate_egad", "finish"]

_HOME = {
    "DetectorFile": "plan",
    "EgadEvaluation": "results",
    "EgadPlan": "plan",
    "EgadTry": "attempt",
    "evaluate_egad": "run",
    "finish": "run",
}

__getattr__, __dir__ = lazy_names(__name__, _HOME)
