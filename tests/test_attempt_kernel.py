"""The compiled looks at MuJoCo's state, against NumPy and against motion itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.simulation._attempt_kernel import in_hand, motion, pinch, press, touches_table

# Table, two pieces of object 0, one of object 1, palm, right and left finger.
OWNER = np.array([-1, 0, 0, 1, -1, -1, -1])
FINGER = np.array([-1, -1, -1, -1, -1, 0, 1])
CONTACTS = st.lists(
    st.tuples(st.integers(0, 6), st.integers(0, 6), st.booleans(), st.floats(-1, 1)), max_size=12
)


def arrays(contacts):
    """Geometries, addresses, forces and places of contacts, strided as MuJoCo's are."""
    pairs = np.zeros((len(contacts), 5), dtype=np.int32)
    pairs[:, :2] = np.reshape([c[:2] for c in contacts], (-1, 2))
    address = np.where([c[2] for c in contacts], 2 * np.arange(len(contacts)), -1)
    places = np.random.default_rng(len(contacts)).normal(size=(len(contacts), 3))
    force = np.zeros(2 * len(contacts) + 1)
    force[: 2 * len(contacts) : 2] = [c[3] for c in contacts]
    return pairs[:, :2], address.astype(np.int32), force, places


@given(CONTACTS)
def test_what_touches_what(contacts):
    pairs, address, force, places = arrays(contacts)
    side = FINGER[pairs].max(axis=1, initial=-1)
    index = OWNER[pairs].max(axis=1, initial=-1)
    out, expected = np.zeros((2, 2)), np.zeros((2, 2))
    press(pairs, address, force, FINGER, OWNER, out)
    active = (side >= 0) & (index >= 0) & (address >= 0)
    np.add.at(expected, (side[active], index[active]), force[address[active]])
    np.testing.assert_allclose(out, expected, atol=1e-12)
    for number in (0, 1):
        on_table = (pairs == 0).any(axis=1) & (OWNER[pairs] == number).any(axis=1)
        assert touches_table(pairs, OWNER, number) == on_table.any()
        middle = np.full(3, 7.0)
        touched = [places[(index == number) & (side == s)] for s in (0, 1)]
        means = [some.mean(axis=0) for some in touched if len(some)]
        assert pinch(pairs, places, FINGER, OWNER, number, middle) == bool(means)
        np.testing.assert_allclose(middle, np.mean(means, axis=0) if means else 7.0)


@pytest.mark.parametrize("seed", range(5))
def test_motion_is_the_change_of_place(seed):
    """Speed against a small step of time; slip against the matrix product."""
    rng = np.random.default_rng(seed)
    position, velocity, spin, point, place = rng.normal(size=(5, 3))
    base, base_speed, step = rng.normal(), rng.normal(), 1e-6

    def rotation(vector):
        angle = np.linalg.norm(vector)
        x, y, z = vector / angle
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k

    turn = rotation(rng.normal(size=3))
    places = []
    for sign in (-0.5, 0.5):
        dt = sign * step
        now = np.empty(3)
        later = turn @ rotation(spin * dt)  # about the object's own axes
        in_hand(position + velocity * dt, later.ravel(), point, base + base_speed * dt, now)
        places.append(now)
    slip, speed, turning = motion(
        position, turn.ravel(), np.r_[velocity, spin], point, (base, base_speed), place
    )
    assert speed == pytest.approx(np.linalg.norm(places[1] - places[0]) / step, rel=1e-6)
    assert turning == np.abs(spin).max()
    now = position + turn @ point - [0, 0, base]
    assert slip == pytest.approx(np.linalg.norm(now - place), rel=1e-12)
