"""`graspmap gripper train`: scenes, training, calibration and comparison for one gripper."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from graspmap import Detector, cli, read_scenes
from graspmap.cli import evaluate, gripper_train
from graspmap.cli.gripper_job import PARTS, TrainForGripper, compared_weights, prepare
from graspmap.errors import ConfigError, InvalidInputError
from graspmap.evaluation.compare import Comparison, Pair
from graspmap.evaluation.tabletops import scene_gripper
from graspmap.generation import recipe
from graspmap.generation.recipe import load_recipe
from graspmap.gripper import load_gripper, profile_names
from graspmap.inference import WeightsCard, load_weights, save_weights, shipped, weights_hash
from graspmap.metrics.paired import compare_paired
from graspmap.networks import make_network
from graspmap.reproduction.table_file import experiments_folder
from graspmap.training import read_experiment

pytestmark = pytest.mark.usefixtures("one_thread")

NARROW = Path(__file__).parents[1] / "docs" / "narrow-gripper.yaml"

RECIPE = """
size_px: 128
candidates: 40
parts:
  train: {scenes: 12, least: 4, seed: 1, views: 2, families: [box]}
  validation: {scenes: 6, least: 3, seed: 2, families: [box]}
  test: {scenes: 8, least: 4, seed: 3, families: [box]}
"""
EXPERIMENT = """
name: tiny
network: {name: ggcnn, channels: depth}
data:
  source: jacquard:nowhere
  depth: stereo
  size: 96
  augment: {crop: 48, zoom: [0.8, 1.0]}
  cache_dir: CACHE
schedule: {kind: cosine}
training: {epochs: 1, batch_size: 4, batches_per_epoch: 20}
"""


def run(capsys, *words):
    """(exit code, standard output, standard error) of one command."""
    code = cli.main([str(word) for word in words])
    return code, *capsys.readouterr()


def small(path, channels="depth"):
    """A small network that has learned nothing, but is sure of everything."""
    card = WeightsCard(network="ggcnn2", channels=channels, size=64, width_scale_px=30.0)
    count = {"depth": 1, "rgbd": 4}[channels]
    network = make_network("ggcnn2", count, 1, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        network.heads.layer.bias[0] += 0.5
    save_weights(path, network, card)
    return path


@pytest.fixture(scope="module")
def words(tmp_path_factory, cache):
    """The command, as small as it goes."""
    root = tmp_path_factory.mktemp("own")
    (root / "tiny.yaml").write_text(RECIPE)
    (root / "experiment.yaml").write_text(EXPERIMENT.replace("CACHE", str(cache)))
    return [
        "gripper", "train", "robotiq-2f85", "--scenes", 6, "--workers", 1, "--device", "cpu",
        "--recipe", root / "tiny.yaml", "--experiment", root / "experiment.yaml",
        "--compare", small(root / "before.safetensors"), "--out", root / "out",
    ]  # fmt: skip


@pytest.fixture(scope="module")
def out(words):
    return words[-1]


@pytest.fixture(scope="module")
def stopped(words, out):
    """A run that Ctrl-C ends when it has evaluated its own weights; files and when they were."""
    whole = evaluate.measure

    def stop_at_the_second(flags, command):
        if "compared" in str(flags.out):
            raise KeyboardInterrupt
        return whole(flags, command)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluate, "measure", stop_at_the_second)
        assert cli.main([str(word) for word in words]) == 130
    kept = [out / "weights.safetensors", out / "evaluation" / "own" / "report.html"]
    kept += [out / "training" / "weights.safetensors"]
    kept += [path for path in (out / "data").rglob("*") if path.suffix in (".tiff", ".txt")]
    return {path: path.stat().st_mtime_ns for path in kept}


@pytest.fixture(scope="module")
def finished(words, out, stopped):
    """The same command again; what it says as JSON."""
    assert cli.main([str(word) for word in (*words, "--json", out.parent / "found.json")]) == 0
    return json.loads((out.parent / "found.json").read_text())


def test_what_was_finished_is_not_done_again(stopped, finished):
    assert len(stopped) > 30
    assert {path: path.stat().st_mtime_ns for path in stopped} == stopped


def test_a_finished_run_says_the_same_at_once(capsys, words, out, finished):
    code, said, err = run(capsys, *words)
    assert code == 0
    assert said.count("is finished") == 3
    assert "going on after" not in err
    assert f"use them: {finished['detect']}\n" in said
    assert f"held in {finished['own']['held']} of 4 trials" in said
    code, said, err = run(capsys, *words, "--json", "-")
    assert json.loads(said) == finished
    assert "2 of 4, training: ggcnn on depth, 1 epoch\n" in err


def test_scenes_are_for_the_gripper_and_scaled(out, finished):
    for name, count in zip(PARTS, (6, 3, 4), strict=True):
        scenes = read_scenes(f"jacquard:{out / 'data' / name}")
        assert len(scenes) == count
        assert all(scene_gripper(scenes, i).name == "robotiq-2f85" for i in range(count))


def test_the_weights_are_trained_and_calibrated_on_these_parts(out, finished):
    _, card = load_weights(out / "weights.safetensors")
    assert (card.network, card.channels, card.data.depth) == ("ggcnn", "depth", "stereo")
    assert card.data.source == f"jacquard:{out.resolve() / 'data' / 'train'}"
    assert card.data.scenes == {"train": 6, "validation": 3, "test": 4}
    assert card.calibration.grippers == ("robotiq-2f85",)
    assert card.calibration.data == f"jacquard:{out / 'data' / 'validation'}"
    assert card.command.startswith("graspmap gripper train robotiq-2f85 ")
    assert "jacquard:nowhere" not in (out / "training" / "experiment.yaml").read_text()


def test_the_comparison_is_of_the_same_trials(out, finished):
    comparison = json.loads((out / "comparison" / "comparison.json").read_text())
    (pair,) = (pair for pair in comparison["pairs"] if pair["measure"] == "held")
    assert {**pair, "page": str(out / "comparison" / "comparison.html")} == finished["difference"]
    assert finished["difference"]["scenes"] == 4
    share = {name: finished[name]["held"] / 4 for name in ("own", "compared")}
    assert pair["difference"] == pytest.approx(share["own"] - share["compared"])
    for name in ("own", "compared"):
        summary = json.loads(
            Path(finished[name]["report"]).with_name("evaluation.json").read_text()
        )
        assert summary["trials"]["best"]["held"] == finished[name]["held"]
        assert summary["trials"]["grippers"] == ["robotiq-2f85"]
        assert summary["depth"] == "stereo"
        assert ("baselines" in summary) == (name == "own")


def test_the_last_line_works_on_a_picture(capsys, out, finished):
    picture = next((out / "data" / "test").rglob("*_stereo_depth.tiff"))
    camera = Path(str(picture).replace("stereo_depth.tiff", "camera.json"))
    overlay = out.parent / "grasps.png"
    line = finished["detect"].replace("depth.tiff", str(picture))
    line = line.replace("camera.json", str(camera)).replace("grasps.png", str(overlay))
    assert run(capsys, *shlex.split(line)[1:])[0] == 0
    assert cv2.imread(str(overlay)) is not None
    assert Detector.load(finished["weights"]).card.calibration is not None


def test_other_settings_need_another_folder(capsys, words, out, finished, stopped):
    for change, part in (
        (["--seed", 1], "data.train.seed: 1 -> 1001"),
        (["--network", "ggcnn2"], "experiment.network.name: ggcnn -> ggcnn2"),
        (["--scenes", 7], "data.train.scenes: 6 -> 7"),
    ):
        code, _, err = run(capsys, *words, *change)
        assert code == 2
        assert "was begun with other settings" in err
        assert part in err
    other = [*words[:2], "franka", *words[3:]]
    code, _, err = run(capsys, *other)
    assert code == 2
    assert "gripper.name: robotiq-2f85 -> franka" in err
    assert {path: path.stat().st_mtime_ns for path in stopped} == stopped


def test_longer_training_goes_on_and_is_measured_anew(capsys, words, out, finished, stopped):
    before = Path(finished["own"]["report"]).stat().st_mtime_ns
    compared = Path(finished["compared"]["report"]).stat().st_mtime_ns
    code, _, err = run(capsys, *words, "--epochs", 2)
    assert code == 0
    assert "going on after epoch 1" in err
    assert "may have been trained on some of these scenes" not in err
    network, card = load_weights(out / "weights.safetensors")
    assert card.metrics["epochs"] == 2
    own = json.loads((out / "evaluation" / "own" / "evaluation.json").read_text())
    assert own["detector"]["hash"] == weights_hash(network, card)
    assert Path(finished["own"]["report"]).stat().st_mtime_ns > before
    assert Path(finished["compared"]["report"]).stat().st_mtime_ns == compared


def test_a_split_is_warned_of_where_it_divides_these_scenes(capsys, out, finished):
    trained = out / "training" / "weights.safetensors"
    for part, warned in (("train", True), ("validation", False)):
        data = f"jacquard:{out / 'data' / part}"
        code, _, err = run(capsys, "evaluate", "--data", data, "--weights", trained)
        assert code == 0
        assert ("may have been trained on some of these scenes" in err) == warned


def test_a_folder_of_something_else_is_left_alone(capsys, words, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    code, _, err = run(capsys, *words[:-1], tmp_path)
    assert code == 2
    assert "holds something else (thesis.tex)" in err
    (tmp_path / "thesis.tex").rename(tmp_path / "settings.json")
    code, _, err = run(capsys, *words[:-1], tmp_path)
    assert code == 2
    assert "is damaged" in err
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (["--scenes", 50], "200 or more in part train of recipe own-gripper"),
        (["--scenes", 0], "--scenes is 0; allowed: 1 or more"),
        (["--recipe", "graspmap-v1"], "none: recipe graspmap-v1 says that it is jacquard"),
        (["--network", "ggcn"], "did you mean 'ggcnn'?"),
        (["--compare", "nothing"], "allowed: none, "),
        (["--compare", "gone.safetensors"], "gone.safetensors: no such file"),
        (["--epochs", "-1"], "--epochs is -1"),
        (["--channels", "rgb"], "--channels is 'rgb'; allowed: depth, rgbd"),
    ],
)
def test_mistakes_are_told_before_any_work(capsys, tmp_path, change, part):
    code, _, err = run(capsys, "gripper", "train", "franka", "--out", tmp_path / "out", *change)
    assert code == 2
    assert part in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("opening", "part"),
    [("0.008", "a greatest one of 1 cm or more"), ("0.011", "or show less of the table")],
)
def test_a_gripper_that_does_not_suit(capsys, tmp_path, opening, part):
    slit = tmp_path / "slit.yaml"
    slit.write_text(NARROW.read_text().replace("0.045 ", f"{opening} "))
    code, _, err = run(capsys, "gripper", "train", slit, "--out", tmp_path / "out")
    assert code == 2
    assert f"opening of gripper narrow is {'0.0 to ' * (opening == '0.008')}{opening} m" in err
    assert part in err
    assert not (tmp_path / "out").exists()


def test_a_recipe_needs_these_parts(capsys, tmp_path):
    file = tmp_path / "two.yaml"
    file.write_text(RECIPE.replace("validation", "valid"))
    code, _, err = run(capsys, "gripper", "train", "franka", "--recipe", file, "--out", tmp_path)
    assert code == 2
    assert "train, valid, test; allowed: one with train, validation, test" in err


def test_what_it_compares_with(tmp_path, monkeypatch, caplog):
    """The best of the same channels; another kind would differ in more than the gripper."""
    monkeypatch.setattr(shipped, "_FOLDER", tmp_path)
    assert compared_weights(None, "depth") is None
    depth = small(tmp_path / "a-depth.safetensors")
    assert compared_weights(None, "depth") == depth
    assert compared_weights(None, "rgbd") is None
    both = small(tmp_path / "b-rgbd.safetensors", "rgbd")
    assert compared_weights(None, "rgbd") == both
    assert compared_weights(None, "depth") == depth
    assert compared_weights("b-rgbd", "depth") == both
    assert compared_weights("none", "depth") is None


@pytest.mark.parametrize(
    ("own", "compared", "words"),
    [
        (18, 4, "+70.0 points (95 % interval +45.0 to +90.0): yours hold more"),
        (4, 18, "-70.0 points (95 % interval -90.0 to -45.0): yours hold less"),
        (10, 9, "+5.0 points (95 % interval "),
    ],
)
def test_the_difference_in_words(tmp_path, capsys, own, compared, words):
    """Of 20 scenes the first so many hold."""
    held = [[float(i < n) for i in range(20)] for n in (own, compared)]
    result = compare_paired(*held, rng=np.random.default_rng(0))
    pair = Pair("own", "compared-x", "held", result, result.p_value)
    comparison = Comparison({}, (replace(pair, measure="iou"), pair), {}, 0.95, "scene")
    job = prepare(TrainForGripper("franka", tmp_path, compare="none"), "x")
    found = gripper_train._difference(job, comparison)
    assert found["difference"] == pytest.approx((own - compared) / 20)
    said = capsys.readouterr().out
    assert words in said
    verdicts = ("hold more often", "hold less often", "not decided")
    (verdict,) = (verdict for verdict in verdicts if verdict in said)
    low, high = result.interval
    assert (verdict == verdicts[0]) == (low > 0)
    assert (verdict == verdicts[1]) == (high < 0)


@pytest.mark.parametrize("name", [*profile_names(), str(NARROW)])
def test_what_ships_suits_every_gripper(tmp_path, name):
    job = prepare(TrainForGripper(name, tmp_path / "out", compare="none"), "x")
    assert [plan.scenes for plan in job.plans.values()] == [2000, 300, 300]
    assert {plan.gripper for plan in job.plans.values()} == {load_gripper(name)}
    shipped_one = read_experiment(experiments_folder() / "stereo.yaml").flat()
    found = job.experiment.flat()
    changed = {key for key in found if found[key] != shipped_one[key]}
    assert changed <= {
        "name", "data.source", "data.validation.source", "data.test.source", "maps.width_scale"
    }  # fmt: skip
    # Openings of any gripper make numbers of one size: this part of the greatest is 1.
    opening_px = load_gripper(name).max_opening_m / 0.36 * 160
    assert found["maps.width_scale"] == pytest.approx(0.42 * opening_px, abs=0.05)
    assert not (tmp_path / "out").exists()


def test_the_example_of_the_page_is_narrow_and_thick():
    gripper = load_gripper(NARROW)
    assert (gripper.min_opening_m, gripper.max_opening_m) == (0, 0.045)
    assert gripper.finger_thickness_m == 0.015
    assert load_recipe("own-gripper", gripper=gripper)["test"].ranges.longest_m[1] < 0.15


class TestRecipe:
    """Recipes for any gripper, and smaller ones."""

    def test_parts_grow_and_shrink_together_down_to_their_least(self):
        franka = load_gripper("franka")
        for scenes, expected in ((4000, [4000, 600, 600]), (200, [200, 150, 150])):
            plans = load_recipe("own-gripper", gripper=franka, scenes=scenes)
            assert [plan.scenes for plan in plans.values()] == expected
        with pytest.raises(InvalidInputError, match="200 or more"):
            load_recipe("own-gripper", gripper=franka, scenes=199)

    def test_a_smaller_benchmark_is_tested_on_as_much(self):
        plans = load_recipe("graspmap-v1", scenes=800)
        assert [plan.scenes for plan in plans.values()] == [800, 150, 240, 180, 180]

    def test_camera_and_families_are_those_of_the_benchmark(self):
        own = load_recipe("own-gripper", gripper=load_gripper("franka"))
        known = load_recipe("graspmap-v1")
        assert own["train"].randomisation == known["train"].randomisation
        assert {plan.families for plan in own.values()} == {known["train"].families}
        seeds = [plan.seed for plans in (own, known) for plan in plans.values()]
        assert len({*seeds}) == len(seeds)

    def test_someone_says_whose_grasps(self, capsys, tmp_path):
        words = ("generate", "--out", tmp_path / "out", "--recipe")
        code, _, err = run(capsys, *words, "own-gripper")
        assert code == 2
        assert "--gripper is missing; allowed: the gripper that recipe own-gripper" in err
        code, _, err = run(capsys, *words, "graspmap-v1", "--gripper", "franka")
        assert code == 2
        assert "--gripper is franka; allowed: none: recipe graspmap-v1 says that" in err

    def test_generate_takes_a_gripper_and_a_size_for_it(self, monkeypatch, capsys, tmp_path):
        (tmp_path / "tiny.yaml").write_text(RECIPE)
        monkeypatch.setitem(recipe.SHIPPED, "tiny", tmp_path / "tiny.yaml")
        code, out, _ = run(
            capsys, "generate", "--recipe", "tiny", "--gripper", NARROW, "--parts", "validation",
            "--scenes", 6, "--workers", 1, "--out", tmp_path / "out",
        )  # fmt: skip
        assert code == 0
        assert "3 scenes of 3 objects" in out
        scenes = read_scenes(f"jacquard:{tmp_path / 'out' / 'validation'}")
        assert scene_gripper(scenes, 0) == load_gripper(NARROW)

    def test_no_scene_is_no_recipe(self, tmp_path):
        (tmp_path / "none.yaml").write_text(RECIPE.replace("scenes: 12", "scenes: 0"))
        with pytest.raises(ConfigError, match=r"parts\.train: scenes is 0"):
            load_recipe(tmp_path / "none.yaml", gripper=load_gripper("franka"))
