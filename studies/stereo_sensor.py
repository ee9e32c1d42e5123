"""The depth camera of the simulator beside real pairs of perfect and stereo depth.

Jacquard gives both for each scene. From the pairs: the lattice of disparities (baseline times focal
length), how disparities are drawn to whole pixels, the noise about that, holes on the object,
around it and elsewhere, holes by the distance to an edge, and on which side the second camera
stands. The same is measured on pictures of our own objects with `Sensor` as it ships.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from graspmap.data.files import read_depth, read_mask
from graspmap.data.jacquard import jacquard_camera
from graspmap.pictures import Tile, contact_sheet, encode
from graspmap.simulation.procedural import make_object
from graspmap.simulation.render import (
    Sensor,
    check_in_view,
    jacquard_view,
    plain_appearance,
    render,
    stereo_depth,
)
from graspmap.simulation.render.view import OutOfViewError
from graspmap.simulation.settle import UnsettledError, settle
from studies._report import table, write

ABOUT = "holes, noise and steps of the simulated depth camera, against Jacquard's stereo depth"

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_SIDE = 1024
_NEAR_PX = 20  # around the object
_JUMP_PX = 1.0  # of disparity, an edge
_DISTANCES = (1, 3, 5, 10)
_ONE_STEP = 1e-5  # of 1 / depth; a step of any depth camera is larger


@dataclass(frozen=True, eq=False)
class Pair:
    """Exact and measured depth of a scene, (H, W) metres, NaN in holes; and its object's mask."""

    exact: Floats
    found: Floats
    mask: Mask


def run(
    data: Path, *, scenes: int = 20, seed: int = 0, out: Path | None = None
) -> dict[str, dict[str, float]]:
    """Measure both and print them side by side.

    Args:
        data: Folder with Jacquard's scenes.
        scenes: How many of our own.
        seed: Of our own.
        out: Folder for the numbers and a sheet of pictures.
    """
    real = list(_real(data))
    ours = list(_ours(scenes, seed))
    strength = _lattice(real) / Sensor().subpixel
    camera = jacquard_camera(_SIDE, _SIDE)
    assert camera is not None
    result = {
        "real": {"baseline_m": strength / camera.fx} | _measure(real, strength),
        "ours": {"baseline_m": Sensor().baseline_m}
        | _measure(ours, camera.fx * Sensor().baseline_m),
    }
    print(f"{len(real)} real pairs, {len(ours)} of our own (seed {seed})")
    rows = [(name, result["real"][name], result["ours"][name]) for name in result["real"]]
    table(("", "real", "ours"), rows)
    write(out, "stereo_sensor", result)
    if out is not None:
        tiles = [
            tile
            for pairs in (real, ours)
            for pair in pairs[:: max(len(pairs) // 4, 1)][:4]
            for tile in _tiles(pair)
        ]
        path = out / "stereo_sensor.png"
        path.write_bytes(encode(contact_sheet(tiles, columns=3, cell=360)))
        print(f"written: {path}")
    return result


def _real(data: Path) -> Iterator[Pair]:
    for path in sorted(data.glob("*/*_perfect_depth.tiff")):
        stem = str(path).removesuffix("perfect_depth.tiff")
        yield Pair(
            read_depth(path).astype(float),
            read_depth(Path(f"{stem}stereo_depth.tiff")).astype(float),
            read_mask(Path(f"{stem}mask.png")),
        )


def _ours(count: int, seed: int) -> Iterator[Pair]:
    view = jacquard_view(_SIDE)
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        try:
            tabletop = settle([make_object(seed, index)], rng)
            check_in_view(tabletop, view)
        except (UnsettledError, OutOfViewError) as error:
            print(f"left out: {error}")
            continue
        picture = render(tabletop, view, plain_appearance(tabletop))
        found = stereo_depth(tabletop, view, picture, Sensor(), rng)
        yield Pair(picture.depth.astype(float), found.astype(float), picture.mask)


def _lattice(pairs: list[Pair]) -> float:
    """Metres times steps: 1 / depth takes whole multiples of one over this number."""
    steps = []
    for pair in pairs:
        inverse = np.unique(1 / pair.found[~np.isnan(pair.found)])
        gaps = np.diff(inverse)
        # Rounding to single precision makes several of one value; most others are neighbours.
        steps.append(np.median(gaps[gaps > _ONE_STEP]))
    return 1 / float(np.median(steps))


def _measure(pairs: list[Pair], strength: float) -> dict[str, float]:
    """Every figure, as the mean over scenes or from all pixels together."""
    shares = np.mean([_holes(pair) for pair in pairs], axis=0)
    spread = np.median([_spread(pair) for pair in pairs])
    fractions, errors = _locking(pairs, strength)
    near_whole = np.abs(fractions) < 0.25
    slope = float(np.polyfit(fractions[near_whole], errors[near_whole], 1)[0])
    noise = errors[near_whole] - slope * fractions[near_whole]
    by_distance = _by_distance(pairs, strength)
    right, left = (_hidden_holes(pairs, strength, side) for side in (1, -1))
    return {
        "holes on the object": float(shares[0]),
        "holes around it": float(shares[1]),
        "holes elsewhere": float(shares[2]),
        **{f"holes {d} px from an edge": s for d, s in by_distance.items()},
        "holes in the shadow, second camera right": right,
        "holes in the shadow, second camera left": left,
        "error on the table, mm (half of 16 to 84 %)": 1000 * float(spread),
        "locking": -slope,
        "noise at whole pixels, px": float(noise.std()),
    }


def _holes(pair: Pair) -> tuple[float, float, float]:
    """Share of holes on the object, around it, elsewhere."""
    size = 2 * _NEAR_PX + 1
    near = cv2.dilate(pair.mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    hole = np.isnan(pair.found)
    parts = (pair.mask, near & ~pair.mask, ~near)
    on, around, elsewhere = (float(hole[part].mean()) for part in parts)
    return on, around, elsewhere


def _far(pair: Pair) -> Mask:
    """Table well away from the object, with depth."""
    near = cv2.dilate(pair.mask.astype(np.uint8), np.ones((61, 61), np.uint8)) > 0
    return ~near & ~np.isnan(pair.found)


def _spread(pair: Pair) -> float:
    low, high = np.percentile((pair.found - pair.exact)[_far(pair)], [16, 84])
    return float(high - low) / 2


def _locking(pairs: list[Pair], strength: float) -> tuple[Floats, Floats]:
    """On the table: distance of the true disparity to a whole pixel, and the error, pixels."""
    fractions, errors = [], []
    for pair in pairs:
        far = _far(pair)
        true, found = strength / pair.exact[far], strength / pair.found[far]
        good = np.abs(found - true) < 0.5
        fractions.append((true - np.round(true))[good])
        errors.append((found - true)[good])
    return np.concatenate(fractions), np.concatenate(errors)


def _shadow(disparity: Floats) -> Mask:
    """What a camera to the right does not see, from the first one's depths alone."""
    place = np.arange(disparity.shape[1]) - disparity
    nearest = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1]
    out = np.zeros(disparity.shape, np.bool_)
    out[:, :-1] = place[:, :-1] > nearest[:, 1:] + 0.3
    return out


def _hidden_holes(pairs: list[Pair], strength: float, side: int) -> float:
    """Share of holes where a second camera on that side (1 right, -1 left) would see nothing."""
    holes = total = 0
    for pair in pairs:
        hidden = _shadow((strength / pair.exact)[:, ::side])[:, ::side]
        holes, total = holes + np.isnan(pair.found[hidden]).sum(), total + hidden.sum()
    return float(holes / max(total, 1))


def _by_distance(pairs: list[Pair], strength: float) -> dict[int, float]:
    """Share of holes within each distance of an edge and not within the one before."""
    holes, total = np.zeros(len(_DISTANCES)), np.zeros(len(_DISTANCES))
    for pair in pairs:
        disparity = strength / pair.exact
        across = np.abs(np.diff(disparity, axis=1, append=disparity[:, -1:]))
        down = np.abs(np.diff(disparity, axis=0, append=disparity[-1:]))
        calm = (np.maximum(across, down) <= _JUMP_PX).astype(np.uint8)
        away = cv2.distanceTransform(calm, cv2.DIST_L2, 5)
        hole, seen = np.isnan(pair.found), ~_shadow(disparity)
        for k, limit in enumerate(_DISTANCES):
            ring = seen & (away <= limit) & (away > (_DISTANCES[k - 1] if k else -1))
            holes[k], total[k] = holes[k] + hole[ring].sum(), total[k] + ring.sum()
    return {d: float(h / max(t, 1)) for d, h, t in zip(_DISTANCES, holes, total, strict=True)}


def _tiles(pair: Pair) -> list[Tile]:
    """Exact depth, measured depth and the error around the object."""
    rows, columns = np.nonzero(pair.mask)
    half = max(np.ptp(rows), np.ptp(columns)) // 2 + 40
    y, x = int(rows.mean()), int(columns.mean())
    part = np.s_[max(y - half, 0) : y + half, max(x - half, 0) : x + half]
    exact, found = pair.exact[part], pair.found[part]
    low, high = float(np.nanmin(exact)), float(np.nanmax(exact))
    return [
        Tile(_colours(exact, low, high), "exact"),
        Tile(_colours(found, low, high), "stereo"),
        Tile(_colours(found - exact, -0.015, 0.015), "error, -15 to 15 mm"),
    ]


def _colours(values: Floats, low: float, high: float) -> NDArray[np.uint8]:
    scaled = np.clip((np.nan_to_num(values) - low) / max(high - low, 1e-9), 0, 1)
    picture: NDArray[Any] = cv2.applyColorMap((255 * scaled).astype(np.uint8), cv2.COLORMAP_TURBO)
    picture[np.isnan(values)] = 0
    return np.ascontiguousarray(picture[..., ::-1])
