"""Rigid transforms: the laws of the group, SciPy as the oracle, and the fit to point pairs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspmap.errors import InvalidInputError
from graspmap.geometry import RigidTransform

metres = st.floats(-5, 5)
vectors = st.tuples(metres, metres, metres)
turns = st.one_of(
    vectors,
    # Half turns, where a quaternion's scalar vanishes.
    st.sampled_from([(np.pi, 0, 0), (0, np.pi, 0), (0, 0, -np.pi), (0, 0, 0)]),
)
transforms = st.builds(
    lambda turn, shift: RigidTransform(Rotation.from_rotvec(turn).as_matrix(), shift),
    turns,
    vectors,
)
clouds = st.lists(vectors, min_size=1, max_size=6)


def close(a, b, tolerance=1e-9):
    return np.abs(a.matrix - b.matrix).max() < tolerance


class TestGroup:
    @given(transforms, transforms, clouds)
    def test_product_applies_the_right_one_first(self, T_a_b, T_b_c, cloud):
        T_a_c = T_a_b @ T_b_c
        assert T_a_c.apply(cloud) == pytest.approx(T_a_b.apply(T_b_c.apply(cloud)), abs=1e-9)
        assert T_a_c.matrix == pytest.approx(T_a_b.matrix @ T_b_c.matrix, abs=1e-9)

    @given(transforms, transforms, transforms)
    def test_associative(self, a, b, c):
        assert close((a @ b) @ c, a @ (b @ c))

    @given(transforms)
    def test_inverse_and_identity(self, a):
        one = RigidTransform.identity()
        assert close(a @ a.inverse(), one)
        assert close(a.inverse() @ a, one)
        assert a @ one == a
        assert close(a.inverse().inverse(), a)
        assert a.inverse().matrix == pytest.approx(np.linalg.inv(a.matrix), abs=1e-9)

    @given(transforms, vectors, vectors)
    def test_keeps_distances_and_hands(self, a, p, q):
        moved = a.apply([p, q])
        assert np.linalg.norm(moved[1] - moved[0]) == pytest.approx(
            np.linalg.norm(np.subtract(q, p)), abs=1e-9
        )
        assert np.linalg.det(a.rotation) == pytest.approx(1)

    def test_columns_are_the_axes_of_b_seen_from_a(self):
        T_a_b = RigidTransform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3])
        assert T_a_b.apply([(0, 0, 0), (1, 0, 0)]).tolist() == [[1, 2, 3], [1, 3, 3]]

    def test_apply_takes_any_leading_axes_and_keeps_nan(self):
        T = RigidTransform.identity()
        assert T.apply([1, 2, 3]).tolist() == [1, 2, 3]
        assert T.apply(np.zeros((4, 5, 3))).shape == (4, 5, 3)
        assert np.isnan(T.apply([(np.nan, 0, 0)])[0, 0])

    def test_a_long_chain_stays_a_rotation(self):
        step = RigidTransform(Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), [0, 0, 0])
        chain = RigidTransform.identity()
        for _ in range(2000):
            chain = chain @ step
        assert np.abs(chain.rotation @ chain.rotation.T - np.eye(3)).max() < 1e-13


class TestConversions:
    @given(transforms)
    def test_quaternion_round_trip(self, a):
        q = a.quaternion()
        assert np.linalg.norm(q) == pytest.approx(1)
        assert q[3] >= 0
        assert close(RigidTransform.from_quaternion(q, a.translation), a)

    @given(transforms)
    def test_quaternion_agrees_with_scipy(self, a):
        expected = Rotation.from_matrix(a.rotation).as_quat()
        # Both signs mean the same rotation.
        assert abs(a.quaternion() @ expected) == pytest.approx(1, abs=1e-12)
        assert RigidTransform.from_quaternion(expected).rotation == pytest.approx(
            a.rotation, abs=1e-9
        )

    @given(transforms)
    def test_matrix_round_trip(self, a):
        assert RigidTransform.from_matrix(a.matrix) == a
        assert RigidTransform.from_matrix(a.matrix[:3]) == a

    def test_rounded_rotation_becomes_a_true_one(self):
        exact = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
        T = RigidTransform(np.round(exact, 5), [0, 0, 0])
        assert np.abs(T.rotation @ T.rotation.T - np.eye(3)).max() < 1e-14
        assert pytest.approx(exact, abs=2e-5) == T.rotation

    @pytest.mark.parametrize(
        "rotation",
        [
            np.diag([1, 1, -1]),
            2 * np.eye(3),
            np.zeros((3, 3)),
            np.full((3, 3), np.nan),
            np.eye(4),
            [[1, 0, 0], [0, 1, 0.01], [0, 0, 1]],
            "upright",
        ],
    )
    def test_refuses_a_rotation(self, rotation):
        with pytest.raises(InvalidInputError, match="rotation"):
            RigidTransform(rotation, [0, 0, 0])

    @pytest.mark.parametrize("translation", [[1, 2], [[1, 2, 3]], [1, 2, np.inf]])
    def test_refuses_a_translation(self, translation):
        with pytest.raises(InvalidInputError, match="translation"):
            RigidTransform(np.eye(3), translation)

    @pytest.mark.parametrize("q", [[0, 0, 0, 0], [1, 1, 1, 1], [0, 0, 1], [np.nan, 0, 0, 1]])
    def test_refuses_a_quaternion(self, q):
        with pytest.raises(InvalidInputError, match="quaternion"):
            RigidTransform.from_quaternion(q)

    @pytest.mark.parametrize("matrix", [np.eye(3), np.diag([1, 1, 1, 2]), np.zeros((4, 4))])
    def test_refuses_a_matrix(self, matrix):
        with pytest.raises(InvalidInputError):
            RigidTransform.from_matrix(matrix)

    def test_values_cannot_be_changed(self):
        T = RigidTransform.identity()
        with pytest.raises(ValueError, match="read-only"):
            T.rotation[0, 0] = 2
        assert T != 3
        with pytest.raises(TypeError):
            T @ np.eye(4)
        with pytest.raises(TypeError):
            np.eye(4) @ T

    def test_refuses_points(self):
        with pytest.raises(InvalidInputError, match="points"):
            RigidTransform.identity().apply([(1, 2)])


class TestFit:
    @given(transforms, st.integers(3, 20), st.integers(0, 999))
    def test_recovers_the_transform(self, T_b_a, count, seed):
        points_a = np.random.default_rng(seed).normal(size=(count, 3))
        assert close(RigidTransform.fit(points_a, T_b_a.apply(points_a)), T_b_a, 1e-8)

    @given(transforms)
    def test_points_in_a_plane_give_no_mirror_image(self, T_b_a):
        points_a = np.array([(0, 0, 0), (1, 0, 0), (0, 2, 0), (1, 1, 0)], float)
        assert close(RigidTransform.fit(points_a, T_b_a.apply(points_a)), T_b_a, 1e-8)

    def test_agrees_with_scipy_on_noisy_points(self):
        rng = np.random.default_rng(5)
        a = rng.normal(size=(30, 3))
        noise = rng.normal(0, 0.05, a.shape)
        b = Rotation.from_rotvec([1, 2, 0.5]).apply(a) + np.array([1, 2, 3]) + noise
        T_b_a = RigidTransform.fit(a, b)
        expected, _ = Rotation.align_vectors(b - b.mean(0), a - a.mean(0))
        assert T_b_a.rotation == pytest.approx(expected.as_matrix(), abs=1e-9)

    def test_is_the_least_of_squares(self):
        rng = np.random.default_rng(6)
        a = rng.normal(size=(10, 3))
        b = a + rng.normal(0, 0.1, a.shape)
        best = RigidTransform.fit(a, b)
        least = ((best.apply(a) - b) ** 2).sum()
        for _ in range(50):
            nudge = RigidTransform(
                Rotation.from_rotvec(rng.normal(0, 0.01, 3)).as_matrix(), rng.normal(0, 0.01, 3)
            )
            assert (((nudge @ best).apply(a) - b) ** 2).sum() > least

    @pytest.mark.parametrize(
        ("points", "problem"),
        [
            (np.eye(3)[:2], "number of point pairs"),
            (np.outer(np.arange(5), [1, 2, 3]), "one line"),
            (np.zeros((5, 3)), "one line"),
            (np.zeros((5, 2)), "shapes"),
            (np.full((4, 3), np.nan), "NaN"),
        ],
    )
    def test_refuses(self, points, problem):
        with pytest.raises(InvalidInputError, match=problem):
            RigidTransform.fit(points, points)

    def test_refuses_unequal_numbers(self):
        with pytest.raises(InvalidInputError, match="shapes"):
            RigidTransform.fit(np.eye(3), np.zeros((4, 3)))

    def test_refuses_when_only_the_second_lies_on_a_line(self):
        line = np.outer(np.arange(3), [1, 2, 3])
        with pytest.raises(InvalidInputError, match="points_b"):
            RigidTransform.fit(np.eye(3), line)
