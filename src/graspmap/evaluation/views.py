"""What a detector sees of a picture: all of it, or what the habits of others make of it.

Letters in shapes: H rows, W columns of the picture; h, w of what is seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.data.scene import Depth, Rgb, Scene
from graspmap.geometry.affine import crop
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.metrics.protocols import View

_WINDOW = 300 / 480
"""Side of the window about the labels, in shorter sides of the picture: the 300 px that GG-CNN's
authors cut out of Cornell's 640 x 480 px."""

_ZOOM = (0.5, 1.0)
"""Part of the shorter side that an augmented picture shows, as in training."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A picture as a detector gets to see it.

    Attributes:
        rgb: (h, w, 3) colour, or None.
        depth: (h, w) metres, or None.
        matrix: (3, 3) map from its pixels to those of the whole picture.
        camera: Its intrinsics, or None.
    """

    rgb: Rgb | None
    depth: Depth | None
    matrix: NDArray[np.float64]
    camera: Camera | None = None


def look(scene: Scene, view: View, rng: np.random.Generator) -> Seen:
    """A scene as a detector sees it under a protocol.

    Args:
        scene: With the labels, where the view is about them.
        view: See `graspmap.metrics.RectangleProtocol`.
        rng: Source of the augmentation.
    """
    if view == "whole":
        return Seen(scene.rgb, scene.depth, np.eye(3), scene.camera)
    if view == "labels":
        return _about_labels(scene)
    return _augmented(scene, rng)


def _about_labels(scene: Scene) -> Seen:
    rows, columns = scene.shape
    labels = scene.grasps if scene.grasps is not None else Grasps.empty()
    side = max(1, round(_WINDOW * min(rows, columns)))
    middle = labels.center.mean(axis=0) if len(labels) else np.array([columns, rows]) / 2
    return _cut(scene, *_corner(middle, side, rows, columns), side)


def _augmented(scene: Scene, rng: np.random.Generator) -> Seen:
    """The middle of the picture, between half of it and all, turned by a multiple of 90 degrees."""
    rows, columns = scene.shape
    side = max(1, round(rng.uniform(*_ZOOM) * min(rows, columns)))
    middle = np.array([columns, rows]) / 2
    cut = _cut(scene, *_corner(middle, side, rows, columns), side)
    turns = int(rng.integers(4))
    # A quarter turn counter-clockwise on screen takes (x, y) to (y, side - 1 - x).
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, side - 1.0], [0.0, 0.0, 1.0]])
    matrix = cut.matrix @ np.linalg.inv(np.linalg.matrix_power(quarter, turns))
    return Seen(
        None if cut.rgb is None else np.ascontiguousarray(np.rot90(cut.rgb, turns)),
        None if cut.depth is None else np.ascontiguousarray(np.rot90(cut.depth, turns)),
        np.round(matrix),  # whole numbers, but for the inverse's rounding
        None if cut.camera is None else _turned(cut.camera, turns),
    )


def _corner(middle: NDArray[np.float64], side: int, rows: int, columns: int) -> tuple[int, int]:
    """First column and row of a square window about a point, moved into the picture."""
    x = int(np.clip(round(middle[0] - side / 2), 0, columns - side))
    y = int(np.clip(round(middle[1] - side / 2), 0, rows - side))
    return x, y


def _cut(scene: Scene, x: int, y: int, side: int) -> Seen:
    window = np.s_[y : y + side, x : x + side]
    return Seen(
        None if scene.rgb is None else np.ascontiguousarray(scene.rgb[window]),
        None if scene.depth is None else np.ascontiguousarray(scene.depth[window]),
        crop(-x, -y),
        None if scene.camera is None else scene.camera.transformed(crop(x, y), side, side),
    )


def _turned(camera: Camera, turns: int) -> Camera:
    """The camera of a picture turned by so many quarters counter-clockwise on screen."""
    for _ in range(turns):
        camera = Camera(
            fx=camera.fy,
            fy=camera.fx,
            cx=camera.cy,
            cy=camera.width - 1 - camera.cx,
            width=camera.height,
            height=camera.width,
        )
    return camera
