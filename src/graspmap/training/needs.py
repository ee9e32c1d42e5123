"""What an experiment needs of its scenes: pictures to look at, and the truth of its tasks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from graspmap.data import Scene, Store
from graspmap.errors import FileError
from graspmap.training.experiment import Experiment

_PICTURES = {"depth": ("depth",), "rgb": ("rgb",), "rgbd": ("rgb", "depth")}


@dataclass(frozen=True)
class Contents:
    """What a scene has.

    Attributes:
        rgb: A colour picture.
        depth: A depth picture.
        mask: A mask.
        labels: Class names by kind.
    """

    rgb: bool
    depth: bool
    mask: bool
    labels: Mapping[str, str]

    @classmethod
    def of_scene(cls, scene: Scene) -> Contents:
        """Of a scene that was read."""
        pictures = (scene.rgb, scene.depth, scene.mask)
        rgb, depth, mask = (picture is not None for picture in pictures)
        return cls(rgb, depth, mask, scene.labels)

    @classmethod
    def of_store(cls, store: Store, index: int) -> Contents:
        """Of a packed scene, without opening its pictures."""
        rgb, depth, mask = (store.has(index, name) for name in ("rgb", "depth", "mask"))
        return cls(rgb, depth, mask, store.labels(index))


def missing(experiment: Experiment, contents: Contents) -> dict[str, str]:
    """What a scene lacks, in words, by the key of the experiment that needs it."""
    tasks = experiment.tasks
    found = {}
    for name in _PICTURES[experiment.network.channels]:
        if not getattr(contents, name):
            found["network.channels"] = f"{name} picture"
    if tasks.saliency is not None and not contents.mask:
        found["tasks.saliency"] = "mask"
    if tasks.depth is not None and not contents.depth:
        found["tasks.depth"] = "depth picture"
    if tasks.category is not None and tasks.category.labels not in contents.labels:
        found["tasks.category"] = f"{tasks.category.labels} class"
    return found


def check_contents(
    experiment: Experiment, source: str, scenes: Mapping[str, Contents], *, tasks: bool = True
) -> None:
    """See that scenes have all that the experiment needs.

    Args:
        experiment: The experiment.
        source: The data set, for the error.
        scenes: What each scene has, by its id.
        tasks: Whether the truth of the tasks counts, too, and not only what the network looks at.

    Raises:
        FileError: They lack something; the error names the key that needs it.
    """
    lacks = {name: missing(experiment, contents) for name, contents in scenes.items()}
    for key in ("network.channels", *(f"tasks.{name}" for name in experiment.tasks.names)):
        without = [name for name, found in lacks.items() if key in found]
        if not without or (key != "network.channels" and not tasks):
            continue
        what = lacks[without[0]][key]
        remedy = (
            f"set {key} to what the data set has, or complete it"
            if key == "network.channels"
            else f"give data that have one, or set {key} to null"
        )
        found = (
            f"{len(without)} of {len(scenes)} scenes have no {what}, which {key} needs, first "
            f"{without[0]}"
            if len(scenes) > 1
            else f"scene {without[0]} has no {what}, which {key} needs"
        )
        raise FileError(source, found, remedy)


def known_tasks(experiment: Experiment, scenes: Sequence[Contents]) -> tuple[str, ...]:
    """The experiment's tasks whose truth every one of some scenes has."""
    lacks = [missing(experiment, contents) for contents in scenes]
    return tuple(
        name for name in experiment.tasks.names if not any(f"tasks.{name}" in f for f in lacks)
    )


@dataclass(frozen=True)
class Classes:
    """The classes of the category task.

    Attributes:
        names: All classes of the data set, sorted: those of the whole set and not of a part, so
            that all folds have the same.
        most: The most frequent class of the training part.
        share: Its share there: what always saying it is right in.
    """

    names: tuple[str, ...] = ()
    most: str = ""
    share: float = 0.0


def find_classes(experiment: Experiment, store: Store, train: Sequence[int]) -> Classes:
    """The classes of a data set; none without a category task.

    Args:
        experiment: Says which labels are the classes.
        store: The scenes.
        train: Those of the training part, each with such a label.

    Raises:
        FileError: All training scenes are of one class.
    """
    if experiment.tasks.category is None:
        return Classes()
    kind = experiment.tasks.category.labels
    labels = [store.labels(i) for i in range(len(store))]
    counts = Counter(labels[i][kind] for i in train)
    if len(counts) < 2:
        raise FileError(
            experiment.data.source,
            f"tasks.category has nothing to tell apart: all {len(train)} training scenes are of "
            f"the {kind} class {next(iter(counts))!r}",
            "give data with several, or set tasks.category to null",
        )
    # Of equally frequent ones the first by name, not the first met.
    most, count = min(counts.items(), key=lambda item: (-item[1], item[0]))
    names = sorted({found[kind] for found in labels if kind in found})
    return Classes(tuple(names), most, count / len(train))
