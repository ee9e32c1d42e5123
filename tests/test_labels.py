"""Class labels of the Cornell pictures, and the objects told from them."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest

from graspmap.data.appendix import (
    LABELS_FILE,
    cornell_labels,
    cornell_objects,
    read_label_tables,
)
from graspmap.errors import FileFormatError, MissingFileError


def test_counts_of_the_appendix():
    labels = cornell_labels()
    assert len(labels) == 885
    assert len({label["specific"] for label in labels.values()}) == 80
    assert len({label["general"] for label in labels.values()}) == 9
    # The numbers 0950 to 0999 were never given.
    numbers = [*range(100, 950), *range(1000, 1035)]
    assert list(labels) == [f"pcd{number:04d}" for number in numbers]


@pytest.mark.parametrize(
    ("name", "specific", "general"),
    [
        ("pcd0100", "remote", "electronics"),
        ("pcd0247", "frisbee", "toy"),
        ("pcd0326", "bowl", "crockery"),
        ("pcd0327", "headphones", "electronics"),
        ("pcd0949", "lock", "work tool"),
        ("pcd1003", "lollipop", "food"),
        ("pcd1034", "spoon", "cooking utensil"),
    ],
)
def test_rows_of_the_tables(name, specific, general):
    assert cornell_labels()[name] == {"specific": specific, "general": general}


def test_each_specific_class_has_one_general_class():
    pairs = {(label["specific"], label["general"]) for label in cornell_labels().values()}
    assert len(pairs) == 80


def test_labels_cannot_be_changed():
    with pytest.raises(TypeError):
        cornell_labels()["pcd0100"] = {}
    with pytest.raises(TypeError):
        cornell_labels()["pcd0100"]["specific"] = "mug"


def test_objects_are_undivided_runs_of_a_class():
    labels, objects = cornell_labels(), cornell_objects()
    assert objects.keys() == labels.keys()
    assert objects["pcd0137"] == objects["pcd0152"] == "box-0137"
    assert objects["pcd0260"] == "box-0260"
    assert objects["pcd0153"] == "glasses-0153"
    # No number lies between 0949 and 1000, so the lock there may be the same one.
    assert objects["pcd0949"] == objects["pcd1000"] == "lock-0934"
    names = list(labels)
    for a, b in itertools.pairwise(names):
        same_class = labels[a]["specific"] == labels[b]["specific"]
        assert (objects[a] == objects[b]) == same_class
    # Two runs never share a name.
    runs = 1 + sum(objects[a] != objects[b] for a, b in itertools.pairwise(names))
    assert runs == len(Counter(objects.values()))


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("classes: 80", "classes: 79", "lists 80 classes, but says 79"),
        ('apple: "0820-0823"', 'apple: "0820-0822"', "lists 884 images, but says 885"),
        ('asparagus: "0804-0807"', 'asparagus: "0823-0826"', "pcd0823 has two specific classes"),
        ('apple: "0820-0823"', 'apple: "0820-0822, 0950"', "has a class in one table only"),
        ('apple: "0820-0823"', 'apple: "082"', "is no range of pictures"),
        ("general:", "generals:", "is no table of class labels"),
        ("specific:\n", "specific: [\n", "is no table of class labels"),
    ],
)
def test_a_damaged_table_is_found(tmp_path, old, new, problem):
    text = LABELS_FILE.read_text()
    assert old in text
    path = tmp_path / "labels.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=problem):
        read_label_tables(path)


def test_a_missing_table(tmp_path):
    with pytest.raises(MissingFileError):
        read_label_tables(tmp_path / "labels.yaml")
