"""Where the objects of a generated scene come from, in a form that a file can hold."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from graspmap.errors import InvalidInputError
from graspmap.generation.model_file import read_model
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.procedural import ObjectRanges, family_of, make_object

_SAME = 1e-6  # relative; another processor may round otherwise, another version differs by more


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class ProceduralSource(_Strict):
    """Object ``index`` of ``seed``.

    Attributes:
        seed: Seed of the family.
        index: Number of the object.
        families: What it was drawn from; empty for all families.
        ranges: How large, thin and heavy objects may be.
    """

    kind: Literal["procedural"] = "procedural"
    seed: int
    index: int
    families: tuple[str, ...] = Field(default=(), strict=False)
    ranges: ObjectRanges

    def labels(self, id: str) -> dict[str, str]:
        """Shape (specific) and family (general) of the object, from the id that it was given."""
        shape = id.removesuffix(f"-{self.index:06d}")
        return {"specific": shape, "general": family_of(shape)}

    def model(self, id: str, root: Path) -> ObjectModel:  # noqa: ARG002  # as the other sources
        """Make the object; ``root`` is not looked at."""
        return make_object(self.seed, self.index, ranges=self.ranges, families=self.families)


class MeshSource(_Strict):
    """A mesh file of the user.

    Attributes:
        file: Its path below the folder of the meshes.
        hash: BLAKE2b of its content.
        model_file: The model file that was made from it, below the folder of the data set.
    """

    kind: Literal["mesh"] = "mesh"
    file: str
    hash: str
    model_file: str

    def labels(self, id: str) -> dict[str, str]:  # noqa: ARG002  # as the other sources
        """Nothing: what a mesh shows is not known."""
        return {}

    def model(self, id: str, root: Path) -> ObjectModel:
        """Read the model file.

        Args:
            id: Name of the object.
            root: Folder of the data set.

        Raises:
            FileError: It is missing or damaged.
        """
        return read_model(root / self.model_file, id)


Source = Annotated[ProceduralSource | MeshSource, Field(discriminator="kind")]


class Fingerprint(_Strict):
    """A few numbers that tell one object from another.

    Attributes:
        vertices: Count.
        faces: Count.
        pieces: Count.
        mass_kg: Mass.
        extents_m: Sides of its box.
    """

    vertices: int
    faces: int
    pieces: int
    mass_kg: float
    extents_m: tuple[float, float, float]

    @classmethod
    def of(cls, model: ObjectModel) -> Fingerprint:
        """Of an object."""
        x, y, z = model.extents_m.tolist()
        return cls(
            vertices=len(model.vertices),
            faces=len(model.faces),
            pieces=len(model.pieces),
            mass_kg=model.mass_kg,
            extents_m=(x, y, z),
        )

    def check(self, model: ObjectModel) -> None:
        """See that an object is the one that the fingerprint was taken of.

        Raises:
            InvalidInputError: It is another.
        """
        found = Fingerprint.of(model)
        counts = ("vertices", "faces", "pieces")
        same = all(getattr(found, name) == getattr(self, name) for name in counts)
        sizes, wanted = ((*f.extents_m, f.mass_kg) for f in (found, self))
        if not (same and np.allclose(sizes, wanted, rtol=_SAME, atol=0)):
            raise InvalidInputError(
                f"object {model.id}",
                "another one than was recorded",
                "the version of graspmap that made the scene; see versions in its record",
            )
