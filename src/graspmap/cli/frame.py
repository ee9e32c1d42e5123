"""What the commands share: flags, checks of what they will write, and their output."""

from __future__ import annotations

import contextlib
import inspect
import io
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import tyro

from graspmap.errors import (
    FileError,
    GraspmapError,
    InvalidInputError,
    UnknownNameError,
    storage_errors,
)

Command = TypeVar("Command")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")


_ABOUT = "@about@"


class _Captured(io.StringIO):
    """What tyro prints; it looks at the encoding to choose the frame of its boxes."""

    encoding = "utf-8"


class UsageError(GraspmapError):
    """The words after the command do not fit its flags.

    Attributes:
        command: For example ``"graspmap detect"``.
    """

    def __init__(self, command: str, problem: str) -> None:
        self.command = command
        super().__init__(f"{problem}; see: {command} --help")


def option(metavar: str, default: str = "") -> Any:
    """How a flag shows in the help: its placeholder and what happens without it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"({default})" if default else "")


def parse(kind: type[Command], argv: Sequence[str], command: str) -> Command:
    """The flags of one command as its frozen dataclass.

    Raises:
        UsageError: A flag is unknown or missing, or its value is of the wrong type.
        SystemExit: ``--help`` was given and has been printed.
    """
    return _parse(kind, argv, command, False)[0]


def parse_known(
    kind: type[Command], argv: Sequence[str], command: str
) -> tuple[Command, list[str]]:
    """Like `parse`, and the words that are none of the command's flags.

    Raises:
        UsageError: A flag is missing or its value is of the wrong type.
        SystemExit: ``--help`` was given and has been printed.
    """
    return _parse(kind, argv, command, True)


def _parse(
    kind: type[Command], argv: Sequence[str], command: str, unknown: bool
) -> tuple[Command, list[str]]:
    complaint, answer = _Captured(), _Captured()
    config = (tyro.conf.FlagCreatePairsOff,)
    try:
        # tyro draws a box of several lines; a command says what is wrong in one.
        with contextlib.redirect_stderr(complaint), contextlib.redirect_stdout(answer):
            if unknown:
                return tyro.cli(
                    kind,
                    prog=command,
                    description=_ABOUT,
                    args=argv,
                    config=config,
                    return_unknown_args=True,
                )
            return tyro.cli(kind, prog=command, description=_ABOUT, args=argv, config=config), []
    except SystemExit as stop:
        if stop.code in (0, None):
            # tyro would join the lines of the description, and with them those of the example.
            text = answer.getvalue().replace(_ABOUT, inspect.getdoc(kind) or "")
            if (sys.stdout.encoding or "").lower() not in ("utf-8", "utf8"):
                text = text.translate(str.maketrans("│─╭╮╰╯", "|-++++"))
            print(text, end="")
            raise
        raise UsageError(command, _unboxed(complaint.getvalue())) from None


def _unboxed(box: str) -> str:
    """The message of tyro's error box, and the flag that it thinks was meant."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", box)
    if "Missing from " in plain:
        # Under it the flags stand indented, under each of them its help.
        above = plain.partition("│ ──")[0]
        missing = re.findall(r"^│ {5}(\S.*?) *│$", above, re.MULTILINE)
        if missing:
            return f"needs {' and '.join(missing)}"
    lines = [line.strip("│ \t") for line in plain.splitlines() if line.strip().startswith("│")]
    parts: list[list[str]] = [[]]
    for line in lines:
        if line and set(line) == {"─"}:
            parts.append([])
        else:
            parts[-1].append(line)
    text = " ".join(parts[0]) or "the flags are wrong"
    for part in parts[1:]:
        if part and part[0].startswith("Perhaps you meant"):
            flag = next((line.split()[0].rstrip(",") for line in part if line.startswith("--")), "")
            text += f"; did you mean {flag}?" if flag else ""
    return _plainly(text.rstrip("."))


_NUMBERS = {
    r"invalid literal for int\(\) with base 10: ('.*?')": "a whole number",
    r"could not convert string to float: ('.*?')": "a number",
}


def _plainly(text: str) -> str:
    """Python's words for a value of the wrong type as those of the other errors."""
    choice = re.fullmatch(r"invalid choice '(.*)' for argument '(\S+)'. Expected.*\((.*)\)", text)
    if choice is not None:
        names = sorted({*re.findall(r"'([^']*)'", choice[3])} - {"None"})
        return str(UnknownNameError(choice[2], choice[1], names))
    flag = re.match(r"Error parsing (\S+):", text)
    for words, allowed in _NUMBERS.items():
        value = re.search(words, text)
        if flag is not None and value is not None:
            return str(InvalidInputError(flag[1], value[1], allowed))
    return text


def numbers(text: str, names: str, flag: str) -> tuple[float, ...]:
    """Comma-separated numbers, as many as ``names`` has.

    Args:
        text: For example ``"10,20,300,200"``.
        names: For example ``"X,Y,W,H"``.
        flag: The flag, for the error.

    Raises:
        InvalidInputError: Another count, or something that is no finite number.
    """
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != len(names.split(",")) or not all(map(math.isfinite, values)):
        raise InvalidInputError(flag, repr(text), f"numbers {names}, separated by commas")
    return values


def at_least(least: int, **flags: int | None) -> None:
    """Refuse numbers that are too small, before any work.

    Args:
        least: The least that is allowed.
        flags: Their values by name, as in ``workers=2``; None where one was not given.

    Raises:
        InvalidInputError: One is less; the error names its flag.
    """
    for name, value in flags.items():
        if value is not None and value < least:
            raise InvalidInputError(f"--{name}", value, f"{least} or more")


def output_file(
    path: Path | None,
    flag: str,
    suffixes: Sequence[str] = (),
    *,
    keep: Iterable[Path | None] = (),
) -> None:
    """Check before the work that a result can be written, and make its folder.

    Args:
        path: Where the result goes; None or ``-``: to no file.
        flag: The flag, for the error.
        suffixes: What the name may end in; anything when empty.
        keep: Files that the command reads, which the result must not replace.

    Raises:
        FileError: The path is a folder or a file to keep, or its folder cannot be made or written.
        InvalidInputError: The suffix is not one that the command can write.
    """
    if path is None or str(path) == "-":
        return
    if suffixes and path.suffix.lower() not in suffixes:
        raise InvalidInputError(flag, path, f"a file name that ends in {', '.join(suffixes)}")
    if path.is_dir():
        raise FileError(path, "is a folder", f"give {flag} the name of a file")
    for other in keep:
        if other is not None and path.exists() and other.exists() and path.samefile(other):
            raise FileError(path, "is read by this very command", f"give {flag} another name")
    if not path.exists() or path.is_file():  # else a device or a pipe
        output_folder(path.parent, flag)


def output_folder(path: Path, flag: str) -> None:
    """Make a folder for results.

    Raises:
        FileError: It cannot be made, or not written to.
    """
    with storage_errors(path):
        try:
            path.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise FileError(path, "is no folder", f"choose another place for {flag}") from error
    if not os.access(path, os.W_OK):
        raise FileError(path, "no permission to write", f"choose another place for {flag}")


def write_picture(path: Path, rgb: Any) -> None:
    """Write a (H, W, 3) uint8 RGB picture as PNG or JPEG, as its suffix says.

    Raises:
        StorageFullError: The disk is full.
        FileError: The folder may not be written to.
    """
    from graspmap.files import write_bytes
    from graspmap.pictures import encode

    write_bytes(path, encode(rgb, path.suffix))


def write_json(value: Any, target: Path | None) -> None:
    """Write a result for machines to a file, or to standard output for ``-``; None: nowhere.

    Numbers that are not finite become null: JSON has no others.

    Raises:
        StorageFullError: The disk is full.
        FileError: The folder may not be written to.
    """
    if target is None:
        return
    text = json.dumps(plain(value), indent=2, ensure_ascii=False) + "\n"
    try:
        text.encode((sys.stdout.encoding or "utf-8") if str(target) == "-" else "utf-8")
    except UnicodeEncodeError:  # an old terminal, or a file name that is no Unicode
        text = json.dumps(plain(value), indent=2) + "\n"
    if str(target) == "-":
        sys.stdout.write(text)
    else:
        from graspmap.files import write_text

        write_text(target, text)


def plain(value: Any) -> Any:
    """A value made of dict, list, str, int, float, bool and None only."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy arrays and numbers
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def teller(json_target: Path | None) -> Callable[[str], None]:
    """Where a command's own words go: standard output, unless the JSON goes there."""

    def tell(text: str = "") -> None:
        print(text, file=sys.stderr if str(json_target) == "-" else sys.stdout)

    return tell
