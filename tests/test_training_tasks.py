"""Tasks beside grasping in training: their truth, their metrics, resuming, what is refused."""

from __future__ import annotations

import csv
import json
import logging
import math
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from graspmap.data import Scene, make_split, open_store, read_scenes, read_split, write_jacquard
from graspmap.errors import ConfigError, FileError, GraspmapError, InvalidInputError
from graspmap.evaluation import evaluate_detector
from graspmap.geometry import Grasps
from graspmap.geometry.affine import rotation
from graspmap.inference import Detector, load_weights
from graspmap.losses import UNKNOWN, Targets
from graspmap.maps import draw_maps
from graspmap.training import Experiment, callbacks, train
from graspmap.training.data import Draw, Samples, collate, make_sample
from graspmap.training.scores import TaskScores
from graspmap.training.state import RunState
from graspmap.training.targets import batch_targets, task_targets
from graspmap.training.tasks import make_experiment_network, make_loss

# The bits of a sum depend on how many threads share it.
pytestmark = pytest.mark.usefixtures("one_thread")

SIDE = 32
ALL_TASKS = {
    "category": {"labels": "specific"},
    "saliency": {"loss": "bce_cel"},
    "depth": {"loss": "smooth_l1"},
    "graspness": {},
    "orientation": {},
}


def thing(object_id: int, view: int, *, holes: bool = True) -> tuple[Scene, dict[str, str]]:
    """A bar or a disc on a table, with labels across it and its class names."""
    rng = np.random.default_rng((9, object_id, view))
    center, width = rng.uniform(12, 19, 2), 7.0
    mask = np.zeros((SIDE, SIDE), np.uint8)
    bar = object_id % 2 == 0
    if bar:
        cv2.rectangle(mask, (int(center[0]) - 3, 3), (int(center[0]) + 3, 28), 1, -1)
    else:
        cv2.circle(mask, (int(center[0]), int(center[1])), 6, 1, -1)
    rgb = rng.integers(30, 60, (SIDE, SIDE, 3)).astype(np.uint8)
    rgb[mask > 0] = (200, 60, 40) if bar else (40, 90, 200)
    depth = np.where(mask > 0, 0.5, 0.6).astype(np.float32)
    if holes:
        depth[2:5, 20:26] = np.nan
    grasps = Grasps(center[None], np.zeros(1), np.array([width + 5]), np.array([4.0]))
    name = f"{object_id:04d}"
    scene = Scene(f"{view}_{name}", rgb, depth, mask > 0, grasps, object_id=name)
    return scene, {"specific": "bar" if bar else "disc", "general": "thing"}


def write_things(root: Path, objects: int, views: int = 3, *, labels: bool = True) -> Path:
    for object_id in range(objects):
        for view in range(views):
            scene, names = thing(object_id, view)
            picture = write_jacquard(scene, root)
            if labels:
                record = {"objects": [{"id": "x", "labels": names}]}
                (picture.parent / f"{scene.id}_scene.json").write_text(json.dumps(record))
    return root


@pytest.fixture(scope="module")
def things(tmp_path_factory):
    return write_things(tmp_path_factory.mktemp("things"), 6)


@pytest.fixture(scope="module")
def experiment(things, cache):
    """Everything that could go wrong on resuming: dropout, batch norm, learned weights."""
    return Experiment.model_validate(
        {
            "name": "things",
            "network": {"name": "grconvnet2", "channels": "rgb", "bins": 2, "filters": 4},
            "tasks": ALL_TASKS,
            "loss": {"weighting": "uncertainty"},
            "data": {
                "source": f"jacquard:{things}",
                "size": SIDE,
                "split": {"train": 0.5, "validation": 0.25, "test": 0.25},
                "cache_dir": str(cache),
            },
            "training": {"epochs": 2, "batch_size": 4, "checkpoint_minutes": 0, "device": "cpu"},
        }
    )


def change(experiment: Experiment, **values) -> Experiment:
    """A copy with values replaced by dotted key, dots written as two underscores."""
    content = experiment.model_dump()
    for key, value in values.items():
        *sections, last = key.split("__")
        inner = content
        for section in sections:
            inner = inner[section]
        inner[last] = value
    return Experiment.model_validate(content)


@pytest.fixture(scope="module")
def whole_run(experiment, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    return out, train(experiment, out)


def rows(out: Path) -> list[dict[str, float]]:
    """The logged rows without what the clock says."""
    found = callbacks.read_rows(out / "metrics.jsonl")
    return [{k: v for k, v in row.items() if k != "seconds"} for row in found]


# A run.


def test_metrics_of_every_task_are_logged(whole_run, experiment):
    out, _ = whole_run
    last = rows(out)[-1]
    for name in (*ALL_TASKS, "loss", "quality"):
        assert math.isfinite(last[f"train_{name}"])
        assert math.isfinite(last[f"validation_{name}"])
    for name in ("saliency_mae", "depth_mae", "category_accuracy"):
        assert 0 <= last[name] <= 1
    weights = {k: v for k, v in last.items() if k.startswith("uncertainty_")}
    assert list(weights) == [f"uncertainty_{n}" for n in ("grasp", *ALL_TASKS)]
    assert all(v == 0 for k, v in rows(out)[0].items() if k in weights)
    assert all(v != 0 for v in weights.values())
    with (out / "metrics.csv").open() as file:
        assert tuple(next(csv.reader(file))) == callbacks.columns(experiment)
    assert set(last) <= set(callbacks.columns(experiment))


def test_the_logged_loss_is_that_of_the_formula(whole_run):
    """sum exp(-s) l + s with the s of the row, which validation used."""
    for row in rows(whole_run[0]):
        grasp = 2 * sum(row[f"validation_{n}"] for n in ("quality", "cos", "sin", "width"))
        losses = {"grasp": grasp, **{n: row[f"validation_{n}"] for n in ALL_TASKS}}
        s = {n: row[f"uncertainty_{n}"] for n in losses}
        total = sum(math.exp(-s[n]) * value + s[n] for n, value in losses.items())
        assert row["validation_loss"] == pytest.approx(total, rel=1e-5)


def test_the_card_says_what_was_learned_and_how_well(whole_run, experiment):
    out, card = whole_run
    network, stored = load_weights(out / "weights.safetensors")
    assert stored == card
    assert [task.name for task in network.tasks] == list(ALL_TASKS)
    assert card.filters == 4
    assert card.data.classes == ("bar", "disc")
    found = card.metrics["test"]
    assert {"saliency_mae", "depth_mae", "category_accuracy", "loss"} <= found.keys()
    scenes = read_scenes(experiment.data.source)
    split = read_split(out / "split.json")
    names = {
        part: [scenes[scenes.index(i)].labels["specific"] for i in ids]
        for part, ids in split.parts.items()
    }
    most = found["category_majority"]
    assert most["class"] in names["train"]
    share = {p: names[p].count(most["class"]) / len(names[p]) for p in ("train", "test")}
    assert share["train"] >= 0.5
    assert (most["train_share"], most["test_share"]) == (share["train"], share["test"])


def test_the_test_of_a_run_is_that_of_the_detector(whole_run, experiment):
    """Weights with tasks load and detect, with graspness and orientation at work."""
    out, card = whole_run
    scenes = read_scenes(experiment.data.source)
    test = read_split(out / "split.json").subset(scenes, "test")
    detector = Detector.load(out / "weights.safetensors")
    result = evaluate_detector(detector, test)
    assert card.metrics["test"]["miou"] == pytest.approx(result.score.miou, abs=1e-6)
    network, _ = load_weights(out / "weights.safetensors")
    store = open_store(scenes, experiment.data.cache_dir, size=SIDE)
    picture = Samples(store, experiment, 10.0)[Draw(0)]["input"]
    with torch.inference_mode():
        said = network.outputs(torch.from_numpy(picture[None]))
    maps = detector.predict(picture[None])
    expected = said.maps.quality * said.tasks["graspness"].sigmoid()
    expected = expected * said.tasks["orientation"].sigmoid()
    assert np.allclose(maps.quality, expected.numpy(), atol=1e-6)


@pytest.mark.parametrize("stop_at", [(1, 2), (2, 1)])
def test_a_run_that_was_stopped_goes_on_to_the_same_bits(experiment, whole_run, tmp_path, stop_at):
    @contextmanager
    def progress(title):
        def update(done, total):
            if title.startswith(f"epoch {stop_at[0]}") and done == stop_at[1]:
                raise KeyboardInterrupt

        yield update

    with pytest.raises(KeyboardInterrupt):
        train(experiment, tmp_path, progress=progress)
    train(experiment, tmp_path)
    assert rows(tmp_path) == rows(whole_run[0])
    one, other = (load_weights(p / "weights.safetensors") for p in (tmp_path, whole_run[0]))
    assert one[1].metrics == other[1].metrics
    for name, tensor in one[0].state_dict().items():
        assert torch.equal(tensor, other[0].state_dict()[name]), name
    first, second = (
        callbacks.load_checkpoint(p / "checkpoints" / "last.ckpt") for p in (tmp_path, whole_run[0])
    )
    name = "_loss.weighting.log_variances"
    assert first["state_dict"][name].abs().min() > 0
    assert torch.equal(first["state_dict"][name], second["state_dict"][name])


def test_learned_weights_do_not_decay(experiment):
    from graspmap.training.module import GraspModule

    decaying = change(experiment, optimiser__weight_decay=0.1)
    module = GraspModule(
        make_experiment_network(decaying), decaying, RunState(), store=None, width_scale_px=1.0
    )
    groups = module.configure_optimizers().param_groups
    assert [g["weight_decay"] for g in groups] == [0.1, 0.0]
    assert [p.shape for p in groups[1]["params"]] == [(6,)]


def test_a_negative_loss_that_stands_still_is_no_improvement():
    values = {"data": {"source": "x"}, "schedule": {"patience": 0}}
    experiment, state = Experiment.model_validate(values), RunState()
    cuts = [state.end_epoch(0.0, loss, experiment).cut for loss in (-1.0, -1.0, -1.1, -1.10001)]
    assert cuts == [False, True, False, True]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("mtgcnn-c", {"saliency": {"loss": "mse"}}),
        ("mtgcnn-a", {"category": {"labels": "specific"}}),
        ("ggcnn", {"depth": {"loss": "mse"}, "saliency": {"loss": "bce"}}),
    ],
)
def test_any_network_learns_any_task(experiment, tmp_path, name, values):
    one = change(
        experiment,
        network__name=name,
        network__filters=None,
        network__channels="depth" if "depth" not in values else "rgb",
        tasks=values,
        loss__weighting="fixed",
        loss__grasp_share=0.25,
        training__epochs=1,
    )
    card = train(one, tmp_path)
    assert [task.name for task in card.tasks] == list(one.tasks.names)
    last = rows(tmp_path)[-1]
    grasp = 2 * sum(last[f"validation_{n}"] for n in ("quality", "cos", "sin", "width"))
    tasks = sum(last[f"validation_{n}"] for n in values)
    assert last["validation_loss"] == pytest.approx(0.25 * grasp + 0.75 * tasks, rel=1e-5)
    assert not any(key.startswith("uncertainty") for key in last)


# The truth.


@pytest.fixture(scope="module")
def store(things, cache):
    return open_store(read_scenes(f"jacquard:{things}"), cache, size=SIDE)


def test_the_truth_of_a_scene_that_is_not_moved(store, experiment, things):
    samples = Samples(store, experiment, 10.0, tuple(ALL_TASKS), ("bar", "disc"))
    sample, scene = samples[Draw(4)], read_scenes(f"jacquard:{things}")[4]
    assert (sample["mask"][0] == scene.mask).all()
    assert sample["inside"].all()
    assert (sample["depth_known"][0] == np.isfinite(scene.depth)).all()
    depth = change(experiment, network__channels="depth")
    assert np.array_equal(sample["depth"], make_sample(store[4], np.eye(3), depth, 10.0)["input"])
    assert sample["class"] == ("bar", "disc").index(scene.labels["specific"])
    assert sample["depth"].dtype == np.float32
    assert sample["mask"].dtype == sample["depth_known"].dtype == bool


def test_the_truth_moves_with_the_picture(store, experiment):
    turn = np.round(rotation(np.pi / 2, ((SIDE - 1) / 2, (SIDE - 1) / 2)))
    tasks = ("saliency", "depth")
    still, turned = (task_targets(tasks, store, 0, m) for m in (np.eye(3), turn))
    for name in ("mask", "inside", "depth_known"):
        assert (np.rot90(still[name], axes=(1, 2)) == turned[name]).all(), name
    assert np.allclose(np.rot90(still["depth"], axes=(1, 2)), turned["depth"], atol=1e-6)
    assert not still["depth_known"].all()


def test_nothing_is_known_beside_the_picture(store):
    shift = np.array([[1.0, 0, 10], [0, 1, 0], [0, 0, 1]])
    found = task_targets(("saliency", "depth"), store, 0, shift)
    for name in ("inside", "depth_known", "mask"):
        assert not found[name][0, :, :10].any()
    assert found["inside"][0, :, 10:].all()
    assert np.isfinite(found["depth"]).all()


def test_a_class_that_is_not_known(store):
    found = task_targets(("category",), store, 0, np.eye(3), label="general", classes=("other",))
    assert found == {"class": UNKNOWN}
    assert task_targets(("graspness", "orientation"), store, 0, np.eye(3)) == {}


def test_a_scene_without_what_a_task_needs_is_named(tmp_path):
    scene = thing(0, 0)[0]
    write_jacquard(Scene(scene.id, scene.rgb, grasps=scene.grasps), tmp_path / "a")
    bare = open_store(read_scenes(f"jacquard:{tmp_path / 'a'}"), tmp_path / "cache", size=SIDE)
    for task, picture in (("saliency", "mask"), ("depth", "depth")):
        with pytest.raises(InvalidInputError, match=f"{picture} of scene 0_0000"):
            task_targets((task,), bare, 0, np.eye(3))


def test_scores_are_means_over_pictures_and_their_known_pixels():
    rng = np.random.default_rng(3)
    shape = (3, 1, 4, 5)
    said = {
        "saliency": torch.from_numpy(rng.normal(size=shape)),
        "depth": torch.from_numpy(rng.normal(size=shape)),
        "category": torch.tensor([[0.1, 0.9], [0.8, 0.2], [0.3, 0.7]]),
        "graspness": torch.zeros(shape),
    }
    known = torch.from_numpy(rng.random(shape) < 0.6)
    nothing = known.clone()
    nothing[1] = False
    mask, depth = (
        torch.from_numpy(rng.random(shape) < 0.5),
        torch.from_numpy(rng.normal(size=shape)),
    )
    truth = Targets(None, mask, known, depth, nothing, torch.tensor([1, UNKNOWN, 0]))
    scores = TaskScores(tuple(said))
    scores.add(said, truth)
    found = scores.means()
    p = 1 / (1 + np.exp(-said["saliency"].numpy()))
    error = [abs(p - mask.numpy())[i][known[i].numpy()].mean() for i in range(3)]
    assert found["saliency_mae"] == pytest.approx(np.mean(error))
    error = [(said["depth"] - depth)[i][known[i]].abs().mean() for i in (0, 2)]
    assert found["depth_mae"] == pytest.approx(float(np.mean(error)))
    assert found["category_accuracy"] == 0.5
    assert set(found) == {"saliency_mae", "depth_mae", "category_accuracy"}
    assert math.isnan(TaskScores(("depth",)).means()["depth_mae"])


def test_counting_in_batches_gives_the_same_scores():
    rng = np.random.default_rng(4)
    said = {"depth": torch.from_numpy(rng.normal(size=(5, 1, 3, 3)))}
    depth = torch.from_numpy(rng.normal(size=(5, 1, 3, 3)))
    one, two = TaskScores(("depth",)), TaskScores(("depth",))
    one.add(said, Targets(None, depth=depth))
    for part in (slice(0, 2), slice(2, 5)):
        two.add({"depth": said["depth"][part]}, Targets(None, depth=depth[part]))
    assert one.means() == pytest.approx(two.means(), rel=1e-12)


# Label maps: everything that an experiment can ask for reaches the target.


@pytest.mark.parametrize("bins", [1, 3, 6])
@pytest.mark.parametrize(
    ("quality", "drop_off"),
    [("binary", 2.0), ("soft", 2.0), *(("strong", g) for g in (2.0, 1.0, 0.5, 0.25))],
)
def test_every_kind_of_label_map_reaches_the_target(store, experiment, quality, drop_off, bins):
    for overlap in ("best", "published"):
        for scale in (150.0, 12.0):
            maps = {"quality": quality, "drop_off": drop_off, "overlap": overlap}
            one = change(experiment, maps=maps, network__bins=bins)
            found = make_sample(store[0], np.eye(3), one, scale)["target"]
            expected = draw_maps(
                store[0].grasps, (SIDE, SIDE), bins=bins, **maps, width_scale=scale
            )
            assert np.array_equal(found, np.stack(list(expected)))
            assert found.any()


@pytest.mark.parametrize(
    ("maps", "bins"),
    [
        ({"quality": "strong", "drop_off": 0.25, "overlap": "published", "width_scale": 150.0}, 6),
        ({"quality": "soft", "overlap": "best", "width_scale": 12.0}, 3),
    ],
)
def test_training_with_other_label_maps_and_bins(experiment, tmp_path, maps, bins):
    one = change(
        experiment,
        maps=maps,
        network={"name": "ggcnn", "channels": "depth", "bins": bins},
        tasks={"orientation": {}},
        training__epochs=1,
    )
    card = train(one, tmp_path)
    assert card.bins == bins
    assert card.width_scale_px == maps["width_scale"]
    assert Detector.load(tmp_path / "weights.safetensors").card == card


# Other data to test on, and fewer to train on.


def test_another_data_set_to_test_on(experiment, tmp_path, caplog):
    other = write_things(tmp_path / "other", 3, views=1, labels=False)
    one = change(
        experiment,
        network={"name": "mtgcnn-d", "channels": "rgb"},
        tasks={"category": {}, "saliency": {}},
        loss__weighting="sum",
        data__test={"source": f"jacquard:{other}"},
        data__split={"train": 0.7, "validation": 0.3, "test": 0.0},
        training__epochs=1,
    )
    with caplog.at_level(logging.WARNING):
        card = train(one, tmp_path / "out")
    assert "no truth for category" in caplog.text
    assert card.data.test_source == f"jacquard:{other}"
    assert card.data.scenes["test"] == 3
    found = card.metrics["test"]
    assert found["scenes"] == 3
    assert 0 <= found["saliency_mae"] <= 1
    assert not {"category_accuracy", "category_majority", "loss"} & found.keys()
    result = evaluate_detector(
        Detector.load(tmp_path / "out" / "weights.safetensors"), read_scenes(f"jacquard:{other}")
    )
    assert found["miou"] == pytest.approx(result.score.miou, abs=1e-6)
    # The other data belong to the run: it does not go on when they change.
    write_jacquard(thing(7, 0)[0], other)
    with pytest.raises(FileError, match=r"changed since this run began \(test_store\)"):
        train(one, tmp_path / "out")
    limited = change(one, data__test={"source": f"jacquard:{other}", "limit_objects": 2})
    assert train(limited, tmp_path / "fewer").data.scenes["test"] == 2


def test_fewer_objects_to_train_on(experiment, tmp_path):
    few = change(
        experiment,
        network={"name": "ggcnn", "channels": "rgb"},
        tasks={},
        loss__weighting="sum",
        data__split={"train": 0.5, "validation": 0.25, "test": 0.25, "limit_objects": 2},
        training__epochs=0,
    )
    whole = change(few, data__split={"train": 0.5, "validation": 0.25, "test": 0.25})
    parts = []
    for name, one in (("few", few), ("whole", whole)):
        train(one, tmp_path / name)
        parts.append(read_split(tmp_path / name / "split.json").parts)
    assert parts[0]["validation"] == parts[1]["validation"]
    assert set(parts[0]["train"]) < set(parts[1]["train"])
    assert len({name.split("_")[1] for name in parts[0]["train"]}) == 2
    assert len(parts[0]["train"]) == 6
    train(few, tmp_path / "few")  # the limit is not applied to what is already limited
    with pytest.raises(ConfigError, match=r"data\.split\.limit_objects: is 99.* 1 to \d+, all"):
        train(change(few, data__split={"limit_objects": 99}), tmp_path / "many")


def test_a_split_without_a_training_part(experiment, tmp_path):
    path = tmp_path / "split.json"
    split = make_split(read_scenes(experiment.data.source))
    replace(split, parts={"test": split.parts["test"]}).write(path)
    problems = ("train part of the split has no", r"data\.split\.limit_objects: is 1, but")
    for name, limit, problem in zip(("all", "few"), (None, 1), problems, strict=True):
        one = change(experiment, data__split={"file": str(path), "limit_objects": limit})
        with pytest.raises(GraspmapError, match=problem):
            train(one, tmp_path / name)


# What is refused, before anything is trained.


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"tasks": {}}, r"loss\.weighting: is 'uncertainty', but there is no task"),
        ({"loss__grasp_share": 0.3}, r"loss\.grasp_share: is 0\.3, but"),
        ({"network__bins": 1}, r"tasks\.orientation: .* network\.bins is 1"),
        ({"network": {"name": "mtgcnn-a"}, "tasks": {}, "loss": {}}, "tasks of mtgcnn-a"),
        ({"network__name": "ggcnn"}, "filters of ggcnn"),
    ],
)
def test_contradictions_are_said_before_the_data_are_read(experiment, tmp_path, values, key):
    nowhere = change(experiment, data__source="jacquard:/nowhere", **values)
    with pytest.raises((ConfigError, InvalidInputError), match=key):
        train(nowhere, tmp_path)
    assert not list(tmp_path.iterdir())


def refusal(experiment: Experiment, out: Path, monkeypatch) -> str:
    """Of a run that is refused before its data are packed."""
    from graspmap.training import setup

    monkeypatch.setattr(setup, "open_store", pytest.fail)
    with pytest.raises(GraspmapError) as caught:
        train(experiment, out)
    return str(caught.value)


def test_truth_that_the_data_lack_is_named_before_packing(experiment, tmp_path, monkeypatch):
    root = tmp_path / "data"
    for object_id in range(4):
        scene = thing(object_id, 0)[0]
        write_jacquard(Scene(scene.id, scene.rgb, grasps=scene.grasps), root)
    for task, what in (
        ("saliency", "no mask, which tasks.saliency needs"),
        ("depth", "no depth picture, which tasks.depth needs"),
        ("category", "no specific class, which tasks.category needs"),
    ):
        one = change(
            experiment,
            data__source=f"jacquard:{root}",
            data__split={},
            tasks={task: {}},
        )
        assert what in refusal(one, tmp_path / task, monkeypatch)


def test_one_scene_without_the_truth_is_enough(experiment, tmp_path):
    root = write_things(tmp_path / "data", 6, views=1)
    (last,) = root.rglob("0_0005_mask.png")
    last.unlink()
    one = change(experiment, data__source=f"jacquard:{root}", data__split={})
    with pytest.raises(FileError, match=r"1 of 6 scenes have no mask, .* first 0_0005"):
        train(one, tmp_path / "out")


def test_one_class_is_nothing_to_tell_apart(experiment, tmp_path):
    one = change(experiment, tasks={"category": {"labels": "general"}})
    with pytest.raises(FileError, match=r"tasks\.category has nothing to tell apart.*'thing'"):
        train(one, tmp_path)


def test_depth_from_depth_is_warned_about(experiment, tmp_path, caplog):
    one = change(experiment, network__channels="depth", tasks={"depth": {}}, training__epochs=0)
    with caplog.at_level(logging.WARNING):
        train(one, tmp_path)
    assert "tasks.depth" in caplog.text


def test_other_tasks_are_another_experiment(experiment, whole_run):
    with pytest.raises(FileError, match=r"tasks\.graspness was \{\} and is now None"):
        train(change(experiment, tasks__graspness=None), whole_run[0])
    with pytest.raises(FileError, match=r"network\.bins was 2 and is now 3"):
        train(change(experiment, network__bins=3), whole_run[0])


def test_the_loss_is_the_one_that_the_experiment_names():
    values = {
        "data": {"source": "x"},
        "tasks": {"saliency": {"loss": "mse"}, "depth": {"loss": "smooth_l1"}, "category": {}},
        "loss": {"base": "smooth_l1", "weighting": "fixed", "grasp_share": 0.75},
    }
    text = repr(make_loss(Experiment.model_validate(values)))
    for part in (
        "GraspLoss(base='smooth_l1', positional='inside', width_expectile=0.5)",
        "SaliencyLoss(kind='mse')",
        "DepthLoss(kind='smooth_l1')",
        "CategoryLoss()",
        "FixedWeighting(share=0.75)",
    ):
        assert part in text


@pytest.fixture(scope="module")
def eight(cache, tmp_path_factory):
    """Eight scenes, two of each of four objects."""
    root = write_things(tmp_path_factory.mktemp("eight"), 4, views=2)
    return open_store(read_scenes(f"jacquard:{root}"), cache, size=SIDE)


@pytest.mark.parametrize("task", ALL_TASKS)
def test_every_head_learns_its_task_on_eight_scenes(experiment, eight, task):
    """Beside grasping, which has a tenth of the loss: its numbers are larger than depth's."""
    learned = change(
        experiment,
        network={"name": "ggcnn2", "channels": "rgb", "bins": 2},
        tasks={task: ALL_TASKS[task]},
        loss={"weighting": "fixed", "grasp_share": 0.1},
    )
    samples = Samples(eight, learned, 12.0, (task,), ("bar", "disc"))
    batch = collate([samples[Draw(i)] for i in range(8)])
    truth, loss = batch_targets(batch), make_loss(learned)
    torch.manual_seed(0)
    network = make_experiment_network(learned, 2)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3 if task == "category" else 3e-3)
    for _ in range(100):
        optimiser.zero_grad()
        loss(*network.outputs(batch["input"]), truth).total.backward()
        optimiser.step()
    scores, ignorant = TaskScores((task,)), TaskScores((task,))
    with torch.inference_mode():
        maps, said = network.eval().outputs(batch["input"])
        reached = float(loss(maps, said, truth).tasks[task])
    scores.add(said, truth)
    if task == "category":
        assert scores.means() == {"category_accuracy": 1.0}
    elif task == "saliency":
        assert scores.means()["saliency_mae"] < 0.02
    elif task == "depth":
        ignorant.add({"depth": torch.zeros_like(truth.depth)}, truth)  # the mean of each picture
        assert scores.means()["depth_mae"] < 0.5 * ignorant.means()["depth_mae"]
    else:
        graspable = truth.maps.quality > 0
        share = float((graspable.any(1) if task == "graspness" else graspable).double().mean())
        # Of saying that share everywhere:
        entropy = -(share * math.log(share) + (1 - share) * math.log(1 - share))
        assert reached < 0.5 * entropy


@pytest.mark.filterwarnings("ignore:.*bfloat16")
def test_other_processes_and_half_precision_learn_tasks_too(experiment, whole_run, tmp_path):
    short = change(experiment, training__epochs=1, training__checkpoint_minutes=60)
    train(change(short, training__workers=1), tmp_path / "workers")
    assert rows(tmp_path / "workers") == rows(whole_run[0])[:2]
    train(change(short, training__precision="bf16"), tmp_path / "half")
    half, full = (rows(out)[1]["train_loss"] for out in (tmp_path / "half", whole_run[0]))
    assert half != full
    assert half == pytest.approx(full, rel=0.05)


def test_the_command_tells_how_the_tasks_went(experiment, whole_run, tmp_path, capsys):
    from graspmap.cli import main

    out, card = whole_run
    path = tmp_path / "things.yaml"
    path.write_text(experiment.to_yaml(), encoding="utf-8")
    assert main(["train", str(path), "--out", str(out)]) == 0
    told = capsys.readouterr().out
    found = card.metrics["test"]
    assert f"category {found['category_accuracy']:.1%} right" in told
    assert f"by always saying {found['category_majority']['class']!r}" in told
    assert f"saliency off by {found['saliency_mae']:.3f}" in told
    assert f"depth off by {1000 * found['depth_mae']:.1f} mm" in told
    assert main(["train", str(path), "--out", str(out), "--tasks.saliency.los", "mse"]) == 2
    assert "did you mean tasks.saliency.loss?" in capsys.readouterr().err
