"""Which square of a picture a network sees, as a map onto its input.

Letters in shapes: H rows, W columns of the picture, size the side of the square input. Matrices map
homogeneous pixels (x, y, 1) of the picture to the input frame (see CONVENTIONS.md).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import PlainValidator

from graspmap.data.table import Table, find_table
from graspmap.errors import InvalidInputError
from graspmap.geometry import affine
from graspmap.geometry.camera import Camera

CLOSE_UP = r"^(\d{1,4}(?:\.\d+)?) cm$"
"""How a side in centimetres is written."""

MOST_PX = 16384

VIEW_ALLOWED = f"'contain', 'cover', a side in pixels, 1 to {MOST_PX}, or in centimetres ('36 cm')"


def _checked_view(view: object) -> int | str:
    """For pydantic: a view as it is.

    Raises:
        ValueError: It is none.
    """
    try:
        close_up_m(view)  # type: ignore[arg-type]
    except InvalidInputError:
        raise ValueError(f"allowed: {VIEW_ALLOWED}") from None
    assert isinstance(view, int | str)
    return view


View = Annotated[int | str, PlainValidator(_checked_view)]
"""Which square of a picture is used: all of it, the largest inside it, a side in pixels, or a side
in centimetres (``"36 cm"``): a close-up of what stands on the table, see `input_window`."""

Floats = NDArray[np.float64]
Region = tuple[float, float, float, float]

_SAMPLES_A_SIDE = 128
_LEAST_RISE_M = 0.004  # what rises less is not told from the table's noise
_DEEPEST_NOISE_M = 0.03
_DEVIATIONS = 4.0
_LEAST_AREA_M2 = 5e-5  # of an object seen from above; specks of noise are smaller
_MARGIN = 1.2  # side of the window over that of what stands on the table, at least


def close_up_m(view: View) -> float | None:
    """Side of a close-up in metres, such as 0.36 of ``"36 cm"``; None for the other views.

    Raises:
        InvalidInputError: It is no view.
    """
    if isinstance(view, str) and view not in ("contain", "cover"):
        found = re.match(CLOSE_UP, view)
        if found is None or not float(found[1]) > 0:
            raise InvalidInputError("view", repr(view), VIEW_ALLOWED)
        return float(found[1]) / 100
    if not isinstance(view, str) and (
        not isinstance(view, int) or isinstance(view, bool) or not 1 <= view <= MOST_PX
    ):
        raise InvalidInputError("view", repr(view), VIEW_ALLOWED)
    return None


def input_window(
    shape: tuple[int, int],
    size: int,
    *,
    view: View = "contain",
    region_xywh: Region | None = None,
    depth_m: NDArray[np.float32] | None = None,
    camera: Camera | None = None,
    table: Table | None = None,
) -> Floats:
    """(3, 3) map of a square of a picture onto size x size pixels.

    Args:
        shape: (rows, columns) of the picture.
        size: Side of the input, pixels.
        view: ``contain``: the square's side is the picture's longer side, so nothing is lost;
            ``cover``: the shorter side, so nothing is added; a number: that many pixels; all these
            about the picture's middle. ``"36 cm"``: the square of that side on the table about
            what stands on it, so that the network sees all things at one scale, however far the
            camera; where more stands on the table than fits, the square grows.
        region_xywh: First column x, first row y, width and height of a region of interest, pixels.
            The square then has its longer side and its centre, whatever the view; but a close-up is
            about what stands on the table inside the region.
        depth_m: (H, W) metres, NaN in holes; needed by a side in centimetres.
        camera: Intrinsics; needed by it, too.
        table: What the depth shows objects on, where it was found already (see `shown_table`).

    Raises:
        InvalidInputError: A size is not positive, the view is none of these, the region is not
            four finite numbers with sizes above 0, or a close-up lacks depth or camera.
    """
    rows, columns = shape
    if region_xywh is not None:
        region_xywh = checked_region(region_xywh)
    side_m = close_up_m(view)
    if side_m is not None:
        depth_m, camera = _metric(view, depth_m, camera)
        table = table or shown_table(depth_m, region_xywh, view=view, camera=camera)
        left, top, right, bottom = _inside(shape, region_xywh or (0, 0, columns, rows))
        part = depth_m[top:bottom, left:right]
        return _close_up(part, camera, side_m, size, table, (left, top))
    if region_xywh is not None:
        x, y, width, height = region_xywh
        longer = max(width, height)
        return affine.window(x + (width - longer) / 2, y + (height - longer) / 2, longer, size)
    side = {"contain": max(rows, columns), "cover": min(rows, columns)}.get(str(view), view)
    assert isinstance(side, int)
    # Whole pixels: a window of the input's own size is then cut out without resampling.
    return affine.window((columns - side) // 2, (rows - side) // 2, side, size)


def shown_table(
    depth_m: NDArray[np.float32],
    region_xywh: Region | None = None,
    *,
    view: View = "contain",
    camera: Camera | None = None,
) -> Table:
    """The table of a picture, or that about a region of interest, whatever else the picture shows.

    A region may hold nothing but the object: a close-up shows the table beside it.

    Args:
        depth_m: (H, W) metres, NaN in holes.
        region_xywh: First column, first row, width and height of the region; None: all of it.
        view: What a network sees of it.
        camera: Intrinsics; None where the view needs none.

    Raises:
        InvalidInputError: There is nothing but holes.
    """
    side_m = close_up_m(view)
    if region_xywh is None or side_m is None or camera is None:
        return find_table(depth_m, region_xywh)
    x, y, width, height = region_xywh
    middle = (x + (width - 1) / 2, y + (height - 1) / 2)
    side = _pixels(side_m, find_table(depth_m), middle, camera)
    wide, high = max(width, side), max(height, side)
    return find_table(depth_m, (x + (width - wide) / 2, y + (height - high) / 2, wide, high))


def checked_region(region_xywh: Sequence[float]) -> Region:
    """A region of interest as four numbers: first column x, first row y, width and height.

    Raises:
        InvalidInputError: Not four finite numbers, or a width or height that is not positive.
    """
    try:
        numbers = tuple(float(v) for v in region_xywh)
    except (TypeError, ValueError):
        numbers = ()
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)) or min(numbers[2:]) <= 0:
        allowed = "x, y, width, height in pixels, sizes above 0"
        raise InvalidInputError("region", region_xywh, allowed)
    x, y, width, height = numbers
    return x, y, width, height


def _inside(shape: tuple[int, int], region_xywh: Region) -> tuple[int, int, int, int]:
    """First column and row of a region and those after its last; at least one pixel."""
    rows, columns = shape
    x, y, width, height = region_xywh
    left, top = (min(max(0, math.ceil(v)), n - 1) for v, n in ((x, columns), (y, rows)))
    return left, top, max(left + 1, math.ceil(x + width)), max(top + 1, math.ceil(y + height))


def _metric(
    view: View, depth_m: NDArray[np.float32] | None, camera: Camera | None
) -> tuple[NDArray[np.float32], Camera]:
    """What a close-up needs.

    Raises:
        InvalidInputError: It is missing.
    """
    if depth_m is None or camera is None:
        lacking = "without depth" if depth_m is None else "without a camera"
        raise InvalidInputError(
            f"view {view!r}", lacking, "a depth picture and its camera, to know the scale"
        )
    return depth_m, camera


def _close_up(
    part_m: NDArray[np.float32],
    camera: Camera,
    side_m: float,
    size: int,
    table: Table,
    first: tuple[int, int],
) -> Floats:
    """The square of ``side_m`` about what stands on the table in a part of the picture.

    Args:
        part_m: (H, W) metres, NaN in holes.
        camera: Intrinsics of the picture.
        side_m: Side of the square on the table.
        size: Side of the input, pixels.
        table: The table, in pixels of the picture.
        first: Column and row of the part's first pixel.
    """
    standing = _standing(part_m, table, camera, first)
    first_x, last_x, first_y, last_y = standing
    middle = ((first_x + last_x) / 2, (first_y + last_y) / 2)
    side = max(
        _pixels(side_m, table, middle, camera),
        _MARGIN * max(last_x - first_x + 1, last_y - first_y + 1),
    )
    return affine.window(middle[0] + 0.5 - side / 2, middle[1] + 0.5 - side / 2, side, size)


def _pixels(length_m: float, table: Table, at: tuple[float, float], camera: Camera) -> float:
    """How long a length on the table looks at a pixel."""
    return length_m * math.sqrt(camera.fx * camera.fy) * table.inverse_depth(*at)


def _standing(
    part_m: NDArray[np.float32], table: Table, camera: Camera, first: tuple[int, int]
) -> tuple[float, float, float, float]:
    """First and last column, first and last row of all that rises from the table.

    The middle of the part twice, where nothing does.
    """
    rows, columns = part_m.shape
    step = max(1, max(rows, columns) // _SAMPLES_A_SIDE)
    shown = table.transformed(np.array([[1.0, 0, -first[0]], [0, 1, -first[1]], [0, 0, 1]]))
    first_row, first_column = (min(step // 2, (n - 1) // 2) for n in (rows, columns))
    risen = (shown.depth_m(part_m.shape) - part_m)[first_row::step, first_column::step]
    low = np.nan_to_num(risen, nan=0.0)
    # Half of the picture is table: what lies a little lower says how far its noise reaches. What
    # lies much lower is a floor beside it.
    below = low[(low < 0) & (low > -_DEEPEST_NOISE_M)]
    noise = 1.4826 * float(np.median(-below)) if below.size else 0.0
    standing = (low > max(_LEAST_RISE_M, _DEVIATIONS * noise)).astype(np.uint8)
    _, _, boxes, middles = cv2.connectedComponentsWithStats(standing, connectivity=8)
    kept = []
    for box, middle in zip(boxes[1:], middles[1:], strict=True):
        at = (middle[0] * step + first[0], middle[1] * step + first[1])
        scale = _pixels(1.0, table, at, camera) / step
        if box[cv2.CC_STAT_AREA] >= _LEAST_AREA_M2 * scale * scale:
            kept.append(box)
    x, y = first
    if not kept:
        x_middle, y_middle = x + (columns - 1) / 2, y + (rows - 1) / 2
        return x_middle, x_middle, y_middle, y_middle
    left, top = (min(box[i] for box in kept) for i in (cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP))
    right = max(box[cv2.CC_STAT_LEFT] + box[cv2.CC_STAT_WIDTH] for box in kept) - 1
    bottom = max(box[cv2.CC_STAT_TOP] + box[cv2.CC_STAT_HEIGHT] for box in kept) - 1
    x, y = x + first_column, y + first_row
    return (
        float(left * step + x),
        float(right * step + x),
        float(top * step + y),
        float(bottom * step + y),
    )
