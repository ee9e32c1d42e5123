"""Pure numbers about grasps: rectangle success, its protocols, and intervals around a score."""

from graspmap.metrics.calibration import Calibration, ReliabilityBin, score_calibration
from graspmap.metrics.confusion import ClassScore, score_classes
from graspmap.metrics.correlation import Correlation, correlate
from graspmap.metrics.depth_error import DepthErrors, DepthScore, depth_errors, score_depth
from graspmap.metrics.intervals import bootstrap_interval, wilson_interval
from graspmap.metrics.paired import PairedComparison, compare_paired
from graspmap.metrics.protocols import PROTOCOLS, QUIRKS, RectangleProtocol, find_protocol
from graspmap.metrics.quality_map import QualityMap, cross_fitted, fit_quality_map
from graspmap.metrics.rectangle import (
    ANGLES_DEG,
    MAX_ANGLE,
    THRESHOLDS,
    RectangleScore,
    best_overlap,
    score_rectangles,
)
from graspmap.metrics.saliency import SaliencyMarks, SaliencyScore, saliency_marks, score_saliency

__all__ = [
    "ANGLES_DEG",
    "MAX_ANGLE",
    "PROTOCOLS",
    "QUIRKS",
    "THRESHOLDS",
    "Calibration",
    "ClassScore",
    "Correlation",
    "DepthErrors",
    "DepthScore",
    "PairedComparison",
    "QualityMap",
    "RectangleProtocol",
    "RectangleScore",
    "ReliabilityBin",
    "SaliencyMarks",
    "SaliencyScore",
    "best_overlap",
    "bootstrap_interval",
    "compare_paired",
    "correlate",
    "cross_fitted",
    "depth_errors",
    "find_protocol",
    "fit_quality_map",
    "saliency_marks",
    "score_calibration",
    "score_classes",
    "score_depth",
    "score_rectangles",
    "score_saliency",
    "wilson_interval",
]
