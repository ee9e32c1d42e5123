"""Results of an evaluation: summary keys, rows, and the files they are written to."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from graspmap.errors import FileError, InvalidInputError
from graspmap.evaluation import Evaluation, SceneResult
from graspmap.evaluation.results import threshold_key
from graspmap.geometry.grasps import Grasps
from graspmap.metrics import ANGLES_DEG, find_protocol, score_rectangles

OVERLAPS = (1.0, 0.2, 0.26, 0.9, 0.0)
GRASP = Grasps([[10.25, 20.5]], [0.1], [30.0], [15.0], [0.7])


def evaluation(protocol: str = "strict") -> Evaluation:
    """Five scenes; the last has no prediction, and a sixth was left out."""
    found = zip(OVERLAPS, [GRASP] * 4 + [Grasps.empty()], strict=True)
    results = tuple(
        SceneResult(
            f"scene{i}",
            None if i == 1 else f"object{i // 2}",
            grasp,
            np.full(len(grasp), iou),
            np.where(np.array(ANGLES_DEG) < 20, 0.0, iou),
        )
        for i, (iou, grasp) in enumerate(found)
    )
    score = score_rectangles(OVERLAPS, rng=np.random.default_rng(0))
    return Evaluation("fake:nowhere", find_protocol(protocol), score, results, ("scene5",))


def test_summary_keys_and_json():
    got = evaluation()
    summary = json.loads(json.dumps(got.to_dict("rows.csv")))
    assert list(summary["success"]) == ["0.25", "0.30", "0.50", "0.75"] == list(summary["interval"])
    assert summary["scenes"] == 5
    assert summary["success"]["0.25"] == 0.6
    low, high = summary["interval"]["0.25"]
    assert 0 <= low < 0.6 < high <= 1
    assert (summary["data"], summary["protocol"]) == ("fake:nowhere", "strict")
    assert summary["cluster"] == "scene"
    assert summary["auc"] == summary["miou"] == pytest.approx(0.472)
    assert summary["per_scene"] == "rows.csv"
    assert summary["without_prediction"] == ["scene4"]
    assert summary["without_labels"] == ["scene5"]
    assert got.to_dict()["per_scene"] is None
    assert summary["angles"] == {str(a): 0.6 if a >= 20 else 0.0 for a in ANGLES_DEG}


def test_the_curve_counts_at_every_hundredth():
    curve = evaluation().curve()
    assert len(curve["thresholds"]) == len(curve["success"]) == 101
    counted = [sum(overlap > t for overlap in OVERLAPS) / 5 for t in curve["thresholds"]]
    assert curve["success"] == pytest.approx(counted)
    # The area under it is the mean overlap, to half a step.
    assert np.mean(curve["success"]) == pytest.approx(0.472, abs=0.01)


def test_rows_say_how_the_trials_ended():
    rows = evaluation().rows({"scene0": "held", "scene2": "slipped"})
    assert [row["outcome"] for row in rows] == ["held", None, "slipped", None, None]


def test_threshold_keys_do_not_collide():
    assert [threshold_key(t) for t in (0.3, 0.25, 0.255, 1)] == ["0.30", "0.25", "0.255", "1.00"]


@pytest.mark.parametrize("suffix", [".csv", ".jsonl"])
def test_rows_round_trip(tmp_path, suffix):
    got = evaluation()
    path = got.write_per_scene(tmp_path / "new" / f"rows{suffix}")
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file)) if suffix == ".csv" else [json.loads(r) for r in file]
    assert [row["id"] for row in rows] == [f"scene{i}" for i in range(5)]
    assert float(rows[0]["angle"]) == 0.1
    names = ("x", "y", "width", "height", "quality", "iou")
    assert [float(rows[0][name]) for name in names] == [10.25, 20.5, 30, 15, 0.7, 1]
    assert rows[1]["object_id"] == ("" if suffix == ".csv" else None)
    assert [float(row["correct@0.25"]) for row in rows] == [1, 0, 1, 1, 0]
    assert rows[4]["x"] == ("" if suffix == ".csv" else None)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_write_folder(tmp_path):
    got = evaluation()
    summary = got.write(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "evaluation.json").read_text()) == summary
    assert Path(summary["per_scene"]).is_file()


def test_writing_refuses(tmp_path):
    got = evaluation()
    with pytest.raises(InvalidInputError, match=r"\*\.csv or \*\.jsonl"):
        got.write_per_scene(tmp_path / "rows.xlsx")
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="is a file"):
        got.write(tmp_path / "file")
