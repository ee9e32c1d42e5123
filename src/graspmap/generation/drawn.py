"""Drawn scenes: simple RGB-D pictures of objects on a table, with exact grasps.

Made for demonstrations and tests: any number of scenes in a moment, without a simulator. The
camera is Jacquard's and looks at the table from above; the picture is a parallel projection (no
side faces, nothing larger for being nearer), the grasps follow from the shapes alone.

Letters in shapes: S the side of the picture, pixels.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from graspmap.data.jacquard import FIELD_OF_VIEW_RAD, write_jacquard
from graspmap.data.scene import Depth, Scene
from graspmap.errors import FileError, FileFormatError, InvalidInputError, storage_errors
from graspmap.generation.shapes import Shape, random_shape
from graspmap.geometry import affine
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps

Floats = NDArray[np.float64]
Pixels = NDArray[np.float32]
Progress = Callable[[int, int], None]

_DISTANCE_M = (1.35, 1.6)  # from camera to table, along the axis
_TILT = math.radians(10.0)  # Jacquard's camera
_HIGHEST_M = 0.16  # no shape is higher
_LEAST_SIZE = 48  # below this the smallest jaw is under half a pixel
_SETTINGS = "drawn.json"
_TRIES = 200  # for a free place of one object


def draw_scene(
    rng: np.random.Generator,
    *,
    size: int = 320,
    shapes: Sequence[Shape] | None = None,
    id: str = "0_drawn",
    object_id: str | None = None,
) -> Scene:
    """One drawn scene.

    Args:
        rng: Source of everything random.
        size: Side of the picture, pixels.
        shapes: The objects on the table; one random one where none are given. Objects for which
            there is no free place are left out, the first never.
        id: Name of the scene.
        object_id: Name of its object or objects.

    Returns:
        Colour, depth without errors, mask, camera, and all grasps that hold, in pixels.

    Raises:
        InvalidInputError: The picture is too small.
    """
    if size < _LEAST_SIZE:
        raise InvalidInputError("size of a drawn scene", size, f"{_LEAST_SIZE} pixels or more")
    camera = Camera.from_field_of_view(FIELD_OF_VIEW_RAD, size, size)
    distance = rng.uniform(*_DISTANCE_M)
    px_per_m = camera.fx / distance
    if shapes is None:
        shapes = [random_shape(rng)]
    placed = _place(rng, shapes, size, px_per_m)
    light = _light(rng)
    picture = _Picture(
        _table(rng, size), np.zeros((size, size), np.float32), np.zeros((size, size), np.bool_)
    )
    for shape, pose in placed:
        _put(rng, picture, shape, pose, light)
    noise = rng.standard_normal(picture.rgb.shape, np.float32)
    rgb = picture.rgb + noise * np.float32(rng.uniform(0.003, 0.02))
    depth = _plane(rng, size, px_per_m) + distance - picture.height_m
    return Scene(
        id=id,
        rgb=np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8),
        depth=depth.astype(np.float32),
        mask=picture.mask,
        grasps=Grasps.concatenate(shape.grasps.transformed(pose) for shape, pose in placed),
        camera=camera,
        object_id=object_id,
    )


def write_drawn(
    root: Path | str,
    scenes: int,
    seed: int = 0,
    *,
    size: int = 320,
    views: int = 5,
    objects: int = 1,
    progress: Progress | None = None,
) -> None:
    """Write drawn scenes in Jacquard's layout; the same arguments give the same files.

    Each object (or set of objects) is shown in several scenes. The perfect depth is exact, the
    stereo depth has noise, steps and holes. Run again after an interruption, it goes on.

    Args:
        root: Folder; it must be new, empty, or made with the same arguments (fewer scenes at most).
        scenes: How many.
        seed: Scene i draws from (seed, i), its object from (seed, i // views).
        size: Side of the pictures, pixels.
        views: Scenes of one object.
        objects: Objects on the table.
        progress: Called with the number of scenes done and of all.

    Raises:
        InvalidInputError: A number is out of range.
        FileError: The folder holds something else.
        StorageFullError: The disk is full.
    """
    for name, value in (("scenes", scenes), ("views", views), ("objects", objects)):
        if value < 1:
            raise InvalidInputError(name, value, "1 or more")
    if seed < 0:
        raise InvalidInputError("seed", seed, "0 or more")
    root = Path(root)
    _claim(root, {"seed": seed, "size": size, "views": views, "objects": objects})
    for i in range(scenes):
        shape_rng = np.random.default_rng([seed, 0, i // views])
        shapes = [random_shape(shape_rng) for _ in range(objects)]
        kind = shapes[0].name if objects == 1 else "several"
        name = f"{kind}-{i // views:04d}"
        scene_id = f"{i % views}_{name}"
        # The writer makes the colour picture last, so where it is, the scene is whole.
        if not (root / name / f"{scene_id}_RGB.png").exists():
            rng = np.random.default_rng([seed, 1, i])
            scene = draw_scene(rng, size=size, shapes=shapes, id=scene_id, object_id=name)
            write_jacquard(scene, root, stereo_depth=sensor_depth(rng, scene))
        if progress is not None:
            progress(i + 1, scenes)


def sensor_depth(rng: np.random.Generator, scene: Scene) -> Depth:
    """(S, S) float32 metres as a depth camera might see a drawn scene, NaN in its holes.

    Noise of 1 mm, steps of a disparity, holes beside high edges (what one of two eyes cannot see)
    and some specks.
    """
    if scene.depth is None or scene.camera is None:
        raise InvalidInputError(f"scene {scene.id}", "without depth or camera", "both")
    depth = scene.depth + rng.normal(0, 0.001, scene.shape)
    disparity = 50 * scene.camera.fx / depth  # baseline 5 cm, in thousandths of a pixel
    step = disparity.mean() / 400
    depth = 50 * scene.camera.fx / (np.round(disparity / step) * step)
    reach = max(1, scene.shape[1] // 100)
    near = cv2.erode(scene.depth, np.ones((1, reach + 1)), anchor=(reach, 0))
    hidden = scene.depth - near > 0.01
    specks = rng.random(scene.shape) < 0.0005
    depth[hidden | specks] = np.nan
    return np.asarray(depth, dtype=np.float32)


def _claim(root: Path, settings: dict[str, Any]) -> None:
    """Make the folder, or see that what is in it was made with the same settings."""
    path = root / _SETTINGS
    remedy = "choose a new or empty folder"
    with storage_errors(root):
        root.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            if any(root.iterdir()):
                raise FileError(root, "holds something else than drawn scenes", remedy)
            path.write_text(json.dumps(settings), encoding="utf-8")
            return
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise FileFormatError(path, "is damaged", remedy) from error
    if found != settings:
        raise FileError(root, f"was drawn with other settings, {found}", remedy)


def _place(
    rng: np.random.Generator, shapes: Sequence[Shape], size: int, px_per_m: float
) -> list[tuple[Shape, Floats]]:
    """Each shape with the (3, 3) map from its metres to pixels; inside the picture and apart."""
    placed: list[tuple[Shape, Floats]] = []
    circles: list[tuple[float, float, float]] = []
    for shape in shapes:
        # Room for the jaws around the object as well.
        radius = (shape.radius + 0.03) * px_per_m
        low, high = sorted((min(radius, size / 2), max(size - radius, size / 2)))
        for _ in range(_TRIES):
            x, y = rng.uniform(low, high, 2) - 0.5
            if all(math.hypot(x - a, y - b) > radius + r for a, b, r in circles):
                turn = affine.rotation(rng.uniform(0, 2 * math.pi))
                placed.append((shape, affine.translation(x, y) @ turn @ affine.zoom(px_per_m)))
                circles.append((x, y, radius))
                break
    return placed


def _light(rng: np.random.Generator) -> Floats:
    """(3,) unit vector towards the light, z out of the table."""
    around, up = rng.uniform(0, 2 * math.pi), math.radians(rng.uniform(40, 65))
    return np.array(
        [math.cos(around) * math.cos(up), math.sin(around) * math.cos(up), math.sin(up)]
    )


def _plane(rng: np.random.Generator, size: int, px_per_m: float) -> Floats:
    """(S, S) depth of the tilted table relative to its middle, metres."""
    tilt, around = rng.uniform(0, _TILT), rng.uniform(0, 2 * math.pi)
    away = np.arange(size) - (size - 1) / 2
    along = away * math.cos(around) + away[:, None] * math.sin(around)
    return along * (math.tan(tilt) / px_per_m)


@dataclass(frozen=True, eq=False)
class _Picture:
    """What is being drawn: (S, S, 3) colour 0 to 1, (S, S) height above the table, (S, S) mask."""

    rgb: Pixels
    height_m: Pixels
    mask: NDArray[np.bool_]


def _put(
    rng: np.random.Generator, picture: _Picture, shape: Shape, pose: Floats, light: Floats
) -> None:
    """Draw one object into a picture; only the window that it and its shadow fill is touched."""
    px_per_m = math.hypot(pose[0, 0], pose[1, 0])
    slope = math.hypot(light[0], light[1]) / light[2]
    reach = (shape.radius + _HIGHEST_M * slope) * px_per_m + 3
    (x0, y0), (x1, y1) = (
        np.clip(pose[:2, 2] + d, 0, len(picture.mask)).astype(int) for d in (-reach, reach)
    )
    window = slice(y0, y1), slice(x0, x1)
    y, x = np.mgrid[window].astype(np.float32)
    inverse = np.linalg.inv(pose).astype(np.float32)
    u, v = (inverse[i, 0] * x + inverse[i, 1] * y + inverse[i, 2] for i in (0, 1))
    away = shape.distance(u, v)
    top_m = shape.top(u, v)
    top_px = np.asarray(top_m * px_per_m, np.float32)
    rgb = _shadow(picture.rgb[window], top_px, light)
    color = _shade(_surface(rng, shape, u, v), top_px, light)
    covered = np.clip(0.5 - away * px_per_m, 0, 1)[..., None]  # share of the pixel
    picture.rgb[window] = rgb * (1 - covered) + color * covered
    picture.height_m[window] += top_m  # objects lie apart
    picture.mask[window] |= away <= 0


def _color(
    rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]
) -> Pixels:
    hsv = np.array([[[rng.uniform(0, 360), rng.uniform(*saturation), rng.uniform(*value)]]])
    return np.asarray(cv2.cvtColor(hsv.astype(np.float32), cv2.COLOR_HSV2RGB)[0, 0], np.float32)


def _noise(rng: np.random.Generator, shape: tuple[int, ...], cells: tuple[int, int]) -> Pixels:
    """(H, W) smooth noise of about -1 to 1, with that many bumps along (y, x)."""
    bumps = rng.normal(0, 0.5, cells).astype(np.float32)
    smooth = cv2.resize(bumps, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)
    return np.asarray(smooth, dtype=np.float32)


def _table(rng: np.random.Generator, size: int) -> Pixels:
    """(S, S, 3) colour of the table, 0 to 1: a colour, a gradient, clouds, sometimes a grain."""
    color = _color(rng, (0.0, 0.5), (0.35, 0.9))
    away = np.arange(size, dtype=np.float32) / size - 0.5
    around = rng.uniform(0, 2 * math.pi)
    gradient = away * math.cos(around) + away[:, None] * math.sin(around)
    gradient *= rng.uniform(0, 0.3)
    clouds = _noise(rng, (size, size), (6, 6)) * rng.uniform(0.01, 0.06)
    grain = _noise(rng, (size, size), (max(4, size // 3), 4)) * rng.uniform(0, 0.06)
    if rng.random() < 0.5:
        grain = grain.T
    return np.asarray(color * (1 + gradient + clouds + grain)[..., None], np.float32)


def _surface(rng: np.random.Generator, shape: Shape, u: Pixels, v: Pixels) -> Pixels:
    """(H, W, 3) colour of an object, 0 to 1: two colours in bands or patches."""
    first, second = _color(rng, (0.3, 1.0), (0.3, 1.0)), _color(rng, (0.0, 1.0), (0.2, 1.0))
    patches = _noise(rng, u.shape, (12, 12)) * np.float32(0.08)
    across = u if rng.random() < 0.5 else v
    center, half = rng.uniform(-0.5, 0.5) * shape.radius, rng.uniform(0.05, 0.3) * shape.radius
    band = np.clip((half - np.abs(across - center)) / (0.02 * shape.radius) + 0.5, 0, 1)[..., None]
    if rng.random() < 0.4:
        band = np.zeros_like(band)
    colors = (first * (1 - band) + second * band) * (1 + patches[..., None])
    return np.asarray(colors, np.float32)


def _shade(surface: Pixels, top_px: Pixels, light: Floats) -> Pixels:
    """(H, W, 3) the surface under the light; edges look rounded off."""
    smooth = cv2.GaussianBlur(top_px, (0, 0), 0.8)
    slope_x = cv2.Sobel(smooth, -1, 1, 0, scale=1 / 8)
    slope_y = cv2.Sobel(smooth, -1, 0, 1, scale=1 / 8)
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    x, y, z = light.tolist()  # Python's numbers leave float32 arrays as they are
    diffuse = np.maximum((z - slope_x * x - slope_y * y) / length, 0)
    # The mirror direction of a light seen from straight above.
    normal_z = 1 / length
    shine = np.maximum(2 * diffuse * normal_z - z, 0) ** 20
    lit = surface * (0.35 + 0.75 * diffuse)[..., None] + 0.25 * shine[..., None]
    return np.asarray(lit, np.float32)


def _shadow(rgb: Pixels, top_px: Pixels, light: Floats) -> Pixels:
    """(H, W, 3) the picture darker where the object keeps the light away."""
    dark: NDArray[Any] = np.zeros_like(top_px)
    reach = -light[:2] / light[2]  # shift of a shadow for each pixel of height
    steps = 12
    for k in range(1, steps + 1):
        level = float(top_px.max()) * k / steps
        shift = affine.translation(*(reach * level))[:2]
        above = (top_px >= level * 0.999).astype(np.float32)
        dark = np.maximum(dark, np.asarray(cv2.warpAffine(above, shift, dark.shape[::-1])))
    soft = cv2.GaussianBlur(dark, (0, 0), max(1.0, float(top_px.max()) / 8))
    return rgb * (1 - 0.55 * soft[..., None])
