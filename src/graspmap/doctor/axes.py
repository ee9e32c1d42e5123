"""Do the labels' axes and angles fit the pictures? Evidence from the pictures themselves.

A label file may have been written by a program that counts angles the other way round, exchanges
x and y, or takes the jaw for the opening. Nothing in the numbers shows it, the pictures do: on
average the picture changes most along the opening of a grasp, because its jaws stand on the two
sides of something.

Letters in shapes: N grasps, H rows, W columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.data.scene import Scene
from graspmap.geometry.grasps import Grasps

READINGS = {
    "as read": "as graspmap reads them",
    "mirrored": "with the sign of the angle turned round",
    "quarter turn": "with opening and jaw exchanged",
    "swapped": "with x and y exchanged",
}
"""The readings of a label file that are compared."""

_MOST_GRASPS = 60
"""Grasps of one scene that are looked at, evenly spread over its list."""
_LEAST_GRASPS = 20
"""Fewer grasps than this give no verdict."""
_MARGIN = 0.03
"""By how much another reading must fit better to be believed (0.5 is chance, 1 perfect)."""


@dataclass(frozen=True)
class AxisEvidence:
    """How well each reading fits the pictures.

    Args:
        fit: Reading to the mean share (0 to 1) of the picture's change that lies along the
            opening; 0.5 is chance.
        count: Grasps looked at.
        best: The reading that fits best, or None where there is too little evidence.
    """

    fit: dict[str, float]
    count: int
    best: str | None


class AxisVotes:
    """Gathers evidence scene by scene."""

    def __init__(self) -> None:
        self._shares: dict[str, list[NDArray[np.float64]]] = {name: [] for name in READINGS}
        self._weights: list[NDArray[np.float64]] = []

    def add(self, scene: Scene) -> None:
        """Add a scene's labels as evidence, if it has any."""
        grasps = scene.grasps
        if grasps is None or not len(grasps):
            return
        chosen = np.unique(np.linspace(0, len(grasps) - 1, _MOST_GRASPS).round().astype(int))
        grasps = grasps[chosen]
        picture = _picture(scene)
        tensor = _structure(picture)
        for name in READINGS:
            self._shares[name].append(_share(tensor, _reading(grasps, name)))
        # A mirrored angle differs little near 0 and 90 degrees: such grasps say nothing about it.
        self._weights.append(np.abs(np.sin(2 * grasps.angle)))

    def evidence(self) -> AxisEvidence:
        """What all scenes together say."""
        count = sum(map(len, self._weights))
        if not count:
            return AxisEvidence({}, 0, None)
        shares = {name: np.concatenate(parts) for name, parts in self._shares.items()}
        weights = np.concatenate(self._weights)
        fit, rival = {}, {}
        for name, share in shares.items():
            known = np.isfinite(share) & np.isfinite(shares["as read"])
            weight = weights[known] if name == "mirrored" else np.ones(int(known.sum()))
            if weight.sum() < _LEAST_GRASPS / 2 or known.sum() < _LEAST_GRASPS:
                continue
            fit[name] = float(np.average(share[known], weights=weight))
            # Each reading is compared with ours on the same grasps, equally weighted.
            rival[name] = fit[name] - float(np.average(shares["as read"][known], weights=weight))
        if "as read" not in fit:
            return AxisEvidence(fit, count, None)
        best = max(rival, key=lambda name: rival[name])
        return AxisEvidence(fit, count, best if rival[best] > _MARGIN else "as read")


def _reading(grasps: Grasps, name: str) -> Grasps:
    """The grasps as another program might have meant them."""
    if name == "mirrored":
        return grasps.replace(angle=-grasps.angle)
    if name == "quarter turn":
        return grasps.replace(angle=grasps.angle + np.pi / 2)
    if name == "swapped":
        return grasps.replace(center=grasps.center[:, ::-1], angle=np.pi / 2 - grasps.angle)
    return grasps


def _picture(scene: Scene) -> NDArray[np.float32]:
    """(H, W) the clearest view of the object's outline: mask, else colour, else depth."""
    if scene.mask is not None and scene.mask.any() and not scene.mask.all():
        return scene.mask.astype(np.float32)
    if scene.rgb is not None:
        return np.asarray(scene.rgb.mean(axis=2, dtype=np.float32) / 255)
    assert scene.depth is not None  # for the type checker; a Scene has one of the two
    known = np.isfinite(scene.depth)
    middle = np.float32(np.median(scene.depth[known])) if known.any() else np.float32(0)
    return np.asarray(np.where(known, scene.depth, middle))


def _structure(picture: NDArray[np.float32]) -> NDArray[np.float64]:
    """(3, H + 1, W + 1) running sums of gx gx, gx gy, gy gy of the smoothed picture."""
    import cv2

    smooth = cv2.GaussianBlur(picture, (0, 0), 1.5)
    gx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=3)
    gy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=3)
    return np.stack([cv2.integral(p, sdepth=cv2.CV_64F) for p in (gx * gx, gx * gy, gy * gy)])


def _share(sums: NDArray[np.float64], grasps: Grasps) -> NDArray[np.float64]:
    """(N,) share of the change in a square round each grasp that lies along its opening.

    The square reaches a little beyond the opening. NaN where it lies outside the picture or shows
    no change at all.
    """
    rows, columns = sums.shape[1] - 1, sums.shape[2] - 1
    half = np.maximum(0.6 * grasps.width, 3.0)
    x, y = grasps.center.T
    x0, x1 = (np.clip(np.rint(v), 0, columns).astype(int) for v in (x - half, x + half + 1))
    y0, y1 = (np.clip(np.rint(v), 0, rows).astype(int) for v in (y - half, y + half + 1))
    xx, xy, yy = sums[:, y1, x1] - sums[:, y0, x1] - sums[:, y1, x0] + sums[:, y0, x0]
    ax, ay = grasps.axis().T
    along: NDArray[Any] = ax * ax * xx + 2 * ax * ay * xy + ay * ay * yy
    total = xx + yy
    seen = (total > 1e-6) & (x1 > x0) & (y1 > y0)
    return np.where(seen, along / np.where(seen, total, 1.0), np.nan)
