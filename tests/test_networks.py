"""Networks: against slow forwards written from the layer tables, and their laws."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.maps import GraspMaps
from graspmap.networks import NETWORKS, TaskSpec, make_network, parameter_count

pytestmark = pytest.mark.usefixtures("one_thread")

# The layer tables, a second time: each row is an operation and what it needs. "conv" and
# "transposed" name their parameters and give kernel, stride, padding, then dilation or output
# padding. "keep" puts the features aside, "add" and "join" (pad to its size, put behind it) take
# them up again.
RELU, POOL, DOUBLE = ("relu",), ("pool",), ("double",)


def conv(name, kernel, stride=1, padding=0, dilation=1):
    return ("conv", name, kernel, stride, padding, dilation)


def transposed(name, kernel, stride=1, padding=0, extra=0):
    return ("transposed", name, kernel, stride, padding, extra)


GGCNN_TABLE = [
    *(conv("shrink1", 9, 3, 3), RELU, conv("shrink2", 5, 2, 2), RELU),
    *(conv("shrink3", 3, 2, 1), RELU, transposed("grow1", 3, 2, 1, 1), RELU),
    *(transposed("grow2", 5, 2, 2, 1), RELU, transposed("grow3", 9, 3, 3, 1), RELU),
]
STEM = [
    *(conv("fine1", 11, 1, 5), RELU, conv("fine2", 5, 1, 2), RELU, POOL),
    *(conv("middle1", 5, 1, 2), RELU, conv("middle2", 5, 1, 2), RELU, POOL),
]
DILATED = [conv("dilated1", 5, 1, 4, 2), RELU, conv("dilated2", 5, 1, 8, 4), RELU]
GROW = [transposed("grow1", 3, 2, 1, 1), RELU, transposed("grow2", 3, 2, 1, 1), RELU]
BILINEAR = [*(DOUBLE, conv("grow1", 3, 1, 1), RELU), *(DOUBLE, conv("grow2", 3, 1, 1), RELU)]


def normed(row, norm):
    return [row, ("norm", norm), RELU]


def residual(i):
    return [
        ("keep",),
        *normed(conv(f"residual.{i}.layer1", 3, 1, 1), f"residual.{i}.norm1"),
        *(conv(f"residual.{i}.layer2", 3, 1, 1), ("norm", f"residual.{i}.norm2"), ("add",)),
    ]


GRCONVNET_TABLE = [
    *normed(conv("shrink1.layer", 9, 1, 4), "shrink1.norm"),
    *normed(conv("shrink2.layer", 4, 2, 1), "shrink2.norm"),
    *normed(conv("shrink3.layer", 4, 2, 1), "shrink3.norm"),
    *(row for i in range(5) for row in residual(i)),
    *normed(transposed("grow1.layer", 4, 2, 1, 1), "grow1.norm"),
    *normed(transposed("grow2.layer", 4, 2, 2, 1), "grow2.norm"),
    transposed("grow3", 9, 1, 4, 0),
]


def twice(name):
    return [
        *normed(conv(f"{name}.layer1", 3, 1, 1), f"{name}.norm1"),
        *normed(conv(f"{name}.layer2", 3, 1, 1), f"{name}.norm2"),
    ]


UNET_TABLE = [
    *(row for i in range(4) for row in [*twice(f"down{i}"), ("keep",), POOL]),
    *twice("down4"),
    *(
        row
        for i in range(1, 5)
        for row in [transposed(f"up{i}.enlarge", 2, 2), ("join",), *twice(f"up{i}.merge")]
    ),
]
TABLES = {
    "ggcnn": (GGCNN_TABLE, 2),
    "ggcnn2": ([*STEM, *DILATED, *GROW], 1),
    "ggcnn2-bilinear": ([*STEM, *DILATED, *BILINEAR], 1),
    **{f"grconvnet{i}": (GRCONVNET_TABLE, 2) for i in ("", 2, 3, 4)},
    "unet": (UNET_TABLE, 1),
    **{f"mtgcnn-{x}": ([*STEM, *DILATED, *GROW], 1) for x in "abcd"},
}
SALIENCY_TABLES = {
    "mtgcnn-a": [*STEM, *DILATED, *GROW],
    "mtgcnn-b": [*STEM, *DILATED, "branch", *GROW],
    "mtgcnn-c": [*STEM, "branch", *DILATED, *GROW],
    "mtgcnn-d": STEM,
}
NARROW = {"unet": 8, **{f"grconvnet{i}": 8 for i in ("", 2, 3, 4)}}
"""Filters with which the wide networks are quick."""


def small(name, channels=1, bins=1, seed=0, tasks=()):
    """A network of few filters, with the task that it may need, in evaluation mode."""
    if NETWORKS[name].needs_task and not tasks:
        tasks = (TaskSpec("saliency"),)
    network = make_network(
        name, channels, bins, tasks=tasks, filters=NARROW.get(name), generator=seeded(seed)
    )
    with torch.no_grad():  # statistics and scales of batch norm that are not 0 and 1
        for key, value in network.state_dict().items():
            if "norm" in key and value.is_floating_point():
                value += torch.rand(value.shape, generator=seeded(len(key))) * 0.5 - 0.2
    return network.eval()


def doubling_matrix(size: int) -> torch.Tensor:
    """(2 size, size) linear interpolation that keeps the corners on the corners."""
    at = np.linspace(0, size - 1, 2 * size)
    rows = [np.interp(at, np.arange(size), column) for column in np.eye(size)]
    return torch.from_numpy(np.stack(rows, axis=1))


def convolved(parameters, x, kind, name, size, stride, padding, last):
    weight, bias = parameters[f"{name}.weight"], parameters[f"{name}.bias"]
    assert weight.shape[2:] == (size, size)
    if kind == "conv":
        return F.conv2d(x, weight, bias, stride, padding, last)
    return F.conv_transpose2d(x, weight, bias, stride, padding, last)


def scaled(parameters, x, kind, name):
    mean, variance, scale, shift = (
        parameters[f"{name}.{part}"][:, None, None]
        for part in ("running_mean", "running_var", "weight", "bias")
    )
    return (x - mean) / (variance + 1e-5).sqrt() * scale + shift


def pooled(x):
    count, channels, rows, columns = x.shape
    x = x[..., : rows // 2 * 2, : columns // 2 * 2]
    return x.reshape(count, channels, rows // 2, 2, columns // 2, 2).amax(dim=(3, 5))


def doubled(x):
    down, across = (doubling_matrix(side).to(x) for side in x.shape[2:])
    return down @ x @ across.T


def joined(x, beside):
    larger = torch.zeros(*x.shape[:2], *beside.shape[2:], dtype=x.dtype)
    larger[..., : x.shape[2], : x.shape[3]] = x
    return torch.cat([beside, larger], 1)


def slow_features(network, table, x, prefix=""):
    """Features (of the type of x), from the layer table and the parameters by name."""
    p = {n: value.detach().contiguous().to(x.dtype) for n, value in network.state_dict().items()}
    kept = []
    simple = {"relu": lambda x: x.clamp_min(0), "pool": pooled, "double": doubled}
    for row in table:
        if row == "branch":
            p |= {n.removeprefix(prefix): v for n, v in p.items() if n.startswith(prefix)}
        elif row[0] in simple:
            x = simple[row[0]](x)
        elif row[0] == "keep":
            kept.append(x)
        elif row[0] == "add":
            x = x + kept.pop()
        elif row[0] == "join":
            x = joined(x, kept.pop())
        else:
            x = (scaled if row[0] == "norm" else convolved)(p, x, *row)
    return x


def slow_forward(network, images, kind=torch.float64):
    """The four maps of the layer table."""
    table, kernel = TABLES[network.name]
    x = slow_features(network, table, images.to(kind))
    weight, bias = network.heads.layer.weight.to(kind), network.heads.layer.bias.to(kind)
    assert weight.shape[2:] == (kernel, kernel)
    n = network.bins
    return [F.conv2d(x, weight[k * n : k * n + n], bias[k * n : k * n + n]) for k in range(4)]


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def distance(found, expected):
    return float((found - expected).abs().max())


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize(("channels", "bins"), [(1, 1), (4, 3)])
def test_forward_agrees_with_the_layer_table(name, channels, bins):
    network = small(name, channels, bins)
    images = torch.randn(2, channels, 48, 60, generator=seeded(1))
    with torch.inference_mode():
        maps = network(images)
        slow = slow_forward(network, images)
    assert isinstance(maps, GraspMaps)
    for found, expected in zip(maps, slow, strict=True):
        assert found.shape == (2, bins, 48, 60)
        assert found.dtype == torch.float32
        assert distance(found, expected) < 1e-5


@pytest.mark.parametrize("name", [n for n in NETWORKS if n not in ("grconvnet2", "grconvnet3")])
def test_published_width_agrees_with_the_layer_table(name):
    tasks = [TaskSpec("depth")] if NETWORKS[name].needs_task else []
    network = make_network(name, 3, tasks=tasks, generator=seeded(2)).eval()
    # GG-CNN at its published size too; the wide ones would take seconds
    side = 96 if name in NARROW else 300
    images = torch.randn(1, 3, side, side, generator=seeded(3))
    with torch.inference_mode():
        maps = network(images)
        slow = slow_forward(network, images, torch.float32 if side == 300 else torch.float64)
    for found, expected in zip(maps, slow, strict=True):
        assert found.shape == (1, 1, side, side)
        assert distance(found, expected) < 1e-5


@pytest.mark.parametrize("name", SALIENCY_TABLES)
def test_branch_agrees_with_the_layer_table(name):
    network = small(name, 3, 2, tasks=[TaskSpec("saliency"), TaskSpec("depth")])
    images = torch.randn(1, 3, 40, 56, generator=seeded(1))
    with torch.inference_mode():
        found = network.outputs(images).tasks
        for task in ("saliency", "depth"):
            prefix = f"task_branches.{task}."
            x = slow_features(network, SALIENCY_TABLES[name], images.double(), prefix)
            layer = network.task_heads[task].layer
            x = torch.einsum("bfhw,of->bohw", x, layer.weight.double()[..., 0, 0])
            x = x + layer.bias.double()[:, None, None]
            if name == "mtgcnn-d":
                x = F.interpolate(x, scale_factor=4, mode="bilinear")
            assert distance(found[task], x) < 1e-5


@pytest.mark.parametrize(
    ("name", "channels", "bins", "count"),
    [
        ("ggcnn", 1, 1, 62_420),
        ("ggcnn", 4, 1, 70_196),
        ("ggcnn2", 1, 1, 66_676),
        ("ggcnn2", 3, 1, 70_548),
        ("ggcnn2", 4, 1, 72_484),
        ("ggcnn2-bilinear", 1, 1, 66_676),
        ("grconvnet", 4, 1, 1_900_900),
        ("grconvnet2", 4, 1, 1_900_900),
        ("grconvnet3", 4, 1, 1_900_900),
        ("grconvnet4", 4, 1, 120_652),
        ("unet", 4, 1, 14_789_700),
        # each further bin adds four 1 x 1 heads with 16 weights and a bias
        ("ggcnn2", 1, 6, 66_676 + 5 * 4 * 17),
        # ... or four 2 x 2 heads over 32 features
        ("ggcnn", 1, 3, 62_420 + 2 * 4 * 129),
    ],
)
def test_parameter_counts(name, channels, bins, count):
    assert parameter_count(make_network(name, channels, bins)) == count


@pytest.mark.parametrize("name", NETWORKS)
@given(rows=st.integers(1, 40), columns=st.integers(1, 40), seed=st.integers(0, 2**32))
@settings(max_examples=3)
def test_any_size_is_the_padded_one_cut_back(name, rows, columns, seed):
    network = small(name)
    images = torch.randn(1, 1, rows, columns, generator=seeded(seed))
    step, least = network.granularity, network.smallest
    larger = torch.zeros(1, 1, *(-(-max(n, least) // step) * step for n in (rows, columns)))
    larger[..., :rows, :columns] = images
    with torch.inference_mode():
        maps, reference = network(images), network(larger)
    for found, expected in zip(maps, reference, strict=True):
        assert found.shape == (1, 1, rows, columns)
        assert (found - expected[..., :rows, :columns]).abs().max() < 1e-5


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("channels", [1, 3])
def test_a_batch_is_its_pictures(name, channels):
    network = small(name, channels, 2)
    images = torch.randn(3, channels, 24, 36, generator=seeded(4))
    with torch.inference_mode():
        together = network(images)
        for i in range(3):
            alone = network(images[i : i + 1])
            for a, b in zip(together.item(i), alone.item(0), strict=True):
                assert (a - b).abs().max() < 1e-5


@pytest.mark.parametrize("name", NETWORKS)
def test_layout_of_the_input_does_not_matter(name):
    network = small(name, 3)
    images = torch.randn(2, 3, 24, 24, generator=seeded(5))
    views = (
        images.contiguous(memory_format=torch.channels_last),
        images.permute(0, 1, 3, 2).contiguous().permute(0, 1, 3, 2),
        torch.randn(2, 3, 48, 48)[..., ::2, ::2].copy_(images),
    )
    with torch.inference_mode():
        expected = network(images)
        for view in views:
            assert (network(view).quality - expected.quality).abs().max() < 1e-6


@pytest.mark.parametrize("name", NETWORKS)
def test_gradients_agree_with_finite_differences(name):
    # With small steps no ReLU changes sides, nor does the largest of four pixels.
    network = small(name, 1, 2, seed=6).double()
    images = torch.randn(1, 1, 16, 16, dtype=torch.float64, generator=seeded(7))
    weights = [
        torch.randn(1, 2, 16, 16, dtype=torch.float64, generator=seeded(k)) for k in range(4)
    ]

    def value() -> torch.Tensor:
        return sum((w * m).sum() for w, m in zip(weights, network(images), strict=True))

    parameters = [p for n, p in network.named_parameters() if not n.startswith("task_")]
    gradients = torch.autograd.grad(value(), parameters)
    # A random direction in all parameters at once: the error of any one would show.
    directions = [
        torch.randn(p.shape, dtype=p.dtype, generator=seeded(k)) for k, p in enumerate(parameters)
    ]
    step = 1e-8
    with torch.no_grad():
        ends = []
        for move in (step, -2 * step):
            for parameter, direction in zip(parameters, directions, strict=True):
                parameter += move * direction
            ends.append(value())
    slope = float(ends[0] - ends[1]) / (2 * step)
    expected = sum(float((g * d).sum()) for g, d in zip(gradients, directions, strict=True))
    assert slope == pytest.approx(expected, rel=1e-4)


def test_weights_are_xavier_uniform_and_biases_as_pytorch_draws_them():
    network = make_network("ggcnn2", 3, 2, generator=seeded())
    for name, module in network.named_modules():
        if not hasattr(module, "weight"):
            continue
        area = module.weight[0, 0].numel()
        fan_in, fan_out = module.weight.shape[1] * area, module.weight.shape[0] * area
        if name.startswith("heads"):
            fan_out //= 4  # each map's layer stands alone
        bound = (6 / (fan_in + fan_out)) ** 0.5
        largest = float(module.weight.detach().abs().max())
        assert 0.9 * bound < largest <= bound, name
        assert float(module.bias.detach().abs().max()) <= fan_in**-0.5


def test_u_net_keeps_the_defaults_of_pytorch():
    network = make_network("unet", 3, 2, filters=8, generator=seeded())
    for name, module in network.named_modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            assert set(module.weight.tolist()) == {1.0}
        elif getattr(module, "weight", None) is not None:
            bound = module.weight[0].numel() ** -0.5
            assert 0.9 * bound < float(module.weight.detach().abs().max()) <= bound, name
            assert float(module.bias.detach().abs().max()) <= bound


@pytest.mark.parametrize("name", NETWORKS)
def test_same_generator_same_weights(name):
    tasks = [TaskSpec("category", 3, 16), TaskSpec("depth"), TaskSpec("graspness")]
    more = {"tasks": tasks, "filters": NARROW.get(name)}
    a, b, c = (
        make_network(name, 4, 3, **more, generator=seeded(k)).state_dict() for k in (9, 9, 10)
    )
    assert all(torch.equal(a[key], b[key]) for key in a)
    assert not any(torch.equal(a[key], c[key]) for key in a if "norm" not in key)
    # ... after any use
    network = make_network(name, 4, 3, **more)
    network.outputs(torch.randn(2, 4, 16, 16))
    network.reset_parameters(seeded(9))
    assert all(torch.equal(a[key], value) for key, value in network.state_dict().items())


@pytest.mark.parametrize("name", NETWORKS)
def test_tasks_do_not_change_the_fresh_trunk(name):
    base = "ggcnn2" if NETWORKS[name].needs_task else name
    plain = make_network(base, 3, filters=NARROW.get(name), generator=seeded()).state_dict()
    tasks = [TaskSpec("category", 5, 20), TaskSpec("saliency")]
    with_tasks = make_network(name, 3, tasks=tasks, filters=NARROW.get(name), generator=seeded())
    state = with_tasks.state_dict()
    assert all(torch.equal(plain[key], state[key]) for key in plain)
    assert all(key.startswith(("task_heads.", "task_branches.")) for key in state.keys() - plain)


@pytest.mark.parametrize("name", NETWORKS)
def test_dropout_and_batch_statistics_only_in_training(name):
    network = small(name, 1)
    images = torch.randn(2, 1, 24, 24, generator=seeded(5))
    state = {key: value.clone() for key, value in network.state_dict().items()}
    with torch.no_grad():
        still = [network(images).quality for _ in range(2)]
        assert torch.equal(*still)
        assert all(torch.equal(state[key], v) for key, v in network.state_dict().items())
        network.train()
        torch.manual_seed(1)
        moving = [network(images).quality for _ in range(2)]
    assert torch.equal(*moving) == (name not in ("grconvnet2", "grconvnet3"))
    # The maps have masks of their own, each scaled back up on average.
    if name == "grconvnet3":
        features = torch.ones(1, 8, 400, 400)
        with torch.no_grad():
            maps = network.heads(features)
            expected = network.heads.eval()(features)
        assert maps.mean((2, 3)) == pytest.approx(expected.mean((2, 3)), abs=0.01)
        assert not torch.equal(maps[:, 0] > maps.mean(), maps[:, 1] > maps.mean())


@pytest.mark.parametrize("name", NETWORKS)
def test_training_mode_works_and_copies_are_independent(name):
    network = small(name).train()
    twin = copy.deepcopy(network)
    network(torch.randn(2, 1, 32, 32)).quality.mean().backward()
    parameters = dict(network.named_parameters())
    assert all(p.grad is not None for n, p in parameters.items() if not n.startswith("task_"))
    assert all(p.grad is None for p in twin.parameters())


@pytest.mark.parametrize("name", NARROW)
def test_filters_set_the_width(name):
    counts = [parameter_count(make_network(name, 4, filters=c)) for c in (4, 8, 16)]
    # layers between features grow with the square, the rest slower
    assert all(2 < b / a < 4 for a, b in itertools.pairwise(counts))
    assert make_network(name, 4).filters == NETWORKS[name].published_filters
    for wrong in (0, -4, 8.0, True):
        with pytest.raises(InvalidInputError, match="filters of the network"):
            make_network(name, 4, filters=wrong)


def test_published_width_of_others():
    assert parameter_count(make_network("grconvnet", 4, filters=16)) == 479_156
    with pytest.raises(InvalidInputError, match="multiple of 4"):
        make_network("grconvnet4", 4, filters=6)
    for name in ("ggcnn", "ggcnn2", "mtgcnn-c"):
        with pytest.raises(InvalidInputError, match=f"filters of {name} is 16; allowed: null"):
            make_network(name, 1, tasks=[TaskSpec("depth")], filters=16)


def test_maps_lie_in_one_piece():
    with torch.inference_mode():
        maps = make_network("ggcnn2", 1)(torch.zeros(1, 1, 30, 30)).item(0)
    assert all(m.is_contiguous() for m in maps)


@pytest.mark.parametrize("shape", [(1, 300, 300), (1, 3, 20, 20), (1, 1, 0, 20), (0, 1, 20, 20)])
def test_wrong_input_says_what_is_allowed(shape):
    with pytest.raises(InvalidInputError) as caught:
        make_network("ggcnn2", 1)(torch.zeros(shape))
    assert caught.value.found == shape
    assert "(B, 1, H, W)" in caught.value.allowed


@pytest.mark.parametrize(("channels", "bins"), [(0, 1), (1, 0), (1, 1.5), (True, 1), (1, -2)])
def test_wrong_channels_or_bins(channels, bins):
    with pytest.raises(InvalidInputError, match="an integer >= 1"):
        make_network("ggcnn", channels, bins)


def test_unknown_network_names_the_nearest():
    with pytest.raises(UnknownNameError) as caught:
        make_network("gg-cnn2", 1)
    assert caught.value.nearest == "ggcnn2"
    assert caught.value.choices == tuple(NETWORKS)
