"""Making data sets: for now drawn scenes with exact grasps."""

from graspmap.generation.drawn import draw_scene, sensor_depth, write_drawn
from graspmap.generation.shapes import SHAPES, Shape, random_shape

__all__ = ["SHAPES", "Shape", "draw_scene", "random_shape", "sensor_depth", "write_drawn"]
