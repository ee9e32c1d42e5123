"""The plane of the table in a depth picture, and the camera's pose over it.

A plane is linear in the inverse depth: 1 / z = p . (x / z, y / z, 1) for a point (x, y, z) of the
camera's frame, with p the normal divided by the distance. What a picture shows beside the table is
an outlier: many planes through three pixels each are compared, and the best is refined with
weights that fall to zero for what lies off it.

Letters in shapes: H rows, W columns of the picture; N pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.camera import Camera
from graspmap.geometry.transforms import RigidTransform

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEEPEST_RAD = math.radians(60.0)
"""Of the camera's axis against the vertical; beyond it one sees sides, and no tops."""

_MOST_PIXELS = 40_000  # a plane needs no more
_LEAST_PIXELS = 100
_LEAST_SHARE = 0.2  # of the pixels beside the objects that must lie on the table
_PLANES = 300  # through three pixels each; with half of them outliers 1e-17 are left without table
_NEAR_M = 0.006  # from the plane, where planes are compared: depth is quantised up to this
_TUKEY = 4.685  # deviations at which a weight falls to zero
_LEAST_DEVIATION_M, _MOST_DEVIATION_M = 0.0002, 0.01  # of a table's depth from its plane
_ROUNDS = 12
_FAR_FROM_PRIOR_RAD = math.radians(5.0)
_FAR_FROM_PRIOR_M = 0.05


@dataclass(frozen=True, eq=False)
class TablePlane:
    """A fitted table.

    Args:
        T_world_camera: Pose of the camera over it.
        residual_m: Robust standard deviation of the table's pixels from the plane.
        share: Part of the pixels looked at that lies on it.
    """

    T_world_camera: RigidTransform
    residual_m: float
    share: float


def fit_table_plane(
    depth_m: NDArray[np.float32],
    candidates: Mask,
    camera: Camera,
    T_world_camera: RigidTransform | None = None,
) -> TablePlane:
    """The table that most of the candidate pixels lie on.

    Without a pose the world's origin is where the ray through the picture's middle meets the
    table, and its x axis runs along the picture's rows. With one, its x and y stay as they are as
    nearly as the fitted plane allows.

    Args:
        depth_m: (H, W) metres, NaN where there is none.
        candidates: (H, W) pixels that may show the table: those beside the objects.
        camera: Intrinsics.
        T_world_camera: Where the camera is thought to be, or None; the fit starts there.

    Returns:
        The plane; the same input gives the same bits.

    Raises:
        InvalidInputError: Too few candidates have depth, too few of them lie on one plane, the
            plane is steeper than `STEEPEST_RAD`, or it is none that the given pose could be meant
            for.
    """
    points = _sample(depth_m, candidates, camera)
    if T_world_camera is None:
        plane = _best_plane(points)
    else:
        down = -T_world_camera.rotation[2]
        plane = down / float(T_world_camera.translation[2])
    plane, residual, share = _refined(points, plane)
    if share < _LEAST_SHARE:
        raise InvalidInputError(
            "table",
            f"seen in {share:.0%} of the pixels beside the object",
            f"a plane that at least {_LEAST_SHARE:.0%} of them lie on"
            + ("" if T_world_camera is None else "; is T_world_camera that of this picture?"),
        )
    distance = 1.0 / float(np.linalg.norm(plane))
    down = plane * distance
    tilt = math.acos(min(1.0, float(down[2])))
    if tilt > STEEPEST_RAD:
        raise InvalidInputError(
            "tilt of the table",
            f"{math.degrees(tilt):.0f} degrees against the picture",
            f"at most {math.degrees(STEEPEST_RAD):.0f}: look at the table more from above",
        )
    if T_world_camera is None:
        pose = _pose(down, distance, camera)
    else:
        _check_prior(down, distance, T_world_camera)
        pose = _moved(T_world_camera, down, distance)
    return TablePlane(pose, residual, share)


def _sample(depth_m: NDArray[np.float32], candidates: Mask, camera: Camera) -> Floats:
    """(N, 4) of at most `_MOST_PIXELS` pixels: x / z, y / z, 1, and z."""
    rows, columns = np.nonzero(candidates & np.isfinite(depth_m))
    if len(rows) < _LEAST_PIXELS:
        raise InvalidInputError(
            "table",
            f"{len(rows)} pixels with depth beside the object",
            f"at least {_LEAST_PIXELS}, to find the table; take a picture that shows more of it",
        )
    # Evenly over the list, which runs row by row: evenly over the picture.
    chosen = np.linspace(0, len(rows) - 1, min(len(rows), _MOST_PIXELS)).astype(np.int64)
    rows, columns = rows[chosen], columns[chosen]
    return np.column_stack(
        [
            (columns - camera.cx) / camera.fx,
            (rows - camera.cy) / camera.fy,
            np.ones(len(rows)),
            depth_m[rows, columns],
        ]
    ).astype(np.float64)


def _heights(points: Floats, plane: Floats) -> Floats:
    """(N,) heights above a plane, metres."""
    return np.asarray((1.0 - points[:, 3] * (points[:, :3] @ plane)) / np.linalg.norm(plane))


def _best_plane(points: Floats) -> Floats:
    """The plane through three pixels that lies nearest to all; far pixels count alike."""
    rng = np.random.default_rng(0)  # of no consequence beyond being the same each time
    triples = points[rng.integers(len(points), size=(_PLANES, 3))]
    good = np.abs(np.linalg.det(triples[:, :, :3])) > 1e-9
    if not good.any():
        raise InvalidInputError("table", "pixels on one line", "pixels that span a plane")
    planes = np.linalg.solve(triples[good, :, :3], 1.0 / triples[good, :, 3:])[:, :, 0]
    some = points[:: max(1, len(points) // 4000)]
    lengths = np.linalg.norm(planes, axis=1)
    heights = (1.0 - (some[:, :3] @ planes.T) * some[:, 3:]) / lengths
    cost = np.minimum((heights / _NEAR_M) ** 2, 1.0).mean(axis=0)
    # A plane that faces away from the camera, or passes through it, is no table.
    cost[planes[:, 2] <= 0] = np.inf
    return np.asarray(planes[int(np.argmin(cost))], dtype=np.float64)


def _refined(points: Floats, plane: Floats) -> tuple[Floats, float, float]:
    """Reweighted least squares (Tukey); plane, deviation of what lies on it, and its share."""
    rays, z = points[:, :3], points[:, 3]
    near = _NEAR_M
    for _ in range(_ROUNDS):
        heights = _heights(points, plane)
        weight = np.clip(1.0 - (heights / (_TUKEY * near)) ** 2, 0.0, None) ** 2
        if np.count_nonzero(weight) < _LEAST_PIXELS / 2:
            return plane, near, 0.0
        # A residual of the inverse depth times z^2 is one of the depth.
        scaled = (weight * z * z)[:, None] * rays
        plane = np.asarray(np.linalg.solve(scaled.T @ (rays * (z * z)[:, None]), scaled.T @ z))
        on_it = np.abs(heights[weight > 0])
        near = 1.4826 * float(np.median(on_it))
        near = min(max(near, _LEAST_DEVIATION_M), _MOST_DEVIATION_M)
    heights = _heights(points, plane)
    on_it = np.abs(heights) < _TUKEY * near
    residual = 1.4826 * float(np.median(np.abs(heights[on_it]))) if on_it.any() else near
    return plane, residual, float(on_it.mean())


def _pose(down: Floats, distance: float, camera: Camera) -> RigidTransform:
    """Pose whose origin the middle of the picture shows, x along its rows."""
    x = np.array([1.0, 0.0, 0.0]) - down[0] * down
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(-down, x), -down])
    middle = camera.deproject([(camera.width - 1) / 2, (camera.height - 1) / 2], 1.0)
    slope = float(middle @ down)
    if slope <= 0.05:
        raise InvalidInputError(
            "table", "not where the picture's middle looks", "a picture whose middle shows it"
        )
    return RigidTransform(rotation, -rotation @ (middle * (distance / slope)))


def _moved(pose: RigidTransform, down: Floats, distance: float) -> RigidTransform:
    """``pose`` turned the shortest way and shifted along z until the table is z = 0."""
    x = pose.rotation[0] - (pose.rotation[0] @ down) * down
    x /= np.linalg.norm(x)
    rotation = np.array([x, np.cross(-down, x), -down])
    # The point of the old table that lies under the camera's axis keeps its x and y.
    axis = np.array([0.0, 0.0, 1.0])
    old = axis * float(-pose.translation[2] / pose.rotation[2, 2])
    new = axis * (distance / float(down[2]))
    shift = pose.apply(old)
    return RigidTransform(rotation, np.array([shift[0], shift[1], 0.0]) - rotation @ new)


def _check_prior(down: Floats, distance: float, pose: RigidTransform) -> None:
    turn = math.acos(min(1.0, float(-pose.rotation[2] @ down)))
    away = abs(distance - float(pose.translation[2]))
    if turn > _FAR_FROM_PRIOR_RAD or away > _FAR_FROM_PRIOR_M:
        raise InvalidInputError(
            "T_world_camera",
            f"{math.degrees(turn):.1f} degrees and {away * 100:.1f} cm off the table that is seen",
            "the pose of this picture over its table; give none to have it found",
        )
