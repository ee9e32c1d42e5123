"""Meshes of the user: from a file to an object that can be dropped, seen and grasped.

Letters in shapes: V vertices, F triangles.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import FileFormatError, GraspmapWarning, InvalidInputError, UnknownNameError
from graspmap.gripper import Gripper
from graspmap.simulation._mend import CannotMendError, Mended, mend
from graspmap.simulation._mesh_file import MESH_SUFFIXES, RawMesh, read_mesh_file
from graspmap.simulation.hulls import box_sides
from graspmap.simulation.objects import ObjectModel, Texture
from graspmap.simulation.pieces import Method, convex_pieces
from graspmap.simulation.solids import mass_properties, object_from_solid

__all__ = ["MESH_SUFFIXES", "MeshWarning", "Unit", "UnitWarning", "egad_scale", "load_object"]

Floats = NDArray[np.float64]
Unit = Literal["m", "cm", "mm", "inch"]

UNITS_M: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254}
"""Length of each unit."""

SIZES_M = (0.005, 2.0)
"""Longest side of a thing on a table; a mesh of such a size is taken to be in metres."""

DENSITY_KG_M3 = 500.0
"""Of an object whose mass is not given: between a full bottle and an empty box."""

MASS_KG = (0.01, 1.0)
"""A mass that follows from the density is kept in this range."""

TOLERANCE_M = 0.002
"""How far the hulls of the pieces may stand off the surface: fingers feel more than that."""

_TOLERANCES = (0.005, 0.05)  # of the longest side: finer takes minutes, coarser is another object
_FLATTEST_SIDE = 0.8  # of the opening: EGAD's bound for the shortest side


class MeshWarning(GraspmapWarning):
    """A mesh was used, but not as it stands in its file."""


class UnitWarning(MeshWarning):
    """The unit of a mesh was guessed."""


def load_object(
    path: Path | str,
    *,
    id: str | None = None,
    unit: Unit | None = None,
    fit_to: Gripper | None = None,
    mass_kg: float | None = None,
    density_kg_m3: float = DENSITY_KG_M3,
    mass_range_kg: tuple[float, float] = MASS_KG,
    tolerance_m: float = TOLERANCE_M,
    method: Method = "cuts",
    cache: Path | str | None = None,
) -> ObjectModel:
    """An object from a mesh file.

    All geometries of the file together are one object. Open surfaces are closed where that gives a
    body, large ones are simplified; a `MeshWarning` says what was done.

    Args:
        path: A file with one of `MESH_SUFFIXES`.
        id: Name of the object; by default that of the file, or of its folder for files that all
            have the same name (``003_cracker_box/textured.obj``).
        unit: Unit of the file. By default what the format says (GLB), or metres or millimetres by
            the size, with a `UnitWarning`.
        fit_to: A gripper to whose opening the object is scaled by EGAD's rule, see `egad_scale`;
            the unit does not matter then.
        mass_kg: Its mass; by default volume times density, kept in ``mass_range_kg``.
        density_kg_m3: Density, where the mass is not given.
        mass_range_kg: Least and greatest mass, where it is not given.
        tolerance_m: How far the hulls of its convex pieces may stand off its surface; not below
            0.5 % or above 5 % of its length.
        method: See `convex_pieces`.
        cache: See `convex_pieces`.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: It is no mesh, damaged, empty, flat, has vertices that are not finite,
            encloses nothing, or its size is not that of a thing on a table.
        InvalidInputError: An argument is out of its range.
    """
    path = Path(path)
    if unit is not None and unit not in UNITS_M:
        raise UnknownNameError("unit", str(unit), get_args(Unit))
    if not 0 < mass_range_kg[0] <= mass_range_kg[1]:
        raise InvalidInputError("mass_range_kg", mass_range_kg, "least and greatest, above 0")
    raw = read_mesh_file(path)
    used = raw.vertices[np.unique(raw.faces)]
    longest = float(np.ptp(used, axis=0).max())
    if not longest > 0:
        raise FileFormatError(path, "all its vertices coincide", "export the mesh again")
    if fit_to is None:
        unit_m = _unit(path, longest, unit, raw.unit_m)
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    mended = _mended(path, raw, (raw.vertices - middle) / longest)
    scale = egad_scale(mended.vertices, fit_to.max_opening_m) if fit_to else unit_m * longest
    texture = _texture(path, raw, mended)
    pieces = convex_pieces(
        mended.vertices,
        mended.faces,
        threshold=_threshold(tolerance_m, scale),
        method=method,
        cache=cache,
    )
    if mass_kg is None:
        volume = mass_properties(mended.vertices, mended.faces).volume_m3 * scale**3
        mass_kg = float(np.clip(volume * density_kg_m3, *mass_range_kg))
    return object_from_solid(
        id or default_id(path),
        mended.vertices * scale,
        mended.faces,
        [piece * scale for piece in pieces],
        mass_kg=mass_kg,
        texture=texture,
    )


def _threshold(tolerance_m: float, longest_m: float) -> float:
    if not 0 < tolerance_m < np.inf:
        raise InvalidInputError("tolerance_m", tolerance_m, "metres, above 0")
    # Few digits, so that nearly the same scales find the same pieces in the cache.
    least, most = _TOLERANCES
    return float(f"{min(max(tolerance_m / longest_m, least), most):.2g}")


def egad_scale(vertices: ArrayLike, opening_m: float) -> float:
    """The factor that fits an object to a gripper by EGAD's rule.

    The longest side of the oriented box becomes the opening; where the shortest side is then above
    0.8 of the opening, it becomes 0.8 of it.

    Args:
        vertices: (V, 3) in any unit.
        opening_m: Greatest opening of the gripper.

    Raises:
        InvalidInputError: The opening is not above 0.

    References:
        Morrison, Corke, Leitner, "EGAD! An evolved grasping analysis dataset for diversity and
        reproducibility in robotic manipulation", RA-L 2020.
    """
    if not 0 < opening_m < np.inf:
        raise InvalidInputError("opening_m", opening_m, "metres, above 0")
    sides = box_sides(np.asarray(vertices, dtype=np.float64))
    return float(min(opening_m / sides[2], _FLATTEST_SIDE * opening_m / sides[0]))


def default_id(path: Path) -> str:
    """Name of the object in a mesh file: that of the file, or of its folder (``textured.obj``)."""
    plain = ("textured", "mesh", "model", "object", "visual", "nontextured", "google_16k")
    name = path.parent.name if path.stem.lower() in plain and path.parent.name else path.stem
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", name).strip("-.") or "object"


def _unit(path: Path, longest: float, unit: Unit | None, of_format: float | None) -> float:
    """Metres in a unit of the file."""
    low, high = SIZES_M
    stated = UNITS_M[unit] if unit is not None else of_format
    if stated is not None:
        if not low <= longest * stated <= high:
            large = "enormous" if longest * stated > high else "tiny"
            raise FileFormatError(
                path,
                f"is {large}: {longest * stated:.4g} m long with its unit "
                f"{unit or 'as the format has it'}",
                f"state another unit, or scale it; things of {low:g} to {high:g} m are allowed",
            )
        return stated
    for name in ("m", "mm"):
        if low <= longest * UNITS_M[name] <= high:
            warnings.warn(
                f"{path}: its unit is taken for {name}, so it is {longest * UNITS_M[name]:.3g} m "
                f"long; state the unit (unit={name!r}, --unit {name}) to be sure",
                UnitWarning,
                stacklevel=3,
            )
            return UNITS_M[name]
    raise FileFormatError(
        path,
        f"its longest side is {longest:.4g}, neither metres nor millimetres of a thing of {low:g} "
        f"to {high:g} m",
        f"state its unit ({', '.join(UNITS_M)}) or scale it",
    )


def _mended(path: Path, raw: RawMesh, vertices: Floats) -> Mended:
    try:
        mended = mend(vertices, raw.faces)
    except CannotMendError as error:
        raise FileFormatError(
            path, f"is no body ({error})", "close the mesh, and give sheets a thickness"
        ) from error
    for remark in (*raw.remarks, *mended.remarks):
        warnings.warn(f"{path}: {remark}", MeshWarning, stacklevel=3)
    return mended


def _texture(path: Path, raw: RawMesh, mended: Mended) -> Texture | None:
    if raw.texture is None:
        return None
    if mended.kept is None:
        warnings.warn(
            f"{path}: its texture does not fit the mended surface and is left out",
            MeshWarning,
            stacklevel=3,
        )
        return None
    return replace(raw.texture, uv=raw.texture.uv[mended.kept])
