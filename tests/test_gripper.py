"""Grippers: profiles are read strictly, what cannot be is refused, drawings are to scale."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap import cli
from graspmap.errors import (
    ConfigError,
    FileFormatError,
    InvalidInputError,
    MissingFileError,
    UnknownNameError,
)
from graspmap.gripper import Gripper, load_gripper, profile_names, profile_path
from graspmap.pictures import gripper_picture
from graspmap.pictures.draw import JAW, OPENING
from graspmap.pictures.gripper import _OBJECT

NAMES = ["franka", "jacquard", "robotiq-2f85", "widowx"]
FRANKA = yaml.safe_load(profile_path("franka").read_text(encoding="utf-8"))


@pytest.fixture
def file(tmp_path):
    def write(**changes) -> Path:
        values = {key: value for key, value in (FRANKA | changes).items() if value is not ...}
        path = tmp_path / "mine.yaml"
        path.write_text(yaml.safe_dump(values), encoding="utf-8")
        return path

    return write


# What ships.


def test_these_profiles_ship():
    assert profile_names() == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_profile_is_whole_and_says_where_its_numbers_come_from(name):
    gripper = load_gripper(name)
    assert gripper.name == name
    assert gripper.description
    text = profile_path(name).read_text(encoding="utf-8")
    assert set(yaml.safe_load(text)) == set(gripper.to_dict())
    assert text.count("ssumed") + text.count("Chosen") >= 2
    lengths = [*gripper.jaw_sizes_m, *gripper.palm_size_m, gripper.finger_length_m]
    assert max(lengths) <= 0.3
    assert (gripper.on_touch == "stop") == (name == "jacquard")


def test_the_numbers_that_jacquards_trials_were_chosen_with():
    gripper = load_gripper("jacquard")
    assert gripper.jaw_sizes_m == (0.01, 0.02, 0.03, 0.04, 0.06)
    assert (gripper.min_opening_m, gripper.max_opening_m) == (0, 0.24)
    assert (gripper.force_n, gripper.friction, gripper.jaw_contact_share) == (50, 0.4, 0.8)
    assert (gripper.max_depth_m, gripper.table_clearance_m) == (0.04, 0.003)
    assert (gripper.on_touch, gripper.touch_gap_m) == ("stop", 0.001)


def test_profiles_are_in_the_wheel(tmp_path):
    pytest.importorskip("hatchling")
    root = Path(__file__).parents[1]
    build = (
        "import sys; from hatchling.builders.wheel import WheelBuilder;"
        "print(next(WheelBuilder(sys.argv[1]).build(directory=sys.argv[2], versions=['standard'])))"
    )
    done = subprocess.run(
        [sys.executable, "-c", build, str(root), str(tmp_path)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    names = zipfile.ZipFile(done.stdout.strip()).namelist()
    for name in NAMES:
        assert f"graspmap/gripper/profiles/{name}.yaml" in names


def test_a_gripper_loads_neither_pydantic_nor_anything_heavy():
    code = (
        "import sys; from graspmap.gripper import load_gripper; load_gripper('franka');"
        "print([m for m in ('pydantic', 'torch', 'cv2', 'scipy', 'numba') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


# The value.


@pytest.mark.parametrize("name", NAMES)
def test_a_gripper_is_a_value(name):
    gripper = load_gripper(name)
    assert pickle.loads(pickle.dumps(gripper)) == gripper
    assert len({gripper, load_gripper(name), replace(gripper, friction=0.123)}) == 2
    written = json.loads(json.dumps(gripper.to_dict()))
    assert Gripper.from_dict(written) == gripper
    assert hash(Gripper.from_dict(written)) == hash(gripper)


@settings(max_examples=40)
@given(
    opening=st.tuples(st.floats(0, 0.2), st.floats(0.001, 0.3)),
    jaws=st.lists(st.integers(1, 400), min_size=1, max_size=6, unique=True),
    depth=st.floats(0.01, 1).flatmap(lambda long: st.tuples(st.floats(0.001, long), st.just(long))),
    force=st.floats(0.01, 5000),
)
def test_round_trip_through_a_file(tmp_path_factory, opening, jaws, depth, force):
    gripper = replace(
        load_gripper("franka"),
        min_opening_m=opening[0],
        max_opening_m=sum(opening),
        jaw_sizes_m=sorted(jaw / 1000 for jaw in jaws),
        max_depth_m=depth[0],
        finger_length_m=depth[1],
        force_n=np.float32(force),
    )
    path = tmp_path_factory.getbasetemp() / "round.yaml"
    path.write_text(yaml.safe_dump(gripper.to_dict()), encoding="utf-8")
    assert load_gripper(path) == gripper


@pytest.mark.parametrize(
    ("changes", "key", "part"),
    [
        ({"max_opening_m": 85}, "max_opening_m", "85 millimetres are 0.085 metres"),
        ({"jaw_sizes_m": [20]}, "jaw_sizes_m", "20 millimetres are 0.02 metres"),
        ({"palm_size_m": [0.2, 60]}, "palm_size_m", "60 millimetres"),
        ({"max_opening_m": 900}, "max_opening_m", "at most 0.5 metres"),
        ({"min_opening_m": 0.08}, "max_opening_m", "cannot open"),
        ({"min_opening_m": 0.1}, "max_opening_m", "more than min_opening_m, 0.1"),
        ({"min_opening_m": -0.01}, "min_opening_m", "from 0"),
        ({"max_opening_m": 0}, "max_opening_m", "more than 0"),
        ({"jaw_sizes_m": []}, "jaw_sizes_m", "at least one"),
        ({"jaw_sizes_m": [0.02, 0.01]}, "jaw_sizes_m", "ascending"),
        ({"jaw_sizes_m": [0.02, 0.02]}, "jaw_sizes_m", "each once"),
        ({"jaw_sizes_m": [0.0]}, "jaw_sizes_m", "more than 0"),
        ({"jaw_sizes_m": 0.02}, "jaw_sizes_m", "a list"),
        ({"jaw_sizes_m": "0.02"}, "jaw_sizes_m", "a list"),
        ({"jaw_sizes_m": ["0.02"]}, "jaw_sizes_m", "a number"),
        ({"palm_size_m": [0.2]}, "palm_size_m", "two sizes"),
        ({"palm_size_m": [0.2, 0.1, 0.1]}, "palm_size_m", "two sizes"),
        ({"jaw_contact_share": 1.01}, "jaw_contact_share", "at most 1"),
        ({"jaw_contact_share": 0}, "jaw_contact_share", "more than 0"),
        ({"finger_thickness_m": 0}, "finger_thickness_m", "more than 0"),
        ({"finger_length_m": 45}, "finger_length_m", "45 millimetres"),
        ({"max_depth_m": 0.046}, "max_depth_m", "finger_length_m, 0.045"),
        ({"friction": 3.1}, "friction", "at most 3"),
        ({"friction": 0}, "friction", "more than 0"),
        ({"friction": True}, "friction", "a number"),
        ({"friction": "0.6"}, "friction", "a number"),
        ({"friction": None}, "friction", "a number"),
        ({"friction": [0.6]}, "friction", "a number"),
        ({"force_n": float("nan")}, "force_n", "newton"),
        ({"force_n": float("inf")}, "force_n", "newton"),
        ({"force_n": -1}, "force_n", "more than 0"),
        ({"torsional_friction_m": -1}, "torsional_friction_m", "from 0"),
        ({"finger_mass_kg": 0}, "finger_mass_kg", "kilogram"),
        ({"closing_speed_m_s": 0}, "closing_speed_m_s", "metres per second"),
        ({"table_clearance_m": 3}, "table_clearance_m", "3 millimetres"),
        ({"touch_gap_m": -0.001}, "touch_gap_m", "from 0"),
        ({"on_touch": "halt"}, "on_touch", "fail, stop"),
        ({"on_touch": ["fail"]}, "on_touch", "fail, stop"),
        ({"name": ""}, "name", "letters"),
        ({"name": "a/b"}, "name", "letters"),
        ({"name": 5}, "name", "letters"),
        ({"description": "two\nlines"}, "description", "one line"),
    ],
)
def test_what_no_gripper_can_be(file, changes, key, part):
    path = file(**changes)
    with pytest.raises(ConfigError) as caught:
        load_gripper(path)
    assert (caught.value.path, caught.value.key) == (path, key)
    assert part in caught.value.remedy
    assert "\n" not in str(caught.value)
    with pytest.raises(InvalidInputError) as built:
        Gripper.from_dict(FRANKA | changes)
    assert built.value.name == key
    assert part in built.value.allowed


def test_wrong_and_missing_keys(file):
    with pytest.raises(ConfigError, match="frictoin: no such key; did you mean friction"):
        load_gripper(file(friction=..., frictoin=0.6))
    with pytest.raises(UnknownNameError, match="did you mean 'friction'"):
        Gripper.from_dict(FRANKA | {"frictoin": 0.6})
    with pytest.raises(ConfigError, match="friction: is missing; allowed: values for friction"):
        load_gripper(file(friction=...))
    assert load_gripper(file(description=...)).description == ""


def test_names_and_paths(tmp_path, file, monkeypatch):
    with pytest.raises(UnknownNameError, match="did you mean 'franka'"):
        load_gripper("franca")
    with pytest.raises(MissingFileError, match="gripper show franka --yaml"):
        load_gripper("franca.yaml")
    with pytest.raises(MissingFileError):
        load_gripper(tmp_path / "franka")
    mine = file(name="mine")
    assert load_gripper(str(mine)).name == "mine"
    monkeypatch.chdir(tmp_path)
    assert load_gripper("mine.yaml").name == "mine"
    mine.rename("other")
    assert load_gripper("other").name == "mine"
    # A file of the same name does not hide what ships.
    mine.with_name("other").rename("franka")
    assert load_gripper("franka").name == "franka"
    for content in ("", "- 1", "name: [", "\0"):
        Path("bad.yaml").write_text(content)
        with pytest.raises(FileFormatError):
            load_gripper("bad.yaml")


# The drawing.


def runs(row, color):
    """Columns (first, last + 1) of the stretches of one colour in a row."""
    hit = np.flatnonzero((row == color).all(axis=1))
    if not len(hit):
        return []
    parts = np.split(hit, np.flatnonzero(np.diff(hit) > 1) + 1)
    return [(part[0], part[-1] + 1) for part in parts]


@pytest.mark.parametrize("name", NAMES)
def test_the_drawing_is_to_scale(name):
    gripper = load_gripper(name)
    picture = gripper_picture(gripper)
    assert picture.dtype == np.uint8
    assert picture.shape[1] == 1280
    # A row through the held object crosses: pad, object, pad of the open view; pads of the closed
    # one; the jaws from the side.
    rows = np.flatnonzero((picture == _OBJECT).all(axis=2).any(axis=1))
    row = picture[rows[len(rows) // 4]]
    ((left, right),) = runs(row, _OBJECT)
    held = right - left
    scale = held / (0.6 * gripper.max_opening_m)
    pads = runs(row, JAW)
    inner = [end for _, end in pads if end <= left][-1], next(a for a, _ in pads if a >= right)
    assert inner[1] - inner[0] == pytest.approx(scale * gripper.max_opening_m, abs=3)
    jaw = pads[-1]
    share = gripper.jaw_contact_share * gripper.jaw_sizes_m[0]
    assert jaw[1] - jaw[0] == pytest.approx(scale * share, abs=3)
    depth = len(rows) / scale
    assert depth == pytest.approx(gripper.max_depth_m + gripper.table_clearance_m, abs=3 / scale)
    assert (picture == OPENING).all(axis=2).any()


def test_extreme_grippers_are_drawn():
    base = load_gripper("franka")
    for gripper in (
        replace(base, max_opening_m=0.5, palm_size_m=(0.01, 0.001), jaw_sizes_m=(0.001, 0.5)),
        replace(base, finger_length_m=1, max_depth_m=1, max_opening_m=0.001),
        replace(base, finger_length_m=0.001, max_depth_m=0.001, min_opening_m=0.079),
        replace(base, jaw_sizes_m=tuple(np.linspace(0.01, 0.1, 12)), description="long " * 60),
    ):
        picture = gripper_picture(gripper, width=800)
        assert picture.shape[1] == 800
        assert 200 < picture.shape[0] < 1600
    with pytest.raises(InvalidInputError):
        gripper_picture(base, width=100)


# The command.


def run(capsys, *words):
    code = cli.main([str(word) for word in words])
    return code, *capsys.readouterr()


def test_list(capsys, tmp_path):
    code, out, _ = run(capsys, "gripper", "list", "--json", tmp_path / "l.json")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == NAMES
    listed = json.loads((tmp_path / "l.json").read_text())
    assert [Gripper.from_dict(values) for values in listed] == [load_gripper(n) for n in NAMES]


def test_show_writes_what_it_says(capsys, tmp_path):
    picture = tmp_path / "new" / "a.png"
    code, out, err = run(
        capsys, "gripper", "show", "widowx", "--out", picture, "--json", tmp_path / "a.json"
    )
    assert (code, err) == (0, "")
    assert "opens from 0 to 80 mm" in out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "a.json").read_text()) == load_gripper("widowx").to_dict()
    code, out, _ = run(capsys, "gripper", "show", "widowx", "--json", "-")
    assert Gripper.from_dict(json.loads(out)) == load_gripper("widowx")


def test_a_profile_to_start_from(capsys, tmp_path):
    code, out, _ = run(capsys, "gripper", "show", "jacquard", "--yaml")
    assert code == 0
    (tmp_path / "mine.yaml").write_text(out.replace("name: jacquard", "name: mine"))
    assert load_gripper(tmp_path / "mine.yaml") == replace(load_gripper("jacquard"), name="mine")
    assert run(capsys, "gripper", "show", tmp_path / "mine.yaml")[0] == 0


def test_the_help_teaches_every_key(capsys):
    code, out, _ = run(capsys, "gripper", "--help")
    assert code == 0
    for key in load_gripper("franka").to_dict():
        assert f"  {key}: " in out
    assert run(capsys, "gripper")[0] == 2


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["shwo"], "did you mean 'show'"),
        (["show", "frank"], "did you mean 'franka'"),
        (["show", "nowhere.yaml"], "no such gripper file"),
        (["show", "franka", "--out", "a.gif"], ".png"),
        (["show", "franka", "--yaml", "--json", "-"], "--yaml"),
    ],
)
def test_mistakes_are_answered_in_one_line(capsys, words, part):
    code, _, err = run(capsys, "gripper", *words)
    assert code == 2
    assert len(err.splitlines()) == 1
    assert part in err


def test_a_profile_is_not_replaced_by_its_own_numbers(capsys, file):
    path = file()
    before = path.read_bytes()
    assert run(capsys, "gripper", "show", path, "--json", path)[0] == 2
    assert path.read_bytes() == before
