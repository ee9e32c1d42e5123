"""Making data sets: scenes with grasps tried in simulation, in Jacquard's layout.

Names load at first use: whoever reads the record of a scene needs no worker pool.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspmap.lazy import lazy_names

if TYPE_CHECKING:
    from graspmap.generation.candidates import propose_grasps
    from graspmap.generation.labels import Labels, label_tabletop
    from graspmap.generation.plan import GenerationPlan
    from graspmap.generation.run import generate
    from graspmap.generation.scene_file import SceneRecord, find_record, read_record

__all__ = [
    "GenerationPlan",
    "Labels",
    "SceneRecord",
    "find_record",
    "generate",
    "label_tabletop",
    "propose_grasps",
    "read_record",
]

_HOME = {
    "GenerationPlan": "plan",
    "Labels": "labels",
    "SceneRecord": "scene_file",
    "find_record": "scene_file",
    "generate": "run",
    "label_tabletop": "labels",
    "propose_grasps": "candidates",
    "read_record": "scene_file",
}

__getattr__, __dir__ = lazy_names(__name__, _HOME)
