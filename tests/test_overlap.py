"""Exact overlap of rectangles, against GEOS (shapely) and closed forms."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.geometry import Grasps, affine, best_iou, intersection_area, pairwise_iou

HALF = np.pi / 2
CLOSE = 1e-12


def rectangle(x=0.0, y=0.0, angle=0.0, width=10.0, height=10.0):
    return Grasps([[x, y]], [angle], [width], [height])


def diagonal(a, b):
    """IoU of a[i] with b[i]."""
    return np.array([pairwise_iou(one, other)[0, 0] for one, other in zip(a, b, strict=True)])


def by_shapely(a, b):
    """IoU of a[i] with b[i] by GEOS, from corners relative to a's centre.

    Absolute corners would cost the oracle digits: at x = 1e6 a corner is good to 1e-10. Even so,
    GEOS 3.14 gives 0 for about three in 100,000 pairs that differ by 1e-16 to 1e-12 (none of
    those below); the closed forms cover what it cannot.
    """
    origin = np.zeros_like(a.center)
    one = shapely.polygons(a.replace(center=origin).corners())
    other = shapely.polygons(b.replace(center=b.center - a.center).corners())
    both = shapely.area(shapely.intersection(one, other))
    union = a.width * a.height + b.width * b.height - both
    return np.divide(both, union, out=np.zeros_like(both), where=both > 0)


angles = st.one_of(
    st.floats(-HALF, HALF), st.sampled_from([0.0, -HALF, np.pi / 4, -np.pi / 4, np.pi / 6, 1e-9])
)
sides = st.one_of(st.just(0.0), st.floats(0.1, 300), st.sampled_from([1.0, 8.0, 16.0, 100.0]))
centers = st.one_of(st.floats(-400, 400), st.integers(-20, 20).map(lambda n: 8.0 * n))
rectangles = st.builds(rectangle, centers, centers, angles, sides, sides)


@st.composite
def pairs(draw):
    """Two rectangles: unrelated, or the second a small or exact change of the first."""
    a = draw(rectangles)
    kind = draw(st.sampled_from(["any", "same", "near", "parallel", "touching", "far"]))
    if kind == "any":
        return a, draw(rectangles)
    if kind == "same":
        return a, a
    b = draw(rectangles)
    tiny = draw(st.sampled_from([0.0, 1e-15, -1e-13, 1e-10, 1e-7, -1e-4]))
    if kind == "near":
        return a, a.replace(center=a.center + tiny, angle=a.angle + tiny, width=a.width + abs(tiny))
    if kind == "parallel":
        return a, b.replace(angle=a.angle + tiny)
    if kind == "touching":
        reach = (a.width + b.width)[:, None] / 2
        return a, b.replace(center=a.center + a.axis() * reach, angle=a.angle)
    return a.replace(center=a.center + 1e6), b.replace(center=b.center + 1e6)


class TestAgainstShapely:
    @given(pairs())
    def test_one_pair(self, pair):
        a, b = pair
        assert abs(pairwise_iou(a, b)[0, 0] - by_shapely(a, b)[0]) < CLOSE

    @pytest.mark.parametrize("spread", [0.0, 1e-13, 1e-9, 1e-4, 1.0, 60.0])
    @pytest.mark.parametrize("shift", [0.0, 1e6])
    @pytest.mark.parametrize("thinnest", [0.1, 5.0])
    def test_many_pairs(self, spread, shift, thinnest):
        rng = np.random.default_rng(7)
        n = 300
        a = Grasps(
            rng.uniform(0, 320, (n, 2)) + shift,
            rng.uniform(-HALF, HALF, n),
            rng.uniform(5, 200, n),
            rng.uniform(thinnest, 2 * thinnest, n),
        )
        b = Grasps(
            a.center + rng.normal(0, 1, (n, 2)) * spread,
            a.angle + rng.normal(0, 1, n) * spread,
            np.abs(a.width + rng.normal(0, 1, n) * spread),
            np.abs(a.height + rng.normal(0, 1, n) * min(spread, thinnest)),
        )
        assert np.abs(diagonal(a, b) - by_shapely(a, b)).max() < CLOSE


class TestClosedForms:
    @given(st.floats(0.1, 50), st.floats(0.1, 50), st.floats(-60, 60), st.floats(-60, 60), angles)
    def test_parallel_rectangles_overlap_in_a_rectangle(self, width, height, u, v, angle):
        a = rectangle(angle=angle, width=20, height=30)
        b = rectangle(u, v, 0, width, height).transformed(affine.rotation(angle))
        inside_u = max(0.0, min(10, u + width / 2) - max(-10, u - width / 2))
        inside_v = max(0.0, min(15, v + height / 2) - max(-15, v - height / 2))
        assert intersection_area(a, b)[0, 0] == pytest.approx(inside_u * inside_v, abs=1e-11)

    def test_square_and_its_eighth_turn_share_an_octagon(self):
        a, b = rectangle(), rectangle(angle=np.pi / 4)
        octagon = 100 * 2 * (np.sqrt(2) - 1)
        assert intersection_area(a, b)[0, 0] == pytest.approx(octagon, abs=1e-12)
        assert pairwise_iou(a, b)[0, 0] == pytest.approx(octagon / (200 - octagon), abs=1e-15)

    @given(angles, st.one_of(st.floats(0, HALF), st.sampled_from([1e-16, 1e-14, 1e-12, 1e-9])))
    def test_square_turned_by_any_angle(self, angle, turn):
        # Also by so little that GEOS loses the overlap of some pairs altogether.
        a, b = rectangle(angle=angle), rectangle(angle=angle + turn)
        both = 200 / (1 + np.cos(turn) + np.sin(turn))
        assert pairwise_iou(a, b)[0, 0] == pytest.approx(both / (200 - both), abs=1e-14)

    @given(angles, st.sampled_from([0.0, 1e-16, 1e-14, 1e-12, 1e-9, 1e-5]), sides, sides)
    def test_shifted_by_little(self, angle, shift, width, height):
        a = rectangle(angle=angle, width=width + 1, height=height + 1)
        b = a.replace(center=a.axis() * shift)
        both = (width + 1 - shift) / (width + 1)
        assert pairwise_iou(a, b)[0, 0] == pytest.approx(both / (2 - both), abs=1e-13)

    @given(st.floats(0.01, HALF - 0.01), st.floats(0.01, 3), st.floats(0.01, 3))
    def test_crossing_strips_share_a_parallelogram(self, angle, thin, other):
        a, b = rectangle(width=1e4, height=thin), rectangle(angle=angle, width=1e4, height=other)
        area = intersection_area(a, b)[0, 0]
        assert area == pytest.approx(thin * other / np.sin(angle), rel=1e-11)

    @given(angles, st.floats(-5, 5), st.floats(-5, 5))
    def test_a_rectangle_inside_another(self, angle, x, y):
        inner, outer = rectangle(x, y, angle, 10, 4), rectangle(0, 0, 0.3, 100, 90)
        assert pairwise_iou(inner, outer)[0, 0] == pytest.approx(40 / 9000, abs=1e-16)

    @given(st.floats(1e-9, 10), angles)
    def test_thin_parallel_strips(self, width, angle):
        # Beyond what a clipper of absolute corners can tell apart: half a width aside.
        a = rectangle(angle=angle, width=width, height=100)
        b = a.replace(center=a.axis() * (width / 2))
        assert pairwise_iou(a, b)[0, 0] == pytest.approx(1 / 3, abs=1e-12)


class TestDegenerate:
    @given(rectangles)
    def test_identical_is_exactly_one(self, a):
        assert pairwise_iou(a, a)[0, 0] == (1.0 if a.width[0] * a.height[0] > 0 else 0.0)

    @pytest.mark.parametrize(("width", "height"), [(0, 5), (5, 0), (0, 0)])
    def test_without_area_overlaps_nothing(self, width, height):
        line = rectangle(width=width, height=height)
        for other in (line, rectangle(), rectangle(width=width, height=height, angle=1)):
            assert pairwise_iou(line, other)[0, 0] == 0
            assert pairwise_iou(other, line)[0, 0] == 0
            assert intersection_area(line, other)[0, 0] == 0

    @pytest.mark.parametrize(("x", "y"), [(10, 0), (0, -10), (10, 10), (-10, 3)])
    def test_touching_is_exactly_zero_on_the_grid(self, x, y):
        assert pairwise_iou(rectangle(), rectangle(x, y))[0, 0] == 0

    def test_touching_by_a_corner(self):
        tip = rectangle(5 + 5 * np.sqrt(2), 0, np.pi / 4)
        assert pairwise_iou(rectangle(), tip)[0, 0] < 1e-15

    @pytest.mark.parametrize("overlap", [1e-2, 1e-4])
    def test_corners_that_barely_meet(self, overlap):
        # The centres are then nearly as far apart as the circles about both reach.
        other = rectangle(10 - overlap, overlap - 10)
        assert intersection_area(rectangle(), other)[0, 0] == pytest.approx(overlap**2)

    def test_far_outside(self):
        far = rectangle(1e300, -1e300, 0.3)
        assert pairwise_iou(rectangle(), far)[0, 0] == 0

    @pytest.mark.parametrize("scale", [1e-200, 1e-160, 1e-30, 1e6, 1e30, 1e160, 1e200])
    def test_any_scale(self, scale):
        a, b = rectangle(1, 2, 0.3, 10, 5), rectangle(2, 1, -0.4, 7, 8)
        expected = pairwise_iou(a, b)[0, 0]
        a, b = (
            g.replace(center=g.center * scale, width=g.width * scale, height=g.height * scale)
            for g in (a, b)
        )
        assert pairwise_iou(a, b)[0, 0] == pytest.approx(expected, abs=1e-14)

    def test_reversed_corners(self):
        a = rectangle(3, 4, 0.5, 20, 8)
        backwards = Grasps.from_corners(a.corners()[:, [1, 0, 3, 2]])
        assert pairwise_iou(a, backwards)[0, 0] == pytest.approx(1, abs=1e-14)


class TestLaws:
    @given(pairs())
    def test_symmetric_and_bounded(self, pair):
        a, b = pair
        there, back = pairwise_iou(a, b)[0, 0], pairwise_iou(b, a)[0, 0]
        assert 0 <= there <= 1
        assert there == pytest.approx(back, abs=CLOSE)
        shared = intersection_area(a, b)[0, 0]
        assert 0 <= shared <= min(a.width * a.height, b.width * b.height)[0]

    @given(pairs())
    def test_a_quarter_turn_with_exchanged_sides_changes_nothing(self, pair):
        a, b = pair
        turned = Grasps(b.center, b.angle + HALF, b.height, b.width)
        assert pairwise_iou(a, turned) == pytest.approx(pairwise_iou(a, b), abs=CLOSE)

    @given(pairs(), st.floats(-4, 4), st.floats(0.2, 5), st.booleans())
    def test_moving_both_changes_nothing(self, pair, angle, factor, mirrored):
        a, b = pair
        # About a, lest the shift itself cost digits.
        about = tuple(a.center[0])
        m = affine.rotation(angle, about) @ affine.zoom(factor, about)
        m = affine.flip(320) @ m if mirrored else m
        moved = pairwise_iou(a.transformed(m), b.transformed(m))
        # Positions round at 1e6 pixels; the thinnest side here is 0.1 pixels.
        assert moved == pytest.approx(pairwise_iou(a, b), abs=1e-8)

    @given(st.lists(rectangles, max_size=4), st.lists(rectangles, max_size=4))
    def test_table_holds_every_pair(self, a, b):
        a, b = Grasps.concatenate(a), Grasps.concatenate(b)
        table = pairwise_iou(a, b)
        assert table.shape == (len(a), len(b))
        for i in range(len(a)):
            for j in range(len(b)):
                assert table[i, j] == pairwise_iou(a[i], b[j])[0, 0]


class TestBest:
    @given(
        st.lists(rectangles, max_size=3),
        st.lists(rectangles, max_size=6),
        st.sampled_from([0.0, 0.1, np.pi / 6, 1.0, HALF]),
    )
    def test_is_the_masked_maximum(self, a, b, max_turn):
        a, b = Grasps.concatenate(a), Grasps.concatenate(b)
        turn = np.abs(a.angle[:, None] - b.angle)
        fits = np.minimum(turn, np.pi - turn) <= max_turn
        expected = np.where(fits, pairwise_iou(a, b), 0).max(axis=1, initial=0)
        assert best_iou(a, b, max_turn).tolist() == expected.tolist()

    def test_wraps_at_the_vertical(self):
        up, almost = rectangle(angle=np.radians(89)), rectangle(angle=np.radians(-89))
        assert best_iou(up, almost, np.radians(1.9))[0] == 0
        assert best_iou(up, almost, np.radians(2.1))[0] > 0.9

    @pytest.mark.parametrize("max_turn", [-0.1, np.nan])
    def test_refuses(self, max_turn):
        with pytest.raises(InvalidInputError):
            best_iou(rectangle(), rectangle(), max_turn)


def test_threads_give_the_same_table():
    rng = np.random.default_rng(3)
    a = Grasps(
        rng.normal(0, 30, (60, 2)),
        rng.uniform(-1, 1, 60),
        rng.uniform(5, 50, 60),
        rng.uniform(5, 50, 60),
    )
    expected = pairwise_iou(a, a)
    with ThreadPoolExecutor(4) as pool:
        tables = list(pool.map(lambda _: pairwise_iou(a, a), range(16)))
    assert all(np.array_equal(table, expected) for table in tables)


def test_geometry_loads_numba_only_for_an_overlap():
    code = (
        "import sys; from graspmap.geometry import Grasps, pairwise_iou;"
        "assert 'numba' not in sys.modules; g = Grasps([[0, 0]], [0], [1], [1]);"
        "assert pairwise_iou(g, g)[0, 0] == 1; assert 'numba' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
