"""Settling: what comes to rest, where, and what is refused."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from graspmap.errors import InvalidInputError
from graspmap.simulation._mujoco_model import compile_world
from graspmap.simulation.numerics import Numerics
from graspmap.simulation.procedural.primitives import ball, block, cylinder
from graspmap.simulation.procedural.solid import Solid
from graspmap.simulation.settle import SettleSettings, UnsettledError, settle
from graspmap.simulation.solids import object_from_solid


def model(solid: Solid, id: str = "thing", mass_kg: float = 0.1):
    return object_from_solid(id, solid.vertices, solid.faces, solid.pieces, mass_kg=mass_kg)


BRICK = model(block(0.06, 0.04, 0.03), "brick")
UPRIGHT = [(0.0, 0.0, 0.0, 1.0)]


def lowest(placed) -> float:
    return float(placed.triangles()[..., 2].min())


@pytest.mark.parametrize("seed", range(6))
def test_a_brick_rests_on_one_of_its_faces(seed):
    (placed,) = settle([BRICK], np.random.default_rng(seed)).objects
    pose = placed.T_world_object
    assert lowest(placed) == pytest.approx(0, abs=2e-4)
    # One axis of the brick is vertical, and the height is half that side.
    vertical = np.abs(pose.rotation[2])
    axis = int(np.argmax(vertical))
    assert vertical[axis] == pytest.approx(1, abs=1e-3)
    assert pose.translation == pytest.approx([0, 0, BRICK.extents_m[axis] / 2], abs=2e-4)


def test_every_face_comes_up():
    up = [settle([BRICK], np.random.default_rng(s)).objects[0] for s in range(24)]
    faces = {int(np.argmax(np.abs(p.T_world_object.rotation[2]))) for p in up}
    assert len(faces) >= 2


def test_a_ball_comes_to_rest():
    marble = model(ball(0.02), "marble")
    for seed in range(3):
        (placed,) = settle([marble], np.random.default_rng(seed)).objects
        assert lowest(placed) == pytest.approx(0, abs=3e-4)


def test_upright_stays_upright():
    can = model(cylinder(0.03, 0.1), "can")
    (placed,) = settle([can], np.random.default_rng(0), quaternions=UPRIGHT).objects
    assert placed.T_world_object.rotation == pytest.approx(np.eye(3), abs=1e-3)
    assert placed.T_world_object.translation == pytest.approx([0, 0, 0.05], abs=2e-4)


def test_a_pencil_does_not_stand_on_its_tip():
    pencil = model(cylinder(0.0005, 0.12, 0.005), "pencil")
    lean = np.radians(3) / 2
    turn = [(np.sin(lean), 0.0, 0.0, np.cos(lean))]
    (placed,) = settle([pencil], np.random.default_rng(0), quaternions=turn).objects
    assert placed.T_world_object.translation[2] < 0.01


def test_one_object_lies_anywhere_in_the_region():
    places = np.array(
        [
            settle([BRICK], np.random.default_rng(s), region_m=0.2)
            .objects[0]
            .T_world_object.translation
            for s in range(12)
        ]
    )
    assert np.abs(places[:, :2]).max() <= 0.1
    assert np.ptp(places[:, :2], axis=0).min() > 0.08


def test_a_clutter_rests_without_overlap():
    things = [BRICK, model(ball(0.025), "ball"), model(cylinder(0.02, 0.08), "can"), BRICK]
    tabletop = settle(things, np.random.default_rng(1))
    assert [placed.model for placed in tabletop.objects] == things
    centers = np.array([p.T_world_object.translation for p in tabletop.objects])
    apart = np.linalg.norm(centers[:, None] - centers, axis=-1)[np.triu_indices(4, 1)]
    assert apart.min() > 0.025
    assert min(lowest(placed) for placed in tabletop.objects) > -1e-3
    assert tabletop.height_map.top_m > 0.02
    # At rest means at rest: with nothing to slow them they stay where they are.
    world = compile_world(things, None, Numerics())
    world.reset()
    for at, placed in zip(world.body_q, tabletop.objects, strict=True):
        pose = placed.T_world_object
        world.data.qpos[at : at + 7] = [*pose.translation, *np.roll(pose.quaternion(), 1)]
    mujoco.mj_step(world.model, world.data, 150)
    after = world.data.qpos[world.body_q[:, None] + np.arange(3)]
    assert after == pytest.approx(centers, abs=1e-3)


def test_same_seed_same_bits_in_another_process():
    code = (
        "import numpy as np; from tests.test_settle import BRICK, settle;"
        "t = settle([BRICK, BRICK], np.random.default_rng(5));"
        "print([p.T_world_object.matrix.tobytes().hex() for p in t.objects])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    here = settle([BRICK, BRICK], np.random.default_rng(5))
    assert done.stdout.strip() == str(
        [p.T_world_object.matrix.tobytes().hex() for p in here.objects]
    )


class TestRefusals:
    def test_still_moving(self):
        short = SettleSettings(time_limit_s=0.1)
        with pytest.raises(UnsettledError) as caught:
            settle([BRICK], np.random.default_rng(0), settings=short)
        assert (caught.value.reason, caught.value.object_id) == ("still moving", "brick")

    def test_outside_the_region(self):
        # Dropped on the same spot, the second ball must roll far from so small a region.
        marbles = [model(ball(0.01), f"marble{i}") for i in range(2)]
        with pytest.raises(UnsettledError) as caught:
            settle(marbles, np.random.default_rng(0), region_m=0.0)
        assert caught.value.reason == "outside the region"
        assert caught.value.object_id.startswith("marble")

    def test_arguments(self):
        rng = np.random.default_rng(0)
        with pytest.raises(InvalidInputError, match="models"):
            settle([], rng)
        with pytest.raises(InvalidInputError, match="region_m"):
            settle([BRICK], rng, region_m=-1)
        with pytest.raises(InvalidInputError, match="number of quaternions"):
            settle([BRICK], rng, quaternions=[])
        with pytest.raises(InvalidInputError, match="time_limit_s"):
            SettleSettings(time_limit_s=0)
        flat = replace(BRICK, pieces=(BRICK.pieces[0] * (1, 1, 0),))
        with pytest.raises(InvalidInputError, match="brick"):
            settle([flat], rng)
