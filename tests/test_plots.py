"""Plots: the same bytes each time, what is drawn where it belongs, and words as they are."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from graspmap.errors import InvalidInputError
from graspmap.pictures.heat_maps import confusion_chart, heat_map
from graspmap.pictures.plots import (
    PALETTE,
    Bar,
    Panel,
    Series,
    bar_chart,
    line_chart,
    reliability_diagram,
)

AXES = {"x_label": "IoU", "y_label": "success", "x_range": (0.0, 10.0), "y_range": (0.0, 100.0)}
BINS = ([0.1, 0.5, 0.9], [0.2, 0.5, 0.7], [[0.1, 0.3], [0.4, 0.6], [0.6, 0.8]], [10, 20, 30])
SVG = "{http://www.w3.org/2000/svg}"


def lines(*series, **options):
    return line_chart([Panel("title", series)], **{**AXES, **options})


PLOTS = {
    "lines": lambda: lines(Series("one", [0, 10], [0, 100], [0, 80], [10, 100])),
    "bars": lambda: bar_chart([Bar("a", 0.4, (0.3, 0.5), "40%")], x_label="x", x_range=(0, 1)),
    "reliability": lambda: reliability_diagram(*BINS),
    "heat map": lambda: heat_map([[0.1, 0.9], [np.nan, 0.5]], ["r", "s"], ["c", "d"]),
    "confusion": lambda: confusion_chart([[3, 1], [0, 5]], ["mug", "bowl"]),
}


def texts(svg):
    return ["".join(node.itertext()) for node in ElementTree.fromstring(svg).iter(f"{SVG}text")]


def paths(svg, color):
    """The points of each path that is drawn in a colour, SVG pixels, y down."""
    found = []
    for path in ElementTree.fromstring(svg).iter(f"{SVG}path"):
        if f"stroke: {color}".lower() in path.get("style", "").lower():
            numbers = re.findall(r"[ML] (-?[\d.]+) (-?[\d.]+)", path.get("d"))
            found.append(np.array(numbers, dtype=float))
    return found


@pytest.mark.parametrize("name", PLOTS)
def test_the_same_numbers_give_the_same_bytes(name):
    first, second = PLOTS[name](), PLOTS[name]()
    svg, png = first.svg("a"), first.png()
    assert svg == first.svg("a") == second.svg("a")
    assert png == first.png() == second.png()
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert (picture[0, 0] == 255).all()


@pytest.mark.parametrize("name", PLOTS)
def test_an_svg_takes_the_ink_of_its_page_and_shares_no_id(name):
    plot = PLOTS[name]()
    svg = plot.svg("first")
    assert ElementTree.fromstring(svg).tag == f"{SVG}svg"
    assert "currentColor" in svg
    assert "#1e2024" not in svg
    assert "http" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", svg)
    ids = [set(re.findall(r'\bid="([^"]+)"', plot.svg(n))) for n in ("first", "second")]
    assert ids[0]
    assert not ids[0] & ids[1]
    referred = set(re.findall(r'(?:url\(#|href="#)([^)"]+)', svg))
    assert referred <= ids[0]


def test_settings_of_the_user_change_nothing():
    import matplotlib as mpl

    plain = PLOTS["lines"]().svg()
    with mpl.rc_context({"lines.linewidth": 9, "font.size": 30, "axes.grid": False}):
        assert PLOTS["lines"]().svg() == plain


def test_a_line_goes_through_its_points():
    x, y = [0.0, 2.0, 5.0, 10.0], [0.0, 90.0, 10.0, 100.0]
    svg = lines(Series("", x, y)).svg()
    (line,) = (path for path in paths(svg, PALETTE[0]) if len(path) > 1)
    grid = np.concatenate([p for p in paths(svg, "currentColor") if np.ptp(p) > 50])
    (left, top), (right, bottom) = grid.min(axis=0), grid.max(axis=0)
    expected = np.column_stack(
        [left + (right - left) * np.array(x) / 10, bottom - (bottom - top) * np.array(y) / 100]
    )
    assert line == pytest.approx(expected, abs=0.01)


def test_pale_lines_use_no_colour_up():
    svg = lines(Series("", [0, 9], [20, 20], pale=True), Series("", [0, 9], [80, 80])).svg()
    assert paths(svg, PALETTE[0])
    assert not paths(svg, PALETTE[1])


def test_a_single_point_is_seen():
    picture = lines(Series("", [5], [50])).png()
    rgb = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert (rgb == [0, 114, 178]).all(axis=2).sum() > 20


def test_panels_fill_rows():
    def size(count):
        panels = [Panel(str(i), (Series("", [0, 1], [0, 1]),)) for i in range(count)]
        png = line_chart(panels, columns=3, **AXES).png()
        return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).shape

    one, four = size(1), size(4)
    assert four[:2] == pytest.approx((2 * one[0], 3 * one[1]), abs=3)


NAME = "<b>&\"'$x^2$</b>"


def test_names_are_words_and_no_markup():
    assert NAME in texts(lines(Series(NAME, [0, 1], [0, 1])).svg())
    bars = bar_chart([Bar(NAME, 0.5, None, "50%")], x_label="x", x_range=(0, 1))
    assert {NAME, "50%"} <= set(texts(bars.svg()))
    assert NAME in texts(confusion_chart([[1]], [NAME]).svg())


@settings(max_examples=8)
@given(
    npst.arrays(
        np.float64,
        npst.array_shapes(min_dims=2, max_dims=2, max_side=4),
        elements=st.sampled_from([0.0, 0.25, 0.5, 1.0, np.nan]),
    )
)
def test_a_heat_map_says_its_cells_and_their_means(shares):
    rows = [f"r{i}" for i in range(shares.shape[0])]
    columns = [f"c{i}" for i in range(shares.shape[1])]
    if np.isnan(shares).all():
        with pytest.raises(InvalidInputError):
            heat_map(shares, rows, columns)
        return
    said = [t for t in texts(heat_map(shares, rows, columns).svg()) if t.isdigit()]

    def mean(values):
        known = [v for v in values if v == v]
        return [sum(known) / len(known)] if known else []

    expected = [v for row in shares.tolist() for v in [*row, *mean(row)] if v == v]
    expected += [m for column in shares.T.tolist() for m in mean(column)]
    expected += mean(shares.ravel().tolist())
    assert said == [f"{100 * v:.0f}" for v in expected]


def test_a_reliability_diagram_leaves_empty_bins_out():
    said, held, ends, _ = BINS
    some = reliability_diagram(said, held, ends, [10, 0, 30]).svg()
    assert {"10", "30"} <= set(texts(some))
    without = reliability_diagram(said[::2], held[::2], ends[::2], [10, 30])
    assert some == without.svg()


@pytest.mark.parametrize("share", [0.0, 0.03, 0.1, 0.15, 0.5, 1.0])
def test_the_number_of_trials_does_not_lie_on_the_axis(share):
    figure = reliability_diagram([0.0, 0.5, 1.0], [share] * 3, [[0, 1]] * 3, [777] * 3).figure
    renderer = figure.canvas.get_renderer() if hasattr(figure.canvas, "get_renderer") else None
    (ax,) = figure.axes
    axes = ax.get_window_extent(renderer)
    for text in ax.texts:
        extent = text.get_window_extent(renderer)
        assert extent.y0 > axes.y0
        assert extent.x0 > axes.x0


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda: line_chart([], **AXES), "panels of the chart is 0"),
        (lambda: lines(Series("", [0], [0]), x_range=(1.0, 1.0)), "x_range"),
        (lambda: lines(Series("", [0], [0]), y_range=(0.0, float("nan"))), "y_range"),
        (lambda: lines(Series("odd", [0, 1], [0])), "one y for each x"),
        (lambda: lines(Series("odd", [0, 1], [0, 1], low=[0, 0])), "points of 'odd'"),
        (lambda: bar_chart([], x_label="", x_range=(0, 1)), "bars is none"),
        (lambda: reliability_diagram([0.1], [0.1], [[0, 1]], [0]), "all empty"),
        (lambda: reliability_diagram([0.1], [0.1, 0.2], [[0, 1]], [1]), "shapes of the bins"),
        (lambda: heat_map([[0.1, 0.2]], ["a"], ["b"]), "with 1 and 1 names"),
        (lambda: confusion_chart([[1, 2], [3, -1]], ["a", "b"]), "0 or more"),
    ],
)
def test_refuses(draw, words):
    with pytest.raises(InvalidInputError, match=re.escape(words)):
        draw()
