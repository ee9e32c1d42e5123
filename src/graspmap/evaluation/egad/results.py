"""What the tries at a folder of meshes found, and their files."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from graspmap.evaluation.egad.attempt import EgadTry
from graspmap.evaluation.egad.grid import PUBLISHED, make_grid, trends
from graspmap.evaluation.egad.plan import EgadPlan
from graspmap.evaluation.results import SUMMARY_FILE, as_csv
from graspmap.files import write_text
from graspmap.metrics.intervals import bootstrap_means, wilson_interval
from graspmap.metrics.trial import HELD, TrialScore, score_trials

PER_TRY_FILE = "per_try.csv"


@dataclass(frozen=True, eq=False)
class EgadEvaluation:
    """A detector tried on a folder of meshes, each object many times.

    Attributes:
        meshes: The folder.
        plan: How they were tried.
        tries: Every try, by mesh and number; at least one.
        broken: Meshes that cannot be used, with the reason; they count nowhere.
        remarks: What was mended of the others, by mesh.
        skipped: Tries that could not be made, with the reason; they count nowhere.
        seconds: How long it took; of a run that was gone on with, its last part.
        confidence: Of the intervals.
    """

    meshes: str
    plan: EgadPlan
    tries: tuple[EgadTry, ...]
    broken: Mapping[str, str] = field(default_factory=dict)
    remarks: Mapping[str, Sequence[str]] = field(default_factory=dict)
    skipped: Mapping[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    confidence: float = 0.95

    @property
    def score(self) -> TrialScore:
        """Success of the best grasps; the interval draws whole objects."""
        return score_trials(
            [one.tried[0].outcome for one in self.tries],
            [one.mesh for one in self.tries],
            rng=self._rng(),
            groups=[one.mesh for one in self.tries],
            confidence=self.confidence,
        )

    def robust(self) -> tuple[float, list[float]] | None:
        """Share of all perturbed repeats that held and its interval; None where none were made."""
        if self.plan.perturbation is None:
            return None
        placed = [one.tried[0].placed for one in self.tries]
        shares = [p.result.success_probability or 0.0 if p else 0.0 for p in placed]
        return self._mean(shares, [one.mesh for one in self.tries])

    def to_dict(self, per_try: Path | str | None = None) -> dict[str, Any]:
        """The summary for JSON.

        Args:
            per_try: Where the rows were written, if they were.
        """
        score, robust = self.score, self.robust()
        objects = {
            name: self._object([one for one in self.tries if one.mesh == name])
            for name in score.per_object
        }
        summary: dict[str, Any] = {
            "meshes": self.meshes,
            "gripper": self.plan.gripper.name,
            "opening_m": self.plan.gripper.max_opening_m,
            "opening_px": self.plan.opening_px,
            "depth": self.plan.depth,
            "size_px": self.plan.size_px,
            "distance_m": list(self.plan.randomisation.camera.distance_m),
            "seed": self.plan.seed,
            "trials_per_object": self.plan.trials,
            "objects": len(objects),
            "trials": score.trials,
            "held": score.held,
            "success": score.success,
            "interval": list(score.interval),
            "confidence": score.confidence,
            "object_mean": score.object_mean,
            "outcomes": score.outcomes,
            "candidates": self._candidates(self.tries),
            "ceiling": self._ceiling(),
            "robust_success": None if robust is None else robust[0],
            "robust_interval": None if robust is None else robust[1],
            "per_object": objects,
            "grid": self._grid(),
            "trends": self._trends(objects),
            "published": [dict(entry) for entry in PUBLISHED],
            "broken": dict(self.broken),
            "remarks": {name: list(texts) for name, texts in self.remarks.items()},
            "skipped": dict(self.skipped),
            "seconds": self.seconds,
            "per_try": None if per_try is None else str(per_try),
        }
        if self.plan.top > 1:
            summary |= self._ranks()
        return summary

    def rows(self) -> list[dict[str, Any]]:
        """One flat row for each grasp, or try without one; all have the same keys."""
        rows = [
            {
                "mesh": one.mesh,
                "number": one.number,
                **tried.to_dict(),
                "candidates": one.candidates,
                "candidates_held": one.candidates_held,
            }
            for one in self.tries
            for tried in one.tried
        ]
        keys = dict.fromkeys(key for row in rows for key in row if key != "position_m")
        return [{key: row.get(key) for key in keys} for row in rows]

    def write(self, folder: Path | str, more: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Write ``evaluation.json`` and ``per_try.csv`` into a folder, which is made if needed.

        Args:
            folder: The folder.
            more: What else ``evaluation.json`` says, beside the section ``egad``.

        Returns:
            What ``evaluation.json`` holds.

        Raises:
            FileError: The folder cannot be written to, or the disk is full.
        """
        root = Path(folder)
        write_text(root / PER_TRY_FILE, as_csv(self.rows()))
        summary = {**(more or {}), "egad": self.to_dict(root / PER_TRY_FILE)}
        # Last, so that a summary on disk always has its rows beside it.
        write_text(root / SUMMARY_FILE, json.dumps(summary, indent=2) + "\n")
        return summary

    def _rng(self) -> np.random.Generator:
        return np.random.default_rng(self.plan.seed)

    def _mean(self, values: Sequence[float], groups: Sequence[str]) -> tuple[float, list[float]]:
        """Mean of values in [0, 1], and its interval by object."""
        column = np.array(values, dtype=np.float64)[:, None]
        ends = bootstrap_means(column, rng=self._rng(), groups=groups, confidence=self.confidence)
        return float(column.mean()), ends[0].tolist()

    def _object(self, tries: Sequence[EgadTry]) -> dict[str, Any]:
        """An object's tries; its own intervals are Wilson's."""
        outcomes = Counter(one.tried[0].outcome for one in tries)
        held = outcomes[HELD]
        return {
            **self._share(held, len(tries)),
            "outcomes": dict(outcomes.most_common()),
            "candidates": self._candidates(tries),
            "ceiling": (
                self._share(sum(one.candidates_held > 0 for one in tries), len(tries))
                if self.plan.candidates
                else None
            ),
        }

    def _share(self, held: int, trials: int) -> dict[str, Any]:
        return {
            "trials": trials,
            "held": held,
            "success": held / trials,
            "interval": list(wilson_interval(held, trials, self.confidence)),
        }

    def _candidates(self, tries: Sequence[EgadTry]) -> dict[str, Any] | None:
        """How many of the proposed grasps held."""
        if not self.plan.candidates:
            return None
        trials = sum(one.candidates for one in tries)
        held = sum(one.candidates_held for one in tries)
        return {"trials": trials, "held": held, "success": held / trials if trials else None}

    def _ceiling(self) -> dict[str, Any] | None:
        """In how many tries at least one of the proposed grasps held: what is possible."""
        if not self.plan.candidates:
            return None
        possible = [one.candidates_held > 0 for one in self.tries]
        return self._score(possible, [one.mesh for one in self.tries])

    def _grid(self) -> dict[str, Any] | None:
        held: dict[str, list[bool]] = {}
        possible: dict[str, list[bool]] = {}
        for one in self.tries:
            held.setdefault(one.mesh, []).append(one.tried[0].outcome == HELD)
            if self.plan.candidates:
                possible.setdefault(one.mesh, []).append(one.candidates_held > 0)
        return make_grid(held, possible, rng=self._rng(), confidence=self.confidence)

    def _trends(self, objects: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """How success, and the share of candidates that held, go with row and column."""
        success = {name: score["success"] for name, score in objects.items()}
        possible = {
            name: score["candidates"]["success"]
            for name, score in objects.items()
            if score["candidates"] is not None and score["candidates"]["trials"]
        }
        return {
            "success": trends(success, confidence=self.confidence),
            "candidates": trends(possible, confidence=self.confidence),
        }

    def _ranks(self) -> dict[str, Any]:
        """Success by rank, and of a robot that tries again."""
        longest = max(len(one.tried) for one in self.tries)
        by_rank = {
            rank: [(one.mesh, one.tried[rank]) for one in self.tries if len(one.tried) > rank]
            for rank in range(longest)
        }
        return {
            "per_rank": {
                str(rank): self._score([g.outcome == HELD for _, g in found], [m for m, _ in found])
                for rank, found in by_rank.items()
            },
            "one_of_first": {
                str(k): self._score(
                    [any(g.outcome == HELD for g in one.tried[:k]) for one in self.tries],
                    [one.mesh for one in self.tries],
                )
                for k in range(1, longest + 1)
            },
        }

    def _score(self, held: Sequence[bool], meshes: Sequence[str]) -> dict[str, Any]:
        """Tries of which some held, with the interval by object."""
        share, interval = self._mean(held, meshes)
        return {"trials": len(held), "held": sum(held), "success": share, "interval": interval}
