"""TableGrasps: grasps from above, in metres on the table, and their way to and from pixels.

World frame: the table is the plane z = 0, z up, metres. Letters in shapes: N grasps, (H, W) depth.

The ends of an opening lie on one line of the picture, and their rays cross a level plane on one
line of the world. With s pixels along the first and t metres along the second, both counted from
the centre, t = g s / (1 + e s), where g is the scale at the centre and e how quickly the rays along
the opening tilt. An opening of w pixels is therefore g w / (1 - (e w / 2)^2) metres wide, and both
directions have a closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry._check import numbers
from graspmap.geometry._rows import Rows, checked_grasps
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps, wrap_angle
from graspmap.geometry.transforms import RigidTransform

Floats = NDArray[np.float64]

HOLE_REACH_PX = 5
"""How far from a pixel without depth its neighbours are asked."""


@dataclass(frozen=True, eq=False)
class TableGrasps(Rows):
    """N grasps of a gripper that comes straight down.

    The fields mean what they mean in `Grasps`, in metres instead of pixels.

    Args:
        center_m: (N, 2) world x, y between the jaws.
        angle: (N,) radians, of the opening, counter-clockwise seen from above from the world's x
            axis; stored in [-pi/2, pi/2).
        width_m: (N,) opening, >= 0.
        height_m: (N,) jaw size, >= 0.
        quality: (N,) score, finite; 1 where none is given.

    Raises:
        InvalidInputError: A shape is wrong, a number is not finite, a size is negative.
    """

    center_m: Floats
    angle: Floats
    width_m: Floats
    height_m: Floats
    quality: Floats = field(default=None)  # type: ignore[arg-type]  # filled in below

    _fields: ClassVar[tuple[str, ...]] = ("center_m", "angle", "width_m", "height_m", "quality")

    def __post_init__(self) -> None:
        arrays = checked_grasps(self._fields, self._columns(), "metres")
        arrays[1] = wrap_angle(arrays[1])
        self._keep(arrays)

    def axis(self) -> Floats:
        """(N, 2) unit vectors along the opening, world x, y."""
        return np.stack([np.cos(self.angle), np.sin(self.angle)], axis=-1)

    @classmethod
    def from_pixels(
        cls,
        grasps: Grasps,
        depth_m: ArrayLike,
        camera: Camera,
        T_world_camera: RigidTransform,
    ) -> TableGrasps:
        """Where grasps of a picture are, at the height that is seen at their centres.

        The centre is deprojected with the depth at its pixel; the ends of the opening are where
        their rays cross the plane at that height; the jaw is height_px * z / f with the depth z of
        the centre (as Jacquard's labels have it).

        Args:
            grasps: N grasps in pixels.
            depth_m: (H, W) metres along the camera's z axis, NaN where there is none.
            camera: Intrinsics of the picture.
            T_world_camera: Where the camera is.

        Raises:
            InvalidInputError: The depth has another size than the camera's picture, the camera is
                not above the table, or an end of an opening is at or above the horizon.
        """
        depth, rays = surface_depth(grasps.center, depth_m, camera, T_world_camera)
        point = T_world_camera.apply(rays * depth[:, None])
        # How the ray changes with a step of one pixel along the opening, in the world.
        step = grasps.axis() / (camera.fx, camera.fy)
        turn = step @ T_world_camera.rotation[:, :2].T
        ray = rays @ T_world_camera.rotation.T
        tilt = turn[:, 2] / ray[:, 2]
        reach = tilt * grasps.width / 2
        if (np.abs(reach) >= 1).any():
            first = int(np.argmax(np.abs(reach) >= 1))
            raise _horizon(grasps.center[first])
        scale = depth[:, None] * (turn - ray * tilt[:, None])[:, :2]
        return cls(
            center_m=point[:, :2],
            angle=np.arctan2(scale[:, 1], scale[:, 0]),
            width_m=np.hypot(scale[:, 0], scale[:, 1]) * grasps.width / (1 - reach**2),
            height_m=grasps.height * depth * pixel_across(grasps, camera),
            quality=grasps.quality,
        )

    def to_pixels(
        self, surface_m: ArrayLike, camera: Camera, T_world_camera: RigidTransform
    ) -> Grasps:
        """The inverse of `from_pixels`, given the heights that are seen at the centres.

        Args:
            surface_m: (N,) heights above the table; one number serves all.
            camera: Intrinsics of the picture.
            T_world_camera: Where the camera is.

        Raises:
            InvalidInputError: There are not N finite heights, or a centre is not in front of the
                camera, or not below it.
        """
        height = numbers("surface_m", surface_m)
        if height.shape not in ((), (len(self),)) or not np.isfinite(height).all():
            raise InvalidInputError("surface_m", f"shape {height.shape}", f"({len(self)},) metres")
        height = np.broadcast_to(height, (len(self),))
        eye = T_world_camera.translation
        point = (np.column_stack([self.center_m, height]) - eye) @ T_world_camera.rotation
        low = (point[:, 2] <= 0) | (height >= eye[2])
        if low.any():
            raise InvalidInputError(
                "center of a grasp",
                self.center_m[low][0].tolist(),
                "in front of the camera and lower than it",
            )
        along = self.axis() @ T_world_camera.rotation[:2]
        depth = point[:, 2]
        tilt = along[:, 2] / depth
        # Pixels that the point moves with a step of one metre along the opening.
        focal = np.array([camera.fx, camera.fy])
        step = (along[:, :2] - point[:, :2] * tilt[:, None]) / depth[:, None] * focal
        scale = np.hypot(step[:, 0], step[:, 1])
        width = 2 * scale * self.width_m / (1 + np.sqrt(1 + (tilt * self.width_m) ** 2))
        grasps = Grasps(
            center=camera.project(point).reshape(-1, 2),
            angle=np.arctan2(-step[:, 1], step[:, 0]),
            width=width,
            height=np.zeros(len(self)),
            quality=self.quality,
        )
        return grasps.replace(height=self.height_m / (depth * pixel_across(grasps, camera)))

    def __repr__(self) -> str:
        if len(self) != 1:
            return f"TableGrasps({len(self)})"
        return (
            f"TableGrasps(x={self.center_m[0, 0]:.4f}, y={self.center_m[0, 1]:.4f}, "
            f"angle={np.degrees(self.angle[0]):.1f} deg, width_m={self.width_m[0]:.4f}, "
            f"height_m={self.height_m[0]:.4f}, quality={self.quality[0]:.3f})"
        )


def surface_depth(
    pixels: Floats, depth_m: ArrayLike, camera: Camera, T_world_camera: RigidTransform
) -> tuple[Floats, Floats]:
    """Depth that a picture shows at points of it: at their pixel, near it, or the table's.

    Where the pixel has no depth, the median of the smallest square about it that has any is taken
    (up to `HOLE_REACH_PX` away); then, and outside the picture, and where the depth lies below the
    table, the depth at which the ray meets the table.

    Args:
        pixels: (N, 2) points x, y.
        depth_m: (H, W) metres along the camera's z axis, NaN where there is none.
        camera: Intrinsics of the picture.
        T_world_camera: Where the camera is.

    Returns:
        Depths (N,), and the rays through the points at depth 1, (N, 3) camera coordinates.

    Raises:
        InvalidInputError: The depth has another size than the camera's picture, the camera is not
            above the table, or a point is at or above the horizon.
    """
    depth = np.asarray(depth_m)
    if depth.shape != (camera.height, camera.width):
        raise InvalidInputError(
            "shape of depth_m", depth.shape, f"{(camera.height, camera.width)}, the camera's"
        )
    above = float(T_world_camera.translation[2])
    if above <= 0:
        raise InvalidInputError("height of the camera", above, "metres above the table, z > 0")
    rays = camera.deproject(pixels.reshape(-1, 2), np.ones(len(pixels)))
    fall = rays @ T_world_camera.rotation[2]
    if (fall >= 0).any():
        raise _horizon(pixels[int(np.argmax(fall >= 0))])
    table = -above / fall
    seen = _nearest_depth(depth, pixels)
    # fmin: NaN, where nothing is seen, gives way to the table.
    return np.fmin(seen, table), rays


def _nearest_depth(depth: NDArray[np.floating], pixels: Floats) -> Floats:
    """(N,) depth at points, from their neighbourhood where their pixel has none, else NaN."""
    rows, columns = depth.shape
    # Beyond the picture by more than a neighbourhood is as good as far beyond.
    nearest = np.clip(np.floor(pixels + 0.5), -1, (columns, rows)).astype(np.int64)
    column, row = nearest[:, 0], nearest[:, 1]
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    out = np.full(len(pixels), np.nan)
    out[inside] = depth[row[inside], column[inside]]
    out[~(np.isfinite(out) & (out > 0))] = np.nan
    for i in np.flatnonzero(inside & np.isnan(out)):
        r, c = int(row[i]), int(column[i])
        for reach in range(1, HOLE_REACH_PX + 1):
            patch = depth[max(r - reach, 0) : r + reach + 1, max(c - reach, 0) : c + reach + 1]
            valid = patch[np.isfinite(patch) & (patch > 0)]
            if valid.size:
                out[i] = np.median(valid)
                break
    return out


def pixel_along(grasps: Grasps, camera: Camera) -> Floats:
    """(N,) metres at depth 1 of a pixel along the opening; 1 / f for square pixels."""
    axis = grasps.axis()
    return np.hypot(axis[:, 0] / camera.fx, axis[:, 1] / camera.fy)


def pixel_across(grasps: Grasps, camera: Camera) -> Floats:
    """(N,) metres at depth 1 of a pixel across the opening, along the jaw."""
    axis = grasps.axis()
    return np.hypot(axis[:, 1] / camera.fx, axis[:, 0] / camera.fy)


def _horizon(pixel: Floats) -> InvalidInputError:
    return InvalidInputError(
        "grasp",
        f"at pixel ({pixel[0]:.1f}, {pixel[1]:.1f}), where a ray of it misses the table",
        "grasps below the horizon of the camera",
    )
