"""graspmap reproduce: runs made once, shared, resumed and counted; tables and figures written."""

from __future__ import annotations

import csv
import io
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from graspmap.cli import main
from graspmap.data import Scene, make_split, read_scenes, write_jacquard
from graspmap.errors import FolderInUseError, GraspmapError, StorageFullError
from graspmap.files import locked
from graspmap.geometry import Grasps
from graspmap.inference import WeightsCard, load_weights, save_weights
from graspmap.networks import make_network
from graspmap.reproduction import crew, make_plan, timing, work
from graspmap.reproduction.crew import Crew, choose_crew, conduct
from graspmap.reproduction.request import Request
from graspmap.reproduction.results import fill
from graspmap.reproduction.timing import time_detection
from graspmap.reproduction.words import duration
from graspmap.reproduction.write import to_csv, to_dict, to_markdown, write_table
from graspmap.training import Experiment

ONE = Crew(1, 1, ("cpu",))
SIDE = 32


def write_bars(root: Path, objects: int = 8, views: int = 2) -> str:
    """Bright bars on a dark table, of two classes."""
    for thing, view in itertools.product(range(objects), range(views)):
        rng = np.random.default_rng((thing, view))
        x, y = rng.uniform(12, 19, 2)
        mask = np.zeros((SIDE, SIDE), np.uint8)
        cv2.rectangle(mask, (int(x) - 3, 4), (int(x) + 3, 27), 1, -1)
        rgb = rng.integers(30, 60, (SIDE, SIDE, 3)).astype(np.uint8)
        rgb[mask > 0] = (200, 60, 40) if thing % 2 else (40, 90, 200)
        depth = np.where(mask > 0, 0.55, 0.6).astype(np.float32)
        grasps = Grasps([[x, y]], [0.0], [12.0], [4.0])
        name = f"{view}_{thing:04d}"
        scene = Scene(name, rgb, depth, mask > 0, grasps, object_id=f"{thing:04d}")
        picture = write_jacquard(scene, root)
        labels = {"specific": "ab"[thing % 2], "general": "cd"[thing % 2]}
        record = {"objects": [{"id": "x", "labels": labels}]}
        (picture.parent / f"{name}_scene.json").write_text(json.dumps(record))
    return f"jacquard:{root}"


@pytest.fixture(scope="module")
def bars(tmp_path_factory):
    return write_bars(tmp_path_factory.mktemp("bars"))


@pytest.fixture
def flags(bars, cache):
    """Flags that make any run a matter of a second."""
    return [
        "--data", bars, "--data.size", str(SIDE), "--data.cache_dir", str(cache),
        "--folds", "1/2", "--devices", "cpu", "--workers", "1",
    ]  # fmt: skip


SMALL = ["--training.epochs", "1", "--training.batches_per_epoch", "1"]


def table_of(folder: Path, name: str) -> dict:
    return json.loads((folder / name / f"{name}.json").read_text())


# A whole table, for real.


@pytest.fixture(scope="module")
def whole(bars, cache, tmp_path_factory):
    """Table 3.3 on small pictures."""
    out = tmp_path_factory.mktemp("whole")
    words = ["reproduce", "table-3.3", "--data", bars, "--data.size", str(SIDE), "--folds", "1/2",
             "--data.cache_dir", str(cache), "--devices", "cpu", "--workers", "1", "--out",
             str(out), *SMALL]  # fmt: skip
    assert main(words) == 0
    return out


def test_a_whole_table(whole, bars):
    content = table_of(whole, "table-3.3")
    assert len(content["rows"]) == 11
    for row in content["rows"]:
        success, mae = row["cells"]
        assert success["folds"] == 1
        assert 0 <= success["mean"] <= 100
        multi = row["labels"][0] == "MTG-CNN"
        assert (mae["mean"] is not None) is multi
        assert (mae["thesis"]["mean"] is not None) is multi
    assert content["rows"][0]["cells"][0]["thesis"] == {
        "text": "72.04 ± 3.44", "mean": 72.04, "spread": 3.44,
    }  # fmt: skip
    assert content["changed"]["training.epochs"] == {"thesis": 40, "here": 1}
    assert content["changed"]["data.size"] == {"thesis": 300, "here": SIDE}
    markdown = (whole / "table-3.3" / "table-3.3.md").read_text()
    assert "| MTG-CNN | RGB | Saliency | CEL/-log | 77.63 ± 0.84 | " in markdown
    assert 'Table 4.1 prints for the row "MTG-CNN / RGB / Depth / MSE"' in markdown
    assert "`training.batches_per_epoch` is 1 instead of 1000." in markdown
    table = list(csv.reader(io.StringIO((whole / "table-3.3" / "table-3.3.csv").read_text())))
    assert len({len(row) for row in table}) == 1
    assert len(table) == 12


def test_a_run_leaves_a_folder_without_checkpoints(whole):
    runs = sorted((whole / "runs").iterdir())
    assert len(runs) == 11
    for folder in runs:
        result = json.loads((folder / "result.json").read_text())
        network, card = load_weights(folder / "train" / "weights.safetensors")
        assert result["test"] == card.metrics["test"]
        assert result["parameters"] == sum(p.numel() for p in network.parameters())
        assert not (folder / "train" / "checkpoints").exists()
        assert not (folder / "progress").exists()


def test_what_is_there_is_not_made_again(whole, flags, monkeypatch, capsys):
    def never(*_):
        raise AssertionError("a run was made twice")

    monkeypatch.setattr(crew, "do_run", never)
    before = (whole / "table-3.3" / "table-3.3.json").read_bytes()
    assert main(["reproduce", "table-3.3", *flags, *SMALL, "--out", str(whole)]) == 0
    assert (whole / "table-3.3" / "table-3.3.json").read_bytes() == before
    # The first rows of Fig. 4.8 are rows of this table: they need no run of their own.
    words = ["reproduce", "fig-4.8", *flags, *SMALL, "--out", str(whole)]
    assert main([*words, "--rows", "*CNN* / MSE"]) == 0
    assert "3 of 3 runs are there already" in capsys.readouterr().err
    assert cv2.imread(str(whole / "fig-4.8" / "fig-4.8.png")) is not None
    points = (whole / "fig-4.8" / "fig-4.8-points.csv").read_text().splitlines()
    assert points[0] == 'Model,Input,Loss,epoch,"success mean, %",spread,folds'
    assert len(points) == 1 + 3  # one epoch each


def test_class_columns(flags, tmp_path):
    words = ["reproduce", "table-3.1", *flags, *SMALL, "--out", str(tmp_path)]
    assert main([*words, "--rows", "MTG-CNN d / RGB / 0.6"]) == 0
    (row,) = table_of(tmp_path, "table-3.1")["rows"]
    assert [cell["measure"] for cell in row["cells"]] == ["success", "accuracy", "majority"]
    assert all(cell["mean"] is not None for cell in row["cells"])


@pytest.mark.slow
def test_killed_and_started_again_with_other_workers(flags, tmp_path):
    words = ["reproduce", "table-3.3", *flags, "--rows", "GG-CNN2 / RGB*", "--training.epochs", "2",
             "--training.batches_per_epoch", "2", "--out"]  # fmt: skip
    program = "import sys; from graspmap.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", program, *words, str(tmp_path / "killed"), "--workers", "2"]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    end = time.monotonic() + 90
    while time.monotonic() < end and process.poll() is None:
        found = [p.read_text() for p in (tmp_path / "killed").glob("runs/*/train/metrics.jsonl")]
        if any(text.count("\n") >= 2 for text in found):  # one epoch is done
            break
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert main([*words, str(tmp_path / "killed")]) == 0
    assert main([*words, str(tmp_path / "whole")]) == 0
    for suffix in ("json", "md", "csv"):
        killed, whole = (
            tmp_path / out / "table-3.3" / f"table-3.3.{suffix}" for out in ("killed", "whole")
        )
        assert killed.read_bytes() == whole.read_bytes()


def test_what_follows_the_training(generated, tmp_path):
    """Overlaps and simulated trials of the test part."""
    scenes = read_scenes(f"jacquard:{generated}")
    make_split(scenes, by="image").write(tmp_path / "train" / "split.json")
    card = WeightsCard(network="ggcnn", channels="depth", size=64, width_scale_px=30)
    save_weights(tmp_path / "train" / "weights.safetensors", make_network("ggcnn", 1), card)
    experiment = Experiment.model_validate({"data": {"source": f"jacquard:{generated}"}})
    tell = work._Heartbeat(tmp_path / "progress")
    curve = work._overlaps(experiment, tmp_path, "cpu", tell)
    assert len(curve["thresholds"]) == len(curve["success"]) == 101
    assert curve["success"] == sorted(curve["success"], reverse=True)
    assert (tmp_path / "per_scene.csv").is_file()
    found = work._trials(experiment, tmp_path, "cpu", tell)
    assert found["scenes"] == 1
    assert found["success"] in (0.0, 1.0)
    assert (tmp_path / "trials" / "trials.json").is_file()


# The rules of sharing, with runs that only pretend.


@pytest.fixture
def plan(bars):
    return make_plan(Request("table-4.3", bars, test_data=bars, rows="GR-ConvNet*"))


def pretend(place, run, progress=None):
    """A run that is done at once."""
    folder = place.root / run.id
    with locked(folder, "test"):
        share = int(run.id[-4:], 16) / 65536
        work._keep(folder, {"format": 1, "test": {"success": {"0.25": share}}})


def test_each_run_is_made_once(plan, tmp_path, monkeypatch):
    monkeypatch.setattr(crew, "do_run", pretend)
    outcome = conduct(plan, tmp_path, ONE)
    assert outcome.made == len(plan.runs) == 4
    assert conduct(plan, tmp_path, ONE).made == 0
    filled = fill(plan, outcome.results)
    assert to_dict(filled)["rows"][0]["cells"][0]["folds"] == 1


def test_a_run_that_another_process_has_is_waited_for(plan, tmp_path, monkeypatch):
    calls = []

    def taken(place, run, progress=None):
        calls.append(run.id)
        if calls.count(run.id) == 1 and run is plan.runs[1]:
            raise FolderInUseError(place.root, "another one is running", "wait")
        if run is plan.runs[1]:
            pretend(place, run)  # the other one did it in the meantime
            raise FolderInUseError(place.root, "another one is running", "wait")
        pretend(place, run)

    monkeypatch.setattr(crew, "do_run", taken)
    monkeypatch.setattr(crew, "_WAIT_S", 0.01)
    outcome = conduct(plan, tmp_path, ONE)
    assert set(outcome.results) == {run.id for run in plan.runs}
    assert outcome.made == 3
    assert not outcome.failures
    assert calls.count(plan.runs[1].id) == 2


def test_a_folder_is_held_while_its_run_goes_on(plan, tmp_path):
    place = work.Place(tmp_path, 1)
    with locked(tmp_path / plan.runs[0].id, "test"), pytest.raises(FolderInUseError):
        work.do_run(place, plan.runs[0])


def test_a_failed_run_is_told_and_the_others_go_on(bars, tmp_path, monkeypatch, capsys):
    def broken(place, run, progress=None):
        if run.experiment.network.name == "ggcnn2":
            raise GraspmapError("the loss is no longer a number")
        if run.experiment.network.name == "grconvnet":
            raise ValueError("a bug")
        pretend(place, run)

    monkeypatch.setattr(crew, "do_run", broken)
    words = ["reproduce", "table-4.3", "--data", bars, "--test-data", bars, "--workers", "1",
             "--devices", "cpu", "--out", str(tmp_path)]  # fmt: skip
    assert main(words) == 1
    shown = capsys.readouterr()
    assert "4 of 6 runs failed; the same command tries them again" in shown.err
    assert "| GG-CNN2 | Depth | MSE | 48.54 | 1 failed |" in shown.out
    assert "GG-CNN2 / Depth / MSE: the loss is no longer a number" in shown.out
    assert "defect: ValueError: a bug" in shown.out
    assert table_of(tmp_path, "table-4.3")["rows"][4]["cells"][0]["mean"] is not None
    monkeypatch.setattr(crew, "do_run", pretend)
    assert main(words) == 0


def test_a_full_disk_stops_everything(plan, tmp_path, monkeypatch):
    def full(place, run, progress=None):
        raise StorageFullError(tmp_path, "the disk is full", "free some space")

    monkeypatch.setattr(crew, "do_run", full)
    with pytest.raises(StorageFullError):
        conduct(plan, tmp_path, ONE)


def test_damaged_results_are_made_again(plan, tmp_path, monkeypatch):
    monkeypatch.setattr(crew, "do_run", pretend)
    conduct(plan, tmp_path, ONE)
    for run, text in zip(plan.runs, ("", "{", "[]", '{"format": 0}'), strict=True):
        (tmp_path / run.id / "result.json").write_text(text)
    assert conduct(plan, tmp_path, ONE).made == 4


def test_mean_and_spread_over_folds(bars):
    plan = make_plan(Request("table-4.2", bars, folds="2", rows="GR-ConvNet4 / Smooth"))
    results = {
        run: {"test": {"success": {"0.25": share}}}
        for run, share in zip(plan.cells[0, 0], (0.80, 0.84), strict=True)
    }
    failed = {plan.cells[0, 1][0]: "no memory"}
    filled = fill(plan, results, failed)
    rgb, depth, both = filled.cells[0]
    assert (rgb.mean, rgb.spread) == (pytest.approx(82), pytest.approx(np.std([80, 84], ddof=1)))
    assert "| GR-ConvNet4 | Smooth L1 | 75.63 ± 1.30 | 82.00 ± 2.83 | " in to_markdown(filled)
    assert depth.missing == "1 failed, 1 to do"
    assert both.missing == "2 to do"
    head, row = list(csv.reader(io.StringIO(to_csv(filled))))
    assert head[2:6] == ["RGB thesis", "RGB mean", "RGB spread", "RGB folds"]
    assert row[2:3] + row[5:6] == ["75.63 ± 1.30", "2"]


def test_success_by_threshold(bars, tmp_path):
    plan = make_plan(Request("fig-5.6", bars, folds="1/2", rows="MSE / 3"))
    steps = [i / 100 for i in range(101)]
    results = {
        run.id: {
            "test": {"success": {"0.25": 0.5}},
            "overlaps": {"thresholds": steps, "success": [(1 - t) ** n for t in steps]},
        }
        for n, run in enumerate(plan.runs, start=1)
    }
    files = write_table(fill(plan, results), tmp_path)
    assert {path.name for path in files} == {
        f"fig-5.6{end}" for end in (".png", "-points.csv", ".md", ".csv", ".json")
    }
    points = list(csv.DictReader((tmp_path / "fig-5.6-points.csv").open()))
    assert len(points) == 3 * 101
    half = [p for p in points if p["Panel"] == "e" and float(p["threshold"]) == 0.5]
    assert float(half[0]["success mean, %"]) == pytest.approx(25)
    assert "![" in (tmp_path / "fig-5.6.md").read_text()


def test_parts_that_are_not_trained_say_nothing(bars):
    plan = make_plan(Request("table-3.1", bars, folds="1/2", rows="GG-CNN2 / RGB / 0.0"))
    result = {"test": {"success": {"0.25": 0.1}, "category_accuracy": 0.5}}
    cells = fill(plan, {run.id: result for run in plan.runs}).cells[0]
    assert [cell.mean for cell in cells] == [None, 50, None]
    assert cells[0].missing == "untrained"


# Times.


def test_times_of_a_network(monkeypatch):
    monkeypatch.setattr(timing, "_SECONDS", 0.2)
    plan = make_plan(Request("table-5.3", rows="GGCNN2", changes={"data.size": SIDE}))
    found = time_detection(plan.experiments[0, 0])
    assert found["parameters"] == 72484
    assert 0 < found["network_ms"] < 5000
    assert 0 < found["grasp_ms"] < 5000
    (row,) = to_dict(fill(plan, {}, timed={0: found}))["rows"]
    assert [cell["thesis"]["text"] for cell in row["cells"]] == ["72k", "12-14", "-"]
    assert row["cells"][0]["mean"] == 72484


def test_quoted_rows_have_no_runs():
    plan = make_plan(Request("table-5.3"))
    filled = fill(plan, {}, timed={})
    assert "| Levine | 1M | - | 200-500 | - | - |" in to_markdown(filled)


# The command.


def test_dry_run(flags, capsys, tmp_path):
    out = tmp_path / "out"
    words = ["reproduce", "table-4.1", *flags, "--scale", "0.0001", "--out", str(out), "--dry-run",
             "--rows", "MTG-CNN Depth*", "--json", str(tmp_path / "runs.json")]  # fmt: skip
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert "115,973 parameters  1 epochs, 10 steps of 8  about" in shown
    assert "4 runs; about" in shown
    runs = json.loads((tmp_path / "runs.json").read_text())["runs"]
    assert len(runs) == 4
    assert {run["parameters"] for run in runs} == {115973}
    assert all(run["seconds"] > 0 for run in runs)
    assert not out.exists()


def test_the_list_of_tables(capsys):
    assert main(["reproduce"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith(("table-", "fig-")) for line in lines) == 12
    assert lines[0].startswith("table-3.1  Grasps and specific object classes on Cornell")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["table-5.4", "--data", "jacquard:x"], "did you mean 'table-5.3'?"),
        (["--data", "jacquard:x"], "no table is named"),
        (["table-5.1"], "--data is missing"),
        (["table-5.1", "extra"], "'extra' belongs to no flag"),
        (["table-5.1", "--data", "jacquard:/nowhere"], "/nowhere"),
        (["table-4.4", "--devices", "7"], "--devices is '7'; allowed: auto, cpu"),
        (["table-4.4", "--workers", "0"], "--workers is 0; allowed: 1 or more"),
        (["table-5.1", "--data", "x:y", "--seed", "-1"], "--seed is -1; allowed: 0 or more"),
        (["table-5.1", "--data", "x:y"], "kind of data set is 'x'"),
        (["table-5.1", "--data", "x:y", "--network.bin", "3"], "did you mean network.bins?"),
    ],
)
def test_mistakes_end_in_one_line(words, said, capsys):
    if "--devices" in words and torch.cuda.is_available():
        pytest.skip("there may be such a device")
    assert main(["reproduce", *words]) == 2
    shown = capsys.readouterr().err
    assert said in shown
    assert shown.count("\n") == 1


def test_data_that_give_only_some_rows(tmp_path, flags, monkeypatch, capsys):
    monkeypatch.setattr(crew, "do_run", pretend)
    for thing in range(4):
        rgb = np.full((SIDE, SIDE, 3), 40 * thing, np.uint8)
        grasps = Grasps([[16, 16]], [0.0], [12.0], [4.0])
        write_jacquard(
            Scene(f"0_{thing:04d}", rgb, grasps=grasps, object_id=f"{thing:04d}"), tmp_path / "rgb"
        )
    words = ["reproduce", "table-4.1", *flags, "--out", str(tmp_path / "out")]
    words[words.index("--data") + 1] = f"jacquard:{tmp_path / 'rgb'}"
    assert main(words) == 0
    shown = capsys.readouterr()
    assert shown.err.count("row left out: ") == 16
    assert "Row left out: MTG-CNN Depth / RGB / Pos / MSE / yes: " in shown.out
    assert main([*words, "--rows", "MTG"]) == 2
    assert "not enough for any row" in capsys.readouterr().err


def test_who_does_the_runs():
    cores = os.cpu_count() or 1
    assert choose_crew(devices="cpu") == Crew(cores, 1, ("cpu",))
    assert choose_crew(3, 2, "cpu") == Crew(3, 2, ("cpu",))
    assert choose_crew(None, cores + 1, "cpu") == Crew(1, cores + 1, ("cpu",))


def test_workers_share_gpus_out(tmp_path, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "before")
    with ExitStack() as held:
        monkeypatch.setattr(work, "_HELD", held)
        seen = []
        for worker in range(3):
            root = tmp_path / str(worker)  # a place of its own: as in another process
            place = work.Place(root, 1, ("4", "7"), tmp_path / "tickets", workers=3)
            assert work._device(place) == "cuda"
            seen.append(os.environ["CUDA_VISIBLE_DEVICES"])
        assert work._device(place) == "cuda"  # and keeps it
        assert seen == ["4", "7", "4"]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0.4, "0 s"), (99, "99 s"), (100, "2 min"), (5400, "90 min"), (7200, "2.0 h"),
     (200_000, "2.3 days")],
)  # fmt: skip
def test_rough_times(seconds, text):
    assert duration(seconds) == text


def test_the_heartbeat_says_how_far_a_run_is(tmp_path, monkeypatch):
    monkeypatch.setattr(work, "_BEAT_S", 0.0)
    beat = work._Heartbeat(tmp_path / "progress")
    with beat("packing pictures") as update:
        update(1, 2)
    assert not (tmp_path / "progress").exists()
    with beat("epoch 2 of 4") as update:
        update(1, 2)
    assert float((tmp_path / "progress").read_text()) == 0.375
