"""The rectangle metric: closed forms, shapely, brute-force pixel counting, and laws."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry.affine import flip, rotation, translation, zoom
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.overlap import pairwise_iou
from graspmap.metrics import (
    MAX_ANGLE,
    PROTOCOLS,
    THRESHOLDS,
    best_overlap,
    find_protocol,
    score_rectangles,
    wilson_interval,
)
from graspmap.metrics.pixel_overlap import pixel_iou
from graspmap.metrics.rectangle import count_right

DEGREE = np.pi / 180


def one(x=0.0, y=0.0, angle=0.0, width=40.0, height=20.0) -> Grasps:
    return Grasps([[x, y]], [angle], [width], [height])


def some(rng: np.random.Generator, count: int, spread: float = 60.0) -> Grasps:
    return Grasps(
        rng.uniform(0, spread, (count, 2)),
        rng.uniform(-np.pi / 2, np.pi / 2, count),
        rng.uniform(5, 60, count),
        rng.uniform(3, 40, count),
    )


def score(overlaps, **options):
    return score_rectangles(overlaps, rng=np.random.default_rng(0), **options)


seeds = st.integers(0, 2**32)


# --- best_overlap -----------------------------------------------------------------------------


@given(shift=st.floats(-60, 60))
def test_a_shift_along_the_opening_has_a_closed_form(shift):
    expected = max(0.0, 40 - abs(shift)) / (40 + min(40.0, abs(shift)))
    assert best_overlap(one(x=shift), one())[0] == pytest.approx(expected, abs=1e-12)


@given(factor=st.floats(1, 10))
def test_a_wider_grasp_has_a_closed_form(factor):
    assert best_overlap(one(width=40 * factor), one())[0] == pytest.approx(1 / factor, abs=1e-12)


@given(angle=st.floats(-30, 30))
def test_a_turned_square_has_a_closed_form(angle):
    """A unit square turned by a about its centre shares 2 / (1 + |cos a| + |sin a|) of itself."""
    a = angle * DEGREE
    shared = 2 / (1 + abs(np.cos(a)) + abs(np.sin(a)))
    got = best_overlap(one(angle=a, width=30, height=30), one(width=30, height=30))
    assert got[0] == pytest.approx(shared / (2 - shared), abs=1e-12)


@pytest.mark.parametrize("base", np.arange(-90, 90, 7.5))
@pytest.mark.parametrize("sign", [-1, 1])
def test_thirty_degrees_count_and_more_do_not(base, sign):
    label = one(angle=base * DEGREE)
    assert best_overlap(one(angle=(base + sign * 30) * DEGREE), label)[0] > 0.25
    assert best_overlap(one(angle=(base + sign * 30.0001) * DEGREE), label)[0] == 0
    assert best_overlap(one(angle=(base + 180) * DEGREE), label)[0] == pytest.approx(1)


def test_a_label_with_the_wrong_angle_does_not_hide_the_right_one():
    labels = Grasps.concatenate([one(angle=40 * DEGREE), one(x=10), one(x=500)])
    assert best_overlap(one(), labels)[0] == pytest.approx(30 / 50)


def test_nothing_predicted_nothing_labelled():
    assert best_overlap(Grasps.empty(), one()).shape == (0,)
    assert best_overlap(some(np.random.default_rng(0), 3), Grasps.empty()).tolist() == [0, 0, 0]
    assert best_overlap(one(width=0), one(width=0)).tolist() == [0]


@given(seed=seeds, max_angle=st.floats(0, np.pi / 2))
def test_best_overlap_against_shapely(seed, max_angle):
    rng = np.random.default_rng(seed)
    predicted, labels = some(rng, 3), some(rng, 8)
    expected = np.zeros(3)
    for i, p in enumerate(shapely.polygons(predicted.corners())):
        for j, q in enumerate(shapely.polygons(labels.corners())):
            # cos of the doubled angle: an angle test that shares nothing with the code's.
            turn = np.arccos(np.clip(np.cos(2 * (predicted.angle[i] - labels.angle[j])), -1, 1)) / 2
            if turn <= max_angle:
                iou = shapely.intersection(p, q).area / shapely.union(p, q).area
                expected[i] = max(expected[i], iou)
    np.testing.assert_allclose(
        best_overlap(predicted, labels, max_angle=max_angle), expected, atol=1e-9
    )


@given(seed=seeds)
def test_every_angle_allowed_is_plain_overlap(seed):
    rng = np.random.default_rng(seed)
    predicted, labels = some(rng, 4), some(rng, 9)
    got = best_overlap(predicted, labels, max_angle=np.pi / 2)
    np.testing.assert_array_equal(got, pairwise_iou(predicted, labels).max(axis=1))


@given(seed=seeds)
def test_laws_of_best_overlap(seed):
    rng = np.random.default_rng(seed)
    predicted, labels = some(rng, 5), some(rng, 12)
    got = best_overlap(predicted, labels)
    assert ((got >= 0) & (got <= 1)).all()
    np.testing.assert_allclose(best_overlap(labels, labels), 1, atol=1e-12)
    # More labels never hurt, the order of labels is nothing, a stricter angle never helps.
    assert (best_overlap(predicted, labels[:6]) <= got).all()
    np.testing.assert_array_equal(best_overlap(predicted, labels[rng.permutation(12)]), got)
    assert (best_overlap(predicted, labels, max_angle=MAX_ANGLE / 2) <= got).all()
    # A similarity of the image changes no overlap (angles at exactly 30 degrees aside).
    matrix = rotation(rng.uniform(-3, 3)) @ zoom(rng.uniform(0.5, 2)) @ flip(320)
    moved = best_overlap(predicted.transformed(matrix), labels.transformed(matrix))
    np.testing.assert_allclose(moved, got, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"max_angle": 30}, "max_angle"),
        ({"max_angle": -0.1}, "max_angle"),
        ({"max_angle": np.nan}, "max_angle"),
        ({"overlap": "grid"}, "overlap"),
    ],
)
def test_best_overlap_refuses(options, name):
    with pytest.raises(InvalidInputError) as caught:
        best_overlap(one(), one(), **options)
    assert caught.value.name == name


# --- pixel counting ---------------------------------------------------------------------------


def covered(grasps: Grasps, index: int, side: int) -> np.ndarray:
    """(side, side) pixels in a rectangle: shapely decides, pixel by pixel."""
    x, y = np.meshgrid(np.arange(side), np.arange(side))
    polygon = shapely.polygons(grasps.corners()[index])
    return shapely.intersects_xy(polygon, x.astype(float), y.astype(float))


@given(seed=seeds)
def test_pixel_overlap_against_shapely(seed):
    rng = np.random.default_rng(seed)
    a, b = (some(rng, 2).transformed(translation(50, 50)) for _ in range(2))
    got = pixel_iou(a, b)
    for i in range(2):
        for j in range(2):
            p, q = covered(a, i, 160), covered(b, j, 160)
            assert got[i, j] == (p & q).sum() / (p | q).sum()


def test_pixel_overlap_nears_the_exact_one_for_large_rectangles():
    rng = np.random.default_rng(3)
    a, b = (some(rng, 6).transformed(zoom(20)) for _ in range(2))
    np.testing.assert_allclose(pixel_iou(a, b), pairwise_iou(a, b), atol=0.01)


def test_pixel_overlap_against_the_field_s_own_raster():
    draw = pytest.importorskip("skimage.draw")
    rng = np.random.default_rng(4)
    a, b = (some(rng, 10).transformed(translation(50, 50)) for _ in range(2))
    masks = []
    for grasps in (a, b):
        for corners in grasps.corners():
            mask = np.zeros((160, 160), bool)
            mask[draw.polygon(corners[:, 1], corners[:, 0], mask.shape)] = True
            masks.append(mask)
    expected = [[(p & q).sum() / (p | q).sum() for q in masks[10:]] for p in masks[:10]]
    np.testing.assert_allclose(pixel_iou(a, b), expected, atol=1e-12)


def test_pixel_overlap_of_next_to_nothing():
    # Between four pixel centres: no pixel at all, so no overlap even with itself.
    tiny = one(x=0.5, y=0.5, width=0.2, height=0.2)
    assert pixel_iou(tiny, tiny)[0, 0] == 0
    # On a pixel centre: one pixel, whatever the size.
    assert pixel_iou(one(width=0.2, height=0.2), one(width=0, height=0))[0, 0] == 1
    assert pixel_iou(one(), one(x=1e6))[0, 0] == 0
    assert pixel_iou(Grasps.empty(), one()).shape == (0, 1)


def test_pixel_overlap_refuses_to_count_for_ever():
    with pytest.raises(InvalidInputError, match="counting pixels"):
        pixel_iou(one(width=1e9, height=1e9), one())


# --- score ------------------------------------------------------------------------------------


def test_score_of_known_overlaps():
    got = score([0.2, 0.25, 0.26, 0.30, 0.31, 0.5, 0.51, 0.75, 0.76, 1.0])
    assert got.scenes == 10
    assert got.success == {0.25: 0.8, 0.30: 0.6, 0.50: 0.4, 0.75: 0.2}
    assert got.miou == pytest.approx(0.484)
    for threshold in THRESHOLDS:
        low, high = got.interval[threshold]
        assert low < got.success[threshold] < high
    assert got.miou_interval[0] < got.miou < got.miou_interval[1]


@given(values=st.lists(st.floats(0, 1), min_size=1, max_size=30))
def test_area_under_the_curve_is_the_sampled_integral(values):
    """Against a fine midpoint rule, whose error is at most half a step (success only falls)."""
    steps = 2000
    middles = (np.arange(steps) + 0.5) / steps
    for rule in ("greater", "percent"):
        curve = count_right(np.array(values), middles, rule=rule).mean(axis=0)
        assert (np.diff(curve) <= 0).all()
        got = score(values, resamples=2, rule=rule)
        assert got.auc == pytest.approx(curve.mean(), abs=1 / steps)
        if rule == "greater":
            assert got.auc == got.miou


@given(values=st.lists(st.floats(0, 1), min_size=2, max_size=30), seed=seeds)
def test_success_falls_with_the_threshold_and_ignores_order(values, seed):
    got = score(values, resamples=20)
    assert list(got.success.values()) == sorted(got.success.values(), reverse=True)
    shuffled = np.random.default_rng(seed).permutation(values)
    assert score(shuffled, resamples=20).success == got.success
    for low, high in (*got.interval.values(), got.miou_interval):
        assert 0 <= low <= high <= 1


def test_percent_rule_cuts_down_and_includes():
    overlaps = np.array([0.2499999, 0.25, 0.2599, 0.2999, 0.3, 0.57, 0.58])
    thresholds = (0.25, 0.26, 0.3, 0.57, 0.58)
    # floor(100 * 0.57) is 56 and floor(100 * 0.58) is 57 in floating point: the published quirk.
    expected = [[0] * 5, [1] + [0] * 4, [1] + [0] * 4, [1, 1] + [0] * 3]
    expected += [[1, 1, 1, 0, 0], [1, 1, 1, 0, 0], [1, 1, 1, 1, 0]]
    np.testing.assert_array_equal(count_right(overlaps, thresholds, rule="percent"), expected)
    assert (count_right(overlaps, thresholds, rule="greater") <= 1).all()


def test_perfect_and_hopeless_scores_keep_honest_intervals():
    perfect, hopeless = score(np.ones(24)), score(np.zeros(24))
    assert perfect.success[0.75] == perfect.miou == perfect.auc == 1
    assert perfect.interval[0.75] == perfect.miou_interval == wilson_interval(24, 24)
    assert hopeless.success[0.25] == hopeless.miou == 0
    assert hopeless.interval[0.25] == wilson_interval(0, 24)


def test_groups_widen_and_few_groups_widen_more():
    rng = np.random.default_rng(5)
    values = np.repeat(rng.random(12), 10)
    alone = score(values).miou_interval
    grouped = score(values, groups=np.repeat(np.arange(12), 10)).miou_interval
    assert grouped[1] - grouped[0] > 2 * (alone[1] - alone[0])


def test_score_of_one_scene():
    got = score([0.6])
    assert got.interval[0.25] == wilson_interval(1, 1)
    assert got.interval[0.75] == wilson_interval(0, 1)
    assert got.miou == 0.6
    assert got.miou_interval == pytest.approx(wilson_interval(0.6, 1))


@pytest.mark.parametrize(
    ("overlaps", "options", "name"),
    [
        ([], {}, "shape of the values"),
        ([0.2, 1.2], {}, "overlap"),
        ([0.2, -0.1], {}, "overlap"),
        ([0.2, np.nan], {}, "values"),
        ([0.2], {"thresholds": ()}, "thresholds"),
        ([0.2], {"thresholds": (25,)}, "thresholds"),
        ([0.2], {"rule": "loose"}, "rule"),
        ([0.2], {"confidence": 95}, "confidence"),
        ([0.2, 0.3], {"groups": ["a"]}, "number of group labels"),
    ],
)
def test_score_refuses(overlaps, options, name):
    with pytest.raises(InvalidInputError) as caught:
        score(overlaps, **options)
    assert caught.value.name == name


# --- protocols --------------------------------------------------------------------------------


def test_protocols_by_name():
    for name, protocol in PROTOCOLS.items():
        assert protocol.name == name
        assert find_protocol(name) is protocol
        assert find_protocol(protocol) is protocol
    with pytest.raises(UnknownNameError) as caught:
        find_protocol("strickt")
    assert caught.value.nearest == "strict"
