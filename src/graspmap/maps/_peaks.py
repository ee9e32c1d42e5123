"""What the ways of `graspmap.maps.find` share: smoothing, the pixels of peaks, their distance.

Letters in shapes: N orientation bins, (H, W) image. Pixels (x right, y down), centres at integers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError

Singles = NDArray[np.float32]
Bools = NDArray[np.bool_]

Row = tuple[float, float, float, float, float, float]
"""One grasp as read from the maps: x, y, cos, sin, scaled width, quality."""


def smoothed(maps: Singles, sigma: float) -> Singles:
    """(N, H, W) maps after a Gaussian blur; the border's values go on outside."""
    if sigma == 0:
        return maps
    import cv2

    side = 2 * int(4 * sigma + 0.5) + 1
    blurred = np.empty_like(maps)
    for source, target in zip(maps, blurred, strict=True):
        cv2.GaussianBlur(source, (side, side), sigma, dst=target, borderType=cv2.BORDER_REPLICATE)
    return blurred


def seeds(score: Singles, allowed: Bools | None, top: int, threshold: float) -> NDArray[np.intp]:
    """Flat indices of the peaks above the threshold, best first; only the best if top is 1."""
    if allowed is not None:
        score = np.where(allowed, score, np.float32(-np.inf))
    best = int(score.argmax())  # a NaN counts as the greatest
    peak = float(score.flat[best])
    if np.isnan(peak):
        check_finite(peak)
    if not peak > threshold:
        return np.zeros(0, np.intp)
    if top == 1:
        return np.array([best])
    import cv2

    square = np.ones((3, 3), np.uint8)
    peaks = np.stack([cv2.dilate(m, square) <= m for m in score]) & (score > threshold)
    return by_value(score, np.flatnonzero(peaks))


def by_value(score: Singles, indices: NDArray[np.intp]) -> NDArray[np.intp]:
    """Indices by falling value; of equal ones the first in the image."""
    return indices[np.argsort(-score.reshape(-1)[indices], kind="stable")]


def near(found: list[Row], x: float, y: float, distance: float) -> bool:
    return any((x - f[0]) ** 2 + (y - f[1]) ** 2 < distance**2 for f in found)


def check_finite(values: Any) -> None:
    if not np.isfinite(values).all():
        raise InvalidInputError(
            "value in the maps", "NaN or infinite", "finite numbers; look at the weights and input"
        )
