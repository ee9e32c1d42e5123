"""graspmap reproduce claims: the file, the plan, the verdicts, and a small run of all of it."""

from __future__ import annotations

import csv
import dataclasses
import itertools
import json
import re
import shutil
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from graspmap import evaluation
from graspmap.cli import main
from graspmap.config import read_model
from graspmap.errors import ConfigError, DatasetNotFoundError, InvalidInputError
from graspmap.evaluation import trials
from graspmap.evaluation.run_folder import read_run_folder
from graspmap.generation import generate
from graspmap.generation.plan import GenerationPlan
from graspmap.geometry import Grasps
from graspmap.gripper import load_gripper
from graspmap.metrics.seeds import compare_seeds
from graspmap.reproduction import claims, held_out, make_plan
from graspmap.reproduction.claims import FAILS, HOLDS, OPEN, UNTESTED, judge, verdict
from graspmap.reproduction.request import Request
from graspmap.reproduction.results import fill
from graspmap.reproduction.table_file import (
    Table,
    experiment_path,
    experiments_folder,
    read_table,
)
from graspmap.reproduction.write import to_csv, to_dict, to_markdown
from graspmap.training import read_experiment
from graspmap.training.callbacks import no_progress
from graspmap.training.tasks import check_experiment

SIZES = {"train": 4, "validation": 2, "test-known": 3, "test-tools": 2}


@pytest.fixture(scope="module")
def parts(tmp_path_factory) -> Path:
    """A tiny recipe's parts: boxes and, never seen in training, rings."""
    root, gripper = tmp_path_factory.mktemp("parts"), load_gripper("jacquard")
    for seed, (name, scenes) in enumerate(SIZES.items(), start=1):
        families = ("ring",) if name == "test-tools" else ("box",)
        plan = GenerationPlan(scenes, gripper, views=1, seed=seed, size_px=128, candidates=40,
                              families=families)  # fmt: skip
        generate(plan, root / name, workers=0)
    return root


# The file.


def test_every_claim_names_rows_and_measures_that_there_are():
    table = read_table("claims")
    assert table.seeds == 3
    used = {t for c in table.claims for p in c.pairs for t in (p.better, p.than)}
    # A row that no claim needs would be trained for nothing but the correlation.
    assert used == {line.title for line in table.lines}
    for claim in table.claims:
        for pair in claim.pairs:
            assert pair.better != pair.than


def test_the_two_sides_of_a_pair_differ_in_what_the_claim_is_about():
    """Only these keys may differ between the experiments of a pair, by claim."""
    allowed = {
        "Positional loss": {"loss.positional"},
        "Three bins": {"network.bins"},
        "Strong maps, trials": {"maps.quality"},
        "Strong maps, overlap": {"maps.quality"},
        "Drop-off": {"maps.drop_off"},
        # The second task comes with a network that has a head for it.
        "Saliency as a second task": {"network.name", "tasks.saliency.loss"},
        "Depth as a second task": {"network.name", "tasks.depth.loss"},
        "Fewer training examples": {"loss.positional"},
        "Label maps, ours against published": {
            "maps.overlap", "maps.gaussian", "maps.background",
        },
        "Overlap rule, ours against published": {
            "maps.overlap", "maps.gaussian", "maps.background",
        },
    }  # fmt: skip
    table = read_table("claims")
    flat = {
        line.title: read_experiment(experiment_path(line.experiment), line.changes).flat()
        for line in table.lines
    }
    for claim in table.claims:
        for pair in claim.pairs:
            a, b = flat[pair.better], flat[pair.than]
            differ = {key for key in a.keys() | b.keys() if a.get(key) != b.get(key)}
            assert differ - {"name"} == allowed[claim.name], (claim.name, pair)
    few = [values for values in flat.values() if values["data.split.limit_objects"]]
    assert [values["data.split.limit_objects"] for values in few] == [100, 100]


def test_labels_say_what_the_experiments_do():
    for line in read_table("claims").lines:
        values = read_experiment(experiment_path(line.experiment), line.changes)
        check_experiment(values)
        network, pictures, loss, bins, maps, objects = line.labels
        assert network.split()[0].replace("-", "").lower() == values.network.name.split("-")[0]
        assert pictures.replace("-", "").lower() == values.network.channels
        assert (loss == "Pos") is (values.loss.positional == "inside")
        assert (loss == "Smooth L1") <= (values.loss.base == "smooth_l1")
        assert int(bins) == values.network.bins
        kind, _, published = maps.partition(", ")
        name, _, drop_off = kind.partition(" ")
        assert name.lower() == values.maps.quality
        assert not drop_off or float(drop_off) == values.maps.drop_off
        assert {values.maps.overlap, values.maps.gaussian, values.maps.background} == (
            {"published"} if published else {"best", "grasp", "zero"}
        )
        assert objects == str(values.data.split.limit_objects or "all")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"claims": []}, "claims and seeds in a table of the kind claims"),
        ({"seeds": None}, "claims and seeds in a table of the kind claims"),
        ({"seeds": 1}, "seeds"),
        ({"pairs": [{"better": "a", "than": "no such row"}]}, "rows of the table"),
        ({"pairs": []}, "either pairs or foretells"),
        ({"foretells": ["miou", "success"]}, "either pairs or foretells"),
        ({"by": "parameters"}, "'success_75', 'miou' or 'sgt'"),
    ],
)
def test_wrong_claims_are_refused(tmp_path, change, said):
    text = (experiments_folder() / "tables" / "claims.yaml").read_text()
    content = yaml.safe_load(text)
    where = content["claims"][0] if change.keys() & {"pairs", "foretells", "by"} else content
    where |= change
    (tmp_path / "claims.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=said):
        read_model(tmp_path / "claims.yaml", Table, what="table")


# The plan.


def test_each_row_becomes_one_run_a_seed(parts):
    plan = make_plan(Request("claims", str(parts), rows="GG-CNN2 / RGB-D", seed=5))
    titles = [line.title for line in plan.lines]
    assert len(plan.runs) == 3 * len(titles) == len({run.id for run in plan.runs})
    firsts = plan.runs[: len(titles)]
    assert {run.experiment.seed for run in firsts} == {5}
    assert [run.experiment.seed for run in plan.runs[:: len(titles)]] == [5, 6, 7]
    for run in plan.runs:
        data = run.experiment.data
        assert data.source == f"jacquard:{parts / 'train'}"
        assert data.validation.source == f"jacquard:{parts / 'validation'}"
        assert data.depth == data.validation.depth == data.test.depth == "stereo"
        assert dict(run.tests) == {
            name: f"jacquard:{parts / name}" for name in ("test-known", "test-tools")
        }
        assert run.needs == {"parts"}


def test_what_the_data_or_the_machine_cannot_give_is_left_out(parts):
    reasons = dict(make_plan(Request("claims", str(parts))).left_out)
    assert len(reasons) == 12
    assert "4 objects, not 100" in reasons["GG-CNN2 / RGB-D / Pos / 3 / Strong 2 / 100"]
    assert "--large" in reasons["U-Net / RGB-D / MSE / 3 / Strong 2 / all"]
    large = make_plan(Request("claims", str(parts), large=True))
    assert len(large.left_out) == 2
    assert {run.experiment.network.name for run in large.runs} >= {"unet", "grconvnet"}


def test_all_parts_get_the_depth_that_is_asked_for(parts):
    changes = {"data.depth": "perfect"}
    (run, *_) = make_plan(Request("claims", str(parts), changes=changes)).runs
    data = run.experiment.data
    assert data.depth == data.validation.depth == data.test.depth == "perfect"


def test_runs_are_known_by_the_objects_of_every_part(parts, tmp_path):
    """Another validation or test part makes another run; nothing else was changed."""
    ids = set()
    shutil.copytree(parts, tmp_path / "own")
    for part in (None, "validation", "test-tools"):
        if part is not None:
            for path in (tmp_path / "own" / part).rglob("1_*"):
                path.unlink()
        (run, *_) = make_plan(Request("claims", str(tmp_path / "own"))).runs
        ids.add(run.id)
    assert len(ids) == 3


def test_missing_parts_are_told(parts, tmp_path):
    with pytest.raises(DatasetNotFoundError, match=r"train.*--recipe graspmap-v1"):
        make_plan(Request("claims", str(tmp_path)))
    for name in ("train", "validation"):
        shutil.copytree(parts / name, tmp_path / name)
    with pytest.raises(DatasetNotFoundError, match="test-"):
        make_plan(Request("claims", str(tmp_path)))


def test_parts_that_cannot_be_tried_are_refused(parts, tmp_path):
    shutil.copytree(parts, tmp_path / "own")
    for path in (tmp_path / "own" / "test-tools").rglob("*_depth.tiff"):
        path.unlink()
    with pytest.raises(InvalidInputError, match="test-tools is of scenes whose grasps cannot"):
        make_plan(Request("claims", str(tmp_path / "own")))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["claims"], "--recipe graspmap-v1"),
        (["claims", "--data", "DIR", "--seeds", "1"], "--seeds is 1; allowed: 2 or more"),
        (["claims", "--data", "DIR", "--folds", "5"], "--folds is 5"),
        (["claims", "--data", "DIR", "--test-data", "x"], "--test-data"),
        (["claims", "--data", "DIR", "--network.bins", "3"], "is varied by claims itself"),
        (["claims", "--data", "DIR", "--data.validation.source", "x"], "give --data"),
        (["table-5.1", "--data", "x:y", "--seeds", "3"], "table-5.1 has one seed"),
        (["table-5.1", "--data", "x:y", "--large"], "table-5.1 has one seed"),
    ],
)
def test_mistakes_end_in_one_line(parts, words, said, capsys):
    words = [str(parts) if word == "DIR" else word for word in words]
    assert main(["reproduce", *words]) == 2
    shown = capsys.readouterr().err
    assert said in shown
    assert shown.count("\n") == 1


# The verdicts.


def test_few_objects_decide_nothing(parts, tmp_path):
    plan = make_plan(Request("claims", str(parts), rows="GG-CNN2 / RGB-D / * / Strong 2 / all"))
    results = pretend(plan, tmp_path, lambda title, _seed, _scene: ("Pos" in title, True))
    positional = judged_by(judge(plan, results, tmp_path), "Positional loss")
    assert positional.pairs[0].found["success"].interval[0] > 0
    assert positional.verdict == OPEN


@pytest.mark.parametrize(
    ("interval", "better", "alike"),
    [
        ((0.01, 0.09), HOLDS, FAILS),
        ((0.001, 0.015), HOLDS, HOLDS),
        ((-0.05, 0.019), FAILS, OPEN),
        ((-0.05, 0.05), OPEN, OPEN),
        ((-0.015, 0.015), FAILS, HOLDS),
        ((-0.09, -0.03), FAILS, FAILS),
        ((0.0, 0.03), OPEN, OPEN),
    ],
)
def test_the_rule(interval, better, alike):
    assert verdict(interval, "better") == better
    assert verdict(interval, "alike") == alike


def pretend(plan, root, values):
    """Results and files of runs as if they had reached these values.

    Args:
        values: (seed, scene) to whether it was right and held, by row.
    """
    results = {}
    for row, line in enumerate(plan.lines):
        for seed, run in enumerate(plan.cells[row, 0]):
            place = root / run / held_out.PARTS_FOLDER
            for part, facts in plan.parts.tests.items():
                write_part(place / part, facts.scenes, partial(values, line.title, seed))
            results[run] = {"test": {}, "parts": held_out._numbers(
                held_out.read_parts(place, plan.parts.tests).values())}  # fmt: skip
    return results


def write_part(folder, scenes, value):
    folder.mkdir(parents=True)
    (folder / "evaluation.json").write_text(json.dumps({
        "data": "x", "cluster": "object", "protocol": "strict", "success": {"0.25": 0.5},
        "interval": {}, "miou": 0.5, "miou_interval": [0, 1], "auc": 0.5}))  # fmt: skip
    (folder / "trials.json").write_text(json.dumps({
        "data": "x", "cluster": "object", "success": 0.5, "interval": [0, 1]}))  # fmt: skip
    rows, tried = [], []
    for i, name in enumerate(scenes.ids):
        right, held = value(name)
        marks = [int(right)] * 3
        rows.append([name, scenes.object_id(i), 0.9 if right else 0.1, *marks])
        tried.append([name, scenes.object_id(i), 0, "held" if held else "slipped"])
    heads = {"per_scene.csv": ["id", "object_id", "iou", *(f"correct@{t}" for t in
             ("0.25", "0.50", "0.75"))], "per_grasp.csv": ["scene", "object_id", "rank",
             "outcome"]}  # fmt: skip
    for (name, head), lines in zip(heads.items(), (rows, tried), strict=True):
        with (folder / name).open("w", newline="") as file:
            csv.writer(file).writerows([head, *lines])


@pytest.fixture(scope="module")
def many(parts, tmp_path_factory):
    """The test parts with ten times the objects, two scenes of each: their files, renamed."""
    root = tmp_path_factory.mktemp("many")
    for name in ("train", "validation"):
        shutil.copytree(parts / name, root / name)
    for name in ("test-known", "test-tools"):
        for number, path in itertools.product(range(20), (parts / name).rglob("*_*.*")):
            i, _, rest = path.name.partition("_")
            thing, _, end = rest.rpartition(f"-{path.parent.name.rpartition('-')[2]}")
            view, copy = number % 2, number // 2
            folder = root / name / f"{thing}-{copy}-{path.parent.name}"
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{2 * int(i) + view}_{folder.name}{end}").symlink_to(path)
    return root


def judged_by(claims_found, name):
    (one,) = [one for one in claims_found if one.claim.name == name]
    return one


def test_verdicts_follow_from_what_the_runs_did(many, tmp_path):
    """Invented runs: one row holds more often than the others, the plain loss is right more."""

    def values(title, seed, scene):
        rng = np.random.default_rng([seed, len(scene), *scene.encode()])
        easy, luck = rng.random(2)
        right = easy < (0.6 if "Pos" in title else 0.95)
        return right, luck < (0.9 if "Strong 2 / all" in title and "Pos / 3" in title else 0.3)

    plan = make_plan(Request("claims", str(many), rows="GG-CNN2 / RGB-D"))
    results = pretend(plan, tmp_path, values)
    found = judge(plan, results, tmp_path)
    strong = judged_by(found, "Strong maps, trials")
    assert (strong.verdict, strong.in_trials) == (HOLDS, HOLDS)
    assert [bool(pair.found) for pair in strong.pairs] == [True, True, False, False, False, False]
    assert strong.pairs[2].why == "the first row was not asked for"
    positional = judged_by(found, "Positional loss")
    assert positional.verdict == FAILS
    assert max(positional.pairs[0].found["success"].by_seed) < -0.2
    assert positional.pairs[0].verdicts["sgt"] == HOLDS
    assert judged_by(found, "Drop-off").verdict == OPEN
    assert judged_by(found, "Saliency as a second task").verdict == UNTESTED
    assert judged_by(found, "Fewer training examples").verdict == UNTESTED
    # Two rows out of twelve are unlike the others: that says nothing of which measure is better.
    assert judged_by(found, "Mean overlap foretells trials").verdict == OPEN


def test_numbers_of_a_pair_are_those_of_the_files(many, tmp_path):
    """The comparison, made again by hand from the files of the runs."""

    def values(title, seed, scene):
        rng = np.random.default_rng([seed, len(title), *scene.encode()])
        return rng.random() < 0.5, rng.random() < 0.4

    rows = "GG-CNN2 / RGB-D / * / Strong 2 / all"
    plan = make_plan(Request("claims", str(many), rows=rows, seed=3))
    results = pretend(plan, tmp_path, values)
    one = judged_by(judge(plan, results, tmp_path), "Three bins").pairs[0]
    rows = {line.title: row for row, line in enumerate(plan.lines)}
    tables = []
    for title in (one.pair.better, one.pair.than):
        table, objects = [], []
        for run in plan.cells[rows[title], 0]:
            read = {p: read_run_folder(tmp_path / run / "parts" / p) for p in plan.parts.tests}
            scenes = [(p, s) for p, folder in read.items() for s in folder.scenes.values()]
            table.append([float(s.held) for _, s in scenes])
            objects = [(p, s.object_id) for p, s in scenes]
        tables.append(table)
    expected = compare_seeds(*tables, groups=objects, rng=np.random.default_rng(3))
    assert one.found["sgt"] == expected
    cells = {c.measure: cell for c, cell in zip(fill(plan, results).columns,
             fill(plan, results).cells[rows[one.pair.better]], strict=True)}  # fmt: skip
    assert cells["sgt"].values == pytest.approx([100 * np.mean(run) for run in tables[0]])


def test_a_seed_that_failed_leaves_both_sides(many, tmp_path):
    plan = make_plan(Request("claims", str(many), rows="GG-CNN2 / RGB-D"))
    results = pretend(plan, tmp_path, lambda _title, seed, _scene: (seed == 1, True))
    row = [line.title for line in plan.lines].index("GG-CNN2 / RGB-D / Pos / 3 / Strong 2 / all")
    first, second, _ = plan.cells[row, 0]
    two = {run: found for run, found in results.items() if run != first}
    pair = judged_by(judge(plan, two, tmp_path), "Three bins").pairs[0]
    assert pair.found["success"].seeds == 2
    assert pair.found["success"].scenes.mean_b == 0.5
    one = {run: found for run, found in two.items() if run != second}
    pair = judged_by(judge(plan, one, tmp_path), "Three bins").pairs[0]
    assert (dict(pair.found), pair.why) == ({}, "1 seeds were trained of both")


def test_which_measure_foretells_trials(many, tmp_path):
    """Trials that follow the overlap exactly, and success at 0.25 that says the reverse."""

    def values(title, seed, scene):
        place = [line.title for line in plan.lines].index(title)
        return seed == 0, seed == 0 and place >= 0

    plan = make_plan(Request("claims", str(many), rows="GG-CNN2 / RGB-D"))
    results = pretend(plan, tmp_path, values)
    for row in range(len(plan.lines)):
        for run in plan.cells[row, 0]:
            noise = 0.03 * (row % 3)
            results[run]["parts"] |= {
                "miou": 0.3 + 0.02 * row, "trials": 0.4 + 0.03 * row + noise / 3,
                "success": {"0.25": 0.9 - 0.02 * row + noise, "0.75": 0.1 * (row % 2)},
            }  # fmt: skip
    found = judged_by(judge(plan, results, tmp_path), "Mean overlap foretells trials")
    assert found.verdict == HOLDS
    assert found.gain.models == len(plan.lines)
    assert found.gain.interval[0] > 0 > found.correlations["success"].pearson
    few = dataclasses.replace(plan, lines=plan.lines[:3])
    assert judge(few, results, tmp_path)[-1].verdict == UNTESTED


def test_pages_say_the_same(many, tmp_path):
    plan = make_plan(Request("claims", str(many), rows="GG-CNN2 / RGB-D"))
    results = pretend(plan, tmp_path, lambda title, _seed, _scene: ("Pos" in title, True))
    filled = fill(plan, results, claims=judge(plan, results, tmp_path))
    content, page = to_dict(filled), to_markdown(filled)
    assert [one["name"] for one in content["claims"]] == [c.name for c in plan.table.claims]
    for one in content["claims"]:
        assert f"## {one['name']}: {one['verdict']}\n\n{one['statement']}" in page
        assert one["printed"] in page
    assert content["claims"][0]["verdict"] == HOLDS
    assert all(line in page for line in claims.RULE)
    assert content["parts"]["test-known"]["scenes"] == 60
    assert content["seeds"] == 3
    assert "3 seeds a row" in page
    assert "Part test-known: 60 scenes of 30 objects" in page
    (rows,) = {len(line) for line in csv.reader(to_csv(filled).splitlines())}
    assert rows == len(plan.table.labels) + 3 * len(plan.measures)


# All of it, small.


def test_a_small_run_of_two_claims(parts, cache, tmp_path, capsys, one_thread):
    out = tmp_path / "out"
    words = ["reproduce", "claims", "--data", str(parts), "--scale", "0.0003", "--seeds", "2",
             "--rows", "GG-CNN2 / RGB-D / * / 1 / Binary*", "--data.size", "32",
             "--data.augment.crop", "24", "--data.cache_dir", str(cache), "--devices", "cpu",
             "--workers", "1", "--out", str(out)]  # fmt: skip
    assert main([*words, "--dry-run"]) == 0
    assert not out.exists()
    assert "6 runs" in capsys.readouterr().out
    assert main(words) == 0
    before = {path.name: path.read_bytes() for path in (out / "claims").iterdir()}
    assert before.keys() == {"claims.md", "claims.csv", "claims-pairs.csv", "claims.json"}
    content = json.loads(before["claims.json"])
    found = {one["name"]: one for one in content["claims"]}
    tested = {name for name, one in found.items() if any(p["measures"] for p in one["pairs"])}
    assert tested == {"Positional loss", "Overlap rule, ours against published"}
    pair = found["Positional loss"]["pairs"][1]["measures"]["sgt"]
    assert pair["seeds"] == 2
    assert pair["over_scenes"]["scenes"] == SIZES["test-known"] + SIZES["test-tools"]
    assert found["Three bins"]["verdict"] == UNTESTED
    assert found["Mean overlap foretells trials"]["verdict"] == UNTESTED  # three rows
    assert content["parts"]["train"]["data_hash"].startswith("manifest:")
    # Trained on one part, chosen with another, tested on a third; no scene left out.
    for run in (out / "runs").iterdir():
        card = json.loads((run / "train" / "weights.json").read_text())
        assert card["data"]["scenes"] == {"train": 4, "validation": 2, "test": 3}
        numbers = json.loads((run / "result.json").read_text())["parts"]
        assert numbers["scenes"] == numbers["tried"] == 5
        assert {n: p["scenes"] for n, p in numbers["by_part"].items()} == {
            "test-known": 3, "test-tools": 2,
        }  # fmt: skip
    # Stopped amid the last part: what is missing is measured again, from the weights, to the same.
    (run, *_) = (out / "runs").iterdir()
    result = json.loads((run / "result.json").read_text())
    del result["parts"]
    (run / "result.json").write_text(json.dumps(result))
    (run / "parts" / "test-tools" / "trials.json").unlink()
    assert main(words) == 0
    assert {path.name: path.read_bytes() for path in (out / "claims").iterdir()} == before
    # Trained anew: what was measured of other weights does not pass for theirs.
    (run / "result.json").unlink()
    shutil.rmtree(run / "train")
    per_grasp = run / "parts" / "test-known" / "per_grasp.csv"
    per_grasp.write_text(re.sub("slipped|dropped|empty|collided|no_grasp", "held",
                                per_grasp.read_text()))  # fmt: skip
    assert main(words) == 0
    assert {path.name: path.read_bytes() for path in (out / "claims").iterdir()} == before


def test_networks_see_the_sensor_and_trials_are_placed_exactly(parts, tmp_path, monkeypatch):
    (run, *_) = make_plan(Request("claims", str(parts), rows="GG-CNN2 / RGB /")).runs
    seen, placed = [], []

    def predict(detector, scenes, **_):
        seen.append(scenes.depth)
        return evaluation.GraspsToTry({})

    def attempt(grasps, scenes, *args, **options):
        placed.append(scenes.depth)
        return trials.try_grasps(grasps, scenes, *args, **options)

    class Nobody:
        """Finds no grasp."""

        def detect(self, *_args, **_options):
            return SimpleNamespace(grasps=Grasps.empty())

    monkeypatch.setattr(evaluation, "predict_scenes", predict)
    monkeypatch.setattr(evaluation, "try_grasps", attempt)
    found = held_out.measure_parts(Nobody(), run, tmp_path, no_progress)
    assert (seen, placed) == (["stereo"] * 2, ["perfect"] * 2)
    assert (found["scenes"], found["tried"], found["trials"], found["miou"]) == (5, 5, 0, 0)
