"""Line charts in panels: learning curves, success against a threshold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.pictures.draw import INK, PAPER, Color, Picture, text_width, write_text

PALETTE: tuple[Color, ...] = (
    (0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (150, 110, 0),
)  # fmt: skip
"""Colours that people of any colour vision tell apart (Okabe and Ito)."""

_GRID: Color = (225, 226, 230)
_PALE: Color = (200, 202, 208)
_PLOT = (360, 220)  # width and height of the axes, pixels
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, 20, 34, 46
_LINE, _SMALL = 18, 0.38
_SHIFT = 4  # cv2 takes coordinates in 1/16 pixel


@dataclass(frozen=True, eq=False)
class Series:
    """One line.

    Attributes:
        name: What the legend calls it; empty for none.
        x: (N,) places.
        y: (N,) values.
        spread: (N,) shown as a band of y +- spread, or None.
        pale: Whether it is only there to compare with: thin and grey.
    """

    name: str
    x: Sequence[float]
    y: Sequence[float]
    spread: Sequence[float] | None = None
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


def line_chart(
    panels: Sequence[Panel],
    *,
    columns: int,
    x_label: str,
    y_label: str,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
) -> Picture:
    """Panels side by side, all with the same axes.

    Args:
        panels: What is shown, row by row.
        columns: Panels in a row.
        x_label: Name of the horizontal axis.
        y_label: Name of the vertical axis.
        x_range: Ends of the horizontal axis.
        y_range: Ends of the vertical axis.

    Returns:
        (H, W, 3) picture.

    Raises:
        InvalidInputError: There is no panel, or an axis has no length.
    """
    if not panels or columns < 1:
        raise InvalidInputError(
            "panels of the chart", len(panels), "1 or more, in 1 column or more"
        )
    for name, (low, high) in (("x_range", x_range), ("y_range", y_range)):
        if not np.isfinite([low, high]).all() or low >= high:
            raise InvalidInputError(name, (low, high), "two numbers, the smaller one first")
    named = max(sum(bool(series.name) for series in panel.series) for panel in panels)
    width = _LEFT + _PLOT[0] + _RIGHT
    height = _TOP + _PLOT[1] + _BOTTOM + _LINE * named
    columns = min(columns, len(panels))
    picture: Picture = np.full(
        (height * -(-len(panels) // columns), width * columns, 3), PAPER, np.uint8
    )
    for i, panel in enumerate(panels):
        row, column = divmod(i, columns)
        part = picture[row * height : (row + 1) * height, column * width : (column + 1) * width]
        tile = np.ascontiguousarray(part)
        _Axes(tile, x_range, y_range).draw(panel, x_label, y_label)
        part[:] = tile
    return picture


@dataclass(frozen=True, eq=False)
class _Axes:
    picture: Picture
    x_range: tuple[float, float]
    y_range: tuple[float, float]

    def draw(self, panel: Panel, x_label: str, y_label: str) -> None:
        """Everything of one panel."""
        self._frame(x_label, y_label)
        write_text(self.picture, panel.title, (_LEFT, 20))
        colors = _colors(panel.series)
        for series, color in reversed(list(zip(panel.series, colors, strict=True))):
            self._band(series, color)
            self._line(series, color)
        at = _TOP + _PLOT[1] + _BOTTOM + 4
        for series, color in zip(panel.series, colors, strict=True):
            if series.name:
                self._polyline(np.array([[_LEFT, at - 4], [_LEFT + 26, at - 4]]), color, 2)
                write_text(self.picture, series.name, (_LEFT + 34, at), size=_SMALL)
                at += _LINE

    def _frame(self, x_label: str, y_label: str) -> None:
        right, bottom = _LEFT + _PLOT[0], _TOP + _PLOT[1]
        for value in _ticks(*self.x_range):
            x = self._place([value], [self.y_range[0]])[0, 0]
            self._polyline(np.array([[x, _TOP], [x, bottom]]), _GRID, 1)
            text = f"{value:g}"
            place = (x - text_width(text, _SMALL) / 2, bottom + 16)
            write_text(self.picture, text, place, size=_SMALL)
        for value in _ticks(*self.y_range):
            y = self._place([self.x_range[0]], [value])[0, 1]
            self._polyline(np.array([[_LEFT, y], [right, y]]), _GRID, 1)
            text = f"{value:g}"
            place = (_LEFT - 6 - text_width(text, _SMALL), y + 4)
            write_text(self.picture, text, place, size=_SMALL)
        corners = [[_LEFT, _TOP], [right, _TOP], [right, bottom], [_LEFT, bottom], [_LEFT, _TOP]]
        self._polyline(np.array(corners), INK, 1)
        middle = _LEFT + (_PLOT[0] - text_width(x_label, _SMALL)) / 2
        write_text(self.picture, x_label, (middle, bottom + 34), size=_SMALL)
        self._on_its_side(y_label)

    def _on_its_side(self, text: str) -> None:
        """The name of the vertical axis, read from below."""
        strip: Picture = np.full((16, _PLOT[1], 3), PAPER, np.uint8)
        write_text(strip, text, ((_PLOT[1] - text_width(text, _SMALL)) / 2, 11), size=_SMALL)
        self.picture[_TOP : _TOP + _PLOT[1], 2:18] = np.rot90(strip)

    def _band(self, series: Series, color: Color) -> None:
        import cv2

        if series.spread is None or series.pale or len(series.x) == 0:
            return
        y, spread = np.asarray(series.y, float), np.asarray(series.spread, float)
        points = np.concatenate(
            [self._place(series.x, y - spread), self._place(series.x, y + spread)[::-1]]
        )
        band = self.picture.copy()
        cv2.fillPoly(
            band, [np.rint(points * 2**_SHIFT).astype(np.int32)], color, cv2.LINE_AA, _SHIFT
        )
        cv2.addWeighted(band, 0.18, self.picture, 0.82, 0, dst=self.picture)

    def _line(self, series: Series, color: Color) -> None:
        import cv2

        points = self._place(series.x, series.y)
        self._polyline(points, color, 1 if series.pale else 2)
        if len(points) == 1 and not series.pale:  # a line of one point cannot be seen
            x, y = np.rint(points[0]).astype(int).tolist()
            cv2.circle(self.picture, (x, y), 4, color, -1, cv2.LINE_AA)

    def _place(
        self, x: Sequence[float] | NDArray[np.floating], y: Sequence[float] | NDArray[np.floating]
    ) -> NDArray[np.float64]:
        """(N, 2) pixels of points of the chart, kept inside the axes."""
        (x0, x1), (y0, y1) = self.x_range, self.y_range
        across = np.clip((np.asarray(x, float) - x0) / (x1 - x0), 0, 1)
        up = np.clip((np.asarray(y, float) - y0) / (y1 - y0), 0, 1)
        return np.column_stack([_LEFT + _PLOT[0] * across, _TOP + _PLOT[1] * (1 - up)])

    def _polyline(self, points: NDArray[np.floating], color: Color, thickness: int) -> None:
        import cv2

        fixed = np.rint(points * 2**_SHIFT).astype(np.int32)
        cv2.polylines(self.picture, [fixed], False, color, thickness, cv2.LINE_AA, _SHIFT)


def _colors(series: Sequence[Series]) -> list[Color]:
    """A colour for each line; pale ones do not use one up."""
    strong = iter(range(len(series)))
    return [_PALE if one.pale else PALETTE[next(strong) % len(PALETTE)] for one in series]


def _ticks(low: float, high: float) -> list[float]:
    """Some five round numbers between the ends."""
    step = 10.0 ** np.floor(np.log10((high - low) / 5))
    step *= next(factor for factor in (1, 2, 5, 10) if (high - low) / (step * factor) <= 6)
    first = np.ceil(low / step - 1e-9)
    # Adding 0 makes 0 of -0.
    return [float(round(k * step, 10)) + 0.0 for k in np.arange(first, high / step + 1e-9)]
