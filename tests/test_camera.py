"""Camera: projection laws, OpenCV as the oracle, and the files that others write."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import (
    FileError,
    FileFormatError,
    GraspmapWarning,
    InvalidInputError,
    MissingFileError,
)
from graspmap.geometry import Camera, affine

CAMERA = Camera(615.5, 614.25, 320.5, 241.0, 640, 480)

focal = st.floats(50, 5000)
offset = st.floats(-1000, 2000)
cameras = st.builds(Camera, focal, focal, offset, offset, st.just(640), st.just(480))
points = st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.05, 10))


class TestProjection:
    @given(cameras, st.lists(points, min_size=1, max_size=5))
    def test_deproject_undoes_project(self, camera, xyz):
        xyz = np.array(xyz)
        back = camera.deproject(camera.project(xyz), xyz[:, 2])
        assert back == pytest.approx(xyz, abs=1e-9)

    @given(cameras, st.lists(points, min_size=1, max_size=5))
    def test_agrees_with_opencv(self, camera, xyz):
        expected, _ = cv2.projectPoints(
            np.array(xyz), np.zeros(3), np.zeros(3), camera.matrix, None
        )
        assert camera.project(xyz) == pytest.approx(expected[:, 0], rel=1e-9, abs=1e-7)

    def test_x_is_right_and_y_is_down(self):
        center, right, down = CAMERA.project([(0, 0, 1), (0.1, 0, 1), (0, 0.1, 1)])
        assert center.tolist() == [320.5, 241.0]
        assert right[0] > center[0]
        assert right[1] == center[1]
        assert down[1] > center[1]

    def test_depth_is_along_z_and_not_along_the_ray(self):
        assert CAMERA.deproject([(0.0, 0.0)], [2.0])[0, 2] == 2.0

    def test_any_leading_axes(self):
        pixels = np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1)
        assert CAMERA.deproject(pixels, np.ones((3, 4))).shape == (3, 4, 3)
        assert CAMERA.project(np.ones(3)).shape == (2,)
        assert CAMERA.project(np.zeros((0, 3))).shape == (0, 2)
        assert CAMERA.deproject(np.zeros((0, 2)), []).shape == (0, 3)

    def test_no_depth_no_point(self):
        assert np.isnan(CAMERA.deproject([(1, 2)], [np.nan])).all()

    @pytest.mark.parametrize("z", [0.0, -1.0, np.nan])
    def test_nothing_is_seen_behind_the_camera(self, z):
        assert np.isnan(CAMERA.project([(0.1, 0.2, z)])).all()

    @pytest.mark.parametrize("depth", [0.0, -1.0, np.inf])
    def test_refuses_a_depth_that_is_none(self, depth):
        with pytest.raises(InvalidInputError, match="NaN where there is none"):
            CAMERA.deproject([(1, 2), (3, 4)], [1.0, depth])

    def test_refuses_wrong_shapes(self):
        with pytest.raises(InvalidInputError, match="depth_m"):
            CAMERA.deproject([(1, 2), (3, 4)], [1.0])
        with pytest.raises(InvalidInputError, match="pixels"):
            CAMERA.deproject([(1, 2, 3)], [1.0])
        with pytest.raises(InvalidInputError, match="points"):
            CAMERA.project([(1, 2)])


class TestConstruction:
    def test_field_of_view_spans_the_outer_edges(self):
        camera = Camera.from_field_of_view(np.radians(30), 1024, 768)
        assert camera.fx == pytest.approx(512 / np.tan(np.radians(15)))
        assert (camera.cx, camera.cy) == (511.5, 383.5)
        left, right = camera.deproject([(-0.5, 0), (1023.5, 0)], [1, 1])
        assert np.arctan(right[0]) - np.arctan(left[0]) == pytest.approx(np.radians(30))

    @pytest.mark.parametrize("fov", [0, -1, np.pi, np.nan, "wide"])
    def test_refuses_a_field_of_view(self, fov):
        with pytest.raises(InvalidInputError):
            Camera.from_field_of_view(fov, 640, 480)

    @pytest.mark.parametrize(
        ("field", "value"),
        [
            ("fx", 0),
            ("fy", -5),
            ("fx", np.nan),
            ("cx", np.inf),
            ("cy", "centre"),
            ("fx", None),
            ("fx", True),
            ("width", 0),
            ("height", 2.5),
            ("width", np.nan),
        ],
    )
    def test_refuses(self, field, value):
        with pytest.raises(InvalidInputError, match=field):
            Camera(**(CAMERA.to_dict() | {field: value}))

    def test_numpy_numbers_become_plain_ones(self):
        camera = Camera(*np.float32([600, 600, 320, 240]), np.int32(640), np.uint16(480))
        assert json.loads(json.dumps(camera.to_dict())) == camera.to_dict()


class TestTransformed:
    @given(cameras, points, st.floats(0.1, 8), offset, offset)
    def test_pixels_of_the_new_camera_are_the_mapped_ones(self, camera, point, factor, dx, dy):
        m = affine.resize(factor) @ affine.crop(dx, dy)
        moved = camera.transformed(m, 224, 224)
        expected = affine.apply(m, camera.project([point]))
        assert moved.project([point]) == pytest.approx(expected, rel=1e-9, abs=1e-6)
        assert (moved.width, moved.height) == (224, 224)

    @pytest.mark.parametrize(
        "matrix",
        [
            affine.rotation(0.1),
            affine.rotation(np.pi),
            affine.flip(640),
            np.diag([2.0, 1.0, 1.0]),
            np.zeros((3, 3)),
        ],
    )
    def test_refuses_what_no_camera_sees(self, matrix):
        with pytest.raises(InvalidInputError):
            CAMERA.transformed(matrix, 640, 480)


ROS_CALIBRATION = """
image_width: 640
image_height: 480
camera_name: wrist
camera_matrix:
  rows: 3
  cols: 3
  data: [615.5, 0, 320.5, 0, 614.25, 241.0, 0, 0, 1]
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0, 0, 0, 0, 0]
"""
ROS_ECHO = """header:
  frame_id: camera
height: 480
width: 640
d: [0.0, 0.0, 0.0, 0.0, 0.0]
k: [615.5, 0.0, 320.5, 0.0, 614.25, 241.0, 0.0, 0.0, 1.0]
---
"""
ROWS = [[615.5, 0, 320.5], [0, 614.25, 241], [0, 0, 1]]


class TestFiles:
    @given(cameras)
    def test_round_trip_is_exact(self, tmp_path_factory, camera):
        path = tmp_path_factory.mktemp("camera") / "camera.json"
        camera.write(path)
        assert Camera.read(path) == camera
        assert [p.name for p in path.parent.iterdir()] == ["camera.json"]

    @pytest.mark.parametrize(
        "text",
        [
            "fx: 6.155e2\nfy: 614.25\ncx: 320.5\ncy: 241\nwidth: 640\nheight: 480\n",
            ROS_CALIBRATION,
            ROS_ECHO,
            json.dumps({"K": ROWS, "width": 640, "height": 480, "D": []}),
            json.dumps(
                {
                    "fx": 615.5,
                    "fy": 614.25,
                    "ppx": 320.5,
                    "ppy": 241,
                    "width": 640,
                    "height": 480,
                    "model": "brown_conrady",
                    "coeffs": [0, 0, 0, 0, 0],
                }
            ),
        ],
        ids=["own", "ros calibration", "ros message", "matrix", "realsense"],
    )
    def test_reads_the_forms_of_others(self, tmp_path, text):
        path = tmp_path / "camera.yaml"
        path.write_text(text)
        assert Camera.read(path) == CAMERA

    def test_warns_of_distortion(self, tmp_path):
        path = tmp_path / "camera.yaml"
        path.write_text(ROS_CALIBRATION.replace("data: [0, 0, 0, 0, 0]", "data: [0.1, 0, 0, 0, 0]"))
        with pytest.warns(GraspmapWarning, match="rectify"):
            assert Camera.read(path) == CAMERA

    def test_a_camera_info_with_distortion_gives_the_rectified_camera(self):
        p = [540.0, 0, 325, 0, 0, 541, 238, 0, 0, 0, 1, 0]
        info = {"K": ROWS, "D": [0.1, 0, 0, 0, 0], "P": p, "width": 640, "height": 480}
        with pytest.warns(GraspmapWarning, match="its P is taken"):
            found = Camera.from_dict(info)
        assert found == Camera(540, 541, 325, 238, 640, 480)
        # Without distortion both are the same, and before a calibration P is empty.
        assert Camera.from_dict({**info, "D": [0, 0, 0, 0, 0]}) == CAMERA
        with pytest.warns(GraspmapWarning, match="rectify"):
            assert Camera.from_dict({**info, "P": [0.0] * 12}) == CAMERA

    def test_arrays_are_read_as_lists_are(self):
        """As the messages of ROS 2 hold them."""
        info = {"k": np.array(ROWS, float), "d": np.zeros(5), "width": 640, "height": 480}
        assert Camera.from_dict(info) == CAMERA
        assert Camera.from_dict({**info, "k": np.array(ROWS, float).ravel()}) == CAMERA
        with pytest.warns(GraspmapWarning, match="rectify"):
            Camera.from_dict({**info, "d": np.array([0.1, 0, 0, 0, 0])})

    @pytest.mark.parametrize(
        ("text", "problem"),
        [
            ("", "no keys"),
            ("[1, 2, 3]", "no keys"),
            ("{'fx: [", "neither JSON nor YAML"),
            ("%YAML:1.0\n---\nK: !!opencv-matrix {}\n", "neither JSON nor YAML"),
            ("fx: 1\nfy: 1\n", "without cx, cy, width, height"),
            ("fx: 1\nfy: 1\ncx: 1\ncy: 1\nwidth: many\nheight: 5\n", "width"),
            ("fx: -1\nfy: 1\ncx: 1\ncy: 1\nwidth: 5\nheight: 5\n", "fx"),
            ("K: [1, 2, 3]\nwidth: 5\nheight: 5\n", "length of K"),
            ("K: 5\nwidth: 5\nheight: 5\n", "nine numbers"),
            ("camera_matrix: {rows: 3}\nwidth: 5\nheight: 5\n", "nine numbers"),
            ("K: [600, 0, 0, 0, 600, 0, 320, 240, 1]\nwidth: 5\nheight: 5\n", "row by row"),
            ("K: [600, 1, 320, 0, 600, 240, 0, 0, 1]\nwidth: 5\nheight: 5\n", "no skew"),
        ],
    )
    def test_names_what_is_wrong(self, tmp_path, text, problem):
        path = tmp_path / "camera.yaml"
        path.write_text(text)
        with pytest.raises(FileFormatError, match=problem) as caught:
            Camera.read(path)
        assert caught.value.path == path
        assert "camera_info" in caught.value.remedy

    def test_missing_folder_and_binary(self, tmp_path):
        with pytest.raises(MissingFileError):
            Camera.read(tmp_path / "none.json")
        with pytest.raises(FileFormatError):
            Camera.read(tmp_path)
        (tmp_path / "picture.png").write_bytes(b"\x89PNG\xff\xfe\x00")
        with pytest.raises(FileFormatError):
            Camera.read(tmp_path / "picture.png")

    def test_from_dict_says_what_it_got(self):
        with pytest.raises(InvalidInputError, match="it has focal"):
            Camera.from_dict({"focal": 600})
        with pytest.raises(InvalidInputError, match="it has nothing"):
            Camera.from_dict({})


@pytest.mark.parametrize("number", ["1" * 400, "1" * 9000, "[" * 50000])
def test_numbers_beyond_all_bounds(tmp_path, number):
    path = tmp_path / "camera.json"
    path.write_text(f'{{"fx": {number}, "fy": 1, "cx": 0, "cy": 0, "width": 4, "height": 3}}')
    with pytest.raises(FileFormatError) as caught:
        Camera.read(path)
    assert caught.value.path == path
    with pytest.raises(FileError, match="cannot be read"):
        Camera.read(tmp_path / ("x" * 300))
