"""How far a run has come, and what the last epoch means for it: best so far, cut, or end.

Everything here goes into the checkpoint, so that a run that was killed continues as if nothing
had happened.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

from graspmap.training.experiment import Experiment

_THRESHOLD = 1e-4
"""Relative change of the loss (absolute of the success) that counts as an improvement."""


@dataclass(frozen=True)
class Verdict:
    """What an epoch's validation means.

    Attributes:
        best: It is the best epoch so far.
        cut: The learning rate is to be multiplied by the schedule's factor.
        stop: Why training ends here, or None.
    """

    best: bool
    cut: bool
    stop: str | None


@dataclass
class RunState:
    """Where a run stands.

    Attributes:
        epoch: Epochs that are complete, validation included.
        batch: Batches of the next epoch that are done (above 0 only inside an epoch).
        step: Optimiser steps in all.
        sums: Sums over the pictures of the running epoch, of each of
            `graspmap.training.tasks.loss_names`, then their count; empty at its beginning.
        seconds: Seconds spent in the running epoch.
        best_epoch: Epoch of the best validation success (ties: lower validation loss).
        best_success: That success, 0 to 1; -1 before the first validation.
        best_loss: That epoch's validation loss.
        reference: Best value of what the schedule monitors.
        bad_epochs: Epochs since ``reference`` improved, or since the last cut.
        cuts: Cuts of the learning rate so far.
        stopped: Why training ended early, or None.
    """

    epoch: int = 0
    batch: int = 0
    step: int = 0
    sums: list[float] = field(default_factory=list)
    seconds: float = 0.0
    best_epoch: int = 0
    best_success: float = -1.0
    best_loss: float = float("inf")
    reference: float | None = None
    bad_epochs: int = 0
    cuts: int = 0
    stopped: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for the checkpoint."""
        return asdict(self)

    def load(self, values: dict[str, Any]) -> None:
        """Take over what `to_dict` gave."""
        for name, value in values.items():
            setattr(self, name, value)

    def finished(self, experiment: Experiment) -> bool:
        """Whether no epoch is left to train."""
        return self.stopped is not None or self.epoch >= experiment.training.epochs

    def start(self, success: float, loss: float) -> None:
        """Take note of the untrained network, which every epoch has to beat."""
        self.best_epoch, self.best_success, self.best_loss = 0, success, loss

    def end_epoch(self, success: float, loss: float, experiment: Experiment) -> Verdict:
        """Count an epoch and judge it.

        Args:
            success: Its rectangle success on validation, 0 to 1.
            loss: Its validation loss.
            experiment: Patience, factor and limits.
        """
        self.epoch += 1
        self.batch = 0
        self.sums = []
        self.seconds = 0.0
        best = (success, -loss) > (self.best_success, -self.best_loss)
        if best:
            self.best_epoch, self.best_success, self.best_loss = self.epoch, success, loss
        cut = self._plateau(success, loss, experiment)
        patience = experiment.training.early_stopping_patience
        if patience is not None and self.epoch - self.best_epoch >= patience:
            self.stopped = f"no better validation success for {patience} epochs"
        limit = experiment.schedule.stop_after_cuts
        if cut and limit is not None and self.cuts == limit:
            cut, self.stopped = False, f"no improvement after {limit} cuts of the learning rate"
        self.cuts += cut
        return Verdict(best, cut, self.stopped)

    def _plateau(self, success: float, loss: float, experiment: Experiment) -> bool:
        """Whether what the schedule monitors has stood still for too long.

        The rule is that of ``torch.optim.lr_scheduler.ReduceLROnPlateau``.
        """
        schedule = experiment.schedule
        if schedule.kind != "plateau":
            return False
        if schedule.monitor == "loss":
            # A loss with learned weights may be negative, where a share of it points the other way.
            share = 1 - math.copysign(_THRESHOLD, self.reference or 1.0)
            value, better = loss, self.reference is None or loss < self.reference * share
        else:
            value = success
            better = self.reference is None or success > self.reference + _THRESHOLD
        if better:
            self.reference, self.bad_epochs = value, 0
        else:
            self.bad_epochs += 1
        if self.bad_epochs <= schedule.patience:
            return False
        self.bad_epochs = 0
        return True
