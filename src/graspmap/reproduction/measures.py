"""What a table can report of a run: how it is read from the run's result, and how it is written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Need = Literal["test", "trials", "overlaps", "parts", "none"]


@dataclass(frozen=True)
class Measure:
    """One number of a run.

    Attributes:
        title: Head of its column.
        paths: Ways of keys that lead to it in a run's result; the first that is there counts.
        percent: Whether it is a share that is written in percent.
        digits: Decimals.
        need: What has to be done for it beyond training.
    """

    title: str
    paths: tuple[tuple[str, ...], ...]
    percent: bool = False
    digits: int = 2
    need: Need = "test"

    def get(self, result: Mapping[str, Any]) -> float | None:
        """Its value in the unit that tables show; None where the run does not have it."""
        for path in self.paths:
            value: Any = result
            for key in path:
                value = value.get(key) if isinstance(value, Mapping) else None
            if isinstance(value, int | float) and math.isfinite(value):
                return float(value) * (100 if self.percent else 1)
        return None

    def text(self, value: float) -> str:
        """A value as tables write it."""
        return f"{value:,.{self.digits}f}" if self.digits else f"{value:,.0f}"


def _success(threshold: str) -> tuple[tuple[str, ...], ...]:
    return (("parts", "success", threshold), ("test", "success", threshold))


MEASURES: dict[str, Measure] = {
    "success": Measure("Grasps IoU 25 %", _success("0.25"), percent=True),
    "success_30": Measure("IoU 30 %", _success("0.30"), percent=True),
    "success_50": Measure("IoU 50 %", _success("0.50"), percent=True),
    "success_75": Measure("IoU 75 %", _success("0.75"), percent=True),
    "miou": Measure("mIoU", (("parts", "miou"), ("test", "miou")), percent=True),
    "auc": Measure("AUC", (("test", "auc"),), digits=3),
    "mae": Measure("MAE", (("test", "saliency_mae"), ("test", "depth_mae")), digits=4),
    "accuracy": Measure("Classes", (("test", "category_accuracy"),), percent=True),
    "majority": Measure("Majority", (("test", "category_majority", "test_share"),), percent=True),
    "sgt": Measure(
        "SGT", (("parts", "trials"), ("trials", "success")), percent=True, need="trials"
    ),
    "validation": Measure(
        "Validation IoU 25 %", (("validation", "success", "0.25"),), percent=True
    ),
    "parameters": Measure("Parameters", (("parameters",),), digits=0, need="none"),
    "network_ms": Measure("Network, ms", (("network_ms",),), digits=1, need="none"),
    "grasp_ms": Measure("Picture to grasp, ms", (("grasp_ms",),), digits=1, need="none"),
}
"""The measures by name."""
