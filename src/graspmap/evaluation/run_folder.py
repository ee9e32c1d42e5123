"""What `graspmap evaluate` and `graspmap trial` left in a folder, read back."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from graspmap.errors import FileFormatError, MissingFileError
from graspmap.evaluation import results, trial_results
from graspmap.files import read_text
from graspmap.metrics.trial import HELD

_REMEDY = "evaluate again with --out"
_OTHER = "name a folder that graspmap evaluate --data or graspmap trial wrote with --out"
_BEST_RANK = "0"
_RIGHT = "correct@"
_TRIALS: Mapping[str, type] = {"data": str, "cluster": str, "success": float, "interval": list}
_EVALUATION: Mapping[str, type] = {
    "data": str, "cluster": str, "protocol": str, "success": dict, "interval": dict,
    "miou": float, "miou_interval": list, "auc": float,
}  # fmt: skip


@dataclass(frozen=True)
class MeasuredScene:
    """What one scene gave.

    Attributes:
        object_id: Its object; None where unknown.
        iou: Overlap of the best grasp, 0 to 1; None where rectangles were not measured.
        right: Whether it was right, by threshold.
        held: Whether it held in its trial; None where none was made.
    """

    object_id: str | None
    iou: float | None
    right: Mapping[str, bool]
    held: bool | None


@dataclass(frozen=True, eq=False)
class RunFolder:
    """One evaluation, trials, or both.

    Attributes:
        folder: Where it lies.
        data: The data set, ``kind:directory``.
        protocol: How rectangles were counted; None where they were not.
        cluster: What its intervals take as independent: ``scene`` or ``object``.
        summary: What ``evaluation.json`` holds; ``trials`` is that of ``trials.json`` where the
            trials were made by themselves.
        scenes: What was measured, by scene.
    """

    folder: Path
    data: str
    protocol: str | None
    cluster: str
    summary: Mapping[str, Any]
    scenes: Mapping[str, MeasuredScene]


def read_run_folder(folder: Path | str) -> RunFolder:
    """Read a folder that ``--out`` made.

    Raises:
        MissingFileError: There is neither an evaluation nor trials in it, or the file with one row
            a scene is gone.
        FileFormatError: A file is damaged, or lacks something, or trials and evaluation are of two
            detectors; the error names it.
    """
    root = Path(folder)
    evaluation, trials = root / results.SUMMARY_FILE, root / trial_results.SUMMARY_FILE
    if not evaluation.is_file() and not trials.is_file():
        raise MissingFileError(
            root,
            f"has neither {results.SUMMARY_FILE} nor {trial_results.SUMMARY_FILE}",
            _OTHER,
        )
    summary: dict[str, Any] = {}
    scenes: dict[str, MeasuredScene] = {}
    if evaluation.is_file():
        summary = _read_json(evaluation)
        if "egad" in summary and "success" not in summary:
            raise FileFormatError(
                evaluation, "holds trials of EGAD, which have no scenes to share", _OTHER
            )
        _check(summary, evaluation, _EVALUATION)
        scenes = _read_scenes(root / results.PER_SCENE_FILE)
    if trials.is_file():
        tried = _check(_read_json(trials), trials, _TRIALS)
        own = {"detector": tried["detector"]} if "detector" in tried else {}
        if own and _content(own["detector"]) != _content({**own, **summary}["detector"]):
            raise FileFormatError(trials, "holds trials of another detector", _REMEDY)
        summary = {"trials": tried, **own, **summary}
        scenes = _with_trials(scenes, root / trial_results.PER_GRASP_FILE)
    first = summary if evaluation.is_file() else summary["trials"]
    return RunFolder(
        root, first["data"], summary.get("protocol"), first["cluster"], summary, scenes
    )


def check_same_detector(folder: Path, detector: Mapping[str, Any], *, trials: bool) -> None:
    """Refuse to measure a detector into a folder that keeps the other half of another one.

    Rectangles and trials in one folder are taken for those of one detector.

    Args:
        folder: Where the results are to be written.
        detector: What is measured, as ``evaluation.json`` and ``trials.json`` say it.
        trials: Whether trials alone are to be written there; else an evaluation without them.

    Raises:
        FileFormatError: What stays in the folder is of another detector, or damaged.
    """
    stays = folder / (results.SUMMARY_FILE if trials else trial_results.SUMMARY_FILE)
    if not stays.is_file():
        return
    known = _read_json(stays).get("detector")
    if _content(known) == _content(detector):
        return
    what = "the evaluation" if trials else "trials"
    whose = "another detector" if known else "a detector that it does not name"
    other = "evaluate this one, too" if trials else "try the grasps of this one, too: --trials"
    remedy = f"choose another folder with --out, or {other}"
    raise FileFormatError(stays, f"holds {what} of {whose}", remedy)


def _content(detector: Any) -> tuple[Any, Any]:
    """What makes a detector this one: weights and predictions by content, wherever they lie."""
    if not isinstance(detector, Mapping):
        return None, None
    return detector.get("kind"), detector.get("hash")


def _read_json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        problem = f"is no JSON (line {error.lineno}: {error.msg})"
        raise FileFormatError(path, problem, _REMEDY) from error
    if not isinstance(value, dict):
        raise FileFormatError(path, "is no summary", _REMEDY)
    return value


def _check(summary: dict[str, Any], path: Path, needed: Mapping[str, type]) -> dict[str, Any]:
    for name, kind in needed.items():
        if not isinstance(summary.get(name), kind):
            found = "is missing" if name not in summary else f"is {summary[name]!r}"
            raise FileFormatError(path, f"{name} {found}", _REMEDY)
    return summary


def _read_rows(path: Path, needed: tuple[str, ...]) -> list[dict[str, str]]:
    reader = csv.DictReader(io.StringIO(read_text(path)))
    missing = [name for name in needed if name not in (reader.fieldnames or ())]
    if missing:
        raise FileFormatError(path, f"lacks the column {missing[0]}", _REMEDY)
    rows = list(reader)
    for number, row in enumerate(rows, start=2):
        if None in row or None in row.values():
            raise FileFormatError(path, f"line {number} has not one value a column", _REMEDY)
    return rows


def _read_scenes(path: Path) -> dict[str, MeasuredScene]:
    scenes = {}
    for number, row in enumerate(_read_rows(path, ("id", "object_id", "iou")), start=2):
        try:
            iou = float(row["iou"])
        except ValueError:
            problem = f"line {number}: iou is {row['iou']!r}, no number"
            raise FileFormatError(path, problem, _REMEDY) from None
        right = {k.removeprefix(_RIGHT): v == "1" for k, v in row.items() if k.startswith(_RIGHT)}
        outcome = row.get("outcome")
        held = outcome == HELD if outcome else None
        scenes[row["id"]] = MeasuredScene(row["object_id"] or None, iou, right, held)
    return scenes


def _with_trials(scenes: Mapping[str, MeasuredScene], path: Path) -> dict[str, MeasuredScene]:
    """The scenes with the trial of their best grasp, and those that were only tried."""
    merged = dict(scenes)
    for row in _read_rows(path, ("scene", "object_id", "rank", "outcome")):
        if row["rank"] == _BEST_RANK:
            known = scenes.get(
                row["scene"], MeasuredScene(row["object_id"] or None, None, {}, None)
            )
            merged[row["scene"]] = MeasuredScene(
                known.object_id, known.iou, known.right, row["outcome"] == HELD
            )
    return merged
