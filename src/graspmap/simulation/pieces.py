"""Convex pieces of a closed surface, cached on disk by what they follow from.

Letters in shapes: V vertices, F triangles, P vertices of one convex piece.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import GraspmapWarning, InvalidInputError, UnknownNameError
from graspmap.simulation import _child
from graspmap.simulation.piece_cache import kept_pieces
from graspmap.simulation.solids import checked_surface, mass_properties

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]
Method = Literal["cuts", "coacd"]

_VERSION = 1  # counts up whenever the same surface would give other pieces
_GRID = 2.0**-26  # of coordinates, of the longest side: a surface and its larger copy are one
_CONVEX = 1e-6  # of its volume may a convex surface lack of its hull
_MOST_PIECES = 300
_LEAST_VERTICES = 26


class PiecesWarning(GraspmapWarning):
    """The pieces are coarser, or made in another way, than was asked for."""


@dataclass(frozen=True)
class _Settings:
    threshold: float
    method: Method
    seed: int
    max_vertices: int
    timeout_s: float

    def __post_init__(self) -> None:
        if not 0.001 <= self.threshold <= 1:
            raise InvalidInputError("threshold", self.threshold, "0.001 to 1 of the longest side")
        if self.method not in get_args(Method):
            raise UnknownNameError("method", str(self.method), get_args(Method))
        if self.max_vertices < _LEAST_VERTICES:
            raise InvalidInputError("max_vertices", self.max_vertices, f">= {_LEAST_VERTICES}")
        if not 0 < self.timeout_s < math.inf:
            raise InvalidInputError("timeout_s", self.timeout_s, "seconds, above 0")


def convex_pieces(
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    threshold: float = 0.02,
    method: Method = "cuts",
    seed: int = 0,
    max_vertices: int = 128,
    timeout_s: float = 300.0,
    cache: Path | str | None = None,
) -> tuple[Floats, ...]:
    """Nearly convex pieces whose hulls together stand for a body in physics.

    The pieces of a surface are kept in a folder and found again by the content of the surface
    (wherever it lies and however large it is) and the settings.

    Args:
        vertices: (V, 3) of a closed surface, in any unit.
        faces: (F, 3) vertex numbers, counter-clockwise seen from outside.
        threshold: How far hulls may stand off the surface, in parts of the longest side of its box
            (coacd: its concavity, which is of half that side).
        method: ``"cuts"`` cuts by planes, in seconds, with the same result however busy the machine
            is. ``"coacd"`` searches, for minutes, in a child process that is stopped after
            ``timeout_s``; where it fails or is late, cuts are made and a warning is given.
        seed: Of CoACD's search.
        max_vertices: Of one hull, at least 26; larger ones lose what matters least.
        timeout_s: See ``method``.
        cache: Folder of the cache; by default `graspmap.files.cache_folder`.

    Returns:
        (P, 3) vertices of each piece, in the unit and frame of the surface. A convex surface is
        one piece.

    Raises:
        InvalidInputError: The surface is open, flat or inside out, or a setting is out of range.

    References:
        Wei et al., "Approximate convex decomposition for 3D meshes with collision-aware concavity
        and tree search", SIGGRAPH 2022 (CoACD).
    """
    settings = _Settings(threshold, method, seed, max_vertices, timeout_s)
    points, triangles = checked_surface(vertices, faces)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    longest = float(np.ptp(points, axis=0).max())
    if not longest > 0 or mass_properties(points, triangles).volume_m3 <= 0:
        raise InvalidInputError("surface", "flat or inside out", "a surface round a body")
    unit = np.round((points - middle) / longest / _GRID) * _GRID
    pieces, remark = kept_pieces(
        _facts(settings),
        (unit, triangles),
        lambda: _decompose(unit, triangles, settings),
        cache=cache,
    )
    if remark:
        warnings.warn(remark, PiecesWarning, stacklevel=2)
    return tuple(piece * longest + middle for piece in pieces)


def _decompose(vertices: Floats, faces: Faces, settings: _Settings) -> tuple[list[Floats], str]:
    """Pieces of a surface with a longest side of 1, and what is to be said of them."""
    from graspmap.simulation.cuts import cut_pieces
    from graspmap.simulation.hulls import fewer_vertices, hull_volume

    remark = ""
    parts: list[Floats] = []
    volume = mass_properties(vertices, faces).volume_m3
    if hull_volume(vertices) - volume <= _CONVEX * volume:
        parts = [vertices]
    elif settings.method == "coacd":
        parts, remark = _searched(vertices, faces, settings)
    if not parts:
        parts = cut_pieces(vertices, faces, settings.threshold, _MOST_PIECES)
    return [fewer_vertices(part, settings.max_vertices)[0] for part in parts], remark


def _searched(vertices: Floats, faces: Faces, settings: _Settings) -> tuple[list[Floats], str]:
    """The pieces that CoACD finds; none, and why, where it does not get there."""
    arguments: _child.Arrays = {
        "vertices": vertices,
        "faces": faces,
        "threshold": np.array(settings.threshold),
        "seed": np.array(settings.seed),
    }
    problem = ""
    for preprocess in ("auto", "on"):
        try:
            found = _child.call(
                "coacd", arguments | {"preprocess": np.array(preprocess)}, settings.timeout_s
            )
        except _child.ChildError as error:
            problem = str(error)
            if error.late:
                break  # a second search takes as long
            continue
        return [found[name] for name in sorted(found)], ""
    return [], f"CoACD failed: {problem}; the pieces are made by cuts"


def _facts(settings: _Settings) -> dict[str, object]:
    """What pieces follow from beside their surface."""
    facts: dict[str, object] = {"version": _VERSION, **asdict(settings)}
    if settings.method == "coacd":
        facts["coacd"] = version("coacd")
    else:  # what makes no difference must not make another key
        del facts["seed"], facts["timeout_s"]
    return facts
