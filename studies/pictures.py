"""Pictures of the simulator: sheets to look at, and what a picture costs.

Each row shows one tabletop: colour, exact depth, depth of the stereo camera, normals and objects.
The time is that of the process on one core, without compilation.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from graspmap.pictures import Tile, contact_sheet, encode
from graspmap.simulation.procedural import make_object
from graspmap.simulation.render import (
    Appearance,
    Rendering,
    View,
    check_in_view,
    load_randomisation,
    render,
    sample_appearance,
    sample_sensor,
    sample_view,
    stereo_depth,
)
from graspmap.simulation.render.view import OutOfViewError
from graspmap.simulation.settle import UnsettledError, settle
from graspmap.simulation.tabletop import Tabletop
from studies._report import table, write

ABOUT = "sheets of the simulator's pictures with all channels, and what one costs"

Picture = NDArray[np.uint8]

_REPEATS = 5
_COLOURS = np.array(
    [(60, 60, 60), (230, 110, 60), (70, 150, 230), (110, 200, 90), (220, 200, 70), (170, 90, 200)]
)


def run(
    *,
    tabletops: int = 6,
    objects: int = 1,
    size: int = 512,
    seed: int = 0,
    randomisation: str = "default",
    out: Path | None = None,
) -> dict[str, float]:
    """Take pictures of random tabletops and print what one costs.

    Args:
        tabletops: How many; one row of the sheet each.
        objects: On each.
        size: Side of the pictures, pixels.
        seed: Of everything.
        randomisation: Shipped name or file.
        out: Folder for the sheets and the numbers.
    """
    chosen = load_randomisation(randomisation)
    tiles, plain, costs = [], [], []
    for tabletop, rng in _tabletops(tabletops, objects, seed):
        view = sample_view(chosen, rng, size)
        try:
            check_in_view(tabletop, view)
        except OutOfViewError as error:
            print(f"left out: {error}")
            continue
        appearance = sample_appearance(tabletop, chosen, rng)
        sensor = sample_sensor(chosen, rng)
        picture = render(tabletop, view, appearance)
        stereo = stereo_depth(tabletop, view, picture, sensor, rng)
        costs.append(_cost(tabletop, view, appearance))
        tiles += _row(picture, stereo)
        plain.append(Tile(picture.rgb))
    result = {"tabletops": len(plain), "size": size, "seed": seed, "objects": objects}
    result |= {name: float(np.median([cost[name] for cost in costs])) for name in costs[0]}
    table(("", "milliseconds, median"), [(name, result[name]) for name in costs[0]])
    write(out, "pictures", result)
    if out is not None:
        for name, some, columns in (("channels", tiles, 5), ("colours", plain, 4)):
            path = out / f"{name}_{objects}_{size}.png"
            path.write_bytes(encode(contact_sheet(some, columns=columns, cell=300)))
            print(f"written: {path}")
    return result


def _tabletops(
    count: int, objects: int, seed: int
) -> Iterator[tuple[Tabletop, np.random.Generator]]:
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        models = [make_object(seed, index * objects + k) for k in range(objects)]
        try:
            yield settle(models, rng), rng
        except UnsettledError as error:
            print(f"left out: {error}")


def _cost(tabletop: Tabletop, view: View, appearance: Appearance) -> dict[str, float]:
    """Least time of the process over some repeats, milliseconds."""
    sensor = sample_sensor(load_randomisation("plain"), np.random.default_rng(0))
    times = []
    for _ in range(_REPEATS):
        start = time.process_time()
        picture = render(tabletop, view, appearance)
        middle = time.process_time()
        stereo_depth(tabletop, view, picture, sensor, np.random.default_rng(0))
        times.append((middle - start, time.process_time() - middle))
    first, second = np.min(times, axis=0)
    return {"picture": 1e3 * first, "stereo depth": 1e3 * second, "both": 1e3 * (first + second)}


def _row(picture: Rendering, stereo: NDArray[np.float32]) -> list[Tile]:
    """All channels of one picture."""
    low, high = np.nanpercentile(picture.depth, [0.1, 99.9])
    normals = np.round((np.nan_to_num(picture.normals) + 1) * 127.5).astype(np.uint8)
    objects = _COLOURS[(picture.instance + 1) % len(_COLOURS)].astype(np.uint8)
    return [
        Tile(picture.rgb, "colour"),
        Tile(_depth(picture.depth, low, high), "depth"),
        Tile(_depth(stereo, low, high), "stereo depth"),
        Tile(normals, "normals"),
        Tile(objects, "objects"),
    ]


def _depth(depth: NDArray[np.float32], low: float, high: float) -> Picture:
    scaled = 1 - np.clip((np.nan_to_num(depth) - low) / (high - low), 0, 1)
    picture: NDArray[Any] = cv2.applyColorMap((255 * scaled).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    picture[np.isnan(depth)] = 0
    return np.ascontiguousarray(picture[..., ::-1])
