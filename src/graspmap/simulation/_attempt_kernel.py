"""Compiled looks at MuJoCo's state, taken every 20 ms; imported with the first attempt.

Letters in shapes: G geometries, N contacts, B objects.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Numbers = NDArray[np.intp]
Pairs = NDArray[np.int32]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def press(
    pairs: Pairs, address: Pairs, force: Floats, finger: Numbers, owner: Numbers, out: Floats
) -> None:
    """Add up the normal forces of the fingers on the objects.

    Args:
        pairs: (N, 2) geometries that touch.
        address: (N,) where each contact's forces begin, -1 where it has none.
        force: Forces of all constraints, newton.
        finger: (G,) 0 for the right finger, 1 for the left, -1 for all else.
        owner: (G,) number of the object, -1 for table and gripper.
        out: (2, B) in and out.
    """
    for n in range(len(pairs)):
        one, other = pairs[n]
        side, index = max(finger[one], finger[other]), max(owner[one], owner[other])
        if side >= 0 and index >= 0 and address[n] >= 0:
            out[side, index] += force[address[n]]


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def touches_table(pairs: Pairs, owner: Numbers, index: int) -> bool:
    """Whether geometry 0, the table, touches an object.

    Args:
        pairs: (N, 2) geometries that touch.
        owner: (G,) number of the object, -1 for table and gripper.
        index: Number of the object.
    """
    for n in range(len(pairs)):
        one, other = pairs[n]
        if (one == 0 and owner[other] == index) or (other == 0 and owner[one] == index):
            return True
    return False


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def pinch(
    pairs: Pairs, places: Floats, finger: Numbers, owner: Numbers, index: int, out: Floats
) -> bool:
    """Middle between where the two fingers touch an object: the mean of each one's contacts.

    Args:
        pairs: (N, 2) geometries that touch.
        places: (N, 3) where, metres.
        finger: (G,) 0 for the right finger, 1 for the left, -1 for all else.
        owner: (G,) number of the object, -1 for table and gripper.
        index: Number of the object.
        out: (3,) the middle; as it was where neither touches.

    Returns:
        Whether one of them touches.
    """
    total, count = np.zeros((2, 3)), np.zeros(2)
    for n in range(len(pairs)):
        one, other = pairs[n]
        side = max(finger[one], finger[other])
        if side >= 0 and max(owner[one], owner[other]) == index:
            total[side] += places[n]
            count[side] += 1
    touching = 0
    middle = np.zeros(3)
    for side in range(2):
        if count[side]:
            middle += total[side] / count[side]
            touching += 1
    if touching:
        out[:] = middle / touching
    return touching > 0


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def in_hand(position: Floats, turn: Floats, point: Floats, base_m: float, out: Floats) -> None:
    """Where a point of an object is, seen from the gripper.

    Args:
        position: (3,) place of the object, metres.
        turn: (9,) its orientation, rows of a rotation.
        point: (3,) in the object's frame, metres.
        base_m: Height of the gripper.
        out: (3,) in the gripper's frame, metres.
    """
    for row in range(3):
        out[row] = position[row]
        for column in range(3):
            out[row] += turn[3 * row + column] * point[column]
    out[2] -= base_m


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator, unused-ignore]
def motion(
    position: Floats,
    turn: Floats,
    speeds: Floats,
    point: Floats,
    base: tuple[float, float],
    place: Floats,
) -> Any:
    """How a point of an object moves in the hand.

    Args:
        position: (3,) place of the object, metres.
        turn: (9,) its orientation, rows of a rotation.
        speeds: (6,) of the object: along the world's axes, about its own (as MuJoCo has a free
            body's), m/s and rad/s.
        point: (3,) in the object's frame, metres.
        base: Height of the gripper and its speed, m and m/s.
        place: (3,) where the point was in the hand, metres.

    Returns:
        How far it has moved, metres; its speed, m/s; the greatest speed of turning about one of
        the object's axes, rad/s.
    """
    wx, wy, wz = speeds[3], speeds[4], speeds[5]
    x, y, z = point
    across = (wy * z - wz * y, wz * x - wx * z, wx * y - wy * x)
    now = np.empty(3)
    in_hand(position, turn, point, base[0], now)
    slip = speed = 0.0
    for row in range(3):
        slip += (now[row] - place[row]) ** 2
        rate = speeds[row] - (base[1] if row == 2 else 0.0)
        for column in range(3):
            rate += turn[3 * row + column] * across[column]
        speed += rate * rate
    return math.sqrt(slip), math.sqrt(speed), max(abs(wx), abs(wy), abs(wz))
