"""Losses between what a network says (grasp maps, auxiliary tasks) and the truth."""

from graspmap.losses.auxiliary import (
    UNKNOWN,
    BinLoss,
    CategoryLoss,
    DepthKind,
    DepthLoss,
    SaliencyKind,
    SaliencyLoss,
    cel,
)
from graspmap.losses.grasp import Base, GraspLoss, GraspLossTerms, Positional
from graspmap.losses.multitask import (
    TASK_LOSSES,
    MultiTaskLoss,
    MultiTaskTerms,
    Targets,
    make_task_loss,
)
from graspmap.losses.weighting import (
    GRASP,
    FixedWeighting,
    SumWeighting,
    UncertaintyWeighting,
    WeightingKind,
    make_weighting,
)

__all__ = [
    "GRASP",
    "TASK_LOSSES",
    "UNKNOWN",
    "Base",
    "BinLoss",
    "CategoryLoss",
    "DepthKind",
    "DepthLoss",
    "FixedWeighting",
    "GraspLoss",
    "GraspLossTerms",
    "MultiTaskLoss",
    "MultiTaskTerms",
    "Positional",
    "SaliencyKind",
    "SaliencyLoss",
    "SumWeighting",
    "Targets",
    "UncertaintyWeighting",
    "WeightingKind",
    "cel",
    "make_task_loss",
    "make_weighting",
]
