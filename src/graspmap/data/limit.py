"""Limited training sets: the first n objects of a part, in an order that a seed gives.

The order is the same for every n, so a smaller set is always part of a larger one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graspmap.data.scene import Scenes
from graspmap.data.split import By
from graspmap.errors import InvalidInputError

_LIMIT = 2**32
"""The stream of random numbers for the order, apart from those of splits."""


def limit_objects(
    scenes: Scenes, ids: Sequence[str], count: int, *, by: By = "object", seed: int = 0
) -> tuple[str, ...]:
    """The scenes of ``count`` objects out of those that some scenes show.

    Args:
        scenes: The data set; only ids and objects are looked at.
        ids: Scenes to choose from.
        count: Number of objects, or of images with ``by="image"``.
        by: What is counted.
        seed: 0 or more.

    Returns:
        Ids in the order in which they were given.

    Raises:
        InvalidInputError: There are fewer objects (images).
    """
    place = {name: i for i, name in enumerate(scenes.ids)}
    # A scene without an object stands for itself.
    things = {
        name: (scenes.object_id(place[name]) if by == "object" else None) or f"scene {name}"
        for name in ids
    }
    names = sorted(set(things.values()))
    if not 1 <= count <= len(names):
        noun = "objects" if by == "object" else "images"
        raise InvalidInputError(f"number of {noun} to keep", count, f"1 to {len(names)}, all")
    # Only the raw stream is promised to stay as it is; Generator.permutation may change.
    keys = np.random.PCG64([seed, _LIMIT]).random_raw(len(names))
    kept = {names[i] for i in np.argsort(keys, kind="stable")[:count]}
    return tuple(name for name in ids if things[name] in kept)
