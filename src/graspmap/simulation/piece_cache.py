"""Convex pieces on disk, found again by what they follow from.

Letters in shapes: P vertices of one convex piece.
"""

from __future__ import annotations

import hashlib
import io
import logging
import zipfile
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import FileError
from graspmap.files import cache_folder, write_bytes

Floats = NDArray[np.float64]

_LOG = logging.getLogger(__name__)


def kept_pieces(
    facts: Mapping[str, object],
    arrays: Sequence[NDArray[Any]],
    make: Callable[[], tuple[list[Floats], str]],
    *,
    cache: Path | str | None = None,
) -> tuple[list[Floats], str]:
    """Pieces as they were made before, bit for bit, or made now and kept.

    A folder that cannot be written, or a damaged file, costs time only.

    Args:
        facts: Settings that the pieces follow from, with the version of the way they are made;
            those of manifold3d and scipy are added.
        arrays: The surface that they follow from.
        make: Makes (P, 3) vertices of each piece, and a remark on them.
        cache: Folder of the cache; by default `cache_folder`.
    """
    tools = {name: version(name) for name in ("manifold3d", "scipy")}
    name = _key({**facts, **tools}, arrays)
    path = (Path(cache) if cache else cache_folder()) / "pieces" / f"{name}.npz"
    found = _load(path)
    if found is None:
        found = make()
        _save(path, *found)
    return found


def _key(facts: Mapping[str, object], arrays: Sequence[NDArray[Any]]) -> str:
    digest = hashlib.blake2b(repr(sorted(facts.items())).encode(), digest_size=20)
    for array in arrays:
        digest.update(repr(array.shape).encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _load(path: Path) -> tuple[list[Floats], str] | None:
    """What `_save` wrote; None where there is nothing, or something damaged."""
    try:
        with np.load(io.BytesIO(path.read_bytes())) as content:
            remark = str(content["remark"])
            pieces = [content[name] for name in sorted(content.files) if name != "remark"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        _LOG.warning("%s is damaged (%s), it is made again", path, error)
        return None
    whole = all(p.ndim == 2 and p.shape[1:] == (3,) and np.isfinite(p).all() for p in pieces)
    return (pieces, remark) if pieces and whole else None


def _save(path: Path, pieces: list[Floats], remark: str) -> None:
    content = io.BytesIO()
    named = {f"{number:05d}": piece for number, piece in enumerate(pieces)}
    np.savez(content, remark=np.array(remark), **named)  # type: ignore[arg-type]
    try:
        write_bytes(path, content.getvalue())
    except FileError as error:
        _LOG.warning("the pieces are not kept: %s", error)  # a full disk costs time, no more
