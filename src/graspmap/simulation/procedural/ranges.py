"""ObjectRanges: how large, thin and heavy the drawn objects may be."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from graspmap.errors import InvalidInputError
from graspmap.gripper import Gripper

Range = tuple[float, float]

_SHORTEST_M = 0.002  # hulls are true to half a millimetre: anything smaller would be caricature
_LONGEST_M = 1.0


@dataclass(frozen=True)
class ObjectRanges:
    """Ranges (least, greatest) that objects are drawn from; lengths in metres.

    The defaults suit the ``jacquard`` gripper, with its opening of 24 cm.

    Args:
        longest_m: Longest side of the object's box.
        width_m: Width across which an object is meant to be held (the diameter of a ball, the
            shortest side of a block, the thickness of a handle). Its upper end should lie a little
            above the gripper's greatest opening, so that some objects cannot be held.
        wall_m: Thickness of walls, plates and rims.
        aspect: Longest side over shortest, for shapes that could have any (blocks, rods, plates).
        density_kg_m3: Density, drawn evenly in its logarithm.
        mass_kg: The mass that follows from volume and density is clipped to this.

    Raises:
        InvalidInputError: An end is not a finite number in the order and the limits above.
    """

    longest_m: Range = (0.05, 0.30)
    width_m: Range = (0.005, 0.264)
    wall_m: Range = (0.002, 0.006)
    aspect: Range = (1.0, 15.0)
    density_kg_m3: Range = (100.0, 2000.0)
    mass_kg: Range = (0.02, 0.3)

    def __post_init__(self) -> None:
        limits: dict[str, Range] = {
            "longest_m": (5 * _SHORTEST_M, _LONGEST_M),
            "width_m": (_SHORTEST_M, _LONGEST_M),
            "wall_m": (_SHORTEST_M, _LONGEST_M),
            "aspect": (1.0, 100.0),
            "density_kg_m3": (1.0, 30000.0),
            "mass_kg": (1e-4, 100.0),
        }
        for field in fields(self):
            low, high = limits[field.name]
            object.__setattr__(
                self, field.name, _range(field.name, getattr(self, field.name), low, high)
            )
        if self.width_m[0] > self.longest_m[0] / 2:
            raise InvalidInputError(
                "width_m",
                f"at least {self.width_m[0]}",
                f"a least width of at most half the least length, {self.longest_m[0] / 2}",
            )
        if self.wall_m[1] > self.longest_m[0] / 5:
            raise InvalidInputError(
                "wall_m",
                f"up to {self.wall_m[1]}",
                f"walls of at most a fifth of the least length, {self.longest_m[0] / 5}",
            )

    @classmethod
    def for_gripper(cls, gripper: Gripper) -> ObjectRanges:
        """Objects for a gripper: most can be held somewhere, some are too wide.

        The longest sides run from a fifth of its greatest opening (at most 5 cm, at least 2.5 cm,
        and what a gripper that does not close needs for widths above its least opening) to 1.25
        times it, or three times it where that is below 25 cm: a small gripper holds long things by
        their handles. The heaviest object is what friction carries four times over.

        Raises:
            InvalidInputError: It opens so little that no such objects exist.
        """
        opening = gripper.max_opening_m
        least = min(max(0.2 * opening, 0.025), 0.05)
        carried = 2 * gripper.friction * gripper.force_n / 9.81
        heaviest = min(max(carried / 4, 0.02), cls.mass_kg[1])
        thinnest = max(cls.width_m[0], 1.2 * gripper.min_opening_m)
        least = max(least, 2 * thinnest)
        if not (math.isfinite(opening) and 2 * thinnest <= 1.1 * opening):
            raise InvalidInputError(
                f"opening of gripper {gripper.name}",
                f"{gripper.min_opening_m} to {opening} m",
                "a greatest one of 1 cm or more, and of 2.2 times the least one or more",
            )
        return cls(
            longest_m=(least, max(1.25 * opening, min(3 * opening, 0.25))),
            width_m=(thinnest, 1.1 * opening),
            wall_m=(cls.wall_m[0], min(cls.wall_m[1], least / 5)),
            mass_kg=(min(cls.mass_kg[0], heaviest), heaviest),
        )


def _range(name: str, value: Range, low: float, high: float) -> Range:
    allowed = f"two numbers, least and greatest, between {low:g} and {high:g}"
    try:
        least, greatest = (float(v) for v in value)
    except (TypeError, ValueError) as error:
        raise InvalidInputError(name, f"{value!r:.80}", allowed) from error
    if not low <= least <= greatest <= high:  # NaN fails too
        raise InvalidInputError(name, (least, greatest), allowed)
    return least, greatest
