"""Inference: weights files with their cards, and the detector that uses them."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from graspmap.inference.importing import import_weights
from graspmap.inference.measured import (
    CalibrationCard,
    EvaluationCard,
    QualityCard,
    TrialsCard,
)
from graspmap.inference.shipped import best_shipped, default_weights, shipped_weights, weights_path
from graspmap.inference.weights import (
    DataCard,
    WeightsCard,
    load_weights,
    read_card,
    save_weights,
    weights_hash,
)

if TYPE_CHECKING:
    from graspmap.inference.detector import Detection, Detector

__all__ = [
    "CalibrationCard",
    "DataCard",
    "Detection",
    "Detector",
    "EvaluationCard",
    "QualityCard",
    "TrialsCard",
    "WeightsCard",
    "best_shipped",
    "default_weights",
    "import_weights",
    "load_weights",
    "read_card",
    "save_weights",
    "shipped_weights",
    "weights_hash",
    "weights_path",
]


def __getattr__(name: str) -> Any:
    """`Detector` and `Detection` load at use: whoever only writes weights needs no decoding."""
    if name not in ("Detection", "Detector"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("graspmap.inference.detector"), name)
