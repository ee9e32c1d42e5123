"""`generate`: from a plan to a labelled data set, by any number of workers, through any kill."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from graspmap.data.jacquard import JacquardScenes
from graspmap.data.split import Split, fingerprint, make_split
from graspmap.errors import FileError, GraspmapError, InvalidInputError
from graspmap.files import locked
from graspmap.generation.entries import ItemEntry, MeshEntry
from graspmap.generation.item import Attempt, Rejected, make_item
from graspmap.generation.ledger import SPLIT, Ledger, check_folder
from graspmap.generation.mesh_folder import MeshFile, find_meshes, prepare_mesh
from graspmap.generation.plan import GenerationPlan
from graspmap.generation.scene_file import versions
from graspmap.generation.workers import Answer, WorkerDiedError, WorkerPool
from graspmap.simulation.render.photo import check_photo

ATTEMPTS = 5
"""Objects that an item may try before it is given up."""

_HOPELESS = 10  # items given up, and not one made
_REMARKS = 5  # about meshes, shown in full
_PARTS = ("train", "validation", "test")
_NO_MESHES = "name a folder of meshes, or 'procedural' for objects that graspmap makes up"
_LOG = logging.getLogger(__name__)

Update = Callable[[int, int], None]
Progress = Callable[[str], AbstractContextManager[Update]]
"""Called with a title; gives the function to call with (done, total)."""


def generate(
    plan: GenerationPlan,
    root: Path | str,
    *,
    workers: int = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Make a data set, or go on with one.

    The folder then holds the scenes in Jacquard's layout with a record and the negatives of each,
    ``split.json`` (by object) and ``manifest.json``: plan, counts and the hash of every file. The
    same plan gives the same bytes, with any number of workers and after any interruption. A run in
    the folder of an earlier one makes what is missing or damaged; with more scenes in its plan, it
    adds them.

    What cannot be used (an object that does not settle, or is larger than the picture, or cannot be
    grasped; a damaged mesh) is counted, and another object takes its place.

    Args:
        plan: What to make.
        root: Folder; it must be new, empty, or made with the same plan.
        workers: Processes; 0 does the work in this process.
        progress: Shows how far the work is.

    Returns:
        What ``manifest.json`` holds.

    Raises:
        InvalidInputError: Nothing at all could be made, or a number is out of range.
        DatasetNotFoundError: The folder of meshes does not exist or holds none.
        FileError: The folder holds something else, was made with another plan, or another run is
            at work in it.
        StorageFullError: The disk is full; free some space and run again.
        MissingExtraError: Photos are asked for without Mitsuba.
    """
    if workers < 0:
        raise InvalidInputError("workers", workers, "0 or more")
    if plan.photo_samples:
        check_photo()
    root = Path(root)
    progress = progress or _quietly
    files = [] if plan.procedural else find_meshes(Path(plan.objects), remedy=_NO_MESHES)
    values = {
        **plan.to_dict(),
        "meshes": {file.name: file.hash for file in files},
        "versions": versions(photo=plan.photo_samples > 0),
    }
    check_folder(root)  # before the lock, which is a file in it
    with locked(root, "generation"):
        with progress("comparing finished scenes") as update:
            ledger = Ledger(root, values, plan.items, plan.views_of, update)
        try:
            meshes = _prepare(ledger, plan, files, workers, progress)
            _make(ledger, plan, meshes, workers, progress)
            return _finish(ledger, plan)
        finally:
            ledger.close()


def _prepare(
    ledger: Ledger,
    plan: GenerationPlan,
    files: Sequence[MeshFile],
    workers: int,
    progress: Progress,
) -> list[MeshEntry]:
    """The usable meshes, in order of their names.

    Raises:
        InvalidInputError: There is none.
    """
    missing = [file for file in files if file.name not in ledger.meshes]
    job = partial(prepare_mesh, plan, ledger.root)
    with progress("preparing meshes") as update, WorkerPool(job, workers) as pool:
        for file in missing:
            pool.submit(file)
        for done, answer in enumerate(pool.answers(), start=1):
            ledger.add_mesh(_mesh_entry(answer))
            update(done, len(missing))
    entries = [ledger.meshes[file.name] for file in files]
    for entry in entries:
        if entry.problem:
            _LOG.warning("mesh %s is left out: %s", entry.file, entry.problem)
    remarks = [f"mesh {entry.file}: {text}" for entry in entries for text in entry.remarks]
    for remark in remarks[:_REMARKS]:
        _LOG.warning(remark)
    if len(remarks) > _REMARKS:
        more = len(remarks) - _REMARKS
        _LOG.warning("%d more remarks about meshes will be in manifest.json", more)
    usable = [entry for entry in entries if not entry.problem]
    if files and not usable:
        raise InvalidInputError(
            f"meshes of {plan.objects}", f"{len(files)}, none of which is usable", "at least one"
        )
    return usable


def _mesh_entry(answer: Answer[MeshFile, MeshEntry]) -> MeshEntry:
    """The entry; of a mesh that broke its worker, one that says so.

    Raises:
        GraspmapError: The work cannot go on.
    """
    if answer.result is not None:
        return answer.result
    reason, detail = _blame(answer.error)
    file = answer.task
    return MeshEntry(file.name, file.hash, file.id, problem=f"{reason}: {detail}")


def _make(
    ledger: Ledger,
    plan: GenerationPlan,
    meshes: Sequence[MeshEntry],
    workers: int,
    progress: Progress,
) -> None:
    """Make the items that are not finished."""
    scenes = {item: len(entry.scenes) for item, entry in ledger.items.items()}
    rejects: dict[int, Counter[str]] = {}
    told: set[tuple[str, ...]] = set()
    job = partial(make_item, plan, ledger.root, meshes)
    with progress("generating scenes") as update, WorkerPool(job, workers) as pool:
        for item in range(plan.items):
            if item not in ledger.items:
                pool.submit(Attempt(item, 0))
        update(sum(scenes.values()), plan.scenes)
        for answer in pool.answers():
            item, number = answer.task.item, answer.task.number
            count = rejects.setdefault(item, Counter())
            entry = answer.result
            if not isinstance(entry, ItemEntry):
                rejected = entry if entry is not None else _broken(answer.error)
                count.update(rejected.rejects)
                _tell(rejected, told, quiet=plan.procedural)
                if number + 1 < ATTEMPTS:
                    pool.submit(Attempt(item, number + 1), first=True)
                    continue
                entry = ItemEntry(item, (), {})
            entry = ItemEntry(item, entry.scenes, dict(count + Counter(entry.rejects)), entry.part)
            ledger.add_item(entry)
            scenes[item] = len(entry.scenes)
            if len(scenes) >= _HOPELESS:
                _check_hope(scenes, ledger)
            update(sum(scenes.values()), plan.scenes)
    _check_hope(scenes, ledger)


def _blame(error: Exception | None) -> tuple[str, str]:
    """Reason and detail of a failure that belongs to an object; any other is raised.

    Raises:
        GraspmapError: The disk is full, a file cannot be used, or workers are killed from outside.
        MemoryError: There is too little memory.
    """
    assert error is not None  # an answer without result has one
    if isinstance(error, WorkerDiedError):
        if error.killed:
            raise InvalidInputError(
                "memory or patience of the system",
                f"short: {error}",
                "fewer workers; run again, finished scenes are kept",
            )
        return "crashed", str(error)
    if isinstance(error, FileError | MemoryError):
        raise error
    if isinstance(error, GraspmapError):
        return "refused", str(error)
    _LOG.error("a defect of graspmap, please report it: %s", error)
    return "defect", str(error).strip().rpartition("\n")[2]


def _broken(error: Exception | None) -> Rejected:
    reason, detail = _blame(error)
    return Rejected(reason, (), detail, {reason: 1})


def _tell(rejected: Rejected, told: set[tuple[str, ...]], *, quiet: bool) -> None:
    """Say once of each object of the user why it cannot be used."""
    usual = quiet and rejected.reason not in ("crashed", "refused")
    key = (rejected.reason, *rejected.objects)
    if not usual and key not in told:
        told.add(key)
        names = f"{', '.join(rejected.objects)}: " if rejected.objects else ""
        _LOG.warning("%s%s; another object takes its place", names, rejected.detail)


def _check_hope(scenes: Mapping[int, int], ledger: Ledger) -> None:
    if scenes and not any(scenes.values()):
        why = ledger.summary()["counts"]["rejects"]
        raise InvalidInputError(
            "plan",
            f"one that gives no scene ({', '.join(f'{n} {reason}' for reason, n in why.items())})",
            "objects that the gripper can hold and the camera sees whole",
        )


def _finish(ledger: Ledger, plan: GenerationPlan) -> dict[str, Any]:
    split = _split(ledger, plan)
    further = []
    if split is not None:
        split.write(ledger.root / SPLIT)
        further.append(ledger.root / SPLIT)
    return ledger.finish(further)


def _split(ledger: Ledger, plan: GenerationPlan) -> Split | None:
    """An object-wise split; None where there are too few objects for one."""
    scenes = JacquardScenes(ledger.root)
    known: dict[str, list[str]] = {part: [] for part in _PARTS}
    for entry in ledger.items.values():
        if entry.part is not None:
            known[entry.part] += [scene.id for scene in entry.scenes]
    if any(known.values()):
        order = {name: i for i, name in enumerate(scenes.ids)}
        parts = {part: tuple(sorted(ids, key=order.__getitem__)) for part, ids in known.items()}
        return (
            Split(parts, "object", plan.seed, fingerprint(scenes)) if all(known.values()) else None
        )
    objects = {scenes.object_id(i) for i in range(len(scenes))}
    if len(objects) < len(_PARTS):
        _LOG.info("no split.json: it takes scenes of at least %d objects", len(_PARTS))
        return None
    return make_split(scenes, seed=plan.seed)


@contextmanager
def _quietly(title: str) -> Iterator[Update]:  # noqa: ARG001
    yield lambda done, total: None  # noqa: ARG005
