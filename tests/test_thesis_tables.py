"""The tables of the thesis as data: the printed numbers, the rows, and the runs they become."""

from __future__ import annotations

import itertools
import json
import re
from functools import cache

import numpy as np
import pytest
import yaml

from graspmap.config import read_model
from graspmap.data import Scene, write_jacquard
from graspmap.errors import ConfigError, InvalidInputError, UnknownNameError
from graspmap.geometry import Grasps
from graspmap.networks import NETWORKS
from graspmap.reproduction.measures import MEASURES
from graspmap.reproduction.plan import make_plan
from graspmap.reproduction.request import Request
from graspmap.reproduction.scale import shrink
from graspmap.reproduction.table_file import (
    Table,
    experiment_path,
    experiments_folder,
    parse_published,
    read_table,
    table_names,
)
from graspmap.training import read_experiment

NAMES = (
    "table-3.1", "table-3.2", "table-3.3", "table-4.1", "table-4.2", "table-4.3", "table-4.4",
    "table-5.1", "table-5.2", "table-5.3", "fig-4.8", "fig-5.6",
)  # fmt: skip
WITH_RUNS = tuple(name for name in NAMES if name not in ("table-4.4", "table-5.3"))


def write_scenes(root, objects=10, views=2, **left_out):
    """Plain scenes, quick to write: only what they have counts here."""
    for thing, view in itertools.product(range(objects), range(views)):
        rng = np.random.default_rng((thing, view))
        pictures = {
            "rgb": rng.integers(0, 255, (16, 16, 3)).astype(np.uint8),
            "depth": np.full((16, 16), 0.6, np.float32),
            "mask": np.eye(16, dtype=bool),
        }
        name = f"{thing:04d}"
        grasps = Grasps([[8, 8]], [0.0], [6.0], [3.0])
        picture = write_jacquard(
            Scene(f"{view}_{name}", **{**pictures, **left_out}, grasps=grasps, object_id=name), root
        )
        labels = {"specific": "ab"[thing % 2], "general": "cd"[thing % 2]}
        record = {"objects": [{"id": "x", "labels": labels}]}
        (picture.parent / f"{view}_{name}_scene.json").write_text(json.dumps(record))
    return f"jacquard:{root}"


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return write_scenes(tmp_path_factory.mktemp("plain"))


def request(name, source, **options):
    table = read_table(name)
    defaults = {
        "data": None if table.data is None else source,
        "test_data": None if table.test_data is None else source,
        "folds": None if table.folds is None else "1/5",
    }
    return Request(name, **{**defaults, **options})


@pytest.fixture(scope="module")
def plan_of(data):
    """Plans of whole tables, made once."""
    return cache(lambda name: make_plan(request(name, data)))


# The files.


def test_the_tables_are_these():
    assert table_names() == (*NAMES, "claims")
    assert (experiments_folder() / "ggcnn2-generated.yaml").is_file()


@pytest.mark.parametrize(
    ("text", "mean", "spread"),
    [
        ("72.04 ± 3.44", 72.04, 3.44),
        ("0.011", 0.011, None),
        ("~ 29", 29.0, None),
        ("-", None, None),
        ("200-500", None, None),
        ("72k", None, None),
    ],
)
def test_printed_numbers(text, mean, spread):
    found = parse_published(text)
    assert (found.text, found.mean, found.spread) == (text, mean, spread)


def printed(name, *labels):
    """The numbers of the one row with these labels, as the file has them."""
    (line,) = [line for line in read_table(name).lines if line.labels == labels]
    return line.published


@pytest.mark.parametrize(
    ("name", "labels", "numbers"),
    [
        ("table-3.1", ("MTG-CNN a", "RGB", "0.8"), ("50.60", "56.22")),
        ("table-3.1", ("MTG-CNN d", "RGB", "0.6"), ("92.77", "1.21")),
        ("table-3.1", ("GG-CNN2", "D", "0.0"), ("-", "1.21")),
        ("table-3.2", ("MTG-CNN a", "RGB", "-log sigma^2"), ("71.49", "60.64")),
        ("table-3.2", ("MTG-CNN b", "RGB", "0.7"), ("81.53", "58.23")),
        ("table-3.3", ("GG-CNN2", "RGB-D", "", ""), ("83.11 ± 1.88", "-")),
        ("table-3.3", ("MTG-CNN", "RGB", "Saliency", "CEL"), ("76.63 ± 2.24", "0.005")),
        ("table-4.1", ("MTG-CNN Depth", "RGB", "Pos", "MSE", "yes"), ("80.19 ± 1.14", "0.015")),
        ("table-4.2", ("GR-ConvNet2", "Positional"),
         ("81.94 ± 1.17", "88.38 ± 1.20", "87.45 ± 1.17")),
        ("table-4.3", ("GG-CNN2", "Depth", "Positional"), ("64.53",)),
        ("table-4.4", ("GR-ConvNet2", "Positional"), ("~ 28",)),
        ("table-5.1", ("U-Net", "Pos", "3"),
         ("94.66", "93.45", "94.04", "94.35", "93.83", "92.59")),
        ("table-5.2", ("U-Net", "Strong"),
         ("94.04", "92.31", "83.87", "50.71", "67.69", "0.675", "87.94")),
        ("table-5.3", ("U-Net",), ("14.7M", "25-28")),
    ],
)  # fmt: skip
def test_numbers_of_the_thesis(name, labels, numbers):
    assert printed(name, *labels) == numbers


def test_every_row_of_a_table_is_printed():
    for name in NAMES:
        table = read_table(name)
        for line in table.lines:
            assert all(
                re.fullmatch(r"-|~ \d+|\d+[Mk]|\d+-\d+|\d+(\.\d+[Mk]?)?( ± \d+\.\d+)?", text)
                for text in line.published
            ), (name, line)
        # The figures are pictures without numbers.
        without = [line for line in table.lines if set(line.published) <= {"-"}]
        assert without == ([] if name.startswith("table") else list(table.lines))


def test_a_number_that_two_tables_print_is_one_number():
    """What the thesis prints twice must be typed twice alike, but for what facts say differs."""
    first = [printed("table-3.3", "GG-CNN2", i, "", "") for i in ("RGB", "Depth", "RGB-D")]
    second = [
        printed("table-4.1", "GG-CNN2", i, "MSE", "-", "-") for i in ("RGB", "Depth", "RGB-D")
    ]
    assert first == second
    strong = {"GG-CNN2": 3, "GR-ConvNet": 4, "U-Net": 2}
    for model, column in strong.items():
        row = printed("table-5.1", model, "Pos", "3")
        assert printed("table-5.2", model, "Binary")[0] == row[0]
        assert printed("table-5.2", model, "Strong")[0] == row[column]
        if model != "GR-ConvNet":
            assert printed("table-5.2", model, "Soft")[0] == row[1]


def test_disagreements_are_quoted_in_both_places():
    quoted = {
        (name, place, numbers)
        for name in NAMES
        for line in read_table(name).lines
        for place, numbers in line.elsewhere.items()
    }
    assert quoted == {
        ("table-3.3", "Table 4.1", ("78.14 ± 0.65", "0.022")),
        ("table-3.3", "Table 4.1", ("79.53 ± 1.43", "0.020")),
        ("table-4.1", "Table 3.3", ("79.50 ± 0.65", "0.022")),
        ("table-4.1", "Table 3.3", ("78.29 ± 1.76", "0.014")),
        ("table-5.1", "Table 5.2", ("-", "91.15", "-", "-", "-", "-")),
        ("table-5.2", "Table 5.1", ("91.82", "-", "-", "-", "-", "-", "-")),
    }


def test_experiments_are_as_published():
    used = {line.experiment for name in NAMES for line in read_table(name).lines} - {None}
    files = {path.stem for path in (experiments_folder() / "thesis").glob("*.yaml")}
    assert used == files
    for name in files:
        experiment = read_experiment(experiment_path(name))
        gaussian = name.startswith("gaussian")
        assert experiment.name == name
        assert experiment.network.name in NETWORKS
        assert experiment.optimiser.name == "adam"
        assert experiment.optimiser.learning_rate == (2e-3 if gaussian else 1e-3)
        assert experiment.training.batch_size == 8
        assert experiment.training.epochs == (50 if gaussian else 40)
        assert experiment.training.batches_per_epoch == (None if gaussian else 1000)
        assert experiment.data.size == (320 if gaussian else 300)
        assert experiment.schedule.kind == ("plateau" if gaussian else "none")
        assert experiment.data.split.folds == (
            None if name.startswith("limited") else 10 if gaussian else 5
        )


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"measures": ["succes"]}, "allowed: measures success"),
        ({"folds": "five"}, "pattern"),
        ({"labels": ["Model"]}, "allowed: 1 labels a row"),
        ({"row": {"published": ["1.0", "2.0"]}}, "allowed: 1 numbers a row"),
        ({"row": {"use": ["posi"]}}, "allowed: settings pos, not posi"),
        ({"row": {"usee": ["pos"]}}, "did you mean"),
    ],
)
def test_damaged_table_files(tmp_path, change, problem):
    content = yaml.safe_load((experiments_folder() / "tables" / "table-4.3.yaml").read_text())
    content["groups"][0]["rows"][0] |= change.pop("row", {})
    path = tmp_path / "table.yaml"
    path.write_text(yaml.safe_dump({**content, **change}))
    with pytest.raises(ConfigError, match=problem):
        read_model(path, Table, what="table")


def test_measures_read_results():
    result = {
        "parameters": 7,
        "test": {"success": {"0.25": 0.5}, "depth_mae": 0.25, "auc": float("nan"),
                 "category_majority": {"test_share": 0.125}},
    }  # fmt: skip
    get = {name: measure.get(result) for name, measure in MEASURES.items()}
    assert get["success"] == 50
    assert get["mae"] == 0.25
    assert get["majority"] == 12.5
    assert get["parameters"] == 7
    assert get["auc"] is get["success_50"] is get["sgt"] is None


# The runs.


@pytest.mark.parametrize("name", WITH_RUNS)
def test_each_row_becomes_runs(name, plan_of):
    plan = plan_of(name)
    table = read_table(name)
    assert plan.lines == table.lines
    assert not plan.left_out
    assert set(plan.cells) == set(
        itertools.product(range(len(table.lines)), range(len(table.columns)))
    )
    assert {run for runs in plan.cells.values() for run in runs} == {run.id for run in plan.runs}
    for run in plan.runs:
        assert run.experiment.name == run.id
        assert run.experiment.data.source.startswith("jacquard:/")


def test_experiments_of_rows(plan_of):
    plan = plan_of("table-5.1")
    experiment = plan.experiments[7, 3]  # GR-ConvNet, positional, 3 bins; strong 1
    assert plan.lines[7].title == "GR-ConvNet / Pos / 3"
    assert (experiment.network.name, experiment.network.bins) == ("grconvnet", 3)
    assert (experiment.loss.base, experiment.loss.positional) == ("smooth_l1", "inside")
    assert (experiment.maps.quality, experiment.maps.drop_off) == ("strong", 1.0)
    plan = plan_of("table-3.1")
    by_title = {line.title: plan.experiments[row, 0] for row, line in enumerate(plan.lines)}
    assert by_title["MTG-CNN b / RGB / 0.7"].loss.grasp_share == 0.7
    assert by_title["MTG-CNN b / RGB / -log sigma^2"].loss.weighting == "uncertainty"
    assert by_title["GG-CNN2 / D / 0.0"].loss.grasp_share == 0
    assert by_title["GG-CNN2 / D / 1.0"].tasks.names == ()


def test_equal_experiments_are_one_run(data, plan_of):
    tables = {name: {run.id for run in plan_of(name).runs} for name in WITH_RUNS}
    assert len(tables["table-3.1"]) == len(tables["table-3.2"]) == 26
    assert len(tables["table-3.1"] & tables["table-3.2"]) == 3  # GG-CNN2, grasps alone
    assert len(tables["table-3.3"] & tables["table-4.1"]) == 9
    assert len(tables["table-4.1"] & tables["fig-4.8"]) == 6
    assert len(tables["table-4.2"] & tables["fig-4.8"]) == 12
    assert tables["table-5.2"] < tables["table-5.1"]
    assert tables["fig-5.6"] < tables["table-5.1"]
    assert len(tables["table-5.1"]) == 72
    every = {run.id for run in make_plan(request("table-4.2", data, folds="5")).runs}
    assert len(every) == 5 * 24
    assert tables["table-4.2"] < every


@pytest.mark.parametrize(
    ("same", "change"),
    [
        (True, {"training.workers": 3, "training.checkpoint_minutes": 1.0}),
        (True, {"data.cache_dir": "elsewhere"}),
        (False, {"data.size": 64}),
        (False, {"training.epochs": 3}),
        (False, {"data.split.limit_objects": 4}),
        (False, {"optimiser.weight_decay": 0.1}),
    ],
)
def test_what_makes_a_run_another(data, same, change):
    rows = {"rows": "U-Net / Soft", "folds": "1/5"}
    one = make_plan(request("table-5.2", data, **rows)).runs[0]
    other = make_plan(request("table-5.2", data, **rows, changes=change)).runs[0]
    assert (one.id == other.id) is same
    assert one.id.startswith("unet-")


def test_data_and_seed_make_a_run_another(data, tmp_path):
    rows = {"rows": "U-Net / Soft"}
    ids = {
        make_plan(request("table-5.2", source, **rows, seed=seed)).runs[0].id
        for source in (data, write_scenes(tmp_path, 10, 2))
        for seed in (0, 1)
    }
    assert len(ids) == 4
    before = make_plan(request("table-5.2", f"jacquard:{tmp_path}", **rows)).runs[0].id
    write_scenes(tmp_path, 11, 2)
    assert make_plan(request("table-5.2", f"jacquard:{tmp_path}", **rows)).runs[0].id != before


def test_the_first_folds_come_first(data):
    plan = make_plan(request("table-4.2", data, folds="2/5", rows="GR-ConvNet4"))
    folds = [run.experiment.data.split.fold for run in plan.runs]
    assert folds == sorted(folds)
    assert all(len(runs) == 2 for runs in plan.cells.values())


def test_scale(data):
    experiment = read_experiment(experiment_path("jacquard-ggcnn2"))
    assert shrink(experiment, 1, 10) == experiment
    small = shrink(experiment, 0.01, 10)
    assert (small.training.epochs, small.training.batches_per_epoch) == (4, 100)
    least = shrink(experiment, 1e-9, 10)
    assert (least.training.epochs, least.training.batches_per_epoch) == (1, 1)
    # An epoch of chapter 5 is a pass over the training part: 9/10 of 20 scenes, in batches of 8.
    plan = make_plan(request("table-5.2", data, rows="U-Net", scale=0.25))
    training = plan.runs[0].experiment.training
    assert (training.epochs, training.batches_per_epoch) == (25, 1)
    assert plan.published[0, 0].training.batches_per_epoch is None


# What is refused, and what is left out.


@pytest.mark.parametrize(
    ("name", "options", "problem"),
    [
        ("table-5.1", {"data": None}, "--data is missing; allowed: KIND:DIR to train on"),
        ("table-5.1", {"test_data": "jacquard:x"}, "--test-data is jacquard:x; allowed: nothing"),
        ("table-4.3", {"test_data": None}, "--test-data is missing"),
        ("table-4.3", {"folds": "5"}, "--folds is 5; allowed: nothing: table-4.3 has one run"),
        ("table-4.4", {"folds": "5"}, "only times networks"),
        ("table-4.4", {"scale": 0.1}, "only times networks"),
        ("table-5.1", {"scale": 0.0}, "--scale is 0.0; allowed: a share above 0"),
        ("table-5.1", {"scale": 2.0}, "--scale"),
        ("table-5.1", {"folds": "1"}, "--folds is '1'; allowed: K of at least 2, or N/K"),
        ("table-5.1", {"folds": "6/5"}, "--folds"),
        ("table-5.1", {"folds": "a/5"}, "--folds"),
        ("table-5.1", {"folds": "11"}, "is 10; allowed: at least 22 for 11 folds, two for each; at "
         "most 5 folds or more data .--folds K"),
        ("table-5.1", {"folds": "6"}, "or folds by image .there are 20. or more data .--folds K or "
         "N/K sets them, --data.split.by image"),
        ("table-5.1", {"rows": "resnet"}, "--rows is 'resnet'; allowed: GG-CNN2 / MSE / 1, "),
        ("table-5.1", {"changes": {"network.bins": 3}}, "varied by table-5.1 itself; pick rows"),
        ("table-5.1", {"changes": {"data.source": "x"}}, "--data.source: is set by the table"),
        ("table-5.1", {"changes": {"training.epochs": 2}, "scale": 0.1}, "contradicts --scale"),
        ("table-5.1", {"changes": {"training.epoch": 2}}, "did you mean training.epochs"),
        ("table-5.1", {"changes": {"data.split.by": "colour"}}, "data.split.by"),
    ],
)  # fmt: skip
def test_refused_before_anything_runs(data, name, options, problem):
    with pytest.raises((InvalidInputError, ConfigError), match=problem):
        make_plan(request(name, data, **options))


def test_unknown_tables_and_the_nearest():
    with pytest.raises(UnknownNameError) as caught:
        make_plan(Request("table-5.4", "jacquard:x"))
    assert caught.value.nearest == "table-5.3"


def test_rows_that_the_data_cannot_give(tmp_path):
    source = write_scenes(tmp_path / "poor", mask=None, depth=None)
    plan = make_plan(request("table-4.1", source))
    assert [line.title for line in plan.lines] == ["GG-CNN2 / RGB / MSE", "GG-CNN2 / RGB / Pos"]
    reasons = dict(plan.left_out)
    assert "without depth picture" in reasons["GG-CNN2 / RGB-D / Pos"]
    assert "without mask" in reasons["MTG-CNN Saliency / RGB / MSE / MSE / no"]
    assert "without depth picture" in reasons["MTG-CNN Depth / RGB / Pos / MSE / yes"]
    with pytest.raises(InvalidInputError, match=r"not enough for any row .*without depth"):
        make_plan(request("table-5.1", source))
    with pytest.raises(InvalidInputError, match=r"not enough .*\(--test-data\)"):
        make_plan(Request("table-4.3", write_scenes(tmp_path / "full"), source))


def test_rows_are_picked_by_part_and_by_pattern(data):
    def titles(pattern):
        return [line.title for line in make_plan(request("table-5.2", data, rows=pattern)).lines]

    assert titles("u-net") == ["U-Net / Binary", "U-Net / Soft", "U-Net / Strong"]
    assert titles("*Net / S[ot]*") == ["GR-ConvNet / Soft", "GR-ConvNet / Strong",
                                       "U-Net / Soft", "U-Net / Strong"]  # fmt: skip
