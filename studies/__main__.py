"""``python -m studies``: list the studies; ``python -m studies NAME [flags]``: run one.

A study is a module of this folder with ``ABOUT``, one line on what it measures, and ``run``, whose
keyword arguments are its flags. It prints a table and, with ``--out DIR``, writes what it found.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from types import ModuleType

import tyro

import studies


def load() -> dict[str, ModuleType]:
    """Every study by its name."""
    names = sorted(m.name for m in pkgutil.iter_modules(studies.__path__) if m.name[0] != "_")
    modules = {name: importlib.import_module(f"studies.{name}") for name in names}
    return {name: module for name, module in modules.items() if hasattr(module, "ABOUT")}


def main(argv: list[str]) -> int:
    """Run the study that ``argv`` names, or list all."""
    if argv and not argv[0].startswith("-"):
        if argv[0].startswith("_") or argv[0] not in {
            m.name for m in pkgutil.iter_modules(studies.__path__)
        }:
            print(f"no study {argv[0]!r}; there are: {', '.join(load())}", file=sys.stderr)
            return 2
        module = importlib.import_module(f"studies.{argv[0]}")
        tyro.cli(module.run, args=argv[1:], prog=f"python -m studies {argv[0]}")
        return 0
    for name, module in load().items():
        print(f"{name:24} {module.ABOUT}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
