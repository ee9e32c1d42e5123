"""Finished scenes of a run of trials on disk, so that a stopped run goes on where it was."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from graspmap.data.scene import Scenes
from graspmap.evaluation import journal
from graspmap.evaluation.trial_results import UNFINISHED_FILE, TriedGrasp
from graspmap.geometry.grasps import Grasps

_FORMAT = "graspmap-trials-1"


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
        lines: The journal that holds them.
    """

    def __init__(self, lines: journal.Journal) -> None:
        self._lines = lines

    def find(self, stamp: str) -> SceneTrials | None:
        """The trials with this stamp; None where they are still to be made."""
        line = self._lines.find(stamp)
        if line is None:
            return None
        try:
            tried = tuple(TriedGrasp.from_dict(entry) for entry in line["tried"])
            return SceneTrials(tried, str(line["gripper"]))
        except (KeyError, TypeError, ValueError):
            return None

    def add(self, stamp: str, trials: SceneTrials) -> None:
        """Keep the trials of a scene.

        Raises:
            StorageFullError: The disk is full.
        """
        tried = [grasp.to_dict() for grasp in trials.tried]
        self._lines.add(stamp, {"gripper": trials.gripper, "tried": tried})


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
    path = None if folder is None else folder / UNFINISHED_FILE
    with journal.open_journal(path, plan, work="trial", pieces="scenes", format=_FORMAT) as lines:
        yield TrialJournal(lines)


def scene_stamp(scenes: Scenes, index: int, grasps: Grasps) -> str:
    """Changes with the grasps that are tried on a scene, and with its files."""
    parts = [scenes.ids[index].encode(errors="surrogateescape")]
    for path in scenes.files(index):
        if path.is_file():
            stat = path.stat()
            parts.append(f"{path.name} {stat.st_size} {stat.st_mtime_ns}".encode(errors="replace"))
    columns = (grasps.center, grasps.angle, grasps.width, grasps.height, grasps.quality)
    return journal.digest(*parts, *(column.tobytes() for column in columns))
