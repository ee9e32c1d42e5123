"""The grasp loss: its laws, the closed forms, and finite differences."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.losses import Base, GraspLoss, Positional
from graspmap.maps import GraspMaps

BASES, POSITIONALS = get_args(Base), get_args(Positional)
ALL = list(itertools.product(BASES, POSITIONALS))


def random_maps(seed: int, bins: int = 2, *, binary: bool = False, side: int = 5):
    rng = np.random.default_rng(seed)
    values = rng.normal(0, 1.5, (4, 2, bins, side, side + 1))
    if binary:
        values[0] = rng.random(values[0].shape) < 0.3
    else:
        values[0] = rng.random(values[0].shape) * (rng.random(values[0].shape) < 0.5)
    return GraspMaps(*torch.from_numpy(values))


def pixel_error(base: str, e: float) -> float:
    if base == "mse":
        return e**2
    return 0.5 * e**2 if abs(e) < 1 else abs(e) - 0.5


def closed_form(base: str, positional: str, predicted, target) -> list[float]:
    """Total and terms, pixel by pixel in plain Python."""
    q_pixels = target.quality.flatten().tolist()
    terms = []
    for k, (p_map, t_map) in enumerate(zip(predicted, target, strict=True)):
        total, weights = 0.0, 0.0
        pixels = zip(p_map.flatten().tolist(), t_map.flatten().tolist(), q_pixels, strict=True)
        for p, t, q in pixels:
            if k == 0 or positional == "none":
                total, weights = total + pixel_error(base, p - t), weights + 1
            elif positional == "inside":
                total, weights = total + pixel_error(base, q * p - q * t), weights + 1
            else:
                total += q * pixel_error(base, p - t)
                weights += q if positional == "normalised" else 1
        terms.append(total / weights)
    return [target.bins * sum(terms), *terms]


@pytest.mark.parametrize(("base", "positional"), ALL)
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), bins=st.integers(1, 4))
def test_equals_the_closed_form(base, positional, seed, bins):
    predicted, target = random_maps(seed, bins), random_maps(seed + 1, bins)
    found = GraspLoss(base, positional)(predicted, target)
    assert [float(v) for v in found] == pytest.approx(
        closed_form(base, positional, predicted, target), rel=1e-12
    )


@pytest.mark.parametrize(("base", "positional"), ALL)
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_never_negative_and_zero_at_the_target(base, positional, seed):
    target = random_maps(seed)
    loss = GraspLoss(base, positional)
    assert all(float(v) == 0 for v in loss(target, target))
    assert all(float(v) >= 0 for v in loss(random_maps(seed + 1), target))


@pytest.mark.parametrize(("base", "positional"), ALL)
def test_gradient_agrees_with_finite_differences(base, positional):
    target = random_maps(3, side=2)
    predicted = [m.clone().requires_grad_() for m in random_maps(4, side=2)]
    assert torch.autograd.gradcheck(
        lambda *maps: GraspLoss(base, positional)(GraspMaps(*maps), target).total, predicted
    )


@pytest.mark.parametrize(("base", "positional"), [c for c in ALL if c[1] != "none"])
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_angle_and_width_are_free_where_nothing_can_be_grasped(base, positional, seed):
    target = random_maps(seed)
    predicted = [m.clone().requires_grad_() for m in random_maps(seed + 1)]
    GraspLoss(base, positional)(GraspMaps(*predicted), target).total.backward()
    nothing = target.quality == 0
    assert all((m.grad[nothing] == 0).all() for m in predicted[1:])
    assert all((m.grad[~nothing] != 0).any() for m in predicted[1:])
    # the quality itself is learned everywhere
    assert (predicted[0].grad[nothing] != 0).any()


@pytest.mark.parametrize("base", BASES)
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_inside_and_outside_agree_for_binary_quality(base, seed):
    predicted, target = random_maps(seed), random_maps(seed + 1, binary=True)
    inside = GraspLoss(base, "inside")(predicted, target)
    outside = GraspLoss(base, "outside")(predicted, target)
    assert [float(v) for v in inside] == pytest.approx([float(v) for v in outside], rel=1e-12)


@pytest.mark.parametrize("base", BASES)
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1))
def test_quality_of_one_everywhere_makes_all_forms_equal(base, seed):
    predicted, maps = random_maps(seed), random_maps(seed + 1)
    target = GraspMaps(torch.ones_like(maps.quality), maps.cos, maps.sin, maps.width)
    totals = [float(GraspLoss(base, p)(predicted, target).total) for p in POSITIONALS]
    assert totals == pytest.approx([totals[0]] * len(totals), rel=1e-12)


@pytest.mark.parametrize("base", BASES)
def test_normalised_does_not_depend_on_the_empty_area(base):
    predicted, target = random_maps(5), random_maps(6)
    padding = torch.nn.ZeroPad2d((0, 7, 0, 9))
    larger = [GraspMaps(*(padding(m) for m in maps)) for maps in (predicted, target)]
    loss = GraspLoss(base, "normalised")
    small, large = loss(predicted, target), loss(*larger)
    assert [float(v) for v in large[2:]] == pytest.approx([float(v) for v in small[2:]], rel=1e-12)


@pytest.mark.parametrize("positional", POSITIONALS)
def test_a_batch_without_any_grasp_is_finite(positional):
    zero = torch.zeros(2, 1, 4, 4)
    target = GraspMaps(zero, zero, zero, zero)
    predicted = [torch.ones(2, 1, 4, 4, requires_grad=True) for _ in range(4)]
    terms = GraspLoss("mse", positional)(GraspMaps(*predicted), target)
    terms.total.backward()
    assert float(terms.total.detach()) == (4.0 if positional == "none" else 1.0)
    assert all(torch.isfinite(m.grad).all() for m in predicted)


def test_half_precision_maps_are_compared_in_the_wider_type():
    target = GraspMaps(*(m.float() for m in random_maps(7)))
    half = GraspMaps(*(m.bfloat16() for m in random_maps(8)))
    wide = GraspMaps(*(m.float() for m in half))
    loss = GraspLoss("mse", "inside")
    assert loss(half, target).total.dtype == torch.float32
    assert torch.equal(loss(half, target).total, loss(wide, target).total)


def test_shapes_must_agree():
    with pytest.raises(InvalidInputError) as caught:
        GraspLoss()(random_maps(0, bins=1), random_maps(0, bins=3))
    assert caught.value.found == (2, 1, 5, 6)


@pytest.mark.parametrize(("base", "positional"), [("l2", "none"), ("mse", "insid")])
def test_unknown_names(base, positional):
    with pytest.raises(UnknownNameError):
        GraspLoss(base, positional)


@pytest.mark.parametrize("positional", POSITIONALS)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), expectile=st.floats(0.05, 0.95))
def test_the_best_constant_width_is_the_expectile(positional, seed, expectile):
    """Found by bisection of t E[(w - e)+] = (1 - t) E[(e - w)+], which defines it."""
    target = random_maps(seed)
    target = replace(target, quality=torch.ones_like(target.quality))
    widths = target.width.flatten().numpy()
    low, high = widths.min(), widths.max()
    for _ in range(60):
        middle = (low + high) / 2
        above, below = np.clip(widths - middle, 0, None).sum(), np.clip(middle - widths, 0, None)
        low, high = (
            (middle, high) if expectile * above > (1 - expectile) * below.sum() else (low, middle)
        )
    constant = torch.tensor(low, requires_grad=True)
    predicted = replace(target, width=constant.expand(target.width.shape))
    loss = GraspLoss("mse", positional, width_expectile=expectile)(predicted, target)
    (slope,) = torch.autograd.grad(loss.width, constant)
    assert abs(float(slope)) < 1e-6
    assert float(loss.quality + loss.cos + loss.sin) == 0


@pytest.mark.parametrize("expectile", [0.0, 1.0, -1, float("nan")])
def test_an_expectile_lies_between_0_and_1(expectile):
    with pytest.raises(InvalidInputError, match="between 0 and 1"):
        GraspLoss(width_expectile=expectile)


def test_prints_what_it_is():
    assert repr(GraspLoss("smooth_l1", "outside")) == (
        "GraspLoss(base='smooth_l1', positional='outside', width_expectile=0.5)"
    )
