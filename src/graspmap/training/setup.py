"""What a run needs before its first step, with every check that can be made before it."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch

from graspmap.data import (
    Scenes,
    Split,
    Store,
    limit_objects,
    make_folds,
    make_split,
    open_store,
    read_scenes,
    read_split,
)
from graspmap.data.fingerprint import data_hash
from graspmap.data.split import By, fingerprint
from graspmap.errors import (
    ConfigError,
    FileError,
    FileFormatError,
    GraspmapError,
    InvalidInputError,
    storage_errors,
)
from graspmap.files import cache_folder, read_bytes, remove_parts, write_text
from graspmap.training.apart import check_apart
from graspmap.training.callbacks import Progress
from graspmap.training.data import greatest_opening
from graspmap.training.experiment import Experiment, TestSection, ValidationSection
from graspmap.training.experiment_file import read_experiment
from graspmap.training.needs import (
    Classes,
    Contents,
    check_contents,
    find_classes,
    known_tasks,
)

PARTS = ("train", "validation", "test")

Other = ValidationSection | TestSection
"""A part that is a data set of its own."""

FREE_KEYS = frozenset(
    {
        "training.epochs",
        "training.workers",
        "training.device",
        "training.checkpoint_minutes",
        "data.cache_dir",
    }
)
"""What may change when a run goes on: nothing of it changes an epoch that is done."""

_logger = logging.getLogger(__name__)
_ANEW = "choose another folder, or delete this one to train anew"
_ABSENT = "not there"


@dataclass(frozen=True)
class Folder:
    """The files of a run.

    Attributes:
        root: The folder given as ``--out``.
    """

    root: Path

    @property
    def experiment(self) -> Path:
        """The experiment, every default written out."""
        return self.root / "experiment.yaml"

    @property
    def split(self) -> Path:
        """The scenes of each part."""
        return self.root / "split.json"

    @property
    def facts(self) -> Path:
        """What was found in the data when the run began."""
        return self.root / "run.json"

    @property
    def checkpoints(self) -> Path:
        """Folder of the last and the best state."""
        return self.root / "checkpoints"

    @property
    def last(self) -> Path:
        """The state to go on from."""
        return self.checkpoints / "last.ckpt"

    @property
    def best(self) -> Path:
        """The state of the best epoch."""
        return self.checkpoints / "best.ckpt"

    @property
    def weights(self) -> Path:
        """The result."""
        return self.root / "weights.safetensors"


@dataclass(frozen=True)
class Part:
    """The scenes that a run trains on, chooses its epoch with, or is tested on.

    Attributes:
        store: Packed pictures and labels; parts that are divided from one data set share theirs.
        indices: The labelled scenes of it; empty for no test.
        tasks: Tasks whose truth these scenes have.
    """

    store: Store
    indices: tuple[int, ...]
    tasks: tuple[str, ...]


@dataclass(frozen=True)
class Setup:
    """What a run works on.

    Attributes:
        parts: Its `PARTS` by name.
        classes: The classes of the category task.
        data_hash: Hash of the training data, see `graspmap.data.fingerprint.data_hash`.
        split_hash: Hash of the split.
        width_scale_px: Opening in input pixels that the width map shows as 1.
        device: ``"cpu"`` or ``"cuda"``.
    """

    parts: dict[str, Part]
    classes: Classes
    data_hash: str
    split_hash: str
    width_scale_px: float
    device: str


def choose_device(experiment: Experiment) -> str:
    """``"cpu"`` or ``"cuda"``.

    Raises:
        ConfigError: The device is not there, or cannot do the precision.
    """
    wanted, found = experiment.training.device, torch.cuda.is_available()
    if wanted == "cuda" and not found:
        raise ConfigError(
            f"experiment {experiment.name}",
            "training.device",
            "is 'cuda', but PyTorch finds no CUDA device",
            "allowed here: auto, cpu",
        )
    device = "cuda" if found and wanted != "cpu" else "cpu"
    if device == "cpu" and experiment.training.precision == "16":
        raise ConfigError(
            f"experiment {experiment.name}",
            "training.precision",
            "is '16', which needs a CUDA device",
            "allowed here: '32', 'bf16'",
        )
    return device


def claim_folder(folder: Folder, experiment: Experiment) -> None:
    """Write the experiment into a new folder, or see that the folder is of the same experiment.

    Raises:
        FileFormatError: The folder holds another experiment, or results without one.
    """
    begun = [path for path in (folder.last, folder.best, folder.weights) if path.exists()]
    if begun and not folder.experiment.exists():
        raise FileFormatError(begun[0], "is here, but no experiment.yaml that it comes from", _ANEW)
    if begun:
        before, now = read_experiment(folder.experiment).flat(), experiment.flat()
        # Also keys of one of them alone: a task, or a test on other data.
        keys = [k for k in dict.fromkeys([*now, *before]) if k not in FREE_KEYS]
        changed = [k for k in keys if now.get(k, _ABSENT) != before.get(k, _ABSENT)]
        if changed:
            key = changed[0]
            more = f" (and {len(changed) - 1} more)" if len(changed) > 1 else ""
            raise FileFormatError(
                folder.experiment,
                f"another experiment was begun in this folder: {key} was "
                f"{before.get(key, _ABSENT)!r} and is now {now.get(key, _ABSENT)!r}{more}",
                _ANEW,
            )
    with storage_errors(folder.checkpoints):
        folder.checkpoints.mkdir(exist_ok=True)
        for place in (folder.root, folder.checkpoints):
            remove_parts(place)
    write_text(folder.experiment, experiment.to_yaml(), durable=True)


def prepare(experiment: Experiment, folder: Folder, device: str, progress: Progress) -> Setup:
    """Read, split and pack the data, and see that the network can learn from it.

    Raises:
        GraspmapError: The data are missing, damaged, without labels or without what the network
            looks at, a part is empty, two parts share an object, or the data changed since the run
            began.
    """
    values = experiment.data
    scenes = read_scenes(values.source, depth=values.depth)
    split = _split(experiment, scenes, folder)
    others = _others(experiment)
    # What all scenes lack is said now, and not after an hour of packing.
    trained = scenes.subset(split.parts.get("train", ()))
    _check_first(experiment, trained, values.source)
    for name, (section, found) in others.items():
        _check_first(experiment, found, section.source, tasks=name != "test")
    if values.validation is not None:
        check_apart({"train": trained, **{name: found for name, (_, found) in others.items()}})
    with progress("packing pictures") as update:
        store = open_store(
            scenes, _store_folder(experiment), size=values.size, view=values.view, progress=update
        )
    drawn = {
        name: _labelled(store, split, name, values.source) for name in PARTS if name not in others
    }
    used = {i: Contents.of_store(store, i) for part in drawn.values() for i in part}
    check_contents(experiment, values.source, {store.ids[i]: c for i, c in used.items()})
    parts = {name: Part(store, found, experiment.tasks.names) for name, found in drawn.items()}
    classes = find_classes(experiment, store, drawn["train"])
    scale = experiment.maps.width_scale
    scale = greatest_opening(store, drawn["train"]) if scale == "data" else float(scale)
    facts = {"store": store.key, "split": split.hash, "width_scale_px": scale}
    for name, (section, found) in others.items():
        parts[name] = _other_part(experiment, name, section, found, progress)
        facts[f"{name}_store"] = parts[name].store.key
    if not folder.facts.exists() or not folder.last.exists():
        write_text(folder.facts, json.dumps(facts, indent=2) + "\n", durable=True)
    elif (before := _read_facts(folder.facts)) != facts:
        changed = ", ".join(key for key in facts if facts[key] != before.get(key))
        raise FileFormatError(
            folder.facts, f"the data changed since this run began ({changed})", _ANEW
        )
    return Setup(parts, classes, data_hash(scenes), split.hash, scale, device)


def _others(experiment: Experiment) -> dict[str, tuple[Other, Scenes]]:
    """The parts that are data sets of their own, with their scenes."""
    sections = {"validation": experiment.data.validation, "test": experiment.data.test}
    return {
        name: (section, other_scenes(experiment, section))
        for name, section in sections.items()
        if section is not None
    }


def other_scenes(experiment: Experiment, values: Other) -> Scenes:
    """The scenes of ``data.validation`` or ``data.test``, as many objects' as it says.

    Raises:
        ConfigError: There are fewer.
        FileError: The data are missing or damaged.
    """
    scenes = read_scenes(values.source, depth=values.depth)
    if not isinstance(values, TestSection) or values.limit_objects is None:
        return scenes
    key = "data.test.limit_objects"
    kept = _limited(experiment, key, scenes, scenes.ids, "object", split_seed(experiment))
    return scenes.subset(kept)


def _limited(
    experiment: Experiment, key: str, scenes: Scenes, ids: Sequence[str], by: By, seed: int
) -> tuple[str, ...]:
    """As many objects' scenes as the value of ``key`` says.

    Raises:
        ConfigError: There are fewer.
    """
    count = experiment.flat()[key]
    try:
        return limit_objects(scenes, ids, count, by=by, seed=seed)
    except InvalidInputError as error:
        what = f"is {count}, but there are fewer objects"
        remedy = f"allowed here: {error.allowed}"
        raise ConfigError(f"experiment {experiment.name}", key, what, remedy) from error


def _other_part(
    experiment: Experiment, part: str, values: Other, scenes: Scenes, progress: Progress
) -> Part:
    """The packed scenes of another data set, those with labels, and the tasks known there."""
    view = values.view if isinstance(values, TestSection) else None
    view = experiment.data.view if view is None else view
    with progress(f"packing pictures of the {part}") as update:
        store = open_store(
            scenes, _store_folder(experiment), size=experiment.data.size, view=view, progress=update
        )
    indices = tuple(i for i in range(len(store)) if len(store.read_grasps(i) or ()))
    if not indices:
        remedy = f"name another data.{part}.source"
        raise FileError(values.source, "has no scene with labels", remedy)
    used = {store.ids[i]: Contents.of_store(store, i) for i in indices}
    # The loss of the validation steers the training: it is to be that of all tasks.
    check_contents(experiment, values.source, used, tasks=part != "test")
    known = known_tasks(experiment, list(used.values()))
    for name in experiment.tasks.names:
        if name not in known:
            _logger.warning("%s has no truth for %s: not tested there", values.source, name)
    return Part(store, indices, known)


def _check_first(
    experiment: Experiment, scenes: Scenes, source: str, *, tasks: bool = True
) -> None:
    """See that the first scene, where there is any, has what the experiment needs."""
    if not len(scenes):
        return
    scene = scenes[0]
    check_contents(experiment, source, {scene.id: Contents.of_scene(scene)}, tasks=tasks)


def _read_facts(path: Path) -> dict[str, Any]:
    try:
        facts = json.loads(read_bytes(path))
    except (ValueError, RecursionError) as error:
        if isinstance(error, GraspmapError):
            raise
        facts = None
    if not isinstance(facts, dict):
        raise FileFormatError(path, "is damaged", _ANEW)
    return facts


def _store_folder(experiment: Experiment) -> Path:
    """Where packed pictures are kept."""
    own = experiment.data.cache_dir
    return cache_folder() if own is None else Path(own).expanduser()


def _split(experiment: Experiment, scenes: Scenes, folder: Folder) -> Split:
    """The split of the run: that of its folder, that of a file, or a fresh one."""
    values = experiment.data.split
    if folder.split.exists() and folder.last.exists():
        return read_split(folder.split, scenes)
    seed = split_seed(experiment)
    if experiment.data.validation is not None:
        split = Split({"train": scenes.ids}, values.by, seed, fingerprint(scenes))
    elif values.file is not None:
        split = read_split(Path(values.file).expanduser(), scenes)
    elif values.folds is not None:
        split = make_folds(scenes, values.folds, by=values.by, seed=seed)[values.fold]
    else:
        shares = {name: getattr(values, name) for name in PARTS if getattr(values, name) > 0}
        split = make_split(scenes, parts=shares, by=values.by, seed=seed)
    if values.limit_objects is not None:
        key, train = "data.split.limit_objects", split.parts.get("train", ())
        kept = _limited(experiment, key, scenes, train, split.by, split.seed)
        split = replace(split, parts={**split.parts, "train": kept})
    split.write(folder.split)
    return split


def split_seed(experiment: Experiment) -> int:
    """Seed of the split: its own, or that of the experiment."""
    seed = experiment.data.split.seed
    return experiment.seed if seed is None else seed


def _labelled(store: Store, split: Split, part: str, source: str) -> tuple[int, ...]:
    """Indices of the scenes of a part that can be used.

    Scenes without labels teach nothing and prove nothing; those known to have no grasp at all
    (an empty label file) can be trained on, but no grasp can be right there.
    """
    places = {name: i for i, name in enumerate(store.ids)}
    found = []
    for name in split.parts.get(part, ()):
        labels = store.read_grasps(places[name])
        if labels is not None and (part == "train" or len(labels)):
            found.append(places[name])
    if part == "train" and not any(len(store.read_grasps(i) or ()) for i in found):
        found = []
    if not found and part != "test":
        raise FileError(
            source,
            f"the {part} part of the split has no scene with labels",
            f"give a data set with labels, or a larger data.split.{part}",
        )
    return tuple(found)
