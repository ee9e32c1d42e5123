"""Comparison: folders read back, paired on shared scenes, refused where they do not fit."""

from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from graspmap import cli
from graspmap.errors import FileFormatError, InvalidInputError, MissingFileError
from graspmap.evaluation.compare import compare_runs, holm
from graspmap.evaluation.report.comparison_page import write_comparison
from page_numbers import Page, check_numbers

SCENES = 40


def write_run(folder, quality, *, trials=None, data="jacquard:/data", scenes=SCENES, **changes):
    """A folder as ``graspmap evaluate --out`` leaves it, of a detector of some quality."""
    rng = np.random.default_rng((5, round(100 * quality)))
    folder.mkdir(parents=True)
    iou = np.clip(quality + rng.uniform(-0.3, 0.3, scenes), 0, 1)
    held = rng.random(scenes) < (quality if trials is None else trials)
    rows = [
        {"id": f"s{i}", "object_id": f"o{i // 4}" if i else "", "iou": repr(float(iou[i])),
         "correct@0.25": int(iou[i] > 0.25), "correct@0.50": int(iou[i] > 0.5)}
        for i in range(scenes)
    ]  # fmt: skip
    with (folder / "per_scene.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    success = {t: float((iou > float(t)).mean()) for t in ("0.25", "0.50")}
    summary = {
        "data": data, "scenes": scenes, "protocol": "strict", "success": success,
        "interval": {t: [p - 0.1, p + 0.1] for t, p in success.items()},
        "miou": float(iou.mean()), "miou_interval": [0.1, 0.9], "auc": float(iou.mean()),
        "confidence": 0.95, "cluster": "scene",
        "curve": {"thresholds": [0.0, 0.5, 1.0], "success": [1.0, success["0.50"], 0.0]},
        **changes,
    }  # fmt: skip
    (folder / "evaluation.json").write_text(json.dumps(summary))
    if trials is not None:
        write_trials(folder, held, data)
    return iou, held


def write_trials(folder, held, data="jacquard:/data"):
    folder.mkdir(parents=True, exist_ok=True)
    lines = ["scene,object_id,rank,outcome"]
    for i, one in enumerate(held):
        lines += [f"s{i},o{i // 4},0,{'held' if one else 'empty'}", f"s{i},o{i // 4},1,held"]
    (folder / "per_grasp.csv").write_text("\n".join(lines) + "\n")
    share = float(np.mean(held) + 1) / 2  # of both ranks
    summary = {"data": data, "cluster": "scene", "trials": 80, "held": round(80 * share),
               "success": share, "interval": [share / 2, (1 + share) / 2]}  # fmt: skip
    (folder / "trials.json").write_text(json.dumps(summary))


def pair(comparison, measure):
    (found,) = (p for p in comparison.pairs if p.measure == measure)
    return found


def test_pairs_are_of_the_scenes_that_both_have(tmp_path):
    iou_a, held_a = write_run(tmp_path / "a", 0.6, trials=0.9)
    iou_b, held_b = write_run(tmp_path / "b", 0.4, trials=0.2, scenes=30)
    found = compare_runs([tmp_path / "a", tmp_path / "b"])
    assert list(found.runs) == ["a", "b"]
    for measure, a, b in (
        ("success", iou_a > 0.25, iou_b > 0.25), ("iou", iou_a, iou_b), ("held", held_a, held_b),
    ):  # fmt: skip
        result = pair(found, measure).result
        assert result.scenes == 30
        assert result.difference == pytest.approx(np.mean(a[:30]) - np.mean(b), abs=1e-12)
        assert result.interval[0] <= result.difference <= result.interval[1]
    only_a, only_b = (held_a[:30] & ~held_b).sum(), (held_b & ~held_a[:30]).sum()
    p = scipy.stats.binomtest(int(only_a), int(only_a + only_b)).pvalue
    assert pair(found, "held").result.p_value == pytest.approx(p)
    assert pair(found, "held").p_adjusted == pair(found, "held").result.p_value
    assert f"of different scenes: {SCENES} of a, 30 of b; all have 30" in found.notes[0]


def test_the_same_evaluation_twice_does_not_differ(tmp_path):
    for name in "ab":
        write_run(tmp_path / name, 0.5, trials=0.5)
    for found in compare_runs([tmp_path / "a", tmp_path / "b"]).pairs:
        assert found.result.difference == 0
        assert found.result.p_value == found.p_adjusted == 1


def test_two_reports_give_the_same_numbers_wherever_they_stand(tmp_path):
    for name, quality in (("a", 0.6), ("b", 0.45), ("c", 0.5)):
        write_run(tmp_path / name, quality, trials=quality)
    a, b, c = (tmp_path / name for name in "abc")
    alone = {p.measure: p.result for p in compare_runs([a, b]).pairs}
    last = {p.measure: p.result for p in compare_runs([c, a, b]).pairs if (p.a, p.b) == ("a", "b")}
    assert last == alone
    turned = {p.measure: p.result for p in compare_runs([b, a]).pairs}
    for measure, result in turned.items():
        low, high = alone[measure].interval
        assert result.interval == pytest.approx((-high, -low), abs=1e-12)
        assert result.p_value == alone[measure].p_value


def edit_trials(folder, **settings):
    summary = json.loads((folder / "trials.json").read_text())
    summary["grippers"] = [settings.pop("gripper", "jacquard")]
    known = {"top": 1, "jaw": "nearest", "shake": None, "perturbation": None, "repeats": 1}
    summary["settings"] = {**known, "seed": 0, **settings}
    (folder / "trials.json").write_text(json.dumps(summary))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"gripper": "franka"}, "gripper of the trials of b is franka; allowed: jacquard, as of a"),
        ({"jaw": 0.02}, "jaw of the trials of b is 0.02; allowed: nearest, as of a"),
        ({"shake": {"frequency_hz": 4.0, "directions": ["up"]}},
         "shake of the trials of b is frequency_hz 4, directions up; allowed: none, as of a"),
        ({"perturbation": {"position_m": 0.002}},
         "perturbation of the trials of b is position_m 0.002; allowed: none, as of a"),
    ],
)  # fmt: skip
def test_trials_made_in_another_way_are_refused(tmp_path, settings, words):
    for name in "ab":
        write_run(tmp_path / name, 0.5, trials=0.5)
    edit_trials(tmp_path / "a")
    edit_trials(tmp_path / "b", **settings)
    with pytest.raises(InvalidInputError, match=re.escape(words)):
        compare_runs([tmp_path / "a", tmp_path / "b"])
    edit_trials(tmp_path / "b", seed=7, top=3)  # these change nothing about the best grasp
    assert compare_runs([tmp_path / "a", tmp_path / "b"]).pairs


def test_what_a_reader_should_know_is_told(tmp_path, capsys):
    write_run(tmp_path / "a", 0.6, depth=None, cluster="object")  # the default: perfect
    write_run(tmp_path / "b", 0.6, depth="stereo")
    write_run(tmp_path / "c", 0.3)
    words = ["compare", *(str(tmp_path / name) for name in "abc"), "--out", str(tmp_path / "out")]
    assert cli.main(words) == 0
    said = capsys.readouterr().out
    assert "warning: The detectors saw different depth: a perfect, b stereo." in said
    assert "take different things as independent: a objects, b scenes, c scenes" in said
    assert "warning: a and b have the same results in every scene" in said
    assert "b and c have" not in said
    page = (tmp_path / "out/comparison.html").read_text()
    assert "saw different depth: a perfect, b stereo" in page
    assert page.count("intervals by object") == 1
    assert page.count("intervals by scene") == 2
    both = compare_runs([tmp_path / "b", tmp_path / "c"])
    assert both.notes == ()


def test_objects_are_independent_only_where_all_say_so(tmp_path):
    write_run(tmp_path / "a", 0.6, cluster="object")
    write_run(tmp_path / "b", 0.4, cluster="object")
    write_run(tmp_path / "c", 0.4)
    both = compare_runs([tmp_path / "a", tmp_path / "b"])
    assert both.cluster == "object"
    # Ten objects of four scenes; one scene says no object, so it is one of its own.
    assert pair(both, "iou").result.groups == 11
    mixed = compare_runs([tmp_path / "a", tmp_path / "c"])
    assert mixed.cluster == "scene"
    assert pair(mixed, "iou").result.groups == SCENES


def test_trials_by_themselves_compare_with_an_evaluation(tmp_path):
    _, held_a = write_run(tmp_path / "a", 0.6, trials=0.8)
    held_b = np.zeros(SCENES, bool)
    write_trials(tmp_path / "b", held_b)
    found = compare_runs([tmp_path / "a", tmp_path / "b"])
    assert {p.measure for p in found.pairs} == {"held"}
    assert pair(found, "held").result.difference == pytest.approx(held_a.mean())
    trials = found.to_dict()["runs"]["a"]["trials"]
    assert (trials["trials"], trials["held"]) == (SCENES, held_a.sum())  # of the best grasps
    page = write_comparison(found, tmp_path / "out")[0]
    check_numbers(Page(page.read_text()), found.to_dict())


@pytest.mark.parametrize("count", [3, 4, 5])
def test_correlation_needs_four(tmp_path, count):
    rng = np.random.default_rng(1)
    folders = [tmp_path / str(i) for i in range(count)]
    shares = []
    for i, folder in enumerate(folders):
        _, held = write_run(folder, 0.3 + 0.1 * i, trials=float(rng.random()))
        shares.append(held.mean())
    found = compare_runs(folders)
    assert len(found.pairs) == 3 * count * (count - 1) / 2
    if count < 4:
        assert not found.correlations
        return
    assert set(found.correlations) == {
        "success at IoU 0.25", "success at IoU 0.50", "mean IoU", "AUC",
    }  # fmt: skip
    mious = [run.summary["miou"] for run in found.runs.values()]
    expected = scipy.stats.pearsonr(mious, shares).statistic
    assert found.correlations["mean IoU"].pearson == pytest.approx(expected)


@given(st.lists(st.floats(0, 1), max_size=8), st.floats(0.001, 0.999))
def test_holm_rejects_as_the_procedure_says(p_values, level):
    """Step by step: reject the least while it is below level / (tests that are left)."""
    rejected, left = set(), sorted(range(len(p_values)), key=lambda i: p_values[i])
    while left and p_values[left[0]] * len(left) <= level:
        rejected.add(left.pop(0))
    assert {i for i, p in enumerate(holm(p_values)) if p <= level} == rejected
    assert all(a >= p for a, p in zip(holm(p_values), p_values, strict=True))


def test_names_tell_folders_apart(tmp_path):
    for name in ("x/run", "y/run"):
        write_run(tmp_path / name, 0.5)
    assert list(compare_runs([tmp_path / "x/run", tmp_path / "y/run"]).runs) == ["x/run", "y/run"]


def test_page_json_and_csv_say_the_same(tmp_path, capsys):
    folders = [tmp_path / name for name in ("a", "<b>&c", "d", "e")]
    for i, folder in enumerate(folders):
        write_run(folder, 0.3 + 0.1 * i, trials=0.2 + 0.15 * i)
    page, table, values = write_comparison(compare_runs(folders), tmp_path / "out")
    assert cli.main(["compare", *map(str, folders)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"mean IoU and trials: Pearson -?\d.\d\d \(-?\d.\d\d to -?\d.\d\d\)", said)
    data = json.loads(values.read_text())
    check_numbers(Page(page.read_text()), data)
    shown = {key for key, _, _ in Page(page.read_text()).shown}
    assert {f"pairs[{i}].difference" for i in range(len(data["pairs"]))} <= shown
    assert not re.search(r"<b>&c", page.read_text())
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["run"] for row in rows] == [folder.name for folder in folders]
    for row in rows:
        run = data["runs"][row["run"]]
        assert float(row["success@0.25"]) == run["success"]["0.25"]
        assert float(row["trials_success"]) == run["trials"]["success"]


def test_the_command(tmp_path, capsys):
    for name, quality in (("a", 0.6), ("b", 0.4)):
        write_run(tmp_path / name, quality, trials=quality)
    words = ["compare", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "out")]
    assert cli.main([*words, "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out) == json.loads((tmp_path / "out/comparison.json").read_text())
    assert "a - b, held in trials: " in err
    assert "a - b, right at IoU 0.25: " in err
    assert (tmp_path / "out/comparison.html").is_file()
    assert cli.main([*words, "--confidence", "1.5"]) == 2
    assert "--confidence is 1.5; allowed: above 0 and below 1" in capsys.readouterr().err


def refuse_edit(tmp_path, edit):
    write_run(tmp_path / "a", 0.5, trials=0.5)
    write_run(tmp_path / "b", 0.5, trials=0.5)
    edit(tmp_path / "b")
    return [tmp_path / "a", tmp_path / "b"]


def rewrite(name, old, new):
    def edit(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return edit


@pytest.mark.parametrize(
    ("edit", "error", "words"),
    [
        (rewrite("evaluation.json", "jacquard:/data", "jacquard:/other"), InvalidInputError,
         "data set of b is jacquard:/other; allowed: jacquard:/data, as of a"),
        (rewrite("evaluation.json", '"strict"', '"ggcnn"'), InvalidInputError,
         "protocol of b is ggcnn; allowed: strict, as of a"),
        (lambda f: [(f / n).unlink() for n in ("evaluation.json", "trials.json")],
         MissingFileError, "has neither evaluation.json nor trials.json"),
        (lambda f: (f / "per_scene.csv").unlink(), MissingFileError, "per_scene.csv: no such file"),
        (rewrite("evaluation.json", "{", "{,"), FileFormatError, "is no JSON (line 1"),
        (rewrite("evaluation.json", '"success"', '"egad"'), FileFormatError, "no scenes to share"),
        (rewrite("evaluation.json", '"miou"', '"mean"'), FileFormatError, "miou is missing"),
        (rewrite("evaluation.json", '"auc": 0', '"auc": "x", "b": 0'), FileFormatError,
         "auc is 'x'"),
        (rewrite("trials.json", '"success"', '"x"'), FileFormatError, "success is missing"),
        (rewrite("per_scene.csv", "iou", "overlap"), FileFormatError, "lacks the column iou"),
        (rewrite("per_scene.csv", "s0,,0", "s0,,x0"), FileFormatError, "line 2: iou is 'x0"),
        (rewrite("per_scene.csv", "s0,,", "s0,"), FileFormatError, "line 2 has not one value"),
        (rewrite("per_grasp.csv", "outcome", "end"), FileFormatError, "lacks the column outcome"),
    ],
)  # fmt: skip
def test_folders_that_do_not_fit_are_told(tmp_path, edit, error, words):
    with pytest.raises(error, match=re.escape(words)):
        compare_runs(refuse_edit(tmp_path, edit))


def test_too_few_folders_or_scenes(tmp_path):
    write_run(tmp_path / "a", 0.5)
    write_run(tmp_path / "b", 0.5)
    with pytest.raises(InvalidInputError, match="folders to compare is 1; allowed: two or more"):
        compare_runs([tmp_path / "a"])
    with pytest.raises(InvalidInputError, match="a twice"):
        compare_runs([tmp_path / "a", tmp_path / "b", tmp_path / "x/../a"])
    rows = (tmp_path / "b/per_scene.csv").read_text().replace("\ns", "\nt")
    (tmp_path / "b/per_scene.csv").write_text(rows)
    with pytest.raises(InvalidInputError, match="none among 40 of a, 40 of b"):
        compare_runs([tmp_path / "a", tmp_path / "b"])
