"""Losses of the auxiliary tasks and their weightings: laws, closed forms, finite differences."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.losses import (
    GRASP,
    TASK_LOSSES,
    UNKNOWN,
    BinLoss,
    CategoryLoss,
    DepthKind,
    DepthLoss,
    FixedWeighting,
    GraspLoss,
    MultiTaskLoss,
    SaliencyKind,
    SaliencyLoss,
    SumWeighting,
    Targets,
    UncertaintyWeighting,
    WeightingKind,
    cel,
    make_task_loss,
    make_weighting,
)
from graspmap.maps import GraspMaps

SALIENCY, DEPTH = get_args(SaliencyKind), get_args(DepthKind)
SEEDS = st.integers(0, 2**32 - 1)
SURE = 1e4
"""A logit whose probability is 0 or 1 to the last bit."""


def floats(seed: int, *shape: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).normal(0, 2, shape))


def bits(seed: int, *shape: int, share: float = 0.4) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).random(shape) < share)


def pictures(seed: int, side: int = 4) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """What a network says, a mask, and where it is known, of 2 pictures."""
    shape = (2, 1, side, side + 1)
    return floats(seed, *shape), bits(seed + 1, *shape), bits(seed + 2, *shape, share=0.7)


# Closed forms, pixel by pixel in plain Python.


def plain_mean(values, known) -> float:
    """Mean over the known pixels of each picture, then over the pictures."""
    means = []
    for picture, allowed in zip(values, known, strict=True):
        used = [v for v, k in zip(picture, allowed, strict=True) if k]
        means.append(sum(used) / len(used) if used else 0.0)
    return sum(means) / len(means)


def plain_saliency(kind: str, logit: float, g: float) -> float:
    p = 1 / (1 + math.exp(-logit))
    if kind == "mse":
        return (p - g) ** 2
    return -(g * math.log(p) + (1 - g) * math.log(1 - p))


def plain_cel(p, g) -> float:
    total = sum(p) + sum(g)
    missed = sum(a - a * b for a, b in zip(p, g, strict=True))
    extra = sum(b - a * b for a, b in zip(p, g, strict=True))
    return (missed + extra) / total if total else 0.0


@pytest.mark.parametrize("kind", SALIENCY)
@settings(max_examples=25)
@given(seed=SEEDS)
def test_saliency_equals_the_closed_form(kind, seed):
    logits, mask, known = pictures(seed)
    rows = [t.flatten(1).tolist() for t in (logits, mask.double(), known)]
    values = [
        [plain_saliency(kind, x, g) for x, g in zip(xs, gs, strict=True)]
        for xs, gs in zip(*rows[:2], strict=True)
    ]
    expected = plain_mean(values, rows[2])
    if kind == "bce_cel":
        p = (logits.sigmoid() * known).flatten(1).tolist()
        g = (mask & known).double().flatten(1).tolist()
        expected += sum(map(plain_cel, p, g)) / len(p)
    assert float(SaliencyLoss(kind)(logits, mask, known)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("kind", DEPTH)
@settings(max_examples=25)
@given(seed=SEEDS)
def test_depth_equals_the_closed_form(kind, seed):
    said, _, known = pictures(seed)
    truth = floats(seed + 3, *said.shape)

    def error(e: float) -> float:
        if kind == "mse":
            return e * e
        return 0.5 * e * e if abs(e) < 1 else abs(e) - 0.5

    values = [[error(e) for e in row] for row in (said - truth).flatten(1).tolist()]
    expected = plain_mean(values, known.flatten(1).tolist())
    assert float(DepthLoss(kind)(said, truth, known)) == pytest.approx(expected, rel=1e-12)


@settings(max_examples=50)
@given(seed=SEEDS, share=st.floats(0.05, 0.95))
def test_cel_of_binary_pictures_is_the_count_of_errors(seed, share):
    """(FP + FN) / (FP + 2 TP + FN)."""
    p, g = bits(seed, 1, 1, 6, 6, share=share), bits(seed + 1, 1, 1, 6, 6, share=share)
    wrong, both = int((p ^ g).sum()), int((p & g).sum())
    expected = wrong / (wrong + 2 * both) if wrong + both else 0.0
    assert float(cel(p.double(), g.double())) == pytest.approx(expected, rel=1e-12)


@settings(max_examples=25)
@given(seed=SEEDS)
def test_category_is_the_cross_entropy(seed):
    logits = floats(seed, 5, 4)
    classes = torch.from_numpy(np.random.default_rng(seed).integers(-1, 4, 5))
    found = float(CategoryLoss()(logits, classes))
    known = [
        math.log(sum(math.exp(x) for x in row)) - row[k]
        for row, k in zip(logits.tolist(), classes.tolist(), strict=True)
        if k != UNKNOWN
    ]
    assert found == pytest.approx(sum(known) / len(known) if known else 0.0, rel=1e-12)


@pytest.mark.parametrize("any_bin", [True, False])
@settings(max_examples=25)
@given(seed=SEEDS)
def test_graspness_and_orientation_are_the_cross_entropy_of_the_maps(any_bin, seed):
    quality = floats(seed, 2, 3, 4, 5).clamp(0, 1)
    logits = floats(seed + 1, 2, 1 if any_bin else 3, 4, 5)
    truth = (quality > 0).any(1, keepdim=True) if any_bin else quality > 0
    pairs = zip(logits.flatten().tolist(), truth.double().flatten().tolist(), strict=True)
    expected = [plain_saliency("bce", x, g) for x, g in pairs]
    found = float(BinLoss(any_bin=any_bin)(logits, quality))
    assert found == pytest.approx(sum(expected) / len(expected), rel=1e-12)


# Laws.


@pytest.mark.parametrize("kind", SALIENCY)
@settings(max_examples=25)
@given(seed=SEEDS)
def test_saliency_is_zero_at_the_target_only(kind, seed):
    logits, mask, known = pictures(seed)
    sure = torch.where(mask, SURE, -SURE).double()
    loss = SaliencyLoss(kind)
    assert float(loss(sure, mask, known)) == 0
    assert float(loss(logits, mask, known)) > 0
    assert float(loss(-sure, mask)) > 0.5


@pytest.mark.parametrize("kind", DEPTH)
@settings(max_examples=25)
@given(seed=SEEDS)
def test_depth_is_zero_at_the_target_only(kind, seed):
    said, _, known = pictures(seed)
    truth = floats(seed + 3, *said.shape)
    loss = DepthLoss(kind)
    assert float(loss(truth, truth)) == 0
    assert float(loss(said, truth, known)) > 0
    # what is not known may be anything
    assert float(loss(torch.where(known, truth, said), truth, known)) == 0


@settings(max_examples=25)
@given(seed=SEEDS)
def test_category_and_bins_are_zero_at_the_target(seed):
    classes = torch.from_numpy(np.random.default_rng(seed).integers(-1, 4, 5))
    logits = SURE * torch.nn.functional.one_hot(classes.clamp_min(0), 4).double()
    assert float(CategoryLoss()(logits, classes)) == 0
    quality = floats(seed, 2, 3, 4, 4).clamp(0, 1)
    per_bin = torch.where(quality > 0, SURE, -SURE)
    assert float(BinLoss(any_bin=False)(per_bin, quality)) == 0
    assert float(BinLoss(any_bin=True)(per_bin.amax(1, keepdim=True), quality)) == 0


WITH_A_MASK = [
    *((SaliencyLoss(kind), lambda seed: bits(seed, 2, 1, 4, 5)) for kind in SALIENCY),
    *((DepthLoss(kind), lambda seed: floats(seed, 2, 1, 4, 5)) for kind in DEPTH),
]


@pytest.mark.parametrize(("loss", "make_truth"), WITH_A_MASK)
@settings(max_examples=25)
@given(seed=SEEDS)
def test_gradient_only_where_the_truth_is_known(loss, make_truth, seed):
    said, _, known = pictures(seed)
    said.requires_grad_()
    loss(said, make_truth(seed + 3), known).backward()
    assert (said.grad[~known] == 0).all()
    assert (said.grad[known] != 0).all()


@pytest.mark.parametrize(("loss", "make_truth"), WITH_A_MASK)
def test_the_loss_of_a_batch_is_the_mean_of_its_pictures(loss, make_truth):
    said, _, known = pictures(5)
    known[1] = False  # a picture of which nothing is known counts as 0
    truth = make_truth(8)
    alone = [loss(said[i : i + 1], truth[i : i + 1], known[i : i + 1]) for i in range(2)]
    assert float(loss(said, truth, known)) == pytest.approx(sum(map(float, alone)) / 2, rel=1e-12)
    assert float(alone[1]) == 0


@pytest.mark.parametrize("kind", SALIENCY)
def test_a_network_that_is_sure_and_wrong_still_learns(kind):
    """The cross-entropy from the logits is finite and has a gradient; from p it is neither."""
    logits = torch.full((1, 1, 2, 2), -200.0, requires_grad=True)
    loss = SaliencyLoss(kind)(logits, torch.ones(1, 1, 2, 2))
    loss.backward()
    assert float(loss.detach()) == pytest.approx({"mse": 1, "bce": 200, "bce_cel": 201}[kind])
    assert logits.grad.isfinite().all()
    assert kind == "mse" or (logits.grad < 0).all()


def test_cel_of_an_empty_picture_is_zero_and_smooth():
    p = torch.zeros(1, 1, 3, 3, requires_grad=True)
    loss = cel(p, torch.zeros(1, 1, 3, 3))
    loss.backward()
    assert float(loss.detach()) == 0
    assert p.grad.isfinite().all()


@pytest.mark.parametrize(("loss", "make_truth"), WITH_A_MASK)
def test_gradients_agree_with_finite_differences(loss, make_truth):
    said, _, known = pictures(11)
    truth = make_truth(12)
    assert torch.autograd.gradcheck(lambda x: loss(x, truth, known), said.requires_grad_())


def test_gradients_of_category_and_bins_agree_with_finite_differences():
    classes = torch.tensor([0, 3, UNKNOWN])
    logits = floats(1, 3, 4).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: CategoryLoss()(x, classes), logits)
    quality = floats(2, 2, 3, 3, 3).clamp(0, 1)
    for any_bin, bins in ((True, 1), (False, 3)):
        logits = floats(3, 2, bins, 3, 3).requires_grad_()
        loss = BinLoss(any_bin=any_bin)
        assert torch.autograd.gradcheck(lambda x, f=loss: f(x, quality), logits)


# Weightings.

LOSSES = st.lists(st.floats(1e-3, 1e3), min_size=3, max_size=3)


def named(values) -> dict[str, torch.Tensor]:
    names = (GRASP, "depth", "category")
    return {n: torch.tensor(v, dtype=torch.float64) for n, v in zip(names, values, strict=True)}


@given(LOSSES, st.floats(0, 1))
def test_sum_and_fixed_weighting(values, share):
    assert float(SumWeighting()(named(values))) == pytest.approx(sum(values))
    expected = share * values[0] + (1 - share) * (values[1] + values[2])
    assert float(FixedWeighting(share)(named(values))) == pytest.approx(expected)
    assert float(FixedWeighting(share)({GRASP: torch.tensor(2.0)})) == pytest.approx(2 * share)


@given(LOSSES, st.lists(st.floats(-5, 5), min_size=3, max_size=3))
def test_uncertainty_weighting_is_the_formula(values, s):
    weighting = UncertaintyWeighting((GRASP, "depth", "category"))
    assert float(weighting(named(values)).detach()) == pytest.approx(sum(values))  # s starts at 0
    with torch.no_grad():
        weighting.log_variances.copy_(torch.tensor(s))
    expected = sum(math.exp(-a) * v + a for a, v in zip(s, values, strict=True))
    assert float(weighting(named(values)).detach()) == pytest.approx(expected, rel=1e-5, abs=1e-4)


def test_uncertainty_weighting_learns_the_logarithm_of_each_loss():
    """At the minimum over s each task weighs 1: d/ds (exp(-s) l + s) = 0 at s = log l."""
    values = (0.01, 1.0, 40.0)
    weighting = UncertaintyWeighting((GRASP, "depth", "category"))
    optimiser = torch.optim.Adam(weighting.parameters(), lr=0.05)
    for _ in range(500):
        optimiser.zero_grad()
        weighting(named(values)).backward()
        optimiser.step()
    assert weighting.log_variances.tolist() == pytest.approx([math.log(v) for v in values], abs=0.1)


def test_gradient_of_the_uncertainty_weighting_agrees_with_finite_differences():
    weighting = UncertaintyWeighting((GRASP, "depth", "category")).double()

    def total(s, *losses):
        named_losses = dict(zip(weighting.names, losses, strict=True))
        return torch.func.functional_call(weighting, {"log_variances": s}, (named_losses,))

    values = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.3, 2.0, 7.0)]
    s = torch.tensor([0.1, -0.4, 1.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(total, (s, *values))


# All together.


def batch(seed: int = 0, bins: int = 2):
    """Maps, what is said on every task, and the truth."""
    shape = (2, bins, 4, 5)
    maps = GraspMaps(*(floats(seed + i, *shape) for i in range(4)))
    true_maps = GraspMaps(floats(seed + 5, *shape).clamp(0, 1), maps.cos, maps.sin, maps.width)
    said = {name: floats(seed + 9, 2, 1, 4, 5) for name in ("saliency", "depth", "graspness")}
    said |= {"orientation": floats(seed + 8, *shape), "category": floats(seed + 7, 2, 6)}
    _, mask, known = pictures(seed)
    depth = floats(seed + 6, 2, 1, 4, 5)
    return maps, said, Targets(true_maps, mask, known, depth, known, torch.tensor([3, 5]))


def test_without_tasks_it_is_the_grasp_loss_to_the_bit():
    maps, _, targets = batch()
    terms = MultiTaskLoss(GraspLoss("smooth_l1", "inside"))(maps, {}, targets)
    expected = GraspLoss("smooth_l1", "inside")(maps, targets.maps)
    assert all(torch.equal(a, b) for a, b in zip(terms.grasp, expected, strict=True))
    assert torch.equal(terms.total, expected.total)
    assert terms.tasks == {}


@pytest.mark.parametrize("weighting", get_args(WeightingKind))
def test_all_tasks_together_and_their_gradients(weighting):
    maps, said, targets = batch()
    loss = MultiTaskLoss(
        tasks={name: make_task_loss(name, saliency="bce_cel") for name in TASK_LOSSES},
        weighting=make_weighting(weighting, TASK_LOSSES, 0.3),
    ).double()
    terms = loss(maps, said, targets)
    assert tuple(terms.tasks) == TASK_LOSSES
    alone = {
        "category": CategoryLoss()(said["category"], targets.classes),
        "saliency": SaliencyLoss("bce_cel")(said["saliency"], targets.mask, targets.inside),
        "depth": DepthLoss()(said["depth"], targets.depth, targets.depth_known),
        "graspness": BinLoss(any_bin=True)(said["graspness"], targets.maps.quality),
        "orientation": BinLoss(any_bin=False)(said["orientation"], targets.maps.quality),
    }
    assert all(torch.equal(terms.tasks[name], value) for name, value in alone.items())
    share = {"fixed": 0.3}.get(weighting)
    weights = (1, 1) if share is None else (share, 1 - share)
    expected = weights[0] * float(terms.grasp.total) + weights[1] * sum(map(float, alone.values()))
    assert float(terms.total.detach()) == pytest.approx(expected)

    def total(*values):
        kinds = GraspMaps(*values[:4]), dict(zip(said, values[4:], strict=True))
        return loss(*kinds, targets).total

    inputs = [t.clone().requires_grad_() for t in (*maps, *said.values())]
    assert torch.autograd.gradcheck(total, inputs)


# What is refused.


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: SaliencyLoss("bcel"),
        lambda: DepthLoss("l1"),
        lambda: make_weighting("mean", ()),
        lambda: make_task_loss("salency"),
        lambda: MultiTaskLoss(tasks={"salency": SaliencyLoss()}),
    ],
)
def test_unknown_names(wrong):
    with pytest.raises(UnknownNameError):
        wrong()


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan])
def test_shares_outside_0_to_1(share):
    with pytest.raises(InvalidInputError):
        FixedWeighting(share)


@pytest.mark.parametrize("names", [(), (GRASP, GRASP)])
def test_uncertainty_needs_each_task_once(names):
    with pytest.raises(InvalidInputError):
        UncertaintyWeighting(names)


def test_shapes_must_agree():
    logits, mask, known = pictures(0)
    for loss in (SaliencyLoss(), DepthLoss()):
        with pytest.raises(InvalidInputError, match="one shape"):
            loss(logits, mask[..., 1:])
        with pytest.raises(InvalidInputError, match="one shape"):
            loss(logits, mask, known[:1])
    with pytest.raises(InvalidInputError, match="orientation"):
        BinLoss(any_bin=False)(floats(0, 2, 2, 4, 4), floats(0, 2, 3, 4, 4))
    with pytest.raises(InvalidInputError, match=r"\(B, K\)"):
        CategoryLoss()(floats(0, 3, 4), torch.zeros(2, dtype=torch.int64))


@pytest.mark.parametrize("classes", [[0, 4], [-2, 0]])
def test_classes_that_do_not_exist(classes):
    with pytest.raises(InvalidInputError, match="not known"):
        CategoryLoss()(floats(0, 2, 4), torch.tensor(classes))


@pytest.mark.parametrize("name", ["category", "saliency", "depth"])
def test_what_is_missing_is_named(name):
    maps, said, targets = batch()
    loss = MultiTaskLoss(tasks={name: make_task_loss(name)})
    with pytest.raises(InvalidInputError, match=f"target of the task {name}"):
        loss(maps, said, Targets(targets.maps))
    with pytest.raises(InvalidInputError, match=f"output of the task {name}"):
        loss(maps, {}, targets)


def test_prints_what_it_is():
    assert repr(SaliencyLoss("bce_cel")) == "SaliencyLoss(kind='bce_cel')"
    assert repr(FixedWeighting(0.25)) == "FixedWeighting(share=0.25)"
    assert "any_bin=True" in repr(make_task_loss("graspness"))
    assert repr(UncertaintyWeighting((GRASP,))) == "UncertaintyWeighting(names=('grasp',))"
