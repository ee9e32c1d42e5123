"""Compiled camera: from linear light to the bytes of a picture.

Letters in shapes: (H, W) picture.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled
from graspmap.simulation.render._noise_kernel import many_bits

Singles = NDArray[np.float32]


@compiled
def bell(x: int, y: int, z: int, seed: int) -> float:
    """A number from nearly a normal distribution (mean 0, variance 1), from four whole numbers.

    The sum of six uniform numbers: it ends at 4.2 standard deviations.
    """
    bits = many_bits(x, y, z, seed)
    total = (bits & 0x3FF) + ((bits >> 10) & 0x3FF) + ((bits >> 20) & 0x3FF)
    total += ((bits >> 30) & 0x3FF) + ((bits >> 40) & 0x3FF) + ((bits >> 50) & 0x3FF)
    # Six whole numbers from 0 to 1023: mean 3069, variance 6 (1024^2 - 1) / 12.
    return (total - 3069.0) * 0.0013810686


@compiled
def linear(byte: float) -> float:
    """Linear light of an sRGB value from 0 to 1: a polynomial within 0.001 of the standard's."""
    out: float = byte * (byte * (byte * 0.305306011 + 0.682171111) + 0.012522878)
    return out


@compiled
def encoded(light: float) -> float:
    """The sRGB value from 0 to 1 of linear light: a polynomial of its root, within 0.013."""
    root = math.sqrt(light)
    out = root * (10.174782636716628 - root * 3.9712536049794878) - 9.215483176696607
    out = root * (0.71541850941188 + root * (3.2840535379494025 + root * out))
    return min(max(out, 0.0), 1.0)


@compiled
def linear_pictures(pictures: NDArray[np.uint8], out: Singles) -> None:
    """(pixels, 3) sRGB bytes to linear light."""
    table = np.empty(256)
    for value in range(256):
        table[value] = linear(value / 255.0)
    for i in range(len(pictures)):
        for k in range(3):
            out[i, k] = table[pictures[i, k]]


@compiled
def blur(light: Singles, side: float, across: Singles, out: Singles) -> None:
    """(H, W, 3) picture in which each pixel gives ``side`` of its light to each neighbour.

    Along rows into ``across``, then along columns into ``out``; at the border the pixel itself
    stands for its neighbour outside.
    """
    rows, columns, _ = light.shape
    keep = 1.0 - 2.0 * side
    for row in range(rows):
        for column in range(columns):
            left, right = max(column - 1, 0), min(column + 1, columns - 1)
            for k in range(3):
                beside = light[row, left, k] + light[row, right, k]
                across[row, column, k] = keep * light[row, column, k] + side * beside
    for row in range(rows):
        above, below = max(row - 1, 0), min(row + 1, rows - 1)
        for column in range(columns):
            for k in range(3):
                beside = across[above, column, k] + across[below, column, k]
                out[row, column, k] = keep * across[row, column, k] + side * beside


@compiled
def develop(
    light: Singles,
    gains: Any,
    vignette: float,
    read: float,
    shot: float,
    seed: int,
    out: NDArray[np.uint8],
) -> None:
    """Bytes from linear light.

    Args:
        light: (H, W, 3).
        gains: Of red, green and blue.
        vignette: Loss of light in the corners, 0 to 1.
        read: Standard deviation of the noise in the dark, of full white.
        shot: The same at full white, where it comes from the light.
        seed: Of the noise.
        out: (H, W, 3) out.
    """
    rows, columns, _ = light.shape
    middle_y, middle_x = (rows - 1) / 2.0, (columns - 1) / 2.0
    scale = 1.0 / max(middle_x * middle_x + middle_y * middle_y, 1.0)
    noisy = read > 0.0 or shot > 0.0
    for row in range(rows):
        for column in range(columns):
            dy, dx = row - middle_y, column - middle_x
            fall = 1.0 - vignette * (dx * dx + dy * dy) * scale
            for k in range(3):
                x = light[row, column, k] * gains[k] * fall
                # Highlights are pressed together instead of cut off.
                if x > 0.7:
                    x = 0.7 + 0.3 * (x - 0.7) / (x - 0.7 + 0.3)
                value = encoded(max(x, 0.0))
                if noisy:
                    sigma = math.sqrt(read * read + shot * shot * value)
                    value += sigma * bell(column, row, k, seed)
                out[row, column, k] = int(min(max(value, 0.0), 1.0) * 255.0 + 0.5)
