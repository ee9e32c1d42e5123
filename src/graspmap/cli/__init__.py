"""The command line: parse, call, print.

Each command is a module of this package with ``ABOUT`` (one line for the overview) and
``run(argv)``; it is imported when it is asked for, so that ``graspmap --help`` needs no library.
Exit codes: 0 done, 2 the user can mend it (one line on standard error says how), 130 stopped with
Ctrl-C or SIGTERM, 1 a defect of graspmap (with a traceback), or `reproduce` with runs that failed.
"""

from __future__ import annotations

import errno
import importlib
import io
import logging
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from graspmap.errors import GraspmapError, UnknownNameError

__all__ = ["main"]

COMMANDS = {
    "demo": "detect on the scenes that ship, try the grasps in physics: in half a minute",
    "gripper": "show a gripper's profile, start one of your own, train a detector for it",
    "generate": "make labelled scenes for a gripper: pictures, and grasps tried in physics",
    "train": "train a network as an experiment file says",
    "detect": "find grasps in one picture",
    "evaluate": "measure weights or predictions against labelled grasps",
    "compare": "set evaluations side by side: is one detector better, or is it chance?",
    "trial": "try grasps in simulated physics: which of them hold?",
    "bench": "time detection: preparation, forward pass and decoding",
    "reproduce": "make the tables and figures of the thesis again, its numbers beside yours",
    "doctor": "look through a data set, meshes or weights, and say what is there",
    "weights": "what ships, what a card says; calibrate; bring in other people's weights",
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
        with warnings.catch_warnings(), _stoppable():
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
        _drop_output()  # the reader went away (`graspmap ... | head`): nobody is left to tell
        return 141
    except (OSError, MemoryError, RuntimeError, UnicodeEncodeError) as error:
        text = _of_the_machine(error)
        if text is None:
            raise
        return _fail(text)


def _of_the_machine(error: Exception) -> str | None:
    """What the machine lacks, and the remedy; None for an error that is a defect of graspmap."""
    memory = "out of memory; use a smaller picture, a smaller batch or fewer workers"
    if isinstance(error, MemoryError):
        return memory
    if isinstance(error, UnicodeEncodeError):
        name = ascii(error.object)[:200]
        return f"{name}: a name or text that is not UTF-8; rename it, or choose another"
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}; choose another file or folder"
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        _drop_output()
        return "standard output: the disk is full; free some space, then run again"
    # PyTorch has no type of its own for it on a CPU.
    full = isinstance(error, RuntimeError) and re.search(
        r"out of memory|can't allocate memory", str(error)
    )
    return memory if full else None


def _drop_output() -> None:
    """Let nothing more go to standard output: Python flushes it at exit, and would complain."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _stoppable() -> Iterator[None]:
    """Let a SIGTERM end a command as Ctrl-C does: what it has half written is removed."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _stop(*_: Any) -> None:
    raise KeyboardInterrupt


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
        "version.\nData sets are named KIND:DIR, for example cornell:~/data/cornell; examples "
        "are the scenes that ship.\n\n"
        "Start with:  graspmap demo --out demo"
    )


def _listen() -> None:
    """Send the package's log and its warnings to standard error as plain lines."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # An old terminal cannot show every name of a file; that is no reason to fail.
        sys.stdout.reconfigure(errors="backslashreplace")
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
