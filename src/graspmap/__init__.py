"""graspmap: robot grasp detection with generative networks.

The names below are the public ones; each is loaded at its first use, so that ``import graspmap``
stays light (NumPy and nothing heavy).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspmap.files import keep_compiled_code
from graspmap.lazy import lazy_names

keep_compiled_code()  # before anything imports numba

__version__ = "0.1.0.dev0"

if TYPE_CHECKING:
    from graspmap.data import Scene, Scenes, read_scenes
    from graspmap.errors import GraspmapError
    from graspmap.geometry import Camera, Grasps, RigidTransform, TableGrasps, pairwise_iou
    from graspmap.gripper import Gripper, load_gripper
    from graspmap.inference import Detection, Detector
    from graspmap.maps import GraspMaps, draw_maps, find_grasps

__all__ = [
    "Camera",
    "Detection",
    "Detector",
    "GraspMaps",
    "GraspmapError",
    "Grasps",
    "Gripper",
    "RigidTransform",
    "Scene",
    "Scenes",
    "TableGrasps",
    "draw_maps",
    "find_grasps",
    "load_gripper",
    "pairwise_iou",
    "read_scenes",
]

_HOME = {
    "Camera": "geometry",
    "Detection": "inference",
    "Detector": "inference",
    "GraspMaps": "maps",
    "Grasps": "geometry",
    "GraspmapError": "errors",
    "Gripper": "gripper",
    "RigidTransform": "geometry",
    "Scene": "data",
    "Scenes": "data",
    "TableGrasps": "geometry",
    "draw_maps": "maps",
    "find_grasps": "maps",
    "load_gripper": "gripper",
    "pairwise_iou": "geometry",
    "read_scenes": "data",
}

__getattr__, __dir__ = lazy_names(__name__, _HOME)
