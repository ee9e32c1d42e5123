"""Detectors and prediction files measured against labelled scenes."""

from graspmap.evaluation.baselines import CenterGrasp, center_grasp_baseline
from graspmap.evaluation.evaluate import (
    GraspDetector,
    evaluate_detector,
    evaluate_predictions,
    to_predictions,
)
from graspmap.evaluation.results import Evaluation, SceneResult

__all__ = [
    "CenterGrasp",
    "Evaluation",
    "GraspDetector",
    "SceneResult",
    "center_grasp_baseline",
    "evaluate_detector",
    "evaluate_predictions",
    "to_predictions",
]
