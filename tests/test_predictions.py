"""Jacquard's prediction files, in both directions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.data.jacquard_predictions import read_predictions, write_predictions
from graspmap.errors import FileFormatError, InvalidInputError, MissingFileError
from graspmap.geometry.grasps import Grasps, angle_difference

grasps = st.integers(1, 4).flatmap(
    lambda n: st.builds(
        Grasps,
        st.lists(st.tuples(*[st.floats(-20, 340)] * 2), min_size=n, max_size=n),
        st.lists(st.floats(-1.57, 1.57), min_size=n, max_size=n),
        st.lists(st.floats(0.1, 300), min_size=n, max_size=n),
        st.lists(st.floats(0, 200), min_size=n, max_size=n),
    )
)


@settings(max_examples=50)
@given(
    predictions=st.dictionaries(st.from_regex(r"[0-9]{1,3}_[a-z0-9]{1,8}", fullmatch=True), grasps),
    size_px=st.sampled_from([224, 300, 320, 1024]),
)
def test_round_trip_to_the_printed_precision(tmp_path_factory, predictions, size_px):
    path = tmp_path_factory.getbasetemp() / "predictions.txt"
    write_predictions(path, predictions, size_px=size_px)
    if not predictions:
        return
    back = read_predictions(path)
    scale = 1024 / size_px
    assert list(back) == list(predictions)
    for name, written in predictions.items():
        read = back[name]
        # Outer edges coincide: (x + 0.5) grows by the scale.
        np.testing.assert_allclose(read.center, (written.center + 0.5) * scale - 0.5, atol=0.00501)
        np.testing.assert_allclose(read.width, written.width * scale, atol=0.00501)
        np.testing.assert_allclose(read.height, written.height * scale, atol=0.00501)
        assert (angle_difference(read.angle, written.angle) < np.radians(0.00501)).all()


def test_the_file_that_the_server_takes(tmp_path):
    path = tmp_path / "predictions.txt"
    write_predictions(
        path,
        {
            "0_cup": Grasps(
                [[1, 2], [511.5, 3]], [0.1, -np.pi / 4], [40, 25], [20, 12.346], [0.2, 0.9]
            ),
            "1_cup": Grasps.empty(),
            "2_cup": Grasps([[7, 8]], [1e-5], [10], [5]),
        },
        size_px=1024,
    )
    assert path.read_text().splitlines() == [
        "0_cup",
        "511.50;3.00;45.00;25.00;12.35",  # the better one first; clockwise
        "0_cup",
        "1.00;2.00;-5.73;40.00;20.00",
        "2_cup",
        "7.00;8.00;0.00;10.00;5.00",
    ]


def test_grasp_lines_may_follow_one_id_or_repeat_it(tmp_path):
    path = tmp_path / "predictions.txt"
    a, b = "1;2;3;4;5", "6;7;8;9;10"
    path.write_text(f"0_x\n{a}\n{b}\n1_x\n{b}\n")
    one = read_predictions(path)
    path.write_text(f"\r\n0_x\r\n{a}\r\n0_x\r\n{b}\r\n\r\n1_x\r\n{b}\r\n")
    assert read_predictions(path) == one
    np.testing.assert_array_equal(one["0_x"].center, [[1, 2], [6, 7]])
    np.testing.assert_allclose(np.degrees(one["0_x"].angle), [-3, -8])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "holds no predictions"),
        ("0_x\n", "line 1 (0_x) has no grasp: the file ends"),
        ("0_x\n1;2;3;4;5\n1_x\n", "line 3 (1_x) has no grasp: the file ends"),
        ("0_x\n1_x\n1;2;3;4;5\n", "line 1 (0_x) has no grasp: line 2 is the next id"),
        ("1;2;3;4;5\n", "line 1 is a grasp before any id"),
        ("0_x\n1;2;3;4\n", "line 2 has 4 numbers"),
        ("0_x\n1;2;3;4;5;6\n", "line 2 has 6 numbers"),
        ("0_x\n1;2;NaN;4;5\n", "line 2 is not finite"),
        ("0_x\n1;2;a;4;5\n", "line 2 is not numbers"),
        ("0_x\n1;2;3;0;5\n", "line 2 has opening 0"),
        ("0_x\n1;2;3;-4;5\n", "line 2 has opening -4"),
        ("0_x\n1 2 3 4 5\n", "line 2 is neither an id nor a grasp"),
        ("0_x\n1,2,3,4,5\n", "line 2 is neither an id nor a grasp"),
        ("0_x\n1;2;3;4;5\n1_x\n1;2;3;4;5\n0_x\n1;2;3;4;5\n", "line 5 names 0_x a second time"),
    ],
)
def test_bad_lines_are_named(tmp_path, text, problem):
    path = tmp_path / "predictions.txt"
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_predictions(path)
    assert problem in str(caught.value)
    assert caught.value.path == path


def test_files_that_are_no_text(tmp_path):
    with pytest.raises(MissingFileError):
        read_predictions(tmp_path / "nowhere.txt")
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    with pytest.raises(FileFormatError, match="no text"):
        read_predictions(tmp_path / "binary")


@pytest.mark.parametrize(
    ("name", "width", "size_px"),
    [("0 x", 5, 1024), ("", 5, 1024), ("a;b", 5, 1024), ("0_x", 0, 1024), ("0_x", 5, 0)],
)
def test_what_cannot_be_written(tmp_path, name, width, size_px):
    path = tmp_path / "predictions.txt"
    with pytest.raises(InvalidInputError):
        write_predictions(path, {name: Grasps([[1, 2]], [0], [width], [3])}, size_px=size_px)
    assert not path.exists()


def test_every_wrong_line_is_told(tmp_path):
    path = tmp_path / "predictions.txt"
    path.write_text("0_x\n1;2;3;4\n1_x\n2_x\n1;2;3;4;5\n0_x\n1;2;3;4;5\n2_x\n")
    with pytest.raises(FileFormatError) as caught:
        read_predictions(path)
    told = str(caught.value)
    for problem in (
        "line 2 has 4 numbers",
        "line 3 (1_x) has no grasp: line 4 is the next id",
        "line 6 names 0_x a second time",
        "line 8 names 2_x a second time",
        "line 8 (2_x) has no grasp: the file ends",
    ):
        assert problem in told
    path.write_text("0_x\n" + "1;2\n" * 9)
    with pytest.raises(FileFormatError, match="and 4 more"):
        read_predictions(path)
