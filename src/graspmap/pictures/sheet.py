"""Sheets: several pictures with captions on one page.

Letters in shapes: H rows, W columns, N orientation bins, S side of the network's input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.grasps import Grasps
from graspmap.maps.grasp_maps import GraspMaps
from graspmap.pictures.draw import (
    PAPER,
    Picture,
    check_picture,
    draw_grasps,
    draw_window,
    text_width,
    write_text,
)
from graspmap.pictures.fields import BarKind, MapKind, color_bar, map_picture, width_range

_GAP = 12
_CAPTION = 24
_TITLE = 34


@dataclass(frozen=True, eq=False)
class Tile:
    """One picture of a sheet.

    Args:
        rgb: (H, W, 3) picture.
        caption: Words above it.
        bar: Colour scale below it: kind of map and the words for its two ends, or None.
        grasps: Grasps to draw on it, in its pixels, or None.
        ranks: Whether to number them.
    """

    rgb: Picture
    caption: str = ""
    bar: tuple[BarKind, str, str] | None = None
    grasps: Grasps | None = None
    ranks: bool = False


def contact_sheet(
    tiles: Sequence[Tile], *, columns: int = 4, cell: int = 300, title: str = ""
) -> Picture:
    """Pictures side by side, each fitted into a square cell with its caption above.

    Args:
        tiles: What to show, row by row.
        columns: Cells in a row, at least 1.
        cell: Side of a cell, pixels.
        title: Words above all.

    Returns:
        The sheet, white between the pictures.

    Raises:
        InvalidInputError: There are no tiles, or columns or cell are too small.
    """
    if not tiles:
        raise InvalidInputError("tiles", "none", "at least one picture")
    if columns < 1 or cell < 16:
        raise InvalidInputError("columns and cell", (columns, cell), "at least 1 and 16")
    columns = min(columns, len(tiles))
    pictures = [_fit(tile, cell) for tile in tiles]
    rows = [pictures[i : i + columns] for i in range(0, len(pictures), columns)]
    heights = [_CAPTION + max(len(picture) for picture in row) for row in rows]
    top = _TITLE if title else 0
    sheet = np.full(
        (top + sum(heights) + _GAP * (len(rows) + 1), columns * (cell + _GAP) + _GAP, 3),
        PAPER,
        dtype=np.uint8,
    )
    if title:
        write_text(sheet, _shorten(title, sheet.shape[1] - 2 * _GAP, 0.6), (_GAP, 28), size=0.6)
    y = top + _GAP
    for number, (row, height) in enumerate(zip(rows, heights, strict=True)):
        for column, picture in enumerate(row):
            x = _GAP + column * (cell + _GAP)
            caption = _shorten(tiles[number * columns + column].caption, cell, 0.45)
            write_text(sheet, caption, (x, y + 16))
            _paste(sheet, picture, x + (cell - picture.shape[1]) // 2, y + _CAPTION)
        y += height + _GAP
    return sheet


def overlay(
    rgb: Picture, grasps: Grasps, maps: GraspMaps[NDArray[Any]], matrix: ArrayLike, *,
    width_scale_px: float = 1.0, title: str = "",
) -> Picture:  # fmt: skip
    """The picture with its grasps, and beside it the maps that they were found in.

    Args:
        rgb: (H, W, 3) picture (colour, or `depth_picture` where there is none).
        grasps: Grasps in its pixels, best first.
        maps: (N, S, S) maps over the network's input.
        matrix: (3, 3) map from pixels of the picture to pixels of the input.
        width_scale_px: What the width map is multiplied with to give pixels of the input.
        title: Words above all.

    Returns:
        The sheet.

    Raises:
        InvalidInputError: ``rgb`` is no picture, or the maps are not (N, S, S).
    """
    check_picture(rgb)
    inside = grasps.transformed(matrix)
    seen = draw_window(rgb, matrix, maps.shape)
    top = width_range(maps)
    many = len(grasps) > 1
    scales: dict[MapKind, tuple[str, str]] = {
        "quality": ("0", "1"),
        "angle": ("-90 deg", "90 deg"),
        "width": ("0 px", f"{top * width_scale_px:.0f} px"),
    }
    captions = {
        "quality": "quality: how good a grasp here is",
        "angle": "angle of the opening (dark: low quality)",
        "width": "width: opening, input pixels",
    }
    count = "no grasp" if not len(grasps) else f"{len(grasps)} grasp{'s' * (len(grasps) > 1)}"
    tiles = [Tile(seen, f"{count}; jaws blue, opening red", grasps=grasps, ranks=many)]
    for kind, (low, high) in scales.items():
        picture = map_picture(maps, kind, width_top=top)
        shown = inside if kind == "quality" else None
        tiles.append(Tile(picture, captions[kind], (kind, low, high), shown, many))
    return contact_sheet(tiles, columns=2, cell=480, title=title)


def _fit(tile: Tile, cell: int) -> Picture:
    """The tile scaled so that its longer side fills the cell, grasps and scale with it."""
    check_picture(tile.rgb, f"tile {tile.caption!r}")
    scale = cell / max(tile.rgb.shape[:2])
    picture = draw_grasps(tile.rgb, tile.grasps or Grasps.empty(), scale=scale, ranks=tile.ranks)
    picture = picture[:cell, :cell]
    if tile.bar is None:
        return picture
    kind, low, high = tile.bar
    bar = color_bar(kind, picture.shape[1], low, high)
    whole = np.full((len(picture) + 4 + len(bar), picture.shape[1], 3), PAPER, dtype=np.uint8)
    whole[: len(picture)] = picture
    whole[len(picture) + 4 :] = bar
    return whole


def _paste(sheet: Picture, picture: Picture, x: int, y: int) -> None:
    sheet[y : y + picture.shape[0], x : x + picture.shape[1]] = picture


def _shorten(text: str, width: int, size: float) -> str:
    if text_width(text, size) <= width:
        return text
    while text and text_width(text + "...", size) > width:
        text = text[:-1]
    return text + "..."
