"""What the doctor hands back: facts by section, problems by file, what the data are good for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Update = Callable[[int, int], None]
"""Called with (done, total) while the doctor reads."""


def nothing(done: int, total: int) -> None:
    """An `Update` that shows nothing."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    Args:
        path: The file or folder.
        text: What is wrong with it, in words.
        hides: Whether it makes (part of) a scene, mesh or weights file unusable; False for what
            the user should merely look at.
    """

    path: str
    text: str
    hides: bool = True


@dataclass
class Report:
    """The doctor's report on one folder.

    Args:
        kind: ``"cornell"``, ``"jacquard"``, ``"meshes"`` or ``"weights"``.
        root: The folder (or the weights file).
        count: Scenes, meshes or weights files that can be used.
        facts: Section name to numbers and words, for machines.
        lines: (section name, sentence) pairs, for people.
        problems: What is wrong, in the order of the files.
        good_for: What the data can be used for: ``"detect"``, ``"train"``, ``"evaluate"``, ...
    """

    kind: str
    root: Path
    count: int = 0
    facts: dict[str, Any] = field(default_factory=dict)
    lines: list[tuple[str, str]] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    good_for: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether anything in the folder can be used."""
        return self.count > 0

    def say(self, section: str, sentence: str, **facts: Any) -> None:
        """Add a sentence for people and the facts behind it to a section."""
        if sentence:
            self.lines.append((section, sentence))
        if facts:
            self.facts.setdefault(section, {}).update(facts)

    def complain(self, path: Path | str, text: str, *, hides: bool = True) -> None:
        """Add a problem."""
        self.problems.append(Problem(str(path), text, hides))

    def to_dict(self) -> dict[str, Any]:
        """The report for machines."""
        return {
            "kind": self.kind,
            "root": str(self.root),
            "usable": self.usable,
            "count": self.count,
            "good_for": list(self.good_for),
            **self.facts,
            "problems": [
                {"path": p.path, "problem": p.text, "hides": p.hides} for p in self.problems
            ],
        }

    def text(self, most_problems: int = 20) -> str:
        """The report for people.

        Args:
            most_problems: At most this many problems are written out.
        """
        width = max((len(name) for name, _ in self.lines), default=0)
        rows, last = [f"{self.kind}:{self.root}"], ""
        for name, sentence in self.lines:
            rows.append(f"  {'' if name == last else name:<{width}}  {sentence}")
            last = name
        if not self.problems:
            rows.append(f"  {'problems':<{width}}  none")
        for i, problem in enumerate(self.problems[:most_problems]):
            mark = "" if problem.hides else "look at: "
            title = "" if i else "problems"
            rows.append(f"  {title:<{width}}  {mark}{problem.path}: {problem.text}")
        if len(self.problems) > most_problems:
            more = len(self.problems) - most_problems
            rows.append(f"  {'':<{width}}  and {more} more; --json FILE lists all")
        return "\n".join(rows)
