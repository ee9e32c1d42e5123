"""The command line: what users type, read and script against."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from graspmap import cli
from graspmap.cli.frame import plain, write_json
from graspmap.data import Scene, write_jacquard, write_predictions
from graspmap.errors import FileError
from graspmap.geometry import Grasps

COMMANDS = [*cli.COMMANDS]


def run(capsys, *words):
    """(exit code, standard output, standard error) of one command."""
    code = cli.main([str(word) for word in words])
    out, err = capsys.readouterr()
    return code, out, err


def refused(capsys, *words):
    """The one line that a mistake is answered with."""
    code, out, err = run(capsys, *words)
    lines = [line for line in err.splitlines() if "error" in line]
    assert code == 2
    assert out == ""
    assert "Traceback" not in err
    assert len(lines) == 1
    assert lines[0].startswith("graspmap: error: ")
    return lines[0]


@pytest.fixture(scope="session")
def weights(tmp_path_factory):
    """A small depth network that has learned nothing."""
    from graspmap.inference import WeightsCard, save_weights
    from graspmap.networks import make_network

    path = tmp_path_factory.mktemp("weights") / "w.safetensors"
    card = WeightsCard(network="ggcnn2", channels="depth", size=64, width_scale_px=30.0)
    save_weights(path, make_network("ggcnn2", 1, 1), card)
    return path


@pytest.fixture(scope="session")
def pictures(tmp_path_factory):
    """Colour and depth of one view, and a mask of another size."""
    folder = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(0)
    cv2.imwrite(str(folder / "rgb.png"), rng.integers(0, 255, (60, 80, 3), dtype=np.uint8))
    cv2.imwrite(str(folder / "depth.tiff"), rng.uniform(0.4, 0.6, (60, 80)).astype(np.float32))
    cv2.imwrite(str(folder / "mm.tiff"), rng.uniform(400, 600, (60, 80)).astype(np.float32))
    cv2.imwrite(str(folder / "holes.tiff"), np.zeros((60, 80), np.float32))
    cv2.imwrite(str(folder / "mask.png"), np.full((30, 40), 255, np.uint8))
    (folder / "cut.tiff").write_bytes((folder / "depth.tiff").read_bytes()[:400])
    (folder / "empty.tiff").write_bytes(b"")
    return folder


@pytest.fixture
def scenes(tmp_path):
    """Two labelled scenes in Jacquard's layout."""
    root = tmp_path / "scenes"
    rgb = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    grasps = Grasps([[30, 30]], [0.3], [20], [8])
    for i in range(2):
        depth = np.full((64, 64), 0.5, np.float32)
        write_jacquard(Scene(f"{i}_thing", rgb, depth, None, grasps), root)
    return root


def test_overview_and_version(capsys):
    code, out, _ = run(capsys, "--help")
    assert code == 0
    assert all(name in out for name in COMMANDS)
    assert run(capsys)[0] == 2
    assert run(capsys, "--version")[1].startswith("graspmap ")


@pytest.mark.parametrize("command", COMMANDS)
def test_each_help_has_an_example(capsys, command):
    code, out, _ = run(capsys, command, "--help")
    assert code == 0
    assert f"\n  graspmap {command} " in out


def test_help_needs_no_library():
    code = (
        "import sys; from graspmap.cli import main; main(['--help']);"
        "heavy = {'torch', 'numba', 'cv2', 'scipy', 'pydantic', 'lightning', 'rich', 'tyro'};"
        "sys.exit(bool(heavy & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["detec"], "did you mean 'detect'?"),
        (["detect", "--rbg", "f"], "did you mean --rgb?"),
        (["detect", "--top", "x"], "--top is 'x'; allowed: a whole number"),
        (["detect", "--threshold", "x"], "--threshold is 'x'; allowed: a number"),
        (["detect", "--top"], "--top"),
        (["detect", "--rgb", "a.png"], "graspmap weights import"),
        (["detect", "--weights", "w"], "the picture is not given"),
        (["detect", "--region", "1,2,3"], "X,Y,W,H"),
        (["detect", "--region", "1,2,3,nan"], "X,Y,W,H"),
        (["detect", "--weights", "w", "--rgb", "a", "--overlay", "o.gif"], ".png"),
        (["detect", "--weights", "w", "--rgb", "nowhere.png"], "nowhere.png: no such file"),
        (["evaluate", "--data", "jacquard:x"], "exactly one"),
        (["evaluate", "--weights", "w"], "--data"),
        (["evaluate", "--data", "jaquard:x", "--weights", "w"], "jacquard"),
        (["evaluate", "--data", "jacquard:nowhere", "--weights", "w"], "nowhere"),
        (["train", "nowhere.yaml", "--out", "x"], "nowhere.yaml"),
        (["train", "nowhere.yaml"], "needs --out DIR; see: graspmap train --help"),
        (["gripper", "train"], "needs GRIPPER and --out DIR; see: graspmap gripper train --help"),
        (["doctor"], "needs KIND:DIR; see: graspmap doctor --help"),
        (["doctor", "nowhere"], "nowhere: there is no such folder"),
        (["weights", "export"], "import"),
        (["weights", "import", "ggcn", "f", "o.safetensors"], "ggcnn"),
        (["weights", "import", "ggcnn", "nowhere.pt", "o.safetensors"], "nowhere.pt"),
        (["weights", "import", "ggcnn", "f", "o.pt"], ".safetensors"),
        (["weights", "import", "ggcnn", "f", "o.safetensors", "--view", "0"], "--view"),
        (["weights", "import", "ggcnn", "f", "o.safetensors", "--view", "0 cm"], "--view"),
        (["demo", "--top", "0"], "--top"),
        (["demo", "--depth", "noisy"], "perfect"),
    ],
)
def test_mistakes_get_one_line(capsys, monkeypatch, tmp_path, words, part):
    monkeypatch.chdir(tmp_path)
    assert part in refused(capsys, *words)


@pytest.mark.parametrize(
    ("depth", "extra", "part"),
    [
        ("mm.tiff", [], "millimetres"),
        ("holes.tiff", [], "depth"),
        ("cut.tiff", [], "cut.tiff"),
        ("empty.tiff", [], "empty.tiff"),
        ("depth.tiff", ["--mask", "mask.png"], "mask.png: is 40 x 30 px"),
        ("depth.tiff", ["--region", "500,500,10,10"], "region"),
        ("depth.tiff", ["--top", "0"], "top"),
        ("depth.tiff", ["--device", "nonsense"], "device"),
        ("depth.tiff", ["--camera", "rgb.png"], "rgb.png"),
    ],
)
def test_detect_refuses_bad_input(capsys, monkeypatch, weights, pictures, depth, extra, part):
    monkeypatch.chdir(pictures)
    assert part in refused(capsys, "detect", "--weights", weights, "--depth", depth, *extra)


def test_detect_needs_the_pictures_of_its_network(capsys, weights, pictures):
    line = refused(capsys, "detect", "--weights", weights, "--rgb", pictures / "rgb.png")
    assert "depth" in line


@pytest.mark.parametrize("content", [b"", b"junk", b"\x80\x02}q\x00.", b"PK\x03\x04"])
def test_what_are_no_weights_is_refused(capsys, pictures, tmp_path, content):
    bad = tmp_path / "bad.safetensors"
    bad.write_bytes(content)
    words = ("detect", "--weights", bad, "--depth", pictures / "depth.tiff")
    assert "bad.safetensors" in refused(capsys, *words)


def test_detect_writes_what_it_says(capsys, weights, pictures, tmp_path):
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps({"fx": 80, "fy": 80, "cx": 40, "cy": 30, "width": 80,
                                  "height": 60}))  # fmt: skip
    code, out, err = run(
        capsys, "detect", "--weights", weights, "--depth", pictures / "depth.tiff",
        "--rgb", pictures / "rgb.png", "--camera", camera, "--top", 3, "--threshold", -9,
        "--overlay", tmp_path / "new" / "o.png", "--json", "-",
    )  # fmt: skip
    found = json.loads(out)
    assert code == 0
    assert found["image"] == {"width": 80, "height": 60}
    assert 1 <= len(found["grasps"]) <= 3
    assert {"x", "y", "angle", "width", "height", "quality", "position_m", "width_m"} <= set(
        found["grasps"][0]
    )
    assert "1. centre" in err
    assert cv2.imread(str(tmp_path / "new" / "o.png")).shape[2] == 3


def test_detect_for_a_gripper(capsys, weights, pictures, tmp_path):
    camera = tmp_path / "camera.json"
    camera.write_text(json.dumps({"fx": 80, "fy": 80, "cx": 40, "cy": 30, "width": 80,
                                  "height": 60}))  # fmt: skip
    words = ("detect", "--weights", weights, "--depth", pictures / "depth.tiff", "--top", 5,
             "--threshold", -9, "--gripper", "franka")  # fmt: skip
    code, out, _ = run(capsys, *words, "--camera", camera, "--json", "-")
    assert code == 0
    assert all(grasp["width_m"] <= 0.08 for grasp in json.loads(out)["grasps"])
    assert "only with --camera and --depth" in refused(capsys, *words)
    assert "'franka'" in refused(capsys, *words[:-1], "frank", "--camera", camera)


def test_results_are_refused_a_bad_place_before_the_work(capsys, weights, pictures, tmp_path):
    (tmp_path / "file").write_text("")
    words = ("detect", "--weights", weights, "--depth", pictures / "depth.tiff", "--json")
    assert "is a folder" in refused(capsys, *words, tmp_path)
    assert "file" in refused(capsys, *words, tmp_path / "file" / "x.json")


def test_evaluate_weights_and_baseline(capsys, weights, scenes, tmp_path):
    words = ("evaluate", "--data", f"jacquard:{scenes}", "--weights", weights, "--baseline")
    code, out, _ = run(capsys, *words, "--out", tmp_path / "e", "--json", tmp_path / "e.json")
    summary = json.loads((tmp_path / "e.json").read_text())
    assert code == 0
    assert summary["scenes"] == 2
    assert set(summary["success"]) == {"0.25", "0.30", "0.50", "0.75"}
    assert summary["per_scene"] == str(tmp_path / "e" / "per_scene.csv")
    assert summary["baselines"]["centre"]["scenes"] == 2
    assert summary["detector"]["network"] == "ggcnn2"
    assert json.loads((tmp_path / "e" / "evaluation.json").read_text()) == summary
    assert "always the centre" in out


def test_evaluate_reports_on_oblong_pictures_without_a_predictions_file(capsys, weights, tmp_path):
    depth = np.full((48, 64), 0.5, np.float32)
    rgb, labels = np.zeros((48, 64, 3), np.uint8), Grasps([[30, 30]], [0.3], [20], [8])
    write_jacquard(Scene("0_thing", rgb, depth, None, labels), tmp_path / "data")
    words = ("evaluate", "--data", f"jacquard:{tmp_path / 'data'}", "--weights", weights)
    code, _, told = run(capsys, *words, "--out", tmp_path / "e")
    assert code == 0
    assert "predictions.txt is not written: " in told
    assert (tmp_path / "e" / "report.html").is_file()
    assert not (tmp_path / "e" / "predictions.txt").exists()


def test_evaluate_predictions_that_are_the_labels(capsys, scenes, tmp_path):
    labels = Grasps([[30, 30]], [0.3], [20], [8])
    file = tmp_path / "p.txt"
    write_predictions(file, {f"{i}_thing": labels for i in range(2)}, size_px=64)
    words = ("evaluate", "--data", f"jacquard:{scenes}", "--predictions", file, "--json", "-")
    code, out, _ = run(capsys, *words)
    assert code == 0
    assert json.loads(out)["success"]["0.75"] == 1.0


def test_evaluate_warns_of_predictions_in_another_frame(capsys, scenes, tmp_path):
    file = tmp_path / "p.txt"
    file.write_text("0_thing\n2000;500;0;100;50\n1_thing\n500;500;0;100;50\n500;400;0;100;50\n")
    code, _, told = run(capsys, "evaluate", "--data", f"jacquard:{scenes}", "--predictions", file)
    assert code == 0
    assert "1 predicted grasps lie outside the picture (first in 0_thing)" in told
    assert "1 scenes have more than 1 grasps" in told


def test_evaluate_takes_the_depth_of_the_training(capsys, tmp_path):
    from graspmap.inference import DataCard, WeightsCard, save_weights
    from graspmap.networks import make_network

    # The stereo depth alone shows the object; in the perfect one there is nothing to see.
    rgb, stereo = np.zeros((64, 64, 3), np.uint8), np.full((64, 64), 0.5, np.float32)
    stereo[20:40, 28:36] = 0.4
    scene = Scene(
        "0_thing", rgb, np.full_like(stereo, 0.5), grasps=Grasps([[32, 30]], [0], [9], [9])
    )
    write_jacquard(scene, tmp_path / "data", stereo_depth=stereo)
    network = make_network("ggcnn2", 1, generator=torch.Generator().manual_seed(1))
    card = WeightsCard(
        network="ggcnn2",
        channels="depth",
        size=64,
        width_scale_px=30.0,
        data=DataCard(source="jacquard:elsewhere", depth="stereo"),
    )
    save_weights(tmp_path / "w.safetensors", network, card)

    def rows(*extra):
        words = ("evaluate", "--data", f"jacquard:{tmp_path / 'data'}")
        weights = ("--weights", tmp_path / "w.safetensors", "--out", tmp_path / "out")
        code, _, err = run(capsys, *words, *weights, *extra)
        assert code == 0
        return (tmp_path / "out" / "per_scene.csv").read_text(), err

    default, said = rows()
    assert "stereo depth, as in the training" in said
    assert default == rows("--depth", "stereo")[0]
    assert default != rows("--depth", "perfect")[0]


def test_a_split_that_is_not_there(capsys, weights, scenes):
    words = ("evaluate", "--data", f"jacquard:{scenes}", "--weights", weights, "--split", "test")
    assert "--split FILE.json:test" in refused(capsys, *words)


def test_evaluate_warns_of_training_scenes(capsys, weights, scenes, tmp_path):
    copy = tmp_path / "w.safetensors"
    copy.write_bytes(weights.read_bytes())
    (tmp_path / "split.json").write_text("{}")
    _, _, err = run(capsys, "evaluate", "--data", f"jacquard:{scenes}", "--weights", copy)
    assert "may have been trained on" in err


def test_train_hands_flags_to_the_experiment(capsys, monkeypatch, tmp_path, scenes):
    import graspmap.training

    file = tmp_path / "e.yaml"
    file.write_text(f"data: {{source: 'jacquard:{scenes}'}}\n")
    seen = {}

    def train(experiment, out, *, command, progress):
        seen.update(experiment=experiment, command=command)
        raise KeyboardInterrupt

    monkeypatch.setattr(graspmap.training, "train", train, raising=False)
    words = ("train", file, "--training.epochs", 3, "--network.bins=2", "--out", tmp_path / "o")
    code, _, err = run(capsys, *words)
    assert (code, err.count("\n")) == (130, 1)
    assert seen["experiment"].training.epochs == 3
    assert seen["experiment"].network.bins == 2
    assert seen["command"].startswith("graspmap train ")
    assert "training.epochs?" in refused(capsys, *words[:2], "--training.epoch", 3, *words[5:])
    assert "training.epochs" in refused(capsys, *words[:2], "--training.epochs", "x", *words[5:])


def test_doctor_of_scenes_and_weights(capsys, scenes, weights, tmp_path):
    sheet, report = tmp_path / "s.png", tmp_path / "r.json"
    code, out, _ = run(capsys, "doctor", f"jacquard:{scenes}", "--sheet", sheet, "--json", report)
    assert code == 0
    assert "opening median" in out
    assert json.loads(report.read_text())["count"] == 2
    assert cv2.imread(str(sheet)) is not None
    code, out, _ = run(capsys, "doctor", weights.parent)
    assert code == 0
    assert "66,676 parameters" in out
    assert "--sheet" in refused_after_output(capsys, "doctor", weights.parent, "--sheet", sheet)


def refused_after_output(capsys, *words):
    code, _, err = run(capsys, *words)
    assert code == 2
    return err


def test_doctor_of_broken_weights(capsys, tmp_path):
    (tmp_path / "a.pt").write_bytes(b"junk")
    code, out, _ = run(capsys, "doctor", f"weights:{tmp_path}")
    assert code == 2
    assert "a.pt" in out


def test_published_weights_from_import_to_grasp(capsys, data_dir, tmp_path):
    """The whole way with real files: the best grasp lies across the remote control."""
    source = data_dir / "weights" / "ggcnn" / "ggcnn2_epoch_50_cornell_statedict.pt"
    out = tmp_path / "w.safetensors"
    code, _, _ = run(capsys, "weights", "import", "ggcnn2", source, out)
    assert code == 0
    raw = data_dir / "cornell-raw"
    # Where the remote control lies, seen by eye: its middle, and the direction across it.
    for name, middle, across in (("pcd0100", (298, 305), 0.0), ("pcd0101", (285, 295), 90.0)):
        code, text, _ = run(
            capsys, "detect", "--weights", out, "--rgb", raw / f"{name}r.png",
            "--depth", raw / f"{name}d.tiff", "--region", "150,150,300,300", "--json", "-",
        )  # fmt: skip
        (grasp,) = json.loads(text)["grasps"]
        assert np.hypot(grasp["x"] - middle[0], grasp["y"] - middle[1]) < 45
        turn = abs((np.degrees(grasp["angle"]) - across + 90) % 180 - 90)
        assert turn < 20


def test_errors_of_the_system_are_one_line(capsys, monkeypatch):
    import graspmap.cli.doctor as command

    for error, code, part in (
        (PermissionError(13, "Permission denied", "secret.png"), 2, "secret.png"),
        (FileError("a", "b", "c"), 2, "a: b; c"),
        (KeyboardInterrupt(), 130, "stopped"),
        (MemoryError(), 2, "out of memory"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory"), 2, "out of memory"),
        (UnicodeEncodeError("utf-8", "b\udcff", 1, 2, "surrogates"), 2, "b\\udcff"),
    ):

        def fail(argv, error=error):
            raise error

        monkeypatch.setattr(command, "run", fail)
        got, _, err = run(capsys, "doctor", "x")
        assert got == code
        assert part in err
        assert err.count("\n") == 1


def test_defects_keep_their_traceback(monkeypatch):
    import graspmap.cli.doctor as command

    def fail(argv):
        raise ZeroDivisionError

    monkeypatch.setattr(command, "run", fail)
    with pytest.raises(ZeroDivisionError):
        cli.main(["doctor", "x"])


def test_a_reader_that_goes_away_is_no_error(scenes):
    line = f"{sys.executable} -m graspmap.cli doctor jacquard:{scenes} --json - | head -c 1"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True)
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr


def test_json_has_only_what_json_knows():
    value = {"a": np.float32(1.5), "b": np.array([1, np.nan]), "c": (float("inf"), None, True)}
    assert json.loads(json.dumps(plain(value))) == {
        "a": 1.5,
        "b": [1.0, None],
        "c": [None, None, True],
    }


def test_detect_names_the_file_that_holds_nothing(capsys, weights, pictures, tmp_path):
    words = ["detect", "--weights", weights]
    holes, empty, camera = tmp_path / "holes.tiff", tmp_path / "0.png", tmp_path / "c.json"
    cv2.imwrite(str(holes), np.zeros((60, 80), np.float32))
    cv2.imwrite(str(empty), np.zeros((60, 80), np.uint8))
    camera.write_text('{"fx": 9, "fy": 9, "cx": 0, "cy": 0, "width": 81, "height": 60}')
    assert str(holes) in refused(capsys, *words, "--depth", holes)
    words += ["--depth", pictures / "depth.tiff"]
    assert str(empty) in refused(capsys, *words, "--mask", empty)
    assert str(camera) in refused(capsys, *words, "--camera", camera)


def test_what_a_command_reads_is_not_replaced(capsys, weights, pictures, tmp_path):
    copy = tmp_path / "rgb.png"
    copy.write_bytes((pictures / "rgb.png").read_bytes())
    words = ("detect", "--weights", weights, "--rgb", copy, "--depth", pictures / "depth.tiff")
    assert "another name" in refused(capsys, *words, "--overlay", tmp_path / "." / "rgb.png")
    assert "another name" in refused(capsys, *words, "--json", weights)
    assert copy.read_bytes() == (pictures / "rgb.png").read_bytes()


def test_a_device_or_a_pipe_can_take_the_json(capsys, weights, pictures):
    words = ("detect", "--weights", weights, "--depth", pictures / "depth.tiff")
    assert run(capsys, *words, "--json", os.devnull)[0] == 0
    assert not Path(os.devnull).is_file()


def test_negative_seed(capsys, scenes, weights):
    words = ("evaluate", "--data", f"jacquard:{scenes}", "--weights", weights, "--seed", -1)
    assert "--seed" in refused(capsys, *words)


def test_an_old_terminal_and_a_full_disk_behind_it():
    code = "import sys; from graspmap.cli import main; sys.exit(main(['doctor', '.']))"
    patch = "import graspmap.cli.doctor as d; d.run = lambda a: print('caf\u00e9'); "
    old = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", patch + code], capture_output=True, env=old)
    assert (done.returncode, done.stdout) == (0, b"caf\\xe9\n")
    if Path("/dev/full").is_char_device():
        with open("/dev/full", "w") as full:  # noqa: PTH123  # Path.open would look at its size
            done = subprocess.run(
                [sys.executable, "-c", patch + code], stdout=full, stderr=subprocess.PIPE
            )
        assert done.returncode == 2
        assert done.stderr == (
            b"graspmap: error: standard output: the disk is full; free some space, then run again\n"
        )


def test_json_for_an_old_terminal_is_still_json(monkeypatch, tmp_path):
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii", errors="backslashreplace")
    monkeypatch.setattr(sys, "stdout", out)
    write_json({"name": "caf\u00e9"}, Path("-"))
    out.seek(0)
    assert json.load(out) == {"name": "caf\u00e9"}
    write_json({"name": "\udcff"}, tmp_path / "a.json")
    assert json.loads((tmp_path / "a.json").read_bytes()) == {"name": "\udcff"}


def test_sigterm_ends_a_command_like_ctrl_c(capsys, monkeypatch):
    import graspmap.cli.doctor as command

    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(command, "run", lambda _: signal.raise_signal(signal.SIGTERM))
    code, _, err = run(capsys, "doctor", "x")
    assert (code, err) == (130, "graspmap: stopped; finished work is kept\n")
    assert signal.getsignal(signal.SIGTERM) is before
