"""Doctor: looks through a folder and says what is there, what is broken, what it is good for.

`examine` takes ``kind:directory`` for the kinds in `EXAMINERS`, or a directory alone, whose kind
it finds out from the files. A new kind is one entry there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from graspmap.data.kinds import split_spec
from graspmap.doctor.meshes import MESH_SUFFIXES, examine_meshes
from graspmap.doctor.report import Report, Update, nothing
from graspmap.doctor.scenes import examine_scenes
from graspmap.doctor.weights import WEIGHTS_SUFFIXES, examine_weights
from graspmap.errors import (
    DatasetNotFoundError,
    InvalidInputError,
    MissingFileError,
)


@dataclass(frozen=True)
class Examiner:
    """How one kind of folder is recognised and looked through.

    Args:
        run: Called with the folder, ``progress`` and ``everything``.
        signs: Ends of the file names that give the kind away.
    """

    run: Callable[..., Report]
    signs: tuple[str, ...]


EXAMINERS: dict[str, Examiner] = {
    "cornell": Examiner(partial(examine_scenes, kind="cornell"), ("r.png", "cpos.txt")),
    "jacquard": Examiner(partial(examine_scenes, kind="jacquard"), ("_RGB.png", "_grasps.txt")),
    "meshes": Examiner(examine_meshes, MESH_SUFFIXES),
    "weights": Examiner(examine_weights, WEIGHTS_SUFFIXES),
}
"""The known kinds by name."""


def examine(
    spec: str | Path,
    *,
    progress: Update = nothing,
    everything: bool = False,
) -> Report:
    """Look through a folder.

    Args:
        spec: ``"kind:directory"``, or a directory whose kind is found out.
        progress: Called with (done, total).
        everything: Open all pictures, also of a large data set.

    Raises:
        UnknownNameError: There is no such kind.
        MissingFileError: There is no such folder.
        DatasetNotFoundError: The folder holds nothing of its kind, or of any kind.
        InvalidInputError: No folder is named, or no kind and the folder holds several.
    """
    kind, root = split_spec(spec, EXAMINERS)
    if not root.exists():
        raise MissingFileError(root, "there is no such folder", "check its name")
    if kind is None:
        kind = _find_kind(root)
    return EXAMINERS[kind].run(root, progress=progress, everything=everything)


def _find_kind(root: Path) -> str:
    """The kind whose signs the files carry."""
    names = [root.name] if root.is_file() else [p.name for p in root.rglob("*") if p.is_file()]
    counts = {
        kind: sum(name.lower().endswith(tuple(s.lower() for s in examiner.signs)) for name in names)
        for kind, examiner in EXAMINERS.items()
    }
    # Cornell's "r.png" is a short sign: its files begin with "pcd", those of others do not.
    counts["cornell"] = sum(
        name.startswith("pcd") and name.endswith(EXAMINERS["cornell"].signs) for name in names
    )
    found = {kind: count for kind, count in counts.items() if count}
    if not found:
        raise DatasetNotFoundError(
            root,
            f"holds nothing of a known kind ({', '.join(EXAMINERS)})",
            "name the folder that holds the files",
        )
    if len(found) > 1:
        listed = ", ".join(f"{kind} ({count} files)" for kind, count in found.items())
        raise InvalidInputError(
            f"kind of {root}", f"not clear: {listed}", f"KIND:FOLDER with one of {', '.join(found)}"
        )
    return next(iter(found))
