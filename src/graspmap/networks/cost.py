"""What a network costs: its layers with their sizes, parameters and multiply-adds.

Letters in shapes: H rows, W columns.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from graspmap.networks.base import GraspNetwork


@dataclass(frozen=True)
class Layer:
    """A layer with weights, as a picture passes it.

    Args:
        name: Its name in the state dict.
        kind: ``conv``, ``transposed`` or ``linear``.
        inputs: Channels that come in.
        outputs: Channels that go out.
        kernel: Side of the kernel; 1 for ``linear``.
        stride: Stride.
        dilation: Dilation.
        shape: (H, W) that goes out; (1, 1) for ``linear``.
        parameters: Its weights and biases, without a batch norm's.
        multiply_adds: Multiplications, each with its addition, for one picture.
    """

    name: str
    kind: Literal["conv", "transposed", "linear"]
    inputs: int
    outputs: int
    kernel: int
    stride: int
    dilation: int
    shape: tuple[int, int]
    parameters: int
    multiply_adds: int


def trace_layers(
    network: GraspNetwork, rows: int, columns: int, *, tasks: bool = False
) -> tuple[Layer, ...]:
    """The layers that a picture passes, in order; nothing is computed.

    Args:
        network: The network.
        rows: Rows of the picture.
        columns: Columns of the picture.
        tasks: Whether every task is asked for, as in training, and not only grasps.

    Returns:
        Convolutions and linear layers. Batch norm, ReLU, pooling and enlargement are left out:
        they cost little, and nothing where they are merged into a convolution.
    """
    outline = copy.deepcopy(network).to("meta").eval()  # shapes without numbers
    found: list[Layer] = []

    def note(name: str, module: nn.Module, inputs: tuple[Tensor], output: Tensor) -> None:
        found.append(_layer(name, module, inputs[0], output))

    for name, module in outline.named_modules():
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
            module.register_forward_hook(lambda *args, name=name: note(name, *args))
    picture = torch.empty(1, network.channels, rows, columns, device="meta")
    with torch.no_grad():
        outline.outputs(picture) if tasks else outline(picture)
    return tuple(found)


def multiply_adds(network: GraspNetwork, rows: int, columns: int, *, tasks: bool = False) -> int:
    """Multiply-adds of one picture through a network, arguments as in `trace_layers`."""
    return sum(layer.multiply_adds for layer in trace_layers(network, rows, columns, tasks=tasks))


def _layer(name: str, module: Any, x: Tensor, output: Tensor) -> Layer:
    parameters = sum(p.numel() for p in module.parameters())
    weights = module.weight.numel()
    if isinstance(module, nn.Linear):
        sizes = (module.in_features, module.out_features)
        return Layer(name, "linear", *sizes, 1, 1, 1, (1, 1), parameters, weights)
    transposed = isinstance(module, nn.ConvTranspose2d)
    # Each weight meets each cell once: of what goes out, or of what a transposed layer spreads.
    rows, columns = (x if transposed else output).shape[2:]
    return Layer(
        name,
        "transposed" if transposed else "conv",
        module.in_channels,
        module.out_channels,
        module.kernel_size[0],
        module.stride[0],
        module.dilation[0],
        (output.shape[2], output.shape[3]),
        parameters,
        weights * rows * columns,
    )
