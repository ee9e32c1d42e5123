"""Reading mesh files: any format, any number of geometries, to plain arrays.

Letters in shapes: V vertices, F triangles, h rows and w columns of a picture.
"""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import FileFormatError, MissingFileError
from graspmap.simulation.objects import Texture

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".off", ".stl")
"""Endings of the files that can be read, those first that say most of an object."""

_LARGEST_BYTES = 2_000_000_000
_TEXTURE_PX = 1024  # an object covers a few hundred pixels of a picture
_MOST_PICTURES = 16
_EXPORT = "export the mesh again, as OBJ, STL, PLY, OFF or GLB"
_UNITS = {"meters": 1.0, "centimeters": 0.01, "millimeters": 0.001, "inches": 0.0254}


@dataclass(frozen=True, eq=False)
class RawMesh:
    """What a mesh file holds.

    Args:
        vertices: (V, 3) in the file's own unit.
        faces: (F, 3) vertex numbers.
        texture: Its picture, where it has one.
        unit_m: Length of the file's unit, where its format says it.
        remarks: What of it had to be left out.
    """

    vertices: Floats
    faces: Faces
    texture: Texture | None
    unit_m: float | None
    remarks: tuple[str, ...] = ()


def read_mesh_file(path: Path) -> RawMesh:
    """All triangles of a mesh file, its geometries put where their scene has them.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: It is no mesh file, damaged, without triangles, or has vertices that are
            not finite.
    """
    _check_file(path)
    import trimesh

    # What trimesh would say about a damaged file is said by our error.
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)
    try:
        scene = _scene(path)
        meshes = [g for g in scene.dump() if isinstance(g, trimesh.Trimesh) and len(g.faces)]
        unit = _UNITS.get(str(scene.units))
    except MemoryError:
        raise
    except ImportError as error:  # trimesh would look for a package that guesses the encoding
        raise FileFormatError(
            path, f"cannot be read as {path.suffix.lower()} (it is no UTF-8 text)", _EXPORT
        ) from error
    except Exception as error:  # whatever a parser stumbles over
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileFormatError(
            path, f"cannot be read as {path.suffix.lower()} ({reason:.100})", _EXPORT
        ) from error
    if not meshes:
        raise FileFormatError(path, "holds no triangle (it is empty, or no mesh)", _EXPORT)
    vertices = np.concatenate([np.asarray(m.vertices, np.float64) for m in meshes])
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = np.concatenate([np.asarray(m.faces) + s for m, s in zip(meshes, starts, strict=False)])
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise FileFormatError(path, "has triangles with vertices that do not exist", _EXPORT)
    used = np.unique(faces)
    wrong = ~np.isfinite(vertices[used]).all(axis=1)
    if wrong.any():
        raise FileFormatError(
            path, f"{int(wrong.sum())} of {len(wrong)} vertices are NaN or infinite", _EXPORT
        )
    texture, remarks = _texture(meshes)
    if len(used) < len(vertices):  # points that no triangle uses are no part of the surface
        vertices, faces = vertices[used], np.searchsorted(used, faces)
        texture = None if texture is None else replace(texture, uv=texture.uv[used])
    return RawMesh(vertices, faces.astype(np.int32), texture, unit, remarks)


def _scene(path: Path) -> Any:
    """What trimesh makes of a file.

    OBJ files of old programs have names of objects in an old encoding. Those do not matter here;
    Latin-1 gives every byte a letter.
    """
    import trimesh

    try:
        return trimesh.load_scene(path, process=False)
    except ImportError:
        if path.suffix.lower() != ".obj":
            raise
        text = io.StringIO(path.read_bytes().decode("latin-1"))
        folder = trimesh.resolvers.FilePathResolver(str(path))
        return trimesh.load_scene(text, file_type="obj", resolver=folder, process=False)


def _check_file(path: Path) -> None:
    if not path.exists():
        raise MissingFileError(path, "no such file", "check the name")
    if path.is_dir():
        raise FileFormatError(path, "this is a folder", "name a mesh file in it")
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise FileFormatError(
            path, f"{path.suffix or 'no ending'!r} is no mesh format known here", _EXPORT
        )
    size = path.stat().st_size
    if size == 0:
        raise FileFormatError(path, "the file is empty", _EXPORT)
    if size > _LARGEST_BYTES:
        raise FileFormatError(
            path, f"is {size / 1e9:.1f} GB large", "simplify the mesh to under a million triangles"
        )


def _texture(meshes: list[Any]) -> tuple[Texture | None, tuple[str, ...]]:
    """The pictures of all geometries side by side, and where the vertices are in them."""
    pictures = [_picture(mesh) for mesh in meshes]
    if all(picture is None for picture in pictures):
        return None, ()
    if len(meshes) > _MOST_PICTURES:
        return None, (f"{len(meshes)} textured parts, more than {_MOST_PICTURES}: drawn plain",)
    uv = [_uv(mesh) for mesh in meshes]
    tiles = [
        _plain(mesh) if picture is None else picture
        for mesh, picture in zip(meshes, pictures, strict=True)
    ]
    if len(meshes) == 1:
        return Texture(_shrunk(tiles[0], _TEXTURE_PX), uv[0]), ()
    side = max(64, _TEXTURE_PX // len(tiles) * 2)
    image = np.concatenate([_resized(tile, side, side) for tile in tiles], axis=1)
    # Half a texel stays free on each side, lest neighbours bleed in.
    edge = 0.5 / side
    parts = [
        np.column_stack([(i + edge + (1 - 2 * edge) * p[:, 0] % 1.0) / len(tiles), p[:, 1]])
        for i, p in enumerate(uv)
    ]
    return Texture(image, np.concatenate(parts)), ()


def _picture(mesh: Any) -> NDArray[np.uint8] | None:
    """(h, w, 3) the picture of a geometry, where it has a usable one."""
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    uv = getattr(mesh.visual, "uv", None)
    if image is None or uv is None or len(uv) != len(mesh.vertices) or not np.isfinite(uv).all():
        return None
    try:
        return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, ValueError, SyntaxError):  # as PIL says that a picture is damaged
        return None


def _uv(mesh: Any) -> Floats:
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or len(uv) != len(mesh.vertices):
        return np.full((len(mesh.vertices), 2), 0.5)
    return np.nan_to_num(np.asarray(uv, dtype=np.float64))


def _plain(mesh: Any) -> NDArray[np.uint8]:
    """(1, 1, 3) the one colour of a geometry without a picture."""
    color = np.asarray(getattr(mesh.visual, "main_color", (150, 150, 150, 255)), dtype=np.uint8)
    return np.ascontiguousarray(color[:3].reshape(1, 1, 3))


def _shrunk(image: NDArray[np.uint8], most: int) -> NDArray[np.uint8]:
    rows, columns = image.shape[:2]
    factor = most / max(rows, columns)
    if factor >= 1:
        return image
    return _resized(image, max(1, round(rows * factor)), max(1, round(columns * factor)))


def _resized(image: NDArray[np.uint8], rows: int, columns: int) -> NDArray[np.uint8]:
    import cv2

    return np.asarray(cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)
