"""Mass properties against closed forms and trimesh, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from graspmap.errors import InvalidInputError
from graspmap.simulation.objects import Texture
from graspmap.simulation.solids import mass_properties, object_from_solid, open_edges

BOX = trimesh.creation.box((0.2, 0.1, 0.06))
sizes = st.tuples(*[st.floats(0.01, 0.5)] * 3)
shifts = st.tuples(*[st.floats(-2, 2)] * 3)
turns = st.integers(0, 10_000).map(lambda n: Rotation.random(rng=n).as_matrix())


def arrays(mesh):
    return np.array(mesh.vertices), np.array(mesh.faces)


class TestMassProperties:
    @settings(max_examples=40)
    @given(sizes, shifts, turns)
    def test_box_anywhere(self, sides, shift, turn):
        vertices, faces = arrays(trimesh.creation.box(sides))
        found = mass_properties(vertices @ turn.T + shift, faces)
        a, b, c = np.square(sides)
        volume = np.prod(sides)
        expected = turn @ np.diag([b + c, a + c, a + b]) @ turn.T * volume / 12
        assert found.volume_m3 == pytest.approx(volume)
        assert found.center_m == pytest.approx(np.array(shift), abs=1e-9)
        assert found.moments_m5 == pytest.approx(expected, rel=1e-8, abs=1e-12 + 1e-9 * volume)

    def test_sphere(self):
        radius = 0.05
        found = mass_properties(*arrays(trimesh.creation.icosphere(5, radius)))
        volume = 4 / 3 * np.pi * radius**3
        assert found.volume_m3 == pytest.approx(volume, rel=1e-3)
        assert found.moments_m5 == pytest.approx(np.eye(3) * 0.4 * volume * radius**2, rel=2e-3)

    @settings(max_examples=20)
    @given(sizes, shifts)
    def test_parallel_axes(self, sides, shift):
        """Two boxes far apart are two boxes and what the theorem adds."""
        parts = [trimesh.creation.box(sides), trimesh.creation.box(sides)]
        parts[1].apply_translation(np.add(shift, (3, 0, 0)))
        one = mass_properties(*arrays(parts[0]))
        both = mass_properties(*arrays(trimesh.util.concatenate(parts)))
        half = np.add(shift, (3, 0, 0)) / 2
        moved = one.volume_m3 * (half @ half * np.eye(3) - np.outer(half, half))
        assert both.volume_m3 == pytest.approx(2 * one.volume_m3)
        assert both.moments_m5 == pytest.approx(2 * (one.moments_m5 + moved), rel=1e-9)

    @pytest.mark.parametrize("seed", range(5))
    def test_agrees_with_trimesh(self, seed):
        rng = np.random.default_rng(seed)
        mesh = trimesh.convex.convex_hull(rng.normal(size=(40, 3)) * 0.05 + rng.normal(size=3))
        found = mass_properties(*arrays(mesh))
        assert found.volume_m3 == pytest.approx(mesh.volume)
        assert found.center_m == pytest.approx(mesh.center_mass)
        assert found.moments_m5 == pytest.approx(mesh.moment_inertia, rel=1e-6, abs=1e-15)

    def test_reversed_faces_are_negative(self):
        vertices, faces = arrays(BOX)
        assert mass_properties(vertices, faces[:, ::-1]).volume_m3 == pytest.approx(-0.0012)


class TestObject:
    def test_is_centred_with_its_pieces(self):
        vertices, faces = arrays(BOX)
        moved = np.add(vertices, (5, 6, 7))
        model = object_from_solid("b", moved, faces, [moved], mass_kg=3)
        assert model.vertices == pytest.approx(vertices, abs=1e-9)
        assert model.pieces[0] == pytest.approx(vertices, abs=1e-9)
        assert model.mass_kg == pytest.approx(3)
        assert np.diag(model.inertia) == pytest.approx(
            3 / 12 * np.array([0.1**2 + 0.06**2, 0.2**2 + 0.06**2, 0.2**2 + 0.1**2])
        )
        with pytest.raises(ValueError, match="read-only"):
            model.vertices[0] = 0

    def test_mass_follows_from_density(self):
        model = object_from_solid("b", *arrays(BOX), [BOX.vertices], density_kg_m3=500)
        assert model.mass_kg == pytest.approx(0.6)

    def test_vertices_may_be_doubled_along_seams(self):
        corners = BOX.vertices[BOX.faces].reshape(-1, 3)
        faces = np.arange(36).reshape(-1, 3)
        texture = Texture(np.zeros((2, 2, 3), np.uint8), np.zeros((36, 2)))
        model = object_from_solid("b", corners, faces, [BOX.vertices], mass_kg=1, texture=texture)
        assert model.texture is texture
        assert len(model.vertices) == 36

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"id": "a/b"}, "letters"),
            ({"vertices": np.full((8, 3), np.nan)}, "finite"),
            ({"vertices": np.zeros((8, 2))}, "shape"),
            ({"vertices": "box"}, "numbers"),
            ({"vertices": BOX.vertices * [1, 1, 0]}, "flat"),
            ({"faces": BOX.faces[:-1]}, "open"),
            ({"faces": BOX.faces + 1}, "0 to 7"),
            ({"faces": BOX.faces + 0.5}, "whole"),
            ({"faces": BOX.faces[:, ::-1]}, "reverse"),
            ({"faces": np.vstack([BOX.faces[:1, ::-1], BOX.faces[1:]])}, "wound"),
            ({"pieces": []}, "at least one"),
            ({"pieces": [BOX.vertices, BOX.vertices * [1, 0, 1]]}, "piece 1"),
            ({"mass_kg": None}, "neither"),
            ({"mass_kg": 0}, "above 0"),
            ({"mass_kg": np.inf}, "above 0"),
            ({"density_kg_m3": 1}, "both"),
            ({"texture": Texture(np.zeros((2, 2, 3), np.uint8), np.zeros((7, 2)))}, "uv"),
            ({"texture": Texture(np.zeros((2, 2), np.uint8), np.zeros((8, 2)))}, "uint8"),
        ],
    )
    def test_refuses(self, change, words):
        good = {"id": "b", "vertices": BOX.vertices, "faces": BOX.faces, "pieces": [BOX.vertices]}
        with pytest.raises(InvalidInputError, match=words):
            object_from_solid(**(good | {"mass_kg": 1} | change))


def test_open_edges_are_those_of_the_missing_face():
    assert open_edges(np.array(BOX.vertices), np.array(BOX.faces)) == 0
    assert open_edges(np.array(BOX.vertices), np.array(BOX.faces[1:])) == 3
    assert open_edges(np.zeros((0, 3)), np.zeros((0, 3), int)) == 0
