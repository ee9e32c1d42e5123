"""Detectors that do not look: what any trained detector has to beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.data.scene import Depth, Rgb, Scenes
from graspmap.errors import InvalidInputError
from graspmap.geometry.grasps import Grasps, angle_difference

_STEPS = 360
"""Candidate angles for the median: half a degree apart."""


@dataclass(frozen=True)
class CenterGrasp:
    """Grasps the middle of every picture, always the same way.

    Args:
        angle: Radians.
        width: Opening, pixels.

    Raises:
        InvalidInputError: At `detect`, when a number is not finite or the width is negative.
    """

    angle: float
    width: float

    def detect(
        self,
        rgb: Rgb | None = None,
        depth: Depth | None = None,
        *,
        top: int = 1,  # noqa: ARG002  # it has one grasp, whatever is asked for
        **options: Any,  # noqa: ARG002  # so that it stands in for any detector
    ) -> CenterDetection:
        """One grasp at the picture's centre, its jaw half its opening.

        Raises:
            InvalidInputError: There is neither colour nor depth to take the centre of.
        """
        picture = rgb if rgb is not None else depth
        if picture is None:
            raise InvalidInputError("rgb and depth", "both missing", "at least one")
        rows, columns = picture.shape[:2]
        center = [[(columns - 1) / 2, (rows - 1) / 2]]
        return CenterDetection(Grasps(center, [self.angle], [self.width], [self.width / 2]))  # type: ignore[arg-type]  # lists are converted


@dataclass(frozen=True, eq=False)
class CenterDetection:
    """What `CenterGrasp` found.

    Attributes:
        grasps: The one grasp, pixels.
    """

    grasps: Grasps


def center_grasp_baseline(training: Scenes) -> CenterGrasp:
    """The centre grasp that knows the training labels: their median angle and opening.

    An angle has no middle on a half circle, so its median is the angle from which the labels
    turn away least on average (to half a degree). Openings are in pixels of their pictures,
    which therefore should have one size.

    Args:
        training: Labelled scenes, not those of the test.

    Raises:
        InvalidInputError: No scene has a label.
    """
    parts = [training.read_grasps(i) for i in range(len(training))]
    labels = Grasps.concatenate(part for part in parts if part is not None)
    if not len(labels):
        raise InvalidInputError(
            f"labels of {training.kind}:{training.root}", "none", "scenes with labelled grasps"
        )
    return CenterGrasp(median_angle(labels.angle), float(np.median(labels.width)))


def median_angle(angle: NDArray[np.float64]) -> float:
    """Angle from which (N,) grasp angles differ least on average, radians, to half a degree."""
    candidates = (np.arange(_STEPS) / _STEPS - 0.5) * np.pi
    nearest = np.round((angle + np.pi / 2) * (_STEPS / np.pi)).astype(np.int64) % _STEPS
    times = np.bincount(nearest, minlength=_STEPS)
    turn = angle_difference(candidates[:, None], candidates) @ times
    return float(candidates[np.argmin(turn)])
