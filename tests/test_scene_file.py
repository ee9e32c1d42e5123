"""Records of scenes: what is written comes back, and what is wrong in a file is named."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from graspmap.errors import FileFormatError, InvalidInputError, MissingFileError
from graspmap.generation.model_file import read_model, write_model
from graspmap.generation.scene_file import (
    RecordedObject,
    SceneRecord,
    find_record,
    read_record,
    versions,
    write_record,
)
from graspmap.generation.sources import Fingerprint, MeshSource, ProceduralSource
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import load_gripper
from graspmap.simulation.objects import Texture
from graspmap.simulation.procedural import ObjectRanges, make_object
from graspmap.simulation.render import jacquard_view, plain_appearance
from graspmap.simulation.settings import TrialSettings
from graspmap.simulation.shake import Shake
from graspmap.simulation.tabletop import PlacedObject, Tabletop

BLOCK = make_object(4, 7, families=("primitive",))
POSE = RigidTransform.from_quaternion([0.1, 0.7, -0.3, 0.64], [0.1, -1 / 3, 0.05])


def record(**changes) -> SceneRecord:
    source = ProceduralSource(seed=4, index=7, families=("primitive",), ranges=ObjectRanges())
    placed = PlacedObject(BLOCK, POSE)
    values = {
        "id": f"3_{BLOCK.id}",
        "objects": (RecordedObject(BLOCK.id, source, Fingerprint.of(BLOCK), POSE),),
        "view": jacquard_view(320),
        "gripper": load_gripper("franka"),
        "settings": TrialSettings(lift_m=0.07, shake=Shake()),
        "seed": (0, 1, 0, 3, 0),
        "appearance": plain_appearance(Tabletop.of((placed,))),
        "versions": versions(),
    }
    return SceneRecord(**{**values, **changes})


def test_what_is_written_comes_back_to_the_last_bit(tmp_path):
    folder = tmp_path / BLOCK.id
    path = write_record(record(), folder)
    assert path.name == f"3_{BLOCK.id}_scene.json"
    found = read_record(path)
    assert found == record(root=tmp_path)
    assert write_record(found, tmp_path / "again").read_bytes() == path.read_bytes()
    (placed,) = found.tabletop().objects
    assert placed.T_world_object == POSE
    for name in ("vertices", "faces", "inertia"):
        np.testing.assert_array_equal(getattr(placed.model, name), getattr(BLOCK, name))
    expected = Tabletop.of((PlacedObject(BLOCK, POSE),)).height_map.heights_m
    np.testing.assert_array_equal(found.tabletop().height_map.heights_m, expected)


def test_objects_carry_their_class_names(tmp_path):
    from graspmap.data.jacquard_labels import read_class_names

    path = write_record(record(), tmp_path / "a")
    shape = BLOCK.id.removesuffix("-000007")
    assert read_class_names(path) == {"specific": shape, "general": "primitive"}
    (one,) = record().objects
    # Of several objects none is the class of the scene.
    assert read_class_names(write_record(record(objects=(one, one)), tmp_path / "b")) == {}
    mesh = replace(one, source=MeshSource(file="a.obj", hash="0", model_file="models/a.npz"))
    assert read_class_names(write_record(record(objects=(mesh,)), tmp_path / "c")) == {}


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"objects": 3}', '{"objects": [[]]}', "[" * 9999]
)
def test_a_damaged_record_is_named_by_who_reads_class_names(tmp_path, text):
    from graspmap.data.jacquard_labels import read_class_names

    (tmp_path / "x_scene.json").write_text(text)
    with pytest.raises(FileFormatError, match=r"x_scene\.json: is no record"):
        read_class_names(tmp_path / "x_scene.json")


def test_objects_from_meshes_come_from_the_data_set(tmp_path):
    texture = Texture(
        np.arange(48, dtype=np.uint8).reshape(4, 4, 3), np.zeros((len(BLOCK.vertices), 2))
    )
    model = replace(BLOCK, id="cup", texture=texture)
    write_model(tmp_path / "models" / "cup.npz", model)
    write_model(tmp_path / "again.npz", model)
    content = (tmp_path / "models" / "cup.npz").read_bytes()
    assert content == (tmp_path / "again.npz").read_bytes()
    source = MeshSource(file="a/cup.obj", hash="12", model_file="models/cup.npz")
    item = RecordedObject("cup", source, Fingerprint.of(model), POSE)
    path = write_record(record(id="0_cup", objects=(item,)), tmp_path / "cup")
    (placed,) = read_record(path).tabletop().objects
    assert placed.model.id == "cup"
    assert placed.model.mass_kg == model.mass_kg
    np.testing.assert_array_equal(placed.model.vertices, model.vertices)
    np.testing.assert_array_equal(placed.model.texture.image, texture.image)
    for found, piece in zip(placed.model.pieces, model.pieces, strict=True):
        np.testing.assert_array_equal(found, piece)
    (tmp_path / "models" / "cup.npz").write_bytes(content[: len(content) // 2])
    with pytest.raises(FileFormatError, match="no model of graspmap"):
        read_record(path).tabletop()
    (tmp_path / "models" / "cup.npz").unlink()
    with pytest.raises(MissingFileError):
        read_record(path).tabletop()
    (tmp_path / "x.npz").write_bytes(b"no archive")
    with pytest.raises(FileFormatError):
        read_model(tmp_path / "x.npz", "x")


def test_an_object_that_has_become_another_is_refused(tmp_path):
    other = Fingerprint.of(BLOCK).model_copy(update={"mass_kg": BLOCK.mass_kg * 1.001})
    item = replace(record().objects[0], fingerprint=other)
    path = write_record(record(objects=(item,)), tmp_path)
    with pytest.raises(InvalidInputError, match="another one than was recorded"):
        read_record(path).tabletop()


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda v: v.pop("camera"), "camera: Field required"),
        (lambda v: v.update(colour=1), "colour: Extra inputs"),
        (lambda v: v.update(format="graspmap-scene-0"), "format"),
        (lambda v: v["camera"].update(fx=-1), "fx is -1"),
        (lambda v: v["gripper"].update(force_n=0), "force_n is 0"),
        (lambda v: v["settings"].update(lift_m=-1), "lift_m"),
        (lambda v: v["objects"][0]["T_world_object"][0].__setitem__(0, 7.0), "rotation"),
        (lambda v: v["objects"][0]["source"].update(kind="magic"), "objects.0.source"),
        (lambda v: v.update(seed="x"), "seed"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(change, part, tmp_path):
    path = write_record(record(), tmp_path)
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))
    with pytest.raises(FileFormatError) as caught:
        read_record(path)
    assert part in str(caught.value)
    assert str(path) in str(caught.value)


def test_records_are_found_beside_the_colour_picture(tmp_path):
    picture = tmp_path / "a_RGB.png"
    assert find_record([picture]) is None
    assert find_record([tmp_path / "a_mask.png"]) is None
    (tmp_path / "a_scene.json").write_text("{")
    assert find_record([tmp_path / "a_mask.png", picture]) == tmp_path / "a_scene.json"
    with pytest.raises(FileFormatError, match="no record of a scene"):
        read_record(tmp_path / "a_scene.json")
