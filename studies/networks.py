"""Pages of the networks: drawings, layers, parameters and multiply-adds, made from the code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from graspmap.networks import (
    NETWORKS,
    GraspNetwork,
    Layer,
    TaskSpec,
    make_network,
    multiply_adds,
    parameter_count,
    trace_layers,
)
from studies._network_drawing import Row, draw

ABOUT = (
    "pages of the networks: drawings, layers, parameters, multiply-adds (rewrites docs/networks)"
)
FOLDER = Path(__file__).parents[1] / "docs" / "networks"
SIDES = (224, 300, 320)
BEGIN = "<!-- made by: python -m studies networks -->"
END = "<!-- end of what was made -->"
DEPTH = (TaskSpec("depth"),)


@dataclass(frozen=True)
class Shown:
    """A network as a page shows it.

    Args:
        name: Its name in the registry.
        title: What the drawing and the tables call it.
        channels: Channels of its input as published.
        tasks: Its tasks.
        same: Other names that have the same layers.
    """

    name: str
    title: str
    channels: int
    tasks: tuple[TaskSpec, ...] = ()
    same: tuple[str, ...] = ()

    def make(self, channels: int) -> GraspNetwork:
        """The network; shapes only."""
        with torch.device("meta"):
            return make_network(self.name, channels, tasks=self.tasks)


PAGES = {
    "ggcnn": (Shown("ggcnn", "GG-CNN", 1),),
    "ggcnn2": (
        Shown("ggcnn2", "GG-CNN2 of the thesis", 1),
        Shown("ggcnn2-bilinear", "GG-CNN2 as its authors trained it", 1),
    ),
    "grconvnet": (
        Shown("grconvnet", "GR-ConvNet 1, 2, 3", 4, same=("grconvnet2", "grconvnet3")),
        Shown("grconvnet4", "GR-ConvNet 4", 4),
    ),
    "unet": (Shown("unet", "U-Net", 4),),
    "mtgcnn": tuple(Shown(f"mtgcnn-{x}", f"MTG-CNN {x}", 3, DEPTH) for x in "abcd"),
}
"""Networks by page."""

_LEAVES = {"mtgcnn-a": "grow2", "mtgcnn-b": "dilated2", "mtgcnn-c": "middle2",
           "mtgcnn-d": "middle2"}  # fmt: skip


def svg(page: str) -> str:
    """The drawing of a page."""
    rows = []
    for shown in PAGES[page]:
        side = NETWORKS[shown.name].published_size_px
        layers = _layers(shown)
        leaves = {"depth": _LEAVES[shown.name]} if shown.tasks else {}
        title = f"{shown.title} ({side} px)"
        sums = shown.name.startswith("grconvnet")
        rows.append(Row(title, side, shown.channels, layers, _skips(shown.name), sums, leaves))
    return draw(rows, ", ".join(shown.title for shown in PAGES[page]))


def block(page: str) -> str:
    """The part of a page that is made from the code."""
    shown = PAGES[page]
    lines = [f"![Layers]({page}.svg)", "", *_costs(shown)]
    for one in shown:
        side = NETWORKS[one.name].published_size_px
        lines += ["", f"**{one.title}**, {one.channels} channel{'s' * (one.channels > 1)}, "
                  f"1 bin, {side} px:", "", *_layer_table(_layers(one))]  # fmt: skip
    return "\n".join(lines)


def overview() -> str:
    """The table of all networks."""
    lines = [
        "| network | page | parameters (published input) | multiply-adds at 300 px, millions |",
        "|---|---|---|---|",
    ]
    for page, all_shown in PAGES.items():
        for shown in all_shown:
            network = shown.make(shown.channels)
            names = ", ".join(f"`{name}`" for name in (shown.name, *shown.same))
            lines.append(
                f"| {names} | [{shown.title}]({page}.md) | {parameter_count(network):,} "
                f"({shown.channels}) | {_millions(network, 300, tasks=True)} |"
            )
    return "\n".join(lines)


def filled(text: str, made: str) -> str:
    """A page's text with what is made between its two marks.

    Raises:
        ValueError: The marks are missing.
    """
    before, _, rest = text.partition(f"{BEGIN}\n")
    _, end, after = rest.partition(END)
    if not end:
        raise ValueError(f"the page has no lines {BEGIN} and {END}")
    return f"{before}{BEGIN}\n{made}\n{END}{after}"


def run(out: Path = FOLDER) -> None:
    """Write the drawings, and the made parts of the pages, of ``out``."""
    for page in PAGES:
        (out / f"{page}.svg").write_text(svg(page))
        _rewrite(out / f"{page}.md", block(page))
    _rewrite(out / "README.md", overview())


def _rewrite(path: Path, made: str) -> None:
    path.write_text(filled(path.read_text(), made))
    print(path)


def _layers(shown: Shown) -> tuple[Layer, ...]:
    side = NETWORKS[shown.name].published_size_px
    return trace_layers(shown.make(shown.channels), side, side, tasks=True)


def _skips(name: str) -> list[tuple[str, str]]:
    """Connections over other layers."""
    if name.startswith("grconvnet"):
        blocks = [f"residual.{i}.layer2" for i in range(5)]
        return list(zip(["shrink3.layer", *blocks], blocks, strict=False))
    if name == "unet":
        return [(f"down{4 - i}.layer2", f"up{i}.merge.layer1") for i in range(1, 5)]
    return []


def _costs(all_shown: Sequence[Shown]) -> list[str]:
    head = "| network | parameters: 1 / 3 / 4 channels | millions of multiply-adds: "
    lines = [f"{head}{' / '.join(map(str, SIDES))} px |", "|---|---|---|"]
    for shown in all_shown:
        networks = [shown.make(channels) for channels in (1, 3, 4)]
        counts = " / ".join(f"{parameter_count(network):,}" for network in networks)
        for tasks in (False, True) if shown.tasks else (False,):
            own = shown.make(shown.channels)
            costs = " / ".join(_millions(own, side, tasks=tasks) for side in SIDES)
            what = "" if not shown.tasks else ", training" if tasks else ", detection"
            lines.append(f"| {shown.title}{what} | {counts} | {costs} |")
    return lines


def _layer_table(layers: Sequence[Layer]) -> list[str]:
    lines = [
        "| layer | kind | kernel | stride | dilation | channels | side | parameters "
        "| multiply-adds, millions |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    return lines + [
        f"| `{layer.name}` | {layer.kind} | {layer.kernel} | {layer.stride} | {layer.dilation} "
        f"| {layer.inputs} to {layer.outputs} | {layer.shape[0]} | {layer.parameters:,} "
        f"| {layer.multiply_adds / 1e6:.1f} |"
        for layer in layers
    ]


def _millions(network: GraspNetwork, side: int, *, tasks: bool) -> str:
    return f"{multiply_adds(network, side, side, tasks=tasks) / 1e6:,.0f}"
