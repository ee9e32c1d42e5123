"""Objects in files: what trials were made with, whole, so that they can be made again anywhere.

A model file is an ``.npz`` (NumPy's archive) with the surface, the convex pieces and the mass; the
same object gives the same bytes.
"""

from __future__ import annotations

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from graspmap.errors import FileFormatError
from graspmap.files import read_bytes, write_bytes
from graspmap.simulation.objects import ObjectModel, Texture

_REMEDY = "make the data set again, or copy the file again"


def write_model(path: Path, model: ObjectModel) -> None:
    """Write an object; reading gives the same one.

    Raises:
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed.
    """
    arrays: dict[str, Any] = {
        "vertices": model.vertices,
        "faces": model.faces,
        "pieces": np.concatenate(model.pieces),
        "piece_sizes": np.array([len(piece) for piece in model.pieces]),
        "mass_kg": np.float64(model.mass_kg),
        "inertia": model.inertia,
    }
    if model.texture is not None:
        arrays |= {"texture": model.texture.image, "uv": model.texture.uv}
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write_bytes(path, content.getvalue())


def read_model(path: Path, id: str) -> ObjectModel:
    """The object in a model file.

    Args:
        path: The file.
        id: Name to give it.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: It is no model file, or a damaged one.
    """
    content = read_bytes(path)
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            sizes = np.cumsum(arrays["piece_sizes"])[:-1]
            texture = Texture(arrays["texture"], arrays["uv"]) if "uv" in arrays else None
            return ObjectModel(
                id=id,
                vertices=arrays["vertices"],
                faces=arrays["faces"],
                pieces=tuple(np.split(arrays["pieces"], sizes)),
                mass_kg=float(arrays["mass_kg"]),
                inertia=arrays["inertia"],
                texture=texture,
            )
    except (ValueError, KeyError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise FileFormatError(path, "is no model of graspmap, or a damaged one", _REMEDY) from error
