"""Compiled noise from whole numbers, products and roots alone.

Nothing here is taken from the C library (sine, power), whose last bits differ between processors.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled

Floats = NDArray[np.float64]

_LAST = 1023  # of the tables of noise; beyond, they repeat


def _tables() -> tuple[NDArray[np.int64], Floats]:
    """Whole numbers 0 to 1023 in a shuffled order, and as many numbers from 0 to 1."""
    state, keys = 12345, []
    for _ in range(2 * (_LAST + 1)):
        state = (state * 1103515245 + 12345) % 2**31
        keys.append(state >> 8)
    order = sorted(range(_LAST + 1), key=keys.__getitem__)
    return np.array(order), np.array(keys[_LAST + 1 :]) / 2.0**23


_SHUFFLED, _RANDOM = _tables()


@compiled
def hashed(x: int, y: int, z: int, seed: int) -> int:
    """31 bits that look random, from four whole numbers."""
    mask = 0xFFFFFFFF
    h = (x * 374761393 + y * 668265263 + z * 1103515245 + seed * 974634777) & mask
    h = ((h ^ (h >> 15)) * 739982445) & mask
    h = ((h ^ (h >> 12)) * 695872825) & mask
    h = h ^ (h >> 15)
    return h & 0x7FFFFFFF


@compiled
def many_bits(x: int, y: int, z: int, seed: int) -> int:
    """63 bits that look random, from four whole numbers; products wrap around at 2^64."""
    h = x * 374761393 + y * 668265263 + z * 1103515245 + seed * 974634777
    h = (h ^ ((h >> 30) & 0x3FFFFFFFF)) * -4658895280553007687
    h = (h ^ ((h >> 27) & 0x1FFFFFFFFF)) * -7723592293110705685
    return (h ^ ((h >> 31) & 0x1FFFFFFFF)) & 0x7FFFFFFFFFFFFFFF


@compiled
def chance(x: int, y: int, z: int, seed: int) -> float:
    """A number in [0, 1) from four whole numbers."""
    return hashed(x, y, z, seed) * (1.0 / 2147483648.0)


@compiled
def smooth(t: float) -> float:
    """0 to 1 with level ends."""
    return t * t * (3.0 - 2.0 * t)


@compiled
def step(edge: float, soft: float, x: float) -> float:
    """0 below an edge, 1 above, rising over ``soft``."""
    return smooth(min(max((x - edge) / soft + 0.5, 0.0), 1.0))


@compiled
def wave(x: float) -> float:
    """A smooth wave of period 1 between 0 and 1."""
    t = x - math.floor(x)
    return smooth(2.0 * t if t < 0.5 else 2.0 - 2.0 * t)


@compiled
def _between(a: float, b: float, c: float, d: float, u: float, v: float) -> float:
    """Between four corners of a square, at (u, v) in it."""
    low = a + (b - a) * u
    return low + ((c + (d - c) * u) - low) * v


@compiled
def noise(x: float, y: float, z: float, seed: int) -> float:
    """Smooth noise between 0 and 1 with bumps of size 1."""
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = smooth(x - fx), smooth(y - fy), smooth(z - fz)
    i, j, k = int(fx), int(fy) + seed, int(fz) + 37 * seed
    p, q = _SHUFFLED[k & _LAST], _SHUFFLED[(k + 1) & _LAST]
    a, b = i + _SHUFFLED[(j + p) & _LAST], i + _SHUFFLED[(j + 1 + p) & _LAST]
    c, d = i + _SHUFFLED[(j + q) & _LAST], i + _SHUFFLED[(j + 1 + q) & _LAST]
    low = _between(
        _RANDOM[a & _LAST],
        _RANDOM[(a + 1) & _LAST],
        _RANDOM[b & _LAST],
        _RANDOM[(b + 1) & _LAST],
        *(u, v),
    )
    high = _between(
        _RANDOM[c & _LAST],
        _RANDOM[(c + 1) & _LAST],
        _RANDOM[d & _LAST],
        _RANDOM[(d + 1) & _LAST],
        *(u, v),
    )
    return low + (high - low) * w


@compiled
def flat_noise(x: float, y: float, seed: int) -> float:
    """The same on a plane."""
    fx, fy = math.floor(x), math.floor(y)
    u, v = smooth(x - fx), smooth(y - fy)
    i, j = int(fx), int(fy) + seed
    a, b = i + _SHUFFLED[j & _LAST], i + _SHUFFLED[(j + 1) & _LAST]
    return _between(
        _RANDOM[a & _LAST],
        _RANDOM[(a + 1) & _LAST],
        _RANDOM[b & _LAST],
        _RANDOM[(b + 1) & _LAST],
        *(u, v),
    )


@compiled
def clouds(x: float, y: float, z: float, seed: int, pixel: float) -> float:
    """Noise over several sizes, 0 to 1; sizes below two pixels are left out."""
    total, weight, size = 0.0, 0.5, 1.0
    for octave in range(4):
        if octave and pixel > 0.5 * size:
            break
        total += weight * (noise(x, y, z, seed + 7 * octave) - 0.5)
        weight, size, x, y, z = weight * 0.5, size * 0.5, 2.0 * x, 2.0 * y, 2.0 * z
    return min(max(0.5 + 1.4 * total, 0.0), 1.0)


@compiled
def flat_clouds(x: float, y: float, seed: int, pixel: float, octaves: int) -> float:
    """The same on a plane, with so many sizes."""
    total, weight, size = 0.0, 0.5, 1.0
    for octave in range(octaves):
        if octave and pixel > 0.5 * size:
            break
        total += weight * (flat_noise(x, y, seed + 7 * octave) - 0.5)
        weight, size, x, y = weight * 0.5, size * 0.5, 2.0 * x, 2.0 * y
    return min(max(0.5 + 1.4 * total, 0.0), 1.0)


@compiled
def spots(x: float, y: float, z: float, seed: int, flat: bool) -> Any:
    """Whether a point lies on one of many spots, one in each cell, and a number of the spot."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    for a in range(-1, 2):
        for b in range(-1, 2):
            for c in range(0 if flat else -1, 1 if flat else 2):
                p, q, r = int(i) + a, int(j) + b, 0 if flat else int(k) + c
                radius = 0.12 + 0.28 * chance(p, q, r, seed + 3)
                dx = x - (p + chance(p, q, r, seed))
                dy = y - (q + chance(p, q, r, seed + 1))
                dz = 0.0 if flat else z - (r + chance(p, q, r, seed + 2))
                if dx * dx + dy * dy + dz * dz < radius * radius:
                    return True, chance(p, q, r, seed + 4)
    return False, 0.0


@compiled
def cell(x: float, y: float, z: float, seed: int) -> float:
    """A number of the patch in which a point lies; patches surround scattered points."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    nearest, found = np.inf, 0.0
    for a in range(-1, 2):
        for b in range(-1, 2):
            for c in range(-1, 2):
                p, q, r = i + a, j + b, k + c
                dx = x - (p + chance(p, q, r, seed))
                dy = y - (q + chance(p, q, r, seed + 1))
                dz = z - (r + chance(p, q, r, seed + 2))
                away = dx * dx + dy * dy + dz * dz
                if away < nearest:
                    nearest, found = away, chance(p, q, r, seed + 3)
    return found
