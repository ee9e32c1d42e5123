"""Jacquard: pictures of rendered objects with grasps that succeeded in a simulation.

Layout, nested by object or flat, all files but the first may be missing:

    <object>/<i>_<object>_RGB.png             colour
    <object>/<i>_<object>_mask.png            0, and 255 on the object
    <object>/<i>_<object>_perfect_depth.tiff  float32 metres, LZW
    <object>/<i>_<object>_stereo_depth.tiff   the same with the errors of stereo; -1 marks holes
    <object>/<i>_<object>_grasps.txt          ``x;y;theta;opening;jaw`` a line
    <object>/<i>_<object>_negatives.txt       our addition: grasps that failed, and how
    <object>/<i>_<object>_camera.json         our addition: intrinsics and, where it is known, the
                                              pose (``T_world_camera``, 4 x 4), where not Jacquard's
    <object>/<i>_<object>_scene.json          our addition: the record of a generated scene; of it
                                              only the objects' class names are read here

``x;y`` is the centre in pixels, ``theta`` the direction of the opening in degrees, CLOCKWISE on
screen (`Grasps` has it counter-clockwise), ``opening`` and ``jaw`` are pixels. A grasp repeats once
for each jaw size with which it held.

References:
    A. Depierre, E. Dellandrea, L. Chen: Jacquard: A Large Scale Dataset for Robotic Grasp
    Detection. IROS 2018.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from graspmap.data import files
from graspmap.data.jacquard_labels import (
    format_grasps,
    format_negatives,
    read_class_names,
    read_grasps,
    read_negatives,
    smallest_jaws,
)
from graspmap.data.scene import Depth, Scene, Scenes
from graspmap.errors import (
    DatasetNotFoundError,
    FileFormatError,
    InvalidInputError,
    UnknownNameError,
)
from graspmap.files import read_bytes, write_text
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.transforms import RigidTransform

JACQUARD_SIDE_PX = 1024
"""Side of Jacquard's pictures, in which its server counts pixels."""

FIELD_OF_VIEW_RAD = math.radians(30.0)
"""Field of view of Jacquard's camera, found from its files: focal length 1910.8 px."""

TILT_RAD = math.radians(10.0)
"""Between Jacquard's optical axis and the vertical: the camera is turned about the image's x axis,
so that it sees the table's far side at the top. Found from its files, to 0.001 degrees."""

TABLE_DISTANCE_M = 1.5
"""From Jacquard's camera to the table along the optical axis, found from its files to 0.1 mm."""

DepthKind = Literal["perfect", "stereo"]
Jaws = Literal["all", "smallest"]

_NAME = re.compile(r"(?P<number>\d+)_(?P<object>.+)")


@dataclass(frozen=True)
class JacquardFiles:
    """The files of one scene; None where one does not exist."""

    rgb: Path
    mask: Path | None
    perfect_depth: Path | None
    stereo_depth: Path | None
    grasps: Path | None
    negatives: Path | None
    camera: Path | None
    record: Path | None


SUFFIXES = {
    "rgb": "_RGB.png",
    "mask": "_mask.png",
    "perfect_depth": "_perfect_depth.tiff",
    "stereo_depth": "_stereo_depth.tiff",
    "grasps": "_grasps.txt",
    "negatives": "_negatives.txt",
    "camera": "_camera.json",
    "record": "_scene.json",
}
"""How the names of a scene's files end, by attribute of `JacquardFiles`."""


class JacquardScenes(Scenes):
    """The scenes of a folder in Jacquard's layout, sorted by object and number.

    A scene's id is ``<i>_<object>``, its object_id ``<object>``. Grasps are in the pixels of the
    scene's own picture. Its labels are what the record of a generated scene says of its one object:
    its shape (``specific``) and the family of the shape (``general``); scenes of several objects,
    of meshes, and Jacquard's own have none.

    Args:
        root: Folder with the files, at any depth below it.
        depth: Which depth a scene gets: ``"perfect"`` or ``"stereo"``.
        jaws: ``"all"`` gives the grasps as in the file, ``"smallest"`` each with its smallest jaw
            only (see `smallest_jaws`).

    Raises:
        DatasetNotFoundError: The folder does not exist or holds no ``*_RGB.png``.
        FileFormatError: Two files give the same scene.
        UnknownNameError: ``depth`` or ``jaws`` is not one of the above.
    """

    kind = "jacquard"

    def __init__(
        self, root: Path | str, *, depth: DepthKind = "perfect", jaws: Jaws = "all"
    ) -> None:
        for name, value, choices in (
            ("depth of jacquard", depth, get_args(DepthKind)),
            ("jaws of jacquard", jaws, get_args(Jaws)),
        ):
            if value not in choices:
                raise UnknownNameError(name, str(value), choices)
        self.root = Path(root)
        self.depth, self.jaws = depth, jaws
        found = _find(self.root)
        self.ids = tuple(sorted(found, key=_order))
        self._paths = [found[name] for name in self.ids]

    @staticmethod
    def recognises(root: Path) -> bool:
        """Whether the folder holds at least one scene in this layout."""
        return next(_names(root), None) is not None

    def paths(self, index: int) -> JacquardFiles:
        """All files of scene ``index``, whether they are read or not."""
        return self._paths[index]

    def read(self, index: int) -> Scene:
        """Scene number ``index``.

        Raises:
            FileError: A file is damaged, or its size is not that of the colour picture.
        """
        paths, name = self._paths[index], self.ids[index]
        depth_path = self._depth_path(paths)
        # Colour takes as long to decode as the other two together: side by side.
        with ThreadPoolExecutor(1) as beside:
            coming = beside.submit(files.read_rgb, paths.rgb)
            depth = None if depth_path is None else files.read_depth(depth_path)
            mask = None if paths.mask is None else files.read_mask(paths.mask)
            rgb = coming.result()
        for path, image in ((depth_path, depth), (paths.mask, mask)):
            if path is not None and image is not None and image.shape != rgb.shape[:2]:
                raise FileFormatError(
                    path,
                    f"is {image.shape[1]} x {image.shape[0]} px, but {paths.rgb.name} is "
                    f"{rgb.shape[1]} x {rgb.shape[0]} px",
                    "give the pictures of a scene one size",
                )
        camera, pose = _read_camera(paths.camera, rgb.shape[1], rgb.shape[0])
        return Scene(
            id=name,
            rgb=rgb,
            depth=depth,
            mask=mask,
            grasps=self.read_grasps(index),
            negatives=None if paths.negatives is None else read_negatives(paths.negatives)[0],
            camera=camera,
            T_world_camera=pose,
            object_id=self.object_id(index),
            labels={} if paths.record is None else read_class_names(paths.record),
        )

    def read_grasps(self, index: int) -> Grasps | None:
        """Labelled grasps of scene ``index``; None where it has no label file.

        Raises:
            FileError: The label file is damaged.
        """
        path = self._paths[index].grasps
        if path is None:
            return None
        grasps = read_grasps(path)
        return smallest_jaws(grasps) if self.jaws == "smallest" else grasps

    def files(self, index: int) -> tuple[Path, ...]:
        """The files that scene ``index`` is read from (those that exist)."""
        paths = self._paths[index]
        labels = (paths.grasps, paths.negatives)
        others = (paths.camera, paths.record)
        used = (paths.rgb, self._depth_path(paths), paths.mask, *labels, *others)
        return tuple(path for path in used if path is not None)

    def object_id(self, index: int) -> str:
        """Object of scene ``index``, from the file name."""
        return _object(self.ids[index])

    def _depth_path(self, paths: JacquardFiles) -> Path | None:
        return paths.perfect_depth if self.depth == "perfect" else paths.stereo_depth


def jacquard_camera(width: int, height: int) -> Camera | None:
    """Intrinsics of Jacquard's camera for a picture scaled to ``width`` x ``height`` px.

    Returns:
        The camera; None for a picture that is not square, as none of Jacquard's is.
    """
    if width != height:
        return None
    return Camera.from_field_of_view(FIELD_OF_VIEW_RAD, width, height)


def jacquard_pose() -> RigidTransform:
    """``T_world_camera`` of Jacquard's camera.

    The world's origin is where the optical axis meets the table, its x axis the image's; y runs up
    in the picture, along the table.
    """
    c, s = math.cos(TILT_RAD), math.sin(TILT_RAD)
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, -c, s], [0.0, -s, -c]])
    return RigidTransform(rotation, -TABLE_DISTANCE_M * rotation[:, 2])


def write_jacquard(
    scene: Scene,
    root: Path | str,
    *,
    stereo_depth: Depth | None = None,
    outcomes: Sequence[str] | None = None,
    nested: bool = True,
) -> Path:
    """Write a scene in Jacquard's layout; reading it back gives the same scene.

    Each file is written whole or not at all, the colour picture last: a scene whose writing was
    cut short is not found by the reader. Not part of the layout, and lost: the grasps' quality and
    class labels.

    Args:
        scene: Needs colour and an id of the form ``<i>_<object>``, where ``<object>`` is its
            object_id if it has one. Its depth becomes the perfect depth, holes are written as -1.
        root: Folder to write into; made where it is missing.
        stereo_depth: (H, W) float32 metres for the stereo depth, or None for no such file.
        outcomes: How each of the negative grasps failed, a word each; None: ``failed``.
        nested: Put the scene into a folder of its object.

    Returns:
        The path of the colour picture.

    Raises:
        InvalidInputError: The scene has no colour, an id that cannot be a file name or does not
            name the object, a grasp without opening or jaw, or the stereo depth another size.
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed.
    """
    if scene.rgb is None:
        raise InvalidInputError(f"rgb of scene {scene.id}", None, "a picture, to write it")
    name = _checked_name(scene)
    if stereo_depth is not None and stereo_depth.shape != scene.shape:
        raise InvalidInputError("shape of stereo_depth", stereo_depth.shape, str(scene.shape))
    grasps = scene.grasps
    texts = {
        "grasps": None if grasps is None else format_grasps(_checked_labels(grasps, name)),
        "negatives": _negatives_text(scene, name, outcomes),
        "camera": _camera_text(scene),
    }
    folder = Path(root) / _object(name) if nested else Path(root)
    path = {part: folder / f"{name}{suffix}" for part, suffix in SUFFIXES.items()}
    if scene.mask is not None:
        files.write_mask(path["mask"], scene.mask)
    for part, depth in (("perfect_depth", scene.depth), ("stereo_depth", stereo_depth)):
        if depth is not None:
            files.write_depth(path[part], depth)
    for part, text in texts.items():
        if text is not None:
            write_text(path[part], text)
    files.write_rgb(path["rgb"], scene.rgb)
    return path["rgb"]


def _checked_name(scene: Scene) -> str:
    match = _NAME.fullmatch(scene.id)
    if match is None or re.search(r"[/\\;\s]|^\.", scene.id):
        raise InvalidInputError(
            "id of the scene", repr(scene.id), "<number>_<object> without blanks, '/', '\\', ';'"
        )
    if scene.object_id not in (None, match["object"]):
        raise InvalidInputError(
            f"object_id of scene {scene.id}",
            repr(scene.object_id),
            f"{match['object']!r}, as in the id <number>_<object>",
        )
    return scene.id


def _checked_labels(grasps: Grasps, name: str) -> Grasps:
    smallest = min([*grasps.width.tolist(), *grasps.height.tolist()], default=1.0)
    if smallest <= 0:
        raise InvalidInputError(f"opening or jaw in scene {name}", smallest, "positive pixels")
    return grasps


def _negatives_text(scene: Scene, name: str, outcomes: Sequence[str] | None) -> str | None:
    if scene.negatives is None:
        return None
    words = ["failed"] * len(scene.negatives) if outcomes is None else outcomes
    return format_negatives(_checked_labels(scene.negatives, name), words)


def _camera_text(scene: Scene) -> str | None:
    """What its camera file holds; None where it needs none: no camera, or Jacquard's own."""
    if scene.camera is None:
        return None
    rows, columns = scene.shape
    own = (jacquard_camera(columns, rows), jacquard_pose())
    if (scene.camera, scene.T_world_camera) == own:
        return None
    values: dict[str, Any] = dict(scene.camera.to_dict())
    if scene.T_world_camera is not None:
        values["T_world_camera"] = scene.T_world_camera.matrix.tolist()
    return json.dumps(values, indent=1) + "\n"


def _read_camera(
    path: Path | None, width: int, height: int
) -> tuple[Camera | None, RigidTransform | None]:
    """Intrinsics and pose; Jacquard's own without a file."""
    if path is None:
        camera = jacquard_camera(width, height)
        return camera, None if camera is None else jacquard_pose()
    camera = Camera.read(path)
    if (camera.width, camera.height) != (width, height):
        raise FileFormatError(
            path,
            f"describes {camera.width} x {camera.height} px, the picture has {width} x {height}",
            "correct it, or delete it to use Jacquard's camera",
        )
    remedy = "give a 4 x 4 matrix that maps camera coordinates to the world's, in metres"
    try:
        matrix = json.loads(read_bytes(path)).get("T_world_camera")
    except ValueError as error:
        raise FileFormatError(path, "no JSON", "write the camera as JSON") from error
    try:
        return camera, None if matrix is None else RigidTransform.from_matrix(matrix)
    except InvalidInputError as error:
        raise FileFormatError(path, f"no usable T_world_camera ({error})", remedy) from error


def _find(root: Path) -> dict[str, JacquardFiles]:
    found: dict[str, JacquardFiles] = {}
    for folder, name, siblings in _names(root):
        paths = {
            part.name: folder / f"{name}{SUFFIXES[part.name]}"
            if f"{name}{SUFFIXES[part.name]}" in siblings
            else None
            for part in fields(JacquardFiles)
        }
        if name in found:
            raise FileFormatError(
                folder / f"{name}{SUFFIXES['rgb']}",
                f"scene {name} is also in {found[name].rgb.parent}",
                "keep one of them",
            )
        found[name] = JacquardFiles(**paths)  # type: ignore[arg-type]  # rgb is there
    if not found:
        raise DatasetNotFoundError(
            root,
            "no Jacquard scenes (<i>_<object>_RGB.png) in it"
            if root.is_dir()
            else "no such folder",
            "name the folder that holds the scenes or their object folders",
        )
    return found


def _names(root: Path) -> Iterator[tuple[Path, str, frozenset[str]]]:
    """Folder, scene name and the folder's files, for each colour picture below ``root``."""
    for folder, names in files.visible_files(root):
        siblings = frozenset(names)
        for name in names:
            if name.endswith(SUFFIXES["rgb"]):
                yield folder, name.removesuffix(SUFFIXES["rgb"]), siblings


def _object(name: str) -> str:
    match = _NAME.fullmatch(name)
    return match["object"] if match else name


def _order(name: str) -> tuple[str, int, str]:
    match = _NAME.fullmatch(name)
    return (match["object"], int(match["number"]), name) if match else (name, 0, name)
