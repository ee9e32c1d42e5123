"""What every grasp network shares: input check, padding, heads, memory layout, initialisation.

Letters in shapes: B pictures, C input channels, H rows, W columns, F features, N orientation bins.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import torch
from torch import Tensor, nn

from graspmap.errors import InvalidInputError
from graspmap.maps.grasp_maps import GraspMaps

MAP_NAMES = ("quality", "cos", "sin", "width")
"""Order of the maps in the heads' output channels; the order of `GraspMaps`."""


class GraspHeads(nn.Module):
    """The four output layers as one convolution with 4 N output channels.

    One convolution reads the features once instead of four times. Output channels
    ``k * bins`` to ``(k + 1) * bins - 1`` belong to map k of `MAP_NAMES`.

    Args:
        features: F, channels of the last feature map.
        bins: N.
        kernel: Side of the square kernel; there is no padding.
    """

    def __init__(self, features: int, bins: int, kernel: int) -> None:
        super().__init__()
        self.bins = bins
        self.layer = nn.Conv2d(features, len(MAP_NAMES) * bins, kernel)

    def forward(self, features: Tensor) -> Tensor:
        """(B, F, h, w) features to (B, 4 N, h - kernel + 1, w - kernel + 1) maps."""
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

    A network implements `raw_maps` and sets `name` and `granularity`; its constructor ends
    with ``self.reset_parameters()``.

    Any H and W are taken: the picture is padded with zeros (the mean of a normalised picture, and
    what the convolutions themselves pad with) on the right and at the bottom to a multiple of
    `granularity`, and the maps are cut back. Pixel (x, y) of the maps belongs to pixel (x, y) of
    the picture.

    Weights and activations are kept in channels-last memory layout: the same numbers up to
    rounding, about 1.5 to 3 times faster on a CPU.

    Args:
        channels: C of the input: 1 depth, 3 colour, 4 depth and colour (depth first).
        bins: N orientation bins.

    Attributes:
        name: Name in the registry.
        granularity: Input sides are padded to a multiple of this.

    Raises:
        InvalidInputError: channels or bins are below 1.
    """

    name: ClassVar[str]
    granularity: ClassVar[int] = 1
    heads: GraspHeads

    def __init__(self, channels: int, bins: int = 1) -> None:
        super().__init__()
        for what, value in (("channels", channels), ("bins", bins)):
            if type(value) is not int or value < 1:  # True counts as an int elsewhere
                raise InvalidInputError(f"{what} of the network", repr(value), "an integer >= 1")
        self.channels, self.bins = channels, bins

    @abstractmethod
    def raw_maps(self, images: Tensor) -> Tensor:
        """The network itself.

        Args:
            images: (B, C, H, W), channels last in memory, sides multiples of `granularity`.

        Returns:
            (B, 4 N, H, W) maps in the order of `MAP_NAMES`, as `GraspHeads` gives them.
        """

    def forward(self, images: Tensor) -> GraspMaps[Tensor]:
        """Grasp maps of a batch of normalised pictures.

        Args:
            images: (B, C, H, W) floats.

        Returns:
            Maps of (B, N, H, W) each; the width map is in units of the data's width scale.

        Raises:
            InvalidInputError: The shape is not (B, C, H, W) with the network's channels, or
                empty.
        """
        if images.ndim != 4 or images.shape[1] != self.channels or 0 in images.shape:
            raise InvalidInputError(
                f"shape of the input of {self.name}",
                tuple(images.shape),
                f"(B, {self.channels}, H, W), none of them 0",
            )
        rows, columns = images.shape[2:]
        below, right = -rows % self.granularity, -columns % self.granularity
        if below or right:
            images = nn.functional.pad(images, (0, right, 0, below))
        maps = self.raw_maps(_channels_last(images))
        # Readers of the maps go through them row by row, so each must lie in one piece.
        maps = maps[..., :rows, :columns].contiguous()
        return GraspMaps(*maps.chunk(len(MAP_NAMES), dim=1))

    def reset_parameters(self, generator: torch.Generator | None = None) -> None:
        """Draw fresh weights: Xavier-uniform with gain 1; biases as PyTorch draws them.

        Args:
            generator: Source of randomness (on the CPU); PyTorch's global one where None.
        """
        for module in self.modules():
            if not isinstance(module, nn.Conv2d | nn.ConvTranspose2d):
                continue
            fresh = torch.empty(module.weight.shape)
            nn.init.xavier_uniform_(fresh, generator=generator)
            with torch.no_grad():
                module.weight.copy_(fresh)
            if module.bias is not None:
                # PyTorch counts the second axis of the weights as inputs, also when transposed.
                bound = fresh[0].numel() ** -0.5
                nn.init.uniform_(module.bias, -bound, bound, generator=generator)
        self.heads.xavier(generator)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # not in its stubs


def parameter_count(network: nn.Module) -> int:
    """Number of trainable and fixed parameters (buffers do not count)."""
    return sum(parameter.numel() for parameter in network.parameters())


def _channels_last(images: Tensor) -> Tensor:
    """The same pictures with the channels last in memory."""
    if images.shape[1] > 1:
        return images.contiguous(memory_format=torch.channels_last)
    # With one channel both layouts are the same bytes and PyTorch would take it for channels
    # first (the first layer of GG-CNN2 then runs 2 to 4 times slower); strides of a permuted
    # view tell it what is meant.
    count, _, rows, columns = images.shape
    return images.reshape(count, rows, columns, 1).permute(0, 3, 1, 2)
