"""Grasp networks: a normalised picture in, `GraspMaps` out, in one pass."""

from graspmap.networks.base import MAP_NAMES, GraspHeads, GraspNetwork, parameter_count
from graspmap.networks.ggcnn import GGCNN, GGCNN2, GGCNN2Bilinear
from graspmap.networks.registry import NETWORKS, make_network

__all__ = [
    "GGCNN",
    "GGCNN2",
    "MAP_NAMES",
    "NETWORKS",
    "GGCNN2Bilinear",
    "GraspHeads",
    "GraspNetwork",
    "make_network",
    "parameter_count",
]
