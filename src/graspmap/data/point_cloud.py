"""Organised point clouds of the Cornell Grasping Dataset, and the depth pictures in them.

A file is an ASCII PCD: a header, then a line ``x y z rgb index`` for each point, millimetres;
the point is seen at row index // W, column index % W of the picture (W = 640 columns).

The points are NOT in the camera's frame: they are relative to the base of the robot that held the
camera, z up, so a point's own z is its height and sqrt(x2 + y2 + z2) the distance from the
robot's base. As each point comes with its pixel, the camera can be found from the file itself
(`camera_depth`), which gives the depth along the camera's axis.

Letters in shapes: N points, H rows, W columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graspmap.data.scene import Depth
from graspmap.errors import FileFormatError
from graspmap.files import read_bytes

Floats = NDArray[np.float64]

_FIELDS = ["x", "y", "z", "rgb", "index"]
_REPLACE = "replace it with a good copy"
_USE_RANGE = 'read the data with depth="range", or give a depth picture'
# The camera is overdetermined by 20,000 points already.
_POINTS_USED = 20_000
# Misfit of the pinhole camera, pixels, above which points and pixels do not belong together.
_WORST_FIT_PX = 2.0


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points and the pixels at which they are seen.

    Attributes:
        path: The file it came from.
        points: (N, 3) metres, in the frame of the file, finite.
        rows: (N,) rows of their pixels.
        columns: (N,) columns of their pixels.
        shape: (H, W) of the picture.
    """

    path: Path
    points: Floats
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    shape: tuple[int, int]

    def image(self, values: Floats) -> Depth:
        """(H, W) float32 picture of one value (N,) for each point, NaN where there is none."""
        image = np.full(self.shape, np.nan, dtype=np.float32)
        image[self.rows, self.columns] = values
        return image


def read_point_cloud(path: Path, shape: tuple[int, int]) -> PointCloud:
    """Read an organised ASCII PCD; points that are NaN are left out.

    Args:
        path: The file.
        shape: (H, W) of the picture that its index column refers to.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is empty, truncated, binary, damaged (the error names the line), lacks
            the index column, or has points outside the picture.
    """
    lines = read_bytes(path).decode("latin-1").splitlines()
    start, fields, expected = _read_header(path, lines)
    body = [line for line in lines[start:] if line.strip()]
    if expected is not None and len(body) < expected:
        raise FileFormatError(
            path, f"has {len(body)} of the {expected} points it announces", _REPLACE
        )
    columns = tuple(fields.index(name) for name in ("x", "y", "z", "index"))
    try:
        # max_rows: some writers leave lines after the announced end.
        table = np.loadtxt(body, usecols=columns, max_rows=expected, comments=None, ndmin=2)
    except ValueError as error:
        raise _line_error(path, lines, start, len(fields)) from error
    table = table[np.isfinite(table).all(axis=1)]
    index = table[:, 3].astype(np.int64)
    height, width = shape
    if not len(index) or index.min() < 0 or index.max() >= height * width:
        found = f"indices up to {index.max()}" if len(index) else "no points"
        raise FileFormatError(
            path,
            f"has {found}, its picture {height * width} pixels",
            "keep cloud and picture whole",
        )
    return PointCloud(path, table[:, :3] / 1000, index // width, index % width, shape)


def origin_distance(cloud: PointCloud) -> Depth:
    """(H, W) metres from the origin of the file's frame, as the GG-CNN code makes its pictures."""
    return cloud.image(np.linalg.norm(cloud.points, axis=1))


def camera_depth(cloud: PointCloud) -> Depth:
    """(H, W) metres along the axis of the camera that saw the points at their pixels.

    The frame of the points does not matter. Points that are in the camera's frame already keep
    their z; otherwise the camera is found from the pairs of point and pixel.

    Raises:
        FileFormatError: No camera sees the points at these pixels, or all lie in one plane, in a
            foreign frame, so that the camera cannot be found.
    """
    if _in_camera_frame(cloud):
        return cloud.image(cloud.points[:, 2])
    step = max(1, len(cloud.points) // _POINTS_USED)
    pixels = np.column_stack([cloud.columns, cloud.rows]).astype(np.float64)
    projection = _find_projection(cloud.path, cloud.points[::step], pixels[::step])
    seen = np.column_stack([cloud.points, np.ones(len(cloud.points))]) @ projection.T
    depth_m = seen[:, 2]
    misfit = seen[:, :2] / depth_m[:, None] - pixels
    error_px = float(np.sqrt(np.mean(np.sum(misfit**2, axis=1))))
    if not error_px < _WORST_FIT_PX or (depth_m <= 0).any():
        raise FileFormatError(
            cloud.path,
            f"no camera sees its points at their pixels (the best misses by {error_px:.1f} px)",
            _USE_RANGE,
        )
    return cloud.image(depth_m)


def _in_camera_frame(cloud: PointCloud) -> bool:
    x, y, z = cloud.points.T
    if (z <= 0).any() or len(z) < 3:
        return False
    # u = fx x / z + cx, v = fy y / z + cy, with focal lengths above 0.
    for ratio, pixel in ((x / z, cloud.columns), (y / z, cloud.rows)):
        design = np.column_stack([ratio, np.ones(len(ratio))])
        fit, *_ = np.linalg.lstsq(design, pixel.astype(np.float64), rcond=None)
        misfit = design @ fit - pixel
        if fit[0] <= 0 or float(np.sqrt(np.mean(misfit**2))) > _WORST_FIT_PX:
            return False
    return True


def _find_projection(path: Path, points: Floats, pixels: Floats) -> Floats:
    """(3, 4) projection matrix by the direct linear transform, scaled so that row 3 gives metres.

    References:
        R. Hartley, A. Zisserman: Multiple View Geometry, 2nd ed., algorithm 7.1 (linear part).
    """
    normal_3d, normal_2d = _normalisation(points), _normalisation(pixels)
    x = np.column_stack([points, np.ones(len(points))]) @ normal_3d.T
    u, v, _ = (np.column_stack([pixels, np.ones(len(pixels))]) @ normal_2d.T).T
    zero = np.zeros_like(x)
    design = np.vstack(
        [np.hstack([x, zero, -u[:, None] * x]), np.hstack([zero, x, -v[:, None] * x])]
    )
    # The triangular factor has the singular values of the tall matrix.
    _, singular, right = np.linalg.svd(np.linalg.qr(design, mode="r"))
    if len(points) < 6 or singular[-2] < 1e-4 * singular[0]:
        raise FileFormatError(
            path, "all points lie in one plane, so the camera cannot be found", _USE_RANGE
        )
    projection = np.linalg.inv(normal_2d) @ right[-1].reshape(3, 4) @ normal_3d
    projection = projection / np.linalg.norm(projection[2, :3])
    middle = projection[2] @ np.append(points.mean(axis=0), 1.0)
    return np.asarray(projection * np.sign(middle))


def _normalisation(points: Floats) -> Floats:
    """(d+1, d+1) similarity that moves the mean to 0 and the mean distance to sqrt(d)."""
    dimensions = points.shape[1]
    mean = points.mean(axis=0)
    spread = np.linalg.norm(points - mean, axis=1).mean() / np.sqrt(dimensions)
    matrix = np.eye(dimensions + 1)
    matrix[:-1, -1] = -mean
    matrix[:-1] /= max(spread, np.finfo(np.float64).tiny)
    return matrix


def _read_header(path: Path, lines: list[str]) -> tuple[int, list[str], int | None]:
    """Number of header lines, names of the fields, announced number of points (None: unsaid)."""
    fields, expected = _FIELDS, None
    for number, line in enumerate(lines):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        match words[0].upper():
            case "FIELDS":
                fields = [word.lower() for word in words[1:]]
            case "POINTS":
                expected = _count(path, number + 1, line)
            case "DATA":
                if words[1:] != ["ascii"]:
                    raise FileFormatError(path, "is a binary point cloud", "save it as ASCII")
                if missing := {"x", "y", "z", "index"} - set(fields):
                    raise FileFormatError(
                        path, f"lacks the column {sorted(missing)[0]!r}", "organise it by an index"
                    )
                return number + 1, fields, expected
            case "VERSION" | "SIZE" | "TYPE" | "COUNT" | "WIDTH" | "HEIGHT" | "VIEWPOINT":
                pass
            case _:
                raise FileFormatError(
                    path, f"line {number + 1} is no line of a PCD header: {line[:60]!r}", _REPLACE
                )
    raise FileFormatError(path, "has no line 'DATA ascii'", _REPLACE)


def _count(path: Path, number: int, line: str) -> int:
    words = line.split()
    if len(words) != 2 or not words[1].isdecimal():
        raise FileFormatError(path, f"line {number} is {line!r}", "write POINTS and a number")
    return int(words[1])


def _line_error(path: Path, lines: list[str], start: int, fields: int) -> FileFormatError:
    """The error that names the first line which is not ``fields`` numbers."""
    for number, line in enumerate(lines[start:], start=start + 1):
        words = line.split()
        try:
            good = not words or (len(words) == fields and bool(list(map(float, words))))
        except ValueError:
            good = False
        if not good:
            return FileFormatError(
                path, f"line {number} is not {fields} numbers: {line[:60]!r}", _REPLACE
            )
    return FileFormatError(path, "is no point cloud", _REPLACE)
