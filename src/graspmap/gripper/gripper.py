"""Gripper: a parallel-jaw gripper, as a YAML profile describes it.

Gripper frame: x along the opening, y along the jaw, z out of the palm, metres.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, Literal, get_args

from graspmap.errors import InvalidInputError, UnknownNameError

OnTouch = Literal["fail", "stop"]
LONGEST_M = 0.5
"""No opening, jaw or palm of a gripper for things on a table is longer."""


@dataclass(frozen=True)
class Gripper:
    """A parallel-jaw gripper that comes down with open fingers and closes them.

    Profiles with the same name and numbers are equal, whatever their description; they are
    hashable, so they can be keys.

    Args:
        name: Name of the profile: letters, digits, '-', '_' and '.'.
        min_opening_m: Distance of the closed fingers, at least 0.
        max_opening_m: Distance of the open fingers, greater than that.
        jaw_sizes_m: Jaw sizes (across the opening) that exist for it, ascending; labels try each.
        jaw_contact_share: Part of the jaw size that the plate really has, in (0, 1].
        finger_thickness_m: Of a finger, along the opening.
        finger_length_m: From the palm to the tips: how deep it can reach over an object.
        palm_size_m: Palm along and across the opening; it must not touch either.
        force_n: Force with which each finger presses.
        friction: Coulomb friction of the finger pads.
        torsional_friction_m: Torsional friction of the pads (MuJoCo's, a length).
        finger_mass_kg: What has to be moved to move one finger, its drive included.
        closing_speed_m_s: Of each finger.
        max_depth_m: How far below the highest point between them the tips go, at most.
        table_clearance_m: How near the table the tips go, at most.
        on_touch: What happens when a finger would touch on the way down: the grasp fails, or the
            gripper stops ``touch_gap_m`` above what it would touch and closes there.
        touch_gap_m: See ``on_touch``.
        description: A line for people.

    Raises:
        InvalidInputError: A number is none, or not in its range, or they do not fit together.
    """

    name: str
    min_opening_m: float
    max_opening_m: float
    jaw_sizes_m: tuple[float, ...]
    jaw_contact_share: float
    finger_thickness_m: float
    finger_length_m: float
    palm_size_m: tuple[float, float]
    force_n: float
    friction: float
    torsional_friction_m: float
    finger_mass_kg: float
    closing_speed_m_s: float
    max_depth_m: float
    table_clearance_m: float
    on_touch: OnTouch
    touch_gap_m: float
    description: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not re.fullmatch(r"[A-Za-z0-9._-]+", self.name):
            raise InvalidInputError("name", repr(self.name), "letters, digits, '-', '_' and '.'")
        if not isinstance(self.description, str) or not self.description.isprintable():
            raise InvalidInputError("description", repr(self.description), "one line of text")
        for key, limits in _RANGES.items():
            object.__setattr__(self, key, _number(key, getattr(self, key), limits))
        for key in ("jaw_sizes_m", "palm_size_m"):
            object.__setattr__(self, key, _sizes(key, getattr(self, key)))
        if self.on_touch not in get_args(OnTouch):
            raise UnknownNameError("on_touch", str(self.on_touch), get_args(OnTouch))
        self._check_together()

    def _check_together(self) -> None:
        if self.max_opening_m <= self.min_opening_m:
            raise InvalidInputError(
                "max_opening_m",
                f"{self.max_opening_m:g}",
                f"more than min_opening_m, {self.min_opening_m:g}: else it cannot open",
            )
        jaws = self.jaw_sizes_m
        if any(b <= a for a, b in itertools.pairwise(jaws)):
            raise InvalidInputError("jaw_sizes_m", list(jaws), "ascending sizes, each once")
        if len(self.palm_size_m) != 2:
            raise InvalidInputError(
                "palm_size_m", list(self.palm_size_m), "two sizes: along and across the opening"
            )
        if self.max_depth_m > self.finger_length_m:
            raise InvalidInputError(
                "max_depth_m",
                f"{self.max_depth_m:g}",
                f"at most finger_length_m, {self.finger_length_m:g}: the palm would touch",
            )

    def words(self) -> tuple[str, ...]:
        """What the numbers mean, one sentence each, in millimetres."""
        jaws = ", ".join(f"{1000 * jaw:.4g}" for jaw in self.jaw_sizes_m)
        touch = {
            "fail": "the grasp fails",
            "stop": f"it stops {1000 * self.touch_gap_m:g} mm above that and closes there",
        }
        return (
            f"opens from {1000 * self.min_opening_m:g} to {1000 * self.max_opening_m:g} mm, each "
            f"finger at {1000 * self.closing_speed_m_s:g} mm/s",
            f"jaw size{'s' * (len(self.jaw_sizes_m) > 1)} {jaws} mm; the pads "
            f"are {100 * self.jaw_contact_share:g} % of that",
            f"presses with {self.force_n:g} N on each side, friction {self.friction:g} (torsional "
            f"{1000 * self.torsional_friction_m:g} mm)",
            f"tips go at most {1000 * self.max_depth_m:g} mm below what lies between them and stay "
            f"{1000 * self.table_clearance_m:g} mm above the table",
            f"if a finger would touch on the way down, {touch[self.on_touch]}",
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values by the names of the profile's keys, as `from_dict` and YAML take them."""
        return {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in asdict(self).items()
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Gripper:
        """From plain values by key.

        Raises:
            InvalidInputError: A key is unknown or missing, or a value is wrong; ``name`` is the
                key.
        """
        for key in values:
            if key not in KEYS:
                raise UnknownNameError("key of a gripper", key, KEYS)
        missing = [key for key in KEYS if key not in values and key != "description"]
        if missing:
            raise InvalidInputError(missing[0], "missing", f"values for {', '.join(missing)}")
        return cls(**values)


def check_gripper(value: Any) -> None:
    """See that a value is a gripper, and not the name of one.

    Raises:
        InvalidInputError: It is something else.
    """
    if not isinstance(value, Gripper):
        raise InvalidInputError("gripper", repr(value), "a Gripper: load_gripper gives it by name")


KEYS = tuple(field.name for field in fields(Gripper))
"""The keys of a profile."""


@dataclass(frozen=True)
class _Range:
    """Numbers from ``low`` to ``high``; ``low`` itself only where ``closed``."""

    low: float
    high: float
    unit: str = ""
    closed: bool = False

    def __contains__(self, number: float) -> bool:
        return (self.low <= number if self.closed else self.low < number) and number <= self.high

    def __str__(self) -> str:
        start = "from" if self.closed else "more than"
        return f"{start} {self.low:g}, at most {self.high:g}{self.unit}"


def _lengths(high: float, *, closed: bool = False) -> _Range:
    return _Range(0, high, " metres", closed)


_SIZE = _lengths(LONGEST_M)
_RANGES = {
    "min_opening_m": _lengths(LONGEST_M, closed=True),
    "max_opening_m": _SIZE,
    "jaw_contact_share": _Range(0, 1),
    "finger_thickness_m": _lengths(0.1),
    "finger_length_m": _lengths(1),
    "force_n": _Range(0, 5000, " newton"),
    "friction": _Range(0, 3),
    "torsional_friction_m": _lengths(0.1, closed=True),
    "finger_mass_kg": _Range(0, 20, " kilogram"),
    "closing_speed_m_s": _Range(0, 5, " metres per second"),
    "max_depth_m": _lengths(1),
    "table_clearance_m": _lengths(0.1, closed=True),
    "touch_gap_m": _lengths(0.1, closed=True),
}


def _number(key: str, value: Any, limits: _Range) -> float:
    if isinstance(value, bool | str) or not hasattr(value, "__float__"):
        raise InvalidInputError(key, repr(value), f"a number, {limits}")
    number = float(value)
    if not math.isfinite(number) or number not in limits:
        in_mm = limits.unit == " metres" and number / 1000 in limits
        hint = f" ({number:g} millimetres are {number / 1000:g} metres)" if in_mm else ""
        raise InvalidInputError(key, f"{number:g}", f"{limits}{hint}")
    return number


def _sizes(key: str, value: Any) -> tuple[float, ...]:
    if isinstance(value, str | Mapping) or not hasattr(value, "__iter__"):
        raise InvalidInputError(key, repr(value), "a list of lengths in metres")
    sizes = tuple(_number(key, size, _SIZE) for size in value)
    if not sizes:
        raise InvalidInputError(key, "an empty list", "at least one length in metres")
    return sizes
