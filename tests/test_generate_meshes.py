"""Generation from meshes of the user: bad ones are told and counted, the others used."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import graspmap.generation.item as item_module
from box_mesh import write_box
from graspmap.data import read_scenes
from graspmap.errors import DatasetNotFoundError, FileError, InvalidInputError
from graspmap.generation import generate
from graspmap.generation.catalogue import _taken, divide_meshes
from graspmap.generation.entries import MeshEntry
from graspmap.generation.mesh_folder import find_meshes
from graspmap.generation.plan import GenerationPlan
from graspmap.generation.scene_file import find_record, read_record
from graspmap.gripper import load_gripper

GRIPPER = load_gripper("jacquard")


def plan_for(folder: Path, **changes) -> GenerationPlan:
    values = {"scenes": 5, "views": 1, "seed": 3, "size_px": 128, "candidates": 20, "unit": "m"}
    return GenerationPlan(gripper=GRIPPER, objects=folder, **{**values, **changes})


def snapshot(root: Path) -> dict[str, bytes]:
    return {
        path.relative_to(root).as_posix(): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


@pytest.fixture(scope="module")
def meshes(tmp_path_factory) -> Path:
    """Two good boxes among meshes of every bad kind."""
    folder = tmp_path_factory.mktemp("meshes")
    write_box(folder / "good" / "brick.obj", (0.06, 0.04, 0.03))
    write_box(folder / "good" / "bar one.obj", (0.12, 0.02, 0.02))
    write_box(folder / "bad" / "flat.obj", (0.06, 0.04, 0))
    write_box(folder / "bad" / "house.obj", (1.9, 1.8, 1.2))
    (folder / "bad" / "empty.obj").write_bytes(b"")
    (folder / "bad" / "nan.obj").write_text("v 0 0 nan\nv 0 1 0\nv 1 0 0\nf 1 2 3\n")
    (folder / "bad" / "noise.stl").write_bytes(bytes(range(256)) * 3)
    (folder / "bad" / "gone.obj").symlink_to("nowhere.obj")
    return folder


def test_bad_meshes_are_told_once_and_the_others_used(meshes, tmp_path, caplog):
    plan = plan_for(meshes)
    manifest = generate(plan, tmp_path / "a", workers=0)
    counts = manifest["counts"]
    assert counts["scenes"] == 5
    assert counts["objects"] == 2
    assert counts["rejects"]["bad mesh"] == 5
    assert counts["rejects"]["larger than the picture"] >= item_module.TRIES
    problems = {mesh["file"]: mesh["problem"] for mesh in manifest["meshes"]}
    assert [file for file, problem in problems.items() if not problem] == [
        "bad/house.obj",
        "good/bar one.obj",
        "good/brick.obj",
    ]
    for name in ("empty", "flat", "gone", "nan"):
        told = [record.message for record in caplog.records if f"bad/{name}.obj" in record.message]
        assert len(told) == 1
        assert problems[f"bad/{name}.obj"] in told[0]
    (house,) = [record.message for record in caplog.records if "house" in record.message]
    assert "inf " not in house
    # The data set needs the meshes no more.
    scenes = read_scenes(f"jacquard:{tmp_path / 'a'}")
    record = read_record(find_record(scenes.files(0)))
    assert record.objects[0].source.file.startswith("good/")
    assert record.tabletop().height_map.top_m > 0.01


def test_a_changed_mesh_is_another_plan(meshes, tmp_path):
    folder = tmp_path / "meshes"
    shutil.copytree(meshes / "good", folder)
    plan = plan_for(folder, scenes=3, clutter=2)
    manifest = generate(plan, tmp_path / "a", workers=0)
    assert manifest["counts"]["objects"] == 3  # sets of two bricks each
    before = snapshot(tmp_path / "a")
    generate(plan, tmp_path / "a", workers=0)
    assert snapshot(tmp_path / "a") == before
    write_box(folder / "brick.obj", (0.06, 0.04, 0.02))
    with pytest.raises(FileError, match=r"meshes\.brick\.obj"):
        generate(plan, tmp_path / "a", workers=0)


def test_folders_without_usable_meshes_are_refused(meshes, tmp_path):
    plan = plan_for(meshes / "bad", scenes=1)
    shutil.copytree(meshes / "bad", tmp_path / "bad", symlinks=True)
    (tmp_path / "bad" / "house.obj").unlink()
    with pytest.raises(InvalidInputError, match="5, none of which is usable"):
        generate(replace(plan, objects=tmp_path / "bad"), tmp_path / "a", workers=0)
    with pytest.raises(DatasetNotFoundError, match="no mesh"):
        generate(replace(plan, objects=tmp_path / "a"), tmp_path / "b", workers=0)


def test_clutter_of_meshes_keeps_the_parts_of_the_split_apart():
    entries = [MeshEntry(f"{i}.obj", "", f"mesh{i}") for i in range(25)]
    divided = divide_meshes(entries, 3)
    assert {part: len(meshes) for part, meshes in divided.items()} == {
        "train": 21, "validation": 2, "test": 2,
    }  # fmt: skip
    assert sorted(m.id for part in divided.values() for m in part) == sorted(m.id for m in entries)
    taken = [{mesh.id for mesh, _ in _taken(divided["train"], 3, turn, 7)} for turn in range(9)]
    assert all(set.union(*taken[i : i + 3]) == {m.id for m in divided["train"]} for i in (0, 3, 6))
    assert taken[0] != taken[3]
    names = [name for _, name in _taken(divided["test"], 3, 0, 5)]
    assert len(set(names)) == 5


def test_objects_are_named_after_files_or_folders(tmp_path):
    def names(*files):
        folder = tmp_path / str(len(list(tmp_path.iterdir())))
        for file in files:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(file)
        return {mesh.name: mesh.id for mesh in find_meshes(folder)}

    assert names("b.obj", "sub/a b.STL", "sub/c.txt", ".hidden.obj") == {
        "b.obj": "b",
        "sub/a b.STL": "a-b",
    }
    assert names("mug/textured.obj", "cup/textured.obj") == {
        "cup/textured.obj": "cup",
        "mug/textured.obj": "mug",
    }
    assert set(names("x/a/m.obj", "y/a/m.obj", "x/b/m.obj").values()) == {"x-a-m", "y-a-m", "x-b-m"}
    assert set(names("a b.obj", "a-b.obj").values()) == {"a-b-1", "a-b-2"}
    (long,) = names(f"{'x' * 200}.obj").values()
    assert long == "x" * 100


def test_an_object_in_several_files_is_one(tmp_path, caplog):
    """As YCB has them, and as programs leave them behind; else training would see test objects."""
    same = {"ycb/a/textured.obj": "a", "ycb/a/nontextured.stl": "b", "ycb/a/nontextured.ply": "c"}
    same |= {"cup.STL": "d", "cup.ply": "e", "plate.ply": "f", "copies/dish.ply": "f"}
    for name, content in same.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    found = find_meshes(tmp_path)
    assert [mesh.name for mesh in found] == ["copies/dish.ply", "cup.ply", "ycb/a/textured.obj"]
    assert "4 of 7 mesh files" in caplog.text
    assert "plate.ply" in caplog.text
