"""Agreement of the trial's quick settings with a finer step and a tighter solver.

On procedural objects of a seed that chose nothing. Of the candidates that pass the height map, as
many that hold as that do not are taken from each object (as far as it has them), so that neither
kind hides the other; that is a hard set, most failures are near misses, and it is chosen by the
quick verdicts, which counts against them. ``--no-balanced`` takes candidates as they come.

Beside the agreement stands the noise of the labels themselves: how many verdicts change when the
grasp is moved by 0.2 mm and turned by 0.2 degrees.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graspmap.generation.candidates import propose_grasps
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper, load_gripper
from graspmap.simulation.procedural import ObjectRanges, make_object
from graspmap.simulation.settle import UnsettledError, settle
from graspmap.simulation.trial import Outcome, TrialRunner, TrialSettings
from studies._report import share, table, write
from studies.sanity import REAL

ABOUT = "agreement with a 0.5 ms step, and the noise of the labels beside it"

FINE = TrialSettings(
    timestep_s=0.0005, fine_timestep_s=0.0005, solver_iterations=100, solver_tolerance=1e-10
)
NOISE_M, NOISE_RAD = 0.0002, np.radians(0.2)


@dataclass(frozen=True)
class Pair:
    """One grasp tried in three ways.

    Args:
        object_id: On which object.
        quick: With the settings under test.
        fine: With the reference's.
        moved: With the settings under test, but moved a little.
    """

    object_id: str
    quick: Outcome
    fine: Outcome
    moved: Outcome


def run(
    *,
    out: Path | None = None,
    seed: int = 77,
    objects: int = 60,
    each: int = 4,
    candidates: int = 400,
    gripper: str = "all",
    balanced: bool = True,
) -> None:
    """Compare verdicts.

    Args:
        out: Folder for reference.json.
        seed: Of objects, poses, candidates and noise.
        objects: How many objects.
        each: Candidates that hold, and as many that do not, of each object.
        candidates: Proposed for each object.
        gripper: Name of a profile, real for that of the sanity study, or all.
        balanced: As many that hold as that do not; else as they come.
    """
    names = ["jacquard", "franka", "real"] if gripper == "all" else [gripper]
    print(f"seed {seed}, {objects} procedural objects; reference: step {FINE.timestep_s * 1e3} ms")
    summary = {}
    for name in names:
        tool = REAL if name == "real" else load_gripper(name)
        pairs = [
            pair
            for index in range(objects)
            for pair in compare(
                tool, seed, index, each=each, candidates=candidates, balanced=balanced
            )
        ]
        summary[name] = _tell(name, pairs)
    write(
        out,
        "reference",
        {"seed": seed, "objects": objects, "balanced": balanced, "grippers": summary},
    )


def compare(
    gripper: Gripper, seed: int, index: int, *, each: int, candidates: int, balanced: bool
) -> Iterator[Pair]:
    """Try candidates of one object in three ways."""
    rng = np.random.default_rng((seed, index))
    model = make_object(seed, index, ranges=ObjectRanges.for_gripper(gripper))
    try:
        tabletop = settle([model], rng)
    except UnsettledError:
        return
    grasps = propose_grasps(tabletop, gripper, candidates, rng)
    quick = TrialRunner(tabletop, gripper)
    passed = _passed(quick, grasps)[: (12 if balanced else 2) * each]
    grasps = grasps[passed]
    results = quick.run(grasps)
    held = [r.outcome is Outcome.HELD for r in results]
    chosen = _balanced(held, each) if balanced else np.arange(len(grasps))
    if not len(chosen):
        return
    grasps = grasps[chosen]
    fine = TrialRunner(tabletop, gripper, FINE).run(grasps)
    moved = quick.run(_moved(grasps, rng))
    for i, a, b in zip(chosen, fine, moved, strict=True):
        yield Pair(model.id, results[i].outcome, a.outcome, b.outcome)


def _passed(runner: TrialRunner, grasps: TableGrasps) -> NDArray[np.intp]:
    """Numbers of the grasps that the height map does not settle."""
    descents = runner.judge(grasps)
    return np.flatnonzero(~descents.collided & ~descents.empty)


def _balanced(held: list[bool], each: int) -> NDArray[np.intp]:
    """Numbers of the first so many of both kinds; as many of one as of the other."""
    flags = np.array(held, dtype=bool)
    yes, no = np.flatnonzero(flags), np.flatnonzero(~flags)
    count = min(each, len(yes), len(no))
    return np.sort(np.concatenate([yes[:count], no[:count]]))


def _moved(grasps: TableGrasps, rng: np.random.Generator) -> TableGrasps:
    count = len(grasps)
    return TableGrasps(
        grasps.center_m + rng.normal(0, NOISE_M, (count, 2)),
        grasps.angle + rng.normal(0, NOISE_RAD, count),
        grasps.width_m,
        grasps.height_m,
    )


def _tell(name: str, pairs: list[Pair]) -> dict[str, object]:
    total = len(pairs)
    same = sum((p.quick is Outcome.HELD) == (p.fine is Outcome.HELD) for p in pairs)
    alike = sum(p.quick is p.fine for p in pairs)
    stable = sum((p.quick is Outcome.HELD) == (p.moved is Outcome.HELD) for p in pairs)
    print(f"\n{name}: {total} grasps on {len({p.object_id for p in pairs})} objects")
    print(f"  held or not, as the reference says: {share(same, total)}")
    print(f"  the same outcome:                   {share(alike, total)}")
    print(f"  held or not, after 0.2 mm and 0.2 degrees: {share(stable, total)}")
    confusion = Counter((p.quick, p.fine) for p in pairs)
    used = [o for o in Outcome if any(o in pair for pair in confusion)]
    table(
        ["quick \\ reference", *used],
        [[a.value, *(confusion[a, b] for b in used)] for a in used],
    )
    return {
        "grasps": total,
        "held_agrees": same / total,
        "outcome_agrees": alike / total,
        "held_unchanged_by_noise": stable / total,
        "confusion": {f"{a}, {b}": n for (a, b), n in sorted(confusion.items())},
    }
