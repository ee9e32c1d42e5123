"""Real meshes: how well their convex pieces stand for them, and which grasps hold.

For each mesh of EGAD (millimetres, scaled to the gripper by EGAD's rule) and YCB (metres, as large
as they are): the processor time that reading and dividing takes, the number of pieces, the sum of
their volumes over that of the mesh, and how far the heights of the pieces' hulls differ from the
mesh's, seen on a grid of 1 mm along both senses of all three axes. Then it is dropped some times,
and candidates from the height map and at random are tried.
"""

from __future__ import annotations

import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import GraspmapWarning
from graspmap.generation.candidates import propose_grasps
from graspmap.gripper import Gripper, load_gripper
from graspmap.simulation.heightmap import HeightMap
from graspmap.simulation.hulls import hull
from graspmap.simulation.meshes import load_object
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.pieces import Method
from graspmap.simulation.settle import UnsettledError, settle
from graspmap.simulation.solids import mass_properties
from graspmap.simulation.trial import Outcome, run_trials
from studies._report import table, write

ABOUT = "EGAD and YCB meshes: quality of their convex pieces, share of grasps that hold"

Floats = NDArray[np.float64]
_CELL_M = 0.001


def run(
    data: Path,
    *,
    out: Path | None = None,
    tolerances_mm: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0),
    method: Method = "cuts",
    only: tuple[str, ...] = (),
    candidates: int = 60,
    drops: int = 3,
    seed: int = 0,
) -> None:
    """Measure.

    Args:
        data: Folder with ``egad/*.obj`` and ``ycb/*/textured.obj``.
        out: Where to write the figures as JSON.
        tolerances_mm: How far hulls may stand off.
        method: How the pieces are made.
        only: Names of meshes; all by default.
        candidates: Grasps to try on each mesh, over all drops; 0 for none.
        drops: How often each is dropped.
        seed: Of drops and candidates.
    """
    meshes = [m for m in sources(data) if not only or m[0] in only]
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as cache:
        for tolerance_mm in tolerances_mm:
            for name, path, gripper, fit in meshes:
                found = division(
                    path, gripper if fit else None, tolerance_mm / 1000, method, Path(cache)
                )
                rows.append({"mesh": name, "tolerance_mm": tolerance_mm, **found})
                print(*(f"{k} {v:.3g}" if isinstance(v, float) else v for k, v in rows[-1].items()))
        trials = [
            {"mesh": name, **grasps(path, gripper, fit, (candidates, drops), (seed, i), cache)}
            for i, (name, path, gripper, fit) in enumerate(meshes if candidates else [])
        ]
    table(list(rows[0]), [list(row.values()) for row in rows])
    print()
    columns = [
        "tolerance_mm",
        "cpu_s",
        "pieces",
        "volume",
        "mean_mm",
        "p95_mm",
        "over_3mm",
        "outline",
    ]
    table(columns, [[t, *means(rows, t, columns[1:])] for t in tolerances_mm])
    if trials:
        print()
        table(list(trials[0]), [list(row.values()) for row in trials])
    write(out, "meshes", {"method": method, "seed": seed, "pieces": rows, "trials": trials})


def sources(data: Path) -> Iterator[tuple[str, Path, Gripper, bool]]:
    """Name, file, gripper and whether it is scaled to it, of each mesh."""
    for path in sorted((data / "egad").glob("*.obj")):
        yield path.stem, path, load_gripper("franka"), True
    for path in sorted((data / "ycb").glob("*/textured.obj")):
        yield path.parent.name, path, load_gripper("robotiq-2f85"), False


def means(rows: list[dict[str, Any]], tolerance_mm: float, columns: list[str]) -> list[float]:
    """Mean of each column over the meshes."""
    mine = [row for row in rows if row["tolerance_mm"] == tolerance_mm]
    return [float(np.mean([row[column] for row in mine])) for column in columns]


def division(
    path: Path, fit_to: Gripper | None, tolerance_m: float, method: Method, cache: Path
) -> dict[str, Any]:
    """How a mesh was divided, how long that took, and how far it is from the mesh."""
    started = time.process_time()
    model, remarks = load(path, fit_to, tolerance_m=tolerance_m, method=method, cache=cache)
    spent = time.process_time() - started
    hulls = [hull(piece) for piece in model.pieces]
    solid = mass_properties(model.vertices, model.faces).volume_m3
    far, outline = deviation(
        model.vertices[model.faces], np.concatenate([corners[faces] for corners, faces in hulls])
    )
    return {
        "cpu_s": spent,
        "pieces": len(hulls),
        "corners": sum(len(corners) for corners, _ in hulls),
        "volume": sum(mass_properties(*h).volume_m3 for h in hulls) / solid,
        "mean_mm": float(far.mean() * 1000),
        "p95_mm": float(np.quantile(far, 0.95) * 1000),
        "over_3mm": float((far > 0.003).mean()),
        "outline": outline,
        "remarks": "; ".join(remarks),
    }


def load(path: Path, fit_to: Gripper | None, **options: Any) -> tuple[ObjectModel, list[str]]:
    """The object, and what was said about it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", GraspmapWarning)
        model = load_object(path, unit="m", fit_to=fit_to, **options)
    return model, [str(w.message).removeprefix(f"{path}: ") for w in said]


def deviation(mesh: Floats, pieces: Floats) -> tuple[Floats, float]:
    """How far the heights of triangles (T, 3, 3) differ where both have some, and where not.

    Returns:
        The differences, and the share of the cells that only one of them covers.
    """
    far: list[Floats] = []
    alone: list[float] = []
    for axis in range(3):
        for sense in (1.0, -1.0):
            turn = np.roll(np.eye(3), axis, axis=0) * [sense, 1.0, sense]
            views = [triangles @ turn.T for triangles in (mesh, pieces)]
            floor = min(float(v[..., 2].min()) for v in views) - 0.05
            maps = [HeightMap.from_triangles(v - [0, 0, floor]) for v in views]
            low = np.min([m.origin_m for m in maps], axis=0)
            high = np.max(
                [m.origin_m + _CELL_M * np.array(m.heights_m.shape[::-1]) for m in maps], axis=0
            )
            x, y = (np.arange(a, b, _CELL_M) for a, b in zip(low, high, strict=True))
            first, second = (m.at(np.stack(np.meshgrid(x, y), axis=-1)) for m in maps)
            both = (first > 0) & (second > 0)
            either = (first > 0) | (second > 0)
            far.append(np.abs(first - second)[both])
            alone.append(float((either & ~both).sum() / either.sum()))
    return np.concatenate(far), float(np.mean(alone))


def grasps(
    path: Path,
    gripper: Gripper,
    fit: bool,
    counts: tuple[int, int],
    seeds: tuple[int, int],
    cache: str,
) -> dict[str, Any]:
    """What becomes of candidates on a mesh dropped some times."""
    candidates, drops = counts
    model, _ = load(path, gripper if fit else None, cache=cache)
    outcomes: Counter[Outcome] = Counter()
    unsettled, wild = 0, 0
    started = time.process_time()
    for drop in range(drops):
        rng = np.random.default_rng((*seeds, drop))
        try:
            tabletop = settle([model], rng)
        except UnsettledError:
            unsettled += 1
            continue
        proposed = propose_grasps(tabletop, gripper, candidates // drops, rng)
        results = run_trials(tabletop, proposed, gripper, seed=seeds[0])
        outcomes.update(result.outcome for result in results)
        numbers = [(r.slip_m or 0.0, r.lift_m or 0.0, r.grip_force_n or 0.0) for r in results]
        # Thrown through the room: what no grasp can do, only an unstable simulation.
        wild += int((~np.isfinite(numbers) | (np.abs(numbers) > (1.0, 1.0, 1e4))).any(axis=1).sum())
    tried = outcomes.total()
    return {
        "gripper": gripper.name,
        "mass_kg": model.mass_kg,
        "pieces": len(model.pieces),
        "unsettled": unsettled,
        "tried": tried,
        **{outcome.value: outcomes[outcome] for outcome in Outcome},
        "held_share": outcomes[Outcome.HELD] / tried if tried else float("nan"),
        "wild": wild,
        "cpu_s": time.process_time() - started,
    }
