"""How hard a scene is to grasp: the share of candidate grasps that failed when it was labelled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from graspmap.data.jacquard import SUFFIXES
from graspmap.data.jacquard_labels import read_negatives
from graspmap.data.scene import Scenes
from graspmap.generation.scene_file import find_record

LEVELS = ("easy", "medium", "hard")


@dataclass(frozen=True)
class Difficulty:
    """Scenes of a data set in three parts of equal size, by the share of candidates that held.

    Attributes:
        level: One of `LEVELS` for each scene, by id.
        bounds: Shares of candidates that held above which a scene is easy, and medium.
    """

    level: Mapping[str, str]
    bounds: tuple[float, float]


def rank_by_difficulty(scenes: Scenes, ids: Sequence[str]) -> Difficulty | None:
    """Divide scenes that graspmap generated into easy, medium and hard ones.

    The candidates of a scene are drawn the same way for all, antipodal ones among them, so the
    share of them that held is what its object allows the gripper. (EGAD's own measure, the quality
    of the best quarter of the antipodal grasps, needs a mesh; see ``graspmap evaluate egad``.)

    Args:
        scenes: The data set.
        ids: The scenes to divide.

    Returns:
        The levels; None where fewer than three of them have a record with failed candidates.

    Raises:
        FileError: A label file is damaged.
    """
    positions = {name: index for index, name in enumerate(scenes.ids)}
    shares = {}
    for name in ids:
        share = _share_held(scenes, positions[name])
        if share is not None:
            shares[name] = share
    if len(shares) < len(LEVELS):
        return None
    # Equal shares stay together: levels depend on the shares, not on the order of the scenes.
    low, high = np.quantile(list(shares.values()), (1 / 3, 2 / 3)).tolist()
    level = {
        name: "easy" if share > high else "medium" if share > low else "hard"
        for name, share in shares.items()
    }
    return Difficulty(level, (high, low))


def _share_held(scenes: Scenes, index: int) -> float | None:
    """Share of the candidates of a scene that held; None where they are not known."""
    files = scenes.files(index)
    failed = [path for path in files if path.name.endswith(SUFFIXES["negatives"])]
    if find_record(files) is None or not failed:
        return None
    held, failures = scenes.read_grasps(index), read_negatives(failed[0])[0]
    tried = len(failures) + (0 if held is None else len(held))
    return None if held is None or not tried else len(held) / tried
