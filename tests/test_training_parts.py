"""Training on parts, each a data set of its own: nothing divided, nothing shared, all recorded."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from graspmap.data import Scene, open_store, read_scenes, read_split, write_jacquard
from graspmap.data.fingerprint import data_hash
from graspmap.errors import ConfigError, FileError, FileFormatError
from graspmap.evaluation import evaluate_detector
from graspmap.generation.scene_file import read_object_keys
from graspmap.geometry import Grasps
from graspmap.inference import Detector
from graspmap.training import Experiment, train
from graspmap.training.apart import check_apart
from graspmap.training.callbacks import read_rows
from graspmap.training.module import SUCCESS_OVERLAP
from graspmap.training.tasks import check_experiment

pytestmark = pytest.mark.usefixtures("one_thread")

SIDE = 32


def write_part(root: Path, seed: int, objects: int, *, first: int = 0, masks: bool = True) -> str:
    """Bars on a table, with records that say from which seed and number each was made."""
    for index in range(first, first + objects):
        rng = np.random.default_rng((seed, index))
        x, y = rng.uniform(12, 19, 2)
        mask = np.zeros((SIDE, SIDE), np.uint8)
        cv2.rectangle(mask, (int(x) - 3, 4), (int(x) + 3, 27), 1, -1)
        depth = np.where(mask > 0, 0.55, 0.6).astype(np.float32)
        rgb = np.repeat(rng.integers(0, 255, (SIDE, SIDE, 1)), 3, axis=2).astype(np.uint8)
        # The name says nothing: every part has a bar-000000.
        name = f"bar-{index:06d}"
        scene = Scene(f"{index}_{name}", rgb, depth, mask > 0 if masks else None,
                      Grasps([[x, y]], [0.0], [12.0], [4.0]), object_id=name)  # fmt: skip
        picture = write_jacquard(scene, root)
        source = {"kind": "procedural", "seed": seed, "index": index}
        record = {"objects": [{"id": name, "source": source}]}
        (picture.parent / f"{scene.id}_scene.json").write_text(json.dumps(record))
    return f"jacquard:{root}"


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    root = tmp_path_factory.mktemp("parts")
    sizes = {"train": 8, "validation": 3, "test": 4}
    return {n: write_part(root / n, seed, k) for seed, (n, k) in enumerate(sizes.items(), 1)}


def make(parts, cache, **data) -> Experiment:
    content = {
        "source": parts["train"],
        "validation": {"source": parts["validation"]},
        "test": {"source": parts["test"]},
        "size": SIDE,
        "cache_dir": str(cache),
    }
    return Experiment.model_validate(
        {
            "network": {"name": "ggcnn", "channels": "depth"},
            "data": {**content, **data},
            "training": {"epochs": 2, "batch_size": 4, "device": "cpu", "checkpoint_minutes": 0},
        }
    )


@pytest.fixture(scope="module")
def trained(parts, cache, tmp_path_factory):
    """Long enough to be right somewhere: a network that never is agrees with any labels."""
    out = tmp_path_factory.mktemp("run")
    still = {"rotation": "none", "zoom": (1.0, 1.0)}
    one = make(parts, cache, augment=still)
    longer = one.training.model_copy(update={"epochs": 4, "batches_per_epoch": 40})
    return out, train(one.model_copy(update={"training": longer}), out)


def test_every_scene_is_used_in_its_part(trained, parts):
    out, card = trained
    assert card.data.scenes == {"train": 8, "validation": 3, "test": 4}
    assert set(read_split(out / "split.json").parts["train"]) == set(
        read_scenes(parts["train"]).ids
    )
    assert set(read_split(out / "split.json").parts) == {"train"}


def test_the_epoch_is_chosen_and_tested_where_it_says(trained, parts):
    """The card's figures, measured again with the weights alone on the parts named."""
    out, card = trained
    detector = Detector.load(out / "weights.safetensors")
    found = {n: evaluate_detector(detector, read_scenes(parts[n])) for n in ("validation", "test")}
    assert found["test"].score.miou > 0.1
    assert card.metrics["test"]["miou"] == pytest.approx(found["test"].score.miou, abs=1e-6)
    right = np.mean([r.iou > SUCCESS_OVERLAP for r in found["validation"].results])
    assert card.metrics["validation"]["scenes"] == 3
    assert card.metrics["validation"]["success"]["0.25"] == pytest.approx(right)
    epoch = card.metrics["validation"]["epoch"]
    (row,) = [row for row in read_rows(out / "metrics.jsonl") if row["epoch"] == epoch]
    assert row["success"] == pytest.approx(right)


def test_card_and_folder_say_which_files_were_what(trained, parts, cache):
    out, card = trained
    keys = {
        name: open_store(read_scenes(source), cache, size=SIDE, view="contain").key
        for name, source in parts.items()
    }
    assert len(set(keys.values())) == 3
    data = card.data
    assert (data.store_key, data.validation_key, data.test_key) == tuple(keys.values())
    assert (data.source, data.validation_source, data.test_source) == tuple(parts.values())
    assert data.data_hash == data_hash(read_scenes(parts["train"]))
    assert card.seed == 0
    facts = json.loads((out / "run.json").read_text())
    assert [facts[f"{n}store"] for n in ("", "validation_", "test_")] == list(keys.values())


@pytest.mark.parametrize("changed", ["validation", "test"])
def test_a_run_does_not_go_on_with_other_files(parts, cache, tmp_path, changed):
    own = dict(parts)
    shutil.copytree(parts[changed].partition(":")[2], tmp_path / changed)
    own[changed] = f"jacquard:{tmp_path / changed}"
    experiment = make(own, cache)
    train(experiment, tmp_path / "out")
    (label,) = (tmp_path / changed).rglob("0_bar-000000_grasps.txt")
    label.write_text("16;16;10;12;4\n")
    with pytest.raises(FileFormatError, match=rf"changed since this run began \({changed}_store\)"):
        train(experiment, tmp_path / "out")


def test_fewer_objects_of_the_training_part(parts, cache, tmp_path):
    chosen = []
    for count in (2, 4):
        one = make(parts, cache, split={"limit_objects": count})
        train(one.model_copy(update={"training": one.training.model_copy(update={"epochs": 0})}),
              tmp_path / str(count))  # fmt: skip
        chosen.append(set(read_split(tmp_path / str(count) / "split.json").parts["train"]))
    assert [len(ids) for ids in chosen] == [2, 4]
    assert chosen[0] < chosen[1]


@pytest.mark.parametrize(
    ("split", "key"),
    [
        ({"train": 0.7, "validation": 0.2}, "train"),
        ({"folds": 5}, "folds"),
        ({"folds": 5, "fold": 2}, "folds"),
        ({"file": "split.json"}, "file"),
    ],
)
def test_dividing_what_is_not_divided_is_told_before_any_work(parts, cache, tmp_path, split, key):
    with pytest.raises(ConfigError, match=rf"data\.split\.{key}") as caught:
        train(make({**parts, "train": "jacquard:/nowhere"}, cache, split=split), tmp_path / "out")
    assert "data.validation" in str(caught.value)
    assert not (tmp_path / "out" / "experiment.yaml").exists()


def test_a_validation_part_needs_a_test_part(parts, cache):
    with pytest.raises(ConfigError, match=r"data\.test: is null"):
        check_experiment(make(parts, cache, test=None))
    check_experiment(make(parts, cache, validation=None))


@pytest.mark.parametrize("part", ["validation", "test"])
def test_an_object_in_two_parts_is_refused(parts, cache, tmp_path, part):
    # Number 7 of the training part's seed, under the name that its own number gives it.
    write_part(tmp_path / part, 9, 2)
    write_part(tmp_path / part, 1, 1, first=7)
    other = {**parts, part: f"jacquard:{tmp_path / part}"}
    with pytest.raises(FileError, match=r"shares 1 objects with the train part.*7_bar-000007"):
        train(make(other, cache), tmp_path / "out")


def test_validation_and_test_share_nothing_either(parts, cache, tmp_path):
    with pytest.raises(FileError, match="shares 3 objects with the validation part"):
        train(make({**parts, "test": parts["validation"]}, cache), tmp_path / "out")


def test_names_tell_nothing(parts):
    """Each part has objects of the same names; they are others, for their seeds are."""
    scenes = {name: read_scenes(source) for name, source in parts.items()}
    assert len({tuple(s.object_id(0) for s in scenes.values())}) == 1
    check_apart(scenes)


def test_without_records_the_same_files_are_the_same_objects(tmp_path):
    for name in ("a", "b"):
        write_part(tmp_path / name, 1, 2)
        for record in (tmp_path / name).rglob("*_scene.json"):
            record.unlink()
    first, second = (read_scenes(f"jacquard:{tmp_path / name}") for name in ("a", "b"))
    check_apart({"train": first, "test": second})
    with pytest.raises(FileError, match="shares 2 objects"):
        check_apart({"train": first, "test": read_scenes(f"jacquard:{tmp_path / 'a'}")})


def test_a_validation_part_has_the_truth_of_every_task(parts, cache, tmp_path):
    other = {**parts, "validation": write_part(tmp_path / "bare", 8, 2, masks=False)}
    one = make(other, cache)
    tasks = type(one.tasks).model_validate({"saliency": {}})
    with pytest.raises(FileError, match=r"no mask, which tasks\.saliency needs"):
        train(one.model_copy(update={"tasks": tasks}), tmp_path / "out")


def test_keys_of_objects_are_read_from_real_records(generated):
    paths = sorted(Path(generated).rglob("*_scene.json"))
    assert {read_object_keys(path) for path in paths} == {
        frozenset({("procedural", "0", str(i))}) for i in range(3)
    }


@pytest.mark.parametrize("text", ["", "[]", '{"objects": 3}', '{"objects": [{"source": {}}, 2]}',
                                  '{"objects": [{"source": {"kind": "procedural"}}]}'])  # fmt: skip
def test_damaged_records_are_told(tmp_path, text):
    (tmp_path / "0_a_scene.json").write_text(text)
    with pytest.raises(FileFormatError, match="is no record of a scene"):
        read_object_keys(tmp_path / "0_a_scene.json")
