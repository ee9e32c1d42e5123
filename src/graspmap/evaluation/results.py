"""What an evaluation found: the score, one row a scene, and their files."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import FileError, InvalidInputError
from graspmap.files import write_text
from graspmap.geometry.grasps import Grasps
from graspmap.metrics.intervals import check_values
from graspmap.metrics.paired import compare_paired
from graspmap.metrics.protocols import PROTOCOLS, QUIRKS, RectangleProtocol
from graspmap.metrics.rectangle import (
    ANGLES_DEG,
    MAX_ANGLE,
    RectangleScore,
    count_right,
    score_rectangles,
)

Floats = NDArray[np.float64]

SUMMARY_FILE = "evaluation.json"
PER_SCENE_FILE = "per_scene.csv"

_NUMBERS = ("x", "y", "angle", "width", "height", "quality")


@dataclass(frozen=True, eq=False)
class SceneResult:
    """How the grasps of one scene fared.

    Attributes:
        id: The scene.
        object_id: Its object, if known.
        grasps: The K grasps that were judged, best first, in pixels of the scene's picture; none
            where none was predicted, which counts as a failure.
        overlaps: (K,) best overlap of each with an angle-compatible label, 0 to 1.
        by_angle: (A,) overlap of the best grasp at each of `ANGLES_DEG`.
    """

    id: str
    object_id: str | None
    grasps: Grasps
    overlaps: Floats
    by_angle: Floats

    @property
    def grasp(self) -> Grasps:
        """The best grasp (N = 1; N = 0 without one)."""
        return self.grasps[:1]

    @property
    def iou(self) -> float:
        """Overlap of the best grasp, 0 to 1; 0 without one."""
        return float(self.overlaps[0]) if len(self.overlaps) else 0.0


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
        top: How many grasps of a scene were judged.
        seed: Of the intervals.
        others: The same scenes judged by further protocols or quirks.
    """

    data: str
    protocol: RectangleProtocol
    score: RectangleScore
    results: tuple[SceneResult, ...]
    without_labels: tuple[str, ...] = ()
    cluster: str = "scene"
    top: int = 1
    seed: int = 0
    others: tuple[Evaluation, ...] = ()

    @property
    def scenes(self) -> int:
        """Number of scenes counted."""
        return len(self.results)

    @property
    def without_prediction(self) -> tuple[str, ...]:
        """Scenes counted as failures because no grasp was predicted for them."""
        return tuple(result.id for result in self.results if not len(result.grasp))

    def right(self) -> NDArray[np.bool_]:
        """(S, T) whether the best grasp of each scene is right, at each threshold of the score."""
        return self._right_at(tuple(self.score.success)) > 0

    def rows(self, outcomes: Mapping[str, str] | None = None) -> list[dict[str, Any]]:
        """One flat row a scene: pixels and radians as in `Grasps`, None without a grasp.

        Args:
            outcomes: How the trial of each scene's best grasp ended, where trials were made.
        """
        thresholds = tuple(self.score.success)
        rows = [
            _row(result, dict(zip(thresholds, marks.tolist(), strict=True)))
            for result, marks in zip(self.results, self.right(), strict=True)
        ]
        if outcomes is not None:
            rows = [{**row, "outcome": outcomes.get(row["id"])} for row in rows]
        return rows

    def to_dict(self, per_scene: Path | str | None = None) -> dict[str, Any]:
        """The summary for JSON; thresholds become keys with two decimals.

        Args:
            per_scene: Where the rows were written, if they were.
        """
        summary = {
            "data": self.data,
            "scenes": self.scenes,
            "protocol": self.protocol.name,
            **_numbers(self.score),
            "confidence": self.score.confidence,
            "cluster": self.cluster,
            "max_angle_deg": round(math.degrees(MAX_ANGLE), 9),
            "curve": self.curve(),
            "angles": self._by_angle(),
            "without_prediction": list(self.without_prediction),
            "without_labels": list(self.without_labels),
            "per_scene": None if per_scene is None else str(per_scene),
        }
        if self.top > 1:
            summary["top"] = self._by_rank()
        everything = {e.protocol.name: e for e in (self, *self.others)}
        published = [name for name in PROTOCOLS if name in everything]
        if len(published) > 1:
            summary["protocols"] = {name: _numbers(everything[name].score) for name in published}
        quirks = [e for e in self.others if e.protocol.name in QUIRKS]
        if quirks:
            summary["quirks"] = [self._price(quirk) for quirk in quirks]
        return summary

    def curve(self) -> dict[str, list[float]]:
        """Success at every hundredth of overlap from 0 to 1 (thesis, Fig. 5.6)."""
        thresholds = [i / 100 for i in range(101)]
        success = self._right_at(thresholds).mean(axis=0)
        return {"thresholds": thresholds, "success": success.tolist()}

    def groups(self) -> list[Hashable] | None:
        """What each scene hangs together with in the intervals; None: with no other."""
        return object_groups(self.results) if self.cluster == "object" else None

    def _right_at(self, thresholds: Sequence[float]) -> Floats:
        """(S, T) 1 where the best grasp of a scene is right at a threshold, else 0."""
        overlaps = check_values([result.iou for result in self.results])
        return count_right(overlaps, thresholds, rule=self.protocol.rule)

    def _by_angle(self) -> dict[str, float]:
        """Success at the first threshold by tolerance of the angle, degrees."""
        overlaps = np.array([result.by_angle for result in self.results])
        first = (min(self.score.success),)
        shares = [
            count_right(column, first, rule=self.protocol.rule).mean() for column in overlaps.T
        ]
        return {str(angle): float(p) for angle, p in zip(ANGLES_DEG, shares, strict=True)}

    def _by_rank(self) -> dict[str, Any]:
        """Scenes in which one of the first k grasps is right, for each k."""
        ranks = {}
        for k in range(1, self.top + 1):
            best = [float(result.overlaps[:k].max(initial=0.0)) for result in self.results]
            score = score_rectangles(
                best,
                rng=np.random.default_rng(self.seed),
                thresholds=tuple(self.score.success),
                confidence=self.score.confidence,
                groups=self.groups(),
                rule=self.protocol.rule,
            )
            part = _numbers(score)
            ranks[str(k)] = {name: part[name] for name in ("success", "interval")}
        return ranks

    def _price(self, quirk: Evaluation) -> dict[str, Any]:
        """What a habit changes at the first threshold."""
        ours, theirs = self.right()[:, 0], quirk.right()[:, 0]
        change = compare_paired(
            theirs,
            ours,
            groups=self.groups(),
            rng=np.random.default_rng(self.seed),
            confidence=self.score.confidence,
        )
        return {
            "name": quirk.protocol.name,
            "summary": quirk.protocol.summary,
            "success": float(theirs.mean()),
            "change": change.difference,
            "interval": list(change.interval),
        }

    def write_per_scene(self, path: Path | str, outcomes: Mapping[str, str] | None = None) -> Path:
        """Write one row a scene, as CSV or, where the name ends in ``.jsonl``, as JSON lines.

        Args:
            path: The file.
            outcomes: As in `rows`.

        Raises:
            InvalidInputError: The name ends in something else.
            FileError: The folder cannot be written to, or the disk is full.
        """
        target = Path(path)
        if target.suffix == ".jsonl":
            text = "".join(json.dumps(row) + "\n" for row in self.rows(outcomes))
        elif target.suffix == ".csv":
            text = as_csv(self.rows(outcomes))
        else:
            raise InvalidInputError("name of the per-scene file", target.name, "*.csv or *.jsonl")
        write_text(target, text)
        return target

    def write(
        self,
        folder: Path | str,
        sections: Mapping[str, Any] | None = None,
        outcomes: Mapping[str, str] | None = None,
    ) -> dict[str, Any]:
        """Write ``evaluation.json`` and ``per_scene.csv`` into a folder, which is made if needed.

        Args:
            folder: The folder.
            sections: Further sections of the summary, for example of trials.
            outcomes: As in `rows`.

        Returns:
            What ``evaluation.json`` holds.

        Raises:
            FileError: The folder cannot be written to or is a file, or the disk is full.
        """
        root = Path(folder)
        if root.exists() and not root.is_dir():
            raise FileError(root, "is a file, not a folder", "name another folder")
        per_scene = self.write_per_scene(root / PER_SCENE_FILE, outcomes)
        summary = {**self.to_dict(per_scene), **(sections or {})}
        # Last, so that a summary on disk always has its rows beside it.
        write_text(root / SUMMARY_FILE, json.dumps(summary, indent=2) + "\n")
        return summary


def object_groups(results: Sequence[SceneResult]) -> list[Hashable]:
    """A label for each scene's object; a scene whose object is unknown is one of its own."""
    return [
        (False, result.id) if result.object_id is None else (True, result.object_id)
        for result in results
    ]


def threshold_key(threshold: float) -> str:
    """Name of a threshold in results: two decimals, or as many as it has."""
    short = f"{threshold:.2f}"
    return short if float(short) == threshold else repr(threshold)


def _numbers(score: RectangleScore) -> dict[str, Any]:
    return {
        "success": {threshold_key(t): p for t, p in score.success.items()},
        "interval": {threshold_key(t): list(ends) for t, ends in score.interval.items()},
        "miou": score.miou,
        "miou_interval": list(score.miou_interval),
        "auc": score.auc,
    }


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
