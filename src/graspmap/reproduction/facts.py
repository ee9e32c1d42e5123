"""What a data set can give to the tables: looked up before anything runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from graspmap.data import Scenes, read_scenes
from graspmap.data.kinds import detect_kind, split_spec
from graspmap.data.split import fingerprint
from graspmap.errors import DatasetNotFoundError, InvalidInputError
from graspmap.generation.scene_file import find_record
from graspmap.training import Experiment
from graspmap.training.needs import Contents, missing

_SAMPLE = 8
"""Scenes that are opened to see what there is, evenly over the data set."""


@dataclass(frozen=True, eq=False)
class DataFacts:
    """What a data set holds, judged by a sample of its scenes.

    Attributes:
        source: ``kind:folder``, the folder absolute.
        scenes: The scenes.
        objects: Number of objects; a scene without one counts as its own.
        sample: What the scenes of the sample have.
        trials: Whether their grasps can be tried in simulation: depth, and a camera or a record.
        fingerprint: Changes with the ids and objects of the scenes.
    """

    source: str
    scenes: Scenes
    objects: int
    sample: tuple[Contents, ...]
    trials: bool
    fingerprint: str

    def lacks(self, experiment: Experiment) -> str | None:
        """What an experiment needs and these data do not have; None where they have it."""
        found = (
            what for contents in self.sample for what in missing(experiment, contents).values()
        )
        what = next(found, None)
        return None if what is None else f"{self.source} has scenes without {what}"

    def classes(self, experiment: Experiment) -> int:
        """Number of classes that the experiment tells apart, for its parameters; 2 without."""
        category = experiment.tasks.category
        if category is None:
            return 2
        return _count_classes(self.scenes, category.labels)


@cache
def _count_classes(scenes: Scenes, kind: str) -> int:
    names = {scenes.read(i).labels.get(kind) for i in range(len(scenes))}
    return len(names - {None})


@dataclass(frozen=True, eq=False)
class PartFacts:
    """The parts of a recipe, each a data set of its own.

    Attributes:
        folder: Where they lie.
        train: What is trained on.
        validation: What the epoch is chosen with.
        tests: What is tested on, by name of the part.
    """

    folder: Path
    train: DataFacts
    validation: DataFacts
    tests: Mapping[str, DataFacts]

    @property
    def by_name(self) -> dict[str, DataFacts]:
        """All parts."""
        return {"train": self.train, "validation": self.validation, **self.tests}


def look_at_parts(folder: Path | str, depth: str | None = None) -> PartFacts:
    """Open the parts of a recipe: ``train``, ``validation``, and every ``test...``.

    Args:
        folder: Where `graspmap generate --recipe` made them.
        depth: Which of their depths; None for the default.

    Raises:
        DatasetNotFoundError: A part is missing.
        FileError: A scene of the sample is damaged.
        InvalidInputError: Grasps of a test part cannot be tried in simulation.
    """
    root = split_spec(folder)[1]
    names = sorted(path.name for path in root.glob("test*") if path.is_dir())
    for name in ("train", "validation", *(names[:1] or ["test-..."])):
        if not (root / name).is_dir():
            raise DatasetNotFoundError(
                root / name,
                "no such part",
                "name the folder that graspmap generate --recipe graspmap-v1 --out DIR made",
            )
    parts = {name: look_at(str(root / name), depth) for name in ("train", "validation", *names)}
    for name in names:
        if not parts[name].trials:
            raise InvalidInputError(
                f"test part {parts[name].source}",
                "of scenes whose grasps cannot be tried",
                "scenes with depth, and a record or a camera",
            )
    train, validation = parts.pop("train"), parts.pop("validation")
    return PartFacts(root.absolute(), train, validation, parts)


def look_at(source: str, depth: str | None = None) -> DataFacts:
    """Open a data set and see what it holds.

    Args:
        source: ``kind:folder``, or a folder.
        depth: Which of its depths; None for the default.

    Raises:
        FileError: It is not there, or a scene of the sample is damaged.
        UnknownNameError: There is no such kind, or no such depth.
    """
    kind, root = split_spec(source)
    name = f"{kind or detect_kind(root)}:{root.absolute()}"
    scenes = read_scenes(name, depth=depth)
    count = min(_SAMPLE, len(scenes))
    sample = [scenes.read(i * (len(scenes) - 1) // max(1, count - 1)) for i in range(count)]
    contents = tuple(map(Contents.of_scene, sample))
    recorded = all(find_record(scenes.files(scenes.index(scene))) for scene in sample)
    cameras = all(scene.camera is not None for scene in sample)
    return DataFacts(
        source=name,
        scenes=scenes,
        objects=len({scenes.object_id(i) or ("", i) for i in range(len(scenes))}),
        sample=contents,
        trials=all(found.depth for found in contents) and (recorded or cameras),
        fingerprint=fingerprint(scenes),
    )


def part_sizes(
    experiment: Experiment, facts: DataFacts, parts: PartFacts | None
) -> tuple[float, float]:
    """About how many scenes an experiment trains on, and how many choose its epoch."""
    split, scenes = experiment.data.split, len(facts.scenes)
    if parts is not None:
        train, validation = float(scenes), float(len(parts.validation.scenes))
    elif split.folds is not None:
        train, validation = (1 - 1 / split.folds) * scenes, scenes / split.folds / 2
    else:
        train, validation = split.train * scenes, split.validation * scenes
    if split.limit_objects is not None:
        each = 1.0 if split.by == "image" else scenes / facts.objects
        train = min(train, split.limit_objects * each)
    return train, validation
