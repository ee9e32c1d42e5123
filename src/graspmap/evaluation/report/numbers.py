"""Numbers of a summary on a page: looked up, formatted and marked in one way.

A number on a page is ``<span data-key="trials.success" data-value="0.583">58.3%</span>``: the key
is its path in the JSON, as jq writes it (without the leading dot), the value is the JSON's.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

from markupsafe import Markup

from graspmap.errors import UnknownNameError

NOTHING = "\N{EN DASH}"
"""What stands where the summary has null."""

_FORMATS: dict[str, Callable[[float], str]] = {
    "share": lambda value: f"{value:.1%}",
    "change": lambda value: f"{100 * value:+.1f} points",
    "number": lambda value: f"{value:.3f}",
    "p": lambda value: f"{value:.2g}",
    "count": lambda value: f"{value:,.0f}",
    "degrees": lambda value: f"{value:g}°",
    "radians": lambda value: f"{math.degrees(value):.1f} degrees",
    "seconds": lambda value: f"{value:,.1f} s",
    "ms": lambda value: f"{value:.1f} ms",
    "mm": lambda value: f"{1000 * value:.1f} mm",
    "millions": lambda value: f"{value / 1e6:,.2f} M",
}


class Numbers:
    """The numbers of one summary.

    Args:
        summary: What the JSON holds.
    """

    def __init__(self, summary: Mapping[str, Any]) -> None:
        self._summary = summary

    def get(self, *path: str | int) -> Any:
        """What the summary has at a path; None where a part of the path is missing."""
        value: Any = self._summary
        for step in path:
            if isinstance(value, Mapping):
                value = value.get(step)
            elif isinstance(value, list | tuple) and isinstance(step, int) and step < len(value):
                value = value[step]
            else:
                return None
        return value

    def show(self, kind: str, *path: str | int) -> Markup:
        """One number.

        Args:
            kind: How it is written: ``share``, ``number``, ``count``, ...
            path: Where it stands in the summary.

        Raises:
            UnknownNameError: There is no such kind.
        """
        value = self.get(*path)
        return Markup('<span data-key="{}" data-value="{}">{}</span>').format(
            key_of(*path), json.dumps(value), as_text(kind, value)
        )

    def interval(self, kind: str, *path: str | int) -> Markup:
        """Both ends of an interval; `NOTHING` where there is none."""
        if self.get(*path) is None:
            return Markup(NOTHING)
        # It may break once, before "to".
        return Markup('{} <span class="end">to {}</span>').format(
            self.show(kind, *path, 0), self.show(kind, *path, 1)
        )


def as_text(kind: str, value: float | None) -> str:
    """A number as pages and plots write it.

    Args:
        kind: ``share``, ``change`` (of a share), ``number``, ``p`` (value), ``count``,
            ``degrees``, ``radians`` (written in degrees), ``seconds``, ``ms`` (of milliseconds),
            ``mm`` (of metres) or ``millions``.
        value: The number; None is `NOTHING`.

    Raises:
        UnknownNameError: There is no such kind.
    """
    if kind not in _FORMATS:
        raise UnknownNameError("kind of number", kind, _FORMATS)
    if value is None or math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    return _FORMATS[kind](value)


def key_of(*path: str | int) -> str:
    """A path as jq writes it, without the leading dot: ``success."0.25"``, ``quirks[2].change``."""
    key = ""
    for step in path:
        if isinstance(step, int):
            key += f"[{step}]"
        elif re.fullmatch(r"[A-Za-z_]\w*", step, re.ASCII):
            key += f".{step}"
        else:
            key += f".{json.dumps(step)}"
    return key.removeprefix(".")
