"""Jacquard: do the grasps that it labels hold in 2.5D, and those that presumably fail not?

Each scene is rebuilt from its depth and mask (or from its depth alone), its labels are tried with
every jaw size, and beside them grasps that are presumed to fail: anywhere on the object, labels
turned by a quarter and labels shifted along their opening, all without a label nearby, and labels
half-closed below the object's width. That no label is near does not prove that a grasp fails: the
labels are a sample.

Every second object (in the order of their names) may choose settings, with ``--sweep``; the others
only report.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from graspmap.data.jacquard import JacquardScenes
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import load_gripper
from graspmap.metrics.intervals import wilson_interval
from graspmap.simulation.columns import ColumnTolerance
from graspmap.simulation.heightmap import HeightMap
from graspmap.simulation.rebuild import rebuild_tabletop
from graspmap.simulation.settings import TrialSettings
from graspmap.simulation.trial import Outcome, TrialResult, run_trials
from studies._disagreements import picture_sheets
from studies._presumed import KINDS, presumed, with_known_jaws
from studies._report import table, write

ABOUT = "2.5D trials of Jacquard's labels and of grasps that presumably fail"

Floats = NDArray[np.float64]
Depth = Literal["perfect", "stereo"]
Rates = dict[str, float]


@dataclass(frozen=True)
class Setting:
    """What is different from the profile and the defaults.

    Args:
        name: For the table.
        gripper: Fields of the gripper.
        trial: Fields of the trial's settings.
        rebuild: Arguments of `rebuild_tabletop`.
        use_mask: Whether the picture's mask is used.
    """

    name: str = "as shipped"
    gripper: Mapping[str, Any] = field(default_factory=dict)
    trial: Mapping[str, Any] = field(default_factory=dict)
    rebuild: Mapping[str, Any] = field(default_factory=dict)
    use_mask: bool = True


SWEEP = (
    Setting(),
    *(Setting(f"friction {mu}", gripper={"friction": mu}) for mu in (0.3, 0.4, 0.5, 0.6, 0.8, 1.0)),
    *(Setting(f"force {n} N", gripper={"force_n": n}) for n in (10, 20, 100)),
    *(Setting(f"jaw {s}", gripper={"jaw_contact_share": s}) for s in (0.6, 1.0)),
    *(Setting(f"depth {d} cm", gripper={"max_depth_m": d / 100}) for d in (2, 3, 6)),
    *(Setting(f"torsion {t} mm", gripper={"torsional_friction_m": t / 1000}) for t in (0, 3, 20)),
    *(Setting(f"finger {t} mm", gripper={"finger_thickness_m": t / 1000}) for t in (2, 10)),
    Setting("a touch fails", gripper={"on_touch": "fail"}),
    *(Setting(f"table friction {m}", trial={"table_friction": m}) for m in (0.2, 1.0)),
    Setting("100 to 500 g", rebuild={"mass_range_kg": (0.1, 0.5)}),
    Setting("20 g", rebuild={"mass_range_kg": (0.02, 0.02)}),
    Setting("beside 1 mm", rebuild={"tolerance": ColumnTolerance(beside_m=0.001)}),
    Setting("above 6 mm", rebuild={"tolerance": ColumnTolerance(height_m=0.006)}),
)
"""One thing changed at a time."""


@dataclass(frozen=True, eq=False)
class SceneTrials:
    """What was tried on one scene.

    Args:
        id: Scene.
        object_id: Its object.
        grasps: Of each kind.
        results: Of each kind, in the same order.
        height_map: The scene, rebuilt.
        T_world_camera: Pose of its camera.
        facts: How the scene was rebuilt.
    """

    id: str
    object_id: str
    grasps: dict[str, TableGrasps]
    results: dict[str, list[TrialResult]]
    height_map: HeightMap
    T_world_camera: RigidTransform
    facts: dict[str, float]


def run(
    data: Path,
    *,
    depth: Depth = "perfect",
    mask: bool = True,
    out: Path | None = None,
    negatives: int = 64,
    labels: int = 0,
    friction: float | None = None,
    sweep: bool = False,
    workers: int = 1,
    seed: int = 0,
) -> None:
    """Measure.

    Args:
        data: Folder in Jacquard's layout.
        depth: Which of the two depths.
        mask: Use the mask of the scene; else what rises above the table is the object.
        out: Where to write the figures as JSON, and pictures of the disagreements.
        negatives: Presumed failures of each kind, for each scene.
        labels: Labels of each scene, drawn at random; 0 for all.
        friction: Of the finger pads, instead of the profile's.
        sweep: Compare settings on the choosing objects instead.
        workers: Processes.
        seed: Scene i draws from (seed, i).
    """
    scenes = JacquardScenes(data, depth=depth)
    objects = sorted({str(scenes.object_id(i)) for i in range(len(scenes))})
    choosing = [i for i in range(len(scenes)) if scenes.object_id(i) in objects[0::2]]
    amount = (negatives, labels, seed)
    if sweep:
        rows = []
        for setting in SWEEP:
            setting = replace(setting, use_mask=mask)
            rates = object_rates(_try_all(scenes, choosing, setting, amount, workers))
            rows.append([setting.name, *_row(mean_rates(rates))])
            print(*(f"{v:.3f}" if isinstance(v, float) else f"{v:20}" for v in rows[-1]))
        print()
        table(["setting", *KINDS, "balanced"], rows)
        columns = ["setting", *KINDS, "balanced"]
        found = [dict(zip(columns, row, strict=True)) for row in rows]
        write(out, f"jacquard_sweep_{depth}", {"seed": seed, "settings": found})
        return
    changed = {} if friction is None else {"friction": friction}
    setting = Setting(gripper=changed, use_mask=mask)
    trials = _try_all(scenes, range(len(scenes)), setting, amount, workers)
    result = report(trials, objects)
    for what, rows in result.items():
        print(f"\n{what}")
        table(list(rows[0]), [list(row.values()) for row in rows])
    name = f"jacquard_{depth}" + ("" if mask else "_no_mask")
    name += "" if friction is None else f"_friction_{friction:g}"
    write(out, name, {"seed": seed, "negatives": negatives, "labels": labels, **result})
    if out is not None:
        picture_sheets(out, name, scenes, trials)


def _try_all(
    scenes: JacquardScenes,
    indices: Iterable[int],
    setting: Setting,
    amount: tuple[int, int, int],
    workers: int,
) -> list[SceneTrials]:
    job = partial(try_scene, scenes, setting, amount)
    if workers == 1:
        return [job(i) for i in indices]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(job, indices))


def try_scene(
    scenes: JacquardScenes, setting: Setting, amount: tuple[int, int, int], index: int
) -> SceneTrials:
    """Rebuild scene ``index`` and try its grasps; ``amount`` is negatives, labels, seed."""
    negatives, some, seed = amount
    scene = scenes[index]
    assert scene.depth is not None
    assert scene.camera is not None
    assert scene.grasps is not None
    gripper = replace(load_gripper("jacquard"), **setting.gripper)
    rebuilt = rebuild_tabletop(
        scene.depth,
        scene.mask if setting.use_mask else None,
        scene.camera,
        scene.T_world_camera,
        **setting.rebuild,
    )
    labels = with_known_jaws(
        TableGrasps.from_pixels(scene.grasps, scene.depth, scene.camera, rebuilt.T_world_camera),
        gripper,
    )
    rng = np.random.default_rng((seed, index))
    grasps = presumed(labels, rebuilt.tabletop.height_map, negatives, rng)
    if some:
        labels = labels[rng.permutation(len(labels))[:some]]
    grasps = {"label": labels, **grasps}
    trial = TrialSettings(**setting.trial)
    results = {
        kind: run_trials(rebuilt.tabletop, g, gripper, settings=trial) for kind, g in grasps.items()
    }
    facts = {
        "pieces": float(sum(len(o.model.pieces) for o in rebuilt.tabletop.objects)),
        "mass_g": 1000 * sum(o.model.mass_kg for o in rebuilt.tabletop.objects),
        "table_residual_mm": 1000 * rebuilt.table_residual_m,
        "filled": rebuilt.filled_share,
    }
    return SceneTrials(
        scene.id,
        str(scene.object_id),
        grasps,
        results,
        rebuilt.tabletop.height_map,
        rebuilt.T_world_camera,
        facts,
    )


def object_rates(trials: Sequence[SceneTrials]) -> dict[str, Rates]:
    """Share of each kind that held, for each object."""
    return {
        name: {kind: held / count for kind, (held, count) in counts.items() if count}
        for name, counts in object_counts(trials).items()
    }


def object_counts(trials: Sequence[SceneTrials]) -> dict[str, dict[str, tuple[int, int]]]:
    """How many of each kind held, and how many there are, for each object."""
    return {
        name: {kind: _count(r for t in group for r in t.results[kind]) for kind in KINDS}
        for name, group in _by_object(trials).items()
    }


def mean_rates(rates: Mapping[str, Rates]) -> Rates:
    """Mean over the objects, each counted once."""
    return {kind: float(np.mean([r[kind] for r in rates.values() if kind in r])) for kind in KINDS}


def balanced(rates: Rates) -> float:
    """Mean of the share of labels that hold and that of presumed failures that do not."""
    return (rates["label"] + 1 - float(np.mean([rates[kind] for kind in KINDS[1:]]))) / 2


def report(trials: Sequence[SceneTrials], objects: Sequence[str]) -> dict[str, Any]:
    """Rows of the tables, by their title."""
    rates, counts = object_rates(trials), object_counts(trials)
    rows = []
    for title, names in (
        *((f"  {name[:12]}", [name]) for name in objects),
        ("choosing objects", objects[0::2]),
        ("reporting objects", objects[1::2]),
        ("all objects", objects),
    ):
        mine = mean_rates({name: rates[name] for name in names})
        row: dict[str, Any] = {"objects": title}
        for kind, value in zip([*KINDS, "balanced"], _row(mine), strict=True):
            row[kind] = value
        if len(names) == 1:
            low, high = wilson_interval(*counts[names[0]]["label"])
            row["labels"] = f"{counts[names[0]]['label'][1]} ({low:.1%} to {high:.1%})"
        else:
            row["labels"] = str(sum(counts[name]["label"][1] for name in names))
        rows.append(row)
    outcomes = [
        {"kind": kind, "tried": len(found), **_outcomes(found)}
        for kind in KINDS
        if (found := [r for t in trials for r in t.results[kind]])
    ]
    return {
        "share that held": rows,
        "outcomes": outcomes,
        "labels that did not hold, by object and reason": _reasons(trials),
        "scenes": [{"scene": t.id[:14], **t.facts} for t in trials],
    }


def _row(rates: Rates) -> list[float]:
    return [*(rates[kind] for kind in KINDS), balanced(rates)]


def _outcomes(results: Sequence[TrialResult]) -> dict[str, float]:
    count = Counter(r.outcome for r in results)
    return {outcome.value: count[outcome] / len(results) for outcome in Outcome}


def _reasons(trials: Sequence[SceneTrials]) -> list[dict[str, Any]]:
    rows = []
    for name, group in _by_object(trials).items():
        lost = [r for t in group for r in t.results["label"] if r.outcome is not Outcome.HELD]
        count = Counter((r.outcome.value, re.sub(r"[\d.]+", "#", r.reason)) for r in lost)
        for (outcome, reason), number in count.most_common():
            rows.append(
                {"object": name[:12], "outcome": outcome, "reason": reason, "labels": number}
            )
    return rows or [{"object": "-", "outcome": "-", "reason": "all hold", "labels": 0}]


def _by_object(trials: Sequence[SceneTrials]) -> dict[str, list[SceneTrials]]:
    ordered = sorted(trials, key=lambda t: t.object_id)
    return {name: list(group) for name, group in groupby(ordered, key=lambda t: t.object_id)}


def _count(results: Iterable[TrialResult]) -> tuple[int, int]:
    held = [r.outcome is Outcome.HELD for r in results]
    return sum(held), len(held)
