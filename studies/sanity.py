"""Sanity: grasps that anyone expects to hold, hold; those that cannot hold, do not.

Each case is tried many times with jitter, on plain shapes with exact convex pieces, for a gripper
like many real ones (10 cm of opening, 10 N a finger, a touch on the way down fails) and for the
``jacquard`` profile. Some failures are seen on the height map; the last cases pass it, and physics
itself must refuse them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper, load_gripper
from graspmap.simulation.trial import Outcome, run_trials
from studies import _objects as shapes
from studies._report import table, write

ABOUT = "plain grasps on plain shapes: which hold, which fail and why"

GRAVITY_M_S2, LIFT_M_S2 = 9.81, 2.0
Grasp = tuple[float, float, float, float, float]
Draw = Callable[[np.random.Generator], Grasp]

REAL = Gripper(
    name="real",
    min_opening_m=0.0,
    max_opening_m=0.10,
    jaw_sizes_m=(0.01, 0.02, 0.03, 0.04, 0.06),
    jaw_contact_share=1.0,
    finger_thickness_m=0.010,
    finger_length_m=0.12,
    palm_size_m=(0.12, 0.03),
    force_n=10.0,
    friction=0.8,
    torsional_friction_m=0.01,
    finger_mass_kg=0.4,
    closing_speed_m_s=0.15,
    max_depth_m=0.04,
    table_clearance_m=0.003,
    on_touch="fail",
    touch_gap_m=0.001,
    description="10 cm of opening, 10 N, a touch fails",
)


@dataclass(frozen=True)
class Case:
    """Grasps of one kind on one object.

    Args:
        name: Of the object and the grasp.
        standing: The object.
        mass_kg: Its mass.
        draw: One grasp: x, y (m), angle (rad), opening, jaw (m).
        holds: Whether it should hold.
        gripper: The gripper.
        why: Why it must fail; empty where it holds.
    """

    name: str
    standing: shapes.Standing
    mass_kg: float
    draw: Draw
    holds: bool
    gripper: Gripper
    why: str = ""


def across(width_m: float, along_m: float, extra_m: tuple[float, float] = (0.012, 0.03)) -> Draw:
    """Across y, anywhere along x, the opening wider than the object by ``extra_m``."""

    def draw(rng: np.random.Generator) -> Grasp:
        x, y = rng.uniform(-1, 1, 2) * (along_m, 0.004)
        angle = np.pi / 2 + rng.uniform(-1, 1) * np.radians(10)
        return x, y, angle, width_m + rng.uniform(*extra_m), rng.choice(REAL.jaw_sizes_m)

    return draw


def about(width: tuple[float, float], spread_m: float = 0.003, x: float = 0.0) -> Draw:
    """Near a point of the x axis, any angle."""

    def draw(rng: np.random.Generator) -> Grasp:
        dx, dy = rng.uniform(-spread_m, spread_m, 2)
        angle = rng.uniform(-np.pi / 2, np.pi / 2)
        return x + dx, dy, angle, rng.uniform(*width), rng.choice(REAL.jaw_sizes_m)

    return draw


def at(
    x: float,
    y: float,
    angle: float,
    width: tuple[float, float],
    jaws: tuple[float, ...] = REAL.jaw_sizes_m,
    spread_m: float = 0.003,
    turn_rad: float = 0.1,
) -> Draw:
    """Near one point and one angle."""

    def draw(rng: np.random.Generator) -> Grasp:
        dx, dy = rng.uniform(-spread_m, spread_m, 2)
        turn = rng.uniform(-turn_rad, turn_rad)
        return x + dx, y + dy, angle + turn, rng.uniform(*width), rng.choice(jaws)

    return draw


def on_circle(
    radius_m: float, wall_m: float, jaws: tuple[float, ...], free_rad: float = np.pi
) -> Draw:
    """Across a wall that stands on a circle, at most ``free_rad`` away from the -x axis."""

    def draw(rng: np.random.Generator) -> Grasp:
        a = np.pi + rng.uniform(-1, 1) * free_rad
        width = wall_m + rng.uniform(0.012, 0.022)
        x, y = radius_m * np.cos(a), radius_m * np.sin(a)
        return x, y, a + rng.uniform(-0.1, 0.1), width, rng.choice(jaws)

    return draw


def expected_to_hold(gripper: Gripper, mass_kg: float) -> list[Case]:
    """Across something that the gripper can span."""
    up = np.pi / 2
    rim = shapes.MUG_RADIUS_M - shapes.MUG_WALL_M / 2
    handle_x = shapes.MUG_RADIUS_M + shapes.MUG_REACH_M
    small, any_jaw = (0.01, 0.02), REAL.jaw_sizes_m
    rows: list[tuple[str, shapes.Standing, Draw]] = [
        ("box, across 4 cm", shapes.bar(0.12, 0.04, 0.05), across(0.04, 0.03)),
        ("cylinder lying, across 4 cm", shapes.lying_cylinder(0.02, 0.12), across(0.04, 0.03)),
        ("cylinder standing, 4 cm", shapes.standing_cylinder(0.02, 0.12), about((0.055, 0.07))),
        ("sphere, 6 cm", shapes.sphere(0.03), about((0.072, 0.095))),
        ("ring, rim", shapes.ring(), on_circle(shapes.RING_RADIUS_M, shapes.RING_WALL_M, small)),
        ("ring, across 9 cm", shapes.ring(), about((0.099, 0.1), 0.001)),
        ("mug, rim", shapes.mug(), on_circle(rim, shapes.MUG_WALL_M, small, np.pi - 0.6)),
        ("mug, handle", shapes.mug(), at(handle_x, 0, up, (0.024, 0.04), small)),
        ("mug, body 8 cm", shapes.mug(), at(0, 0, up, (0.095, 0.1), any_jaw)),
        ("wrench, handle", shapes.wrench(), across(0.016, 0.03)),
        ("wrench, ring end", shapes.wrench(), at(-0.07, 0, up, (0.048, 0.066))),
        ("wrench, open end", shapes.wrench(), at(0.065, 0, up, (0.052, 0.066))),
    ]
    return [Case(name, s, mass_kg, draw, True, gripper) for name, s, draw in rows]


def seen_on_the_map(gripper: Gripper, mass_kg: float) -> list[Case]:
    """Too narrow, beside the object, or longer than the gripper opens."""
    up, most = np.pi / 2, gripper.max_opening_m
    box, lying = shapes.bar(0.12, 0.04, 0.05), shapes.lying_cylinder(0.02, 0.12)
    ball, long = shapes.sphere(0.03), shapes.bar(most + 0.02, 0.04, 0.05)
    narrow, beside = "the fingers come down on it", "there is nothing"
    rows: list[tuple[str, shapes.Standing, Draw, str]] = [
        ("box, opening too narrow", box, at(0, 0, up, (0.02, 0.036)), narrow),
        ("box, beside it", box, at(0, 0.07, up, (0.02, 0.045)), beside),
        ("box, longer than the opening", long, at(0, 0, 0, (most - 0.01, most)), narrow),
        ("cylinder, opening too narrow", lying, at(0, 0, up, (0.02, 0.032)), narrow),
        ("sphere, opening too narrow", ball, at(0, 0, up, (0.03, 0.045)), narrow),
        ("sphere, beside it", ball, at(0.075, 0, up, (0.02, 0.06), (0.02,)), beside),
        ("ring, in its hole", shapes.ring(), about((0.02, 0.03), 0.002), beside),
        ("wrench, beside it", shapes.wrench(), at(0, 0.06, up, (0.02, 0.05), (0.02,)), beside),
    ]
    return [Case(name, s, mass_kg, draw, False, gripper, why) for name, s, draw, why in rows]


def refused_by_physics(gripper: Gripper, mass_kg: float) -> list[Case]:
    """Grasps that look possible from above, and why they are not."""
    up = np.pi / 2
    steep = float(np.arctan(gripper.friction))
    shallow = replace(gripper, max_depth_m=0.008)
    slick = 0.3 / gripper.friction
    slippery = replace(
        gripper, friction=0.3, torsional_friction_m=slick * gripper.torsional_friction_m
    )
    # Friction bears this much of it when it is held in the middle.
    heavy = 0.6 * 2 * slippery.friction * gripper.force_n / (GRAVITY_M_S2 + LIFT_M_S2)
    block = shapes.bar(0.16, 0.04, 0.04)
    gentle = shapes.wedge(steep - np.radians(12), 0.03)
    slanted = shapes.wedge(steep + np.radians(6), 0.03)
    roof = (0.09, 0.1)
    return [
        Case("wedge 12 deg below the friction angle", gentle, mass_kg,
             at(0, 0, up, roof, turn_rad=0.0), True, gripper),
        Case("wedge 6 deg beyond the friction angle", slanted, mass_kg,
             at(0, 0, up, roof, turn_rad=0.0), False, gripper,
             "the sides push the fingers up with more than friction can hold"),
        Case("sphere, gripped above its equator", shapes.sphere(0.03), mass_kg,
             about((0.058, 0.07), 0.002), False, shallow,
             "at 47 degrees above the equator the slope exceeds the friction angle"),
        Case("box, at a corner", shapes.bar(0.12, 0.12, 0.05), mass_kg,
             at(0.055, 0.055, -np.pi / 4, (0.06, 0.08), (0.01, 0.02), 0.002), False, gripper,
             "both sides lean 45 degrees: the fingers squeeze it out"),
        Case("slippery heavy block, middle", block, heavy,
             at(0, 0, up, (0.052, 0.07), (0.02,)), True, slippery),
        Case("slippery heavy block, its end", block, heavy,
             at(0.07, 0, up, (0.052, 0.07), (0.02,)), False, slippery,
             "its weight turns it in the fingers; the other end stays on the table"),
        Case("too heavy block, middle", block, heavy / 0.6 * 1.2,
             at(0, 0, up, (0.052, 0.07), (0.02,)), False, slippery,
             "friction bears less than its weight"),
    ]  # fmt: skip


def run(*, out: Path | None = None, seed: int = 0, tries: int = 100) -> None:
    """Try every case and say which do what they should.

    Args:
        out: Folder for sanity.json.
        seed: Of the jitter.
        tries: Jittered tries of each case.
    """
    print(f"seed {seed}, {tries} tries a case")
    found = []
    for gripper, mass_kg in ((REAL, 0.2), (load_gripper("jacquard"), 0.06)):
        cases = [
            *expected_to_hold(gripper, mass_kg),
            *seen_on_the_map(gripper, mass_kg),
            *refused_by_physics(gripper, mass_kg),
        ]
        found += [
            _try(case, np.random.default_rng((seed, i)), tries) for i, case in enumerate(cases)
        ]
    table(
        ["gripper", "case", "should", "held", "right", "outcomes", "most frequent reason"],
        [
            [
                row["gripper"],
                row["case"],
                "hold" if row["should_hold"] else "fail",
                row["held"],
                "yes" if row["right"] else "NO",
                ", ".join(f"{k} {v}" for k, v in row["outcomes"].items()),
                row["why"] or row["reason"],
            ]
            for row in found
        ],
    )
    wrong = sum(not row["right"] for row in found)
    print(f"{len(found) - wrong} of {len(found)} cases are as they should be")
    write(out, "sanity", {"seed": seed, "tries": tries, "real": asdict(REAL), "cases": found})


def _try(case: Case, rng: np.random.Generator, tries: int) -> dict[str, object]:
    grasps = np.array([case.draw(rng) for _ in range(tries)])
    results = run_trials(
        case.standing.tabletop(case.mass_kg),
        TableGrasps(grasps[:, :2], grasps[:, 2], grasps[:, 3], grasps[:, 4]),
        case.gripper,
    )
    outcomes = Counter(r.outcome.value for r in results)
    held = outcomes[Outcome.HELD.value]
    reason = Counter(r.reason for r in results).most_common(1)[0][0]
    return {
        "gripper": case.gripper.name,
        "case": case.name,
        "should_hold": case.holds,
        "held": held,
        "right": held >= 0.95 * tries if case.holds else held == 0,
        "outcomes": dict(outcomes.most_common()),
        "why": case.why,
        "reason": reason,
    }
