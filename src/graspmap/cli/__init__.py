"""The command line: parse, call, print.

Each command is a module of this package with ``ABOUT`` (one line for the overview) and
``run(argv)``; it is imported when it is asked for, so that ``graspmap --help`` needs no library.
Exit codes: 0 done, 2 the user can mend it (one line on standard error says how), 130 stopped with
Ctrl-C, 1 a defect of graspmap (with a traceback).
"""

from __future__ import annotations

import importlib
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from graspmap.errors import GraspmapError, UnknownNameError

__all__ = ["main"]

COMMANDS = {
    "demo": "train for a minute on drawn scenes, detect on unseen ones, show the picture",
    "detect": "find grasps in one picture",
    "train": "train a network as an experiment file says",
    "evaluate": "measure weights or predictions against labelled grasps",
    "doctor": "look through a data set, meshes or weights, and say what is there",
    "weights": "bring other people's weights into graspmap's own format",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Words after the program's name; those of the process when None.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        with warnings.catch_warnings():
            _listen()
            code = _dispatch(words)
            sys.stdout.flush()
        return code
    except SystemExit as stop:  # how tyro ends after --help
        return stop.code if isinstance(stop.code, int) else 1
    except GraspmapError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        return _fail("stopped; finished work is kept", 130)
    except BrokenPipeError:
        # The reader went away (`graspmap ... | head`): nobody is left to tell. Python flushes
        # standard output once more at exit, which must not complain either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        if error.filename is None:
            raise
        return _fail(f"{error.filename}: {error.strerror}; choose another file or folder")
    except MemoryError:
        return _fail("out of memory; use a smaller picture, a smaller batch or fewer workers")


def _dispatch(words: list[str]) -> int:
    if words and words[0] == "--version":
        from graspmap import __version__

        print(f"graspmap {__version__}")
        return 0
    if not words or words[0] in ("-h", "--help", "help"):
        print(_overview())
        return 0 if words else 2
    if words[0] not in COMMANDS:
        raise UnknownNameError("command", words[0], COMMANDS)
    module = importlib.import_module(f"graspmap.cli.{words[0]}")
    return int(module.run(words[1:]) or 0)


def _overview() -> str:
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:<{width}}  {text}" for name, text in COMMANDS.items())
    return (
        "graspmap finds parallel-jaw grasps in RGB-D pictures.\n\n"
        "usage: graspmap COMMAND [options]\n\n"
        f"commands:\n{lines}\n\n"
        "graspmap COMMAND --help explains one of them with an example; --version prints the "
        "version.\nData sets are named KIND:DIR, for example cornell:~/data/cornell.\n\n"
        "Start with:  graspmap demo --out demo"
    )


def _listen() -> None:
    """Send the package's log and its warnings to standard error as plain lines."""
    logger = logging.getLogger("graspmap")
    logger.handlers = [_Stderr()]
    logger.setLevel(logging.INFO)
    logger.propagate = False
    warnings.showwarning = _show_warning
    # Lightning tells about its own workings at every turn; the command tells what matters.
    for name in ("lightning", "lightning.pytorch", "lightning.fabric", "pytorch_lightning"):
        logging.getLogger(name).setLevel(logging.WARNING)


class _Stderr(logging.Handler):
    """Writes to the standard error of the moment, so that captured output is captured."""

    def emit(self, record: logging.LogRecord) -> None:
        mark = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        print(f"graspmap: {mark}{_one_line(record.getMessage())}", file=sys.stderr)


def _show_warning(message: Any, category: type[Warning], *_: Any, **__: Any) -> None:
    if category.__module__.startswith("graspmap"):
        print(f"graspmap: warning: {_one_line(str(message))}", file=sys.stderr)


def _fail(text: str, code: int = 2) -> int:
    print(
        f"graspmap: error: {_one_line(text)}" if code == 2 else f"graspmap: {text}", file=sys.stderr
    )
    return code


def _one_line(text: str) -> str:
    return " ".join(text.split())
