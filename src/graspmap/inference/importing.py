"""Other people's weights of GG-CNN, GR-ConvNet and U-Net in, our networks out, no code run."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from graspmap.data.images import Channels, channel_count
from graspmap.data.windows import MOST_PX, View, close_up_m
from graspmap.errors import InvalidInputError, UnknownNameError, WeightsError
from graspmap.inference.foreign_files import NO_STATE_DICT, read_foreign
from graspmap.inference.weights import (
    MOST_FILTERS,
    WeightsCard,
    check_numbers,
    differences,
    read_content,
)
from graspmap.networks import MAP_NAMES, NETWORKS, GraspNetwork, make_network

_VARIANTS = {"ggcnn2": ("ggcnn2", "ggcnn2-bilinear")}
"""Networks that are published under one name; the tensors' shapes tell which one it is."""

_HEAD_WORDS = {
    "quality": {"pos", "position", "quality"},
    "cos": {"cos", "cosine"},
    "sin": {"sin", "sine"},
    "width": {"width"},
}
_WRAPPERS = ("module.", "model.", "network.", "net.", "_orig_mod.")
_CONTAINERS = ("state_dict", "model_state_dict", "model", "network", "net")
_GRCONVNET_LAYERS = (
    *(f"{kind}{i}" for i in (1, 2, 3) for kind in ("conv", "bn")),
    *(f"res{i}.{kind}{k}" for i in range(1, 6) for k in (1, 2) for kind in ("conv", "bn")),
    *("conv4", "bn4", "conv5", "bn5", "conv6"),
)
"""The usual names of GR-ConvNet's layers, in the order in which a picture passes them."""


def import_weights(
    network_name: str,
    file: Path | str,
    *,
    width_scale: float = 150.0,
    size: int | None = None,
    channels: Channels | None = None,
    view: View = "cover",
) -> tuple[GraspNetwork, WeightsCard]:
    """Read weights that were trained with other people's programs.

    The layers are matched by their order and shapes, the four heads by their names; GR-ConvNet's
    layers by their usual names (``conv1``, ``bn1``, ..., ``res1.conv1``, ...) where it has those.
    Under ``ggcnn2`` both published forms are taken (transposed convolutions, or bilinear
    enlargement with convolutions); the shapes tell them apart, and the card names the one found.
    The width of GR-ConvNet and U-Net is told from the shapes. GR-ConvNet 1 to 3 differ in
    training only, so weights of any of them fit all three.

    Args:
        network_name: One of `graspmap.networks.NETWORKS`.
        file: A state dict as PyTorch or safetensors file, possibly under a key such as
            ``state_dict`` or with a prefix such as ``module.``; or a TorchScript file, of which
            only the tensors are read.
        width_scale: Opening in input pixels for which the width map is 1, as in its training.
        size: Side of the input it was trained with, pixels; by default the published one, 300,
            for GR-ConvNet 224 and for U-Net 320.
        channels: What it sees; by default told from its number of channels (1 ``depth``,
            3 ``rgb``, 4 ``rgbd``).
        view: Centre square of a picture that fills the input, see `WeightsCard`.

    Returns:
        The network in evaluation mode, float32, on the CPU, and its card.

    Raises:
        UnknownNameError: There is no such network, or no such kind of channels.
        MissingFileError: There is no such file.
        WeightsError: The file would run code (it is not opened further), is damaged, holds
            something else, or does not fit the network; the error lists what differs.
        InvalidInputError: width_scale or size is not above 0, or there is no such view.
    """
    if network_name not in NETWORKS:
        raise UnknownNameError("network", network_name, NETWORKS)
    size = NETWORKS[network_name].published_size_px if size is None else size
    _check_settings(width_scale, size, view)
    path = Path(file)
    content = read_content(path)
    tensors = _state_dict(path, read_foreign(path, content))
    check_numbers(path, tensors)
    network = _fitted(path, network_name, tensors)
    card = WeightsCard(
        network=network.name,
        channels=_channels(path, network.channels, channels),
        bins=network.bins,
        filters=None if network.filters == network.published_filters else network.filters,
        size=size,
        view=view,
        width_scale_px=width_scale,
        notes=f"imported from {path.name}, blake2b "
        f"{hashlib.blake2b(content, digest_size=16).hexdigest()}",
    )
    return network.eval(), card


def _check_settings(width_scale: float, size: int, view: View) -> None:
    if not 0 < width_scale < float("inf"):
        raise InvalidInputError("width_scale", width_scale, "pixels above 0")
    if not 1 <= size <= MOST_PX:
        raise InvalidInputError("size", size, f"pixels, from 1 to {MOST_PX}")
    close_up_m(view)


def _state_dict(path: Path, loaded: Any) -> dict[str, Tensor]:
    """The dictionary of tensors inside what was read, without wrappers' prefixes."""
    for key in _CONTAINERS:
        if isinstance(loaded, Mapping) and isinstance(loaded.get(key), Mapping):
            loaded = loaded[key]
    if not isinstance(loaded, Mapping) or not loaded:
        raise WeightsError(path, f"holds a {type(loaded).__name__}", NO_STATE_DICT)
    odd = [key for key, value in loaded.items() if not isinstance(value, Tensor)]
    if odd or not all(isinstance(key, str) for key in loaded):
        raise WeightsError(path, f"holds more than named tensors ({odd[:3]})", NO_STATE_DICT)
    tensors = dict(loaded)
    while prefix := _common_prefix(tensors):
        tensors = {name.removeprefix(prefix): tensor for name, tensor in tensors.items()}
    return tensors


def _common_prefix(tensors: Mapping[str, Tensor]) -> str | None:
    return next((p for p in _WRAPPERS if all(name.startswith(p) for name in tensors)), None)


def _fitted(path: Path, network_name: str, tensors: dict[str, Tensor]) -> GraspNetwork:
    """The network that takes the tensors, filled with them."""
    problems: list[str] = []
    for name in _VARIANTS.get(network_name, (network_name,)):
        network, found = _match(name, tensors)
        if network is not None:
            return network
        problems = problems or found
    other = next((name for name in NETWORKS if _match(name, tensors)[0] is not None), None)
    text = f"does not fit {network_name}: {'; '.join(problems)}"
    if other is not None:
        raise WeightsError(
            path, f"{text}; it holds a {other}", f"import it with: graspmap weights import {other}"
        )
    known = [name for name, network in NETWORKS.items() if not network.needs_task]
    raise WeightsError(path, text, f"give weights of one of: {', '.join(known)}")


def _match(name: str, tensors: dict[str, Tensor]) -> tuple[GraspNetwork | None, list[str]]:
    """Network ``name`` filled with the tensors, or None and what differs."""
    if NETWORKS[name].needs_task:
        return None, ["nobody publishes it under layer names that are known here"]
    layers = list(dict.fromkeys(key.rpartition(".")[0] for key in tensors))
    heads = {k: [m for m in layers if _is_head(m, k)] for k in MAP_NAMES}
    wrong = [f"{len(found)} layers for {k}" for k, found in heads.items() if len(found) != 1]
    if wrong:
        return None, [f"{text}, 1 expected" for text in wrong]
    trunk = [m for m in layers if not any(m in found for found in heads.values())]
    problems: list[str] = []
    # PyTorch's files keep the layers in the order they were made in, safetensors in none.
    orders = [trunk, sorted(trunk, key=_natural)]
    if set(trunk) == set(_GRCONVNET_LAYERS):
        orders = [list(_GRCONVNET_LAYERS)]
    for order in orders:
        network, found = _match_in_order(name, order, [heads[k][0] for k in MAP_NAMES], tensors)
        if network is not None:
            return network, []
        problems = found
    return None, problems


def _match_in_order(
    name: str, trunk: list[str], heads: list[str], tensors: dict[str, Tensor]
) -> tuple[GraspNetwork | None, list[str]]:
    """`_match` for layers whose order in the network is known."""
    first = tensors.get(f"{trunk[0]}.weight") if trunk else None
    head = tensors.get(f"{heads[0]}.weight")
    if first is None or head is None or first.ndim != 4 or head.ndim != 4:
        return None, ["its first layer or its heads are no convolutions"]
    if not first.shape[1] or not head.shape[0]:
        return None, ["its first layer or its heads hold no numbers"]
    filters = None if NETWORKS[name].published_filters is None else first.shape[0]
    if filters is not None and filters > MOST_FILTERS:
        return None, [f"its first layer has {filters} filters, {MOST_FILTERS} at most are allowed"]
    try:
        with torch.device("meta"):  # shapes without numbers: most networks will not fit
            outline = make_network(name, first.shape[1], head.shape[0], filters=filters)
    except InvalidInputError as error:
        return None, [str(error)]
    renamed = _renamed(outline, trunk, heads, tensors)
    problems = differences(outline.state_dict(), renamed)
    if problems:
        return None, problems
    network = make_network(name, first.shape[1], head.shape[0], filters=filters)
    network.load_state_dict(renamed)
    return network, []


def _renamed(
    network: GraspNetwork, trunk: list[str], heads: list[str], tensors: dict[str, Tensor]
) -> dict[str, Tensor]:
    """The tensors under our names as far as they go; the rest keeps its names."""
    kinds = (nn.Conv2d, nn.ConvTranspose2d, nn.BatchNorm2d)
    ours = [
        name
        for name, module in network.named_modules()
        if isinstance(module, kinds) and not name.startswith("heads.")
    ]
    rename = dict(zip(trunk, ours, strict=False))
    result: dict[str, Tensor] = {}
    for key, tensor in tensors.items():
        layer, _, kind = key.rpartition(".")
        if layer not in heads:
            result[f"{rename.get(layer, layer)}.{kind}"] = tensor
    for kind in ("weight", "bias"):
        parts = [tensors[f"{head}.{kind}"] for head in heads if f"{head}.{kind}" in tensors]
        if len(parts) == len(heads) and len({part.shape for part in parts}) == 1:
            result[f"heads.layer.{kind}"] = torch.cat(parts)
    return result


def _is_head(layer: str, map_name: str) -> bool:
    return bool(_HEAD_WORDS[map_name] & set(re.split(r"[._\d]+", layer.lower())))


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key under which ``conv10`` comes after ``conv9``."""
    return [(int(p), "") if p.isdigit() else (-1, p) for p in re.split(r"(\d+)", name) if p]


def _channels(path: Path, count: int, said: Channels | None) -> Channels:
    by_count: dict[int, Channels] = {1: "depth", 3: "rgb", 4: "rgbd"}
    if said is None and count in by_count:
        return by_count[count]
    if said is None or channel_count(said) != count:
        allowed = by_count.get(count, "1, 3 or 4 channels")
        raise WeightsError(
            path, f"takes {count} channel(s), not those of {said}", f"allowed here: {allowed}"
        )
    return said
