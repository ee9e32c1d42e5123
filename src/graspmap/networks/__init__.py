"""Grasp networks: a normalised picture in, `GraspMaps` out, in one pass."""

from graspmap.networks.base import MAP_NAMES, GraspHeads, GraspNetwork, parameter_count
from graspmap.networks.cost import Layer, multiply_adds, trace_layers
from graspmap.networks.ggcnn import GGCNN, GGCNN2, GGCNN2Bilinear
from graspmap.networks.registry import NETWORKS, make_network
from graspmap.networks.tasks import (
    AUXILIARY_TASKS,
    DECODING_TASKS,
    TASK_NAMES,
    Outputs,
    TaskSpec,
)

__all__ = [
    "AUXILIARY_TASKS",
    "DECODING_TASKS",
    "GGCNN",
    "GGCNN2",
    "MAP_NAMES",
    "NETWORKS",
    "TASK_NAMES",
    "GGCNN2Bilinear",
    "GraspHeads",
    "GraspNetwork",
    "Layer",
    "Outputs",
    "TaskSpec",
    "make_network",
    "multiply_adds",
    "parameter_count",
    "trace_layers",
]
