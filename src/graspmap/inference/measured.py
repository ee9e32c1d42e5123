"""Parts of a weights file's card that say what was measured of it: calibration and evaluations."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, field_validator

from graspmap.errors import InvalidInputError
from graspmap.metrics.quality_map import QualityMap

Ends = tuple[float, float]
"""Lower and upper end of a 95 % interval."""


class _Card(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class QualityCard(_Card):
    """How far a quality is from the probability that the trial holds.

    Attributes:
        ece: Expected calibration error, 0 to 1.
        ece_interval: Its interval.
        brier: Brier score, 0 to 1.
        brier_interval: Its interval.
    """

    ece: float
    ece_interval: Ends
    brier: float
    brier_interval: Ends


class CalibrationCard(_Card):
    """The map from the network's quality to the probability that the trial holds.

    Attributes:
        knots: Pairs of quality and probability, see `graspmap.metrics.QualityMap`.
        data: Scenes that it was fitted on, ``kind:directory``.
        data_hash: ``manifest:`` and the hash of their manifest.json, which holds the hash of every
            file; where they have none, ``scenes:`` and that of their ids and objects.
        part: Part of their split; None: all of them.
        depth: Which of their depths the network saw; None: the default of their kind.
        grippers: Names of the grippers of the trials.
        perturbation: Standard deviations of place (m), angle (rad), and, relative, of friction and
            mass, where grasps were tried so perturbed; None: where they were said to be.
        top: How many grasps of a scene were tried.
        trials: How many trials.
        objects: Of how many objects.
        held: How many held.
        before: Of the network's own quality, cut to [0, 1].
        after: Of the probabilities, each by a map fitted without the trial's object.
    """

    knots: tuple[tuple[float, float], ...]
    data: str
    data_hash: str
    part: str | None = None
    depth: str | None = None
    grippers: tuple[str, ...]
    perturbation: tuple[float, float, float, float] | None = None
    top: int = Field(ge=1)
    trials: int = Field(ge=1)
    objects: int = Field(ge=1)
    held: int = Field(ge=0)
    before: QualityCard
    after: QualityCard

    @field_validator("knots")
    @classmethod
    def _make_a_map(cls, knots: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        try:
            return QualityMap(knots).knots
        except InvalidInputError as error:
            raise ValueError(f"no map of qualities ({error.allowed})") from error

    @property
    def quality_map(self) -> QualityMap:
        """The map."""
        return QualityMap(self.knots)


class TrialsCard(_Card):
    """What trials of the best grasps gave.

    Attributes:
        trials: How many.
        success: Share that held.
        interval: Its interval.
        grippers: Names of the grippers.
        quality: How far the quality was from the probability; None where it was not measured.
    """

    trials: int = Field(ge=1)
    success: float
    interval: Ends
    grippers: tuple[str, ...]
    quality: QualityCard | None = None


class EvaluationCard(_Card):
    """Headline numbers of an evaluation.

    Attributes:
        data: The scenes, ``kind:directory``.
        data_hash: As in `CalibrationCard`.
        part: Part of their split; None: all of them.
        scenes: How many were measured.
        protocol: How rectangles were counted.
        success: Share of right rectangles, by threshold of the overlap (``"0.25"``).
        interval: Its interval, likewise.
        miou: Mean overlap.
        cluster: What the intervals take as independent: ``scene`` or ``object``.
        trials: What trials gave; None where none were made.
    """

    data: str
    data_hash: str
    part: str | None = None
    scenes: int = Field(ge=1)
    protocol: str
    success: dict[str, float]
    interval: dict[str, Ends]
    miou: float
    cluster: str
    trials: TrialsCard | None = None
