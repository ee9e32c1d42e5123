"""Limited training sets: whole objects, nested, the same on every machine."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.data import limit_objects
from graspmap.data.scene import Scenes
from graspmap.errors import InvalidInputError


class Listed(Scenes):
    """Scenes that are only listed: three of each object, and one without."""

    kind, root = "listed", Path("listed")

    def __init__(self, objects: int) -> None:
        self.ids = ("alone", *(f"{view}_{o}" for o in range(objects) for view in range(3)))

    def object_id(self, index):
        return None if index == 0 else self.ids[index].split("_")[1]

    def read(self, index):  # noqa: ARG002
        raise AssertionError("pictures are not looked at")

    read_grasps = files = read


@given(objects=st.integers(1, 12), seed=st.integers(0, 2**63), data=st.data())
def test_whole_objects_and_fewer_are_some_of_more(objects, seed, data):
    scenes = Listed(objects)
    count = data.draw(st.integers(1, objects + 1))
    kept = limit_objects(scenes, scenes.ids, count, seed=seed)
    assert list(kept) == [name for name in scenes.ids if name in set(kept)]
    shown = [scenes.object_id(scenes.index(name)) for name in kept]
    assert len(set(shown)) == count
    assert all(shown.count(name) == 3 for name in shown if name is not None)
    if count > 1:
        assert set(limit_objects(scenes, scenes.ids, count - 1, seed=seed)) < set(kept)
    assert limit_objects(scenes, scenes.ids, objects + 1, seed=seed) == scenes.ids


def test_by_image_and_out_of_a_part():
    scenes = Listed(4)
    part = scenes.ids[4:]
    kept = limit_objects(scenes, part, 5, by="image")
    assert len(kept) == 5
    assert set(kept) <= set(part)
    assert limit_objects(scenes, part, 3) == part


def test_the_choice_of_a_seed_never_changes():
    scenes = Listed(6)
    kept = limit_objects(scenes, scenes.ids, 2, seed=5)
    assert kept == ("0_1", "1_1", "2_1", "0_3", "1_3", "2_3")
    assert limit_objects(scenes, scenes.ids, 2, seed=8) != kept


@pytest.mark.parametrize("count", [0, 6])
def test_more_objects_than_there_are(count):
    scenes = Listed(4)
    with pytest.raises(InvalidInputError, match=r"number of objects to keep is .*1 to 5, all"):
        limit_objects(scenes, scenes.ids, count)
