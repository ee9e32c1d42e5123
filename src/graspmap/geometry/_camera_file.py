"""How intrinsics are written down by others, and reading and writing their files."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from graspmap.errors import FileFormatError, GraspmapWarning, InvalidInputError
from graspmap.files import read_text

_REMEDY = "give a JSON or YAML file with fx, fy, cx, cy, width, height, or a ROS camera_info"
_MATRIX_KEYS = ("K", "k", "camera_matrix")
_DISTORTION_KEYS = ("D", "d", "distortion_coefficients", "coeffs")


def intrinsics(values: Mapping[str, Any]) -> dict[str, Any]:
    """The six numbers of a `Camera`, not yet checked for their ranges.

    Raises:
        InvalidInputError: A number is missing, or the camera matrix is not one.
    """
    found: dict[str, Any] = {}
    key = next((k for k in _MATRIX_KEYS if k in values), None)
    if key is not None and "fx" not in values:
        found.update(_from_matrix(key, values[key]))
    names = {
        "fx": ("fx",),
        "fy": ("fy",),
        "cx": ("cx", "ppx"),
        "cy": ("cy", "ppy"),
        "width": ("width", "image_width"),
        "height": ("height", "image_height"),
    }
    for name, spellings in names.items():
        spelling = next((s for s in spellings if s in values), None)
        if spelling is not None:
            found.setdefault(name, values[spelling])
    missing = [name for name in names if name not in found]
    if missing:
        raise InvalidInputError(
            "camera",
            f"without {', '.join(missing)} (it has {', '.join(map(str, values)) or 'nothing'})",
            "fx, fy, cx, cy, width, height, or a ROS camera_info with K, width and height",
        )
    _warn_of_distortion(values)
    return found


def _from_matrix(key: str, value: Any) -> dict[str, float]:
    """Focal lengths and principal point from nine numbers, row by row, or three rows of three."""
    rows: Any = value.get("data") if isinstance(value, Mapping) else value
    try:
        flat = [n for row in rows for n in (row if isinstance(row, list | tuple) else [row])]
        numbers = [float(n) for n in flat]
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInputError(key, f"{value!r:.80}", "nine numbers, row by row") from error
    if len(numbers) != 9:
        raise InvalidInputError(f"length of {key}", len(numbers), "nine numbers, row by row")
    fx, skew, cx, zero, fy, cy, *last = numbers
    if (skew, zero, *last) != (0.0, 0.0, 0.0, 0.0, 1.0):
        raise InvalidInputError(key, numbers, "fx 0 cx / 0 fy cy / 0 0 1, row by row, no skew")
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy}


def _warn_of_distortion(values: Mapping[str, Any]) -> None:
    for key in _DISTORTION_KEYS:
        terms = values.get(key)
        terms = terms.get("data") if isinstance(terms, Mapping) else terms
        if isinstance(terms, list | tuple) and any(t not in (0, 0.0) for t in terms):
            warnings.warn(
                f"{key} is {list(terms)}: graspmap's camera has no lens distortion; "
                "rectify the pictures first or accept the error near their edges",
                GraspmapWarning,
                stacklevel=4,
            )


def load(path: Path) -> Mapping[str, Any]:
    """The mapping in a JSON or YAML file (the first document of several).

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: It is neither, or holds something else than keys and values.
    """
    import yaml

    text = read_text(path)
    try:
        try:
            values = json.loads(text)
        except ValueError:  # no JSON, or a number with thousands of digits
            values = next(yaml.safe_load_all(text), None)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise FileFormatError(path, "neither JSON nor YAML", _REMEDY) from error
    if not isinstance(values, Mapping):
        raise FileFormatError(path, "no keys and values in it", _REMEDY)
    return values
