"""Layers, parameters and multiply-adds of the networks, and the pages that show them."""

from __future__ import annotations

import copy
import importlib
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from graspmap.networks import (
    NETWORKS,
    TaskSpec,
    make_network,
    multiply_adds,
    parameter_count,
    trace_layers,
)

ROOT = Path(__file__).parents[1]
TASKS = (TaskSpec("category", 5, 24), TaskSpec("saliency"), TaskSpec("graspness"))
PAGES = ("ggcnn", "ggcnn2", "grconvnet", "unet", "mtgcnn")


@pytest.fixture
def study(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    return importlib.import_module("studies.networks")


def network_of(name):
    with torch.device("meta"):
        return make_network(name, 3, 2, tasks=TASKS)


@pytest.mark.parametrize("name", NETWORKS)
@pytest.mark.parametrize("tasks", [False, True])
def test_multiply_adds_are_half_of_pytorchs_operations(name, tasks):
    network = network_of(name).eval()
    images = torch.empty(1, 3, 48, 60, device="meta")
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        network.outputs(images) if tasks else network(images)
    assert 2 * multiply_adds(network, 48, 60, tasks=tasks) == counter.get_total_flops()


@pytest.mark.parametrize("name", NETWORKS)
def test_layers_hold_all_parameters_but_those_of_batch_norm(name):
    network = network_of(name)
    before = copy.deepcopy(network)
    layers = trace_layers(network, 24, 24, tasks=True)
    norms = [m for m in network.modules() if isinstance(m, nn.BatchNorm2d)]
    found = sum(layer.parameters for layer in layers) + sum(map(parameter_count, norms))
    assert found == parameter_count(network)
    assert network.training
    assert [len(m._forward_hooks) for m in network.modules()] == [0 for _ in before.modules()]


def test_known_layers():
    (first, *_, head) = trace_layers(make_network("ggcnn", 1), 300, 300)
    assert (first.kind, first.kernel, first.stride, first.shape) == ("conv", 9, 3, (100, 100))
    assert first.multiply_adds == 81 * 32 * 100 * 100
    assert (head.name, head.outputs, head.shape) == ("heads.layer", 4, (300, 300))


@pytest.mark.parametrize("page", PAGES)
def test_pages_are_made_from_the_code(study, page):
    folder = ROOT / "docs" / "networks"
    text = (folder / f"{page}.md").read_text()
    assert text == study.filled(text, study.block(page)), "run: python -m studies networks"
    drawing = (folder / f"{page}.svg").read_text()
    assert drawing == study.svg(page), "run: python -m studies networks"
    ElementTree.fromstring(drawing)


def test_every_network_has_a_page(study):
    text = (ROOT / "docs" / "networks" / "README.md").read_text()
    assert text == study.filled(text, study.overview()), "run: python -m studies networks"
    assert tuple(study.PAGES) == PAGES
    assert set(NETWORKS) <= set(re.findall(r"`([\w-]+)`", text))
    assert all(f"{page}.md" in text for page in PAGES)
