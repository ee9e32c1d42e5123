"""Settling: objects are dropped on the table and come to rest.

World frame: the table is the plane z = 0, z up, metres. Letters in shapes: B objects.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from graspmap.errors import GraspmapError, InvalidInputError
from graspmap.geometry.transforms import RigidTransform
from graspmap.simulation._mujoco_model import World, compile_world
from graspmap.simulation.numerics import Numerics, check_range
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.tabletop import PlacedObject, Tabletop

Floats = NDArray[np.float64]
Unsettled = Literal["still moving", "outside the region", "fell through", "unstable"]

# Where objects wait until it is their turn, far from all others.
_WAITING_M = 50.0
_BELOW_TABLE_M = 0.003
# Damping that brings things to rest sooner: speeds decay with these rates, 1/s.
_SLOW_DOWN, _TURN_DOWN = 2.0, 6.0
_ROLLING_FRICTION_M = 0.001


class UnsettledError(GraspmapError):
    """Objects did not come to rest on the table; another draw may.

    Attributes:
        reason: Which way it failed, one of a few words that can be counted.
        object_id: The object that failed first.
    """

    def __init__(self, reason: Unsettled, object_id: str, detail: str) -> None:
        self.reason: Unsettled = reason
        self.object_id = object_id
        super().__init__(f"{object_id} did not settle: {reason} ({detail})")


@dataclass(frozen=True, kw_only=True)
class SettleSettings(Numerics):
    """Numbers of the settling; those of `Numerics` come first.

    Args:
        drop_m: Height of the fall onto the table, or onto what lies there.
        time_limit_s: Time after which an object that still moves is given up.
        pause_s: Time between the drops of two objects of a clutter.
        rest_speed_m_s: An object whose every point is slower may be at rest...
        rest_s: ...and is, if without any damping no point of it then moves by ``rest_way_m`` in
            this time.
        rest_way_m: See ``rest_s``.

    Raises:
        InvalidInputError: A number is not finite or out of range.
    """

    drop_m: float = 0.01
    time_limit_s: float = 4.0
    pause_s: float = 0.3
    rest_speed_m_s: float = 0.002
    rest_s: float = 0.2
    rest_way_m: float = 0.0003

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range(self, "drop_m", 0.0, 1.0)
        check_range(self, "time_limit_s", 0.1, 100.0)
        check_range(self, "pause_s", 0.0, 10.0)
        check_range(self, "rest_speed_m_s", 1e-5, 0.1)
        check_range(self, "rest_s", 0.01, 10.0)
        check_range(self, "rest_way_m", 1e-6, 0.01)


def settle(
    models: Sequence[ObjectModel],
    rng: np.random.Generator,
    *,
    region_m: float | None = None,
    quaternions: Sequence[Sequence[float]] | None = None,
    settings: SettleSettings | None = None,
) -> Tabletop:
    """Drop objects on the table, one after the other, each turned at random, and wait for rest.

    A single object ends with its centre of mass at a random place of the region; of several, each
    is dropped at a random place of it, and all must come to rest with their centres above it or
    not farther outside than they are long.

    Args:
        models: B objects, dropped in this order.
        rng: Where the turns and places come from.
        region_m: Side of the square about the world's origin; by default 0 for one object, and for
            several what holds them side by side.
        quaternions: B turns (x, y, z, w) instead of random ones, such as (0, 0, 0, 1) for upright.
        settings: Numbers of the settling.

    Returns:
        The objects at rest.

    Raises:
        UnsettledError: They did not come to rest, or not where they should.
        InvalidInputError: There is no object, an object makes no body, or an argument is out of
            range.
    """
    settings = settings or SettleSettings()
    if not models:
        raise InvalidInputError("models", "none", "one object or more")
    if region_m is not None and not (0 <= region_m <= 10 and math.isfinite(region_m)):
        raise InvalidInputError("region_m", region_m, "metres from 0 to 10")
    if quaternions is not None and len(quaternions) != len(models):
        raise InvalidInputError("number of quaternions", len(quaternions), f"{len(models)}")
    region = _region(models) if region_m is None else region_m
    turns = [
        RigidTransform.from_quaternion(_random_turn(rng) if quaternions is None else quaternions[i])
        for i in range(len(models))
    ]
    places = rng.uniform(-region / 2, region / 2, (len(models), 2))
    drops = [
        RigidTransform(turn.rotation, np.append(place, 0.0))
        for turn, place in zip(turns, places, strict=True)
    ]
    poses = _Fall(models, settings).run(drops)
    if len(models) == 1:
        at = np.append(places[0], poses[0].translation[2])
        poses = [RigidTransform(poses[0].rotation, at)]
    else:
        _check_region(models, poses, region)
    return Tabletop.of(tuple(PlacedObject(m, p) for m, p in zip(models, poses, strict=True)))


def _random_turn(rng: np.random.Generator) -> Floats:
    """(4,) quaternion, uniform over all rotations."""
    q = rng.standard_normal(4)
    return np.asarray(q / np.linalg.norm(q))


def _region(models: Sequence[ObjectModel]) -> float:
    if len(models) == 1:
        return 0.0
    return 0.7 * math.sqrt(sum(_radius(m) ** 2 * 4 for m in models))


def _radius(model: ObjectModel) -> float:
    """Distance of the farthest vertex from the centre of mass, metres."""
    return float(np.linalg.norm(model.vertices, axis=1).max())


def _check_region(
    models: Sequence[ObjectModel], poses: Sequence[RigidTransform], region_m: float
) -> None:
    for model, pose in zip(models, poses, strict=True):
        out = float(np.abs(pose.translation[:2]).max()) - region_m / 2
        if out > 2 * _radius(model):
            raise UnsettledError(
                "outside the region", model.id, f"its centre rests {out:.2f} m outside"
            )


class _Fall:
    """A world in which objects fall one after the other."""

    def __init__(self, models: Sequence[ObjectModel], settings: SettleSettings) -> None:
        self._models, self._settings = models, settings
        self._world: World = compile_world(models, None, settings)
        self._points = [np.concatenate(model.pieces) for model in models]
        self._radius = np.array([_radius(model) for model in models])
        model = self._world.model
        # Objects roll on as if on a hard table, but not for ever.
        model.geom_condim[:] = 6
        model.geom_friction[:, 2] = _ROLLING_FRICTION_M
        self._world.reset()

    def run(self, drops: Sequence[RigidTransform]) -> list[RigidTransform]:
        """Poses at rest; ``drops`` give the turns and the places in the plane.

        Raises:
            UnsettledError: They do not come to rest.
        """
        settings = self._settings
        pause = round(settings.pause_s / settings.check_s)
        for count, drop in enumerate(drops):
            self._drop(count, drop)
            if count + 1 < len(drops):
                self._advance(count + 1, pause)
        everything = len(drops)
        limit = settings.time_limit_s * (1 + 0.25 * (everything - 1))
        rest = round(settings.rest_s / settings.check_s)
        checks = round(limit / settings.check_s)
        while checks > 0:
            self._advance(everything, 1)
            checks -= 1
            if self._fastest() < settings.rest_speed_m_s:
                before = [self._corners(i) for i in range(everything)]
                self._damp(0.0)
                self._advance(everything, rest)
                self._damp(1.0)
                checks -= rest
                after = [self._corners(i) for i in range(everything)]
                moved = [np.abs(a - b).max() for a, b in zip(after, before, strict=True)]
                if max(moved) < settings.rest_way_m:
                    self._check_above(after)
                    return [self._pose(i) for i in range(everything)]
        index = int(np.argmax(self._speeds()))
        speed = self._speeds()[index] * 1e3
        raise UnsettledError(
            "still moving",
            self._models[index].id,
            f"up to {speed:.0f} mm/s after {limit:.1f} s",
        )

    def _drop(self, index: int, drop: RigidTransform) -> None:
        """Put an object just above everything below it."""
        low = float((self._points[index] @ drop.rotation.T)[:, 2].min())
        top = 0.0
        for other in range(index):
            pose = self._pose(other)
            way = np.linalg.norm(pose.translation[:2] - drop.translation[:2])
            if way < self._radius[index] + self._radius[other]:
                top = max(top, float(pose.apply(self._points[other])[:, 2].max()))
        height = top - low + self._settings.drop_m
        data, at = self._world.data, self._world.body_q[index]
        data.qpos[at : at + 3] = [*drop.translation[:2], height]
        data.qpos[at + 3 : at + 7] = np.roll(drop.quaternion(), 1)
        speeds = self._world.body_v[index]
        data.qvel[speeds : speeds + 6] = 0.0
        self._damp(1.0)

    def _damp(self, share: float) -> None:
        """Air as thick as honey: speeds decay at a share of the full rates."""
        model = self._world.model
        for body, at in zip(self._world.bodies, self._world.body_v, strict=True):
            model.dof_damping[at : at + 3] = share * _SLOW_DOWN * model.body_mass[body]
            turning = float(model.body_inertia[body].mean())
            model.dof_damping[at + 3 : at + 6] = share * _TURN_DOWN * turning

    def _advance(self, count: int, checks: int) -> None:
        """Let time go on; objects from number ``count`` on wait far away."""
        world, data = self._world, self._world.data
        for _ in range(checks):
            for index in range(count, len(self._models)):
                q, v = world.body_q[index], world.body_v[index]
                data.qpos[q : q + 7] = [_WAITING_M * (index + 1), 0.0, _WAITING_M, 1, 0, 0, 0]
                data.qvel[v : v + 6] = 0.0
            mujoco.mj_step(world.model, data, self._settings.steps_a_check)
            if world.unstable():
                raise UnsettledError("unstable", self._models[count - 1].id, "speeds became huge")
            for index in range(count):
                if data.qpos[world.body_q[index] + 2] < -_BELOW_TABLE_M:
                    raise UnsettledError(
                        "fell through", self._models[index].id, "its centre is below the table"
                    )

    def _speeds(self) -> Floats:
        """(B,) bound on the speed of any point of each object, m/s."""
        at = self._world.body_v[:, None] + np.arange(6)
        speeds = self._world.data.qvel[at]
        turning = np.linalg.norm(speeds[:, 3:], axis=1) * self._radius
        return np.asarray(np.linalg.norm(speeds[:, :3], axis=1) + turning)

    def _fastest(self) -> float:
        return float(self._speeds().max())

    def _pose(self, index: int) -> RigidTransform:
        at = self._world.body_q[index]
        q = self._world.data.qpos[at : at + 7]
        return RigidTransform.from_quaternion(np.roll(q[3:], -1), q[:3])

    def _corners(self, index: int) -> Floats:
        """(P, 3) where the vertices of an object's pieces are."""
        return self._pose(index).apply(self._points[index])

    def _check_above(self, corners: Sequence[Floats]) -> None:
        for model, points in zip(self._models, corners, strict=True):
            low = float(points[:, 2].min())
            if low < -_BELOW_TABLE_M:
                raise UnsettledError(
                    "fell through", model.id, f"it reaches {-low * 1e3:.0f} mm below"
                )
