"""Experiment files: strict keys and values, flags over them, and errors that say what is right."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.config import COMMAND_LINE
from graspmap.errors import ConfigError, FileFormatError, MissingFileError
from graspmap.training import Experiment, parse_overrides, read_experiment

SHIPPED = sorted((Path(__file__).parents[1] / "experiments").glob("*.yaml"))


@pytest.fixture
def file(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "experiment.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def wrong(path: Path, *flags: str) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        read_experiment(path, flags)
    return caught.value


def test_the_least_that_must_be_said_is_the_data(file):
    experiment = read_experiment(file("data: {source: 'jacquard:x'}"))
    assert experiment == Experiment(data={"source": "jacquard:x"})
    assert experiment.training.epochs == 40
    assert wrong(file("name: a")).key == "data"
    assert wrong(file("data: {size: 64}")).key == "data.source"
    assert "pass --data.source" in str(wrong(file("data: {size: 64}")))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_shipped_experiments_are_valid_and_named_after_their_file(path):
    assert read_experiment(path).name == path.stem


def test_experiments_are_shipped():
    assert len(SHIPPED) >= 3


def test_scalars_are_those_of_yaml_1_2(file):
    experiment = read_experiment(
        file(
            "name: no\n"  # a country, not a truth value
            "data: {source: 'jacquard:x', augment: {zoom: [0.5, 1], flip: true}}\n"
            "optimiser: {learning_rate: 2e-3}\n"
            "maps: {width_scale: 150}\n"
        )
    )
    assert experiment.name == "no"
    assert experiment.optimiser.learning_rate == 2e-3
    assert experiment.data.augment.zoom == (0.5, 1.0)
    assert experiment.maps.width_scale == 150.0


def test_written_files_are_read_back_equal(file, tmp_path):
    experiment = read_experiment(
        file("data: {source: 'jacquard:ä b', view: 224}\nschedule: {stop_after_cuts: 3}")
    )
    (tmp_path / "again.yaml").write_text(experiment.to_yaml(), encoding="utf-8")
    assert read_experiment(tmp_path / "again.yaml") == experiment


# No name of a folder holds a zero byte.
SOURCE = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]))


@given(
    st.builds(
        dict,
        seed=st.integers(0, 2**63 - 1),
        name=st.text(min_size=1).filter(lambda s: s.isprintable()),
        optimiser=st.fixed_dictionaries(
            {"learning_rate": st.floats(1e-12, 1e6), "weight_decay": st.floats(0, 1)}
        ),
        data=st.fixed_dictionaries(
            {"source": SOURCE, "size": st.integers(16, 4096), "view": st.integers(1, 9999)}
        ),
    )
)
def test_round_trip_for_any_values(tmp_path_factory, values):
    path = tmp_path_factory.getbasetemp() / "round.yaml"
    experiment = Experiment.model_validate(values)
    path.write_text(experiment.to_yaml(), encoding="utf-8")
    assert read_experiment(path) == experiment


@pytest.mark.parametrize(
    ("text", "key", "nearest"),
    [
        ("trainin: {epochs: 3}", "trainin", "training"),
        ("training: {epoch: 3}", "training.epoch", "training.epochs"),
        ("epochs: 3", "epochs", "training.epochs"),
        ("optimizer: {name: adam}", "optimizer", "optimiser"),
        ("data: {source: x, augment: {rotate: any}}", "data.augment.rotate", "rotation"),
        ("network: {zzz: 1}", "network.zzz", "allowed here: bins, channels, filters, name"),
    ],
)
def test_a_wrong_key_names_the_nearest(file, text, key, nearest):
    if not text.startswith("data"):
        text += "\ndata: {source: x}"
    error = wrong(file(text))
    assert error.key == key
    assert nearest in error.remedy
    assert str(error.path).endswith("experiment.yaml")


@pytest.mark.parametrize(
    ("section", "key", "allowed"),
    [
        ("network: {channels: infrared}", "network.channels", "'depth', 'rgb' or 'rgbd'"),
        ("network: {bins: 0}", "network.bins", "greater than or equal to 1"),
        ("network: {bins: 1.5}", "network.bins", "integer"),
        ("network: {bins: '3'}", "network.bins", "integer"),
        ("training: {epochs: -1}", "training.epochs", "0"),
        ("training: {precision: 8}", "training.precision", "'32', 'bf16' or '16'"),
        ("optimiser: {learning_rate: .nan}", "optimiser.learning_rate", "finite"),
        ("optimiser: {learning_rate: 0}", "optimiser.learning_rate", "greater than 0"),
        ("maps: {width_scale: wide}", "maps.width_scale", "'data'"),
        ("maps: {drop_off: true}", "maps.drop_off", "number"),
        ("schedule: {factor: 1}", "schedule.factor", "less than 1"),
        ("schedule: plateau", "schedule", "object"),
        ("seed: -1", "seed", "0"),
        ("network: null", "network", "object"),
    ],
)
def test_a_wrong_value_says_what_is_allowed(file, section, key, allowed):
    error = wrong(file(f"{section}\ndata: {{source: x}}"))
    assert error.key == key
    assert allowed in error.remedy
    assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("data", "allowed"),
    [
        ("split: {train: 0.5}", "1 in sum"),
        ("split: {folds: 5, fold: 5}", "0 to 4"),
        ("augment: {zoom: [1.0, 0.5]}", "low, high"),
        ("augment: {crop: 8}", "16"),
        ("augment: {zoom: [0.5]}", ""),
        ("augment: {zoom: [0.0, 1.0]}", "0.05"),
        ("size: 8", "16"),
        ("view: 0", "contain"),
    ],
)
def test_values_that_do_not_fit_together(file, data, allowed):
    error = wrong(file(f"data: {{source: x, {data}}}"))
    assert error.key.startswith("data.")
    assert allowed in error.remedy


def test_a_crop_larger_than_the_input_is_refused(file):
    error = wrong(file("data: {source: x, augment: {crop: 301}}"))
    assert error.key == "data"
    assert "up to size, 300 px" in error.remedy


def test_flags_replace_values(file):
    path = file("data: {source: x}\ntraining: {epochs: 5}\nschedule: {kind: none}")
    flags = [
        "--training.epochs", "7", "--data.augment.zoom", "[0.8, 1.0]", "--data.source=jacquard:y",
        "--schedule.stop-after-cuts", "2", "--optimiser.weight_decay", "1e-4",
        "--network", "{channels: rgb}",
    ]  # fmt: skip
    experiment = read_experiment(path, flags)
    assert experiment.training.epochs == 7
    assert experiment.data.augment.zoom == (0.8, 1.0)
    assert experiment.data.source == "jacquard:y"
    assert experiment.schedule.stop_after_cuts == 2
    assert experiment.optimiser.weight_decay == 1e-4
    assert experiment.network.channels == "rgb"
    assert read_experiment(path, {"training.epochs": 7}).training.epochs == 7


@pytest.mark.parametrize(
    ("flags", "key", "text"),
    [
        (["--training.epoch", "7"], "--training.epoch", "training.epochs"),
        (["--training.epochs", "many"], "--training.epochs", "integer"),
        (["--training.epochs"], "--training.epochs", "no value"),
        (["--training.epochs", "--seed"], "--training.epochs", "no value"),
        (["--seed", "1", "--seed", "2"], "--seed", "twice"),
        (["epochs", "3"], "epochs", "--section.key value"),
        (["--data.augment.zoom", "[1"], "--data.augment.zoom", "quote"),
        (["--training", "3"], "--training", "object"),
    ],
)
def test_a_wrong_flag_is_named_as_a_flag(file, flags, key, text):
    error = wrong(file("data: {source: x}"), *flags)
    assert str(error.path) == COMMAND_LINE
    assert error.key == key
    assert text in str(error)


def test_negative_numbers_are_values_of_flags():
    assert parse_overrides(["--seed", "-1", "--name="]) == {"seed": -1, "name": None}


@pytest.mark.parametrize(
    "text",
    ["", "- 1", "just words", "a: [1", "a: 1\na: 2", "1: 2", "a: !!python/object:os.system {}"],
)
def test_files_that_are_no_mapping_are_refused(file, text):
    with pytest.raises(FileFormatError):
        read_experiment(file(text))


def test_double_keys_name_their_lines(file):
    with pytest.raises(FileFormatError, match="line 3: key 'seed' is already in line 1"):
        read_experiment(file("seed: 1\nname: x\nseed: 2\ndata: {source: x}"))


def test_missing_and_binary_files(tmp_path):
    with pytest.raises(MissingFileError, match="experiments/"):
        read_experiment(tmp_path / "none.yaml")
    (tmp_path / "x.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(FileFormatError):
        read_experiment(tmp_path / "x.yaml")
    with pytest.raises(FileFormatError):
        read_experiment(tmp_path)


def test_flat_has_every_value_by_its_dotted_key():
    flat = Experiment(data={"source": "x"}).flat()
    assert flat["data.split.by"] == "object"
    assert flat["training.batches_per_epoch"] is None
    assert read_back(flat) == Experiment(data={"source": "x"})


def read_back(flat):
    import json

    values: dict = {}
    for key, value in flat.items():
        *sections, last = key.split(".")
        inner = values
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[last] = value
    return Experiment.model_validate_json(json.dumps(values))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("name: !!binary aGVsbG8=", "holds a bytes"),
        ("name: !!timestamp 2001-01-01", "holds a date"),
        ("name: !!set {a, b}", "holds a set"),
        ('data: {source: "jacquard:a\\0b"}', "no text"),
        ('name: "\\ud800"', "no text"),
        (
            "a: &a [1, 2, 3, 4, 5, 6, 7, 8, 9]\n"
            + "".join(
                f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n"
                for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
            ),
            "more than",
        ),
    ],
)
def test_values_that_no_experiment_has(file, text, problem):
    with pytest.raises(FileFormatError, match=problem):
        read_experiment(file(text))


def test_precision_may_be_written_as_a_number(file):
    path = file("data: {source: x}\ntraining: {precision: 32}")
    assert read_experiment(path).training.precision == "32"
    flags = ["--training.precision", "16"]
    assert read_experiment(path, flags).training.precision == "16"


@pytest.mark.parametrize("flag", ["--training.workers=100000", "--network.bins=1000000000"])
def test_numbers_that_would_only_fill_the_memory(file, flag):
    with pytest.raises(ConfigError, match="less than or equal to"):
        read_experiment(file("data: {source: x}"), [flag])


@pytest.mark.parametrize("view", ["1000000000", "0", "true", "36cm", "0 cm", "fill", "[1]"])
def test_views_that_there_are_not(file, view):
    allowed = "'contain', 'cover', a side in pixels, 1 to 16384, or in centimetres"
    with pytest.raises(ConfigError, match=rf"data.view: is .*allowed: {allowed}"):
        read_experiment(file("data: {source: x}"), [f"--data.view={view}"])
