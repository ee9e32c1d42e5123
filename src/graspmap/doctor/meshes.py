"""The doctor's look at object models: OBJ, STL and PLY files.

Letters in shapes: V vertices, F triangles.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.doctor.report import Report, Update, nothing
from graspmap.errors import DatasetNotFoundError, FileFormatError

MESH_SUFFIXES = (".obj", ".ply", ".stl")
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
    """Look through a folder of object models.

    Args:
        root: The folder; subfolders too.
        progress: Called with (done, total).

    Raises:
        DatasetNotFoundError: There is no mesh file.
    """
    paths = sorted(p for p in root.rglob("*") if p.suffix.lower() in MESH_SUFFIXES)
    if not paths:
        raise DatasetNotFoundError(
            root, "holds no .obj, .ply or .stl file", "name the folder that holds the meshes"
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
        items[str(path.relative_to(root))] = {
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
            report.complain(report.root / name, "has no extent: all its vertices coincide")


def _unit(median: float) -> tuple[str, str]:
    if _METERS[0] <= median <= _METERS[1]:
        return "m", "metres, if these are things that a hand can hold"
    if _METERS[0] * 1000 <= median <= _METERS[1] * 1000:
        return "mm", "millimetres, if these are things that a hand can hold (divide by 1000)"
    return "unknown", "neither metres nor millimetres of things that a hand can hold"


def read_mesh(path: Path) -> Mesh:
    """A mesh file as vertices and triangles; polygons are cut into fans.

    Args:
        path: An OBJ, STL (both forms) or PLY (both forms) file.

    Raises:
        FileFormatError: The file is empty, damaged, or has no triangles.
    """
    reader = {".obj": _obj, ".stl": _stl, ".ply": _ply}[path.suffix.lower()]
    try:
        vertices, faces = reader(path.read_bytes())
    except (ValueError, IndexError, KeyError, struct.error) as error:
        raise FileFormatError(path, f"is damaged ({error})", _REMEDY) from error
    if not len(vertices) or not len(faces):
        raise FileFormatError(path, "has no vertices or no faces", _REMEDY)
    if not np.isfinite(vertices).all():
        raise FileFormatError(path, "has vertices that are NaN or infinite", _REMEDY)
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileFormatError(path, "has faces that name vertices it lacks", _REMEDY)
    return Mesh(vertices, faces)


Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]


def _fans(polygons: list[list[int]]) -> NDArray[np.int64]:
    """Polygons as triangles that share their first corner."""
    fans = [(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)]
    return np.array(fans, dtype=np.int64).reshape(-1, 3)


def _obj(content: bytes) -> Triangles:
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    for line in content.decode("utf-8", "replace").splitlines():
        if line.startswith("v "):
            vertices.append([float(word) for word in line.split()[1:4]])
        elif line.startswith("f "):
            numbers = [int(word.split("/")[0]) for word in line.split()[1:]]
            # OBJ counts from 1; negative numbers count back from the latest vertex.
            polygons.append([n - 1 if n > 0 else len(vertices) + n for n in numbers])
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), _fans(polygons)


def _stl(content: bytes) -> Triangles:
    count = struct.unpack_from("<I", content, 80)[0] if len(content) >= 84 else -1
    if len(content) == 84 + 50 * count:
        kind = np.dtype([("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("spare", "<u2")])
        points = np.frombuffer(content, kind, offset=84)["points"].reshape(-1, 3)
    elif content.lstrip().startswith(b"solid"):
        rows = [line.split()[1:4] for line in content.splitlines() if b"vertex" in line]
        points = np.array([[float(w) for w in row] for row in rows]).reshape(-1, 3)
    else:
        raise ValueError(f"{len(content)} bytes, its header promises {84 + 50 * count}")
    vertices, place = np.unique(np.asarray(points, np.float64), axis=0, return_inverse=True)
    return vertices, place.reshape(-1, 3).astype(np.int64)


_PLY_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip


def _ply(content: bytes) -> Triangles:
    head, mark, body = content.partition(b"end_header")
    if not content.startswith(b"ply") or not mark:
        raise ValueError("no PLY header")
    body = body.partition(b"\n")[2]
    form, elements = _ply_header(head.decode("ascii", "replace").splitlines())
    rows = _ply_text(body, elements) if form == "ascii" else _ply_binary(body, elements, form)
    names = [name for name, _ in elements["vertex"][1]]
    columns = [names.index(axis) for axis in "xyz"]
    vertices = [[float(row[c]) for c in columns] for row in rows["vertex"]]
    at = next(i for i, (n, _) in enumerate(elements["face"][1]) if n.startswith("vertex_ind"))
    polygons = [[int(v) for v in row[at]] for row in rows["face"]]
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), _fans(polygons)


Element = tuple[int, list[tuple[str, tuple[str, ...]]]]
"""Count of rows, and (name, types) of each property; two types make a list: count and item."""


def _ply_header(lines: list[str]) -> tuple[str, dict[str, Element]]:
    form, elements, current = "ascii", dict[str, Element](), ""
    for words in (line.split() for line in lines):
        if words[:1] == ["format"]:
            form = words[1]
        elif words[:1] == ["element"]:
            current = words[1]
            elements[current] = (int(words[2]), [])
        elif words[:1] == ["property"]:
            kinds = words[2:4] if words[1] == "list" else words[1:2]
            elements[current][1].append((words[-1], tuple(_PLY_TYPES[k] for k in kinds)))
    return form, elements


def _ply_text(body: bytes, elements: dict[str, Element]) -> dict[str, list[list[Any]]]:
    words = iter(body.split())
    rows: dict[str, list[list[Any]]] = {}
    try:
        for name, (count, properties) in elements.items():
            rows[name] = [
                [
                    float(next(words))
                    if len(kinds) == 1
                    else [float(next(words)) for _ in range(int(next(words)))]
                    for _, kinds in properties
                ]
                for _ in range(count)
            ]
    except (StopIteration, RuntimeError):
        raise ValueError("it ends before its last row") from None
    return rows


def _ply_binary(body: bytes, elements: dict[str, Element], form: str) -> dict[str, list[list[Any]]]:
    order = ">" if "big" in form else "<"
    rows: dict[str, list[list[Any]]] = {}
    at = 0

    def take(kind: str, count: int = 1) -> NDArray[Any]:
        nonlocal at
        values = np.frombuffer(body, order + kind, count, at)
        at += values.nbytes
        return values

    for name, (count, properties) in elements.items():
        rows[name] = [
            [
                take(kinds[0])[0] if len(kinds) == 1 else take(kinds[1], int(take(kinds[0])[0]))
                for _, kinds in properties
            ]
            for _ in range(count)
        ]
    return rows
