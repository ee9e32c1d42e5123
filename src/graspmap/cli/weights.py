"""``graspmap weights``: what ships, what a card says, and weights files made of other files."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from graspmap.cli.frame import option, output_file, parse, teller, write_json
from graspmap.errors import InvalidInputError, UnknownNameError

if TYPE_CHECKING:
    from graspmap.data.windows import View

_HELP = """usage: graspmap weights list [--json F]
       graspmap weights show W [--json F]
       graspmap weights import NETWORK FILE OUT.safetensors [options]
       graspmap weights calibrate W --data KIND:DIR --out OUT.safetensors [options]
       graspmap weights note W --evaluation DIR --out OUT.safetensors [options]

A weights file carries a card: which network, for which pictures, trained on what, how well it does.
W is such a file, or the name of weights that ship with graspmap.

  list       the weights that ship
  show       a card in words
  import     turn other people's PyTorch state dict into a weights file, without running its code
  calibrate  make the quality of its grasps the probability that they hold, by trials in physics
  note       put the numbers of an evaluation, and known weaknesses, into the card

Examples:
  graspmap weights show ggcnn2.safetensors
  graspmap weights import ggcnn2 ggcnn2_epoch_50_cornell_statedict.pt ggcnn2.safetensors

graspmap weights COMMAND --help lists the options of one."""

_COMMANDS = {
    "list": ("graspmap.cli.weights_cards", "list_"),
    "show": ("graspmap.cli.weights_cards", "show"),
    "import": ("graspmap.cli.weights", "import_"),
    "calibrate": ("graspmap.cli.weights_calibrate", "calibrate"),
    "note": ("graspmap.cli.weights_cards", "note"),
}
"""Module and function of each command."""


@dataclass(frozen=True)
class Import:
    """Turn other people's weights into a weights file of graspmap, without running their code.

    Example:
      graspmap weights import ggcnn2 ggcnn2_epoch_50_cornell_statedict.pt ggcnn2.safetensors
    """

    network: Annotated[tyro.conf.Positional[str], option("NETWORK")]
    """Which network it is: ggcnn, ggcnn2 (with transposed layers, or bilinear as published),
    grconvnet, grconvnet2, grconvnet3, grconvnet4 or unet."""
    file: Annotated[tyro.conf.Positional[Path], option("FILE")]
    """The state dict: a .pt or .pth file of PyTorch (also TorchScript), or a .safetensors file."""
    out: Annotated[tyro.conf.Positional[Path], option("OUT.safetensors")]
    """The weights file to write; a readable card OUT.json is written beside it."""
    width_scale: Annotated[float, option("PX", "default: 150, as the published weights have")] = (
        150.0
    )
    """Opening in input pixels that the network's width map shows as 1."""
    size: Annotated[int | None, option("PX", "default: 300; 224 for GR-ConvNet, 320 for U-Net")] = (
        None
    )
    """Side of the square input that it was trained with."""
    channels: Annotated[
        Literal["depth", "rgb", "rgbd"] | None,
        option("depth|rgb|rgbd", "default: told from their number"),
    ] = None
    """What it looks at."""
    view: Annotated[str, option("cover|contain|PX|'CM cm'", "default: cover")] = "cover"
    """Which square of a picture fills the input: the shorter side, the longer side, a side in
    pixels about the middle, or one in centimetres ('36 cm') about what stands on the table."""
    json: Annotated[Path | None, option("F")] = None
    """Write the card as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap weights``."""
    if not argv or argv[0] in ("-h", "--help"):
        print(_HELP)
        return 0 if argv else 2
    if argv[0] not in _COMMANDS:
        raise UnknownNameError("weights command", argv[0], _COMMANDS)
    home, name = _COMMANDS[argv[0]]
    command: Callable[[Sequence[str]], None] = getattr(importlib.import_module(home), name)
    command(argv[1:])
    return 0


def import_(argv: Sequence[str]) -> None:
    """Run ``graspmap weights import``."""
    flags = parse(Import, argv, "graspmap weights import")
    output_file(flags.out, "OUT", (".safetensors",), keep=[flags.file])
    output_file(flags.json, "--json", keep=[flags.file, flags.out])
    from graspmap.inference import import_weights, save_weights
    from graspmap.networks import parameter_count

    network, card = import_weights(
        flags.network,
        flags.file,
        width_scale=flags.width_scale,
        size=flags.size,
        channels=flags.channels,
        view=_view(flags.view),
    )
    save_weights(flags.out, network, card)
    tell = teller(flags.json)
    tell(
        f"{flags.out}: {card.network}, {card.channels}, {card.bins} bin(s), "
        f"{parameter_count(network):,} parameters, input {card.size} px, width scale "
        f"{card.width_scale_px:g} px"
    )
    write_json(card.model_dump(mode="json"), flags.json)


def _view(text: str) -> View:
    from graspmap.data.windows import VIEW_ALLOWED, close_up_m

    view = int(text) if text.isdecimal() else text
    try:
        close_up_m(view)
    except InvalidInputError:
        raise InvalidInputError("--view", repr(text), VIEW_ALLOWED) from None
    return view
