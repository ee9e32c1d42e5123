"""A folder of the user's meshes, and the way of each into a model file.

A model file in the data set holds what was really dropped and grasped (the mended surface, its
convex parts, its mass), so the data set can be used without the meshes.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from graspmap.errors import DatasetNotFoundError, FileError, GraspmapError, GraspmapWarning
from graspmap.files import file_hash
from graspmap.generation.entries import MODELS, MeshEntry
from graspmap.generation.model_file import write_model
from graspmap.generation.plan import GenerationPlan
from graspmap.simulation.meshes import MESH_SUFFIXES, load_object

_TOLD = 5
_LONGEST = 100
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class MeshFile:
    """A mesh file.

    Args:
        path: The file.
        name: Its path below the folder of the meshes, with slashes.
        id: Name for the object: that of the file, or of its folder where all files are called the
            same, or both.
        hash: Of its content; "" where it cannot be read.
    """

    path: Path
    name: str
    id: str
    hash: str


def find_meshes(folder: Path, *, remedy: str = "name a folder of meshes") -> list[MeshFile]:
    """The mesh files of a folder and of its subfolders, one for each object, sorted by name.

    One object in several formats side by side (``cup.obj``, ``cup.stl``; YCB's ``textured.obj``,
    ``nontextured.ply``) or twice with the same content is taken once, with a warning: else it would
    be several objects, of which training sees one and the test another.

    Args:
        folder: The folder.
        remedy: What to do where there are none.

    Raises:
        DatasetNotFoundError: The folder does not exist or holds none.
    """
    paths = {
        path.relative_to(folder).as_posix(): path
        for path in folder.rglob("*")
        if path.suffix.lower() in MESH_SUFFIXES
        and not path.name.startswith(".")
        # A link to nowhere is told when it is to be prepared.
        and (path.is_file() or not path.exists())
    }
    if not paths:
        raise DatasetNotFoundError(folder, _nothing(folder), remedy)
    hashes = {name: _hash(path) for name, path in paths.items()}
    names = _objects(hashes)
    if len(names) < len(paths):
        left_out = sorted({*paths} - {*names})
        _LOG.warning(
            "%d of %d mesh files in %s show an object that another file shows, too; left out: %s",
            len(left_out), len(paths), folder,
            ", ".join(left_out[:_TOLD]) + (", ..." if len(left_out) > _TOLD else ""),
        )  # fmt: skip
    ids = _ids(names)
    return [MeshFile(paths[n], n, ids[n], hashes[n]) for n in names]


def _objects(hashes: Mapping[str, str]) -> list[str]:
    """One name for each object, of the format that tells most; the first of equal contents."""
    best: dict[str, str] = {}
    for name in sorted(hashes, key=_poverty):
        best.setdefault(name.rpartition(".")[0].replace("nontextured", "textured"), name)
    seen: dict[str, str] = {}
    return sorted(
        name for name in best.values() if seen.setdefault(hashes[name] or name, name) == name
    )


def _poverty(name: str) -> tuple[bool, int, str]:
    """What is taken last of several files of one object: what has no texture."""
    suffix = PurePosixPath(name).suffix.lower()
    return "nontextured" in name, MESH_SUFFIXES.index(suffix), name


def _nothing(folder: Path) -> str:
    """Why there is no mesh in what should be a folder."""
    if folder.is_dir():
        return f"no mesh ({', '.join(MESH_SUFFIXES)}) in it"
    return "is a file and no folder" if folder.exists() else "no such folder"


def prepare_mesh(plan: GenerationPlan, root: Path, file: MeshFile) -> MeshEntry:
    """Read a mesh, mend it, divide it into convex parts, and write its model file.

    Args:
        plan: Unit, gripper and whether to scale to it.
        root: Folder of the data set.
        file: The mesh.

    Returns:
        The entry for the ledger; for a mesh that cannot be used, one that says why.

    Raises:
        StorageFullError: The disk is full.
        FileError: The model file cannot be written.
    """
    remarks: list[str] = []
    try:
        with _remarks(file.path, remarks):
            fit_to = plan.gripper if plan.fit else None
            model = load_object(file.path, id=file.id, unit=plan.unit, fit_to=fit_to)
    except GraspmapError as error:
        problem = error.problem if isinstance(error, FileError) else str(error)
        return MeshEntry(file.name, file.hash, file.id, problem=problem)
    path = root / MODELS / f"{file.id}.npz"
    write_model(path, model)
    files = {path.relative_to(root).as_posix(): file_hash(path)}
    return MeshEntry(file.name, file.hash, file.id, files, remarks=tuple(remarks))


@contextmanager
def _remarks(path: Path, found: list[str]) -> Iterator[None]:
    """Gather graspmap's warnings about a file instead of showing them, without its path."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", GraspmapWarning)
        yield
    told = [str(w.message) for w in caught if issubclass(w.category, GraspmapWarning)]
    found += [text.removeprefix(f"{path}: ") for text in told]


def _hash(path: Path) -> str:
    try:
        return file_hash(path)
    except FileError:
        return ""  # that it cannot be read is said when it is to be prepared


def _ids(names: list[str]) -> dict[str, str]:
    """A name for each object: short, unique, and fit for a file name."""
    parts = {name: name.rpartition(".")[0].split("/") for name in names}
    for choose in (
        lambda path: path[-1],
        lambda path: path[-2] if len(path) > 1 else path[-1],
        lambda path: "-".join(path),
    ):
        ids = {name: _slug(choose(path)) for name, path in parts.items()}
        if len({id.lower() for id in ids.values()}) == len(ids):
            return ids
    count: Counter[str] = Counter()
    for name, id in ids.items():
        count[id.lower()] += 1
        ids[name] = f"{id}-{count[id.lower()]}"
    return ids


def _slug(text: str) -> str:
    # Names of files are at most 255 bytes long, and more is added to this one.
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", text)[:_LONGEST].strip("-.") or "object"
