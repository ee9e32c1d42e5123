"""Finished work on disk, one line for each piece, so that a stopped run goes on where it was."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from typing import Any, TextIO

from graspmap.errors import storage_errors
from graspmap.files import locked

_LOG = logging.getLogger(__name__)


class Journal:
    """Finished pieces of work; use `open_journal`.

    Args:
        file: Open for appending; None keeps nothing.
        finished: What an earlier run of the same plan left, by stamp.
    """

    def __init__(self, file: TextIO | None, finished: Mapping[str, dict[str, Any]]) -> None:
        self._file, self._finished = file, finished

    def find(self, stamp: str) -> dict[str, Any] | None:
        """What was kept under a stamp; None where that is still to be done."""
        return self._finished.get(stamp)

    def add(self, stamp: str, entry: Mapping[str, Any]) -> None:
        """Keep a finished piece of work.

        Args:
            stamp: Changes with all that the piece follows from, beside the plan.
            entry: Values for JSON.

        Raises:
            StorageFullError: The disk is full.
        """
        if self._file is None:
            return
        with storage_errors(self._file.name):
            self._file.write(json.dumps({"stamp": stamp, **entry}) + "\n")
            self._file.flush()


@contextmanager
def open_journal(
    path: Path | None, plan: str, *, work: str, pieces: str, format: str
) -> Iterator[Journal]:
    """The journal in a folder, which is held alone.

    Args:
        path: The file; its folder is made. None keeps nothing.
        plan: Everything that the result of a piece follows from, beside its stamp; what another
            plan left is dropped.
        work: What runs, for the message to another run: ``"trial"``.
        pieces: What is finished piece by piece, for the log: ``"scenes"``.
        format: Name and version of the entries.

    Raises:
        FileError: Another run holds the folder, or it cannot be written to.
    """
    if path is None:
        yield Journal(None, {})
        return
    with locked(path.parent, work):
        header = {"format": format, "plan": digest(plan.encode(errors="surrogateescape"))}
        lines = _read(path, header)
        finished = {str(line.get("stamp")): line for line in lines}
        if finished:
            _LOG.info("%d %s were finished by an earlier run", len(finished), pieces)
        with storage_errors(path):
            file = path.open("w", encoding="utf-8", errors="surrogateescape")
        with file:
            with storage_errors(path):
                file.writelines(json.dumps(line) + "\n" for line in (header, *lines))
                file.flush()
            yield Journal(file, finished)


def digest(*parts: bytes) -> str:
    """32 hexadecimal digits of several contents, which also tell where each of them ends."""
    found = blake2b(digest_size=16)
    for part in parts:
        found.update(len(part).to_bytes(8, "little") + part)
    return found.hexdigest()


def _read(path: Path, header: dict[str, Any]) -> list[dict[str, Any]]:
    """The whole lines of an earlier run of the same plan."""
    try:
        text = path.read_text(encoding="utf-8", errors="surrogateescape")
        # What follows the last line end was cut short.
        lines = [json.loads(line) for line in text.split("\n")[:-1]]
    except (OSError, ValueError, RecursionError):
        return []
    if lines[:1] != [header]:
        return []
    return [line for line in lines[1:] if isinstance(line, dict)]
