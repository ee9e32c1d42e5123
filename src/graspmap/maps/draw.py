"""Ground-truth maps from labelled grasps.

Letters in shapes: N orientation bins, (H, W) image. Pixels (x right, y down), centres at integers.
"""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry.grasps import Grasps
from graspmap.maps.grasp_maps import GraspMaps, bin_of

Singles = NDArray[np.float32]

Quality = Literal["binary", "soft", "strong"]
"""How the quality map falls off inside a grasp's region."""
Overlap = Literal["best", "published"]
"""Which of several grasps of one bin gives the maps their values at a pixel."""
Gaussian = Literal["grasp", "published"]
"""The frame in which the Gaussian of the quality is drawn."""
Peaks = Literal["one", "quality"]
"""How high the quality rises in the middle of a grasp's region: 1, or the grasp's own quality."""
Background = Literal["zero", "published"]
"""The value of cos 2a where there is no grasp: 0, or 1 as published."""

LEAST_QUALITY: dict[str, float] = {"binary": 1.0, "soft": 0.9, "strong": 0.0}
"""Least quality inside a region (thesis, Eq. 5.3, with max for its printed inner min)."""

LEAST_SIDE_PX = 1.5
"""Sides of a region shorter than this are drawn this long. Such a region always covers the pixel
nearest its centre, and a narrow one is a strip without gaps; exact strips thinner than a pixel
cover a few pixels anywhere along their length, or none, so their centre would be lost."""


def draw_maps(
    grasps: Grasps,
    shape: tuple[int, int],
    *,
    bins: int = 1,
    quality: Quality = "binary",
    drop_off: float = 2.0,
    peaks: Peaks = "one",
    overlap: Overlap = "best",
    gaussian: Gaussian = "grasp",
    width_scale: float = 1.0,
    background: Background = "zero",
) -> GraspMaps[Singles]:
    """Draw the maps that a network should give for an image with these grasps.

    A grasp's region is the centre third of its rectangle along the opening and the full jaw
    across it; a pixel belongs to it when its centre lies inside or on the border (to within 1e-6
    pixels). A side shorter than 1.5 pixels is drawn 1.5 pixels long (`LEAST_SIDE_PX`), so that no
    label vanishes: a grasp with its centre in the image marks at least the pixel nearest it.

    With G = exp(-(u^2 + v^2) / drop_off), u and v in [-1, 1] along the sides of the region,
    the quality inside is 1 (binary), max(0.9, G) (soft) or G (strong), and 0 outside; with
    ``peaks="quality"`` times the grasp's own.

    Grasps are drawn as given: where a data set repeats a grasp with several jaws, the caller
    chooses one.

    Args:
        grasps: Grasps in the image, pixels.
        shape: (H, W) of the maps.
        bins: Number N of orientation bins.
        quality: Fall-off of the quality inside the region.
        drop_off: g of the Gaussian, relative to the region's half sides (the thesis's sigma).
        peaks: ``one``: all grasps are equally good; ``quality``: as good as their own quality says,
            which lies in [0, 1] (see `graspmap.data.jaw_shares`).
        overlap: Inside one bin, ``best`` lets the grasp with the greatest G at the pixel give all
            four values (of equal ones the narrower grasp); ``published`` takes the greatest
            quality, the least angle and the greatest width, each on its own.
        gaussian: ``grasp`` draws G in the grasp's frame about its true centre; ``published`` over
            the axis-aligned box around the covered pixels, sampled on them.
        width_scale: Opening in pixels that the width map shows as 1.
        background: ``zero`` leaves all maps 0 outside; ``published`` sets cos to 1 there.

    Returns:
        Maps of (N, H, W) float32.

    Raises:
        InvalidInputError: The shape, bins, drop_off or width_scale is not positive; a quality that
            is to be drawn is not in [0, 1].
        UnknownNameError: A choice is not one of the listed names.

    References:
        Thesis, sections 5.1.1 and 5.1.2 (Eq. 5.1 to 5.4); the thesis's text garbles the soft form
        (min for max) and the published overlap rule (smallest width for greatest).
    """
    from graspmap.maps import _draw_kernel as kernel

    rows, columns = _check_shape(shape)
    _check_settings(bins, drop_off, width_scale)
    for name, value, choices in (
        ("quality", quality, Quality),
        ("peaks", peaks, Peaks),
        ("overlap", overlap, Overlap),
        ("gaussian", gaussian, Gaussian),
        ("background", background, Background),
    ):
        if value not in get_args(choices):
            raise UnknownNameError(name, str(value), get_args(choices))

    # Equal distances go to the first grasp drawn, which must be the narrower one.
    grasps = grasps[np.argsort(grasps.width, kind="stable")]
    regions, values = _regions(grasps), _values(grasps, width_scale, own=peaks == "quality")
    numbers = bin_of(grasps.angle, bins).astype(np.int32)
    boxed, low = gaussian == "published", LEAST_QUALITY[quality]
    maps = np.zeros((4, bins, rows, columns), np.float32)
    if background == "published":
        maps[1] = 1.0
    if overlap == "best":
        covered = np.empty(maps[0].size, np.int32)
        distance = np.empty(maps[0].size, np.float32)
        count = kernel.paint_best(regions, numbers, values, boxed, maps, covered, distance)
        if low < 1.0:
            inside = np.exp(distance[:count] * np.float32(-1.0 / drop_off))
            kernel.scale(np.maximum(inside, np.float32(low)), covered, maps[0].reshape(-1))
    else:
        kernel.paint_published(regions, numbers, grasps.angle, values, boxed, drop_off, low, maps)
    return GraspMaps(*maps)


def _regions(grasps: Grasps) -> NDArray[np.float64]:
    """(K, 6) centre x, centre y, cos a, sin a, half sides along the opening and along the jaw."""
    regions = np.empty((len(grasps), 6))
    regions[:, :2] = grasps.center
    regions[:, 2], regions[:, 3] = np.cos(grasps.angle), np.sin(grasps.angle)
    regions[:, 4], regions[:, 5] = grasps.width / 6, grasps.height / 2
    np.maximum(regions[:, 4:], LEAST_SIDE_PX / 2, out=regions[:, 4:])
    return regions


def _values(grasps: Grasps, width_scale: float, *, own: bool) -> Singles:
    """(K, 4) greatest quality, cos 2a, sin 2a and scaled width of each grasp."""
    wrong = (grasps.quality < 0) | (grasps.quality > 1)
    if own and wrong.any():
        raise InvalidInputError("quality to draw", grasps.quality[wrong][0], "from 0 to 1")
    values = np.empty((len(grasps), 4), np.float32)
    values[:, 0] = grasps.quality if own else 1.0
    values[:, 1], values[:, 2] = np.cos(2 * grasps.angle), np.sin(2 * grasps.angle)
    values[:, 3] = grasps.width / width_scale
    return values


def _check_shape(shape: Any) -> tuple[int, int]:
    try:
        rows, columns = (int(side) for side in shape)
    except (TypeError, ValueError):
        raise InvalidInputError("shape of the maps", shape, "(rows, columns)") from None
    if rows < 1 or columns < 1:
        raise InvalidInputError("shape of the maps", (rows, columns), "two positive numbers")
    return rows, columns


def _check_settings(bins: int, drop_off: float, width_scale: float) -> None:
    if bins != int(bins) or bins < 1:
        raise InvalidInputError("bins", bins, "a whole number, 1 or more")
    for name, value in (("drop_off", drop_off), ("width_scale", width_scale)):
        if not np.isfinite(value) or value <= 0:
            raise InvalidInputError(name, value, "a positive number")
