"""Recipes: data sets of several parts, each a generation plan, in one YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from graspmap.config import read_model
from graspmap.errors import ConfigError, InvalidInputError, UnknownNameError
from graspmap.files import shipped_or_path
from graspmap.generation.labels import ANTIPODAL_SHARE
from graspmap.generation.plan import GenerationPlan
from graspmap.gripper import load_gripper
from graspmap.simulation.render import Randomisation

_FOLDER = Path(__file__).with_name("recipes")
SHIPPED = {path.stem: path for path in sorted(_FOLDER.glob("*.yaml"))}
"""Recipes that ship, by the name that `load_recipe` takes."""

_Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]*$")]


class _Section(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class Part(_Section):
    """One part of a data set; fields as in `GenerationPlan`.

    Attributes:
        scenes: How many.
        seed: Parts with different seeds share no object.
        views: Scenes of one object.
        clutter: Objects on the table.
        families: Of the objects; all where empty.
    """

    scenes: int
    seed: int
    views: int = 1
    clutter: int = 1
    families: tuple[str, ...] = ()


class RecipeFile(_Section):
    """What a recipe's file holds.

    Attributes:
        gripper: Name of a profile or path of a YAML file; whose grasps are tried.
        size_px: Side of the pictures.
        candidates: Grasps tried on each scene.
        antipodal_share: Part of them that is antipodal.
        parts: The parts by name, which is that of their folder.
        randomisation: By how much pictures vary; keys left out stay as in the default.
    """

    gripper: str
    size_px: int
    candidates: int
    antipodal_share: float = ANTIPODAL_SHARE
    parts: dict[_Name, Part] = Field(min_length=1)
    randomisation: Randomisation = Randomisation()


def load_recipe(name_or_path: str | Path) -> Mapping[str, GenerationPlan]:
    """The plans of a recipe, by the name of their part.

    Args:
        name_or_path: Name of a recipe that ships, or a YAML file.

    Raises:
        UnknownNameError: None that ships has this name.
        MissingFileError: There is no such file.
        FileFormatError: The file is no YAML mapping.
        ConfigError: A key or a value is wrong, or two parts have one seed, so that they would show
            the same objects.
    """
    path = shipped_or_path(name_or_path, SHIPPED, what="recipe", own="a YAML file")
    recipe = read_model(path, RecipeFile, what="recipe", example=f"one of {', '.join(SHIPPED)}")
    seeds: dict[int, str] = {}
    for name, part in recipe.parts.items():
        if part.seed in seeds:
            raise ConfigError(
                path,
                f"parts.{name}.seed",
                f"{part.seed} is the seed of part {seeds[part.seed]}, too",
                "give each part a seed of its own, so that they share no object",
            )
        seeds[part.seed] = name
    return {name: _plan(path, recipe, name) for name in recipe.parts}


def _plan(path: Path, recipe: RecipeFile, name: str) -> GenerationPlan:
    part = recipe.parts[name]
    try:
        return GenerationPlan(
            scenes=part.scenes,
            gripper=load_gripper(recipe.gripper),
            views=part.views,
            clutter=part.clutter,
            seed=part.seed,
            size_px=recipe.size_px,
            candidates=recipe.candidates,
            antipodal_share=recipe.antipodal_share,
            randomisation=recipe.randomisation,
            families=part.families,
        )
    except (InvalidInputError, UnknownNameError) as error:
        raise ConfigError(path, f"parts.{name}", str(error), "mend it there") from error
