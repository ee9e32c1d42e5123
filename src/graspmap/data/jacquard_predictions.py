"""The format in which Jacquard's server takes predicted grasps.

Two lines for each scene: its id ``<i>_<object>``, then ``x;y;theta;opening;jaw``: pixels of the
1024 px picture, theta in degrees CLOCKWISE on screen, two decimals. As an extension, a scene may
have several grasps, best first: further grasp lines, or the pair of lines repeated.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
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


def read_predictions(path: Path | str) -> dict[str, Grasps]:
    """Predicted grasps by scene id, best first, in the pixels of the 1024 px picture.

    The format has no quality: each is 1, the order tells which is better.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It holds no predictions, a line is no id and not five finite numbers with
            a positive opening, an id has no grasp, or comes again after another one; the error
            names the line.
    """
    path = Path(path)
    rows: dict[str, list[list[float]]] = {}
    current, id_line = None, 0
    for number, line in read_lines(path):
        if ";" in line:
            if current is None:
                raise FileFormatError(path, f"line {number} is a grasp before any id", _LAYOUT)
            rows[current].append(_parse(path, number, line))
            continue
        _check_id(path, number, line)
        if current is not None and not rows[current]:
            raise FileFormatError(
                path,
                f"line {number} is an id, but line {id_line} ({current}) has no grasp",
                _LAYOUT,
            )
        if line in rows and line != current:
            raise FileFormatError(
                path, f"line {number} names {line} a second time", "keep its grasps together"
            )
        current, id_line = line, number
        rows.setdefault(line, [])
    if current is None:
        raise FileFormatError(path, "holds no predictions", _LAYOUT)
    if not rows[current]:
        raise FileFormatError(path, f"ends after the id in line {id_line}", _LAYOUT)
    return {name: _grasps(lines) for name, lines in rows.items()}


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


def _check_id(path: Path, number: int, line: str) -> None:
    # A grasp line with the wrong separator would pass for an id.
    if re.search(r"\s|,", line):
        raise FileFormatError(
            path, f"line {number} is neither an id nor a grasp: {line!r}", _LAYOUT
        )


def _parse(path: Path, number: int, line: str) -> list[float]:
    parts = line.split(";")
    if len(parts) != 5:
        raise FileFormatError(path, f"line {number} has {len(parts)} numbers: {line!r}", _LAYOUT)
    try:
        values = [float(part) for part in parts]
    except ValueError as error:
        raise FileFormatError(path, f"line {number} is not numbers: {line!r}", _LAYOUT) from error
    if not all(map(math.isfinite, values)):
        raise FileFormatError(path, f"line {number} is not finite: {line!r}", _LAYOUT)
    if values[3] <= 0 or values[4] < 0:
        raise FileFormatError(
            path,
            f"line {number} has opening {values[3]:g} and jaw {values[4]:g}",
            "the opening must be positive, the jaw not negative",
        )
    return values
