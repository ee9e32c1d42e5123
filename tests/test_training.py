"""Training: samples and order follow from the seed, resumed runs equal uninterrupted ones."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import graspmap
from graspmap.data import Scene, make_split, open_store, read_scenes, read_split, write_jacquard
from graspmap.errors import (
    ConfigError,
    FileError,
    FileFormatError,
    GraspmapError,
    StorageFullError,
    UnknownNameError,
)
from graspmap.evaluation import evaluate_detector
from graspmap.geometry import Grasps
from graspmap.geometry.affine import rotation
from graspmap.inference import Detector, load_weights
from graspmap.training import Experiment, callbacks, read_experiment, run, train
from graspmap.training.data import (
    ELSEWHERE,
    Draw,
    DrawSampler,
    Samples,
    crop_sample,
    greatest_opening,
    make_sample,
)
from graspmap.training.module import cosine_share
from graspmap.training.state import RunState

# The bits of a sum depend on how many threads share it.
pytestmark = pytest.mark.usefixtures("one_thread")

SIDE = 32


def bar_scene(object_id: int, view: int) -> Scene:
    """One bright bar on a dark table; the grasps lie across it."""
    rng = np.random.default_rng((7, object_id, view))
    angle = rng.uniform(-np.pi / 2, np.pi / 2)
    center = rng.uniform(13, 18, 2)
    width = 4.0 + object_id % 3
    axis = np.array([np.cos(angle), -np.sin(angle)])
    across = np.array([-axis[1], axis[0]])
    corners = [
        center + 8 * s * axis + t * across * width / 2
        for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    mask = np.zeros((SIDE, SIDE), np.uint8)
    cv2.fillPoly(mask, [np.round(corners).astype(np.int32)], 1)
    rgb = rng.integers(30, 60, (SIDE, SIDE, 3)).astype(np.uint8)
    rgb[mask > 0] = (200, 120 + 10 * object_id, 40)
    depth = np.where(mask > 0, 0.55, 0.6).astype(np.float32)
    along = np.array([-4.0, 0.0, 4.0])
    three = np.ones(3)
    grasps = Grasps(
        center + along[:, None] * axis, (angle + np.pi / 2) * three, (width + 5) * three, 4 * three
    )
    name = f"{object_id:04d}"
    return Scene(f"{view}_{name}", rgb, depth, mask > 0, grasps, object_id=name)


@pytest.fixture(scope="module")
def bars(tmp_path_factory):
    root = tmp_path_factory.mktemp("bars")
    for object_id in range(5):
        for view in range(3):
            write_jacquard(bar_scene(object_id, view), root)
    return root


@pytest.fixture(scope="module")
def experiment(bars, cache):
    return Experiment.model_validate(
        {
            "name": "bars",
            "network": {"channels": "rgbd", "bins": 2},
            "data": {
                "source": f"jacquard:{bars}",
                "size": SIDE,
                "split": {"train": 0.6, "validation": 0.2, "test": 0.2},
                "augment": {"rotation": "any", "zoom": (0.8, 1.0), "flip": True},
                "cache_dir": str(cache),
            },
            "optimiser": {"learning_rate": 3e-3},
            "schedule": {"monitor": "success", "patience": 0, "factor": 0.5},
            # After every batch, so that the run can be cut anywhere.
            "training": {"epochs": 3, "batch_size": 4, "checkpoint_minutes": 0, "device": "cpu"},
        }
    )


@pytest.fixture(scope="module")
def whole_run(experiment, tmp_path_factory):
    """A run that nothing interrupts."""
    out = tmp_path_factory.mktemp("whole")
    return out, train(experiment, out, command="graspmap train bars.yaml")


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


def rows(out: Path) -> list[dict[str, float]]:
    """The logged rows without what the clock says."""
    found = callbacks.read_rows(out / "metrics.jsonl")
    return [{k: v for k, v in row.items() if k != "seconds"} for row in found]


def assert_same_run(one: Path, other: Path) -> None:
    assert rows(one) == rows(other)
    first, second = (load_weights(p / "weights.safetensors") for p in (one, other))
    assert first[1].metrics == second[1].metrics
    for name, tensor in first[0].state_dict().items():
        assert torch.equal(tensor, second[0].state_dict()[name]), name


# The whole of it.


def test_a_run_leaves_weights_card_metrics_and_split(experiment, whole_run):
    out, card = whole_run
    network, stored = load_weights(out / "weights.safetensors")
    assert stored == card
    assert (network.channels, network.bins, card.size) == (4, 2, SIDE)
    assert card.command == "graspmap train bars.yaml"
    assert card.metrics["test"]["scenes"] == card.data.scenes["test"] == 3
    assert card.metrics["validation"]["epoch"] <= 3
    assert read_experiment(out / "experiment.yaml") == experiment
    with (out / "metrics.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [int(r["epoch"]) for r in table] == [r["epoch"] for r in rows(out)] == [0, 1, 2, 3]
    assert [r["step"] for r in rows(out)] == [0, 3, 6, 9]
    assert list((out / "tensorboard").glob("events*"))
    assert not list(out.rglob("*.part"))


def wide_scene(object_id: int) -> Scene:
    """A picture twice as wide as high, with labels of every angle all over it."""
    rng = np.random.default_rng((8, object_id))
    count = 40
    grasps = Grasps(
        rng.uniform((0, 0), (63, 31), (count, 2)),
        rng.uniform(-np.pi / 2, np.pi / 2, count),
        np.full(count, 12.0),
        np.full(count, 6.0),
    )
    rgb = rng.integers(0, 256, (32, 64, 3)).astype(np.uint8)
    name = f"{object_id:04d}"
    return Scene(f"0_{name}", rgb, grasps=grasps, object_id=name)


def test_the_test_of_a_run_is_that_of_the_detector(tmp_path):
    for object_id in range(24):
        write_jacquard(wide_scene(object_id), tmp_path / "wide")
    experiment = Experiment.model_validate(
        {
            "network": {"name": "ggcnn", "channels": "rgb"},
            "data": {
                "source": f"jacquard:{tmp_path / 'wide'}",
                "size": 48,  # half of it is repeated border, where no grasp may be found
                "split": {"train": 0.2, "validation": 0.1, "test": 0.7},
                "cache_dir": str(tmp_path / "cache"),
            },
            "optimiser": {"learning_rate": 1e-2},
            "training": {"epochs": 1, "batches_per_epoch": 10, "device": "cpu"},
        }
    )
    found = train(experiment, tmp_path / "run").metrics["test"]
    scenes = read_scenes(experiment.data.source)
    test = read_split(tmp_path / "run" / "split.json").subset(scenes, "test")
    result = evaluate_detector(Detector.load(tmp_path / "run" / "weights.safetensors"), test)
    assert result.score.miou > 0
    assert found["miou"] == pytest.approx(result.score.miou, abs=1e-6)


def test_the_network_learns(whole_run):
    losses = [row["train_loss"] for row in rows(whole_run[0])[1:]]
    assert losses[-1] < losses[0]


def test_validation_and_test_scenes_are_not_trained_on(whole_run, bars):
    parts = json.loads((whole_run[0] / "split.json").read_text())["parts"]
    objects = {name: {i.split("_")[1] for i in ids} for name, ids in parts.items()}
    assert not objects["train"] & objects["validation"] | objects["train"] & objects["test"]
    assert sum(map(len, parts.values())) == 15


def test_a_finished_run_gives_its_card_without_work(experiment, whole_run, monkeypatch):
    monkeypatch.setattr(run, "_trainer", None)
    assert train(experiment, whole_run[0]) == whole_run[1]


def test_more_epochs_go_on_as_if_planned_from_the_start(experiment, whole_run, tmp_path):
    train(change(experiment, training__epochs=1), tmp_path)
    train(experiment, tmp_path)
    assert_same_run(tmp_path, whole_run[0])


def test_a_run_of_crops_with_a_cosine_goes_on_to_the_same_bits(experiment, tmp_path, monkeypatch):
    """Stopped inside its second epoch; the learning rate ends at nothing."""
    crops = change(
        experiment, data__augment__crop=24, schedule__kind="cosine", schedule__warmup=0.25
    )
    train(crops, tmp_path / "whole")
    calls = 0
    save = callbacks.write_bytes

    def stop(path, content, **options):
        nonlocal calls
        calls += 1
        if calls == 7:
            raise KeyboardInterrupt
        save(path, content, **options)

    with monkeypatch.context() as patch:
        patch.setattr(callbacks, "write_bytes", stop)
        with pytest.raises(KeyboardInterrupt):
            train(crops, tmp_path / "cut")
    state = callbacks.load_checkpoint(tmp_path / "cut" / "checkpoints" / "last.ckpt")["graspmap"]
    assert 0 < state["step"] < 9
    train(crops, tmp_path / "cut")
    assert_same_run(tmp_path / "cut", tmp_path / "whole")
    rates = [row["learning_rate"] for row in rows(tmp_path / "whole")[1:]]
    # Nine steps; the rate of an epoch's last one, against the formula.
    peak = crops.optimiser.learning_rate
    assert rates == pytest.approx([peak * cosine_share(n / 9, 0.25) for n in (2, 5, 8)])
    assert rates[-1] < 0.1 * peak


def test_workers_do_not_change_the_run(experiment, whole_run, tmp_path):
    train(change(experiment, training__workers=1, training__checkpoint_minutes=60), tmp_path)
    assert_same_run(tmp_path, whole_run[0])


def test_no_epochs_give_the_untrained_network(experiment, whole_run, tmp_path):
    card = train(change(experiment, training__epochs=0), tmp_path)
    assert card.metrics["validation"]["epoch"] == 0
    assert rows(tmp_path) == rows(whole_run[0])[:1]


@pytest.mark.filterwarnings("ignore:.*bfloat16")
def test_mixed_precision_trains_too(experiment, whole_run, tmp_path):
    train(change(experiment, training__epochs=1, training__precision="bf16"), tmp_path)
    half, full = rows(tmp_path)[1]["train_loss"], rows(whole_run[0])[1]["train_loss"]
    assert half != full
    assert half == pytest.approx(full, rel=0.05)


KILLED = """
import os, signal, sys, numba, torch, torch.utils.tensorboard
from contextlib import contextmanager
from graspmap.training import read_experiment, train

torch.set_num_threads(1)

def run(kill_at):
    batches = 0

    @contextmanager
    def progress(title):
        def update(done, total):
            nonlocal batches
            batches += title.startswith("epoch")
            if batches == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
        yield update

    train(read_experiment(sys.argv[1]), sys.argv[2], progress=progress)

for kill_at in map(int, sys.argv[3:]):
    # Importing takes longer than training; nothing has run yet that a fork would harm.
    child = os.fork()
    if not child:
        run(kill_at)
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def test_a_killed_run_goes_on_to_the_same_bits(experiment, whole_run, tmp_path):
    """Killed in the first epoch, then in the second, then let go."""
    (tmp_path / "bars.yaml").write_text(experiment.to_yaml(), encoding="utf-8")
    out = tmp_path / "out"
    environment = {**os.environ, "PYTHONPATH": str(Path(graspmap.__file__).parents[1])}
    command = [sys.executable, "-c", KILLED, str(tmp_path / "bars.yaml"), str(out), "2", "4"]
    killed = subprocess.run(
        command, env=environment, timeout=300, check=True, stdout=subprocess.PIPE
    )
    assert killed.stdout.split() == [b"-9", b"-9"]
    assert not (out / "weights.safetensors").exists()
    state = callbacks.load_checkpoint(out / "checkpoints" / "last.ckpt")["graspmap"]
    # 1 batch was saved before the first kill, 3 more before the second: 3 make an epoch.
    assert (state["epoch"], state["batch"]) == (1, 1)
    train(experiment, out)
    assert_same_run(out, whole_run[0])


@pytest.mark.parametrize("crash", range(1, 13, 2))
def test_a_run_cut_at_any_write_goes_on_to_the_same_bits(
    experiment, whole_run, tmp_path, monkeypatch, crash
):
    """The writes of a run are rows, best and last states: fail at every second one in turn."""
    writes = 0

    def failing(write):
        def fail(path, content, **options):
            nonlocal writes
            writes += path.suffix != ".csv"
            if writes == crash:
                path.with_name(f".{path.name}.1.part").write_bytes(b"half a file")
                raise StorageFullError(path, "the disk is full", "free some space")
            write(path, content, **options)

        return fail

    short = change(experiment, training__checkpoint_minutes=60)
    with monkeypatch.context() as patch:
        for name in ("write_bytes", "write_text"):
            patch.setattr(callbacks, name, failing(getattr(callbacks, name)))
        with pytest.raises(StorageFullError):
            train(short, tmp_path)
    train(short, tmp_path)
    assert_same_run(tmp_path, whole_run[0])
    assert not list(tmp_path.rglob("*.part"))


def test_ctrl_c_gets_through_and_keeps_the_state(experiment, whole_run, tmp_path):
    import signal
    from contextlib import contextmanager

    @contextmanager
    def progress(title):
        def update(done, total):
            if title.startswith("epoch 2"):
                raise KeyboardInterrupt

        yield update

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        train(experiment, tmp_path, progress=progress)
    assert signal.getsignal(signal.SIGINT) is before
    train(experiment, tmp_path)
    assert_same_run(tmp_path, whole_run[0])


# What is refused.


def test_another_experiment_in_the_same_folder_is_refused(experiment, whole_run):
    with pytest.raises(FileFormatError, match=r"optimiser\.learning_rate was 0\.003"):
        train(change(experiment, optimiser__learning_rate=1.0), whole_run[0])


def test_a_run_that_never_began_can_be_changed(experiment, tmp_path):
    with pytest.raises(FileError):
        train(change(experiment, data__source="jacquard:/nowhere"), tmp_path)
    train(change(experiment, training__epochs=0), tmp_path)


def test_results_without_an_experiment_are_not_overwritten(experiment, tmp_path):
    (tmp_path / "weights.safetensors").write_bytes(b"precious")
    with pytest.raises(FileFormatError, match="another folder"):
        train(experiment, tmp_path)
    assert (tmp_path / "weights.safetensors").read_bytes() == b"precious"


def test_two_runs_in_one_folder_are_refused(experiment, tmp_path):
    from graspmap.files import locked

    with locked(tmp_path, "training"), pytest.raises(FileError, match="another training"):
        train(experiment, tmp_path)


def test_changed_data_are_noticed(experiment, tmp_path):
    root = tmp_path / "data"
    for object_id in range(3):
        write_jacquard(bar_scene(object_id, 0), root)
    values = {"data__source": f"jacquard:{root}", "training__epochs": 0}
    mine = change(experiment, **values, data__split={})
    train(mine, tmp_path / "out")
    write_jacquard(bar_scene(3, 0), root)
    with pytest.raises(FileFormatError, match="changed since this run began"):
        train(mine, tmp_path / "out")


def test_a_damaged_checkpoint_is_named(experiment, tmp_path):
    train(change(experiment, training__epochs=0), tmp_path)
    last = tmp_path / "checkpoints" / "last.ckpt"
    last.write_bytes(last.read_bytes()[:1000])
    with pytest.raises(FileFormatError, match=r"last\.ckpt: damaged"):
        train(experiment, tmp_path)


def test_a_damaged_best_checkpoint_is_found_before_the_work(experiment, tmp_path, monkeypatch):
    train(change(experiment, training__epochs=0), tmp_path)
    (tmp_path / "checkpoints" / "best.ckpt").write_bytes(b"x")
    monkeypatch.setattr(run, "_fit", pytest.fail)
    with pytest.raises(FileFormatError, match=r"best\.ckpt: damaged"):
        train(experiment, tmp_path)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("run.json", b'{"store": '),
        ("run.json", b"[]"),
        ("run.json", b"\xff"),
        ("run.json", b"[" * 50000),
        ("metrics.jsonl", b"\xff\xfe"),
        ("metrics.jsonl", b'{"epoch": 0, "unheard": 1}\n'),
        ("metrics.jsonl", b"[" * 50000),
    ],
)
def test_damaged_notes_of_a_run_are_named(experiment, tmp_path, name, content):
    train(change(experiment, training__epochs=0), tmp_path)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileFormatError, match=name):
        train(experiment, tmp_path)


def test_opencv_has_no_threads_where_workers_are_forked(experiment, tmp_path, monkeypatch):
    """A worker would wait for ever for threads that its parent had."""

    def look(*_):
        raise InterruptedError(cv2.getNumThreads())

    monkeypatch.setattr(run, "_fit", look)
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        for workers, threads in ((0, 3), (1, 1)):
            values = {"training__workers": workers}
            with pytest.raises(InterruptedError, match=str(threads)):
                train(change(experiment, **values), tmp_path / str(workers))
            assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ("DataLoader worker (pid 7) is killed by signal: Killed. ", GraspmapError),
        ("DataLoader worker (pid 7) is killed by signal: Terminated. ", KeyboardInterrupt),
        ("anything else", RuntimeError),
    ],
)
def test_workers_that_die(experiment, tmp_path, monkeypatch, said, expected):
    def fit(*_, **__):
        raise RuntimeError(said)

    monkeypatch.setattr(run.Trainer, "fit", fit)
    with pytest.raises(expected):
        train(experiment, tmp_path)


def test_checkpoints_never_run_code(tmp_path):
    class Evil:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    torch.save({"graspmap": Evil()}, tmp_path / "evil.ckpt")
    with pytest.raises(FileFormatError):
        callbacks.load_checkpoint(tmp_path / "evil.ckpt")
    assert not (tmp_path / "ran").exists()


def test_scenes_without_what_is_needed(experiment, tmp_path):
    root = tmp_path / "data"
    for object_id in range(4):
        scene = bar_scene(object_id, 0)
        write_jacquard(Scene(scene.id, scene.rgb, grasps=scene.grasps), root)
    colour = change(experiment, data__source=f"jacquard:{root}", data__split={})
    with pytest.raises(FileError, match="no depth picture"):
        train(colour, tmp_path / "a")
    for path in root.rglob("*_grasps.txt"):
        path.unlink()
    with pytest.raises(FileError, match="no scene with labels"):
        train(change(colour, network__channels="rgb"), tmp_path / "b")


def test_machines_and_names_that_do_not_exist(experiment, tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match=r"training\.device"):
        train(change(experiment, training__device="cuda"), tmp_path)
    with pytest.raises(ConfigError, match=r"training\.precision"):
        train(change(experiment, training__precision="16"), tmp_path)
    with pytest.raises(UnknownNameError, match="did you mean 'ggcnn2'"):
        train(change(experiment, network__name="ggcn2"), tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_loss_that_is_no_number_ends_the_run_with_a_remedy(experiment, tmp_path):
    hot = change(
        experiment,
        optimiser__learning_rate=1e30,
        training__checkpoint_minutes=60,
        optimiser__name="sgd",
    )
    with pytest.raises(GraspmapError, match=r"lower --optimiser\.learning_rate"):
        train(hot, tmp_path)
    assert [row["epoch"] for row in rows(tmp_path)] == [0]


# Order, samples, state.


@given(
    scenes=st.integers(1, 40),
    batch_size=st.integers(1, 9),
    batches=st.none() | st.integers(1, 12),
    seed=st.integers(0, 2**40),
)
def test_every_scene_is_seen_equally_often(scenes, batch_size, batches, seed):
    experiment = Experiment.model_validate(
        {
            "seed": seed,
            "data": {"source": "x"},
            "training": {"batch_size": batch_size, "batches_per_epoch": batches},
        }
    )
    indices = [3 * i + 1 for i in range(scenes)]
    sampler = DrawSampler(indices, experiment, RunState())
    counts: Counter[int] = Counter()
    for epoch in range(4):
        drawn = [draw for batch in sampler.epoch(epoch) for draw in batch]
        assert [d.position for d in drawn] == list(range(len(drawn)))
        assert {d.epoch for d in drawn} == {epoch}
        assert {d.scene for d in drawn} <= set(indices)
        assert len(drawn) == (scenes if batches is None else batches * batch_size)
        counts.update(d.scene for d in drawn)
        values = [counts[i] for i in indices]
        assert max(values) - min(values) <= 1
    state = RunState(epoch=2, batch=min(2, sampler.batches - 1))
    rest = DrawSampler(indices, experiment, state)
    assert list(rest) == sampler.epoch(2)[state.batch :]
    assert len(rest) == len(list(rest))


@pytest.fixture(scope="module")
def store(bars, cache):
    return open_store(read_scenes(f"jacquard:{bars}"), cache, size=SIDE)


def test_samples_follow_from_seed_epoch_and_position(store, experiment):
    samples = Samples(store, experiment, 10.0)
    one, again = samples[Draw(3, 1, 5)], samples[Draw(3, 1, 5)]
    assert all(np.array_equal(one[name], again[name]) for name in one)
    for other in (Draw(3, 2, 5), Draw(3, 1, 6), Draw(3)):
        assert not np.array_equal(one["input"], samples[other]["input"])
    assert one["input"].shape == (4, SIDE, SIDE)
    assert one["target"].shape == (4, 2, SIDE, SIDE)
    assert one["index"] == 3


def test_picture_and_targets_move_together(store, experiment):
    """A quarter turn of the sample is the sample of a quarter turn."""
    one_bin = change(experiment, network__bins=1)
    turn = rotation(np.pi / 2, ((SIDE - 1) / 2, (SIDE - 1) / 2))
    still, turned = (make_sample(store[0], m, one_bin, 10.0) for m in (np.eye(3), np.round(turn)))
    assert np.allclose(np.rot90(still["input"], axes=(1, 2)), turned["input"], atol=1e-5)
    quality, cos, sin, width = np.rot90(still["target"], axes=(2, 3))
    # Turned by 90 degrees, the doubled angle turns by 180.
    expected = np.stack([quality, -cos, -sin, width])
    differing = np.abs(expected - turned["target"]).max(axis=(0, 1)) > 1e-5
    assert quality.any()
    assert differing.mean() < 0.005  # pixel centres that lie on a region's border


@given(
    seed=st.integers(0, 2**32),
    size=st.integers(2, 40),
    grasps=st.booleans(),
    data=st.data(),
)
def test_a_crop_is_a_part_of_the_sample(seed, size, grasps, data):
    side, rng = data.draw(st.integers(1, size)), np.random.default_rng(seed)
    places = np.arange(size * size, dtype=np.float32).reshape(size, size)
    quality = np.zeros((2, size, size), np.float32)
    if grasps:
        quality[rng.integers(2), rng.integers(size), rng.integers(size)] = 0.5
    sample = {
        "input": places[None],
        "target": np.stack([quality, places + 0 * quality, quality, quality]),
        "mask": places[None] > 3,
        "index": np.array(7),
    }
    cut = crop_sample(sample, side, rng)
    assert cut["input"].shape == (1, side, side)
    assert cut["target"].shape == (4, 2, side, side)
    top, left = divmod(int(cut["input"][0, 0, 0]), size)
    assert np.array_equal(cut["input"][0], places[top : top + side, left : left + side])
    assert np.array_equal(cut["target"][1, 0], cut["input"][0])
    assert np.array_equal(cut["mask"], cut["input"] > 3)
    assert cut["index"] == 7
    assert grasps or not cut["target"][0].any()


def test_crops_lie_anywhere_around_what_can_be_grasped_and_now_and_then_elsewhere():
    quality = np.zeros((1, 1, 60, 60), np.float32)
    quality[..., 30, 30] = 1
    sample = {"input": np.zeros((1, 60, 60), np.float32), "target": np.repeat(quality, 4, axis=0)}
    rng = np.random.default_rng(0)
    found = [np.argwhere(crop_sample(sample, 10, rng)["target"][0, 0]) for _ in range(1200)]
    around = np.concatenate(found)
    # Of those elsewhere one in 36 (10 of 60 rows, and columns) meets the pixel by chance.
    assert len(around) / len(found) == pytest.approx(1 - ELSEWHERE * 35 / 36, abs=0.04)
    counts = np.stack([np.bincount(axis, minlength=10) for axis in around.T])
    assert counts.shape == (2, 10)
    assert counts.min() > 60  # 90 are expected in each of ten rows and columns
    ends = sample | {"input": np.arange(3600, dtype=np.float32).reshape(1, 60, 60)}
    corners = {0.0, 50.0, 3000.0, 3050.0}
    seen = {float(crop_sample(ends, 10, rng)["input"][0, 0, 0]) for _ in range(3000)}
    assert corners <= seen


def test_the_rate_rises_and_falls_along_a_cosine():
    shares = [cosine_share(n / 1000, 0.1) for n in range(1001)]
    assert shares[0] == pytest.approx(0.01)
    assert int(np.argmax(shares)) == 100
    assert max(shares) == pytest.approx(1)
    assert shares[-1] == pytest.approx(0, abs=1e-12)
    assert shares[550] == pytest.approx(0.5)
    optimiser = torch.optim.SGD([torch.zeros(1)], lr=1.0)
    oracle = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, T_max=900)
    for share in shares[100:]:
        assert share == pytest.approx(optimiser.param_groups[0]["lr"], abs=1e-9)
        optimiser.step()
        oracle.step()
    assert cosine_share(0.0, 0.0) == 1.0


def test_width_scale_is_the_greatest_opening_in_sight(store):
    assert greatest_opening(store, range(len(store))) == pytest.approx(11.0, abs=0.02)
    assert greatest_opening(store, []) == 1.0


@given(st.lists(st.floats(0.01, 2.0), min_size=1, max_size=30), st.integers(0, 4))
def test_plateau_is_that_of_pytorch(losses, patience):
    experiment = Experiment.model_validate(
        {"data": {"source": "x"}, "schedule": {"patience": patience, "factor": 0.5}}
    )
    optimiser = torch.optim.SGD([torch.zeros(1, requires_grad=True)], lr=1.0)
    oracle = torch.optim.lr_scheduler.ReduceLROnPlateau(
        optimiser, factor=0.5, patience=patience, eps=0.0
    )
    state, rate = RunState(), 1.0
    for loss in losses:
        oracle.step(loss)
        rate *= 0.5 if state.end_epoch(0.0, loss, experiment).cut else 1.0
        assert rate == optimiser.param_groups[0]["lr"]
        state.load(json.loads(json.dumps(state.to_dict())))


def test_early_ends():
    values = {"data": {"source": "x"}, "training": {"early_stopping_patience": 2}}
    experiment, state = Experiment.model_validate(values), RunState()
    state.start(0.1, 1.0)
    verdicts = [state.end_epoch(s, 1.0, experiment) for s in (0.0, 0.2, 0.2, 0.1)]
    assert [v.best for v in verdicts] == [False, True, False, False]
    assert verdicts[2].stop is None
    assert "2 epochs" in verdicts[3].stop
    assert state.finished(experiment)
    assert state.best_epoch == 2

    values = {"data": {"source": "x"}, "schedule": {"patience": 0, "stop_after_cuts": 2}}
    experiment, state = Experiment.model_validate(values), RunState()
    verdicts = [state.end_epoch(0.0, 1.0, experiment) for _ in range(4)]
    assert [v.cut for v in verdicts] == [False, True, True, False]
    assert "2 cuts" in verdicts[3].stop


def test_equal_success_is_decided_by_the_loss():
    experiment, state = Experiment.model_validate({"data": {"source": "x"}}), RunState()
    state.start(0.5, 1.0)
    assert state.end_epoch(0.5, 0.9, experiment).best
    assert not state.end_epoch(0.5, 0.9, experiment).best


def test_split_can_come_from_a_file(experiment, bars, tmp_path):
    split = make_split(read_scenes(f"jacquard:{bars}"), by="image", seed=5)
    split.write(tmp_path / "mine.json")
    mine = change(experiment, data__split={"file": str(tmp_path / "mine.json")}, training__epochs=0)
    card = train(mine, tmp_path / "out")
    assert card.data.split_hash == split.hash
