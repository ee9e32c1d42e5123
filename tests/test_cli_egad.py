"""``graspmap evaluate egad``: what users type, read and script against."""

from __future__ import annotations

import csv
import json

import pytest

from box_mesh import write_box
from graspmap import cli
from graspmap.inference import WeightsCard, save_weights
from graspmap.networks import make_network


def run(capsys, *words):
    """(exit code, standard output, standard error) of ``graspmap evaluate egad``."""
    code = cli.main(["evaluate", "egad", *map(str, words)])
    out, err = capsys.readouterr()
    return code, out, err


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    write_box(folder / "B1.obj", (100, 25, 30))
    (folder / "torn.obj").write_text("v 0 0 nan\nv 0 1 0\nv 1 0 0\nf 1 2 3\n")
    return folder


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    card = WeightsCard(network="ggcnn2", channels="depth", size=64, width_scale_px=30.0)
    save_weights(path, make_network("ggcnn2", 1), card)
    return path


def test_egad(capsys, meshes, weights, tmp_path):
    words = ("--meshes", meshes, "--weights", weights, "--gripper", "franka", "--size", 96)
    code, out, err = run(
        capsys, *words, "--trials", 2, "--top", 2, "--candidates", 10, "--distance", 0.6,
        "--shake", "--perturb", "1,1", "--repeats", 2, "--workers", 1, "--out", tmp_path / "o",
        "--json", tmp_path / "e.json",
    )  # fmt: skip
    assert code == 0
    assert "1 object of" in out
    assert "gripper franka, stereo depth" in out
    assert "success in percent" in out
    assert "on a robot, thesis: 77%" in out
    assert "robust success" in out
    assert "1 mesh left out" in out
    assert "mesh torn.obj is left out" in err
    summary = json.loads((tmp_path / "e.json").read_text())
    assert summary == json.loads((tmp_path / "o" / "evaluation.json").read_text())
    assert summary["detector"]["parameters"] == 66_676
    egad = summary["egad"]
    assert (egad["trials"], egad["objects"], egad["gripper"]) == (2, 1, "franka")
    assert sum(egad["outcomes"].values()) == 2
    assert list(egad["broken"]) == ["torn.obj"]
    assert egad["grid"]["success"][1][1] == egad["success"]
    with (tmp_path / "o" / "per_try.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["mesh"] for row in rows} == {"B1"}
    assert {row["number"] for row in rows} == {"0", "1"}
    assert {f.name for f in (tmp_path / "o").iterdir()} == {
        ".lock", "evaluation.json", "per_try.csv", "report.html"
    }  # fmt: skip


def test_the_same_result_without_a_folder(capsys, meshes, weights, tmp_path):
    words = ("--meshes", meshes, "--weights", weights, "--gripper", "franka", "--size", 96)
    options = ("--trials", 1, "--candidates", 0, "--depth", "perfect", "--workers", 1)
    code, out, err = run(capsys, *words, *options, "--json", "-")
    assert code == 0
    assert "1 object of" in err
    found = json.loads(out)["egad"]
    assert found["per_try"] is None
    assert found["ceiling"] is None
    run(capsys, *words, *options, "--out", tmp_path)
    again = json.loads((tmp_path / "evaluation.json").read_text())["egad"]
    same = ("success", "outcomes", "per_object", "grid", "interval", "broken")
    assert {key: found[key] for key in same} == {key: again[key] for key in same}


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--gripper", "frank"], "did you mean 'franka'?"),
        (["--trials", "0"], "--trials"),
        (["--top", "0"], "--top"),
        (["--candidates", "-1"], "--candidates"),
        (["--seed", "-1"], "--seed"),
        (["--workers", "-1"], "--workers"),
        (["--repeats", "2"], "--perturb"),
        (["--perturb", "1"], "MM,DEG"),
        (["--distance", "0"], "--distance"),
        (["--depth", "sonar"], "stereo"),
        (["--size", "10"], "size_px"),
        (["--randomisation", "none"], "plain"),
        (["--meshes", "nowhere"], "no such folder"),
        (["--weights", "no.safetensors"], "no.safetensors"),
        (["--shak"], "--shake"),
        (["--data", "jacquard:x"], "--data"),
    ],
)
def test_mistakes_get_one_line(capsys, monkeypatch, meshes, weights, tmp_path, words, part):
    monkeypatch.chdir(tmp_path)
    given = {"--meshes": meshes, "--weights": weights, "--gripper": "franka"}
    first = [word for flag, value in given.items() if flag not in words for word in (flag, value)]
    code, out, err = run(capsys, *first, *words)
    assert (code, out) == (2, "")
    lines = [line for line in err.splitlines() if line.startswith("graspmap: error: ")]
    assert len(lines) == 1
    assert part in lines[0]


def test_help(capsys):
    code, out, _ = run(capsys, "--help")
    assert code == 0
    assert "graspmap evaluate egad --meshes" in out
    assert "--trials" in out
