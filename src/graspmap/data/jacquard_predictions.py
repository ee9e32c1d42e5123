"""The format in which Jacquard's server takes predicted grasps.

Two lines for each scene: its id ``<i>_<object>``, then ``x;y;theta;opening;jaw``: pixels of the
1024 px picture, theta in degrees CLOCKWISE on screen, two decimals. As an extension, a scene may
have several grasps, best first: further grasp lines, or the pair of lines repeated.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path

import numpy as np

from graspmap.data.jacquard import JACQUARD_SIDE_PX
from graspmap.errors import FileFormatError, InvalidInputError
from graspmap.files import read_lines, write_text
from graspmap.geometry.affine import resize
from graspmap.geometry.grasps import Grasps

_LAYOUT = (
    "a scene is two lines, its id and x;y;theta;opening;jaw (1024 px pixels, degrees clockwise)"
)

_TOLD = 5
"""Wrong lines that are told one by one."""


def read_predictions(path: Path | str) -> dict[str, Grasps]:
    """Predicted grasps by scene id, best first, in the pixels of the 1024 px picture.

    The format has no quality: each is 1, the order tells which is better.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It holds no predictions, a line is no id and not five finite numbers with
            a positive opening, an id has no grasp, or comes again after another one; the error
            tells each of these lines (of very many, the first ones).
    """
    path = Path(path)
    reader = _Reader()
    for number, line in read_lines(path):
        reader.take(number, line)
    reader.end_of_id("the file ends")
    if not reader.rows and not reader.problems:
        raise FileFormatError(path, "holds no predictions", _LAYOUT)
    if reader.problems:
        shown = "; ".join(reader.problems[:_TOLD])
        more = len(reader.problems) - _TOLD
        raise FileFormatError(path, shown + (f"; and {more} more" if more > 0 else ""), _LAYOUT)
    return {name: _grasps(lines) for name, lines in reader.rows.items()}


def predictions_hash(predictions: Mapping[str, Grasps]) -> str:
    """32 hexadecimal digits (BLAKE2b) of predicted grasps, by scene and in their order."""
    found = blake2b(digest_size=16)
    for name, grasps in sorted(predictions.items()):
        columns = (*grasps.center.T, grasps.angle, grasps.width, grasps.height, grasps.quality)
        found.update(f"{name}\n{len(grasps)}\n".encode())
        found.update(np.column_stack(columns).astype("<f8").tobytes())
    return found.hexdigest()


class _Reader:
    """Takes the lines one after the other, and notes every one that is wrong."""

    def __init__(self) -> None:
        self.rows: dict[str, list[list[float]]] = {}
        self.problems: list[str] = []
        self._id: str | None = None
        self._id_line = self._grasps = 0

    def take(self, number: int, line: str) -> None:
        if ";" in line:
            self._take_grasp(number, line)
        elif re.search(r"\s|,", line):
            # A grasp line with the wrong separator would pass for an id.
            self._note(number, f"is neither an id nor a grasp: {line!r}")
            self._grasps += 1
        elif line == self._id:  # the pair of lines repeated
            self.end_of_id(f"line {number} is the id again")
            self._id_line = number
        else:
            self.end_of_id(f"line {number} is the next id")
            if line in self.rows:
                self._note(number, f"names {line} a second time; its grasps belong together")
            self._id, self._id_line = line, number
            self.rows.setdefault(line, [])

    def _take_grasp(self, number: int, line: str) -> None:
        self._grasps += 1
        try:
            values = _parse(line)
        except ValueError as error:
            self._note(number, str(error))
            return
        if self._id is None:
            self._note(number, "is a grasp before any id")
        else:
            self.rows[self._id].append(values)

    def end_of_id(self, why: str) -> None:
        """Whatever follows belongs to another id."""
        if self._id is not None and not self._grasps:
            self.problems.append(f"line {self._id_line} ({self._id}) has no grasp: {why}")
        self._grasps = 0

    def _note(self, number: int, problem: str) -> None:
        self.problems.append(f"line {number} {problem}")


def write_predictions(
    path: Path | str, predictions: Mapping[str, Grasps], *, size_px: float
) -> None:
    """Write predicted grasps, those of each scene by falling quality.

    Positions are rounded to 0.01 px of the 1024 px picture, angles to 0.01 degrees. A scene
    without grasps is left out.

    Args:
        path: The file.
        predictions: Grasps by scene id.
        size_px: Side of the pictures in whose pixels the grasps are; 1024 for Jacquard's own.

    Raises:
        InvalidInputError: ``size_px`` is not positive, an id cannot be told from a grasp line, or
            an opening is too small to be written.
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed.
    """
    if not (math.isfinite(size_px) and size_px > 0):
        raise InvalidInputError("size_px", size_px, "the positive side of the pictures, pixels")
    matrix = resize(JACQUARD_SIDE_PX / size_px)
    lines = []
    for name, grasps in predictions.items():
        if not re.fullmatch(r"[^\s;]+", name):
            raise InvalidInputError("id of a scene", repr(name), "no blanks and no ';'")
        best_first = grasps[np.argsort(-grasps.quality, kind="stable")].transformed(matrix)
        for grasp in best_first:
            lines += [name, _format(name, grasp)]
    write_text(Path(path), "".join(f"{line}\n" for line in lines))


def _format(name: str, grasp: Grasps) -> str:
    (x, y), width, height = grasp.center[0], grasp.width[0], grasp.height[0]
    if width < 0.005:
        raise InvalidInputError(f"opening of a grasp in {name}", width, "at least 0.01 px")
    # + 0.0 turns the -0.0 of a rounded small angle into 0.0.
    theta = round(-math.degrees(grasp.angle[0]), 2) + 0.0
    return f"{x:.2f};{y:.2f};{theta:.2f};{width:.2f};{height:.2f}"


def _grasps(rows: list[list[float]]) -> Grasps:
    table = np.array(rows, dtype=np.float64)
    return Grasps(table[:, :2], -np.radians(table[:, 2]), table[:, 3], table[:, 4])


def _parse(line: str) -> list[float]:
    """The five numbers of a grasp.

    Raises:
        ValueError: They are none; the error says why.
    """
    parts = line.split(";")
    if len(parts) != 5:
        raise ValueError(f"has {len(parts)} numbers: {line!r}")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        raise ValueError(f"is not numbers: {line!r}") from None
    if not all(map(math.isfinite, values)):
        raise ValueError(f"is not finite: {line!r}")
    if values[3] <= 0 or values[4] < 0:
        raise ValueError(
            f"has opening {values[3]:g} and jaw {values[4]:g}: the opening must be positive, "
            "the jaw not negative"
        )
    return values
