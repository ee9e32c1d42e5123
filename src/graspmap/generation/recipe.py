"""Recipes: data sets of several parts, each a generation plan, in one YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from graspmap.config import read_model
from graspmap.errors import ConfigError, InvalidInputError, UnknownNameError
from graspmap.files import shipped_or_path
from graspmap.generation.labels import ANTIPODAL_SHARE
from graspmap.generation.plan import GenerationPlan
from graspmap.gripper import Gripper, load_gripper
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
        least: How many at least, where a recipe is made smaller than it says.
        seed: Parts with different seeds share no object.
        views: Scenes of one object.
        clutter: Objects on the table.
        families: Of the objects; all where empty.
    """

    scenes: int
    least: Annotated[int, Field(ge=1)] = 1
    seed: int
    views: int = 1
    clutter: int = 1
    families: tuple[str, ...] = ()


class RecipeFile(_Section):
    """What a recipe's file holds.

    Attributes:
        gripper: Name of a profile or path of a YAML file; whose grasps are tried. None: whoever
            uses the recipe says.
        size_px: Side of the pictures.
        candidates: Grasps tried on each scene.
        antipodal_share: Part of them that is antipodal.
        photo_samples: Paths through each pixel of colour pictures; 0: they are ray cast.
        parts: The parts by name, which is that of their folder.
        randomisation: By how much pictures vary; keys left out stay as in the default.
    """

    gripper: str | None = None
    size_px: int
    candidates: int
    antipodal_share: float = ANTIPODAL_SHARE
    photo_samples: int = 0
    parts: dict[_Name, Part] = Field(min_length=1)
    randomisation: Randomisation = Randomisation()


def load_recipe(
    name_or_path: str | Path, *, gripper: Gripper | None = None, scenes: int | None = None
) -> Mapping[str, GenerationPlan]:
    """The plans of a recipe, by the name of their part.

    Args:
        name_or_path: Name of a recipe that ships, or a YAML file.
        gripper: Whose grasps are tried, for a recipe that leaves it open.
        scenes: How many the first part has; the others grow and shrink with it, down to their
            ``least``. None: as many as the recipe says.

    Raises:
        InvalidInputError: The gripper is missing, or given although the recipe has one, or does not
            suit its pictures; or there are too few scenes.
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
    whose = _gripper(name_or_path, recipe, gripper)
    plans = {name: _plan(path, recipe, name, whose) for name in recipe.parts}
    return plans if scenes is None else _scaled(name_or_path, recipe, plans, scenes)


def _gripper(recipe: str | Path, file: RecipeFile, given: Gripper | None) -> Gripper:
    """The gripper of a recipe, or that of its user."""
    if file.gripper is not None:
        if given is not None:
            allowed = f"none: recipe {recipe} says that it is {file.gripper}"
            raise InvalidInputError("--gripper", given.name, allowed)
        return load_gripper(file.gripper)
    if given is None:
        allowed = f"the gripper that recipe {recipe} is to be made for: a profile or a YAML file"
        raise InvalidInputError("--gripper", "missing", allowed)
    return given


def _scaled(
    recipe: str | Path, file: RecipeFile, plans: Mapping[str, GenerationPlan], scenes: int
) -> dict[str, GenerationPlan]:
    """The plans with so many scenes in the first part, and others in proportion."""
    first = next(iter(file.parts))
    if scenes < file.parts[first].least:
        allowed = f"{file.parts[first].least} or more in part {first} of recipe {recipe}"
        raise InvalidInputError("--scenes", scenes, allowed)
    factor = scenes / plans[first].scenes
    return {
        name: replace(plan, scenes=max(file.parts[name].least, round(factor * plan.scenes)))
        for name, plan in plans.items()
    }


def _plan(path: Path, recipe: RecipeFile, name: str, gripper: Gripper) -> GenerationPlan:
    part = recipe.parts[name]
    try:
        return GenerationPlan(
            scenes=part.scenes,
            gripper=gripper,
            views=part.views,
            clutter=part.clutter,
            seed=part.seed,
            size_px=recipe.size_px,
            candidates=recipe.candidates,
            antipodal_share=recipe.antipodal_share,
            randomisation=recipe.randomisation,
            photo_samples=recipe.photo_samples,
            families=part.families,
        )
    except (InvalidInputError, UnknownNameError) as error:
        if recipe.gripper is None and f"gripper {gripper.name}" in error.name:
            raise  # the gripper does not suit the recipe: it is not the recipe's to mend
        raise ConfigError(path, f"parts.{name}", str(error), "mend it there") from error
