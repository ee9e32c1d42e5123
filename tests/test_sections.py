"""Sections of a summary that are made of trials: difficulty, families, calibration."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from graspmap.data import read_scenes
from graspmap.data.jacquard_labels import read_negatives
from graspmap.evaluation import TrialPlan, labelled_grasps, try_grasps
from graspmap.evaluation.difficulty import LEVELS, rank_by_difficulty
from graspmap.evaluation.sections import calibration_section, outcomes_by_scene, trials_section
from graspmap.geometry.grasps import Grasps
from graspmap.metrics import wilson_interval
from graspmap.simulation.trial import Perturbation


@pytest.fixture(scope="module")
def labelled(tmp_path_factory, generated):
    """The three scenes; the second and third with labels taken away, so that they are harder."""
    root = tmp_path_factory.mktemp("sections") / "data"
    shutil.copytree(generated, root)
    scenes = read_scenes(f"jacquard:{root}")
    for index, keep in ((1, 6), (2, 2)):
        path = next(p for p in scenes.files(index) if p.name.endswith("_grasps.txt"))
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:keep]))
    # Another family for the last one.
    record = next(p for p in scenes.files(2) if p.name.endswith("_scene.json"))
    text = json.loads(record.read_text())
    text["objects"][0]["labels"]["general"] = "shell"
    record.write_text(json.dumps(text))
    return read_scenes(f"jacquard:{root}")


@pytest.fixture(scope="module")
def trials(labelled):
    """A grasp that is known to hold, nothing, and a grasp beside the object; qualities 0.9, 0.7."""
    held = labelled_grasps(labelled).grasps[labelled.ids[0]][:1]
    beside = Grasps([[3, 3]], [0.0], [9.0], [4.0], [0.7])
    found = {labelled.ids[0]: held.replace(quality=np.array([0.9])), labelled.ids[2]: beside}
    return try_grasps(found, labelled, TrialPlan())


def test_levels_follow_the_share_of_candidates_that_held(labelled):
    shares = []
    for index in range(3):
        failed = next(p for p in labelled.files(index) if p.name.endswith("_negatives.txt"))
        held, failures = len(labelled.read_grasps(index)), len(read_negatives(failed)[0])
        shares.append(held / (held + failures))
    assert shares[0] > shares[1] > shares[2]
    found = rank_by_difficulty(labelled, labelled.ids)
    assert [found.level[name] for name in labelled.ids] == list(LEVELS)
    assert shares[0] > found.bounds[0] > shares[1] > found.bounds[1] > shares[2]
    assert rank_by_difficulty(labelled, labelled.ids[:2]) is None  # too few to divide


def test_scenes_without_failed_candidates_have_no_difficulty(tmp_path, generated):
    shutil.copytree(generated, tmp_path / "data")
    for path in (tmp_path / "data").rglob("*_negatives.txt"):
        path.unlink()
    scenes = read_scenes(f"jacquard:{tmp_path / 'data'}")
    assert rank_by_difficulty(scenes, scenes.ids) is None


def test_trials_by_difficulty_and_family(labelled, trials):
    section = trials_section(trials, labelled, 1.5)
    assert section["seconds"] == 1.5
    counts = {k: (s["held"], s["trials"]) for k, s in section["per_difficulty"].items()}
    assert counts == {"easy": (1, 1), "medium": (0, 1), "hard": (0, 1)}
    families = {k: (s["held"], s["trials"]) for k, s in section["per_family"].items()}
    assert families == {"primitive": (1, 2), "shell": (0, 1)}
    assert section["per_family"]["primitive"]["interval"] == pytest.approx(wilson_interval(1, 2))
    assert json.loads(json.dumps(section)) == section


def test_calibration_is_of_the_grasps_that_there_are(trials):
    section = calibration_section(trials)
    # One of 0.9 held, one of 0.7 did not; the scene without a grasp says nothing of qualities.
    assert section["trials"] == 2
    assert section["brier"] == pytest.approx((0.1**2 + 0.7**2) / 2)
    assert section["ece"] == pytest.approx((0.1 + 0.7) / 2)


def test_outcomes_are_those_of_the_best_grasp(labelled, trials):
    first, second, third = labelled.ids
    assert outcomes_by_scene(trials) == {first: "held", second: "no_grasp", third: "empty"}


def test_a_detector_that_finds_nothing_has_no_calibration(labelled):
    nothing = try_grasps({}, labelled, TrialPlan())
    assert calibration_section(nothing) is None
    assert nothing.to_dict()["best"]["success"] == 0.0


def test_the_best_grasp_is_scored_apart_and_perturbed(labelled):
    held = labelled_grasps(labelled).grasps[labelled.ids[0]][:1]
    beside = Grasps([[3, 3]], [0.0], [9.0], [4.0])
    found = {labelled.ids[0]: Grasps.concatenate([held, beside, beside])}
    plan = TrialPlan(top=3, perturbation=Perturbation(position_m=1e-4), repeats=2)
    summary = try_grasps(found, labelled.subset(labelled.ids[:1]), plan).to_dict()
    assert (summary["trials"], summary["held"]) == (3, 1)
    assert summary["robust_success"] == pytest.approx(1 / 3)
    best = summary["best"]
    assert (best["trials"], best["held"], best["robust_success"]) == (1, 1, 1.0)
    assert best["interval"] == pytest.approx(wilson_interval(1, 1))
    assert summary["settings"]["perturbation"]["position_m"] == 1e-4
    assert summary["settings"]["shake"] is None
