"""Errors of graspmap: one base, facts as attributes, the remedy in the text.

Everything that a user can mend raises a `GraspmapError`; the command line turns it into one line
on standard error and exit code 2. Anything else that escapes is a defect of graspmap.
"""

from __future__ import annotations

import difflib
import errno
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


class GraspmapError(Exception):
    """Base of all errors that graspmap raises on purpose."""

    def __reduce__(self) -> tuple[Any, ...]:
        # Exception would call the class with the finished text; errors come out of workers whole.
        return _rebuilt, (type(self), self.args), self.__dict__


def _rebuilt(kind: type[GraspmapError], args: tuple[Any, ...]) -> GraspmapError:
    error = kind.__new__(kind)
    error.args = args
    return error


class GraspmapWarning(UserWarning):
    """Base of the warnings of graspmap: the work went on, but the user should look."""


class InvalidInputError(GraspmapError, ValueError):
    """A value is outside what a function allows.

    Attributes:
        name: What was wrong, for example ``"width"``.
        found: The value, or a short description of it.
        allowed: What would have been accepted, in words.
    """

    def __init__(self, name: str, found: Any, allowed: str) -> None:
        self.name, self.found, self.allowed = name, found, allowed
        super().__init__(f"{name} is {found!s}; allowed: {allowed}")


class UnknownNameError(InvalidInputError):
    """A name is not one of the known ones; the text lists them, the nearest first.

    Attributes:
        choices: The known names.
        nearest: The known name that resembles the given one most, or None.
    """

    def __init__(self, name: str, found: str, choices: Iterable[str]) -> None:
        self.choices = tuple(choices)
        near = difflib.get_close_matches(found, self.choices, n=1)
        self.nearest = near[0] if near else None
        hint = f"; did you mean {self.nearest!r}?" if self.nearest else ""
        super().__init__(name, repr(found), f"{', '.join(self.choices) or 'nothing'}{hint}")


class FileError(GraspmapError):
    """A file cannot be used.

    Attributes:
        path: The file or folder.
        problem: What is wrong with it.
        remedy: What the user can do.
    """

    def __init__(self, path: Path | str, problem: str, remedy: str) -> None:
        self.path, self.problem, self.remedy = Path(path), problem, remedy
        super().__init__(f"{path}: {problem}; {remedy}")


class FolderInUseError(FileError):
    """Another process works in a folder."""


class MissingFileError(FileError, FileNotFoundError):
    """A file or folder does not exist."""


class FileFormatError(FileError, ValueError):
    """A file exists but its content is not what its name or place says."""


class DatasetNotFoundError(MissingFileError):
    """A folder holds no scenes of the data set it was said to be."""


class WeightsError(FileFormatError):
    """A weights file does not fit, is damaged, or would run code when opened."""


class ConfigError(FileFormatError):
    """A file of settings (an experiment, a gripper) or a flag has a wrong key or value.

    Attributes:
        key: Dotted key, for example ``"training.epochs"``.
    """

    def __init__(self, path: Path | str, key: str, problem: str, remedy: str) -> None:
        self.key = key
        super().__init__(path, f"{key}: {problem}", remedy)


class MissingExtraError(GraspmapError, ImportError):
    """A feature needs a package that only an extra installs.

    Attributes:
        feature: What was asked for.
        package: The package that is missing.
        extra: The extra of graspmap that installs it.
    """

    def __init__(self, feature: str, package: str, extra: str) -> None:
        self.feature, self.package, self.extra = feature, package, extra
        super().__init__(f"{feature} needs {package}; pip install 'graspmap[{extra}]'")


class StorageFullError(FileError, OSError):
    """The disk ran full while writing."""


@contextmanager
def storage_errors(path: Path | str) -> Iterator[None]:
    """Turn the system's refusals to write (full disk, read-only) into errors that name ``path``.

    Raises:
        StorageFullError: The block ran out of space.
        FileError: The block could not write for another reason.
    """
    try:
        yield
    except OSError as error:
        if isinstance(error, GraspmapError | BrokenPipeError):
            raise
        # NumPy says of a full disk only how much of an array it could write.
        short = error.errno is None and "requested and" in str(error)
        if short or error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise StorageFullError(
                path, "the disk is full", "free some space or choose another folder, then run again"
            ) from error
        if error.errno in (errno.EACCES, errno.EROFS, errno.EPERM):
            raise FileError(
                path, "no permission to write", "choose a folder that you may write to"
            ) from error
        if isinstance(error, NotADirectoryError | FileExistsError | IsADirectoryError):
            raise FileError(
                path,
                "a file stands where a folder is needed, or the reverse",
                "choose another name",
            ) from error
        raise FileError(
            path,
            f"cannot be written ({error.strerror or error})",
            "choose another name or folder",
        ) from error
