"""Dividing scenes into training, validation and test: by object or by image, into a file.

A split names its scenes, so it stays the same when a data set grows, and carries a hash of its
content. The random order comes from the raw stream of PCG64, which NumPy keeps from release to
release, over sorted names: one seed gives one split on every machine.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np

from graspmap.data.scene import Scenes
from graspmap.errors import FileFormatError, InvalidInputError, UnknownNameError
from graspmap.files import read_bytes, write_text

logger = logging.getLogger(__name__)

By = Literal["object", "image"]

DEFAULT_PARTS: Mapping[str, float] = MappingProxyType(
    {"train": 0.8, "validation": 0.1, "test": 0.1}
)
"""Share of the scenes in each part."""

_FORMAT = "graspmap-split-1"
_REMEDY = "make the split again; a split file must not be edited"


@dataclass(frozen=True)
class Split:
    """Which scenes belong to which part.

    Attributes:
        parts: Scene ids by part, each sorted as in the data set; no id is in two parts.
        by: ``"object"`` where scenes of one object are in one part, ``"image"`` where not.
        seed: Seed that the split was drawn with.
        source: Hash of the ids and objects that were divided (`fingerprint`).
    """

    parts: Mapping[str, tuple[str, ...]]
    by: By
    seed: int
    source: str

    @property
    def hash(self) -> str:
        """32 hexadecimal digits that change with anything in the split."""
        return _digest(self._content())

    def subset(self, scenes: Scenes, part: str) -> Scenes:
        """The scenes of one part.

        Raises:
            UnknownNameError: There is no such part.
            InvalidInputError: A scene of the part is not in ``scenes``.
        """
        if part not in self.parts:
            raise UnknownNameError("part of the split", part, self.parts)
        return scenes.subset(self.parts[part])

    def write(self, path: Path | str) -> None:
        """Write the split as JSON, whole or not at all.

        Raises:
            StorageFullError: The disk is full.
            FileError: Writing there is not allowed.
        """
        content = {**self._content(), "hash": self.hash}
        write_text(Path(path), json.dumps(content, indent=1) + "\n")

    def _content(self) -> dict[str, Any]:
        return {
            "format": _FORMAT,
            "by": self.by,
            "seed": self.seed,
            "source": self.source,
            "parts": {name: list(ids) for name, ids in self.parts.items()},
        }


def fingerprint(scenes: Scenes) -> str:
    """32 hexadecimal digits over the ids and objects of a data set, in any order."""
    return _digest(sorted((name, scenes.object_id(i)) for i, name in enumerate(scenes.ids)))


def make_split(
    scenes: Scenes,
    *,
    parts: Mapping[str, float] = DEFAULT_PARTS,
    by: By = "object",
    seed: int = 0,
) -> Split:
    """Divide scenes at random.

    Sizes are counted in scenes and come as near to the shares as whole objects allow, but no part
    stays empty. A scene without an object stands for itself.

    Args:
        scenes: The data set; only ids and objects are looked at.
        parts: Share of each part, positive, 1 in sum.
        by: Keep objects together, or divide image by image (which lets a network see the test
            objects in training).
        seed: 0 or more.

    Raises:
        InvalidInputError: The shares are not positive or not 1 in sum, the seed is negative, or
            there are fewer objects (images) than parts.
        UnknownNameError: ``by`` is not one of the above.
    """
    shares = {name: float(share) for name, share in parts.items()}
    wrong = not shares or not all(share > 0 for share in shares.values())
    if wrong or not math.isclose(sum(shares.values()), 1.0, abs_tol=1e-6):
        raise InvalidInputError("parts", shares, "positive shares that are 1 in sum")
    groups = _shuffled(_groups(scenes, by), _check_seed(seed))
    assigned = _assign(groups, shares, by)
    return _make(scenes, assigned, by, seed)


def make_folds(
    scenes: Scenes,
    k: int = 5,
    *,
    by: By = "object",
    seed: int = 0,
) -> list[Split]:
    """Cross-validation: k splits, each of which holds another 1/k of the scenes out.

    The parts held out are disjoint and together hold every scene. Half of each is for validation
    and half for the test: k = 5 gives the 80/10/10 of the thesis's chapters 3 and 4, k = 10 gives
    90/5/5, the 90/10 of chapter 5 with choosing and testing held apart.

    Args:
        scenes: The data set; only ids and objects are looked at.
        k: Number of folds, 2 or more.
        by: As in `make_split`.
        seed: 0 or more.

    Raises:
        InvalidInputError: k or the seed is out of its range, or there are fewer than 2 k objects
            (images): every fold needs one to validate with and another to test with.
        UnknownNameError: ``by`` is not one of the above.
    """
    if isinstance(k, bool) or not isinstance(k, int) or k < 2:
        raise InvalidInputError("k", k, "2 or more folds")
    groups = _shuffled(_groups(scenes, by), _check_seed(seed))
    if len(groups) < 2 * k:
        raise _too_few(scenes, len(groups), k, by)
    held = ("validation", "test")
    names = {(fold, part): f"{part} of fold {fold}" for fold in range(k) for part in held}
    drawn = _assign(groups, dict.fromkeys(names.values(), 1 / (2 * k)), by)
    folds = []
    for fold in range(k):
        out = {part: drawn[names[fold, part]] for part in held}
        taken = {name for ids in out.values() for name in ids}
        train = [name for name in scenes.ids if name not in taken]
        folds.append(_make(scenes, {"train": train, **out}, by, seed))
    return folds


def _too_few(scenes: Scenes, groups: int, k: int, by: str) -> InvalidInputError:
    """What to say of data that are too small for k folds."""
    noun = "objects" if by == "object" else "images"
    ways = [f"at most {groups // 2} folds"] if groups >= 4 else []
    if by == "object" and len(scenes) >= 2 * k:
        ways.append(f"folds by image (there are {len(scenes)})")
    return InvalidInputError(
        f"number of {noun} in {scenes.kind}:{scenes.root}",
        groups,
        f"at least {2 * k} for {k} folds, two for each; " + " or ".join([*ways, "more data"]),
    )


def read_split(path: Path | str, scenes: Scenes | None = None) -> Split:
    """Read a split and check it.

    Args:
        path: File written by `Split.write`.
        scenes: The data set that it is for; None leaves out the checks against it.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is no split, was changed since it was written, names a scene twice or
            one that ``scenes`` lacks, or divides an object of ``scenes`` although it is by object.
    """
    path = Path(path)
    try:
        content = json.loads(read_bytes(path))
        stored = content.pop("hash")
        split = Split(
            parts={name: tuple(ids) for name, ids in content["parts"].items()},
            by=content["by"],
            seed=content["seed"],
            source=content["source"],
        )
        known = content["format"] == _FORMAT and split.by in get_args(By)
        if not all(isinstance(name, str) for ids in split.parts.values() for name in ids):
            raise TypeError("an id is no text")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(path, "is no split of graspmap", "make one") from error
    if not known:
        raise FileFormatError(path, "is no split of this version of graspmap", "make it again")
    if stored != _digest(content):
        raise FileFormatError(path, "was changed since it was written (its hash differs)", _REMEDY)
    everyone = [name for ids in split.parts.values() for name in ids]
    doubled = [a for a, b in pairwise(sorted(everyone)) if a == b]
    if doubled:
        raise FileFormatError(path, f"names scene {doubled[0]} twice", _REMEDY)
    if scenes is not None:
        _check_against(path, split, scenes)
    return split


def _check_against(path: Path, split: Split, scenes: Scenes) -> None:
    where = f"{scenes.kind}:{scenes.root}"
    position = {name: i for i, name in enumerate(scenes.ids)}
    named = [name for ids in split.parts.values() for name in ids]
    missing = [name for name in named if name not in position]
    if missing:
        raise FileFormatError(
            path,
            f"names {len(missing)} scenes that {where} lacks, first {missing[0]}",
            "use the data it was made for, or make the split again",
        )
    if split.by == "object":
        part_of: dict[str, str] = {}
        for part, ids in split.parts.items():
            for name in ids:
                thing = scenes.object_id(position[name]) or name
                if part_of.setdefault(thing, part) != part:
                    raise FileFormatError(
                        path, f"object {thing} of {where} is in two parts", "make the split again"
                    )
    if len(named) < len(scenes):
        logger.warning("%s leaves out %d scenes of %s", path, len(scenes) - len(named), where)


def _groups(scenes: Scenes, by: str) -> dict[str, list[str]]:
    """Scene ids that must stay together, by name of the group, sorted by that name."""
    if by not in get_args(By):
        raise UnknownNameError("by", str(by), get_args(By))
    groups: dict[str, list[str]] = {}
    for i, name in enumerate(scenes.ids):
        thing = scenes.object_id(i) if by == "object" else None
        # The prefix keeps a scene without object apart from an object of the same name.
        groups.setdefault(f"scene {name}" if thing is None else f"object {thing}", []).append(name)
    return dict(sorted(groups.items()))


def _check_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InvalidInputError("seed", seed, "a whole number, 0 or more")
    return seed


def _shuffled(groups: Mapping[str, list[str]], *seed: int) -> dict[str, list[str]]:
    names = list(groups)
    # Only the raw stream is promised to stay as it is; Generator.permutation may change.
    keys = np.random.PCG64(list(seed)).random_raw(len(names))
    return {names[i]: groups[names[i]] for i in np.argsort(keys, kind="stable")}


def _assign(
    groups: Mapping[str, list[str]], shares: Mapping[str, float], by: str
) -> dict[str, list[str]]:
    """Scene ids by part: each group, in order, goes where most scenes are missing.

    So the parts fill up side by side towards the end, and a part's size misses its share by less
    than the largest group, with the last groups kept for parts that would stay empty.
    """
    if len(groups) < len(shares):
        noun = "objects" if by == "object" else "images"
        raise InvalidInputError(
            f"number of {noun}", len(groups), f"at least {len(shares)}, one for each part"
        )
    total = sum(map(len, groups.values()))
    missing = {part: share * total for part, share in shares.items()}
    chosen: dict[str, list[list[str]]] = {part: [] for part in shares}
    for left, ids in zip(range(len(groups), 0, -1), groups.values(), strict=True):
        empty = [part for part in shares if not chosen[part]]
        part = max(empty if left <= len(empty) else shares, key=lambda part: missing[part])
        chosen[part].append(ids)
        missing[part] -= len(ids)
    _even_out(chosen, missing)
    return {part: [name for ids in lists for name in ids] for part, lists in chosen.items()}


def _even_out(chosen: dict[str, list[list[str]]], missing: dict[str, float]) -> None:
    """Exchange or move single groups between parts as long as that brings the sizes nearer."""
    while True:
        best = (1e-9, "", "", -1, -1)
        for giver, taker in ((a, b) for a in chosen for b in chosen if a != b):
            # Groups of one size are interchangeable: the last of each size stands for all.
            given = {len(ids): i for i, ids in enumerate(chosen[giver])}
            taken = {0: -1, **{len(ids): i for i, ids in enumerate(chosen[taker])}}
            for out, i in given.items():
                for back, j in taken.items():
                    if out <= back or (j < 0 and len(chosen[giver]) == 1):
                        continue
                    before = missing[giver] ** 2 + missing[taker] ** 2
                    after = (missing[giver] + out - back) ** 2 + (missing[taker] - out + back) ** 2
                    if before - after > best[0]:
                        best = (before - after, giver, taker, i, j)
        _, giver, taker, i, j = best
        if not giver:
            return
        moved = [(taker, chosen[giver].pop(i), giver)]
        if j >= 0:
            moved.append((giver, chosen[taker].pop(j), taker))
        for part, ids, origin in moved:
            chosen[part].append(ids)
            missing[part] -= len(ids)
            missing[origin] += len(ids)


def _make(scenes: Scenes, assigned: Mapping[str, Sequence[str]], by: By, seed: int) -> Split:
    position = {name: i for i, name in enumerate(scenes.ids)}
    parts = {part: tuple(sorted(ids, key=position.__getitem__)) for part, ids in assigned.items()}
    return Split(parts, by, seed, fingerprint(scenes))


def _digest(content: Any) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return blake2b(text.encode(), digest_size=16).hexdigest()
