"""Rebuilding a tabletop from one depth picture: what is seen from above, extruded to the table.

The picture shows no undersides, so each object stands on the table as a block with the outline and
the top that the camera sees (2.5D). Gaps under a part are filled; gaps beside a part are kept.

World frame: the table is the plane z = 0, z up, metres. Letters in shapes: H rows, W columns of the
picture; R rows, C columns of cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry.camera import Camera
from graspmap.geometry.transforms import RigidTransform
from graspmap.simulation.block import block_from_heights
from graspmap.simulation.columns import ColumnTolerance
from graspmap.simulation.heightmap import MOST_CELLS, RESOLUTION_M, HeightMap
from graspmap.simulation.table_plane import fit_table_plane
from graspmap.simulation.tabletop import Tabletop

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Bodies = Literal["one", "components"]

LOWEST_M = 0.002
"""What rises less above the table is table: no finger gets hold of it."""

_LEAST_CELLS_M2 = 1.5e-5  # parts of an object with less area are noise at its rim
_BESIDE_PX = 4  # how far the mask is widened before the rest counts as table
_ABOVE_NOISE = 4.0  # standard deviations of the table that an object rises, without a mask
_LEAST_RISE_M = 0.004  # lower things are lost in a stereo camera's noise


@dataclass(frozen=True, eq=False)
class Rebuilt:
    """A tabletop made from a depth picture.

    Args:
        tabletop: Its objects and the height map they were made from.
        T_world_camera: Pose of the camera, refined on the table that the picture shows.
        mask: (H, W) pixels taken for objects.
        table_residual_m: Robust standard deviation of the table's depth from its plane.
        table_share: Part of the pixels beside the objects that lies on the table.
        filled_share: Part of the objects' pixels that had no usable depth and got a neighbour's.
    """

    tabletop: Tabletop
    T_world_camera: RigidTransform
    mask: Mask
    table_residual_m: float
    table_share: float
    filled_share: float


def rebuild_tabletop(
    depth_m: NDArray[np.float32],
    mask: Mask | None,
    camera: Camera,
    T_world_camera: RigidTransform | None = None,
    *,
    bodies: Bodies = "one",
    resolution_m: float = RESOLUTION_M,
    density_kg_m3: float = 300.0,
    mass_range_kg: tuple[float, float] = (0.02, 0.1),
    tolerance: ColumnTolerance | None = None,
    name: str = "rebuilt",
) -> Rebuilt:
    """The objects that a depth picture shows, as blocks on the table that it shows.

    Args:
        depth_m: (H, W) metres along the camera's z axis, NaN where there is none.
        mask: (H, W) True on the objects; None to take what rises above the table.
        camera: Intrinsics of the picture.
        T_world_camera: Where the camera is, as well as it is known; None to find it. Either way
            the table's plane is fitted to the depth; the pose gives where to begin, and x and y.
        bodies: ``"one"`` makes one rigid object of everything, ``"components"`` one of each part
            that does not touch another in the view from above.
        resolution_m: Side of a cell of the height map.
        density_kg_m3: Of an object, as far as its mass stays within the range.
        mass_range_kg: Least and greatest mass of an object.
        tolerance: How closely the convex pieces follow the height map.
        name: Id of the object; with several, each gets a number behind it.

    Returns:
        The tabletop, and the pose with which pixels map onto it.

    Raises:
        InvalidInputError: Sizes differ, a number is out of range, the mask is empty or without
            depth, nothing rises above the table, or no table is found (see `fit_table_plane`).
        UnknownNameError: ``bodies`` is neither of the two.
    """
    _check(depth_m, mask, camera, bodies, resolution_m, density_kg_m3, mass_range_kg)
    beside = np.ones(depth_m.shape, np.bool_) if mask is None else ~_widened(mask)
    plane = fit_table_plane(depth_m, beside, camera, T_world_camera)
    pose = plane.T_world_camera
    rises = _pixel_heights(depth_m, camera, pose)
    if mask is None:
        mask = risen(rises, plane.residual_m)
    pixels, filled = _tops(rises, mask)
    heights, origin = _draw(pixels, camera, pose, resolution_m)
    heights = _without_crumbs(heights, resolution_m)
    height_map = HeightMap(heights.astype(np.float32), origin, resolution_m)
    parts = [heights] if bodies == "one" else _components(heights)
    objects = []
    for number, part in enumerate(parts):
        id = name if len(parts) == 1 else f"{name}_{number}"
        objects.append(
            block_from_heights(
                id,
                part,
                origin,
                resolution_m,
                density_kg_m3=density_kg_m3,
                mass_range_kg=mass_range_kg,
                tolerance=tolerance,
            )
        )
    return Rebuilt(
        Tabletop(tuple(objects), height_map), pose, mask, plane.residual_m, plane.share, filled
    )


def _check(
    depth_m: NDArray[np.float32],
    mask: Mask | None,
    camera: Camera,
    bodies: str,
    resolution_m: float,
    density_kg_m3: float,
    mass_range_kg: tuple[float, float],
) -> None:
    size = (camera.height, camera.width)
    for what, image in (("depth_m", depth_m), ("mask", mask)):
        if image is not None and image.shape != size:
            raise InvalidInputError(f"shape of {what}", image.shape, f"{size}, the camera's")
    if mask is not None and mask.dtype != np.bool_:
        raise InvalidInputError("type of mask", mask.dtype, "bool, True on the objects")
    if mask is not None and not mask.any():
        raise InvalidInputError("mask", "empty", "True on the objects, or None to find them")
    if bodies not in get_args(Bodies):
        raise UnknownNameError("bodies", bodies, get_args(Bodies))
    if not 1e-4 <= resolution_m <= 0.02:
        raise InvalidInputError("resolution_m", resolution_m, "0.0001 to 0.02 m")
    if not 0 < density_kg_m3 < np.inf:
        raise InvalidInputError("density_kg_m3", density_kg_m3, "a finite number above 0")
    low, high = mass_range_kg
    if not 0 < low <= high < np.inf:
        raise InvalidInputError("mass_range_kg", mass_range_kg, "0 < least <= greatest")


def _widened(mask: Mask) -> Mask:
    side = 2 * _BESIDE_PX + 1
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)


def _pixel_heights(depth_m: NDArray[np.float32], camera: Camera, pose: RigidTransform) -> Floats:
    """(H, W) how high above the table each pixel's point lies; NaN without depth."""
    down = pose.rotation[2]
    u = (np.arange(camera.width) - camera.cx) / camera.fx * down[0]
    v = (np.arange(camera.height) - camera.cy) / camera.fy * down[1]
    return np.asarray(depth_m * (v[:, None] + u + down[2]) + pose.translation[2])


def risen(rises: Floats, residual_m: float) -> Mask:
    """What stands on the table, where no mask says so.

    Args:
        rises: (H, W) metres from the table to each pixel's point, upwards or towards the camera;
            NaN where there is no depth.
        residual_m: Robust standard deviation of the table from its plane, metres.

    Returns:
        (H, W) True on what rises more than the table's noise does; single pixels are left out.

    Raises:
        InvalidInputError: Nothing does.
    """
    least = max(_LEAST_RISE_M, _ABOVE_NOISE * residual_m)
    with np.errstate(invalid="ignore"):
        high = (rises > least).astype(np.uint8)
    mask = np.asarray(cv2.morphologyEx(high, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)
    if not mask.any():
        raise InvalidInputError(
            "scene", f"nowhere {least * 1000:.0f} mm above the table", "an object on the table"
        )
    return mask


def _tops(rises: Floats, mask: Mask) -> tuple[Floats, float]:
    """(H, W) heights of the objects' pixels, 0 elsewhere, and the part of them that was filled.

    A pixel of the mask without depth gets the height of the nearest pixel that rises; one with the
    table's depth is table.
    """
    with np.errstate(invalid="ignore"):
        known = mask & (rises > LOWEST_M)
    if not known.any():
        if not (mask & np.isfinite(rises)).any():
            raise InvalidInputError("depth_m", "none on the mask", "depth on the object")
        raise InvalidInputError(
            "object",
            f"nowhere {LOWEST_M * 1000:g} mm above the table",
            "an object that stands up from the table; is the mask that of this picture?",
        )
    holes = mask & ~np.isfinite(rises)
    tops = np.where(known, rises, 0.0)
    if holes.any():
        nearest = ndimage.distance_transform_edt(
            ~known, return_distances=False, return_indices=True
        )
        tops[holes] = rises[nearest[0][holes], nearest[1][holes]]
    return tops, float(holes.sum() / mask.sum())


def _draw(
    tops: Floats, camera: Camera, pose: RigidTransform, resolution_m: float
) -> tuple[Floats, Floats]:
    """(R, C) heights of the cells, and the world x, y of the middle of the first."""
    from graspmap.simulation._rebuild_kernel import splat

    rows, columns = np.nonzero(tops)
    window = slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1)
    # The corners of the objects' pixels, at the heights of their pixels, bound the map.
    corners = [
        camera.deproject(np.column_stack([columns + du, rows + dv]), np.ones(len(rows)))
        for du in (-0.5, 0.5)
        for dv in (-0.5, 0.5)
    ]
    rays = np.stack(corners) @ pose.rotation.T
    reach = (tops[rows, columns] - pose.translation[2]) / rays[..., 2]
    places = pose.translation[:2] + rays[..., :2] * reach[..., None]
    first = np.floor(places.min(axis=(0, 1)) / resolution_m)
    last = np.floor(places.max(axis=(0, 1)) / resolution_m)
    width, depth = (last - first + 1).astype(np.int64).tolist()
    if width * depth > MOST_CELLS:
        raise InvalidInputError(
            "size of the objects",
            f"{width * resolution_m:.1f} m x {depth * resolution_m:.1f} m",
            f"at most {MOST_CELLS} cells of {resolution_m:g} m; is the depth in metres?",
        )
    origin = (first + 0.5) * resolution_m
    heights = np.zeros((depth, width))
    focal = (camera.fx, camera.fy, camera.cx - window[1].start, camera.cy - window[0].start)
    view = (focal, pose.rotation, pose.translation, origin, float(resolution_m))
    splat(np.ascontiguousarray(tops[window]), view, heights)
    return _without_pinholes(heights), origin


def _without_pinholes(heights: Floats) -> Floats:
    """Cells that the patches of four pixels left open between them, at a corner."""
    solid = np.pad(heights, 1)
    sides = np.stack([solid[1:-1, :-2], solid[1:-1, 2:], solid[:-2, 1:-1], solid[2:, 1:-1]])
    across = (sides[:2] > 0).all(axis=0) | (sides[2:] > 0).all(axis=0)
    pinhole = (heights == 0) & across & ((sides > 0).sum(axis=0) >= 3)
    least = np.where(sides > 0, sides, np.inf).min(axis=0)
    return np.where(pinhole, least, heights)


def _without_crumbs(heights: Floats, resolution_m: float) -> Floats:
    """Without the parts too small to be anything but noise; the largest part always stays."""
    labels, count = ndimage.label(heights > 0, np.ones((3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=count + 1)
    sizes[0] = 0
    keep = sizes >= min(_LEAST_CELLS_M2 / resolution_m**2, sizes.max())
    keep[0] = False
    return np.where(keep[labels], heights, 0.0)


def _components(heights: Floats) -> list[Floats]:
    """One map for each part that touches no other, in the order of their first cells."""
    labels, count = ndimage.label(heights > 0, np.ones((3, 3)))
    return [np.where(labels == number, heights, 0.0) for number in range(1, count + 1)]
