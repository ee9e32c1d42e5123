"""Tasks beside grasping measured over scenes: against training's own scores, and known answers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from graspmap.data import Scene, fill_depth, open_store, read_scenes, write_jacquard
from graspmap.data.images import TABLE_UNIT_M
from graspmap.data.table import find_table
from graspmap.evaluation import evaluate_tasks
from graspmap.geometry import Grasps
from graspmap.inference import Detector
from graspmap.inference.weights import DataCard, WeightsCard
from graspmap.losses import Targets
from graspmap.networks import TaskSpec, make_network
from graspmap.networks.tasks import Outputs
from graspmap.training.data import collate
from graspmap.training.scores import TaskScores
from graspmap.training.targets import batch_targets, task_targets

pytestmark = pytest.mark.usefixtures("one_thread")

SIDE = 32
CLASSES = ("bar", "box", "disc")
TASKS = (TaskSpec("category", 3, SIDE), TaskSpec("saliency"), TaskSpec("depth"))


def write(root: Path, *, side: int = SIDE, masks: bool = True, labels: bool = True) -> Path:
    """Six scenes of three objects, two of class bar and one of class disc, with holes in depth."""
    rows, columns = np.mgrid[:side, :side]
    for index in range(6):
        rng, name = np.random.default_rng((5, index)), f"{index // 2:04d}"
        x, y = rng.uniform(0.35, 0.6, 2) * side
        mask = (abs(columns - x) < side / 6) & (abs(rows - y) < side / 5)
        depth = np.where(mask, 0.5, 0.6 + rows / side / 10).astype(np.float32)
        depth[2:5, 6:11] = np.nan
        rgb = rng.integers(0, 255, (side, side, 3)).astype(np.uint8)
        grasps = Grasps(np.array([[x, y]]), np.zeros(1), np.array([9.0]), np.array([4.0]))
        scene = Scene(
            f"{index}_{name}", rgb, depth, mask if masks else None, grasps, object_id=name
        )
        picture = write_jacquard(scene, root)
        if labels:
            names = {"specific": "bar" if index < 4 else "disc", "general": "thing"}
            record = {"objects": [{"id": "x", "labels": names}]}
            (picture.parent / f"{scene.id}_scene.json").write_text(json.dumps(record))
    return root


@pytest.fixture(scope="module")
def things(tmp_path_factory):
    return read_scenes(f"jacquard:{write(tmp_path_factory.mktemp('things'))}")


def detector_of(channels: str = "rgb", tasks=TASKS) -> Detector:
    count = {"depth": 1, "rgb": 3, "rgbd": 4}[channels]
    seed = torch.Generator().manual_seed(1)
    network = make_network("ggcnn2", count, 1, tasks=tasks, generator=seed)
    card = WeightsCard(
        network="ggcnn2", channels=channels, tasks=tasks, size=SIDE, width_scale_px=20,
        data=DataCard(source="here", classes=CLASSES),
    )  # fmt: skip
    return Detector(network, card)


def answering(monkeypatch, answers: dict[str, np.ndarray]) -> Detector:
    """A detector whose network answers scene after scene what it is told to."""
    detector, left = detector_of(), iter(range(100))

    def outputs(images):
        index = next(left)
        maps = detector.network(images)
        said = {k: torch.as_tensor(v[index], dtype=torch.float32)[None] for k, v in answers.items()}
        return Outputs(maps, said)

    monkeypatch.setattr(detector.network, "outputs", outputs)
    return detector


def truth(scenes) -> dict[str, np.ndarray]:
    """What a network that knows everything would say."""
    found: dict[str, list] = {"saliency": [], "depth": [], "category": []}
    for scene in scenes:
        filled = np.where(np.isfinite(scene.depth), scene.depth, 0.6)
        found["saliency"].append(np.where(scene.mask, 40.0, -40.0)[None])
        found["depth"].append(filled[None])
        found["category"].append([3.0 * (name == scene.labels["specific"]) for name in CLASSES])
    return {k: np.array(v) for k, v in found.items()}


def filled_mean(scene) -> float:
    """Mean depth in metres of the picture, its holes filled."""
    return float(fill_depth(scene.depth).mean(dtype=np.float64))


def test_means_are_those_that_training_reports(things, tmp_path):
    detector = detector_of()
    found = evaluate_tasks(detector, things)
    store = open_store(things, tmp_path / "cache", size=SIDE)
    names = tuple(task.name for task in TASKS)
    samples = [
        task_targets(names, store, i, np.eye(3), label="specific", classes=CLASSES)
        for i in range(len(store))
    ]
    inputs = np.stack([detector.prepare(s.rgb, s.depth).inputs for s in things])
    with torch.inference_mode():
        said = detector.network.outputs(torch.from_numpy(inputs)).tasks
    scores = TaskScores(names)
    batch = collate([{**s, "target": np.zeros((4, 1, SIDE, SIDE), np.float32)} for s in samples])
    scores.add(said, batch_targets(batch))
    expected = scores.means()
    assert found.saliency.mae == pytest.approx(expected["saliency_mae"], rel=1e-5)
    assert found.depth.mae_m == pytest.approx(expected["depth_mae"], rel=1e-4)
    assert found.category.accuracy == expected["category_accuracy"]


def test_who_knows_everything_scores_everything(things, monkeypatch):
    answers = truth(things)
    for index, scene in enumerate(things):  # a network's depth is relative to the picture's mean
        answers["depth"][index] -= filled_mean(scene)
    found = evaluate_tasks(answering(monkeypatch, answers), things)
    assert found.saliency.mae == pytest.approx(0, abs=1e-12)
    assert found.saliency.f_measure == found.saliency.f_adaptive == 1
    assert found.depth.mae_m == pytest.approx(0, abs=1e-6)
    assert found.depth.within_1_25 == 1
    assert found.category.accuracy == 1
    assert found.category.classes == CLASSES
    assert found.category.confusion == ((4, 0, 0), (0, 0, 0), (0, 0, 2))
    assert found.category.majority == pytest.approx(4 / 6)


def test_errors_come_out_in_metres_and_probabilities(things, monkeypatch):
    answers = truth(things)
    for index, scene in enumerate(things):
        answers["depth"][index] += 0.03 - filled_mean(scene)
    answers["depth"][:, :, 2:5, 6:11] = 77  # a hole: nobody knows
    answers["saliency"] = np.where(answers["saliency"] > 0, np.log(3), -np.log(3))
    answers["category"] = answers["category"][:, ::-1].copy()
    found = evaluate_tasks(answering(monkeypatch, answers), things)
    assert found.depth.mae_m == pytest.approx(0.03, abs=1e-6)
    assert found.depth.rmse_m == pytest.approx(0.03, abs=1e-6)
    assert found.saliency.mae == pytest.approx(0.25, abs=1e-6)  # sigmoid of log 3 is 3/4
    assert found.category.accuracy == 0


@pytest.mark.parametrize("off_m", [0.0, 0.02])
def test_depth_above_the_table_comes_out_in_metres(things, monkeypatch, off_m):
    """By its own way here: depth less that of the table, in units of 5 cm."""
    answers = truth(things)
    for index, scene in enumerate(things):
        table = find_table(scene.depth).depth_m(scene.depth.shape)
        answers["depth"][index] = (fill_depth(scene.depth) - table + off_m) / 0.05
    detector = answering(monkeypatch, answers)
    detector.card = detector.card.model_copy(update={"depth_zero": "table"})
    assert evaluate_tasks(detector, things).depth.mae_m == pytest.approx(off_m, abs=1e-5)
    scores = TaskScores(("depth",), depth_unit_m=TABLE_UNIT_M)
    said = torch.zeros(1, 1, SIDE, SIDE)
    known = torch.ones_like(said, dtype=torch.bool)
    apart = Targets(None, depth=said + off_m / 0.05, depth_known=known)
    scores.add({"depth": said}, apart)
    assert scores.means()["depth_mae"] == pytest.approx(off_m, abs=1e-6)


def test_pictures_of_other_sizes_are_compared_as_the_network_sees_them(tmp_path):
    scenes = read_scenes(f"jacquard:{write(tmp_path, side=48)}")
    detector = detector_of("rgbd")
    found = evaluate_tasks(detector, scenes, cluster="object")
    assert found.saliency.pictures == found.depth.pictures == found.category.pictures == 6
    assert (
        0 < found.saliency.mae_interval[0] <= found.saliency.mae <= found.saliency.mae_interval[1]
    )
    again = evaluate_tasks(detector, scenes, cluster="object")
    assert again.to_dict() == found.to_dict()
    alone = evaluate_tasks(detector, scenes)
    assert alone.depth.mae_m == found.depth.mae_m
    assert alone.depth.mae_m_interval != found.depth.mae_m_interval


def test_without_heads_or_truth_there_is_no_score(things, tmp_path):
    assert evaluate_tasks(detector_of(tasks=()), things).to_dict() == {}
    scenes = read_scenes(f"jacquard:{write(tmp_path, masks=False, labels=False)}")
    assert set(evaluate_tasks(detector_of(), scenes).to_dict()) == {"depth"}
    only = evaluate_tasks(detector_of(tasks=TASKS[1:2]), things)
    assert set(only.to_dict()) == {"saliency"}


def test_the_summary_is_json_and_progress_is_told(things):
    steps = []
    found = evaluate_tasks(detector_of(), things, progress=lambda *step: steps.append(step))
    assert steps == [(i + 1, 6) for i in range(6)]
    summary = json.loads(json.dumps(found.to_dict()))
    assert set(summary) == {"saliency", "depth", "category"}
    assert {"mae", "mae_interval", "f_measure"} <= summary["saliency"].keys()
    assert {"accuracy", "majority", "classes", "confusion"} <= summary["category"].keys()
