"""Descents: verdicts on the height map, against looking at every cell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from graspmap.geometry import TableGrasps
from graspmap.gripper import load_gripper
from graspmap.simulation.descent import LEAST_GRIP_M, Descents, judge_descents
from graspmap.simulation.heightmap import HeightMap

JACQUARD = load_gripper("jacquard")
FAILING = replace(JACQUARD, on_touch="fail")
CELL = 0.001
SIDE = 60


def scene(seed, tallest=0.08):
    """A 6 cm square with a few blocks, its middle at the world's origin."""
    rng = np.random.default_rng(seed)
    heights = np.zeros((SIDE, SIDE), np.float32)
    for _ in range(rng.integers(1, 6)):
        row, column = rng.integers(0, SIDE - 5, 2)
        rows, columns = rng.integers(2, 25, 2)
        block = heights[row : row + rows, column : column + columns]
        np.maximum(block, rng.uniform(0.002, tallest), out=block)
    return around_origin(heights)


def around_origin(heights):
    """The map whose grid is centred on the world's origin."""
    rows, columns = np.shape(heights)
    return HeightMap(heights, [-(columns - 1) / 2 * CELL, -(rows - 1) / 2 * CELL], CELL)


def random_grasps(seed, count=20):
    rng = np.random.default_rng(seed)
    return TableGrasps(
        rng.uniform(-0.03, 0.03, (count, 2)),
        rng.uniform(-np.pi / 2, np.pi / 2, count),
        rng.uniform(0, 0.08, count),
        rng.choice(JACQUARD.jaw_sizes_m, count),
    )


def grasp(x=0.0, y=0.0, angle=0.0, width=0.04, jaw=0.02):
    return TableGrasps([[x, y]], [angle], [width], [jaw])


grippers = st.builds(
    replace,
    st.just(JACQUARD),
    on_touch=st.sampled_from(["fail", "stop"]),
    finger_thickness_m=st.floats(0.001, 0.02),
    finger_length_m=st.floats(0.03, 0.1),
    palm_size_m=st.tuples(st.floats(0.01, 0.1), st.floats(0.01, 0.05)),
    max_depth_m=st.floats(0.005, 0.03),
    max_opening_m=st.floats(0.03, 0.1),
    jaw_contact_share=st.floats(0.3, 1.0),
)
seeds = st.integers(0, 10_000)


def look_at_every_cell(height_map, one, gripper):
    """tip, top, left, right, palm, needed of one grasp; None if a middle is near a border."""
    rows, columns = height_map.heights_m.shape
    middle = height_map.middles(np.stack(np.mgrid[:rows, :columns], axis=-1))
    axis = np.array([np.cos(one.angle[0]), np.sin(one.angle[0])])
    u = (middle - one.center_m[0]) @ axis
    v = (middle - one.center_m[0]) @ [-axis[1], axis[0]]
    half = min(max(one.width_m[0], gripper.min_opening_m), gripper.max_opening_m) / 2
    jaw = one.height_m[0] * gripper.jaw_contact_share / 2
    outer = half + gripper.finger_thickness_m
    along, across = np.array(gripper.palm_size_m) / 2
    for value, border in ((u, half), (u, outer), (v, jaw), (u, along), (v, across)):
        if np.abs(np.abs(value) - border).min() < 1e-9:
            return None
    h = height_map.heights_m.astype(float)

    def highest(where):
        return h[where].max(initial=0)

    held = (np.abs(u) < half) & (np.abs(v) < jaw)
    top = highest(held)
    left = highest((u < -half) & (u > -outer) & (np.abs(v) < jaw))
    right = highest((u > half) & (u < outer) & (np.abs(v) < jaw))
    length, gap = gripper.finger_length_m, gripper.touch_gap_m
    tip = max(gripper.table_clearance_m, top - gripper.max_depth_m, top + gap - length)
    palm = highest((np.abs(u) < along) & (np.abs(v) < across))
    if h.max() <= gripper.table_clearance_m + length:
        palm = 0
    if gripper.on_touch == "stop":
        tip = max(left, right) + gap if max(left, right) > tip else tip
        tip = palm - length + gap if palm - length > tip else tip
    higher = np.abs(u[held & (h > tip)])
    needed = min(2 * higher.max() + CELL, 2 * half) if higher.size else 0
    return tip, top, left, right, palm, needed


class TestAgainstEveryCell:
    @settings(max_examples=30)
    @given(seeds, grippers)
    def test_numbers(self, seed, gripper):
        height_map, grasps = scene(seed, 0.15), random_grasps(seed)
        d = judge_descents(height_map, grasps, gripper)
        for i, one in enumerate(grasps):
            wanted = look_at_every_cell(height_map, one, gripper)
            if wanted is None:
                continue
            got = (d.tip_m[i], d.top_m[i], *d.under_fingers_m[i], d.under_palm_m[i], d.needed_m[i])
            assert got == pytest.approx(wanted, abs=1e-12)
            touched = max(*wanted[2:4], wanted[4] - gripper.finger_length_m)
            assert d.clearance_m[i] == pytest.approx(wanted[0] - touched, abs=1e-12)

    @given(seeds, grippers)
    def test_verdicts_follow_from_the_numbers(self, seed, gripper):
        d = judge_descents(scene(seed), random_grasps(seed), gripper)
        assert (d.collided == (d.clearance_m < 0)).all()
        assert (d.empty == (d.top_m <= d.tip_m + LEAST_GRIP_M)).all()
        assert (d.tip_m >= gripper.table_clearance_m).all()
        assert (d.needed_m <= gripper.max_opening_m).all()
        if gripper.on_touch == "stop":
            assert not d.collided.any()


class TestLaws:
    @settings(max_examples=50)
    @given(seeds, st.integers(0, 3), grippers)
    def test_turning_scene_and_grasp_together_changes_nothing(self, seed, quarters, gripper):
        height_map, grasps = scene(seed), random_grasps(seed)
        # Rows grow with y: seen with y up, rot90 turns the other way round.
        turned_map = around_origin(np.rot90(height_map.heights_m, -quarters))
        c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarters]
        x, y = grasps.center_m.T
        turned = grasps.replace(
            center_m=np.stack([c * x - s * y, s * x + c * y], axis=-1),
            angle=grasps.angle + quarters * np.pi / 2,
        )
        here = judge_descents(height_map, grasps, gripper)
        there = judge_descents(turned_map, turned, gripper)
        # An angle that comes back turned by pi has its fingers swapped.
        swapped = np.abs(np.cos(grasps.angle + quarters * np.pi / 2 - turned.angle) + 1) < 0.5
        fingers = np.where(swapped[:, None], there.under_fingers_m[:, ::-1], there.under_fingers_m)
        same(replace(there, under_fingers_m=fingers), here)

    @given(seeds, st.integers(-40, 40), st.integers(-40, 40))
    def test_moving_scene_and_grasp_together_changes_nothing(self, seed, dx, dy):
        height_map, grasps = scene(seed), random_grasps(seed)
        by = np.array([dx, dy]) * CELL
        moved = HeightMap(height_map.heights_m, height_map.origin_m + by, CELL)
        there = judge_descents(moved, grasps.replace(center_m=grasps.center_m + by), JACQUARD)
        same(there, judge_descents(height_map, grasps, JACQUARD))

    @given(seeds)
    def test_bare_table_around_the_map_changes_nothing(self, seed):
        height_map, grasps = scene(seed), random_grasps(seed)
        wider = HeightMap(
            np.pad(height_map.heights_m, ((7, 3), (5, 9))),
            height_map.origin_m - np.array([5, 7]) * CELL,
            CELL,
        )
        here = judge_descents(height_map, grasps, JACQUARD)
        same(judge_descents(wider, grasps, JACQUARD), here)

    @given(seeds)
    def test_each_grasp_is_judged_alone(self, seed):
        height_map, grasps = scene(seed), random_grasps(seed, 5)
        together = judge_descents(height_map, grasps, JACQUARD)
        for i, one in enumerate(grasps):
            alone = judge_descents(height_map, one, JACQUARD)
            for name in vars(together):
                assert np.array_equal(getattr(together, name)[i], getattr(alone, name)[0])

    @given(seeds)
    def test_more_below_the_fingers_never_helps(self, seed):
        height_map, one = scene(seed), random_grasps(seed, 1)
        rng = np.random.default_rng(seed)
        heights = height_map.heights_m.copy()
        rows, columns = heights.shape
        middle = height_map.middles(np.stack(np.mgrid[:rows, :columns], axis=-1))
        beside = np.abs((middle - one.center_m[0]) @ one.axis()[0]) > one.width_m[0] / 2
        heights[beside] += rng.uniform(0, 0.05, beside.sum()) * (rng.random(beside.sum()) < 0.1)
        before = judge_descents(height_map, one, FAILING)
        after = judge_descents(around_origin(heights), one, FAILING)
        assert after.clearance_m[0] <= before.clearance_m[0]
        assert after.collided[0] >= before.collided[0]

    @given(seeds, st.floats(1.0, 3.0))
    def test_a_larger_jaw_meets_no_less(self, seed, factor):
        height_map, grasps = scene(seed), random_grasps(seed)
        small = judge_descents(height_map, grasps, FAILING)
        wide = grasps.replace(height_m=grasps.height_m * factor)
        large = judge_descents(height_map, wide, FAILING)
        assert (large.top_m >= small.top_m).all()
        assert (large.under_fingers_m >= small.under_fingers_m).all()
        # A higher top lifts the tips, and only that can make way.
        same_tip = large.tip_m == small.tip_m
        assert (large.clearance_m <= small.clearance_m)[same_tip].all()

    @given(seeds)
    def test_the_opening_needed_is_enough(self, seed):
        height_map, grasps = scene(seed), random_grasps(seed)
        d = judge_descents(height_map, grasps, FAILING)
        good = ~d.collided & (d.needed_m > 0)
        assume(good.any())
        closer = grasps[good].replace(width_m=d.needed_m[good])
        again = judge_descents(height_map, closer, FAILING)
        assert not again.collided.any()
        assert again.tip_m == pytest.approx(d.tip_m[good])
        assert again.needed_m == pytest.approx(d.needed_m[good])


def same(there: Descents, here: Descents) -> None:
    """All numbers and verdicts agree."""
    for name in ("tip_m", "clearance_m", "top_m", "needed_m", "under_fingers_m", "under_palm_m"):
        # Lengths in the plane carry the rounding of the move.
        assert getattr(there, name) == pytest.approx(getattr(here, name), abs=1e-9), name
    assert (there.collided == here.collided).all()
    assert (there.empty == here.empty).all()


class TestByHand:
    """A bar 2 cm wide and 5 cm high along y, in the middle of 6 cm of table."""

    bar = np.zeros((SIDE, SIDE), np.float32)
    bar[:, 20:40] = 0.05
    bar = around_origin(bar)

    def judge(self, one, gripper=JACQUARD):
        return judge_descents(self.bar, one, gripper)

    def test_across(self):
        d = self.judge(grasp(width=0.04))
        assert d.tip_m[0] == pytest.approx(0.01)
        assert d.top_m[0] == pytest.approx(0.05)
        assert d.clearance_m[0] == pytest.approx(0.01)
        assert d.needed_m[0] == pytest.approx(0.02)
        assert not d.collided[0]
        assert not d.empty[0]

    def test_off_centre_needs_more(self):
        assert self.judge(grasp(x=0.004, width=0.04)).needed_m[0] == pytest.approx(0.028)

    def test_too_narrow(self):
        stopped = self.judge(grasp(width=0.015))
        assert stopped.tip_m[0] == pytest.approx(0.051)
        assert stopped.clearance_m[0] == pytest.approx(0.001)
        assert stopped.empty[0]
        failed = self.judge(grasp(width=0.015), FAILING)
        assert failed.clearance_m[0] == pytest.approx(-0.04)
        assert failed.collided[0]
        assert failed.under_fingers_m[0] == pytest.approx([0.05, 0.05])

    def test_one_finger_on_it(self):
        d = self.judge(grasp(x=0.012, width=0.02), FAILING)
        assert d.collided[0]
        assert d.under_fingers_m[0] == pytest.approx([0.05, 0])

    def test_beside_it(self):
        d = self.judge(grasp(x=0.025, width=0.01))
        assert d.tip_m[0] == JACQUARD.table_clearance_m
        assert d.empty[0]
        assert d.needed_m[0] == 0

    def test_openings_outside_the_range_are_the_nearest(self):
        narrow = replace(JACQUARD, min_opening_m=0.03, max_opening_m=0.05)
        for asked, taken in ((0.5, 0.05), (0.01, 0.03)):
            got, wanted = self.judge(grasp(width=asked), narrow), self.judge(grasp(width=taken))
            assert got.clearance_m == wanted.clearance_m
            assert got.needed_m == wanted.needed_m

    def test_jaws_count_with_what_the_plate_has_of_them(self):
        # The end of a bar: a jaw of 2 cm reaches past it by 0.8 x 1 cm.
        end = np.zeros((SIDE, SIDE), np.float32)
        end[30:, 20:40] = 0.05
        # The middles of its last cells lie at y = 0.5 mm.
        for y, top in ((-0.0074, 0.05), (-0.0076, 0.0)):
            d = judge_descents(around_origin(end), grasp(y=y), JACQUARD)
            assert d.top_m[0] == pytest.approx(top)

    def test_palm_stays_above_what_is_held(self):
        short = replace(JACQUARD, finger_length_m=0.03, max_depth_m=0.03, palm_size_m=(0.01, 0.01))
        d = self.judge(grasp(width=0.04), short)
        assert d.tip_m[0] == pytest.approx(0.05 - 0.03 + JACQUARD.touch_gap_m)
        assert not d.collided[0]

    def test_palm_meets_a_neighbour(self):
        heights = self.bar.heights_m.copy()
        heights[28:32, 55:] = 0.2
        tall = around_origin(heights)
        robot = replace(FAILING, finger_length_m=0.06, palm_size_m=(0.055, 0.02))
        d = judge_descents(tall, grasp(width=0.03), robot)
        assert d.collided[0]
        assert d.under_palm_m[0] == pytest.approx(0.2)
        assert d.clearance_m[0] == pytest.approx(0.01 + 0.06 - 0.2)
        stopped = judge_descents(tall, grasp(width=0.03), replace(robot, on_touch="stop"))
        assert stopped.tip_m[0] == pytest.approx(0.2 - 0.06 + 0.001)
        assert stopped.empty[0]
        narrow = replace(robot, palm_size_m=(0.045, 0.02))
        assert not judge_descents(tall, grasp(width=0.03), narrow).collided[0]

    def test_bare_table(self):
        d = judge_descents(HeightMap(np.zeros((0, 0)), [0, 0]), grasp(), JACQUARD)
        assert d.empty[0]
        assert not d.collided[0]
        assert d.tip_m[0] == JACQUARD.table_clearance_m

    def test_no_grasps(self):
        d = judge_descents(self.bar, TableGrasps.empty(), JACQUARD)
        assert d.tip_m.shape == (0,)
        assert d.under_fingers_m.shape == (0, 2)
