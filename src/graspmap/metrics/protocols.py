"""Ways to decode and count that others report with, so that their numbers can be set beside ours.

Each protocol takes the best grasp of a scene, its jaw half its opening. They differ in what the
detector sees, in how the grasp is read from the maps, in how the overlap is computed, and in when
it is enough. `QUIRKS` changes ``strict`` in one of these at a time, so that each habit has a price.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from graspmap.errors import UnknownNameError
from graspmap.metrics.rectangle import Overlap, Rule

Decoding = Literal["refined", "ggcnn", "orange"]
View = Literal["whole", "labels", "augmented"]


@dataclass(frozen=True)
class RectangleProtocol:
    """How a grasp is read from the maps and judged.

    Attributes:
        name: Name on the command line and in results.
        decoding: Method of `graspmap.maps.find_grasps`.
        overlap: How overlaps are computed, see `best_overlap`.
        rule: When an overlap reaches a threshold, see `count_right`.
        summary: The above in words.
        view: What the detector sees of the picture: the ``whole``; a window about the ``labels``,
            which gives away where they are; or an ``augmented`` picture, turned and enlarged at
            random as in training.
    """

    name: str
    decoding: Decoding
    overlap: Overlap
    rule: Rule
    summary: str
    view: View = "whole"

    @property
    def needs_detector(self) -> bool:
        """Whether it takes more than finished grasps to follow it."""
        return self.view != "whole" or self.decoding != "refined"


PROTOCOLS: dict[str, RectangleProtocol] = {
    p.name: p
    for p in (
        RectangleProtocol(
            "strict", "refined", "exact", "greater", "refined peak, exact area above the threshold"
        ),
        RectangleProtocol(
            "ggcnn",
            "ggcnn",
            "pixels",
            "greater",
            "smoothed local peaks, pixel count above the threshold",
        ),
        RectangleProtocol(
            "orange",
            "orange",
            "pixels",
            "percent",
            "plain argmax, pixel count in whole per cent at the threshold or above",
        ),
    )
}
"""The known protocols by name; ``strict`` is the default everywhere."""


_STRICT = PROTOCOLS["strict"]

QUIRKS: dict[str, RectangleProtocol] = {
    p.name: p
    for p in (
        replace(
            _STRICT,
            name="local peaks",
            decoding="ggcnn",
            summary="grasps read at smoothed local peaks, as GG-CNN does",
        ),
        replace(
            _STRICT,
            name="plain argmax",
            decoding="orange",
            summary="grasps read at the largest value of the raw maps, as ORANGE does",
        ),
        replace(
            _STRICT,
            name="pixel overlap",
            overlap="pixels",
            summary="overlap counted in whole pixels instead of exact area",
        ),
        replace(
            _STRICT,
            name="whole per cent",
            rule="percent",
            summary="overlap cut down to whole per cent, and the threshold itself enough",
        ),
        replace(
            _STRICT,
            name="crop about the labels",
            view="labels",
            summary="the network sees a window about the labelled grasps, as on Cornell",
        ),
        replace(
            _STRICT,
            name="augmented pictures",
            view="augmented",
            summary="test pictures turned and enlarged at random, as in training",
        ),
    )
}
"""``strict`` with one habit of others each, by name. That training and test pictures may show the
same object is another habit; only training again can tell its price (``data.split.by: image``)."""


def find_protocol(protocol: str | RectangleProtocol) -> RectangleProtocol:
    """The protocol of that name, or the one given.

    Raises:
        UnknownNameError: There is none of that name.
    """
    if isinstance(protocol, RectangleProtocol):
        return protocol
    if protocol not in PROTOCOLS:
        raise UnknownNameError("protocol", protocol, PROTOCOLS)
    return PROTOCOLS[protocol]
