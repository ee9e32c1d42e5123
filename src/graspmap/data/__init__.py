"""Data sets, their scenes, and the way from a scene to a network's input.

Each name is loaded at its first use, so that importing one of them does not load all the others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from graspmap.lazy import lazy_names

if TYPE_CHECKING:
    from graspmap.data.appendix import cornell_labels
    from graspmap.data.augment import NONE, PUBLISHED, Augmentation
    from graspmap.data.cornell import CornellScenes
    from graspmap.data.examples import example_scenes
    from graspmap.data.images import (
        Channels,
        channel_count,
        check_depth_m,
        fill_depth,
        to_input,
        warp,
    )
    from graspmap.data.jacquard import (
        JACQUARD_SIDE_PX,
        JacquardScenes,
        write_jacquard,
    )
    from graspmap.data.jacquard_labels import jaw_shares, smallest_jaws
    from graspmap.data.jacquard_predictions import read_predictions, write_predictions
    from graspmap.data.kinds import KINDS, read_scenes
    from graspmap.data.limit import limit_objects
    from graspmap.data.scene import Scene, Scenes
    from graspmap.data.split import Split, make_folds, make_split, read_split
    from graspmap.data.store import Store, open_store
    from graspmap.data.windows import input_window

__all__ = [
    "JACQUARD_SIDE_PX",
    "KINDS",
    "NONE",
    "PUBLISHED",
    "Augmentation",
    "Channels",
    "CornellScenes",
    "JacquardScenes",
    "Scene",
    "Scenes",
    "Split",
    "Store",
    "channel_count",
    "check_depth_m",
    "cornell_labels",
    "example_scenes",
    "fill_depth",
    "input_window",
    "jaw_shares",
    "limit_objects",
    "make_folds",
    "make_split",
    "open_store",
    "read_predictions",
    "read_scenes",
    "read_split",
    "smallest_jaws",
    "to_input",
    "warp",
    "write_jacquard",
    "write_predictions",
]

_HOME = {
    "JACQUARD_SIDE_PX": "jacquard",
    "KINDS": "kinds",
    "NONE": "augment",
    "PUBLISHED": "augment",
    "Augmentation": "augment",
    "Channels": "images",
    "CornellScenes": "cornell",
    "JacquardScenes": "jacquard",
    "Scene": "scene",
    "Scenes": "scene",
    "Split": "split",
    "Store": "store",
    "channel_count": "images",
    "check_depth_m": "images",
    "cornell_labels": "appendix",
    "example_scenes": "examples",
    "fill_depth": "images",
    "input_window": "windows",
    "jaw_shares": "jacquard_labels",
    "limit_objects": "limit",
    "make_folds": "split",
    "make_split": "split",
    "open_store": "store",
    "read_predictions": "jacquard_predictions",
    "read_scenes": "kinds",
    "read_split": "split",
    "smallest_jaws": "jacquard_labels",
    "to_input": "images",
    "warp": "images",
    "write_jacquard": "jacquard",
    "write_predictions": "jacquard_predictions",
}

__getattr__, __dir__ = lazy_names(__name__, _HOME)
