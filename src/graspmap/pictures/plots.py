"""Plots of numbers: lines with bands, bars with intervals, reliability, heat maps, confusion.

Every plot comes as SVG, whose ink is that of the page around it (dark on a light page, light on a
dark one) and whose words are text, and as PNG on white. The same numbers give the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#966E00")
"""Colours that people of any colour vision tell apart (Okabe and Ito; the yellow is darker)."""
_DASHES = ("solid", (0, (6, 2)), (0, (1.5, 1.5)), (0, (6, 2, 1.5, 2)))
"""Lines differ by more than their colour."""

INK = "#1e2024"
PAPER = "#fefefe"
"""What lies between cells; in an SVG it is the page's ``--paper``."""
_PALE = "#9a9da5"
_NEAR_AXIS = 0.12
"""Points of a reliability diagram whose number would lie on the axis if it stood below them."""
_PANEL = (4.4, 3.1)  # inches; at 72 points an inch a panel fits a phone held upright
_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": INK,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "figure.constrained_layout.use": True,
    "font.size": 10,
    "grid.alpha": 0.15,
    "grid.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "savefig.facecolor": "white",
    "svg.fonttype": "none",
    "svg.hashsalt": "graspmap",
    "text.color": INK,
    "text.parse_math": False,  # a name may hold a $
    "xtick.color": INK,
    "ytick.color": INK,
}


@dataclass(frozen=True, eq=False)
class Plot:
    """A finished plot.

    Attributes:
        figure: Matplotlib's figure.
    """

    figure: Figure

    def svg(self, name: str = "plot") -> str:
        """The plot as an ``<svg>`` element to stand in a page.

        Args:
            name: Put before every id in it; plots of one page must differ in it.
        """
        text = io.StringIO()
        with style():
            self.figure.savefig(
                text, format="svg", transparent=True, metadata={"Date": None, "Creator": None}
            )
        svg = text.getvalue()
        svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
        svg = svg.replace(PAPER, "var(--paper, white)")
        svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
        svg = re.sub(r'\bid="', f'id="{name}-', svg)
        return re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", svg)

    def png(self, dpi: int = 144) -> bytes:
        """The plot as the bytes of a PNG, on white.

        Args:
            dpi: Pixels an inch; a panel is 4.4 by 3.1 inches.
        """
        content = io.BytesIO()
        with style():
            self.figure.savefig(content, format="png", dpi=dpi, metadata={"Software": None})
        return content.getvalue()


@dataclass(frozen=True, eq=False)
class Series:
    """One line.

    Attributes:
        name: What the legend calls it; empty for none.
        x: (N,) places.
        y: (N,) values; NaN leaves a gap.
        low: (N,) lower edge of a band around it, or None.
        high: (N,) upper edge.
        pale: Whether it is only there to compare with: thin and grey.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    low: Sequence[float] | None = None
    high: Sequence[float] | None = None
    pale: bool = False


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes.

    Attributes:
        title: Above it.
        series: Its lines; the first of them lies on top.
    """

    title: str
    series: tuple[Series, ...]


@dataclass(frozen=True)
class Bar:
    """One bar.

    Attributes:
        name: Beside it.
        value: Its end.
        interval: Lower and upper end of the interval around the value, or None.
        text: Written behind it: the value in words.
    """

    name: str
    value: float
    interval: tuple[float, float] | None = None
    text: str = ""


def line_chart(
    panels: Sequence[Panel],
    *,
    columns: int = 1,
    x_label: str,
    y_label: str,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
) -> Plot:
    """Panels side by side, all with the same axes.

    Args:
        panels: What is shown, row by row.
        columns: Panels in a row.
        x_label: Name of the horizontal axis.
        y_label: Name of the vertical axis.
        x_range: Ends of the horizontal axis.
        y_range: Ends of the vertical axis.

    Raises:
        InvalidInputError: There is no panel, an axis has no length, or a line has not one y for
            each x.
    """
    if not panels or columns < 1:
        raise InvalidInputError(
            "panels of the chart", len(panels), "1 or more, in 1 column or more"
        )
    _check_range("x_range", x_range)
    _check_range("y_range", y_range)
    for series in (series for panel in panels for series in panel.series):
        parts = (series.x, series.y, series.low, series.high)
        lengths = {len(part) for part in parts if part is not None}
        if len(lengths) > 1 or (series.low is None) != (series.high is None):
            raise InvalidInputError(f"points of {series.name!r}", lengths, "one y for each x")
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    with style():
        figure, axes = new_axes(rows, columns, (_PANEL[0] * columns, _PANEL[1] * rows))
        for panel, ax in zip(panels, axes, strict=False):
            _draw_panel(ax, panel)
            ax.set(xlabel=x_label, ylabel=y_label, xlim=x_range, ylim=y_range)
        for ax in axes[len(panels) :]:
            ax.set_visible(False)
        return laid_out(figure)


def bar_chart(
    bars: Sequence[Bar],
    *,
    x_label: str,
    x_range: tuple[float, float],
    title: str = "",
) -> Plot:
    """Horizontal bars from zero, the first one on top, with intervals.

    Args:
        bars: What is shown.
        x_label: Name of the axis.
        x_range: Ends of the axis; intervals that reach beyond are cut there.
        title: Above it.

    Raises:
        InvalidInputError: There is no bar, or the axis has no length.
    """
    if not bars:
        raise InvalidInputError("bars", "none", "1 or more")
    _check_range("x_range", x_range)
    with style():
        figure, (ax,) = new_axes(1, 1, (_PANEL[0], 0.9 + 0.3 * len(bars)))
        places = range(len(bars))
        ax.barh(places, [bar.value for bar in bars], height=0.6, color=PALETTE[0], alpha=0.55)
        span = x_range[1] - x_range[0]
        for place, bar in zip(places, bars, strict=True):
            low, high = np.clip(bar.interval or (bar.value, bar.value), *x_range)
            if bar.interval is not None:
                ax.plot([low, high], [place, place], color=INK, linewidth=1.5)
            end = max(bar.value, float(high), 0.0)
            ax.text(end + 0.02 * span, place, bar.text, va="center", fontsize=9)
        ax.axvline(0.0, color=INK, linewidth=0.8)
        ax.set_yticks(list(places), [bar.name for bar in bars])
        ax.set(xlabel=x_label, xlim=x_range, ylim=(len(bars) - 0.5, -0.5), title=title)
        ax.grid(visible=False, axis="y")
        return laid_out(figure)


def reliability_diagram(
    said: ArrayLike,
    held: ArrayLike,
    interval: ArrayLike,
    counts: ArrayLike,
    *,
    x_label: str = "quality that the detector says",
    y_label: str = "share that held",
) -> Plot:
    """What a detector says against what came of it; calibrated detectors lie on the diagonal.

    Args:
        said: (B,) mean probability in each bin.
        held: (B,) share in each bin that came true.
        interval: (B, 2) ends of the interval around ``held``.
        counts: (B,) how many there are in each bin; bins without any are left out.
        x_label: Name of the horizontal axis.
        y_label: Name of the vertical axis.

    Raises:
        InvalidInputError: The shapes do not fit each other, or all bins are empty.
    """
    x, y, ends, count = (floats(values) for values in (said, held, interval, counts))
    if x.ndim != 1 or y.shape != x.shape or ends.shape != (len(x), 2) or count.shape != x.shape:
        shapes = [part.shape for part in (x, y, ends, count)]
        raise InvalidInputError("shapes of the bins", shapes, "(B,), (B,), (B, 2), (B,)")
    some = count > 0
    if not some.any():
        raise InvalidInputError("bins", "all empty", "one or more with something in it")
    x, y, ends, count = x[some], y[some], ends[some], count[some]
    with style():
        figure, (ax,) = new_axes(1, 1, (_PANEL[0], 3.9))
        ax.plot([0, 1], [0, 1], color=_PALE, linewidth=1, linestyle=_DASHES[1])
        ax.vlines(x, ends[:, 0], ends[:, 1], color=PALETTE[0], linewidth=1.5)
        ax.plot(x, y, color=PALETTE[0], linewidth=1, alpha=0.5)
        ax.scatter(x, y, s=15 + 120 * count / count.max(), color=PALETTE[0], zorder=3)
        for place, share, number in zip(x, y, count, strict=True):
            # Beside the point and, where the axis is near, above it.
            offset = (7, 5) if share < _NEAR_AXIS else (7, -11)
            ax.annotate(
                f"{number:.0f}", (place, share), offset, textcoords="offset points", fontsize=8
            )
        ax.set(xlabel=x_label, ylabel=y_label, xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
        return laid_out(figure)


def _draw_panel(ax: Axes, panel: Panel) -> None:
    """The lines of one panel."""
    strong = 0
    for depth, series in enumerate(panel.series):
        look: dict[str, Any] = {"color": _PALE, "linewidth": 0.8, "alpha": 0.6}
        if not series.pale:
            look = {"color": PALETTE[strong % len(PALETTE)], "linewidth": 1.8}
            look["linestyle"] = _DASHES[strong % len(_DASHES)]
            strong += 1
        if len(series.x) == 1:  # a line of one point cannot be seen
            look["marker"] = "o"
        order = 3 - depth / len(panel.series)
        ax.plot(series.x, series.y, label=series.name or "_", zorder=order, **look)
        if series.low is not None and series.high is not None and not series.pale:
            color = look["color"]
            ax.fill_between(series.x, series.low, series.high, color=color, alpha=0.18, linewidth=0)
    ax.set_title(panel.title)
    if any(series.name for series in panel.series):
        ax.legend(loc="best")


def new_axes(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """An empty figure of ``size`` (width, height) inches with its axes, row by row."""
    # Not pyplot: it would keep every figure, and look for a screen.
    from matplotlib.figure import Figure

    figure = Figure(figsize=size)
    return figure, list(figure.subplots(rows, columns, squeeze=False).flat)


def laid_out(figure: Figure) -> Plot:
    """The plot, with everything in its final place.

    Matplotlib would move the axes a little at each drawing, and the bytes would differ.
    """
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    return Plot(figure)


@contextmanager
def style() -> Iterator[None]:
    """Our settings and nobody else's: a matplotlibrc of the user changes nothing."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def floats(values: ArrayLike) -> Floats:
    """Numbers as float64."""
    return np.asarray(values, dtype=np.float64)


def _check_range(name: str, ends: tuple[float, float]) -> None:
    if not np.isfinite(ends).all() or ends[0] >= ends[1]:
        raise InvalidInputError(name, ends, "two numbers, the smaller one first")
