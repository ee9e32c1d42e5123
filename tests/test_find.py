"""find_grasps: what is drawn is found again, and the published decodings against slow ones."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry import Grasps, angle_difference, pairwise_iou
from graspmap.maps import GraspMaps, draw_maps, find_grasps

SHAPE = (96, 120)
QUALITIES = ["binary", "soft", "strong"]


def region_reach(angle, width, height):
    """Half extent (x, y) of a grasp's region."""
    u, v = width / 6, height / 2
    c, s = abs(np.cos(angle)), abs(np.sin(angle))
    return np.array([u * c + v * s, u * s + v * c])


@st.composite
def single_grasps(draw, shape=SHAPE):
    """One grasp whose region lies in the image: thin, tiny, huge, at bin edges, at the border."""
    edge = st.builds(
        lambda step, off: step * np.pi / 12 + off,
        st.integers(-6, 6),
        st.sampled_from([0.0, 1e-12, -1e-12, 1e-6, -1e-6, 0.003, -0.003, 0.02]),
    )
    angle = draw(st.one_of(st.floats(-np.pi / 2, np.pi / 2), edge))
    size = st.one_of(st.floats(0, 1), st.floats(0, 12), st.floats(0, 300), st.just(0.0))
    width, height = draw(size), draw(size)
    image = np.array([shape[1] - 1.0, shape[0] - 1.0])
    fit = min(1.0, float((image / 2 / np.maximum(region_reach(angle, width, height), 1e-9)).min()))
    width, height = width * fit, height * fit
    reach = region_reach(angle, width, height)
    place = st.one_of(st.floats(0, 1), st.sampled_from([0.0, 0.5, 1.0]))
    center = reach + np.array([draw(place), draw(place)]) * np.maximum(image - 2 * reach, 0)
    if draw(st.booleans()):
        center = np.clip(np.round(2 * center) / 2, reach, np.maximum(image - reach, reach))
    return Grasps([center], [angle], [width], [height])


def assert_found(grasp, found, center_px=0.5):
    """Centre within half a pixel along each axis, angle within 1 degree, width within 1 px."""
    assert len(found) == 1
    assert np.abs(found.center - grasp.center).max() <= center_px + 1e-6
    assert np.degrees(angle_difference(found.angle, grasp.angle)[0]) <= 1
    assert abs(found.width[0] - grasp.width[0]) <= 1


@given(
    grasp=single_grasps(),
    quality=st.sampled_from(QUALITIES),
    bins=st.sampled_from([1, 3, 6]),
    overlap=st.sampled_from(["best", "published"]),
    background=st.sampled_from(["zero", "published"]),
    width_scale=st.sampled_from([1.0, 37.3, 150.0]),
)
def test_finds_any_single_grasp(grasp, quality, bins, overlap, background, width_scale):
    maps = draw_maps(
        grasp,
        SHAPE,
        bins=bins,
        quality=quality,
        overlap=overlap,
        background=background,
        width_scale=width_scale,
    )
    assert_found(grasp, find_grasps(maps, width_scale=width_scale))
    # A drawn grasp is one grasp, however many are asked for.
    assert_found(grasp, find_grasps(maps, 5, width_scale=width_scale))


@given(grasp=single_grasps(), drop_off=st.sampled_from([0.25, 0.5, 1.0, 4.0]))
def test_finds_any_single_grasp_with_any_drop_off(grasp, drop_off):
    assert_found(grasp, find_grasps(draw_maps(grasp, SHAPE, quality="strong", drop_off=drop_off)))


@pytest.mark.parametrize("bins", [1, 3, 6])
@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("degrees", [-90, -89.99, -60, -30, 0, 30, 45.2, 60, 89.99, 90])
def test_finds_slender_grasps_at_awkward_angles(degrees, quality, bins):
    # A strip that is nearly along the rows, the columns or the diagonals has more pixels in its
    # rows at one end than at the other: the mean of its pixels is off by up to 20 px.
    for tilt in (0.0, 0.3, -0.6):
        angle = np.radians(degrees + tilt)
        slender = Grasps([[148.3, 151.6]], [angle], [3.7], [240.0])
        assert_found(
            slender, find_grasps(draw_maps(slender, (300, 300), bins=bins, quality=quality))
        )
        flat = Grasps([[148.3, 151.6]], [angle], [700.0], [1.2])
        assert_found(flat, find_grasps(draw_maps(flat, (300, 300), bins=bins, quality=quality)))


def test_strong_maps_give_the_centre_exactly():
    grasp = Grasps([[60.37, 40.81]], [0.6], [40.0], [18.0])
    found = find_grasps(draw_maps(grasp, SHAPE, quality="strong"))
    np.testing.assert_allclose(found.center, grasp.center, atol=1e-3)


@given(grasp=single_grasps(), dx=st.integers(0, 30), dy=st.integers(0, 30))
def test_moves_with_the_maps(grasp, dx, dy):
    maps = draw_maps(grasp, SHAPE, quality="soft")
    here = find_grasps(GraspMaps(*(np.pad(m, ((0, 0), (30, 30), (30, 30))) for m in maps)))
    there = find_grasps(
        GraspMaps(*(np.pad(m, ((0, 0), (30 + dy, 30 - dy), (30 + dx, 30 - dx))) for m in maps))
    )
    np.testing.assert_allclose(there.center, here.center + np.array([dx, dy]), atol=1e-4)
    np.testing.assert_allclose(there.width, here.width, atol=1e-4)


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("degrees", [-90.0, -30.0, 12.0, 89.0])
def test_noise_moves_the_grasp_little(quality, degrees):
    grasp = Grasps([[61.3, 47.8]], [np.radians(degrees)], [36.0], [24.0])
    clean = draw_maps(grasp, SHAPE, quality=quality, width_scale=50.0)
    rng = np.random.default_rng(1)
    noisy = GraspMaps(*(m + rng.normal(0, 0.05, m.shape) for m in clean))
    found = find_grasps(noisy, width_scale=50.0)
    assert np.abs(found.center - grasp.center).max() < 3
    assert np.degrees(angle_difference(found.angle, grasp.angle)[0]) < 3
    assert abs(found.width[0] - 36) < 3


def smooth_maps(peaks, shape=SHAPE, angle=0.4, width=20.0):
    """Maps as a network gives them: bumps of quality over constant angle and width."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    quality = sum(
        height * np.exp(-((x - px) ** 2 + (y - py) ** 2) / 2 / spread**2)
        for px, py, height, spread in peaks
    )
    return GraspMaps(
        quality[None],
        np.full((1, *shape), np.cos(2 * angle)),
        np.full((1, *shape), np.sin(2 * angle)),
        np.full((1, *shape), width),
    )


@pytest.mark.parametrize("spread", [3.0, 10.0, 40.0, 200.0])
def test_finds_the_top_of_a_smooth_bump(spread):
    found = find_grasps(smooth_maps([(70.4, 33.7, 0.8, spread)]))
    np.testing.assert_allclose(found.center, [[70.4, 33.7]], atol=0.5)
    assert np.isclose(found.angle[0], 0.4, atol=1e-6)
    assert np.isclose(found.width[0], 20, atol=1e-4)


def test_finds_the_top_of_a_cone_over_the_whole_image():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    maps = smooth_maps([(0, 0, 1, 1)])
    cone = 1 - np.hypot(x - 30, y - 60) / 200
    found = find_grasps(GraspMaps(cone[None], maps.cos, maps.sin, maps.width))
    np.testing.assert_allclose(found.center, [[30, 60]], atol=1)


def test_centre_of_a_ring_lies_on_the_ring():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ring = (np.abs(np.hypot(x - 60, y - 48) - 30) < 4).astype(float)[None]
    maps = smooth_maps([(0, 0, 1, 1)])
    found = find_grasps(GraspMaps(ring, maps.cos, maps.sin, maps.width))
    column, row = np.round(found.center[0]).astype(int)
    assert ring[0, row, column] == 1


def test_pixels_without_a_grasp_do_not_bias_angle_and_width():
    # A region of two columns: most pixels in reach of the smoothing show no grasp.
    grasp = Grasps([[40.0, 40.0]], [np.radians(89.5)], [6.0], [8.0])
    for background in ("zero", "published"):
        found = find_grasps(draw_maps(grasp, SHAPE, background=background))
        assert np.degrees(angle_difference(found.angle, grasp.angle)[0]) < 0.01
        assert np.isclose(found.width[0], 6.0, atol=1e-3)


# Several grasps ------------------------------------------------------------------------------


@pytest.mark.parametrize("bins", [1, 3])
@pytest.mark.parametrize("quality", QUALITIES)
def test_finds_all_grasps_that_lie_apart(bins, quality):
    grid = np.stack(np.meshgrid([30.0, 110.4, 190.0, 270.7], [40.3, 130.0, 220.0]), -1)
    rng = np.random.default_rng(2)
    labels = Grasps(
        grid.reshape(-1, 2), rng.uniform(-1.5, 1.5, 12), rng.uniform(15, 60, 12), np.full(12, 18.0)
    )
    found = find_grasps(draw_maps(labels, (260, 300), bins=bins, quality=quality), 50)
    assert len(found) == 12
    distance = np.abs(found.center[:, None] - labels.center[None]).max(axis=-1)
    match = distance.argmin(axis=1)
    assert sorted(match) == list(range(12))
    assert distance.min(axis=1).max() <= 0.5
    assert np.degrees(angle_difference(found.angle, labels.angle[match])).max() < 1
    assert np.abs(found.width - labels.width[match]).max() < 1


@given(
    seed=st.integers(0, 99),
    top=st.integers(1, 8),
    distance=st.floats(0, 40),
    threshold=st.floats(0, 0.6),
    method=st.sampled_from(["refined", "ggcnn", "orange"]),
)
def test_keeps_order_distance_threshold_and_mask(seed, top, distance, threshold, method):
    rng = np.random.default_rng(seed)
    maps = GraspMaps(*(ndimage.gaussian_filter(rng.random((2, 60, 70)), (0, 2, 2)) for _ in "qcsw"))
    mask = np.zeros((60, 70), bool)
    mask[10:50, 20:60] = True
    found = find_grasps(
        maps, top, method=method, min_distance=distance, threshold=threshold, mask=mask
    )
    assert len(found) <= top
    assert (np.diff(found.quality) <= 0).all()
    assert (found.quality > threshold).all()
    columns, rows = np.round(found.center).astype(int).T
    assert mask[rows, columns].all()
    apart = np.linalg.norm(found.center[:, None] - found.center[None], axis=-1)
    least = int(distance) if method == "ggcnn" else distance
    assert (apart[~np.eye(len(found), dtype=bool)] >= least - 1e-9).all()
    # The best one does not depend on how many are asked for.
    if len(found):
        only = find_grasps(
            maps, method=method, min_distance=distance, threshold=threshold, mask=mask
        )
        np.testing.assert_array_equal(only.center, found.center[:1])


def test_the_best_of_all_bins_comes_first():
    parts = [Grasps([[x, 50.0]], [a], [24.0], [12.0]) for x, a in ((30.0, -1.2), (80.0, 0.9))]
    weak, strong = (draw_maps(part, SHAPE, bins=3, quality="strong") for part in parts)
    maps = GraspMaps(
        np.maximum(0.6 * weak.quality, strong.quality),
        *(a + b for a, b in list(zip(weak, strong, strict=True))[1:]),
    )
    for method in ("refined", "ggcnn", "orange"):
        found = find_grasps(maps, 2, method=method)
        np.testing.assert_allclose(found.center[:, 0], [80, 30], atol=0.5)
        np.testing.assert_allclose(found.angle, [0.9, -1.2], atol=0.02)


# The published ways --------------------------------------------------------------------------


def slow_local_peaks(maps, top, smoothing=(2, 2, 1), distance=20, threshold=0.2):
    """GG-CNN's decoding by SciPy and a loop over all pixels; one bin."""
    sigmas = (smoothing[0], smoothing[1], smoothing[1], smoothing[2])
    q, c, s, w = (
        ndimage.gaussian_filter(m[0].astype(np.float64), sigma, mode="nearest")
        for m, sigma in zip(maps, sigmas, strict=True)
    )
    rows, columns = q.shape
    peaks = []
    for y in range(distance, rows - distance):
        for x in range(distance, columns - distance):
            square = q[y - distance : y + distance + 1, x - distance : x + distance + 1]
            if q[y, x] > threshold and q[y, x] == square.max():
                angle = 0.5 * np.arctan2(s[y, x], c[y, x])
                peaks.append((q[y, x], x, y, angle, max(w[y, x], 0)))
    return sorted(peaks, reverse=True)[:top]


@given(seed=st.integers(0, 10**6), top=st.integers(1, 4))
def test_ggcnn_equals_a_slow_form(seed, top):
    rng = np.random.default_rng(seed)
    maps = GraspMaps(
        *(ndimage.zoom(rng.random((1, 9, 11)) ** 2, (1, 10, 10), order=1) for _ in "q"),
        *(rng.uniform(-1, 1, (1, 90, 110)) for _ in "csw"),
    )
    expected = slow_local_peaks(maps, top)
    found = find_grasps(maps, top, method="ggcnn")
    assert len(found) == len(expected)
    for i, (quality, x, y, angle, width) in enumerate(expected):
        assert tuple(found.center[i]) == (x, y)
        assert np.isclose(found.quality[i], quality, atol=1e-5)
        assert angle_difference(found.angle[i], angle) < 1e-4
        assert np.isclose(found.width[i], width, atol=1e-5)


@given(seed=st.integers(0, 10**6), bins=st.integers(1, 4))
def test_orange_is_the_raw_argmax(seed, bins):
    rng = np.random.default_rng(seed)
    q, c, s, w = rng.uniform(-1, 1, (4, bins, 30, 40)).astype(np.float32)
    found = find_grasps(GraspMaps(q, c, s, w), method="orange", width_scale=150.0)
    b, y, x = np.unravel_index(q.argmax(), q.shape)
    assert found.center[0].tolist() == [x, y]
    assert angle_difference(found.angle[0], np.arctan2(s[b, y, x], c[b, y, x]) / 2) < 1e-6
    assert np.isclose(found.width[0], max(w[b, y, x], 0) * 150)
    assert found.quality[0] == q[b, y, x]


def test_labels_of_real_scenes_are_found_in_their_maps(data_dir):
    from graspmap.data import read_scenes, smallest_jaws

    for scene in read_scenes(f"jacquard:{data_dir / 'jacquard'}"):
        for bins, quality in ((1, "binary"), (3, "strong")):
            maps = draw_maps(smallest_jaws(scene.grasps), (1024, 1024), bins=bins, quality=quality)
            found = find_grasps(maps)
            near = angle_difference(found.angle, scene.grasps.angle) < np.radians(30)
            assert (pairwise_iou(found, scene.grasps)[0] * near).max() > 0.25, scene.id


# Input ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["refined", "ggcnn", "orange"])
def test_empty_maps_hold_no_grasp(method):
    maps = draw_maps(Grasps.empty(), SHAPE, bins=2, background="published")
    assert len(find_grasps(maps, 3, method=method)) == 0
    negative = GraspMaps(maps.quality - 1, maps.cos, maps.sin, maps.width)
    assert len(find_grasps(negative, 3, method=method)) == 0
    one = draw_maps(Grasps([[50, 50]], [0.0], [30], [20]), SHAPE)
    assert len(find_grasps(one, method=method, threshold=1.5)) == 0
    assert len(find_grasps(one, method=method, mask=np.zeros(SHAPE, bool))) == 0


def test_height_is_half_the_opening_or_as_given():
    maps = draw_maps(Grasps([[50, 50]], [0.2], [30], [20]), SHAPE, width_scale=10.0)
    assert find_grasps(maps, width_scale=10.0).height[0] == pytest.approx(15, abs=1e-4)
    assert find_grasps(maps, width_scale=10.0, height=7.0).height[0] == 7


def test_mask_keeps_the_centre_inside():
    labels = Grasps([[30, 40], [85, 60]], [0.2, -0.4], [40, 30], [20, 20])
    maps = draw_maps(labels, SHAPE)
    mask = np.zeros(SHAPE, bool)
    mask[:, 60:] = True
    found = find_grasps(maps, 5, mask=mask)
    assert len(found) == 1
    assert np.abs(found.center - labels.center[1]).max() <= 0.5


def test_takes_torch_tensors_and_other_types():
    torch = pytest.importorskip("torch")
    grasp = Grasps([[50.3, 40.2]], [0.5], [30], [20])
    maps = draw_maps(grasp, SHAPE, quality="strong")
    tensors = GraspMaps(*(torch.from_numpy(m).requires_grad_() for m in maps))
    assert_found(grasp, find_grasps(tensors))
    half = GraspMaps(*(torch.from_numpy(m).bfloat16() for m in maps))
    assert len(find_grasps(half)) == 1
    assert_found(grasp, find_grasps(GraspMaps(*(m.astype(np.float64) for m in maps))))


@pytest.mark.parametrize("method", ["refined", "ggcnn", "orange"])
@pytest.mark.parametrize("which", [0, 1, 3])
def test_nan_is_an_error(method, which):
    arrays = [m.copy() for m in draw_maps(Grasps([[50, 50]], [0.2], [30], [20]), SHAPE)]
    arrays[which][:] = np.nan
    with pytest.raises(InvalidInputError, match="NaN"):
        find_grasps(GraspMaps(*arrays), method=method)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"top": 0}, "top"),
        ({"width_scale": 0.0}, "width_scale"),
        ({"height": -1.0}, "height"),
        ({"smoothing": (1.0, 2.0)}, "smoothing"),
        ({"smoothing": (1.0, -2.0, 1.0)}, "smoothing"),
        ({"min_distance": -1.0}, "min_distance"),
        ({"threshold": float("nan")}, "threshold"),
        ({"mask": np.ones((3, 3), bool)}, "mask"),
        ({"mask": np.ones(SHAPE)}, "mask"),
    ],
)
def test_refuses_bad_settings(settings, word):
    maps = draw_maps(Grasps.empty(), SHAPE)
    with pytest.raises(InvalidInputError, match=word):
        find_grasps(maps, **settings)


def test_refuses_batches_and_unknown_methods():
    maps = draw_maps(Grasps.empty(), SHAPE)
    with pytest.raises(InvalidInputError, match="batch"):
        find_grasps(GraspMaps(*(m[None] for m in maps)))
    with pytest.raises(UnknownNameError, match="did you mean 'refined'"):
        find_grasps(maps, method="refine")
