"""``graspmap bench``: how long detection takes, step by step."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from graspmap.cli.frame import at_least, option, output_file, parse, teller, write_json
from graspmap.errors import InvalidInputError, UnknownNameError

if TYPE_CHECKING:
    from graspmap.data import Scene
    from graspmap.evaluation.latency import Latency, Speed
    from graspmap.inference import Detector
    from graspmap.reproduction.published_times import PublishedTime


@dataclass(frozen=True)
class Bench:
    """Time the detection of grasps: preparation of the picture, forward pass, decoding.

    Examples:
      graspmap bench --weights W
      graspmap bench --weights W --size 640x480 --threads 1,2,4 --gripper franka --json speed.json
      graspmap bench --weights W --data jacquard:DIR --device cuda --repeats 1000

    The picture is a simulated table with a stereo camera's depth, or a scene of your own data.
    Each setting is timed with and, where --gripper names one, also for grasps that a gripper can
    open for. Times are percentiles over the repeats, in milliseconds; the sizes of the network
    and the times that the thesis prints stand beside them.
    """

    weights: Annotated[Path, option("W", "needed")]
    """Weights file, or the name of shipped weights (`graspmap weights list`)."""
    size: Annotated[str | None, option("WxH", "default: 640x480")] = None
    """Size of the simulated picture, pixels."""
    data: Annotated[str | None, option("KIND:DIR")] = None
    """Take a scene of this data set as the picture instead."""
    scene: Annotated[str | None, option("ID", "default: the first")] = None
    """Which scene of --data."""
    threads: Annotated[str, option("N[,N...]", "default: 1")] = "1"
    """Thread counts of PyTorch and OpenCV."""
    backends: Annotated[str | None, option("B[,B...]", "default: all")] = None
    """What runs the network: torch."""
    gripper: Annotated[str | None, option("G", "default: none")] = None
    """Also time detection for this gripper: a profile (`graspmap gripper list`) or a YAML file."""
    top: Annotated[int, option("K", "default: 1")] = 1
    """Grasps asked for."""
    device: Annotated[str, option("NAME", "default: cpu")] = "cpu"
    """Where the network runs: cpu, cuda, ..."""
    repeats: Annotated[int, option("N", "default: 100")] = 100
    """Detections that are timed in each setting, after two that are not."""
    seconds: Annotated[float, option("S", "default: 10")] = 10.0
    """A setting ends after so much time, with fewer repeats, but at least three."""
    json: Annotated[Path | None, option("F")] = None
    """Write the result as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap bench``."""
    flags = parse(Bench, argv, "graspmap bench")
    at_least(1, top=flags.top, repeats=flags.repeats)
    if not flags.seconds > 0:
        raise InvalidInputError("--seconds", flags.seconds, "above 0")
    if flags.data is not None and flags.size is not None:
        raise InvalidInputError("--size", flags.size, "only without --data: a scene has its own")
    if flags.scene is not None and flags.data is None:
        raise InvalidInputError("--scene", flags.scene, "only with --data")
    threads = _threads(flags.threads)
    size = _size(flags.size or "640x480")
    output_file(flags.json, "--json", keep=[flags.weights])
    from graspmap.evaluation.latency import measure_speed
    from graspmap.gripper import load_gripper
    from graspmap.reproduction.published_times import published_times

    grippers = (None,) if flags.gripper is None else (None, load_gripper(flags.gripper))
    detectors = _detectors(flags)
    speed = measure_speed(
        detectors,
        _picture(flags, size),
        threads=threads,
        grippers=grippers,
        top=flags.top,
        repeats=flags.repeats,
        seconds=flags.seconds,
    )
    published = published_times()
    network = speed.detector["network"]
    same = [time for time in published if time.network and _same(time.network, network)]
    _tell(flags, speed, same)
    write_json({**speed.to_dict(), "published": [time.to_dict() for time in published]}, flags.json)
    return 0


def _same(one: str, other: str) -> bool:
    """Whether two networks differ by a variant at most: ggcnn2-bilinear, mtgcnn-c."""
    return one.partition("-")[0] == other.partition("-")[0]


def _threads(text: str) -> tuple[int, ...]:
    counts = tuple(int(part) for part in text.split(",") if re.fullmatch(r"\s*\d{1,4}\s*", part))
    if len(counts) != len(text.split(",")) or min(counts) < 1:
        raise InvalidInputError("--threads", repr(text), "counts from 1 to 9999: 1,2,4")
    return tuple(dict.fromkeys(counts))


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", text)
    if match is None:
        raise InvalidInputError("--size", repr(text), "columns x rows in pixels: 640x480")
    return int(match[1]), int(match[2])


def _detectors(flags: Bench) -> dict[str, Detector]:
    """The weights, by backend."""
    from graspmap.inference import Detector
    from graspmap.inference.detector import BACKENDS

    names = BACKENDS if flags.backends is None else tuple(flags.backends.split(","))
    for name in names:
        if name not in BACKENDS:
            raise UnknownNameError("--backends", name, BACKENDS)
    return {name: Detector.load(flags.weights, name, device=flags.device) for name in names}


def _picture(flags: Bench, size: tuple[int, int]) -> Scene:
    if flags.data is None:
        from graspmap.evaluation.latency import example_scene

        return example_scene(*size)
    from graspmap.data import read_scenes

    scenes = read_scenes(flags.data)
    if flags.scene is None:
        return scenes[0]
    if flags.scene not in scenes.ids:
        raise UnknownNameError("--scene", flags.scene, scenes.ids)
    return scenes[scenes.ids.index(flags.scene)]


def _tell(flags: Bench, speed: Speed, published: Sequence[PublishedTime]) -> None:
    tell = teller(flags.json)
    about, picture = speed.detector, speed.picture
    tell(
        f"{about['network']}, {about['channels']}, {about['size']} px input: "
        f"{about['parameters']:,} parameters, "
        f"{about['multiply_adds'] / 1e9:.3g} G multiply-adds a picture"
    )
    tell(f"picture {picture['id']}, {picture['width']} x {picture['height']} px, {speed.device}")
    for latency in speed.settings:
        tell(_setting(latency))
        for step, values in _steps(latency).items():
            numbers = "  ".join(f"{name} {value:8.2f}" for name, value in values.items())
            tell(f"    {step:<8} {numbers}  ms")
    for time in published:
        size = "" if time.parameters is None else f", {time.parameters} parameters"
        tell(f"  {time.source}, {time.model}: {time.time_ms} ms{size} (GTX 1080 Ti)")


def _setting(latency: Latency) -> str:
    threads = f"{latency.threads} thread{'s' * (latency.threads > 1)}"
    gripper = "any grasp" if latency.gripper is None else f"grasps for {latency.gripper}"
    return f"  {latency.backend}, {threads}, {gripper}, {latency.repeats} repeats"


def _steps(latency: Latency) -> dict[str, dict[str, Any]]:
    """Percentiles and mean by step, milliseconds."""
    values = latency.to_dict()
    return {
        step: {name.removesuffix("_ms"): value for name, value in values[step].items()}
        for step in latency.seconds
    }
