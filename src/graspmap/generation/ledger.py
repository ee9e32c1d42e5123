"""The ledger of a data set being made: what is finished, kept so that no kill can spoil it.

While a run goes on, ``unfinished.jsonl`` in its folder holds the plan and a line for each finished
item, each with the hashes of its files. At the end it becomes ``manifest.json``, which holds the
same and the counts. A later run with the same plan goes on from either, after comparing the hashes:
what is missing or damaged is made again.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from graspmap.data.fingerprint import MANIFEST
from graspmap.errors import FileError, FileFormatError, storage_errors
from graspmap.files import file_hash, read_text, remove_parts, write_text
from graspmap.generation.entries import (
    MODELS,
    Entry,
    ItemEntry,
    MeshEntry,
    entry_from_dict,
    manifest_content,
    manifest_entries,
)

UNFINISHED = "unfinished.jsonl"
SPLIT = "split.json"

_FORMAT = "graspmap-manifest-1"
_STAGING = ".staging"
_ANEW = "choose another folder, or delete this one to begin anew"

Progress = Callable[[int, int], None]


class Ledger:
    """What of a data set is finished. Whoever makes one holds the folder alone.

    Args:
        root: Folder of the data set; it must be new, empty, or made with the same plan (with fewer
            scenes at most).
        plan: The plan's plain values.
        items: Number of items that there are to be.
        views_of: Gives the number of scenes that an item is to have.
        progress: Called with (done, total) while finished scenes are compared with their hashes.

    Attributes:
        items: Finished items by number.
        meshes: Meshes by file.

    Raises:
        FileError: The folder holds something else, or was made with another plan.
        FileFormatError: The ledger in it is damaged.
        StorageFullError: The disk is full.
    """

    def __init__(
        self,
        root: Path,
        plan: Mapping[str, Any],
        items: int,
        views_of: Callable[[int], int],
        progress: Progress | None = None,
    ) -> None:
        self.root, self.plan, self._views_of = root, dict(plan), views_of
        self.items: dict[int, ItemEntry] = {}
        self.meshes: dict[str, MeshEntry] = {}
        self._redo: dict[int, ItemEntry] = {}
        other_versions = self._read()
        self._clean()
        self._verify(progress)
        if other_versions and len(self.items) < items:
            self._refuse(other_versions)  # scenes of two kinds would lie in one data set
        lines: list[dict[str, Any]] = [{"format": _FORMAT, "plan": self.plan}]
        lines += [{"mesh": asdict(entry)} for entry in self.meshes.values()]
        lines += [{"redo": asdict(entry)} for entry in self._redo.values()]
        lines += [{"item": asdict(entry)} for entry in self.items.values()]
        write_text(root / UNFINISHED, "".join(map(_line, lines)), durable=True)
        with storage_errors(root / UNFINISHED):
            for name in (MANIFEST, SPLIT):  # they speak for a whole data set
                (root / name).unlink(missing_ok=True)
            self._journal = (root / UNFINISHED).open("ab")

    def close(self) -> None:
        """Let go of the journal, and remove what workers did not finish."""
        self._journal.close()
        shutil.rmtree(self.root / _STAGING, ignore_errors=True)

    def add_item(self, entry: ItemEntry) -> None:
        """Enter a finished item and move its files from the staging folder to their places.

        Raises:
            StorageFullError: The disk is full.
        """
        # First the line: a file in its place is always one that the ledger knows.
        self._append({"item": asdict(entry)})
        with storage_errors(self.root):
            staging = staging_folder(self.root, entry.item)
            for path in entry.files:
                target = self.root / path
                target.parent.mkdir(parents=True, exist_ok=True)
                (staging / path).replace(target)
            shutil.rmtree(staging, ignore_errors=True)
            self.items[entry.item] = entry
            self._remove_redone(entry.item)

    def add_mesh(self, entry: MeshEntry) -> None:
        """Enter a prepared or refused mesh.

        Raises:
            StorageFullError: The disk is full.
        """
        self._append({"mesh": asdict(entry)})
        self.meshes[entry.file] = entry

    def summary(self) -> dict[str, Any]:
        """What is finished by now, as the manifest says it."""
        items = [self.items[i] for i in sorted(self.items)]
        meshes = [self.meshes[name] for name in sorted(self.meshes)]
        return {"format": _FORMAT, **manifest_content(self.plan, items, meshes)}

    def finish(self, further: Iterable[Path] = ()) -> dict[str, Any]:
        """Write the manifest; the data set is whole.

        Args:
            further: Files of the data set that belong to no item, for their hashes.

        Returns:
            What the manifest holds.

        Raises:
            StorageFullError: The disk is full.
        """
        content = self.summary()
        own = {path.relative_to(self.root).as_posix(): file_hash(path) for path in further}
        content["files"] = dict(sorted({**content["files"], **own}.items()))
        write_text(self.root / MANIFEST, json.dumps(content, indent=1) + "\n", durable=True)
        self.close()
        (self.root / UNFINISHED).unlink()
        return content

    def _append(self, values: dict[str, Any]) -> None:
        with storage_errors(self.root / UNFINISHED):
            self._journal.write(_line(values).encode())
            self._journal.flush()
            os.fsync(self._journal.fileno())

    def _read(self) -> list[str]:
        """Take over what an earlier run left.

        Returns:
            Which versions were others, where a whole data set was made with them.
        """
        if (self.root / UNFINISHED).exists():
            plan, entries = _read_journal(self.root / UNFINISHED)
        elif (self.root / MANIFEST).exists():
            plan, entries = _read_manifest(self.root / MANIFEST)
        else:
            check_folder(self.root)
            return []
        found = differences(plan, self.plan)
        found = [text for text in found if not text.startswith("gripper.description:")]
        if plan.get("scenes", 0) <= self.plan["scenes"]:
            found = [text for text in found if not text.startswith("scenes:")]
        whole = not (self.root / UNFINISHED).exists()
        versions = [text for text in found if whole and text.startswith("versions.")]
        if len(found) > len(versions):
            self._refuse(found)
        # What is there stays what it is.
        self.plan |= {key: plan[key] for key in ("versions", "gripper") if key in plan}
        for redo, entry in entries:
            if isinstance(entry, MeshEntry):
                self.meshes[entry.file] = entry
            elif redo:
                self._redo[entry.item] = entry
            else:
                self.items[entry.item] = entry
        return versions

    def _refuse(self, found: list[str]) -> None:
        raise FileError(self.root, f"was made with another plan ({'; '.join(found[:5])})", _ANEW)

    def _clean(self) -> None:
        """Remove what a killed run left half done."""
        with storage_errors(self.root):
            shutil.rmtree(self.root / _STAGING, ignore_errors=True)
            for folder in (self.root, self.root / MODELS):
                remove_parts(folder)
            for item in self.items:
                self._remove_redone(item)

    def _remove_redone(self, item: int) -> None:
        """Remove the files that an item had before it was made again, and has no more."""
        before = self._redo.pop(item, None)
        for path in (before.files.keys() if before else set()) - self.items[item].files.keys():
            (self.root / path).unlink(missing_ok=True)

    def _verify(self, progress: Progress | None) -> None:
        """Set aside entries whose files are missing or changed, and items that want more views."""
        entries: list[Entry] = [*self.meshes.values(), *self.items.values()]
        with ThreadPoolExecutor(os.cpu_count()) as pool:  # hashing lets other threads run
            whole = pool.map(self._is_whole, entries)
            for done, (entry, good) in enumerate(zip(entries, whole, strict=True), start=1):
                if progress is not None:
                    progress(done, len(entries))
                if good:
                    continue
                if isinstance(entry, MeshEntry):
                    del self.meshes[entry.file]
                else:
                    self._redo[entry.item] = self.items.pop(entry.item)

    def _is_whole(self, entry: Entry) -> bool:
        if isinstance(entry, ItemEntry) and entry.scenes:
            wanted = self._views_of(entry.item)
            if len(entry.scenes) != wanted:
                return False
        try:
            return all(file_hash(self.root / path) == v for path, v in entry.files.items())
        except FileError:
            return False


def check_folder(root: Path) -> None:
    """See that a folder is new, empty, or a data set that was made; nothing is written.

    Raises:
        FileError: It holds something else.
    """
    if not root.is_dir() or (root / UNFINISHED).exists() or (root / MANIFEST).exists():
        return
    strange = sorted(path.name for path in root.iterdir() if path.name != ".lock")
    if strange:
        raise FileError(root, f"holds something else than generated scenes ({strange[0]})", _ANEW)


def staging_folder(root: Path, item: int) -> Path:
    """Where the files of an item lie until all of them are written."""
    return root / _STAGING / str(item)


def differences(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Where two nested dictionaries differ, as ``key: old -> new``."""
    found = []
    for key in dict.fromkeys([*old, *new]):
        a, b = old.get(key), new.get(key)
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            found += differences(a, b, f"{prefix}{key}.")
        elif a != b:
            found.append(f"{prefix}{key}: {_short(a)} -> {_short(b)}")
    return found


def _short(value: Any) -> str:
    text = "none" if value is None else str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _line(values: dict[str, Any]) -> str:
    return json.dumps(values, separators=(",", ":")) + "\n"


def _read_journal(path: Path) -> tuple[dict[str, Any], Iterator[tuple[bool, Entry]]]:
    """The plan, and pairs of whether it is to be made again, and entry."""
    lines = read_text(path).split("\n")
    # What follows the last line end was cut short by a kill.
    values = [_parse(path, number, line) for number, line in enumerate(lines[:-1], start=1)]
    if not values or values[0].get("format") != _FORMAT:
        raise FileFormatError(path, "is no ledger of this version of graspmap", _ANEW)
    return values[0]["plan"], iter([_entry(path, line) for line in values[1:]])


def _parse(path: Path, number: int, line: str) -> dict[str, Any]:
    try:
        values = json.loads(line)
        if isinstance(values, dict):
            return values
    except ValueError:
        pass
    raise FileFormatError(path, f"line {number} is damaged", _ANEW)


def _entry(path: Path, values: dict[str, Any]) -> tuple[bool, Entry]:
    try:
        ((kind, content),) = values.items()
        return kind == "redo", entry_from_dict(kind, content)
    except (ValueError, KeyError) as error:
        raise FileFormatError(path, f"has a damaged line ({error})", _ANEW) from error


def _read_manifest(path: Path) -> tuple[dict[str, Any], Iterator[tuple[bool, Entry]]]:
    try:
        content = json.loads(read_text(path))
        if content["format"] != _FORMAT:
            raise ValueError("format")
        plan: dict[str, Any] = content["plan"]
        return plan, ((False, entry) for entry in manifest_entries(content))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(
            path, f"is no manifest of this version of graspmap, or a damaged one ({error})", _ANEW
        ) from error
