"""A box as a mesh file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def write_box(path: Path, sides: Sequence[float]) -> None:
    """A box as an OBJ file; with one side 0 it is flat."""
    corners = [(x, y, z) for x in (0, sides[0]) for y in (0, sides[1]) for z in (0, sides[2])]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    lines = [" ".join(map(str, ("v", *corner))) for corner in corners]
    lines += [" ".join(map(str, ("f", *face))) for face in faces]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
