"""TableGrasps: what they check, and their way between the picture and the table."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from graspmap.data import read_scenes
from graspmap.errors import InvalidInputError
from graspmap.geometry import Camera, Grasps, RigidTransform, TableGrasps, angle_difference
from graspmap.geometry.table_grasps import HOLE_REACH_PX, surface_depth

CAMERA = Camera(600, 600, 319.5, 239.5, 640, 480)


def turn(axis: int, angle: float) -> RigidTransform:
    """Rotation about one of the axes."""
    half = angle / 2
    xyz = np.sin(half) * np.eye(3)[axis]
    return RigidTransform.from_quaternion([*xyz, np.cos(half)])


def looking_down(height=1.0, tilt=0.0, nod=0.0, heading=0.0) -> RigidTransform:
    """Camera whose optical axis meets the table at the origin, `height` away along it."""
    facing = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    attitude = turn(2, heading) @ facing @ turn(0, tilt) @ turn(1, nod)
    return RigidTransform(attitude.rotation, -height * attitude.rotation[:, 2])


def flat(value, camera=CAMERA):
    return np.full((camera.height, camera.width), value)


@st.composite
def views(draw):
    camera = Camera(
        draw(st.floats(300, 2000)),
        draw(st.floats(300, 2000)),
        draw(st.floats(0, 640)),
        draw(st.floats(0, 480)),
        640,
        480,
    )
    lean = st.floats(-0.7, 0.7)
    heading = draw(st.floats(-3, 3))
    return camera, looking_down(draw(st.floats(0.5, 3)), draw(lean), draw(lean), heading)


@st.composite
def table_grasps(draw):
    place = st.floats(-0.2, 0.2)
    return TableGrasps(
        [[draw(place), draw(place)]],
        [draw(st.floats(-np.pi / 2, 1.57))],
        [draw(st.floats(0.001, 0.24))],
        [draw(st.floats(0.001, 0.06))],
        [draw(st.floats(0, 1))],
    )


def on_table(pixel, height, camera, T_world_camera):
    """Where the ray of a pixel crosses z = height, by solving three equations."""
    x, y = pixel
    inverse = np.linalg.inv(camera.matrix)
    ray = T_world_camera.matrix[:3, :3] @ inverse @ [x, y, 1.0]
    # eye + t ray = (X, Y, height) in the unknowns X, Y, t.
    left = np.column_stack([np.eye(3)[:, :2], -ray])
    eye = T_world_camera.matrix[:3, 3]
    return np.linalg.solve(left, eye - [0, 0, height])


class TestPixels:
    @given(views(), table_grasps(), st.floats(0, 0.2))
    def test_round_trip_is_the_same_grasp(self, view, grasp, height):
        camera, pose = view
        pixels = grasp.to_pixels(height, camera, pose)
        z = pose.inverse().apply([[*grasp.center_m[0], height]])[0, 2]
        inside = (np.abs(pixels.center - (319.5, 239.5)) < (320, 240)).all()
        assume(inside)
        again = TableGrasps.from_pixels(pixels, flat(z), camera, pose)
        assert again.center_m == pytest.approx(grasp.center_m, abs=1e-12)
        assert again.width_m == pytest.approx(grasp.width_m, rel=1e-9)
        assert again.height_m == pytest.approx(grasp.height_m, rel=1e-9)
        assert angle_difference(again.angle, grasp.angle) == pytest.approx(0, abs=1e-9)
        assert again.quality == grasp.quality

    @given(
        views(),
        st.tuples(st.floats(0, 639), st.floats(0, 479)),
        st.floats(-1.57, 1.57),
        st.floats(1, 60),
        st.floats(0.02, 0.25),
    )
    def test_agrees_with_crossing_the_plane_ray_by_ray(self, view, center, angle, width, height):
        camera, pose = view
        step = np.array([np.cos(angle), -np.sin(angle)]) * width / 2
        middle, first, second = (
            on_table(center + k * step, height, camera, pose) for k in (0, -1, 1)
        )
        assume(min(middle[2], first[2], second[2]) > 0)
        # The third unknown is the depth along the ray, in units of the camera's z.
        pixels = Grasps([center], [angle], [width], [12.0])
        grasp = TableGrasps.from_pixels(pixels, flat(middle[2]), camera, pose)
        opening = second[:2] - first[:2]
        assert grasp.center_m[0] == pytest.approx(middle[:2], abs=1e-9)
        assert grasp.width_m[0] == pytest.approx(np.hypot(*opening), rel=1e-7)
        assert angle_difference(grasp.angle, np.arctan2(opening[1], opening[0])) < 1e-7
        if camera.fx == camera.fy:
            assert grasp.height_m[0] == pytest.approx(12 * middle[2] / camera.fx)

    @given(table_grasps(), st.floats(-3, 3), st.floats(-0.5, 0.5))
    def test_turning_the_camera_turns_the_grasps(self, grasp, heading, tilt):
        pixels = grasp.to_pixels(0.05, CAMERA, looking_down(1.5, tilt))
        turned = looking_down(1.5, tilt, heading=heading)
        depth = looking_down(1.5, tilt).inverse().apply([[*grasp.center_m[0], 0.05]])[0, 2]
        assume((np.abs(pixels.center - (319.5, 239.5)) < (320, 240)).all())
        moved = TableGrasps.from_pixels(pixels, flat(depth), CAMERA, turned)
        assert angle_difference(moved.angle - heading, grasp.angle) == pytest.approx(0, abs=1e-9)
        assert moved.width_m == pytest.approx(grasp.width_m)

    def test_angle_is_counter_clockwise_from_above(self):
        pixels = Grasps([[319.5, 239.5]], [np.radians(30)], [60], [12])
        grasp = TableGrasps.from_pixels(pixels, flat(1.0), CAMERA, looking_down(1.0))
        assert grasp.angle[0] == pytest.approx(np.radians(30))
        assert grasp.width_m[0] == pytest.approx(0.1)
        assert grasp.height_m[0] == pytest.approx(0.02)

    def test_an_opening_of_nothing_keeps_its_angle(self):
        pixels = Grasps([[300, 200]], [0.4], [0], [12])
        pose = looking_down(1.0, 0.2)
        grasp = TableGrasps.from_pixels(pixels, flat(0.9), CAMERA, pose)
        assert grasp.width_m[0] == 0
        height = pose.apply(CAMERA.deproject([[300, 200]], [0.9]))[0, 2]
        assert grasp.to_pixels(height, CAMERA, pose).angle == pytest.approx([0.4])

    def test_no_grasps(self):
        none = TableGrasps.from_pixels(Grasps.empty(), flat(1.0), CAMERA, looking_down())
        assert len(none) == 0
        assert len(none.to_pixels([], CAMERA, looking_down())) == 0


class TestSurface:
    """Which depth a grasp's centre gets."""

    def depth_at(self, depth, x, y, pose=None):
        return surface_depth(np.array([[x, y]]), depth, CAMERA, pose or looking_down(1.0))[0][0]

    def test_is_that_of_the_nearest_pixel(self):
        depth = flat(1.0)
        depth[100, 200] = 0.9
        assert self.depth_at(depth, 200.4, 99.6) == 0.9
        assert self.depth_at(depth, 200.6, 99.6) == 1.0

    @pytest.mark.parametrize("hole", [np.nan, 0.0, -1.0, np.inf])
    def test_of_a_hole_comes_from_the_nearest_square_that_has_any(self, hole):
        depth = flat(0.8)
        depth[98:103, 198:203] = hole
        depth[97, 200], depth[97, 201] = 0.6, 0.5
        ring = [0.6, 0.5] + [0.8] * 22
        assert self.depth_at(depth, 200, 100) == pytest.approx(np.median(ring))

    def test_of_a_wide_hole_is_the_tables(self):
        depth = flat(0.8)
        reach = HOLE_REACH_PX
        depth[100 - reach : 101 + reach, 200 - reach : 201 + reach] = np.nan
        assert self.depth_at(depth, 200, 100) == pytest.approx(1.0)
        assert self.depth_at(depth, 201, 100) == 0.8

    @given(st.tuples(st.floats(-300, 900), st.floats(-300, 700)), st.floats(-0.4, 0.4))
    def test_outside_the_picture_is_the_tables(self, pixel, tilt):
        x, y = pixel
        assume(not (-1 < x < 640 and -1 < y < 480))
        pose = looking_down(1.0, tilt)
        depth = self.depth_at(flat(0.5), x, y, pose)
        assert pose.apply(CAMERA.deproject([pixel], [depth]))[0, 2] == pytest.approx(0, abs=1e-12)

    def test_below_the_table_is_the_tables(self):
        assert self.depth_at(flat(1.1), 200, 100) == pytest.approx(1.0)

    def test_in_a_corner_of_the_picture(self):
        depth = flat(0.8)
        depth[0, 0] = np.nan
        assert self.depth_at(depth, -0.4, -0.4) == 0.8


class TestRefuses:
    grasp = Grasps([[319.5, 239.5]], [np.pi / 2 - 0.01], [20], [5])

    def test_depth_of_another_camera(self):
        with pytest.raises(InvalidInputError, match=r"\(480, 640\)"):
            TableGrasps.from_pixels(self.grasp, np.ones((640, 480)), CAMERA, looking_down())

    @pytest.mark.parametrize("tilt", [-2.0, 2.0, np.pi / 2])
    def test_centres_above_the_horizon(self, tilt):
        facing = looking_down(1.0, tilt)
        pose = RigidTransform(facing.rotation, [0, 0, 1.0])
        with pytest.raises(InvalidInputError, match="misses the table"):
            TableGrasps.from_pixels(self.grasp, flat(1.0), CAMERA, pose)

    def test_openings_that_reach_the_horizon(self):
        # The horizon of a camera that looks 80 degrees up from straight down: f tan(10) above.
        facing = looking_down(1.0, np.radians(80))
        pose = RigidTransform(facing.rotation, [0, 0, 1.0])
        horizon = 600 * np.tan(np.radians(10))
        upright = self.grasp.replace(angle=np.pi / 2 - 1e-9)
        TableGrasps.from_pixels(upright.replace(width=1.99 * horizon), flat(2.0), CAMERA, pose)
        with pytest.raises(InvalidInputError, match="misses the table"):
            TableGrasps.from_pixels(upright.replace(width=2.01 * horizon), flat(2.0), CAMERA, pose)

    def test_a_camera_below_the_table(self):
        pose = RigidTransform(looking_down().rotation, [0, 0, -0.1])
        with pytest.raises(InvalidInputError, match="height of the camera"):
            TableGrasps.from_pixels(self.grasp, flat(1.0), CAMERA, pose)

    @pytest.mark.parametrize("surface", [[0.1], [0.1, np.nan], [[0.1, 0.1]]])
    def test_heights_of_other_grasps(self, surface):
        two = TableGrasps([[0, 0], [0, 0]], [0, 0], [0.1, 0.1], [0.02, 0.02])
        with pytest.raises(InvalidInputError, match="surface_m"):
            two.to_pixels(surface, CAMERA, looking_down())

    def test_a_surface_above_the_camera(self):
        one = TableGrasps([[0, 0]], [0], [0.1], [0.02])
        with pytest.raises(InvalidInputError, match="lower than it"):
            one.to_pixels([1.5], CAMERA, looking_down(1.0))

    @pytest.mark.parametrize(
        ("field", "value"),
        [
            ("center_m", [[np.nan, 0]]),
            ("center_m", [[0, 0, 0]]),
            ("angle", [0, 1]),
            ("width_m", [-0.1]),
            ("height_m", [-0.1]),
            ("quality", [np.inf]),
        ],
    )
    def test_fields(self, field, value):
        values = {"center_m": [[0, 0]], "angle": [0], "width_m": [0.1], "height_m": [0.02]}
        with pytest.raises(InvalidInputError, match=field):
            TableGrasps(**(values | {field: value}))


class TestRows:
    four = TableGrasps(
        np.arange(8).reshape(4, 2), [0, 1, 2, 3], [1, 2, 3, 4], [5, 6, 7, 8], [0.1, 0.2, 0.3, 0.4]
    )

    def test_index(self):
        assert len(self.four) == 4
        assert self.four[-1].width_m.tolist() == [4]
        assert self.four[1:3].width_m.tolist() == [2, 3]
        assert self.four[[3, 0]].width_m.tolist() == [4, 1]
        assert self.four[self.four.quality > 0.25].width_m.tolist() == [3, 4]
        assert [g.height_m[0] for g in self.four] == [5, 6, 7, 8]
        with pytest.raises(IndexError):
            self.four[4]

    def test_joined_again(self):
        assert TableGrasps.concatenate([self.four[:1], self.four[1:]]) == self.four
        assert TableGrasps.concatenate([]) == TableGrasps.empty()

    def test_is_not_a_grasp_in_pixels(self):
        assert TableGrasps.empty() != Grasps.empty()

    def test_angle_is_wrapped_and_gives_the_axis(self):
        assert self.four.angle == pytest.approx([0, 1, 2 - np.pi, 3 - np.pi])
        one = TableGrasps([[0, 0]], [np.radians(30)], [1], [1])
        assert one.axis()[0] == pytest.approx([np.sqrt(3) / 2, 0.5])

    def test_arrays_cannot_be_written(self):
        for grasps in (self.four, self.four[1:], pickle.loads(pickle.dumps(self.four))):
            with pytest.raises(ValueError, match="read-only"):
                grasps.width_m[0] = 1

    def test_replace(self):
        assert self.four.replace(height_m=0.02).height_m.tolist() == [0.02] * 4
        with pytest.raises(InvalidInputError, match="width_m"):
            self.four.replace(width=1)

    def test_says_what_it_is(self):
        assert repr(self.four) == "TableGrasps(4)"
        assert "width_m=1.0000" in repr(self.four[0])


def test_jaws_of_jacquard_are_whole_centimetres(data_dir):
    """The jaws of its labels are 1, 2, 3, 4 or 6 cm by the depth of the centre's pixel."""
    scenes = read_scenes(f"jacquard:{data_dir / 'jacquard'}")
    jaws = []
    for index in range(0, len(scenes), 6):
        scene = scenes[index]
        grasps = TableGrasps.from_pixels(
            scene.grasps, scene.depth, scene.camera, scene.T_world_camera
        )
        jaws.append(grasps.height_m)
    off = np.abs(np.concatenate(jaws)[:, None] - [0.01, 0.02, 0.03, 0.04, 0.06]).min(axis=1)
    assert np.median(off) < 0.0003
    assert np.quantile(off, 0.95) < 0.0015
