"""Tasks of the networks: heads against their formulas, where branches leave, decoding."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.maps import GraspMaps
from graspmap.networks import NETWORKS, Outputs, TaskSpec, make_network, parameter_count

pytestmark = pytest.mark.usefixtures("one_thread")

NARROW = {"unet": 4, **{f"grconvnet{i}": 4 for i in ("", 2, 3, 4)}}
CATEGORY = TaskSpec("category", 7, 24)
IMAGES = (TaskSpec("saliency"), TaskSpec("depth"))
ORANGE = (TaskSpec("graspness"), TaskSpec("orientation", 2))
ALL = (CATEGORY, *IMAGES, *ORANGE)


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def network_of(name, tasks=ALL, bins=2, channels=1):
    filters = NARROW.get(name)
    return make_network(
        name, channels, bins, tasks=tasks, filters=filters, generator=seeded()
    ).eval()


@pytest.mark.parametrize("name", NETWORKS)
@given(rows=st.integers(1, 40), columns=st.integers(1, 40))
@settings(max_examples=3)
def test_shapes_and_types_at_any_size(name, rows, columns):
    network = network_of(name)
    images = torch.randn(2, 1, rows, columns, generator=seeded(1))
    with torch.inference_mode():
        outputs = network.outputs(images)
    assert outputs.maps.quality.shape == (2, 2, rows, columns)
    assert {name: tuple(t.shape) for name, t in outputs.tasks.items()} == {
        "category": (2, 7),
        "saliency": (2, 1, rows, columns),
        "depth": (2, 1, rows, columns),
        "graspness": (2, 1, rows, columns),
        "orientation": (2, 2, rows, columns),
    }
    assert all(t.dtype == torch.float32 for t in outputs.tasks.values())
    assert all(t.is_contiguous() and t.isfinite().all() for t in outputs.tasks.values())


@pytest.mark.parametrize("name", NETWORKS)
def test_quality_is_multiplied_by_what_orange_says(name):
    network = network_of(name)
    images = torch.randn(1, 1, 24, 28, generator=seeded(2))
    with torch.inference_mode():
        maps, outputs = network(images), network.outputs(images)
        probability = 1 / (1 + torch.exp(-outputs.tasks["graspness"].double()))
        probability = probability / (1 + torch.exp(-outputs.tasks["orientation"].double()))
        expected = outputs.maps.quality * probability
    assert (maps.quality - expected).abs().max() < 1e-5
    for k in ("cos", "sin", "width"):
        assert torch.equal(getattr(maps, k), getattr(outputs.maps, k))
    assert torch.equal(outputs.decoded().quality, maps.quality)


def test_each_bin_has_its_own_orientation_probability():
    maps = GraspMaps(*(torch.ones(1, 3, 2, 2) for _ in range(4)))
    logits = torch.tensor([-30.0, 0.0, 30.0])[None, :, None, None].expand(1, 3, 2, 2)
    quality = Outputs(maps, {"orientation": logits, "category": torch.ones(1, 4)}).decoded().quality
    assert torch.allclose(quality[0, :, 1, 0], torch.tensor([0.0, 0.5, 1.0]), atol=1e-6)


@pytest.mark.parametrize("name", NETWORKS)
def test_auxiliary_tasks_do_not_change_the_maps_and_are_not_computed(name):
    network = network_of(name, (CATEGORY, *IMAGES))
    images = torch.randn(1, 1, 24, 24, generator=seeded(2))
    called = []
    for task, head in network.task_heads.items():
        head.register_forward_hook(lambda *_, task=task: called.append(task))
    with torch.inference_mode():
        maps = network(images)
        assert called == []
        for a, b in zip(maps, network.outputs(images).maps, strict=True):
            assert torch.equal(a, b)
    assert called == ["category", "saliency", "depth"]
    if not NETWORKS[name].needs_task:
        with torch.inference_mode():
            alone = network_of(name, ())(images)
        assert torch.equal(alone.quality, maps.quality)


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("task", [CATEGORY, *IMAGES, *ORANGE], ids=lambda task: task.name)
def test_gradient_of_a_task_reaches_its_layers_and_no_others(name, task):
    tasks = (task, TaskSpec("depth" if task.name == "saliency" else "saliency"))
    if task.name == "depth":
        tasks = (task, CATEGORY)
    network = network_of(name, tasks)
    outputs = network.outputs(torch.randn(1, 1, 24, 24, generator=seeded(3)))
    outputs.tasks[task.name].square().sum().backward()
    reached = {n for n, p in network.named_parameters() if p.grad is not None}
    trunk = {n for n, _ in network.named_parameters() if not n.startswith(("heads.", "task_"))}
    tail = {n for n in trunk if n.startswith(("dilated", "grow"))}
    shared = trunk
    if name.startswith("mtgcnn") and task.name not in ("graspness", "orientation"):
        grow = {n for n in tail if n.startswith("grow")}
        shared = trunk - {"a": set(), "b": grow, "c": tail, "d": tail}[name[-1]]
        own = {"a": set(), "b": grow, "c": tail, "d": set()}[name[-1]]
        shared = shared | {f"task_branches.{task.name}.{n}" for n in own}
    head = {n for n, _ in network.named_parameters() if n.startswith(f"task_heads.{task.name}.")}
    assert reached == shared | head


@pytest.mark.parametrize("name", [n for n in NETWORKS if NETWORKS[n].needs_task])
def test_grasp_loss_does_not_reach_the_branch(name):
    network = network_of(name, IMAGES)
    network.outputs(torch.randn(1, 1, 24, 24)).maps.cos.sum().backward()
    reached = {n for n, p in network.named_parameters() if p.grad is not None}
    assert reached == {n for n, _ in network.named_parameters() if not n.startswith("task_")}


@pytest.mark.parametrize(
    ("name", "channels", "tasks", "count"),
    [
        # one 1 x 1 layer over 16 features, on a trunk of 70,548
        ("mtgcnn-a", 3, IMAGES[:1], 70_548 + 17),
        ("mtgcnn-d", 3, IMAGES[:1], 70_548 + 17),
        # two transposed layers more
        ("mtgcnn-b", 3, IMAGES[:1], 70_548 + 17 + (32 + 16) * 16 * 9 + 32),
        ("mtgcnn-c", 3, IMAGES[:1], 115_973),
        ("mtgcnn-c", 3, IMAGES[1:], 115_973),
        ("mtgcnn-c", 4, IMAGES[1:], 115_973 + 16 * 121),
        # each task has a branch
        ("mtgcnn-c", 3, IMAGES, 115_973 + 115_973 - 70_548),
        # 300 px: 90,000 pixels to 512 to 256 to 80 classes; a quarter of the side for d
        ("mtgcnn-a", 3, (TaskSpec("category", 80, 300),),
         70_548 + 17 + 90_001 * 512 + 513 * 256 + 257 * 80),
        ("mtgcnn-d", 3, (TaskSpec("category", 80, 300),),
         70_548 + 17 + 5_626 * 512 + 513 * 256 + 257 * 80),
        # 2 x 2 heads over 32 features
        ("grconvnet", 4, ORANGE[:1], 1_900_900 + 129),
        ("unet", 4, (TaskSpec("orientation", 1),), 14_789_700 + 65),
    ],
)  # fmt: skip
def test_parameter_counts(name, channels, tasks, count):
    with torch.device("meta"):
        assert parameter_count(make_network(name, channels, tasks=tasks)) == count


def slow_category(network, features):
    """The head's formula on (B, F, S, S) features, in float64."""
    p = {n: v.detach().double() for n, v in network.task_heads["category"].state_dict().items()}
    x = F.conv2d(features.double(), p["layer.weight"], p["layer.bias"]).clamp_min(0)
    x = x.reshape(len(x), -1) @ p["hidden1.weight"].T + p["hidden1.bias"]
    x = x.clamp_min(0) @ p["hidden2.weight"].T + p["hidden2.bias"]
    return x.clamp_min(0) @ p["classes.weight"].T + p["classes.bias"]


@pytest.mark.parametrize("name", ["ggcnn2", "ggcnn", "mtgcnn-d", "unet"])
def test_category_head_is_what_the_formula_says(name):
    network = network_of(name, (CATEGORY,), channels=3)
    images = torch.randn(2, 3, 24, 24, generator=seeded(4))
    with torch.inference_mode():
        features = network.branches(images, ["category"])[1]["category"]
        found = network.outputs(images).tasks["category"]
        assert (found - slow_category(network, features)).abs().max() < 1e-5


def test_category_of_other_sizes_averages_the_features():
    network = network_of("ggcnn2", (TaskSpec("category", 3, 12),))
    features = torch.rand(1, 16, 12, 12, generator=seeded(5))
    head = network.task_heads["category"]
    with torch.inference_mode():
        expected = head(features, (12, 12), (12, 12))
        larger = features.repeat_interleave(2, 2).repeat_interleave(3, 3)
        assert (head(larger, (24, 36), (24, 36)) - expected).abs().max() < 1e-5
        # what was padded does not count
        padded = F.pad(larger, (0, 4, 0, 8), value=50.0)
        assert (head(padded, (32, 40), (24, 36)) - expected).abs().max() < 1e-5


def test_coarse_pictures_keep_their_place():
    # A coarse cell covers 4 x 4 pixels; its middle is where they meet.
    network = network_of("mtgcnn-d", IMAGES[:1])
    head = network.task_heads["saliency"]
    features = torch.zeros(1, 16, 8, 8)
    features[..., 3, 5] = 1
    with torch.no_grad():
        head.layer.weight.fill_(1)
        head.layer.bias.zero_()
        picture = head(features, (32, 32), (32, 30))[0, 0]
    assert picture.shape == (32, 30)
    total = picture.sum()
    rows, columns = torch.arange(32.0), torch.arange(30.0)
    assert float((picture.sum(1) * rows).sum() / total) == pytest.approx(3 * 4 + 1.5)
    assert float((picture.sum(0) * columns).sum() / total) == pytest.approx(5 * 4 + 1.5)


def test_dropout_of_the_category_head_is_off_outside_training():
    network = network_of("ggcnn2", (CATEGORY,))
    images = torch.randn(1, 1, 24, 24)
    with torch.no_grad():
        still = [network.outputs(images).tasks["category"] for _ in range(2)]
        network.train()
        moving = [network.outputs(images).tasks["category"] for _ in range(2)]
    assert torch.equal(*still)
    assert not torch.equal(*moving)


@pytest.mark.parametrize("name", [n for n in NETWORKS if NETWORKS[n].needs_task])
def test_mtg_cnn_needs_an_auxiliary_task(name):
    for tasks in ((), ORANGE):
        with pytest.raises(InvalidInputError, match=f"tasks of {name} is .*allowed: at least one"):
            make_network(name, 1, 2, tasks=tasks)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("saliency", 2), "outputs of the task saliency is 2; allowed: 1"),
        (("category", 0, 300), "1 to 4096"),
        (("category", True, 300), "1 to 4096"),
        (("category", 80), "size of the task category is 0; allowed: the side of the input"),
        (("category", 80, 10_000), "1 to 1024 px"),
        (("depth", 1, 300), "size of the task depth is 300; allowed: 0"),
        (("orientation", 10**6), "1 to 4096"),
    ],
)
def test_wrong_tasks(arguments, words):
    with pytest.raises(InvalidInputError) as caught:
        TaskSpec(*arguments)
    assert words in str(caught.value)


def test_unknown_task_names_the_nearest():
    with pytest.raises(UnknownNameError) as caught:
        TaskSpec("salience")
    assert caught.value.nearest == "saliency"


def test_tasks_that_do_not_go_together():
    with pytest.raises(InvalidInputError, match="each task once"):
        make_network("ggcnn", 1, tasks=[TaskSpec("depth"), TaskSpec("depth")])
    with pytest.raises(InvalidInputError, match="3, the bins of the network"):
        make_network("ggcnn", 1, 3, tasks=[TaskSpec("orientation", 2)])
