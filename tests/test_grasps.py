"""Grasps: what they check, their corners, and how they move with the image."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.geometry import Grasps, affine, angle_difference, wrap_angle

HALF = np.pi / 2
angles = st.floats(-HALF, HALF, exclude_max=True)
coordinates = st.floats(-1000, 1000)
sizes = st.floats(0, 500)
counts = st.integers(1, 5)


def one(x=10.0, y=20.0, angle=0.0, width=8.0, height=4.0, quality=1.0):
    return Grasps([[x, y]], [angle], [width], [height], [quality])


@st.composite
def grasps(draw, count=counts, size=sizes):
    n = draw(count)
    rows = [
        (draw(coordinates), draw(coordinates), draw(angles), draw(size), draw(size))
        for _ in range(n)
    ]
    x, y, a, w, h = np.array(rows).reshape(n, 5).T
    return Grasps(np.stack([x, y], axis=-1), a, w, h)


@st.composite
def similarities(draw):
    about = draw(st.tuples(coordinates, coordinates))
    m = affine.rotation(draw(st.floats(-4, 4)), about) @ affine.zoom(draw(st.floats(0.1, 10)))
    m = affine.translation(draw(coordinates), draw(coordinates)) @ m
    return affine.flip(640) @ m if draw(st.booleans()) else m


def same_axis(a, b):
    """Difference of the axes; exact also where the angles wrap."""
    return angle_difference(a.angle, b.angle).max(initial=0.0)


class TestWrapAngle:
    @given(st.floats(-100, 100))
    def test_lies_in_the_half_open_interval_and_keeps_the_axis(self, angle):
        wrapped = float(wrap_angle(angle))
        assert -HALF <= wrapped < HALF
        turns = (angle - wrapped) / np.pi
        assert abs(turns - round(turns)) < 1e-13

    @given(angles)
    def test_leaves_angles_in_range_alone(self, angle):
        assert wrap_angle(angle) == angle

    @pytest.mark.parametrize(
        ("given_angle", "wrapped"),
        [(HALF, -HALF), (-HALF, -HALF), (np.pi, 0.0), (3 * HALF, -HALF), (-HALF - 1e-17, -HALF)],
    )
    def test_edges(self, given_angle, wrapped):
        assert wrap_angle(given_angle) == pytest.approx(wrapped, abs=1e-15)

    def test_just_below_the_lower_edge_stays_in_range(self):
        assert wrap_angle(np.nextafter(-HALF, -2)) < HALF

    def test_does_not_change_its_argument(self):
        angle = np.array([3.0])
        wrap_angle(angle)
        assert angle[0] == 3.0


class TestAngleDifference:
    @given(st.floats(-50, 50), st.floats(-50, 50))
    def test_equals_the_angle_between_the_axes(self, a, b):
        cosine = abs(np.cos(a) * np.cos(b) + np.sin(a) * np.sin(b))
        difference = float(angle_difference(a, b))
        assert 0 <= difference <= HALF
        assert np.cos(difference) == pytest.approx(cosine, abs=1e-13)
        assert difference == angle_difference(b, a)

    def test_wraps_at_the_vertical(self):
        almost = np.radians([89.0, -89.0])
        assert angle_difference(almost[0], almost[1]) == pytest.approx(np.radians(2))

    def test_broadcasts(self):
        assert angle_difference(np.zeros((3, 1)), np.zeros((1, 2))).shape == (3, 2)


class TestConstruction:
    def test_angle_is_stored_in_range(self):
        assert one(angle=np.pi).angle[0] == 0.0
        assert one(angle=HALF).angle[0] == -HALF

    def test_quality_is_one_where_none_is_given(self):
        assert Grasps([[1, 2]], [0], [3], [4]).quality.tolist() == [1.0]

    def test_no_grasps(self):
        for none in (Grasps.empty(), Grasps([], [], [], []), Grasps.concatenate([])):
            assert len(none) == 0
            assert none.center.shape == (0, 2)
            assert none.corners().shape == (0, 4, 2)
            assert len(none.transformed(np.eye(3))) == 0

    @pytest.mark.parametrize(
        ("fields", "name"),
        [
            ({"center": [[1, 2, 3]]}, "center"),
            ({"center": [1, 2]}, "center"),
            ({"center": [[np.nan, 2]]}, "center"),
            ({"center": "here"}, "center"),
            ({"center": [[1, 2], [3]]}, "center"),
            ({"angle": [0, 1]}, "angle"),
            ({"angle": [np.inf]}, "angle"),
            ({"angle": None}, "angle"),
            ({"width": [-1]}, "width"),
            ({"width": ["wide"]}, "width"),
            ({"height": [-0.1]}, "height"),
            ({"height": [[1]]}, "height"),
            ({"quality": [np.nan]}, "quality"),
        ],
    )
    def test_refuses(self, fields, name):
        values = {"center": [[1, 2]], "angle": [0], "width": [3], "height": [4]} | fields
        with pytest.raises(InvalidInputError) as caught:
            Grasps(**values)
        assert name in caught.value.name

    def test_arrays_are_copies_that_cannot_be_written(self):
        center = np.array([[1.0, 2.0]])
        g = Grasps(center, [0], [1], [1])
        center[0, 0] = 99
        assert g.center[0, 0] == 1
        for array in (g.center, g.angle, g[0].width, g[:1].height, Grasps.concatenate([g]).quality):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 5

    def test_pickle_keeps_values_and_read_only(self):
        g = one(angle=0.3)
        back = pickle.loads(pickle.dumps(g))
        assert back == g
        assert not back.center.flags.writeable

    def test_replace(self):
        g = Grasps.concatenate([one(), one()]).replace(width=3, quality=[0.1, 0.2])
        assert g.width.tolist() == [3, 3]
        assert g.quality.tolist() == [0.1, 0.2]
        assert g.replace(center=[5, 6]).center.tolist() == [[5, 6], [5, 6]]
        with pytest.raises(InvalidInputError, match="colour"):
            g.replace(colour=1)
        with pytest.raises(InvalidInputError, match="width"):
            g.replace(width=-1)
        with pytest.raises(InvalidInputError, match="width"):
            g.replace(width=[1, 2, 3])


class TestIndexing:
    many = Grasps(np.arange(10.0).reshape(5, 2), np.zeros(5), np.arange(5.0), np.ones(5))

    @pytest.mark.parametrize(
        ("index", "widths"),
        [
            (1, [1]),
            (-1, [4]),
            (np.int64(2), [2]),
            (slice(1, 3), [1, 2]),
            (slice(None, None, 2), [0, 2, 4]),
            (slice(None, None, -1), [4, 3, 2, 1, 0]),
            ([3, 0], [3, 0]),
            ([], []),
            (np.array([True, False, False, True, False]), [0, 3]),
        ],
    )
    def test_chooses(self, index, widths):
        chosen = self.many[index]
        assert chosen.width.tolist() == widths
        assert chosen.center.shape == (len(widths), 2)
        assert chosen.center.flags.c_contiguous

    @pytest.mark.parametrize("index", [5, -6, [7]])
    def test_out_of_range(self, index):
        with pytest.raises(IndexError):
            self.many[index]

    def test_index_of_two_axes(self):
        with pytest.raises(InvalidInputError):
            self.many[np.zeros((2, 2), int)]

    def test_iteration_and_concatenation_are_inverse(self):
        assert Grasps.concatenate(self.many) == self.many
        assert Grasps.concatenate([Grasps.empty(), self.many, Grasps.empty()]) == self.many

    def test_equality_and_text(self):
        assert self.many != self.many[:2]
        assert self.many != 3
        assert repr(self.many) == "Grasps(5)"
        assert repr(one(angle=-HALF)).startswith("Grasps(x=10.00, y=20.00, angle=-90.0 deg")


class TestCorners:
    def test_axis_is_counter_clockwise_on_screen(self):
        # Angle +90 degrees points up, which is -y in an image; +45 up and to the right.
        assert one(angle=np.radians(45)).axis()[0] == pytest.approx([np.sqrt(0.5), -np.sqrt(0.5)])

    def test_order_is_as_in_the_figure_of_the_conventions(self):
        got = one(x=10, y=20, angle=0, width=8, height=4).corners()[0]
        assert got.tolist() == [[6, 18], [14, 18], [14, 22], [6, 22]]

    def test_first_edge_is_the_opening(self):
        corners = one(angle=0.4, width=8, height=4).corners()[0]
        assert np.linalg.norm(corners[1] - corners[0]) == pytest.approx(8)
        assert np.linalg.norm(corners[2] - corners[1]) == pytest.approx(4)

    @given(grasps())
    def test_round_trip(self, g):
        back = Grasps.from_corners(g.corners(), g.quality)
        assert back.center == pytest.approx(g.center, abs=1e-9)
        assert back.width == pytest.approx(g.width, abs=1e-9)
        assert back.height == pytest.approx(g.height, abs=1e-9)
        # The shorter the sides, the less a corner's rounding lets through of the direction.
        clear = g.width > 1e-3
        assert same_axis(back[clear], g[clear]) < 1e-8

    def test_zero_opening_keeps_its_direction(self):
        g = one(x=0, y=0, angle=0.3, width=0, height=4)
        back = Grasps.from_corners(g.corners())
        assert back.width[0] == 0
        assert same_axis(back, g) < 1e-12

    @given(grasps(count=st.just(1), size=st.floats(1, 500)), st.sampled_from([2, -1]))
    def test_reversed_and_rotated_order_give_the_same_grasp(self, g, change):
        corners = g.corners()[0]
        # From the opposite corner; or the other way round, the opening still first.
        other = np.roll(corners, 2, axis=0) if change == 2 else corners[[1, 0, 3, 2]]
        back = Grasps.from_corners(other[None])
        assert back.center == pytest.approx(g.center, abs=1e-9)
        assert back.width == pytest.approx(g.width)
        assert back.height == pytest.approx(g.height)
        assert same_axis(back, g) < 1e-9

    def test_from_the_next_corner_opening_and_jaw_change_places(self):
        g = one(angle=0.3)
        back = Grasps.from_corners(np.roll(g.corners()[0], -1, axis=0)[None])
        assert (back.width[0], back.height[0]) == pytest.approx((g.height[0], g.width[0]))
        assert angle_difference(back.angle, g.angle)[0] == pytest.approx(HALF)

    def test_uneven_rectangle_takes_the_mean_of_opposite_edges(self):
        g = Grasps.from_corners([[[0, 0], [10, 0], [12, 5], [0, 5]]])
        assert g.width[0] == 11
        assert g.angle[0] == 0

    @pytest.mark.parametrize(
        "corners", [np.zeros((4, 2)), np.zeros((1, 3, 2)), np.full((1, 4, 2), np.nan), [["a"]]]
    )
    def test_refuses(self, corners):
        with pytest.raises(InvalidInputError):
            Grasps.from_corners(corners)

    def test_no_corners(self):
        assert len(Grasps.from_corners([])) == 0


class TestTransformed:
    @given(grasps(size=st.floats(0.1, 500)), similarities())
    def test_commutes_with_transforming_the_corners(self, g, matrix):
        moved = g.transformed(matrix)
        direct = affine.apply(matrix, g.corners().reshape(-1, 2)).reshape(-1, 4, 2)
        through = moved.corners()
        scale = 1 + np.abs(direct).max()
        # A flip and a half turn name the corners in another order: compare as sets of points.
        distance = np.linalg.norm(direct[:, :, None] - through[:, None], axis=-1)
        assert distance.min(axis=2).max() < 1e-9 * scale
        assert distance.min(axis=1).max() < 1e-9 * scale
        back = Grasps.from_corners(direct)
        assert same_axis(back, moved) < 1e-7
        assert back.width == pytest.approx(moved.width, rel=1e-7)

    @given(grasps(), similarities(), similarities())
    def test_composes(self, g, first, second):
        step_by_step = g.transformed(first).transformed(second)
        at_once = g.transformed(second @ first)
        assert step_by_step.center == pytest.approx(at_once.center, rel=1e-9, abs=1e-6)
        assert step_by_step.width == pytest.approx(at_once.width, rel=1e-9)
        assert same_axis(step_by_step, at_once) < 1e-9

    @given(grasps(), similarities())
    def test_inverse_brings_back(self, g, matrix):
        back = g.transformed(matrix).transformed(np.linalg.inv(matrix))
        assert back.center == pytest.approx(g.center, abs=1e-6)
        assert back.height == pytest.approx(g.height, rel=1e-9, abs=1e-12)
        assert same_axis(back, g) < 1e-9

    @given(angles)
    def test_flip_changes_the_sign_of_the_angle(self, angle):
        flipped = one(angle=angle).transformed(affine.flip(100))
        assert angle_difference(flipped.angle, -angle)[0] < 1e-12
        assert flipped.center[0].tolist() == [89, 20]

    @given(angles, st.floats(-7, 7))
    def test_rotation_adds_to_the_angle(self, angle, turn):
        turned = one(angle=angle).transformed(affine.rotation(turn, (3, 4)))
        assert angle_difference(turned.angle, angle + turn)[0] < 1e-12

    @pytest.mark.parametrize("turns", range(4))
    def test_agrees_with_turning_the_pixels(self, turns):
        # np.rot90 turns counter-clockwise on screen, in whole pixels.
        image = np.zeros((9, 9))
        image[2, 7] = 1
        moved = np.argwhere(np.rot90(image, turns))[0][::-1]
        g = one(x=7, y=2, angle=0.1).transformed(affine.rotation(turns * HALF, (4, 4)))
        assert g.center[0] == pytest.approx(moved)
        assert angle_difference(g.angle, 0.1 + turns * HALF)[0] < 1e-12

    def test_flip_agrees_with_flipping_the_pixels(self):
        image = np.zeros((5, 8))
        image[3, 2] = 1
        moved = np.argwhere(image[:, ::-1])[0][::-1]
        assert one(x=2, y=3).transformed(affine.flip(8)).center[0].tolist() == moved.tolist()

    def test_zoom_scales_sizes(self):
        g = one(width=8, height=4, quality=0.3).transformed(affine.zoom(2.5))
        assert (g.width[0], g.height[0], g.quality[0]) == (20, 10, 0.3)

    @pytest.mark.parametrize("matrix", [np.diag([2, 1, 1]), [[1, 0.1, 0], [0, 1, 0]], np.eye(2)])
    def test_refuses_what_is_no_similarity(self, matrix):
        with pytest.raises(InvalidInputError):
            one().transformed(matrix)
