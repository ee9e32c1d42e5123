"""Draw: the numbers that one object is made of, from its own stream."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from graspmap.simulation.procedural.ranges import ObjectRanges, Range

T = TypeVar("T")


@dataclass(frozen=True)
class Draw:
    """Draws numbers within ranges; all lengths in metres.

    Args:
        rng: The object's own stream.
        ranges: What the objects may be like.
    """

    rng: np.random.Generator
    ranges: ObjectRanges

    def uniform(self, low: float, high: float) -> float:
        """Evenly from [low, high); ``low`` where the range is empty."""
        return low + (high - low) * self.rng.random() if high > low else low

    def even_log(self, low: float, high: float) -> float:
        """Evenly in the logarithm; each doubling is as likely as the next."""
        return math.exp(self.uniform(math.log(low), math.log(max(low, high))))

    def integer(self, low: int, high: int) -> int:
        """A whole number from low to high, both included."""
        return int(self.rng.integers(low, high + 1))

    def chance(self, probability: float) -> bool:
        """True with that probability."""
        return bool(self.rng.random() < probability)

    def choice(self, options: Sequence[T]) -> T:
        """One of the options, each as likely as the others."""
        return options[int(self.rng.integers(len(options)))]

    def longest(self, held_ratio: float = 0.0) -> float:
        """Longest side of an object that is held across ``held_ratio`` of it.

        Args:
            held_ratio: Width to hold over longest side, at most 1; 0 where the width is free.
        """
        low, high = self.ranges.longest_m
        widest = self.ranges.width_m[1]
        return self.even_log(low, max(low, min(high, widest / held_ratio if held_ratio else high)))

    def width(self, least: float, most: float) -> float:
        """A width to hold within [least, most] and the ranges, the nearer end where they part."""
        low, high = self.ranges.width_m
        return self.even_log(min(max(least, low), high), min(max(most, low), high))

    def wall(self, most: float = math.inf) -> float:
        """Thickness of a wall, at most ``most`` but never below the least wall."""
        low, high = self.ranges.wall_m
        return self.even_log(low, max(low, min(high, most)))

    def sturdy(self, thickness: float, share: float = 1) -> float:
        """The thickness, or more where ``share`` of it would be below the least wall."""
        return max(thickness, self.ranges.wall_m[0] / share)

    def sides(self) -> Range:
        """Middle and shortest side, over the longest, within the ranges' aspect."""
        low, high = self.ranges.aspect
        first, second = (1 / self.even_log(low, high) for _ in range(2))
        return max(first, second), min(first, second)
