"""MTG-CNN a to d: GG-CNN2 with a branch for what it learns beside grasping.

The variants differ in where the branch leaves the trunk (thesis, section 3.1.2 and Fig. 3.2).
Each auxiliary task has a branch of its own. Graspness and orientation are about grasps and sit on
the last feature map of the grasps' own branch, as in every network.
"""

from __future__ import annotations

import copy
from collections.abc import Collection
from typing import ClassVar, Literal

from torch import Tensor, nn

from graspmap.networks.ggcnn import GGCNN2
from graspmap.networks.tasks import AUXILIARY_TASKS


class MTGCNNa(GGCNN2):
    """MTG-CNN a: only the heads tell the tasks apart, all layers are shared.

    Attributes:
        leaves: After which part of the trunk the branches of the auxiliary tasks begin.
        replicated: Layers of the trunk that each branch has a second time, for itself.
    """

    name: ClassVar[str] = "mtgcnn-a"
    needs_task: ClassVar[bool] = True
    leaves: ClassVar[Literal["stem", "dilated", "last"]] = "last"
    replicated: ClassVar[tuple[str, ...]] = ()

    def add_heads(self, features: int, kernel: int, *, dropout: float = 0.0) -> None:
        """Make the branches, then the heads, see `GraspNetwork.add_heads`."""
        self.task_branches = nn.ModuleDict()
        for task in self.tasks:
            if task.name in AUXILIARY_TASKS:
                layers = {name: copy.deepcopy(getattr(self, name)) for name in self.replicated}
                self.task_branches[task.name] = nn.ModuleDict(layers)
        super().add_heads(features, kernel, dropout=dropout)

    def branches(self, images: Tensor, names: Collection[str]) -> tuple[Tensor, dict[str, Tensor]]:
        """See `GraspNetwork.branches`."""
        stem = self.stem(images)
        dilated = self.tail(stem, ("dilated1", "dilated2"), self)
        last = self.tail(dilated, ("grow1", "grow2"), self)
        start = {"stem": stem, "dilated": dilated, "last": last}[self.leaves]
        own = {
            name: self.tail(start, self.replicated, layers)
            for name, layers in self.task_branches.items()
            if name in names
        }
        return last, dict.fromkeys(names, last) | own


class MTGCNNb(MTGCNNa):
    """MTG-CNN b: the transposed layers are replicated for the auxiliary task."""

    name: ClassVar[str] = "mtgcnn-b"
    leaves: ClassVar[Literal["stem", "dilated", "last"]] = "dilated"
    replicated: ClassVar[tuple[str, ...]] = ("grow1", "grow2")


class MTGCNNc(MTGCNNa):
    """MTG-CNN c: the dilated and the transposed layers are replicated.

    115,973 parameters with three channels, one bin and one task that gives a picture.
    """

    name: ClassVar[str] = "mtgcnn-c"
    leaves: ClassVar[Literal["stem", "dilated", "last"]] = "stem"
    replicated: ClassVar[tuple[str, ...]] = ("dilated1", "dilated2", "grow1", "grow2")


class MTGCNNd(MTGCNNa):
    """MTG-CNN d: the branch leaves as in c and has no layers of its own.

    Its features are a quarter of the picture's size; a picture made of them is enlarged.
    """

    name: ClassVar[str] = "mtgcnn-d"
    auxiliary_stride: ClassVar[int] = 4
    leaves: ClassVar[Literal["stem", "dilated", "last"]] = "stem"
