"""Blobs: bodies without a name, from a random function over space.

A compositional pattern-producing network (a small network with mixed activations) is evaluated on
a grid; the body is where it exceeds a bound that falls with the distance from the middle. How many
units it has, and how fast their inputs vary, is the drawn complexity.

References:
    Morrison, Corke, Leitner, "EGAD! An evolved grasping analysis dataset for diversity and
    reproducibility in robotic manipulation", RA-L 2020 (who evolve such functions).
    Stanley, "Compositional pattern producing networks", GPEM 2007.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from fast_simplification import simplify
from scipy import ndimage
from skimage.measure import marching_cubes

from graspmap.simulation.piece_cache import kept_pieces
from graspmap.simulation.procedural.blob_pieces import CUTS_VERSION, pieces_by_cuts
from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.solid import Faces, Floats, Solid, arrays, manifold, snap

_CELLS = 40  # along each side of the grid
_FACES = 2500
_MOST_PIECES = 64
_TOLERANCE = 0.012  # of the longest side


def _sine(x: Floats) -> Floats:
    return np.asarray(np.sin(math.pi * x))


def _bump(x: Floats) -> Floats:
    return np.asarray(2 * np.exp(-(x**2)) - 1)


def _bend(x: Floats) -> Floats:
    return np.asarray(np.tanh(1.5 * x))


def _fold(x: Floats) -> Floats:
    return np.asarray(np.abs(x) - 0.6)


_ACTIVATIONS: tuple[Callable[[Floats], Floats], ...] = (_sine, _bump, _bend, _fold)


def _field(draw: Draw, complexity: float) -> Floats:
    """(n, n, n) values of the network over [-1, 1]^3, of mean 0 and deviation 1."""
    axis = np.linspace(-1, 1, _CELLS)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    frequency = 0.6 + 1.6 * complexity
    values = [x * frequency, y * frequency, z * frequency, np.sqrt(x**2 + y**2 + z**2) * frequency]
    layers, units = 1 + round(2 * complexity), 4 + round(6 * complexity)
    for _ in range(layers):
        fresh = []
        for _ in range(units):
            weights = draw.rng.normal(size=len(values)) * (2 / len(values)) ** 0.5
            bias = draw.uniform(-1, 1)
            total = sum((w * v for w, v in zip(weights.tolist(), values, strict=True)), bias)
            fresh.append(draw.choice(_ACTIVATIONS)(np.asarray(total)))
        values = fresh
    weights = draw.rng.normal(size=len(values))
    total = np.asarray(sum(w * v for w, v in zip(weights.tolist(), values, strict=True)))
    return np.asarray((total - total.mean()) / max(float(total.std()), 1e-9))


def _body(field: Floats) -> tuple[Floats, Faces]:
    """Surface of the largest lump where a field is positive, without inner hollows."""
    inside = np.zeros(field.shape, bool)
    inside[2:-2, 2:-2, 2:-2] = field[2:-2, 2:-2, 2:-2] > 0
    # Threads and films of one cell go.
    inside = ndimage.binary_opening(inside, ndimage.generate_binary_structure(3, 2))
    labels, count = ndimage.label(inside)
    if count == 0:
        return np.empty((0, 3)), np.empty((0, 3), np.int32)
    sizes = np.bincount(labels.ravel())
    lump = ndimage.binary_fill_holes(labels == 1 + int(np.argmax(sizes[1:])))
    # The blurred lump has a smooth surface and no two parts that touch in a corner.
    level = ndimage.gaussian_filter(lump.astype(np.float64), 1.3)
    vertices, faces, _, _ = marching_cubes(level, 0.5)  # type: ignore[no-untyped-call]
    return np.asarray(vertices, dtype=np.float64), np.asarray(faces[:, ::-1], dtype=np.int32)


def _drawn_body(draw: Draw, complexity: float) -> tuple[Floats, Faces]:
    """Surface of a noisy ellipsoid; without faces where it is nowhere thick."""
    field = _field(draw, complexity)
    axis = np.linspace(-1, 1, _CELLS)
    stretch = [draw.uniform(0.55, 1) for _ in range(3)]
    x, y, z = np.meshgrid(*(axis / s for s in stretch), indexing="ij")
    distance = np.sqrt(x**2 + y**2 + z**2)
    strength = 0.12 + 0.25 * complexity
    return _body(strength * field + 0.62 - distance)


def _blob(draw: Draw, complexity: float) -> Solid:
    vertices, faces = _drawn_body(draw, complexity)
    while not len(faces):  # about one of 10,000 fields is nowhere thick enough for a body
        vertices, faces = _drawn_body(draw, complexity)
    fewer, triangles = simplify(
        vertices.astype(np.float32), faces, target_count=min(_FACES, len(faces))
    )
    size = np.ptp(fewer, axis=0)
    ratio = float(np.sort(size)[0] / size.max())
    length = draw.longest(ratio)
    points = snap((fewer - fewer.mean(axis=0)) * (length / float(size.max())))
    body = max(manifold(points, triangles).decompose(), key=lambda part: part.volume())
    points, triangles = arrays(body)
    return Solid(points, triangles, _kept_pieces(points, triangles, _TOLERANCE * length))


def _kept_pieces(vertices: Floats, faces: Faces, tolerance_m: float) -> tuple[Floats, ...]:
    """Pieces of a body. They take a second, whoever tries a grasp needs them again: kept."""
    pieces, _ = kept_pieces(
        {
            "method": "blob",
            "version": CUTS_VERSION,
            "tolerance_m": tolerance_m,
            "most": _MOST_PIECES,
        },
        (vertices, faces),
        lambda: (pieces_by_cuts(vertices, faces, tolerance_m, _MOST_PIECES), ""),
    )
    return tuple(pieces)


def _plain(draw: Draw) -> Solid:
    return _blob(draw, draw.uniform(0, 0.4))


def _lumpy(draw: Draw) -> Solid:
    return _blob(draw, draw.uniform(0.4, 0.8))


def _wild(draw: Draw) -> Solid:
    return _blob(draw, draw.uniform(0.8, 1.2))


SHAPES: dict[str, Callable[[Draw], Solid]] = {
    "pebble": _plain,
    "lump": _lumpy,
    "knot": _wild,
}
"""Shapes of the family by name, from simple to complex."""
