"""What a data set can give to the tables: looked up before anything runs."""

from __future__ import annotations

from dataclasses import dataclass

from graspmap.data import Scenes, read_scenes
from graspmap.data.kinds import detect_kind, split_spec
from graspmap.data.split import fingerprint
from graspmap.generation.scene_file import find_record
from graspmap.training import Experiment

_SAMPLE = 8
"""Scenes that are opened to see what there is, evenly over the data set."""


@dataclass(frozen=True, eq=False)
class DataFacts:
    """What a data set holds, judged by a sample of its scenes.

    Attributes:
        source: ``kind:folder``, the folder absolute.
        scenes: The scenes.
        objects: Number of objects; a scene without one counts as its own.
        pictures: Which of ``rgb``, ``depth`` and ``mask`` all scenes of the sample have.
        labels: Kinds of class labels that all of them have.
        trials: Whether their grasps can be tried in simulation: depth, and a camera or a record.
        fingerprint: Changes with the ids and objects of the scenes.
    """

    source: str
    scenes: Scenes
    objects: int
    pictures: frozenset[str]
    labels: frozenset[str]
    trials: bool
    fingerprint: str

    def lacks(self, experiment: Experiment) -> str | None:
        """Why an experiment cannot be trained on these data; None where it can."""
        network, tasks = experiment.network, experiment.tasks
        wanted = {"depth": ("depth",), "rgb": ("rgb",), "rgbd": ("rgb", "depth")}
        missing = [name for name in wanted[network.channels] if name not in self.pictures]
        if missing:
            return f"the data have no {missing[0]} pictures"
        if tasks.saliency is not None and "mask" not in self.pictures:
            return "the data have no masks for saliency"
        if tasks.depth is not None and "depth" not in self.pictures:
            return "the data have no depth to reconstruct"
        if tasks.category is not None and tasks.category.labels not in self.labels:
            return f"the data have no {tasks.category.labels} class labels"
        return None


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
    pictures = {
        kind
        for kind in ("rgb", "depth", "mask")
        if all(getattr(scene, kind) is not None for scene in sample)
    }
    labels = set.intersection(*(set(scene.labels) for scene in sample))
    recorded = all(find_record(scenes.files(scenes.index(scene))) for scene in sample)
    cameras = all(scene.camera is not None for scene in sample)
    return DataFacts(
        source=name,
        scenes=scenes,
        objects=len({scenes.object_id(i) or ("", i) for i in range(len(scenes))}),
        pictures=frozenset(pictures),
        labels=frozenset(labels),
        trials="depth" in pictures and (recorded or cameras),
        fingerprint=fingerprint(scenes),
    )
