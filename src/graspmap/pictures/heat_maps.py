"""Plots of tables: heat maps with the means of rows and columns, confusion of classes.

Letters in shapes: R rows, C columns, K classes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from graspmap.errors import InvalidInputError
from graspmap.pictures.plots import PAPER, Floats, Plot, floats, laid_out, new_axes, style


def heat_map(
    shares: ArrayLike,
    rows: Sequence[str],
    columns: Sequence[str],
    *,
    row_label: str = "",
    column_label: str = "",
    means: bool = True,
) -> Plot:
    """Shares as coloured cells with their percents, and the means of rows and columns.

    Args:
        shares: (R, C) numbers in [0, 1]; NaN where there is none, which counts in no mean.
        rows: R names, from the top.
        columns: C names, from the left.
        row_label: What the rows are.
        column_label: What the columns are.
        means: Whether to show the means.

    Raises:
        InvalidInputError: The names do not fit the shares, or no cell has a share.
    """
    cells = floats(shares)
    if cells.ndim != 2 or cells.shape != (len(rows), len(columns)) or np.isnan(cells).all():
        found = f"{cells.shape} with {len(rows)} and {len(columns)} names"
        raise InvalidInputError("shape of the shares", found, "(R, C) with R and C names")
    down, right = list(rows), list(columns)
    if means:
        cells = np.block(
            [
                [cells, _means(cells, 1)[:, None]],
                [_means(cells, 0)[None], np.full((1, 1), float(np.nanmean(cells)))],
            ]
        )
        down, right = [*down, "mean"], [*right, "mean"]
    texts = [["" if math.isnan(v) else f"{100 * v:.0f}" for v in row] for row in cells]
    plot = _grid(cells, texts, down, right, row_label, column_label)
    if means:  # a gap of paper sets the means apart
        (ax,) = plot.figure.axes
        ax.axhline(len(rows) - 0.5, color=PAPER, linewidth=4)
        ax.axvline(len(columns) - 0.5, color=PAPER, linewidth=4)
    return plot


def confusion_chart(counts: ArrayLike, classes: Sequence[str]) -> Plot:
    """True classes by rows, said ones by columns; the colour is the share of the row.

    Args:
        counts: (K, K) how often row was taken for column.
        classes: K names.

    Raises:
        InvalidInputError: The counts are no square of K, or some are negative.
    """
    table = floats(counts)
    if table.shape != (len(classes), len(classes)) or not len(classes) or not (table >= 0).all():
        found = f"{table.shape} with {len(classes)} names"
        raise InvalidInputError("counts", found, "(K, K) with K names, 0 or more each")
    shares = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    # In a hundred cells a row, numbers would be specks.
    shown = len(classes) <= 16
    texts = [[f"{v:.0f}" if v and shown else "" for v in row] for row in table]
    return _grid(shares, texts, classes, classes, "true", "said")


def _grid(
    shares: Floats,
    texts: Sequence[Sequence[str]],
    rows: Sequence[str],
    columns: Sequence[str],
    row_label: str,
    column_label: str,
) -> Plot:
    """Coloured cells with a text in each."""
    size = min(max(0.42 * max(shares.shape) + 1.0, 3.0), 9.0)
    with style():
        figure, (ax,) = new_axes(1, 1, (size, size * 0.92))
        # Cells are drawn, not an image: an image in an SVG is blurred and tied to one size.
        ax.pcolormesh(
            np.arange(shares.shape[1] + 1) - 0.5,
            np.arange(shares.shape[0] + 1) - 0.5,
            np.ma.masked_invalid(shares),
            cmap="viridis",
            vmin=0,
            vmax=1,
        )
        for (row, column), share in np.ndenumerate(shares):
            color = "white" if share < 0.55 else "black"
            ax.text(column, row, texts[row][column], ha="center", va="center", color=color, size=9)
        ax.set_xticks(range(len(columns)), list(columns))
        ax.set_yticks(range(len(rows)), list(rows))
        if max(map(len, columns)) > 4:
            ax.tick_params(axis="x", labelrotation=90)
        if len(rows) > 30:
            ax.tick_params(labelsize=6)
        ax.set(xlabel=column_label, ylabel=row_label, aspect="equal")
        ax.set_ylim(len(rows) - 0.5, -0.5)
        ax.grid(visible=False)
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        return laid_out(figure)


def _means(cells: Floats, axis: int) -> Floats:
    """Means along an axis; NaN where nothing is."""
    known = ~np.isnan(cells)
    count = known.sum(axis=axis)
    total = np.where(known, cells, 0.0).sum(axis=axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
