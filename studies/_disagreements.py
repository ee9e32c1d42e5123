"""Pictures of the grasps on which the trial and Jacquard disagree."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from graspmap.data.jacquard import JacquardScenes
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import load_gripper
from graspmap.pictures import Tile, contact_sheet, draw_grasps, encode
from graspmap.simulation.heightmap import HeightMap
from graspmap.simulation.trial import Outcome, TrialResult
from studies._presumed import KINDS, gaps

if TYPE_CHECKING:
    from studies.jacquard_agreement import SceneTrials

Picture = NDArray[np.uint8]

_MOST = 20  # tiles of a sheet
_HALF_PX = 100  # half the side of the part of the picture that is shown
_STRIP = (90, 400)  # rows and columns of the section under it
_M_PER_PX = 0.0012
_BLUE, _BLACK, _GREY = (40, 90, 255), (0, 0, 0), (170, 170, 170)


def picture_sheets(
    out: Path, name: str, scenes: JacquardScenes, trials: Sequence[SceneTrials]
) -> None:
    """One sheet for each kind and object with disagreements, ``OUT/NAME_KIND_OBJECT.png``."""
    for object_id in sorted({t.object_id for t in trials}):
        mine = [t for t in trials if t.object_id == object_id]
        for kind in KINDS:
            wanted = [
                (t, i)
                for t in mine
                for i, result in enumerate(t.results[kind])
                if (result.outcome is Outcome.HELD) != (kind == "label")
            ]
            if not wanted:
                continue
            some = np.unique(np.linspace(0, len(wanted) - 1, min(len(wanted), _MOST)).astype(int))
            total = sum(len(t.results[kind]) for t in mine)
            what = "do not hold" if kind == "label" else "hold"
            title = f"{object_id[:12]}: {len(wanted)} of {total} ({kind}) {what}"
            tiles = [_tile(scenes, wanted[k][0], wanted[k][1], kind) for k in some]
            path = out / f"{name}_{kind}_{object_id[:6]}.png"
            path.write_bytes(encode(contact_sheet(tiles, columns=5, cell=400, title=title)))


def _tile(scenes: JacquardScenes, trial: SceneTrials, index: int, kind: str) -> Tile:
    """The grasp on the picture, and below it a section of the scene along its opening."""
    scene = scenes[scenes.index(trial.id)]
    assert scene.rgb is not None
    assert scene.camera is not None
    grasp, result = trial.grasps[kind][index : index + 1], trial.results[kind][index]
    heights = trial.height_map
    pixels = grasp.to_pixels(heights.at(grasp.center_m), scene.camera, trial.T_world_camera)
    x, y = np.round(pixels.center[0]).astype(int)
    size = 2 * _HALF_PX
    padded = np.pad(scene.rgb, ((_HALF_PX, _HALF_PX), (_HALF_PX, _HALF_PX), (0, 0)), mode="edge")
    crop = padded[y : y + size, x : x + size]
    shift = np.array([[1.0, 0.0, _HALF_PX - x], [0.0, 1.0, _HALF_PX - y], [0.0, 0.0, 1.0]])
    drawn = draw_grasps(np.ascontiguousarray(crop), pixels.transformed(shift), scale=2.0)
    whole = np.concatenate([drawn[: 2 * size, : 2 * size], _section(heights, grasp, result)])
    caption = f"{trial.id[:6]} {result.outcome.value}: {result.reason}"
    if kind != "label":
        place, turn = gaps(grasp, trial.grasps["label"])
        nearest = int(np.argmin(np.hypot(place[0] / 0.02, turn[0] / np.radians(30))))
        away, off = place[0, nearest] * 100, np.degrees(turn[0, nearest])
        caption = f"{trial.id[:6]} next label {away:.1f} cm, {off:.0f} deg away"
    return Tile(whole, caption)


def _section(heights: HeightMap, grasp: TableGrasps, result: TrialResult) -> Picture:
    """Heights along the opening (black), along the edges of the jaw (grey), and the fingers."""
    rows, columns = _STRIP
    strip = np.full((rows, columns, 3), 255, np.uint8)
    along = (np.arange(columns) - columns / 2) * _M_PER_PX / 2
    axis = grasp.axis()[0]
    across = np.array([-axis[1], axis[0]]) * float(grasp.height_m[0]) / 2
    gripper = load_gripper("jacquard")
    half = min(float(grasp.width_m[0]), gripper.max_opening_m) / 2
    for side in (-1, 1):
        inner, outer = half, half + gripper.finger_thickness_m
        left, right = sorted(columns / 2 + side * np.array([inner, outer]) * 2 / _M_PER_PX)
        bottom = int(rows - 2 - result.tip_m / _M_PER_PX)
        cv2.rectangle(strip, (int(left), 0), (int(right), bottom), _BLUE, -1)
    for offset, color, thick in ((-1, _GREY, 1), (1, _GREY, 1), (0, _BLACK, 2)):
        points = grasp.center_m[0] + along[:, None] * axis + offset * across
        row = rows - 2 - heights.at(points) / _M_PER_PX
        line = np.column_stack([np.arange(columns), row]).astype(np.int32)
        cv2.polylines(strip, [line[:, None]], False, color, thick)
    return strip
