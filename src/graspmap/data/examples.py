"""The few scenes that ship with graspmap: ten objects, made by the recipe ``graspmap-examples``."""

from __future__ import annotations

from pathlib import Path

EXAMPLES = "examples"
"""Their name, which stands for ``kind:directory`` wherever a data set is asked for."""

_FOLDER = Path(__file__).with_name("examples") / "scenes"


def example_scenes() -> Path:
    """Folder of the scenes that ship with graspmap, in Jacquard's layout.

    Each has colour, perfect and stereo depth, mask, camera, labels and the record of its making, so
    that all that graspmap does with a generated data set can be tried on them.
    """
    return _FOLDER
