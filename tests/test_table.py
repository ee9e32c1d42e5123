"""The table behind a depth picture: exact on planes, unmoved by objects, holes and noise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.data import to_input
from graspmap.data.table import find_table
from graspmap.errors import InvalidInputError, UnknownNameError

SHAPE = (90, 120)


def plane(tilt: float, turn: float, distance: float, focal: float) -> np.ndarray:
    """Depth of a tilted plane, by meeting every ray of a pinhole camera with it."""
    rows, columns = SHAPE
    x = (np.arange(columns)[None] - columns / 2) / focal
    y = (np.arange(rows)[:, None] - rows / 2) / focal
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    return (distance * normal[2] / (normal[0] * x + normal[1] * y + normal[2])).astype(np.float32)


planes = st.builds(
    plane,
    tilt=st.floats(0, 0.7),
    turn=st.floats(-3, 3),
    distance=st.floats(0.3, 2.5),
    focal=st.floats(110, 300),
)


@given(table=planes)
def test_a_bare_table_is_found_exactly(table):
    assert np.abs(find_table(table).depth_m(table.shape) - table).max() < 1e-5 * table.max()


@given(table=planes, seed=st.integers(0, 2**32), share=st.floats(0, 0.3))
def test_objects_holes_and_noise_do_not_move_it(table, seed, share):
    rng = np.random.default_rng(seed)
    rows, columns = SHAPE
    picture = table + rng.normal(0, 0.001, SHAPE).astype(np.float32)
    side = np.sqrt(share)
    top, left = (int(rng.integers(0, n - int(n * side) + 1)) for n in SHAPE)
    on = (slice(top, top + int(rows * side)), slice(left, left + int(columns * side)))
    picture[on] -= np.float32(rng.uniform(0.02, 0.15))
    picture[rng.random(SHAPE) < 0.1] = np.nan
    picture[:4, :4] = 6.0  # beyond the table's edge
    error = np.abs(find_table(picture).depth_m(picture.shape) - table)
    assert np.median(error) < 0.002
    assert error.max() < 0.008


def bowl(seed: int, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    """Ranges from a point beside the camera to a tilted table, by meeting every ray with it."""
    rng = np.random.default_rng(seed)
    rows, columns = shape
    x = (np.arange(columns)[None] - columns / 2) / (1.2 * columns)
    y = (np.arange(rows)[:, None] - rows / 2) / (1.2 * columns)
    z = rng.uniform(0.6, 1.2) / (1 + rng.uniform(-0.3, 0.3) * x + rng.uniform(-0.3, 0.3) * y)
    base = rng.uniform(-0.2, 0.2, 3)
    away = (x * z - base[0]) ** 2 + (y * z - base[1]) ** 2 + (z - base[2]) ** 2
    return np.sqrt(away).astype(np.float32)


@given(seed=st.integers(0, 2**32), share=st.floats(0, 0.07))
def test_what_measures_ranges_sees_a_bowl(seed, share):
    """As the pictures of Cornell do: what stands on the table is still what rises from it."""
    rng = np.random.default_rng(seed)
    table = bowl(seed)
    picture = table + rng.normal(0, 0.001, SHAPE).astype(np.float32)
    rows, columns = SHAPE
    side = np.sqrt(share)
    top, left = (int(rng.integers(0, n - int(n * side) + 1)) for n in SHAPE)
    picture[top : top + int(rows * side), left : left + int(columns * side)] -= np.float32(0.04)
    error = np.abs(find_table(picture).depth_m(SHAPE) - table)
    assert np.median(error) < 0.003
    assert np.percentile(error, 95) < 0.03


@pytest.mark.parametrize("flat", [False, True])
def test_it_moves_with_the_picture(flat):
    """A zoom and a shift: the same depth at the same place, by a closed form."""
    table = find_table(plane(0.3, 0.5, 1.0, 200) if flat else bowl(5))
    assert table.inverse[1:, 1:].any() != flat
    matrix = np.array([[1.7, 0, -31.0], [0, 0.6, 12.0], [0, 0, 1]])
    moved = table.transformed(matrix)
    for x, y in ((0.0, 0.0), (40.5, 17.25), (119.0, 89.0)):
        found = moved.inverse_depth(1.7 * x - 31, 0.6 * y + 12)
        assert found == pytest.approx(table.inverse_depth(x, y), rel=1e-9)
    shown = table.depth_m(SHAPE)
    assert 1 / shown[17, 40] == pytest.approx(table.inverse_depth(40, 17), rel=1e-5)
    back = moved.transformed(np.linalg.inv(matrix))
    assert np.allclose(back.box, table.box)
    assert np.allclose(back.depth_m(SHAPE), shown, rtol=1e-5)
    with pytest.raises(InvalidInputError, match="zoom and shift"):
        table.transformed(np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]))


def test_a_region_of_a_picture():
    """A table in a room: the wall and the floor are most of the picture."""
    table = plane(0.3, 1.5, 1.0, 200)
    room = np.full(SHAPE, 1.8, np.float32)
    room[40:80, 20:90] = table[40:80, 20:90]
    found = find_table(room, (22.0, 41.0, 60.0, 37.5)).depth_m(SHAPE)
    assert np.abs(found - table)[40:80, 20:90].max() < 1e-4
    assert np.abs(find_table(room).depth_m(SHAPE) - table)[40:80, 20:90].max() > 0.2
    room[40:80, 20:90] = np.nan  # nothing there: all of the picture then
    assert np.allclose(find_table(room, (22.0, 41.0, 60.0, 37.5)).depth_m(SHAPE), 1.8, atol=1e-4)


def test_a_region_counts_although_the_picture_shows_the_horizon():
    """A camera that looks far along a table: beyond its horizon there is a wall."""
    rows, columns = SHAPE
    y = (np.arange(rows)[:, None] - rows / 2) / 60
    inverse = (0.9 * y + 0.35) / 0.7 + np.zeros((1, columns))  # below 0 in the upper rows
    room = np.where(inverse > 1 / 3, 1 / np.maximum(inverse, 1e-6), 3.0).astype(np.float32)
    region = (30.0, 60.0, 60.0, 28.0)
    found = find_table(room, region)
    assert np.abs(found.depth_m(SHAPE) - room)[60:88, 30:90].max() < 1e-3
    # Behind the horizon there is no table; it is said to be very far, and never behind the camera.
    assert (found.depth_m(SHAPE) > 0).all()
    assert found.inverse_depth(0, 0) > 0


def test_thin_pictures_and_single_pixels():
    for shape in ((1, 1), (1, 50), (50, 1), (2, 3)):
        depth = np.full(shape, 0.7, np.float32)
        assert np.allclose(find_table(depth).depth_m(depth.shape), 0.7, atol=1e-5)
    lonely = np.full((200, 200), np.nan, np.float32)
    lonely[101, 57] = 0.9  # on no sample of the grid
    assert np.allclose(find_table(lonely).depth_m(lonely.shape), 0.9, atol=1e-5)


def test_a_plane_that_passes_the_camera_is_not_believed():
    depth = np.full((64, 64), np.nan, np.float32)
    depth[:, :6] = np.linspace(0.3, 3.0, 6, dtype=np.float32)
    found = find_table(depth).depth_m(depth.shape)
    assert (found > 0).all()
    assert np.isfinite(found).all()
    assert found.max() <= 30


def test_nothing_but_holes_is_refused():
    with pytest.raises(InvalidInputError, match="holes"):
        find_table(np.full((5, 5), np.nan, np.float32))


def test_the_input_shows_what_rises_whatever_the_tilt():
    """A block of 5 cm gives -1 on 0 from straight above and from aside."""
    block = np.zeros(SHAPE, np.float32)
    block[30:60, 40:80] = -0.05
    block[0, 0] = np.nan
    corner = np.array([[1.0, 0, -15], [0, 1, 0], [0, 0, 1]])
    for tilt in (0.0, 0.4):
        seen = to_input(
            None, plane(tilt, 0.5, 1.0, 200) + block, "depth", corner, 90, depth_zero="table"
        )[0]
        assert seen.shape == (90, 90)
        assert np.allclose(seen, np.nan_to_num(block)[:, 15:105] / 0.05, atol=2e-3)
    level = to_input(None, plane(0.0, 0.0, 1.0, 200) + block, "depth", corner, 90)[0]
    assert abs(level.mean()) < 1e-5
    with pytest.raises(UnknownNameError, match="table"):
        to_input(None, block + 1, "depth", corner, 90, depth_zero="floor")
