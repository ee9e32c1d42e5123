"""How procedural solids are made: closed forms, hulls by another library, bounded deviations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.special import beta

from graspmap.simulation.procedural.blob_pieces import pieces_by_cuts
from graspmap.simulation.procedural.convex import convex, split
from graspmap.simulation.procedural.primitives import ball, block, cylinder, ellipsoid, rod
from graspmap.simulation.procedural.revolve import arc, revolve, revolve_ring
from graspmap.simulation.procedural.solid import (
    MOST_VERTICES,
    TOLERANCE_M,
    join,
    rotation,
    snap,
    volume,
)
from graspmap.simulation.procedural.superquadrics import superquadric
from graspmap.simulation.procedural.sweep import bend, flat_bar, oval, sweep
from graspmap.simulation.solids import open_edges

lengths = st.floats(0.01, 0.1)


def size(solid):
    assert open_edges(solid.vertices, solid.faces) == 0
    return volume(solid.vertices, solid.faces)


def inside_depth(points, pieces):
    """(N,) how far each point lies inside the union of hulls, as qhull sees them; < 0 outside."""
    depth = np.full(len(points), -np.inf)
    for piece in pieces:
        planes = ConvexHull(piece).equations
        depth = np.maximum(depth, -(points @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return depth


class TestConvex:
    @settings(max_examples=6, deadline=None)
    @given(lengths, lengths, lengths)
    def test_volumes_of_round_bodies(self, a, b, c):
        assert size(ellipsoid(a, b, c)) == pytest.approx(4 / 3 * math.pi * a * b * c, rel=0.05)
        assert size(block(a, b, c)) == pytest.approx(a * b * c, rel=1e-5)
        frustum = math.pi * c / 3 * (a * a + a * b + b * b)
        assert size(cylinder(a, c, b)) == pytest.approx(frustum, rel=0.005)
        straight = math.pi * a * a * 2 * c + 4 / 3 * math.pi * a**3
        assert size(rod(a, 2 * a + 2 * c)) == pytest.approx(straight, rel=0.05)

    @settings(max_examples=4, deadline=None)
    @given(*[st.floats(0.02, 0.1)] * 3, *[st.floats(0.25, 1.9)] * 2)
    def test_superquadrics_have_barrs_volume(self, a, b, c, upright, around):
        first = beta(upright / 2 + 1, upright) * upright
        second = beta(around / 2, around / 2) * around
        expected = 2 * a * b * c * first * second
        assert size(superquadric((a, b, c), upright, around)) == pytest.approx(expected, rel=0.03)

    @settings(max_examples=5, deadline=None)
    @given(st.integers(0, 10**6), st.floats(0.01, 0.08))
    def test_split_loses_at_most_the_tolerance(self, seed, radius):
        points = np.random.default_rng(seed).normal(size=(700, 3))
        points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
        points[:, 0] *= 1.5
        pieces = split(points)
        assert max(map(len, pieces)) <= MOST_VERTICES
        assert inside_depth(snap(points), pieces).min() > -TOLERANCE_M - 1e-7
        # And nothing is added.
        whole = [ConvexHull(snap(points)).points]
        assert inside_depth(np.concatenate(pieces), whole).min() > -1e-6

    def test_what_is_small_enough_stays_as_it_is(self):
        solid = block(0.1, 0.2, 0.3)
        assert len(solid.pieces) == 1
        assert sorted(map(tuple, solid.pieces[0])) == sorted(map(tuple, solid.vertices))


class TestRevolve:
    @settings(max_examples=15, deadline=None)
    @given(lengths, st.floats(0.2, 0.9), lengths)
    def test_tube_and_torus(self, outer, share, high):
        inner = outer * share
        tube = revolve_ring([(inner, 0), (outer, 0), (outer, high), (inner, high)])
        assert size(tube) == pytest.approx(math.pi * (outer**2 - inner**2) * high, rel=0.01)
        small = 0.3 * outer
        # Pappus: the area of the section (a 12-gon) times the way of its middle.
        section = [(outer + r, z) for r, z in oval(small, small)]
        area = 12 / 2 * small**2 * math.sin(2 * math.pi / 12)
        expected = 2 * math.pi * outer * area
        assert size(revolve_ring(section)) == pytest.approx(expected, rel=0.01)

    @settings(max_examples=15, deadline=None)
    @given(lengths, st.floats(0.3, 3))
    def test_a_cup_is_a_cylinder_less_a_cylinder(self, radius, ratio):
        high, wall = radius * ratio, radius / 5
        cup = revolve(
            [(radius, 0), (radius, high)], [(radius - wall, high / 4), (radius - wall, high)]
        )
        expected = math.pi * (radius**2 * high - (radius - wall) ** 2 * high * 0.75)
        assert size(cup) == pytest.approx(expected, rel=0.02)
        # Inside the cavity there is nothing, in the wall and the floor there is something.
        t = np.linspace(0, 2 * math.pi, 50)
        around = np.column_stack([np.cos(t), np.sin(t), np.zeros(50)])
        hole = around * (radius - wall - 0.0009) * 0.999 + (0, 0, 0.6 * high)
        wall_points = around * (radius - wall / 2) * 0.999 + (0, 0, 0.6 * high)
        floor = around * radius / 2 + (0, 0, high / 8)
        assert inside_depth(hole, cup.pieces).max() < 0
        assert inside_depth(wall_points, cup.pieces).min() > -TOLERANCE_M
        assert inside_depth(floor, cup.pieces).min() > 0

    def test_a_ball_is_a_half_circle_turned(self):
        solid = revolve(arc((0, 0.05), (0.05, 0.05), -90, 90, 24))
        assert size(solid) == pytest.approx(4 / 3 * math.pi * 0.05**3, rel=0.02)


class TestSweep:
    @settings(max_examples=5, deadline=None)
    @given(st.floats(0.02, 0.1), st.floats(0.05, 0.4), st.floats(0.3, 1))
    def test_closed_ring_is_a_torus(self, radius, share, flat):
        a, b = radius * share, radius * share * flat
        path = bend((0, 0, 0), (radius, 0, 0), (0, radius, 0), 0, 360, 48)[:-1]
        solid = sweep(path, oval(a, b, 24), (0, 0, 1), closed=True)
        assert size(solid) == pytest.approx(2 * math.pi * radius * math.pi * a * b, rel=0.03)
        assert inside_depth(solid.vertices, solid.pieces).min() > -1e-7

    def test_straight_bar_is_a_prism_in_one_piece(self):
        path = [(0, 0, 0), (0.05, 0, 0), (0.1, 0, 0)]
        solid = sweep(path, flat_bar(0.01, 0.02, 0), (0, 0, 1))
        assert size(solid) == pytest.approx(0.1 * 0.01 * 0.02, rel=1e-5)
        assert len(solid.pieces) == 1

    def test_a_bent_strip_does_not_fill_its_hollow(self):
        """Its flat ends hide the hollow from whoever looks at corners only."""
        path = bend((0, 0, 0), (0.05, 0, 0), (0, 0.05, 0), -90, 90, 24)
        gutter = sweep(
            path, [(0.001, -0.1), (0.001, 0.1), (-0.001, 0.1), (-0.001, -0.1)], (0, 0, 1)
        )
        middle = np.column_stack([np.linspace(0, 0.0485, 20), np.zeros((20, 2))])
        assert inside_depth(middle, gutter.pieces).max() < 0


class TestSolid:
    def test_join_is_a_union(self):
        one, other = block(0.1, 0.1, 0.1), block(0.1, 0.1, 0.1).moved(x=0.06)
        both = join([one, other])
        assert size(both) == pytest.approx(0.16 * 0.01, rel=1e-5)
        assert len(both.pieces) == 2

    def test_a_mirror_keeps_its_faces_outwards(self):
        solid = cylinder(0.02, 0.1).stretched(x=-1)
        assert size(solid) > 0

    @given(st.sampled_from("xyz"), st.floats(-7, 7))
    def test_turning(self, axis, angle):
        from scipy.spatial.transform import Rotation

        expected = Rotation.from_euler(axis, angle).as_matrix()
        assert rotation(axis, angle) == pytest.approx(expected, abs=1e-12)

    @given(st.lists(st.floats(-1, 1), min_size=3, max_size=3))
    def test_the_grid_is_finer_than_anything_seen_and_keeps_what_is_on_it(self, point):
        once = snap(point)
        assert np.abs(once - point).max() <= 2.0**-27
        assert (snap(once) == once).all()
        # A last bit more or less gives the same point, but on the very border.
        assert np.abs(snap(np.nextafter(point, 2)) - once).max() <= 2.0**-26


def test_cuts_follow_a_ring_without_filling_it():
    path = bend((0, 0, 0), (0.04, 0, 0), (0, 0.04, 0), 0, 360, 40)[:-1]
    ring = sweep(path, oval(0.012, 0.012, 16), (0, 0, 1), closed=True)
    pieces = pieces_by_cuts(ring.vertices, ring.faces, 0.0015, 40)
    assert inside_depth(ring.vertices, pieces).min() > -TOLERANCE_M
    hole = np.array([(0, 0, 0), (0.02, 0, 0), (0, -0.02, 0.003)])
    assert inside_depth(hole, pieces).max() < 0
    hulls = sum(ConvexHull(p).volume for p in pieces)
    assert hulls == pytest.approx(size(ring), rel=0.12)


def test_a_convex_body_is_not_cut():
    solid = convex(ball(0.03).vertices)
    assert len(pieces_by_cuts(solid.vertices, solid.faces, 0.001, 20)) == len(split(solid.vertices))
