"""Training samples: from the packed cache to batches, each drawn from (seed, epoch, position).

No sample depends on what was drawn before it, so a run that was cut in half, or that prepares its
pictures in other processes, sees the same pictures.

Letters in shapes: B pictures, C channels, N bins, S side of the input.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import lightning
import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset, Sampler

from graspmap.data import Augmentation, Scene, Store, jaw_shares, smallest_jaws, to_input
from graspmap.data.table import Table
from graspmap.geometry import Grasps
from graspmap.maps import draw_maps
from graspmap.training.experiment import Experiment
from graspmap.training.state import RunState
from graspmap.training.targets import task_targets

Batch = dict[str, torch.Tensor]
"""``input`` (B, C, S, S); ``target`` (B, 4, N, S, S) quality, cos, sin, width; ``index`` (B,); and
what `graspmap.training.targets.task_targets` gives for the tasks."""

ELSEWHERE = 0.25
"""Share of the crops that lie anywhere in the picture, not around what can be grasped."""

_ORDER, _MOVE = 0, 1
"""Which stream of random numbers: the order of the scenes, or the motion of one picture."""


class Draw(NamedTuple):
    """One sample to prepare.

    Attributes:
        scene: Its index in the store.
        epoch: Epoch that it is for; -1 leaves the picture unmoved (validation, test).
        position: Its place in the epoch.
    """

    scene: int
    epoch: int = -1
    position: int = 0


class DrawSampler(Sampler[list[Draw]]):
    """Batches of one epoch, from where the run stands.

    The scenes are shuffled, used up, shuffled again, and so on; each epoch takes the next
    stretch. So every scene is seen equally often, however long an epoch is.

    Args:
        indices: Scenes of the training part.
        experiment: Seed, batch size and batches in an epoch.
        state: Where the run stands; read when an epoch's iteration begins.
    """

    def __init__(self, indices: Sequence[int], experiment: Experiment, state: RunState) -> None:
        self._indices = np.asarray(indices, dtype=np.int64)
        self._seed, self._size = experiment.seed, experiment.training.batch_size
        batches = experiment.training.batches_per_epoch
        self._samples = len(self._indices) if batches is None else batches * self._size
        self._state = state
        # Lightning asks for the length once a run: what is left of a half-done first epoch.
        self._length = self.batches - state.batch

    @property
    def batches(self) -> int:
        """Batches in a whole epoch."""
        return -(-self._samples // self._size)

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[list[Draw]]:
        # No generator: the place in the run is read now, not at the first batch.
        return iter(self.epoch(self._state.epoch)[self._state.batch :])

    def epoch(self, epoch: int) -> list[list[Draw]]:
        """All batches of epoch ``epoch`` (from 0)."""
        scenes = len(self._indices)
        places = epoch * self._samples + np.arange(self._samples)
        rounds = {
            r: np.random.default_rng((self._seed, _ORDER, r)).permutation(self._indices)
            for r in range(places[0] // scenes, places[-1] // scenes + 1)
        }
        draws = [
            Draw(int(rounds[place // scenes][place % scenes]), epoch, position)
            for position, place in enumerate(places.tolist())
        ]
        return [draws[i : i + self._size] for i in range(0, len(draws), self._size)]


@dataclass(frozen=True)
class Samples(Dataset[dict[str, NDArray[Any]]]):
    """The samples of a store: pictures as the network sees them, with target maps.

    Args:
        store: Packed pictures and labels.
        experiment: Channels, size, bins, augmentation, and how maps are drawn.
        width_scale_px: Opening in input pixels that the width map shows as 1.
        tasks: Tasks whose truth is given, too.
        classes: All classes of the category task.
    """

    store: Store
    experiment: Experiment
    width_scale_px: float
    tasks: tuple[str, ...] = ()
    classes: tuple[str, ...] = ()

    def __getitem__(self, draw: Draw) -> dict[str, NDArray[Any]]:
        """``input`` (C, S, S), ``target`` (4, N, S, S), ``index`` and the truth of the tasks."""
        if draw.epoch < 0:
            return self._sample(draw.scene, np.eye(3))
        rng = np.random.default_rng((self.experiment.seed, _MOVE, draw.epoch, draw.position))
        matrix = augmentation(self.experiment).draw(rng, self.experiment.data.size)
        sample, crop = self._sample(draw.scene, matrix), self.experiment.data.augment.crop
        return sample if crop is None else crop_sample(sample, crop, rng)

    def _sample(self, index: int, matrix: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        """A whole picture, moved, with everything that is true of it."""
        scene = self.store[index]
        table = self.store.table(index)
        sample = make_sample(scene, matrix, self.experiment, self.width_scale_px, table)
        category = self.experiment.tasks.category
        truth = task_targets(
            self.tasks,
            self.store,
            index,
            matrix,
            scene=scene,
            # Depth comes first in the input.
            seen=None if self.experiment.network.channels == "rgb" else sample["input"][:1],
            label=None if category is None else category.labels,
            classes=self.classes,
            depth_zero=self.experiment.data.depth_zero,
            table=table,
        )
        return {**sample, **truth, "index": np.array(index)}


def augmentation(experiment: Experiment) -> Augmentation:
    """The augmentation of the experiment's training part."""
    values = experiment.data.augment
    return Augmentation(
        rotation=values.rotation, zoom=values.zoom, flip=values.flip, shift=values.shift
    )


def make_sample(
    scene: Scene,
    matrix: NDArray[np.float64],
    experiment: Experiment,
    width_scale_px: float,
    table: Table | None = None,
) -> dict[str, NDArray[np.float32]]:
    """One picture and its target maps, moved together.

    Args:
        scene: Pictures of side S, holes of the depth filled, and labels.
        matrix: (3, 3) similarity of the input frame.
        experiment: Channels, size, bins, and how maps are drawn.
        width_scale_px: Opening in input pixels that the width map shows as 1.
        table: The table behind the picture, where it was found already.

    Returns:
        ``input`` (C, S, S) and ``target`` (4, N, S, S), float32.
    """
    size, maps = experiment.data.size, experiment.maps
    picture = to_input(
        scene.rgb,
        scene.depth,
        experiment.network.channels,
        matrix,
        size,
        depth_zero=experiment.data.depth_zero,
        table=table,
    )
    labels = Grasps.empty() if scene.grasps is None else scene.grasps
    by_jaws = maps.peaks == "jaws"
    labels = jaw_shares(labels, scene.negatives) if by_jaws else smallest_jaws(labels)
    target = draw_maps(
        labels.transformed(matrix),
        (size, size),
        bins=experiment.network.bins,
        quality=maps.quality,
        peaks="quality" if by_jaws else "one",
        drop_off=maps.drop_off,
        overlap=maps.overlap,
        gaussian=maps.gaussian,
        background=maps.background,
        width_scale=width_scale_px,
    )
    return {"input": picture, "target": np.stack(list(target))}


def crop_sample(
    sample: Mapping[str, NDArray[Any]], side: int, rng: np.random.Generator
) -> dict[str, NDArray[Any]]:
    """A square of a sample, around a graspable pixel drawn at random, or, now and then, anywhere.

    Without the others (a share of `ELSEWHERE`) a network would never see the picture's corners, and
    would find grasps in them: there a tilted table is nearest and farthest, beside the zeros that
    convolutions add.

    Args:
        sample: What `Samples` gives; every array that ends in (S, S) is cut.
        side: Side of the square, at most S.
        rng: What pixel and place are drawn from.
    """
    size = sample["target"].shape[-1]
    pixels = np.flatnonzero(sample["target"][0].max(axis=0) > 0)
    if not len(pixels) or rng.random() < ELSEWHERE:
        pixels = np.arange(size * size)
    chosen = pixels[rng.integers(len(pixels))]
    row, column = (
        # Anywhere in the square, as far as the square lies inside the picture.
        int(rng.integers(max(0, at - side + 1), min(at, size - side) + 1))
        for at in divmod(int(chosen), size)
    )
    window = (..., slice(row, row + side), slice(column, column + side))
    return {
        name: np.ascontiguousarray(array[window]) if array.shape[-2:] == (size, size) else array
        for name, array in sample.items()
    }


class GraspData(lightning.LightningDataModule):
    """The loaders of one run.

    Args:
        samples: Those of each part, ``train``, ``validation`` and ``test``.
        parts: Indices of the scenes of each part.
        state: Where the run stands.
        pin_memory: Whether batches go to an accelerator.
    """

    def __init__(
        self,
        samples: Mapping[str, Samples],
        parts: Mapping[str, tuple[int, ...]],
        state: RunState,
        *,
        pin_memory: bool = False,
    ) -> None:
        super().__init__()
        self.samples, self.parts, self._state = samples, parts, state
        self._pin_memory = pin_memory

    def train_dataloader(self) -> DataLoader[Any]:
        """Moved samples, from where the run stands."""
        experiment = self.samples["train"].experiment
        return self._loader("train", DrawSampler(self.parts["train"], experiment, self._state))

    def val_dataloader(self) -> DataLoader[Any]:
        """The validation part, unmoved, in order."""
        return self._in_order("validation")

    def test_dataloader(self) -> DataLoader[Any]:
        """The test part, unmoved, in order."""
        return self._in_order("test")

    def _in_order(self, part: str) -> DataLoader[Any]:
        draws = [Draw(index) for index in self.parts[part]]
        size = self.samples[part].experiment.training.batch_size
        return self._loader(part, [draws[i : i + size] for i in range(0, len(draws), size)])

    def _loader(self, part: str, batches: Any) -> DataLoader[Any]:
        samples = self.samples[part]
        workers = samples.experiment.training.workers
        return DataLoader(
            samples,
            batch_sampler=batches,
            num_workers=workers,
            collate_fn=collate,
            pin_memory=self._pin_memory,
            persistent_workers=workers > 0,
            worker_init_fn=_one_thread if workers else None,
            # A loader seeds its processes from the global generator unless it has one of its own.
            generator=torch.Generator(),
        )


def collate(samples: Sequence[dict[str, NDArray[Any]]]) -> Batch:
    """Stack samples into a batch."""
    return {
        name: torch.from_numpy(np.stack([sample[name] for sample in samples]))
        for name in samples[0]
    }


def _one_thread(worker: int) -> None:
    """Each worker keeps to one core: more would fight with the training itself."""
    del worker
    cv2.setNumThreads(1)


def greatest_opening(store: Store, indices: Sequence[int]) -> float:
    """Greatest labelled opening of some scenes in input pixels, at least 1.

    Labels whose centre lies outside the input do not count.
    """
    greatest = 1.0
    for index in indices:
        grasps = store.read_grasps(index)
        if grasps is None or not len(grasps):
            continue
        inside = ((grasps.center >= -0.5) & (grasps.center <= store.size - 0.5)).all(axis=1)
        greatest = max(greatest, float(grasps.width[inside].max(initial=0.0)))
    return greatest
