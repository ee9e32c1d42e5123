"""Which objects an item shows: made up, or meshes of the user that were prepared once.

Letters: M usable meshes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graspmap.generation.entries import MODELS, MeshEntry
from graspmap.generation.plan import GenerationPlan
from graspmap.generation.sources import MeshSource, ProceduralSource, Source
from graspmap.simulation.objects import ObjectModel

# Later attempts take objects and meshes from far behind those of first attempts.
_LATER = 10**9
_MOST_ATTEMPTS = 64
_ORDER, _DIVISION = 2**31, 2**31 + 1  # streams of their own, beside those of the objects


@dataclass(frozen=True)
class Pick:
    """The objects of an attempt.

    Args:
        name: Of the object, or of the set: the folder of its scenes.
        models: The objects.
        sources: What each is made from.
        part: Part of the split that the item belongs to, where that is known beforehand.
    """

    name: str
    models: tuple[ObjectModel, ...]
    sources: tuple[Source, ...]
    part: str | None = None


def pick_objects(
    plan: GenerationPlan, meshes: Sequence[MeshEntry], root: Path, item: int, attempt: int
) -> Pick:
    """The objects of attempt number ``attempt`` at item number ``item``.

    Made-up objects are new ones for each attempt. Meshes are taken in turn, in an order that is
    mixed anew for each turn; in a clutter, only those of one part of the split, so that no object
    is in two parts.

    Args:
        plan: The plan.
        meshes: M usable meshes, sorted; none for made-up objects.
        root: Folder of the data set, with the model files.
        item: Number of the item.
        attempt: Number of the attempt.

    Raises:
        FileError: A model file is missing or damaged.
    """
    turn = item if attempt == 0 else _LATER + item * _MOST_ATTEMPTS + attempt
    if plan.procedural:
        return _made_up(plan, item, attempt * _LATER + item * plan.clutter)
    if plan.clutter == 1:
        ((mesh, id),) = _taken(meshes, plan.seed, turn, 1)
        source = _mesh_source(mesh)
        return Pick(id, (source.model(id, root),), (source,))
    divided = divide_meshes(meshes, plan.seed)
    part = item_part(item) if divided["test"] else "train"
    name = f"clutter-{item:06d}"
    taken = _taken(divided[part], plan.seed, turn, plan.clutter)
    sources = tuple(_mesh_source(mesh) for mesh, _ in taken)
    models = (s.model(id, root) for s, (_, id) in zip(sources, taken, strict=True))
    return Pick(name, tuple(models), sources, part)


def divide_meshes(meshes: Sequence[MeshEntry], seed: int) -> dict[str, list[MeshEntry]]:
    """Meshes by part of the split: a tenth for validation and for test, at least one for each.

    With fewer than three meshes all are for training.
    """
    order = [meshes[i] for i in _mixed(len(meshes), seed, _DIVISION, 0)]
    tenth = max(1, round(len(order) / 10)) if len(order) > 2 else 0
    return {
        "train": order[2 * tenth :],
        "validation": order[:tenth],
        "test": order[tenth : 2 * tenth],
    }


def item_part(item: int) -> str:
    """Part of the split of a clutter of meshes: of ten, one is for validation and one for test."""
    return {1: "validation", 2: "test"}.get(item % 10, "train")


def _made_up(plan: GenerationPlan, item: int, first: int) -> Pick:
    assert plan.ranges is not None  # a plan for made-up objects has them
    sources = tuple(
        ProceduralSource(
            seed=plan.seed, index=first + k, families=plan.families, ranges=plan.ranges
        )
        for k in range(plan.clutter)
    )
    models = tuple(source.model("", Path()) for source in sources)
    name = models[0].id if plan.clutter == 1 else f"clutter-{item:06d}"
    return Pick(name, models, sources)


def _mesh_source(mesh: MeshEntry) -> MeshSource:
    return MeshSource(file=mesh.file, hash=mesh.hash, model_file=f"{MODELS}/{mesh.id}.npz")


def _taken(
    meshes: Sequence[MeshEntry], seed: int, turn: int, count: int
) -> list[tuple[MeshEntry, str]]:
    """Meshes number ``turn * count`` and following of an endless mixed order, with a name each."""
    taken = []
    for place in range(turn * count, (turn + 1) * count):
        rounds, position = divmod(place, len(meshes))
        taken.append(meshes[int(_mixed(len(meshes), seed, _ORDER, rounds)[position])])
    seen: Counter[str] = Counter()
    named = []
    for mesh in taken:
        seen[mesh.id] += 1
        again = f"-again{seen[mesh.id]}" if seen[mesh.id] > 1 else ""
        named.append((mesh, mesh.id + again))
    return named


def _mixed(count: int, *seed: int) -> list[int]:
    # Only the raw stream is promised to stay as it is; Generator.permutation may change.
    keys = np.random.PCG64(list(seed)).random_raw(count)
    return [int(i) for i in np.argsort(keys, kind="stable")]
