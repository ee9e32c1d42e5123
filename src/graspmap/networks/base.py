"""What every grasp network shares: input check, padding, heads, memory layout, initialisation.

Letters in shapes: B pictures, C input channels, H rows, W columns, F features, N orientation bins.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Collection, Sequence
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d, dropout, pad

from graspmap.errors import InvalidInputError
from graspmap.maps.grasp_maps import GraspMaps
from graspmap.networks.tasks import (
    AUXILIARY_TASKS,
    DECODING_TASKS,
    Outputs,
    TaskSpec,
    check_tasks,
    make_head,
)

MAP_NAMES = ("quality", "cos", "sin", "width")
"""Order of the maps in the heads' output channels; the order of `GraspMaps`."""

TASK_PARTS = ("task_heads.", "task_branches.")
"""What the names of the layers that serve only tasks begin with."""


class GraspHeads(nn.Module):
    """The four output layers as one convolution with 4 N output channels.

    One convolution reads the features once instead of four times. Output channels
    ``k * bins`` to ``(k + 1) * bins - 1`` belong to map k of `MAP_NAMES`.

    Args:
        features: F, channels of the last feature map.
        bins: N.
        kernel: Side of the square kernel; there is no padding.
        dropout: Share of the features that each map's layer drops in training, on its own.
    """

    def __init__(self, features: int, bins: int, kernel: int, dropout: float = 0.0) -> None:
        super().__init__()
        self.bins, self.dropout = bins, dropout
        self.layer = nn.Conv2d(features, len(MAP_NAMES) * bins, kernel)

    def forward(self, features: Tensor) -> Tensor:
        """(B, F, h, w) features to (B, 4 N, h - kernel + 1, w - kernel + 1) maps."""
        if self.training and self.dropout:
            bias: Tensor = self.layer.bias  # type: ignore[assignment]  # it has one
            parts = zip(self.layer.weight.chunk(4), bias.chunk(4), strict=True)
            return torch.cat([conv2d(dropout(features, self.dropout), w, b) for w, b in parts], 1)
        maps: Tensor = self.layer(features)
        return maps

    @torch.no_grad()
    def xavier(self, generator: torch.Generator | None) -> None:
        """Draw each map's weights as if it had a layer of its own (the fan-out differs)."""
        for part in self.layer.weight.chunk(len(MAP_NAMES)):
            # Random fills ignore strides only on a dense block of their own.
            fresh = torch.empty(part.shape, dtype=part.dtype, device=part.device)
            part.copy_(nn.init.xavier_uniform_(fresh, generator=generator))


class GraspNetwork(nn.Module):
    """Base of the networks that turn a picture into grasp maps in one pass.

    A network sets `name` (and `granularity`, ...), makes its layers in its constructor, which ends
    with ``self.add_heads(...)``, and implements `features`.

    Any H and W are taken: the picture is padded with zeros (the mean of a normalised picture, and
    what the convolutions themselves pad with) on the right and at the bottom to a multiple of
    `granularity`, and the maps are cut back. Pixel (x, y) of the maps belongs to pixel (x, y) of
    the picture.

    Weights and activations are kept in `memory_format`, by default with the channels last: the
    same numbers up to rounding, 1.2 to 2 times faster on a CPU (``python -m benchmarks --only
    layout``).

    Args:
        channels: C of the input: 1 depth, 3 colour, 4 depth and colour (depth first).
        bins: N orientation bins.
        tasks: What it learns beside grasping; each task gets a head.
        filters: Width of its layers, where they can be chosen; None for the published width.

    Attributes:
        name: Name in the registry.
        granularity: Input sides are padded to a multiple of this.
        smallest: Input sides are padded to at least this.
        published_size_px: Side of the input that it was published with.
        published_filters: The published width of its layers; None where it cannot be chosen.
        needs_task: Whether it is only defined with an auxiliary task.
        auxiliary_stride: Pixels of the input to a cell of the auxiliary tasks' feature maps.
        memory_format: Layout of weights and activations in memory.
        convolutions: How fresh weights of convolutions are drawn: ``xavier`` (uniform, gain 1) or
            ``pytorch`` (PyTorch's default).

    Raises:
        InvalidInputError: channels, bins or filters are below 1, the network has no filters to
            choose, a task does not fit, or the network needs one.
    """

    name: ClassVar[str]
    granularity: ClassVar[int] = 1
    smallest: ClassVar[int] = 1
    published_size_px: ClassVar[int] = 300
    published_filters: ClassVar[int | None] = None
    needs_task: ClassVar[bool] = False
    auxiliary_stride: ClassVar[int] = 1
    memory_format: torch.memory_format = torch.channels_last
    convolutions: ClassVar[Literal["xavier", "pytorch"]] = "xavier"
    heads: GraspHeads

    def __init__(
        self,
        channels: int,
        bins: int = 1,
        tasks: Sequence[TaskSpec] = (),
        filters: int | None = None,
    ) -> None:
        super().__init__()
        if filters is not None and self.published_filters is None:
            raise InvalidInputError(f"filters of {self.name}", repr(filters), "null: its are fixed")
        filters = self.published_filters if filters is None else filters
        counts = {"channels": channels, "bins": bins}
        for what, value in (counts if filters is None else counts | {"filters": filters}).items():
            if type(value) is not int or value < 1:  # True counts as an int elsewhere
                raise InvalidInputError(f"{what} of the network", repr(value), "an integer >= 1")
        self.channels, self.bins, self.filters = channels, bins, filters
        self.tasks = check_tasks(tasks, bins)
        if self.needs_task and not {task.name for task in tasks} & set(AUXILIARY_TASKS):
            raise InvalidInputError(
                f"tasks of {self.name}",
                ", ".join(task.name for task in tasks) or "none",
                f"at least one of {', '.join(AUXILIARY_TASKS)} (without any it is a ggcnn2)",
            )

    @abstractmethod
    def features(self, images: Tensor) -> Tensor:
        """The network up to its heads.

        Args:
            images: (B, C, H, W) in `memory_format`, sides multiples of `granularity`.

        Returns:
            (B, F, h, w) last feature map, from which the heads make H x W maps.
        """

    def branches(self, images: Tensor, names: Collection[str]) -> tuple[Tensor, dict[str, Tensor]]:
        """The feature map that the grasp heads sit on, and those of tasks.

        Args:
            images: As `features` takes them.
            names: Tasks that are asked for.

        Returns:
            (B, F, h, w) features, and those of each task by name; here the same for all.
        """
        last = self.features(images)
        return last, dict.fromkeys(names, last)

    def add_heads(self, features: int, kernel: int, *, dropout: float = 0.0) -> None:
        """Make the heads, and draw all weights; the last thing that a constructor does.

        Args:
            features: F of the last feature map.
            kernel: Side of the heads' kernels; h - kernel + 1 must be H.
            dropout: Share of the features that the grasp heads drop in training.
        """
        self.heads = GraspHeads(features, self.bins, kernel, dropout)
        self.task_heads = nn.ModuleDict()
        for task in self.tasks:
            stride = self.auxiliary_stride if task.name in AUXILIARY_TASKS else 1
            self.task_heads[task.name] = make_head(task, features, kernel, stride)
        self.reset_parameters()

    def forward(self, images: Tensor) -> GraspMaps[Tensor]:
        """Grasp maps of a batch of normalised pictures, ready for `graspmap.maps.find_grasps`.

        Auxiliary tasks are not computed; graspness and orientation are, see `Outputs.decoded`.

        Args:
            images: (B, C, H, W) floats.

        Returns:
            Maps of (B, N, H, W) each; the width map is in units of the data's width scale.

        Raises:
            InvalidInputError: The shape is not (B, C, H, W) with the network's channels, or
                empty.
        """
        names = [task.name for task in self.tasks if task.name in DECODING_TASKS]
        return self._run(images, names).decoded()

    def outputs(self, images: Tensor) -> Outputs:
        """The maps as the heads give them, and every task: what a loss compares.

        Args:
            images: (B, C, H, W) floats.

        Returns:
            Maps of (B, N, H, W) each, and the tasks' tensors, see `TaskSpec`.

        Raises:
            InvalidInputError: As `forward`.
        """
        return self._run(images, [task.name for task in self.tasks])

    def _run(self, images: Tensor, names: Collection[str]) -> Outputs:
        """The maps and the tasks of those names."""
        if images.ndim != 4 or images.shape[1] != self.channels or 0 in images.shape:
            raise InvalidInputError(
                f"shape of the input of {self.name}",
                tuple(images.shape),
                f"(B, {self.channels}, H, W), none of them 0",
            )
        shape = images.shape[2:]
        padded = [-(-max(s, self.smallest) // self.granularity) * self.granularity for s in shape]
        if padded != [*shape]:
            images = pad(images, (0, padded[1] - shape[1], 0, padded[0] - shape[0]))
        last, others = self.branches(_laid_out(images, self.memory_format), names)
        # Readers of the maps go through them row by row, so each must lie in one piece.
        maps = self.heads(last)[..., : shape[0], : shape[1]].contiguous()
        tasks = {name: self.task_heads[name](others[name], padded, shape) for name in names}
        return Outputs(GraspMaps(*maps.chunk(len(MAP_NAMES), dim=1)), tasks)

    def reset_parameters(self, generator: torch.Generator | None = None) -> None:
        """Draw fresh weights.

        Convolutions as `convolutions` says, everything else and all biases as PyTorch draws them.
        The trunk is drawn first, so that it does not depend on the tasks.

        Args:
            generator: Source of randomness (on the CPU); PyTorch's global one where None.
        """
        others = [m for name, m in self.named_modules() if name.startswith(TASK_PARTS)]
        xavier = self.convolutions == "xavier"
        for module in self.modules():
            if module not in others:
                _draw(module, xavier, generator)
        if xavier:
            self.heads.xavier(generator)
        for module in others:
            _draw(module, xavier, generator)
        self.to(memory_format=self.memory_format)  # type: ignore[call-overload]  # not in its stubs


def parameter_count(network: nn.Module) -> int:
    """Number of trainable and fixed parameters (buffers do not count)."""
    return sum(parameter.numel() for parameter in network.parameters())


def _draw(module: nn.Module, xavier: bool, generator: torch.Generator | None) -> None:
    """Fresh weights of one layer."""
    if isinstance(module, nn.BatchNorm2d):
        module.reset_parameters()  # draws nothing: ones and zeros
    if not isinstance(module, nn.Conv2d | nn.ConvTranspose2d | nn.Linear):
        return
    fresh = torch.empty(module.weight.shape)
    # PyTorch counts the second axis of the weights as inputs, also when transposed.
    bound = fresh[0].numel() ** -0.5
    if xavier and not isinstance(module, nn.Linear):
        nn.init.xavier_uniform_(fresh, generator=generator)
    else:
        nn.init.uniform_(fresh, -bound, bound, generator=generator)
    with torch.no_grad():
        module.weight.copy_(fresh)
    if module.bias is not None:
        nn.init.uniform_(module.bias, -bound, bound, generator=generator)


def _laid_out(images: Tensor, memory_format: torch.memory_format) -> Tensor:
    """The same pictures in another layout."""
    if images.shape[1] > 1 or memory_format != torch.channels_last:
        return images.contiguous(memory_format=memory_format)
    # With one channel both layouts are the same bytes and PyTorch would take it for channels
    # first (the first layer of GG-CNN2 then runs 2 to 4 times slower); strides of a permuted
    # view tell it what is meant.
    count, _, rows, columns = images.shape
    return images.reshape(count, rows, columns, 1).permute(0, 3, 1, 2)
