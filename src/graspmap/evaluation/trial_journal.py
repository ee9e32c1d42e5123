"""Finished scenes of a run of trials on disk, so that a stopped run goes on where it was."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any, TextIO

from graspmap.data.scene import Scenes
from graspmap.errors import storage_errors
from graspmap.evaluation.trial_results import UNFINISHED_FILE, TriedGrasp
from graspmap.files import locked
from graspmap.geometry.grasps import Grasps

_FORMAT = "graspmap-trials-1"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class SceneTrials:
    """The trials of one scene.

    Attributes:
        tried: Every grasp, by rank.
        gripper: Name of the gripper.
    """

    tried: tuple[TriedGrasp, ...]
    gripper: str


class TrialJournal:
    """Finished scenes, one line each; use `open_journal`.

    Args:
        file: Open for appending.
        finished: What an earlier run of the same plan left, by stamp.
    """

    def __init__(self, file: TextIO | None, finished: Mapping[str, SceneTrials]) -> None:
        self._file, self._finished = file, finished

    def find(self, stamp: str) -> SceneTrials | None:
        """The trials with this stamp; None where they are still to be made."""
        return self._finished.get(stamp)

    def add(self, stamp: str, trials: SceneTrials) -> None:
        """Keep the trials of a scene.

        Raises:
            StorageFullError: The disk is full.
        """
        if self._file is None:
            return
        entry = {
            "stamp": stamp,
            "gripper": trials.gripper,
            "tried": [tried.to_dict() for tried in trials.tried],
        }
        with storage_errors(self._file.name):
            self._file.write(json.dumps(entry) + "\n")
            self._file.flush()


@contextmanager
def open_journal(folder: Path | None, plan: str) -> Iterator[TrialJournal]:
    """The journal of a folder, held alone.

    Args:
        folder: The folder; None keeps nothing.
        plan: Everything that the result of a scene follows from, beside its files and its grasps;
            what another plan left is dropped.

    Raises:
        FileError: Another run holds the folder, or it cannot be written to.
    """
    if folder is None:
        yield TrialJournal(None, {})
        return
    with locked(folder, "trial"):
        path = folder / UNFINISHED_FILE
        header = {"format": _FORMAT, "plan": _digest(plan.encode())}
        lines = _read(path, header)
        finished = {stamp: trials for stamp, trials in map(_trials, lines) if trials is not None}
        if finished:
            _LOG.info("%d scenes were finished by an earlier run", len(finished))
        with storage_errors(path):
            file = path.open("w", encoding="utf-8", errors="surrogateescape")
        with file:
            with storage_errors(path):
                file.writelines(json.dumps(line) + "\n" for line in (header, *lines))
                file.flush()
            yield TrialJournal(file, finished)


def scene_stamp(scenes: Scenes, index: int, grasps: Grasps) -> str:
    """Changes with the grasps that are tried on a scene, and with its files."""
    parts = [scenes.ids[index].encode(errors="surrogateescape")]
    for path in scenes.files(index):
        if path.is_file():
            stat = path.stat()
            parts.append(f"{path.name} {stat.st_size} {stat.st_mtime_ns}".encode(errors="replace"))
    columns = (grasps.center, grasps.angle, grasps.width, grasps.height, grasps.quality)
    return _digest(*parts, *(column.tobytes() for column in columns))


def _read(path: Path, header: dict[str, Any]) -> list[dict[str, Any]]:
    """The whole lines of an earlier run of the same plan."""
    try:
        text = path.read_text(encoding="utf-8", errors="surrogateescape")
        # What follows the last line end was cut short.
        lines = [json.loads(line) for line in text.split("\n")[:-1]]
    except (OSError, ValueError, RecursionError):
        return []
    return lines[1:] if lines[:1] == [header] else []


def _trials(line: dict[str, Any]) -> tuple[str, SceneTrials | None]:
    try:
        tried = tuple(TriedGrasp.from_dict(entry) for entry in line["tried"])
        return str(line["stamp"]), SceneTrials(tried, str(line["gripper"]))
    except (KeyError, TypeError, ValueError):
        return "", None


def _digest(*parts: bytes) -> str:
    digest = blake2b(digest_size=16)
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()
