"""What `graspmap demo` shows: each scene with its grasps, the quality map, and the trial."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from graspmap.data.images import warp
from graspmap.data.scene import Scene
from graspmap.evaluation.report.gallery import Exhibit, window_around
from graspmap.evaluation.report.page import render_page
from graspmap.evaluation.trial_results import TriedGrasp
from graspmap.files import write_text
from graspmap.geometry.affine import crop, resize
from graspmap.geometry.grasps import Grasps
from graspmap.inference.detector import Detection
from graspmap.pictures import Tile, contact_sheet, draw_grasps, map_picture
from graspmap.pictures.draw import Picture

PAGE_FILE = "index.html"
JSON_FILE = "demo.json"
"""What the page's numbers are looked up in."""

_SIDE_PX = 360
_GRASPS, _QUALITY = "grasps: jaws blue, opening red", "quality: bright where a grasp is good"


def make_exhibit(
    scene: Scene,
    found: Detection,
    tried: Sequence[TriedGrasp],
    *,
    calibrated: bool,
    film: bytes | None = None,
) -> Exhibit:
    """One scene with the grasps that were found in it and what became of them.

    Args:
        scene: With colour.
        found: What the detector said about it.
        tried: The trial of each grasp, best first; at least one.
        calibrated: Whether quality is the probability that a grasp holds.
        film: Animated WebP of the best one's trial.
    """
    best, many = tried[0], len(tried) > 1
    quality = float(best.grasp.quality[0]) if len(best.grasp) else None
    words = " ".join(f"{t.rank + 1}. {_ending(t)}" if many else _ending(t) for t in tried)
    return Exhibit(
        scene=scene.id,
        why=best.outcome,
        words=f"{name_of(scene)}. {words}",
        numbers={"probability to hold" if calibrated else "quality": quality},
        pictures=_pictures(scene, found),
        film=film,
    )


def name_of(scene: Scene) -> str:
    """What a generated scene shows: ``mug (handled)``; its id where its record does not say."""
    names = [scene.labels[kind] for kind in ("specific", "general") if kind in scene.labels]
    return f"{names[0]} ({names[1]})" if len(names) == 2 else scene.id


def demo_picture(exhibits: Sequence[Exhibit], title: str) -> Picture:
    """All scenes on one sheet: each with its grasps, and its quality map beside it.

    Args:
        exhibits: At least one.
        title: Words above all.
    """
    tiles = []
    for exhibit in exhibits:
        name, quality = next(iter(exhibit.numbers.items()))
        number = "" if quality is None else f" {quality:.2f}"
        # The map is what the network draws; the number may be what a calibration makes of it.
        drawn = "" if name == "quality" else "quality map; "
        tiles += [
            Tile(exhibit.pictures[_GRASPS], f"{exhibit.words.partition('. ')[0]}: {exhibit.why}"),
            Tile(exhibit.pictures[_QUALITY], f"{drawn}{name}{number}"),
        ]
    return contact_sheet(tiles, columns=4, cell=300, title=title)


def write_demo(folder: Path | str, summary: Mapping[str, Any], exhibits: Sequence[Exhibit]) -> Path:
    """Write ``index.html``: what was found and tried, in one file.

    Args:
        folder: Where it is written; made if needed.
        summary: ``weights``, ``depth``, ``calibrated``, ``best`` (as
            `TrialEvaluation.score_of` gives it), ``trials`` (as its ``to_dict``) and ``gallery``
            (the exhibits as dictionaries).
        exhibits: The scenes.

    Returns:
        The file.

    Raises:
        StorageFullError: The disk is full.
        FileError: The folder cannot be written to.
    """
    path = Path(folder) / PAGE_FILE
    write_text(path, render_page("demo.html.j2", summary, {}, gallery=exhibits, source=JSON_FILE))
    return path


def _ending(tried: TriedGrasp) -> str:
    if tried.outcome == "held":
        return "The grasp held."
    return f"The grasp failed, {tried.outcome}: {tried.reason}."


def _pictures(scene: Scene, found: Detection) -> dict[str, Picture]:
    """A close-up of the scene with the grasps, and the same piece of the quality map."""
    assert scene.rgb is not None  # generated scenes have colour
    grasps = found.grasps
    x, y, side = window_around(scene.shape, [grasps, scene.grasps or Grasps.empty()])
    matrix = resize(_SIDE_PX / side) @ crop(x, y)
    shown, many = grasps.transformed(matrix), len(grasps) > 1
    quality = warp(
        map_picture(found.maps, "quality"), matrix @ np.linalg.inv(found.matrix), _SIDE_PX
    )
    return {
        _GRASPS: draw_grasps(warp(scene.rgb, matrix, _SIDE_PX), shown, ranks=many),
        _QUALITY: draw_grasps(quality, shown, ranks=many),
    }
