"""Convex pieces of polygons: exact laws, and shapely as the oracle of the cover."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.simulation.procedural.extrusions import SHAPES as EXTRUSIONS
from graspmap.simulation.procedural.letters import GLYPHS, glyph
from graspmap.simulation.procedural.outline import Outline, circle, rounded
from graspmap.simulation.procedural.polygon_pieces import convex_polygons, triangulate
from graspmap.simulation.procedural.solid import GRID_M


def star(radii, scale=1.0):
    turns = np.linspace(0, 2 * np.pi, len(radii), endpoint=False)
    return scale * np.array(radii)[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])


radii = st.lists(st.floats(0.02, 0.15), min_size=5, max_size=24)
stars = st.builds(lambda r: shapely.Polygon(star(r)), radii)
# Corners that meet, lie on one line or nearly do: what cuts of plates are made of.
boxes = st.builds(
    lambda x, y, w, h: shapely.box(x / 100, y / 100, (x + w) / 100, (y + h) / 100),
    *[st.integers(0, 9)] * 2,
    *[st.integers(1, 9)] * 2,
)
unions = st.lists(boxes, min_size=1, max_size=7).map(shapely.union_all)
holed = st.builds(
    lambda r, hole, at: shapely.Polygon(star(r)).difference(circle(hole, at, hole=True)),
    st.lists(st.floats(0.06, 0.15), min_size=6, max_size=16),
    st.floats(0.004, 0.03),
    st.tuples(*[st.floats(-0.01, 0.01)] * 2),
)


def exact_turn(a, b, c):
    """Sign of the turn at b, in whole numbers of the grid: no rounding."""
    (ax, ay), (bx, by), (cx, cy) = ((round(x / GRID_M), round(y / GRID_M)) for x, y in (a, b, c))
    return (bx - ax) * (cy - by) - (by - ay) * (cx - bx)


def check(outline):
    whole = shapely.Polygon(outline.loops[0], outline.loops[1:])
    pieces = outline.pieces()
    corners = {tuple(p) for loop in outline.loops for p in loop.tolist()}
    for piece in pieces:
        around = [*piece.tolist(), *piece[:2].tolist()]
        turns = [exact_turn(*around[i : i + 3]) for i in range(len(piece))]
        assert min(turns) >= 0
        assert {tuple(p) for p in piece.tolist()} <= corners
        # Once round, and not twice.
        steps = [np.subtract(b, a) for a, b in pairwise(around)]
        angles = [np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v) for u, v in pairwise(steps)]
        assert sum(angles) == pytest.approx(2 * np.pi)
    polygons = [shapely.Polygon(p) for p in pieces]
    assert sum(p.area for p in polygons) == pytest.approx(whole.area, abs=1e-9)
    assert shapely.union_all(polygons).symmetric_difference(whole).area < 1e-9
    return whole, pieces


@settings(max_examples=60, deadline=None)
@given(st.one_of(stars, unions, holed))
def test_pieces_are_convex_disjoint_and_cover_the_polygon(shape):
    whole, pieces = check(Outline.of(shape))
    # Hertel and Mehlhorn: each reflex corner needs at most two diagonals.
    loops = [np.asarray(ring.coords)[:-1] for ring in (whole.exterior, *whole.interiors)]
    signs = [1 if shapely.LinearRing(loop).is_ccw else -1 for loop in loops]
    signs = [signs[0], *(-s for s in signs[1:])]
    reflex = sum(
        exact_turn(loop[i - 2], loop[i - 1], loop[i]) * sign < 0
        for loop, sign in zip(loops, signs, strict=True)
        for i in range(len(loop))
    )
    assert len(pieces) <= 2 * reflex + 1


def test_a_convex_polygon_is_one_piece():
    assert len(Outline.of(circle(0.1)).pieces()) == 1


def test_few_pieces():
    wide, arm = 0.1, 0.02
    cross = shapely.union_all(
        [shapely.box(-wide, -arm, wide, arm), shapely.box(-arm, -wide, arm, wide)]
    )
    assert len(Outline.of(cross).pieces()) == 3
    ell = shapely.union_all([shapely.box(0, 0, wide, arm), shapely.box(0, 0, arm, wide)])
    assert len(Outline.of(ell).pieces()) == 2


@given(st.one_of(stars, unions, holed))
@settings(max_examples=20, deadline=None)
def test_the_triangulation_uses_every_corner(shape):
    loops = Outline.of(shape).loops
    count = sum(map(len, loops))
    triangles = triangulate(loops)
    assert set(triangles.ravel().tolist()) == set(range(count))
    assert len(triangles) == count + 2 * (len(loops) - 1) - 2  # Euler


def test_pieces_of_loops_as_given():
    square = np.array([(0, 0), (0.5, 0), (0.5, 0.5), (0, 0.5)])
    hole = np.array([(0.125, 0.125), (0.125, 0.25), (0.25, 0.25), (0.25, 0.125)])
    pieces = convex_polygons([square, hole])
    assert sum(shapely.Polygon(p).area for p in pieces) == 0.25 - 0.125**2


class TestOutline:
    @pytest.mark.parametrize("character", sorted(GLYPHS))
    def test_every_character_is_one_sound_shape(self, character):
        shape = glyph(character, 0.8)
        assert shape.geom_type == "Polygon"
        assert shape.is_valid
        left, low, right, high = shape.bounds
        assert 6.7 < high - low < 7.7  # mitres stand out at sharp tips
        assert right - left < 7.5
        holes = {"A": 1, "B": 2, "D": 1, "O": 1, "P": 1, "Q": 1, "R": 1, "8": 2, "0": 1}
        holes |= {"4": 1, "6": 1, "9": 1}
        assert len(shape.interiors) == holes.get(character, 0)

    def test_all_letters_and_digits_are_there(self):
        assert "".join(sorted(GLYPHS)) == "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
        assert "letter" in EXTRUSIONS

    @given(st.floats(0.004, 0.2))
    def test_circles_are_true_to_the_tolerance(self, radius):
        for hole, off in ((False, 0.000125), (True, 0.0005)):
            corners = np.asarray(circle(radius, hole=hole).exterior.coords)
            middles = (corners[1:] + corners[:-1]) / 2
            assert np.hypot(*corners.T).max() - radius < off + 1e-12
            assert radius - np.hypot(*middles.T).min() < off + 1e-12

    def test_rounding_takes_away_and_only_at_convex_corners(self):
        ell = shapely.union_all([shapely.box(0, 0, 1, 0.3), shapely.box(0, 0, 0.3, 1)])
        soft = rounded(ell, 0.1)
        assert ell.buffer(1e-12).contains(soft)
        assert soft.distance(shapely.Point(0.3, 0.3)) < 1e-9
        assert soft.distance(shapely.Point(0, 0)) == pytest.approx(0.1 * (2**0.5 - 1), abs=2e-3)

    @given(st.one_of(stars, holed), st.floats(0.002, 0.1))
    @settings(max_examples=15, deadline=None)
    def test_a_plate_has_the_volume_of_its_outline(self, shape, thickness):
        from graspmap.simulation.solids import mass_properties, open_edges

        outline = Outline.of(shape)
        plate = outline.plate(thickness)
        area = shapely.Polygon(outline.loops[0], outline.loops[1:]).area
        assert open_edges(plate.vertices, plate.faces) == 0
        found = mass_properties(plate.vertices, plate.faces).volume_m3
        assert found == pytest.approx(area * thickness, rel=1e-5)
