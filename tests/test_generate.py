"""Generation: the same bytes however it is run, interrupted or damaged; and what the bytes say."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest

import graspmap.generation.item as item_module
from graspmap.cli import main
from graspmap.cli.progress import progress
from graspmap.data import read_scenes, read_split
from graspmap.data.files import read_rgb
from graspmap.data.jacquard_labels import read_negatives
from graspmap.errors import (
    FileError,
    InvalidInputError,
    StorageFullError,
    UnknownNameError,
)
from graspmap.files import locked
from graspmap.generation import generate
from graspmap.generation import run as run_module
from graspmap.generation.ledger import file_hash
from graspmap.generation.plan import GenerationPlan
from graspmap.generation.scene_file import find_record, read_record
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import load_gripper
from graspmap.simulation.render.randomisation import CameraSection, Randomisation
from graspmap.simulation.trial import run_trials

GRIPPER = load_gripper("jacquard")
PLAN = GenerationPlan(
    scenes=5, gripper=GRIPPER, views=2, seed=3, size_px=128, candidates=20, families=("primitive",)
)
NEAR = Randomisation(camera=CameraSection(distance_m=(0.5, 0.5)))
FLAGS = [
    "generate", "--scenes", "5", "--views", "2", "--seed", "3", "--size", "128",
    "--candidates", "20", "--family", "primitive",
]  # fmt: skip


def snapshot(root: Path) -> dict[str, bytes]:
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name not in (".lock", "sheet.png")
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """The plan, made in one go in this process; nobody may change it."""
    root = tmp_path_factory.mktemp("made")
    generate(PLAN, root, workers=0)
    return root


# What is in a data set.


def test_the_manifest_counts_and_hashes_everything(made):
    manifest = json.loads((made / "manifest.json").read_text())
    files = snapshot(made)
    del files["manifest.json"]
    assert {path: file_hash(made / path) for path in files} == manifest["files"]
    assert list(manifest["files"]) == sorted(manifest["files"])
    scenes = read_scenes(f"jacquard:{made}")
    counts = manifest["counts"]
    assert counts["scenes"] == len(scenes) == 5
    assert counts["objects"] == len({scenes.object_id(i) for i in range(5)}) == 3
    negatives = [read_negatives(scenes.paths(i).negatives)[1] for i in range(5)]
    assert counts["labels"] == sum(len(scenes.read_grasps(i)) for i in range(5))
    assert counts["trials"] == counts["labels"] + sum(map(len, negatives))
    assert sum(counts["outcomes"].values()) == counts["trials"]
    for outcome in ("empty", "slipped", "dropped", "collided"):
        found = sum(words.count(outcome) for words in negatives)
        assert counts["outcomes"].get(outcome, 0) == found
    text = (made / "manifest.json").read_text()
    assert str(made) not in text
    assert os.uname().nodename not in text or len(os.uname().nodename) < 4


@pytest.mark.parametrize("depth", ["perfect", "stereo"])
def test_the_reader_of_jacquard_reads_it(made, depth):
    scenes = read_scenes(f"jacquard:{made}", depth=depth)
    for scene in scenes:
        assert scene.rgb.shape == (128, 128, 3)
        assert scene.mask.any()
        assert not scene.mask.all()
        assert len(scene.grasps)
        assert scene.negatives is not None
        assert np.isfinite(scene.depth[scene.mask]).mean() > 0.8
        # The table lies under what the mask shows.
        origin = scene.T_world_camera.apply(
            scene.camera.deproject(np.argwhere(scene.mask)[:, ::-1], scene.depth[scene.mask])
        )
        assert np.nanmedian(origin[:, 2]) > 0.001
    split = read_split(made / "split.json", scenes)
    objects = [{scenes.object_id(scenes.index(n)) for n in ids} for ids in split.parts.values()]
    assert len(set.union(*objects)) == sum(map(len, objects)) == 3


def test_labels_hold_again_when_they_are_read_and_tried(made):
    """The way of any prediction: pixels, the written depth, the recorded tabletop, physics."""
    scenes = read_scenes(f"jacquard:{made}")
    for index in range(len(scenes)):
        scene, record = scenes[index], read_record(find_record(scenes.files(index)))
        assert record.view.camera == scene.camera
        _, words = read_negatives(scenes.paths(index).negatives)
        tabletop = record.tabletop()
        for grasps, expected in (
            (scene.grasps, ["held"] * len(scene.grasps)),
            (scene.negatives, list(words)),
        ):
            table = TableGrasps.from_pixels(grasps, scene.depth, scene.camera, scene.T_world_camera)
            results = run_trials(tabletop, table, record.gripper, settings=record.settings)
            assert [result.outcome.value for result in results] == expected


def test_scenes_carry_the_class_names_of_their_record(made):
    from graspmap.data.jacquard_labels import read_class_names
    from graspmap.simulation.procedural import FAMILIES

    scenes = read_scenes(f"jacquard:{made}")
    for i, scene in enumerate(scenes):
        (record,) = made.rglob(f"{scene.id}_scene.json")
        assert scene.labels == read_class_names(record)
        assert record in scenes.files(i)  # a corrected record makes another packed store
        if scene.labels:
            assert scene.labels["specific"] == scene.object_id.rpartition("-")[0]
            assert scene.labels["specific"] in FAMILIES[scene.labels["general"]].shapes
    assert any(scene.labels for scene in scenes)


def test_labels_carry_each_jaw_size_that_holds(made):
    scenes = read_scenes(f"jacquard:{made}")
    sizes = set()
    for scene in scenes:
        everything = [*scene.grasps, *scene.negatives]
        keys = [(*g.center[0], g.angle[0], g.width[0]) for g in everything]
        assert {keys.count(key) for key in keys} == {len(GRIPPER.jaw_sizes_m)}
        table = TableGrasps.from_pixels(
            scene.grasps, scene.depth, scene.camera, scene.T_world_camera
        )
        sizes |= set(table.height_m.round(4).tolist())
    assert sizes <= set(GRIPPER.jaw_sizes_m)
    assert len(sizes) > 1


def test_records_say_where_scenes_come_from(made):
    scenes = read_scenes(f"jacquard:{made}")
    for index, name in enumerate(scenes.ids):
        record = read_record(find_record(scenes.files(index)))
        number = int(name.split("_")[0])
        assert record.id == name
        assert record.gripper == GRIPPER
        assert record.seed[:2] == (3, number // 2)
        assert record.seed[3] == number % 2
        assert record.objects[0].source.seed == 3
        assert {"graspmap", "mujoco", "manifold3d", "numba"} <= record.versions.keys()


# The same bytes.


@pytest.mark.parametrize("workers", [1, 2])
def test_workers_do_not_change_a_byte(made, tmp_path, workers):
    generate(PLAN, tmp_path, workers=workers)
    assert snapshot(tmp_path) == snapshot(made)


def test_killed_at_any_moment_it_goes_on_to_the_same_bytes(made, tmp_path):
    """Ctrl-C of all, kill -9 of the parent, kill -9 of one worker; then the rest is made."""
    flags = [*FLAGS, "--workers", "2", "--out", str(tmp_path)]
    rng = np.random.default_rng(os.getpid())
    for everybody, number in ((True, signal.SIGINT), (False, signal.SIGKILL)):
        run = subprocess.Popen(
            [sys.executable, "-m", "graspmap.cli", *flags],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        # A quick machine has finished, in this round or the one before.
        wait_for(lambda run=run: (tmp_path / "unfinished.jsonl").exists() or run.poll() is not None)
        time.sleep(rng.uniform(0, 3))
        with suppress(ProcessLookupError):
            (os.killpg if everybody else os.kill)(run.pid, number)
        words = run.communicate()[1]
        if everybody and run.returncode != 0:
            assert run.returncode == 130
            assert words.splitlines()[-1] == "graspmap: stopped; finished work is kept"
            assert "Traceback" not in words
        wait_for(lambda group=run.pid: not alive(group))  # workers end with their parent
    # With nothing left to make there is no worker to kill.
    kills, whole = [], len(list(tmp_path.glob("*/*_scene.json"))) == PLAN.scenes
    generate(PLAN, tmp_path, workers=2, progress=lambda _: kill_context(kills))
    assert whole or len(kills) == 1
    assert snapshot(tmp_path) == snapshot(made)


def wait_for(condition):
    deadline = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def alive(group):
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@contextmanager
def kill_context(kills):
    """Kills one worker when the first progress is reported with workers at work."""

    def update(done, total):
        workers = active_children()
        if workers and not kills:
            kills.append(workers[0].pid)
            os.kill(workers[0].pid, signal.SIGKILL)

    yield update


def test_a_damaged_scene_is_made_again(made, tmp_path):
    root = tmp_path / "set"
    shutil.copytree(made, root)
    files = sorted(root.rglob("*_perfect_depth.tiff"))
    files[0].write_bytes(files[0].read_bytes()[:-5])
    sorted(root.rglob("*_scene.json"))[-1].unlink()
    generate(PLAN, root, workers=0)
    assert snapshot(root) == snapshot(made)


def test_more_scenes_are_added(made, tmp_path):
    generate(replace(PLAN, scenes=3), tmp_path, workers=0)
    generate(PLAN, tmp_path, workers=0)
    assert snapshot(tmp_path) == snapshot(made)


def test_a_full_disk_stops_it_and_it_goes_on_later(made, tmp_path, monkeypatch):
    original, count = item_module.write_record, 0

    def full(record, folder):
        nonlocal count
        count += 1
        if count == 3:
            raise StorageFullError(folder, "the disk is full", "free some space")
        return original(record, folder)

    monkeypatch.setattr(item_module, "write_record", full)
    with pytest.raises(StorageFullError):
        generate(PLAN, tmp_path, workers=0)
    monkeypatch.undo()
    assert (tmp_path / "unfinished.jsonl").exists()
    assert len(list(tmp_path.glob("*/*_RGB.png"))) == 2
    generate(PLAN, tmp_path, workers=0)
    assert snapshot(tmp_path) == snapshot(made)


def test_another_plan_or_a_second_run_is_refused(made, monkeypatch):
    before = snapshot(made)
    changed = replace(PLAN, seed=4, gripper=replace(GRIPPER, force_n=20))
    with pytest.raises(FileError, match=r"seed: 3 -> 4; gripper\.force_n: 50\.0 -> 20\.0"):
        generate(changed, made, workers=0)
    with locked(made, "generation"), pytest.raises(FileError, match="another generation"):
        generate(PLAN, made, workers=0)
    assert snapshot(made) == before


def test_what_is_whole_stays_whole_after_an_upgrade(tmp_path, made, monkeypatch):
    """Nothing is to be made, so nothing is mixed; else versions are refused as any other plan."""
    before = snapshot(made)
    monkeypatch.setattr(run_module, "versions", lambda **_: {"graspmap": "0"})
    told = replace(PLAN, gripper=replace(GRIPPER, description="the same, in other words"))
    generate(told, made, workers=0)
    assert snapshot(made) == before
    more = replace(PLAN, scenes=PLAN.scenes + 2)
    with pytest.raises(FileError, match=r"versions\.graspmap: \S+ -> 0;"):
        generate(more, made, workers=0)
    assert snapshot(made) == before
    copy = tmp_path / "copy"
    shutil.copytree(made, copy)
    next(copy.glob("*/*_RGB.png")).unlink()
    with pytest.raises(FileError, match=r"versions\.graspmap"):
        generate(PLAN, copy, workers=0)


def test_a_folder_with_other_things_is_left_as_it_is(tmp_path):
    (tmp_path / "photo.png").write_bytes(b"")
    with pytest.raises(FileError, match=r"something else .*\(photo\.png\)"):
        generate(PLAN, tmp_path, workers=0)
    assert [path.name for path in tmp_path.iterdir()] == ["photo.png"]


# Rejects.


def test_what_fails_is_counted_and_replaced(tmp_path, monkeypatch):
    from graspmap.simulation.settle import UnsettledError

    original, calls = item_module.settle, 0

    def unsettled(models, rng):
        nonlocal calls
        calls += 1
        if calls <= item_module.TRIES + 1:
            raise UnsettledError("still moving", models[0].id, "20 mm/s")
        return original(models, rng)

    monkeypatch.setattr(item_module, "settle", unsettled)
    plan = replace(PLAN, scenes=2, views=1)
    counts = generate(plan, tmp_path, workers=0)["counts"]
    assert counts["scenes"] == 2
    assert counts["rejects"] == {"unsettled: still moving": item_module.TRIES + 1}
    first = read_record(next(tmp_path.glob("*/0_*_scene.json")))
    assert first.seed == (3, 0, 1, 0, 1)  # the second object, its second fall


def test_a_plan_without_any_scene_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "_HOPELESS", 2)
    monkeypatch.setattr(run_module, "ATTEMPTS", 1)
    monkeypatch.setattr(item_module, "TRIES", 1)
    weak = replace(GRIPPER, force_n=1e-3)
    plan = replace(PLAN, gripper=weak, ranges=PLAN.ranges, views=1, candidates=5)
    with pytest.raises(InvalidInputError, match=r"no scene .*2 no grasp holds"):
        generate(plan, tmp_path, workers=0)


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"scenes": 0}, "scenes is 0"),
        ({"views": 0}, "views"),
        ({"clutter": 51}, "clutter"),
        ({"seed": -1}, "seed"),
        ({"size_px": 20}, "size_px"),
        ({"size_px": 48}, r"jaw size of gripper jacquard is 0\.01 m, 0\.\d+ px"),
        ({"candidates": 0}, "candidates"),
        ({"gripper": "franka"}, "gripper is 'franka'; allowed: a Gripper"),
        ({"unit": "mm"}, "not for procedural objects"),
        ({"families": ("mugg",)}, "did you mean 'mug"),
        (
            {"randomisation": NEAR, "gripper": replace(GRIPPER, jaw_sizes_m=(0.02, 0.3))},
            r"jaw size of gripper jacquard is 0\.3 m, 143 px of a picture that shows 0\.27 m",
        ),
    ],
)
def test_a_wrong_plan_is_refused(change, error):
    with pytest.raises((InvalidInputError, UnknownNameError), match=error):
        replace(PLAN, **change)


# The command.


def test_the_command_goes_on_and_says_what_there_is(made, tmp_path, capsys):
    root = tmp_path / "set"
    shutil.copytree(made, root)
    assert main([*FLAGS, "--out", str(root), "--json", "-"]) == 0
    output = capsys.readouterr()
    summary = json.loads(output.out)
    assert (summary["scenes"], summary["made_now"], summary["objects"]) == (5, 0, 3)
    assert summary["held_share"] == pytest.approx(summary["labels"] / summary["trials"])
    assert "5 scenes of 3 objects" in output.err
    assert "labels a scene" in output.err
    assert read_rgb(root / "sheet.png").std() > 10
    assert snapshot(root) == snapshot(made)


def test_the_speed_counts_what_this_run_has_made(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr("graspmap.cli.progress.time.monotonic", lambda: now[0])
    with progress("generating scenes", per_hour="scenes") as update:
        for now[0], done in ((0.0, 100), (20.0, 110), (40.0, 140)):
            update(done, 200)
    assert capsys.readouterr().err.splitlines() == [
        "graspmap: generating scenes: 110 of 200, 1,800 scenes an hour",
        "graspmap: generating scenes: 140 of 200, 3,600 scenes an hour",
    ]


@pytest.mark.parametrize(
    ("flags", "part"),
    [
        ([], "--scenes"),
        (["--scenes", "3", "--objects", "nowhere"], "no such folder"),
        (["--scenes", "3", "--gripper", "frankka"], "did you mean 'franka'?"),
        (["--scenes", "3", "--workers", "-1"], "--workers is -1"),
        (["--scenes", "3", "--randomisation", "none.yaml"], "no such randomisation file"),
        (["--scenes", "3", "--randomisation", "plane"], "did you mean 'plain'?"),
        (["--scenes", "3", "--objects", __file__], "is a file and no folder"),
        (["--scenes", "3", "--objects", "x", "--family", "mug"], "families is mug"),
        (["--scenes", "three"], "--scenes is 'three'; allowed: a whole number"),
        (["--scenes", "3", "--unit", "cmm"], "--unit is 'cmm'; allowed: cm, inch, m, mm; did"),
        (["--scenes", "-3"], "scenes is -3"),
        (["--scenes", "3", "--unit", "mm"], "not for procedural objects"),
    ],
)
def test_mistakes_are_told_in_one_line(flags, part, tmp_path, capsys):
    assert main(["generate", "--out", str(tmp_path / "new"), *flags]) == 2
    text = capsys.readouterr().err
    assert part in text
    assert text.count("\n") == 1
