"""`evaluate_egad`: a detector tried on every mesh of a folder, by any number of workers."""

from __future__ import annotations

import logging
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path

from graspmap import __version__
from graspmap.errors import FileError, InvalidInputError
from graspmap.evaluation.egad.attempt import EgadTry, try_object
from graspmap.evaluation.egad.plan import DetectorSource, EgadPlan, GripperDetector
from graspmap.evaluation.egad.results import EgadEvaluation
from graspmap.evaluation.journal import Journal, open_journal
from graspmap.evaluation.trial_results import UNFINISHED_FILE
from graspmap.evaluation.trials import SCENES_A_WORKER, blame
from graspmap.files import file_hash
from graspmap.generation.entries import MODELS, MeshEntry, entry_from_dict
from graspmap.generation.mesh_folder import MeshFile, find_meshes, prepare_mesh
from graspmap.generation.model_file import read_model
from graspmap.generation.plan import GenerationPlan
from graspmap.generation.workers import WorkerPool
from graspmap.inference.threads import threads_of

MODELS_FOLDER = "egad-models"
"""Prepared meshes of a run that is not finished, below its folder."""

PREPARING, TRYING = "preparing meshes", "trying grasps"
"""Titles of the two parts of the work, for its progress."""

_FORMAT = "graspmap-egad-1"
_LOG = logging.getLogger(__name__)

Update = Callable[[int, int], None]
Progress = Callable[[str], AbstractContextManager[Update]]
"""Called with a title; gives the function to call with (done, total)."""


@dataclass(frozen=True)
class _Throw:
    """Try number ``number`` at a mesh; ``index`` is its place among the usable ones."""

    index: int
    number: int


def evaluate_egad(
    meshes: Path | str,
    source: DetectorSource,
    plan: EgadPlan,
    *,
    workers: int = 1,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> EgadEvaluation:
    """Try a detector on a folder of meshes by the protocol of EGAD's authors.

    Each mesh is scaled to the gripper, and dropped ``plan.trials`` times; each time a camera sees
    it, and the detector's best grasp is tried in physics. Beside it a number of proposed grasps
    are tried, to say whether the object can be grasped as it lies.

    Meshes and tries that cannot be used are left out, counted in the result, and told as warnings.

    Args:
        meshes: The folder, searched with its subfolders. Objects that are called A0 to G6 have a
            place in EGAD's grid.
        source: Where the detector comes from.
        plan: How.
        workers: Processes; the result does not depend on it.
        folder: Finished tries are kept there until `finish` is called, so that a run that was
            stopped goes on where it was; None keeps nothing.
        progress: Shows how far the work is.

    Raises:
        DatasetNotFoundError: The folder of meshes does not exist or holds none.
        InvalidInputError: Not one mesh can be used, or not one try be made.
        StorageFullError: The disk is full.
        FileError: Another run is at work in the folder.
        WeightsError: The detector's file is missing or damaged.

    References:
        Morrison, Corke, Leitner, "EGAD! An evolved grasping analysis dataset for diversity and
        reproducibility in robotic manipulation", RA-L 2020.
    """
    if workers < 1:
        raise InvalidInputError("workers", workers, "1 or more")
    start, progress = time.monotonic(), progress or _quietly
    meshes = Path(meshes)
    files = find_meshes(meshes)
    source.load()  # a wrong one is told before the meshes are prepared
    path = None if folder is None else folder / UNFINISHED_FILE
    # More tries of each object go on from fewer.
    what = f"{__version__} {source.stamp} {replace(plan, trials=1)!r}"
    with (
        _models(folder) as root,
        open_journal(path, what, work="evaluation", pieces="parts", format=_FORMAT) as journal,
    ):
        entries = _prepare(files, plan.preparing(meshes), root, journal, workers, progress)
        usable = [entry for entry in entries if not entry.problem]
        if not usable:
            raise InvalidInputError(
                f"meshes of {meshes}", f"{len(files)}, none of which is usable", "at least one"
            )
        run = _Run(plan, source, root, usable, journal)
        tries, skipped = run.all(workers, progress)
    if not tries:
        reason = next(iter(skipped.values()))
        raise InvalidInputError(
            f"tries at {meshes}", f"{len(skipped)}, none of which can be made ({reason})", "some"
        )
    return EgadEvaluation(
        meshes=str(meshes),
        plan=plan,
        tries=tries,
        broken={entry.file: entry.problem for entry in entries if entry.problem},
        remarks={entry.file: entry.remarks for entry in usable if entry.remarks},
        skipped=skipped,
        seconds=time.monotonic() - start,
    )


def finish(folder: Path) -> None:
    """Remove what `evaluate_egad` kept in a folder to go on from, when its result is written."""
    (folder / UNFINISHED_FILE).unlink(missing_ok=True)
    shutil.rmtree(folder / MODELS_FOLDER, ignore_errors=True)


@contextmanager
def _models(folder: Path | None) -> Iterator[Path]:
    """Where prepared meshes lie."""
    if folder is not None:
        yield folder / MODELS_FOLDER
        return
    with tempfile.TemporaryDirectory(prefix="graspmap-") as name:
        yield Path(name)


def _prepare(
    files: Sequence[MeshFile],
    plan: GenerationPlan,
    root: Path,
    journal: Journal,
    workers: int,
    progress: Progress,
) -> list[MeshEntry]:
    """An entry for each mesh, in order; those of an earlier run are taken over."""
    entries = {file: _known(file, root, journal) for file in files}
    missing = [file for file, entry in entries.items() if entry is None]
    job = partial(prepare_mesh, plan, root)
    with (
        progress(PREPARING) as update,
        WorkerPool(job, _processes(workers, len(missing))) as pool,
    ):
        for file in missing:
            pool.submit(file)
        for done, answer in enumerate(pool.answers(), start=1):
            file, entry = answer.task, answer.result
            if entry is None:
                problem = blame(answer.error)
                entry = MeshEntry(file.name, file.hash, file.id, problem=problem)
            journal.add(_mesh_stamp(file), {"mesh": asdict(entry)})
            entries[file] = entry
            update(done, len(missing))
    found = [entry for entry in entries.values() if entry is not None]
    for entry in found:
        if entry.problem:
            _LOG.warning("mesh %s is left out: %s", entry.file, entry.problem)
    return found


def _known(file: MeshFile, root: Path, journal: Journal) -> MeshEntry | None:
    """What an earlier run made of a mesh; None where it is still to be prepared."""
    line = journal.find(_mesh_stamp(file))
    try:
        if line is None or not file.hash:
            return None
        entry = entry_from_dict("mesh", line["mesh"])
        assert isinstance(entry, MeshEntry)
        whole = all(file_hash(root / path) == value for path, value in entry.files.items())
    except (KeyError, ValueError, FileError):
        return None
    return entry if whole else None


def _mesh_stamp(file: MeshFile) -> str:
    return f"mesh {file.id} {file.name} {file.hash}"


@dataclass(frozen=True)
class _Job:
    """What a worker does; each loads its own detector, once.

    Args:
        plan: How the tries are made.
        source: Where the detector comes from.
        root: Above the folder of the prepared meshes.
        meshes: Their ids.
    """

    plan: EgadPlan
    source: DetectorSource
    root: Path
    meshes: tuple[str, ...]

    @cached_property
    def detector(self) -> GripperDetector:
        """The detector of this process."""
        return self.source.load()

    def __call__(self, throw: _Throw) -> EgadTry:
        """One try."""
        id = self.meshes[throw.index]
        model = read_model(self.root / MODELS / f"{id}.npz", id)
        # The bits of a network's sums depend on the number of threads.
        with threads_of(1):
            return try_object(self.plan, model, throw.number, self.detector)


class _Run:
    """The tries at all usable meshes."""

    def __init__(
        self,
        plan: EgadPlan,
        source: DetectorSource,
        root: Path,
        meshes: Sequence[MeshEntry],
        journal: Journal,
    ) -> None:
        self._plan, self._meshes, self._journal = plan, meshes, journal
        self._job = _Job(plan, source, root, tuple(mesh.id for mesh in meshes))

    def all(
        self, workers: int, progress: Progress
    ) -> tuple[tuple[EgadTry, ...], Mapping[str, str]]:
        """Every try in order, and the reason for each that could not be made."""
        order = [
            _Throw(index, number)
            for index in range(len(self._meshes))
            for number in range(self._plan.trials)
        ]
        found: dict[_Throw, EgadTry] = {}
        skipped: dict[_Throw, str] = {}
        for throw in order:
            known = self._kept(throw)
            if known is not None:
                found[throw] = known
        todo = [throw for throw in order if throw not in found]
        with (
            progress(TRYING) as update,
            WorkerPool(self._job, _processes(workers, len(todo) // SCENES_A_WORKER)) as pool,
        ):
            update(len(found), len(order))
            for throw in todo:
                pool.submit(throw)
            for done, answer in enumerate(pool.answers(), start=len(found) + 1):
                if answer.result is None:
                    skipped[answer.task] = blame(answer.error)
                else:
                    found[answer.task] = answer.result
                    self._journal.add(self._stamp(answer.task), answer.result.to_dict())
                update(done, len(order))
        self._tell(skipped)
        names = {self._name(throw): skipped[throw] for throw in order if throw in skipped}
        return tuple(found[throw] for throw in order if throw in found), names

    def _kept(self, throw: _Throw) -> EgadTry | None:
        line = self._journal.find(self._stamp(throw))
        try:
            return None if line is None else EgadTry.from_dict(line)
        except (KeyError, TypeError, ValueError):
            return None

    def _stamp(self, throw: _Throw) -> str:
        mesh = self._meshes[throw.index]
        return f"try {mesh.id} {mesh.hash} {throw.number}"

    def _name(self, throw: _Throw) -> str:
        return f"{self._meshes[throw.index].id}#{throw.number}"

    def _tell(self, skipped: Mapping[_Throw, str]) -> None:
        """Warn once of each object some of whose tries are left out."""
        for index, mesh in enumerate(self._meshes):
            reasons = [why for throw, why in skipped.items() if throw.index == index]
            if reasons:
                _LOG.warning(
                    "%d of %d tries at %s are left out: %s",
                    len(reasons),
                    self._plan.trials,
                    mesh.id,
                    reasons[0],
                )


def _processes(workers: int, tasks: int) -> int:
    """Processes that are worth starting; one worker is this process, which works at once."""
    count = min(workers, tasks)
    return count if count > 1 else 0


@contextmanager
def _quietly(title: str) -> Iterator[Update]:  # noqa: ARG001
    yield lambda done, total: None  # noqa: ARG005
