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
