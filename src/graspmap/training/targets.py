"""The truth of the tasks beside grasping: mask, depth and class, moved with the picture.

Letters in shapes: B pictures, S side of the input.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.data import Scene, Store, to_input, warp
from graspmap.data.images import DepthZero
from graspmap.data.table import Table
from graspmap.errors import InvalidInputError
from graspmap.losses import UNKNOWN, Targets
from graspmap.maps import GraspMaps


def task_targets(
    tasks: Sequence[str],
    store: Store,
    index: int,
    matrix: NDArray[np.float64],
    *,
    scene: Scene | None = None,
    seen: NDArray[np.float32] | None = None,
    label: str | None = None,
    classes: Sequence[str] = (),
    depth_zero: DepthZero = "mean",
    table: Table | None = None,
) -> dict[str, NDArray[Any]]:
    """The truth of a scene on some tasks; one matrix moves it as it moves picture and grasps.

    Beside the picture, where the input repeats its border, nothing is known of mask and depth, and
    neither of depth where it was not measured.

    Args:
        tasks: Names; those that are drawn from the grasps (graspness, orientation) need nothing.
        store: The packed scenes.
        index: Number of the scene.
        matrix: (3, 3) map of the input frame onto itself.
        scene: That scene, where it was read already.
        seen: (1, S, S) the moved depth as the network sees it, where it does.
        label: Which of the scene's labels is its class.
        classes: All classes.
        depth_zero: What depth is measured from, where the network does not see it.
        table: The table behind the picture, where it was found already.

    Returns:
        Of ``saliency``: ``mask`` and ``inside``, of ``depth``: ``depth`` (as the depth input of a
        network is, float32) and ``depth_known``, each (1, S, S), bool where not said otherwise; of
        ``category``: ``class`` (), int64.

    Raises:
        InvalidInputError: The scene lacks the picture.
    """
    found: dict[str, NDArray[Any]] = {}
    scene, size = store.read(index) if scene is None else scene, store.size
    if "category" in tasks:
        name = scene.labels.get(label or "")
        found["class"] = np.array(classes.index(name) if name in classes else UNKNOWN)
    if not {"saliency", "depth"} & set(tasks):
        return found
    shown = np.ones(store.shape(index), np.bool_)
    inside = warp(shown, matrix @ store.matrix(index), size, fill=False)
    if "saliency" in tasks:
        mask = warp(_need(scene, "mask"), matrix, size, fill=False)
        found |= {"mask": mask[None], "inside": inside[None]}
    if "depth" in tasks:
        measured = store.measured(index)
        known = inside if measured is None else inside & warp(measured, matrix, size, fill=False)
        if seen is None:
            seen = to_input(
                None,
                _need(scene, "depth"),
                "depth",
                matrix,
                size,
                depth_zero=depth_zero,
                table=table,
            )
        found |= {"depth": seen, "depth_known": known[None]}
    return found


def batch_targets(batch: Mapping[str, Any]) -> Targets:
    """The truth of a batch of samples, as the loss takes it.

    Args:
        batch: ``target`` (B, 4, N, S, S) and what `task_targets` gave, stacked; tensors.
    """
    return Targets(
        GraspMaps(*batch["target"].unbind(1)),
        mask=batch.get("mask"),
        inside=batch.get("inside"),
        depth=batch.get("depth"),
        depth_known=batch.get("depth_known"),
        classes=batch.get("class"),
    )


def _need(scene: Scene, name: str) -> NDArray[Any]:
    picture: NDArray[Any] | None = getattr(scene, name)
    if picture is None:
        raise InvalidInputError(f"{name} of scene {scene.id}", "missing", "a picture, for its task")
    return picture
