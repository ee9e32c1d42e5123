"""Cards: calibration by trials, evaluations noted, weights by name, and what is refused."""

from __future__ import annotations

import json
import shutil
from hashlib import blake2b

import cv2
import numpy as np
import pytest
import torch

from graspmap import cli, read_scenes
from graspmap.data import write_predictions
from graspmap.data.fingerprint import data_hash
from graspmap.data.split import Split, fingerprint
from graspmap.errors import (
    FileFormatError,
    InvalidInputError,
    MissingFileError,
    UnknownNameError,
)
from graspmap.evaluation import TrialPlan, try_grasps
from graspmap.evaluation.cards import (
    calibrate,
    check_not_trained_on,
    evaluation_card,
    evaluation_name,
)
from graspmap.evaluation.run_folder import read_run_folder
from graspmap.geometry import Grasps
from graspmap.inference import (
    DataCard,
    Detector,
    EvaluationCard,
    WeightsCard,
    default_weights,
    load_weights,
    save_weights,
    shipped,
    shipped_weights,
    weights_hash,
    weights_path,
)
from graspmap.networks import make_network
from graspmap.simulation.trial import Perturbation

pytestmark = pytest.mark.usefixtures("one_thread")


def run(capsys, *words):
    """(exit code, standard output, standard error) of one command."""
    code = cli.main([str(word) for word in words])
    out, err = capsys.readouterr()
    return code, out, err


def small(path, channels="depth", **more):
    """A small network that has learned nothing, but is sure of everything."""
    card = WeightsCard(network="ggcnn2", channels=channels, size=64, width_scale_px=30.0, **more)
    count = {"depth": 1, "rgb": 3, "rgbd": 4}[channels]
    network = make_network("ggcnn2", count, 1, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        network.heads.layer.bias[0] += 0.5
    save_weights(path, network, card)
    return path


def known_trials(root, **plan):
    """Trials of labels, which hold, said to be good, and beside the objects, said to be poor."""
    scenes = read_scenes(f"jacquard:{root}")
    grasps = {}
    for scene in scenes:
        label = scene.grasps[:2]
        quality = [0.9, 0.95]
        poor = label.replace(center=[[6, 6], [120, 6]])
        grasps[scene.id] = Grasps.concatenate(
            [label.replace(quality=quality), poor.replace(quality=[0.6, 0.7])]
        )
    return try_grasps(grasps, scenes, TrialPlan(top=4, **plan)), scenes


def test_trials_become_a_calibration(generated):
    trials, scenes = known_trials(generated)
    held = np.array([t.outcome == "held" for t in trials.tried])
    said = np.array([t.grasp.quality[0] for t in trials.tried])
    assert held[said > 0.8].all()
    assert not held[said < 0.8].any()
    found = calibrate(trials, scenes, part="validation", depth="stereo")
    assert (found.trials, found.held, found.objects, found.top) == (12, 6, 3, 4)
    assert (found.part, found.depth, found.grippers) == ("validation", "stereo", ("jacquard",))
    assert found.before.ece == pytest.approx((0.6 + 0.7 + 0.1 + 0.05) / 4)
    assert found.before.brier == pytest.approx((0.36 + 0.49 + 0.01 + 0.0025) / 4)
    assert found.after.ece < 0.25
    manifest = (generated / "manifest.json").read_bytes()
    assert found.data_hash == f"manifest:{blake2b(manifest, digest_size=16).hexdigest()}"
    sure, poor = found.quality_map([0.95, 0.6])
    assert sure > 0.7
    assert poor < 0.3


def test_each_perturbed_repeat_is_a_trial(generated):
    trials, scenes = known_trials(generated, perturbation=Perturbation(position_m=0.004), repeats=3)
    found = calibrate(trials, scenes)
    assert found.trials == 36
    shares = [t.placed.result.success_probability for t in trials.tried]
    assert found.held == round(3 * sum(shares))
    assert found.perturbation == (0.004, 0, 0, 0)


def test_the_hash_of_data_without_a_manifest_is_that_of_ids_and_objects(generated, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(generated, copy)
    (copy / "manifest.json").unlink()
    scenes = read_scenes(f"jacquard:{copy}")
    assert data_hash(scenes) == f"scenes:{fingerprint(scenes)}"


def test_scenes_of_the_training_are_refused(generated, tmp_path, caplog):
    scenes = read_scenes(f"jacquard:{generated}")
    ids, mark = scenes.ids, fingerprint(scenes)
    split = Split({"train": ids[:1], "validation": ids[1:2], "test": ids[2:]}, "object", 0, mark)
    other = Split({"train": ids[:2], "validation": ids[2:]}, "object", 0, mark)
    trained = DataCard(source=f"jacquard:{generated}", split_hash=split.hash)
    for using, part, words in (
        (None, "", "all scenes"),
        (other, "validation", "another split"),
        (split, "train", "train, its training part"),
    ):
        with pytest.raises(InvalidInputError, match=words):
            check_not_trained_on(trained, scenes, using, part)
    check_not_trained_on(trained, scenes, split, "validation")
    assert not caplog.records
    check_not_trained_on(trained, scenes, split, "test")
    assert "test scenes" in caplog.text
    whole = trained.model_copy(update={"validation_source": "jacquard:elsewhere"})
    with pytest.raises(InvalidInputError, match="jacquard:elsewhere"):
        check_not_trained_on(whole, scenes, split, "validation")
    # A copy of them elsewhere is known by its content.
    moved = DataCard(
        source="jacquard:/elsewhere", split_hash=split.hash, data_hash=data_hash(scenes)
    )
    with pytest.raises(InvalidInputError, match="all scenes"):
        check_not_trained_on(moved, scenes, None, "")
    for nothing in (None, DataCard(source=f"jacquard:{tmp_path}", split_hash=split.hash)):
        check_not_trained_on(nothing, scenes, None, "")


def test_from_trials_to_a_card_that_says_it_all(capsys, generated, tmp_path):
    raw, calibrated, noted = (tmp_path / f"{name}.safetensors" for name in "abc")
    data = f"jacquard:{generated}"
    small(raw)
    code, out, _ = run(
        capsys, "weights", "calibrate", raw, "--data", data, "--top", 2, "--workers", 1,
        "--out", calibrated, "--json", tmp_path / "c.json",
    )  # fmt: skip
    assert code == 0
    assert "cross-fitted over objects" in out
    network, card = load_weights(calibrated)
    assert json.loads((tmp_path / "c.json").read_text()) == card.calibration.model_dump(mode="json")
    assert card.calibration.objects == 3
    before, after = load_weights(raw)[0].state_dict(), network.state_dict()
    assert all(torch.equal(before[name], after[name]) for name in before)

    words = ("evaluate", "--data", data, "--weights", calibrated, "--trials", "--workers", 1)
    code, _, _ = run(capsys, *words, "--out", tmp_path / "report")
    assert code == 0
    summary = json.loads((tmp_path / "report" / "evaluation.json").read_text())
    code, _, err = run(
        capsys, "weights", "note", calibrated, "--evaluation", tmp_path / "report", "--weakness",
        "thin rods", "--licence", "Apache-2.0", "--out", noted,
    )  # fmt: skip
    assert code == 0
    assert "on the scenes of the calibration" in err
    found = load_weights(noted)[1].evaluations[generated.name]
    assert found.success == summary["success"]
    assert found.trials.success == summary["trials"]["success"]
    assert found.trials.quality.ece == summary["calibration"]["ece"]
    assert found.data_hash == card.calibration.data_hash
    assert weights_hash(*load_weights(noted)) == weights_hash(network, card)

    code, out, _ = run(capsys, "weights", "show", noted, "--json", tmp_path / "show.json")
    assert code == 0
    for words in (
        f"{generated.name} (3 scenes",
        "thin rods",
        "Apache-2.0",
        "probability",
        "trial ",
    ):
        assert words in out
    assert json.loads((tmp_path / "show.json").read_text())["hash"] == weights_hash(network, card)

    # Nor are the trials of one detector left beside the rectangles of another.
    other = ("evaluate", "--data", data, "--weights", raw, "--out", tmp_path / "report")
    code, _, err = run(capsys, *other)
    assert code == 2
    assert "holds trials of another detector" in err
    code, _, err = run(capsys, "trial", *other[1:])
    assert code == 2
    assert "holds the evaluation of another detector" in err
    assert json.loads((tmp_path / "report" / "evaluation.json").read_text()) == summary
    code, _, err = run(capsys, *other[:-2], "--jaw", "banana")
    assert code == 2
    assert "only with --trials" in err
    code, _, err = run(
        capsys, "weights", "calibrate", raw, "--data", data, "--out", calibrated,
        "--json", calibrated.with_suffix(".json"),
    )  # fmt: skip
    assert code == 2

    # What was measured of the quality as it was is not said of the calibrated one.
    code, _, err = run(
        capsys, "weights", "note", raw, "--evaluation", tmp_path / "report", "--out", noted
    )
    assert code == 2
    assert "not measured with these weights" in err
    code, _, err = run(
        capsys, "weights", "calibrate", noted, "--data", data, "--workers", 1, "--out",
        tmp_path / "again.safetensors",
    )  # fmt: skip
    assert code == 0
    assert "left out" in err
    assert not load_weights(tmp_path / "again.safetensors")[1].evaluations


def test_trials_alone_say_whose_they_are(capsys, generated, tmp_path):
    """Predictions are one detector's when they say the same, wherever they lie."""
    scenes = read_scenes(f"jacquard:{generated}")
    found, moved = tmp_path / "found.txt", tmp_path / "moved.txt"
    size = max(scenes[0].shape)
    write_predictions(found, {scenes.ids[0]: scenes[0].grasps[:1]}, size_px=size)
    out = tmp_path / "report"
    data = ("--data", f"jacquard:{generated}", "--out", out, "--predictions")
    assert run(capsys, "trial", *data, found)[0] == 0
    moved.write_text(found.read_text().replace("\n", "\r\n"))
    write_predictions(found, {scenes.ids[0]: scenes[0].grasps[1:2]}, size_px=size)
    code, _, err = run(capsys, "evaluate", *data, found)
    assert code == 2
    assert "holds trials of another detector" in err
    assert run(capsys, "evaluate", *data, moved)[0] == 0
    code, _, err = run(capsys, "trial", *data, found)
    assert code == 2
    assert "holds the evaluation of another detector" in err
    evaluation = (out / "evaluation.json").read_text()
    (out / "evaluation.json").unlink()
    alone = read_run_folder(out).summary["detector"]
    assert alone["hash"] == json.loads(evaluation)["detector"]["hash"]
    with pytest.raises(MissingFileError, match="trials alone"):
        evaluation_card(out, "")
    changed = json.loads(evaluation)
    changed["detector"]["hash"] = "0"  # as after a kill between the two files
    (out / "evaluation.json").write_text(json.dumps(changed))
    with pytest.raises(FileFormatError, match="holds trials of another detector"):
        read_run_folder(out)
    (out / "evaluation.json").unlink()
    told = json.loads((out / "trials.json").read_text())
    del told["detector"]
    (out / "trials.json").write_text(json.dumps(told))
    code, _, err = run(capsys, "evaluate", *data, moved)
    assert code == 2
    assert "holds trials of a detector that it does not name" in err
    for flag, needed in (("--jaw", "--trials"), ("--camera", "--trials or --weights")):
        code, _, err = run(capsys, "evaluate", *data, moved, flag, "banana")
        assert code == 2
        assert f"only with {needed}" in err


def test_evaluations_of_other_data_have_names_of_their_own():
    def made(data, data_hash, part=None):
        numbers = {"scenes": 1, "protocol": "strict", "success": {}, "interval": {}, "miou": 0.5}
        return EvaluationCard(data=data, data_hash=data_hash, part=part, cluster="scene", **numbers)

    known = {"test": made("jacquard:/a/test", "1")}
    for card, name in (
        (made("jacquard:/a/test", "2"), "test"),  # the folder was made anew: it takes its place
        (made("jacquard:/elsewhere/test", "1"), "test"),  # a copy of it
        (made("jacquard:/b/test", "2"), "b/test"),
        (made("jacquard:/b/test", "1", "validation"), "test:validation"),
        (made("jacquard:.", "2"), "2"),
        (made("jacquard:..", "3", "test"), "3:test"),
        (made("jacquard:../b/test", "3"), "b/test"),
    ):
        assert evaluation_name(card, known) == name
    known["b/test"] = made("jacquard:/c/b/test", "3")
    assert evaluation_name(made("jacquard:/b/test", "2"), known) == "test (2)"
    assert evaluation_name(made("jacquard:/d/b/test", "4"), known) == "d/b/test"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of the weights that ship, empty."""
    folder = tmp_path / "shipped"
    folder.mkdir()
    monkeypatch.setattr(shipped, "_FOLDER", folder)
    return folder


def test_what_ships_is_small_and_whole():
    """Trivial while nothing ships; each file that does is opened."""
    paths = list(shipped_weights().values())
    assert sum(path.stat().st_size for path in paths) < 10e6
    for path in paths:
        card = Detector.load(path).card
        assert card.calibration is not None
        assert card.evaluations
        assert card.weaknesses
        assert card.licence is not None
        assert path.with_suffix(".json").is_file()


def test_weights_by_name(capsys, folder, tmp_path, monkeypatch):
    small(folder / "tiny-depth.safetensors")
    small(folder / "tiny-rgbd.safetensors", "rgbd")
    monkeypatch.chdir(tmp_path)
    assert list(shipped_weights()) == ["tiny-depth", "tiny-rgbd"]
    assert Detector.load("tiny-depth").card.channels == "depth"
    assert Detector.load().card.channels == "rgbd"
    assert default_weights(has_rgb=False).stem == "tiny-depth"
    with pytest.raises(InvalidInputError, match="none for colour pictures"):
        default_weights(has_depth=False)
    with pytest.raises(UnknownNameError) as error:
        weights_path("tiny-deep")
    assert error.value.nearest == "tiny-depth"
    for path in ("w.safetensors", "folder/w", tmp_path):
        assert weights_path(path) == tmp_path.__class__(path)
    code, out, _ = run(capsys, "weights", "list")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == ["name", "tiny-depth", "tiny-rgbd"]
    code, out, _ = run(capsys, "weights", "show", "tiny-depth")
    assert code == 0
    assert "not a probability" in out


def test_the_default_is_the_one_that_held_most(folder, generated, tmp_path, capsys):
    """Whatever it sees beside depth: the card of one says that something held."""
    for name, channels in (("a", "depth"), ("b", "depth"), ("c", "rgbd")):
        small(folder / f"{name}.safetensors", channels)
    assert default_weights().stem == "c"
    network, card = load_weights(folder / "b.safetensors")
    trials = {"trials": 5, "success": 0.4, "interval": (0.1, 0.8), "grippers": ("jacquard",)}
    measured = {
        "data": "jacquard:x", "data_hash": "manifest:0", "scenes": 5, "protocol": "strict",
        "success": {"0.25": 0.2}, "interval": {"0.25": (0.0, 0.6)}, "miou": 0.1,
        "cluster": "scene", "trials": trials,
    }  # fmt: skip
    fields = card.model_dump() | {"evaluations": {"x": measured}}
    save_weights(folder / "b.safetensors", network, WeightsCard.model_validate(fields))
    assert default_weights().stem == "b"


def test_detect_takes_what_ships_and_says_so(capsys, folder, tmp_path):
    depth = np.full((80, 80), 0.5, np.float32)
    depth[30:50, 35:45] = 0.45
    cv2.imwrite(str(tmp_path / "d.tiff"), depth)
    words = ("detect", "--depth", tmp_path / "d.tiff")
    code, _, err = run(capsys, *words)
    assert code == 2
    for way in ("none for depth pictures", "--weights", "weights import", "train"):
        assert way in err
    small(folder / "tiny-depth.safetensors")
    code, out, _ = run(capsys, *words)
    assert code == 0
    assert out.startswith("weights: tiny-depth, which ship with graspmap\n")
    assert out.count("centre") == 1
    code, by_name, _ = run(capsys, *words, "--weights", "tiny-depth")
    assert code == 0
    assert by_name == out.split("\n", 1)[1]


def test_evaluate_and_bench_take_a_name(capsys, folder, generated, tmp_path):
    small(folder / "tiny-depth.safetensors")
    words = ("evaluate", "--data", f"jacquard:{generated}", "--weights", "tiny-depth")
    code, out, _ = run(capsys, *words, "--json", "-")
    assert code == 0
    network, card = load_weights(folder / "tiny-depth.safetensors")
    assert json.loads(out)["detector"]["hash"] == weights_hash(network, card)
    code, _, _ = run(capsys, "bench", "--weights", "tiny-depth", "--size", "64x64", "--repeats", 3)
    assert code == 0


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("note", "w.safetensors", "--out", "o.safetensors"), "--evaluation"),
        (("note", "w.safetensors", "--licence", "MIT", "--out", "o.pt"), ".safetensors"),
        (("show", "nowhere.safetensors"), "no such file"),
        (
            ("calibrate", "w", "--data", "jacquard:x", "--out", "o.safetensors", "--top", "0"),
            "1 or",
        ),
        (("calibrate", "w", "--data", "jacquard:x", "--out", "o.pt"), ".safetensors"),
        (("callibrate",), "did you mean 'calibrate'"),
    ],
)
def test_mistakes_get_one_line(capsys, tmp_path, monkeypatch, words, part):
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, "weights", *words)
    assert code == 2
    assert out == ""
    assert part in err
    assert len(err.splitlines()) == 1
