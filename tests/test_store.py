"""The packed store: what goes in comes out, it is never stale, and never half there."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import pickle
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from graspmap.data import images, input_window, store
from graspmap.data.fingerprint import FileHashes, scenes_key
from graspmap.data.jacquard import jacquard_pose
from graspmap.data.scene import Scene, Scenes
from graspmap.data.store import Store, open_store
from graspmap.errors import FileError, InvalidInputError, MissingFileError, StorageFullError
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps

SIZE = 24


class FakeScenes(Scenes):
    """Scenes from a seed in each of its files; not all have everything."""

    kind = "fake"

    def __init__(self, root: Path, *, gain: float = 1.0, delay_s: float = 0.0) -> None:
        self.root, self.gain, self._delay_s = root, gain, delay_s
        self.ids = tuple(sorted(path.stem for path in root.glob("*.seed")))

    def read(self, index):
        time.sleep(self._delay_s)
        rng = np.random.default_rng([int(self.files(index)[0].read_text()), index])
        depth = rng.uniform(1, 2, (40, 60)).astype(np.float32) * np.float32(self.gain)
        depth[5:9, 7:11] = np.nan
        return Scene(
            id=self.ids[index],
            rgb=rng.integers(0, 256, (40, 60, 3)).astype(np.uint8),
            depth=None if index == 1 else depth,
            mask=None if index == 2 else rng.random((40, 60)) > 0.5,
            grasps=self.read_grasps(index),
            negatives=random_grasps(rng, 2) if index == 0 else None,
            camera=None if index == 3 else Camera(50.0, 50.0, 29.5, 19.5, 60, 40),
            T_world_camera=None if index == 2 else jacquard_pose(),
            object_id=self.object_id(index),
            labels={"specific": f"thing {index}"},
        )

    def read_grasps(self, index):
        if index == 2:
            return None
        return random_grasps(np.random.default_rng(index), index)

    def files(self, index):
        return (self.root / f"{self.ids[index]}.seed",)

    def object_id(self, index):
        return None if index == 4 else f"object {index // 2}"


def random_grasps(rng, count):
    return Grasps(
        rng.uniform(0, 40, (count, 2)),
        rng.uniform(-1.5, 1.5, count),
        rng.uniform(1, 20, count),
        rng.uniform(1, 9, count),
        rng.random(count),
    )


def make_files(folder, count=5):
    folder.mkdir()
    for i in range(count):
        (folder / f"s{i}.seed").write_text(f"{i + 7}")
        os.utime(folder / f"s{i}.seed", (1_000_000_000, 1_000_000_000))
    return FakeScenes(folder)


@pytest.fixture
def scenes(tmp_path):
    return make_files(tmp_path / "data")


def test_what_goes_in_comes_out(scenes, tmp_path):
    seen = []
    packed = open_store(
        scenes, tmp_path / "cache", size=SIZE, progress=lambda *a: seen.append(a), workers=2
    )
    assert seen == [(i + 1, 5) for i in range(5)]
    assert packed.ids == scenes.ids
    assert packed.size == SIZE
    for i, (source, scene) in enumerate(zip(scenes, packed, strict=True)):
        matrix = input_window((40, 60), SIZE)
        np.testing.assert_array_equal(packed.matrix(i), matrix)
        # 60 x 40 px in a square: a sixth of the rows above and below is repeated border.
        np.testing.assert_array_equal(
            packed.inside(i).all(axis=1), [4 <= r < 20 for r in range(24)]
        )
        np.testing.assert_array_equal(scene.rgb, images.warp(source.rgb, matrix, SIZE))
        for name, warp in (("depth", images.warp_depth), ("mask", images.warp)):
            picture = getattr(source, name)
            if picture is None:
                assert getattr(scene, name) is None
            else:
                np.testing.assert_array_equal(getattr(scene, name), warp(picture, matrix, SIZE))
        for name in ("grasps", "negatives"):
            grasps = getattr(source, name)
            expected = None if grasps is None else grasps.transformed(matrix)
            assert getattr(scene, name) == expected
        assert packed.read_grasps(i) == scene.grasps
        assert (scene.object_id, scene.labels) == (source.object_id, source.labels)
        assert packed.object_id(i) == source.object_id
        if source.camera is None:
            assert scene.camera is None
        else:
            assert scene.camera == source.camera.transformed(matrix, SIZE, SIZE)
        assert scene.T_world_camera == source.T_world_camera
        assert not scene.rgb.flags.writeable
    assert packed.subset(["s3"])[0].id == "s3"


def test_it_tells_what_was_measured_and_what_was_filled(scenes, tmp_path):
    packed = open_store(
        scenes, tmp_path / "cache", size=60
    )  # the size of the pictures' longer side
    assert packed.measured(1) is None  # it has no depth
    measured = packed.measured(0)
    assert measured.dtype == bool
    hole = np.zeros((60, 60), bool)
    hole[15:19, 7:11] = True  # ten rows of border above the picture
    np.testing.assert_array_equal(~measured, hole)
    # Shrunk to half: a pixel that shows two pixels of a hole and two others counts as measured.
    half = open_store(scenes, tmp_path / "cache", size=30).measured(0)
    assert np.argwhere(~half).min(axis=0).tolist() >= [7, 3]
    assert 1 <= (~half).sum() <= 9


def test_a_depth_without_holes_needs_no_such_picture(tmp_path):
    from graspmap.data import read_scenes, write_jacquard

    for number, hole in enumerate((False, True)):
        depth = np.full((16, 16), 0.5, np.float32)
        depth[3, 4] = np.nan if hole else 0.5
        rgb = np.zeros((16, 16, 3), np.uint8)
        write_jacquard(Scene(f"{number}_a", rgb, depth), tmp_path / "data")
    packed = open_store(read_scenes(f"jacquard:{tmp_path / 'data'}"), tmp_path / "cache", size=16)
    assert packed.measured(0) is None
    assert np.argwhere(~packed.measured(1)).tolist() == [[3, 4]]


def test_what_a_scene_has_is_known_without_reading_it(scenes, tmp_path):
    packed = open_store(scenes, tmp_path / "cache", size=SIZE)
    for i, scene in enumerate(packed):
        for name in ("rgb", "depth", "mask"):
            assert packed.has(i, name) == (getattr(scene, name) is not None)
        assert packed.labels(i) == scene.labels == {"specific": f"thing {i}"}
        assert packed.shape(i) == (40, 60)


def test_it_is_built_once_and_survives_pickling(scenes, tmp_path):
    first = open_store(scenes, tmp_path / "cache", size=SIZE)
    again = open_store(
        scenes, tmp_path / "cache", size=SIZE, progress=lambda *_: pytest.fail("built again")
    )
    assert again.key == first.key
    data = pickle.dumps(first)
    assert len(data) < 5000
    np.testing.assert_array_equal(pickle.loads(data)[3].rgb, first[3].rgb)
    assert not list((tmp_path / "cache").glob("*.part*"))


def key_of(scenes, folder, **settings):
    return open_store(scenes, folder, **{"size": SIZE, **settings}).key


def test_every_change_makes_another_key(scenes, tmp_path):
    cache = tmp_path / "cache"
    keys = [
        key_of(scenes, cache),
        key_of(scenes, cache, size=SIZE + 1),
        key_of(scenes, cache, view="cover"),
        key_of(scenes, cache, view=30),
        key_of(scenes[:4], cache),
        key_of(scenes.subset(scenes.ids[::-1]), cache),
        key_of(FakeScenes(scenes.root, gain=1.5), cache),
        key_of(FakeScenes(scenes.root, gain=1.5)[:4], cache),
    ]
    assert len(set(keys)) == len(keys)
    path = scenes.files(2)[0]
    stat = path.stat()
    path.write_text("8")  # one byte, as long as before
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # and even as old as before
    keys.append(key_of(scenes, cache))
    assert len(set(keys)) == len(keys)
    assert open_store(scenes, cache, size=SIZE)[2].rgb.any()


def test_a_moved_data_set_keeps_its_key(scenes, tmp_path):
    key = key_of(scenes, tmp_path / "cache")
    moved = scenes.root.rename(tmp_path / "elsewhere")
    assert key_of(FakeScenes(moved), tmp_path / "cache") == key


def test_hashes_are_remembered_but_not_of_fresh_files(tmp_path, monkeypatch):
    old, fresh = tmp_path / "old", tmp_path / "fresh"
    old.write_text("a")
    fresh.write_text("b")
    now = time.time_ns()
    # Times of change cannot be set, so the clock is: the old file is ten seconds old.
    monkeypatch.setattr(time, "time_ns", lambda: now + 10_000_000_000)
    hashes = FileHashes(tmp_path / "index.json")
    first = hashes(old)
    monkeypatch.setattr(time, "time_ns", lambda: now)
    hashes(fresh)
    hashes.save()
    known = json.loads((tmp_path / "index.json").read_text())
    assert [Path(name).name for name in known] == ["old"]
    assert FileHashes(tmp_path / "index.json")(old) == first
    (tmp_path / "index.json").write_text("{damaged")
    assert FileHashes(tmp_path / "index.json")(old) == first


def test_missing_source_is_named(scenes, tmp_path):
    scenes.files(3)[0].unlink()
    with pytest.raises(MissingFileError, match=r"s3\.seed"):
        scenes_key(scenes, FileHashes(tmp_path / "index.json"), {})


def test_bad_scenes_leave_nothing(scenes, tmp_path, monkeypatch):
    class Holes(FakeScenes):
        def read(self, index):
            scene = super().read(index)
            if index == 3:
                scene.depth[:] = np.nan
            return scene

    with pytest.raises(InvalidInputError, match=r"depth of scene s3 .*holes"):
        open_store(Holes(scenes.root), tmp_path / "cache", size=SIZE)
    assert not [path for path in (tmp_path / "cache").iterdir() if path.is_dir()]
    with pytest.raises(InvalidInputError, match="at least one"):
        open_store(scenes[:0], tmp_path / "cache", size=SIZE)
    with pytest.raises(InvalidInputError, match="view"):
        open_store(scenes, tmp_path / "cache", size=SIZE, view="fit")  # type: ignore[arg-type]


def test_files_that_change_meanwhile_are_not_packed_under_their_old_hash(scenes, tmp_path):
    # Two scenes are read ahead of the first one's progress; the last is not.
    def change(done, total):
        (scenes.root / "s4.seed").write_text("77")

    cache = tmp_path / "cache"
    with pytest.raises(FileError, match="was changed while"):
        open_store(scenes, cache, size=SIZE, progress=change, workers=1)
    assert not [path for path in cache.iterdir() if path.is_dir()]
    packed = open_store(scenes, cache, size=SIZE)
    expected = images.warp(scenes.read(4).rgb, packed.matrix(4), SIZE)
    np.testing.assert_array_equal(packed[4].rgb, expected)


def test_interrupt_leaves_nothing(scenes, tmp_path):
    def interrupt(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        open_store(scenes, tmp_path / "cache", size=SIZE, progress=interrupt)
    assert not [path for path in (tmp_path / "cache").iterdir() if path.is_dir()]
    assert len(open_store(scenes, tmp_path / "cache", size=SIZE)) == 5


def test_full_disk_is_said_before_any_work(scenes, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(StorageFullError, match="disk is full"):
        open_store(scenes, tmp_path / "cache", size=SIZE)
    assert not [path for path in (tmp_path / "cache").iterdir() if path.is_dir()]


def test_full_disk_in_the_middle_of_an_array(scenes, tmp_path, monkeypatch):
    def short(*_):
        raise OSError("822 requested and 496 written")

    monkeypatch.setattr(np, "save", short)
    with pytest.raises(StorageFullError):
        open_store(scenes, tmp_path / "cache", size=SIZE)
    assert not list((tmp_path / "cache").glob("*.part-*"))


def test_a_damaged_index_and_a_file_in_the_way_do_no_harm(scenes, tmp_path):
    cache = tmp_path / "cache"
    place = open_store(scenes, cache, size=SIZE).root
    (cache / "files.json").write_text("[" * 50000)
    shutil.rmtree(place)
    place.touch()
    assert open_store(scenes, cache, size=SIZE).root == place


@pytest.mark.parametrize("place", ["file", "file/cache"])
def test_folder_that_is_a_file(scenes, tmp_path, place):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="is no folder"):
        open_store(scenes, tmp_path / place, size=SIZE)


def build(root, cache, delay_s, results=None):
    packed = open_store(FakeScenes(root, delay_s=delay_s), cache, size=SIZE, workers=1)
    if results is not None:
        results.put(int(packed[0].rgb.sum()))


def test_killed_builder_leaves_nothing_that_counts(scenes, tmp_path):
    cache = tmp_path / "cache"
    context = multiprocessing.get_context("fork")
    process = context.Process(target=build, args=(scenes.root, cache, 0.2))
    process.start()
    while not list(cache.glob("*.part-*/rgb.npy")):
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    left = list(cache.glob("*.part-*"))
    assert len(left) == 1
    with pytest.raises(FileError, match="no whole store"):
        Store(left[0])
    slow = FakeScenes(scenes.root, delay_s=0.2)
    slow._delay_s = 0.0  # another key: the leftover is removed all the same
    assert len(open_store(slow, cache, size=SIZE)) == 5
    assert not list(cache.glob("*.part-*"))


def test_two_builders_at_once(scenes, tmp_path):
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    arguments = (scenes.root, tmp_path / "cache", 0.05, results)
    processes = [context.Process(target=build, args=arguments) for _ in range(3)]
    for process in processes:
        process.start()
    sums = {results.get(timeout=30) for _ in processes}
    for process in processes:
        process.join()
    assert len(sums) == 1
    assert len([path for path in (tmp_path / "cache").iterdir() if path.is_dir()]) == 1


def test_without_locks_the_faster_builder_wins(scenes, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "fcntl", None)
    cache = tmp_path / "cache"
    place = cache / key_of(scenes, cache)
    kept = place.rename(tmp_path / "kept")

    def race(done, total):
        if done == total and kept.exists():
            kept.rename(place)

    packed = open_store(scenes, cache, size=SIZE, progress=race)
    assert len(packed) == 5
    assert not list(cache.glob("*.part-*"))


@pytest.mark.parametrize(
    "damage",
    ["truncate", "remove", "description", "version", "ids", "scenes", "files", "header", "nested"],
)
def test_damaged_store_is_built_again(scenes, tmp_path, damage):
    cache = tmp_path / "cache"
    packed = open_store(scenes, cache, size=SIZE)
    expected = np.array(packed[0].rgb)
    if damage == "truncate":
        os.truncate(packed.root / "rgb.npy", 200)
    elif damage == "remove":
        (packed.root / "grasps.npy").unlink()
    elif damage == "description":
        (packed.root / "store.json").write_text("{")
    elif damage == "header":
        size = (packed.root / "rgb.npy").stat().st_size
        (packed.root / "rgb.npy").write_bytes(b"x" * size)
    elif damage == "nested":
        (packed.root / "store.json").write_text("[" * 50000)
    else:
        meta = json.loads((packed.root / "store.json").read_text())
        change = {"version": 0, "ids": ["a"], "scenes": None, "files": {}}[damage]
        (packed.root / "store.json").write_text(json.dumps(meta | {damage: change}))
    with pytest.raises(FileError, match="delete the folder"):
        Store(packed.root)
    np.testing.assert_array_equal(open_store(scenes, cache, size=SIZE)[0].rgb, expected)


def test_real_scenes(data_dir, tmp_path):
    from graspmap.data import read_scenes

    scenes = read_scenes(f"jacquard:{data_dir / 'jacquard'}", depth="stereo")[:3]
    packed = open_store(scenes, tmp_path, size=64)
    stereo = packed.key
    for source, scene in zip(scenes, packed, strict=True):
        assert np.isfinite(scene.depth).all()
        np.testing.assert_allclose(scene.grasps.width, source.grasps.width / 16, rtol=1e-9)
        assert scene.camera.fx == pytest.approx(source.camera.fx / 16)
    perfect = read_scenes(f"jacquard:{data_dir / 'jacquard'}")[:3]
    assert open_store(perfect, tmp_path, size=64).key != stereo
