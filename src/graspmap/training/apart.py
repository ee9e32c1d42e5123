"""Data that come in parts, each a data set of its own: nothing is divided, nothing is shared."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from itertools import combinations

from graspmap.data import Scenes
from graspmap.errors import ConfigError, FileError
from graspmap.generation.scene_file import find_record, read_object_keys
from graspmap.training.experiment import Experiment, SplitSection

_DIVIDES = ("train", "validation", "test", "folds", "fold", "file")
"""Keys of the split that divide a data set."""


def check_parts(experiment: Experiment) -> None:
    """See that an experiment whose validation is a data set of its own divides nothing.

    Raises:
        ConfigError: It does, or has no test data; the error names the key.
    """
    values = experiment.data
    if values.validation is None:
        return
    where = f"experiment {experiment.name}"
    if values.test is None:
        raise ConfigError(
            where,
            "data.test",
            "is null, but data.validation is a data set of its own",
            "set data.test.source to the part to test on, or data.validation to null",
        )
    usual = SplitSection()
    for key in _DIVIDES:
        found = getattr(values.split, key)
        if found != getattr(usual, key):
            raise ConfigError(
                where,
                f"data.split.{key}",
                f"is {found!r}, but with data.validation all of data.source is trained on",
                "leave it out (data.split.limit_objects keeps a part), or set data.validation to "
                "null",
            )


def check_apart(parts: Mapping[str, Scenes]) -> None:
    """See that no object is in two parts.

    An object of a generated scene is known by what it was made from, as the scene's record says,
    and not by its name, which two recipes may give to different objects. Of other scenes nothing is
    known but their files: those must not be the same.

    Args:
        parts: Scenes by name of the part.

    Raises:
        FileError: One is.
        FileFormatError: A record is damaged.
    """
    scenes_of = {name: _scenes_by_object(scenes) for name, scenes in parts.items()}
    for (first, mine), (second, others) in combinations(scenes_of.items(), 2):
        shared = sorted(mine[key] for key in mine.keys() & others.keys())
        if shared:
            raise FileError(
                parts[second].root,
                f"shares {len(shared)} objects with the {first} part, {parts[first].root} "
                f"(there in scene {shared[0]})",
                f"name a {second} part of other objects, generated with a seed of its own",
            )


def _scenes_by_object(scenes: Scenes) -> dict[Hashable, str]:
    """A scene of each object, by what the object is."""
    found: dict[Hashable, str] = {}
    for index, name in enumerate(scenes.ids):
        files = scenes.files(index)
        record = find_record(files)
        keys = frozenset() if record is None else read_object_keys(record)
        for key in keys or {str(files[0].resolve())}:
            found.setdefault(key, name)
    return found
