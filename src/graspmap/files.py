"""Reading and writing whole files, with errors that name the file and the remedy.

Files are written to a temporary neighbour and renamed, so a half-written file never carries the
final name.
"""

from __future__ import annotations

import atexit
import importlib
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from typing import Any

from graspmap.errors import (
    FileError,
    FileFormatError,
    FolderInUseError,
    MissingFileError,
    UnknownNameError,
    storage_errors,
)

# Without POSIX locks nobody is kept out.
fcntl: Any = importlib.import_module("fcntl") if os.name == "posix" else None
_LOG = logging.getLogger(__name__)

_REPLACE = "replace it with a good copy"
_PART = ".part"


def _umask() -> int:
    # The only portable way to ask for it is to set it.
    mask = os.umask(0)
    os.umask(mask)
    return mask


_UMASK = _umask()


def cache_folder() -> Path:
    """``$GRASPMAP_CACHE``, or ``graspmap`` in the user's folder of caches.

    A user without a home, as in some containers, has it among the temporary files.
    """
    if own := os.environ.get("GRASPMAP_CACHE"):
        return Path(os.path.expanduser(own))  # noqa: PTH111  # Path's raises where there is no home
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base) / "graspmap"
    try:
        return Path.home() / ".cache" / "graspmap"
    except RuntimeError:
        return Path(tempfile.gettempdir()) / "graspmap"


def keep_compiled_code() -> None:
    """Give numba a folder for what it compiles, where it would find none.

    It keeps its code beside the package or in the user's folder of caches, and where neither can be
    written (a package of root's in a container, a user without a home) refuses to import.
    """
    beside = Path(__file__).parent
    if "NUMBA_CACHE_DIR" in os.environ or os.access(beside, os.W_OK):
        return
    folder = cache_folder() / "numba"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(folder)
    except OSError:
        # A name that others could guess would let them put code there.
        folder = Path(tempfile.mkdtemp(prefix="graspmap-numba-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)


def shipped_or_path(
    name_or_path: Path | str, shipped: Mapping[str, Path], *, what: str, own: str
) -> Path:
    """The file of something that ships with graspmap, by its name, or a user's own.

    A name that ships is taken as such. Else, what has a suffix, holds a slash or exists is a path.

    Args:
        name_or_path: Which.
        shipped: Files that ship, by name.
        what: What the file describes, for messages: ``"gripper"``.
        own: What a user may give instead, for messages: ``"a YAML file"``.

    Raises:
        UnknownNameError: It is no path, and nothing of this name ships.
    """
    path, name = Path(name_or_path), str(name_or_path)
    if name in shipped:
        return shipped[name]
    if path.suffix or len(path.parts) > 1 or path.exists():
        return path
    raise UnknownNameError(what, name, [*shipped, f"or {own}"])


def read_bytes(path: Path, *, empty: bool = False) -> bytes:
    """The content of a file.

    Args:
        path: The file.
        empty: Whether it may be empty.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is empty and must not be, or a folder.
        FileError: It may not be read.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError as error:
        raise MissingFileError(path, "no such file", "check the name") from error
    except IsADirectoryError as error:
        raise FileFormatError(path, "this is a folder", "name a file in it") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise FileError(path, f"cannot be read ({reason})", "check its permissions") from error
    if not content and not empty:
        raise FileFormatError(path, "the file is empty", _REPLACE)
    return content


def file_hash(path: Path) -> str:
    """32 hexadecimal digits (BLAKE2b) of a file's content.

    Raises:
        FileError: It cannot be read.
    """
    return blake2b(read_bytes(path, empty=True), digest_size=16).hexdigest()


def read_text(path: Path) -> str:
    """The text of a file, UTF-8 with or without a mark at its start; "" for an empty file.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is no text, or a folder.
        FileError: It may not be read.
    """
    try:
        text = read_bytes(path, empty=True).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(path, f"is no text (byte {error.start})", _REPLACE) from error
    if "\0" in text:
        raise FileFormatError(path, "is no text (it holds zero bytes)", _REPLACE)
    return text


def read_lines(path: Path) -> list[tuple[int, str]]:
    """The lines of a text file that are not blank, whichever line endings it has.

    Returns:
        Pairs of line number (from 1) and stripped text; none for an empty file.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is no text.
        FileError: It may not be read.
    """
    lines = enumerate(read_text(path).splitlines(), start=1)
    numbered = ((number, line.strip()) for number, line in lines)
    return [(number, line) for number, line in numbered if line]


def write_bytes(path: Path, content: bytes, *, durable: bool = False) -> None:
    """Write a file whole or not at all; folders are made where they are missing.

    A device or a pipe (``/dev/stdout``) is written to, not replaced by a file.

    Args:
        path: The file.
        content: All of it.
        durable: Return only when the disk has the content, so that not even a power cut leaves
            less than the old file or the new one; this takes milliseconds.

    Raises:
        StorageFullError: The disk is full; nothing is left behind under the name.
        FileError: Writing there is not allowed.
    """
    with storage_errors(path):
        if path.exists() and not path.is_file() and not path.is_dir():
            path.write_bytes(content)
            return
        path = path.resolve() if path.is_symlink() else path  # a link stays one
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=_PART, dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
                if durable:
                    file.flush()
                    os.fsync(file.fileno())
            # mkstemp makes files private; give them what the user's umask gives any other.
            Path(name).chmod(0o666 & ~_UMASK)
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise


def write_text(path: Path, text: str, *, durable: bool = False) -> None:
    """Write UTF-8 text whole or not at all, line endings as given.

    Names of files that are no UTF-8 come out as the bytes they are.

    Args:
        path: The file.
        text: All of it.
        durable: See `write_bytes`.

    Raises:
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed.
    """
    write_bytes(path, text.encode(errors="surrogateescape"), durable=durable)


def remove_parts(folder: Path) -> None:
    """Remove what processes that were killed while writing left in a folder.

    Only for a folder that nobody else writes to at the moment: their half-written files would go.
    """
    for part in folder.glob(f".*{_PART}"):
        part.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path, what: str) -> Iterator[None]:
    """Make a folder, and hold it alone; the operating system lets go of it when a process dies.

    Args:
        folder: The folder; ``.lock`` in it stays there.
        what: What runs in it, for the message: ``"training"``.

    Raises:
        FolderInUseError: Another process holds it.
        FileError: It cannot be made.
    """
    with storage_errors(folder):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise FileError(folder, "is no folder", "choose another one with --out") from error
        lock = (folder / ".lock").open("w")
    with lock:
        if fcntl is not None:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise FolderInUseError(
                    folder, f"another {what} is running in it", "wait for it, or choose another"
                ) from error
            except OSError as error:
                # Some network file systems know no locks. As without them on Windows, it goes on.
                _LOG.warning("%s cannot be locked (%s): start no second run in it", folder, error)
        yield
