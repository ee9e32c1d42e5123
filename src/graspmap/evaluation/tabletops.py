"""The tabletop behind a scene of a data set: from graspmap's own record, or from its depth (2.5D).

Letters in shapes: H rows, W columns of the picture.
"""

from __future__ import annotations

from dataclasses import dataclass

from graspmap.data.scene import Depth, Scenes
from graspmap.errors import InvalidInputError
from graspmap.generation.scene_file import find_record, read_record
from graspmap.geometry.camera import Camera
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import Gripper
from graspmap.simulation.rebuild import Bodies, rebuild_tabletop
from graspmap.simulation.tabletop import Tabletop
from graspmap.simulation.trial import TrialSettings


@dataclass(frozen=True, eq=False)
class SceneWorld:
    """What trials of a scene need.

    Args:
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

    Raises:
        InvalidInputError: It has no depth or no camera, or its depth shows no table or no object.
        FileError: A file of the scene is missing or damaged.
    """
    scene = scenes.read(index)
    data = f"scene {scene.id} of {scenes.kind}:{scenes.root}"
    if scene.depth is None or scene.camera is None:
        missing = "depth" if scene.depth is None else "camera"
        raise InvalidInputError(
            f"{missing} of {data}", "missing", "depth in metres and intrinsics, to try grasps on it"
        )
    path = find_record(scenes.files(index))
    if path is not None:
        record = read_record(path)
        return SceneWorld(
            record.tabletop(),
            scene.depth,
            scene.camera,
            record.view.T_world_camera,
            record.gripper,
            record.settings,
        )
    # Jacquard shows one object a picture; elsewhere parts that do not touch are objects.
    bodies: Bodies = "one" if scenes.kind == "jacquard" else "components"
    try:
        rebuilt = rebuild_tabletop(
            scene.depth, scene.mask, scene.camera, scene.T_world_camera, bodies=bodies
        )
    except InvalidInputError as error:
        raise InvalidInputError(f"{data}: {error.name}", error.found, error.allowed) from error
    return SceneWorld(rebuilt.tabletop, scene.depth, scene.camera, rebuilt.T_world_camera)
