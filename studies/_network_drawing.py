"""Drawings of networks as SVG, made from the layers that a picture really passes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.sax.saxutils import escape

from graspmap.networks import Layer

FILL = {
    "input": "#e9e9e9",
    "conv": "#9fc5e8",
    "transposed": "#f6b26b",
    "linear": "#c9a0dc",
    "head": "#93c47d",
}
SAID = {
    "input": "input",
    "conv": "convolution",
    "transposed": "transposed",
    "linear": "linear",
    "head": "head",
}
_TALL, _GAP, _LEFT = 110.0, 19.0, 16.0
_INK, _SOFT = "#333333", "#777777"


@dataclass
class Box:
    """A layer's output as a box; px of the drawing."""

    x: float
    y: float
    width: float
    height: float


@dataclass
class Drawing:
    """Boxes, lines and words that grow to the right and downwards."""

    parts: list[str] = field(default_factory=list)
    width: float = 0.0
    height: float = 0.0
    scale: float = 1.0

    def text(
        self, x: float, y: float, words: str, *, size: int = 9, color: str = _INK, anchor: str = ""
    ) -> None:
        """Words whose middle (or ``start``) is at x, on the base line y."""
        self.parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{color}" '
            f'text-anchor="{anchor or "middle"}">{escape(words)}</text>'
        )
        self.height = max(self.height, y + 6)

    def line(self, path: str, *, dashed: bool = False) -> None:
        """A path with an arrow at its end."""
        dash = ' stroke-dasharray="3 2"' if dashed else ""
        self.parts.append(
            f'<path d="{path}" fill="none" stroke="{_SOFT}"{dash} marker-end="url(#tip)"/>'
        )

    def box(self, x: float, middle: float, kind: str, channels: int, rows: int) -> Box:
        """The box of a feature map, with its channels above and its size below."""
        width = 7 + 2.6 * math.log2(channels + 1)
        height = max(8.0, _TALL * rows / self.scale)
        top = middle - height / 2
        self.parts.append(
            f'<rect x="{x:.1f}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}" '
            f'rx="1.5" fill="{FILL[kind]}" stroke="{_INK}" stroke-width="0.6"/>'
        )
        self.text(x + width / 2, top - 3, str(channels))
        self.width = max(self.width, x + width)
        self.height = max(self.height, top + height + 8)
        return Box(x, top, width, height)

    def svg(self, title: str) -> str:
        """The finished drawing."""
        width, height = math.ceil(self.width + _LEFT), math.ceil(self.height + 6)
        body = "\n".join(self.parts)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
            f'viewBox="0 0 {width} {height}" font-family="Helvetica, Arial, sans-serif">\n'
            f"<title>{escape(title)}</title>\n"
            '<defs><marker id="tip" viewBox="0 0 6 6" refX="5.5" refY="3" markerWidth="5" '
            f'markerHeight="5" orient="auto"><path d="M0 0L6 3L0 6z" fill="{_SOFT}"/></marker>'
            f'</defs>\n<rect width="100%" height="100%" fill="#ffffff"/>\n{body}\n</svg>\n'
        )


@dataclass(frozen=True)
class Row:
    """One network of a drawing.

    Args:
        title: What is written above it.
        side: Side of its input, px.
        channels: Channels of its input.
        layers: Its layers, in order.
        skips: Connections over other layers: from the output of the first to the second.
        sums: Whether they are added to its output, and not put beside its input.
        leaves: For each branch (a word in its layers' names) the layer that it leaves after.
    """

    title: str
    side: int
    channels: int
    layers: Sequence[Layer]
    skips: Sequence[tuple[str, str]] = ()
    sums: bool = False
    leaves: Mapping[str, str] = field(default_factory=dict)


def draw(rows: Sequence[Row], title: str) -> str:
    """An SVG with the networks below each other, and a legend."""
    drawing = Drawing(scale=max(row.side for row in rows))
    kinds = dict.fromkeys(["input", "head"])
    for row in rows:
        top = drawing.height + 12
        drawing.text(_LEFT, top + 6, row.title, size=12, anchor="start")
        kinds |= dict.fromkeys(_kind(layer) for layer in row.layers)
        lift = 26 if row.skips else 12
        middle = top + lift + 18 + _TALL / 2
        boxes = _trunk(drawing, row, middle)
        for start, end in row.skips:
            drawing.line(_skip(boxes[start], boxes[end], middle, sums=row.sums))
        for word, after in row.leaves.items():
            below, pooled = drawing.height + 20, after == "middle2"
            _branch(drawing, row, word, boxes[after], below, pooled=pooled)
    x, y = _LEFT, drawing.height + 14
    for kind in (k for k in FILL if k in kinds):
        drawing.parts.append(
            f'<rect x="{x:.1f}" y="{y - 8:.1f}" width="10" height="10" rx="1.5" '
            f'fill="{FILL[kind]}" stroke="{_INK}" stroke-width="0.6"/>'
        )
        drawing.text(x + 14, y, SAID[kind], anchor="start")
        x += 26 + 5.2 * len(SAID[kind])
    words = "above a box its channels; below it kernel, stride s, dilation d, and the side in px"
    drawing.text(_LEFT, y + 15, words, anchor="start", color=_SOFT)
    drawing.width = max(drawing.width, _LEFT + 4.6 * len(words))
    drawing.height = y + 21
    return drawing.svg(title)


def _skip(a: Box, b: Box, middle: float, *, sums: bool) -> str:
    """The path from one box to another: into what goes into it, or onto what comes out."""
    high = min(a.y, b.y) - 22 - 0.02 * (b.x - a.x)
    if sums:
        x0, x1 = a.x + a.width + 12, b.x + b.width + 6
        low, onto = a.y - 4, f"V{middle - 1:.1f}"
        start = f"M{x0:.1f} {middle:.1f}V{low:.1f}"
    else:
        x0, x1 = a.x + a.width / 2, b.x - 4
        low, onto = b.y - 2, ""
        start = f"M{x0:.1f} {a.y - 11:.1f}"
    return f"{start}C{x0:.1f} {high:.1f} {x1:.1f} {high:.1f} {x1:.1f} {low:.1f}{onto}"


def _trunk(drawing: Drawing, row: Row, middle: float) -> dict[str, Box]:
    """The layers that serve grasping, from left to right; their boxes by name."""
    box = drawing.box(_LEFT, middle, "input", row.channels, row.side)
    drawing.text(box.x + box.width / 2, middle + _TALL / 2 + 34, str(row.side), color=_SOFT)
    boxes, size = {"input": box}, row.side
    for layer in row.layers:
        if not layer.name.startswith("task_"):
            box = _layer(drawing, layer, box, size, middle)
            boxes[layer.name], size = box, layer.shape[0]
    words = ("quality, cos,", "sin, width")
    for i, text in enumerate(words):
        drawing.text(box.x + box.width + 5, middle - 3 + 11 * i, text, anchor="start")
    drawing.width = max(drawing.width, box.x + box.width + 64)
    return boxes


def _branch(
    drawing: Drawing, row: Row, word: str, source: Box, top: float, *, pooled: bool
) -> None:
    """The layers of one task, below the trunk."""
    own = (f"task_branches.{word}.", f"task_heads.{word}.")
    layers = [layer for layer in row.layers if layer.name.startswith(own)]
    middle = top + 6 + max(_TALL * layer.shape[0] / drawing.scale for layer in layers) / 2
    # From the arrow behind the source: there it is pooled already, and no words are below.
    start = source.x + source.width + _GAP * (0.45 if pooled else 0.4) + 12 * pooled
    box, size = Box(start, 0, 0, 0), 0
    bottom = source.y + source.height / 2
    for i, layer in enumerate(layers):
        box = _layer(drawing, layer, box, size, middle, arrow=i > 0)
        if i == 0:
            drawing.line(f"M{start:.1f} {bottom:.1f}V{middle:.1f}H{box.x - 2:.1f}", dashed=True)
        size = layer.shape[0]
    coarse = "" if size in (1, row.side) else f", enlarged x {row.side // size}"
    drawing.text(box.x + box.width + 5, middle + 3, f"{word}{coarse}", anchor="start")
    drawing.width = max(drawing.width, box.x + box.width + 70)


def _layer(
    drawing: Drawing, layer: Layer, before: Box, size: int, middle: float, *, arrow: bool = True
) -> Box:
    """One layer to the right of the box before it, with what happens on the way to it."""
    between = ""
    if size and layer.kind == "conv":
        taken = layer.shape[0] * layer.stride
        between = "pool" if taken < 0.6 * size else "x 2" if taken > 1.6 * size else ""
    x = before.x + before.width + _GAP + (12 if between else 0)
    if arrow:
        drawing.line(f"M{before.x + before.width + 1:.1f} {middle:.1f}H{x - 2:.1f}")
        drawing.text((before.x + before.width + x) / 2, middle - 4, between, color=_SOFT)
    box = drawing.box(x, middle, _kind(layer), layer.outputs, layer.shape[0])
    center, low = x + box.width / 2, middle + max(box.height, 8) / 2
    if layer.kind == "linear":
        drawing.text(center, low + 11, "all")
        return box
    low = max(low, middle + (_TALL / 2 if not layer.name.startswith("task_") else 0))
    drawing.text(center, low + 11, f"{layer.kernel} x {layer.kernel}")
    extra = f"s{layer.stride}" * (layer.stride > 1) + f"d{layer.dilation}" * (layer.dilation > 1)
    drawing.text(center, low + 22, extra)
    drawing.text(center, low + 34, str(layer.shape[0]), color=_SOFT)
    return box


def _kind(layer: Layer) -> str:
    return "head" if "heads." in layer.name and layer.kind == "conv" else layer.kind
