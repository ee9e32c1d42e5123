"""Grasps, their overlap, and the frames they live in (NumPy; numba loads at the first overlap)."""

from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps, angle_difference, wrap_angle
from graspmap.geometry.overlap import best_iou, intersection_area, pairwise_iou
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.geometry.transforms import RigidTransform

__all__ = [
    "Camera",
    "Grasps",
    "RigidTransform",
    "TableGrasps",
    "angle_difference",
    "best_iou",
    "intersection_area",
    "pairwise_iou",
    "wrap_angle",
]
