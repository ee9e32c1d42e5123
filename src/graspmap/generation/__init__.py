"""Making data sets: scenes with grasps tried in simulation (`graspmap.generation.generate`).

Drawn scenes with exact grasps, for tests, are here too. Their names load at first use: a worker
that generates scenes needs none of them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from graspmap.generation.drawn import draw_scene, sensor_depth, write_drawn
    from graspmap.generation.shapes import SHAPES, Shape, random_shape

__all__ = ["SHAPES", "Shape", "draw_scene", "random_shape", "sensor_depth", "write_drawn"]

_HOME = {
    "SHAPES": "shapes",
    "Shape": "shapes",
    "draw_scene": "drawn",
    "random_shape": "shapes",
    "sensor_depth": "drawn",
    "write_drawn": "drawn",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'graspmap.generation' has no attribute {name!r}")
    return getattr(importlib.import_module(f"graspmap.generation.{_HOME[name]}"), name)
