"""How well a network does the tasks beside grasping, counted over many pictures.

Letters in shapes: B pictures, K classes, H rows, W columns.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from graspmap.losses import UNKNOWN, Targets
from graspmap.training.tasks import METRICS


class TaskScores:
    """Means over pictures of the metrics of some tasks, see `METRICS`.

    A picture counts where its truth is known; a mean absolute error is first taken over a
    picture's known pixels.

    Args:
        tasks: Names; those without a metric are left out.
        device: Where the sums are kept.
        depth_unit_m: Metres that 1 of the depth task stands for.
    """

    def __init__(
        self,
        tasks: Sequence[str],
        device: torch.device | str = "cpu",
        *,
        depth_unit_m: float = 1.0,
    ) -> None:
        self._unit = {"depth": depth_unit_m}
        self._tasks = tuple(name for name in tasks if name in METRICS)
        self._sums = torch.zeros(len(self._tasks), 2, dtype=torch.float64, device=device)

    def add(self, said: Mapping[str, Tensor], truth: Targets) -> None:
        """Count a batch.

        Args:
            said: What the network gives for each task.
            truth: The truth of these tasks.
        """
        for row, task in zip(self._sums, self._tasks, strict=True):
            row += torch.stack(_measure(task, said[task].detach(), truth))

    def means(self) -> dict[str, float]:
        """Metrics by name; NaN where no picture counted."""
        return {
            METRICS[task]: self._unit.get(task, 1.0) * total / count if count else math.nan
            for task, (total, count) in zip(self._tasks, self._sums.tolist(), strict=True)
        }


def _measure(task: str, said: Tensor, truth: Targets) -> tuple[Tensor, Tensor]:
    """Sum over the pictures that count, and their number; float64."""
    if task == "category":
        assert truth.classes is not None
        known = truth.classes != UNKNOWN
        right = (said.argmax(1) == truth.classes) & known
        return right.sum().double(), known.sum().double()
    if task == "saliency":
        assert truth.mask is not None
        error, where = (said.sigmoid() - truth.mask.to(said.dtype)).abs(), truth.inside
    else:
        assert truth.depth is not None
        error, where = (said - truth.depth).abs(), truth.depth_known
    weight = torch.ones_like(error) if where is None else where.to(error.dtype)
    pixels = weight.flatten(1).sum(1)
    means = (error * weight).flatten(1).sum(1) / pixels.clamp_min(1)
    return means.double().sum(), (pixels > 0).sum().double()
