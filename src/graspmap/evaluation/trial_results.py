"""What trials over a data set found: every grasp with its outcome, the score, and their files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import FileError
from graspmap.evaluation.results import as_csv
from graspmap.evaluation.trial_plan import TrialPlan
from graspmap.files import write_text
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.metrics.intervals import bootstrap_means, share_interval
from graspmap.metrics.trial import HELD, TrialScore, first_held
from graspmap.simulation.outcomes import Outcome, TrialResult

NO_GRASP = "no_grasp"
"""Outcome of a scene for which no grasp was predicted: a failure."""
OFF_TABLE = "off_table"
"""Outcome of a grasp at or above the horizon, where no table is: a failure."""

SUMMARY_FILE = "trials.json"
PER_GRASP_FILE = "per_grasp.csv"
UNFINISHED_FILE = "unfinished.jsonl"
"""Finished scenes of a run that was stopped; see `graspmap.evaluation.trial_journal`."""

_PIXELS = ("angle", "width", "height", "quality")


@dataclass(frozen=True, eq=False)
class Placed:
    """A grasp on the table, and what became of it there.

    Attributes:
        table: The grasp (N = 1) as it was tried, metres.
        position_m: (3,) its centre in the camera's frame (x right, y down, z forward), metres.
        result: The trial.
        grasped: Id of the object that the fingers closed on; None where on none.
    """

    table: TableGrasps
    position_m: NDArray[np.float64]
    result: TrialResult
    grasped: str | None


@dataclass(frozen=True, eq=False)
class TriedGrasp:
    """One grasp and what became of it.

    Attributes:
        scene: Id of the scene.
        object_id: Its object, if known.
        rank: 0 for the best grasp of its scene.
        grasp: The grasp (N = 1) as it was given, in pixels of the scene's picture; empty where
            none was predicted.
        placed: Its trial; None where there was none to try.
    """

    scene: str
    object_id: str | None
    rank: int
    grasp: Grasps
    placed: Placed | None

    @property
    def outcome(self) -> str:
        """The trial's outcome; `NO_GRASP` or `OFF_TABLE` where there was none."""
        if self.placed is not None:
            return self.placed.result.outcome.value
        return OFF_TABLE if len(self.grasp) else NO_GRASP

    @property
    def reason(self) -> str:
        """Why it ended so, in words."""
        if self.placed is not None:
            return self.placed.result.reason
        return "its rays miss the table" if len(self.grasp) else "no grasp was predicted"

    def to_dict(self) -> dict[str, Any]:
        """An entry for JSON: as one of `graspmap detect`, with the outcome and its numbers.

        Pixels and radians as in `Grasps`; ``x_m, y_m, table_angle, width_m, jaw_m`` as in
        `TableGrasps`; the rest as in `TrialResult`.
        """
        entry: dict[str, Any] = {
            "scene": self.scene,
            "object_id": self.object_id,
            "rank": self.rank,
            "outcome": self.outcome,
            "reason": self.reason,
        }
        if len(self.grasp):
            entry |= {"x": float(self.grasp.center[0, 0]), "y": float(self.grasp.center[0, 1])}
            entry |= {name: float(getattr(self.grasp, name)[0]) for name in _PIXELS}
        if self.placed is None:
            return entry
        table = self.placed.table
        entry |= {
            "position_m": self.placed.position_m.tolist(),
            "width_m": float(table.width_m[0]),
            "x_m": float(table.center_m[0, 0]),
            "y_m": float(table.center_m[0, 1]),
            "table_angle": float(table.angle[0]),
            "jaw_m": float(table.height_m[0]),
            "grasped": self.placed.grasped,
        }
        return entry | {k: v for k, v in asdict(self.placed.result).items() if k not in entry}

    @classmethod
    def from_dict(cls, entry: Mapping[str, Any]) -> TriedGrasp:
        """The inverse of `to_dict`.

        Raises:
            KeyError, TypeError, ValueError: It is no such entry.
        """
        grasp, placed = Grasps.empty(), None
        if "x" in entry:
            sizes = {name: np.array([entry[name]]) for name in _PIXELS}
            grasp = Grasps(center=np.array([[entry["x"], entry["y"]]]), **sizes)
        if "x_m" in entry:
            result = {field.name: entry[field.name] for field in fields(TrialResult)}
            placed = Placed(
                TableGrasps(
                    center_m=np.array([[entry["x_m"], entry["y_m"]]]),
                    angle=np.array([entry["table_angle"]]),
                    width_m=np.array([entry["width_m"]]),
                    height_m=np.array([entry["jaw_m"]]),
                    quality=grasp.quality,
                ),
                np.array(entry["position_m"], dtype=np.float64),
                TrialResult(**{**result, "outcome": Outcome(result["outcome"])}),
                entry["grasped"],
            )
        return cls(entry["scene"], entry["object_id"], entry["rank"], grasp, placed)


@dataclass(frozen=True, eq=False)
class TrialEvaluation:
    """Trials over a data set.

    Attributes:
        data: The data set, ``kind:directory``.
        score: Success, interval, outcomes, per object.
        tried: Every grasp, by scene and rank.
        skipped: Scenes that could not be tried, with the reason; they count nowhere.
        grippers: Names of the grippers used.
        plan: How they were tried.
        cluster: What the interval takes as independent.
    """

    data: str
    score: TrialScore
    tried: tuple[TriedGrasp, ...]
    skipped: dict[str, str]
    grippers: tuple[str, ...]
    plan: TrialPlan
    cluster: str

    @property
    def scenes(self) -> int:
        """How many scenes count."""
        return len({tried.scene for tried in self.tried})

    @property
    def without_prediction(self) -> tuple[str, ...]:
        """Scenes that count as failures because no grasp was predicted for them."""
        return tuple(tried.scene for tried in self.tried if tried.outcome == NO_GRASP)

    def best(self) -> tuple[TriedGrasp, ...]:
        """The best grasp of each scene, or the scene without one."""
        return tuple(tried for tried in self.tried if tried.rank == 0)

    def robust(
        self, tried: tuple[TriedGrasp, ...] | None = None
    ) -> tuple[float, tuple[float, float]] | None:
        """Share of the perturbed repeats that held and its interval; None where none were made.

        Args:
            tried: The grasps that count; None: all.
        """
        tried = self.tried if tried is None else tried
        if self.plan.perturbation is None:
            return None
        shares = [t.placed.result.success_probability if t.placed else 0.0 for t in tried]
        robust = np.array(shares, dtype=np.float64)
        low, high = bootstrap_means(
            robust[:, None],
            rng=np.random.default_rng(self.plan.seed),
            groups=clusters(tried, self.cluster),
            confidence=self.score.confidence,
        )[0].tolist()
        return float(robust.mean()), (low, high)

    def score_of(self, tried: tuple[TriedGrasp, ...]) -> dict[str, Any]:
        """How some of the grasps fared, for JSON: trials, held, success, interval.

        Args:
            tried: The grasps, at least one.
        """
        return self._score([t.outcome == HELD for t in tried], tried)

    def _score(self, held: list[bool], tried: tuple[TriedGrasp, ...]) -> dict[str, Any]:
        """Of which some held, for JSON; what hangs together is drawn together."""
        interval = share_interval(
            np.array(held),
            rng=np.random.default_rng(self.plan.seed),
            groups=clusters(tried, self.cluster),
            confidence=self.score.confidence,
        )
        return {
            "trials": len(held),
            "held": sum(held),
            "success": sum(held) / len(held),
            "interval": list(interval),
        }

    def _ranks(self) -> dict[str, Any]:
        """Success by rank, and of a robot that tries again."""
        best, ranks = self.best(), [t.rank for t in self.tried]
        first = first_held([t.outcome for t in self.tried], [t.scene for t in self.tried], ranks)
        return {
            "per_rank": {
                str(rank): self.score_of(tuple(t for t in self.tried if t.rank == rank))
                for rank in sorted(set(ranks))
            },
            "one_of_first": {
                str(k): self._score([first[t.scene] < k for t in best], best)
                for k in range(1, max(ranks) + 2)
            },
        }

    def to_dict(self, per_grasp: Path | str | None = None) -> dict[str, Any]:
        """The summary for JSON.

        Args:
            per_grasp: Where the rows were written, if they were.
        """
        score, robust = self.score, self.robust()
        summary: dict[str, Any] = {
            "data": self.data,
            "scenes": self.scenes,
            "trials": score.trials,
            "held": score.held,
            "success": score.success,
            "interval": list(score.interval),
            "confidence": score.confidence,
            "cluster": self.cluster,
            "object_mean": score.object_mean,
            "outcomes": score.outcomes,
            "per_object": {name: group.to_dict() for name, group in score.per_object.items()},
            "robust_success": None if robust is None else robust[0],
            "robust_interval": None if robust is None else list(robust[1]),
            "grippers": list(self.grippers),
            "settings": self.plan.to_dict(),
            "without_prediction": list(self.without_prediction),
            "skipped": self.skipped,
            "per_grasp": None if per_grasp is None else str(per_grasp),
        }
        if self.plan.ranked:
            best = self.best()
            robust = self.robust(best)
            summary["best"] = {
                **self.score_of(best),
                "robust_success": None if robust is None else robust[0],
                "robust_interval": None if robust is None else list(robust[1]),
            }
            summary |= self._ranks()
        return summary

    def entries(self) -> list[dict[str, Any]]:
        """One entry for each grasp that was given, for JSON."""
        return [tried.to_dict() for tried in self.tried if len(tried.grasp)]

    def rows(self) -> list[dict[str, Any]]:
        """One flat row for each grasp, or scene without one; all have the same keys."""
        rows = [tried.to_dict() for tried in self.tried]
        keys = dict.fromkeys(key for row in rows for key in row if key != "position_m")
        return [{key: row.get(key) for key in keys} for row in rows]


def clusters(tried: tuple[TriedGrasp, ...], cluster: str) -> list[tuple[bool, str]]:
    """What each grasp hangs together with: its scene or, where it is known, its object."""
    by_object = cluster == "object"
    return [
        (True, t.object_id) if by_object and t.object_id is not None else (False, t.scene)
        for t in tried
    ]


def write_trials(
    evaluation: TrialEvaluation,
    folder: Path | str,
    sections: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Write ``trials.json`` and ``per_grasp.csv`` into a folder, which is made if needed.

    Args:
        evaluation: What the trials found.
        folder: Where to.
        sections: What ``trials.json`` says beside it, such as the detector.

    Returns:
        What ``trials.json`` holds.

    Raises:
        FileError: The folder cannot be written to or is a file, or the disk is full.
    """
    root = Path(folder)
    if root.exists() and not root.is_dir():
        raise FileError(root, "is a file, not a folder", "name another folder")
    write_text(root / PER_GRASP_FILE, as_csv(evaluation.rows()))
    summary = {**evaluation.to_dict(root / PER_GRASP_FILE), **(sections or {})}
    # Last, so that a summary on disk always has its rows beside it.
    write_text(root / SUMMARY_FILE, json.dumps(summary, indent=2) + "\n")
    (root / UNFINISHED_FILE).unlink(missing_ok=True)
    return summary
