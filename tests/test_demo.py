"""The scenes that ship with graspmap, and the demo on them."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from graspmap import cli, read_scenes
from graspmap.data import JacquardScenes, example_scenes, examples
from graspmap.generation.entries import ItemEntry
from graspmap.generation.item import Attempt, make_item, staging_folder
from graspmap.generation.ledger import file_hash
from graspmap.generation.recipe import load_recipe
from graspmap.generation.scene_file import read_record, versions
from graspmap.geometry import Camera
from graspmap.inference import WeightsCard, save_weights, shipped, shipped_weights
from graspmap.networks import make_network
from page_numbers import Page, check_numbers

MOST_BYTES = 5_000_000


@pytest.fixture(scope="module")
def manifest():
    return json.loads((example_scenes() / "manifest.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def plan():
    (plan,) = load_recipe("graspmap-examples").values()
    return plan


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A network that has learned nothing, but is sure that everything can be grasped."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = make_network("ggcnn2", 4, 1)
    with torch.no_grad():
        network.heads.layer.bias[0] += 10
    card = WeightsCard(
        network="ggcnn2", channels="rgbd", size=96, view="contain", width_scale_px=40.0
    )
    path = tmp_path_factory.mktemp("shipped") / "tiny.safetensors"
    save_weights(path, network, card)
    return path


def run(capsys, *words):
    code = cli.main([str(word) for word in words])
    return code, *capsys.readouterr()


class TestExamples:
    def test_each_has_everything(self):
        for depth in ("perfect", "stereo"):
            for scene in read_scenes("examples", depth=depth):
                assert scene.rgb is not None
                assert np.isfinite(scene.depth).mean() > 0.5
                assert scene.mask.any()
                assert scene.camera is not None
                assert len(scene.grasps) > 10
                assert set(scene.labels) == {"specific", "general"}

    def test_known_families_tools_and_wild_bodies(self):
        families = [scene.labels["general"] for scene in read_scenes("examples")]
        assert len(families) == 10
        assert len(set(families)) >= 7
        assert families.count("tool") >= 2
        assert families.count("blob") >= 2

    def test_name_and_folder_are_the_same_scenes(self):
        named = read_scenes("examples")
        assert isinstance(named, JacquardScenes)
        assert named.root == example_scenes()
        assert read_scenes(example_scenes()).ids == named.ids
        assert read_scenes(f"jacquard:{example_scenes()}").ids == named.ids

    def test_a_folder_of_that_name_is_a_path(self, tmp_path, monkeypatch, generated):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "examples").symlink_to(generated)
        assert read_scenes(Path("examples")).ids == read_scenes("jacquard:examples").ids
        assert len(read_scenes("./examples")) == 3
        assert len(read_scenes("examples")) == 10

    def test_files_are_those_that_the_recipe_made(self, manifest, plan):
        made = json.loads(json.dumps(plan.to_dict()))
        assert {key: manifest["plan"].get(key) for key in made} == made
        hashes = {name: file_hash(example_scenes() / name) for name in manifest["files"]}
        assert hashes == manifest["files"]

    def test_small_enough_for_a_package(self, manifest):
        sizes = [os.path.getsize(example_scenes() / name) for name in manifest["files"]]  # noqa: PTH202
        assert sum(sizes) < MOST_BYTES

    def test_every_table_is_made_again(self):
        for path in example_scenes().glob("*/*_scene.json"):
            assert len(read_record(path).tabletop().objects) == 1

    def test_a_scene_comes_out_the_same(self, manifest, plan, tmp_path):
        """The pictures and labels to the byte, the record but for the version of graspmap."""
        old = dict(manifest["plan"]["versions"])
        if {**old, "graspmap": ""} != {**versions(), "graspmap": ""}:
            pytest.skip(f"the example scenes were made with other libraries: {old}")
        name = read_scenes("examples").ids[0]
        record = next(example_scenes().glob(f"*/{name}_scene.json"))
        _, item, attempt, *_ = read_record(record).seed
        made = make_item(plan, tmp_path, (), Attempt(item, attempt))
        assert isinstance(made, ItemEntry)
        assert len(made.files) == 8
        for path, value in made.files.items():
            if not path.endswith("_scene.json"):
                assert manifest["files"][path] == value, path
        (again,) = staging_folder(tmp_path, item).rglob("*_scene.json")
        old, new = (json.loads(path.read_text(encoding="utf-8")) for path in (record, again))
        assert {**old, "versions": None} == {**new, "versions": None}


class TestDemo:
    def test_end_to_end(self, capsys, monkeypatch, tmp_path, weights):
        monkeypatch.setattr(shipped, "_FOLDER", weights.parent)
        out = tmp_path / "d"
        code, printed, told = run(capsys, "demo", "--out", out, "--top", 2, "--json", "-")
        assert code == 0
        summary = json.loads(printed)
        assert summary == json.loads((out / "demo.json").read_text(encoding="utf-8"))
        assert summary["weights"] == "tiny"
        assert summary["best"]["trials"] == len(summary["gallery"]) == 10
        assert list(summary["trials"]["one_of_first"].values())[-1]["trials"] == 10
        for name in ("teacup", "trowel", "knot"):
            assert name in told
        assert "best grasps held in physics" in told
        picture = cv2.imread(summary["picture"])
        assert min(picture.shape[:2]) > 1000
        page = Page((out / "index.html").read_text(encoding="utf-8"))
        check_numbers(page, summary)
        assert all(address.startswith("data:") for address in page.addresses)
        assert len(page.addresses) == 2 * 10 + 1  # and the icon

    def test_films_on_request(self, capsys, monkeypatch, tmp_path, weights, generated):
        """On small scenes, which take less time than those that ship."""
        monkeypatch.setattr(examples, "_FOLDER", generated)
        code, _, _ = run(capsys, "demo", "--out", tmp_path, "--weights", weights, "--animate")
        assert code == 0
        text = (tmp_path / "index.html").read_text(encoding="utf-8")
        assert text.count("data:image/webp") == 3

    def test_a_scene_that_cannot_be_tried_is_left_out(
        self, capsys, monkeypatch, tmp_path, weights, generated
    ):
        shutil.copytree(generated, tmp_path / "scenes")
        monkeypatch.setattr(examples, "_FOLDER", tmp_path / "scenes")
        path = next((tmp_path / "scenes").glob("*/*_scene.json"))
        record = json.loads(path.read_text(encoding="utf-8"))
        record["objects"][0]["fingerprint"]["mass_kg"] *= 2
        path.write_text(json.dumps(record), encoding="utf-8")
        code, told, warned = run(capsys, "demo", "--out", tmp_path / "d", "--weights", weights)
        assert code == 0
        assert "of 2 best grasps" in told
        assert path.name.removesuffix("_scene.json") in warned

    def test_no_grasp_is_a_failure(self, capsys, tmp_path):
        network = make_network("ggcnn2", 1, 1)
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.zero_()
        card = WeightsCard(network="ggcnn2", channels="depth", size=96, width_scale_px=40.0)
        path = tmp_path / "nothing.safetensors"
        save_weights(path, network, card)
        code, told, _ = run(capsys, "demo", "--out", tmp_path / "d", "--weights", path)
        assert code == 0
        assert "0 of 10 best grasps held" in told
        assert told.count("no_grasp: no grasp was predicted") == 10

    def test_without_shipped_weights_it_says_what_to_do(self, capsys, monkeypatch, tmp_path):
        monkeypatch.setattr(shipped, "_FOLDER", tmp_path)
        code, _, told = run(capsys, "demo", "--out", tmp_path / "d")
        assert code == 2
        assert "--weights" in told
        assert "graspmap train" in told
        assert "graspmap demo" not in told

    def test_the_weights_that_ship_hold_half_of_them(self, capsys, tmp_path):
        if not shipped_weights():
            pytest.skip("no weights ship yet")
        code, printed, _ = run(capsys, "demo", "--out", tmp_path / "d", "--json", "-")
        assert code == 0
        assert json.loads(printed)["best"]["held"] >= 5


def test_the_files_that_the_readme_detects_in(capsys, weights):
    folder = example_scenes() / "teacup-000000"
    name = folder / "0_teacup-000000"
    camera = Camera.read(Path(f"{name}_camera.json"))
    assert camera.width == 320
    words = ["--rgb", f"{name}_RGB.png", "--depth", f"{name}_stereo_depth.tiff"]
    words += ["--camera", f"{name}_camera.json", "--json", "-"]
    code, printed, _ = run(capsys, "detect", "--weights", weights, *words)
    assert code == 0
    assert json.loads(printed)["grasps"]
