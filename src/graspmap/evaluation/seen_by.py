"""Scenes as pictures of another camera than the one that their data set says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from graspmap.data.scene import Scene, Scenes
from graspmap.errors import InvalidInputError
from graspmap.generation.scene_file import find_record
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps


class SeenBy(Scenes):
    """Scenes of one's own camera, in the layout of a data set that says another or none.

    Scenes that graspmap generated stay as they are: their record says what took them. The pose of
    another camera is not that of this one, so it is left out; the table says where this one is.

    Args:
        scenes: The scenes.
        camera: Intrinsics of their pictures.
    """

    camera: Camera

    def __init__(self, scenes: Scenes, camera: Camera) -> None:
        self.kind, self.root, self.ids = scenes.kind, scenes.root, scenes.ids
        self.camera = camera
        self._scenes = scenes

    def read(self, index: int) -> Scene:
        """Scene number ``index``; see `Scenes.read`.

        Raises:
            FileError: A file is missing or damaged.
            InvalidInputError: The picture is not of the camera's size.
        """
        scene, camera = self._scenes.read(index), self.camera
        if camera == scene.camera or find_record(self.files(index)) is not None:
            return scene
        if (camera.height, camera.width) != scene.shape:
            raise InvalidInputError(
                "size of the camera's picture",
                f"{camera.width} x {camera.height}",
                f"{scene.shape[1]} x {scene.shape[0]}, that of scene {scene.id}",
            )
        return replace(scene, camera=camera, T_world_camera=None)

    def read_grasps(self, index: int) -> Grasps | None:
        """See `Scenes.read_grasps`."""
        return self._scenes.read_grasps(index)

    def files(self, index: int) -> tuple[Path, ...]:
        """See `Scenes.files`."""
        return self._scenes.files(index)

    def object_id(self, index: int) -> str | None:
        """See `Scenes.object_id`."""
        return self._scenes.object_id(index)
