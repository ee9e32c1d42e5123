"""Grasp maps: drawn from labelled grasps (`draw_maps`) and read back as grasps (`find_grasps`)."""

from graspmap.maps.draw import (
    Background,
    Gaussian,
    Overlap,
    Quality,
    draw_maps,
)
from graspmap.maps.find import Method, find_grasps
from graspmap.maps.grasp_maps import GraspMaps, bin_centers, bin_of

__all__ = [
    "Background",
    "Gaussian",
    "GraspMaps",
    "Method",
    "Overlap",
    "Quality",
    "bin_centers",
    "bin_of",
    "draw_maps",
    "find_grasps",
]
