"""Several evaluations side by side: paired tests, and whether offline measures foretell trials.

Letters in shapes: S scenes, P pairs.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from graspmap.data import KINDS
from graspmap.errors import InvalidInputError
from graspmap.evaluation.run_folder import MeasuredScene, RunFolder, read_run_folder
from graspmap.metrics.correlation import Correlation, correlate
from graspmap.metrics.paired import PairedComparison, compare_paired
from graspmap.metrics.trial import HELD, TrialScore, score_trials

_LEAST_MODELS = 4  # a correlation over fewer says nothing
_SHOWN = ("protocol", "scenes", "success", "interval", "miou", "miou_interval", "auc")

Measure = Callable[[MeasuredScene], float | None]


@dataclass(frozen=True)
class Pair:
    """Two runs by one measure, on the scenes that both have.

    Attributes:
        a: Name of the first.
        b: Name of the second.
        measure: ``success`` (right at the lowest threshold), ``iou`` or ``held``.
        result: Difference a - b, interval, p value.
        p_adjusted: The p value among all pairs of this measure, by Holm's method: the more pairs
            one looks at, the more differ by chance.
    """

    a: str
    b: str
    measure: str
    result: PairedComparison
    p_adjusted: float

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        names = {"a": self.a, "b": self.b, "measure": self.measure}
        return {**names, **self.result.to_dict(), "p_adjusted": self.p_adjusted}


@dataclass(frozen=True, eq=False)
class Comparison:
    """Evaluations side by side.

    Attributes:
        runs: The evaluations by their name.
        pairs: Each two of them, by each measure that both have.
        correlations: Each offline measure with the success of trials, over the runs.
        confidence: Of the intervals.
        cluster: What the paired intervals and those of the trials take as independent.
        notes: What a reader should know before believing the numbers, a sentence each.
    """

    runs: Mapping[str, RunFolder]
    pairs: tuple[Pair, ...]
    correlations: Mapping[str, Correlation]
    confidence: float
    cluster: str
    notes: tuple[str, ...] = ()

    @property
    def threshold(self) -> str | None:
        """The lowest overlap that counts as right, by which pairs are compared; None without."""
        return _threshold(self.runs)

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "confidence": self.confidence,
            "cluster": self.cluster,
            "threshold": self.threshold,
            "notes": list(self.notes),
            "runs": {name: self._shown(run) for name, run in self.runs.items()},
            "pairs": [pair.to_dict() for pair in self.pairs],
            "correlations": {name: c.to_dict() for name, c in self.correlations.items()},
        }

    def _shown(self, run: RunFolder) -> dict[str, Any]:
        """What a comparison shows of a run; its trials are those of each scene's best grasp."""
        shown = {name: run.summary[name] for name in _SHOWN if name in run.summary}
        shown |= {name: run.summary[name] for name in ("detector", "curve") if name in run.summary}
        score = best_trials(run, by_object=self.cluster == "object", confidence=self.confidence)
        if score is not None:
            shown["trials"] = {
                "trials": score.trials,
                "held": score.held,
                "success": score.success,
                "interval": list(score.interval),
            }
        about = {"data": run.data, "cluster": run.cluster, "depth": _depth(run)}
        return {"folder": str(run.folder), **shown, **about}


def compare_runs(
    folders: Sequence[Path | str], *, seed: int = 0, confidence: float = 0.95
) -> Comparison:
    """Compare evaluations of one data set under one protocol.

    Args:
        folders: What ``--out`` of ``graspmap evaluate`` or ``graspmap trial`` made, two or more.
        seed: Of the intervals; each pair and measure draws from it anew, so that two reports give
            the same numbers whatever stands beside them.
        confidence: Of the intervals.

    Raises:
        InvalidInputError: Fewer than two folders, one of them twice, other data sets or protocols
            among them, trials that were made in another way, or no scene that all of them have.
        FileError: A folder holds no evaluation, or a damaged one.

    References:
        S. Holm, A simple sequentially rejective multiple test procedure, Scandinavian Journal of
        Statistics 6, 1979.
    """
    runs = _read(folders)
    _check_alike(runs)
    by_object = all(run.cluster == "object" for run in runs.values())
    pairs: list[Pair] = []
    for measure, get in _measures(runs).items():
        found = {
            (a, b): result
            for a, b in itertools.combinations(runs, 2)
            if (result := _compare(runs[a], runs[b], get, by_object, seed, confidence)) is not None
        }
        adjusted = holm([result.p_value for result in found.values()])
        pairs += [
            Pair(a, b, measure, result, p)
            for ((a, b), result), p in zip(found.items(), adjusted, strict=True)
        ]
    return Comparison(
        runs,
        tuple(pairs),
        _correlations(runs, confidence),
        confidence,
        "object" if by_object else "scene",
        _notes(runs),
    )


def best_trials(
    run: RunFolder, *, by_object: bool = False, confidence: float = 0.95, seed: int = 0
) -> TrialScore | None:
    """Trials of the best grasp of each scene, whatever else was tried; None without trials.

    Args:
        run: The run.
        by_object: Whether objects are what the interval takes as independent; else scenes.
        confidence: Of the interval.
        seed: Of the interval.
    """
    tried = {name: scene for name, scene in run.scenes.items() if scene.held is not None}
    if not tried:
        return None
    objects = [scene.object_id or name for name, scene in tried.items()]
    return score_trials(
        [HELD if scene.held else "failed" for scene in tried.values()],
        objects,
        rng=np.random.default_rng(seed),
        groups=objects if by_object else None,
        confidence=confidence,
    )


def holm(p_values: Sequence[float]) -> list[float]:
    """P values of several tests, so that any of them errs with the stated probability.

    Args:
        p_values: (P,) one for each test.

    Returns:
        (P,) adjusted, none below the one given.
    """
    adjusted, least = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(sorted(range(len(p_values)), key=lambda i: p_values[i])):
        least = max(least, min(1.0, (len(p_values) - rank) * p_values[i]))
        adjusted[i] = least
    return adjusted


def _read(folders: Sequence[Path | str]) -> dict[str, RunFolder]:
    """The runs by name: as much of the end of their path as tells them apart."""
    paths = [Path(folder).resolve() for folder in folders]
    if len(paths) < 2:
        raise InvalidInputError("folders to compare", len(paths), "two or more")
    twice = [path for path in paths if paths.count(path) > 1]
    if twice:
        raise InvalidInputError("folders to compare", f"{twice[0]} twice", "each of them once")
    length = 1
    while len({path.parts[-length:] for path in paths}) < len(paths):
        length += 1
    return {str(Path(*path.parts[-length:])): read_run_folder(path) for path in paths}


def _check_alike(runs: Mapping[str, RunFolder]) -> None:
    alike: tuple[tuple[str, Callable[[RunFolder], str | None]], ...] = (
        ("data set", _data),
        ("protocol", lambda run: run.protocol),
        *((f"{what} of the trials", get) for what, get in _TRIED_ALIKE.items()),
    )
    for what, get in alike:
        found = {name: get(run) for name, run in runs.items() if get(run) is not None}
        first = next(iter(found), "")
        for name, value in found.items():
            if value != found[first]:
                raise InvalidInputError(
                    f"{what} of {name}", value, f"{found[first]}, as of {first}: all must agree"
                )
    shared = set.intersection(*(set(run.scenes) for run in runs.values()))
    if not shared:
        counts = ", ".join(f"{len(run.scenes)} of {name}" for name, run in runs.items())
        raise InvalidInputError("shared scenes", f"none among {counts}", "one or more")


def _notes(runs: Mapping[str, RunFolder]) -> tuple[str, ...]:
    """What makes reports less alike, or more alike, than a comparison expects."""
    notes = []
    seen = {name: _depth(run) for name, run in runs.items()}
    depths = {name: depth for name, depth in seen.items() if depth is not None}
    if len(set(depths.values())) > 1:
        told = ", ".join(f"{name} {depth}" for name, depth in depths.items())
        notes.append(f"The detectors saw different depth: {told}. They differ in their input, too.")
    clusters = {name: run.cluster for name, run in runs.items() if run.protocol is not None}
    if len(set(clusters.values())) > 1:
        told = ", ".join(f"{name} {cluster}s" for name, cluster in clusters.items())
        notes.append(
            f"The intervals of the overlap take different things as independent: {told}. "
            "The pairs take scenes."
        )
    shared = set.intersection(*(set(run.scenes) for run in runs.values()))
    if any(len(run.scenes) > len(shared) for run in runs.values()):
        told = ", ".join(f"{len(run.scenes)} of {name}" for name, run in runs.items())
        notes.append(
            f"The reports are of different scenes: {told}; all have {len(shared)}. Figures of a "
            "run count all of its own, the pairs what both have."
        )
    for a, b in itertools.combinations(runs, 2):
        if runs[a].scenes == runs[b].scenes:
            notes.append(f"{a} and {b} have the same results in every scene: one detector twice?")
    return tuple(notes)


def _depth(run: RunFolder) -> str | None:
    """Which depth the detector saw; None where the report does not say."""
    if "depth" not in run.summary:
        return None
    kind = KINDS.get(run.data.partition(":")[0])
    told: str | None = run.summary["depth"]
    return told or (kind.depths[0] if kind is not None and kind.depths else None)


def _setting(name: str) -> Callable[[RunFolder], str | None]:
    """How a run's trials were made, in words; None where it has none or does not say."""

    def get(run: RunFolder) -> str | None:
        settings = (run.summary.get("trials") or {}).get("settings")
        if not isinstance(settings, Mapping) or name not in settings:
            return None
        return _in_words(settings[name])

    return get


def _in_words(setting: Any) -> str:
    if setting is None:
        return "none"
    if isinstance(setting, Mapping):
        return ", ".join(f"{name} {_in_words(value)}" for name, value in setting.items())
    if isinstance(setting, list | tuple):
        return " ".join(map(_in_words, setting))
    return f"{setting:g}" if isinstance(setting, float) else str(setting)


def _grippers(run: RunFolder) -> str | None:
    return ", ".join((run.summary.get("trials") or {}).get("grippers") or ()) or None


_TRIED_ALIKE: Mapping[str, Callable[[RunFolder], str | None]] = {
    "gripper": _grippers,
    "jaw": _setting("jaw"),
    "shake": _setting("shake"),
    "perturbation": _setting("perturbation"),
}
"""What trials must share: with another gripper or a shake they are other tests."""


def _data(run: RunFolder) -> str:
    """What was measured on; by its content where that is known, for data lie at many places."""
    known = run.summary.get("data_hash")
    if known:
        return str(known)
    kind, _, folder = run.data.partition(":")
    return f"{kind}:{Path(folder).expanduser().resolve()}"


def _measures(runs: Mapping[str, RunFolder]) -> dict[str, Measure]:
    """What scenes are compared by, of a scene: a number, or None where it has none."""
    measures: dict[str, Measure] = {}
    first = _threshold(runs)
    if first is not None:
        measures["success"] = lambda scene: scene.right.get(first)
        measures["iou"] = lambda scene: scene.iou
    measures["held"] = lambda scene: scene.held
    return measures


def _threshold(runs: Mapping[str, RunFolder]) -> str | None:
    """The lowest threshold of the first run; None where fewer than two have any."""
    thresholds = [run.summary["success"] for run in runs.values() if "success" in run.summary]
    return min(thresholds[0], key=float) if len(thresholds) > 1 else None


def _compare(
    a: RunFolder,
    b: RunFolder,
    get: Measure,
    by_object: bool,
    seed: int,
    confidence: float,
) -> PairedComparison | None:
    """Two runs on the scenes that both have; None where there are none."""
    first, second = [], []
    groups: list[Hashable] = []
    for name in sorted(a.scenes.keys() & b.scenes.keys()):  # whichever comes first
        scene = a.scenes[name]
        x, y = get(scene), get(b.scenes[name])
        if x is not None and y is not None:
            first.append(float(x))
            second.append(float(y))
            groups.append((True, scene.object_id) if scene.object_id else (False, name))
    if not first:
        return None
    result = compare_paired(
        first,
        second,
        groups=groups if by_object else None,
        rng=np.random.default_rng(seed),
        confidence=confidence,
    )
    # Overlaps that agree to the last bit are those of the same grasps: other scenes differ no more.
    same = first == second and not set(first) <= {0.0, 1.0}
    return replace(result, interval=(0.0, 0.0)) if same else result


def _correlations(runs: Mapping[str, RunFolder], confidence: float) -> dict[str, Correlation]:
    """Each offline measure with the share of best grasps that held, over runs that have both."""
    scores = {name: best_trials(run) for name, run in runs.items() if "success" in run.summary}
    held = [score.success for score in scores.values() if score is not None]
    both = [runs[name].summary for name, score in scores.items() if score is not None]
    if len(both) < _LEAST_MODELS:
        return {}
    measures = {
        f"success at IoU {t}": [summary["success"].get(t) for summary in both]
        for t in both[0]["success"]
    }
    measures["mean IoU"] = [summary["miou"] for summary in both]
    measures["AUC"] = [summary["auc"] for summary in both]
    return {
        name: correlate(values, held, confidence=confidence)
        for name, values in measures.items()
        if None not in values
    }
