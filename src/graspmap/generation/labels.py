"""Labels of a scene: candidate grasps, every one tried in physics with every jaw size.

Letters in shapes: N grasps tried, M candidates, J jaw sizes of the gripper, H rows, W columns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.generation.candidates import propose_grasps
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper
from graspmap.simulation.render import View
from graspmap.simulation.settings import TrialSettings
from graspmap.simulation.tabletop import Tabletop
from graspmap.simulation.trial import Outcome, TrialResult, run_trials

ANTIPODAL_SHARE = 0.7
"""Part of the candidates that is antipodal. Most of those hold, centred on what they hold, little
wider than it: labels that a network can learn from. Random ones, of which one in four holds, find
the failures and the grasps that nobody thinks of."""

DECIMALS = 4
"""Digits after the point of pixels and degrees in label files: a tenth of a micrometre, or so."""


@dataclass(frozen=True, eq=False)
class Labels:
    """What the trials of a scene say, in pixels of its picture.

    Args:
        positives: Grasps that held; one that holds with several jaw sizes comes once with each.
        negatives: Grasps that did not, in the same way.
        failures: How each of the negatives ended.
    """

    positives: Grasps
    negatives: Grasps
    failures: tuple[Outcome, ...]

    @property
    def trials(self) -> int:
        """How many grasps were tried."""
        return len(self.positives) + len(self.negatives)

    @property
    def outcomes(self) -> Mapping[str, int]:
        """How many trials ended which way; every outcome is there."""
        count = Counter(self.failures)
        count[Outcome.HELD] = len(self.positives)
        return MappingProxyType({outcome.value: count[outcome] for outcome in Outcome})


def label_tabletop(
    tabletop: Tabletop,
    view: View,
    depth_m: NDArray[np.float32],
    gripper: Gripper,
    count: int,
    rng: np.random.Generator,
    *,
    settings: TrialSettings | None = None,
    antipodal_share: float = ANTIPODAL_SHARE,
) -> Labels:
    """Try about ``count`` grasps on a scene.

    What is tried is what the label says when it is read with the written depth: a candidate is
    first turned into pixels, rounded as in the file, and brought back to the table with the depth
    at its pixel (`TableGrasps.from_pixels`). So a label, read from the files and tried again,
    gives the same result.

    Args:
        tabletop: The scene.
        view: The camera of its picture.
        depth_m: (H, W) exact depth seen by it, metres, NaN where there is none.
        gripper: The gripper; each of its J jaw sizes is tried.
        count: Trials, over all jaw sizes: ``count // J`` candidates, at least one, are proposed.
        rng: Source of everything random.
        settings: Of the trials.
        antipodal_share: See `propose_grasps`.

    Raises:
        InvalidInputError: ``count`` is not positive.
    """
    if count < 1:
        raise InvalidInputError("number of candidates", count, "1 or more")
    jaws = gripper.jaw_sizes_m
    candidates = propose_grasps(
        tabletop, gripper, max(1, count // len(jaws)), rng, antipodal_share=antipodal_share
    )
    seen = _in_pixels(candidates, tabletop, view)
    unit = TableGrasps.from_pixels(
        seen.replace(height=1.0), depth_m, view.camera, view.T_world_camera
    )
    # All jaws of a candidate stand together, as in Jacquard's files.
    sizes = np.outer(1 / unit.height_m, jaws).ravel()
    seen = as_written(seen[np.repeat(np.arange(len(seen)), len(jaws))].replace(height=sizes))
    seen = seen[np.flatnonzero((seen.width > 0) & (seen.height > 0))]
    table = TableGrasps.from_pixels(seen, depth_m, view.camera, view.T_world_camera)
    results = run_trials(tabletop, table, gripper, settings=settings)
    return _labels(seen, results)


def as_written(grasps: Grasps) -> Grasps:
    """Grasps with the digits that label files keep."""
    theta = np.round(-np.degrees(grasps.angle), DECIMALS)
    return Grasps(
        center=np.round(grasps.center, DECIMALS),
        angle=-np.radians(theta),
        width=np.round(grasps.width, DECIMALS),
        height=np.round(grasps.height, DECIMALS),
        quality=grasps.quality,
    )


def _in_pixels(candidates: TableGrasps, tabletop: Tabletop, view: View) -> Grasps:
    """Where the camera sees them, as far as their centres lie in the picture."""
    surface = tabletop.height_map.at(candidates.center_m)
    pixels = candidates.to_pixels(surface, view.camera, view.T_world_camera)
    x, y = pixels.center.T
    inside = (
        (x > -0.5) & (x < view.camera.width - 0.5) & (y > -0.5) & (y < view.camera.height - 0.5)
    )
    return as_written(pixels[np.flatnonzero(inside)])


def _labels(grasps: Grasps, results: list[TrialResult]) -> Labels:
    held = np.array([result.outcome is Outcome.HELD for result in results], dtype=bool)
    return Labels(
        positives=grasps[np.flatnonzero(held)],
        negatives=grasps[np.flatnonzero(~held)],
        failures=tuple(r.outcome for r in results if r.outcome is not Outcome.HELD),
    )
