"""Jacquard's layout: hand-written files are read right, and written scenes are read back whole."""

from __future__ import annotations

import math
import pickle
import shutil
from collections import Counter

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap import files
from graspmap.data.jacquard import (
    JacquardScenes,
    format_grasps,
    jacquard_camera,
    jacquard_pose,
    read_grasps,
    smallest_jaws,
    write_jacquard,
)
from graspmap.data.jacquard_labels import jaw_shares
from graspmap.data.scene import Scene
from graspmap.errors import (
    DatasetNotFoundError,
    FileFormatError,
    GraspmapError,
    InvalidInputError,
    MissingFileError,
    StorageFullError,
    UnknownNameError,
)
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps, angle_difference
from graspmap.geometry.transforms import RigidTransform

LINES = "10.5;20.25;68.2615;25.5;25.62\r\n10.5;20.25;68.2615;25.5;12.81\r\n30;40;-6.5;27.0;13\r\n"
SIDE = 48


def write_scene(folder, name, *, lines=LINES, side=SIDE, seed=0):
    """One scene as Jacquard publishes it, written without graspmap."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    rgb = rng.integers(0, 256, (side, side, 3), dtype=np.uint8)
    perfect = rng.uniform(1.4, 1.6, (side, side)).astype(np.float32)
    stereo = perfect.copy()
    stereo[3, 5] = -1
    mask = np.zeros((side, side), np.uint8)
    mask[10:20, 5:30] = 255
    lzw = [cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_LZW]
    cv2.imwrite(str(folder / f"{name}_RGB.png"), rgb[:, :, ::-1])
    cv2.imwrite(str(folder / f"{name}_mask.png"), mask)
    cv2.imwrite(str(folder / f"{name}_perfect_depth.tiff"), perfect, lzw)
    cv2.imwrite(str(folder / f"{name}_stereo_depth.tiff"), stereo, lzw)
    (folder / f"{name}_grasps.txt").write_bytes(lines.encode())
    return rgb, perfect, stereo, mask


def random_scene(seed, side=SIDE, **changes):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 6))
    depth = rng.uniform(0.5, 2, (side, side)).astype(np.float32)
    depth[rng.random((side, side)) < 0.1] = np.nan
    values = {
        "id": f"{seed}_cup",
        "rgb": rng.integers(0, 256, (side, side, 3), dtype=np.uint8),
        "depth": depth,
        "mask": rng.random((side, side)) < 0.3,
        "grasps": Grasps(
            rng.uniform(-5, side + 5, (n, 2)),
            rng.uniform(-np.pi / 2, np.pi / 2, n),
            rng.uniform(0.1, 90, n),
            rng.uniform(0.1, 40, n),
        ),
        "camera": jacquard_camera(side, side),
        "T_world_camera": jacquard_pose(),
        "object_id": "cup",
    }
    return Scene(**{**values, **changes})


def assert_same(a: Scene, b: Scene):
    assert (a.id, a.object_id, a.camera) == (b.id, b.object_id, b.camera)
    assert a.T_world_camera == b.T_world_camera
    for name in ("rgb", "depth", "mask"):
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None)
        if x is not None:
            np.testing.assert_array_equal(x, y)
            assert x.dtype == y.dtype
    assert (a.grasps is None) == (b.grasps is None)
    if a.grasps is not None:
        for name in ("center", "width", "height"):
            np.testing.assert_array_equal(getattr(a.grasps, name), getattr(b.grasps, name))
        assert (angle_difference(a.grasps.angle, b.grasps.angle) < 1e-13).all()


@pytest.mark.parametrize("nested", [True, False])
def test_reads_what_the_originals_hold(tmp_path, nested):
    truth = {
        name: write_scene(tmp_path / name[2:] if nested else tmp_path, name, seed=i)
        for i, name in enumerate(("10_b", "2_b", "0_a"))
    }
    scenes = JacquardScenes(tmp_path)
    assert scenes.ids == ("0_a", "2_b", "10_b")
    assert [scenes.object_id(i) for i in range(3)] == ["a", "b", "b"]
    for scene in scenes:
        rgb, perfect, _, mask = truth[scene.id]
        np.testing.assert_array_equal(scene.rgb, rgb)
        np.testing.assert_array_equal(scene.depth, perfect)
        np.testing.assert_array_equal(scene.mask, mask > 0)
        np.testing.assert_allclose(scene.grasps.center, [[10.5, 20.25], [10.5, 20.25], [30, 40]])
        # Clockwise on screen in the file, counter-clockwise here.
        np.testing.assert_allclose(np.degrees(scene.grasps.angle), [-68.2615, -68.2615, 6.5])
        np.testing.assert_array_equal(scene.grasps.width, [25.5, 25.5, 27])
        np.testing.assert_array_equal(scene.grasps.height, [25.62, 12.81, 13])
    assert pickle.loads(pickle.dumps(scenes)).ids == scenes.ids


def test_clockwise_angle_against_the_axis_on_screen(tmp_path):
    # 45 degrees clockwise: the opening runs to the right and down, y grows.
    path = tmp_path / "0_a_grasps.txt"
    path.write_text("50;50;45;20;10\n")
    p0, p1 = read_grasps(path).corners()[0, :2]
    assert p1[0] > p0[0]
    assert p1[1] > p0[1]
    np.testing.assert_allclose(p1 - p0, 20 * math.sqrt(0.5))


def test_stereo_holes_and_smallest_jaws(tmp_path):
    _, _, stereo, _ = write_scene(tmp_path, "0_a")
    scene = JacquardScenes(tmp_path, depth="stereo", jaws="smallest")[0]
    assert np.isnan(scene.depth[3, 5])
    assert np.isnan(scene.depth).sum() == 1
    np.testing.assert_array_equal(np.nan_to_num(scene.depth, nan=-1), stereo)
    np.testing.assert_array_equal(scene.grasps.height, [12.81, 13])


@pytest.mark.parametrize("part", ["mask.png", "perfect_depth.tiff", "grasps.txt"])
def test_each_file_but_the_colour_may_be_missing(tmp_path, part):
    write_scene(tmp_path, "0_a")
    (tmp_path / f"0_a_{part}").unlink()
    scenes = JacquardScenes(tmp_path)
    scene = scenes[0]
    field = {"m": "mask", "p": "depth", "g": "grasps"}[part[0]]
    assert getattr(scene, field) is None
    assert len(scenes.files(0)) == 3
    for other in {"mask", "depth", "grasps"} - {field}:
        assert getattr(scene, other) is not None


def test_files_are_those_that_are_read(tmp_path):
    write_scene(tmp_path, "0_a")
    names = {path.name for path in JacquardScenes(tmp_path, depth="stereo").files(0)}
    assert names == {"0_a_RGB.png", "0_a_stereo_depth.tiff", "0_a_mask.png", "0_a_grasps.txt"}


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("1;2;3;4", "4 numbers"),
        ("1;2;3;4;5;6", "6 numbers"),
        ("1;2;nan;4;5", "not finite"),
        ("1;2;inf;4;5", "not finite"),
        ("1;2;x;4;5", "line 2"),
        ("1;2;3;0;5", "opening 0"),
        ("1;2;3;-4;5", "opening -4"),
        ("1;2;3;4;-5", "jaw -5"),
        ("1 2 3 4 5", "1 numbers"),
    ],
)
def test_a_bad_label_line_is_named(tmp_path, line, problem):
    write_scene(tmp_path, "0_a", lines=f"1;2;3;4;5\r\n{line}\r\n")
    with pytest.raises(FileFormatError, match="line 2") as caught:
        JacquardScenes(tmp_path).read_grasps(0)
    assert problem in str(caught.value)
    assert caught.value.path == tmp_path / "0_a_grasps.txt"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("part", ["RGB.png", "mask.png", "perfect_depth.tiff"])
@pytest.mark.parametrize("keep", [0, 5, 0.5, "text"])
def test_a_damaged_picture_is_named(tmp_path, capfd, part, keep):
    write_scene(tmp_path, "0_a")
    path = tmp_path / f"0_a_{part}"
    content = path.read_bytes()
    if keep == "text":
        path.write_text("this is no picture")
    else:
        path.write_bytes(content[: int(keep * len(content)) if keep == 0.5 else keep])
    with pytest.raises(FileFormatError) as caught:
        JacquardScenes(tmp_path)[0]
    assert caught.value.path == path
    # The decoder's own complaints stay silent: one error, one line.
    assert capfd.readouterr() == ("", "")


def test_a_flipped_bit_in_a_png_is_found(tmp_path, capfd):
    write_scene(tmp_path, "0_a")
    path = tmp_path / "0_a_RGB.png"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match="checksum"):
        JacquardScenes(tmp_path)[0]
    assert capfd.readouterr() == ("", "")


def test_wrong_size_and_wrong_type(tmp_path):
    write_scene(tmp_path, "0_a")
    write_scene(tmp_path / "other", "0_b", side=20)
    mask = tmp_path / "0_a_mask.png"
    good = mask.read_bytes()
    shutil.copy(tmp_path / "other" / "0_b_mask.png", mask)
    with pytest.raises(FileFormatError, match=r"20 x 20 px, but 0_a_RGB\.png is 48 x 48 px"):
        JacquardScenes(tmp_path)[0]
    cv2.imwrite(str(mask), np.arange(SIDE * SIDE, dtype=np.uint16).reshape(SIDE, SIDE))
    with pytest.raises(FileFormatError, match="uint16"):
        JacquardScenes(tmp_path)[0]
    cv2.imwrite(str(mask), np.arange(SIDE * SIDE).reshape(SIDE, SIDE).astype(np.uint8))
    with pytest.raises(FileFormatError, match="two levels"):
        JacquardScenes(tmp_path)[0]
    mask.write_bytes(good)
    cv2.imwrite(str(tmp_path / "0_a_RGB.png"), np.zeros((SIDE, SIDE, 3), np.uint16))
    with pytest.raises(FileFormatError, match="8 bits"):
        JacquardScenes(tmp_path)[0]


def test_depth_in_millimetres(tmp_path):
    write_scene(tmp_path, "0_a")
    path = tmp_path / "0_a_perfect_depth.tiff"
    cv2.imwrite(str(path), np.full((SIDE, SIDE), 1500, np.float32))
    with pytest.raises(FileFormatError, match="millimetres; divide it by 1000"):
        JacquardScenes(tmp_path)[0]
    # Whole numbers of 16 bits are millimetres by the convention of depth cameras.
    cv2.imwrite(str(path), np.full((SIDE, SIDE), 1500, np.uint16))
    np.testing.assert_allclose(JacquardScenes(tmp_path)[0].depth, 1.5)
    cv2.imwrite(str(path), np.zeros((SIDE, SIDE), np.float32))
    assert np.isnan(JacquardScenes(tmp_path)[0].depth).all()


def test_folder_without_scenes(tmp_path):
    with pytest.raises(DatasetNotFoundError, match="no such folder"):
        JacquardScenes(tmp_path / "nowhere")
    with pytest.raises(DatasetNotFoundError, match=r"_RGB\.png"):
        JacquardScenes(tmp_path)
    write_scene(tmp_path / "one", "0_a")
    write_scene(tmp_path / "two", "0_a")
    with pytest.raises(FileFormatError, match="scene 0_a is also in"):
        JacquardScenes(tmp_path)


def test_options_are_checked(tmp_path):
    write_scene(tmp_path, "0_a")
    with pytest.raises(UnknownNameError) as caught:
        JacquardScenes(tmp_path, depth="sterio")
    assert caught.value.nearest == "stereo"
    with pytest.raises(UnknownNameError):
        JacquardScenes(tmp_path, jaws="small")


@given(seed=st.integers(0, 10_000), nested=st.booleans())
def test_written_scenes_are_read_back(tmp_path_factory, seed, nested):
    root = tmp_path_factory.mktemp("written")
    scene = random_scene(seed)
    path = write_jacquard(scene, root, nested=nested)
    assert path.parent == (root / "cup" if nested else root)
    assert_same(JacquardScenes(root)[0], scene)
    assert not list(root.rglob("*.part"))
    shutil.rmtree(root)


def test_parts_that_a_scene_lacks_are_not_written(tmp_path):
    scene = random_scene(1, depth=None, mask=None, grasps=None)
    write_jacquard(scene, tmp_path, nested=False)
    assert [path.name for path in tmp_path.iterdir()] == ["1_cup_RGB.png"]
    assert_same(JacquardScenes(tmp_path)[0], scene)


def test_labels_that_hold_nothing_differ_from_no_labels(tmp_path):
    write_jacquard(random_scene(1, grasps=Grasps.empty()), tmp_path)
    assert JacquardScenes(tmp_path)[0].grasps == Grasps.empty()


def test_stereo_depth_is_written(tmp_path):
    scene = random_scene(2)
    stereo = np.full(scene.shape, 1.25, np.float32)
    stereo[0, 0] = np.nan
    write_jacquard(scene, tmp_path, stereo_depth=stereo)
    np.testing.assert_array_equal(JacquardScenes(tmp_path, depth="stereo")[0].depth, stereo)
    raw = cv2.imread(str(tmp_path / "cup" / "2_cup_stereo_depth.tiff"), cv2.IMREAD_UNCHANGED)
    assert raw[0, 0] == -1


def test_the_written_tiff_is_lzw(tmp_path):
    write_jacquard(random_scene(3), tmp_path, nested=False)
    content = (tmp_path / "3_cup_perfect_depth.tiff").read_bytes()
    # Tag 259 (compression), one 16-bit value: 5 is LZW.
    assert b"\x03\x01\x03\x00\x01\x00\x00\x00\x05\x00" in content


def test_a_camera_of_its_own_is_kept(tmp_path):
    own = Camera(60.0, 61.0, 20.0, 22.5, SIDE, SIDE)
    write_jacquard(random_scene(4, camera=own), tmp_path)
    assert JacquardScenes(tmp_path)[0].camera == own
    wide = Camera(60.0, 61.0, 20.0, 22.5, SIDE + 1, SIDE)
    wide.write(tmp_path / "cup" / "4_cup_camera.json")
    with pytest.raises(FileFormatError, match="49 x 48"):
        JacquardScenes(tmp_path)[0]


@pytest.mark.parametrize(
    "camera", [jacquard_camera(SIDE, SIDE), Camera(60, 61, 20, 22.5, SIDE, SIDE)]
)
def test_a_pose_of_its_own_is_kept(tmp_path, camera):
    pose = RigidTransform.from_quaternion([0.9, 0.1, -0.3, 0.3], [0.1, 0.2, 0.8])
    for i, own in enumerate((pose, None, jacquard_pose())):
        scene = random_scene(i, camera=camera, T_world_camera=own)
        write_jacquard(scene, tmp_path)
        assert JacquardScenes(tmp_path)[i].T_world_camera == own
        written = (tmp_path / "cup" / f"{i}_cup_camera.json").exists()
        assert written == (i < 2 or camera != jacquard_camera(SIDE, SIDE))


@pytest.mark.parametrize("matrix", ["[[1, 2], [3, 4]]", "7", '"none"', "[1, 2, 3]", "{}"])
def test_a_damaged_pose_is_named(tmp_path, matrix):
    write_jacquard(random_scene(0, T_world_camera=None), tmp_path)
    path = tmp_path / "cup" / "0_cup_camera.json"
    path.write_text(path.read_text().replace("{", f'{{"T_world_camera": {matrix},', 1))
    with pytest.raises(FileFormatError, match="T_world_camera") as caught:
        JacquardScenes(tmp_path)[0]
    assert caught.value.path == path


def test_pose_of_the_originals():
    pose = jacquard_pose()
    # The picture's middle shows the world's origin, its right half the positive x, its upper y.
    np.testing.assert_allclose(pose.apply([0, 0, 1.5]), 0, atol=1e-15)
    camera = jacquard_camera(1024, 1024)
    to_camera = pose.inverse()
    right, up, above = camera.project(to_camera.apply([[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]))
    assert right[0] > camera.cx
    assert right[1] == pytest.approx(camera.cy)
    assert up[0] == pytest.approx(camera.cx)
    assert up[1] < camera.cy
    # The camera leans towards the lower edge of the picture: what stands up, leans to the upper.
    assert above[1] < camera.cy
    assert pose.translation[2] == pytest.approx(1.4772, abs=1e-4)


def test_table_of_the_originals_is_the_plane_z_0(data_dir):
    """The published depth of bare table against the pose, to the steps it is written in."""
    for index in (0, 5, 8, 13, 18):
        scene = JacquardScenes(data_dir / "jacquard")[index]
        near = cv2.dilate(scene.mask.astype(np.uint8), np.ones((9, 9))) > 0
        rows, columns = np.nonzero(~near)
        pixels = np.column_stack([columns, rows])[::97].astype(float)
        points = scene.camera.deproject(pixels, scene.depth[rows, columns][::97])
        heights = scene.T_world_camera.apply(points)[:, 2]
        assert np.abs(heights).max() < 3e-4
        assert abs(heights.mean()) < 1e-4


def test_camera_of_the_originals():
    camera = jacquard_camera(1024, 1024)
    assert camera.fx == camera.fy == pytest.approx(1910.8, abs=0.05)
    assert jacquard_camera(640, 480) is None
    # The picture's edges are seen under 15 degrees whatever its size.
    for side in (320, 1024):
        camera = jacquard_camera(side, side)
        left = (-0.5 - camera.cx) / camera.fx
        assert math.degrees(math.atan(left)) == pytest.approx(-15)


@pytest.mark.parametrize(
    "changes",
    [
        {"rgb": None},
        {"id": "cup"},
        {"id": "0_../cup"},
        {"id": "0_a b"},
        {"id": "0_mug"},
        {"grasps": Grasps([[1, 2]], [0], [0], [3])},
    ],
)
def test_scenes_that_cannot_be_written(tmp_path, changes):
    with pytest.raises(InvalidInputError):
        write_jacquard(random_scene(0, **changes), tmp_path)
    assert not list(tmp_path.iterdir())


def test_wrong_stereo_shape(tmp_path):
    with pytest.raises(InvalidInputError, match="stereo"):
        write_jacquard(random_scene(0), tmp_path, stereo_depth=np.zeros((2, 2), np.float32))


def test_a_full_disk_leaves_no_scene(tmp_path, monkeypatch):
    real, calls = files.os.fdopen, []

    def full(handle, mode):
        calls.append(handle)
        if len(calls) < 3:
            return real(handle, mode)
        files.os.close(handle)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, "fdopen", full)
    with pytest.raises(StorageFullError, match="disk is full"):
        write_jacquard(random_scene(6), tmp_path)
    monkeypatch.undo()
    assert not list(tmp_path.rglob("*.part"))
    with pytest.raises(DatasetNotFoundError):
        JacquardScenes(tmp_path)


@given(
    theta=st.floats(-90, 89.9999).map(lambda degrees: round(degrees, 4)),
    x=st.floats(0, 1023).map(lambda pixel: round(pixel, 5)),
)
def test_label_text_survives(tmp_path_factory, theta, x):
    path = tmp_path_factory.mktemp("text") / "0_a_grasps.txt"
    path.write_text(f"{x};1.5;{theta};25.5;13.0321")
    once = format_grasps(read_grasps(path))
    numbers = [float(number) for number in once.strip().split(";")]
    assert numbers[0] == x
    assert numbers[1:] == [
        1.5,
        pytest.approx(theta if theta > -90 else 90, abs=1e-11),
        25.5,
        13.0321,
    ]
    path.write_text(once)
    assert format_grasps(read_grasps(path)) == once


@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.integers(0, 2), st.integers(0, 1), st.integers(1, 4)),
        max_size=30,
    )
)
def test_smallest_jaws_against_a_dictionary(rows):
    grasps = Grasps(
        [(x * 10.1, y * 7.3) for x, y, _, _ in rows],
        [0.3 * a for _, _, a, _ in rows],
        np.full(len(rows), 20.0),
        [float(jaw) for *_, jaw in rows],
    )
    expected: dict[tuple[int, int, int], int] = {}
    for *place, jaw in rows:
        expected[tuple(place)] = min(jaw, expected.get(tuple(place), 99))
    small = smallest_jaws(grasps)
    np.testing.assert_array_equal(small.height, list(expected.values()))
    np.testing.assert_allclose(
        small.center, np.reshape([(x * 10.1, y * 7.3) for x, y, _ in expected], (-1, 2))
    )
    assert smallest_jaws(small) == small


@given(
    st.lists(st.tuples(st.integers(0, 1), st.integers(0, 1), st.integers(1, 4)), unique=True),
    st.data(),
)
def test_jaw_shares_against_a_dictionary(rows, data):
    held = data.draw(st.lists(st.booleans(), min_size=len(rows), max_size=len(rows)))

    def made(some):
        return Grasps(
            np.reshape([(x * 10.1, 7.3) for x, _, _ in some], (-1, 2)),
            [0.3 * a for _, a, _ in some],
            np.full(len(some), 20.0),
            [float(jaw) for *_, jaw in some],
        )

    good = [row for row, h in zip(rows, held, strict=True) if h]
    bad = [row for row, h in zip(rows, held, strict=True) if not h]
    count = Counter(tuple(place) for *place, _ in good)
    both = Counter(tuple(place) for *place, _ in rows)
    for failed, most in (
        (None, max(count.values(), default=1)),
        (bad, max(both.values(), default=1)),
    ):
        shares = jaw_shares(made(good), None if failed is None else made(failed))
        # One that is listed again, as good as alike, counts once.
        again = made(good + good[:1])
        again = again.replace(height=again.height + 1e-12 * np.arange(len(again)))
        twice = jaw_shares(again, None if failed is None else made(failed))
        np.testing.assert_allclose(twice.quality, shares.quality)
        assert shares.replace(quality=np.ones(len(shares))) == smallest_jaws(made(good))
        np.testing.assert_allclose(shares.quality, [n / most for n in count.values()])


def test_smallest_jaws_after_a_turn():
    # -pi/2 and pi/2 are one angle, and rounding may fall on either side.
    grasps = Grasps([[5, 5], [5 + 1e-9, 5]], [np.pi / 2 - 1e-12, -np.pi / 2], [9, 9], [4, 2])
    np.testing.assert_array_equal(smallest_jaws(grasps).height, [2])


def test_real_scenes(data_dir, tmp_path):
    root = data_dir / "jacquard"
    scenes = JacquardScenes(root)
    assert len(scenes) == len(list(root.glob("*/*_RGB.png"))) > 0
    assert len({scenes.object_id(i) for i in range(len(scenes))}) == len(list(root.iterdir()))
    lines = sum(len(path.read_bytes().splitlines()) for path in root.glob("*/*_grasps.txt"))
    assert sum(len(scenes.read_grasps(i)) for i in range(len(scenes))) == lines
    first = scenes[0]
    assert first.shape == (1024, 1024)
    assert 1.3 < first.depth.min() < first.depth.max() < 1.6
    write_jacquard(first, tmp_path)
    assert_same(JacquardScenes(tmp_path)[0], first)
    # The table's rows say that a jaw size is a multiple of the smallest: all repeats are grouped.
    small = smallest_jaws(first.grasps)
    keys = {tuple(row) for row in np.column_stack([first.grasps.center, first.grasps.angle])}
    assert len(small) == len(keys) < len(first.grasps)
    # Grasps lie on the object: so the axes are not exchanged.
    x, y = np.round(small.center).astype(int).T
    assert first.mask[y, x].mean() > 0.8


def test_missing_file_between_listing_and_reading(tmp_path):
    write_scene(tmp_path, "0_a")
    scenes = JacquardScenes(tmp_path)
    (tmp_path / "0_a_mask.png").unlink()
    with pytest.raises(MissingFileError) as caught:
        scenes[0]
    assert isinstance(caught.value, GraspmapError)
    assert caught.value.path.name == "0_a_mask.png"
