"""The doctor's look at weights files: which network they fit, without running what they hold."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from graspmap.doctor.report import Report, Update, nothing
from graspmap.errors import DatasetNotFoundError, GraspmapError, WeightsError
from graspmap.inference import WeightsCard, import_weights, load_weights
from graspmap.networks import NETWORKS, GraspNetwork, parameter_count

WEIGHTS_SUFFIXES = (".safetensors", ".pt", ".pth")


def examine_weights(root: Path, *, progress: Update = nothing, **_: Any) -> Report:
    """Look through weights files: graspmap's own, and other people's state dicts.

    Args:
        root: A folder (subfolders too) or one file.
        progress: Called with (done, total).

    Raises:
        DatasetNotFoundError: There is no weights file.
    """
    paths = [root] if root.is_file() else sorted(root.rglob("*"))
    paths = [path for path in paths if path.suffix.lower() in WEIGHTS_SUFFIXES]
    if not paths:
        raise DatasetNotFoundError(
            root, f"holds no {', '.join(WEIGHTS_SUFFIXES)} file", "name the folder of the weights"
        )
    report = Report("weights", root)
    items: dict[str, dict[str, Any]] = {}
    for done, path in enumerate(paths):
        progress(done, len(paths))
        try:
            network, card, own = _open(path)
        except GraspmapError as error:
            problem = getattr(error, "problem", str(error))
            remedy = getattr(error, "remedy", "")
            report.complain(path, f"{problem}; {remedy}" if remedy else problem)
            continue
        name = path.name if root.is_file() else str(path.relative_to(root))
        items[name] = _facts(network, card, own)
        report.say(name, _sentence(items[name], path))
    report.count = len(items)
    report.good_for = ("detect", "evaluate") if items else ()
    report.facts["items"] = items
    return report


def _open(path: Path) -> tuple[GraspNetwork, WeightsCard, bool]:
    """The network in a file, its card, and whether the file is graspmap's own.

    Raises:
        GraspmapError: The file fits no known network, is damaged, or would run code.
    """
    if path.suffix.lower() == ".safetensors":
        try:
            return *load_weights(path), True
        except WeightsError as own_error:
            if "card" not in own_error.problem:
                raise
            first: GraspmapError = own_error
    else:
        first = WeightsError(path, "fits no network", "see graspmap weights import --help")
    misfits = []
    for name in NETWORKS:
        try:
            return *import_weights(name, path), False
        except WeightsError as error:
            misfits.append(error)
    # All networks fail in the same words when the file itself is at fault.
    if len({error.problem for error in misfits}) == 1:
        raise misfits[0]
    raise first


def _facts(network: GraspNetwork, card: WeightsCard, own: bool) -> dict[str, Any]:
    return {
        "network": card.network,
        "channels": card.channels,
        "input_channels": network.channels,
        "bins": network.bins,
        "parameters": parameter_count(network),
        "graspmap": own,
        "width_scale_px": card.width_scale_px if own else None,
        "size": card.size if own else None,
    }


def _sentence(item: dict[str, Any], path: Path) -> str:
    text = (
        f"{item['network']}, {item['input_channels']} input channel"
        f"{'s' * (item['input_channels'] > 1)} ({item['channels']}), {item['bins']} orientation "
        f"bin{'s' * (item['bins'] > 1)}, {item['parameters']:,} parameters"
    )
    if item["graspmap"]:
        return (
            f"{text}, input {item['size']} px, width scale {item['width_scale_px']:g} px; "
            f"ready for: graspmap detect --weights {path}"
        )
    out = f"{path.stem}.safetensors"
    return f"{text}; bring it in: graspmap weights import {item['network']} {path} {out}"
