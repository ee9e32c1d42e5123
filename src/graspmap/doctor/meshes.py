"""The doctor's look at object models, in any format that trimesh reads.

Letters in shapes: V vertices, F triangles.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.doctor.report import Report, Update, nothing
from graspmap.errors import DatasetNotFoundError, FileFormatError
from graspmap.files import read_bytes

MESH_SUFFIXES = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
_NEEDS_MORE = (".3mf", ".dae")
"""Formats for which trimesh asks for a library that is not among graspmap's."""
_REMEDY = "export the mesh again"
_METERS = (0.005, 2.0)
"""Longest side of an object that a hand can grasp, metres: a number in this range is metres."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, as far as the doctor needs it.

    Args:
        vertices: (V, 3) in the file's own unit.
        faces: (F, 3) vertex numbers.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]

    @property
    def extents(self) -> NDArray[np.float64]:
        """(3,) sides of the axis-aligned box round the vertices that faces use."""
        used = self.vertices[np.unique(self.faces)]
        return np.asarray(used.max(axis=0) - used.min(axis=0))

    def edge_uses(self) -> NDArray[np.int64]:
        """How many triangles share each edge; vertices at one place count as one.

        A closed surface has no odd number; more than two say that it touches itself.
        """
        _, place = np.unique(self.vertices, axis=0, return_inverse=True)
        faces = place.reshape(-1)[self.faces]
        different = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        edges = faces[different][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        _, uses = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
        return np.asarray(uses)


def examine_meshes(root: Path, *, progress: Update = nothing, **_: Any) -> Report:
    """Look through object models.

    Args:
        root: A folder (subfolders too) or one file.
        progress: Called with (done, total).

    Raises:
        DatasetNotFoundError: There is no mesh file.
    """
    paths = [root] if root.is_file() else sorted(root.rglob("*"))
    paths = [path for path in paths if path.suffix.lower() in MESH_SUFFIXES]
    if not paths:
        raise DatasetNotFoundError(
            root,
            f"holds no {', '.join(MESH_SUFFIXES[:-1])} or {MESH_SUFFIXES[-1]} file",
            "name the folder that holds the meshes",
        )
    report = Report("meshes", root)
    items: dict[str, dict[str, Any]] = {}
    for done, path in enumerate(paths):
        progress(done, len(paths))
        try:
            mesh = read_mesh(path)
        except FileFormatError as error:
            report.complain(path, error.problem)
            continue
        uses = mesh.edge_uses()
        items[path.name if path == root else str(path.relative_to(root))] = {
            "vertices": len(mesh.vertices),
            "faces": len(mesh.faces),
            "extents": mesh.extents,
            "closed": bool((uses % 2 == 0).all()),
            "touching_edges": int((uses > 2).sum()),
        }
    report.count = len(items)
    report.good_for = ("generate", "trial") if items else ()
    kinds = {s: sum(p.suffix.lower() == s for p in paths) for s in MESH_SUFFIXES}
    named = ", ".join(f"{n} {s[1:]}" for s, n in kinds.items() if n)
    report.say("meshes", f"{len(items)} of {len(paths)} can be read ({named})", files=len(paths))
    if items:
        _sizes(report, items)
    report.facts["items"] = items
    return report


def _sizes(report: Report, items: dict[str, dict[str, Any]]) -> None:
    longest = np.array([item["extents"].max() for item in items.values()])
    unit, why = _unit(float(np.median(longest)))
    report.say(
        "size",
        f"longest side {longest.min():.4g} to {longest.max():.4g}, median "
        f"{np.median(longest):.4g}: {why}",
        longest_side=[float(longest.min()), float(np.median(longest)), float(longest.max())],
        unit=unit,
    )
    faces = [item["faces"] for item in items.values()]
    report.say("faces", f"{min(faces)} to {max(faces)} triangles")
    opened = [name for name, item in items.items() if not item["closed"]]
    touching = sum(item["touching_edges"] > 0 for item in items.values())
    text = "all closed"
    if opened:
        text = (
            f"{len(items) - len(opened)} closed, {len(opened)} with holes (volume and mass need "
            f"a closed surface): {', '.join(opened[:5])}{' ...' if len(opened) > 5 else ''}"
        )
    if touching:
        text += f"; {touching} touch themselves along a few edges"
    report.say("surface", text, closed=len(items) - len(opened), touching=touching)
    for name, item in items.items():
        if not item["extents"].max() > 0:
            path = report.root if report.root.is_file() else report.root / name
            report.complain(path, "has no extent: all its vertices coincide")


def _unit(median: float) -> tuple[str, str]:
    if _METERS[0] <= median <= _METERS[1]:
        return "m", "metres, if these are things that a hand can hold"
    if _METERS[0] * 1000 <= median <= _METERS[1] * 1000:
        return "mm", "millimetres, if these are things that a hand can hold (divide by 1000)"
    return "unknown", "neither metres nor millimetres of things that a hand can hold"


def read_mesh(path: Path) -> Mesh:
    """A mesh file as vertices and triangles: all its parts together, polygons cut.

    Args:
        path: A file of a format that trimesh reads.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: The file is empty, damaged, or has no triangles, or its format needs a
            library that is not installed.
    """
    content = read_bytes(path)
    try:
        vertices, faces = _load(path, content)
    except ImportError as error:
        if path.suffix.lower() in _NEEDS_MORE:
            problem = f"cannot be read without another library ({error})"
            raise FileFormatError(path, problem, "install that, or export it as .glb") from error
        raise FileFormatError(path, "is damaged", _REMEDY) from error
    except IndexError as error:
        raise FileFormatError(path, "has faces that name vertices it lacks", _REMEDY) from error
    except Exception as error:  # trimesh raises whatever the damaged bytes lead to
        raise FileFormatError(path, f"is damaged ({error})", _REMEDY) from error
    if not len(vertices) or not len(faces):
        raise FileFormatError(path, "has no vertices or no faces", _REMEDY)
    if not np.isfinite(vertices).all():
        raise FileFormatError(path, "has vertices that are NaN or infinite", _REMEDY)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileFormatError(path, "has faces that name vertices it lacks", _REMEDY)
    return Mesh(vertices, faces)


def _load(path: Path, content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    import trimesh

    source: Any = path
    kind = path.suffix.lower()[1:]
    if kind == "obj":
        # Its numbers are ASCII; a name in another encoding is no reason to fail.
        source = io.BytesIO(content.decode("utf-8", "replace").encode())
    # As it is in the file: vertices neither merged nor dropped.
    scene = trimesh.load_scene(source, file_type=kind, process=False, skip_materials=True)
    mesh = scene.to_mesh()
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
