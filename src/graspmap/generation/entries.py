"""What the ledger of a data set knows of its finished parts, and how a manifest holds it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, cast

from pydantic import TypeAdapter

MODELS = "models"
"""Folder of the model files, below that of the data set."""


@dataclass(frozen=True)
class SceneEntry:
    """A finished scene.

    Args:
        id: Its name, ``<i>_<object>``.
        object: Its object (or set of objects).
        grasps: Labels: grasps that held, over all jaw sizes.
        outcomes: How many trials ended which way.
        files: BLAKE2b hash of each of its files, by path below the folder of the data set.
    """

    id: str
    object: str
    grasps: int
    outcomes: dict[str, int]
    files: dict[str, str]


@dataclass(frozen=True)
class ItemEntry:
    """A finished item: an object (or a set of objects) with its views.

    Args:
        item: Its number.
        scenes: Its scenes; none where it was given up.
        rejects: How many tries failed on the way, by reason.
        part: Part of the split that it belongs to; None where the split is drawn at the end.
    """

    item: int
    scenes: tuple[SceneEntry, ...]
    rejects: dict[str, int]
    part: str | None = None

    @property
    def files(self) -> dict[str, str]:
        """Hashes of all its files by path."""
        return {path: value for scene in self.scenes for path, value in scene.files.items()}


@dataclass(frozen=True)
class MeshEntry:
    """A mesh of the user, prepared or refused.

    Args:
        file: Its path below the folder of the meshes.
        hash: Of its content.
        id: Name of the object made from it.
        files: Hash of the model file, by path; empty where the mesh is refused.
        problem: Why it is refused; "" where it is not.
        remarks: What was guessed or mended on the way.
    """

    file: str
    hash: str
    id: str
    files: dict[str, str] = field(default_factory=dict)
    problem: str = ""
    remarks: tuple[str, ...] = ()


Entry = ItemEntry | MeshEntry
_ADAPTERS = {"item": TypeAdapter(ItemEntry), "redo": TypeAdapter(ItemEntry)}
_MESH = TypeAdapter(MeshEntry)


def entry_from_dict(kind: str, values: Any) -> Entry:
    """An entry from the plain values of a journal or manifest.

    Raises:
        ValueError: They are none.
    """
    adapter = cast(TypeAdapter[Entry], _MESH if kind == "mesh" else _ADAPTERS[kind])
    return adapter.validate_python(values)


def manifest_content(
    plan: Mapping[str, Any], items: Iterable[ItemEntry], meshes: Iterable[MeshEntry]
) -> dict[str, Any]:
    """What a manifest says of finished items (in order) and meshes (in order)."""
    items, meshes = list(items), list(meshes)
    scenes = [scene for item in items for scene in item.scenes]
    outcomes: Counter[str] = Counter()
    rejects: Counter[str] = Counter()
    for scene in scenes:
        outcomes.update(scene.outcomes)
    for item in items:
        rejects.update(item.rejects)
    rejects["bad mesh"] += sum(1 for mesh in meshes if mesh.problem)
    finished: list[Entry] = [*meshes, *items]
    files = {path: value for entry in finished for path, value in entry.files.items()}
    return {
        "plan": dict(plan),
        "counts": {
            "scenes": len(scenes),
            "missing_scenes": plan["scenes"] - len(scenes),
            "objects": len({scene.object for scene in scenes}),
            "labels": sum(scene.grasps for scene in scenes),
            "trials": outcomes.total(),
            "outcomes": dict(sorted(outcomes.items())),
            "rejects": {reason: n for reason, n in sorted(rejects.items()) if n},
        },
        "meshes": [_without_files(asdict(mesh)) for mesh in meshes],
        "items": [_without_files(asdict(item)) for item in items],
        "files": dict(sorted(files.items())),
    }


def manifest_entries(content: Mapping[str, Any]) -> list[Entry]:
    """The entries that a manifest was made from.

    Raises:
        ValueError, KeyError, TypeError: It is no manifest.
    """
    files: dict[str, dict[str, str]] = {}
    for path, value in content["files"].items():
        files.setdefault(path.rpartition("/")[0], {})[path] = value
    entries: list[Entry] = []
    for values in content["meshes"]:
        model = f"{MODELS}/{values['id']}.npz"
        own = {model: files[MODELS][model]} if not values["problem"] else {}
        entries.append(entry_from_dict("mesh", {**values, "files": own}))
    for values in content["items"]:
        scenes = []
        for scene in values["scenes"]:
            start = f"{scene['object']}/{scene['id']}_"
            siblings = files[scene["object"]].items()
            own = {path: value for path, value in siblings if path.startswith(start)}
            scenes.append({**scene, "files": own})
        entries.append(entry_from_dict("item", {**values, "scenes": scenes}))
    return entries


def _without_files(values: dict[str, Any]) -> dict[str, Any]:
    plain = {key: value for key, value in values.items() if key != "files"}
    if "scenes" in plain:
        plain["scenes"] = [_without_files(scene) for scene in plain["scenes"]]
    return plain
