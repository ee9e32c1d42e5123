"""Detectors and prediction files measured against labelled scenes, and tried in physics.

Each name is loaded at its first use: measuring rectangles needs no simulator.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspmap.lazy import lazy_names

if TYPE_CHECKING:
    from graspmap.evaluation.animations import animate_trials
    from graspmap.evaluation.baselines import CenterGrasp, center_grasp_baseline
    from graspmap.evaluation.compare import Comparison, compare_runs
    from graspmap.evaluation.evaluate import (
        GraspDetector,
        evaluate_detector,
        evaluate_predictions,
        in_file_frame,
        to_predictions,
    )
    from graspmap.evaluation.grasps_to_try import (
        GraspsToTry,
        file_predictions,
        labelled_grasps,
        predict_scenes,
    )
    from graspmap.evaluation.report.comparison_page import write_comparison
    from graspmap.evaluation.report.gallery import Exhibit, make_gallery
    from graspmap.evaluation.report.page import write_report
    from graspmap.evaluation.results import Evaluation, SceneResult
    from graspmap.evaluation.seen_by import SeenBy
    from graspmap.evaluation.shape_baselines import AntipodalGrasp, MomentsGrasp
    from graspmap.evaluation.task_scores import TaskEvaluation, evaluate_tasks
    from graspmap.evaluation.trial_plan import TrialPlan
    from graspmap.evaluation.trial_results import TrialEvaluation, TriedGrasp, write_trials
    from graspmap.evaluation.trials import try_grasps

__all__ = [
    "AntipodalGrasp",
    "CenterGrasp",
    "Comparison",
    "Evaluation",
    "Exhibit",
    "GraspDetector",
    "GraspsToTry",
    "MomentsGrasp",
    "SceneResult",
    "SeenBy",
    "TaskEvaluation",
    "TrialEvaluation",
    "TrialPlan",
    "TriedGrasp",
    "animate_trials",
    "center_grasp_baseline",
    "compare_runs",
    "evaluate_detector",
    "evaluate_predictions",
    "evaluate_tasks",
    "file_predictions",
    "in_file_frame",
    "labelled_grasps",
    "make_gallery",
    "predict_scenes",
    "to_predictions",
    "try_grasps",
    "write_comparison",
    "write_report",
    "write_trials",
]

_HOME = {
    "AntipodalGrasp": "shape_baselines",
    "MomentsGrasp": "shape_baselines",
    "CenterGrasp": "baselines",
    "Comparison": "compare",
    "Evaluation": "results",
    "Exhibit": "report.gallery",
    "GraspDetector": "evaluate",
    "GraspsToTry": "grasps_to_try",
    "SceneResult": "results",
    "TaskEvaluation": "task_scores",
    "TrialEvaluation": "trial_results",
    "SeenBy": "seen_by",
    "TrialPlan": "trial_plan",
    "TriedGrasp": "trial_results",
    "animate_trials": "animations",
    "center_grasp_baseline": "baselines",
    "compare_runs": "compare",
    "evaluate_detector": "evaluate",
    "evaluate_predictions": "evaluate",
    "evaluate_tasks": "task_scores",
    "file_predictions": "grasps_to_try",
    "in_file_frame": "evaluate",
    "labelled_grasps": "grasps_to_try",
    "make_gallery": "report.gallery",
    "predict_scenes": "grasps_to_try",
    "to_predictions": "evaluate",
    "try_grasps": "trials",
    "write_comparison": "report.comparison_page",
    "write_report": "report.page",
    "write_trials": "trial_results",
}

__getattr__, __dir__ = lazy_names(__name__, _HOME)
