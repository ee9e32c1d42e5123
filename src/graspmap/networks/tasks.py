"""Auxiliary tasks as data: what a network learns beside grasping, and the heads that give it.

Letters in shapes: B pictures, F features, H rows and W columns of the picture, h and w of a
feature map, N orientation bins, K classes.

References:
    The thesis, sections 3.1.2 and 3.2.2 (category, saliency, depth). Chalvatzaki, Gkanatsios,
    Maragos and Peters, "Orientation Attentive Robotic Grasp Synthesis with Augmented Grasp Map
    Representation", 2020 (ORANGE: graspness, orientation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.functional import adaptive_avg_pool2d, interpolate

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.maps.grasp_maps import GraspMaps

AUXILIARY_TASKS = ("category", "saliency", "depth")
"""Tasks that only help to learn; detection leaves them out."""
DECODING_TASKS = ("graspness", "orientation")
"""Tasks of ORANGE whose probabilities multiply the quality at detection."""
TASK_NAMES = AUXILIARY_TASKS + DECODING_TASKS

_MOST_OUTPUTS, _MOST_SIZE_PX = 4096, 1024
"""More would only fill the memory: the first layer of a category head has 512 size^2 weights."""


@dataclass(frozen=True)
class TaskSpec:
    """A task that a network has a head for.

    | name | what the head gives | meaning |
    |---|---|---|
    | ``category`` | (B, K) logits | class of the object: softmax |
    | ``saliency`` | (B, 1, H, W) logits | pixel on an object: sigmoid |
    | ``depth`` | (B, 1, H, W) | depth in units of the normalised depth input |
    | ``graspness`` | (B, 1, H, W) logits | some grasp is centred at the pixel: sigmoid |
    | ``orientation`` | (B, N, H, W) logits | one of that bin is: sigmoid, bin by bin |

    Args:
        name: One of `TASK_NAMES`.
        outputs: K of ``category``, N of ``orientation``, 1 of the others.
        size: ``category`` only: side in pixels of the input that its flattened layer is made
            for; the features of other sizes are averaged or repeated to fit.

    Raises:
        UnknownNameError: There is no such task.
        InvalidInputError: outputs or size do not go with the task.
    """

    name: str
    outputs: int = 1
    size: int = 0

    def __post_init__(self) -> None:
        if self.name not in TASK_NAMES:
            raise UnknownNameError("task", self.name, TASK_NAMES)
        most = _MOST_OUTPUTS if self.name in ("category", "orientation") else 1
        if type(self.outputs) is not int or not 1 <= self.outputs <= most:
            allowed = f"1 to {most}" if most > 1 else "1"
            raise InvalidInputError(f"outputs of the task {self.name}", repr(self.outputs), allowed)
        flat = self.name == "category"
        if type(self.size) is not int or not flat <= self.size <= _MOST_SIZE_PX * flat:
            allowed = f"the side of the input, 1 to {_MOST_SIZE_PX} px" if flat else "0"
            raise InvalidInputError(f"size of the task {self.name}", repr(self.size), allowed)


class Outputs(NamedTuple):
    """All that a network gives for a batch.

    Attributes:
        maps: (B, N, H, W) grasp maps as the heads give them.
        tasks: Tensor of each task by its name, see `TaskSpec`.
    """

    maps: GraspMaps[Tensor]
    tasks: dict[str, Tensor]

    def decoded(self) -> GraspMaps[Tensor]:
        """The maps that grasps are read from: quality times the probabilities of ORANGE.

        Where there is a graspness head, the quality is multiplied by its sigmoid; where there is
        an orientation head, each bin's quality is multiplied by the sigmoid of that bin.
        """
        quality = self.maps.quality
        for name in DECODING_TASKS:
            if name in self.tasks:
                quality = quality * self.tasks[name].sigmoid()
        return GraspMaps(quality, self.maps.cos, self.maps.sin, self.maps.width)


class ImageHead(nn.Module):
    """One convolution from the features to a picture.

    Args:
        features: F.
        outputs: Channels of the picture.
        kernel: Side of the kernel, without padding, as the grasp heads have it.
    """

    def __init__(self, features: int, outputs: int, kernel: int) -> None:
        super().__init__()
        self.layer = nn.Conv2d(features, outputs, kernel)

    def forward(self, features: Tensor, padded: Sequence[int], shape: Sequence[int]) -> Tensor:
        """The picture.

        Args:
            features: (B, F, h, w) features of the padded input.
            padded: (rows, columns) of the padded input.
            shape: (H, W) of the picture itself, its top left part.

        Returns:
            (B, outputs, H, W); a coarse picture is enlarged bilinearly.
        """
        picture: Tensor = self.layer(features)
        if picture.shape[2:] != torch.Size(padded):
            picture = interpolate(picture, size=tuple(padded), mode="bilinear", align_corners=False)
        return picture[..., : shape[0], : shape[1]].contiguous()


class CategoryHead(nn.Module):
    """One convolution to one channel and ReLU, then layers of 512, 256 and K over all its pixels.

    Args:
        features: F.
        classes: K.
        kernel: Side of the convolution's kernel, without padding.
        side: Side in cells of the feature map that the flattened layer is made for.
    """

    def __init__(self, features: int, classes: int, kernel: int, side: int) -> None:
        super().__init__()
        self.side = side
        self.layer = nn.Conv2d(features, 1, kernel)
        self.hidden1 = nn.Linear(side * side, 512)
        self.hidden2 = nn.Linear(512, 256)
        self.classes = nn.Linear(256, classes)
        self.dropout = nn.Dropout(0.5)

    def forward(self, features: Tensor, padded: Sequence[int], shape: Sequence[int]) -> Tensor:
        """(B, K) logits; arguments as in `ImageHead.forward`."""
        x = self.layer(features).relu()
        # Cells that see only padding do not take part.
        rows, columns = (
            -(-part * cells // whole)
            for part, cells, whole in zip(shape, x.shape[2:], padded, strict=True)
        )
        x = x[..., :rows, :columns]
        if (rows, columns) != (self.side, self.side):
            x = adaptive_avg_pool2d(x, self.side)
        x = self.hidden1(x.flatten(1)).relu()
        x = self.hidden2(self.dropout(x)).relu()
        logits: Tensor = self.classes(self.dropout(x))
        return logits


def check_tasks(tasks: Sequence[TaskSpec], bins: int) -> tuple[TaskSpec, ...]:
    """The tasks of one network.

    Raises:
        InvalidInputError: A task is there twice, or orientation has another number of bins than
            the grasp maps.
    """
    names = [task.name for task in tasks]
    if len(set(names)) != len(names):
        raise InvalidInputError("tasks of the network", ", ".join(names), "each task once")
    for task in tasks:
        if task.name == "orientation" and task.outputs != bins:
            raise InvalidInputError(
                "outputs of the task orientation", task.outputs, f"{bins}, the bins of the network"
            )
    return tuple(tasks)


def make_head(task: TaskSpec, features: int, kernel: int, stride: int) -> nn.Module:
    """The head of a task.

    Args:
        task: The task.
        features: F of the feature map that it sits on.
        kernel: Side of its convolution's kernel.
        stride: Input pixels to a cell of that feature map.
    """
    if task.name == "category":
        return CategoryHead(features, task.outputs, kernel, -(-task.size // stride))
    return ImageHead(features, task.outputs, kernel)
