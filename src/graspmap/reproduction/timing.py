"""How long networks take: to find a grasp, and to train."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from graspmap.data.scene import Scene
from graspmap.evaluation.latency import TOTAL, measure_latency
from graspmap.inference import Detector, WeightsCard
from graspmap.inference.threads import threads_of
from graspmap.networks import parameter_count
from graspmap.reproduction.facts import part_sizes
from graspmap.reproduction.plan import Plan, Run
from graspmap.training import Experiment
from graspmap.training.tasks import make_experiment_network

_REPEATS, _SECONDS = 30, 8.0
"""Detections that are timed, or for how long at most."""
_STEP_PX, _STEP_PICTURES = 128, 2
"""A training step is timed on so small a batch, and scaled by its pixels."""


def count_parameters(experiment: Experiment, classes: int = 2) -> int:
    """Parameters of an experiment's network, heads of tasks included.

    Args:
        experiment: The experiment.
        classes: Number of classes of a category task.
    """
    with torch.device("meta"):
        return parameter_count(make_experiment_network(experiment, classes))


def time_detection(experiment: Experiment, device: str = "cpu") -> dict[str, float]:
    """How long the network of an experiment takes for one picture of its input size.

    The weights are random: they do not change the time. Heads of tasks that only help to learn are
    left out, as at every detection.

    Args:
        experiment: Network, channels, bins and input size.
        device: Where it runs.

    Returns:
        ``parameters`` of the network without tasks; ``network_ms`` from prepared input to maps and
        ``grasp_ms`` from picture to best grasp: medians in milliseconds.
    """
    bare = experiment.model_copy(update={"tasks": type(experiment.tasks)()})
    if experiment.network.name.startswith("mtgcnn"):
        bare = experiment  # there is none without a task
    network = make_experiment_network(bare, generator=torch.Generator().manual_seed(0)).eval()
    values, size = experiment.network, experiment.data.size
    card = WeightsCard(
        network=values.name,
        channels=values.channels,
        bins=values.bins,
        size=size,
        width_scale_px=size / 2,
        tasks=network.tasks,
        filters=values.filters,
    )
    detector = Detector(network, card, device=device)
    rng = np.random.default_rng(0)
    picture = Scene(
        "noise",
        rgb=rng.integers(0, 256, (size, size, 3)).astype(np.uint8),
        depth=rng.uniform(0.5, 0.6, (size, size)).astype(np.float32),
    )
    latency = measure_latency(
        detector, picture, threads=torch.get_num_threads(), repeats=_REPEATS, seconds=_SECONDS
    )
    return {
        "parameters": float(parameter_count(network)),
        "network_ms": latency.percentile_ms("forward", 50),
        "grasp_ms": latency.percentile_ms(TOTAL, 50),
    }


@dataclass(frozen=True)
class StepTime:
    """Time of a training step on this machine.

    Attributes:
        train_s: Forward and backward pass, per picture of the full input size.
        look_s: Forward pass alone, per picture.
        step_s: The optimiser's part of a step.
    """

    train_s: float
    look_s: float
    step_s: float


def time_step(experiment: Experiment, classes: int, device: str, threads: int) -> StepTime:
    """Time one training step of an experiment's network, on a small batch of noise."""
    where = "cpu" if device == "cpu" else "cuda"
    network = make_experiment_network(experiment, classes).to(where)
    side = min(experiment.data.size, _STEP_PX)
    images = torch.randn(_STEP_PICTURES, network.channels, side, side, device=where)
    optimiser = torch.optim.Adam(network.parameters())
    with threads_of(threads):
        for _ in range(2):  # the first one warms up
            start = time.perf_counter()
            with torch.no_grad():
                network.outputs(images)
            looked = _now(where)
            maps, tasks = network.outputs(images)
            total = sum(part.square().mean() for part in (*maps, *tasks.values()))
            assert isinstance(total, torch.Tensor)
            total.backward()  # type: ignore[no-untyped-call]
            trained = _now(where)
            optimiser.step()
            stepped = _now(where)
            optimiser.zero_grad()
    full = (experiment.data.size / side) ** 2 / _STEP_PICTURES
    return StepTime((trained - looked) * full, (looked - start) * full, stepped - trained)


def _now(device: str) -> float:
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


@dataclass(frozen=True)
class Estimate:
    """What a run costs.

    Attributes:
        parameters: Of its network.
        steps: Training steps.
        seconds: Rough time; reading data and simulated trials are not in it.
    """

    parameters: int
    steps: int
    seconds: float


def estimate(plan: Plan, device: str, threads: int) -> Mapping[str, Estimate]:
    """What each run of a plan costs on this machine, by the run.

    One training step of each different network is timed; a run takes its steps and its passes over
    the validation part (each epoch) and the test part (once).
    """
    assert plan.facts is not None  # tables without data have no runs
    times: dict[str, tuple[int, StepTime]] = {}
    found = {}
    for run in plan.runs:
        values = run.experiment
        key = f"{values.network} {values.tasks} {values.data.size} {values.optimiser.name}"
        if key not in times:
            classes = plan.facts.classes(values)
            step = time_step(values, classes, device, threads)
            times[key] = count_parameters(values, classes), step
        found[run.id] = _cost(plan, run, *times[key])
    return found


def _cost(plan: Plan, run: Run, parameters: int, step: StepTime) -> Estimate:
    assert plan.facts is not None
    training = run.experiment.training
    train, validation = part_sizes(run.experiment, plan.facts, plan.parts)
    batches = training.batches_per_epoch or -(-round(train) // training.batch_size)
    steps = training.epochs * batches
    looked = (training.epochs + 2) * validation
    seconds = steps * (training.batch_size * step.train_s + step.step_s) + looked * step.look_s
    return Estimate(parameters, steps, seconds)
