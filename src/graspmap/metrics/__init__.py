"""Pure numbers about grasps: rectangle success, its protocols, and intervals around a score."""

from graspmap.metrics.calibration import Calibration, ReliabilityBin, score_calibration
from graspmap.metrics.correlation import Correlation, correlate
from graspmap.metrics.intervals import bootstrap_interval, wilson_interval
from graspmap.metrics.paired import PairedComparison, compare_paired
from graspmap.metrics.protocols import PROTOCOLS, RectangleProtocol, find_protocol
from graspmap.metrics.rectangle import (
    MAX_ANGLE,
    THRESHOLDS,
    RectangleScore,
    best_overlap,
    score_rectangles,
)

__all__ = [
    "MAX_ANGLE",
    "PROTOCOLS",
    "THRESHOLDS",
    "Calibration",
    "Correlation",
    "PairedComparison",
    "RectangleProtocol",
    "RectangleScore",
    "ReliabilityBin",
    "best_overlap",
    "bootstrap_interval",
    "compare_paired",
    "correlate",
    "find_protocol",
    "score_calibration",
    "score_rectangles",
    "wilson_interval",
]
