"""EGAD's protocol: what is tried, what is counted, and runs that are stopped or spread."""

from __future__ import annotations

import json
import math
import shutil
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from box_mesh import write_box
from graspmap.errors import DatasetNotFoundError, InvalidInputError, UnknownNameError
from graspmap.evaluation.egad import DetectorFile, EgadPlan, EgadTry, evaluate_egad, finish
from graspmap.evaluation.egad import run as run_module
from graspmap.evaluation.egad.attempt import mesh_number
from graspmap.evaluation.egad.grid import PUBLISHED, cell_of, make_grid, trends
from graspmap.evaluation.egad.results import EgadEvaluation
from graspmap.geometry import Grasps
from graspmap.gripper import load_gripper
from graspmap.metrics import wilson_interval
from graspmap.simulation.render import load_randomisation
from graspmap.simulation.trial import Perturbation

GRIPPER = load_gripper("franka")
PLAIN = load_randomisation("plain")
_DOWN = {"distance_m": (0.5, 0.5), "tilt_deg": (0.0, 0.0), "pan_deg": (0.0, 0.0)}
CLOSE = PLAIN.model_copy(update={"camera": PLAIN.camera.model_copy(update=_DOWN)})
PLAN = EgadPlan(GRIPPER, trials=3, size_px=96, candidates=10, randomisation=CLOSE, depth="perfect")


@pytest.fixture(scope="module")
def meshes(tmp_path_factory) -> Path:
    """Two bars in EGAD's grid and one that is no body."""
    folder = tmp_path_factory.mktemp("meshes")
    write_box(folder / "A0.obj", (120, 30, 30))
    write_box(folder / "C3.obj", (100, 25, 40))
    write_box(folder / "flat.obj", (60, 40, 0))
    return folder


@dataclass(frozen=True)
class Across:
    """A detector that knows what lies there: it grasps the object's middle across its long side.

    ``turn`` turns its grasps; at a quarter turn they run along the bar, which is as long as the
    gripper opens.
    """

    turn: float = 0.0
    grasps: int = 1
    stamp: str = "across"

    def load(self):
        return self

    def detect(self, _, depth, *, camera, gripper, **__):
        rows, columns = np.nonzero(depth < np.nanmax(depth) - 0.012)
        points = np.stack([columns, rows], axis=1)
        middle = points.mean(axis=0)
        _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
        across = axes[1]
        angle = math.atan2(-across[1], across[0]) + self.turn
        z = float(np.nanmin(depth))
        scale = camera.fx / z
        found = Grasps([middle], [angle], [0.07 * scale], [gripper.jaw_sizes_m[0] * scale])
        return SimpleNamespace(grasps=Grasps.concatenate([found] * self.grasps))


@dataclass(frozen=True)
class Blind:
    """A detector that finds nothing."""

    stamp: str = "blind"

    def load(self):
        return self

    def detect(self, *_, **__):
        return SimpleNamespace(grasps=Grasps.empty())


@dataclass(frozen=True)
class Unfit:
    """A detector that wants something else."""

    stamp: str = "unfit"

    def load(self):
        return self

    def detect(self, *_, **__):
        raise InvalidInputError("thermal picture", "missing", "one")


@pytest.fixture(scope="module")
def across(meshes) -> EgadEvaluation:
    return evaluate_egad(meshes, Across(), PLAN)


def entries(result: EgadEvaluation):
    return [one.to_dict() for one in result.tries]


def test_good_grasps_hold_and_a_broken_mesh_is_told(across, meshes, caplog):
    summary = across.to_dict()
    assert summary["objects"] == 2
    assert summary["trials"] == 6
    assert summary["success"] >= 0.8
    assert summary["candidates"]["trials"] > 40
    assert 0 < summary["candidates"]["success"] < 1
    assert list(summary["broken"]) == ["flat.obj"]
    assert summary["grid"]["missing"].count("A0") == 0
    assert len(summary["grid"]["missing"]) == 47
    # As every section for the report: nothing that JSON does not know.
    assert json.loads(json.dumps(summary)) == summary


def test_grasps_along_the_bar_fail(meshes):
    result = evaluate_egad(meshes, Across(turn=math.pi / 2), replace(PLAN, candidates=0))
    summary = result.to_dict()
    assert summary["held"] == 0
    assert summary["candidates"] is summary["ceiling"] is None
    assert summary["per_object"]["A0"]["ceiling"] is None


def test_the_numbers_are_those_of_the_rows(across):
    summary, rows = across.to_dict(), across.rows()
    outcomes = [row["outcome"] for row in rows]
    assert summary["outcomes"] == dict(Counter(outcomes))
    assert summary["success"] == outcomes.count("held") / len(outcomes)
    low, high = summary["interval"]
    assert 0 <= low <= summary["success"] <= high <= 1
    assert summary["ceiling"]["held"] == sum(row["candidates_held"] > 0 for row in rows)
    for name, score in summary["per_object"].items():
        mine = [row for row in rows if row["mesh"] == name]
        held = sum(row["outcome"] == "held" for row in mine)
        assert (score["trials"], score["held"]) == (3, held)
        assert score["interval"] == list(wilson_interval(held, 3))
        assert score["candidates"]["held"] == sum(row["candidates_held"] for row in mine)


def test_objects_are_as_long_as_the_gripper_opens(meshes, monkeypatch):
    seen = {}

    def look(plan, model, number, detector):
        seen[model.id] = np.sort(model.extents_m)
        raise InvalidInputError("this test", "enough", "nothing more")

    monkeypatch.setattr(run_module, "try_object", look)
    with pytest.raises(InvalidInputError, match=r"6, none of which can be made .*enough"):
        evaluate_egad(meshes, Across(), PLAN)
    # By hand: 120 x 30 x 30 and 100 x 40 x 25, the longest side 80 mm.
    assert seen["A0"] == pytest.approx([0.02, 0.02, 0.08])
    assert seen["C3"] == pytest.approx([0.02, 0.032, 0.08])


def test_a_try_follows_from_seed_mesh_and_number_alone(across, meshes, tmp_path):
    shutil.copy(meshes / "C3.obj", tmp_path / "C3.obj")
    alone = evaluate_egad(tmp_path, Across(), replace(PLAN, trials=2))
    expected = [entry for entry in entries(across) if entry["mesh"] == "C3"][:2]
    assert entries(alone) == expected
    other = evaluate_egad(tmp_path, Across(), replace(PLAN, trials=2, seed=1))
    assert entries(other) != expected
    assert mesh_number("C3") != mesh_number("A0")


def test_tries_of_one_object_differ(across):
    places = {(row["mesh"], row["angle"]) for row in across.rows()}
    assert len(places) == 6


def test_more_candidates_leave_the_picture_and_the_grasp_as_they_are(across, meshes):
    result = evaluate_egad(meshes, Across(), replace(PLAN, trials=1, candidates=0))
    first = [entry for entry in entries(across) if entry["number"] == 0]
    assert [e["tried"] for e in entries(result)] == [e["tried"] for e in first]


def test_workers_do_not_change_the_result(across, meshes, monkeypatch):
    monkeypatch.setattr(run_module, "SCENES_A_WORKER", 1)
    two = evaluate_egad(meshes, Across(), PLAN, workers=2)
    assert entries(two) == entries(across)
    assert {**two.to_dict(), "seconds": 0} == {**across.to_dict(), "seconds": 0}


class StopError(BaseException):
    """As Ctrl-C."""


def stopped_after(monkeypatch, count):
    """Let the run be stopped in the middle of try number ``count``; the tries that were made."""
    made, real = [], run_module.try_object

    def try_object(plan, model, number, detector):
        if len(made) == count:
            raise StopError
        made.append((model.id, number))
        return real(plan, model, number, detector)

    monkeypatch.setattr(run_module, "try_object", try_object)
    return made


def test_a_stopped_run_goes_on(across, meshes, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        stopped_after(patch, 4)
        with pytest.raises(StopError):
            evaluate_egad(meshes, Across(), PLAN, folder=tmp_path)
    journal = tmp_path / "unfinished.jsonl"
    with journal.open("a") as file:
        file.write('{"stamp": "cut sho')  # a kill in the middle of a line
    prepared = []
    with monkeypatch.context() as patch:
        made = stopped_after(patch, 99)
        patch.setattr(run_module, "prepare_mesh", lambda *_: prepared.append(1))
        again = evaluate_egad(meshes, Across(), PLAN, folder=tmp_path)
    assert made == [("C3", 1), ("C3", 2)]
    assert prepared == []
    assert entries(again) == entries(across)
    # Another detector does not go on from this one's tries; more tries of the same one do.
    with monkeypatch.context() as patch:
        made = stopped_after(patch, 99)
        evaluate_egad(meshes, Across(), replace(PLAN, trials=4), folder=tmp_path)
        assert made == [("A0", 3), ("C3", 3)]
        made.clear()
        evaluate_egad(meshes, Across(stamp="new"), replace(PLAN, trials=1), folder=tmp_path)
        assert made == [("A0", 0), ("C3", 0)]
    finish(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".lock"]


def test_a_changed_mesh_or_a_lost_model_is_made_again(meshes, tmp_path, monkeypatch):
    mine = shutil.copytree(meshes, tmp_path / "mine")
    plan, out = replace(PLAN, trials=1, candidates=0), tmp_path / "out"
    evaluate_egad(mine, Across(), plan, folder=out)
    write_box(mine / "A0.obj", (120, 20, 30))
    (out / "egad-models" / "models" / "C3.npz").unlink()
    with monkeypatch.context() as patch:
        made = stopped_after(patch, 99)
        evaluate_egad(mine, Across(), plan, folder=out)
    assert made == [("A0", 0)]
    assert (out / "egad-models" / "models" / "C3.npz").exists()


def test_a_detector_that_finds_nothing_fails(meshes):
    result = evaluate_egad(meshes, Blind(), replace(PLAN, trials=1, candidates=0))
    assert result.to_dict()["outcomes"] == {"no_grasp": 2}
    assert result.to_dict()["success"] == 0


def test_a_try_that_cannot_be_made_counts_nowhere(meshes, monkeypatch, caplog):
    real = run_module.try_object

    def sometimes(plan, model, number, detector):
        if (model.id, number) == ("A0", 1):
            raise InvalidInputError("this fall", "off the table", "one on it")
        return real(plan, model, number, detector)

    monkeypatch.setattr(run_module, "try_object", sometimes)
    result = evaluate_egad(meshes, Blind(), replace(PLAN, candidates=0))
    assert len(result.tries) == 5
    assert list(result.to_dict()["skipped"]) == ["A0#1"]
    assert "1 of 3 tries at A0 are left out: this fall is off the table" in caplog.text
    assert "mesh flat.obj is left out" in caplog.text


def test_a_detector_that_cannot_work_is_told(meshes):
    with pytest.raises(InvalidInputError, match=r"none of which can be made .*thermal picture"):
        evaluate_egad(meshes, Unfit(), replace(PLAN, trials=1))


def test_ranks_and_perturbed_repeats(meshes):
    plan = replace(
        PLAN, trials=2, top=2, candidates=0, perturbation=Perturbation(0.001, 0.01), repeats=3
    )
    result = evaluate_egad(meshes, Across(grasps=5), plan)
    summary = result.to_dict()
    assert summary["trials"] == 4  # the first grasp of each try counts
    assert set(summary["per_rank"]) == {"0", "1"}
    # The same grasp twice: what holds, holds again.
    assert summary["one_of_first"]["1"] == summary["one_of_first"]["2"]
    assert {k: summary["one_of_first"]["1"][k] for k in ("trials", "held", "success")} == {
        k: summary[k] for k in ("trials", "held", "success")
    }
    assert (summary["size_px"], summary["distance_m"]) == (96, [0.5, 0.5])
    shares = [one.tried[0].placed.result.success_probability for one in result.tries]
    assert summary["robust_success"] == pytest.approx(np.mean(shares))
    again = [EgadTry.from_dict(json.loads(json.dumps(entry))) for entry in entries(result)]
    assert [one.to_dict() for one in again] == entries(result)


def test_stereo_depth_reaches_the_detector(meshes, tmp_path):
    depths = []

    @dataclass(frozen=True)
    class Watch(Blind):
        def detect(self, rgb, depth, **options):
            depths.append(depth)
            return super().detect(rgb, depth, **options)

    shutil.copy(meshes / "A0.obj", tmp_path)
    for depth in ("perfect", "stereo"):
        evaluate_egad(tmp_path, Watch(), replace(PLAN, trials=1, candidates=0, depth=depth))
    perfect, stereo = depths
    assert np.isfinite(perfect).all()
    assert np.isnan(stereo).any()
    assert np.nanmedian(np.abs(perfect - stereo)) < 0.005


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"trials": 0}, InvalidInputError),
        ({"top": 0}, InvalidInputError),
        ({"candidates": -1}, InvalidInputError),
        ({"depth": "sonar"}, UnknownNameError),
        ({"size_px": 10}, InvalidInputError),
        ({"seed": -1}, InvalidInputError),
        ({"repeats": 2}, InvalidInputError),
    ],
)
def test_refuses(options, error):
    with pytest.raises(error, match=next(iter(options))):
        replace(PLAN, **options)


def test_no_meshes(tmp_path):
    with pytest.raises(DatasetNotFoundError, match="no mesh") as caught:
        evaluate_egad(tmp_path, Blind(), PLAN)
    assert "procedural" not in str(caught.value)
    write_box(tmp_path / "flat.obj", (1, 1, 0))
    with pytest.raises(InvalidInputError, match="1, none of which is usable"):
        evaluate_egad(tmp_path, Blind(), PLAN)
    with pytest.raises(InvalidInputError, match="workers"):
        evaluate_egad(tmp_path, Blind(), PLAN, workers=0)


def test_length_in_the_picture():
    # 8 cm at 0.5 m, by the pinhole: f = 48 / tan(half the field of view).
    focal = 48 / math.tan(math.radians(sum(CLOSE.camera.field_of_view_deg) / 4))
    assert PLAN.opening_px == pytest.approx(focal * 0.08 / 0.5)


# The grid.


@pytest.mark.parametrize(
    ("name", "cell"),
    [("A0", (0, 0)), ("g6", (6, 6)), ("B3", (1, 3)), ("H0", None), ("A7", None), ("A00", None),
     ("mug", None)],
)  # fmt: skip
def test_names_of_the_grid(name, cell):
    assert cell_of(name) == cell


def test_grid_against_means_by_hand():
    held = {"A0": [True, True], "A2": [False, True], "B2": [False, False], "mug": [True]}
    possible = {"A0": [True, True], "A2": [True, True], "B2": [False, True]}
    grid = make_grid(held, possible, rng=np.random.default_rng(0))
    assert grid["success"][0] == [1.0, None, 0.5, None, None, None, None]
    assert grid["success"][1] == [None, None, 0.0, None, None, None, None]
    assert grid["ceiling"][1][2] == 0.5
    assert grid["row_means"] == [0.75, 0.0, None, None, None, None, None]
    assert grid["column_means"] == [1.0, None, 0.25, None, None, None, None]
    assert grid["mean"] == 0.5
    assert grid["interval"][0][2] == list(wilson_interval(1, 2))
    assert grid["row_intervals"][2] is None
    low, high = grid["row_intervals"][0]
    assert 0 <= low <= 0.75 <= high <= 1
    assert len(grid["missing"]) == 46
    assert grid["outside"] == ["mug"]
    assert make_grid({"mug": [True]}, {}, rng=np.random.default_rng(0)) is None


def test_trends_against_ranks_by_hand():
    falls = {"A0": 0.9, "B3": 0.5, "C1": 0.4, "G2": 0.1, "mug": 0.7}
    found = trends(falls)
    assert found["rows"]["spearman"] == -1.0
    # Columns 0, 3, 1, 2 against ranks 4, 3, 2, 1: 1 - 6 * (9 + 1 + 0 + 4) / (4 * 15).
    assert found["columns"]["spearman"] == pytest.approx(1 - 6 * (9 + 1 + 0 + 4) / 60)
    low, high = found["columns"]["interval"]
    assert -1 <= low <= found["columns"]["spearman"] <= high <= 1
    flat = trends(dict.fromkeys(falls, 0.5))
    assert flat["rows"] == {"spearman": None, "interval": None}
    assert trends({"A0": 1.0, "B0": 0.5, "C0": 0.1, "mug": 0.2}) is None


def test_numbers_of_the_thesis():
    assert [(entry["name"], entry["success"]) for entry in PUBLISHED] == [
        ("thesis", 0.77), ("original study", 0.58)
    ]  # fmt: skip


# Real ones.


def test_meshes_of_egad(data_dir, tmp_path):
    folder = data_dir / "egad"
    if not folder.is_dir():
        pytest.skip(f"no EGAD meshes at {folder}")
    for name in ("A0", "G6"):
        shutil.copy(folder / f"{name}.obj", tmp_path)
    result = evaluate_egad(tmp_path, Across(), replace(PLAN, trials=1, candidates=50))
    summary = result.to_dict()
    assert summary["trials"] == 2
    assert summary["broken"] == {}
    assert summary["candidates"]["held"] > 0
    assert summary["grid"]["success"][0][0] is not None
    assert summary["grid"]["success"][6][6] is not None


def test_a_weights_file(meshes, tmp_path, one_thread):
    from graspmap.inference import WeightsCard, save_weights
    from graspmap.networks import make_network

    path = tmp_path / "w.safetensors"
    card = WeightsCard(network="ggcnn2", channels="rgbd", size=64, width_scale_px=30.0)
    save_weights(path, make_network("ggcnn2", 4), card)
    source = DetectorFile(path)
    before = source.stamp
    result = evaluate_egad(meshes, source, replace(PLAN, trials=1, candidates=0))
    assert len(result.tries) == 2
    save_weights(path, make_network("ggcnn2", 4), card)
    assert source.stamp != before
