"""What a data set can give to the tables: looked up before anything runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from graspmap.data import Scenes, read_scenes
from graspmap.data.kinds import detect_kind, split_spec
from graspmap.data.split import fingerprint
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
