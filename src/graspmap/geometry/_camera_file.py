"""How intrinsics are written down by others, and reading and writing their files."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from graspmap.errors import FileFormatError, GraspmapWarning, InvalidInputError
from graspmap.files import read_text

_REMEDY = "give a JSON or YAML file with fx, fy, cx, cy, width, height, or a ROS camera_info"
_MATRIX_KEYS = ("K", "k", "camera_matrix")
_DISTORTION_KEYS = ("D", "d", "distortion_coefficients", "coeffs")
_PROJECTION_KEYS = ("P", "p", "projection_matrix")


def intrinsics(values: Mapping[str, Any]) -> dict[str, Any]:
    """The six numbers of a `Camera`, not yet checked for their ranges.

    Raises:
        InvalidInputError: A number is missing, or the camera matrix is not one.
    """
    found: dict[str, Any] = {}
    key = next((k for k in _MATRIX_KEYS if k in values), None)
    bent = next((k for k in _DISTORTION_KEYS if k in values and any(_flat(values[k]) or ())), None)
    if key is not None and "fx" not in values:
        rectified = None if bent is None else _rectified(values)
        found.update(rectified or _from_matrix(key, values[key]))
        if rectified:
            bent = None
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
    if bent is not None:
        _warn(
            f"{bent} is {_flat(values[bent])}: graspmap's camera has no lens distortion; "
            "rectify the pictures first or accept the error near their edges"
        )
    return found


def _flat(value: Any) -> list[float] | None:
    """The numbers of a list, of rows, of an array, or of a mapping with ``data``; else None."""
    try:
        rows = value["data"] if isinstance(value, Mapping) else value
        found: list[float] = np.asarray(rows, np.float64).ravel().tolist()
    except (TypeError, ValueError, OverflowError, KeyError):
        return None
    return found


def _from_matrix(key: str, value: Any) -> dict[str, float]:
    """Focal lengths and principal point from nine numbers, row by row, or three rows of three."""
    numbers = _flat(value)
    if numbers is None:
        raise InvalidInputError(key, f"{value!r:.80}", "nine numbers, row by row")
    if len(numbers) != 9:
        raise InvalidInputError(f"length of {key}", len(numbers), "nine numbers, row by row")
    fx, skew, cx, zero, fy, cy, *last = numbers
    if (skew, zero, *last) != (0.0, 0.0, 0.0, 0.0, 1.0):
        raise InvalidInputError(key, numbers, "fx 0 cx / 0 fy cy / 0 0 1, row by row, no skew")
    return {"fx": fx, "fy": fy, "cx": cx, "cy": cy}


def _rectified(values: Mapping[str, Any]) -> dict[str, float] | None:
    """The camera of the rectified picture, which a ROS camera_info has beside that of the lens.

    Its D stays that of the lens, whichever picture the camera_info came with. None where it does
    not say, as before a calibration.
    """
    key = next((k for k in _PROJECTION_KEYS if k in values), None)
    numbers = None if key is None else _flat(values[key])
    if numbers is None or len(numbers) != 12 or not numbers[0] > 0 or not numbers[5] > 0:
        return None
    _warn(
        f"the camera_info has lens distortion: its {key} is taken, the camera of the rectified "
        "picture; give that picture (image_rect), not the raw one"
    )
    return {"fx": numbers[0], "fy": numbers[5], "cx": numbers[2], "cy": numbers[6]}


def _warn(text: str) -> None:
    warnings.warn(text, GraspmapWarning, stacklevel=5)


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
