"""Cornell's layout: rectangles, point clouds in a foreign frame, depth pictures."""

from __future__ import annotations

import math
import pickle

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.data import appendix, cornell
from graspmap.data.cornell import CornellScenes, read_labels
from graspmap.data.fingerprint import FileHashes, scenes_key
from graspmap.data.point_cloud import camera_depth, origin_distance, read_point_cloud
from graspmap.errors import DatasetNotFoundError, FileFormatError, UnknownNameError
from graspmap.geometry.grasps import Grasps, angle_difference

ROWS, COLUMNS = 48, 64
FOCAL = 55.0


def rectangle_lines(corners):
    return "".join(f"{x:.3f} {y:.3f} \n" for x, y in np.reshape(corners, (-1, 2)))


def table_with_box(tilt_deg=35.0):
    """(H, W) depth along z, metres, of a tilted table with a box on it, seen by a pinhole."""
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    x, y = (u - COLUMNS / 2) / FOCAL, (v - ROWS / 2) / FOCAL
    tilt = math.radians(tilt_deg)
    normal = np.array([0.0, math.cos(tilt), math.sin(tilt)])
    along = x * normal[0] + y * normal[1] + normal[2]
    depth = 1.0 / along
    box = (abs(u - 30) < 10) & (abs(v - 25) < 6)
    return np.where(box, 0.93 / along, depth)


def cloud_text(depth, *, frame="base", drop=(), fields="x y z rgb index", decimals=4):
    """An organised cloud as Cornell publishes it, millimetres; ``frame`` is that of the points."""
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(float)
    points = np.stack([(u - COLUMNS / 2) / FOCAL, (v - ROWS / 2) / FOCAL, np.ones_like(u)], -1)
    points = (points * depth[..., None]).reshape(-1, 3)
    if frame == "base":
        # Robot's base: x forward, y left, z up; the camera looks down by 35 degrees.
        tilt = math.radians(35)
        turn = np.array(
            [
                [0, -math.sin(tilt), math.cos(tilt)],
                [-1, 0, 0],
                [0, -math.cos(tilt), -math.sin(tilt)],
            ]
        )
        points = points @ turn.T + [0.6, -0.05, 0.4]
    lines = [
        f"{x:.{decimals}f} {y:.{decimals}f} {z:.{decimals}f} 2.34e-38 {index}"
        for index, (x, y, z) in enumerate(points * 1000)
        if index not in drop
    ]
    header = (
        f"# .PCD v.7 - Point Cloud Data file format\nFIELDS {fields}\nSIZE 4 4 4 4 4\n"
        f"TYPE F F F F U\nCOUNT 1 1 1 1 1\nWIDTH {len(lines)}\nHEIGHT 1\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(lines)}\nDATA ascii\n"
    )
    return header + "\n".join(lines) + "\n", points


def write_scene(folder, number, *, positives=None, negatives=None, cloud=None, depth=None):
    """One scene as Cornell publishes it, written without graspmap."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"pcd{number:04d}"
    rgb = np.random.default_rng(number).integers(0, 256, (ROWS, COLUMNS, 3), dtype=np.uint8)
    cv2.imwrite(str(folder / f"{name}r.png"), rgb[:, :, ::-1])
    for suffix, text in (("cpos.txt", positives), ("cneg.txt", negatives), (".txt", cloud)):
        if text is not None:
            (folder / f"{name}{suffix}").write_text(text)
    if depth is not None:
        cv2.imwrite(str(folder / f"{name}d.tiff"), depth.astype(np.float32))
    return rgb


SQUARE = [[10, 10], [30, 10], [30, 20], [10, 20]]


def test_reads_what_the_originals_hold(tmp_path):
    text = rectangle_lines(SQUARE)
    rgb = write_scene(tmp_path / "03", 320, positives=text, negatives=text * 2)
    write_scene(tmp_path / "10" / "deep", 1031)
    write_scene(tmp_path / "backgrounds", 7777)
    (tmp_path / "backgrounds" / "pcdb_0002r.png").write_bytes(b"")
    scenes = CornellScenes(tmp_path)
    assert scenes.ids == ("pcd0320", "pcd1031", "pcd7777")
    scene = scenes[0]
    np.testing.assert_array_equal(scene.rgb, rgb)
    assert scene.depth is None
    assert scene.labels == {"specific": "mug", "general": "crockery"}
    assert [scenes.object_id(i) for i in range(3)] == ["mug-0320", "lightbulb-1031", "pcd7777"]
    np.testing.assert_allclose(scene.grasps.center, [[20, 15]])
    assert (scene.grasps.angle[0], scene.grasps.width[0], scene.grasps.height[0]) == (0, 20, 10)
    assert len(scene.negatives) == 2
    assert scenes[1].grasps is None
    assert scenes[1].negatives is None
    assert CornellScenes(tmp_path, labels=False)[0].labels == {}
    assert pickle.loads(pickle.dumps(scenes)).ids == scenes.ids
    assert {path.name for path in scenes.files(0)} == {
        "pcd0320r.png",
        "pcd0320cpos.txt",
        "pcd0320cneg.txt",
    }


@given(
    angle=st.floats(-math.pi / 2, math.pi / 2 - 1e-6),
    width=st.floats(2, 90),
    height=st.floats(2, 60),
    reverse=st.booleans(),
)
def test_rectangles_round_trip(tmp_path_factory, angle, width, height, reverse):
    grasp = Grasps([[300, 200]], [angle], [width], [height])
    corners = grasp.corners()[0]
    if (
        reverse
    ):  # drawn the other way round, from the other end; the first edge is still the opening
        corners = corners[[1, 0, 3, 2]]
    path = tmp_path_factory.getbasetemp() / "round_trip_cpos.txt"
    path.write_text(rectangle_lines(corners))
    back = read_labels(path).grasps
    np.testing.assert_allclose(back.center, grasp.center, atol=1e-3)
    np.testing.assert_allclose(
        [back.width[0], back.height[0]], [grasp.width[0], grasp.height[0]], atol=2e-3
    )
    assert angle_difference(back.angle, grasp.angle)[0] < 2e-3 / width


def test_opening_runs_along_the_first_edge(tmp_path):
    # The first edge goes right and UP on screen (y falls), so the angle is positive.
    path = tmp_path / "pcd0100cpos.txt"
    path.write_text(rectangle_lines([[10, 30], [20, 20], [25, 25], [15, 35]]))
    assert read_labels(path).grasps.angle[0] == pytest.approx(math.pi / 4)


def test_nan_and_flat_rectangles_are_dropped_and_counted(tmp_path):
    good = rectangle_lines(SQUARE)
    nan = good.replace("30.000 20.000", "NaN NaN")
    flat = rectangle_lines([[10, 10], [30, 10], [30, 10], [10, 10]])
    path = tmp_path / "pcd0100cpos.txt"
    path.write_text((good + nan + flat + good).replace("\n", "\r\n"))
    labels = read_labels(path)
    assert labels.dropped == 2
    assert len(labels.grasps) == 2
    path.write_text(nan)
    assert read_labels(path).grasps == Grasps.empty()
    path.write_text("")
    assert read_labels(path).dropped == 0


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (rectangle_lines(SQUARE) + "1 2\n", "rectangle of 1 lines (line 5)"),
        ("1 2 3\n", "line 1 has 3 numbers"),
        ("1\n", "line 1 has 1 numbers"),
        ("\n1 2\nx y\n", "line 3 is not two numbers"),
        ("1 inf\n", "line 1 is infinite"),
        ("1\0 2\n", "zero bytes"),
    ],
)
def test_damaged_labels_are_named(tmp_path, text, problem):
    write_scene(tmp_path, 100, positives=text)
    with pytest.raises(FileFormatError) as caught:
        CornellScenes(tmp_path).read_grasps(0)
    assert problem in str(caught.value)
    assert caught.value.path == tmp_path / "pcd0100cpos.txt"


def test_corners_beyond_all_pixels_are_named(tmp_path):
    path = tmp_path / "pcd0001cpos.txt"
    path.write_text("1e308 1e308\n-1e308 1e308\n-1e308 -1e308\n1e308 -1e308\n")
    with pytest.raises(FileFormatError, match="no pixels"):
        read_labels(path)


def test_labels_that_are_no_text(tmp_path):
    path = tmp_path / "pcd0100cpos.txt"
    path.write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(FileFormatError, match="is no text"):
        read_labels(path)


@pytest.mark.parametrize("frame", ["base", "camera"])
def test_depth_along_the_camera_axis_from_a_cloud(tmp_path, frame):
    truth = table_with_box()
    text, points = cloud_text(truth, frame=frame, drop={5, 700})
    write_scene(tmp_path, 100, cloud=text)
    depth = CornellScenes(tmp_path)[0].depth
    holes = np.zeros(truth.size, bool)
    holes[[5, 700]] = True
    assert depth.dtype == np.float32
    np.testing.assert_array_equal(np.isnan(depth), holes.reshape(truth.shape))
    np.testing.assert_allclose(depth[~np.isnan(depth)], truth[~np.isnan(depth)], atol=2e-5)
    distance = CornellScenes(tmp_path, depth="range")[0].depth
    expected = np.linalg.norm(points, axis=1).reshape(truth.shape)
    np.testing.assert_allclose(distance[~np.isnan(depth)], expected[~np.isnan(depth)], rtol=1e-6)


def test_published_points_are_in_no_camera_frame(tmp_path):
    # Four published lines of pcd0100.txt: the z of the points is negative (a height), and their
    # distance from the origin is what the derived depth picture holds at their pixels.
    rows = [
        (1924.064, -647.111, -119.4176, 25547),
        (1924.412, -649.678, -119.7147, 25548),
        (1919.929, -650.5591, -116.9839, 25549),
        (1920.276, -653.1166, -117.2799, 25550),
    ]
    path = tmp_path / "pcd0100.txt"
    path.write_text(
        "FIELDS x y z rgb index\nPOINTS 4\nDATA ascii\n"
        + "".join(f"{x} {y} {z} 0 {i}\n" for x, y, z, i in rows)
    )
    cloud = read_point_cloud(path, (480, 640))
    assert (cloud.rows[0], cloud.columns[0]) == (39, 587)
    assert origin_distance(cloud)[39, 587] == pytest.approx(2.0334787, abs=1e-6)
    with pytest.raises(FileFormatError, match="range"):
        camera_depth(cloud)


def test_published_range_is_what_the_depth_picture_holds(data_dir):
    scenes = CornellScenes(data_dir / "cornell-raw")
    expected = {(39, 587): 2.0334787, (39, 588): 2.0346437, (39, 589): 2.0305269}
    for pixel, metres in expected.items():
        assert scenes[0].depth[pixel] == pytest.approx(metres, abs=1e-6)


def test_a_flat_cloud_in_a_foreign_frame_has_no_camera(tmp_path):
    v, _ = np.mgrid[:ROWS, :COLUMNS].astype(float)
    tilt = math.radians(35)
    plane = 1 / ((v - ROWS / 2) / FOCAL * math.cos(tilt) + math.sin(tilt))
    write_scene(tmp_path, 100, cloud=cloud_text(plane)[0])
    with pytest.raises(FileFormatError, match=r'plane.*depth="range"'):
        CornellScenes(tmp_path)[0]
    assert CornellScenes(tmp_path, depth="range")[0].depth is not None
    write_scene(tmp_path, 100, cloud=cloud_text(plane, frame="camera")[0])
    np.testing.assert_allclose(CornellScenes(tmp_path)[0].depth, plane, atol=1e-5)


def test_points_that_do_not_belong_to_their_pixels(tmp_path):
    text, _ = cloud_text(table_with_box())
    lines = text.splitlines()
    body = lines[10:]
    order = np.random.default_rng(0).permutation(len(body))
    moved = [" ".join([*body[i].split()[:4], str(k)]) for k, i in enumerate(order)]
    write_scene(tmp_path, 100, cloud="\n".join(lines[:10] + moved))
    with pytest.raises(FileFormatError, match="no camera sees"):
        CornellScenes(tmp_path)[0]


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("DATA ascii", "DATA binary", "binary"),
        ("DATA ascii", "VERSION .7", "no line of a PCD header"),
        ("FIELDS x y z rgb index", "FIELDS x y z rgb", "lacks the column 'index'"),
        (f"POINTS {ROWS * COLUMNS}", "POINTS many", "line 9 is 'POINTS many'"),
        (f"POINTS {ROWS * COLUMNS}", "POINTS 99999", "of the 99999 points"),
        (" 2.34e-38 7\n", " 2.34e-38\n", "line 18 is not 5 numbers"),
        (" 2.34e-38 7\n", " 2.34e-38 x7\n", "line 18 is not 5 numbers"),
        (" 2.34e-38 7\n", " 2.34e-38 7777\n", "indices up to 7777"),
    ],
)
def test_damaged_clouds_are_named(tmp_path, old, new, problem):
    text, _ = cloud_text(table_with_box())
    assert old in text
    write_scene(tmp_path, 100, cloud=text.replace(old, new))
    with pytest.raises(FileFormatError) as caught:
        CornellScenes(tmp_path)[0]
    assert problem in str(caught.value)
    assert caught.value.path == tmp_path / "pcd0100.txt"


def test_a_cloud_cut_short_is_no_scene_of_holes(tmp_path):
    text, _ = cloud_text(table_with_box())
    write_scene(tmp_path, 100, cloud=text[: len(text) // 2])
    with pytest.raises(FileFormatError, match="points it announces"):
        CornellScenes(tmp_path)[0]


def test_which_file_gives_the_depth(tmp_path):
    truth = table_with_box()
    picture = np.full(truth.shape, 0.7)
    picture[2, 3] = 0
    write_scene(tmp_path, 100, cloud=cloud_text(truth)[0], depth=picture)
    write_scene(tmp_path, 101, depth=picture)
    along, distance = CornellScenes(tmp_path), CornellScenes(tmp_path, depth="range")
    np.testing.assert_allclose(along[0].depth, truth, atol=2e-5)
    for scene in (along[1], distance[0], distance[1]):
        assert np.isnan(scene.depth[2, 3])
        assert np.nanmax(scene.depth) == np.float32(0.7)
    assert [path.name for path in along.files(0)] == ["pcd0100r.png", "pcd0100.txt"]
    assert [path.name for path in distance.files(0)] == ["pcd0100r.png", "pcd0100d.tiff"]
    cv2.imwrite(str(tmp_path / "pcd0101d.tiff"), np.ones((5, 5), np.float32))
    with pytest.raises(FileFormatError, match="5 x 5 px"):
        along[1]


def test_folder_without_scenes(tmp_path):
    with pytest.raises(DatasetNotFoundError, match="no such folder"):
        CornellScenes(tmp_path / "nowhere")
    with pytest.raises(DatasetNotFoundError, match=r"pcdNNNNr\.png"):
        CornellScenes(tmp_path)
    write_scene(tmp_path / "a", 100)
    write_scene(tmp_path / "b", 100)
    with pytest.raises(FileFormatError, match="pcd0100 is also in"):
        CornellScenes(tmp_path)
    with pytest.raises(UnknownNameError):
        CornellScenes(tmp_path / "a", depth="perfect")


def test_real_labels(data_dir):
    root = data_dir / "cornell-rgb"
    scenes = CornellScenes(root)
    assert len(scenes) == len(list(root.glob("*/*r.png")))
    lines = sum(len(path.read_text().split()) for path in root.glob("*/*cpos.txt"))
    assert sum(len(scenes.read_grasps(i)) for i in range(len(scenes))) == lines // 8
    scene = scenes[scenes.index("pcd0320")]
    assert scene.shape == (224, 224)
    assert scene.labels["specific"] == "mug"


def test_a_corrected_table_of_classes_makes_another_store(tmp_path, monkeypatch):
    cv2.imwrite(str(tmp_path / "pcd0100r.png"), np.zeros((4, 4, 3), np.uint8))

    def key(**options):
        hashes = FileHashes(tmp_path / "index.json")
        return scenes_key(CornellScenes(tmp_path, **options), hashes, {})

    before, unlabelled = key(), key(labels=False)
    corrected = tmp_path / "labels.yaml"
    corrected.write_bytes(appendix.LABELS_FILE.read_bytes() + b"# corrected\n")
    monkeypatch.setattr(cornell, "LABELS_FILE", corrected)
    assert key() != before
    assert key(labels=False) == unlabelled
