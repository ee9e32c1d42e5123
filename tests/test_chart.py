"""Line charts: points land where they belong, and nothing is drawn outside the axes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.pictures.chart import _LEFT, _PLOT, _TOP, PALETTE, Panel, Series, _ticks, line_chart

AXES = {
    "x_label": "epoch",
    "y_label": "success, %",
    "x_range": (0.0, 10.0),
    "y_range": (0.0, 100.0),
}


def drawn(picture, color):
    """(N, 2) pixels x, y of a colour."""
    rows, columns = np.nonzero((picture == color).all(axis=2))
    return np.column_stack([columns, rows])


def chart(*series, **options):
    return line_chart([Panel("title", series)], columns=1, **{**AXES, **options})


def test_a_line_goes_through_its_points():
    points = drawn(chart(Series("one", [0, 10], [0, 100])), PALETTE[0])
    inside = points[points[:, 1] < _TOP + _PLOT[1]]
    expected = _TOP + _PLOT[1] * (1 - (inside[:, 0] - _LEFT) / _PLOT[0])
    assert np.abs(inside[:, 1] - expected).max() < 2.5
    assert inside[:, 0].min() < _LEFT + 3
    assert inside[:, 0].max() > _LEFT + _PLOT[0] - 3


def test_a_single_point_is_seen():
    assert len(drawn(chart(Series("", [5], [50])), PALETTE[0])) > 20


def test_values_outside_stay_at_the_edge():
    picture = chart(Series("", [-5, 20], [-100, 300], [50, 50]))
    points = drawn(picture, PALETTE[0])
    assert points[:, 0].min() >= _LEFT - 2
    assert points[:, 1].max() <= _TOP + _PLOT[1] + 2


def test_the_spread_is_a_band_around_the_line():
    plain = chart(Series("", [0, 10], [50, 50]))
    band = chart(Series("", [0, 10], [50, 50], [10, 10]))
    changed = np.nonzero((plain != band).any(axis=2))[0]
    middle, half = _TOP + _PLOT[1] / 2, 0.1 * _PLOT[1]
    assert changed.min() == pytest.approx(middle - half, abs=2)
    assert changed.max() == pytest.approx(middle + half, abs=2)


def test_pale_lines_use_no_colour_up():
    picture = chart(Series("", [0, 10], [20, 20], pale=True), Series("", [0, 10], [80, 80]))
    assert len(drawn(picture, PALETTE[0]))
    assert not len(drawn(picture, PALETTE[1]))


def test_panels_fill_rows():
    one = chart(Series("", [0, 10], [0, 1]))
    panels = [Panel(str(i), (Series("", [0, 10], [0, 1]),)) for i in range(4)]
    rows, columns, _ = line_chart(panels, columns=3, **AXES).shape
    assert (rows, columns) == (2 * one.shape[0], 3 * one.shape[1])


@given(low=st.floats(-1e3, 1e3), length=st.floats(1e-2, 1e4))
def test_ticks_are_few_round_and_inside(low, length):
    ticks = _ticks(low, low + length)
    assert 1 <= len(ticks) <= 8
    assert all(low - 1e-6 * length <= tick <= low + length * (1 + 1e-6) for tick in ticks)
    steps = np.diff(ticks)
    assert len(ticks) < 2 or np.allclose(steps, steps[0], rtol=1e-6)


@pytest.mark.parametrize(
    "options", [{"x_range": (1.0, 1.0)}, {"y_range": (2.0, 1.0)}, {"y_range": (0.0, float("nan"))}]
)
def test_axes_without_length(options):
    with pytest.raises(InvalidInputError):
        chart(Series("", [0], [0]), **options)
    with pytest.raises(InvalidInputError, match="panels"):
        line_chart([], columns=1, **AXES)
