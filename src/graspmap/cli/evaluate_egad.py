"""``graspmap evaluate egad``: a detector tried on a folder of meshes by EGAD's protocol."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
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
)
from graspmap.cli.progress import progress
from graspmap.cli.trial_flags import REPEATS, check_repeats, read_perturbation
from graspmap.errors import InvalidInputError

if TYPE_CHECKING:
    from graspmap.evaluation.egad import EgadPlan
    from graspmap.simulation.render import Randomisation

_DISTANCES = (0.95, 1.05)
"""Of what --distance says: cameras vary a little."""
_WORST = 5
"""Objects that are named as the hardest."""


@dataclass(frozen=True)
class EvaluateEgad:
    """Try a detector on a folder of meshes in simulation, each object many times (EGAD's protocol).

    Examples:
      graspmap evaluate egad --meshes ~/egad_eval_set --weights W --gripper franka --out report
      graspmap evaluate egad --meshes DIR --weights W --gripper mine.yaml --trials 5 --shake

    Each mesh is scaled to the gripper: the longest side of its box becomes the greatest opening,
    the shortest at most 0.8 of it. It is dropped at random, a camera sees it, and the detector's
    best grasp that the gripper can open for is tried: it is right when the object hangs in the
    fingers after the lift. So --trials times, each with a fall, a camera and a light of its own.
    Beside it proposed grasps are tried, to say in how many of the falls any grasp holds at all.
    Objects called A0 to G6 fill EGAD's grid, with the mean of each row and column. A mesh that
    cannot be used is told, and counts nowhere. With --out, a run that was stopped goes on where
    it was.
    """

    meshes: Annotated[Path, option("DIR", "needed")]
    """Folder of meshes (.obj .stl .ply .off .glb .gltf); of EGAD: its evaluation set."""
    weights: Annotated[Path, option("W", "needed")]
    """Weights of the detector: a file, or the name of shipped ones (`graspmap weights list`)."""
    gripper: Annotated[str, option("G", "needed")]
    """Name of a profile (`graspmap gripper list`) or a YAML file."""
    trials: Annotated[int, option("N", "default: 20")] = 20
    """Tries of each object."""
    top: Annotated[int, option("K", "default: 1")] = 1
    """Grasps tried in each, best first, each on the object as it fell; the first one counts, the
    others say what a robot reaches that tries again."""
    depth: Annotated[Literal["stereo", "perfect"], option("stereo|perfect", "default: stereo")] = (
        "stereo"
    )
    """What the camera measures: the detector sees it, and it places the grasps."""
    candidates: Annotated[int, option("N", "default: 100")] = 100
    """Proposed grasps that are tried in each fall, over all jaw sizes; 0 for none."""
    size: Annotated[int, option("PX", "default: 1024")] = 1024
    """Side of the pictures, pixels."""
    randomisation: Annotated[str, option("F", "default: default")] = "default"
    """Where cameras stand, and by how much lights and surfaces vary: default, plain, or a YAML
    file."""
    distance: Annotated[float | None, option("M", "default: about 1.5, as Jacquard's")] = None
    """From the camera to the table, metres, instead of what --randomisation says. A network finds
    things of the size that it was trained on: those trained on Cornell want about 0.5."""
    shake: bool = False
    """Shake the gripper after the lift: weak grips lose."""
    perturb: Annotated[str | None, option("MM,DEG[,FRICTION,MASS]", "default: none")] = None
    """Standard deviations of the grasp's place (mm), its angle (degrees), and, relative, of
    friction and mass: 2,2,0.1,0.1. Gives the robust success as well."""
    repeats: Annotated[int | None, option("N", f"default: {REPEATS}")] = None
    """Perturbed repeats of each grasp."""
    seed: Annotated[int, option("S", "default: 0")] = 0
    """Seed of everything random; a try follows from it, its mesh and its number."""
    workers: Annotated[int, option("W", "default: number of cores")] = 0
    """Processes; the result does not depend on it."""
    device: Annotated[str, option("NAME", "default: cpu")] = "cpu"
    """Where the network runs: cpu, cuda, ..."""
    out: Annotated[Path | None, option("DIR")] = None
    """Folder for the report (report.html, evaluation.json, per_try.csv)."""
    json: Annotated[Path | None, option("F")] = None
    """Write the summary as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap evaluate egad``."""
    flags = parse(EvaluateEgad, argv, "graspmap evaluate egad")
    _check(flags)
    plan = _plan(flags)
    if flags.out is not None:
        output_folder(flags.out, "--out")
    output_file(flags.json, "--json", keep=[flags.weights])
    from graspmap.evaluation.egad import DetectorFile, evaluate_egad, finish
    from graspmap.evaluation.egad.run import TRYING
    from graspmap.inference import Detector, weights_path

    weights = weights_path(flags.weights)
    # Before the work: a wrong file is told at once.
    detector = Detector.load(weights, device=flags.device).describe()
    result = evaluate_egad(
        flags.meshes.expanduser(),
        DetectorFile(weights, flags.device),
        plan,
        workers=flags.workers or os.cpu_count() or 1,
        folder=flags.out,
        progress=lambda title: progress(title, "tries" if title == TRYING else ""),
    )
    about = {
        "data": f"egad:{flags.meshes}",
        "command": shlex.join(["graspmap", "evaluate", "egad", *argv]),
        "detector": {"kind": "weights", "file": str(flags.weights), **detector},
    }
    summary: dict[str, Any]
    if flags.out is None:
        summary = {**about, "egad": result.to_dict()}
    else:
        from graspmap.evaluation.report.page import write_report

        summary = result.write(flags.out, about)
        write_report(flags.out, summary)
        finish(flags.out)
    _tell(flags, summary["egad"])
    write_json(summary, flags.json)
    return 0


def _check(flags: EvaluateEgad) -> None:
    at_least(1, trials=flags.trials, top=flags.top)
    at_least(0, candidates=flags.candidates, seed=flags.seed, workers=flags.workers)
    check_repeats(flags.repeats, flags.perturb)
    if flags.distance is not None and not 0.05 <= flags.distance <= 5:
        raise InvalidInputError("--distance", flags.distance, "0.05 to 5 metres")


def _plan(flags: EvaluateEgad) -> EgadPlan:
    from graspmap.evaluation.egad import EgadPlan
    from graspmap.gripper import load_gripper
    from graspmap.simulation.trial import Shake, TrialSettings

    return EgadPlan(
        gripper=load_gripper(flags.gripper),
        trials=flags.trials,
        top=flags.top,
        depth=flags.depth,
        candidates=flags.candidates,
        size_px=flags.size,
        randomisation=_randomisation(flags),
        settings=TrialSettings(shake=Shake()) if flags.shake else TrialSettings(),
        perturbation=None if flags.perturb is None else read_perturbation(flags.perturb),
        repeats=1 if flags.perturb is None else flags.repeats or REPEATS,
        seed=flags.seed,
    )


def _randomisation(flags: EvaluateEgad) -> Randomisation:
    from graspmap.simulation.render import load_randomisation

    found = load_randomisation(flags.randomisation)
    if flags.distance is None:
        return found
    near, far = (round(factor * flags.distance, 6) for factor in _DISTANCES)
    camera = found.camera.model_copy(update={"distance_m": (near, far)})
    return found.model_copy(update={"camera": camera})


def _tell(flags: EvaluateEgad, egad: Mapping[str, Any]) -> None:
    tell = teller(flags.json)
    tell(
        f"{_counted(egad['objects'], 'object')} of {flags.meshes}, "
        f"{_counted(egad['trials'], 'try', 'tries')}, gripper "
        f"{egad['gripper']}, {egad['depth']} depth, {egad['seconds']:.0f} s"
    )
    tell(
        f"  its opening of {1000 * egad['opening_m']:.0f} mm, the length of an object, is about "
        f"{egad['opening_px']:.0f} of {flags.size} px"
    )
    tell(f"  held {egad['held']} of {egad['trials']}: success {_share(egad)}")
    tell("  outcomes: " + ", ".join(f"{name} {n}" for name, n in egad["outcomes"].items()))
    for line in (*_beside(egad), *(_grid(egad["grid"]) or _hardest(egad["per_object"]))):
        tell(f"  {line}")
    for what, names in (("broken", ("mesh", "meshes")), ("skipped", ("try", "tries"))):
        if egad[what]:
            tell(f"  {_counted(len(egad[what]), *names)} left out")
    if flags.out is not None:
        tell(f"  written: {flags.out / 'report.html'}, evaluation.json and per_try.csv beside it")


def _beside(egad: Mapping[str, Any]) -> Iterator[str]:
    """What stands beside the success: of perturbed and of proposed grasps, and of robots."""
    if egad["robust_success"] is not None:
        low, high = egad["robust_interval"]
        yield f"robust success, perturbed: {egad['robust_success']:.1%} ({low:.1%} to {high:.1%})"
    for k, score in list(egad.get("one_of_first", {}).items())[1:]:
        yield f"one of the first {k} holds in {score['success']:.1%} of the tries"
    if egad["ceiling"] is not None:
        yield f"falls in which any of the proposed grasps holds: {_share(egad['ceiling'])}"
    proposed = egad["candidates"]
    if proposed is not None and proposed["trials"]:
        grasps = _counted(proposed["trials"], "proposed grasp")
        yield f"of {grasps} held {proposed['success']:.1%}"
    for entry in egad["published"]:
        yield f"on a robot, {entry['name']}: {entry['success']:.0%} ({entry['source']})"
    for what, measure in (("success", "success"), ("candidates", "share of proposed that hold")):
        if egad["trends"][what] is not None:
            yield f"{measure}, rank correlation with {_trend(egad['trends'][what])}"


def _counted(count: int, one: str, several: str = "") -> str:
    """A number of things: ``1 mesh``, ``2 meshes``."""
    return f"{count} {one if count == 1 else several or one + 's'}"


def _share(score: Mapping[str, Any]) -> str:
    low, high = score["interval"]
    return f"{score['success']:.1%} (95% interval {low:.1%} to {high:.1%})"


def _trend(trend: Mapping[str, Any]) -> str:
    return ", with ".join(
        f"the {name}: undefined"
        if found["spearman"] is None
        else f"the {name}: {found['spearman']:.2f} "
        f"({found['interval'][0]:.2f} to {found['interval'][1]:.2f})"
        for name, found in (("letter", trend["rows"]), ("number", trend["columns"]))
    )


def _grid(grid: Mapping[str, Any] | None) -> list[str]:
    """EGAD's grid in percent: a line for each row, with the means at its right and lower edge."""
    if grid is None:
        return []

    def cells(values: Sequence[float | None]) -> str:
        return "".join("   -" if v is None else f"{100 * v:4.0f}" for v in values)

    lines = ["success in percent, row and column means outside:"]
    lines.append("    " + "".join(f"{name:>4}" for name in grid["columns"]) + "  mean")
    for name, values, mean in zip(grid["rows"], grid["success"], grid["row_means"], strict=True):
        lines.append(f"  {name} {cells(values)}  {cells([mean])}")
    lines.append(f"mean{cells(grid['column_means'])}  {cells([grid['mean']])}")
    if grid["outside"]:
        lines.append(f"outside the grid of A0 to G6: {_counted(len(grid['outside']), 'object')}")
    return lines


def _hardest(objects: Mapping[str, Any]) -> list[str]:
    """The objects with the most failures, where there is no grid."""
    failing = [(name, s) for name, s in objects.items() if s["held"] < s["trials"]]
    worst = sorted(failing, key=lambda item: item[1]["success"])[:_WORST]
    names = ", ".join(f"{name} {s['held']} of {s['trials']}" for name, s in worst)
    return [f"hardest objects: {names}"] if names else []
