"""Baselines that see the outline of an object: boxes and discs of known place, angle and width."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.evaluation.shape_baselines import AntipodalGrasp, MomentsGrasp, object_mask
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import angle_difference
from graspmap.gripper import load_gripper

SIDE = 240
DEGREE = np.pi / 180


def table(tilt: float = 0.0) -> np.ndarray:
    """Depth of a bare table 0.6 m away; inverse depth is linear over the picture."""
    y, x = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    return (1 / (1 / 0.6 + tilt * (x + 0.5 * y) / SIDE)).astype(np.float32)


def box(center, angle: float, length: float, width: float, tilt: float = 0.0) -> np.ndarray:
    """A box whose long side points along ``angle`` (counter-clockwise on screen), 3 cm high."""
    depth = table(tilt)
    y, x = np.mgrid[:SIDE, :SIDE].astype(float)
    x, y = x - center[0], y - center[1]
    along = np.cos(angle) * x - np.sin(angle) * y
    across = np.sin(angle) * x + np.cos(angle) * y
    depth[(np.abs(along) <= length / 2) & (np.abs(across) <= width / 2)] -= 0.03
    return depth


@settings(max_examples=10, deadline=None)
@given(
    x=st.floats(90, 150),
    y=st.floats(90, 150),
    angle=st.floats(-90, 90),
    tilt=st.floats(-0.4, 0.4),
    length=st.floats(60, 100),
    width=st.floats(12, 40),
)
@pytest.mark.parametrize("baseline", [MomentsGrasp(), AntipodalGrasp()])
def test_a_box_is_grasped_across(baseline, x, y, angle, tilt, length, width):
    depth = box((x, y), angle * DEGREE, length, width, tilt)
    found = baseline.detect(depth=depth).grasps
    assert len(found) == 1
    square = isinstance(baseline, AntipodalGrasp)  # may grasp the long way if that fits as well
    turns = [angle_difference(found.angle, (angle + 90) * DEGREE)[0]]
    widths = [width]
    if square:
        turns.append(angle_difference(found.angle, angle * DEGREE)[0])
        widths.append(length)
    best = int(np.argmin(turns))
    assert turns[best] < 8 * DEGREE
    # Along a box every place is as good.
    assert np.linalg.norm(found.center[0] - [x, y]) < 2 + 0.1 * length
    assert found.width[0] == pytest.approx(1.25 * widths[best], rel=0.08, abs=3)


def test_the_mask_is_what_rises():
    depth = box((100, 120), 0.5, 80, 30, tilt=0.3)
    seen, truth = object_mask(depth), table(0.3) - depth > 0.01
    assert (seen & truth).sum() / (seen | truth).sum() > 0.97
    holes = depth.copy()
    holes[50:60] = np.nan
    assert (object_mask(holes) & truth).sum() / truth.sum() > 0.95


def test_the_best_pairs_are_apart_and_fit_the_gripper():
    depth = box((120, 120), 0.2, 100, 36)
    found = AntipodalGrasp().detect(depth=depth, top=5).grasps
    assert 2 <= len(found) <= 5
    assert (np.diff(found.quality) <= 0).all()
    gaps = np.linalg.norm(found.center[:, None] - found.center, axis=2)
    assert gaps[np.triu_indices(len(found), k=1)].min() >= 0.05 * SIDE
    # 100 px at 0.57 m with this lens are 23 cm, 45 px are 10.7 cm: too wide for 8 cm, with room.
    camera = Camera(SIDE, SIDE, SIDE / 2, SIDE / 2, SIDE, SIDE)
    narrow = AntipodalGrasp().detect(depth=depth, camera=camera, gripper=load_gripper("franka"))
    assert len(narrow.grasps) == 0
    wide = AntipodalGrasp().detect(depth=depth, camera=camera, gripper=load_gripper("jacquard"))
    assert len(wide.grasps) == 1


def test_nothing_on_the_table_is_no_grasp_and_no_depth_an_error():
    for baseline in (MomentsGrasp(), AntipodalGrasp()):
        assert len(baseline.detect(depth=table()).grasps) == 0
        assert len(baseline.detect(depth=np.full((50, 50), np.nan, np.float32)).grasps) == 0
        with pytest.raises(InvalidInputError, match="depth"):
            baseline.detect(np.zeros((9, 9, 3), np.uint8), None)
