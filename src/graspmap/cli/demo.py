"""``graspmap demo``: the whole path in about a minute, on scenes that graspmap draws itself."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
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
    from graspmap.evaluation import Evaluation
    from graspmap.inference import Detector, WeightsCard
    from graspmap.training import Experiment

_SIDE = 160
"""Side of the drawn pictures, pixels."""
_INPUT = 112
"""Side of the network's input, pixels: small, so that a minute is enough for many epochs."""
_VIEWS = 2
"""Scenes of one object: few, so that the test part holds objects of every kind."""
_LEAST_EPOCHS = 10
"""A busy machine trains longer rather than showing grasps that nothing was learned for."""
_SHOWN = 12
"""Held-out scenes in the picture."""


@dataclass(frozen=True)
class Demo:
    """The whole path in about a minute: draw scenes, train GG-CNN2, detect on unseen objects.

    Example:
      graspmap demo --out demo

    Writes DIR/demo.png and DIR/index.html (open either), DIR/scenes (a data set in Jacquard's
    layout) and DIR/run (the weights, and how the training went). The same DIR again goes on where
    it was stopped.
    """

    out: Annotated[Path, option("DIR", "default: demo")] = Path("demo")
    """Folder for everything."""
    seconds: Annotated[float, option("S", "default: 60")] = 60.0
    """About how long to train; longer gives better grasps."""
    scenes: Annotated[int, option("N", "default: 300")] = 300
    """How many scenes to draw, at least 50; a fifth of them is held out for the test."""
    seed: Annotated[int, option("N", "default: 0")] = 0
    """Seed of the scenes and of the training."""
    json: Annotated[Path | None, option("F")] = None
    """Write the numbers as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap demo``."""
    flags = parse(Demo, argv, "graspmap demo")
    if not 0 < flags.seconds < 1e6:
        raise InvalidInputError("--seconds", flags.seconds, "a number above 0")
    if flags.scenes < 50:
        raise InvalidInputError("--scenes", flags.scenes, "50 or more")
    if flags.seed < 0:
        raise InvalidInputError("--seed", flags.seed, "0 or more")
    output_folder(flags.out, "--out")
    output_file(flags.json, "--json")
    from graspmap.data import read_scenes, read_split
    from graspmap.generation import write_drawn
    from graspmap.inference import Detector

    tell = teller(flags.json)
    data = flags.out / "scenes"
    tell(f"drawing {flags.scenes} scenes with exact grasps into {data}")
    with progress("drawing scenes") as update:
        write_drawn(data, flags.scenes, flags.seed, size=_SIDE, views=_VIEWS, progress=update)
    tell(f"training GG-CNN2 on them for about {flags.seconds:.0f} s")
    card = _train_for(flags, f"jacquard:{data}")
    scenes = read_scenes(f"jacquard:{data}", depth="stereo")
    split = read_split(flags.out / "run" / "split.json", scenes)
    test, training = split.subset(scenes, "test"), split.subset(scenes, "train")
    tell(f"detecting on {len(test)} held-out scenes of objects that it has never seen")
    detector = Detector.load(flags.out / "run" / "weights.safetensors")
    result, base = _measure(detector, test, training, flags.seed)
    summary = _summary(result, base, card, flags)
    words = _words(summary)
    write_picture(flags.out / "demo.png", _picture(detector, test, result, words[0]))
    _write_page(flags.out, words)
    for line in words:
        tell(line)
    tell(f"see {flags.out / 'demo.png'} or open {flags.out / 'index.html'}")
    write_json(summary, flags.json)
    return 0


def _experiment(source: str, epochs: int, flags: Demo) -> Experiment:
    """A small GG-CNN2 that learns fast; the full-sized ones are in experiments/."""
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
                "augment": {"rotation": "any", "zoom": (0.7, 1.0), "flip": True},
            },
            "loss": {"base": "smooth_l1", "positional": "inside"},
            "optimiser": {"learning_rate": 3e-3},
            # Small batches: in a minute, more steps are worth more than smoother ones.
            "training": {"epochs": epochs, "batch_size": 4, "device": "cpu"},
        }
    )


def _train_for(flags: Demo, source: str) -> WeightsCard:
    """Train for about the time that was asked for: one epoch is timed, the rest follows from it."""
    from graspmap.training import read_experiment, train

    folder = flags.out / "run"
    written = folder / "experiment.yaml"
    # A second call goes on with the epochs that the first one settled on.
    epochs = read_experiment(written).training.epochs if written.is_file() else 1
    if epochs > 1:
        teller(flags.json)(f"going on with the {epochs} epochs that the first run settled on")
    else:
        train(_experiment(source, 1, flags), folder, command="graspmap demo", progress=progress)
        rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
        epochs = max(_LEAST_EPOCHS, round(flags.seconds / max(rows[-1]["seconds"], 0.01)))
    return train(
        _experiment(source, epochs, flags), folder, command="graspmap demo", progress=progress
    )


def _measure(
    detector: Detector, test: Scenes, training: Scenes, seed: int
) -> tuple[Evaluation, Evaluation]:
    """The detector, and a grasp that is always at the picture's centre."""
    from graspmap.evaluation import center_grasp_baseline, evaluate_detector

    with progress("detecting") as update:
        result = evaluate_detector(detector, test, seed=seed, progress=update)
    return result, evaluate_detector(center_grasp_baseline(training), test, seed=seed)


def _summary(
    result: Evaluation, base: Evaluation, card: WeightsCard, flags: Demo
) -> dict[str, Any]:
    return {
        **result.to_dict(),
        "center_baseline": base.to_dict()["success"],
        "by_kind": _by_kind(result),
        "epochs": card.metrics.get("epochs"),
        "picture": str(flags.out / "demo.png"),
        "page": str(flags.out / "index.html"),
        "weights": str(flags.out / "run" / "weights.safetensors"),
    }


def _by_kind(result: Evaluation) -> dict[str, dict[str, int]]:
    """Scenes and right grasps of each kind of object: some are far harder than others."""
    kinds: dict[str, dict[str, int]] = {}
    for row in sorted(result.rows(), key=lambda row: str(row["object_id"])):
        kind = kinds.setdefault(str(row["object_id"]).split("-")[0], {"scenes": 0, "right": 0})
        kind["scenes"] += 1
        kind["right"] += bool(row["correct@0.25"])
    return kinds


def _words(summary: dict[str, Any]) -> list[str]:
    low, high = summary["interval"]["0.25"]
    return [
        f"success {summary['success']['0.25']:.1%} at IoU 0.25 on {summary['scenes']} held-out "
        f"scenes (95 % interval {low:.1%} to {high:.1%})",
        "right by kind of object: "
        + ", ".join(f"{k} {n['right']} of {n['scenes']}" for k, n in summary["by_kind"].items()),
        f"always grasping the picture's centre: {summary['center_baseline']['0.25']:.1%}",
        f"mean IoU {summary['miou']:.3f}, AUC {summary['auc']:.3f}, {summary['epochs']} epochs",
    ]


def _picture(detector: Detector, test: Scenes, result: Evaluation, title: str) -> Any:
    """Held-out scenes with the best grasp of each, the first ones with their maps."""
    import numpy as np

    from graspmap.pictures import Tile, contact_sheet, map_picture

    tiles = []
    overlaps = {scene.id: scene.iou for scene in result.results}
    for number, index in enumerate(np.linspace(0, len(test) - 1, _SHOWN).round().astype(int)):
        scene = test[int(index)]
        assert scene.rgb is not None  # drawn scenes have colour
        found = detector.detect(scene.rgb, scene.depth)
        iou = overlaps.get(scene.id, 0.0)
        verdict = "right" if iou > 0.25 else "wrong"
        tiles.append(Tile(scene.rgb, f"IoU {iou:.2f}: {verdict}", grasps=found.grasps))
        if number < _SHOWN // 3:
            maps = map_picture(found.maps, "quality")
            tiles.append(Tile(maps, "its quality map", ("quality", "0", "1")))
    return contact_sheet(tiles, columns=4, cell=260, title=title)


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
<p>GG-CNN2 was trained on the noisy depth of drawn scenes with exact grasps. The pictures show
objects that it had never seen, each with the best grasp it found: the jaws in blue, the way they
close in red.</p>
<ul>
{lines}
</ul>
<img alt="Held-out scenes with the grasps found in them" src="data:image/png;base64,{image}">
<p>Next: <code>graspmap detect --weights {folder}/run/weights.safetensors --rgb F --depth F
--overlay grasps.png</code>, or a training of your own: <code>graspmap train
experiments/ggcnn2-drawn.yaml --data.source jacquard:{folder}/scenes --out runs/first</code>.</p>
</html>
""",
    )
