"""``graspmap demo``: the whole path in a few minutes, on data that graspmap generates itself."""

from __future__ import annotations

import base64
import html
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from graspmap.cli.frame import (
    option,
    output_file,
    output_folder,
    parse,
    teller,
    write_json,
    write_picture,
)
from graspmap.cli.progress import progress
from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.data import Scenes
    from graspmap.evaluation import Evaluation, TrialEvaluation
    from graspmap.generation import GenerationPlan
    from graspmap.inference import Detector, WeightsCard
    from graspmap.training import Experiment

_SIDE = 224
"""Side of the generated pictures, pixels."""
_INPUT = 144
"""Side of the network's input, pixels: small, so that two minutes are enough to learn."""
_DISTANCE_M = (0.75, 0.9)
"""From the camera to the table: nearer than Jacquard's, so that small pictures show enough."""
_LOOK_AT_M = 0.08
"""How far from the object the camera looks: else the picture's centre would always be right."""
_CANDIDATES = 200
"""Grasps tried in each scene to label it."""
_VIEWS = 2
"""Scenes of one object: few, so that the test part holds many objects."""
_JAW_M = 0.02
"""The one jaw size of the demo's gripper: labels for several would take several times as long."""
_HELD, _FAILED = 6, 6
"""Held-out scenes in the picture, by how the trial of their grasp ended."""


@dataclass(frozen=True)
class Demo:
    """The whole path in a few minutes: generate data, train GG-CNN2, detect, try the grasps.

    Example:
      graspmap demo --out demo

    Objects are made up and dropped on a table, candidate grasps are tried in physics, and what held
    becomes the label. GG-CNN2 learns from that and detects grasps on objects that it has never
    seen; these are tried in physics again. Writes DIR/index.html and DIR/demo.png (open either),
    DIR/scenes (the data set, in Jacquard's layout) and DIR/run (the weights, and how the training
    went). The same DIR again goes on where it was stopped.
    """

    out: Annotated[Path, option("DIR", "default: demo")] = Path("demo")
    """Folder for everything."""
    scenes: Annotated[int, option("N", "default: 240")] = 240
    """How many scenes to generate, at least 20; a fifth of them is held out for the test."""
    epochs: Annotated[int, option("N", "default: 24")] = 24
    """How long to train; more epochs give better grasps."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of the scenes and of the training."""
    workers: Annotated[int, option("N", "default: number of cores")] = 0
    """Processes that generate scenes and try grasps; the result does not depend on it."""
    json: Annotated[Path | None, option("F")] = None
    """Write the numbers as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap demo``."""
    flags = parse(Demo, argv, "graspmap demo")
    for name, value, least in (
        ("--scenes", flags.scenes, 20),
        ("--epochs", flags.epochs, 1),
        ("--seed", flags.seed, 0),
        ("--workers", flags.workers, 0),
    ):
        if value < least:
            raise InvalidInputError(name, value, f"{least} or more")
    output_folder(flags.out, "--out")
    output_file(flags.json, "--json")
    tell = teller(flags.json)
    data = flags.out / "scenes"
    workers = flags.workers or os.cpu_count() or 1
    tell(f"generating {flags.scenes} scenes with grasps tried in physics into {data}")
    _generate(flags, data, workers)
    tell(f"training GG-CNN2 on them, {flags.epochs} epochs")
    card = _train(flags, f"jacquard:{data}")
    detector, test, training = _held_out(flags, data)
    tell(f"detecting on {len(test)} held-out scenes of objects that it has never seen")
    result, base = _measure(detector, test, training, flags.seed)
    tell("trying the detected grasps in physics")
    tried = _try(result, data, workers)
    summary = _summary(flags, card, result, base, tried)
    words = _words(summary)
    write_picture(flags.out / "demo.png", _picture(test, result, tried, words[0]))
    _write_page(flags.out, words)
    for line in words:
        tell(line)
    tell(f"see {flags.out / 'demo.png'} or open {flags.out / 'index.html'}")
    write_json(summary, flags.json)
    return 0


def _plan(flags: Demo) -> GenerationPlan:
    from graspmap.generation import GenerationPlan
    from graspmap.gripper import load_gripper
    from graspmap.simulation.render import load_randomisation

    usual = load_randomisation()
    near = usual.camera.model_copy(update={"distance_m": _DISTANCE_M, "look_at_m": _LOOK_AT_M})
    return GenerationPlan(
        scenes=flags.scenes,
        gripper=replace(load_gripper("jacquard"), name="demo", jaw_sizes_m=(_JAW_M,)),
        views=_VIEWS,
        seed=flags.seed,
        size_px=_SIDE,
        candidates=_CANDIDATES,
        randomisation=usual.model_copy(update={"camera": near}),
    )


def _generate(flags: Demo, data: Path, workers: int) -> None:
    from graspmap.generation import generate

    generate(_plan(flags), data, workers=workers, progress=progress)


def _experiment(flags: Demo, source: str) -> Experiment:
    from graspmap.training import Experiment

    return Experiment.model_validate(
        {
            "name": "demo",
            "seed": flags.seed,
            "network": {"name": "ggcnn2", "channels": "depth"},
            "data": {
                "source": source,
                "depth": "stereo",
                "size": _INPUT,
                "split": {"train": 0.7, "validation": 0.1, "test": 0.2},
                "cache_dir": str(flags.out / "cache"),
                "augment": {"rotation": "any", "zoom": (0.6, 1.0), "flip": True},
            },
            "loss": {"base": "smooth_l1", "positional": "inside"},
            "optimiser": {"learning_rate": 3e-3},
            # Small batches: in two minutes, more steps are worth more than smoother ones.
            "training": {"epochs": flags.epochs, "batch_size": 4, "device": "cpu"},
        }
    )


def _train(flags: Demo, source: str) -> WeightsCard:
    from graspmap.training import train

    return train(
        _experiment(flags, source), flags.out / "run", command="graspmap demo", progress=progress
    )


def _held_out(flags: Demo, data: Path) -> tuple[Detector, Scenes, Scenes]:
    """The detector, the scenes that it never saw, and those that it was trained on."""
    from graspmap.data import read_scenes, read_split
    from graspmap.inference import Detector

    scenes = read_scenes(f"jacquard:{data}", depth="stereo")
    split = read_split(flags.out / "run" / "split.json", scenes)
    detector = Detector.load(flags.out / "run" / "weights.safetensors")
    return detector, split.subset(scenes, "test"), split.subset(scenes, "train")


def _measure(
    detector: Detector, test: Scenes, training: Scenes, seed: int
) -> tuple[Evaluation, Evaluation]:
    """Rectangle success of the detector, and of a grasp that is always at the picture's centre."""
    from graspmap.evaluation import center_grasp_baseline, evaluate_detector

    with progress("detecting") as update:
        result = evaluate_detector(detector, test, seed=seed, progress=update)
    return result, evaluate_detector(center_grasp_baseline(training), test, seed=seed)


def _try(result: Evaluation, data: Path, workers: int) -> TrialEvaluation:
    """The detected grasps in physics, on the very scenes that the pictures show."""
    from graspmap.data import read_scenes
    from graspmap.evaluation import TrialPlan, try_grasps

    scenes = read_scenes(f"jacquard:{data}").subset([scene.id for scene in result.results])
    found = {scene.id: scene.grasp for scene in result.results}
    with progress("trying grasps, scenes") as update:
        return try_grasps(found, scenes, TrialPlan(), workers=workers, progress=update)


def _summary(
    flags: Demo,
    card: WeightsCard,
    result: Evaluation,
    base: Evaluation,
    tried: TrialEvaluation,
) -> dict[str, Any]:
    return {
        **result.to_dict(),
        "center_baseline": base.to_dict()["success"],
        "trial": tried.to_dict(),
        "epochs": card.metrics.get("epochs"),
        "picture": str(flags.out / "demo.png"),
        "page": str(flags.out / "index.html"),
        "weights": str(flags.out / "run" / "weights.safetensors"),
    }


def _words(summary: dict[str, Any]) -> list[str]:
    trial = summary["trial"]
    low, high = trial["interval"]
    rectangle_low, rectangle_high = summary["interval"]["0.25"]
    return [
        f"trial success {trial['success']:.1%}: {trial['held']} of {trial['trials']} grasps on "
        f"held-out scenes held in physics (95 % interval {low:.1%} to {high:.1%})",
        "how they ended: " + ", ".join(f"{name} {n}" for name, n in trial["outcomes"].items()),
        f"rectangle success {summary['success']['0.25']:.1%} at IoU 0.25 on {summary['scenes']} "
        f"held-out scenes (95 % interval {rectangle_low:.1%} to {rectangle_high:.1%})",
        f"always grasping the picture's centre: {summary['center_baseline']['0.25']:.1%} by "
        "rectangles",
        f"mean IoU {summary['miou']:.3f}, AUC {summary['auc']:.3f}, {summary['epochs']} epochs",
    ]


def _picture(test: Scenes, result: Evaluation, tried: TrialEvaluation, title: str) -> Any:
    """Held-out scenes with the best grasp of each: some that held, some that failed."""
    from graspmap.pictures import Tile, contact_sheet

    overlaps = {scene.id: scene.iou for scene in result.results}
    held = [t for t in tried.tried if t.outcome == "held"][:_HELD]
    failed = [t for t in tried.tried if t.outcome != "held"][:_FAILED]
    tiles = []
    for trial in held + failed:
        scene = test[test.index(trial.scene)]
        assert scene.rgb is not None  # generated scenes have colour
        words = f"{trial.outcome} (IoU {overlaps[trial.scene]:.2f})"
        tiles.append(Tile(scene.rgb, words, grasps=trial.grasp))
    return contact_sheet(tiles, columns=_HELD, cell=260, title=title)


def _write_page(out: Path, words: Sequence[str]) -> None:
    """A page that needs nothing but itself."""
    from graspmap.files import write_text

    image = base64.b64encode((out / "demo.png").read_bytes()).decode()
    folder = html.escape(str(out))
    lines = "\n".join(f"<li>{html.escape(line)}</li>" for line in words)
    write_text(
        out / "index.html",
        f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>graspmap demo</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2rem auto;
  padding: 0 1rem; color: #1e2024; background: #fff; }}
img {{ max-width: 100%; border: 1px solid #ddd; }}
code {{ background: #f2f2f2; padding: 0 .3em; }}
</style>
<h1>graspmap demo</h1>
<p>Objects were made up, dropped on a table and photographed; grasps were tried on them in physics,
and what held became the label. GG-CNN2 was trained on the noisy depth of these scenes. The pictures
show objects that it had never seen, each with the best grasp it found (the jaws in blue, the way
they close in red), and what became of that grasp when it was tried in physics.</p>
<ul>
{lines}
</ul>
<img alt="Held-out scenes with the grasps found in them" src="data:image/png;base64,{image}">
<p>Next: see some of these grasps move with <code>graspmap trial --data jacquard:{folder}/scenes
--weights {folder}/run/weights.safetensors --split test --animate films</code>, or make data for
your own gripper with <code>graspmap generate --help</code>.</p>
</html>
""",
    )
