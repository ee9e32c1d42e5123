"""Pure numbers about grasps: rectangle success, its protocols, and intervals around a score."""

from graspmap.metrics.intervals import bootstrap_interval, wilson_interval
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
    "RectangleProtocol",
    "RectangleScore",
    "best_overlap",
    "bootstrap_interval",
    "find_protocol",
    "score_rectangles",
    "wilson_interval",
]
