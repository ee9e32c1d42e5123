"""``python -m benchmarks``: print the table of speeds, ours against the usual tools.

With ``--json FILE`` the rows are written too; ``--only WORD`` runs the rows that contain it.
Real Jacquard scenes are used where GRASPMAP_TEST_DATA points to a folder that has them, otherwise
generated ones of the same size and format.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import torch

from benchmarks import simulation, usual
from benchmarks.timing import Comparison, compare
from graspmap import Grasps, Scenes, draw_maps, find_grasps, read_scenes
from graspmap.data import input_window, open_store
from graspmap.geometry import affine
from graspmap.losses import GraspLoss
from graspmap.maps import GraspMaps
from graspmap.metrics import best_overlap
from graspmap.networks import NETWORKS, TaskSpec, make_network
from graspmap.training import Experiment
from graspmap.training.data import Draw, Samples, augmentation, collate, make_sample

SIDE = 300
WIDTH_SCALE = 150.0
Sample = dict[str, np.ndarray]


def scenes_of(folder: Path) -> tuple[Scenes, str]:
    """Jacquard scenes of 1024 px and what they are."""
    real = Path(os.environ.get("GRASPMAP_TEST_DATA", "../shared/data")) / "jacquard"
    if real.is_dir():
        return read_scenes(f"jacquard:{real}"), "real Jacquard scenes"
    from graspmap.generation import GenerationPlan, generate
    from graspmap.gripper import load_gripper

    generate(GenerationPlan(8, load_gripper("jacquard"), candidates=200), folder / "generated")
    return read_scenes(f"jacquard:{folder / 'generated'}"), "generated scenes"


def many_grasps(rng: np.random.Generator, count: int, side: int) -> Grasps:
    """Grasps of the sizes that Jacquard has, scaled to ``side``."""
    return Grasps(
        rng.uniform(0.2 * side, 0.8 * side, (count, 2)),
        rng.uniform(-np.pi / 2, np.pi / 2, count),
        rng.uniform(0.03, 0.18, count) * side,
        rng.uniform(0.015, 0.08, count) * side,
    )


class Work:
    """Training samples as `graspmap train` makes them, and the usual way."""

    def __init__(self, scenes: Scenes, folder: Path) -> None:
        self.scenes = scenes
        self.experiment = Experiment.model_validate(
            {
                "name": "bench",
                "network": {"name": "ggcnn2", "channels": "rgbd"},
                "data": {
                    "source": f"{scenes.kind}:{scenes.root}",
                    "size": SIDE,
                    "augment": {"rotation": "any", "zoom": (0.5, 1.0)},
                },
            }
        )
        store = open_store(scenes, folder, size=SIDE, view="contain")
        self.samples = Samples(store, self.experiment, WIDTH_SCALE)
        self.rng = np.random.default_rng(0)
        self.turn = 0

    def next(self) -> int:
        """Number of the next scene, round and round."""
        self.turn += 1
        return self.turn % len(self.scenes)

    def from_files(self) -> Sample:
        """Read, warp and draw one scene from its original files."""
        scene = self.scenes[self.next()]
        moved = augmentation(self.experiment).draw(self.rng, SIDE)
        matrix = moved @ input_window(scene.shape, SIDE, view="contain")
        return make_sample(scene, matrix, self.experiment, WIDTH_SCALE)

    def from_store(self) -> Sample:
        """Warp and draw one scene from the packed store."""
        return self.samples[Draw(self.next(), epoch=0, position=self.turn)]

    def usual(self) -> tuple[np.ndarray, np.ndarray]:
        """The same sample the usual way."""
        rgb = next(p for p in self.scenes.files(self.next()) if p.name.endswith("_RGB.png"))
        angle, zoom = self.rng.uniform(-np.pi, np.pi), self.rng.uniform(0.5, 1.0)
        return usual.sample(str(rgb).removesuffix("_RGB.png"), SIDE, angle, zoom)


def sample_rows(work: Work) -> Iterator[Comparison]:
    """One training sample."""
    yield compare(
        "sample: RGB-D 300 px from the original files, augmented, maps drawn",
        work.from_files, work.usual, seconds=6, budget_ms=30, budget_ratio=14,
    )  # fmt: skip
    yield compare(
        "sample: the same from the packed store",
        work.from_store, work.usual, seconds=6, budget_ms=2,
    )  # fmt: skip


def map_rows() -> Iterator[Comparison]:
    """Drawing and decoding."""
    rng = np.random.default_rng(1)
    grasps = many_grasps(rng, 100, 320)
    rows = [
        (float(x), float(y), float(a), float(w), float(h))
        for (x, y), a, w, h in zip(
            grasps.center, grasps.angle, grasps.width, grasps.height, strict=True
        )
    ]
    for bins, quality, ms, ratio in ((1, "binary", 0.7, 20), (3, "strong", 0.9, 90)):
        yield compare(
            f"drawing: 100 grasps, 320 px, {bins} bin{'s' * (bins > 1)}, {quality}",
            lambda b=bins, q=quality: draw_maps(grasps, (320, 320), bins=b, quality=q),
            lambda b=bins: usual.draw_maps(rows, 320, b),
            budget_ms=ms, budget_ratio=ratio,
        )  # fmt: skip
    maps = draw_maps(many_grasps(rng, 20, SIDE), (SIDE, SIDE), quality="strong")
    noisy = GraspMaps(*(m + rng.normal(0, 0.02, m.shape).astype(np.float32) for m in maps))
    stacked = np.stack(list(noisy))
    yield compare(
        "decoding: best grasp, 300 px",
        lambda: find_grasps(noisy, 1), lambda: usual.find_grasp(stacked),
        budget_ms=0.65, budget_ratio=9,
    )  # fmt: skip


def metric_row(scenes: Scenes) -> Iterator[Comparison]:
    """The rectangle metric on one picture with about 100 labels."""
    all_labels = [scenes.read_grasps(i) for i in range(len(scenes))]
    labels = min((g for g in all_labels if g is not None), key=lambda g: abs(len(g) - 100))
    labels = labels.transformed(affine.zoom(320 / 1024))
    predicted = labels[len(labels) // 2].transformed(affine.rotation(0.1, labels.center[0]))
    yield compare(
        f"metric: one grasp against {len(labels)} labels",
        lambda: best_overlap(predicted, labels), lambda: usual.best_overlap(predicted, labels),
        budget_ms=0.04, budget_ratio=270,
    )  # fmt: skip


def network_rows(work: Work) -> Iterator[Comparison]:
    """Forward pass and training step of GG-CNN2."""
    plain = usual.PlainGGCNN2(4)
    ours = make_network("ggcnn2", 4, 1)
    x = torch.randn(1, 4, SIDE, SIDE)
    ours.eval()
    plain.eval()

    def forward(network: torch.nn.Module) -> None:
        with torch.inference_mode():
            network(x)

    yield compare(
        "forward: GG-CNN2, fp32, batch 1, 300 px",
        lambda: forward(ours), lambda: forward(plain), seconds=4, budget_ratio=1.5,
    )  # fmt: skip

    batch = 8
    ours.train()
    plain.train()
    optimisers = [torch.optim.Adam(n.parameters(), 1e-3) for n in (ours, plain)]
    loss = GraspLoss()

    def our_step() -> None:
        drawn = collate([work.from_store() for _ in range(batch)])
        inputs, target = drawn["input"], GraspMaps(*drawn["target"].unbind(1))
        optimisers[0].zero_grad()
        loss(ours(inputs), target).total.backward()
        optimisers[0].step()

    def usual_step() -> None:
        drawn = [work.usual() for _ in range(batch)]
        inputs = torch.from_numpy(np.stack([d[0] for d in drawn]))
        target = torch.from_numpy(np.stack([d[1][:, 0] for d in drawn]))
        optimisers[1].zero_grad()
        nn_loss = sum(
            torch.nn.functional.mse_loss(p, t)
            for p, t in zip(plain(inputs).unbind(1), target.unbind(1), strict=True)
        )
        nn_loss.backward()
        optimisers[1].step()

    yield compare(
        "training: GG-CNN2, RGB-D 300 px, a batch of 8, loading included",
        our_step, usual_step, seconds=20, budget_ms=8 / 9 * 1e3, budget_ratio=6,
    )  # fmt: skip


def layout_rows() -> Iterator[Comparison]:
    """Forward pass of every network: channels last in memory against channels first."""
    for name, kind in NETWORKS.items():
        tasks = [TaskSpec("saliency")] if kind.needs_task else []
        first, last = (make_network(name, 4, tasks=tasks).eval() for _ in range(2))
        first.memory_format = torch.contiguous_format
        first.to(memory_format=torch.contiguous_format)
        last.memory_format = torch.channels_last
        last.to(memory_format=torch.channels_last)
        side = kind.published_size_px
        x = torch.randn(1, 4, side, side)

        def forward(network: torch.nn.Module, x: torch.Tensor = x) -> None:
            with torch.inference_mode():
                network(x)

        yield compare(
            f"layout: {name}, fp32, batch 1, {side} px, channels last against first",
            lambda n=last: forward(n), lambda n=first: forward(n), seconds=4,
        )  # fmt: skip


def show(row: Comparison) -> str:
    """One line of the table."""
    budget = f"{row.budget_ms:g} ms" if row.budget_ms is not None else "-"
    gain = f"{row.budget_ratio:g}x" if row.budget_ratio is not None else "-"
    return (
        f"| {row.work} | {row.ours_ms:.3g} ms | {row.usual_ms:.3g} ms | {row.ratio:.1f}x "
        f"| {budget} | {gain} |"
    )


def main() -> None:
    """Run the rows and print them as they come."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the rows here")
    parser.add_argument("--only", default="", help="run the groups that contain this word")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    rows: list[Comparison] = []
    with tempfile.TemporaryDirectory() as folder:
        scenes, what = scenes_of(Path(folder))
        work = Work(scenes, Path(folder) / "store")
        print(f"{what}; {platform.machine()}, {os.cpu_count()} cores, torch {torch.__version__}\n")
        print("| work | graspmap | usual | gain | budget | budgeted gain |")
        print("|---|---|---|---|---|---|")
        groups = {
            "sample": lambda: sample_rows(work),
            "maps": map_rows,
            "metric": lambda: metric_row(scenes),
            "network": lambda: network_rows(work),
            "layout": layout_rows,
            "simulation": simulation.rows,
        }
        for name, group in groups.items():
            if arguments.only not in name:
                continue
            for row in group():
                rows.append(row)
                print(show(row), flush=True)
    if arguments.json:
        table = [asdict(row) | {"ratio": row.ratio} for row in rows]
        arguments.json.write_text(json.dumps(table, indent=2) + "\n")


if __name__ == "__main__":
    main()
