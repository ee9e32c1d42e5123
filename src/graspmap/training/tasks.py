"""What an experiment's tasks mean for its network, its loss and its metrics."""

from __future__ import annotations

import logging

import torch

from graspmap.data import channel_count
from graspmap.errors import ConfigError
from graspmap.losses import GRASP, GraspLoss, MultiTaskLoss, make_task_loss, make_weighting
from graspmap.networks import GraspNetwork, TaskSpec, make_network
from graspmap.training.apart import check_parts
from graspmap.training.experiment import Experiment

METRICS = {
    "category": "category_accuracy",
    "saliency": "saliency_mae",
    "depth": "depth_mae",
}
"""Measured on validation and test, by task: share of right classes; mean absolute error of the
probability; mean absolute error of the depth, in metres (after subtracting the picture's mean)."""

_TASKS = ("category", "saliency", "depth", "graspness", "orientation")
_GRASP_LOSSES = ("loss", "quality", "cos", "sin", "width")

_logger = logging.getLogger(__name__)


def loss_names(experiment: Experiment | None = None) -> tuple[str, ...]:
    """The losses that are logged: what is minimised, the grasp terms, then each task's own.

    Args:
        experiment: Whose; None for all that there can be.
    """
    return _GRASP_LOSSES + (_TASKS if experiment is None else experiment.tasks.names)


def metric_names(experiment: Experiment | None = None) -> tuple[str, ...]:
    """The metrics of tasks that are logged, and the s_i of an uncertainty weighting.

    Args:
        experiment: Whose; None for all that there can be.
    """
    tasks = _TASKS if experiment is None else experiment.tasks.names
    metrics = tuple(METRICS[name] for name in tasks if name in METRICS)
    if experiment is not None and experiment.loss.weighting != "uncertainty":
        return metrics
    return metrics + tuple(f"uncertainty_{name}" for name in (GRASP, *tasks))


def make_experiment_network(
    experiment: Experiment, classes: int = 2, *, generator: torch.Generator | None = None
) -> GraspNetwork:
    """The network of an experiment with fresh weights.

    Args:
        experiment: Name, channels, bins, filters and tasks.
        classes: Number of classes of the category task, which the data decide.
        generator: Source of the weights.

    Raises:
        UnknownNameError: There is no such network.
        InvalidInputError: It has no such filters or tasks.
    """
    values, size = experiment.network, experiment.data.size
    outputs = {"category": classes, "orientation": values.bins}
    tasks = [
        TaskSpec(name, outputs.get(name, 1), size if name == "category" else 0)
        for name in experiment.tasks.names
    ]
    return make_network(
        values.name,
        channel_count(values.channels),
        values.bins,
        tasks=tasks,
        filters=values.filters,
        generator=generator,
    )


def make_loss(experiment: Experiment) -> MultiTaskLoss:
    """The loss of an experiment."""
    values, tasks = experiment.loss, experiment.tasks
    kinds = {
        "saliency": tasks.saliency.loss if tasks.saliency else "bce",
        "depth": tasks.depth.loss if tasks.depth else "mse",
    }
    return MultiTaskLoss(
        GraspLoss(values.base, values.positional, width_expectile=values.width_expectile),
        {name: make_task_loss(name, **kinds) for name in tasks.names},  # type: ignore[arg-type]
        make_weighting(values.weighting, tasks.names, values.grasp_share),
    )


def check_experiment(experiment: Experiment) -> None:
    """See that an experiment does not contradict itself, before any data are read.

    Raises:
        ConfigError: It does; the error names the key.
        UnknownNameError: There is no such network.
        InvalidInputError: The network has no such filters, or needs a task.
    """
    loss, tasks = experiment.loss, experiment.tasks
    check_parts(experiment)

    def wrong(key: str, problem: str, remedy: str) -> ConfigError:
        return ConfigError(f"experiment {experiment.name}", key, problem, remedy)

    if loss.weighting != "sum" and not tasks.names:
        raise wrong(
            "loss.weighting",
            f"is {loss.weighting!r}, but there is no task to weigh the grasps against",
            "set one of tasks, or take loss.weighting sum",
        )
    if loss.weighting != "fixed" and loss.grasp_share != type(loss)().grasp_share:
        raise wrong(
            "loss.grasp_share",
            f"is {loss.grasp_share:g}, but loss.weighting is {loss.weighting!r}",
            "take loss.weighting fixed, or leave the share out",
        )
    if tasks.orientation is not None and experiment.network.bins == 1:
        raise wrong(
            "tasks.orientation",
            "is a choice between bins, but network.bins is 1",
            "set network.bins to 2 or more, or take tasks.graspness",
        )
    if tasks.depth is not None and experiment.network.channels == "depth":
        _logger.warning(
            "tasks.depth: the network is to say the depth that is all it is shown; "
            "set network.channels to rgb to learn it from colour"
        )
    with torch.device("meta"):  # shapes without numbers
        make_experiment_network(experiment)
