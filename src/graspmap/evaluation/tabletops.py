"""The tabletop behind a scene of a data set: from graspmap's own record, or from its depth (2.5D).

Letters in shapes: H rows, W columns of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

from graspmap.data.scene import Depth, Scene, Scenes
from graspmap.errors import InvalidInputError
from graspmap.generation.scene_file import SceneRecord, find_record, read_record
from graspmap.geometry.camera import Camera
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import Gripper
from graspmap.simulation.rebuild import Bodies, rebuild_tabletop
from graspmap.simulation.tabletop import Tabletop
from graspmap.simulation.trial import TrialSettings


@dataclass(frozen=True, eq=False)
class SceneWorld:
    """What trials of a scene need.

    Attributes:
        tabletop: The objects on the table.
        depth_m: (H, W) metres; places grasps of the picture on the table.
        camera: Intrinsics of the picture.
        T_world_camera: Where the camera is.
        gripper: The gripper that the scene was made for; None where there is no record.
        settings: With which its labels were tried; None where there is no record.
    """

    tabletop: Tabletop
    depth_m: Depth
    camera: Camera
    T_world_camera: RigidTransform
    gripper: Gripper | None = None
    settings: TrialSettings | None = None


def scene_world(scenes: Scenes, index: int) -> SceneWorld:
    """Rebuild the tabletop of scene ``index``.

    Args:
        scenes: With the depth that says where things are.
        index: Number of the scene.

    Raises:
        InvalidInputError: It has no depth or no camera, its depth shows no table or no object, or
            its record no longer gives the same objects.
        FileError: A file of the scene is missing or damaged.
    """
    record = _record(scenes, index)
    scene = scenes.read(index)
    if scene.depth is None:
        raise InvalidInputError("depth", "missing", "scenes with depth in metres: it says where")
    if record is not None:
        return _recorded(record, scene, scene.depth)
    if scene.camera is None:
        raise InvalidInputError(
            "camera", "missing", "scenes whose camera is known, or a camera file (--camera)"
        )
    # Jacquard shows one object a picture; elsewhere parts that do not touch are objects.
    bodies: Bodies = "one" if scenes.kind == "jacquard" else "components"
    rebuilt = rebuild_tabletop(
        scene.depth, scene.mask, scene.camera, scene.T_world_camera, bodies=bodies
    )
    return SceneWorld(rebuilt.tabletop, scene.depth, scene.camera, rebuilt.T_world_camera)


def scene_gripper(scenes: Scenes, index: int) -> Gripper | None:
    """The gripper that scene ``index`` was made for; None where there is no record of it.

    Raises:
        FileError: The record is damaged.
    """
    record = _record(scenes, index)
    return None if record is None else record.gripper


def _record(scenes: Scenes, index: int) -> SceneRecord | None:
    path = find_record(scenes.files(index))
    return None if path is None else read_record(path)


def _recorded(record: SceneRecord, scene: Scene, depth_m: Depth) -> SceneWorld:
    camera = record.view.camera
    if (camera.height, camera.width) != scene.shape:
        raise InvalidInputError(
            "size of the picture",
            f"{scene.shape[1]} x {scene.shape[0]}",
            f"{camera.width} x {camera.height}, as the scene was made",
        )
    return SceneWorld(
        record.tabletop(),
        depth_m,
        camera,
        record.view.T_world_camera,
        record.gripper,
        record.settings,
    )
