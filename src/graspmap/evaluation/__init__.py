"""Detectors and prediction files measured against labelled scenes, and tried in physics.

Each name is loaded at its first use: measuring rectangles needs no simulator.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from graspmap.evaluation.animations import animate_trials
    from graspmap.evaluation.baselines import CenterGrasp, center_grasp_baseline
    from graspmap.evaluation.evaluate import (
        GraspDetector,
        evaluate_detector,
        evaluate_predictions,
        to_predictions,
    )
    from graspmap.evaluation.results import Evaluation, SceneResult
    from graspmap.evaluation.trials import (
        TrialEvaluation,
        TrialPlan,
        TriedGrasp,
        file_predictions,
        labelled_grasps,
        predict_scenes,
        try_grasps,
        write_trials,
    )

__all__ = [
    "CenterGrasp",
    "Evaluation",
    "GraspDetector",
    "SceneResult",
    "TrialEvaluation",
    "TrialPlan",
    "TriedGrasp",
    "animate_trials",
    "center_grasp_baseline",
    "evaluate_detector",
    "evaluate_predictions",
    "file_predictions",
    "labelled_grasps",
    "predict_scenes",
    "to_predictions",
    "try_grasps",
    "write_trials",
]

_HOME = {
    "CenterGrasp": "baselines",
    "Evaluation": "results",
    "GraspDetector": "evaluate",
    "SceneResult": "results",
    "TrialEvaluation": "trials",
    "TrialPlan": "trials",
    "TriedGrasp": "trials",
    "animate_trials": "animations",
    "center_grasp_baseline": "baselines",
    "evaluate_detector": "evaluate",
    "evaluate_predictions": "evaluate",
    "file_predictions": "trials",
    "labelled_grasps": "trials",
    "predict_scenes": "trials",
    "to_predictions": "evaluate",
    "try_grasps": "trials",
    "write_trials": "trials",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'graspmap.evaluation' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"graspmap.evaluation.{_HOME[name]}"), name)
    globals()[name] = value
    return value
