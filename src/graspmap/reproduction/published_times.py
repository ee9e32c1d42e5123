"""The times that the thesis prints of networks, to stand beside a measured one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from graspmap.config import read_values
from graspmap.reproduction.table_file import NOTHING, Line, experiment_path, read_table

TABLES = ("table-4.4", "table-5.3")
"""The tables of the thesis that print times."""
NETWORK = "network.name"


@dataclass(frozen=True)
class PublishedTime:
    """A row of a table with times.

    Attributes:
        source: Where it stands, for example ``"Thesis, Table 5.3"``.
        model: What the row is called there.
        network: Name of the network here; None of a model that graspmap does not have.
        time_ms: As printed, milliseconds, for example ``"12-14"``.
        parameters: As printed; None where the table has none.
    """

    source: str
    model: str
    network: str | None
    time_ms: str
    parameters: str | None

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "source": self.source,
            "model": self.model,
            "network": self.network,
            "time_ms": self.time_ms,
            "parameters": self.parameters,
        }


def published_times() -> tuple[PublishedTime, ...]:
    """The rows of `TABLES`, in the order of the thesis."""
    found = []
    for name in TABLES:
        table = read_table(name)
        for line in table.lines:
            printed = dict(zip(table.measures, line.published, strict=True))
            parameters = printed.get("parameters", NOTHING)
            found.append(
                PublishedTime(
                    source=table.source,
                    model=line.title,
                    network=_network(line),
                    time_ms=printed["network_ms"],
                    parameters=None if parameters == NOTHING else parameters,
                )
            )
    return tuple(found)


def _network(line: Line) -> str | None:
    if line.experiment is None:
        return None
    values = read_values(experiment_path(line.experiment), what="experiment")
    return str(line.changes.get(NETWORK, values["network"]["name"]))
