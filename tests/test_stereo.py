"""Stereo depth: holes on the right side, disparities on their lattice, errors of the right size."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.data.files import read_depth, read_mask
from graspmap.errors import InvalidInputError
from graspmap.geometry import RigidTransform
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.render import (
    Sensor,
    jacquard_view,
    plain_appearance,
    render,
    stereo_depth,
)
from graspmap.simulation.tabletop import PlacedObject, Tabletop

FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ],
    np.int32,
)
CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
EXACT = Sensor(
    locking=0.0,
    noise_px=0.0,
    fine_px=0.0,
    waver_px=0.0,
    fattening_px=0.0,
    shadow=0.0,
    dropout=0.0,
    speckle=0.0,
)


def scene(size=160, sides=(0.1, 0.1, 0.15), count=1):
    model = ObjectModel("box", CUBE * sides, FACES, (), 0.1, np.eye(3))
    placed = PlacedObject(model, RigidTransform(np.eye(3), [0, 0, sides[2] / 2]))
    tabletop, view = Tabletop((placed,) * count, None), jacquard_view(size)
    return tabletop, view, render(tabletop, view, plain_appearance(tabletop))


def measure(sensor, seed=0, **options):
    tabletop, view, picture = scene(**options)
    return picture, stereo_depth(tabletop, view, picture, sensor, np.random.default_rng(seed))


class TestDisparity:
    @pytest.mark.parametrize("size", [64, 320])
    def test_without_errors_it_is_the_nearest_step(self, size):
        picture, depth = measure(EXACT, size=size)
        strength = jacquard_view(1024).camera.fx * EXACT.baseline_m
        steps = strength / depth.astype(float) * EXACT.subpixel
        assert steps == pytest.approx(np.round(steps), abs=2e-4)
        exact = strength / picture.depth.astype(float) * EXACT.subpixel
        assert np.abs(steps - exact).max() <= 0.5 + 2e-4

    def test_with_fine_steps_it_is_the_exact_depth(self):
        picture, depth = measure(EXACT.model_copy(update={"subpixel": 4096.0}))
        assert depth == pytest.approx(picture.depth, abs=3e-6)

    def test_locking_draws_to_whole_pixels(self):
        sensor = EXACT.model_copy(update={"locking": 0.5, "subpixel": 4096.0})
        picture, depth = measure(sensor, count=0)
        strength = jacquard_view(1024).camera.fx * sensor.baseline_m
        true, found = strength / picture.depth.astype(float), strength / depth.astype(float)
        away, left = true - np.round(true), found - np.round(true)
        inside = np.abs(away) < 0.49
        expected = away * (1 - 0.5 * (1 - 2.2 * away**2))
        assert left[inside] == pytest.approx(expected[inside], abs=1e-3)

    @given(st.integers(0, 2**32))
    @settings(max_examples=10)
    def test_noise_is_as_large_as_said(self, seed):
        sensor = EXACT.model_copy(update={"noise_px": 0.3, "subpixel": 4096.0})
        picture, depth = measure(sensor, seed, count=0, size=128)
        strength = jacquard_view(1024).camera.fx * sensor.baseline_m
        error = strength / depth.astype(float) - strength / picture.depth.astype(float)
        assert error.std() == pytest.approx(0.3, rel=0.2)
        assert abs(error.mean()) < 0.03

    def test_errors_in_metres_do_not_depend_on_the_size_of_the_picture(self):
        spread = []
        for size in (160, 640):
            picture, depth = measure(Sensor(), size=size, count=0)
            spread.append(np.nanstd(depth - picture.depth))
        assert spread[0] == pytest.approx(spread[1], rel=0.1)


class TestHoles:
    def test_lie_where_the_second_camera_cannot_see(self):
        sensor = EXACT.model_copy(update={"shadow": 1.0})
        size, sides = 320, (0.1, 0.1, 0.15)
        tabletop, view, picture = scene(size, sides)
        depth = stereo_depth(tabletop, view, picture, sensor, np.random.default_rng(0))
        holes = np.isnan(depth)
        # The second camera stands to the right, so it misses what lies to the left of the box.
        camera, pose = view.camera, view.T_world_camera
        y, x = np.mgrid[:size, :size]
        points = pose.apply(camera.deproject(np.stack([x, y], -1), picture.depth))
        second = pose.apply([sensor.baseline_m, 0, 0])
        middle = 0.5 * np.array([0, 0, sides[2]])
        half = 0.5 * np.array(sides)
        # Slabs: the ray from a point to the second camera against the box, in double precision.
        direction = second - points
        middle = np.array([0, 0, sides[2] / 2])
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (middle - half - points) / direction, (middle + half - points) / direction
        enter, leave = np.minimum(one, two).max(-1), np.maximum(one, two).min(-1)
        hidden = (leave - enter > 0.01) & (enter > 1e-4)
        assert holes.sum() > 100
        assert holes[hidden & ~picture.mask].mean() > 0.9
        columns = np.nonzero(holes & ~picture.mask)[1]
        assert columns.max() < np.nonzero(picture.mask)[1].min() + 12
        clear = (leave < enter) & ~picture.mask
        assert holes[clear].mean() < 0.002

    def test_shadow_grows_with_the_baseline(self):
        widths = []
        for baseline in (0.04, 0.08, 0.16):
            sensor = EXACT.model_copy(update={"shadow": 1.0, "baseline_m": baseline})
            widths.append(np.isnan(measure(sensor)[1]).sum())
        assert 1.6 < widths[1] / widths[0] < 2.5
        assert 1.6 < widths[2] / widths[1] < 2.5

    def test_dropouts_lie_at_edges(self):
        sensor = EXACT.model_copy(update={"dropout": 0.5})
        picture, depth = measure(sensor, size=320)
        holes = np.isnan(depth)
        rows, columns = np.nonzero(picture.mask)
        box = np.s_[rows.min() - 8 : rows.max() + 9, columns.min() - 8 : columns.max() + 9]
        outside = holes.copy()
        outside[box] = False
        assert holes.sum() > 50
        assert not outside.any()

    def test_share_of_specks(self):
        _, depth = measure(EXACT.model_copy(update={"speckle": 0.05}), size=320, count=0)
        assert np.isnan(depth).mean() == pytest.approx(0.05, rel=0.25)

    def test_no_depth_stays_none(self):
        tabletop, view, picture = scene(64)
        picture.depth[:5] = np.nan
        depth = stereo_depth(tabletop, view, picture, EXACT, np.random.default_rng(0))
        assert np.isnan(depth[:5]).all()
        assert np.isfinite(depth[5:]).all()


class TestEdges:
    def test_fattening_moves_them_outwards(self):
        sensor = EXACT.model_copy(update={"fattening_px": 4.0})
        tabletop, view, picture = scene(512)
        thin = stereo_depth(tabletop, view, picture, EXACT, np.random.default_rng(0))
        fat = stereo_depth(tabletop, view, picture, sensor, np.random.default_rng(0))
        assert ((fat < 1.4) & ~(thin < 1.4)).sum() > 100
        assert not ((thin < 1.4) & ~(fat < 1.4)).any()

    def test_same_seed_same_bytes(self):
        first, second, other = (measure(Sensor(), seed)[1].tobytes() for seed in (1, 1, 2))
        assert first == second != other

    def test_refuses_a_picture_of_another_size(self):
        tabletop, _, picture = scene(64)
        with pytest.raises(InvalidInputError, match="shape of the rendering"):
            stereo_depth(tabletop, jacquard_view(65), picture, EXACT, np.random.default_rng(0))


def errors(depth, exact, mask):
    """Share of holes on and around the object and elsewhere; spread on the table, metres."""
    rows, columns = np.nonzero(mask)
    near = np.zeros_like(mask)
    near[
        max(rows.min() - 30, 0) : rows.max() + 30, max(columns.min() - 30, 0) : columns.max() + 30
    ] = 1
    hole = np.isnan(depth)
    far = ~near & ~hole
    spread = np.subtract(*np.percentile((depth - exact)[far], [84, 16])) / 2
    return hole[mask].mean(), hole[near].mean(), hole[~near].mean(), spread


def test_is_like_jacquards(data_dir):
    """Errors of the measured sensor beside those of real pairs of perfect and stereo depth."""
    real = []
    for path in sorted((data_dir / "jacquard").glob("*/0_*_perfect_depth.tiff")):
        stem = str(path).removesuffix("perfect_depth.tiff")
        exact, depth = read_depth(path), read_depth(type(path)(f"{stem}stereo_depth.tiff"))
        real.append(errors(depth, exact, read_mask(type(path)(f"{stem}mask.png"))))
    on, around, elsewhere, spread = np.median(real, axis=0)
    picture, depth = measure(Sensor(), size=1024)
    ours = errors(depth, picture.depth, picture.mask)
    assert ours[0] == pytest.approx(on, abs=0.03)
    assert ours[1] == pytest.approx(around, abs=0.03)
    assert ours[2] == pytest.approx(elsewhere, abs=0.002)
    assert ours[3] == pytest.approx(spread, rel=0.2)
