"""Weights files: round trips, other people's state dicts, and everything that must be refused."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pickle
import zipfile
from collections import OrderedDict

import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from torch import nn

from graspmap.errors import (
    FileError,
    FileFormatError,
    InvalidInputError,
    MissingFileError,
    UnknownNameError,
    WeightsError,
)
from graspmap.inference import DataCard, WeightsCard, import_weights, load_weights, save_weights
from graspmap.networks import NETWORKS, TaskSpec, make_network

pytestmark = pytest.mark.usefixtures("one_thread")

COUNT = {"depth": 1, "rgb": 3, "rgbd": 4}


def card_for(network="ggcnn2", channels="depth", bins=1, **more):
    return WeightsCard(network=network, channels=channels, bins=bins, width_scale_px=150, **more)


def network_for(card, seed=0):
    generator = torch.Generator().manual_seed(seed)
    kind = (card.network, COUNT[card.channels], card.bins)
    more = {"tasks": card.tasks, "filters": card.filters}
    return make_network(*kind, **more, generator=generator).eval()


@pytest.fixture
def weights(tmp_path):
    """A whole weights file of a small network."""
    path = tmp_path / "weights.safetensors"
    save_weights(path, network_for(card_for()), card_for())
    return path


# --- our own files


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize(("channels", "bins"), [("depth", 1), ("rgb", 3), ("rgbd", 6)])
def test_round_trip(tmp_path, network, channels, bins):
    tasks = (TaskSpec("category", 5, 24), TaskSpec("graspness"), TaskSpec("orientation", bins))
    card = card_for(
        network,
        channels,
        bins,
        tasks=tasks if NETWORKS[network].needs_task or bins == 3 else (),
        filters=4 if NETWORKS[network].published_filters else None,
        view=480,
        data=DataCard(source="cornell:x", split="s.json", scenes={"train": 3}),
        metrics={"success": {"0.25": 0.5}, "epochs": 3},
        command="graspmap train x.yaml",
    )
    original, path = network_for(card), tmp_path / "w.safetensors"
    save_weights(path, original, card)
    loaded, read = load_weights(path)
    assert read == card
    assert not loaded.training
    for name, tensor in original.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], tensor)
    images = torch.randn(1, COUNT[channels], 24, 24)
    with torch.inference_mode():
        for a, b in zip(original(images), loaded(images), strict=True):
            assert torch.equal(a, b)


def test_same_weights_same_bytes(tmp_path):
    paths = [tmp_path / name for name in ("a.safetensors", "b.safetensors")]
    for path in paths:
        save_weights(path, network_for(card_for()), card_for())
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_the_card_beside_is_a_copy_and_the_one_inside_counts(weights):
    beside = weights.with_suffix(".json")
    assert json.loads(beside.read_text()) == card_for().model_dump(mode="json")
    beside.unlink()
    assert load_weights(weights)[1] == card_for()


def test_other_programs_can_read_the_tensors(weights):
    tensors = safetensors.torch.load_file(weights)
    assert sum(t.numel() for t in tensors.values()) == 66_676


def test_writing_leaves_nothing_but_the_two_files(weights):
    save_weights(weights, network_for(card_for(), seed=1), card_for())
    assert sorted(p.name for p in weights.parent.iterdir()) == [
        "weights.json",
        "weights.safetensors",
    ]


def test_a_failed_write_leaves_the_old_file(weights, monkeypatch):
    before = weights.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(FileError, match="disk is full"):
        save_weights(weights, network_for(card_for(), seed=1), card_for())
    assert weights.read_bytes() == before
    assert len(list(weights.parent.iterdir())) == 2


@given(
    card=st.builds(
        WeightsCard,
        network=st.sampled_from(list(NETWORKS)),
        channels=st.sampled_from(list(COUNT)),
        bins=st.integers(1, 20),
        size=st.integers(1, 5000),
        view=st.sampled_from(["contain", "cover"]) | st.integers(1, 5000),
        width_scale_px=st.floats(1e-3, 1e6),
        metrics=st.dictionaries(st.text(), st.floats(allow_nan=False, allow_infinity=False)),
        data=st.none() | st.builds(DataCard, source=st.text()),
        command=st.none() | st.text(),
        notes=st.text(),
    )
)
@settings(max_examples=50)
def test_any_card_survives_json(card):
    assert WeightsCard.model_validate_json(card.model_dump_json()) == card


@pytest.mark.parametrize(
    "wrong",
    [
        {"bins": 0},
        {"size": 0},
        {"view": "fit"},
        {"view": 0},
        {"epochs": 3},
        {"channels": "grey"},
        {"bins": 10**9},
        {"size": 10**6},
        {"view": 10**12},
    ],
)
def test_wrong_cards(wrong):
    with pytest.raises(ValidationError):
        WeightsCard(**{"network": "ggcnn", "channels": "rgb", "width_scale_px": 1.0, **wrong})


def test_the_card_must_fit_the_network(tmp_path):
    for card in (card_for("ggcnn"), card_for(channels="rgb"), card_for(bins=2)):
        with pytest.raises(InvalidInputError):
            save_weights(tmp_path / "w.safetensors", network_for(card_for()), card)
    with pytest.raises(FileFormatError, match="safetensors"):
        save_weights(tmp_path / "w.pt", network_for(card_for()), card_for())
    assert not list(tmp_path.iterdir())


def test_missing_folder_empty_and_foreign_files(tmp_path, weights):
    with pytest.raises(MissingFileError):
        load_weights(tmp_path / "none.safetensors")
    bad = tmp_path / "bad.safetensors"
    for content, word in (
        (b"", "empty"),
        (b"hello, this is text", "not a safetensors file"),
        (bytes(range(256)), "not a safetensors file"),
        (safetensors.torch.save({"a": torch.zeros(2)}), "graspmap weights import"),
    ):
        bad.write_bytes(content)
        with pytest.raises(WeightsError, match=word) as caught:
            load_weights(bad)
        assert caught.value.path == bad
    for legacy in (True, False):
        torch.save({"a": torch.zeros(2)}, bad, _use_new_zipfile_serialization=legacy)
        with pytest.raises(WeightsError, match="graspmap weights import"):
            load_weights(bad)
    with pytest.raises(WeightsError, match="folder"):
        load_weights(tmp_path)


@given(share=st.floats(0, 1, exclude_max=True))
@settings(max_examples=30)
def test_a_file_cut_short_is_refused(tmp_path_factory, share):
    path = tmp_path_factory.mktemp("cut") / "w.safetensors"
    save_weights(path, network_for(card_for()), card_for())
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(WeightsError) as caught:
        load_weights(path)
    assert "\n" not in str(caught.value)


@given(position=st.integers(0, 2500), value=st.integers(0, 255))
@settings(max_examples=150)
def test_a_damaged_header_is_refused_or_harmless(tmp_path_factory, position, value):
    path = tmp_path_factory.mktemp("flip") / "w.safetensors"
    save_weights(path, network_for(card_for()), card_for())
    content = bytearray(path.read_bytes())
    content[position] = value
    path.write_bytes(content)
    with contextlib.suppress(WeightsError):  # anything else escapes and fails the test
        load_weights(path)


def test_a_header_whose_length_looks_like_a_pickle_is_no_pickle(tmp_path):
    """Lengths 0x280 and 0x4b50 begin like a pickle and like a zip archive."""
    network, found = network_for(card_for()), set()
    path = tmp_path / "w.safetensors"
    save_weights(path, network, card_for())
    shortest = int.from_bytes(path.read_bytes()[:8], "little")
    for target in (0x280 + 0x10000, 0x4B50):
        notes = "x" * (target - shortest)  # the header is filled up to a multiple of 8
        save_weights(path, network, card_for(notes=notes))
        found.add(path.read_bytes()[:2])
        assert load_weights(path)[1].notes == notes
    assert found == {b"\x80\x02", b"PK"}


def rewrite(path, *, card=None, tensors=None):
    """The file again with parts exchanged, past the checks of `save_weights`."""
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    text = json.loads(content[8 : 8 + length])["__metadata__"]["graspmap"]
    values = {**json.loads(text), **(card or {})}
    held = {**safetensors.torch.load(content), **(tensors or {})}
    held = {name: tensor for name, tensor in held.items() if tensor is not None}
    path.write_bytes(safetensors.torch.save(held, {"graspmap": json.dumps(values)}))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"card": {"format": 2}}, ["format 2", "newer"]),
        ({"card": {"network": "resnet"}}, ["resnet", "ggcnn2"]),
        ({"card": {"colour": 1}}, ["colour"]),
        ({"card": {"bins": -1}}, ["bins"]),
        ({"card": {"width_scale_px": None}}, ["width_scale_px"]),
        ({"card": {"bins": 2}}, ["heads.layer.weight", "(4, 16, 1, 1)", "(8, 16, 1, 1)"]),
        ({"card": {"channels": "rgb"}}, ["fine1.weight", "(16, 3, 11, 11)"]),
        ({"card": {"network": "ggcnn"}}, ["shrink1.weight is missing", "more"]),
        ({"tensors": {"grow1.bias": None}}, ["grow1.bias is missing"]),
        ({"tensors": {"extra": torch.zeros(1)}}, ["extra is unknown"]),
        ({"tensors": {"grow1.bias": torch.full((16,), torch.nan)}}, ["grow1.bias", "NaN"]),
        ({"tensors": {"grow1.bias": torch.zeros(16, dtype=torch.int8)}}, ["grow1.bias", "int8"]),
    ],
)
def test_what_does_not_fit_is_named(weights, change, words):
    rewrite(weights, **change)
    with pytest.raises(WeightsError) as caught:
        load_weights(weights)
    assert all(word in str(caught.value) for word in [str(weights), *words]), caught.value


# --- other people's files: the networks as published, written here a second time


class Published(nn.Module):
    """GG-CNN2 with its published layer names, in both of its forms."""

    def __init__(self, form="bilinear", channels=1, bins=1):
        super().__init__()
        down = [
            *(nn.Conv2d(channels, 16, 11, padding=5), nn.ReLU()),
            *(nn.Conv2d(16, 16, 5, padding=2), nn.ReLU(), nn.MaxPool2d(2)),
            *(nn.Conv2d(16, 16, 5, padding=2), nn.ReLU()),
            *(nn.Conv2d(16, 16, 5, padding=2), nn.ReLU(), nn.MaxPool2d(2)),
            *(nn.Conv2d(16, 32, 5, padding=4, dilation=2), nn.ReLU()),
            *(nn.Conv2d(32, 32, 5, padding=8, dilation=4), nn.ReLU()),
        ]
        if form == "bilinear":
            up = [
                *(nn.UpsamplingBilinear2d(scale_factor=2), nn.Conv2d(32, 16, 3, padding=1)),
                nn.ReLU(),
                *(nn.UpsamplingBilinear2d(scale_factor=2), nn.Conv2d(16, 16, 3, padding=1)),
                nn.ReLU(),
            ]
        else:
            up = [
                *(nn.ConvTranspose2d(32, 16, 3, 2, 1, output_padding=1), nn.ReLU()),
                *(nn.ConvTranspose2d(16, 16, 3, 2, 1, output_padding=1), nn.ReLU()),
            ]
        self.features = nn.Sequential(*down, *up)
        for name in ("pos", "cos", "sin", "width"):
            self.add_module(f"{name}_output", nn.Conv2d(16, bins, 1))

    def forward(self, x):
        x = self.features(x)
        return [getattr(self, f"{name}_output")(x) for name in ("pos", "cos", "sin", "width")]


class PublishedFirst(nn.Module):
    """GG-CNN with its published layer names."""

    def __init__(self, channels=1, bins=1):
        super().__init__()
        self.conv1 = nn.Conv2d(channels, 32, 9, 3, 3)
        self.conv2 = nn.Conv2d(32, 16, 5, 2, 2)
        self.conv3 = nn.Conv2d(16, 8, 3, 2, 1)
        self.convt1 = nn.ConvTranspose2d(8, 8, 3, 2, 1, 1)
        self.convt2 = nn.ConvTranspose2d(8, 16, 5, 2, 2, 1)
        self.convt3 = nn.ConvTranspose2d(16, 32, 9, 3, 3, 1)
        for name in ("pos", "cos", "sin", "width"):
            self.add_module(f"{name}_output", nn.Conv2d(32, bins, 2))

    def forward(self, x):
        for name in ("conv1", "conv2", "conv3", "convt1", "convt2", "convt3"):
            x = torch.relu(getattr(self, name)(x))
        return [getattr(self, f"{name}_output")(x) for name in ("pos", "cos", "sin", "width")]


PUBLISHED = {
    "ggcnn": PublishedFirst,
    "ggcnn2": lambda *a: Published("transposed", *a),
    "ggcnn2-bilinear": lambda *a: Published("bilinear", *a),
}


def assert_same_maps(network, published, side=300):
    images = torch.randn(
        1, network.channels, side, side, generator=torch.Generator().manual_seed(5)
    )
    with torch.inference_mode():
        for ours, theirs in zip(network(images), published.eval()(images), strict=True):
            assert (ours - theirs).abs().max() < 1e-5


@pytest.mark.parametrize("kind", PUBLISHED)
@pytest.mark.parametrize(("channels", "bins"), [("depth", 1), ("rgb", 1), ("rgbd", 3)])
def test_imported_weights_give_the_same_maps(tmp_path, kind, channels, bins):
    published = PUBLISHED[kind](COUNT[channels], bins)
    path = tmp_path / "w.pt"
    torch.save(published.state_dict(), path)
    asked = kind.removesuffix("-bilinear")
    network, card = import_weights(asked, path, width_scale=100, size=320, view=200)
    assert (card.network, card.channels, card.bins) == (kind, channels, bins)
    assert (card.width_scale_px, card.size, card.view) == (100, 320, 200)
    assert_same_maps(network, published, side=96)
    # ... and so after a round trip through our own format
    save_weights(tmp_path / "w.safetensors", network, card)
    assert_same_maps(load_weights(tmp_path / "w.safetensors")[0], published, side=96)


@pytest.mark.parametrize(
    ("name", "kind", "published"),
    [
        ("ggcnn2_epoch_50_cornell_statedict.pt", "ggcnn2", Published),
        ("ggcnn_epoch_23_cornell_statedict.pt", "ggcnn", PublishedFirst),
    ],
)
def test_real_weights_give_the_same_maps(data_dir, name, kind, published):
    path = data_dir / "weights" / "ggcnn" / name
    if not path.is_file():
        pytest.skip(f"no {path}")
    network, card = import_weights(kind, path)
    theirs = published()
    theirs.load_state_dict(torch.load(path, map_location="cpu", weights_only=True))
    assert_same_maps(network, theirs)
    assert (card.channels, card.bins, card.size, card.width_scale_px) == ("depth", 1, 300, 150)
    assert name in card.notes


@pytest.mark.parametrize("prefix", ["module.", "model.", "module.model.", "_orig_mod."])
@pytest.mark.parametrize("container", [None, "state_dict", "model"])
@pytest.mark.parametrize("new", [True, False])
def test_wrappings_of_a_state_dict(tmp_path, prefix, container, new):
    published, path = Published(), tmp_path / "w.pth"
    state = OrderedDict((prefix + k, v) for k, v in published.state_dict().items())
    wrapped = {container: state, "epoch": 3} if container else state
    torch.save(wrapped, path, _use_new_zipfile_serialization=new)
    network, _ = import_weights("ggcnn2", path)
    assert torch.equal(network.state_dict()["fine1.bias"], published.features[0].bias)


def test_sorted_and_half_precision_safetensors(tmp_path):
    for kind, make in PUBLISHED.items():
        published, path = make(3, 2).half(), tmp_path / "w.safetensors"
        state = {name: t.contiguous() for name, t in published.state_dict().items()}
        safetensors.torch.save_file(dict(sorted(state.items())), path)
        network, card = import_weights(kind, path, channels="rgb")
        assert card.network == kind
        assert_same_maps(network, published.float(), side=48)


def refusal(path, kind="ggcnn2", **more):
    with pytest.raises(WeightsError) as caught:
        import_weights(kind, path, **more)
    assert caught.value.path == path
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_weights_of_another_network_say_so(tmp_path):
    path = tmp_path / "w.pt"
    torch.save(PublishedFirst().state_dict(), path)
    assert "it holds a ggcnn; import it with: graspmap weights import ggcnn" in refusal(path)
    torch.save(Published("transposed").state_dict(), path)
    assert "it holds a ggcnn2;" in refusal(path, "ggcnn")
    assert "it holds a ggcnn2;" in refusal(path, "ggcnn2-bilinear")


def test_differences_are_listed(tmp_path):
    path = tmp_path / "w.pt"
    state = Published("transposed").state_dict()
    torch.save({k: v for k, v in state.items() if k != "features.7.bias"}, path)
    assert "middle2.bias is missing" in refusal(path)
    torch.save({**state, "graspness.weight": torch.zeros(1, 16, 1, 1)}, path)
    assert "graspness.weight is unknown" in refusal(path)
    torch.save({k: v for k, v in state.items() if "sin" not in k}, path)
    assert "0 layers for sin" in refusal(path)
    torch.save({k: v for k, v in state.items() if "weight" not in k}, path)
    assert "no convolutions" in refusal(path)


def test_channels_must_be_those_of_the_file(tmp_path):
    path = tmp_path / "w.pt"
    torch.save(Published(channels=3).state_dict(), path)
    assert "allowed here: rgb" in refusal(path, channels="depth")
    torch.save(Published(channels=2).state_dict(), path)
    assert "1, 3 or 4" in refusal(path)


def test_damaged_and_other_files(tmp_path, weights):
    path = tmp_path / "w.pt"
    for new in (True, False):
        torch.save(Published().state_dict(), path, _use_new_zipfile_serialization=new)
        whole = path.read_bytes()
        for length in (1, 9, 100, 1000, len(whole) // 2, len(whole) - 2):
            path.write_bytes(whole[:length])
            assert "copy or download it again" in refusal(path) or length < 2
    path.write_bytes(b"not weights at all")
    assert "neither a PyTorch nor a safetensors file" in refusal(path)
    path.write_bytes(b"")
    assert "empty" in refusal(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("release/statedict.pt", whole)
    assert "release/statedict.pt" in refusal(path)
    torch.save([torch.zeros(2)], path)
    assert "holds a list" in refusal(path)
    torch.save({"epoch": 3}, path)
    assert "epoch" in refusal(path)
    assert "already" in refusal(weights)
    with pytest.raises(MissingFileError):
        import_weights("ggcnn", tmp_path / "none.pt")
    with pytest.raises(UnknownNameError, match="ggcnn2"):
        import_weights("gg-cnn2", path)


@pytest.mark.parametrize(
    ("key", "value"),
    [("width_scale", 0), ("size", 0), ("size", 10**6), ("view", "all"), ("view", 10**9)],
)
def test_wrong_settings(tmp_path, key, value):
    torch.save(Published().state_dict(), tmp_path / "w.pt")
    with pytest.raises(InvalidInputError):
        import_weights("ggcnn2", tmp_path / "w.pt", **{key: value})


class Malicious:
    """What an attacker would put into a file: opening it makes a folder."""

    def __init__(self, folder):
        self.folder = folder

    def __reduce__(self):
        return os.mkdir, (str(self.folder),)


def malicious_files(trap):
    """Contents that run a program when opened carelessly."""
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        yield pickle.dumps({"weight": Malicious(trap)}, protocol=protocol)
    for new in (True, False):
        for content in (Malicious(trap), {**Published().state_dict(), "x": Malicious(trap)}):
            buffer = io.BytesIO()
            torch.save(content, buffer, _use_new_zipfile_serialization=new)
            yield buffer.getvalue()


def test_files_that_would_run_code_are_refused_and_not_run(tmp_path):
    trap, path = tmp_path / "owned", tmp_path / "w.pt"
    for content in malicious_files(trap):
        path.write_bytes(content)
        text = refusal(path)
        if content[:1] == b"\x80" or content[:2] == b"PK":
            assert "could run code" in text
            assert "state_dict" in text
        with pytest.raises(WeightsError):
            load_weights(path)
        assert not trap.exists()
    # the trap does work
    pickle.loads(pickle.dumps(Malicious(trap)))
    assert trap.exists()


@pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
def test_whole_pickled_networks_and_programs_are_refused(tmp_path):
    path = tmp_path / "w.pt"
    torch.save(nn.Sequential(nn.Conv2d(1, 1, 1)), path)
    assert "torch.nn.modules.container.Sequential" in refusal(path)
    torch.jit.save(torch.jit.script(nn.Sequential(nn.Conv2d(1, 1, 1))), path)
    assert "0 layers for quality" in refusal(path)  # its tensors are read, its program is not run


def test_a_card_that_nests_without_end_is_damaged(tmp_path):
    path = tmp_path / "w.safetensors"
    safetensors.torch.save_file({"a": torch.zeros(1)}, path, {"graspmap": "[" * 50000})
    with pytest.raises(WeightsError, match="card is damaged"):
        load_weights(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.to(torch.float8_e4m3fn), "float8"),
        (lambda t: t.to("meta"), "meta"),
        (lambda t: t.flatten()[:1].expand(10**12), "4 bytes for 1000000000000 numbers"),
        (lambda t: t.to_sparse(), "sparse"),
    ],
)
def test_tensors_without_all_their_numbers_are_refused(tmp_path, change, words):
    state = Published().state_dict()
    name = next(iter(state))
    torch.save({**state, name: change(state[name])}, tmp_path / "w.pt")
    with pytest.raises(WeightsError, match=words):
        import_weights("ggcnn2", tmp_path / "w.pt")


def test_layers_without_channels_do_not_fit(tmp_path):
    state = Published().state_dict()
    first = next(iter(state))
    heads = {name: torch.tensor(1.0) for name in state if "pos" in name}
    for change in ({first: state[first][:, :0]}, heads):
        torch.save({**state, **change}, tmp_path / "w.pt")
        with pytest.raises(WeightsError, match="does not fit ggcnn2"):
            import_weights("ggcnn2", tmp_path / "w.pt")
