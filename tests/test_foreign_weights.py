"""Other people's GR-ConvNet and U-Net weights, and TorchScript files, honest and hostile."""

from __future__ import annotations

import io
import os
import pickle
import zipfile

import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import nn
from torch.nn import functional as F

from graspmap.errors import WeightsError
from graspmap.inference import import_weights, load_weights, save_weights
from graspmap.inference.foreign_files import read_foreign

pytestmark = [
    pytest.mark.usefixtures("one_thread"),
    pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning"),
]
HEADS = ("pos", "cos", "sin", "width")


class PublishedBlock(nn.Module):
    """A residual block with its usual layer names."""

    def __init__(self, width):
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, 3, padding=1)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)
        self.bn2 = nn.BatchNorm2d(width)

    def forward(self, x):
        return x + self.bn2(self.conv2(torch.relu(self.bn1(self.conv1(x)))))


class PublishedGRConvNet(nn.Module):
    """GR-ConvNet with its usual layer names, written here a second time."""

    def __init__(self, channels=4, bins=1, widths=(8, 16, 32)):
        super().__init__()
        a, b, c = widths
        down = [(channels, a, 9, 1, 4), (a, b, 4, 2, 1), (b, c, 4, 2, 1)]
        for i, sizes in enumerate(down, start=1):
            self.add_module(f"conv{i}", nn.Conv2d(*sizes))
            self.add_module(f"bn{i}", nn.BatchNorm2d(sizes[1]))
        for i in range(1, 6):
            self.add_module(f"res{i}", PublishedBlock(c))
        self.conv4 = nn.ConvTranspose2d(c, b, 4, 2, 1, output_padding=1)
        self.bn4 = nn.BatchNorm2d(b)
        self.conv5 = nn.ConvTranspose2d(b, a, 4, 2, 2, output_padding=1)
        self.bn5 = nn.BatchNorm2d(a)
        self.conv6 = nn.ConvTranspose2d(a, a, 9, 1, 4)
        for name in HEADS:
            self.add_module(f"{name}_output", nn.Conv2d(a, bins, 2))

    def forward(self, x):
        x = torch.relu(self.bn1(self.conv1(x)))
        x = torch.relu(self.bn2(self.conv2(x)))
        x = torch.relu(self.bn3(self.conv3(x)))
        x = self.res5(self.res4(self.res3(self.res2(self.res1(x)))))
        x = torch.relu(self.bn4(self.conv4(x)))
        x = self.conv6(torch.relu(self.bn5(self.conv5(x))))
        return self.pos_output(x), self.cos_output(x), self.sin_output(x), self.width_output(x)


class PublishedUNet(nn.Module):
    """U-Net with other names."""

    def __init__(self, channels=4, bins=1, c=4):
        super().__init__()

        def double(i, o):
            layers = []
            for j in (i, o):
                layers += [nn.Conv2d(j, o, 3, padding=1), nn.BatchNorm2d(o), nn.ReLU()]
            return nn.Sequential(*layers)

        sizes = [channels, c, 2 * c, 4 * c, 8 * c, 8 * c]
        self.inc = double(*sizes[:2])
        self.downs = nn.ModuleList(double(*sizes[i : i + 2]) for i in range(1, 5))
        self.ups = nn.ModuleList()
        for i, o in ((8, 4), (4, 2), (2, 1), (1, 1)):
            up = nn.ConvTranspose2d(i * c, i * c, 2, 2)
            self.ups.append(nn.ModuleList([up, double(2 * i * c, o * c)]))
        for name in HEADS:
            self.add_module(f"{name}_decoder", nn.Conv2d(c, bins, 1))

    def forward(self, x):
        kept = [self.inc(x)]
        for down in self.downs:
            kept.append(down(F.max_pool2d(kept[-1], 2)))
        x = kept.pop()
        for up, double in self.ups:
            across, x = kept.pop(), up(x)
            rows, columns = (a - b for a, b in zip(across.shape[2:], x.shape[2:], strict=True))
            x = double(torch.cat([across, F.pad(x, (0, columns, 0, rows))], 1))
        return tuple(getattr(self, f"{name}_decoder")(x) for name in HEADS)


def used(network, channels=4):
    """The network after some training steps' worth of batch statistics, in evaluation mode."""
    torch.manual_seed(3)
    with torch.no_grad():
        for _ in range(3):
            network(torch.randn(2, channels, 32, 32))
    return network.eval()


def assert_same_maps(ours, theirs, side=44):
    images = torch.randn(2, ours.channels, side, side)
    with torch.inference_mode():
        for a, b in zip(ours(images), theirs(images), strict=True):
            assert (a - b).abs().max() < 1e-5


WIDTHS = {"grconvnet": (8, 16, 32), "grconvnet3": (12, 24, 48), "grconvnet4": (8, 4, 2)}


@pytest.mark.parametrize("form", ["pt", "sorted safetensors", "script", "trace", "half"])
@pytest.mark.parametrize("name", WIDTHS)
def test_grconvnet_gives_the_same_maps(tmp_path, name, form):
    theirs = used(PublishedGRConvNet(widths=WIDTHS[name], bins=3))
    path = tmp_path / "w.pt"
    if form == "half":
        theirs = theirs.half()
    if form in ("pt", "half"):
        torch.save({f"module.{k}": v for k, v in theirs.state_dict().items()}, path)
    elif form == "script":
        torch.jit.save(torch.jit.script(theirs), path)
    elif form == "trace":
        torch.jit.save(torch.jit.trace(theirs, torch.randn(1, 4, 32, 32)), path)
    else:
        safetensors.torch.save_file(dict(sorted(theirs.state_dict().items())), path)
    network, card = import_weights(name, path)
    assert (card.network, card.channels, card.bins, card.size) == (name, "rgbd", 3, 224)
    assert card.filters == WIDTHS[name][0] == network.filters
    assert_same_maps(network, theirs.float())
    # running statistics and their count came along, also through our own format
    save_weights(tmp_path / "w.safetensors", network, card)
    state = load_weights(tmp_path / "w.safetensors")[0].state_dict()
    assert torch.equal(state["shrink2.norm.running_var"], theirs.bn2.running_var)
    assert torch.equal(state["residual.4.norm1.running_mean"], theirs.res5.bn1.running_mean)
    assert int(state["grow2.norm.num_batches_tracked"]) == 3


def test_published_width_is_not_noted(tmp_path):
    theirs = PublishedGRConvNet(widths=(32, 64, 128))
    torch.save(theirs.state_dict(), tmp_path / "w.pt")
    assert import_weights("grconvnet2", tmp_path / "w.pt")[1].filters is None


@pytest.mark.parametrize("form", ["pt", "script"])
def test_unet_gives_the_same_maps(tmp_path, form):
    theirs = used(PublishedUNet(3, 2), 3)
    path = tmp_path / "w.pt"
    if form == "pt":
        torch.save(theirs.state_dict(), path)
    else:
        torch.jit.save(torch.jit.trace(theirs, torch.randn(1, 3, 32, 32)), path)
    network, card = import_weights("unet", path)
    assert (card.channels, card.bins, card.filters, card.size) == ("rgb", 2, 4, 320)
    assert_same_maps(network, theirs)


def refusal(path, name="grconvnet"):
    with pytest.raises(WeightsError) as caught:
        import_weights(name, path)
    assert caught.value.path == path
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_does_not_fit_is_said(tmp_path):
    path, state = tmp_path / "w.pt", PublishedGRConvNet().state_dict()
    torch.save(state, path)
    assert "it holds a grconvnet; import it with" in refusal(path, "unet")
    assert "it holds a grconvnet; import it with" in refusal(path, "grconvnet4")
    assert "nobody publishes it" in refusal(path, "mtgcnn-c")
    torch.save({k: v for k, v in state.items() if "running_var" not in k}, path)
    assert "shrink1.norm.running_var is missing" in refusal(path)
    torch.save({k: v for k, v in state.items() if not k.startswith("res5")}, path)
    assert "does not fit grconvnet" in refusal(path)
    assert "mtgcnn" not in refusal(path)
    torch.save(state | {"res3.conv1.weight": state["res3.conv1.weight"][:, :9]}, path)
    assert "residual.2.layer1.weight is (32, 9, 3, 3) instead of (32, 32, 3, 3)" in refusal(path)
    torch.save(state | {"bn1.num_batches_tracked": torch.tensor(3, dtype=torch.int16)}, path)
    assert "int16" in refusal(path)
    torch.save(state | {"conv1.weight": torch.zeros(5000, 4, 9, 9)}, path)
    assert "5000 filters, 256 at most" in refusal(path)
    torch.save(PublishedGRConvNet(widths=(6, 3, 2)).state_dict(), path)
    assert "a multiple of 4" in refusal(path, "grconvnet4")


@pytest.mark.parametrize("new", [True, False])
def test_whole_networks_are_refused_with_a_way_to_convert_them(tmp_path, new):
    path = tmp_path / "epoch_30_iou_0.97"
    torch.save(PublishedGRConvNet(), path, _use_new_zipfile_serialization=new)
    text = refusal(path)
    assert "PublishedGRConvNet" in text
    assert "could run code" in text
    assert "torch.save(model.state_dict(), 'weights.pt')" in text


# --- TorchScript files that are not what they seem


def script(tmp_path):
    """A small program's file, as name and content of its parts."""
    path = tmp_path / "script.pt"
    torch.jit.save(torch.jit.script(nn.Sequential(nn.Conv2d(1, 2, 3), nn.BatchNorm2d(2))), path)
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def packed(parts, compression=zipfile.ZIP_STORED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def test_script_holds_what_pytorch_reads(tmp_path):
    content = packed(script(tmp_path))
    found = read_foreign(tmp_path / "w.pt", content)
    expected = torch.jit.load(io.BytesIO(content)).state_dict()
    assert list(found) == list(expected)
    assert all(torch.equal(found[name], tensor) for name, tensor in expected.items())
    assert all(found[name].dtype == tensor.dtype for name, tensor in expected.items())


class Hostile:
    def __init__(self, call, *arguments):
        self.parts = call, arguments

    def __reduce__(self):
        return self.parts


def test_program_of_a_script_is_never_run(tmp_path):
    trap, path = tmp_path / "owned", tmp_path / "w.pt"
    parts = script(tmp_path)
    path.write_bytes(packed(parts))
    first = next(name for name in parts if name.endswith("data.pkl"))
    for hostile in (
        Hostile(os.mkdir, str(trap)),
        Hostile(getattr, Hostile(__import__, "os"), "mkdir"),
        Hostile(eval, "__import__('os').mkdir('owned')"),
    ):
        for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
            path.write_bytes(packed(parts | {first: pickle.dumps(hostile, protocol)}))
            text = refusal(path)
            assert "could run code" in text or "damaged" in text
            assert not trap.exists()
    # Nor is the program itself looked at.
    code = {name: b"def __setstate__(self): raise" for name in parts if "/code/" in name}
    assert code
    assert list(read_foreign(path, packed(parts | code)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: {n: v[:4] if n.endswith("data/0") else v for n, v in p.items()}, "larger"),
        (lambda p: {n: v for n, v in p.items() if not n.endswith("data/0")}, "data/0"),
        (lambda p: {n: b"big" if n.endswith("order") else v for n, v in p.items()}, "big-endian"),
        (lambda p: {n: v[:90] if n.endswith("data.pkl") else v for n, v in p.items()}, "damaged"),
        (lambda p: p | {"other/data.pkl": b""}, "damaged"),
        (lambda _: {"x/model.json": b"", "x/tensors/0": b""}, "before PyTorch 1.4"),
    ],
)
def test_damaged_scripts(tmp_path, change, words):
    path = tmp_path / "w.pt"
    path.write_bytes(packed(change(script(tmp_path))))
    assert words in refusal(path)


def test_packed_scripts_are_refused(tmp_path):
    path = tmp_path / "w.pt"
    path.write_bytes(packed(script(tmp_path), zipfile.ZIP_DEFLATED))
    assert "compressed" in refusal(path)


@given(at=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255))
@settings(max_examples=60)
def test_one_changed_byte_is_refused_or_harmless(tmp_path, at, value):
    parts = script(tmp_path)
    name = next(name for name in parts if name.endswith("data.pkl"))
    changed = bytearray(parts[name])
    changed[int(at * len(changed))] = value
    try:
        found = read_foreign(tmp_path / "w.pt", packed(parts | {name: bytes(changed)}))
    except WeightsError:
        return
    assert all(isinstance(tensor, torch.Tensor) for tensor in found.values())
