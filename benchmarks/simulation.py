"""Rows of the simulated trial and of the renderer."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.timing import Comparison, compare
from graspmap.generation import propose_grasps
from graspmap.geometry.table_grasps import TableGrasps
from graspmap.gripper import Gripper, load_gripper
from graspmap.simulation.procedural import ObjectRanges, make_object
from graspmap.simulation.render import Randomisation, View, render, sample_appearance, sample_view
from graspmap.simulation.settle import UnsettledError, settle
from graspmap.simulation.tabletop import Tabletop
from graspmap.simulation.trial import TrialRunner
from studies._rays import RayCaster

_SCENES, _EACH, _RANDOM = 8, 12, 60
_SEED = 5


def rows() -> Iterator[Comparison]:
    """Trials of procedural objects, and their pictures."""
    gripper = load_gripper("jacquard")
    tabletops = list(_tabletops(gripper))
    random, physical = [], []
    for number, tabletop in enumerate(tabletops):
        rng = np.random.default_rng((_SEED, number))
        drawn = propose_grasps(tabletop, gripper, _RANDOM, rng, antipodal_share=0.0)
        mixed = propose_grasps(tabletop, gripper, 20 * _EACH, rng, antipodal_share=0.2)
        descents = TrialRunner(tabletop, gripper).judge(mixed)
        passed = np.flatnonzero(~descents.collided & ~descents.empty)
        random.append(drawn)
        physical.append(mixed[passed[:_EACH]])
    # The usual way: a model for each grasp, since jaw and opening are part of it.
    yield _trials("trial: a grasp that needs physics", tabletops, physical, gripper, 1e3 / 110)
    yield _trials("trial: a random candidate", tabletops, random, gripper, 1e3 / 700)
    yield from _pictures(tabletops)


def _tabletops(gripper: Gripper) -> Iterator[Tabletop]:
    for index in range(_SCENES):
        rng = np.random.default_rng((_SEED, index))
        model = make_object(_SEED, index, ranges=ObjectRanges.for_gripper(gripper))
        try:
            yield settle([model], rng)
        except UnsettledError:
            continue


def _trials(
    work: str,
    tabletops: list[Tabletop],
    grasps: list[TableGrasps],
    gripper: Gripper,
    budget_ms: float,
) -> Comparison:
    runners = [TrialRunner(tabletop, gripper) for tabletop in tabletops]

    def ours() -> None:
        for runner, tried in zip(runners, grasps, strict=True):
            runner.run(tried)

    def usual() -> None:
        for tabletop, tried in zip(tabletops, grasps, strict=True):
            for i in range(len(tried)):
                TrialRunner(tabletop, gripper).run(tried[i : i + 1])

    row = compare(work, ours, usual, seconds=20.0)
    return _each(row, sum(map(len, grasps)), round(budget_ms, 2))


def _pictures(tabletops: list[Tabletop]) -> Iterator[Comparison]:
    """A picture with all channels; the usual tool casts the rays to its pixels' centres alone."""
    for size, budget_ms in ((320, 30.0), (1024, None)):
        rng = np.random.default_rng(_SEED)
        views = [sample_view(Randomisation(), rng, size) for _ in tabletops]
        looks = [sample_appearance(t, Randomisation(), rng) for t in tabletops]
        rays = [_rays(view) for view in views]
        casters = [RayCaster(_triangles(tabletop)) for tabletop in tabletops]

        def ours(views: list[View] = views, looks: list = looks) -> None:
            for tabletop, view, look in zip(tabletops, views, looks, strict=True):
                render(tabletop, view, look)

        def usual(casters: list[RayCaster] = casters, rays: list = rays) -> None:
            for caster, (origins, ways) in zip(casters, rays, strict=True):
                caster.distances(origins, ways, caster.first_hit(origins, ways))

        row = compare(
            f"render: {size} px, colour, depth, mask, normals; usual: Embree's depth alone",
            ours, usual, seconds=15.0,
        )  # fmt: skip
        yield _each(row, len(tabletops), budget_ms)


def _each(row: Comparison, count: int, budget_ms: float | None) -> Comparison:
    return replace(
        row, ours_ms=row.ours_ms / count, usual_ms=row.usual_ms / count, budget_ms=budget_ms
    )


def _rays(view: View) -> tuple[np.ndarray, np.ndarray]:
    camera, pose = view.camera, view.T_world_camera
    y, x = np.mgrid[: camera.height, : camera.width].reshape(2, -1)
    ways = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(x.shape)])
    directions = (pose.rotation @ ways).T
    return np.broadcast_to(pose.translation, directions.shape), directions


def _triangles(tabletop: Tabletop) -> np.ndarray:
    placed = [
        item.T_world_object.apply(item.model.vertices)[item.model.faces]
        for item in tabletop.objects
    ]
    return np.concatenate(placed)
