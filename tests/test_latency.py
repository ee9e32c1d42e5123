"""Latency: the steps of detection are timed as they are, and the command tells it."""

from __future__ import annotations

import json
import statistics
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from graspmap import Detector, cli
from graspmap.data import Scene
from graspmap.errors import InvalidInputError
from graspmap.evaluation import latency as module
from graspmap.evaluation.latency import (
    STEPS,
    TOTAL,
    Latency,
    example_scene,
    measure_latency,
    measure_speed,
)
from graspmap.gripper import load_gripper
from graspmap.inference import WeightsCard, save_weights
from graspmap.inference.threads import threads_of
from graspmap.networks import make_network
from graspmap.reproduction.published_times import published_times

CARD = WeightsCard(network="ggcnn2", channels="depth", size=64, width_scale_px=30.0)


class Clockwork:
    """A detector whose steps take known times, and the clock that it moves."""

    def __init__(self, *times: float) -> None:
        self.now, self.calls, self.times = 0.0, 0, times

    def perf_counter(self) -> float:
        return self.now

    def _pass(self, step: int) -> None:
        self.now += self.times[step] * (1 + self.calls)

    def prepare(self, *_, **__):
        self._pass(0)
        return SimpleNamespace(inputs=np.zeros((1, 2, 2), np.float32))

    def predict(self, _):
        self._pass(1)
        return SimpleNamespace(item={0: "maps"}.get)

    def decode(self, _, maps, **__):
        assert maps == "maps"
        self._pass(2)
        self.calls += 1


def timed(monkeypatch, times=(0.25, 0.5, 1.0), **options) -> Latency:
    detector = Clockwork(*times)
    monkeypatch.setattr(module, "time", detector)
    return measure_latency(detector, Scene("s", depth=np.ones((4, 4), np.float32)), **options)


def test_each_step_has_its_own_time_and_the_first_two_detections_do_not_count(monkeypatch):
    found = timed(monkeypatch, repeats=4, seconds=1000.0)
    # Detection number n takes 1 + n times as long, and those timed are numbers 2 to 5.
    factors = np.array([3, 4, 5, 6])
    assert found.repeats == 4
    for step, unit in zip((*STEPS, TOTAL), (0.25, 0.5, 1.0, 1.75), strict=True):
        assert found.seconds[step] == pytest.approx(unit * factors)


@pytest.mark.parametrize(("seconds", "repeats"), [(0.1, 3), (21.0, 3), (22.0, 4), (1e6, 9)])
def test_the_time_limit_leaves_three_repeats(monkeypatch, seconds, repeats):
    # The repeats take 5.25, 7, 8.75, 10.5 s and so on.
    assert timed(monkeypatch, repeats=9, seconds=seconds).repeats == repeats


@given(st.lists(st.floats(1e-6, 10), min_size=2, max_size=50))
def test_percentiles_agree_with_pythons_own(values):
    found = Latency("torch", 1, None, 1, {step: np.array(values) for step in (*STEPS, TOTAL)})
    cuts = statistics.quantiles(values, n=100, method="inclusive")
    entry = found.to_dict()
    for percent in (50, 90, 99):
        assert entry["forward"][f"p{percent}_ms"] == pytest.approx(1000 * cuts[percent - 1])
    assert entry["total"]["mean_ms"] == pytest.approx(1000 * statistics.fmean(values))
    assert entry["decode"]["p50_ms"] <= entry["decode"]["p90_ms"] <= entry["decode"]["p99_ms"]


@pytest.mark.parametrize(
    ("options", "part"), [({"repeats": 0}, "repeats"), ({"seconds": 0}, "seconds"),
                          ({"threads": 0}, "threads")]
)  # fmt: skip
def test_refuses(monkeypatch, options, part):
    with pytest.raises(InvalidInputError, match=part):
        timed(monkeypatch, **options)


def test_threads_are_given_back_after_an_error():
    before = torch.get_num_threads(), cv2.getNumThreads()
    inside = []

    def fail():
        with threads_of(1):
            inside.extend((torch.get_num_threads(), cv2.getNumThreads()))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert inside == [1, 1]
    assert (torch.get_num_threads(), cv2.getNumThreads()) == before


@pytest.fixture(scope="module")
def picture() -> Scene:
    return example_scene(96, 64)


@pytest.fixture(scope="module")
def detector() -> Detector:
    network = make_network("ggcnn2", 1, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():  # quality and width as of a trained one: there are grasps, small ones
        network.heads.layer.weight[3] *= 0.01
        network.heads.layer.bias[:] = torch.tensor([1.0, 0.0, 0.0, 0.3])
    return Detector(network, CARD)


def test_the_example_is_a_table_with_objects_and_holes(picture):
    again = example_scene(96, 64)
    assert picture.shape == (64, 96)
    assert np.array_equal(picture.depth, again.depth, equal_nan=True)
    assert np.array_equal(picture.rgb, again.rgb)
    assert np.isnan(picture.depth).any()
    assert 0.02 < np.nanmax(picture.depth) - np.nanmin(picture.depth) < 0.5
    with pytest.raises(InvalidInputError, match="height of the picture is 20"):
        example_scene(96, 20)


@pytest.mark.parametrize("gripper", [None, "franka"])
@pytest.mark.parametrize("region", [None, (10, 5, 60, 40)])
def test_detection_is_its_three_steps(detector, picture, gripper, region, one_thread):
    given = None if gripper is None else load_gripper(gripper)
    rgb, depth, camera = picture.rgb, picture.depth, picture.camera
    mask = np.zeros(depth.shape, bool)
    mask[10:50, 15:80] = True
    options = {"camera": camera, "gripper": given, "top": 3}
    whole = detector.detect(rgb, depth, region=region, mask=mask, **options)
    prepared = detector.prepare(rgb, depth, camera=camera, region=region, mask=mask)
    maps = detector.predict(prepared.inputs[None]).item(0)
    steps = detector.decode(prepared, maps, **options)
    assert len(whole.grasps)
    assert np.array_equal(steps.grasps.corners(), whole.grasps.corners())
    assert np.array_equal(steps.position_m, whole.position_m)
    assert np.array_equal(steps.width_m, whole.width_m)
    assert prepared.allowed.shape == (64, 64)
    assert not prepared.allowed.all()


def test_speed_in_every_setting(detector, picture):
    found = measure_speed(
        {"torch": detector},
        picture,
        threads=(1, 2),
        grippers=(None, load_gripper("franka")),
        repeats=3,
    ).to_dict()
    assert [(s["threads"], s["gripper"]) for s in found["settings"]] == [
        (1, None), (1, "franka"), (2, None), (2, "franka")
    ]  # fmt: skip
    assert found["parameters"] == 66_676
    # Facts of the architecture: multiply-adds grow with the area of the input.
    larger = Detector(make_network("ggcnn2", 1), CARD.model_copy(update={"size": 128}))
    other = measure_speed({"torch": larger}, picture, repeats=1, seconds=1e-9).to_dict()
    assert other["multiply_adds"] == 4 * found["multiply_adds"]
    for setting in found["settings"]:
        assert setting["repeats"] == 3
        parts = sum(setting[step]["mean_ms"] for step in STEPS)
        assert parts == pytest.approx(setting[TOTAL]["mean_ms"])
    with pytest.raises(InvalidInputError, match="threads"):
        measure_speed({"torch": detector}, picture, threads=())


def test_a_gripper_needs_a_camera(detector):
    bare = Scene("bare", depth=np.ones((64, 64), np.float32))
    with pytest.raises(InvalidInputError, match="camera is missing"):
        measure_latency(detector, bare, gripper=load_gripper("franka"))


def test_times_of_the_thesis():
    rows = {(time.source, time.model): time for time in published_times()}
    unet = rows["Thesis, Table 5.3", "U-Net"]
    assert (unet.network, unet.time_ms, unet.parameters) == ("unet", "25-28", "14.7M")
    dropout = rows["Thesis, Table 4.4", "GR-ConvNet2 / Positional"]
    assert (dropout.network, dropout.time_ms, dropout.parameters) == ("grconvnet2", "~ 28", None)
    assert rows["Thesis, Table 5.3", "GQ-CNN"].network is None


# The command.


def run(capsys, *words):
    code = cli.main(["bench", *map(str, words)])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    save_weights(path, make_network("ggcnn2", 1), CARD)
    return path


def test_bench(capsys, weights, tmp_path):
    code, out, err = run(
        capsys, "--weights", weights, "--size", "96x64", "--threads", "1,2", "--gripper", "franka",
        "--repeats", 3, "--json", tmp_path / "s.json",
    )  # fmt: skip
    assert (code, err) == (0, "")
    assert "66,676 parameters" in out
    assert "picture example, 96 x 64 px, cpu" in out
    assert "torch, 2 threads, grasps for franka, 3 repeats" in out
    assert "Thesis, Table 5.3, GGCNN2: 12-14 ms, 72k parameters" in out
    assert "U-Net" not in out
    summary = json.loads((tmp_path / "s.json").read_text())
    assert len(summary["settings"]) == 4
    assert len(summary["published"]) == 14
    shown = f"{summary['settings'][0]['forward']['p50_ms']:.2f}"
    assert shown in out


def test_bench_on_a_scene_of_a_data_set(capsys, weights, generated):
    from graspmap.data import read_scenes

    name = read_scenes(f"jacquard:{generated}").ids[1]
    words = ("--weights", weights, "--data", f"jacquard:{generated}", "--repeats", 1)
    code, out, err = run(capsys, *words, "--scene", name, "--json", "-")
    assert code == 0
    assert json.loads(out)["picture"] == {"id": name, "width": 128, "height": 128}
    assert name in err


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--threads", "0"], "--threads is '0'"),
        (["--threads", "1,,2"], "--threads"),
        (["--size", "640"], "--size"),
        (["--size", "20x640"], "width of the picture is 20"),
        (["--backends", "onnx"], "torch"),
        (["--repeats", "0"], "--repeats"),
        (["--seconds", "0"], "--seconds"),
        (["--top", "0"], "--top"),
        (["--gripper", "frank"], "did you mean 'franka'?"),
        (["--scene", "1"], "only with --data"),
        (["--data", "jacquard:DIR", "--scene", "gone"], "gone"),
        (["--data", "jacquard:DIR", "--size", "9x9"], "only without --data"),
        (["--weights", "no.safetensors"], "no.safetensors"),
    ],
)
def test_mistakes_get_one_line(capsys, weights, generated, words, part):
    words = [word.replace("DIR", str(generated)) for word in words]
    first = [] if "--weights" in words else ["--weights", weights]
    code, out, err = run(capsys, *first, *words)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("graspmap: error: ")
    assert part in line
