"""Other people's GG-CNN weights: PyTorch state dicts in, our networks out, no code run.

A state dict is a dictionary of tensors, but the format it is kept in (pickle) can carry any
program. Only PyTorch's restricted reader is used here, which builds tensors and nothing else.
"""

from __future__ import annotations

import hashlib
import io
import pickle
import re
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from graspmap.data.images import Channels, channel_count
from graspmap.errors import InvalidInputError, UnknownNameError, WeightsError
from graspmap.inference.weights import (
    MOST_PX,
    View,
    WeightsCard,
    check_numbers,
    differences,
    is_safetensors,
    read_content,
    read_safetensors,
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
_CONVERT = (
    "if you trust it, open it with its authors' own code, write "
    "torch.save(model.state_dict(), 'weights.pt') and import that file"
)
_NO_STATE_DICT = "give a file written by torch.save(model.state_dict(), FILE)"


def import_weights(
    network_name: str,
    file: Path | str,
    *,
    width_scale: float = 150.0,
    size: int = 300,
    channels: Channels | None = None,
    view: View = "cover",
) -> tuple[GraspNetwork, WeightsCard]:
    """Read weights of GG-CNN or GG-CNN2 that were trained with other people's programs.

    The layers are matched by their order and shapes, the four heads by their names. Under
    ``ggcnn2`` both published forms are taken (transposed convolutions, or bilinear enlargement
    with convolutions); the shapes tell them apart, and the card names the one found.

    Args:
        network_name: One of `graspmap.networks.NETWORKS`.
        file: A state dict as PyTorch or safetensors file, possibly under a key such as
            ``state_dict`` or with a prefix such as ``module.``.
        width_scale: Opening in input pixels for which the width map is 1, as in its training.
        size: Side of the input it was trained with, pixels.
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
    _check_settings(width_scale, size, view)
    path = Path(file)
    content = read_content(path)
    tensors = _state_dict(path, _read(path, content))
    check_numbers(path, tensors)
    network = _fitted(path, network_name, tensors)
    card = WeightsCard(
        network=network.name,
        channels=_channels(path, network.channels, channels),
        bins=network.bins,
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
    if view not in ("contain", "cover") and (isinstance(view, str) or not 1 <= view <= MOST_PX):
        raise InvalidInputError(
            "view", repr(view), f"contain, cover, or a side in pixels, at most {MOST_PX}"
        )


def _read(path: Path, content: bytes) -> Any:
    """What the file holds, built of tensors and plain containers only."""
    if is_safetensors(content):
        tensors, metadata = read_safetensors(path, content)
        if "graspmap" in metadata:
            raise WeightsError(path, "is a weights file of graspmap already", "use it as it is")
        return tensors
    if content[:1] != b"\x80" and content[:2] != b"PK":
        raise WeightsError(path, "is neither a PyTorch nor a safetensors file", _NO_STATE_DICT)
    if content[:2] == b"PK":
        _check_archive(path, content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the errors below say it in one line
            return torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        named = re.search(r"(?:GLOBAL|class|function|type) ([\w.]+\.[\w.]+)", str(error))
        what = named[1] if named else "instructions that no state dict has"
        raise WeightsError(
            path,
            f"is refused, because opening it could run code: it holds {what}, and not only tensors",
            _CONVERT,
        ) from error
    except Exception as error:  # a damaged file can make PyTorch raise anything
        raise WeightsError(
            path,
            f"is cut short, damaged, or no PyTorch file ({_first_line(error)})",
            "copy or download it again",
        ) from error


def _check_archive(path: Path, content: bytes) -> None:
    """Tell PyTorch's own archives from other zip files."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError) as error:
        raise WeightsError(
            path, f"is cut short or damaged ({error})", "copy or download it again"
        ) from error
    if any(name.endswith("constants.pkl") for name in names):
        raise WeightsError(path, "is a TorchScript program, not a state dict", _CONVERT)
    if not any(name.endswith("data.pkl") for name in names):
        listed = ", ".join(sorted(names)[:5])
        raise WeightsError(
            path, f"is a zip archive of files ({listed})", "unpack it and import the state dict"
        )


def _state_dict(path: Path, loaded: Any) -> dict[str, Tensor]:
    """The dictionary of tensors inside what was read, without wrappers' prefixes."""
    for key in _CONTAINERS:
        if isinstance(loaded, Mapping) and isinstance(loaded.get(key), Mapping):
            loaded = loaded[key]
    if not isinstance(loaded, Mapping) or not loaded:
        raise WeightsError(path, f"holds a {type(loaded).__name__}", _NO_STATE_DICT)
    odd = [key for key, value in loaded.items() if not isinstance(value, Tensor)]
    if odd or not all(isinstance(key, str) for key in loaded):
        raise WeightsError(path, f"holds more than named tensors ({odd[:3]})", _NO_STATE_DICT)
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
    raise WeightsError(path, text, f"give weights of one of: {', '.join(NETWORKS)}")


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
    for order in (trunk, sorted(trunk, key=_natural)):
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
    network = make_network(name, first.shape[1], head.shape[0])
    renamed = _renamed(network, trunk, heads, tensors)
    problems = differences(network.state_dict(), renamed)
    if problems:
        return None, problems
    network.load_state_dict(renamed)
    return network, []


def _renamed(
    network: GraspNetwork, trunk: list[str], heads: list[str], tensors: dict[str, Tensor]
) -> dict[str, Tensor]:
    """The tensors under our names as far as they go; the rest keeps its names."""
    ours = [
        name
        for name, module in network.named_modules()
        if isinstance(module, nn.Conv2d | nn.ConvTranspose2d) and not name.startswith("heads.")
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


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0][:160] if str(error).strip() else type(error).__name__
