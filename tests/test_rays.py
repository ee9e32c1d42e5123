"""RayCaster: against crossing every triangle in double precision."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from studies._rays import RayCaster


def brute_force(triangles, origin, direction):
    """Distance and number of the first triangle, and how far from an edge it was hit.

    References:
        T. Moeller, B. Trumbore: Fast, minimum storage ray-triangle intersection. 1997.
    """
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(direction, second)
    det = (first * p).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = origin - triangles[:, 0]
        u = (t * p).sum(axis=1) / det
        q = np.cross(t, first)
        v = (q @ direction) / det
        distance = (second * q).sum(axis=1) / det
    edge = np.fmin(np.fmin(u, v), 1 - u - v)
    hit = (edge >= 0) & (distance > 0)
    if not hit.any():
        return np.inf, -1, np.nanmin(np.abs(edge))
    order = np.where(hit, distance, np.inf)
    return order.min(), int(order.argmin()), np.nanmin(np.abs(edge))


def scene(seed, count=20):
    rng = np.random.default_rng(seed)
    triangles = rng.uniform(-0.1, 0.1, (count, 1, 3)) + rng.uniform(-0.05, 0.05, (count, 3, 3))
    origins = rng.uniform(-0.3, 0.3, (40, 3)) + np.array([0, 0, 0.5])
    return triangles, origins, rng.uniform(-0.1, 0.1, (40, 3)) - origins


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_agrees_with_crossing_every_triangle(seed):
    triangles, origins, directions = scene(seed)
    caster = RayCaster(triangles)
    number = caster.first_hit(origins, directions)
    distance = caster.distances(origins, directions, number)
    for i in range(len(origins)):
        wanted, which, edge = brute_force(triangles, origins[i], directions[i])
        # Within single precision of an outline, either side is right.
        if edge > 1e-4:
            assert number[i] == which
            assert distance[i] == pytest.approx(wanted, rel=1e-9)


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_what_is_occluded_is_what_hits(seed):
    triangles, origins, directions = scene(seed)
    caster = RayCaster(triangles)
    hit = caster.first_hit(origins, directions) >= 0
    assert (caster.occluded(origins, directions) == hit).all()


def test_distance_is_in_lengths_of_the_direction():
    caster = RayCaster(np.array([[(0, 0, 0), (1, 0, 0), (0, 1, 0)]]))
    origins, down = np.array([[0.2, 0.2, 3.0]] * 2), np.array([[0, 0, -1.0], [0, 0, -2.0]])
    number = caster.first_hit(origins, down)
    assert number.tolist() == [0, 0]
    assert caster.distances(origins, down, number).tolist() == [3.0, 1.5]


def test_rays_that_miss_or_run_along_are_infinitely_far():
    caster = RayCaster(np.array([[(0, 0, 0), (1, 0, 0), (0, 1, 0)]]))
    origins, directions = (
        np.array([[5.0, 5.0, 1.0], [0, 0, 1]]),
        np.array([[0, 0, -1.0], [1, 0, 0]]),
    )
    assert caster.first_hit(origins, directions).tolist() == [-1, -1]
    assert caster.distances(origins, directions, np.array([-1, 0], np.int32)).tolist() == [
        np.inf,
        np.inf,
    ]
    assert caster.occluded(origins, directions).tolist() == [False, False]


def test_without_triangles_or_rays():
    nothing = RayCaster(np.zeros((0, 3, 3)))
    origins, down = np.zeros((2, 3)), np.array([[0, 0, -1.0]] * 2)
    assert nothing.first_hit(origins, down).tolist() == [-1, -1]
    assert nothing.occluded(origins, down).tolist() == [False, False]
    caster = RayCaster(np.eye(3)[None])
    assert caster.first_hit(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert caster.occluded(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
