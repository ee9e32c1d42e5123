"""Scenes worth looking at: the best, the worst, and some drawn at random."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graspmap.data.scene import Scene, Scenes
from graspmap.errors import InvalidInputError
from graspmap.evaluation.animations import film_of
from graspmap.evaluation.evaluate import GraspDetector, camera_options
from graspmap.evaluation.judge import Progress
from graspmap.evaluation.results import Evaluation, SceneResult
from graspmap.evaluation.trial_results import TrialEvaluation, TriedGrasp
from graspmap.geometry.affine import crop, resize
from graspmap.geometry.grasps import Grasps
from graspmap.maps.grasp_maps import GraspMaps
from graspmap.metrics.rectangle import count_right
from graspmap.metrics.trial import HELD
from graspmap.pictures.draw import Color, Picture, draw_grasps
from graspmap.pictures.fields import MAP_KINDS, depth_picture, map_picture

Why = Literal["best", "worst", "random"]

_LABEL: Color = (0, 150, 90)
_TRIED: Color = (255, 190, 0)
"""The grasp that was tried, where it is another than the one measured."""
_LABELS = 12
"""Labels drawn on a picture; hundreds would hide it."""
_SAME_PX = 0.01
_TRIED_DECODING = "refined"
"""How grasps that are tried are read from maps; see `predict_scenes`."""
_SIDE_PX = 360
_LEAST_PART = 0.3
"""Part of the picture's longer side that is shown at least around labels and detection."""
_CAPTIONS = {
    "quality": "quality: bright where a grasp is good",
    "angle": "angle of the opening; dark: low quality",
    "width": "width of the opening; bright: wide",
}


@dataclass(frozen=True, eq=False)
class Exhibit:
    """One scene of the gallery.

    Attributes:
        scene: Its id.
        why: Why it is shown, or how its trial ended, in a word.
        words: What became of it.
        numbers: What was measured on it, by name: overlap, quality, ...
        pictures: Pictures by their caption: labels and detection, maps, depth.
        film: Animated WebP of its trial; None where there was none.
    """

    scene: str
    why: str
    words: str
    numbers: Mapping[str, float | None] = field(default_factory=dict)
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    film: bytes | None = None

    def to_dict(self) -> dict[str, Any]:
        """For JSON, without the pictures."""
        return {"scene": self.scene, "why": self.why, "words": self.words, **self.numbers}


def make_gallery(
    evaluation: Evaluation,
    scenes: Scenes,
    *,
    detector: GraspDetector | None = None,
    trials: TrialEvaluation | None = None,
    trial_scenes: Scenes | None = None,
    each: int = 3,
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[Exhibit, ...]:
    """Show some scenes of an evaluation.

    Tried is the best grasp that the gripper can open for; where it is another than the one
    measured, the words say so and the pictures show it too.

    The best are those whose grasp held and overlaps a label most, the worst those that failed in
    the trial or overlap least, the surest first; of different objects where there are.

    Args:
        evaluation: What was measured.
        scenes: The scenes that it was measured on, with the depth that the detector sees.
        detector: The detector, for its maps; None for grasps out of a file.
        trials: Trials on the same scenes, if there were any.
        trial_scenes: The scenes with the depth that placed their grasps; None: ``scenes``.
        each: How many of each kind: best, worst, random.
        seed: Of the random ones.
        progress: Called after each scene.

    Raises:
        InvalidInputError: ``each`` is below 1.
        FileError: A file of a scene is missing or damaged.
    """
    tried = {} if trials is None else {t.scene: t for t in reversed(trials.tried) if t.rank == 0}
    chosen = choose_scenes(evaluation.results, tried, each=each, seed=seed)
    exhibits = []
    for number, (result, why) in enumerate(chosen, start=1):
        scene = scenes.read(scenes.index(result.id))
        trial = tried.get(result.id)
        another = trial is not None and _is_another(result.grasp, trial.grasp)
        film = None
        if trials is not None and trial is not None and trial.placed is not None:
            film = film_of(trials, trial_scenes or scenes, trial, trial.placed)
        exhibits.append(
            Exhibit(
                scene=result.id,
                why=why,
                words=_words(evaluation, result, trial, another=another),
                numbers=_numbers(result),
                pictures=_pictures(
                    evaluation, scene, result, detector, trial.grasp if trial and another else None
                ),
                film=film,
            )
        )
        if progress is not None:
            progress(number, len(chosen))
    return tuple(exhibits)


def choose_scenes(
    results: Sequence[SceneResult],
    tried: Mapping[str, TriedGrasp],
    *,
    each: int,
    seed: int = 0,
) -> list[tuple[SceneResult, Why]]:
    """The scenes to show, none of them twice.

    Args:
        results: Of all scenes.
        tried: The trial of a scene's best grasp, by scene, where there was one.
        each: How many of each kind.
        seed: Of the random ones.

    Raises:
        InvalidInputError: ``each`` is below 1.
    """
    if each < 1:
        raise InvalidInputError("scenes of each kind", each, "1 or more")

    def merit(result: SceneResult) -> tuple[bool, float]:
        trial = tried.get(result.id)
        return trial is None or trial.outcome == HELD, result.iou

    def quality(result: SceneResult) -> float:
        return float(result.grasp.quality[0]) if len(result.grasp) else 0.0

    surest = sorted(results, key=quality, reverse=True)
    best = _distinct(sorted(surest, key=merit, reverse=True), each)
    taken = {result.id for result in best}
    rest = [result for result in sorted(surest, key=merit) if result.id not in taken]
    # Of a handful of scenes, those that are left are no failures only for being last.
    worst = _distinct(rest, min(each, -(-len(rest) // 2)))
    taken |= {result.id for result in worst}
    others = [result for result in results if result.id not in taken]
    drawn = np.random.default_rng(seed).permutation(len(others))[:each]
    chosen: list[tuple[SceneResult, Why]] = [(result, "best") for result in best]
    chosen += [(result, "worst") for result in worst]
    return chosen + [(others[i], "random") for i in drawn]


def _distinct(order: Iterable[SceneResult], count: int) -> list[SceneResult]:
    """The first of each object, then others, in the order given."""
    order = list(order)
    firsts = {result.object_id or result.id: result for result in reversed(order)}
    first = [result for result in order if firsts[result.object_id or result.id] is result]
    return list({result.id: result for result in [*first, *order]}.values())[:count]


def _is_another(measured: Grasps, tried: Grasps) -> bool:
    """Whether the grasp that was tried lies or is turned another way than the one measured."""
    if not len(measured) or not len(tried):
        return len(measured) != len(tried)
    # Turned by half a turn a grasp is the same. The jaw's size is custom, so it says nothing; nor
    # does the opening, which is tried with clearance.
    one, other = measured.corners()[0], tried.replace(width=measured.width).corners()[0]
    ends = [(one[[0, 1]] + one[[3, 2]]) / 2, (other[[0, 1]] + other[[3, 2]]) / 2]
    same = [np.abs(ends[0] - way).max() for way in (ends[1], ends[1][::-1])]
    return bool(min(same) > _SAME_PX)


def _words(
    evaluation: Evaluation, result: SceneResult, trial: TriedGrasp | None, *, another: bool
) -> str:
    threshold = next(iter(evaluation.score.success))
    (right,) = count_right(np.array([result.iou]), (threshold,), rule=evaluation.protocol.rule)[0]
    if not len(result.grasp):
        words = "No grasp was predicted."
    elif right:
        words = f"Right at IoU {threshold:.2f}."
    else:
        words = f"Wrong at IoU {threshold:.2f}."
    if trial is None or not len(result.grasp):
        return words
    if not another:
        if trial.outcome == HELD:
            return f"{words} It held in the trial."
        return f"{words} The trial failed, {trial.outcome}: {trial.reason}."
    # Read in the same way, only those that the gripper cannot open for are left out.
    why = (
        "The gripper cannot open that wide"
        if evaluation.protocol.decoding == _TRIED_DECODING
        else "Another grasp was tried than this protocol reads"
    )
    if not len(trial.grasp):
        return f"{words} {why}, and there is no other grasp to try."
    ended = "it held" if trial.outcome == HELD else f"{trial.outcome}, {trial.reason}"
    next_one = "its next grasp was tried: " if why.endswith("wide") else ""
    return f"{words} {why}; {next_one}{ended}."


def _numbers(result: SceneResult) -> dict[str, float | None]:
    quality = float(result.grasp.quality[0]) if len(result.grasp) else None
    return {"overlap": result.iou, "quality": quality}


def _pictures(
    evaluation: Evaluation,
    scene: Scene,
    result: SceneResult,
    detector: GraspDetector | None,
    tried: Grasps | None = None,
) -> dict[str, Picture]:
    """Labels and detection, depth, and the maps where the detector has some.

    ``tried`` is the grasp that was tried, where it is another.
    """
    depth = None if scene.depth is None else depth_picture(scene.depth)
    view = scene.rgb if scene.rgb is not None else depth
    assert view is not None  # Scene sees to it
    tried = Grasps.empty() if tried is None else tried
    window = window_around(scene.shape, [result.grasp, tried, scene.grasps or Grasps.empty()])
    pictures = {"labels and detection": _close_up(view, window, scene.grasps, result.grasp, tried)}
    if depth is not None:
        pictures["depth: near bright"] = _close_up(depth, window, None, result.grasp, tried)
    if detector is None:
        return pictures
    method = evaluation.protocol.decoding
    found = detector.detect(
        scene.rgb, scene.depth, top=1, method=method, **camera_options(detector, scene)
    )
    maps: GraspMaps[NDArray[Any]] | None = getattr(found, "maps", None)
    matrix = getattr(found, "matrix", None)
    if maps is None or matrix is None:  # a detector that is none of ours
        return pictures
    inside = result.grasp.transformed(matrix)
    for kind in MAP_KINDS:
        shown = inside if kind == "quality" else Grasps.empty()
        picture = map_picture(maps, kind)
        pictures[_CAPTIONS[kind]] = draw_grasps(picture, shown, scale=_fitting(picture))
    return pictures


def window_around(shape: tuple[int, int], grasps: Sequence[Grasps]) -> tuple[int, int, int]:
    """First column, first row and side of a square around some grasps, inside the picture."""
    corners = np.concatenate([some.corners().reshape(-1, 2) for some in grasps])
    rows, columns = shape
    side, middle = max(shape), np.array([columns, rows]) / 2
    if len(corners):
        low, high = corners.min(axis=0), corners.max(axis=0)
        side = int(np.clip(1.4 * (high - low).max(), _LEAST_PART * side, side))
        middle = (low + high) / 2
    x, y = (
        int(np.clip(m - side / 2, 0, max(0, size - side)))
        for m, size in zip(middle, (columns, rows), strict=True)
    )
    return x, y, side


def _close_up(
    view: Picture,
    window: tuple[int, int, int],
    labels: Grasps | None,
    grasp: Grasps,
    tried: Grasps,
) -> Picture:
    """A window of a picture with some labels, the grasp measured, and another that was tried."""
    x, y, side = window
    part = np.ascontiguousarray(view[y : y + side, x : x + side])
    scale = _fitting(part)
    matrix = resize(scale) @ crop(x, y)
    picture = draw_grasps(part, Grasps.empty(), scale=scale)
    if labels is not None and len(labels):
        some = np.unique(np.linspace(0, len(labels) - 1, _LABELS).round().astype(int))
        shown = labels[some].transformed(matrix)
        picture = draw_grasps(picture, shown, jaw=_LABEL, opening=_LABEL)
    picture = draw_grasps(picture, grasp.transformed(matrix))
    return draw_grasps(picture, tried.transformed(matrix), jaw=_TRIED, opening=_TRIED)


def _fitting(view: Picture) -> float:
    """Scale at which the longer side is `_SIDE_PX`."""
    longer: int = max(view.shape[:2])
    return _SIDE_PX / longer
