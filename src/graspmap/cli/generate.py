"""``graspmap generate``: labelled RGB-D scenes for any gripper."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from graspmap.cli.frame import (
    option,
    output_file,
    output_folder,
    parse,
    teller,
    write_json,
    write_picture,
)
from graspmap.cli.progress import Update, progress
from graspmap.errors import InvalidInputError, UnknownNameError

if TYPE_CHECKING:
    from graspmap.data import Scene
    from graspmap.generation.plan import GenerationPlan
    from graspmap.pictures import Tile

_SHOWN = 12
"""Scenes on the contact sheet."""
_LABELS = 8
"""Grasps drawn on each."""


@dataclass(frozen=True)
class Generate:
    """Make a data set for a gripper: scenes with colour, depth, mask, and grasps tried in physics.

    Examples:
      graspmap generate --scenes 500 --out data/first
      graspmap generate --scenes 200 --gripper franka --clutter 5 --out data/piles
      graspmap generate --scenes 100 --objects ~/meshes --unit mm --fit --out data/mine
      graspmap generate --recipe graspmap-v1 --out data/graspmap-v1
      graspmap generate --recipe graspmap-v1 --scenes 800 --out data/small
      graspmap doctor jacquard:data/first

    Each scene is an object (or --clutter of them) dropped on a table until it rests, seen by a
    camera that varies (--views scenes in a row have the same object), with about --candidates
    grasps tried in simulated physics. Those that held are the labels; the others are kept with the
    way they failed. The files are laid out as in the Jacquard data set, so whatever reads Jacquard
    reads them; beside them lie NAME_negatives.txt, NAME_camera.json and NAME_scene.json, from which
    `graspmap trial` tries any prediction later. split.json divides the scenes by object;
    manifest.json has the counts and the hash of each file; sheet.png shows some scenes. Stopped
    (Ctrl-C, kill, full disk), the same command goes on where it was, and ends with the same bytes.
    More --scenes in the same folder add scenes.

    A recipe is a YAML file that says all of this for several parts (training, test, ...) that share
    no object; graspmap-v1 is the benchmark of the project, graspmap-examples made the scenes that
    ship, own-gripper is for any --gripper (`graspmap gripper train` uses it). Part P becomes the
    data set DIR/P.
    """

    out: Annotated[Path, option("DIR", "needed")]
    """Folder of the data set."""
    scenes: Annotated[int | None, option("N", "needed without --recipe")] = None
    """How many scenes; of a recipe, in its first part, and the others shrink and grow with it as
    far as the recipe lets them (the tests of graspmap-v1 stay whole)."""
    recipe: Annotated[str | None, option("R")] = None
    """Name of a recipe (graspmap-v1) or a YAML file, instead of all other flags but --scenes,
    --workers and, where the recipe leaves it open, --gripper."""
    parts: Annotated[str | None, option("P,...", "default: all")] = None
    """Parts of the recipe to make."""
    objects: Annotated[str, option("procedural|DIR", "default: procedural")] = "procedural"
    """Objects that graspmap makes up, or a folder of meshes (.obj .stl .ply .off .glb .gltf)."""
    gripper: Annotated[str | None, option("G", "default: jacquard")] = None
    """Name of a profile (`graspmap gripper list`) or a YAML file."""
    views: Annotated[int, option("V", "default: 5")] = 5
    """Scenes of one object, each with a fall, a camera and a light of its own."""
    clutter: Annotated[int, option("K", "default: 1")] = 1
    """Objects on the table."""
    seed: Annotated[int, option("S", "default: 0")] = 0
    """Seed of everything random; the same seed gives the same bytes."""
    workers: Annotated[int, option("W", "default: number of cores")] = 0
    """Processes; the result does not depend on it."""
    size: Annotated[int, option("PX", "default: 1024")] = 1024
    """Side of the pictures, pixels."""
    candidates: Annotated[int, option("N", "default: 1000")] = 1000
    """Grasps tried on each scene, over all jaw sizes of the gripper."""
    randomisation: Annotated[str, option("F", "default: default")] = "default"
    """By how much cameras, lights and surfaces vary: default, plain, or a YAML file."""
    photo: Annotated[int, option("SAMPLES", "default: none")] = 0
    """Path-trace the colour pictures, so many paths through each pixel (64 to 256): real glass and
    metal, but seconds to minutes a picture. Needs the extra `photo`; all else stays the same."""
    family: Annotated[str | None, option("NAME,...", "default: all")] = None
    """Kinds of made-up objects: families or shapes, for example extrusion,mug."""
    unit: Annotated[Literal["m", "cm", "mm", "inch"] | None, option("UNIT", "default: guessed")] = (
        None
    )
    """Unit of the meshes: m, cm, mm or inch."""
    fit: bool = False
    """Scale each mesh to the gripper: its longest side to the opening, its shortest to at most 0.8
    of it (the rule of EGAD)."""
    json: Annotated[Path | None, option("F")] = None
    """Write the summary as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap generate``."""
    flags = parse(Generate, argv, "graspmap generate")
    if flags.workers < 0:
        raise InvalidInputError("--workers", flags.workers, "1 or more, 0 for every core")
    plans = _plans(flags)
    output_folder(flags.out, "--out")
    output_file(flags.json, "--json")
    summaries = {}
    for part, plan in plans.items():
        if part:
            teller(flags.json)(f"part {part}: {plan.scenes} scenes")
        summaries[part] = make_data_set(
            plan, flags.out / part, workers=flags.workers, tell=teller(flags.json)
        )
    write_json(summaries.get("", {"parts": summaries}), flags.json)
    return 0


def make_data_set(
    plan: GenerationPlan, out: Path, *, workers: int, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Make one data set, or go on with it, and tell about it.

    Args:
        plan: What to make.
        out: Its folder.
        workers: Processes; 0 for every core.
        tell: Takes the lines about it.

    Returns:
        The summary.

    Raises:
        GraspmapError: As `graspmap.generation.generate`.
    """
    from graspmap.generation import generate

    clock = _Clock()
    manifest = generate(plan, out, workers=workers or os.cpu_count() or 1, progress=clock.progress)
    write_picture(out / "sheet.png", _sheet(out, plan.gripper.name))
    summary = _summary(manifest, clock, out)
    _tell(tell, summary)
    return summary


def _plans(flags: Generate) -> Mapping[str, GenerationPlan]:
    """The plan of each part by its name; without a recipe the one plan, whose name is empty."""
    if flags.recipe is None:
        if flags.scenes is None:
            raise InvalidInputError("--scenes", "missing", "a number of scenes, or --recipe")
        if flags.parts is not None:
            raise InvalidInputError("--parts", flags.parts, "only with --recipe")
        return {"": _plan(flags)}
    others = {"out", "recipe", "scenes", "parts", "gripper", "workers", "json"}
    for known in fields(flags):
        value = getattr(flags, known.name)
        if known.name not in others and value != known.default:
            flag = "--" + known.name.replace("_", "-")
            raise InvalidInputError(flag, value, "not with --recipe: it is the recipe that says so")
    from graspmap.generation.recipe import load_recipe
    from graspmap.gripper import load_gripper

    gripper = None if flags.gripper is None else load_gripper(flags.gripper)
    plans = load_recipe(flags.recipe, gripper=gripper, scenes=flags.scenes)
    if flags.parts is None:
        return plans
    for name in flags.parts.split(","):
        if name not in plans:
            raise UnknownNameError(f"part of {flags.recipe}", name, plans)
    return {name: plans[name] for name in flags.parts.split(",")}


def _plan(flags: Generate) -> GenerationPlan:
    from graspmap.generation.plan import PROCEDURAL, GenerationPlan
    from graspmap.gripper import load_gripper
    from graspmap.simulation.render import load_randomisation

    assert flags.scenes is not None  # _plans() saw to it
    made_up = flags.objects == PROCEDURAL
    return GenerationPlan(
        scenes=flags.scenes,
        objects=PROCEDURAL if made_up else Path(flags.objects).expanduser(),
        gripper=load_gripper(flags.gripper or "jacquard"),
        views=flags.views,
        clutter=flags.clutter,
        seed=flags.seed,
        size_px=flags.size,
        candidates=flags.candidates,
        randomisation=load_randomisation(flags.randomisation),
        photo_samples=flags.photo,
        families=() if flags.family is None else tuple(flags.family.split(",")),
        unit=flags.unit,
        fit=flags.fit,
    )


class _Clock:
    """Shows progress, and remembers how many scenes this run has made in what time."""

    def __init__(self) -> None:
        self.start = time.monotonic()
        self.before: int | None = None
        self.made = 0

    @contextmanager
    def progress(self, title: str) -> Iterator[Update]:
        scenes = title == "generating scenes"
        with progress(title, per_hour="scenes" if scenes else "") as update:
            yield partial(self._note, update) if scenes else update

    def _note(self, update: Update, done: int, total: int) -> None:
        if self.before is None:
            self.start, self.before = time.monotonic(), done
        self.made = done - self.before
        update(done, total)

    @property
    def seconds(self) -> float:
        return time.monotonic() - self.start


def _summary(manifest: Mapping[str, Any], clock: _Clock, out: Path) -> dict[str, Any]:
    counts = manifest["counts"]
    seconds = clock.seconds
    return {
        **counts,
        "labels_per_scene": counts["labels"] / max(counts["scenes"], 1),
        "held_share": counts["labels"] / max(counts["trials"], 1),
        "made_now": clock.made,
        "seconds": seconds,
        "scenes_per_hour": clock.made / seconds * 3600,
        "data": f"jacquard:{out}",
        "manifest": str(out / "manifest.json"),
        "sheet": str(out / "sheet.png"),
    }


def _tell(tell: Callable[[str], None], summary: Mapping[str, Any]) -> None:
    things = "1 object" if summary["objects"] == 1 else f"{summary['objects']} objects"
    tell(
        f"{summary['scenes']} scenes of {things} in {summary['data']}, "
        f"{summary['made_now']} of them made now in {summary['seconds']:.0f} s "
        f"({summary['scenes_per_hour']:,.0f} scenes an hour)"
    )
    outcomes = ", ".join(f"{n} {word}" for word, n in summary["outcomes"].items())
    tell(f"  {summary['trials']} grasps tried: {outcomes}")
    tell(
        f"  {summary['labels_per_scene']:.0f} labels a scene, "
        f"{summary['held_share']:.1%} of what was tried"
    )
    if summary["rejects"]:
        reasons = ", ".join(f"{n} {reason}" for reason, n in summary["rejects"].items())
        tell(f"  rejected and replaced on the way: {reasons}")
    if summary["missing_scenes"]:
        tell(f"  {summary['missing_scenes']} scenes are missing: no object for them was usable")
    tell(f"  see {summary['sheet']}, or: graspmap doctor {summary['data']}")


def _sheet(root: Path, gripper: str) -> Any:
    """Some scenes, cut out around their objects, with some of their labels."""
    import numpy as np

    from graspmap.data import JacquardScenes
    from graspmap.pictures import contact_sheet

    scenes = JacquardScenes(root)
    chosen = np.linspace(0, len(scenes) - 1, min(_SHOWN, len(scenes))).round().astype(int)
    tiles = [_tile(scenes[int(index)]) for index in chosen]
    title = f"{len(scenes)} scenes, gripper {gripper}; jaws blue, opening red"
    return contact_sheet(tiles, columns=4, cell=300, title=title)


def _tile(scene: Scene) -> Tile:
    import numpy as np

    from graspmap.data import smallest_jaws
    from graspmap.geometry import affine
    from graspmap.pictures import Tile

    assert scene.rgb is not None  # generated scenes have all of it
    assert scene.mask is not None
    assert scene.grasps is not None
    rows, columns = np.nonzero(scene.mask)
    low = np.array([columns.min(), rows.min()])
    high = np.array([columns.max(), rows.max()]) + 1
    side = min(len(scene.rgb), max(int(2 * (high - low).max()), len(scene.rgb) // 4))
    left, top = np.clip((low + high - side) // 2, 0, len(scene.rgb) - side).tolist()
    grasps = smallest_jaws(scene.grasps)
    some = np.linspace(0, len(grasps) - 1, min(_LABELS, len(grasps))).round().astype(int)
    return Tile(
        scene.rgb[top : top + side, left : left + side],
        f"{scene.id}: {len(grasps)} grasps",
        grasps=grasps[some].transformed(affine.translation(-left, -top)),
    )
