"""Latency of detection, step by step: preparation, forward pass, decoding.

The three steps are those that `graspmap.Detector.detect` itself goes through. Letters in shapes:
R repeats.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.data.scene import Scene
from graspmap.errors import InvalidInputError
from graspmap.gripper import Gripper
from graspmap.inference.detector import Detector
from graspmap.inference.threads import threads_of

STEPS = ("prepare", "forward", "decode")
"""From the picture to the network's input, from there to the maps, from the maps to the grasps."""
TOTAL = "total"
PERCENTILES = (50, 90, 99)

_WARM = 2  # detections before the clock: kernels are compiled, buffers allocated
_LEAST = 3  # detections with it, however long they take
_OBJECTS = 5
_SIDES_PX = (48, 4096)


@dataclass(frozen=True, eq=False)
class Latency:
    """How long detection takes in one setting.

    Attributes:
        backend: What ran the network, one of `graspmap.inference.detector.BACKENDS`.
        threads: Of PyTorch and OpenCV.
        gripper: Name of the gripper whose grasps were asked for; None without one.
        top: Grasps asked for.
        seconds: (R,) seconds of each repeat, by step, and their sum as `TOTAL`.
    """

    backend: str
    threads: int
    gripper: str | None
    top: int
    seconds: Mapping[str, NDArray[np.float64]]

    @property
    def repeats(self) -> int:
        """R, how often it was timed."""
        return len(self.seconds[TOTAL])

    def percentile_ms(self, step: str, percent: float) -> float:
        """A percentile of a step's time, milliseconds; linear between the repeats."""
        return 1000 * float(np.percentile(self.seconds[step], percent))

    def to_dict(self) -> dict[str, Any]:
        """For JSON; times in milliseconds, as their names say."""
        steps = {
            step: {
                **{f"p{p}_ms": self.percentile_ms(step, p) for p in PERCENTILES},
                "mean_ms": 1000 * float(self.seconds[step].mean()),
            }
            for step in (*STEPS, TOTAL)
        }
        return {
            "backend": self.backend,
            "threads": self.threads,
            "gripper": self.gripper,
            "top": self.top,
            "repeats": self.repeats,
            **steps,
        }


@dataclass(frozen=True, eq=False)
class Speed:
    """What a detector costs: its size, and its latency in each setting.

    Attributes:
        detector: What it is, as `graspmap.Detector.describe` says it.
        device: Where it ran.
        picture: Id, width and height of the picture.
        settings: One latency for each setting, in the order in which they were asked for.
    """

    detector: Mapping[str, Any]
    device: str
    picture: Mapping[str, str | int]
    settings: tuple[Latency, ...]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            **self.detector,
            "device": self.device,
            "picture": dict(self.picture),
            "settings": [latency.to_dict() for latency in self.settings],
        }


def measure_speed(
    detectors: Mapping[str, Detector],
    scene: Scene,
    *,
    threads: Sequence[int] = (1,),
    grippers: Sequence[Gripper | None] = (None,),
    top: int = 1,
    repeats: int = 100,
    seconds: float = 10.0,
) -> Speed:
    """Measure a detector in every combination of backend, thread count and gripper.

    Args:
        detectors: The same weights by backend; at least one.
        scene: The picture; with a camera and depth where a gripper is asked for.
        threads: Thread counts.
        grippers: Grippers that grasps have to fit; None: any grasp.
        top: Grasps asked for.
        repeats: See `measure_latency`.
        seconds: See `measure_latency`.

    Raises:
        InvalidInputError: Nothing is asked for, a number is out of range, or the picture lacks
            what the detector needs.
    """
    for name, given in (("detectors", detectors), ("threads", threads), ("grippers", grippers)):
        if not given:
            raise InvalidInputError(name, "none", "at least one")
    first = next(iter(detectors.values()))
    rows, columns = scene.shape
    settings = [
        measure_latency(
            detector,
            scene,
            backend=backend,
            threads=count,
            gripper=gripper,
            top=top,
            repeats=repeats,
            seconds=seconds,
        )
        for backend, detector in detectors.items()
        for count in threads
        for gripper in grippers
    ]
    return Speed(
        detector=first.describe(),
        device=first.device,
        picture={"id": scene.id, "width": columns, "height": rows},
        settings=tuple(settings),
    )


def measure_latency(
    detector: Detector,
    scene: Scene,
    *,
    backend: str = "torch",
    threads: int = 1,
    gripper: Gripper | None = None,
    top: int = 1,
    repeats: int = 100,
    seconds: float = 10.0,
) -> Latency:
    """Time the steps of detection in one picture, again and again.

    Args:
        detector: The detector.
        scene: The picture; its labels and mask are not looked at.
        backend: What runs the network, for the record.
        threads: Of PyTorch and OpenCV.
        gripper: Leaves out grasps that it cannot open for; more candidates are decoded then.
        top: Grasps asked for.
        repeats: How often, after a few that are not counted.
        seconds: It ends earlier when so much time has passed, after three repeats at least.

    Raises:
        InvalidInputError: A number is out of range, or the picture lacks what is needed.
    """
    if repeats < 1:
        raise InvalidInputError("repeats", repeats, "1 or more")
    if not seconds > 0:
        raise InvalidInputError("seconds", seconds, "above 0")

    def steps() -> tuple[float, ...]:
        start = time.perf_counter()
        prepared = detector.prepare(scene.rgb, scene.depth, camera=scene.camera)
        ready = time.perf_counter()
        # What comes back lies in the main memory, so a GPU has finished.
        maps = detector.predict(prepared.inputs[None]).item(0)
        seen = time.perf_counter()
        detector.decode(prepared, maps, camera=scene.camera, gripper=gripper, top=top)
        found = time.perf_counter()
        return ready - start, seen - ready, found - seen, found - start

    with threads_of(threads):
        for _ in range(_WARM):
            steps()
        end = time.perf_counter() + seconds
        times: list[tuple[float, ...]] = []
        while len(times) < repeats and (len(times) < _LEAST or time.perf_counter() < end):
            times.append(steps())
    columns = dict(zip((*STEPS, TOTAL), np.array(times).T, strict=True))
    return Latency(backend, threads, None if gripper is None else gripper.name, top, columns)


def example_scene(width_px: int = 640, height_px: int = 480) -> Scene:
    """A picture to measure with: objects on a table in simulation, depth with a stereo's holes.

    Noise would not do: holes of depth, peaks of the maps and grasps that fit a gripper are what
    preparation and decoding spend their time on.

    Args:
        width_px: Columns.
        height_px: Rows.

    Returns:
        Colour, depth and camera; always the same for one size.

    Raises:
        InvalidInputError: A side is out of range.
    """
    from graspmap.geometry.camera import Camera
    from graspmap.simulation.procedural import make_object
    from graspmap.simulation.render import Sensor, View, jacquard_view, render, stereo_depth
    from graspmap.simulation.render.appearance import plain_appearance
    from graspmap.simulation.render.view import FIELD_OF_VIEW_RAD
    from graspmap.simulation.settle import settle

    low, high = _SIDES_PX
    for name, side in (("width", width_px), ("height", height_px)):
        if not low <= side <= high:
            raise InvalidInputError(f"{name} of the picture", side, f"{low} to {high} px")
    rng = np.random.default_rng(0)
    tabletop = settle([make_object(0, index) for index in range(_OBJECTS)], rng)
    camera = Camera.from_field_of_view(FIELD_OF_VIEW_RAD, width_px, height_px)
    view = View(camera, jacquard_view().T_world_camera)
    picture = render(tabletop, view, plain_appearance(tabletop))
    depth = stereo_depth(tabletop, view, picture, Sensor(), rng)
    return Scene("example", rgb=picture.rgb, depth=depth, camera=camera)
