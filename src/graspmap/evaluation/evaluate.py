"""Detectors and prediction files against the labels of a data set.

The best grasp of a scene is judged; the next ones only say in how many scenes one of the first k
is right. A scene without a prediction is a failure; a scene without a labelled rectangle is
skipped, because the metric has nothing to say about it.
"""

from __future__ import annotations

import difflib
import logging
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from inspect import signature
from typing import Any, Protocol

import numpy as np

from graspmap.data.jacquard import JACQUARD_SIDE_PX
from graspmap.data.png import png_shape
from graspmap.data.scene import Depth, Rgb, Scene, Scenes
from graspmap.errors import InvalidInputError
from graspmap.evaluation.judge import Cluster, Jaw, Judge, Progress
from graspmap.evaluation.results import Evaluation
from graspmap.evaluation.views import Seen, look
from graspmap.geometry.affine import resize
from graspmap.geometry.grasps import Grasps
from graspmap.gripper import Gripper
from graspmap.metrics.protocols import Decoding, RectangleProtocol
from graspmap.metrics.rectangle import THRESHOLDS

_LOG = logging.getLogger(__name__)
_TOLD = 5
"""Unknown scenes that are named."""


class Found(Protocol):
    """What a detector gives back: at least its grasps."""

    @property
    def grasps(self) -> Grasps:
        """Grasps in pixels of the whole picture, best first."""


class GraspDetector(Protocol):
    """What can be evaluated: `graspmap.Detector`, or anything with such a method."""

    def detect(self, rgb: Rgb | None, depth: Depth | None, *, top: int, method: Decoding) -> Found:
        """The ``top`` best grasps of one picture.

        Args:
            rgb: (H, W, 3) uint8, red first, or None.
            depth: (H, W) float32 metres, NaN where there is none, or None.
            top: How many grasps at most.
            method: How to read grasps from maps; detectors without maps may ignore it.
        """


def evaluate_detector(
    detector: GraspDetector,
    scenes: Scenes,
    *,
    protocol: str | RectangleProtocol = "strict",
    also: Sequence[str | RectangleProtocol] = (),
    top: int = 1,
    thresholds: Sequence[float] = THRESHOLDS,
    confidence: float = 0.95,
    cluster: Cluster = "scene",
    jaw: Jaw = "half",
    seed: int = 0,
    progress: Progress | None = None,
) -> Evaluation:
    """Let a detector look at every labelled scene and judge its best grasps.

    Args:
        detector: Sees colour and depth of the scene, never its mask or labels.
        scenes: The data set, or a part of it.
        protocol: Name of a protocol, see `graspmap.metrics.PROTOCOLS`.
        also: Further protocols (or quirks) to judge by beside it; the detector looks at a scene
            once for each way to see it and to read its maps.
        top: How many grasps of a scene are judged.
        thresholds: Overlaps at which success is reported.
        confidence: Confidence of the intervals.
        cluster: What the intervals take as independent; ``object`` for claims about new objects.
        jaw: ``half``: the predicted grasp's height is half its width, the field's custom;
            ``given``: the height that the detector says.
        seed: Seed of the bootstrap.
        progress: Called after each scene.

    Raises:
        InvalidInputError: No scene has a label, a scene lacks what the detector needs (the error
            names it), or an option is not allowed.
        FileError: A file of a scene is missing or damaged.
    """
    judge = Judge(protocol, also, thresholds, confidence, cluster, jaw, seed, top)

    def grasps_of(index: int, scene: Scene | None) -> Callable[[RectangleProtocol], Grasps]:
        assert scene is not None  # it was asked for
        known: dict[tuple[str, str], Grasps] = {}

        def grasps(by: RectangleProtocol) -> Grasps:
            if (by.view, by.decoding) not in known:
                found = _detect(detector, scene, scenes, index, by, top, seed)
                known[by.view, by.decoding] = found
            return known[by.view, by.decoding]

        return grasps

    return judge.evaluate(scenes, grasps_of, progress, pictures=True)


def evaluate_predictions(
    predictions: Mapping[str, Grasps],
    scenes: Scenes,
    *,
    known_ids: Collection[str] | None = None,
    protocol: str | RectangleProtocol = "strict",
    also: Sequence[str | RectangleProtocol] = (),
    top: int = 1,
    thresholds: Sequence[float] = THRESHOLDS,
    confidence: float = 0.95,
    cluster: Cluster = "scene",
    jaw: Jaw = "given",
    seed: int = 0,
    progress: Progress | None = None,
) -> Evaluation:
    """Judge grasps that somebody predicted.

    Args:
        predictions: Grasps by scene id, best first, as `graspmap.data.read_predictions` gives
            them: for Jacquard in its 1024 px frame whatever the size of the pictures, for other
            data sets in pixels of the picture.
        scenes: The data set, or a part of it.
        known_ids: Scenes that may be predicted beside those of ``scenes``: the ids of the whole
            data set where a part of it is judged. Their predictions are left out.
        protocol: Its way to count; how the grasps were decoded is no longer known.
        also: Further protocols to count by.
        top: How many grasps of a scene are judged, the first ones of the file.
        thresholds: Overlaps at which success is reported.
        confidence: Confidence of the intervals.
        cluster: What the intervals take as independent.
        jaw: ``given``: the height that the file says; ``half``: half its width.
        seed: Seed of the bootstrap.
        progress: Called after each scene.

    Raises:
        InvalidInputError: A prediction is for a scene that is not there (the error says which
            names are near), no scene has a label, or an option is not allowed.
        FileError: A file of a scene is missing or damaged.
    """
    check_ids(predictions, scenes, known_ids or ())
    outside = [name for name in scenes.ids if _outside(predictions.get(name), scenes)]
    if outside:
        _LOG.warning(
            "%d predicted grasps lie outside the picture (first in %s): are they in pixels of the "
            "picture enlarged to %d px?", len(outside), outside[0], JACQUARD_SIDE_PX,
        )  # fmt: skip
    unjudged = sum(len(predictions.get(name, ())) > top for name in scenes.ids)
    if unjudged:
        _LOG.warning("%d scenes have more than %d grasps; the others are not judged", unjudged, top)
    judge = Judge(protocol, also, thresholds, confidence, cluster, jaw, seed, top)

    def grasps_of(index: int, _scene: Scene | None) -> Callable[[RectangleProtocol], Grasps]:
        grasps = predictions.get(scenes.ids[index], Grasps.empty())[:top]
        grasps = to_picture_frame(grasps, scenes, index) if len(grasps) else grasps
        return lambda _by: grasps

    return judge.evaluate(scenes, grasps_of, progress)


def _outside(grasps: Grasps | None, scenes: Scenes) -> bool:
    """Whether the first grasp of a file in Jacquard's frame lies outside every picture."""
    if grasps is None or not len(grasps) or scenes.kind != "jacquard":
        return False
    x, y = grasps.center[0]
    return not (-0.5 <= x <= JACQUARD_SIDE_PX - 0.5 and -0.5 <= y <= JACQUARD_SIDE_PX - 0.5)


def detect_in(
    detector: GraspDetector,
    scenes: Scenes,
    index: int,
    *,
    top: int,
    method: Decoding,
    gripper: Gripper | None = None,
) -> Grasps:
    """What a detector finds in scene ``index``, pixels of its picture, best first.

    Args:
        detector: The detector.
        scenes: The data set.
        index: Number of the scene.
        top: How many grasps at most.
        method: How to read grasps from maps.
        gripper: Detectors whose ``detect`` takes ``camera`` and ``gripper``, as that of
            `graspmap.Detector`, leave out what it cannot open for, where the scene has both depth
            and a camera.

    Raises:
        InvalidInputError: The scene lacks what the detector needs; the error names it.
        FileError: A file of the scene is missing or damaged.
    """
    scene = scenes.read(index)
    options: dict[str, Any] = {"top": top, "method": method}
    options |= camera_options(detector, scene, gripper)
    with _scene_named(scene.id, scenes):
        return detector.detect(scene.rgb, scene.depth, **options).grasps


def _detect(
    detector: GraspDetector,
    scene: Scene,
    scenes: Scenes,
    index: int,
    protocol: RectangleProtocol,
    top: int,
    seed: int,
) -> Grasps:
    """What a detector finds in a scene under a protocol, pixels of the whole picture."""
    seen = look(scene, protocol.view, np.random.default_rng((seed, index)))
    options = {"top": top, "method": protocol.decoding, **camera_options(detector, seen)}
    with _scene_named(scene.id, scenes):
        found = detector.detect(seen.rgb, seen.depth, **options)
    # Whole pictures stay as they are, to the last bit.
    return found.grasps if protocol.view == "whole" else found.grasps.transformed(seen.matrix)


def camera_options(
    detector: GraspDetector, seen: Scene | Seen, gripper: Gripper | None = None
) -> dict[str, Any]:
    """What tells a detector the scale of a picture, where it asks for it and both are known."""
    known = signature(detector.detect).parameters
    if seen.camera is None or seen.depth is None or "camera" not in known:
        return {}
    options: dict[str, Any] = {"camera": seen.camera}
    return options | ({"gripper": gripper} if gripper is not None and "gripper" in known else {})


@contextmanager
def _scene_named(name: str, scenes: Scenes) -> Iterator[None]:
    """Errors of a detector name the scene that it looked at."""
    try:
        yield
    except InvalidInputError as error:
        where = f"scene {name} of {scenes.kind}:{scenes.root}: {error.name}"
        raise InvalidInputError(where, error.found, error.allowed) from error


def to_picture_frame(grasps: Grasps, scenes: Scenes, index: int) -> Grasps:
    """Grasps of a predictions file in pixels of the picture of scene ``index``."""
    return grasps.transformed(resize(_file_frame_side(scenes, index) / JACQUARD_SIDE_PX))


def to_predictions(evaluation: Evaluation, scenes: Scenes) -> dict[str, Grasps]:
    """The judged grasps as a predictions file holds them: what `evaluate_predictions` takes.

    Args:
        evaluation: Of a detector.
        scenes: The scenes that it was measured on.

    Returns:
        Grasps by scene id; write them with ``write_predictions(..., size_px=1024)``.
    """
    return in_file_frame({result.id: result.grasp for result in evaluation.results}, scenes)


def in_file_frame(grasps: Mapping[str, Grasps], scenes: Scenes) -> dict[str, Grasps]:
    """Grasps in pixels of each picture as a predictions file holds them; see `to_predictions`.

    Args:
        grasps: By scene id.
        scenes: The scenes that they belong to.
    """
    positions = {name: index for index, name in enumerate(scenes.ids)}
    predictions = {}
    for name, found in grasps.items():
        side = _file_frame_side(scenes, positions[name])
        moved = found.transformed(resize(JACQUARD_SIDE_PX / side))
        # The format has two decimals: a closed gripper can't be written, and it hits nothing.
        moved = moved[np.flatnonzero(moved.width >= 0.01)]
        if len(moved):
            predictions[name] = moved
    return predictions


def check_ids(
    predictions: Mapping[str, Grasps], scenes: Scenes, known_ids: Collection[str]
) -> None:
    """Refuse predictions for scenes that do not exist: they hide a spelling or a wrong folder.

    Args:
        predictions: Grasps by scene id.
        scenes: The scenes that are judged.
        known_ids: Further ids that are allowed.

    Raises:
        InvalidInputError: An id is unknown; the error says which names are near.
    """
    known = {*scenes.ids, *known_ids}
    unknown = [name for name in predictions if name not in known]
    if not unknown:
        return
    names, told = sorted(known), []
    for name in unknown[:_TOLD]:
        near = difflib.get_close_matches(name, names, n=1)
        told.append(repr(name) + (f" (nearest: {near[0]})" if near else ""))
    more = ", ..." if len(unknown) > _TOLD else ""
    raise InvalidInputError(
        "predicted scenes",
        f"{len(unknown)} of {len(predictions)} not in {scenes.kind}:{scenes.root}: "
        + ", ".join(told)
        + more,
        f"ids of its {len(known)} scenes",
    )


def _file_frame_side(scenes: Scenes, index: int) -> int:
    """Side of a scene's picture whose pixels 1024 of a predictions file's frame stand for.

    Jacquard's files always speak of 1024 px pictures; those of other kinds of the picture itself.
    """
    if scenes.kind != "jacquard":
        return JACQUARD_SIDE_PX
    rows, columns = _picture_shape(scenes, index)
    if rows != columns:
        raise InvalidInputError(
            f"picture size of scene {scenes.ids[index]}", f"{columns} x {rows}", "a square"
        )
    return rows


def _picture_shape(scenes: Scenes, index: int) -> tuple[int, int]:
    """(rows, columns) of a scene, from the first bytes of a PNG where it has one.

    Decoding every picture only to learn its size would take most of the time of an evaluation.
    """
    for path in scenes.files(index):
        if path.suffix.lower() == ".png" and path.is_file():
            shape = png_shape(path)
            if shape is not None:
                return shape
    return scenes.read(index).shape
