"""What a run needs before its first step, with every check that can be made before it."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from graspmap.data import (
    Scenes,
    Split,
    Store,
    make_folds,
    make_split,
    open_store,
    read_scenes,
    read_split,
)
from graspmap.errors import (
    ConfigError,
    FileError,
    FileFormatError,
    GraspmapError,
    storage_errors,
)
from graspmap.files import read_bytes, remove_parts, write_text
from graspmap.training.callbacks import Progress
from graspmap.training.data import greatest_opening
from graspmap.training.experiment import Experiment
from graspmap.training.experiment_file import read_experiment

PARTS = ("train", "validation", "test")

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

_ANEW = "choose another folder, or delete this one to train anew"


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
class Setup:
    """What a run works on.

    Attributes:
        store: Packed pictures and labels.
        parts: Indices into the store of the labelled scenes of each part.
        split_hash: Hash of the split.
        width_scale_px: Opening in input pixels that the width map shows as 1.
        device: ``"cpu"`` or ``"cuda"``.
    """

    store: Store
    parts: dict[str, tuple[int, ...]]
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
        changed = [k for k in now if now[k] != before.get(k) and k not in FREE_KEYS]
        if changed:
            key = changed[0]
            more = f" (and {len(changed) - 1} more)" if len(changed) > 1 else ""
            raise FileFormatError(
                folder.experiment,
                f"another experiment was begun in this folder: {key} was {before.get(key)!r} "
                f"and is now {now[key]!r}{more}",
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
            looks at, a part of the split is empty, or the data changed since the run began.
    """
    values = experiment.data
    scenes = read_scenes(values.source, depth=values.depth)
    split = _split(experiment, scenes, folder)
    with progress("packing pictures") as update:
        store = open_store(
            scenes, cache_folder(experiment), size=values.size, view=values.view, progress=update
        )
    parts = {name: _labelled(store, split, name, values.source) for name in PARTS}
    _check_pictures(store, [i for part in parts.values() for i in part], experiment)
    scale = experiment.maps.width_scale
    scale = greatest_opening(store, parts["train"]) if scale == "data" else float(scale)
    facts = {"store": store.key, "split": split.hash, "width_scale_px": scale}
    if not folder.facts.exists() or not folder.last.exists():
        write_text(folder.facts, json.dumps(facts, indent=2) + "\n", durable=True)
    elif (before := _read_facts(folder.facts)) != facts:
        changed = ", ".join(key for key in facts if facts[key] != before.get(key))
        raise FileFormatError(
            folder.facts, f"the data changed since this run began ({changed})", _ANEW
        )
    return Setup(store, parts, split.hash, scale, device)


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


def cache_folder(experiment: Experiment) -> Path:
    """Where packed pictures are kept."""
    if experiment.data.cache_dir is not None:
        return Path(experiment.data.cache_dir).expanduser()
    if "GRASPMAP_CACHE" in os.environ:
        return Path(os.environ["GRASPMAP_CACHE"])
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "graspmap"


def _split(experiment: Experiment, scenes: Scenes, folder: Folder) -> Split:
    """The split of the run: that of its folder, that of a file, or a fresh one."""
    values = experiment.data.split
    if folder.split.exists() and folder.last.exists():
        return read_split(folder.split, scenes)
    seed = experiment.seed if values.seed is None else values.seed
    if values.file is not None:
        split = read_split(Path(values.file).expanduser(), scenes)
    elif values.folds is not None:
        split = make_folds(scenes, values.folds, by=values.by, seed=seed)[values.fold]
    else:
        shares = {name: getattr(values, name) for name in PARTS if getattr(values, name) > 0}
        split = make_split(scenes, parts=shares, by=values.by, seed=seed)
    split.write(folder.split)
    return split


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


def _check_pictures(store: Store, indices: Sequence[int], experiment: Experiment) -> None:
    """See that every scene has the pictures that the network looks at."""
    needed = {"depth": ("depth",), "rgb": ("rgb",), "rgbd": ("rgb", "depth")}
    for name in needed[experiment.network.channels]:
        lacking = [i for i in indices if getattr(store[i], name) is None]
        if lacking:
            raise FileError(
                experiment.data.source,
                f"{len(lacking)} of {len(indices)} scenes have no {name} picture, first "
                f"{store.ids[lacking[0]]}",
                "set network.channels to what the data set has, or complete it",
            )
