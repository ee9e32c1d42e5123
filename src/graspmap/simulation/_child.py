"""Work of foreign libraries that may abort, hang or swell: in a child process that can be killed.

As a program, ``python -m graspmap.simulation._child TASK IN.npz OUT.npz``, this is the child.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import GraspmapError

Arrays = dict[str, NDArray[Any]]


class ChildError(GraspmapError):
    """The work in the child process did not come to an end.

    Attributes:
        late: Whether the time ran out; else the child died.
    """

    def __init__(self, problem: str, *, late: bool) -> None:
        self.late = late
        super().__init__(problem)


def call(
    task: str, arrays: Arrays, timeout_s: float, *, program: Sequence[str] | None = None
) -> Arrays:
    """Do a task in a child process.

    Args:
        task: Name in `TASKS`.
        arrays: Its arguments.
        timeout_s: The child is killed after this many seconds.
        program: Command of the child, for tests.

    Raises:
        ChildError: The child died, said that it cannot, or was killed since its time ran out.
    """
    command = program or (sys.executable, "-P", "-m", __name__)
    with tempfile.TemporaryDirectory(prefix="graspmap-") as folder:
        given, result = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(given, **arrays)  # type: ignore[arg-type]  # the stubs see allow_pickle in **
        try:
            # `run` kills the child when the time is over, and also at Ctrl-C.
            done = subprocess.run(
                [*command, task, str(given), str(result)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise ChildError(f"not done after {timeout_s:g} s", late=True) from error
        if done.returncode != 0 or not result.exists():
            words = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            said = f" ({words[0]:.200})" if words else ""
            raise ChildError(f"ended with code {done.returncode}{said}", late=False)
        with np.load(result) as found:
            return dict(found)


def _coacd(arrays: Arrays) -> Arrays:
    import coacd

    coacd.set_log_level("off")
    parts = coacd.run_coacd(
        coacd.Mesh(arrays["vertices"], arrays["faces"]),
        threshold=float(arrays["threshold"]),
        preprocess_mode=str(arrays["preprocess"]),
        seed=int(arrays["seed"]),
    )
    return {f"{number:05d}": vertices for number, (vertices, _) in enumerate(parts)}


def _simplify(arrays: Arrays) -> Arrays:
    from fast_simplification import simplify

    vertices, faces = simplify(
        arrays["vertices"].astype(np.float32), arrays["faces"], target_count=int(arrays["count"])
    )
    return {"vertices": vertices.astype(np.float64), "faces": faces.astype(np.int32)}


TASKS: dict[str, Callable[[Arrays], Arrays]] = {"coacd": _coacd, "simplify": _simplify}
"""What the child can do."""


def _main(task: str, given: str, result: str) -> None:
    if sys.platform != "win32":
        import resource

        # Should the parent be killed, nobody stops the child: it stops itself after an hour.
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_CPU, (3600, 3600))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with np.load(given) as arrays:
        found = TASKS[task](dict(arrays))
    part = Path(result).with_suffix(".part.npz")
    np.savez(part, **found)  # type: ignore[arg-type]  # the stubs see allow_pickle in **
    part.rename(result)


if __name__ == "__main__":
    _main(*sys.argv[1:])
