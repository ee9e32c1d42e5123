"""What an evaluation found: the score, one row a scene, and their files."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from graspmap.errors import FileError, InvalidInputError
from graspmap.files import write_text
from graspmap.geometry.grasps import Grasps
from graspmap.metrics.intervals import check_values
from graspmap.metrics.protocols import RectangleProtocol
from graspmap.metrics.rectangle import RectangleScore, count_right

SUMMARY_FILE = "evaluation.json"
PER_SCENE_FILE = "per_scene.csv"

_NUMBERS = ("x", "y", "angle", "width", "height", "quality")


@dataclass(frozen=True)
class SceneResult:
    """How the grasp of one scene fared.

    Attributes:
        id: The scene.
        object_id: Its object, if known.
        grasp: The grasp that was judged (N = 1), in pixels of the scene's picture; empty (N = 0)
            where none was predicted, which counts as a failure.
        iou: Best overlap with an angle-compatible label, 0 to 1; 0 without a grasp.
    """

    id: str
    object_id: str | None
    grasp: Grasps
    iou: float


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Score of a detector, or of a predictions file, over the labelled scenes of a data set.

    Attributes:
        data: The data set, ``kind:directory``.
        protocol: How grasps were decoded and counted.
        score: Success, mean overlap and area under the curve.
        results: One result for each scene that was counted.
        without_labels: Scenes that were skipped, because no labelled rectangle is there to hit.
        cluster: What the intervals take as independent: ``scene`` or ``object``.
    """

    data: str
    protocol: RectangleProtocol
    score: RectangleScore
    results: tuple[SceneResult, ...]
    without_labels: tuple[str, ...] = ()
    cluster: str = "scene"

    @property
    def scenes(self) -> int:
        """Number of scenes counted."""
        return len(self.results)

    @property
    def without_prediction(self) -> tuple[str, ...]:
        """Scenes counted as failures because no grasp was predicted for them."""
        return tuple(result.id for result in self.results if not len(result.grasp))

    def rows(self) -> list[dict[str, Any]]:
        """One flat row a scene: pixels and radians as in `Grasps`, None without a grasp."""
        thresholds = tuple(self.score.success)
        overlaps = check_values([result.iou for result in self.results])
        right = count_right(overlaps, thresholds, rule=self.protocol.rule)
        return [
            _row(result, dict(zip(thresholds, marks.astype(bool).tolist(), strict=True)))
            for result, marks in zip(self.results, right, strict=True)
        ]

    def to_dict(self, per_scene: Path | str | None = None) -> dict[str, Any]:
        """The summary for JSON; thresholds become keys with two decimals.

        Args:
            per_scene: Where the rows were written, if they were.
        """
        score = self.score
        return {
            "data": self.data,
            "scenes": self.scenes,
            "protocol": self.protocol.name,
            "success": {threshold_key(t): p for t, p in score.success.items()},
            "interval": {threshold_key(t): list(ends) for t, ends in score.interval.items()},
            "miou": score.miou,
            "miou_interval": list(score.miou_interval),
            "auc": score.auc,
            "confidence": score.confidence,
            "cluster": self.cluster,
            "without_prediction": list(self.without_prediction),
            "without_labels": list(self.without_labels),
            "per_scene": None if per_scene is None else str(per_scene),
        }

    def write_per_scene(self, path: Path | str) -> Path:
        """Write one row a scene, as CSV or, where the name ends in ``.jsonl``, as JSON lines.

        Raises:
            InvalidInputError: The name ends in something else.
            FileError: The folder cannot be written to, or the disk is full.
        """
        target = Path(path)
        if target.suffix == ".jsonl":
            text = "".join(json.dumps(row) + "\n" for row in self.rows())
        elif target.suffix == ".csv":
            text = as_csv(self.rows())
        else:
            raise InvalidInputError("name of the per-scene file", target.name, "*.csv or *.jsonl")
        write_text(target, text)
        return target

    def write(self, folder: Path | str) -> dict[str, Any]:
        """Write ``evaluation.json`` and ``per_scene.csv`` into a folder, which is made if needed.

        Returns:
            What ``evaluation.json`` holds.

        Raises:
            FileError: The folder cannot be written to or is a file, or the disk is full.
        """
        root = Path(folder)
        if root.exists() and not root.is_dir():
            raise FileError(root, "is a file, not a folder", "name another folder")
        summary = self.to_dict(self.write_per_scene(root / PER_SCENE_FILE))
        # Last, so that a summary on disk always has its rows beside it.
        write_text(root / SUMMARY_FILE, json.dumps(summary, indent=2) + "\n")
        return summary


def threshold_key(threshold: float) -> str:
    """Name of a threshold in results: two decimals, or as many as it has."""
    short = f"{threshold:.2f}"
    return short if float(short) == threshold else repr(threshold)


def _row(result: SceneResult, right: dict[float, bool]) -> dict[str, Any]:
    grasp = result.grasp
    numbers: dict[str, float | None] = dict.fromkeys(_NUMBERS)
    if len(grasp):
        sizes = (grasp.angle, grasp.width, grasp.height, grasp.quality)
        values = (*grasp.center[0], *(size[0] for size in sizes))
        numbers = {name: float(v) for name, v in zip(_NUMBERS, values, strict=True)}
    return {
        "id": result.id,
        "object_id": result.object_id,
        **numbers,
        "iou": result.iou,
        **{f"correct@{threshold_key(t)}": mark for t, mark in right.items()},
    }


def as_csv(rows: Sequence[dict[str, Any]]) -> str:
    """Rows of equal keys as CSV; their keys are the first line."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    # 0 and 1 read as numbers in every spreadsheet; True and False do not.
    writer.writerows({k: int(v) if isinstance(v, bool) else v for k, v in r.items()} for r in rows)
    return text.getvalue()
