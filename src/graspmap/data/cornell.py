"""Cornell Grasping Dataset: pictures of real objects with hand-drawn grasp rectangles.

Layout, in any folders; all files but the first may be missing:

    pcdNNNNr.png      colour, 640 x 480 px in the original
    pcdNNNN.txt       organised point cloud, see `graspmap.data.point_cloud`
    pcdNNNNd.tiff     depth picture that others derive from the cloud: float32 metres, in the copies
                      in use the distance from the robot's base (the range), holes filled
    pcdNNNNcpos.txt   rectangles that hold, four lines ``x y`` each; the first edge is the opening
    pcdNNNNcneg.txt   rectangles that fail, the same

Rectangles with a NaN (there are some) or without an area are dropped and counted.

References:
    Y. Jiang, S. Moseson, A. Saxena: Efficient grasping from RGBD images: learning using a new
    rectangle representation. ICRA 2011.
    I. Lenz, H. Lee, A. Saxena: Deep learning for detecting robotic grasps. IJRR 2015.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from graspmap.data import files
from graspmap.data.appendix import LABELS_FILE, cornell_labels, cornell_objects
from graspmap.data.point_cloud import camera_depth, origin_distance, read_point_cloud
from graspmap.data.scene import Depth, Scene, Scenes
from graspmap.errors import (
    DatasetNotFoundError,
    FileFormatError,
    InvalidInputError,
    UnknownNameError,
)
from graspmap.files import read_bytes, read_lines
from graspmap.geometry.grasps import Grasps

logger = logging.getLogger(__name__)

DepthKind = Literal["z", "range"]

_NAME = re.compile(r"(pcd\d{4,})r\.png")
_LINE = "each rectangle is four lines with two numbers, x and y in pixels"


@dataclass(frozen=True)
class CornellFiles:
    """The files of one scene; None where one does not exist."""

    rgb: Path
    depth: Path | None
    cloud: Path | None
    positives: Path | None
    negatives: Path | None


@dataclass(frozen=True)
class LabelFile:
    """What a file of rectangles holds.

    Attributes:
        grasps: Its grasps, pixels of the picture.
        dropped: Number of rectangles left out because a number is NaN or they have no area.
    """

    grasps: Grasps
    dropped: int


class CornellScenes(Scenes):
    """The scenes of a folder with Cornell's files, sorted by number.

    A scene's id is ``pcdNNNN``; its labels are the class names of Appendix A of the thesis; its
    object_id is the run of neighbouring pictures with one specific class
    (`graspmap.data.appendix.cornell_objects`), or the id itself for a number that the appendix
    lacks.

    Args:
        root: Folder with the files, at any depth below it.
        depth: ``"z"``: along the camera's axis, from the point cloud where there is one, else the
            depth picture as it is. ``"range"``: the distance from the origin of the cloud's frame,
            as the GG-CNN weights were trained: the depth picture where there is one, else from
            the point cloud.
        labels: Give scenes the class names.

    Raises:
        DatasetNotFoundError: The folder does not exist or holds no ``pcdNNNNr.png``.
        FileFormatError: Two files give the same scene.
        UnknownNameError: ``depth`` is not one of the above.
    """

    kind = "cornell"

    def __init__(self, root: Path | str, *, depth: DepthKind = "z", labels: bool = True) -> None:
        if depth not in get_args(DepthKind):
            raise UnknownNameError("depth of cornell", str(depth), get_args(DepthKind))
        self.root = Path(root)
        self.depth, self.labels = depth, labels
        # Part of what is read: a corrected table must make another packed store.
        self._tables = blake2b(read_bytes(LABELS_FILE)).hexdigest() if labels else None
        found = _find(self.root)
        self.ids = tuple(sorted(found, key=lambda name: (int(name[3:]), name)))
        self._paths = [found[name] for name in self.ids]

    @staticmethod
    def recognises(root: Path) -> bool:
        """Whether the folder holds at least one scene in this layout."""
        return next(_names(root), None) is not None

    def paths(self, index: int) -> CornellFiles:
        """All files of scene ``index``, whether they are read or not."""
        return self._paths[index]

    def read(self, index: int) -> Scene:
        """Scene number ``index``.

        Raises:
            FileError: A file is damaged, or its size is not that of the colour picture.
        """
        paths, name = self._paths[index], self.ids[index]
        rgb = files.read_rgb(paths.rgb)
        rows, columns = rgb.shape[:2]
        return Scene(
            id=name,
            rgb=rgb,
            depth=self._read_depth(index, (rows, columns)),
            grasps=self.read_grasps(index),
            negatives=None if paths.negatives is None else read_labels(paths.negatives).grasps,
            object_id=self.object_id(index),
            labels=dict(cornell_labels().get(name, {})) if self.labels else {},
        )

    def read_grasps(self, index: int) -> Grasps | None:
        """Rectangles that hold, of scene ``index``; None where it has no file of them.

        Raises:
            FileError: The label file is damaged.
        """
        path = self._paths[index].positives
        return None if path is None else read_labels(path).grasps

    def files(self, index: int) -> tuple[Path, ...]:
        """The files that scene ``index`` is read from (those that exist)."""
        paths = self._paths[index]
        used = (paths.rgb, self._depth_path(paths), paths.positives, paths.negatives)
        return tuple(path for path in used if path is not None)

    def object_id(self, index: int) -> str:
        """Object of scene ``index``, as far as it can be told."""
        return cornell_objects().get(self.ids[index], self.ids[index])

    def _depth_path(self, paths: CornellFiles) -> Path | None:
        preferred = (paths.cloud, paths.depth) if self.depth == "z" else (paths.depth, paths.cloud)
        return next((path for path in preferred if path is not None), None)

    def _read_depth(self, index: int, shape: tuple[int, int]) -> Depth | None:
        path = self._depth_path(self._paths[index])
        if path is None:
            return None
        if path == self._paths[index].cloud:
            cloud = read_point_cloud(path, shape)
            return camera_depth(cloud) if self.depth == "z" else origin_distance(cloud)
        depth = files.read_depth(path)
        if depth.shape != shape:
            raise FileFormatError(
                path,
                f"is {depth.shape[1]} x {depth.shape[0]} px, but {self._paths[index].rgb.name} is "
                f"{shape[1]} x {shape[0]} px",
                "give the pictures of a scene one size",
            )
        return depth


def read_labels(path: Path) -> LabelFile:
    """Rectangles of a ``cpos.txt`` or ``cneg.txt``.

    Raises:
        FileError: The file is missing or no text, a line is not two numbers, or the last
            rectangle is not whole; the error names the line.
    """
    lines = read_lines(path)
    points = [_parse(path, number, line) for number, line in lines]
    if len(points) % 4:
        raise FileFormatError(
            path, f"ends in a rectangle of {len(points) % 4} lines (line {lines[-1][0]})", _LINE
        )
    corners = np.array(points, dtype=np.float64).reshape(-1, 4, 2)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            grasps = Grasps.from_corners(corners[~np.isnan(corners).any(axis=(1, 2))])
    except InvalidInputError as error:
        raise FileFormatError(path, f"holds numbers that are no pixels ({error})", _LINE) from error
    grasps = grasps[(grasps.width > 0) & (grasps.height > 0)]
    dropped = len(corners) - len(grasps)
    if dropped:
        logger.debug("%s: %d of %d rectangles dropped", path, dropped, len(corners))
    return LabelFile(grasps, dropped)


def _parse(path: Path, number: int, line: str) -> tuple[float, float]:
    parts = line.split()
    try:
        x, y = map(float, parts)
    except ValueError as error:
        found = f"has {len(parts)} numbers" if len(parts) != 2 else "is not two numbers"
        raise FileFormatError(path, f"line {number} {found}: {line!r}", _LINE) from error
    if math.isinf(x) or math.isinf(y):
        raise FileFormatError(path, f"line {number} is infinite: {line!r}", _LINE)
    return x, y


def _find(root: Path) -> dict[str, CornellFiles]:
    found: dict[str, CornellFiles] = {}
    for folder, name, siblings in _names(root):
        parts = {
            part: folder / f"{name}{suffix}" if f"{name}{suffix}" in siblings else None
            for part, suffix in (
                ("depth", "d.tiff"),
                ("cloud", ".txt"),
                ("positives", "cpos.txt"),
                ("negatives", "cneg.txt"),
            )
        }
        path = folder / f"{name}r.png"
        if name in found:
            raise FileFormatError(
                path, f"scene {name} is also in {found[name].rgb.parent}", "keep one of them"
            )
        found[name] = CornellFiles(rgb=path, **parts)
    if not found:
        raise DatasetNotFoundError(
            root,
            "no Cornell scenes (pcdNNNNr.png) in it" if root.is_dir() else "no such folder",
            "name the folder that holds the scenes or the folders 01 to 10",
        )
    return found


def _names(root: Path) -> Iterator[tuple[Path, str, frozenset[str]]]:
    """Folder, scene name and the folder's files, for each colour picture below ``root``."""
    for folder, names in files.visible_files(root):
        siblings = frozenset(names)
        for name in names:
            if match := _NAME.fullmatch(name):
                yield folder, match[1], siblings
