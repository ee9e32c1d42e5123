"""Can each network memorise eight scenes, and each head its task?

A network, a loss or a sample that is wired wrongly learns something anyhow; memorising a handful of
scenes completely is what it does not. Each network of the registry is trained on eight drawn scenes
(no validation, nothing moved) until the best grasp of every scene is right, at an overlap above
0.25 and an angle within 30 degrees, and the loss is below a share of that of empty maps. Then
GG-CNN2 learns each task beside grasping, with a hundredth of the loss for the grasps, until the
task's loss is below a fifth of that of zeros everywhere; from several seeds, since the category
head, which sees the picture through one channel and a ReLU, often starts dead and sometimes stays
so.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from graspmap.data import Store, open_store
from graspmap.geometry import Grasps
from graspmap.losses import Targets
from graspmap.maps import GraspMaps, find_grasps
from graspmap.metrics import best_overlap
from graspmap.networks import NETWORKS, GraspNetwork, parameter_count
from graspmap.training import Experiment
from graspmap.training.data import Draw, Samples, collate, greatest_opening
from graspmap.training.scores import TaskScores
from graspmap.training.targets import batch_targets
from graspmap.training.tasks import make_experiment_network, make_loss
from studies._drawn import SHAPES, DrawnScenes
from studies._report import table, write

ABOUT = "every network memorises eight scenes, every head its task"

_RIGHT = 0.25
_LEARNED = 0.2
"""Share of the loss of zeros everywhere below which a head has learned."""
_BETAS = (0.9, 0.95)
"""Of Adam. The maps of a fresh GR-ConvNet are large, and with the usual 0.999 its first gradients
would slow it down for a thousand steps."""
_TASKS = {
    "category": {},
    "saliency": {"loss": "bce_cel"},
    "depth": {},
    "graspness": {},
    "orientation": {},
}


@dataclass(frozen=True)
class Run:
    """What is memorised, and how."""

    experiment: Experiment
    store: Store
    device: str
    steps: int
    rate: float
    near: float
    every: int = 10


def run(
    *, networks: tuple[str, ...] = tuple(NETWORKS), heads: bool = True, scenes: int = 8,
    size: int = 48, steps: int = 800, rate: float = 1e-3, near: float = 0.05,
    channels: str = "rgbd", bins: int = 1, filters: int | None = None, seed: int = 0,
    seeds: int = 3, threads: int = 2, device: str = "cpu", out: Path | None = None,
) -> None:  # fmt: skip
    """Memorise scenes.

    Args:
        networks: Names; those that need a task get saliency.
        heads: Also each task on GG-CNN2.
        scenes: How many; one batch.
        size: Side of the input, pixels.
        steps: At most so many steps.
        rate: Learning rate of Adam.
        near: Share of the loss of empty maps below which the loss is near 0.
        channels: What the networks see.
        bins: Orientation bins.
        filters: Of the networks that leave them open; the published ones where None. With 16 the
            run takes a third of the time.
        seed: Of the scenes and the weights.
        seeds: Weights that each head is tried with.
        threads: Of PyTorch on the processor.
        device: Of PyTorch.
        out: Folder for ``overfit.json``.
    """
    torch.set_num_threads(threads)
    rows: dict[str, dict[str, Any]] = {}
    task_rows: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        store = open_store(DrawnScenes(scenes, seed, size), folder, size=size)
        for name in networks:
            tasks = {"saliency": _TASKS["saliency"]} if NETWORKS[name].needs_task else {}
            width = None if NETWORKS[name].published_filters is None else filters
            values = {"name": name, "channels": channels, "bins": bins, "filters": width}
            experiment = _experiment(values, size, seed, tasks, {})
            rows[name] = _memorise(Run(experiment, store, device, steps, rate, near))
            _tell(name, rows[name])
        for task, options in _TASKS.items() if heads else ():
            loss = {"weighting": "fixed", "grasp_share": 0.01}
            # Depth has to be learned from colour, and orientation between bins.
            values = {"name": "ggcnn2", "channels": "rgb", "bins": 3}
            runs = []
            for number in range(seed, seed + seeds):
                experiment = _experiment(values, size, number, {task: options}, loss)
                runs.append(Run(experiment, store, device, steps, rate, _LEARNED, every=25))
            task_rows[task] = _learn(runs)
            _tell(task, task_rows[task])
    if rows:
        table(["network", *next(iter(rows.values()))], [[n, *r.values()] for n, r in rows.items()])
    if task_rows:
        columns = ["head", *next(iter(task_rows.values()))]
        table(columns, [[n, *r.values()] for n, r in task_rows.items()])
    write(out, "overfit", {"seed": seed, "size": size, "networks": rows, "heads": task_rows})


def _experiment(network: Any, size: int, seed: int, tasks: Any, loss: Any) -> Experiment:
    return Experiment.model_validate(
        {
            "seed": seed,
            "network": network,
            "tasks": tasks,
            "loss": loss,
            "data": {"source": "drawn:", "size": size},
        }
    )


def _memorise(work: Run) -> dict[str, Any]:
    """Train until every scene's best grasp is right and the loss is near 0."""
    network, batch, truth, scale = _prepare(work)
    loss = make_loss(work.experiment)
    zeros = GraspMaps(*(torch.zeros_like(m) for m in truth.maps))
    empty = float(loss.grasp(zeros, truth.maps).total)
    optimiser = torch.optim.Adam(network.parameters(), lr=work.rate, betas=_BETAS)
    success, share, step, began = 0.0, 1.0, 0, time.perf_counter()
    while step < work.steps and not (success == 1.0 and share < work.near):
        for _ in range(work.every):
            _step(network, loss, optimiser, batch, truth)
        step += work.every
        with torch.inference_mode():
            outputs = network.eval().outputs(batch)
            share = float(loss.grasp(outputs.maps, truth.maps).total) / empty
        success = _success(outputs.decoded(), work.store, scale)
    return {
        "parameters": parameter_count(network),
        "steps": step,
        "seconds": round(time.perf_counter() - began, 1),
        "success": success,
        "loss / empty": share,
        "memorised": success == 1.0 and share < work.near,
    }


def _learn(runs: Sequence[Run]) -> dict[str, Any]:
    """Train a task beside grasping from several seeds, each until its loss is near 0."""
    began, shares, steps, metrics = time.perf_counter(), [], [], []
    for work in runs:
        network, batch, truth, _ = _prepare(work)
        (task,), loss = work.experiment.tasks.names, make_loss(work.experiment)
        optimiser = torch.optim.Adam(network.parameters(), lr=work.rate, betas=_BETAS)
        share, step, scores = 1.0, 0, TaskScores(())
        while step < work.steps and share >= work.near:
            for _ in range(work.every):
                _step(network, loss, optimiser, batch, truth)
            step += work.every
            scores = TaskScores((task,), work.device)
            with torch.inference_mode():
                maps, said = network.eval().outputs(batch)
                scores.add(said, truth)
                nothing = {task: torch.zeros_like(said[task])}
                now, empty = (loss(maps, s, truth).tasks[task] for s in (said, nothing))
            share = float(now / empty)
        shares.append(share)
        steps.append(step)
        metrics.append(next(iter(scores.means().values()), float("nan")))
    return {
        "learned": f"{sum(s < w.near for s, w in zip(shares, runs, strict=True))} of {len(runs)}",
        "seconds": round(time.perf_counter() - began, 1),
        "steps": " ".join(map(str, steps)),
        "loss / empty": " ".join(f"{s:.3f}" for s in shares),
        "metric": " ".join(f"{m:.3g}" for m in metrics),
    }


def _prepare(work: Run) -> tuple[GraspNetwork, Tensor, Targets, float]:
    """Network, inputs (B, C, S, S), truth, and the width scale in px."""
    indices = range(len(work.store))
    scale = greatest_opening(work.store, indices)
    samples = Samples(work.store, work.experiment, scale, work.experiment.tasks.names, SHAPES)
    moved = {k: v.to(work.device) for k, v in collate([samples[Draw(i)] for i in indices]).items()}
    torch.manual_seed(work.experiment.seed)  # for dropout
    generator = torch.Generator().manual_seed(work.experiment.seed)
    network = make_experiment_network(work.experiment, len(SHAPES), generator=generator)
    return network.to(work.device), moved["input"], batch_targets(moved), scale


def _step(network: GraspNetwork, loss: Any, optimiser: Any, batch: Tensor, truth: Targets) -> None:
    optimiser.zero_grad()
    loss(*network.train().outputs(batch), truth).total.backward()
    optimiser.step()


def _success(maps: GraspMaps[Tensor], store: Store, scale: float) -> float:
    """Share of scenes whose best grasp is right."""
    arrays = GraspMaps(*(m.float().cpu().numpy() for m in maps))
    right = []
    for i in range(len(store)):
        best = find_grasps(arrays.item(i), 1, width_scale=scale)
        overlap = best_overlap(best, store.read_grasps(i) or Grasps.empty())
        right.append(bool(len(overlap)) and float(overlap[0]) > _RIGHT)
    return float(np.mean(right))


def _tell(name: str, row: dict[str, Any]) -> None:
    print(f"{name}: " + ", ".join(f"{key} {value}" for key, value in row.items()), flush=True)
