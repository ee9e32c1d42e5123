"""The Lightning module: loss on training pictures; loss, success and task metrics on validation.

Letters in shapes: B pictures, N bins, S side of the input.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import lightning
import numpy as np
import torch
from torch import Tensor

from graspmap.data import Store
from graspmap.data.images import TABLE_UNIT_M
from graspmap.errors import GraspmapError
from graspmap.geometry import Grasps
from graspmap.losses import UncertaintyWeighting
from graspmap.maps import GraspMaps, find_grasps
from graspmap.metrics import best_overlap
from graspmap.networks import GraspNetwork
from graspmap.training.data import Batch
from graspmap.training.experiment import Experiment
from graspmap.training.scores import TaskScores
from graspmap.training.state import RunState, Verdict
from graspmap.training.targets import batch_targets
from graspmap.training.tasks import loss_names, make_loss

SUCCESS_OVERLAP = 0.25
"""Overlap that a right grasp exceeds, for choosing the best epoch."""

_DROP = 2
"""The stream of random numbers for what a network draws itself (dropout)."""

_OPTIMISERS: dict[str, Callable[..., torch.optim.Optimizer]] = {
    "adam": torch.optim.Adam,
    "adamw": torch.optim.AdamW,
    "sgd": lambda parameters, **options: torch.optim.SGD(parameters, momentum=0.9, **options),
}


class GraspModule(lightning.LightningModule):
    """A network in training.

    Args:
        network: The network.
        experiment: Loss, optimiser, schedule.
        state: Where the run stands; the module moves it on and keeps it in checkpoints.
        store: The scenes; their labels say which grasps are right.
        width_scale_px: Opening in input pixels that the width map shows as 1.
        tasks: Tasks whose truth the scenes have; None for all of the experiment.
        steps: Optimiser steps of the whole training, which a cosine schedule goes by.

    Attributes:
        row: Metrics of the last complete epoch, for the log.
        verdict: What that epoch meant.
        overlaps: Best overlap of each scene of the last validation or test, by index.
        loss_value: Mean loss of that validation or test; NaN where the truth of a task is unknown.
        task_means: Metrics of the tasks there, by name.
    """

    def __init__(
        self,
        network: GraspNetwork,
        experiment: Experiment,
        state: RunState,
        *,
        store: Store,
        width_scale_px: float,
        tasks: tuple[str, ...] | None = None,
        steps: int = 0,
    ) -> None:
        super().__init__()
        self.network, self.state = network, state
        self._experiment, self._store, self._width_scale_px = experiment, store, width_scale_px
        self._loss, self._names = make_loss(experiment), loss_names(experiment)
        self._tasks = experiment.tasks.names if tasks is None else tasks
        self._steps = steps
        self.row: dict[str, float] = {}
        self.verdict: Verdict | None = None
        self.overlaps: dict[int, float] = {}
        self.loss_value = math.nan
        self.task_means: dict[str, float] = {}
        self._scores = TaskScores(())
        self._sums: Tensor | None = None
        self._held_out: Tensor | None = None
        self._clock = time.monotonic()

    # Lightning's hooks, in the order in which it calls them.

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """The optimiser; the schedule is `RunState`'s (Lightning forgets one on resuming)."""
        values = self._experiment.optimiser
        groups: list[dict[str, Any]] = [{"params": list(self.network.parameters())}]
        if learned := list(self._loss.parameters()):
            # Weights of losses, not of layers: decay would pull the tasks' variances towards 1.
            groups.append({"params": learned, "weight_decay": 0.0})
        return _OPTIMISERS[values.name](
            groups, lr=values.learning_rate, weight_decay=values.weight_decay
        )

    def on_train_epoch_start(self) -> None:
        """Take up the sums of a half-done epoch."""
        sums = self.state.sums or [0.0] * (len(self._names) + 1)
        self._sums = torch.tensor(sums, dtype=torch.float64, device=self.device)
        self._clock = time.monotonic() - self.state.seconds

    def on_train_batch_start(self, batch: Batch, batch_idx: int) -> None:
        """Set the learning rate, and seed what the network draws from (seed, epoch, batch).

        Both are functions of where the run stands, so a resumed run goes on alike.
        """
        del batch, batch_idx
        if self._experiment.schedule.kind == "cosine":
            done = self.state.step / max(1, self._steps)
            share = cosine_share(done, self._experiment.schedule.warmup)
            for group in self.trainer.optimizers[0].param_groups:
                group["lr"] = self._experiment.optimiser.learning_rate * share
        key = (self._experiment.seed, _DROP, self.state.epoch, self.state.batch)
        torch.manual_seed(int(np.random.SeedSequence(key).generate_state(1, np.uint64)[0]))

    def training_step(self, batch: Batch, batch_idx: int) -> Tensor:
        """Loss of one batch."""
        del batch_idx
        _, terms = self._forward(batch, score=False)
        assert self._sums is not None
        self._sums += _weighted(terms, len(batch["input"]))
        return terms[0]

    def on_validation_epoch_start(self) -> None:
        """Begin counting."""
        self.overlaps = {}
        self._held_out = torch.zeros(len(self._names) + 1, dtype=torch.float64, device=self.device)
        unit_m = TABLE_UNIT_M if self._experiment.data.depth_zero == "table" else 1.0
        self._scores = TaskScores(self._tasks, self.device, depth_unit_m=unit_m)

    def validation_step(self, batch: Batch, batch_idx: int) -> None:
        """Loss and overlap of the best grasp with the labels, scene by scene."""
        del batch_idx
        maps, terms = self._forward(batch, score=True)
        assert self._held_out is not None
        self._held_out += _weighted(terms, len(batch["input"]))
        arrays = GraspMaps(*(m.detach().float().cpu().numpy() for m in maps))
        for place, index in enumerate(batch["index"].tolist()):
            one = arrays.item(place)
            if not all(np.isfinite(m).all() for m in one):
                self.overlaps[index] = 0.0  # the loss is no number either: the epoch reports it
                continue
            # As `Detector` does: no grasp is centred beside the picture.
            inside = self._store.inside(index)
            best = find_grasps(one, 1, width_scale=self._width_scale_px, mask=inside)
            overlap = best_overlap(best, self._store.read_grasps(index) or Grasps.empty())
            self.overlaps[index] = float(overlap[0]) if len(overlap) else 0.0

    def on_validation_epoch_end(self) -> None:
        """Close the epoch: its row of metrics, and what it means for the run.

        Raises:
            GraspmapError: The loss is no longer a number.
        """
        assert self._held_out is not None
        means = _means(self._held_out.tolist())
        self.loss_value, self.task_means = means[0], self._scores.means()
        if self.trainer.testing:
            return
        overlaps = np.array(list(self.overlaps.values()))
        success = float((overlaps > SUCCESS_OVERLAP).mean())
        row: dict[str, float] = {"epoch": self.state.epoch, "step": self.state.step}
        if self.trainer.sanity_checking:
            self.state.start(success, means[0])
            self.verdict = Verdict(True, False, None)
        else:
            self.store_sums()
            trained = _means(self.state.sums)
            row |= {"epoch": self.state.epoch + 1}
            row |= {f"train_{name}": v for name, v in zip(self._names, trained, strict=True)}
            row |= {"learning_rate": self._rate(1.0), "seconds": round(self.state.seconds, 3)}
            if not math.isfinite(sum(trained) + sum(means)):
                raise GraspmapError(
                    f"the loss is no longer a number in epoch {row['epoch']}; use a lower "
                    "--optimiser.learning_rate, or precision 32"
                )
            self.verdict = self.state.end_epoch(success, means[0], self._experiment)
            self._rate(self._experiment.schedule.factor if self.verdict.cut else 1.0)
        row |= {f"validation_{name}": v for name, v in zip(self._names, means, strict=True)}
        row |= {"success": success, "miou": float(overlaps.mean())}
        self.row = row | self.task_means | self._log_variances()

    on_test_epoch_start = on_validation_epoch_start
    test_step = validation_step
    on_test_epoch_end = on_validation_epoch_end

    def on_save_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Add where the run stands; drop Lightning's own counters."""
        checkpoint["graspmap"] = self.state.to_dict()
        # Lightning's loops resume with repeated hooks and stale schedules. Ours starts them
        # afresh from `state`, which holds all that a run consists of.
        checkpoint.pop("loops", None)

    def on_load_checkpoint(self, checkpoint: dict[str, Any]) -> None:
        """Take over where the run stood."""
        self.state.load(checkpoint["graspmap"])

    # What the callbacks use.

    def end_batch(self) -> None:
        """Count an optimiser step."""
        self.state.batch += 1
        self.state.step += 1

    def store_sums(self) -> None:
        """Bring the running sums from the device into `state`."""
        if self._sums is not None:
            self.state.sums = self._sums.tolist()
            self.state.seconds = time.monotonic() - self._clock

    def _forward(
        self, batch: Batch, *, score: bool
    ) -> tuple[GraspMaps[Tensor], tuple[Tensor, ...]]:
        """Maps (B, N, S, S) to find grasps in, and the loss with its parts, see `loss_names`."""
        outputs, truth = self.network.outputs(batch["input"]), batch_targets(batch)
        # The loss sums over many small numbers: never in half precision.
        maps = GraspMaps(*(m.float() for m in outputs.maps))
        said = {name: tensor.float() for name, tensor in outputs.tasks.items()}
        grasp, tasks = self._loss.parts(maps, said, truth, self._tasks)
        nothing = grasp.total.new_tensor(math.nan)  # of a task that cannot be judged here
        complete = len(tasks) == len(said)
        total = self._loss.weigh(grasp, tasks) if complete else nothing
        if score:
            self._scores.add(said, truth)
        others = (tasks.get(name, nothing) for name in self._experiment.tasks.names)
        terms = (total, grasp.quality, grasp.cos, grasp.sin, grasp.width, *others)
        return outputs.decoded(), terms

    def _log_variances(self) -> dict[str, float]:
        """The s_i of an uncertainty weighting, by column."""
        weighting = self._loss.weighting
        if not isinstance(weighting, UncertaintyWeighting):
            return {}
        values = weighting.log_variances.tolist()
        return {f"uncertainty_{n}": v for n, v in zip(weighting.names, values, strict=True)}

    def _rate(self, factor: float) -> float:
        """Multiply the learning rate by ``factor``, and give it."""
        groups = self.trainer.optimizers[0].param_groups
        for group in groups:
            if factor != 1.0:
                group["lr"] *= factor
        return float(groups[0]["lr"])


def cosine_share(done: float, warmup: float) -> float:
    """Share of the greatest learning rate when a share ``done`` of all steps lies behind.

    It rises as a straight line from a hundredth over ``warmup``, then falls along half a cosine to
    nothing.
    """
    if done < warmup:
        return 0.01 + 0.99 * done / warmup
    return 0.5 * (1 + math.cos(math.pi * min(1.0, (done - warmup) / (1 - warmup))))


def _weighted(terms: tuple[Tensor, ...], count: int) -> Tensor:
    """(terms + 1,) float64: each mean times the number of pictures, and that number."""
    values = torch.stack([t.detach().double() for t in terms])
    return torch.cat([values * count, values.new_tensor([count])])


def _means(sums: list[float]) -> list[float]:
    return [value / sums[-1] if sums[-1] else math.nan for value in sums[:-1]]
