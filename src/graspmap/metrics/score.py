"""What all scores have in common: they can be written as JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Score:
    """Numbers about some trials, scenes or pictures: a frozen record."""

    def to_dict(self) -> dict[str, Any]:
        """For JSON: its attributes by name, tuples as lists."""
        return {name: _listed(value) for name, value in asdict(self).items()}


def _listed(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _listed(part) for name, part in value.items()}
    return [_listed(part) for part in value] if isinstance(value, tuple) else value
