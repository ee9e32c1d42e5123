"""What ``graspmap gripper train`` is asked for: its flags, checked, and the folder of the work."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from graspmap.cli.frame import at_least, option, teller
from graspmap.errors import (
    FileError,
    FileFormatError,
    InvalidInputError,
    UnknownNameError,
)

if TYPE_CHECKING:
    from graspmap.data.images import Channels
    from graspmap.generation.plan import GenerationPlan
    from graspmap.gripper import Gripper
    from graspmap.training import Experiment

PARTS = ("train", "validation", "test")
SETTINGS_FILE = "settings.json"
WEIGHTS_FILE = "weights.safetensors"
NONE = "none"

_FORMAT = "graspmap-own-gripper-1"
_ANEW = "choose another folder, or delete this one to begin anew"
_SEEDS_APART = 1000
"""Between the seeds of the parts of two runs."""
_LEAST_OPENING_PX = 5.0
"""A network can't tell by fewer whether something fits between the fingers."""
_WIDTH_SCALE = 0.42
"""Part of the greatest opening for which the width map says 1: then most of its numbers are near 1,
and its errors weigh in the loss what those of the other maps do, whatever the gripper."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrainForGripper:
    """Make a detector for your gripper, and say what it gains over the weights that ship.

    Examples:
      graspmap gripper show franka --yaml > mine.yaml         (then change its numbers)
      graspmap gripper train mine.yaml --out mine
      graspmap gripper train robotiq-2f85 --scenes 500 --epochs 10 --out first
      graspmap gripper train mine.yaml --compare runs/old/weights.safetensors --out mine

    Four steps, each by the command that you could call yourself:
      1. graspmap generate: objects that suit the gripper are made up, pictures taken, and grasps
         tried with its openings, jaws and fingers: data/train, data/validation, data/test.
      2. graspmap train: a network learns from data/train, as a stereo camera sees it: training/.
      3. graspmap weights calibrate: trials on data/validation make its quality the probability
         that a grasp holds: weights.safetensors, which is what you use.
      4. graspmap evaluate --trials and graspmap compare: its best grasp on each scene of data/test
         is tried with the gripper, and so is that of the weights to compare: report.html of each
         in evaluation/, and comparison/comparison.html. Both look at the same pictures, of
         objects that yours has never seen.
    The last lines say how often each held, whether the difference is more than chance, and how to
    use the weights. Stopped (Ctrl-C, kill), the same command goes on where it was; what is finished
    is not done again. Another gripper or other settings need another folder.
    """

    gripper: Annotated[tyro.conf.Positional[str], option("GRIPPER")]
    """A profile that ships (`graspmap gripper list`), or a YAML file of your own."""
    out: Annotated[Path, option("DIR", "needed")]
    """Folder for everything."""
    scenes: Annotated[int | None, option("N", "default: as the recipe says, 2000")] = None
    """Scenes to train on; validation and test grow and shrink with them."""
    epochs: Annotated[int | None, option("N", "default: as the experiment says")] = None
    """How often the network goes over them."""
    network: Annotated[str | None, option("NAME", "default: as the experiment says, ggcnn2")] = None
    """Which network: ggcnn, ggcnn2, grconvnet, grconvnet2 to 4, unet, mtgcnn-a to d."""
    channels: Annotated[
        Literal["depth", "rgbd"] | None, option("depth|rgbd", "default: as the experiment says")
    ] = None
    """What it looks at: depth alone, or colour as well."""
    compare: Annotated[
        str | None, option("W|none", "default: the best that ship for these channels")
    ] = None
    """Weights to compare with: a file, or the name of shipped ones; none compares with nothing."""
    recipe: Annotated[str, option("R", "default: own-gripper")] = "own-gripper"
    """Recipe of the scenes, with the parts train, validation and test and without a gripper: copy
    the one that ships to change camera, light or kinds of objects."""
    experiment: Annotated[Path | None, option("F.yaml", "default: experiments/stereo.yaml")] = None
    """Experiment to train by; its data are replaced by those of the recipe."""
    workers: Annotated[int, option("N", "default: number of cores")] = 0
    """Processes that make scenes and try grasps; the result does not depend on it."""
    device: Annotated[Literal["auto", "cpu", "cuda"], option("NAME", "default: auto")] = "auto"
    """Where the network runs; auto takes a CUDA device where there is one."""
    seed: Annotated[int, option("S", "default: 0")] = 0
    """Seed of objects, scenes and training; another one is another run of it all."""
    json: Annotated[Path | None, option("F")] = None
    """Write the result as JSON to this file, - for standard output."""


@dataclass(frozen=True, eq=False)
class Job:
    """Everything that the steps need.

    Attributes:
        flags: What was asked for.
        command: Command line to record in cards and reports.
        gripper: The gripper.
        plans: The plan of each of the `PARTS`.
        experiment: What is trained.
        compared: Weights to compare with; None: nothing.
        device: Where the network runs, ``"cpu"`` or ``"cuda"``.
    """

    flags: TrainForGripper
    command: str
    gripper: Gripper
    plans: Mapping[str, GenerationPlan]
    experiment: Experiment
    compared: Path | None
    device: str

    @property
    def tell(self) -> Callable[[str], None]:
        """Takes the command's own words."""
        return teller(self.flags.json)

    @property
    def told(self) -> Path | None:
        """The ``--json`` of a step: it writes none, but keeps out of the way of ours."""
        return Path("-") if str(self.flags.json) == "-" else None

    @property
    def weights(self) -> Path:
        """The result."""
        return self.flags.out / WEIGHTS_FILE

    @property
    def trained(self) -> Path:
        """Folder of the training."""
        return self.flags.out / "training"

    def part(self, name: str) -> Path:
        """Folder of a part of the data."""
        return self.flags.out / "data" / name

    def source(self, name: str) -> str:
        """A part of the data, ``kind:directory``."""
        return f"jacquard:{self.part(name)}"


def prepare(flags: TrainForGripper, command: str) -> Job:
    """Everything that the steps need; what is wrong is told before the first scene is made.

    Args:
        flags: What is asked for.
        command: Command line to record in cards and reports.

    Raises:
        GraspmapError: A flag is out of range, a file is missing or wrong, or the gripper does not
            suit the pictures.
    """
    from graspmap.gripper import load_gripper
    from graspmap.training.setup import choose_device
    from graspmap.training.tasks import check_experiment

    at_least(0, workers=flags.workers, seed=flags.seed, epochs=flags.epochs)
    at_least(1, scenes=flags.scenes)
    gripper = load_gripper(flags.gripper)
    plans = _plans(flags, gripper)
    experiment = _experiment(flags, gripper, plans["test"].shown_m)
    check_experiment(experiment)
    return Job(
        flags,
        command,
        gripper,
        plans,
        experiment,
        compared_weights(flags.compare, experiment.network.channels),
        choose_device(experiment),
    )


def _plans(flags: TrainForGripper, gripper: Gripper) -> dict[str, GenerationPlan]:
    from graspmap.generation.recipe import load_recipe

    plans = load_recipe(flags.recipe, gripper=gripper, scenes=flags.scenes)
    if set(plans) != set(PARTS):
        found = f"one with the parts {', '.join(plans)}"
        raise InvalidInputError("--recipe", found, f"one with {', '.join(PARTS)}")
    shift = _SEEDS_APART * flags.seed
    return {name: replace(plans[name], seed=plans[name].seed + shift) for name in PARTS}


def _experiment(flags: TrainForGripper, gripper: Gripper, shown_m: float) -> Experiment:
    """The experiment with the data, and what the flags and the gripper change of it.

    Args:
        flags: What is asked for.
        gripper: The gripper.
        shown_m: Side of the table that a whole picture shows.
    """
    from graspmap.data.windows import close_up_m
    from graspmap.reproduction.table_file import experiments_folder
    from graspmap.training import read_experiment

    path = flags.experiment or experiments_folder() / "stereo.yaml"
    data = read_experiment(path).data
    depth = data.depth
    opening_px = gripper.max_opening_m / (close_up_m(data.view) or shown_m) * data.size
    if opening_px < _LEAST_OPENING_PX:
        raise InvalidInputError(
            f"opening of gripper {gripper.name}",
            f"{gripper.max_opening_m:g} m, {opening_px:.3g} px of what the network sees",
            f"{_LEAST_OPENING_PX:g} px or more: enlarge data.size of the experiment, or show less "
            "of the table (its data.view, or the camera of the recipe)",
        )
    sources = {name: f"jacquard:{flags.out.resolve() / 'data' / name}" for name in PARTS}
    values: dict[str, Any] = {
        "name": f"gripper-{gripper.name}",
        "seed": flags.seed,
        "network.name": flags.network,
        "network.channels": flags.channels,
        "data.source": sources["train"],
        "data.validation": {"source": sources["validation"], "depth": depth},
        "data.test": {"source": sources["test"], "depth": depth},
        "maps.width_scale": max(1.0, round(_WIDTH_SCALE * opening_px, 1)),
        "training.epochs": flags.epochs,
        "training.device": flags.device,
    }
    given = {key: value for key, value in values.items() if value is not None}
    experiment = read_experiment(path, given)
    if experiment.network.channels == "rgb":
        found = "one of colour alone"
        raise InvalidInputError("--experiment", found, "one of depth or rgbd, or --channels")
    return experiment


def compared_weights(given: str | None, channels: Channels) -> Path | None:
    """The weights to compare with; None: with nothing."""
    from graspmap.inference import best_shipped, read_card, weights_path

    if given == NONE:
        return None
    if given is not None:
        try:
            path = weights_path(given)
        except UnknownNameError as error:
            raise UnknownNameError("--compare", given, [NONE, *error.choices]) from None
        read_card(path)
        return path
    found = best_shipped({channels})
    if found is None:
        _LOG.info("no weights ship for %s: nothing to compare with (--compare W)", channels)
    return found


def claim(job: Job) -> None:
    """Write the settings into a new folder, or see that the folder is of the same settings.

    Raises:
        FileError: It is of others, or holds something else.
    """
    from graspmap.files import read_text, write_text
    from graspmap.generation.ledger import differences
    from graspmap.training.setup import FREE_KEYS

    path = job.flags.out / SETTINGS_FILE
    plans = {name: plan.to_dict() for name, plan in job.plans.items()}
    for plan in plans.values():
        del plan["gripper"]
    values = {
        "format": _FORMAT,
        "gripper": job.gripper.to_dict(),
        "data": plans,
        "experiment": {k: v for k, v in job.experiment.flat().items() if k not in FREE_KEYS},
    }
    text = json.dumps(values, indent=1) + "\n"
    if path.is_file():
        try:
            before = json.loads(read_text(path))
            known = before["format"] == _FORMAT
        except (ValueError, KeyError, TypeError):
            known = False
        if not known:
            raise FileFormatError(path, "is damaged, or of another version of graspmap", _ANEW)
        found = differences(before, json.loads(text))
        if found:
            more = f" and {len(found) - 3} more" if len(found) > 3 else ""
            words = "; ".join(found[:3]) + more
            raise FileError(job.flags.out, f"was begun with other settings ({words})", _ANEW)
        return
    strange = sorted(entry.name for entry in job.flags.out.iterdir() if entry.name != ".lock")
    if strange:
        raise FileError(job.flags.out, f"holds something else ({strange[0]})", _ANEW)
    write_text(path, text, durable=True)
