"""GR-ConvNet 1 to 4: residual grasp networks.

References:
    Kumra, Joshi and Sahin, "Antipodal Robotic Grasping using Generative Residual Convolutional
    Neural Network", IROS 2020; the variants are those that the thesis compares in Table 4.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor, nn

from graspmap.errors import InvalidInputError
from graspmap.networks.base import GraspNetwork
from graspmap.networks.tasks import TaskSpec


class Normed(nn.Module):
    """A convolution, batch norm and ReLU.

    Args:
        layer: The convolution, plain or transposed.
    """

    def __init__(self, layer: nn.Conv2d | nn.ConvTranspose2d) -> None:
        super().__init__()
        self.layer = layer
        self.norm = nn.BatchNorm2d(layer.out_channels)

    def forward(self, x: Tensor) -> Tensor:
        """(B, F, h, w) to what the convolution gives, not below 0."""
        last: Tensor = self.norm(self.layer(x)).relu_()
        return last


class Residual(nn.Module):
    """Two 3 x 3 convolutions with batch norm, added to what comes in; no ReLU after the sum.

    Args:
        width: F.
        dropout: Share of the features dropped in training between the two.
    """

    def __init__(self, width: int, dropout: float) -> None:
        super().__init__()
        self.layer1 = nn.Conv2d(width, width, 3, padding=1)
        self.norm1 = nn.BatchNorm2d(width)
        self.layer2 = nn.Conv2d(width, width, 3, padding=1)
        self.norm2 = nn.BatchNorm2d(width)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor) -> Tensor:
        """(B, F, h, w) to the same shape."""
        inner = self.dropout(self.norm1(self.layer1(x)).relu_())
        changed: Tensor = self.norm2(self.layer2(inner))
        return changed.add_(x)


class GRConvNet(GraspNetwork):
    """GR-ConvNet: down by 4, five residual blocks, up again.

    As in GG-CNN, one pixel too many comes out of the transposed layers, and the unpadded 2 x 2
    heads bring it back.

    1,900,900 parameters with four channels, one bin and 32 filters; 479,156 with 16 filters.

    Attributes:
        residual_dropout: Share of the features dropped in training in the residual blocks.
        head_dropout: The same before the heads.
    """

    name: ClassVar[str] = "grconvnet"
    granularity: ClassVar[int] = 4
    published_size_px: ClassVar[int] = 224
    published_filters: ClassVar[int | None] = 32
    residual_dropout: ClassVar[float] = 0.0
    head_dropout: ClassVar[float] = 0.0

    def __init__(
        self,
        channels: int,
        bins: int = 1,
        tasks: Sequence[TaskSpec] = (),
        filters: int | None = None,
    ) -> None:
        super().__init__(channels, bins, tasks, filters)
        wide, middle, deep = self.widths()
        self.shrink1 = Normed(nn.Conv2d(channels, wide, 9, padding=4))
        self.shrink2 = Normed(nn.Conv2d(wide, middle, 4, stride=2, padding=1))
        self.shrink3 = Normed(nn.Conv2d(middle, deep, 4, stride=2, padding=1))
        self.residual = nn.Sequential(*(Residual(deep, self.residual_dropout) for _ in range(5)))
        self.grow1 = Normed(
            nn.ConvTranspose2d(deep, middle, 4, stride=2, padding=1, output_padding=1)
        )
        self.grow2 = Normed(
            nn.ConvTranspose2d(middle, wide, 4, stride=2, padding=2, output_padding=1)
        )
        self.grow3 = nn.ConvTranspose2d(wide, wide, 9, padding=4)
        self.add_heads(wide, kernel=2, dropout=self.head_dropout)

    def widths(self) -> tuple[int, int, int]:
        """Channels at the full, the half and the quarter size."""
        c = self.filters or 0
        return c, 2 * c, 4 * c

    def features(self, images: Tensor) -> Tensor:
        """See `GraspNetwork.features`."""
        x = self.shrink3(self.shrink2(self.shrink1(images)))
        last: Tensor = self.grow3(self.grow2(self.grow1(self.residual(x))))
        return last


class GRConvNet2(GRConvNet):
    """GR-ConvNet with dropout in the residual blocks and before the heads."""

    name: ClassVar[str] = "grconvnet2"
    residual_dropout: ClassVar[float] = 0.1
    head_dropout: ClassVar[float] = 0.1


class GRConvNet3(GRConvNet):
    """GR-ConvNet with dropout before the heads."""

    name: ClassVar[str] = "grconvnet3"
    head_dropout: ClassVar[float] = 0.1


class GRConvNet4(GRConvNet):
    """GR-ConvNet that narrows as it shrinks: 32, 16, 8 filters and back.

    120,652 parameters with four channels, one bin and 32 filters.
    """

    name: ClassVar[str] = "grconvnet4"

    def widths(self) -> tuple[int, int, int]:
        """Channels at the full, the half and the quarter size.

        Raises:
            InvalidInputError: The filters cannot be halved twice.
        """
        c = self.filters or 0
        if c % 4:
            raise InvalidInputError(f"filters of {self.name}", c, "a multiple of 4")
        return c, c // 2, c // 4
