"""Ways to decode and count that others report with, so that their numbers can be set beside ours.

Each protocol takes the best grasp of a scene, its jaw half its opening. They differ in how the
grasp is read from the maps, in how the overlap is computed, and in when it is enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from graspmap.errors import UnknownNameError
from graspmap.metrics.rectangle import Overlap, Rule

Decoding = Literal["refined", "ggcnn", "orange"]


@dataclass(frozen=True)
class RectangleProtocol:
    """How a grasp is read from the maps and judged.

    Attributes:
        name: Name on the command line and in results.
        decoding: Method of `graspmap.maps.find_grasps`.
        overlap: How overlaps are computed, see `best_overlap`.
        rule: When an overlap reaches a threshold, see `count_right`.
        summary: The above in words.
    """

    name: str
    decoding: Decoding
    overlap: Overlap
    rule: Rule
    summary: str


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
