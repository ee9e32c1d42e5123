"""Whole files, single pictures, and the errors of the lowest level."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from graspmap import files
from graspmap.data import files as pictures
from graspmap.errors import (
    FileError,
    FileFormatError,
    MissingFileError,
    StorageFullError,
    UnknownNameError,
)


def save(path, image):
    assert cv2.imwrite(str(path), image)
    return path


def test_what_ships_by_name_else_a_path(tmp_path, monkeypatch):
    shipped = {"plain": tmp_path / "plain.yaml"}
    options = {"what": "cup", "own": "a YAML file"}
    monkeypatch.chdir(tmp_path)
    Path("mine").touch()
    Path("plain").touch()  # does not hide what ships
    for name in ("plain", Path("plain")):
        assert files.shipped_or_path(name, shipped, **options) == shipped["plain"]
    for name in ("mine", "none.yaml", "folder/none", tmp_path / "none", Path("mine")):
        assert files.shipped_or_path(name, shipped, **options) == Path(name)
    with pytest.raises(UnknownNameError, match=r"cup.*plain, or a YAML file.*'plain'"):
        files.shipped_or_path("plan", shipped, **options)


def test_colour_of_all_layouts(tmp_path):
    bgr = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    rgb = bgr[:, :, ::-1]
    np.testing.assert_array_equal(pictures.read_rgb(save(tmp_path / "a.png", bgr)), rgb)
    clear = np.dstack([bgr, np.zeros((5, 7), np.uint8)])
    np.testing.assert_array_equal(pictures.read_rgb(save(tmp_path / "b.png", clear)), rgb)
    grey = pictures.read_rgb(save(tmp_path / "c.png", bgr[:, :, 0]))
    np.testing.assert_array_equal(grey, np.repeat(bgr[:, :, :1], 3, axis=2))
    pictures.write_rgb(tmp_path / "new" / "d.png", rgb)
    np.testing.assert_array_equal(pictures.read_rgb(tmp_path / "new" / "d.png"), rgb)


@pytest.mark.parametrize("levels", [(0, 255), (0, 1), (0, 0), (255, 255)])
def test_masks_of_all_levels(tmp_path, levels):
    plane = np.full((4, 6), levels[0], np.uint8)
    plane[1:3, 2:4] = levels[1]
    expected = plane > 0
    np.testing.assert_array_equal(pictures.read_mask(save(tmp_path / "a.png", plane)), expected)
    colour = np.repeat(plane[:, :, None], 3, axis=2)
    np.testing.assert_array_equal(pictures.read_mask(save(tmp_path / "b.png", colour)), expected)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_depth_of_all_formats(tmp_path, dtype):
    depth = np.array([[1.5, 0.0, -1.0], [np.nan, np.inf, 2.25]])
    expected = np.array([[1.5, np.nan, np.nan], [np.nan, np.nan, 2.25]], np.float32)
    np.save(tmp_path / "a.npy", depth.astype(dtype))
    save(tmp_path / "b.tiff", depth.astype(dtype))
    for name in ("a.npy", "b.tiff"):
        read = pictures.read_depth(tmp_path / name)
        assert read.dtype == np.float32
        np.testing.assert_array_equal(read, expected)
    millimetres = np.array([[1500, 0, 0], [0, 0, 2250]], np.uint16)
    for name in ("c.png", "d.tiff"):
        np.testing.assert_array_equal(
            pictures.read_depth(save(tmp_path / name, millimetres)), expected
        )


@pytest.mark.parametrize("colour", [(0, 0, 255), (0, 255, 0), (255, 0, 0), (255, 255, 255)])
def test_a_mask_of_any_colour_on_black(tmp_path, colour):
    picture = np.zeros((4, 6, 3), np.uint8)
    picture[1:3, 2:4] = colour
    found = pictures.read_mask(save(tmp_path / "a.png", picture))
    np.testing.assert_array_equal(found, picture.any(axis=2))


def test_a_cut_out_is_where_it_is_opaque(tmp_path):
    picture = np.full((4, 6, 4), 255, np.uint8)
    picture[..., 3] = 0
    picture[1:3, 2:4] = (7, 7, 7, 255)  # nearly black, and white around it
    found = pictures.read_mask(save(tmp_path / "a.png", picture))
    np.testing.assert_array_equal(found, picture[..., 3] > 0)


@pytest.mark.parametrize("beyond", [100.5, 655.35, 1e10, 3e38])
def test_what_stands_for_no_depth_is_a_hole(tmp_path, beyond):
    """A renderer's background, the greatest number of a driver: however much of the picture."""
    for share in (1, 3):
        depth = np.full((2, 4), 0.5, np.float32)
        depth[:, :share] = beyond
        if share == 3 and beyond < 1e5:
            continue  # then it looks like a picture in millimetres
        expected = np.where(depth == 0.5, depth, np.nan)
        np.save(tmp_path / "a.npy", depth)
        np.testing.assert_array_equal(pictures.read_depth(tmp_path / "a.npy"), expected)
    sixteen = np.array([[500, 65535], [65534, 1]], np.uint16)
    expected = np.array([[0.5, np.nan], [65.534, 0.001]], np.float32)
    found = pictures.read_depth(save(tmp_path / "b.png", sixteen))
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.parametrize("dtype", [">f4", "<f4", ">f8", ">u2", "<u2"])
def test_depth_in_any_order_of_bytes(tmp_path, dtype):
    depth = np.array([[500, 750]]).astype(dtype)
    np.save(tmp_path / "a.npy", depth if dtype.endswith("u2") else depth / 1000)
    found = pictures.read_depth(tmp_path / "a.npy")
    np.testing.assert_allclose(found, [[0.5, 0.75]], rtol=1e-6)


def test_depth_that_is_none(tmp_path):
    colour = np.zeros((4, 4, 3), np.uint8)
    with pytest.raises(FileFormatError, match="one channel"):
        pictures.read_depth(save(tmp_path / "a.png", colour))
    with pytest.raises(FileFormatError, match="uint8"):
        pictures.read_depth(save(tmp_path / "b.png", colour[:, :, 0]))
    # Millimetres are found although most of the picture, and every sampled pixel, is a hole.
    sparse = np.zeros((400, 400), np.float32)
    sparse[1, 1] = 1500
    with pytest.raises(FileFormatError, match="looks like millimetres"):
        pictures.read_depth(save(tmp_path / "c.tiff", sparse))
    (tmp_path / "d.npy").write_bytes(b"\x93NUMPY no")
    with pytest.raises(FileFormatError, match="no array"):
        pictures.read_depth(tmp_path / "d.npy")
    np.save(tmp_path / "e.npy", np.array([{"code": 1}], dtype=object))
    with pytest.raises(FileFormatError, match="no array"):
        pictures.read_depth(tmp_path / "e.npy")
    with pytest.raises(MissingFileError):
        pictures.read_depth(tmp_path / "f.npy")


def test_paths_that_are_no_file(tmp_path):
    with pytest.raises(MissingFileError, match="no such file"):
        files.read_bytes(tmp_path / "nowhere")
    with pytest.raises(FileFormatError, match="this is a folder"):
        files.read_bytes(tmp_path)
    (tmp_path / "empty").touch()
    with pytest.raises(FileFormatError, match="is empty"):
        files.read_bytes(tmp_path / "empty")
    with pytest.raises(FileError, match="Not a directory"):
        files.read_bytes(tmp_path / "empty" / "file")


@pytest.mark.parametrize("content", [b"\xff\xfea", b"a\0b"])
def test_what_is_no_text(tmp_path, content):
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(FileFormatError, match="is no text"):
        files.read_text(tmp_path / "a")


def test_an_empty_text_is_a_text(tmp_path):
    (tmp_path / "a").touch()
    assert files.read_text(tmp_path / "a") == ""
    assert files.read_lines(tmp_path / "a") == []


def test_lines_of_all_endings(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"\xef\xbb\xbfone\r\n\r\n two \nthree")
    assert files.read_lines(path) == [(1, "one"), (3, "two"), (4, "three")]


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.txt"
    files.write_text(path, "old")

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(files.Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        files.write_text(path, "new")
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("call", ["fsync", "fdopen"])
def test_a_full_disk_is_named_and_leaves_the_old_file(tmp_path, monkeypatch, call):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "a.txt"
    files.write_text(path, "old")
    monkeypatch.setattr(files.os, call, full)
    with pytest.raises(StorageFullError):
        files.write_text(path, "new", durable=True)
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]


def test_a_durable_file_is_synced_before_it_gets_its_name(tmp_path, monkeypatch):
    calls = []
    monkeypatch.setattr(files.os, "fsync", lambda _: calls.append("sync"))
    replace = Path.replace
    monkeypatch.setattr(
        files.Path, "replace", lambda *paths: (calls.append("rename"), replace(*paths))
    )
    files.write_bytes(tmp_path / "a", b"1")
    files.write_bytes(tmp_path / "b", b"2", durable=True)
    assert calls == ["rename", "sync", "rename"]
    assert (tmp_path / "b").read_bytes() == b"2"


def test_what_a_killed_writer_left_can_be_removed(tmp_path):
    left = subprocess.Popen([sys.executable, "-c", KILLED_WHILE_WRITING, str(tmp_path / "a")])
    assert left.wait(30) == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1
    assert not (tmp_path / "a").exists()
    (tmp_path / "mine.part").touch()
    files.remove_parts(tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["mine.part"]


KILLED_WHILE_WRITING = """
import os, signal, sys
from pathlib import Path
from graspmap import files
os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)
files.write_bytes(Path(sys.argv[1]), b"content", durable=True)
"""


def test_new_files_have_the_usual_permissions(tmp_path):
    (tmp_path / "plain").touch()
    files.write_text(tmp_path / "ours", "x")
    modes = {os.stat(tmp_path / name).st_mode for name in ("plain", "ours")}  # noqa: PTH116
    assert len(modes) == 1


def test_an_unknown_ending(tmp_path):
    with pytest.raises(FileFormatError, match="no format"):
        pictures.write_mask(tmp_path / "mask.xyz", np.ones((2, 2), bool))
    assert not list(tmp_path.iterdir())


def test_pipes_and_links_stay_what_they_are(tmp_path):
    read, write = os.pipe()
    files.write_bytes(Path(f"/dev/fd/{write}"), b"abc")
    assert os.read(read, 9) == b"abc"
    os.close(read)
    os.close(write)
    (tmp_path / "link").symlink_to(tmp_path / "target")
    for text in ("one", "two"):
        files.write_text(tmp_path / "link", text)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "target").read_text() == "two"


def test_names_that_are_no_unicode_are_written_as_their_bytes(tmp_path):
    files.write_text(tmp_path / "a", os.fsdecode(b"caf\xe9"))
    assert (tmp_path / "a").read_bytes() == b"caf\xe9"


def test_any_refusal_to_write_is_named(tmp_path):
    with pytest.raises(FileError, match="cannot be written"):
        files.write_text(tmp_path / ("x" * 300), "y")


@pytest.mark.parametrize("body", ["", "0000000049454e44ae426082"])
def test_a_png_without_a_header(tmp_path, body):
    path = tmp_path / "a.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes.fromhex(body))
    with pytest.raises(FileFormatError):
        pictures.read_rgb(path)


def test_the_cache_folder_is_the_users(monkeypatch, tmp_path):
    monkeypatch.setenv("GRASPMAP_CACHE", str(tmp_path / "a"))
    assert files.cache_folder() == tmp_path / "a"
    monkeypatch.delenv("GRASPMAP_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "b"))
    assert files.cache_folder() == tmp_path / "b" / "graspmap"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert files.cache_folder().parts[-2:] == (".cache", "graspmap")


@pytest.mark.skipif(files.fcntl is None, reason="no POSIX locks here")
def test_a_file_system_without_locks_is_told_and_used(tmp_path, monkeypatch, caplog):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(files.fcntl, "flock", no_locks)
    with files.locked(tmp_path / "run", "training"):
        assert (tmp_path / "run").is_dir()
    assert "cannot be locked" in caplog.text


@pytest.mark.parametrize("own", ["", "~/mine"])
def test_an_empty_cache_folder_is_none_and_a_tilde_is_the_home(monkeypatch, tmp_path, own):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("GRASPMAP_CACHE", own)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    expected = tmp_path / "mine" if own else tmp_path / ".cache" / "graspmap"
    assert files.cache_folder() == expected


@pytest.mark.parametrize("cache", ["there", "a-file"])
def test_numba_has_a_folder_where_the_package_cannot_be_written(tmp_path, cache):
    """In a process of its own: what numba is told counts until it is imported."""
    (tmp_path / "a-file").touch()
    code = (
        "import os\n"
        "real = os.access\n"
        "os.access = lambda path, mode: 'graspmap' not in str(path).rsplit('/src/', 1)[-1]"
        " and real(path, mode)\n"
        "import graspmap\n"
        "import numba\n"
        "print(numba.config.CACHE_DIR)\n"
        "import graspmap.data.images\n"
    )
    env = {**os.environ, "GRASPMAP_CACHE": str(tmp_path / cache)}
    env.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    folder = Path(done.stdout.split()[-1])
    if cache == "there":
        assert folder == tmp_path / "there" / "numba"
        assert folder.is_dir()
    else:
        assert folder.name.startswith("graspmap-numba-")
        assert not folder.exists()  # it went with its process


def test_a_user_without_a_home_has_a_cache_folder(monkeypatch):
    for name in ("GRASPMAP_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)

    def homeless():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(files.Path, "home", homeless)
    assert files.cache_folder() == Path(tempfile.gettempdir()) / "graspmap"
