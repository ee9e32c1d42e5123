"""Weights files: safetensors with a JSON card inside, written and read as one thing.

A weights file says by itself what it is for (network, channels, bins, input size, width scale)
and where it comes from. It holds numbers and text only, so opening one never runs code.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Final, Literal

import safetensors.torch
import torch
from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError
from safetensors import SafetensorError
from torch import Tensor

from graspmap import __version__
from graspmap.data.images import Channels, DepthZero, channel_count
from graspmap.data.windows import MOST_PX, View
from graspmap.errors import (
    FileFormatError,
    GraspmapError,
    InvalidInputError,
    WeightsError,
)
from graspmap.files import read_bytes, write_bytes
from graspmap.inference.measured import CalibrationCard, EvaluationCard
from graspmap.networks import GraspNetwork, TaskSpec, make_network

FORMAT: Final = 1
"""Version of the card; a newer one is refused rather than misread."""

MOST_BINS, MOST_FILTERS = 1024, 256
"""A card that asks for more is a damaged or a hostile one: it would only fill the memory."""

SUFFIX = ".safetensors"
_CARD_KEY = "graspmap"
_NOTES = {
    "data", "seed", "metrics", "calibration", "evaluations", "weaknesses", "command",
    "created_by", "licence", "notes",
}  # fmt: skip
"""What of a card changes nothing of what a detector says; of the calibration the knots do."""

_IMPORT = "turn it into one with: graspmap weights import NETWORK FILE OUT.safetensors"
_AGAIN = "copy or download it again, or train anew"


class DataCard(BaseModel):
    """What a network was trained on.

    Attributes:
        source: Data set as ``kind:directory``.
        data_hash: Of all of its scenes, see `graspmap.data.fingerprint.data_hash`.
        depth: Which of its depths, for example ``stereo``; None for its kind's default.
        split: Name or file of the split.
        split_hash: Hash of the split's content.
        store_key: Key of the packed cache, which is a hash over all source files.
        scenes: Number of scenes by part.
        validation_source: Data set of the validation part, where it is another one.
        validation_key: Key of its packed cache.
        test_source: Data set of the test part, where it is another one.
        test_key: Key of its packed cache.
        classes: Class names of the category task, in the order of its outputs.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    source: str
    data_hash: str | None = None
    depth: str | None = None
    split: str | None = None
    split_hash: str | None = None
    store_key: str | None = None
    scenes: dict[str, int] = Field(default_factory=dict)
    validation_source: str | None = None
    validation_key: str | None = None
    test_source: str | None = None
    test_key: str | None = None
    classes: tuple[str, ...] = ()


class WeightsCard(BaseModel):
    """What a weights file is for and where it comes from.

    Attributes:
        format: Version of this card.
        network: Name of the network, see `graspmap.networks.NETWORKS`.
        channels: What it sees: ``depth``, ``rgb``, or ``rgbd`` (depth first).
        bins: Orientation bins.
        tasks: What it learned beside grasping, and has heads for.
        filters: Width of its layers, where it is not the published one.
        size: Side of the square input, pixels.
        view: Square of a picture that fills the input: ``contain``, ``cover``, a side in pixels,
            or one in centimetres, see `graspmap.data.input_window`.
        depth_zero: What its depth is measured from, see `graspmap.data.to_input`.
        width_scale_px: Opening in input pixels for which the width map is 1.
        data: What it was trained on, where known.
        seed: Of the training, where known.
        metrics: Measured figures of the training by name.
        calibration: From its quality to the probability that a grasp holds; None: not known.
        evaluations: What was measured of it afterwards, by name of the data's part.
        weaknesses: Where it is known to fail, in words.
        command: Command that made it, where known.
        created_by: Program and version that wrote it.
        licence: SPDX name of the licence that it may be used under; None: not known.
        notes: Anything else, in words.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    format: Literal[1] = FORMAT
    network: str
    channels: Channels
    bins: int = Field(default=1, ge=1, le=MOST_BINS)
    tasks: tuple[TaskSpec, ...] = ()
    filters: int | None = Field(default=None, ge=1, le=MOST_FILTERS)
    size: int = Field(default=300, ge=1, le=MOST_PX)
    view: View = "cover"
    depth_zero: DepthZero = "mean"
    width_scale_px: float = Field(gt=0, allow_inf_nan=False)
    data: DataCard | None = None
    seed: int | None = None
    metrics: dict[str, JsonValue] = Field(default_factory=dict)
    calibration: CalibrationCard | None = None
    evaluations: dict[str, EvaluationCard] = Field(default_factory=dict)
    weaknesses: tuple[str, ...] = ()
    command: str | None = None
    created_by: str = f"graspmap {__version__}"
    licence: str | None = None
    notes: str = ""

    @property
    def trial_success(self) -> float | None:
        """Share of the trials that held, over all of its evaluations; None where it has none."""
        made = [e.trials for e in self.evaluations.values() if e.trials is not None]
        count = sum(trials.trials for trials in made)
        return sum(t.success * t.trials for t in made) / count if count else None

    @property
    def calibration_error(self) -> float | None:
        """Expected calibration error, mean over the trials of its evaluations; None: unknown."""
        trials = [e.trials for e in self.evaluations.values() if e.trials is not None]
        made = [(t.quality.ece, t.trials) for t in trials if t.quality is not None]
        count = sum(number for _, number in made)
        return sum(error * number for error, number in made) / count if count else None

    def make_network(self) -> GraspNetwork:
        """A network of this card's kind with random weights.

        Raises:
            UnknownNameError: This version of graspmap has no such network.
            InvalidInputError: It has no such tasks or filters.
        """
        return make_network(
            self.network,
            channel_count(self.channels),
            self.bins,
            tasks=self.tasks,
            filters=self.filters,
        )


def save_weights(path: Path | str, network: GraspNetwork, card: WeightsCard) -> None:
    """Write a network and its card; a file that exists is replaced in one step.

    The card is stored inside the file, and once more beside it as ``<name>.json`` for people to
    read; the one inside counts.

    Args:
        path: File to write; its name ends in ``.safetensors``.
        network: The network.
        card: What it is for.

    Raises:
        InvalidInputError: The card is for another network, channel count or number of bins.
        FileFormatError: The name ends otherwise.
        FileError: The disk is full, or writing there is not allowed.
    """
    path = Path(path)
    if path.suffix != SUFFIX:
        raise FileFormatError(path, "a weights file needs another name", f"end it in {SUFFIX}")
    if path.is_dir():
        raise FileFormatError(path, "is a folder", "give the name of a file")
    filters = network.published_filters if card.filters is None else card.filters
    tasks = [tuple(t.name for t in whose.tasks) for whose in (network, card)]
    found = (network.name, network.channels, network.bins, network.filters, tasks[0])
    said = (card.network, channel_count(card.channels), card.bins, filters, tasks[1])
    if found != said or network.tasks != card.tasks:
        what = "card (network, channels, bins, filters, tasks)"
        raise InvalidInputError(what, said, f"the network's {found}")
    text = card.model_dump_json(indent=2)
    tensors = {name: t.detach().cpu().contiguous() for name, t in network.state_dict().items()}
    # A single metadata key: with more, safetensors writes them in an order that changes by run.
    write_bytes(path, safetensors.torch.save(tensors, {_CARD_KEY: text}))
    write_bytes(path.with_suffix(".json"), f"{text}\n".encode())


def load_weights(path: Path | str) -> tuple[GraspNetwork, WeightsCard]:
    """Read a weights file of graspmap.

    Args:
        path: A file written by `save_weights`.

    Returns:
        The network in evaluation mode, float32, on the CPU, and its card.

    Raises:
        MissingFileError: There is no such file.
        WeightsError: It is damaged, is not of graspmap, needs a newer version, or its tensors do
            not fit the network that its card names.
    """
    path = Path(path)
    tensors, card = _read(path)
    try:
        with torch.device("meta"):  # shapes without numbers, however large the card's network is
            outline = card.make_network()
    except GraspmapError as error:
        raise WeightsError(path, f"its card does not work here ({error})", _AGAIN) from error
    problems = differences(outline.state_dict(), tensors)
    if problems:
        raise WeightsError(
            path,
            f"does not hold the {card.network} with {card.channels} input and {card.bins} bin(s) "
            f"that its card names: {'; '.join(problems)}",
            _AGAIN,
        )
    check_numbers(path, tensors)
    network = card.make_network()
    network.load_state_dict(tensors)
    return network.eval(), card


def read_card(path: Path | str) -> WeightsCard:
    """The card of a weights file of graspmap, without making its network.

    Raises:
        MissingFileError: There is no such file.
        WeightsError: It is damaged, is not of graspmap, or needs a newer version.
    """
    return _read(Path(path))[1]


def weights_hash(network: GraspNetwork, card: WeightsCard) -> str:
    """32 hexadecimal digits that change with whatever changes what a detector says of a picture.

    Notes in the card change nothing; its calibration does.
    """
    what = card.model_dump_json(exclude=_NOTES, exclude_defaults=True)
    digest = hashlib.blake2b(what.encode(), digest_size=16)
    if card.calibration is not None:
        digest.update(json.dumps(card.calibration.knots).encode())
    for name, tensor in network.state_dict().items():
        digest.update(name.encode())
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def _read(path: Path) -> tuple[dict[str, Tensor], WeightsCard]:
    content = read_content(path)
    refuse_pytorch(path, content)
    tensors, metadata = read_safetensors(path, content)
    if _CARD_KEY not in metadata:
        raise WeightsError(path, "holds tensors but no card of graspmap", _IMPORT)
    return tensors, _read_card(path, metadata[_CARD_KEY])


def read_content(path: Path) -> bytes:
    """The bytes of a weights file (they are small: a few MB).

    Raises:
        MissingFileError: There is no such file.
        WeightsError: It is a folder or empty.
        FileError: It may not be read.
    """
    try:
        return read_bytes(path)
    except FileFormatError as error:
        raise WeightsError(path, error.problem, "give a weights file") from error


def is_safetensors(content: bytes) -> bool:
    """Whether the bytes begin as safetensors do: a length below 4 GB, then a JSON object.

    To be asked first: the length may happen to look like the first bytes of another format.
    """
    return content[4:9] == b"\0\0\0\0{"


def refuse_pytorch(path: Path, content: bytes) -> None:
    """Raise a `WeightsError` for PyTorch's own formats, which may carry code."""
    if not is_safetensors(content) and (content[:2] == b"PK" or content[:1] == b"\x80"):
        raise WeightsError(
            path, "is a PyTorch or pickle file, not a weights file of graspmap", _IMPORT
        )


def read_safetensors(path: Path, content: bytes) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and metadata of a safetensors file.

    Raises:
        WeightsError: The bytes are not whole safetensors.
    """
    if not is_safetensors(content):
        raise WeightsError(path, "is not a safetensors file", "give a weights file of graspmap")
    try:
        tensors = safetensors.torch.load(content)
        # safetensors has checked the header by now; it does not hand out its metadata.
        length = int.from_bytes(content[:8], "little")
        metadata = json.loads(content[8 : 8 + length]).get("__metadata__") or {}
    except (SafetensorError, ValueError, KeyError, RecursionError) as error:
        raise WeightsError(path, f"is cut short or damaged ({error})", _AGAIN) from error
    return tensors, metadata


def differences(expected: dict[str, Tensor], found: dict[str, Tensor], most: int = 4) -> list[str]:
    """What distinguishes two sets of tensors in names and shapes, in words, ``most`` at most."""
    lines = [
        f"{name} is missing"
        if name not in found
        else f"{name} is {tuple(found[name].shape)} instead of {tuple(tensor.shape)}"
        for name, tensor in expected.items()
        if name not in found or found[name].shape != tensor.shape
    ]
    lines += [f"{name} is unknown" for name in found if name not in expected]
    return lines if len(lines) <= most else [*lines[:most], f"and {len(lines) - most} more"]


def check_numbers(path: Path, tensors: dict[str, Tensor]) -> None:
    """Raise a `WeightsError` unless all tensors hold finite floating-point numbers."""
    for name, tensor in tensors.items():
        if not _is_plain(name, tensor):
            raise WeightsError(
                path,
                f"{name} is of type {tensor.dtype} in layout {tensor.layout}, {_stored(tensor)}",
                "give a file with dense tensors of 16, 32 or 64-bit floating-point numbers",
            )
        if not bool(tensor.isfinite().all()):
            raise WeightsError(
                path, f"{name} holds NaN or infinite numbers", "train anew with a lower rate"
            )


def _is_plain(name: str, tensor: Tensor) -> bool:
    """Whether every number of the tensor is in memory, in a type that all operations know."""
    if tensor.layout != torch.strided or tensor.device.type != "cpu":
        return False
    known = [torch.float16, torch.bfloat16, torch.float32, torch.float64]
    if name.endswith(".num_batches_tracked"):  # batch norm's only whole number
        known.append(torch.int64)
    return tensor.dtype in known and _stored_bytes(tensor) >= tensor.numel() * tensor.itemsize


def _stored_bytes(tensor: Tensor) -> int:
    return tensor.untyped_storage().nbytes()


def _stored(tensor: Tensor) -> str:
    if tensor.layout != torch.strided or tensor.device.type != "cpu":
        return f"on the device {tensor.device}"
    return f"{_stored_bytes(tensor)} bytes for {tensor.numel()} numbers"


def _read_card(path: Path, text: str) -> WeightsCard:
    try:
        version = json.loads(text)["format"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise WeightsError(path, "its card is damaged", _AGAIN) from error
    if version != FORMAT:
        raise WeightsError(
            path,
            f"its card has format {version}, this graspmap ({__version__}) reads {FORMAT}",
            "install the version of graspmap that wrote it, or a newer one",
        )
    try:
        return WeightsCard.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "card"
        raise WeightsError(path, f"its card is wrong at {key}: {first['msg']}", _AGAIN) from error
