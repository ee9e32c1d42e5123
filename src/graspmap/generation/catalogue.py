"""Which objects an item shows: made up, or meshes of the user, prepared once.

Letters: M usable meshes.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from graspmap.errors import DatasetNotFoundError, FileError, GraspmapError, StorageFullError
from graspmap.generation.entries import MODELS, MeshEntry
from graspmap.generation.ledger import file_hash
from graspmap.generation.model_file import read_model, write_model
from graspmap.generation.plan import GenerationPlan
from graspmap.generation.sources import MeshSource, ProceduralSource, Source
from graspmap.simulation.meshes import MESH_SUFFIXES, load_object
from graspmap.simulation.objects import ObjectModel

_ATTEMPT = 10**9  # procedural objects of later attempts are numbered from here
_PARTS = ("train", "validation", "test")


@dataclass(frozen=True)
class Pick:
    """The objects of an attempt.

    Args:
        name: Of the object, or of the set: the folder of its scenes.
        ids: Names of the objects.
        sources: What each is made from.
        part: Part of the split that the item belongs to, where that is known beforehand.
    """

    name: str
    ids: tuple[str, ...]
    sources: tuple[Source, ...]
    part: str | None = None

    def models(self, root: Path) -> tuple[ObjectModel, ...]:
        """Make the objects.

        Args:
            root: Folder of the data set.

        Raises:
            FileError: A model file is missing or damaged.
        """
        # Sources name model files as seen from a scene's folder.
        folder = root / self.name
        pairs = zip(self.ids, self.sources, strict=True)
        return tuple(source.model(id, folder) for id, source in pairs)


def pick_objects(
    plan: GenerationPlan, meshes: Sequence[MeshEntry], item: int, attempt: int
) -> Pick:
    """The objects of attempt number ``attempt`` at item number ``item``.

    Made-up objects are new ones for each attempt. Meshes are taken in turn, in an order that is
    mixed anew for each turn; of a clutter of meshes, those of one part of the split only, so that
    no object is in two parts.
    """
