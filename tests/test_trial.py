"""Grasp trials: outcomes on plain shapes, Coulomb's law, and that nothing but the inputs counts."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from graspmap.errors import InvalidInputError
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import load_gripper
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.procedural.primitives import ball, block
from graspmap.simulation.procedural.solid import Solid, join
from graspmap.simulation.recording import record_trial
from graspmap.simulation.solids import object_from_solid
from graspmap.simulation.tabletop import PlacedObject, Tabletop
from graspmap.simulation.trial import (
    Outcome,
    Perturbation,
    Shake,
    TrialRunner,
    TrialSettings,
    run_trials,
)

UP = np.pi / 2
GRIPPER = replace(
    load_gripper("jacquard"),
    max_opening_m=0.1,
    force_n=10.0,
    on_touch="fail",
    jaw_contact_share=1.0,
    finger_length_m=0.12,
)


def model(solid: Solid, mass_kg: float = 0.1, id: str = "thing") -> ObjectModel:
    return object_from_solid(id, solid.vertices, solid.faces, solid.pieces, mass_kg=mass_kg)


def standing(solid: Solid, mass_kg: float = 0.1, x: float = 0.0, y: float = 0.0) -> PlacedObject:
    """On the table, upright, its middle above (x, y)."""
    thing = model(solid, mass_kg)
    low = float(thing.vertices[:, 2].min())
    return PlacedObject(thing, RigidTransform(np.eye(3), np.array([x, y, -low])))


def table(*objects: PlacedObject) -> Tabletop:
    return Tabletop.of(objects)


def grasps(*rows: tuple[float, float, float, float, float]) -> TableGrasps:
    """From x, y, angle, opening, jaw."""
    rows = np.array(rows, dtype=float).reshape(-1, 5)
    return TableGrasps(rows[:, :2], rows[:, 2], rows[:, 3], rows[:, 4])


BOX = table(standing(block(0.12, 0.04, 0.05)))
ACROSS = (0.0, 0.0, UP, 0.06, 0.02)
MANY = grasps(
    ACROSS,
    (0.02, 0.002, UP - 0.1, 0.055, 0.01),
    (0.055, 0.0, UP, 0.06, 0.02),
    (0.058, 0.016, 0.8, 0.07, 0.01),
    (0.0, 0.0, 0.0, 0.1, 0.02),
    (0.0, 0.1, UP, 0.05, 0.02),
    (0.03, 0.0, UP + 0.3, 0.07, 0.06),
)


class TestOutcomes:
    def test_held_across_a_box(self):
        (result,) = run_trials(BOX, grasps(ACROSS), GRIPPER)
        assert result.outcome is Outcome.HELD
        assert result.object_index == 0
        assert result.opening_m == 0.06
        # The map has cells of 1 mm.
        assert result.needed_m == pytest.approx(0.04, abs=0.0021)
        assert result.tip_m == pytest.approx(0.01, abs=0.0001)
        assert result.closed_m == pytest.approx(0.04, abs=0.0005)
        assert result.grip_force_n == pytest.approx(10, rel=0.02)
        assert result.slip_m < 0.002
        # The lift ends once the object hangs still.
        assert TrialSettings().left_table_m < result.lift_m <= TrialSettings().lift_m
        assert result.success_probability is None

    @pytest.mark.parametrize(
        ("grasp", "outcome", "reason"),
        [
            ((0, 0, UP, 0.03, 0.02), Outcome.COLLIDED, "finger would touch 40 mm above its goal"),
            ((0, 0, 0, 0.2, 0.02), Outcome.COLLIDED, "asked to open 200 mm, the gripper's most"),
            ((0, 0.1, UP, 0.05, 0.02), Outcome.EMPTY, "nothing lies between"),
        ],
    )
    def test_decided_on_the_height_map(self, grasp, outcome, reason):
        (result,) = run_trials(BOX, grasps(grasp), GRIPPER)
        assert (result.outcome, result.closed_m, result.object_index) == (outcome, None, None)
        assert reason in result.reason

    def test_too_heavy_slips(self):
        heavy = table(standing(block(0.12, 0.04, 0.05), mass_kg=2.0))
        (result,) = run_trials(heavy, grasps(ACROSS), GRIPPER)
        assert result.outcome is Outcome.SLIPPED
        assert result.lift_m < 0.01

    def test_ball_gripped_above_its_equator_slips(self):
        high = replace(GRIPPER, max_depth_m=0.008)
        (low, above) = (
            run_trials(table(standing(ball(0.03))), grasps((0, 0, 0, 0.07, 0.02)), g)[0]
            for g in (GRIPPER, high)
        )
        assert low.outcome is Outcome.HELD
        assert above.outcome is Outcome.SLIPPED

    def test_held_at_its_end_a_slippery_bar_stays_on_the_table(self):
        bar = table(standing(block(0.16, 0.02, 0.02), mass_kg=0.4))
        slick = replace(GRIPPER, torsional_friction_m=0.002)
        middle, end = run_trials(
            bar, grasps((0, 0, UP, 0.04, 0.02), (0.07, 0, UP, 0.04, 0.005)), slick
        )
        assert middle.outcome is Outcome.HELD
        assert end.outcome is Outcome.SLIPPED
        assert "table" in end.reason

    def test_pieces_beyond_the_surface_collide_in_physics(self):
        thing = model(block(0.04, 0.04, 0.04))
        wide = replace(thing, pieces=(thing.pieces[0] * (3.0, 1.0, 1.0),))
        place = RigidTransform(np.eye(3), np.array([0, 0, 0.02]))
        (result,) = run_trials(
            table(PlacedObject(wide, place)), grasps((0, 0, 0, 0.06, 0.02)), GRIPPER
        )
        assert result.outcome is Outcome.COLLIDED
        assert "convex pieces" in result.reason

    def test_opening_below_the_least(self):
        stiff = replace(GRIPPER, min_opening_m=0.05)
        (result,) = run_trials(BOX, grasps((0, 0, UP, 0.045, 0.02)), stiff)
        assert result.opening_m == 0.05
        assert "the gripper's least is 50" in result.reason
        assert result.outcome is Outcome.EMPTY


class TestJaws:
    @pytest.mark.parametrize("jaw", [0.01, 0.02, 0.04, 0.06])
    def test_all_of_a_jaw_holds_whatever_the_object_is_made_of(self, jaw):
        """An object off the middle of the jaw, in one piece and cut into four."""
        outcomes = []
        for y in (0.0, 0.012, 0.021, 0.027, 0.032, 0.045):
            for cuts in (1, 4):
                slices = [
                    block(0.03, 0.02 / cuts, 0.04).moved(y=(k + 0.5) * 0.02 / cuts - 0.01)
                    for k in range(cuts)
                ]
                whole = slices[0] if cuts == 1 else join(slices)
                thing = table(standing(whole, 0.05, y=y))
                (result,) = run_trials(thing, grasps((0.0, 0.0, 0.0, 0.06, jaw)), GRIPPER)
                outcomes.append(result.outcome is Outcome.EMPTY)
        one, four = outcomes[::2], outcomes[1::2]
        assert one == four
        beside = [abs(y) > jaw / 2 + 0.01 for y in (0.0, 0.012, 0.021, 0.027, 0.032, 0.045)]
        assert one == beside

    @pytest.mark.parametrize("speed", [0.15, 0.02, 0.004, 0.002])
    def test_slow_fingers_hold_as_well(self, speed):
        slow = replace(GRIPPER, closing_speed_m_s=speed)
        (result,) = run_trials(BOX, grasps(ACROSS), slow)
        assert result.outcome is Outcome.HELD


class TestClutter:
    SCENE = table(
        standing(block(0.12, 0.04, 0.05)),
        standing(ball(0.025), y=0.09),
        standing(block(0.03, 0.03, 0.06), x=0.12),
    )

    def test_names_the_object_that_was_grasped(self):
        tried = grasps(ACROSS, (0, 0.09, 0.3, 0.07, 0.02), (0.12, 0, UP, 0.05, 0.02))
        results = run_trials(self.SCENE, tried, GRIPPER)
        assert [r.outcome for r in results] == [Outcome.HELD] * 3
        assert [r.object_index for r in results] == [0, 1, 2]

    def test_a_neighbour_in_the_way(self):
        near = table(standing(block(0.12, 0.04, 0.05)), standing(block(0.12, 0.04, 0.05), y=0.045))
        (result,) = run_trials(near, grasps(ACROSS), GRIPPER)
        assert result.outcome is Outcome.COLLIDED

    def test_says_what_came_along(self):
        rider = standing(block(0.02, 0.02, 0.02))
        above = PlacedObject(
            rider.model,
            RigidTransform(np.eye(3), rider.T_world_object.translation + np.array([0.05, 0, 0.05])),
        )
        scene = table(standing(block(0.12, 0.04, 0.05)), above)
        (result,) = run_trials(scene, grasps((-0.01, 0, UP, 0.06, 0.02)), GRIPPER)
        assert (result.outcome, result.object_index) == (Outcome.HELD, 0)
        assert "object 1 came along" in result.reason


class TestFriction:
    """Coulomb: two fingers bear a weight of 2 mu F."""

    @pytest.mark.parametrize("friction", [0.3, 0.9])
    @pytest.mark.parametrize(("share", "held"), [(0.9, True), (1.1, False)])
    def test_bears_twice_the_force_times_the_friction(self, friction, share, held):
        settings = TrialSettings(max_slip_m=0.002, lift_m=0.02)
        pull = 9.81 + settings.lift_accelerations()[0]
        gripper = replace(GRIPPER, friction=friction)
        mass = share * 2 * friction * gripper.force_n / pull
        scene = table(standing(block(0.06, 0.04, 0.04), mass_kg=mass))
        (result,) = run_trials(scene, grasps(ACROSS), gripper, settings=settings)
        assert (result.outcome is Outcome.HELD) == held


class TestDeterminism:
    def test_order_and_history_change_nothing(self):
        runner = TrialRunner(BOX, GRIPPER)
        forward = runner.run(MANY)
        order = np.array([3, 6, 0, 5, 2, 4, 1])
        mixed = runner.run(MANY[order])
        assert [mixed[i] for i in np.argsort(order)] == forward
        # Friction and mass of a perturbed repeat do not stay behind.
        unsure = Perturbation(position_m=0.003, angle_rad=0.1, friction=0.4, mass=0.5)
        runner.run(MANY[:2], perturbation=unsure, repeats=2)
        assert runner.run(MANY) == forward
        assert [runner.try_one(MANY, i) for i in range(len(MANY))] == forward

    def test_shake_leaves_nothing_behind(self):
        settings = TrialSettings(shake=Shake(tilt_rad=0.5, cycles=1, tilt_s=0.3))
        runner = TrialRunner(BOX, GRIPPER, settings)
        first = runner.run(MANY[:2])
        assert runner.run(MANY[:2]) == first

    def test_another_process_has_the_same_bits(self):
        code = (
            "from tests.test_trial import BOX, GRIPPER, MANY, run_trials;"
            "print(repr(run_trials(BOX, MANY, GRIPPER)))"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == repr(run_trials(BOX, MANY, GRIPPER))


class TestPerturbation:
    def test_share_of_the_repeats(self):
        # The opening leaves 1 mm on either side: half of the moved grasps touch.
        tight = grasps((0, 0, UP, 0.046, 0.02), ACROSS)
        unsure = Perturbation(position_m=0.004)
        results = run_trials(BOX, tight, GRIPPER, perturbation=unsure, repeats=12, seed=3)
        assert 0.1 < results[0].success_probability < 0.9
        assert results[1].success_probability == 1.0
        again = run_trials(BOX, tight, GRIPPER, perturbation=unsure, repeats=12, seed=3)
        assert again == results

    def test_repeats_draw_from_seed_grasp_and_repeat(self):
        unsure = Perturbation(0.01, 0.2, 0.3, 0.4)
        x, y, angle, friction, mass = unsure.draw(np.random.default_rng((1, 2, 3)))
        normal = np.random.default_rng((1, 2, 3)).standard_normal(5)
        assert [x, y, angle] == pytest.approx(normal[:3] * [0.01, 0.01, 0.2])
        assert [friction, mass] == pytest.approx(np.exp(normal[3:] * [0.3, 0.4]))

    def test_mass_decides(self):
        gripper = replace(GRIPPER, friction=0.5)
        scene = table(standing(block(0.06, 0.04, 0.04), mass_kg=0.8))
        unsure = Perturbation(mass=0.5)
        (result,) = run_trials(
            scene, grasps(ACROSS), gripper, perturbation=unsure, repeats=10, seed=1
        )
        factors = [unsure.draw(np.random.default_rng((1, 0, r)))[4] for r in range(10)]
        borne = 2 * 0.5 * 10 / 9.81 / 0.8
        light = np.mean([f < 0.85 * borne for f in factors])
        heavy = np.mean([f > 1.0 * borne for f in factors])
        assert light <= result.success_probability <= 1 - heavy
        assert 0 < light <= 1 - heavy < 1


class TestShake:
    def test_loses_a_weak_grip_and_keeps_a_strong_one(self):
        still, shaken = (
            TrialSettings(shake=shake) for shake in (None, Shake(acceleration_m_s2=40.0, cycles=1))
        )
        scene = table(standing(block(0.06, 0.04, 0.04), mass_kg=0.5))
        weak, strong = replace(GRIPPER, friction=0.5), replace(GRIPPER, force_n=60.0)
        outcomes = [
            run_trials(scene, grasps(ACROSS), gripper, settings=settings)[0]
            for gripper in (weak, strong)
            for settings in (still, shaken)
        ]
        assert [r.outcome is Outcome.HELD for r in outcomes] == [True, False, True, True]
        assert outcomes[1].reason.endswith("when shaken")

    def test_gravity_keeps_its_size_while_tilting(self):
        shake = Shake(directions=(), tilt_rad=0.7, tilt_s=1.0)
        felt = np.array([shake.gravity(t) for t in np.linspace(0, 1.999, 50)])
        assert np.linalg.norm(felt, axis=1) == pytest.approx(9.81)
        assert np.degrees(np.arccos(-felt[:, 2] / 9.81)).max() == pytest.approx(40.1, abs=0.5)
        assert shake.duration_s == 2.0

    def test_swings_along_each_direction_in_turn(self):
        shake = Shake(acceleration_m_s2=3.0, frequency_hz=2.0, cycles=1)
        times = np.linspace(0, 1.499, 600)
        moved = np.array([shake.gravity(t) for t in times]) + np.array([0, 0, 9.81])
        for axis in range(3):
            mine = (times >= axis / 2) & (times < (axis + 1) / 2)
            assert np.abs(moved[mine, axis]).max() == pytest.approx(3.0, rel=0.01)
            assert np.abs(moved[~mine, axis]).max() < 1e-9


class TestRecording:
    def test_shows_the_trial(self):
        turned = grasps((0.02, 0.01, UP + 0.05, 0.06, 0.02))
        film = record_trial(BOX, turned, GRIPPER)
        assert film.result == run_trials(BOX, turned, GRIPPER)[0]
        count = len(film)
        assert film.object_positions_m.shape == (count, 1, 3)
        assert film.finger_places_m.shape == (count, 2)
        assert list(dict.fromkeys(film.phases)) == ["descend", "close", "lift"]
        start = BOX.objects[0].T_world_object
        assert film.T_world_object(0, 0).matrix == pytest.approx(start.matrix)
        # Until the fingers meet it the object stays; then it rises with the gripper.
        first = film.phases.index("close")
        assert film.T_world_object(first, 0).matrix == pytest.approx(start.matrix, abs=1e-5)
        risen = film.object_positions_m[-1, 0, 2] - start.translation[2]
        assert risen == pytest.approx(film.tips_m[-1] - film.result.tip_m, abs=0.003)
        # The verdict falls on the way; the film goes on to the top.
        assert risen == pytest.approx(TrialSettings().lift_m, abs=0.003)
        assert film.result.lift_m < risen
        opening = film.finger_places_m[:, 1] - film.finger_places_m[:, 0]
        assert opening[0] == pytest.approx(0.06)
        assert opening[-1] == pytest.approx(0.04, abs=0.001)
        # The fingers stand beside the box, which leans a little in the grasp.
        assert np.abs(film.object_positions_m[:, 0, :2]).max() < 0.01

    def test_a_collision_ends_where_it_touches(self):
        film = record_trial(BOX, grasps((0, 0, UP, 0.03, 0.02)), GRIPPER)
        assert set(film.phases) == {"descend"}
        assert film.tips_m[-1] == pytest.approx(0.05, abs=0.0002)


class TestSettings:
    @pytest.mark.parametrize(
        ("field", "value"),
        [
            ("timestep_s", 0.0),
            ("timestep_s", float("nan")),
            ("lift_m", -0.1),
            ("stall_checks", 0),
            ("max_slip_m", "much"),
            ("impratio", True),
            ("contact_impedance", (0.9, 0.5, 0.001)),
            ("shake", 5.0),
        ],
    )
    def test_refuses(self, field, value):
        with pytest.raises(InvalidInputError, match=field):
            TrialSettings(**{field: value})

    @pytest.mark.parametrize("kwargs", [{"acceleration_m_s2": -1}, {"directions": ("sideways",)}])
    def test_shake_refuses(self, kwargs):
        with pytest.raises(InvalidInputError):
            Shake(**kwargs)

    @pytest.mark.parametrize("lift", [0.001, 0.02, 0.08, 0.5])
    @pytest.mark.parametrize("acceleration", [0.5, 2.0, 20.0])
    def test_lift_reaches_its_height_within_its_limits(self, lift, acceleration):
        settings = TrialSettings(lift_m=lift, lift_acceleration_m_s2=acceleration)
        rates = np.array(settings.lift_accelerations())
        assert np.abs(rates).max() <= acceleration * (1 + 1e-6)
        speed = np.cumsum(rates) * settings.check_s
        way = ((np.r_[0, speed[:-1]] + speed) / 2 * settings.check_s).sum()
        assert way == pytest.approx(lift)
        assert speed[-1] == pytest.approx(0, abs=1e-12)
        assert speed.max() <= settings.lift_speed_m_s * 1.2

    def test_refuses_what_makes_no_trial(self):
        with pytest.raises(InvalidInputError, match="objects of the tabletop"):
            TrialRunner(Tabletop((), BOX.height_map), GRIPPER)
        with pytest.raises(InvalidInputError, match="gripper is 'franka'; allowed: a Gripper"):
            run_trials(BOX, grasps(ACROSS), "franka")
        with pytest.raises(InvalidInputError, match="repeats"):
            run_trials(BOX, grasps(ACROSS), GRIPPER, repeats=3)
        with pytest.raises(InvalidInputError, match="friction"):
            Perturbation(friction=-1)

    def test_refuses_pieces_that_are_no_bodies(self):
        thing = model(block(0.04, 0.04, 0.04), id="sheet")
        flat = replace(thing, pieces=(thing.pieces[0] * (1.0, 1.0, 0.0),))
        with pytest.raises(InvalidInputError, match="sheet"):
            TrialRunner(table(PlacedObject(flat, RigidTransform.identity())), GRIPPER)

    def test_no_grasps_no_results(self):
        assert run_trials(BOX, MANY[:0], GRIPPER) == []
        assert run_trials(BOX, MANY[:0], GRIPPER, perturbation=Perturbation()) == []


def test_parts_of_one_object_move_together():
    solid = join([block(0.12, 0.02, 0.02), block(0.02, 0.08, 0.02)])
    (result,) = run_trials(table(standing(solid)), grasps((0.04, 0, UP, 0.04, 0.02)), GRIPPER)
    assert result.outcome is Outcome.HELD
