"""Pictures: what is drawn is where the numbers say, in the colours that the legend says."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.geometry import Grasps, affine
from graspmap.maps.grasp_maps import GraspMaps
from graspmap.pictures import (
    Tile,
    color_bar,
    contact_sheet,
    depth_picture,
    draw_grasps,
    encode,
    map_picture,
    overlay,
)
from graspmap.pictures.draw import JAW, OPENING, draw_window, text_width
from graspmap.pictures.fields import HOLE


def gray(rows=120, columns=160):
    return np.full((rows, columns, 3), 128, dtype=np.uint8)


def one(x=80.0, y=60.0, angle=0.0, width=60.0, height=30.0):
    return Grasps([[x, y]], [angle], [width], [height])


def near(picture, point, color, reach=2):
    x, y = np.rint(point).astype(int)
    patch = picture[y - reach : y + reach + 1, x - reach : x + reach + 1].reshape(-1, 3)
    # Thin lines are blended with what is around them: blue and red only have to dominate.
    balance = patch[:, 2].astype(int) - patch[:, 0]
    return balance.max() > 60 if color == JAW else balance.min() < -60


def maps_of(angle, quality=1.0, width=0.5, shape=(8, 8)):
    full = np.full((1, *shape), 1.0, dtype=np.float32)
    return GraspMaps(
        full * quality, full * np.cos(2 * angle), full * np.sin(2 * angle), full * width
    )


@given(st.floats(-np.pi / 2, np.pi / 2 - 0.01), st.floats(30, 70), st.floats(20, 40))
def test_jaws_and_opening_are_where_the_corners_say(angle, width, height):
    grasp = one(angle=angle, width=width, height=height)
    picture = draw_grasps(gray(), grasp)
    p0, p1, p2, p3 = grasp.corners()[0]
    for a, b in ((p0, p3), (p1, p2)):
        assert near(picture, (a + b) / 2, JAW)
    for a, b in ((p0, p1), (p3, p2)):
        assert near(picture, (a + b) / 2, OPENING)


def test_a_positive_angle_turns_counter_clockwise_on_screen():
    picture = draw_grasps(gray(), one(angle=np.pi / 4, width=80, height=6))
    assert near(picture, (80 + 28, 60 - 28), JAW)  # upper right
    assert near(picture, (80 - 28, 60 + 28), JAW)  # lower left
    assert (picture[60 + 28, 80 + 28] == 128).all()


def test_drawing_leaves_the_picture_and_can_enlarge():
    base = gray()
    large = draw_grasps(base, one(angle=0.3), scale=2.5)
    assert (base == 128).all()
    assert large.shape == (300, 400, 3)
    axis_end = affine.apply(affine.resize(2.5), one(angle=0.3).corners()[0][[0, 3]]).mean(axis=0)
    assert near(large, axis_end, JAW, reach=3)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e7, 1e12])
def test_extreme_grasps_do_not_break_the_drawing(size):
    grasps = Grasps([[0, 0], [1e12, -1e12], [80, 60]], [0, 1, -1], [size] * 3, [size] * 3)
    assert draw_grasps(gray(), grasps, ranks=True).shape == (120, 160, 3)


def test_the_best_grasp_lies_on_top():
    best, other = one(width=60, height=30), one(width=60, height=30, x=80.5)
    picture = draw_grasps(gray(), Grasps.concatenate([best, other]))
    alone = draw_grasps(gray(), best)
    assert (picture[60, 50] == alone[60, 50]).all()


@pytest.mark.parametrize(
    "bad", [np.zeros((4, 4), np.uint8), np.zeros((4, 4, 3)), np.zeros((0, 4, 3), np.uint8)]
)
def test_what_is_no_picture_is_refused(bad):
    with pytest.raises(InvalidInputError):
        draw_grasps(bad, one())
    with pytest.raises(InvalidInputError):
        encode(bad)


@given(st.lists(st.floats(0, 1), min_size=2, max_size=30))
def test_quality_brightens_steadily(values):
    row = np.sort(np.array(values, np.float32))[None, None]
    picture = map_picture(GraspMaps(row, row * 0 + 1, row * 0, row), "quality")
    light = picture[0].astype(float) @ [0.299, 0.587, 0.114]
    assert (np.diff(light) >= -1.0).all()


def test_angle_hue_is_cyclic_and_distinct():
    up, down = (map_picture(maps_of(s * np.pi / 2), "angle")[0, 0].astype(int) for s in (1, -1))
    assert np.abs(up - down).max() <= 2
    flat = map_picture(maps_of(0.0), "angle")[0, 0].astype(int)
    assert np.abs(up - flat).max() > 150
    assert map_picture(maps_of(0.0, quality=0.0), "angle").max() < 60


def test_the_angle_bar_shows_the_hues_of_the_map():
    bar = color_bar("angle", 181, "-90", "90")[0].astype(int)
    for degrees in (-60, 0, 45):
        drawn = map_picture(maps_of(np.radians(degrees)), "angle")[0, 0].astype(int)
        assert np.abs(bar[degrees + 90] - drawn).max() <= 4


def test_the_best_bin_is_shown():
    quality = np.zeros((2, 4, 4), np.float32)
    quality[1] = 1
    width = np.stack([np.zeros((4, 4)), np.ones((4, 4))]).astype(np.float32)
    maps = GraspMaps(quality, quality, quality * 0, width)
    bright = map_picture(maps, "width", width_top=1.0)
    assert bright[0, 0].sum() > 300


@pytest.mark.parametrize("level", [-0.1, 0.0, 1.0])
def test_maps_without_any_promise_are_shown_too(level):
    sheet = overlay(gray(), one(), maps_of(0.1, quality=level, width=-level), np.eye(3))
    assert sheet.shape[2] == 3


def test_unknown_kind_of_map():
    with pytest.raises(InvalidInputError, match="quality, angle, width"):
        map_picture(maps_of(0), "height")  # type: ignore[arg-type]


def test_depth_marks_holes_and_near_is_bright():
    depth = np.linspace(0.5, 1.5, 100, dtype=np.float32).reshape(10, 10)
    depth[0, 0] = np.nan
    picture = depth_picture(depth)
    assert tuple(picture[0, 0]) == HOLE
    assert picture[0, 1].sum() > picture[-1, -1].sum()
    assert (depth_picture(np.full((3, 3), np.nan, np.float32)) == HOLE).all()


def test_sheet_holds_every_tile_and_shortens_captions():
    tiles = [Tile(gray(40, 80), "word " * 40), Tile(gray(80, 40)), Tile(gray(30, 30))]
    sheet = contact_sheet(tiles, columns=2, cell=100, title="title")
    assert sheet.dtype == np.uint8
    assert sheet.shape[1] == 2 * 112 + 12
    with pytest.raises(InvalidInputError):
        contact_sheet([])
    with pytest.raises(InvalidInputError):
        contact_sheet(tiles, columns=0)


def test_overlay_of_a_detection_without_grasps():
    sheet = overlay(gray(), Grasps.empty(), maps_of(0.1, shape=(32, 32)), np.eye(3))
    assert sheet.shape[2] == 3


def test_window_darkens_what_is_not_seen():
    matrix = affine.window(20, 10, 50, 100)
    picture = draw_window(gray(), matrix, (100, 100))
    assert tuple(picture[30, 40]) == (128, 128, 128)
    assert tuple(picture[5, 5]) == (64, 64, 64)
    assert tuple(picture[100, 100]) == (64, 64, 64)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".JPEG"])
def test_encoded_pictures_decode_to_the_same_colours(suffix):
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 0] = 200
    back = cv2.imdecode(np.frombuffer(encode(red, suffix), np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(back[..., ::-1].astype(int) - red).max() < 6
    with pytest.raises(InvalidInputError):
        encode(red, ".bmp")


def test_text_that_is_no_unicode_has_a_width():
    assert text_width("a\udcff") == text_width("a?") > 0
