"""The one loss of a training run: grasp maps and any tasks beside them, weighed into one number.

Letters in shapes: B pictures, N orientation bins, H rows, W columns.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from torch import Tensor, nn

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.losses.auxiliary import (
    BinLoss,
    CategoryLoss,
    DepthKind,
    DepthLoss,
    SaliencyKind,
    SaliencyLoss,
)
from graspmap.losses.grasp import GraspLoss, GraspLossTerms
from graspmap.losses.weighting import GRASP, SumWeighting
from graspmap.maps.grasp_maps import GraspMaps


@dataclass(frozen=True, eq=False)
class Targets:
    """The truth of a batch; of a task that is not learned it may be left out.

    Args:
        maps: (B, N, H, W) drawn grasp maps.
        mask: (B, 1, H, W) bool, True on the object.
        inside: (B, 1, H, W) bool where the input shows the picture and not the border that is
            repeated beside it; None for everywhere.
        depth: (B, 1, H, W) depth as the network's depth input has it.
        depth_known: (B, 1, H, W) bool where it was measured; None for everywhere.
        classes: (B,) class of each picture, `graspmap.losses.auxiliary.UNKNOWN` where there is
            none.
    """

    maps: GraspMaps[Tensor]
    mask: Tensor | None = None
    inside: Tensor | None = None
    depth: Tensor | None = None
    depth_known: Tensor | None = None
    classes: Tensor | None = None


_TRUTH: dict[str, Callable[[Targets], tuple[Tensor | None, ...]]] = {
    "category": lambda t: (t.classes,),
    "saliency": lambda t: (t.mask, t.inside),
    "depth": lambda t: (t.depth, t.depth_known),
    "graspness": lambda t: (t.maps.quality,),
    "orientation": lambda t: (t.maps.quality,),
}
"""What of the truth each task's loss takes, after what the network says."""

TASK_LOSSES = tuple(_TRUTH)
"""The tasks that have a loss."""


class MultiTaskTerms(NamedTuple):
    """The loss and its parts, scalars.

    Attributes:
        total: What is minimised.
        grasp: The grasp loss and its parts.
        tasks: Loss of each task, not weighed.
    """

    total: Tensor
    grasp: GraspLossTerms
    tasks: dict[str, Tensor]


class MultiTaskLoss(nn.Module):
    """Grasp loss and the losses of the tasks, weighed.

    Without tasks and with `SumWeighting` its total is that of the grasp loss, to the bit.

    Args:
        grasp: Loss of the grasp maps.
        tasks: Loss of each task by its name, see `make_task_loss`.
        weighting: Makes them one number.

    Raises:
        UnknownNameError: There is no such task.
    """

    def __init__(
        self,
        grasp: GraspLoss | None = None,
        tasks: Mapping[str, nn.Module] | None = None,
        weighting: nn.Module | None = None,
    ) -> None:
        super().__init__()
        for name in tasks or ():
            _check_task(name)
        self.grasp = grasp or GraspLoss()
        self.tasks = nn.ModuleDict(dict(tasks or {}))
        self.weighting = weighting or SumWeighting()

    def forward(
        self, maps: GraspMaps[Tensor], said: Mapping[str, Tensor], targets: Targets
    ) -> MultiTaskTerms:
        """The loss of a batch.

        Args:
            maps: (B, N, H, W) maps of a network.
            said: Tensor of each task, as the network gives it.
            targets: The truth.

        Raises:
            InvalidInputError: Shapes differ, or what the network says on a task, or its truth, is
                missing.
        """
        grasp, tasks = self.parts(maps, said, targets)
        return MultiTaskTerms(self.weigh(grasp, tasks), grasp, tasks)

    def parts(
        self,
        maps: GraspMaps[Tensor],
        said: Mapping[str, Tensor],
        targets: Targets,
        names: Collection[str] | None = None,
    ) -> tuple[GraspLossTerms, dict[str, Tensor]]:
        """The grasp loss, and the loss of each task, not weighed.

        Args:
            maps: As for `forward`.
            said: As for `forward`.
            targets: As for `forward`.
            names: The tasks whose truth is known; None for all.

        Raises:
            InvalidInputError: As from `forward`.
        """
        losses = {}
        for name, loss in self.tasks.items():
            if names is not None and name not in names:
                continue
            truth, *known = _TRUTH[name](targets)
            for what, value in (("output", said.get(name)), ("target", truth)):
                if value is None:
                    raise InvalidInputError(f"{what} of the task {name}", "missing", "a tensor")
            losses[name] = loss(said[name], truth, *known)
        return self.grasp(maps, targets.maps), losses

    def weigh(self, grasp: GraspLossTerms, tasks: Mapping[str, Tensor]) -> Tensor:
        """What is minimised, from what `parts` gives for all tasks; a scalar."""
        total: Tensor = self.weighting({GRASP: grasp.total, **tasks})
        return total


def make_task_loss(
    name: str, *, saliency: SaliencyKind = "bce", depth: DepthKind = "mse"
) -> nn.Module:
    """The loss of a task.

    Args:
        name: One of `TASK_LOSSES`.
        saliency: Kind of the loss of saliency.
        depth: Kind of the loss of depth.

    Raises:
        UnknownNameError: There is no such task or kind.
    """
    _check_task(name)
    if name == "saliency":
        return SaliencyLoss(saliency)
    if name == "depth":
        return DepthLoss(depth)
    return CategoryLoss() if name == "category" else BinLoss(any_bin=name == "graspness")


def _check_task(name: str) -> None:
    if name not in TASK_LOSSES:
        raise UnknownNameError("task", name, TASK_LOSSES)
