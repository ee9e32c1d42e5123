"""Opening a data set by ``kind:directory``."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import graspmap.data
from graspmap.data.cornell import CornellScenes
from graspmap.data.jacquard import JacquardScenes
from graspmap.data.kinds import KINDS, detect_kind, read_scenes, split_spec
from graspmap.errors import (
    DatasetNotFoundError,
    FileFormatError,
    InvalidInputError,
    UnknownNameError,
)


def write_cornell(root):
    root.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(root / "pcd0100r.png"), np.zeros((8, 8, 3), np.uint8))
    return root


def write_jacquard(root):
    root.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(root / "0_cup_RGB.png"), np.zeros((8, 8, 3), np.uint8))
    for name, value in (("perfect", 1.5), ("stereo", 1.25)):
        depth = np.full((8, 8), value, np.float32)
        cv2.imwrite(str(root / f"0_cup_{name}_depth.tiff"), depth)
    return root


def test_by_kind_and_by_the_files(tmp_path):
    cornell, jacquard = write_cornell(tmp_path / "c" / "01"), write_jacquard(tmp_path / "j" / "cup")
    for spec in (f"cornell:{cornell}", str(tmp_path / "c"), tmp_path / "c"):
        assert isinstance(read_scenes(spec), CornellScenes)
    for spec in (f"jacquard:{jacquard}", str(tmp_path / "j"), tmp_path / "j"):
        assert isinstance(read_scenes(spec), JacquardScenes)


def test_options_of_a_kind(tmp_path):
    root = write_jacquard(tmp_path)
    assert read_scenes(root)[0].depth[0, 0] == 1.5
    assert read_scenes(root, depth=None, jaws=None)[0].depth[0, 0] == 1.5
    assert read_scenes(root, depth="stereo")[0].depth[0, 0] == 1.25
    assert read_scenes(f"jacquard:{root}", jaws="smallest").jaws == "smallest"
    with pytest.raises(UnknownNameError) as caught:
        read_scenes(root, jaw="smallest")
    assert caught.value.nearest == "jaws"
    assert set(caught.value.choices) == {"depth", "jaws"}
    with pytest.raises(UnknownNameError) as caught:
        read_scenes(root, depth="z")
    assert set(caught.value.choices) == {"perfect", "stereo"}


def test_unknown_kind(tmp_path):
    with pytest.raises(UnknownNameError) as caught:
        read_scenes(f"jaquard:{tmp_path}")
    assert caught.value.nearest == "jacquard"
    assert set(caught.value.choices) == set(KINDS)


def test_folders_without_scenes(tmp_path):
    with pytest.raises(DatasetNotFoundError, match="no such folder"):
        read_scenes(tmp_path / "nowhere")
    with pytest.raises(DatasetNotFoundError) as caught:
        read_scenes(tmp_path)
    for name, kind in KINDS.items():
        assert name in str(caught.value)
        assert kind.files in str(caught.value)
    for name in KINDS:
        with pytest.raises(DatasetNotFoundError):
            read_scenes(f"{name}:{tmp_path}")


def test_folders_of_two_kinds(tmp_path):
    write_cornell(write_jacquard(tmp_path))
    with pytest.raises(FileFormatError, match=f"cornell:{tmp_path} or jacquard:{tmp_path}"):
        read_scenes(tmp_path)
    assert len(read_scenes(f"cornell:{tmp_path}")) == 1


def test_a_colon_in_a_folder(tmp_path):
    root = write_cornell(tmp_path / "set:1")
    assert len(read_scenes(f"cornell:{root}")) == 1
    assert len(read_scenes(str(root))) == 1
    assert split_spec("cornell:a:b") == ("cornell", Path("a:b"))


def test_kinds_of_the_real_folders(data_dir):
    assert detect_kind(data_dir / "jacquard") == "jacquard"
    assert detect_kind(data_dir / "cornell-rgb") == "cornell"
    assert detect_kind(data_dir / "cornell-raw") == "cornell"
    raw = read_scenes(data_dir / "cornell-raw")
    assert len(raw) == 2
    assert raw[0].shape == (480, 640)
    assert raw[0].grasps is None
    with pytest.raises(DatasetNotFoundError):
        detect_kind(data_dir / "egad")


def test_public_names():
    assert sorted(graspmap.data.__all__) == sorted(graspmap.data._HOME)
    for name in graspmap.data.__all__:
        assert getattr(graspmap.data, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        graspmap.data.nothing  # noqa: B018  # the access is the test


def test_home_and_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert split_spec("cornell:~/a") == ("cornell", tmp_path / "a")
    assert split_spec("~/a") == (None, tmp_path / "a")
    assert split_spec("cornell:~nobody-at-all/a") == ("cornell", Path("~nobody-at-all/a"))
    for spec in ("", "cornell:", "jacquard:a\0b"):
        with pytest.raises(InvalidInputError, match="kind:directory"):
            split_spec(spec)
