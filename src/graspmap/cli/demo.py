"""``graspmap demo``: shipped weights on the scenes that ship, each grasp tried in physics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from graspmap.cli.frame import (
    at_least,
    option,
    output_file,
    output_folder,
    parse,
    teller,
    write_json,
    write_picture,
)
from graspmap.cli.progress import progress

if TYPE_CHECKING:
    from graspmap.data import Scenes
    from graspmap.evaluation import TrialEvaluation, TriedGrasp
    from graspmap.inference import Detection, Detector

PICTURE_FILE = "demo.png"


@dataclass(frozen=True)
class Demo:
    """Detect grasps on the scenes that ship with graspmap, and try them in physics.

    Example:
      graspmap demo --out demo

    Ten objects on a table, made by the recipe graspmap-examples, and never shown to the weights
    that ship. The best grasp of each is tried with the gripper that the scenes were made for.
    Writes DIR/index.html and DIR/demo.png (open either) and DIR/demo.json (the numbers). Nothing is
    trained, nothing is downloaded. The same scenes serve other commands under the name examples:
      graspmap trial --data examples --weights W --top 3
    """

    out: Annotated[Path, option("DIR", "default: demo")] = Path("demo")
    """Folder for everything."""
    weights: Annotated[Path | None, option("W", "default: the best that ship")] = None
    """Weights file (.safetensors), or the name of shipped weights (`graspmap weights list`)."""
    depth: Annotated[Literal["stereo", "perfect"], option("NAME", "default: stereo")] = "stereo"
    """Which depth the network sees: with the errors of a stereo camera, or exact."""
    top: Annotated[int, option("K", "default: 1")] = 1
    """How many grasps of each scene are tried."""
    animate: bool = False
    """Show a film of each trial on the page (takes longer)."""
    json: Annotated[Path | None, option("F")] = None
    """Write the numbers as JSON to this file as well, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap demo``."""
    flags = parse(Demo, argv, "graspmap demo")
    at_least(1, top=flags.top)
    output_folder(flags.out, "--out")
    output_file(flags.json, "--json", keep=[flags.weights])
    tell = teller(flags.json)
    from graspmap.data import JacquardScenes, example_scenes
    from graspmap.evaluation.report.demo_page import (
        JSON_FILE,
        demo_picture,
        make_exhibit,
        write_demo,
    )
    from graspmap.inference import Detector, default_weights, weights_path

    weights = default_weights() if flags.weights is None else weights_path(flags.weights)
    detector = Detector.load(weights)
    scenes: Scenes = JacquardScenes(example_scenes(), depth=flags.depth)
    tell(f"weights {weights.stem} on the {len(scenes)} scenes that ship, {flags.depth} depth")
    found = _detect(detector, scenes, flags.top)
    result = _try(found, flags.top)
    # Other libraries may make another object of a record: that scene is told, and left out.
    tried = _by_scene(result)
    scenes = scenes.subset(list(tried))
    calibrated = detector.card.calibration is not None
    films = _films(scenes, tried, result) if flags.animate else {}
    exhibits = [
        make_exhibit(
            scene,
            found[scene.id],
            tried[scene.id],
            calibrated=calibrated,
            film=films.get(scene.id),
        )
        for scene in scenes
    ]
    summary: dict[str, Any] = {
        "weights": weights.stem,
        "depth": flags.depth,
        "calibrated": calibrated,
        "best": result.score_of(result.best()),
        "trials": result.to_dict(),
        "gallery": [exhibit.to_dict() for exhibit in exhibits],
        "picture": str(flags.out / PICTURE_FILE),
    }
    total = _total(summary["best"])
    write_picture(flags.out / PICTURE_FILE, demo_picture(exhibits, total))
    summary["page"] = str(write_demo(flags.out, summary, exhibits))
    write_json(summary, flags.out / JSON_FILE)
    _tell(tell, scenes, tried, calibrated)
    tell(total)
    if len(summary["trials"]["one_of_first"]) > 1:
        tell(f"  {_one_of_first(summary['trials'])}")
    tell(f"see {summary['picture']}, or open {summary['page']}")
    write_json(summary, flags.json)
    return 0


def _detect(detector: Detector, scenes: Scenes, top: int) -> dict[str, Detection]:
    """What the detector finds that the gripper of each scene can open for, by scene."""
    from graspmap.evaluation.tabletops import scene_gripper

    found = {}
    with progress("detecting") as update:
        for index, scene in enumerate(scenes):
            found[scene.id] = detector.detect(
                scene.rgb,
                scene.depth,
                camera=scene.camera,
                gripper=scene_gripper(scenes, index),
                top=top,
            )
            update(index + 1, len(scenes))
    return found


def _try(found: Mapping[str, Detection], top: int) -> TrialEvaluation:
    """The grasps in physics; exact depth says where they are, whatever the network saw."""
    from graspmap.data import JacquardScenes, example_scenes
    from graspmap.evaluation import TrialPlan, try_grasps

    grasps = {name: detection.grasps for name, detection in found.items()}
    with progress("trying grasps, scenes") as update:
        return try_grasps(
            grasps, JacquardScenes(example_scenes()), TrialPlan(top=top), progress=update
        )


def _films(
    scenes: Scenes, tried: Mapping[str, Sequence[TriedGrasp]], result: TrialEvaluation
) -> dict[str, bytes]:
    """A film of the best grasp's trial, by scene; none where no grasp was tried."""
    from graspmap.evaluation.animations import film_of

    films = {}
    with progress("filming") as update:
        for number, name in enumerate(scenes.ids, start=1):
            best = tried[name][0]
            if best.placed is not None:
                films[name] = film_of(result, scenes, best, best.placed)
            update(number, len(scenes))
    return films


def _by_scene(result: TrialEvaluation) -> dict[str, list[TriedGrasp]]:
    tried: dict[str, list[TriedGrasp]] = {}
    for trial in result.tried:
        tried.setdefault(trial.scene, []).append(trial)
    return tried


def _tell(
    tell: Callable[[str], None],
    scenes: Scenes,
    tried: Mapping[str, Sequence[TriedGrasp]],
    calibrated: bool,
) -> None:
    """A line a grasp."""
    from graspmap.evaluation.report.demo_page import name_of

    word = "probability" if calibrated else "quality"
    for scene in scenes:
        name = name_of(scene)
        for trial in tried[scene.id]:
            quality = f"{word} {trial.grasp.quality[0]:.2f}  " if len(trial.grasp) else ""
            reason = "" if trial.outcome == "held" else f": {trial.reason}"
            tell(f"  {name:<26} {quality}{trial.outcome}{reason}")
            name = ""


def _total(best: Mapping[str, Any]) -> str:
    low, high = best["interval"]
    return (
        f"{best['held']} of {best['trials']} best grasps held in physics: {best['success']:.0%} "
        f"(95 % interval {low:.0%} to {high:.0%})"
    )


def _one_of_first(trials: Mapping[str, Any]) -> str:
    count, score = list(trials["one_of_first"].items())[-1]
    return f"one of the first {count} held in {score['held']} of {score['trials']} scenes"
