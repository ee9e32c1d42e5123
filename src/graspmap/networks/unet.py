"""U-Net: a deep network with a connection across at each size.

References:
    Ronneberger, Fischer and Brox, "U-Net: Convolutional Networks for Biomedical Image
    Segmentation", MICCAI 2015; with batch norm and padded convolutions, as the thesis uses it in
    chapter 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import max_pool2d, pad

from graspmap.networks.base import GraspNetwork
from graspmap.networks.tasks import TaskSpec


class Double(nn.Module):
    """Twice a 3 x 3 convolution, batch norm and ReLU.

    Args:
        inputs: Channels that come in.
        outputs: Channels that go out, and between the two.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.layer1 = nn.Conv2d(inputs, outputs, 3, padding=1)
        self.norm1 = nn.BatchNorm2d(outputs)
        self.layer2 = nn.Conv2d(outputs, outputs, 3, padding=1)
        self.norm2 = nn.BatchNorm2d(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, h, w) to (B, outputs, h, w)."""
        x = self.norm1(self.layer1(x)).relu_()
        last: Tensor = self.norm2(self.layer2(x)).relu_()
        return last


class Up(nn.Module):
    """Twice the size, beside the features from the way down, through a `Double`.

    Args:
        inputs: Channels from below, and from the way down.
        outputs: Channels that go out.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.enlarge = nn.ConvTranspose2d(inputs, inputs, 2, stride=2)
        self.merge = Double(2 * inputs, outputs)

    def forward(self, below: Tensor, across: Tensor) -> Tensor:
        """(B, inputs, h // 2, w // 2) and (B, inputs, h, w) to (B, outputs, h, w)."""
        larger = self.enlarge(below)
        down, right = (a - b for a, b in zip(across.shape[2:], larger.shape[2:], strict=True))
        if down or right:  # pooling has dropped an odd row or column
            larger = pad(larger, (0, right, 0, down))
        merged: Tensor = self.merge(torch.cat([across, larger], dim=1))
        return merged


class UNet(GraspNetwork):
    """U-Net with four poolings; sides need no multiple, the way up is padded to the way down.

    14,789,700 parameters with four channels, one bin and 64 filters.
    """

    name: ClassVar[str] = "unet"
    smallest: ClassVar[int] = 16
    published_size_px: ClassVar[int] = 320
    published_filters: ClassVar[int | None] = 64
    convolutions: ClassVar[Literal["xavier", "pytorch"]] = "pytorch"

    def __init__(
        self,
        channels: int,
        bins: int = 1,
        tasks: Sequence[TaskSpec] = (),
        filters: int | None = None,
    ) -> None:
        super().__init__(channels, bins, tasks, filters)
        c = self.filters or 0
        self.down0 = Double(channels, c)
        self.down1 = Double(c, 2 * c)
        self.down2 = Double(2 * c, 4 * c)
        self.down3 = Double(4 * c, 8 * c)
        self.down4 = Double(8 * c, 8 * c)
        self.up1 = Up(8 * c, 4 * c)
        self.up2 = Up(4 * c, 2 * c)
        self.up3 = Up(2 * c, c)
        self.up4 = Up(c, c)
        self.add_heads(c, kernel=1)

    def features(self, images: Tensor) -> Tensor:
        """See `GraspNetwork.features`."""
        across = [self.down0(images)]
        for layer in (self.down1, self.down2, self.down3, self.down4):
            across.append(layer(max_pool2d(across[-1], 2)))
        x: Tensor = across.pop()
        for up in (self.up1, self.up2, self.up3, self.up4):
            x = up(x, across.pop())
        return x
