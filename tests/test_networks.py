"""Networks: against slow forwards written from the layer tables, and their laws."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.maps import GraspMaps
from graspmap.networks import NETWORKS, GraspNetwork, make_network, parameter_count

# (parameter name, kind, kernel, stride, padding, dilation, output padding); "pool" and "double"
# have no parameters. ReLU follows each convolution.
GGCNN_TABLE = [
    ("shrink1", "conv", 9, 3, 3, 1, 0),
    ("shrink2", "conv", 5, 2, 2, 1, 0),
    ("shrink3", "conv", 3, 2, 1, 1, 0),
    ("grow1", "transposed", 3, 2, 1, 1, 1),
    ("grow2", "transposed", 5, 2, 2, 1, 1),
    ("grow3", "transposed", 9, 3, 3, 1, 1),
]
GGCNN2_DOWN = [
    ("fine1", "conv", 11, 1, 5, 1, 0),
    ("fine2", "conv", 5, 1, 2, 1, 0),
    ("pool",),
    ("middle1", "conv", 5, 1, 2, 1, 0),
    ("middle2", "conv", 5, 1, 2, 1, 0),
    ("pool",),
    ("dilated1", "conv", 5, 1, 4, 2, 0),
    ("dilated2", "conv", 5, 1, 8, 4, 0),
]
GGCNN2_TABLE = [
    *GGCNN2_DOWN,
    ("grow1", "transposed", 3, 2, 1, 1, 1),
    ("grow2", "transposed", 3, 2, 1, 1, 1),
]
BILINEAR_TABLE = [
    *GGCNN2_DOWN,
    ("double",),
    ("grow1", "conv", 3, 1, 1, 1, 0),
    ("double",),
    ("grow2", "conv", 3, 1, 1, 1, 0),
]
TABLES = {
    "ggcnn": (GGCNN_TABLE, 2),
    "ggcnn2": (GGCNN2_TABLE, 1),
    "ggcnn2-bilinear": (BILINEAR_TABLE, 1),
}


def doubling_matrix(size: int) -> torch.Tensor:
    """(2 size, size) linear interpolation that keeps the corners on the corners."""
    at = np.linspace(0, size - 1, 2 * size)
    rows = [np.interp(at, np.arange(size), column) for column in np.eye(size)]
    return torch.from_numpy(np.stack(rows, axis=1))


def slow_forward(
    network: GraspNetwork, images: torch.Tensor, kind: torch.dtype = torch.float64
) -> list[torch.Tensor]:
    """The four maps, from the layer table and the parameters by name."""
    table, kernel = TABLES[network.name]
    p = {name: value.detach().contiguous().to(kind) for name, value in network.named_parameters()}
    x = images.to(kind)
    for name, *rest in table:
        if name == "pool":
            count, channels, rows, columns = x.shape
            blocks = x.reshape(count, channels, rows // 2, 2, columns // 2, 2)
            x = blocks.amax(dim=(3, 5))
            continue
        if name == "double":
            down, across = (doubling_matrix(side).to(x) for side in x.shape[2:])
            x = down @ x @ across.T
            continue
        form, size, stride, padding, dilation, extra = rest
        weight, bias = p[f"{name}.weight"], p[f"{name}.bias"]
        assert weight.shape[2:] == (size, size)
        if form == "conv":
            x = F.conv2d(x, weight, bias, stride, padding, dilation)
        else:
            x = F.conv_transpose2d(x, weight, bias, stride, padding, extra)
        x = x.clamp_min(0)
    weight, bias = p["heads.layer.weight"], p["heads.layer.bias"]
    assert weight.shape[2:] == (kernel, kernel)
    n = network.bins
    return [F.conv2d(x, weight[k * n : k * n + n], bias[k * n : k * n + n]) for k in range(4)]


def seeded(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize(("channels", "bins"), [(1, 1), (3, 2), (4, 3)])
def test_forward_agrees_with_the_layer_table(name, channels, bins):
    network = make_network(name, channels, bins, generator=seeded()).eval()
    images = torch.randn(2, channels, 48, 60, generator=seeded(1))
    with torch.inference_mode():
        maps = network(images)
    assert isinstance(maps, GraspMaps)
    for found, expected in zip(maps, slow_forward(network, images), strict=True):
        assert found.shape == (2, bins, 48, 60)
        assert (found - expected).abs().max() < 1e-5


@pytest.mark.parametrize("name", NETWORKS)
def test_published_size_agrees_with_the_layer_table(name):
    network = make_network(name, 1, generator=seeded(2)).eval()
    images = torch.randn(1, 1, 300, 300, generator=seeded(3))
    with torch.inference_mode():
        maps = network(images)
        slow = slow_forward(network, images, torch.float32)
    for found, expected in zip(maps, slow, strict=True):
        assert found.shape == (1, 1, 300, 300)
        assert (found - expected).abs().max() < 1e-5


@pytest.mark.parametrize(
    ("name", "channels", "bins", "count"),
    [
        ("ggcnn", 1, 1, 62_420),
        ("ggcnn", 4, 1, 70_196),
        ("ggcnn2", 1, 1, 66_676),
        ("ggcnn2", 3, 1, 70_548),
        ("ggcnn2", 4, 1, 72_484),
        ("ggcnn2-bilinear", 1, 1, 66_676),
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
@settings(max_examples=6)
def test_any_size_is_the_padded_one_cut_back(name, rows, columns, seed):
    network = make_network(name, 1, generator=seeded()).eval()
    images = torch.randn(1, 1, rows, columns, generator=seeded(seed))
    larger = torch.zeros(1, 1, 48, 48)
    step = network.granularity
    larger = larger[..., : -(-rows // step) * step, : -(-columns // step) * step].clone()
    larger[..., :rows, :columns] = images
    with torch.inference_mode():
        maps, reference = network(images), network(larger)
    for found, expected in zip(maps, reference, strict=True):
        assert found.shape == (1, 1, rows, columns)
        assert (found - expected[..., :rows, :columns]).abs().max() < 1e-5


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("channels", [1, 3])
def test_a_batch_is_its_pictures(name, channels):
    network = make_network(name, channels, 2, generator=seeded()).eval()
    images = torch.randn(3, channels, 24, 36, generator=seeded(4))
    with torch.inference_mode():
        together = network(images)
        for i in range(3):
            alone = network(images[i : i + 1])
            for a, b in zip(together.item(i), alone.item(0), strict=True):
                assert (a - b).abs().max() < 1e-5


@pytest.mark.parametrize("name", NETWORKS)
def test_layout_of_the_input_does_not_matter(name):
    network = make_network(name, 3, generator=seeded()).eval()
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
    network = make_network(name, 1, 2, generator=seeded(6)).double()
    images = torch.randn(1, 1, 12, 12, dtype=torch.float64, generator=seeded(7))
    # Random directions rather than all of the parameters: the error of any one would show.
    # Away from zero no ReLU sits on its kink.
    weights = [
        torch.randn(1, 2, 12, 12, dtype=torch.float64, generator=seeded(k)) for k in range(4)
    ]

    def value(net: GraspNetwork) -> torch.Tensor:
        return sum((w * m).sum() for w, m in zip(weights, net(images), strict=True))

    gradients = torch.autograd.grad(value(network), list(network.parameters()))
    step = 1e-7
    for parameter, gradient in zip(network.parameters(), gradients, strict=True):
        direction = torch.randn(parameter.shape, dtype=torch.float64, generator=seeded(8))
        with torch.no_grad():
            parameter += step * direction
            above = value(network)
            parameter -= 2 * step * direction
            below = value(network)
            parameter += step * direction
        slope = float((above - below) / (2 * step))
        assert slope == pytest.approx(float((gradient * direction).sum()), rel=1e-4, abs=1e-4)


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


def test_same_generator_same_weights():
    a = make_network("ggcnn", 4, 3, generator=seeded(9)).state_dict()
    b = make_network("ggcnn", 4, 3, generator=seeded(9)).state_dict()
    c = make_network("ggcnn", 4, 3, generator=seeded(10)).state_dict()
    assert all(torch.equal(a[name], b[name]) for name in a)
    assert not any(torch.equal(a[name], c[name]) for name in a)


def test_training_mode_works_and_copies_are_independent():
    network = make_network("ggcnn2", 1)
    twin = copy.deepcopy(network)
    network(torch.randn(2, 1, 20, 20)).quality.mean().backward()
    assert all(p.grad is not None for n, p in network.named_parameters() if "heads" not in n)
    assert all(p.grad is None for p in twin.parameters())


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
