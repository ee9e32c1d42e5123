"""Trials over a data set: from pixels to outcomes, what is left out, and runs that are stopped."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from graspmap.cli.trial_flags import TrialFlags
from graspmap.data import Scenes, read_scenes
from graspmap.errors import FileError, InvalidInputError
from graspmap.evaluation import (
    SeenBy,
    TrialPlan,
    file_predictions,
    in_file_frame,
    labelled_grasps,
    predict_scenes,
    trials,
    try_grasps,
    write_trials,
)
from graspmap.evaluation.tabletops import scene_gripper, scene_world
from graspmap.evaluation.trial_results import TriedGrasp
from graspmap.evaluation.trials import try_in_world
from graspmap.geometry import Camera, Grasps
from graspmap.gripper import load_gripper
from graspmap.metrics import wilson_interval
from graspmap.simulation.trial import Perturbation, Shake, TrialSettings

ALL = TrialPlan(top=None, ranked=False)


@pytest.fixture
def copy(generated, tmp_path):
    """The generated scenes, to be damaged."""
    return shutil.copytree(generated, tmp_path / "copy")


def scenes_of(root):
    return read_scenes(f"jacquard:{root}")


def some(scenes, per_scene=3):
    """Labels and failures of each scene, as a detector might find them."""
    return {s.id: Grasps.concatenate([s.grasps[:per_scene], s.negatives[:1]]) for s in scenes}


def test_labels_of_a_generated_set_hold_when_they_are_tried_again(generated):
    scenes = scenes_of(generated)
    todo = labelled_grasps(scenes)
    result = try_grasps(todo.grasps, scenes, ALL)
    assert result.score.outcomes == {"held": sum(map(len, todo.grasps.values()))}
    assert result.grippers == ("jacquard",)
    negatives = {s.id: s.negatives for s in scenes}
    failed = try_grasps(negatives, scenes, ALL)
    assert failed.score.held == 0
    assert failed.score.trials == sum(map(len, negatives.values())) > 0


def test_workers_do_not_change_the_result(generated, monkeypatch):
    monkeypatch.setattr(trials, "SCENES_A_WORKER", 1)
    scenes = scenes_of(generated)
    one, two = (try_grasps(some(scenes), scenes, ALL, workers=w) for w in (1, 2))
    assert one.entries() == two.entries()
    assert one.to_dict() == two.to_dict()
    assert [t.scene for t in one.tried] == sorted(t.scene for t in one.tried)


def test_entries_come_back_from_json(generated):
    scenes = scenes_of(generated)
    result = try_grasps({scenes.ids[0]: some(scenes)[scenes.ids[0]]}, scenes, ALL)
    for tried in result.tried:
        entry = json.loads(json.dumps(tried.to_dict()))
        again = TriedGrasp.from_dict(entry)
        assert again.to_dict() == entry == tried.to_dict()
        assert again.outcome == tried.outcome
        if tried.placed is not None:
            assert again.placed.result == tried.placed.result
            assert np.array_equal(again.placed.table.angle, tried.placed.table.angle)
    assert set(result.entries()[0]) >= {
        "scene", "outcome", "x", "y", "angle", "width", "height", "quality", "position_m", "width_m"
    }  # fmt: skip


def test_positions_are_where_the_camera_sees_the_grasp(generated):
    scenes = scenes_of(generated)
    scene = scenes[0]
    result = try_grasps({scene.id: scene.grasps[:2]}, scenes.subset([scene.id]), ALL)
    for entry in result.entries():
        assert scene.camera.project(entry["position_m"]) == pytest.approx([entry["x"], entry["y"]])
        world = scene.T_world_camera.apply(entry["position_m"])
        assert world[:2] == pytest.approx([entry["x_m"], entry["y_m"]])
        assert entry["grasped"] == scene.object_id


def test_a_scene_without_a_grasp_fails_and_one_that_cannot_be_tried_does_not_count(copy):
    scenes = scenes_of(copy)
    first, second, third = scenes.ids
    record = copy / scenes.object_id(2) / f"{third}_scene.json"
    record.write_text(record.read_text().replace('"vertices": ', '"vertices": 1'))
    grasps = {first: scenes[0].grasps[:1]}
    # Whether the third counts does not depend on what is predicted for it.
    for further in ({}, {third: scenes[2].grasps[:1]}):
        result = try_grasps(grasps | further, scenes)
        assert result.score.outcomes == {"held": 1, "no_grasp": 1}
        assert result.without_prediction == (second,)
        assert list(result.skipped) == [third]
        assert "another one than was recorded" in result.skipped[third]
        assert result.scenes == 2
        assert result.rows()[1]["outcome"] == "no_grasp"
        assert len(result.entries()) == 1


def test_the_run_goes_on_past_damaged_scenes(copy, caplog):
    scenes = scenes_of(copy)
    first, second, third = scenes.ids
    (copy / scenes.object_id(0) / f"{first}_perfect_depth.tiff").write_bytes(b"no picture")
    (copy / scenes.object_id(1) / f"{second}_scene.json").write_text("{}")
    result = try_grasps(some(scenes_of(copy).subset([third])), scenes, ALL)
    assert {t.scene for t in result.tried} == {third}
    assert "perfect_depth.tiff" in result.skipped[first]
    assert "no record" in result.skipped[second]
    assert sum("left out" in message for message in caplog.messages) == 2
    (copy / scenes.object_id(2) / f"{third}_perfect_depth.tiff").unlink()
    with pytest.raises(InvalidInputError, match="3, none of which can be tried"):
        try_grasps({}, scenes_of(copy))


def test_scenes_without_a_record_are_rebuilt_from_their_depth(copy):
    scenes = scenes_of(copy)
    grasps = {s.id: s.grasps for s in scenes}
    for path in copy.glob("*/*_scene.json"):
        path.unlink()
    scenes = scenes_of(copy)
    assert scene_gripper(scenes, 0) is None
    world = scene_world(scenes, 0)
    assert world.gripper is None
    assert len(world.tabletop.objects) == 1
    result = try_grasps(grasps, scenes, ALL)
    assert result.score.success > 0.8  # boxes lose little in 2.5D
    assert result.grippers == ("jacquard",)


class Bare(Scenes):
    """The same pictures in a data set that knows no camera."""

    kind = "bare"

    def __init__(self, scenes):
        self.root, self.ids, self._scenes = scenes.root, scenes.ids, scenes

    def read(self, index):
        return replace(self._scenes[index], camera=None, T_world_camera=None)

    def read_grasps(self, _):
        return None

    def files(self, _):
        return ()

    def object_id(self, _):
        return None


def test_a_camera_can_be_given_where_there_is_none(copy):
    scenes = scenes_of(copy).subset(scenes_of(copy).ids[:1])
    scene = scenes[0]

    bare = Bare(scenes)
    with pytest.raises(InvalidInputError, match="camera is missing"):
        try_grasps({scene.id: scene.grasps[:1]}, bare)
    wrong = Camera.from_field_of_view(0.5, 100, 100)
    with pytest.raises(InvalidInputError, match="100 x 100"):
        try_grasps({scene.id: scene.grasps[:1]}, SeenBy(bare, wrong))
    known = SeenBy(bare, scene.camera)
    assert try_grasps({scene.id: scene.grasps}, known, TrialPlan(top=None)).score.success > 0.5


def test_a_given_camera_counts_more_than_the_one_that_is_assumed(copy):
    """Own pictures in Jacquard's layout, without a record or a camera's file."""
    for path in copy.rglob("*"):
        if path.name.endswith(("_scene.json", "_camera.json")):
            path.unlink()
    scenes = scenes_of(copy).subset(scenes_of(copy).ids[:1])
    assumed = scenes[0].camera
    own = replace(assumed, fx=1.3 * assumed.fx, fy=1.3 * assumed.fy)
    seen = SeenBy(scenes, own).subset(scenes.ids)
    found = scene_world(seen, 0)
    assert found.camera == own
    # Its pose is that of the table it sees, not the one that goes with the other camera.
    assert not np.allclose(
        found.T_world_camera.matrix, scene_world(scenes, 0).T_world_camera.matrix
    )
    # Detectors see it, too, and a stopped run does not go on with another camera.
    file = copy / "own.json"
    file.write_text(json.dumps(own.to_dict()))
    for read in (seen, TrialFlags(camera=file).read(f"jacquard:{copy}", None)):
        assert read[0].camera == read.camera == own
        assert read[0].T_world_camera is None
        detector = WithGripper()
        predict_scenes(detector, read)
        assert detector.told[0] == own


def test_scenes_with_a_record_keep_their_camera(generated):
    scenes = scenes_of(generated)
    other = Camera.from_field_of_view(0.5, 100, 100)
    assert SeenBy(scenes, other)[0].camera == scenes[0].camera


def test_scenes_are_perturbed_apart(generated):
    """Errors that all scenes shared would not average out over scenes."""
    scenes = scenes_of(generated)
    world = scene_world(scenes, 0)
    grasp = scenes[0].grasps[:1]
    plan = TrialPlan(perturbation=Perturbation(position_m=0.02), repeats=12)

    def share(name):
        tried = try_in_world(world, plan, grasp, name, None).tried
        return tried[0].placed.result.success_probability

    shares = [share(f"scene-{number}") for number in range(8)]
    assert len(set(shares)) > 2
    assert shares == [share(f"scene-{number}") for number in range(8)]


def test_jaws(generated):
    scenes = scenes_of(generated)
    name = scenes.ids[0]
    grasp = scenes[0].grasps[:1]
    exact = scenes[0].grasps[:1]

    def jaw(height, **plan):
        found = try_grasps(
            {name: grasp.replace(height=height)}, scenes.subset([name]), TrialPlan(**plan)
        )
        return found.entries()[0]["jaw_m"]

    given = jaw(exact.height, jaw="given")
    sizes = load_gripper("jacquard").jaw_sizes_m
    assert min(abs(given - size) for size in sizes) < 1e-4 * given
    assert jaw(exact.height) == given  # a label is tried with the very size that it has
    assert jaw(exact.height * 1.1) in sizes
    assert jaw(exact.height * 1.1, jaw="given") == pytest.approx(1.1 * given)
    assert jaw(exact.height, jaw=0.025) == 0.025
    assert jaw(exact.height, gripper=load_gripper("franka")) == 0.02


def test_labels_with_several_jaws_are_tried_once_by_a_gripper_with_one(generated):
    scenes = scenes_of(generated)
    todo = labelled_grasps(scenes).grasps
    franka = load_gripper("franka")
    every = try_grasps(todo, scenes, TrialPlan(franka, top=None, ranked=False))
    once = try_grasps(todo, scenes, TrialPlan(franka, top=None, ranked=False, distinct=True))
    keys = ("scene", "x_m", "y_m", "table_angle", "width_m", "jaw_m", "outcome")
    rows = [{tuple(e[k] for k in keys) for e in result.entries()} for result in (every, once)]
    assert rows[0] == rows[1]
    assert len(once.tried) == len(rows[1]) < len(every.tried)
    assert once.grippers == ("franka",)


def test_drawn_labels(generated):
    scenes = scenes_of(generated)
    todo = labelled_grasps(scenes, top=4, seed=1)
    assert all(len(grasps) == 4 for grasps in todo.grasps.values())
    for index, name in enumerate(scenes.ids):
        labels = scenes.read_grasps(index).center.tolist()
        assert all(center in labels for center in todo.grasps[name].center.tolist())
    assert labelled_grasps(scenes, top=4, seed=1).grasps[name].angle.tolist() == (
        todo.grasps[name].angle.tolist()
    )
    others = [labelled_grasps(scenes, top=4, seed=s).grasps[name].angle.tolist() for s in range(5)]
    assert any(angles != others[0] for angles in others)


def test_labels_that_are_missing_are_left_out(copy):
    scenes = scenes_of(copy)
    (copy / scenes.object_id(0) / f"{scenes.ids[0]}_grasps.txt").unlink()
    todo = labelled_grasps(scenes_of(copy))
    assert todo.skipped == {scenes.ids[0]: "it has no labelled grasp"}
    result = try_grasps(todo.grasps, scenes, TrialPlan(), skipped=todo.skipped)
    assert result.scenes == 2
    assert result.skipped == todo.skipped
    for path in copy.glob("*/*_grasps.txt"):
        path.unlink()
    with pytest.raises(InvalidInputError, match="none in 3 scenes"):
        labelled_grasps(scenes_of(copy))


def test_predictions_of_other_scenes(generated):
    scenes = scenes_of(generated)
    grasps = in_file_frame(some(scenes), scenes)
    todo = file_predictions({**grasps, "9_other": Grasps.empty()}, scenes)
    assert todo.unknown == ("9_other",)
    for name, found in some(scenes).items():
        assert todo.grasps[name].center == pytest.approx(found.center)
    part = scenes.subset(scenes.ids[:1])
    assert list(file_predictions(grasps, part, scenes.ids).grasps) == list(part.ids)
    with pytest.raises(InvalidInputError, match="1 of 1 not in"):
        file_predictions({"9_other": Grasps.empty()}, scenes)


class Fixed:
    """A detector that knows the answer of one scene after the other."""

    def __init__(self, answers):
        self.answers, self.calls = list(answers), []

    def detect(self, rgb, depth, *, top, method):
        self.calls.append((rgb.shape, depth.shape, top, method))
        found = self.answers[len(self.calls) - 1]
        if found is None:
            raise InvalidInputError("picture", "too dark", "light")
        return type("Found", (), {"grasps": found[:top]})()


def test_any_detector_can_be_tried(generated):
    scenes = scenes_of(generated)
    detector = Fixed([scenes[0].grasps, None, Grasps.empty()])
    done = []
    todo = predict_scenes(detector, scenes, top=2, progress=lambda *step: done.append(step))
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert {call[2:] for call in detector.calls} == {(2, "refined")}
    assert "too dark" in todo.skipped[scenes.ids[1]]
    result = try_grasps(todo.grasps, scenes, TrialPlan(top=2), skipped=todo.skipped)
    assert result.score.outcomes == {"held": 2, "no_grasp": 1}


class WithGripper:
    """A detector that is told the camera and the gripper."""

    def detect(self, *_, camera=None, gripper=None, **__):
        self.told = camera, gripper
        return type("Found", (), {"grasps": Grasps.empty()})()


def test_a_detector_knows_the_gripper_that_its_grasps_are_tried_with(generated):
    scenes, franka = scenes_of(generated), load_gripper("franka")
    detector = WithGripper()
    predict_scenes(detector, scenes)
    assert detector.told == (scenes[2].camera, load_gripper("jacquard"))  # of the scene's record
    predict_scenes(detector, scenes, gripper=franka)
    assert detector.told == (scenes[2].camera, franka)
    predict_scenes(detector, Bare(scenes), gripper=franka)
    assert detector.told == (None, None)


def test_what_lies_beyond_the_horizon_is_a_failure(generated):
    scenes = scenes_of(generated)
    name = scenes.ids[0]
    good = scenes[0].grasps[:1]
    far = good.replace(center=[[64.0, -1e6]])
    grasps = Grasps.concatenate([far, good])
    result = try_grasps({name: grasps}, scenes.subset([name]), TrialPlan(top=2))
    assert [t.outcome for t in result.tried] == ["off_table", "held"]
    assert [t.rank for t in result.tried] == [0, 1]
    assert result.entries()[0]["reason"] == "its rays miss the table"
    alone = try_grasps({name: far}, scenes.subset([name]))
    assert alone.score.outcomes == {"off_table": 1}


def test_ranks_and_robust_success(generated):
    scenes = scenes_of(generated)
    grasps = some(scenes, 2)
    plan = TrialPlan(
        top=3, perturbation=Perturbation(position_m=0.002, friction=0.2), repeats=3, shake=Shake()
    )
    result = try_grasps({name: grasps[name] for name in scenes.ids[:2]}, scenes, plan)
    summary = result.to_dict()
    assert summary["per_rank"]["0"]["trials"] == 3  # the scene without a grasp has a rank, too
    assert summary["per_rank"]["1"]["trials"] == 2
    third = summary["one_of_first"]["3"]
    assert (third["trials"], third["held"], third["success"]) == (3, 2, 2 / 3)
    assert third["interval"] == pytest.approx(wilson_interval(2, 3))
    # Pictures of one object alone say nothing of others, whatever the rank.
    alone = tuple(replace(t, object_id="one") for t in result.tried)
    alone = replace(result, tried=alone, cluster="object").to_dict()
    for score in (*alone["per_rank"].values(), *alone["one_of_first"].values()):
        all_or_none = score["success"] in (0.0, 1.0)
        ends = wilson_interval(score["success"], 1) if all_or_none else (0.0, 1.0)
        assert score["interval"] == pytest.approx(ends)
    shares = [t.placed.result.success_probability for t in result.tried if t.placed]
    assert summary["robust_success"] == pytest.approx(sum(shares) / result.score.trials)
    low, high = summary["robust_interval"]
    assert low <= summary["robust_success"] <= high
    assert TrialPlan(settings=TrialSettings(lift_m=0.1), shake=Shake()).settings_for(
        scene_world(scenes, 0)
    ) == TrialSettings(lift_m=0.1, shake=Shake())


def test_a_stopped_run_goes_on(generated, tmp_path, monkeypatch, caplog):
    caplog.set_level("INFO")
    scenes = scenes_of(generated)
    grasps = some(scenes, 1)
    whole = try_grasps(grasps, scenes, ALL)
    real, calls = trials.run_trials, []

    def stopped(*args, **options):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(*args, **options)

    monkeypatch.setattr(trials, "run_trials", stopped)
    with pytest.raises(KeyboardInterrupt):
        try_grasps(grasps, scenes, ALL, folder=tmp_path)
    journal = tmp_path / "unfinished.jsonl"
    assert len(journal.read_text().splitlines()) == 3
    with journal.open("a") as file:
        file.write('{"stamp": "cut sho')
    done = []
    result = try_grasps(
        grasps, scenes, ALL, folder=tmp_path, progress=lambda *step: done.append(step)
    )
    assert len(calls) == 4  # one more: the scene that was missing
    assert done == [(2, 3), (3, 3)]
    assert "2 scenes were finished" in caplog.text
    assert result.entries() == whole.entries()
    # Another plan, or other grasps, start anew.
    try_grasps(grasps, scenes, TrialPlan(top=None, seed=5), folder=tmp_path)
    assert len(calls) == 7
    grasps[scenes.ids[1]] = grasps[scenes.ids[1]][:1]
    changed = try_grasps(grasps, scenes, TrialPlan(top=None, seed=5), folder=tmp_path)
    assert len(calls) == 8
    summary = write_trials(changed, tmp_path)
    assert not journal.exists()
    assert json.loads((tmp_path / "trials.json").read_text()) == summary
    table = (tmp_path / "per_grasp.csv").read_text().splitlines()
    assert len(table) == 1 + changed.score.trials
    assert table[0].startswith("scene,object_id,rank,outcome,reason,x,y,angle,width")


def test_two_runs_do_not_share_a_folder(generated, tmp_path):
    from graspmap.files import locked

    with locked(tmp_path, "trial"), pytest.raises(FileError, match="another trial is running"):
        try_grasps({}, scenes_of(generated), folder=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="is a file"):
        write_trials(try_grasps({}, scenes_of(generated)), tmp_path / "file")


def test_a_scene_that_breaks_graspmap_is_left_out(generated, monkeypatch, caplog):
    scenes = scenes_of(generated)
    broken = scenes[1].grasps[:1]

    def fails(tabletop, table, gripper, **options):
        if len(table) == 3:
            raise ZeroDivisionError("a defect")
        return real(tabletop, table, gripper, **options)

    real = trials.run_trials
    monkeypatch.setattr(trials, "run_trials", fails)
    three = Grasps.concatenate([broken] * 3)
    grasps = {scenes.ids[0]: scenes[0].grasps[:1], scenes.ids[1]: three}
    result = try_grasps(grasps, scenes, ALL)
    assert result.skipped == {scenes.ids[1]: "defect: ZeroDivisionError: a defect"}
    assert "please report it" in caplog.text


@pytest.mark.parametrize(
    "wrong",
    [
        {"gripper": "franka"},
        {"top": 0},
        {"repeats": 0},
        {"repeats": 2},
        {"jaw": "nearly"},
        {"jaw": 0.0},
        {"jaw": float("nan")},
    ],
)
def test_a_plan_refuses(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        TrialPlan(**wrong)


def test_options_are_checked(generated):
    scenes = scenes_of(generated)
    for options in ({"cluster": "image"}, {"workers": 0}):
        with pytest.raises(InvalidInputError, match=next(iter(options))):
            try_grasps({}, scenes, **options)


def test_real_jacquard_labels_hold_in_pictures_of_any_size(data_dir):
    scenes = read_scenes(f"jacquard:{data_dir / 'jacquard'}")
    scenes = scenes.subset(scenes.ids[:1])
    labels = labelled_grasps(scenes, top=8, seed=3)
    result = try_grasps(labels.grasps, scenes, ALL)
    assert result.score.trials == 8
    assert result.score.held >= 6
    # A predictions file speaks of 1024 px, whatever the size of the picture.
    again = file_predictions(in_file_frame(labels.grasps, scenes), scenes)
    assert again.grasps[scenes.ids[0]].center == pytest.approx(labels.grasps[scenes.ids[0]].center)
    aside = np.array([200, 0])
    shifted = {name: g.replace(center=g.center + aside) for name, g in labels.grasps.items()}
    assert try_grasps(shifted, scenes, ALL).score.held < result.score.held
