"""Candidates: where they lie, that opposite sides are found, and that a seed fixes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.generation.candidates import BESIDE_M, MARGIN_M, propose_grasps
from graspmap.geometry import angle_difference
from graspmap.gripper import load_gripper
from graspmap.simulation.descent import judge_descents
from graspmap.simulation.heightmap import HeightMap
from graspmap.simulation.tabletop import Tabletop

JACQUARD = load_gripper("jacquard")
FAILING = replace(JACQUARD, on_touch="fail")
CELL = 0.001


def tabletop(height):
    """240 x 240 mm about the origin; ``height`` gives metres from x and y (arrays)."""
    place = (np.arange(240) - 119.5) * CELL
    x, y = np.meshgrid(place, place)
    heights = np.broadcast_to(height(x, y), x.shape).astype(np.float32)
    return Tabletop((), HeightMap(heights, [place[0], place[0]], CELL))


def box(long=0.12, wide=0.04, high=0.05):
    return tabletop(lambda x, y: high * ((abs(x) < long / 2) & (abs(y) < wide / 2)))


def disc(radius=0.03):
    return tabletop(lambda x, y: 0.03 * (np.hypot(x, y) < radius))


def ring(radius=0.04, thick=0.008):
    return tabletop(lambda x, y: 0.02 * (abs(np.hypot(x, y) - radius) < thick / 2))


def antipodal(scene, count=400, gripper=JACQUARD, seed=0, **more):
    rng = np.random.default_rng(seed)
    return propose_grasps(scene, gripper, count, rng, antipodal_share=1, **more)


class TestEvery:
    @settings(max_examples=30)
    @given(
        st.integers(0, 60),
        st.floats(0, 1),
        st.sampled_from(["jacquard", "franka", "widowx"]),
        st.sampled_from([box(), ring(), box(0.2, 0.2, 0.003), box(0.002, 0.002)]),
    )
    def test_scene_with_anything_on_it_gets_all_it_asks_for(self, count, share, name, scene):
        gripper = load_gripper(name)
        rng = np.random.default_rng(count)
        grasps = propose_grasps(scene, gripper, count, rng, antipodal_share=share)
        assert len(grasps) == count
        assert (grasps.width_m >= gripper.min_opening_m).all()
        assert (grasps.width_m <= gripper.max_opening_m).all()
        assert np.isin(grasps.height_m, gripper.jaw_sizes_m).all()
        assert (grasps.quality == 1).all()

    def test_seed_fixes_them(self):
        scene = ring()
        first, again, other = (
            propose_grasps(scene, JACQUARD, 50, np.random.default_rng(seed)) for seed in (1, 1, 2)
        )
        assert first == again
        assert first != other

    def test_bare_table_gets_none(self):
        bare = tabletop(lambda x, _: 0 * x)
        assert len(propose_grasps(bare, JACQUARD, 10, np.random.default_rng(0))) == 0
        nothing = Tabletop((), HeightMap.from_triangles(np.zeros((0, 3, 3))))
        assert len(propose_grasps(nothing, JACQUARD, 10, np.random.default_rng(0))) == 0

    def test_jaws_of_ones_own(self):
        grasps = propose_grasps(box(), JACQUARD, 40, np.random.default_rng(0), jaws=(0.015,))
        assert (grasps.height_m == 0.015).all()

    @pytest.mark.parametrize(
        ("count", "more", "match"),
        [
            (-1, {}, "count"),
            (5, {"antipodal_share": 1.1}, "share"),
            (5, {"antipodal_share": np.nan}, "share"),
            (5, {"jaws": ()}, "jaws"),
            (5, {"jaws": (0.01, 0)}, "jaws"),
        ],
    )
    def test_refuses(self, count, more, match):
        with pytest.raises(InvalidInputError, match=match):
            propose_grasps(box(), JACQUARD, count, np.random.default_rng(0), **more)


class TestRandom:
    def grasps(self, scene, count=2000):
        rng = np.random.default_rng(0)
        return propose_grasps(scene, JACQUARD, count, rng, antipodal_share=0)

    def test_centres_cover_the_object_and_a_little_beside(self):
        center = self.grasps(box(0.10, 0.04)).center_m
        beside = np.hypot(*(np.abs(center) - [0.05, 0.02]).clip(0).T)
        assert beside.max() <= BESIDE_M + CELL
        assert (beside > 0).mean() == pytest.approx(
            1 - 0.0040 / (0.0040 + 0.28 * BESIDE_M + np.pi * BESIDE_M**2), abs=0.05
        )
        assert np.abs(center.mean(axis=0)).max() < 0.003

    def test_angles_and_openings_are_spread(self):
        grasps = self.grasps(box(0.10, 0.04))
        turns, _ = np.histogram(grasps.angle, 6, (-np.pi / 2, np.pi / 2))
        assert turns.min() > 2000 / 6 * 0.8
        assert grasps.width_m.min() < 0.01
        assert grasps.width_m.max() > 0.2


class TestAntipodal:
    def test_grasps_of_a_box_go_down_beside_it(self):
        grasps = antipodal(box())
        d = judge_descents(box().height_map, grasps, FAILING)
        assert (~d.collided & ~d.empty).mean() > 0.95
        across = angle_difference(grasps.angle, np.pi / 2) < np.arctan(JACQUARD.friction)
        # The sides are three times as long as the ends.
        assert 0.6 < across.mean() < 0.9

    @pytest.mark.parametrize("friction", [0.2, 0.8])
    def test_chords_of_a_disc_lie_in_the_friction_cone(self, friction):
        radius = 0.03
        grasps = antipodal(disc(radius), gripper=replace(JACQUARD, friction=friction))
        axis = grasps.axis()
        off = np.abs(axis[:, 0] * grasps.center_m[:, 1] - axis[:, 1] * grasps.center_m[:, 0])
        # A chord at the angle phi from the normals passes the centre at r sin(phi).
        greatest = radius * np.sin(np.arctan(friction))
        assert off.max() < greatest + 0.004
        assert off.max() > 0.5 * greatest
        chord = 2 * np.sqrt(radius**2 - off**2)
        assert (grasps.width_m > chord + MARGIN_M[0] - 2 * CELL).all()

    def test_ring_is_grasped_at_its_rim_and_across(self):
        grasps = antipodal(ring(0.04, 0.008))
        radius = np.hypot(*grasps.center_m.T)
        heading = np.arctan2(grasps.center_m[:, 1], grasps.center_m[:, 0])
        rim = (abs(radius - 0.04) < 0.01) & (angle_difference(grasps.angle, heading) < 0.6)
        across = (radius < 0.02) & (grasps.width_m > 0.08)
        assert rim[grasps.width_m < 0.03].mean() > 0.9
        assert (rim & (grasps.width_m < 0.03)).mean() > 0.3
        assert across.mean() > 0.1

    @pytest.mark.parametrize("cells", [1, 2, 3])
    def test_thin_walls_have_two_sides(self, cells):
        wall = tabletop(lambda x, y: 0.05 * ((abs(x) < 0.05) & (y > 0) & (y < cells * CELL)))
        grasps = antipodal(wall, jaws=(0.01,))
        across = angle_difference(grasps.angle, np.pi / 2) < np.arctan(JACQUARD.friction) + 0.05
        assert across.mean() > 0.9
        assert (grasps.width_m[across] > cells * CELL + MARGIN_M[0] - CELL).all()
        d = judge_descents(wall.height_map, grasps, FAILING)
        assert (~d.collided & ~d.empty).mean() > 0.9

    def test_handle_beside_a_tall_body(self):
        """The handle is lower than what the fingers reach on the body."""
        mug = tabletop(
            lambda x, y: np.where(
                np.hypot(x, y) < 0.035,
                0.1,
                0.07 * ((x > 0) & (x < 0.07) & (abs(y) < 0.005)),
            )
        )
        grasps = antipodal(mug, jaws=(0.01,))
        x, y = grasps.center_m.T
        handle = (x > 0.036) & (abs(y) < 0.01) & (grasps.width_m < 0.03)
        assert handle.mean() > 0.15
        d = judge_descents(mug.height_map, grasps[handle], FAILING)
        assert (~d.collided & ~d.empty).mean() > 0.5

    def test_flat_things_beside_tall_ones(self):
        both = tabletop(
            lambda x, y: np.where(
                abs(x + 0.05) < 0.015, 0.15 * (abs(y) < 0.04), 0.01 * ((x > 0) & (abs(y) < 0.01))
            )
        )
        assert (antipodal(both).center_m[:, 0] > 0).mean() > 0.3

    def test_what_is_wider_than_the_gripper_opens_gets_random_ones(self):
        large = box(0.2, 0.2)
        grasps = antipodal(large, gripper=replace(FAILING, max_opening_m=0.1))
        assert len(grasps) == 400
        assert (grasps.width_m <= 0.1).all()
