"""Packed store: the scenes of a data set in the input frame, memory-mapped for training.

A store is a folder ``<key>`` with one array file for each kind of picture, the labels, and
``store.json``. The key is a hash of everything that the pictures and labels follow from: the
content of every source file, the reader's options, the order of the scenes, size and view. So a
store is never stale: a changed byte anywhere makes another key. It is built beside its place and
renamed when whole, under a lock that the operating system releases when a builder dies.

Letters in shapes: N scenes, S the side of the input, M labelled grasps of all scenes together.
"""

from __future__ import annotations

import importlib
import json
import logging
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from graspmap.data import images
from graspmap.data.fingerprint import FileHashes, scenes_key
from graspmap.data.scene import Mask, Scene, Scenes
from graspmap.data.table import Table, find_table
from graspmap.data.windows import View, close_up_m, input_window
from graspmap.errors import FileError, GraspmapError, InvalidInputError, storage_errors
from graspmap.files import write_text
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.transforms import RigidTransform

# Without POSIX locks two builders do the work twice, and the first one's result is kept.
fcntl: Any = importlib.import_module("fcntl") if os.name == "posix" else None

_LOG = logging.getLogger(__name__)
_VERSION = 8  # counts up whenever the same sources would give other bytes
_META = "store.json"
_PICTURES: dict[str, tuple[Any, tuple[int, ...]]] = {
    "rgb": (np.uint8, (3,)),
    "depth": (np.float32, ()),
    "mask": (np.bool_, ()),
    "measured": (np.bool_, ()),  # only where the depth has holes, which are filled in "depth"
}
_SCENE_PICTURES = ("rgb", "depth", "mask")
_LABELS = ("grasps", "negatives")
_LABEL_FILES = (".npy", "_offsets.npy")
_REMEDY = "delete the folder, it is built again at the next use"

Progress = Callable[[int, int], None]
"""Called with the number of scenes done and the number of all."""

Floats = NDArray[np.float64]


class Store(Scenes):
    """The scenes of a built store, in their input frame; random access, picklable.

    Pictures are read-only views of the memory-mapped files, depth is filled, grasps and camera are
    those of the input frame.

    Args:
        root: Folder of the store.

    Attributes:
        size: Side of every picture, pixels.

    Raises:
        FileError: The folder is no whole store.
    """

    kind = "store"

    def __init__(self, root: Path | str) -> None:
        self.root = Path(root)
        self._meta = _read_meta(self.root)
        self.size = self._meta["size"]
        self.ids = tuple(self._meta["ids"])
        self._arrays = _map_arrays(self.root, self._meta)

    @property
    def key(self) -> str:
        """Hash of everything that the content follows from."""
        return self.root.name

    def matrix(self, index: int) -> Floats:
        """(3, 3) map from the picture of scene ``index`` to its input frame."""
        return np.array(self._arrays["matrix"][index])

    def inside(self, index: int) -> Mask:
        """(S, S) where the input of scene ``index`` shows its picture, not the repeated border."""
        shown = np.ones(self.shape(index), np.bool_)
        return images.warp(shown, self.matrix(index), self.size, fill=False)

    def measured(self, index: int) -> Mask | None:
        """(S, S) True where the depth of scene ``index`` was measured and not filled in.

        A pixel counts as measured where at least half of what it shows was. None where there is no
        hole at all, or no depth.
        """
        found = self._meta["scenes"][index]["measured"]
        return self._arrays["measured"][index] if found else None

    def table(self, index: int) -> Table | None:
        """The table behind the input of scene ``index``; None without depth."""
        numbers = self._meta["scenes"][index]["table"]
        return (
            None if numbers is None else Table(np.array(numbers["inverse"]), tuple(numbers["box"]))
        )

    def shape(self, index: int) -> tuple[int, int]:
        """(rows, columns) of the picture of scene ``index`` before it was packed."""
        rows, columns = self._meta["scenes"][index]["shape"]
        return rows, columns

    def has(self, index: int, picture: str) -> bool:
        """Whether scene ``index`` has a picture: ``"rgb"``, ``"depth"`` or ``"mask"``."""
        return bool(self._meta["scenes"][index][picture])

    def labels(self, index: int) -> dict[str, str]:
        """Class names of scene ``index`` by kind."""
        names: dict[str, str] = self._meta["scenes"][index]["labels"]
        return dict(names)

    def read(self, index: int) -> Scene:
        """Scene number ``index``, without copying its pictures."""
        facts = self._meta["scenes"][index]
        pictures = {name: self._arrays[name][index] for name in _SCENE_PICTURES if facts[name]}
        return Scene(
            id=self.ids[index],
            **pictures,
            grasps=self._labels("grasps", index),
            negatives=self._labels("negatives", index),
            camera=Camera(**facts["camera"]) if facts["camera"] else None,
            T_world_camera=(
                RigidTransform.from_matrix(facts["T_world_camera"])
                if facts["T_world_camera"]
                else None
            ),
            object_id=facts["object_id"],
            labels=facts["labels"],
        )

    def read_grasps(self, index: int) -> Grasps | None:
        """Labelled grasps of scene ``index`` in its input frame."""
        return self._labels("grasps", index)

    def files(self, index: int) -> tuple[Path, ...]:  # noqa: ARG002  # all scenes share them
        """The files of the store."""
        return tuple(self.root / name for name in self._meta["files"])

    def object_id(self, index: int) -> str | None:
        """Object of scene ``index``."""
        name: str | None = self._meta["scenes"][index]["object_id"]
        return name

    def _labels(self, name: str, index: int) -> Grasps | None:
        if not self._meta["scenes"][index][name]:
            return None
        start, stop = self._arrays[f"{name}_offsets"][index : index + 2]
        rows = self._arrays[name][start:stop]
        return Grasps(rows[:, :2], *(rows[:, column] for column in range(2, 6)))

    def __getstate__(self) -> dict[str, Any]:
        """All but the mapped files: a worker opens them itself."""
        return {k: v for k, v in self.__dict__.items() if k != "_arrays"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._arrays = _map_arrays(self.root, self._meta)


def open_store(
    scenes: Scenes,
    folder: Path | str,
    *,
    size: int,
    view: View = "contain",
    progress: Progress | None = None,
    workers: int | None = None,
) -> Store:
    """The packed store of some scenes; it is built where it does not exist yet.

    Unchanged files are not read again to see that they are: their hashes are kept with their size
    and times, as git does. Several processes may open the same store: one builds, the others wait.

    Args:
        scenes: What to pack.
        folder: Where stores are kept, for any number of data sets and settings.
        size: Side of the input, pixels.
        view: Which square of a picture is used, see `graspmap.data.windows.input_window`.
        progress: Called after each scene while building.
        workers: Threads that read scenes while building; None for one per processor, at most 8.

    Returns:
        The store, scenes in the order of ``scenes``.

    Raises:
        InvalidInputError: There are no scenes, size or view is wrong, or the depth of a scene is
            nothing but holes; the error names the scene.
        FileError: A source file is missing or damaged, or was changed meanwhile.
        StorageFullError: The disk has no room for the store; nothing of it is left behind.
    """
    if not len(scenes):
        raise InvalidInputError("scenes to pack", "none", "at least one")
    close_up_m(view)  # complains before any work is done
    folder = Path(folder)
    with storage_errors(folder):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise FileError(
                folder, "is no folder", "choose another folder for the store"
            ) from error
        hashes = FileHashes(folder / "files.json")
        settings = {"version": _VERSION, "size": int(size), "view": view}
        key = scenes_key(scenes, hashes, settings)
        hashes.save()
    place = folder / key
    if not _is_whole(place):
        with storage_errors(place), _locked(folder / f"{key}.lock"):
            _remove_leftovers(folder, key)
            if not _is_whole(place):  # the one we waited for may have built it
                shutil.rmtree(place, ignore_errors=True)
                if place.is_file():
                    place.unlink()
                builder = _Builder(scenes, place, int(size), view)

                def unchanged() -> bool:
                    return scenes_key(scenes, hashes, settings) == key

                builder.run(progress, workers or min(8, os.cpu_count() or 1), unchanged)
    return Store(place)


@dataclass(frozen=True, eq=False)
class _Packed:
    """One scene on its way into the store."""

    pictures: dict[str, NDArray[Any]]
    labels: dict[str, Floats | None]
    matrix: Floats
    facts: dict[str, Any]


class _Builder:
    """Writes one store, beside its place until it is whole."""

    def __init__(self, scenes: Scenes, place: Path, size: int, view: View) -> None:
        self._scenes, self._place, self._size, self._view = scenes, place, size, view
        self._part = place.with_name(f"{place.name}.part-{os.getpid()}")
        self._arrays: dict[str, NDArray[Any]] = {}

    def run(self, progress: Progress | None, workers: int, unchanged: Callable[[], bool]) -> None:
        """Build; ``unchanged`` is asked at the end whether the sources are still those of the key.

        Raises:
            FileError: They are not.
        """
        self._part.mkdir()
        try:
            self._write(progress, workers)
            if not unchanged():
                raise FileError(
                    self._scenes.root,
                    "was changed while its scenes were packed",
                    "run again when nothing writes to it",
                )
            self._arrays.clear()
            self._part.rename(self._place)
        except BaseException:  # Ctrl-C too: nothing half-written stays
            self._arrays.clear()
            shutil.rmtree(self._part, ignore_errors=True)
            if not _is_whole(self._place):  # else another builder was faster; its store is ours
                raise
        _LOG.info("packed %d scenes into %s", len(self._scenes), self._place)

    def _write(self, progress: Progress | None, workers: int) -> None:
        count = len(self._scenes)
        facts, matrices = [], np.zeros((count, 3, 3))
        labels: dict[str, list[Floats | None]] = {name: [] for name in _LABELS}
        for i, packed in enumerate(self._packed(workers)):
            for name, picture in packed.pictures.items():
                self._array(name)[i] = picture
            for name in _LABELS:
                labels[name].append(packed.labels[name])
            facts.append(packed.facts)
            matrices[i] = packed.matrix
            if progress is not None:
                progress(i + 1, count)
        np.save(self._part / "matrix.npy", matrices)
        for name, parts in labels.items():
            lengths = [0 if rows is None else len(rows) for rows in parts]
            rows = [rows for rows in parts if rows is not None]
            np.save(self._part / f"{name}.npy", np.concatenate([np.zeros((0, 6)), *rows]))
            np.save(self._part / f"{name}_offsets.npy", np.cumsum([0, *lengths], dtype=np.int64))
        for array in self._arrays.values():
            array.flush()  # type: ignore[attr-defined]  # these are memory maps
        self._finish(facts)

    def _finish(self, facts: list[dict[str, Any]]) -> None:
        """Bring all to disk, then the description: it is what makes the folder a store."""
        sizes = {}
        for path in sorted(self._part.iterdir()):
            _sync(path)
            sizes[path.name] = path.stat().st_size
        meta: dict[str, Any] = {
            "version": _VERSION,
            "source": f"{self._scenes.kind}:{self._scenes.root}",
            "size": self._size,
            "view": self._view,
            "files": sizes,
            "ids": self._scenes.ids,
            "scenes": facts,
        }
        write_text(self._part / _META, json.dumps(meta), durable=True)

    def _packed(self, workers: int) -> Iterator[_Packed]:
        """All scenes in order; a few are read ahead, since decoding does not hold Python's lock."""
        count, ahead = len(self._scenes), 2 * workers
        with ThreadPoolExecutor(workers) as pool:
            for start in range(0, count, ahead):
                yield from pool.map(self._pack, range(start, min(start + ahead, count)))

    def _pack(self, index: int) -> _Packed:
        scene = self._scenes.read(index)
        try:
            matrix = input_window(
                scene.shape, self._size, view=self._view, depth_m=scene.depth, camera=scene.camera
            )
        except InvalidInputError as error:
            raise InvalidInputError(
                f"{error.name} of scene {scene.id}", error.found, error.allowed
            ) from error
        pictures: dict[str, NDArray[Any]] = {}
        table: Table | None = None
        if scene.rgb is not None:
            pictures["rgb"] = images.warp(scene.rgb, matrix, self._size)
        if scene.mask is not None:
            pictures["mask"] = images.warp(scene.mask, matrix, self._size)
        if scene.depth is not None:
            try:
                pictures["depth"] = images.warp_depth(scene.depth, matrix, self._size)
            except InvalidInputError as error:
                raise InvalidInputError(
                    f"depth of scene {scene.id}", error.found, error.allowed
                ) from error
            table = find_table(scene.depth).transformed(matrix)
            measured = np.isfinite(scene.depth)
            if not measured.all():
                share = images.warp(measured.astype(np.float32), matrix, self._size)
                pictures["measured"] = share >= 0.5
        camera = None
        if scene.camera is not None:
            camera = asdict(scene.camera.transformed(matrix, self._size, self._size))
        grasps = {"grasps": scene.grasps, "negatives": scene.negatives}
        facts: dict[str, Any] = {name: name in pictures for name in _PICTURES}
        facts |= {name: value is not None for name, value in grasps.items()}
        facts |= {"object_id": scene.object_id, "labels": scene.labels, "camera": camera}
        # A crop or zoom leaves the camera where it is.
        pose = scene.T_world_camera
        facts["T_world_camera"] = None if pose is None else pose.matrix.tolist()
        facts["shape"] = scene.shape
        facts["table"] = (
            None if table is None else {"inverse": table.inverse.tolist(), "box": list(table.box)}
        )
        labels = {name: _rows(value, matrix) for name, value in grasps.items()}
        return _Packed(pictures, labels, matrix, facts)

    def _array(self, name: str) -> NDArray[Any]:
        """The file of one kind of picture, made at its first use with all its space taken."""
        if name not in self._arrays:
            dtype, channels = _PICTURES[name]
            shape = (len(self._scenes), self._size, self._size, *channels)
            path = self._part / f"{name}.npy"
            # Writing to a mapped file on a full disk would kill the process: take the space first.
            with path.open("wb") as file:
                header = {"descr": np.dtype(dtype).str, "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, header)
                file.flush()
                _allocate(file, file.tell() + int(np.prod(shape)) * np.dtype(dtype).itemsize)
            self._arrays[name] = np.load(path, mmap_mode="r+")
        return self._arrays[name]


def _rows(grasps: Grasps | None, matrix: Floats) -> Floats | None:
    """(M, 6) x, y, angle, width, height, quality in the input frame."""
    if grasps is None:
        return None
    g = grasps.transformed(matrix)
    return np.column_stack([g.center, g.angle, g.width, g.height, g.quality])


def _allocate(file: BinaryIO, size: int) -> None:
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
    else:
        file.truncate(size)


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _read_meta(root: Path) -> dict[str, Any]:
    """The description of a store, after a check that its files are there in full length."""
    try:
        meta: dict[str, Any] = json.loads((root / _META).read_text(encoding="utf-8"))
        sizes = {name: (root / name).stat().st_size for name in meta["files"]}
        needed = {"matrix.npy", *(f"{name}{end}" for name in _LABELS for end in _LABEL_FILES)}
        whole = (
            sizes == meta["files"]
            and needed <= set(sizes)
            and isinstance(meta["size"], int)
            and len(meta["ids"]) == len(meta["scenes"])
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise FileError(root, f"no whole store ({error})", _REMEDY) from error
    if meta.get("version") != _VERSION or not whole:
        raise FileError(root, "a damaged store, or one of another version", _REMEDY)
    return meta


def _is_whole(root: Path) -> bool:
    try:
        Store(root)
    except GraspmapError:
        if root.exists():
            _LOG.warning("%s is damaged and is built again", root)
        return False
    return True


def _map_arrays(root: Path, meta: dict[str, Any]) -> dict[str, NDArray[Any]]:
    # As plain arrays: slices of np.memmap objects cost ten times as much.
    try:
        return {
            name.removesuffix(".npy"): np.asarray(np.load(root / name, mmap_mode="r"))
            for name in meta["files"]
        }
    except (OSError, ValueError) as error:
        raise FileError(root, f"a damaged store ({error})", _REMEDY) from error


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock file; wait while another process holds it."""
    with path.open("w") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                _LOG.info("another process builds %s; waiting", path.stem)
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
    # The file stays: removing it would let two builders hold locks on two files of one name.


def _remove_leftovers(folder: Path, own: str) -> None:
    """Remove what killed builders left: parts whose lock nobody holds."""
    for part in folder.glob("*.part-*"):
        key = part.name.partition(".part-")[0]
        if key == own or (fcntl is not None and _is_free(folder / f"{key}.lock")):
            shutil.rmtree(part, ignore_errors=True)


def _is_free(lock: Path) -> bool:
    with lock.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True
