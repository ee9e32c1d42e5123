"""``graspmap trial``: what users type, read and script against."""

from __future__ import annotations

import json

import numpy as np
import pytest

from graspmap import cli
from graspmap.data import Scene, read_scenes, write_jacquard, write_predictions
from graspmap.evaluation import in_file_frame
from graspmap.geometry import Grasps


def run(capsys, *words):
    """(exit code, standard output, standard error) of ``graspmap trial``."""
    code = cli.main(["trial", *map(str, words)])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.fixture(scope="module")
def predictions(generated, tmp_path_factory):
    """Three labels of each scene, and something for a scene that is not there."""
    scenes = read_scenes(f"jacquard:{generated}")
    found = in_file_frame({scene.id: scene.grasps[:3] for scene in scenes}, scenes)
    path = tmp_path_factory.mktemp("predictions") / "p.txt"
    write_predictions(path, {**found, "77_gone": Grasps([[1, 1]], [0], [9], [9])}, size_px=1024)
    return path


def test_predictions(capsys, generated, predictions, tmp_path):
    words = ("--data", f"jacquard:{generated}", "--predictions", predictions, "--top", 2)
    code, out, err = run(
        capsys, *words, "--workers", 1, "--out", tmp_path / "o", "--json", tmp_path / "t.json"
    )
    assert code == 0
    assert "1 of 4 predictions are for scenes" in err
    assert "77_gone" in err
    assert "6 grasps in 3 scenes" in out
    assert "gripper jacquard" in out
    assert "outcomes: held" in out
    assert "by rank 1: " in out
    summary = json.loads((tmp_path / "t.json").read_text())
    assert list(summary)[:6] == ["data", "scenes", "trials", "held", "success", "interval"]
    assert (summary["scenes"], summary["trials"]) == (3, 6)
    assert summary["success"] == summary["held"] / 6
    assert sum(summary["outcomes"].values()) == 6
    assert sum(group["trials"] for group in summary["per_object"].values()) == 6
    assert summary["unknown_predictions"] == 1
    low, high = summary["interval"]
    assert 0 <= low <= summary["success"] <= high <= 1
    assert len(summary["grasps"]) == 6
    # As an entry of `graspmap detect`, with the outcome.
    assert {
        "x", "y", "angle", "width", "height", "quality", "position_m", "width_m", "outcome"
    } <= set(summary["grasps"][0])  # fmt: skip
    assert {f.name for f in (tmp_path / "o").iterdir()} == {
        ".lock", "per_grasp.csv", "trials.json"
    }  # fmt: skip
    again = run(capsys, *words, "--workers", 1, "--json", "-")
    assert json.loads(again[1])["grasps"] == summary["grasps"]
    assert "6 grasps in 3 scenes" in again[2]


def test_labels_of_a_part_with_films(capsys, generated, tmp_path):
    words = ("--data", f"jacquard:{generated}", "--labels", "--split", "test", "--top", 1)
    options = ("--workers", 1, "--shake", "--perturb", "1,1", "--repeats", 2, "--cluster", "object")
    films = tmp_path / "films"
    code, out, _ = run(capsys, *words, *options, "--animate", films, "--json", tmp_path / "t.json")
    assert code == 0
    summary = json.loads((tmp_path / "t.json").read_text())
    assert summary["trials"] == 1
    assert summary["split"]["part"] == "test"
    assert summary["cluster"] == "object"
    assert "per_rank" not in summary  # labels have no order
    assert summary["robust_success"] in (0.0, 0.5, 1.0)
    assert "robust success" in out
    assert summary["animations"] == [str(path) for path in films.iterdir()]
    assert "1 animations" in out


def test_weights(capsys, generated, tmp_path):
    from graspmap.inference import WeightsCard, save_weights
    from graspmap.networks import make_network

    weights = tmp_path / "w.safetensors"
    card = WeightsCard(network="ggcnn2", channels="depth", size=64, width_scale_px=30.0)
    save_weights(weights, make_network("ggcnn2", 1, 1), card)
    words = ("--data", f"jacquard:{generated}", "--weights", weights, "--depth", "stereo")
    code, out, err = run(
        capsys, *words, "--workers", 1, "--split", "test", "--gripper", "franka", "--top", 3,
        "--out", tmp_path / "o", "--json", tmp_path / "t.json",
    )  # fmt: skip
    assert code == 0
    assert "gripper franka" in out
    assert "no split.json lies beside the weights" in err
    summary = json.loads((tmp_path / "t.json").read_text())
    assert summary["scenes"] == 1
    assert summary["grippers"] == ["franka"]
    widths = [grasp["width_m"] for grasp in summary["grasps"]]
    assert all(width < 0.083 for width in widths)  # it opens 8 cm; others are left out
    if widths:
        assert (tmp_path / "o" / "predictions.txt").is_file()


@pytest.fixture
def colour_only(tmp_path):
    """Scenes without depth."""
    rgb, grasps = np.zeros((64, 64, 3), np.uint8), Grasps([[30, 30]], [0.3], [20], [8])
    for i in range(2):
        write_jacquard(Scene(f"{i}_thing", rgb, grasps=grasps), tmp_path / "rgb")
    return tmp_path / "rgb"


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ([], "exactly one"),
        (["--labels", "--weights", "w"], "exactly one"),
        (["--labels", "--gripper", "frank"], "did you mean 'franka'?"),
        (["--labels", "--gripper", "no.yaml"], "no.yaml"),
        (["--labels", "--depth", "stereo"], "--trial-depth"),
        (["--labels", "--trial-depth", "z"], "perfect, stereo"),
        (["--labels", "--repeats", "3"], "--perturb"),
        (["--labels", "--perturb", "1"], "MM,DEG"),
        (["--labels", "--perturb", "1,-1"], "--perturb is '1,-1', so angle_rad is -0.01745"),
        (["--labels", "--perturb", "x,y"], "--perturb is 'x,y'; allowed: numbers MM,DEG,"),
        (["--labels", "--top", "0"], "--top"),
        (["--labels", "--jaw", "-3"], "--jaw"),
        (["--labels", "--jaw", "wide"], "--jaw"),
        (["--labels", "--seed", "-1"], "--seed"),
        (["--labels", "--workers", "-1"], "--workers"),
        (["--labels", "--split", "tst"], "test"),
        (["--labels", "--camera", "no.json"], "no.json"),
        (["--labels", "--shak"], "--shake"),
        (["--predictions", "no.txt"], "no.txt"),
        (["--weights", "no.safetensors"], "no.safetensors"),
    ],
)
def test_mistakes_get_one_line(capsys, monkeypatch, generated, tmp_path, words, part):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "--data", f"jacquard:{generated}", *words)
    assert code == 2
    assert out == ""
    lines = [line for line in err.splitlines() if line.startswith("graspmap: error: ")]
    assert len(lines) == 1
    assert part in lines[0]


def test_a_file_for_another_data_set_is_refused(capsys, generated, tmp_path):
    path = tmp_path / "p.txt"
    write_predictions(path, {"3_mug": Grasps([[1, 1]], [0], [9], [9])}, size_px=1024)
    code, _, err = run(capsys, "--data", f"jacquard:{generated}", "--predictions", path)
    assert code == 2
    assert "1 of 1 not in" in err
    assert "3_mug" in err


def test_scenes_that_cannot_be_tried_are_told_once(capsys, colour_only):
    code, _, err = run(capsys, "--data", f"jacquard:{colour_only}", "--labels", "--workers", 1)
    assert code == 2
    assert err.count("depth is missing") == 1
    assert "2, none of which can be tried" in err
