"""Label files of Jacquard's layout: grasps that held, and (our addition) grasps that did not.

A line of ``_grasps.txt`` is ``x;y;theta;opening;jaw``: the centre in pixels, the direction of the
opening in degrees, CLOCKWISE on screen (`Grasps` has it counter-clockwise), opening and jaw size in
pixels. A line of ``_negatives.txt`` is the same followed by ``;outcome``, a word that says how the
grasp failed: ``collided``, ``empty``, ``slipped``, ``dropped``.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import FileFormatError, InvalidInputError
from graspmap.files import read_bytes, read_lines
from graspmap.geometry.grasps import Grasps

_LINE = "a line is x;y;theta;opening;jaw (pixels, degrees clockwise), five finite numbers"
_NEGATIVE_LINE = "a line is x;y;theta;opening;jaw;outcome, five finite numbers and a word"
_WORD = re.compile(r"[a-z_]+")


def read_grasps(path: Path) -> Grasps:
    """Grasps of a ``_grasps.txt``, all jaw sizes, in the order of the file; pixels of its picture.

    A file without lines means that no grasp succeeded.

    Raises:
        FileError: The file is missing or no text, or a line is not five finite numbers with a
            positive opening and jaw; the error names the line.
    """
    return _grasps([_parse(path, number, line) for number, line in read_lines(path)])


def format_grasps(grasps: Grasps) -> str:
    """The lines of a ``_grasps.txt`` (CRLF, as in the original); reading them is exact.

    The quality is not part of the format.
    """
    return "".join(f"{line}\r\n" for line in _lines(grasps))


def read_negatives(path: Path) -> tuple[Grasps, tuple[str, ...]]:
    """Grasps of a ``_negatives.txt`` and how each failed, in the order of the file.

    Raises:
        FileError: The file is missing or no text, or a line is not five finite numbers with a
            positive opening and jaw, and a word; the error names the line.
    """
    rows, outcomes = [], []
    for number, line in read_lines(path):
        numbers, _, word = line.rpartition(";")
        if not _WORD.fullmatch(word):
            raise FileFormatError(path, f"line {number} is {line!r}", _NEGATIVE_LINE)
        rows.append(_parse(path, number, numbers))
        outcomes.append(word)
    return _grasps(rows), tuple(outcomes)


def format_negatives(grasps: Grasps, outcomes: Sequence[str]) -> str:
    """The lines of a ``_negatives.txt``; reading them is exact.

    Args:
        grasps: N grasps that failed.
        outcomes: N words, lower case, that say how.

    Raises:
        InvalidInputError: Not one word for each grasp.
    """
    if len(outcomes) != len(grasps):
        raise InvalidInputError("outcomes", f"{len(outcomes)} words", f"{len(grasps)}, one a grasp")
    for word in set(outcomes):
        if not _WORD.fullmatch(word):
            raise InvalidInputError("outcome", repr(word), "a word in lower case")
    pairs = zip(_lines(grasps), outcomes, strict=True)
    return "".join(f"{line};{outcome}\r\n" for line, outcome in pairs)


def smallest_jaws(grasps: Grasps) -> Grasps:
    """Each grasp once, with the smallest of the jaws (height) that it is repeated with.

    Grasps are the same where centre, angle and opening agree to 1e-4 px and 1e-4 rad, which is
    finer than the files are written and coarser than the rounding of an affine map. The order is
    that of the first appearance.
    """
    order, starts = _by_place(grasps)
    return _once(grasps, order, starts)


def jaw_shares(grasps: Grasps, failed: Grasps | None = None) -> Grasps:
    """Each grasp once, as by `smallest_jaws`; its quality is the share of the jaws that held.

    Jaws of all sizes are tried at a place, so their share says how safe it is: on graspmap-v1, of
    what was tried within 12 mm and 20 degrees of grasps that held with one jaw of five, 44 % held,
    and 90 % near those that held with all five.

    Args:
        grasps: Grasps that held, repeated with each jaw size that did; one that is listed twice
            counts once.
        failed: Grasps that did not, which tell how many sizes were tried; without them that is the
            greatest number that one grasp held with.
    """
    order, starts = _by_place(grasps)
    both = grasps if failed is None else Grasps.concatenate([grasps, failed])
    tried = _jaws(both, *_by_place(both)).max(initial=1)
    shares = np.empty(len(grasps))
    held = _jaws(grasps, order, starts)
    shares[order] = np.repeat(held / tried, np.diff(np.r_[starts, len(order)]))
    return _once(grasps.replace(quality=shares), order, starts)


def _by_place(grasps: Grasps) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Numbers of the grasps by place and jaw size, and where each place begins among them."""
    key = np.column_stack(
        # The double angle makes -pi/2 and pi/2 the same.
        [grasps.center, np.cos(2 * grasps.angle), np.sin(2 * grasps.angle), grasps.width]
    )
    same = np.round(key * 1e4).astype(np.int64)
    # By hand: np.unique along an axis doubles the time, and every training sample waits for it.
    order = np.lexsort((grasps.height, *same.T))  # stable: of equal jaws the first in the list
    changes = (np.diff(same[order], axis=0) != 0).any(axis=1)
    return order, np.flatnonzero(np.r_[True, changes][: len(order)])


def _jaws(grasps: Grasps, order: NDArray[np.intp], starts: NDArray[np.intp]) -> NDArray[np.intp]:
    """How many jaw sizes each place has."""
    if not len(grasps):
        return np.zeros(0, dtype=np.intp)
    # They stand in order of size, and are told apart as finely as places are.
    larger = np.diff(np.round(grasps.height[order] * 1e4), prepend=-1.0) != 0
    larger[starts] = True
    return np.asarray(np.add.reduceat(larger.astype(np.intp), starts))


def _once(grasps: Grasps, order: NDArray[np.intp], starts: NDArray[np.intp]) -> Grasps:
    """The first grasp of each place, in the order in which places appear."""
    if not len(grasps):
        return grasps
    appearance = np.minimum.reduceat(order, starts)
    return grasps[order[starts][np.argsort(appearance)]]


def read_class_names(path: Path) -> dict[str, str]:
    """Class names by kind from the record of a generated scene; none of several objects."""
    try:
        objects = json.loads(read_bytes(path))["objects"]
        labels = objects[0].get("labels", {}) if len(objects) == 1 else {}
        return {str(kind): str(name) for kind, name in labels.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(
            path, "is no record of a scene", "copy the file again, or make the scene again"
        ) from error


def _lines(grasps: Grasps) -> list[str]:
    # 1e-12 degrees are below the rounding of the conversion: 68.2615 stays what it was.
    theta = np.round(-np.degrees(grasps.angle), 12)
    table = np.column_stack([grasps.center, theta, grasps.width, grasps.height])
    return [";".join(map(repr, row)) for row in table.tolist()]


def _grasps(rows: Sequence[Sequence[float]]) -> Grasps:
    if not rows:
        return Grasps.empty()
    table = np.array(rows, dtype=np.float64)
    return Grasps(
        center=table[:, :2],
        angle=-np.radians(table[:, 2]),
        width=table[:, 3],
        height=table[:, 4],
    )


def _parse(path: Path, number: int, line: str) -> list[float]:
    parts = line.split(";")
    if len(parts) != 5:
        raise FileFormatError(path, f"line {number} has {len(parts)} numbers: {line!r}", _LINE)
    try:
        values = [float(part) for part in parts]
    except ValueError as error:
        raise FileFormatError(path, f"line {number} is {line!r}", _LINE) from error
    if not all(map(math.isfinite, values)):
        raise FileFormatError(path, f"line {number} is not finite: {line!r}", _LINE)
    if values[3] <= 0 or values[4] <= 0:
        raise FileFormatError(
            path,
            f"line {number} has opening {values[3]:g} and jaw {values[4]:g}",
            "both must be positive",
        )
    return values
