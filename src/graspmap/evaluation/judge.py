"""Judging the grasps of every labelled scene by one or several protocols."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from graspmap.data.scene import Scene, Scenes
from graspmap.errors import InvalidInputError
from graspmap.evaluation.results import Evaluation, SceneResult, object_groups
from graspmap.geometry.grasps import Grasps
from graspmap.metrics.protocols import RectangleProtocol, find_protocol
from graspmap.metrics.rectangle import ANGLES_DEG, MAX_ANGLE, overlap_by_angle, score_rectangles

Jaw = Literal["half", "given"]
Cluster = Literal["scene", "object"]
Progress = Callable[[int, int], object]
"""Called with the scenes done and the scenes in all."""

GraspsOf = Callable[[int, Scene | None], Callable[[RectangleProtocol], Grasps]]
"""Called with a scene's number and, where pictures are read, the scene: gives the grasps, pixels of
the whole picture, best first, by protocol."""

_TOLERANCES = tuple(np.radians(ANGLES_DEG).tolist())
_CUSTOMARY = ANGLES_DEG.index(round(math.degrees(MAX_ANGLE)))
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Judge:
    """How grasps are judged; arguments as in `graspmap.evaluation.evaluate_detector`.

    Raises:
        UnknownNameError: There is no such protocol.
        InvalidInputError: Another option is not allowed.
    """

    protocol: str | RectangleProtocol
    also: Sequence[str | RectangleProtocol]
    thresholds: Sequence[float]
    confidence: float
    cluster: Cluster
    jaw: Jaw
    seed: int
    top: int

    def __post_init__(self) -> None:
        for name, value, allowed in (
            ("cluster", self.cluster, ("scene", "object")),
            ("jaw", self.jaw, ("half", "given")),
        ):
            if value not in allowed:
                raise InvalidInputError(name, repr(value), ", ".join(allowed))
        if self.top < 1:
            raise InvalidInputError("top", self.top, "1 or more grasps")
        names = [protocol.name for protocol in self.protocols]
        if len(set(names)) < len(names):
            raise InvalidInputError("protocols", ", ".join(names), "each of them once")

    @property
    def protocols(self) -> tuple[RectangleProtocol, ...]:
        """All protocols, the one that counts first."""
        return tuple(map(find_protocol, (self.protocol, *self.also)))

    def evaluate(
        self,
        scenes: Scenes,
        grasps_of: GraspsOf,
        progress: Progress | None = None,
        *,
        pictures: bool = False,
    ) -> Evaluation:
        """Judge all labelled scenes.

        Args:
            scenes: The scenes.
            grasps_of: Gives the grasps of a scene.
            progress: Called after each scene.
            pictures: Whether ``grasps_of`` needs the pictures; scenes without labels are never
                opened.

        Raises:
            InvalidInputError: No scene has a label.
            FileError: A file is missing or damaged.
        """
        results: dict[str, list[SceneResult]] = {p.name: [] for p in self.protocols}
        without_labels = []
        for index, (labels, scene) in enumerate(_read(scenes, pictures)):
            if labels is None:
                without_labels.append(scenes.ids[index])
            else:
                grasps, place = (
                    grasps_of(index, scene),
                    (scenes.ids[index], scenes.object_id(index)),
                )
                for by in self.protocols:
                    results[by.name].append(self._one(*place, grasps(by), labels, by))
            if progress is not None:
                progress(index + 1, len(scenes))
        data = f"{scenes.kind}:{scenes.root}"
        if not any(results.values()):
            raise InvalidInputError(
                f"labels of {data}", f"none in {len(scenes)} scenes", "scenes with labelled grasps"
            )
        if without_labels:
            _LOG.warning("%s: %d scenes without labels left out", data, len(without_labels))
        first, *others = (
            self._score(data, by, results[by.name], tuple(without_labels)) for by in self.protocols
        )
        return replace(first, others=tuple(others))

    def _one(
        self,
        name: str,
        object_id: str | None,
        grasps: Grasps,
        labels: Grasps,
        protocol: RectangleProtocol,
    ) -> SceneResult:
        grasps = grasps[: self.top]
        if self.jaw == "half":
            grasps = grasps.replace(height=grasps.width / 2)
        overlaps = overlap_by_angle(grasps, labels, _TOLERANCES, overlap=protocol.overlap)
        by_angle = overlaps[0] if len(grasps) else np.zeros(len(_TOLERANCES))
        return SceneResult(name, object_id, grasps, overlaps[:, _CUSTOMARY], by_angle)

    def _score(
        self,
        data: str,
        protocol: RectangleProtocol,
        results: Sequence[SceneResult],
        without_labels: tuple[str, ...],
    ) -> Evaluation:
        score = score_rectangles(
            [result.iou for result in results],
            rng=np.random.default_rng(self.seed),
            thresholds=self.thresholds,
            confidence=self.confidence,
            groups=object_groups(results) if self.cluster == "object" else None,
            rule=protocol.rule,
        )
        return Evaluation(
            data=data,
            protocol=protocol,
            score=score,
            results=tuple(results),
            without_labels=without_labels,
            cluster=self.cluster,
            top=self.top,
            seed=self.seed,
        )


def _read(scenes: Scenes, pictures: bool) -> Iterator[tuple[Grasps | None, Scene | None]]:
    """Labels of each scene (None: there are none) and, if asked for, its pictures."""
    if not pictures:
        yield from ((_labels(scenes, index), None) for index in range(len(scenes)))
        return

    def read(index: int) -> tuple[Grasps | None, Scene | None]:
        labels = _labels(scenes, index)
        return labels, None if labels is None else scenes.read(index)

    # The next picture is decoded while the network looks at this one.
    with ThreadPoolExecutor(1) as beside:
        coming = beside.submit(read, 0) if len(scenes) else None
        for index in range(1, len(scenes) + 1):
            assert coming is not None  # there is a scene to read
            found = coming.result()
            coming = beside.submit(read, index) if index < len(scenes) else None
            yield found


def _labels(scenes: Scenes, index: int) -> Grasps | None:
    labels = scenes.read_grasps(index)
    return labels if labels is not None and len(labels) else None
