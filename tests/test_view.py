"""Views: Jacquard's camera, random ones, and objects that no picture holds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.data.jacquard import jacquard_camera, jacquard_pose
from graspmap.errors import GraspmapError, InvalidInputError
from graspmap.geometry import Camera, RigidTransform
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.render import (
    OutOfViewError,
    Randomisation,
    View,
    check_in_view,
    jacquard_view,
    sample_view,
)
from graspmap.simulation.render.view import turn
from graspmap.simulation.tabletop import PlacedObject, Tabletop

CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def points_on_table(*cubes):
    """A tabletop of cubes (side, x, y), as far as their vertices matter."""
    placed = []
    for number, (side, x, y) in enumerate(cubes):
        model = ObjectModel(
            f"cube{number}", side * CUBE, np.zeros((0, 3), np.int32), (), 0.1, np.eye(3)
        )
        placed.append(PlacedObject(model, RigidTransform(np.eye(3), [x, y, side / 2])))
    return Tabletop(tuple(placed), None)


class TestJacquardView:
    @pytest.mark.parametrize("size", [320, 1024])
    def test_is_the_camera_that_the_reader_gives(self, size):
        view = jacquard_view(size)
        assert view.camera == jacquard_camera(size, size)
        assert view.T_world_camera == jacquard_pose()

    def test_image_runs_along_the_world(self):
        view = jacquard_view(512)
        T_camera_world = view.T_world_camera.inverse()
        middle, x, y = view.camera.project(
            T_camera_world.apply([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)])
        )
        assert middle == pytest.approx([255.5, 255.5])
        assert x[0] > middle[0] + 50
        assert x[1] == pytest.approx(middle[1])
        assert y[0] == pytest.approx(middle[0])
        assert y[1] < middle[1] - 50


class TestSampleView:
    @given(st.integers(0, 2**32))
    def test_stays_within_its_ranges(self, seed):
        ranges = Randomisation().camera
        view = sample_view(Randomisation(), np.random.default_rng(seed), 320)
        pose, camera = view.T_world_camera, view.camera
        axis = pose.rotation[:, 2]
        distance = -pose.translation[2] / axis[2]
        meets = pose.translation + distance * axis
        assert ranges.distance_m[0] - 1e-9 <= distance <= ranges.distance_m[1] + 1e-9
        assert np.abs(meets[:2]).max() <= ranges.look_at_m + 1e-9
        field = 2 * math.degrees(math.atan(160 / camera.fx))
        assert ranges.field_of_view_deg[0] <= field <= ranges.field_of_view_deg[1]
        lean = math.degrees(math.acos(-axis[2]))
        assert lean <= math.hypot(ranges.tilt_deg[1], ranges.pan_deg[1])
        assert pose.rotation[0, 0] > 0.95
        assert pose.rotation[1, 1] < -0.95

    def test_without_ranges_it_is_jacquards(self):
        camera = {
            "distance_m": (1.5, 1.5),
            "tilt_deg": (10.0, 10.0),
            "pan_deg": (0.0, 0.0),
            "roll_deg": (0.0, 0.0),
            "look_at_m": 0.0,
            "field_of_view_deg": (30.0, 30.0),
        }
        randomisation = Randomisation.model_validate({"camera": camera})
        view = sample_view(randomisation, np.random.default_rng(3), 640)
        expected = jacquard_view(640)
        assert view.camera.matrix == pytest.approx(expected.camera.matrix)
        assert view.T_world_camera.matrix == pytest.approx(expected.T_world_camera.matrix)

    def test_a_roll_turns_the_picture_clockwise(self):
        camera = {"roll_deg": (30.0, 30.0), "tilt_deg": (0.0, 0.0), "pan_deg": (0.0, 0.0)}
        randomisation = Randomisation.model_validate({"camera": camera | {"look_at_m": 0.0}})
        view = sample_view(randomisation, np.random.default_rng(0), 400)
        ahead = view.camera.project(view.T_world_camera.inverse().apply([0.1, 0, 0]))
        assert math.degrees(math.atan2(-(ahead[1] - 199.5), ahead[0] - 199.5)) == pytest.approx(30)

    @given(st.floats(-math.pi, math.pi))
    def test_cosine_and_sine(self, angle):
        assert turn(angle) == pytest.approx((math.cos(angle), math.sin(angle)), abs=2e-15)


class TestCheckInView:
    def test_an_object_in_the_middle_is_seen(self):
        check_in_view(points_on_table((0.1, 0, 0), (0.2, 0.1, 0.1)), jacquard_view(320))

    def test_says_which_object_and_how_much_lies_outside(self):
        tabletop = points_on_table((0.1, 0, 0), (0.1, 0.4, 0))
        with pytest.raises(OutOfViewError, match=r"cube1 is 50% outside") as caught:
            check_in_view(tabletop, jacquard_view(320))
        error = caught.value
        assert isinstance(error, GraspmapError)
        assert error.object_id == "cube1"
        # Its upper far corners are at depth 1.5 / cos(10 deg) at least, 45 cm to the right.
        assert 15 < error.beyond_px < 40

    def test_an_object_larger_than_the_view(self):
        with pytest.raises(OutOfViewError) as caught:
            check_in_view(points_on_table((1.2, 0, 0)), jacquard_view(320))
        assert caught.value.outside == 1.0

    def test_an_object_behind_the_camera(self):
        view = View(Camera(300, 300, 159.5, 159.5, 320, 320), jacquard_view(320).T_world_camera)
        with pytest.raises(OutOfViewError) as caught:
            check_in_view(points_on_table((4.0, 0, 0)), view)
        assert caught.value.beyond_px == math.inf

    def test_refuses_a_size(self):
        with pytest.raises(InvalidInputError):
            jacquard_view(0)
