"""Friction is Coulomb's: where grasps begin to slip, against the closed form.

Two fingers press with F each on sides that lean inwards by alpha; mu = tan(phi) is the friction.
Friction pulls up along the side, the pressure pushes down: lifting with acceleration a they bear

    m (g + a) = 2 F tan(phi - alpha),

which for upright sides is m (g + a) = 2 mu F, and for a light body says alpha = phi. Held at a
distance d from its centre of mass a bar also twists each pad by m (g + a) d / 2; with the
torsional friction tau (a length) MuJoCo's cone bears the two together:

    (m (g + a) / 2)^2 (1 / mu^2 + d^2 / tau^2) = F^2.

Each threshold is found by bisection over whole trials in which a slip of 2 mm counts as lost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper
from graspmap.simulation.shake import GRAVITY_M_S2
from graspmap.simulation.trial import Outcome, TrialSettings, run_trials
from studies import _objects as shapes
from studies._report import table, write
from studies.sanity import REAL

ABOUT = "where grasps begin to slip, against Coulomb's closed form"

SETTINGS = TrialSettings(max_slip_m=0.002, lift_m=0.02)
PULL_M_S2 = GRAVITY_M_S2 + SETTINGS.lift_accelerations()[0]
FRICTIONS = (0.2, 0.4, 0.6, 0.8, 1.0)
MASSES_KG = (0.05, 0.2, 0.8)
ALLOWED = 0.10


def holds(
    standing: shapes.Standing,
    mass_kg: float,
    gripper: Gripper,
    opening_m: float,
    *,
    jaw_m: float = 0.02,
    x: float = 0.0,
    settings: TrialSettings = SETTINGS,
) -> bool:
    """Whether a grasp across y at (x, 0) holds."""
    grasp = TableGrasps([[x, 0.0]], [np.pi / 2], [opening_m], [jaw_m])
    (result,) = run_trials(standing.tabletop(mass_kg), grasp, gripper, settings=settings)
    return result.outcome is Outcome.HELD


def threshold(test: Callable[[float], bool], low: float, high: float, steps: int = 9) -> float:
    """Where a test that is true at one end and false at the other turns; NaN where it is not."""
    first = test(low)
    if test(high) == first:
        return float("nan")
    for _ in range(steps):
        middle = (low + high) / 2
        low, high = (middle, high) if test(middle) == first else (low, middle)
    return (low + high) / 2


def slipping_angle(friction: float, mass_kg: float = 0.02, force_n: float = 20.0) -> Row:
    """Lean of the sides at which a light wedge begins to slip, degrees."""
    gripper = replace(REAL, friction=friction, force_n=force_n)
    limit = np.arctan(friction) - np.arctan(mass_kg * PULL_M_S2 / (2 * force_n))

    def test(slope: float) -> bool:
        wedge = shapes.wedge(slope, height_m=0.02, top_m=0.02)
        return holds(wedge, mass_kg, gripper, 0.095)

    found = threshold(test, 0.5 * limit, min(1.5 * limit, 1.2))
    return _row(
        "lean of the sides, degrees", friction, mass_kg, np.degrees(limit), np.degrees(found)
    )


def slipping_force(friction: float, mass_kg: float) -> Row:
    """Force at which an upright block begins to slip, newton."""
    limit = mass_kg * PULL_M_S2 / (2 * friction)
    block = shapes.bar(0.06, 0.04, 0.04)

    def test(force_n: float) -> bool:
        return holds(block, mass_kg, replace(REAL, friction=friction, force_n=force_n), 0.06)

    found = threshold(test, 0.5 * limit, 2.0 * limit)
    return _row("force on a block, N", friction, mass_kg, limit, found)


def twisting_force(friction: float, mass_kg: float, distance_m: float = 0.04) -> Row:
    """Force at which a thin bar held off its middle begins to turn, newton."""
    tau = REAL.torsional_friction_m
    limit = mass_kg * PULL_M_S2 / 2 * np.hypot(1 / friction, distance_m / tau)
    bar = shapes.bar(0.16, 0.02, 0.006)

    def test(force_n: float) -> bool:
        gripper = replace(REAL, friction=friction, force_n=force_n)
        return holds(bar, mass_kg, gripper, 0.04, jaw_m=0.002, x=distance_m)

    found = threshold(test, 0.4 * limit, 2.5 * limit)
    return _row("force on a bar held off its middle, N", friction, mass_kg, limit, found)


Row = dict[str, object]


def _row(what: str, friction: float, mass_kg: float, expected: float, found: float) -> Row:
    off = float(found / expected - 1)
    return {
        "what": what,
        "friction": friction,
        "mass_kg": mass_kg,
        "expected": float(expected),
        "found": float(found),
        "off": off,
        "within": abs(off) <= ALLOWED,
    }


def run(*, out: Path | None = None) -> None:
    """Find every threshold and compare it with the closed form (nothing is random).

    Args:
        out: Folder for friction.json.
    """
    rows = [slipping_angle(mu) for mu in FRICTIONS]
    rows += [slipping_force(mu, mass) for mu in FRICTIONS for mass in MASSES_KG]
    rows += [twisting_force(mu, mass) for mu in (0.4, 0.8) for mass in (0.02, 0.05)]
    table(
        ["threshold", "mu", "mass, kg", "closed form", "found", "off"],
        [
            [r["what"], r["friction"], r["mass_kg"], r["expected"], r["found"], f"{r['off']:+.1%}"]
            for r in rows
        ],
    )
    outside = sum(not r["within"] for r in rows)
    print(f"{len(rows) - outside} of {len(rows)} within {ALLOWED:.0%}")
    write(out, "friction", {"thresholds": rows})
