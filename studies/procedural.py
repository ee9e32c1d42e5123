"""Procedural objects: what they look like, what they cost, and how many can be held.

Prints, for each family, the CPU time of an object, its convex pieces and faces, the share that is
watertight, and the share with some extent across the vertical below the gripper's opening, and
draws a sheet of objects as the mixture gives them.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Any

import numpy as np

from graspmap.files import write_bytes
from graspmap.gripper import load_gripper
from graspmap.pictures import Tile, contact_sheet, encode
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.procedural import FAMILIES, ObjectRanges, make_object
from graspmap.simulation.solids import open_edges
from studies._rays import RayCaster
from studies._report import table, write

ABOUT = "procedural objects: a sheet of them, their cost, and how many can be held"

_AWAY = np.array([0.55, -0.8, 0.62]) / math.sqrt(0.55**2 + 0.8**2 + 0.62**2)  # to the eye
_LIGHT = np.array([0.2, -0.5, 0.9]) / math.sqrt(0.2**2 + 0.5**2 + 0.9**2)
_COLOR = np.array([150.0, 190.0, 200.0])


def run(
    *, each: int = 30, sheet: int = 60, seed: int = 0, gripper: str = "jacquard",
    out: Path | None = None,
) -> None:  # fmt: skip
    """Make objects of each family, and draw some of the mixture.

    Args:
        each: Objects of each family for the table.
        sheet: Objects on the sheet, which is only drawn with ``out``.
        seed: Of the objects.
        gripper: Name of a profile, or a file: whom the objects are for.
        out: Folder for ``procedural.json`` and ``procedural.png``.
    """
    hand = load_gripper(gripper)
    ranges = ObjectRanges.for_gripper(hand)
    make_object(seed, 0, ranges=ranges, families=("blob",))  # loads what loads at the first use
    rows = {name: _measure(name, each, seed, ranges, hand.max_opening_m) for name in FAMILIES}
    total = sum(f.weight for f in FAMILIES.values())
    mean = sum(rows[n]["cpu_s"] * f.weight / total for n, f in FAMILIES.items())
    print(
        f"{each} objects of each family, seed {seed}, for {hand.name}; "
        f"an object of the mixture takes {mean:.3f} s of CPU"
    )
    head = list(next(iter(rows.values())))
    table(["family", *head], [[n, *r.values()] for n, r in rows.items()])
    found: dict[str, Any] = {
        "seed": seed, "each": each, "gripper": hand.name, "cpu_s": mean, "families": rows,
    }  # fmt: skip
    if out is not None:
        write(out, "procedural", found)
        models = [make_object(seed, i, ranges=ranges) for i in range(sheet)]
        tiles = [Tile(picture(m), f"{m.id[:-7]} {100 * m.extents_m.max():.0f} cm") for m in models]
        write_bytes(out / "procedural.png", encode(contact_sheet(tiles, columns=10, cell=150)))


def _measure(
    family: str, count: int, seed: int, ranges: ObjectRanges, opening_m: float
) -> dict[str, float]:
    start = time.process_time()
    models = [make_object(seed, i, ranges=ranges, families=(family,)) for i in range(count)]
    seconds = time.process_time() - start
    return {
        "cpu_s": seconds / count,
        "pieces": float(np.mean([len(m.pieces) for m in models])),
        "most pieces": float(max(len(m.pieces) for m in models)),
        "faces": float(np.mean([len(m.faces) for m in models])),
        "watertight": float(np.mean([open_edges(m.vertices, m.faces) == 0 for m in models])),
        "held": float(np.mean([narrowest(m) < opening_m for m in models])),
        "always held": float(np.mean([m.extents_m.max() < opening_m for m in models])),
    }


def narrowest(model: ObjectModel) -> float:
    """Least width of the whole object across any of 90 directions, standing or on a side."""
    turns = np.pi * np.arange(90) / 90
    planes = [model.vertices[:, list(axes)] for axes in ((0, 1), (1, 2), (2, 0))]
    ways = np.stack([np.cos(turns), np.sin(turns)])
    return float(min(np.ptp(plane @ ways, axis=0).min() for plane in planes))


def picture(model: ObjectModel, size: int = 150) -> np.ndarray:
    """(size, size, 3) of the object from its front right, lit from above; red inside."""
    right = np.cross((0, 0, 1), _AWAY)
    right /= np.sqrt((right**2).sum())
    up = np.cross(_AWAY, right)
    corners = model.vertices[model.faces]
    middle = (model.vertices.max(axis=0) + model.vertices.min(axis=0)) / 2
    seen = (model.vertices - middle) @ np.stack([right, up], axis=1)
    reach = 1.08 * np.abs(seen).max()
    steps = np.linspace(-reach, reach, 2 * size)
    across, along = np.meshgrid(steps, -steps)
    eyes = (middle + across[..., None] * right + along[..., None] * up + _AWAY).reshape(-1, 3)
    rays = np.broadcast_to(-_AWAY, eyes.shape)
    hit = RayCaster(corners).first_hit(eyes, rays)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.sqrt((normals**2).sum(axis=1, keepdims=True)), 1e-30)
    shade = 0.25 + 0.6 * np.clip(normals @ _LIGHT, 0, 1) + 0.15 * np.clip(normals @ _AWAY, 0, 1)
    colors = np.where((normals @ _AWAY < 0)[:, None], (255.0, 0.0, 0.0), _COLOR * shade[:, None])
    rgb = np.full((len(hit), 3), 255.0)
    rgb[hit >= 0] = colors[hit[hit >= 0]]
    fine = rgb.reshape(size, 2, size, 2, 3)
    return np.asarray(np.clip(fine.mean(axis=(1, 3)), 0, 255).astype(np.uint8))
