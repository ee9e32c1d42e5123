"""What one can do without learning: grasps from the outline of the object in a depth picture.

The object is what rises from the table plane; no mask and no camera is needed. A trained network
has to beat these.

Letters in shapes: H rows, W columns of the picture; P pixels of the object; E points of its edge;
N grasps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from graspmap.data.scene import Depth, Mask, Rgb
from graspmap.errors import InvalidInputError
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.gripper import Gripper
from graspmap.inference.locate import fitted, locate
from graspmap.simulation.rebuild import risen
from graspmap.simulation.table_plane import fit_table_plane

Floats = NDArray[np.float64]

_SPARE = 1.25  # opening over the width of what is grasped
_BAND = 0.12  # of the length: the slice about the middle whose width is grasped
_EDGE_POINTS = 240
_NORMAL_PX = 0.008  # of the picture's side: blur of the outline that its normals are taken from
_CONE = math.atan(0.5)  # rad; friction of rubber on most things is more
_APART = 0.05  # of the picture's side, between the centres of two grasps


@dataclass(frozen=True, eq=False)
class ShapeDetection:
    """What a baseline found.

    Attributes:
        grasps: N grasps, pixels of the picture, best first; none where no object was seen.
    """

    grasps: Grasps


class MomentsGrasp:
    """Grasps across the short axis of the object's outline, at its centroid (image moments)."""

    def detect(
        self,
        rgb: Rgb | None = None,  # noqa: ARG002  # so that it stands in for any detector
        depth: Depth | None = None,
        *,
        top: int = 1,  # noqa: ARG002  # it has one grasp, whatever is asked for
        **options: Any,  # noqa: ARG002
    ) -> ShapeDetection:
        """One grasp.

        Args:
            rgb: Not looked at.
            depth: (H, W) metres, NaN where there is none.
            top: Not looked at.
            options: Not looked at.

        Raises:
            InvalidInputError: There is no depth.
        """
        mask = object_mask(_needed(depth))
        if not mask.any():
            return ShapeDetection(Grasps.empty())
        points = np.argwhere(mask)[:, ::-1].astype(np.float64)
        middle = points.mean(axis=0)
        _, axes = np.linalg.eigh(np.cov((points - middle).T) + 1e-9 * np.eye(2))
        short, long = axes.T
        across, along = (points - middle) @ short, (points - middle) @ long
        slice_ = across[np.abs(along) <= max(1.0, _BAND * np.ptp(along))]
        width = float(np.ptp(slice_)) + 1
        center = middle + short * (slice_.max() + slice_.min()) / 2
        return ShapeDetection(_grasps(center[None], short[None], np.array([width]), np.ones(1)))


class AntipodalGrasp:
    """Grasps between two points of the object's outline that face each other.

    Of all pairs whose line lies in both friction cones, the best has its normals nearest to that
    line and its middle nearest to the object's; its quality says how near.
    """

    def detect(
        self,
        rgb: Rgb | None = None,  # noqa: ARG002  # so that it stands in for any detector
        depth: Depth | None = None,
        *,
        camera: Camera | None = None,
        gripper: Gripper | None = None,
        top: int = 1,
        **options: Any,  # noqa: ARG002
    ) -> ShapeDetection:
        """The best pairs.

        Args:
            rgb: Not looked at.
            depth: (H, W) metres, NaN where there is none.
            camera: Intrinsics, where a gripper is given.
            gripper: Leaves out pairs that it cannot open for.
            top: How many grasps at most.
            options: Not looked at.

        Raises:
            InvalidInputError: There is no depth.
        """
        depth = _needed(depth)
        mask = object_mask(depth)
        outline = _outline(mask)
        first, second, quality = _facing(outline, mask)
        order = np.argsort(-quality, kind="stable")
        start, end = outline.points[first[order]], outline.points[second[order]]
        way = end - start
        length = np.linalg.norm(way, axis=1)
        grasps = _grasps((start + end) / 2, way / length[:, None], length + 1, quality[order])
        if camera is not None and gripper is not None and len(grasps):
            position_m, width_m = locate(grasps, depth, camera)
            _, grasps, _ = fitted(grasps, width_m, position_m[:, 2], camera, gripper)
        return ShapeDetection(_spread(grasps, top, _APART * max(mask.shape)))


def object_mask(depth: Depth) -> Mask:
    """The largest thing that rises from the table.

    Args:
        depth: (H, W) metres, NaN where there is none.

    Returns:
        (H, W) True on it; all False where no table or nothing on it is seen.
    """
    rows, columns = depth.shape
    # Inverse depth is linear over the picture whatever the lens: any intrinsics find the plane.
    camera = Camera(columns, columns, (columns - 1) / 2, (rows - 1) / 2, columns, rows)
    try:
        table = fit_table_plane(depth, np.isfinite(depth), camera)
        down, distance = -table.T_world_camera.rotation[2], table.T_world_camera.translation[2]
        x, y = np.arange(columns) - camera.cx, (np.arange(rows) - camera.cy)[:, None]
        plane = distance / (down[0] * x / camera.fx + down[1] * y / camera.fy + down[2])
        above = risen(plane - depth, table.residual_m)
    except InvalidInputError:
        return np.zeros(depth.shape, dtype=bool)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(above.astype(np.uint8), connectivity=8)
    return np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def _needed(depth: Depth | None) -> Depth:
    if depth is None:
        raise InvalidInputError("depth", "missing", "a depth picture: the baseline sees no colour")
    return depth


@dataclass(frozen=True, eq=False)
class _Outline:
    """Edge of an object, holes included.

    Attributes:
        points: (E, 2) pixels, x and y.
        normals: (E, 2) outward, of length 1.
        flat: (E,) 1 on straight parts, less at corners, where a finger has no hold.
    """

    points: Floats
    normals: Floats
    flat: Floats


def _outline(mask: Mask) -> _Outline:
    sigma = max(1.0, _NORMAL_PX * max(mask.shape))
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), sigma)
    slope = np.stack([np.gradient(soft, axis=1), np.gradient(soft, axis=0)], axis=-1)
    found, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    parts = [_part(contour[:, 0], -slope, 3 * sigma) for contour in found]
    points, normals, flat = (
        (np.concatenate(columns) for columns in zip(*parts, strict=True))
        if parts
        else (np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    )
    chosen = np.linspace(0, len(points) - 1, min(_EDGE_POINTS, len(points))).round().astype(int)
    return _Outline(points[chosen], normals[chosen], flat[chosen])


def _part(
    points: NDArray[Any], outward: NDArray[Any], reach: float
) -> tuple[Floats, Floats, Floats]:
    """Points, normals and flatness along one closed contour."""
    normals = outward[points[:, 1], points[:, 0]].astype(np.float64)
    length = np.linalg.norm(normals, axis=1)
    sound = length > 1e-6
    points, normals = points[sound], normals[sound] / length[sound, None]
    # A mean of unit vectors is the shorter, the more they turn.
    mean = uniform_filter1d(normals, max(1, round(2 * reach)), axis=0, mode="wrap")
    return points.astype(np.float64), normals, np.linalg.norm(mean, axis=1)


def _facing(outline: _Outline, mask: Mask) -> tuple[NDArray[np.intp], NDArray[np.intp], Floats]:
    """Pairs of edge points in each other's friction cones, and their quality in [0, 1]."""
    points, normals = outline.points, outline.normals
    i, j = np.triu_indices(len(points), k=1)
    way = points[j] - points[i]
    length = np.linalg.norm(way, axis=1)
    good = length >= 2
    i, j, way = i[good], j[good], way[good] / length[good, None]
    turn = np.minimum(-(normals[i] * way).sum(axis=1), (normals[j] * way).sum(axis=1))
    middle = (points[i] + points[j]) / 2
    x, y = middle.round().astype(int).T
    good = (turn >= math.cos(_CONE)) & mask[y, x]  # the line runs through the object
    i, j, turn, middle = i[good], j[good], turn[good], middle[good]
    inside = np.argwhere(mask)[:, ::-1]
    size = max(1.0, float(inside.std(axis=0).max())) if len(inside) else 1.0
    center = inside.mean(axis=0) if len(inside) else np.zeros(2)
    away = np.linalg.norm(middle - center, axis=1) / size
    straight = 1 - np.arccos(np.clip(turn, -1, 1)) / _CONE
    flat = np.minimum(outline.flat[i], outline.flat[j])
    return i, j, straight * flat * np.exp(-(away**2))


def _spread(grasps: Grasps, top: int, apart_px: float) -> Grasps:
    """The first grasps whose centres are some way apart."""
    chosen: list[int] = []
    for index, center in enumerate(grasps.center):
        if len(chosen) == top:
            break
        far = np.linalg.norm(grasps.center[chosen] - center, axis=1) >= apart_px
        if far.all():
            chosen.append(index)
    return grasps[np.array(chosen, dtype=np.intp)]


def _grasps(center: Floats, axis: Floats, width: Floats, quality: Floats) -> Grasps:
    """Grasps along axes (x, y down), open a little wider than what they grasp."""
    opening = _SPARE * width
    angle = np.arctan2(-axis[:, 1], axis[:, 0])
    return Grasps(center, angle, opening, opening / 2, quality)
