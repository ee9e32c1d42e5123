"""GG-CNN and GG-CNN2: small fully convolutional grasp networks.

References:
    Morrison, Corke and Leitner, "Closing the Loop for Robotic Grasping: A Real-time, Generative
    Grasp Synthesis Approach", RSS 2018 (GG-CNN). The same, "Learning robust, real-time, reactive
    robotic grasping", IJRR 2020 (GG-CNN2). The thesis, section 3.1, trains GG-CNN2 with
    transposed convolutions; its authors' own weights come from bilinear enlargement. Both have
    the same number of parameters but are different functions, so they are different networks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from torch import Tensor, nn
from torch.nn.functional import interpolate, max_pool2d

from graspmap.networks.base import GraspNetwork
from graspmap.networks.tasks import TaskSpec


class GGCNN(GraspNetwork):
    """GG-CNN: three strided convolutions down by 12, three transposed ones up again.

    At 300 px the last transposed layer gives 301 px, which the unpadded 2 x 2 heads bring back to
    300; so it is for every multiple of 12.

    62,420 parameters with one channel and one bin.
    """

    name: ClassVar[str] = "ggcnn"
    granularity: ClassVar[int] = 12

    def __init__(
        self,
        channels: int,
        bins: int = 1,
        tasks: Sequence[TaskSpec] = (),
        filters: int | None = None,
    ) -> None:
        super().__init__(channels, bins, tasks, filters)
        self.shrink1 = nn.Conv2d(channels, 32, 9, stride=3, padding=3)
        self.shrink2 = nn.Conv2d(32, 16, 5, stride=2, padding=2)
        self.shrink3 = nn.Conv2d(16, 8, 3, stride=2, padding=1)
        self.grow1 = nn.ConvTranspose2d(8, 8, 3, stride=2, padding=1, output_padding=1)
        self.grow2 = nn.ConvTranspose2d(8, 16, 5, stride=2, padding=2, output_padding=1)
        self.grow3 = nn.ConvTranspose2d(16, 32, 9, stride=3, padding=3, output_padding=1)
        self.add_heads(32, kernel=2)

    def features(self, images: Tensor) -> Tensor:
        """See `GraspNetwork.features`."""
        x: Tensor = self.shrink1(images).relu_()
        for layer in (self.shrink2, self.shrink3, self.grow1, self.grow2, self.grow3):
            x = layer(x).relu_()
        return x


class GGCNN2(GraspNetwork):
    """GG-CNN2 of the thesis: two pooled pairs, two dilated layers, two transposed ones.

    66,676 / 70,548 / 72,484 parameters with 1 / 3 / 4 channels and one bin.
    """

    name: ClassVar[str] = "ggcnn2"
    granularity: ClassVar[int] = 4

    def __init__(
        self,
        channels: int,
        bins: int = 1,
        tasks: Sequence[TaskSpec] = (),
        filters: int | None = None,
    ) -> None:
        super().__init__(channels, bins, tasks, filters)
        self.fine1 = nn.Conv2d(channels, 16, 11, padding=5)
        self.fine2 = nn.Conv2d(16, 16, 5, padding=2)
        self.middle1 = nn.Conv2d(16, 16, 5, padding=2)
        self.middle2 = nn.Conv2d(16, 16, 5, padding=2)
        self.dilated1 = nn.Conv2d(16, 32, 5, dilation=2, padding=4)
        self.dilated2 = nn.Conv2d(32, 32, 5, dilation=4, padding=8)
        self.grow1 = self.enlarging_layer(32, 16)
        self.grow2 = self.enlarging_layer(16, 16)
        self.add_heads(16, kernel=1)

    def enlarging_layer(self, inputs: int, outputs: int) -> nn.Module:
        """The layer with weights that goes with one doubling of the size."""
        return nn.ConvTranspose2d(inputs, outputs, 3, stride=2, padding=1, output_padding=1)

    def enlarge(self, layer: nn.Module, features: Tensor) -> Tensor:
        """(B, F, h, w) features at twice the size, through ``layer``."""
        larger: Tensor = layer(features)
        return larger

    def features(self, images: Tensor) -> Tensor:
        """See `GraspNetwork.features`."""
        return self.tail(self.stem(images), ("dilated1", "dilated2", "grow1", "grow2"), self)

    def stem(self, images: Tensor) -> Tensor:
        """(B, C, H, W) pictures to (B, 16, H / 4, W / 4) features."""
        # Pooling before the ReLU gives the same numbers as after it, on a quarter of the pixels.
        x = self.fine1(images).relu_()
        x = max_pool2d(self.fine2(x), 2).relu_()
        x = self.middle1(x).relu_()
        return max_pool2d(self.middle2(x), 2).relu_()

    def tail(self, x: Tensor, names: Sequence[str], owner: nn.Module) -> Tensor:
        """Features through the layers of those names (after the stem) that ``owner`` has."""
        for name in names:
            layer = getattr(owner, name)
            x = (self.enlarge(layer, x) if name.startswith("grow") else layer(x)).relu_()
        return x


class GGCNN2Bilinear(GGCNN2):
    """GG-CNN2 as its authors trained it: bilinear enlargement, then a 3 x 3 convolution."""

    name: ClassVar[str] = "ggcnn2-bilinear"

    def enlarging_layer(self, inputs: int, outputs: int) -> nn.Module:
        """The convolution after one doubling of the size."""
        return nn.Conv2d(inputs, outputs, 3, padding=1)

    def enlarge(self, layer: nn.Module, features: Tensor) -> Tensor:
        """(B, F, h, w) features at twice the size (corners stay on corners), through ``layer``."""
        larger = interpolate(features, scale_factor=2, mode="bilinear", align_corners=True)
        return GGCNN2.enlarge(self, layer, larger)
