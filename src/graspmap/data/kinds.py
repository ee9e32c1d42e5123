"""The kinds of data sets, and `read_scenes`, which opens one by its name ``kind:directory``.

A new kind is one class derived from `Scenes` with a static method ``recognises(root)``, and one
line in `KINDS`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from dataclasses import dataclass
from inspect import signature
from pathlib import Path
from typing import Any, get_args

from graspmap.data import cornell, jacquard
from graspmap.data.cornell import CornellScenes
from graspmap.data.examples import EXAMPLES, example_scenes
from graspmap.data.jacquard import JacquardScenes
from graspmap.data.scene import Scenes
from graspmap.errors import (
    DatasetNotFoundError,
    FileFormatError,
    InvalidInputError,
    UnknownNameError,
)


@dataclass(frozen=True)
class Kind:
    """One kind of data set.

    Attributes:
        open: Gives its scenes; called with the folder and the kind's own options as keywords.
        recognises: Whether a folder looks like one of this kind.
        depths: The depths that its scenes offer, the default first.
        files: The files that make a scene, in words, for messages.
    """

    open: Callable[..., Scenes]
    recognises: Callable[[Path], bool]
    depths: tuple[str, ...]
    files: str

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options that `open` understands."""
        return tuple(
            parameter.name
            for parameter in signature(self.open).parameters.values()
            if parameter.kind is parameter.KEYWORD_ONLY
        )


KINDS: dict[str, Kind] = {
    "cornell": Kind(
        CornellScenes, CornellScenes.recognises, get_args(cornell.DepthKind), "pcdNNNNr.png"
    ),
    "jacquard": Kind(
        JacquardScenes,
        JacquardScenes.recognises,
        get_args(jacquard.DepthKind),
        "<i>_<object>_RGB.png",
    ),
}
"""The known kinds by name."""


def split_spec(spec: str | Path, kinds: Collection[str] = KINDS.keys()) -> tuple[str | None, Path]:
    """Kind (None where it is not given) and folder of ``kind:directory``.

    A leading ``~`` is the user's home: a shell leaves it alone after a colon.

    Args:
        spec: ``"kind:directory"``, a directory, or ``"examples"`` for the scenes that ship.
        kinds: The kinds that there are.

    Raises:
        UnknownNameError: The kind is not one of them, and no such folder exists.
        InvalidInputError: No folder is named, or its name holds a zero byte.
    """
    text = str(spec)
    if spec == EXAMPLES:
        return "jacquard", example_scenes()
    kind, colon, folder = text.partition(":")
    known = kind in kinds and not isinstance(spec, Path)
    # The current folder is hardly meant: rather a variable of the shell that is not set.
    if not (folder if known and colon else text) or "\0" in text:
        raise InvalidInputError("data set", repr(text), "kind:directory, or . for this folder")
    if isinstance(spec, Path) or not colon:
        return None, _at_home(text)
    if known:
        return kind, _at_home(folder)
    if Path(text).exists():
        # A folder with a colon in its name, or a drive letter.
        return None, Path(text)
    raise UnknownNameError("kind of data set", kind, kinds)


def _at_home(folder: str) -> Path:
    # Path.expanduser raises where the user is unknown; this leaves the name as it is.
    return Path(os.path.expanduser(folder))  # noqa: PTH111


def read_scenes(spec: str | Path, *, depth: str | None = None, **options: Any) -> Scenes:
    """The scenes of a data set, read from disk one at a time.

    Args:
        spec: ``"kind:directory"``, a directory whose kind is found from its files, or
            ``"examples"`` for the scenes that ship (`example_scenes`).
        depth: Which depth the scenes get: ``"perfect"`` or ``"stereo"`` for jacquard, ``"z"`` or
            ``"range"`` for cornell; None for the kind's default.
        **options: What else the kind understands, for example ``jaws="smallest"`` for jacquard;
            None stands for the default.

    Raises:
        UnknownNameError: The kind, an option or its value is unknown.
        DatasetNotFoundError: The folder does not exist or holds no such scenes.
        FileFormatError: The kind was not given, and the folder holds scenes of several.
    """
    name, root = split_spec(spec)
    if name is None:
        name = detect_kind(root)
    kind = KINDS[name]
    given = {"depth": depth, **options}
    given = {option: value for option, value in given.items() if value is not None}
    for option in given:
        if option not in kind.options:
            raise UnknownNameError(f"option of {name} data", option, kind.options)
    return kind.open(root, **given)


def detect_kind(root: Path) -> str:
    """The kind of the data set in a folder, found from the names of its files.

    Raises:
        DatasetNotFoundError: The folder does not exist or holds no scenes of any kind.
        FileFormatError: It holds scenes of several kinds.
    """
    if not root.is_dir():
        raise DatasetNotFoundError(root, "no such folder", "name a folder as kind:directory")
    matching = [name for name, kind in KINDS.items() if kind.recognises(root)]
    if not matching:
        known = "; ".join(f"{name}: {kind.files}" for name, kind in KINDS.items())
        raise DatasetNotFoundError(root, "no data set of a known kind in it", f"known are {known}")
    if len(matching) > 1:
        choices = " or ".join(f"{name}:{root}" for name in matching)
        raise FileFormatError(root, "holds scenes of several kinds", f"say which: {choices}")
    return matching[0]
