"""Where the grasps come from that are tried: a detector, a predictions file, or the labels."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from graspmap.data.scene import Scenes
from graspmap.errors import GraspmapError, InvalidInputError
from graspmap.evaluation.evaluate import (
    GraspDetector,
    check_ids,
    detect_in,
    to_picture_frame,
)
from graspmap.evaluation.judge import Progress
from graspmap.evaluation.tabletops import scene_gripper
from graspmap.evaluation.trial_plan import recorded_or_default
from graspmap.geometry.grasps import Grasps
from graspmap.gripper import Gripper


@dataclass(frozen=True, eq=False)
class GraspsToTry:
    """Grasps of a data set that wait for their trial.

    Attributes:
        grasps: By scene, best first, in pixels of each picture.
        skipped: Scenes that nothing can be said about, with the reason.
        unknown: Scenes that were predicted and that the data set lacks.
    """

    grasps: Mapping[str, Grasps]
    skipped: Mapping[str, str] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()


def predict_scenes(
    detector: GraspDetector,
    scenes: Scenes,
    *,
    top: int = 1,
    gripper: Gripper | None = None,
    progress: Progress | None = None,
) -> GraspsToTry:
    """The best grasps of a detector in every scene.

    `graspmap.Detector` leaves out grasps that the gripper cannot open for, as on a robot.

    Args:
        detector: Sees colour and depth, never the mask or the labels.
        scenes: With the depth that the detector should see.
        top: How many a scene.
        gripper: The gripper; None: as in the trials, that of each scene's record, or Jacquard's.
        progress: Called after each scene.

    Returns:
        The grasps; scenes that lack what the detector needs, or are damaged, are skipped.
    """
    found, skipped = {}, {}
    for index, name in enumerate(scenes.ids):
        try:
            own = gripper or recorded_or_default(scene_gripper(scenes, index))
            found[name] = detect_in(detector, scenes, index, top=top, method="refined", gripper=own)
        except GraspmapError as error:
            skipped[name] = str(error)
        if progress is not None:
            progress(index + 1, len(scenes))
    return GraspsToTry(found, skipped)


def file_predictions(
    predictions: Mapping[str, Grasps], scenes: Scenes, known_ids: Collection[str] = ()
) -> GraspsToTry:
    """Grasps of a predictions file.

    Args:
        predictions: As `graspmap.data.read_predictions` gives them.
        scenes: The data set, or a part of it.
        known_ids: Scenes that may be predicted beside those; they are left out.

    Raises:
        InvalidInputError: Not one prediction is for a scene of the data set.
    """
    known = {*scenes.ids, *known_ids}
    unknown = tuple(name for name in predictions if name not in known)
    if len(unknown) == len(predictions):
        check_ids(predictions, scenes, known_ids)
    found, skipped = {}, {}
    for index, name in enumerate(scenes.ids):
        if name in predictions:
            try:
                found[name] = to_picture_frame(predictions[name], scenes, index)
            except GraspmapError as error:
                skipped[name] = str(error)
    return GraspsToTry(found, skipped, unknown)


def labelled_grasps(scenes: Scenes, *, top: int | None = None, seed: int = 0) -> GraspsToTry:
    """The labels themselves, as if they were predicted: what share of them holds?

    Args:
        scenes: The data set, or a part of it; scenes without a label are skipped.
        top: How many of a scene's, drawn at random (labels have no order); None: all.
        seed: Those of scene i are drawn from (seed, i).

    Raises:
        InvalidInputError: No scene has labels.
    """
    found, skipped = {}, {}
    for index, name in enumerate(scenes.ids):
        try:
            grasps = scenes.read_grasps(index)
        except GraspmapError as error:
            skipped[name] = str(error)
            continue
        if grasps is None or not len(grasps):
            skipped[name] = "it has no labelled grasp"
            continue
        if top is not None and top < len(grasps):
            rng = np.random.default_rng((seed, index))
            grasps = grasps[np.sort(rng.choice(len(grasps), top, replace=False))]
        found[name] = grasps
    if not found:
        reason = next(iter(skipped.values()), "there are no scenes")
        raise InvalidInputError(
            f"labels of {scenes.kind}:{scenes.root}",
            f"none in {len(scenes)} scenes ({reason})",
            "scenes with labelled grasps",
        )
    return GraspsToTry(found, skipped)
