"""How the losses of several tasks become the one number that is minimised.

References:
    Thesis, Eq. 3.10 and 3.17 (sum), 3.11 (fixed), 3.12 (learned; garbled). Kendall, Gal, Cipolla:
    Multi-task learning using uncertainty to weigh losses for scene geometry and semantics,
    CVPR 2018.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from graspmap.errors import InvalidInputError, UnknownNameError

WeightingKind = Literal["sum", "fixed", "uncertainty"]
"""See `SumWeighting`, `FixedWeighting`, `UncertaintyWeighting`."""

GRASP = "grasp"
"""Name of the grasp loss among the losses of the tasks; it comes first."""


class SumWeighting(nn.Module):
    """The plain sum of all losses."""

    def forward(self, losses: Mapping[str, Tensor]) -> Tensor:
        """The scalar to minimise, from the scalar loss of each task."""
        return torch.stack(list(losses.values())).sum()


class FixedWeighting(nn.Module):
    """share * grasp + (1 - share) * (sum of the other tasks).

    Args:
        share: Share of the grasp loss, 0 to 1: lambda in Eq. 3.11.

    Raises:
        InvalidInputError: It is outside.
    """

    def __init__(self, share: float = 0.5) -> None:
        super().__init__()
        if not 0 <= share <= 1:
            raise InvalidInputError("grasp_share", share, "0 to 1")
        self.share = float(share)

    def forward(self, losses: Mapping[str, Tensor]) -> Tensor:
        """The scalar to minimise, from the scalar loss of each task."""
        others = [loss for name, loss in losses.items() if name != GRASP]
        total = self.share * losses[GRASP]
        return total + (1 - self.share) * torch.stack(others).sum() if others else total

    def extra_repr(self) -> str:
        """The share, for printing."""
        return f"share={self.share}"


class UncertaintyWeighting(nn.Module):
    """Sum of exp(-s_i) l_i + s_i, each s_i learned beside the network from 0.

    s_i is the logarithm of the variance sigma_i^2 that task i is thought to have: at the minimum
    over s_i it is log l_i, so that each task weighs as much as the others, whatever its unit.

    Args:
        names: The tasks, `GRASP` among them, in the order of `log_variances`.

    Attributes:
        log_variances: (tasks,) the s_i.

    Raises:
        InvalidInputError: There is no task, or one is named twice.
    """

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        if not names or len(set(names)) < len(names):
            raise InvalidInputError("tasks to weigh", list(names), "one or more, each once")
        self.names = tuple(names)
        self.log_variances = nn.Parameter(torch.zeros(len(names)))

    def forward(self, losses: Mapping[str, Tensor]) -> Tensor:
        """The scalar to minimise, from the scalar loss of each task."""
        values = torch.stack([losses[name] for name in self.names])
        s = self.log_variances.to(values.dtype)
        return ((-s).exp() * values + s).sum()

    def extra_repr(self) -> str:
        """The tasks, for printing."""
        return f"names={self.names!r}"


def make_weighting(kind: WeightingKind, tasks: Sequence[str], share: float = 0.5) -> nn.Module:
    """A weighting of the grasp loss and the losses of some tasks.

    Args:
        kind: Its name.
        tasks: The tasks beside grasping, in order.
        share: Share of the grasp loss, for ``fixed``.

    Raises:
        UnknownNameError: There is no such weighting.
        InvalidInputError: The share is outside 0 to 1, or a task is named twice.
    """
    if kind not in get_args(WeightingKind):
        raise UnknownNameError("weighting", str(kind), get_args(WeightingKind))
    if kind == "sum":
        return SumWeighting()
    return FixedWeighting(share) if kind == "fixed" else UncertaintyWeighting((GRASP, *tasks))
