"""The contact sheet: scenes of a data set with their labels drawn on them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from graspmap.data import read_scenes
from graspmap.data.scene import Scene
from graspmap.errors import GraspmapError
from graspmap.geometry import Grasps, affine
from graspmap.pictures import Tile, contact_sheet, depth_picture, draw_grasps
from graspmap.pictures.draw import FAILED
from graspmap.pictures.fields import depth_limits

_SCENES = 12
_GRASPS = 12
"""Scenes on a contact sheet, and grasps drawn on each at most."""


def contact_sheet_of(spec: str) -> NDArray[np.uint8]:
    """Scenes of a data set, evenly spread, with some of their labels drawn on them.

    Args:
        spec: ``"kind:directory"``.

    Raises:
        GraspmapError: Not one scene can be read.
    """
    scenes = read_scenes(spec)
    tiles: list[Tile] = []
    failure: GraspmapError | None = None
    for index in np.unique(np.linspace(0, len(scenes) - 1, _SCENES).round().astype(int)):
        try:
            tiles += _tiles(scenes[int(index)])
        except GraspmapError as error:  # it is among the report's problems
            failure = error
    if not tiles and failure is not None:
        raise failure
    title = f"{spec}: jaws blue, opening red, mask green; grey: labelled as failing"
    return contact_sheet(tiles, columns=4, cell=300, title=title)


def _tiles(scene: Scene) -> list[Tile]:
    """Colour with labels, and the depth beside it where there is one."""
    grasps = scene.grasps if scene.grasps is not None else Grasps.empty()
    chosen = np.unique(np.linspace(0, len(grasps) - 1, _GRASPS).round().astype(int))
    grasps = grasps[chosen] if len(grasps) else grasps
    image = scene.rgb
    if image is None:
        assert scene.depth is not None  # a Scene has one of the two
        image = depth_picture(scene.depth)
    if scene.negatives is not None and len(scene.negatives):
        image = draw_grasps(image, scene.negatives[:_GRASPS], jaw=FAILED, opening=FAILED)
    if scene.mask is not None:
        edges, _ = cv2.findContours(
            scene.mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        )
        thickness = max(1, image.shape[1] // 400)
        image = image.copy()
        cv2.drawContours(image, edges, -1, (0, 200, 90), thickness)
    count = 0 if scene.grasps is None else len(scene.grasps)
    cut = _surroundings(scene)
    name = scene.id if len(scene.id) <= 20 else f"{scene.id[:12]}..{scene.id[-6:]}"
    moved = grasps.transformed(affine.crop(cut[1].start, cut[0].start))
    tiles = [Tile(image[cut], f"{name}: {count} labels", grasps=moved)]
    if scene.depth is not None and scene.rgb is not None:
        depth = scene.depth[cut]
        near, far = depth_limits(depth)
        words = f"{near:.2f} m", f"{far:.2f} m"
        picture = depth_picture(depth)
        tiles.append(Tile(picture, "depth (magenta: none)", ("depth", *words)))
    return tiles


def _surroundings(scene: Scene) -> tuple[slice, slice]:
    """Rows and columns of the square around all labels, or of the whole picture without any."""
    rows, columns = scene.shape
    if scene.grasps is None or not len(scene.grasps):
        return slice(0, rows), slice(0, columns)
    corners = scene.grasps.corners().reshape(-1, 2)
    low, high = corners.min(axis=0), corners.max(axis=0)
    half = max(0.7 * float((high - low).max()), 40.0)
    x, y = (low + high) / 2
    x0, x1 = (int(np.clip(v, 0, columns)) for v in (x - half, x + half))
    y0, y1 = (int(np.clip(v, 0, rows)) for v in (y - half, y + half))
    if x1 - x0 < 16 or y1 - y0 < 16:  # labels outside the picture: show that they are
        return slice(0, rows), slice(0, columns)
    return slice(y0, y1), slice(x0, x1)
