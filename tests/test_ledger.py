"""The ledger: whatever an earlier run left, the next one knows what is finished."""

from __future__ import annotations

import json

import pytest

from graspmap.errors import FileError, FileFormatError
from graspmap.generation.entries import ItemEntry, MeshEntry, SceneEntry, manifest_entries
from graspmap.generation.ledger import Ledger, differences, file_hash, staging_folder

PLAN = {"scenes": 6, "seed": 1, "gripper": {"name": "a", "force_n": 50.0}, "meshes": {}}


def ledger(root, plan=PLAN):
    root.mkdir(exist_ok=True)
    return Ledger(
        root, plan, -(-plan["scenes"] // 2), lambda item: min(2, plan["scenes"] - 2 * item)
    )


def item(root, number, *, content=b"picture", name="mug", rejects=None):
    """An item with two scenes, its files in the staging folder."""
    scenes = []
    for view in range(2):
        id = f"{2 * number + view}_{name}"
        path = staging_folder(root, number) / name / f"{id}_RGB.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content + id.encode())
        files = {f"{name}/{id}_RGB.png": file_hash(path)}
        scenes.append(SceneEntry(id, name, 5, {"held": 5, "empty": 2}, files))
    return ItemEntry(number, tuple(scenes), rejects or {})


def snapshot(root):
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def filled(root, numbers=(0, 1, 2)):
    book = ledger(root)
    for number in numbers:
        book.add_item(item(root, number, name=f"mug{number}", rejects={"unsettled": number}))
    return book


def test_finishing_gives_counts_and_hashes_of_all_files(tmp_path):
    content = filled(tmp_path / "a").finish()
    assert content["counts"] == {
        "scenes": 6,
        "missing_scenes": 0,
        "objects": 3,
        "labels": 30,
        "trials": 42,
        "outcomes": {"empty": 12, "held": 30},
        "rejects": {"unsettled": 3},
    }
    files = snapshot(tmp_path / "a")
    assert json.loads(files.pop("manifest.json")) == content
    assert list(content["files"]) == sorted(files)
    for path, value in content["files"].items():
        assert file_hash(tmp_path / "a" / path) == value


def test_a_manifest_gives_its_entries_back(tmp_path):
    book = ledger(tmp_path)
    model = tmp_path / "models" / "cup.npz"
    model.parent.mkdir()
    model.write_bytes(b"model")
    good = MeshEntry("a/cup.obj", "12", "cup", {"models/cup.npz": file_hash(model)}, "", ("open",))
    bad = MeshEntry("b.obj", "34", "b", problem="is empty")
    book.add_mesh(good)
    book.add_mesh(bad)
    items = [item(tmp_path, number, name="a_b" if number else "a") for number in range(3)]
    for entry in items:
        book.add_item(entry)
    content = book.finish()
    assert content["counts"]["rejects"] == {"bad mesh": 1}
    assert manifest_entries(content) == [good, bad, *items]
    again = ledger(tmp_path)
    assert [again.items[i] for i in range(3)] == items
    assert again.meshes == {"a/cup.obj": good, "b.obj": bad}


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)])
def test_a_run_in_pieces_ends_like_one_run(tmp_path, order):
    filled(tmp_path / "whole").finish()
    filled(tmp_path / "cut", order[:1]).close()
    (tmp_path / "cut" / ".mask.png.x1.part").write_bytes(b"half")
    item(tmp_path / "cut", order[1], name="other")  # staged, never entered
    book = ledger(tmp_path / "cut")
    assert set(book.items) == {order[0]}
    for number in order[1:]:
        assert not staging_folder(tmp_path / "cut", number).exists()
        entry = item(tmp_path / "cut", number, name=f"mug{number}", rejects={"unsettled": number})
        book.add_item(entry)
    book.finish()
    assert snapshot(tmp_path / "cut") == snapshot(tmp_path / "whole")


@pytest.mark.parametrize("cut", [1, 30, 200])
def test_a_line_that_was_cut_short_is_forgotten(tmp_path, cut):
    book = filled(tmp_path, (0, 1))
    book.close()
    journal = tmp_path / "unfinished.jsonl"
    journal.write_bytes(journal.read_bytes()[:-cut])
    assert set(ledger(tmp_path).items) == {0}


def test_a_damaged_or_missing_file_is_to_be_made_again(tmp_path):
    filled(tmp_path).finish()
    before = snapshot(tmp_path)
    (tmp_path / "mug1" / "2_mug1_RGB.png").write_bytes(b"damaged")
    (tmp_path / "mug2" / "5_mug2_RGB.png").unlink()
    book = ledger(tmp_path)
    assert set(book.items) == {0}
    assert not (tmp_path / "manifest.json").exists()  # it spoke for a whole data set
    for number in (1, 2):
        book.add_item(item(tmp_path, number, name=f"mug{number}", rejects={"unsettled": number}))
    book.finish()
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize("killed", [False, True])
def test_more_scenes_may_be_added_and_what_an_item_loses_is_removed(tmp_path, killed):
    small = {**PLAN, "scenes": 5}
    book = ledger(tmp_path, small)
    book.add_item(item(tmp_path, 0))
    book.add_item(item(tmp_path, 1))
    entry = item(tmp_path, 2, name="old")
    book.add_item(ItemEntry(2, entry.scenes[:1], {}))  # the last item had room for one view only
    book.finish()
    assert (tmp_path / "old" / "4_old_RGB.png").exists()
    book = ledger(tmp_path)
    assert set(book.items) == {0, 1}
    if killed:
        book.close()
        book = ledger(tmp_path)
    book.add_item(item(tmp_path, 2, name="new"))
    assert not (tmp_path / "old" / "4_old_RGB.png").exists()
    assert book.finish()["counts"]["scenes"] == 6


def test_another_plan_is_refused_with_what_differs(tmp_path):
    filled(tmp_path).close()
    changed = {**PLAN, "seed": 2, "gripper": {"name": "a", "force_n": 20.0}}
    with pytest.raises(FileError, match=r"seed: 1 -> 2; gripper\.force_n: 50\.0 -> 20\.0"):
        ledger(tmp_path, changed)
    with pytest.raises(FileError, match="scenes: 6 -> 5"):
        ledger(tmp_path, {**PLAN, "scenes": 5})
    assert set(ledger(tmp_path).items) == {0, 1, 2}


def test_strange_folders_and_damaged_ledgers_are_refused(tmp_path):
    (tmp_path / "photo.png").write_bytes(b"")
    with pytest.raises(FileError, match=r"something else than generated scenes \(photo\.png\)"):
        ledger(tmp_path)
    for name, text in (
        ("unfinished.jsonl", "{}\n"),
        ("unfinished.jsonl", '{"format":"graspmap-manifest-1","plan":{}}\nx\n'),
        ("unfinished.jsonl", '{"format":"graspmap-manifest-1","plan":{}}\n{"item":{}}\n'),
        ("unfinished.jsonl", '{"format":"graspmap-manifest-1","plan":{}}\n{"thing":{}}\n'),
        ("manifest.json", "{}"),
        ("manifest.json", '{"format": "graspmap-manifest-1", "plan": {}}'),
        ("manifest.json", "[1]"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(FileError) as caught:
            Ledger(tmp_path, {"scenes": 1}, 1, lambda _: 1)
        assert isinstance(caught.value, FileFormatError) or "another plan" in str(caught.value)
        (tmp_path / name).unlink()


def test_differences_of_nested_values():
    assert differences({"a": {"b": 1, "c": [1]}, "d": None}, {"a": {"b": 1, "c": [1]}}) == []
    old, new = {"a": {"b": 1}, "d": "x" * 50}, {"a": {"b": 2}, "e": 3}
    assert differences(old, new) == ["a.b: 1 -> 2", f"d: {'x' * 37}... -> none", "e: none -> 3"]
