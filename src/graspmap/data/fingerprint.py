"""What a data set is, in one hash: the content of its files and how they are read."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import time
from pathlib import Path
from typing import Any

from graspmap.data.scene import Scenes
from graspmap.data.split import fingerprint
from graspmap.errors import MissingFileError
from graspmap.files import file_hash, write_text

MANIFEST = "manifest.json"
"""File in which `graspmap.generation` keeps the hash of every file of a finished data set."""

_LOG = logging.getLogger(__name__)
_DIGEST = 16  # bytes: no two of 2^40 files will share one by chance
_RACY_NS = 2_000_000_000  # the coarsest clock of a usual file system (FAT) ticks every 2 s


class FileHashes:
    """Content hashes of files, remembered with size, times and inode, as git's index does.

    A file that was changed within the last two seconds is not remembered: it might change again
    within one tick of the file system's clock and look the same.

    Args:
        index: JSON file in which the hashes are kept; a missing or damaged one is started anew.
    """

    def __init__(self, index: Path) -> None:
        self._index = index
        self._known: dict[str, list[Any]] = {}
        self._changed = False
        try:
            known = json.loads(index.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            known = {}
        if isinstance(known, dict):
            self._known = known

    def __call__(self, path: Path) -> str:
        """Hash of the content of a file.

        Raises:
            MissingFileError: The file does not exist or cannot be read.
        """
        name = os.path.abspath(path)  # noqa: PTH100  # resolve() would cost a call per folder
        try:
            stat = os.stat(name)  # noqa: PTH116  # twice as fast as Path.stat, for 10^5 files
            stamp = [stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino]
            known = self._known.get(name)
            if isinstance(known, list) and known[:-1] == stamp:
                return str(known[-1])
            with Path(name).open("rb") as file:
                digest = hashlib.file_digest(file, _blake2b).hexdigest()
        except OSError as error:
            raise MissingFileError(
                path, f"cannot be read ({error.strerror})", "restore it or remove its scene"
            ) from error
        if max(stat.st_mtime_ns, stat.st_ctime_ns) < time.time_ns() - _RACY_NS:
            self._known[name] = [*stamp, digest]
            self._changed = True
        return digest

    def save(self) -> None:
        """Keep what was learnt; the file is replaced in one step."""
        if not self._changed:
            return
        write_text(self._index, json.dumps(self._known))
        self._changed = False


def data_hash(scenes: Scenes) -> str:
    """What a whole data set is, in one hash that a user can compare with a published one.

    Args:
        scenes: All of its scenes.

    Returns:
        ``manifest:`` and the hash of its manifest.json, which holds the hash of every file, where
        graspmap generated it; else ``scenes:`` and the hash of its ids and objects.

    Raises:
        FileError: The manifest cannot be read.
    """
    manifest = scenes.root / MANIFEST
    if manifest.is_file():
        return f"manifest:{file_hash(manifest)}"
    return f"scenes:{fingerprint(scenes)}"


def scenes_key(scenes: Scenes, hashes: FileHashes, settings: dict[str, Any]) -> str:
    """Hash of some scenes as they are read, and of what is done with them.

    Args:
        scenes: Their ids and order count, their objects, the options of the reader, and the place
            below the root and the content of each of their files; the root itself does not.
        hashes: Gives the content of files.
        settings: Anything else that counts, as JSON values.

    Returns:
        32 hexadecimal digits.

    Raises:
        MissingFileError: A file cannot be read.
    """
    _LOG.info("checking the files of %d scenes in %s", len(scenes), scenes.root)
    digest = _blake2b()
    head = {"kind": scenes.kind, "options": _options(scenes), "settings": settings}
    digest.update(json.dumps(head, sort_keys=True).encode())
    for i, name in enumerate(scenes.ids):
        files = [(_below(path, scenes.root), hashes(path)) for path in scenes.files(i)]
        digest.update(json.dumps([name, scenes.object_id(i), files]).encode())
    return str(digest.hexdigest())


def _blake2b() -> Any:
    return hashlib.blake2b(digest_size=_DIGEST)


def _below(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name


def _options(scenes: Scenes) -> dict[str, Any]:
    """Plain values that a reader carries, such as which depth it gives; of a subset, its parent's.

    Taken from the object itself, so that a reader with a new option needs no change here.
    """
    found: dict[str, Any] = {}
    for name, value in vars(scenes).items():
        if isinstance(value, Scenes):
            found |= _options(value)
        elif value is None or isinstance(value, str | int | float):
            found[name.lstrip("_")] = value
    return found
