"""Pictures for people: grasps drawn on images, maps and depth in colour, sheets of many.

All pictures are (H, W, 3) uint8 RGB arrays; OpenCV loads at the first one. Plots of numbers are in
`graspmap.pictures.plots` and `graspmap.pictures.heat_maps`.
"""

from graspmap.pictures.draw import draw_grasps, encode, write_text
from graspmap.pictures.fields import color_bar, depth_picture, map_picture
from graspmap.pictures.gripper import gripper_picture
from graspmap.pictures.sheet import Tile, contact_sheet, overlay

__all__ = [
    "Tile",
    "color_bar",
    "contact_sheet",
    "depth_picture",
    "draw_grasps",
    "encode",
    "gripper_picture",
    "map_picture",
    "overlay",
    "write_text",
]
