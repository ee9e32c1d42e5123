"""The networks by name: a new network is one file, and one line here."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from graspmap.errors import UnknownNameError
from graspmap.networks.base import GraspNetwork
from graspmap.networks.ggcnn import GGCNN, GGCNN2, GGCNN2Bilinear
from graspmap.networks.grconvnet import GRConvNet, GRConvNet2, GRConvNet3, GRConvNet4
from graspmap.networks.mtgcnn import MTGCNNa, MTGCNNb, MTGCNNc, MTGCNNd
from graspmap.networks.tasks import TaskSpec
from graspmap.networks.unet import UNet

NETWORKS: dict[str, type[GraspNetwork]] = {
    network.name: network
    for network in (
        GGCNN,
        GGCNN2,
        GGCNN2Bilinear,
        GRConvNet,
        GRConvNet2,
        GRConvNet3,
        GRConvNet4,
        UNet,
        MTGCNNa,
        MTGCNNb,
        MTGCNNc,
        MTGCNNd,
    )
}
"""Network classes by name; each is called with (channels, bins, tasks, filters)."""


def make_network(
    name: str,
    channels: int,
    bins: int = 1,
    *,
    tasks: Sequence[TaskSpec] = (),
    filters: int | None = None,
    generator: torch.Generator | None = None,
) -> GraspNetwork:
    """A fresh network with random weights.

    Args:
        name: One of `NETWORKS`.
        channels: Input channels: 1 depth, 3 colour, 4 depth and colour.
        bins: Orientation bins.
        tasks: What it learns beside grasping; each task gets a head.
        filters: Width of its layers, where they can be chosen; None for the published width.
        generator: Source of the weights, on the CPU; PyTorch's global one where None.

    Returns:
        The network, in training mode, float32, on the CPU.

    Raises:
        UnknownNameError: There is no network of that name.
        InvalidInputError: channels, bins or filters are below 1, the network has no filters to
            choose, a task does not fit, or the network needs one.
    """
    if name not in NETWORKS:
        raise UnknownNameError("network", name, NETWORKS)
    network = NETWORKS[name](channels, bins, tasks, filters)
    if generator is not None:
        network.reset_parameters(generator)
    return network
