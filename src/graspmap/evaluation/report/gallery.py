"""Scenes worth looking at: the best, the worst, and some drawn at random."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from graspmap.pictures.draw import Picture

Why = Literal["best", "worst", "random"]


@dataclass(frozen=True, eq=False)
class Exhibit:
    """One scene of the gallery.

    Attributes:
        scene: Its id.
        why: Why it is shown.
        words: What became of it.
        numbers: What was measured on it, by name: overlap, quality, ...
        pictures: Pictures by their caption: labels and detection, maps, depth.
        film: Animated WebP of its trial; None where there was none.
    """

    scene: str
    why: Why
    words: str
    numbers: Mapping[str, float | None] = field(default_factory=dict)
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    film: bytes | None = None

    def to_dict(self) -> dict[str, Any]:
        """For JSON, without the pictures."""
        return {"scene": self.scene, "why": self.why, "words": self.words, **self.numbers}
