"""draw_maps against a brute-force raster, and the laws of the drawn maps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry import Grasps
from graspmap.geometry.affine import rotation, translation
from graspmap.maps import bin_of, draw_maps

SHAPE = (40, 56)
LOW = {"binary": 1.0, "soft": 0.9, "strong": 0.0}


def sizes(least, most):
    return st.one_of(st.floats(least, most), st.sampled_from([0.0, 1e-9, 3.0, 6.0, 12.0]))


@st.composite
def grasps(draw, most=6, shape=SHAPE):
    """Grasps in, across and beside an image: any angle, some on grid points, some without size."""
    rows, columns = shape
    count = draw(st.integers(1, most))
    angle = st.one_of(
        st.floats(-np.pi / 2, np.pi / 2), st.sampled_from(np.arange(-6, 6) * np.pi / 12)
    )
    x = st.one_of(st.floats(-10, columns + 10), st.integers(0, 2 * columns).map(lambda i: i / 2))
    y = st.one_of(st.floats(-10, rows + 10), st.integers(0, 2 * rows).map(lambda i: i / 2))
    own = st.sampled_from([0.0, 0.2, 0.6, 1.0])
    row = st.tuples(x, y, angle, sizes(0, 90), sizes(0, 40), own)
    table = np.array(draw(st.lists(row, min_size=count, max_size=count)))
    return Grasps(table[:, :2], table[:, 2], table[:, 3], table[:, 4], table[:, 5])


def brute_force(labels, shape, bins, quality, drop_off, overlap, gaussian, peaks="one"):
    """Maps by testing every pixel against the four edges of every region, in float64.

    Returns the (4, bins, H, W) maps and a mask of the pixels that rounding may decide: those on
    a border, and those where two grasps are equally near.
    """
    maps = np.zeros((4, bins, *shape))
    nearest = np.full((bins, *shape), np.inf)
    least_angle = np.full((bins, *shape), np.inf)
    doubtful = np.zeros((bins, *shape), bool)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    third = labels.replace(
        width=np.maximum(labels.width / 3, 1.5), height=np.maximum(labels.height, 1.5)
    )
    for i in np.argsort(labels.width, kind="stable"):
        corners, b = third.corners()[i], int(bin_of(labels.angle, bins)[i])
        inside = np.full(shape, True)
        for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge = (q - p) / np.hypot(*(q - p))
            depth = edge[0] * (y - p[1]) - edge[1] * (x - p[0])
            inside &= depth >= 0
            doubtful[b] |= np.abs(depth) < 1e-5
        if not inside.any():
            continue
        if gaussian == "published":
            half_x, half_y = np.ptp(x[inside]) / 2, np.ptp(y[inside]) / 2
            u = (x - x[inside].min() - half_x) / max(half_x, 1e-300) * (half_x > 0)
            v = (y - y[inside].min() - half_y) / max(half_y, 1e-300) * (half_y > 0)
        else:
            to_p1, to_p3 = corners[1] - corners[0], corners[3] - corners[0]
            dx, dy = x - corners[0, 0], y - corners[0, 1]
            u = 2 * (dx * to_p1[0] + dy * to_p1[1]) / (to_p1 @ to_p1) - 1
            v = 2 * (dx * to_p3[0] + dy * to_p3[1]) / (to_p3 @ to_p3) - 1
        d = np.where(inside, u**2 + v**2, np.inf)
        g = np.where(inside, np.maximum(np.exp(-d / drop_off), LOW[quality]), 0)
        g *= labels.quality[i] if peaks == "quality" else 1
        values = (np.cos(2 * labels.angle[i]), np.sin(2 * labels.angle[i]), labels.width[i])
        if overlap == "published":
            maps[0, b] = np.maximum(maps[0, b], g)
            maps[3, b] = np.where(inside, np.maximum(maps[3, b], values[2]), maps[3, b])
            lower = inside & (labels.angle[i] < least_angle[b])
            least_angle[b][lower] = labels.angle[i]
            maps[1:3, b, lower] = np.array(values[:2])[:, None]
        else:
            with np.errstate(invalid="ignore"):
                doubtful[b] |= inside & (np.abs(d - nearest[b]) < 1e-5)
            won = d < nearest[b]
            nearest[b][won] = d[won]
            maps[0, b, won] = g[won]
            maps[1:, b, won] = np.array(values)[:, None]
    return maps, doubtful


@given(
    labels=grasps(),
    bins=st.sampled_from([1, 2, 3, 6, 7]),
    quality=st.sampled_from(["binary", "soft", "strong"]),
    drop_off=st.sampled_from([0.25, 1.0, 2.0]),
    overlap=st.sampled_from(["best", "published"]),
    peaks=st.sampled_from(["one", "quality"]),
    width_scale=st.sampled_from([1.0, 150.0]),
)
def test_equals_brute_force(labels, bins, quality, drop_off, overlap, peaks, width_scale):
    drawn = draw_maps(
        labels,
        SHAPE,
        bins=bins,
        quality=quality,
        drop_off=drop_off,
        overlap=overlap,
        peaks=peaks,
        width_scale=width_scale,
    )
    expected, doubtful = brute_force(
        labels, SHAPE, bins, quality, drop_off, overlap, "grasp", peaks
    )
    expected[3] /= width_scale
    for got, want in zip(drawn, expected, strict=True):
        assert got.dtype == np.float32
        np.testing.assert_allclose(got[~doubtful], want[~doubtful], rtol=1e-6, atol=2e-6)


def test_equals_brute_force_for_many_grasps():
    rng = np.random.default_rng(0)
    labels = Grasps(
        rng.uniform(0, 120, (100, 2)),
        rng.uniform(-np.pi / 2, np.pi / 2, 100),
        rng.uniform(0, 60, 100),
        rng.uniform(0, 30, 100),
    )
    for bins in (1, 3):
        drawn = draw_maps(labels, (120, 130), bins=bins, quality="strong")
        expected, doubtful = brute_force(labels, (120, 130), bins, "strong", 2.0, "best", "grasp")
        assert doubtful.mean() < 0.01
        for got, want in zip(drawn, expected, strict=True):
            np.testing.assert_allclose(got[~doubtful], want[~doubtful], rtol=1e-6, atol=2e-6)


@given(
    labels=grasps(most=1),
    quality=st.sampled_from(["soft", "strong"]),
    drop_off=st.sampled_from([0.5, 2.0]),
)
def test_published_gaussian_equals_brute_force(labels, quality, drop_off):
    drawn = draw_maps(labels, SHAPE, quality=quality, drop_off=drop_off, gaussian="published")
    expected, doubtful = brute_force(labels, SHAPE, 1, quality, drop_off, "best", "published")
    if not doubtful.any():  # a border pixel more or less would move the box
        np.testing.assert_allclose(drawn.quality, expected[0], rtol=1e-6, atol=2e-6)


def test_published_gaussian_misses_the_peak_of_even_sizes():
    even = Grasps([[20.5, 15.5]], [0.0], [24.0], [6.0])
    published = draw_maps(even, SHAPE, quality="strong", gaussian="published").quality
    ours = draw_maps(even, SHAPE, quality="strong").quality
    assert np.count_nonzero(published == published.max()) == 4
    assert published.max() == pytest.approx(np.exp(-((1 / 7) ** 2 + (1 / 5) ** 2) / 2))
    assert ours.max() == pytest.approx(np.exp(-((0.5 / 4) ** 2 + (0.5 / 3) ** 2) / 2))


@given(labels=grasps(), bins=st.sampled_from([1, 3]), data=st.data())
def test_order_of_the_grasps_does_not_matter(labels, bins, data):
    order = data.draw(st.permutations(range(len(labels))))
    drawn = draw_maps(labels, SHAPE, bins=bins, quality="strong")
    again = draw_maps(labels[list(order)], SHAPE, bins=bins, quality="strong")
    np.testing.assert_array_equal(drawn.quality, again.quality)
    np.testing.assert_array_equal(drawn.width, again.width)  # ties go to the smaller width


@given(labels=grasps(), quality=st.sampled_from(["binary", "soft", "strong"]))
def test_bins_divide_the_quality(labels, quality):
    one = draw_maps(labels, SHAPE, quality=quality)
    six = draw_maps(labels, SHAPE, bins=6, quality=quality)
    np.testing.assert_array_equal(six.quality.max(axis=0), one.quality[0])
    angle = 0.5 * np.arctan2(six.sin, six.cos).astype(np.float64)
    for b in range(6):
        # How far the angles lie above the lower edge of their bin, modulo 180 degrees.
        above = (np.degrees(angle[b][six.quality[b] > 0]) - (-90 + 30 * b) + 1e-3) % 180
        assert (above <= 30 + 2e-3).all()


@given(labels=grasps(most=1), dx=st.integers(-9, 9), dy=st.integers(-9, 9))
def test_moves_with_the_grasp(labels, dx, dy):
    labels = labels.replace(center=np.round(labels.center * 8) / 8)  # exact under the shift
    moved = draw_maps(labels.transformed(translation(dx, dy)), SHAPE, quality="strong")
    wide = draw_maps(labels.transformed(translation(20, 20)), (80, 96), quality="strong")
    window = slice(20 - dy, 60 - dy), slice(20 - dx, 76 - dx)
    for got, want in zip(moved, wide, strict=True):
        np.testing.assert_allclose(got[0], want[0][window], atol=1e-6)


@given(labels=grasps(most=1, shape=(41, 41)))
def test_a_quarter_turn_of_the_grasp_turns_the_maps(labels):
    turned = labels.transformed(rotation(np.pi / 2, about=(20.0, 20.0)))
    drawn = draw_maps(labels, (41, 41), quality="strong")
    again = draw_maps(turned, (41, 41), quality="strong")
    expected = np.rot90(drawn.quality[0])
    # Two border pixels may be decided by the rounding of the turned corners.
    differ = np.abs(again.quality[0] - expected) > 1e-5
    assert differ.sum() <= 0.02 * max((expected > 0).sum(), 100)
    both = (again.quality[0] > 0) & (expected > 0)
    np.testing.assert_allclose(again.cos[0][both], -np.rot90(drawn.cos[0])[both], atol=1e-6)


@given(labels=grasps())
def test_quality_is_ordered_and_angles_are_units(labels):
    binary, soft, strong = (
        draw_maps(labels, SHAPE, quality=q) for q in ("binary", "soft", "strong")
    )
    assert set(np.unique(binary.quality)) <= {0.0, 1.0}
    assert (strong.quality <= soft.quality).all()
    assert (soft.quality <= binary.quality).all()
    inside = binary.quality > 0
    assert (soft.quality[inside] >= np.float32(0.9)).all()
    length = np.hypot(binary.cos, binary.sin)
    np.testing.assert_allclose(length[inside], 1, atol=1e-6)
    for m in binary:
        assert (m[~inside] == 0).all()


@given(labels=grasps(most=1), bins=st.sampled_from([1, 4]))
def test_no_label_with_its_centre_in_the_image_vanishes(labels, bins):
    column, row = np.floor(labels.center[0] + 0.5).astype(int)
    drawn = draw_maps(labels, SHAPE, bins=bins)
    if 0 <= row < SHAPE[0] and 0 <= column < SHAPE[1]:
        assert drawn.quality[:, row, column].max() == 1


def test_equally_near_grasps_show_the_narrower_one():
    # Of two grasps with one centre both are at distance 0 there.
    labels = Grasps([[20, 20], [20, 20]], [0.3, 0.1], [30, 18], [10, 10])
    drawn = draw_maps(labels, SHAPE, quality="strong", width_scale=10.0)
    assert drawn.width[0, 20, 20] == pytest.approx(1.8)
    assert drawn.sin[0, 20, 20] == pytest.approx(np.sin(0.2))
    published = draw_maps(labels, SHAPE, overlap="published", width_scale=10.0)
    assert published.width[0, 20, 20] == 3.0
    assert published.sin[0, 20, 20] == pytest.approx(np.sin(0.2))


def test_published_background():
    drawn = draw_maps(Grasps.empty(), SHAPE, bins=2, background="published")
    assert [float(m.min()) for m in drawn] == [0, 1, 0, 0]
    assert [float(m.max()) for m in drawn] == [0, 1, 0, 0]
    one = draw_maps(Grasps([[20, 20]], [np.pi / 4], [9], [5]), SHAPE, background="published")
    assert one.cos[0, 20, 20] == pytest.approx(0, abs=1e-7)
    assert one.cos[0, 0, 0] == 1


@pytest.mark.parametrize(
    ("center", "width", "height"),
    [((-500.0, 9.0), 30.0, 20.0), ((1e9, -1e9), 1.0, 1.0), ((20.0, 1e4), 90.0, 90.0)],
)
def test_far_outside_draws_nothing(center, width, height):
    drawn = draw_maps(Grasps([center], [0.2], [width], [height]), SHAPE)
    assert not any(m.any() for m in drawn)


def test_refuses_to_draw_a_quality_that_is_none():
    labels = Grasps([[5, 5], [9, 9]], [0, 0], [6, 6], [3, 3], [1.0, 1.5])
    assert draw_maps(labels, SHAPE).quality.max() == 1
    with pytest.raises(InvalidInputError, match=r"quality to draw is 1\.5; allowed: from 0 to 1"):
        draw_maps(labels, SHAPE, peaks="quality")


def test_larger_than_the_image_covers_it():
    drawn = draw_maps(Grasps([[1e3, -1e3]], [0.7], [1e6], [1e6]), SHAPE)
    assert (drawn.quality == 1).all()


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"bins": 0}, "bins"),
        ({"bins": 1.5}, "bins"),
        ({"drop_off": 0.0}, "drop_off"),
        ({"drop_off": np.nan}, "drop_off"),
        ({"width_scale": -1.0}, "width_scale"),
        ({"shape": (0, 5)}, "shape"),
        ({"shape": (5,)}, "shape"),
    ],
)
def test_refuses_bad_numbers(settings, word):
    shape = settings.pop("shape", SHAPE)
    with pytest.raises(InvalidInputError, match=word):
        draw_maps(Grasps.empty(), shape, **settings)


@pytest.mark.parametrize("name", ["quality", "overlap", "gaussian", "background", "peaks"])
def test_refuses_unknown_choices(name):
    with pytest.raises(UnknownNameError) as caught:
        draw_maps(Grasps.empty(), SHAPE, **{name: "publishd"})
    assert caught.value.name == name
    assert len(caught.value.choices) >= 2
