"""How well a network does the tasks beside grasping that it has heads for, over whole scenes.

Letters in shapes: S side of the network's input.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from graspmap.data.images import TABLE_UNIT_M, DepthZero, warp, warp_depth
from graspmap.data.scene import Scene, Scenes
from graspmap.data.table import find_table
from graspmap.inference.detector import Detector, Prepared
from graspmap.metrics.confusion import ClassScore, score_classes
from graspmap.metrics.depth_error import DepthErrors, DepthScore, depth_errors, score_depth
from graspmap.metrics.saliency import (
    SaliencyMarks,
    SaliencyScore,
    saliency_marks,
    score_saliency,
)
from graspmap.networks import AUXILIARY_TASKS

Found = TypeVar("Found")


@dataclass(frozen=True)
class TaskEvaluation:
    """Scores of the tasks; None where the network has no such head or no scene has the truth.

    Attributes:
        saliency: Of the object's pixels, against the mask.
        depth: Of the depth, against the measured pixels, metres. Networks say depth relative to
            the picture's mean; that mean is taken from the truth.
        category: Of the class of the object.
    """

    saliency: SaliencyScore | None = None
    depth: DepthScore | None = None
    category: ClassScore | None = None

    def to_dict(self) -> dict[str, Any]:
        """For JSON: the scores that there are, by task."""
        scores = {name: getattr(self, name) for name in AUXILIARY_TASKS}
        return {name: score.to_dict() for name, score in scores.items() if score is not None}


@dataclass(frozen=True)
class _Looked:
    """What one scene gave.

    Attributes:
        group: What it hangs together with in the intervals.
        saliency: Marks, where there is a head and a mask.
        depth: Errors, where there is a head and a measured pixel.
        category: Number of the class that was said, where there is a head.
        labels: Names of the object's class, by kind.
    """

    group: Hashable
    saliency: SaliencyMarks | None
    depth: DepthErrors | None
    category: int | None
    labels: Mapping[str, str]


def evaluate_tasks(
    detector: Detector,
    scenes: Scenes,
    *,
    confidence: float = 0.95,
    cluster: Literal["scene", "object"] = "scene",
    seed: int = 0,
    progress: Callable[[int, int], object] | None = None,
) -> TaskEvaluation:
    """Let a network do its auxiliary tasks on every scene that has the truth.

    Pictures are compared as the network sees them, over the pixels that show the picture (for
    depth: a measured part of it); each counts once, however many pixels it knows.

    Args:
        detector: Sees colour and depth of the scene.
        scenes: The data set, or a part of it.
        confidence: Confidence of the intervals.
        cluster: What the intervals take as independent: ``scene`` or ``object``.
        seed: Seed of the bootstrap.
        progress: Called after each scene with the scenes done and the scenes in all.

    Raises:
        InvalidInputError: A scene lacks what the network sees.
        FileError: A file of a scene is missing or damaged.
    """
    names = {task.name for task in detector.network.tasks} & set(AUXILIARY_TASKS)
    if not names:
        return TaskEvaluation()
    looked = []
    for index in range(len(scenes)):
        scene, object_id = scenes.read(index), scenes.object_id(index)
        # A scene whose object is unknown is one of its own.
        alone = cluster == "scene" or object_id is None
        looked.append(_look(detector, scene, names, (alone, scene.id if alone else object_id)))
        if progress is not None:
            progress(index + 1, len(scenes))
    rng = np.random.default_rng(seed)
    marks, mark_groups = _known([one.saliency for one in looked], looked)
    errors, error_groups = _known([one.depth for one in looked], looked)
    options: dict[str, Any] = {"rng": rng, "confidence": confidence}
    return TaskEvaluation(
        score_saliency(marks, groups=mark_groups, **options) if marks else None,
        score_depth(errors, groups=error_groups, **options) if errors else None,
        _categories(looked, detector, options) if "category" in names else None,
    )


def _look(detector: Detector, scene: Scene, names: set[str], group: Hashable) -> _Looked:
    prepared = detector.prepare(scene.rgb, scene.depth, camera=scene.camera)
    with torch.inference_mode():
        inputs = torch.from_numpy(prepared.inputs[None]).to(detector.device)
        said = detector.network.outputs(inputs).tasks
    return _Looked(
        group,
        _saliency(said["saliency"], scene, prepared) if "saliency" in names else None,
        _depth(said["depth"], prepared, detector.card.depth_zero) if "depth" in names else None,
        int(said["category"][0].argmax()) if "category" in names else None,
        scene.labels,
    )


def _saliency(logits: Tensor, scene: Scene, prepared: Prepared) -> SaliencyMarks | None:
    if scene.mask is None:
        return None
    mask = warp(scene.mask, prepared.matrix, prepared.allowed.shape, fill=False)
    return saliency_marks(_picture(logits.float().sigmoid()), mask, prepared.allowed)


def _depth(said: Tensor, prepared: Prepared, depth_zero: DepthZero) -> DepthErrors | None:
    depth_m = prepared.depth_m
    if depth_m is None:
        return None
    shape = prepared.allowed.shape
    true_m = warp_depth(depth_m.astype(np.float32, copy=False), prepared.matrix, shape)
    measured = warp(np.isfinite(depth_m), prepared.matrix, shape, fill=False)
    found = _picture(said)
    if depth_zero == "table":
        table_m = find_table(depth_m).depth_m(depth_m.shape)
        said_m = warp_depth(table_m, prepared.matrix, shape) + TABLE_UNIT_M * found
    else:
        said_m = found + float(true_m.mean(dtype=np.float64))
    return depth_errors(said_m, true_m, prepared.allowed & measured)


def _picture(said: Tensor) -> NDArray[np.float64]:
    """(S, S) picture of the one channel."""
    return said[0, 0].double().cpu().numpy()


def _known(
    values: Sequence[Found | None], looked: Sequence[_Looked]
) -> tuple[list[Found], list[Hashable]]:
    """What is known, and its groups."""
    pairs = [(v, one.group) for v, one in zip(values, looked, strict=True) if v is not None]
    return [value for value, _ in pairs], [group for _, group in pairs]


def _categories(
    looked: Sequence[_Looked], detector: Detector, options: Mapping[str, Any]
) -> ClassScore | None:
    """Score of the scenes whose class is one of the network's."""
    card = detector.card
    classes = () if card.data is None else card.data.classes
    # The card lists the names; of which kind they are shows in the scenes.
    kinds = Counter(kind for one in looked for kind, v in one.labels.items() if v in classes)
    if not kinds:
        return None
    kind = kinds.most_common(1)[0][0]
    scored = [one for one in looked if one.labels.get(kind) in classes]
    return score_classes(
        np.array([one.category for one in scored], dtype=np.int64),
        [classes.index(one.labels[kind]) for one in scored],
        classes,
        groups=[one.group for one in scored],
        **options,
    )
