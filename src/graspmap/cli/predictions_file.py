"""The predictions file that commands write: what a detector said."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.data import Scenes
    from graspmap.geometry import Grasps

_LOG = logging.getLogger(__name__)


def write_found(path: Path, grasps: Mapping[str, Grasps], scenes: Scenes) -> None:
    """Write grasps in the format that ``--predictions`` and Jacquard's server take.

    Pictures of Jacquard's kind that are not square have no such file; that is told as a warning.

    Args:
        path: The file.
        grasps: By scene, best first, in pixels of each picture.
        scenes: The scenes that they belong to.

    Raises:
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed.
    """
    from graspmap.data import write_predictions
    from graspmap.data.jacquard import JACQUARD_SIDE_PX
    from graspmap.evaluation import in_file_frame

    try:
        found = in_file_frame(grasps, scenes)
        write_predictions(path, found, size_px=JACQUARD_SIDE_PX)
    except InvalidInputError as error:  # the format knows square pictures and names without blanks
        _LOG.warning("%s is not written: %s", path, error)
