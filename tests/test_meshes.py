"""Mesh files of users: real ones, and every bad one told clearly."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from graspmap.errors import (
    FileFormatError,
    GraspmapWarning,
    InvalidInputError,
    MissingFileError,
    UnknownNameError,
)
from graspmap.gripper import load_gripper
from graspmap.simulation import _mend, pieces
from graspmap.simulation._mend import mend
from graspmap.simulation.hulls import box_sides
from graspmap.simulation.meshes import (
    MESH_SUFFIXES,
    MeshWarning,
    UnitWarning,
    default_id,
    egad_scale,
    load_object,
)
from graspmap.simulation.solids import open_edges

BOX = trimesh.creation.box((0.06, 0.04, 0.05))
BALL = trimesh.creation.icosphere(3, 0.04)


@pytest.fixture
def load(tmp_path, cache):
    """Write a mesh and load it."""

    def _load(mesh, name="thing.ply", **options):
        if not isinstance(mesh, trimesh.Trimesh):
            (tmp_path / name).write_bytes(mesh)
        else:
            mesh.export(tmp_path / name)
        return load_object(tmp_path / name, **({"unit": "m", "cache": cache} | options))

    return _load


def without(mesh, keep):
    return trimesh.Trimesh(mesh.vertices, mesh.faces[keep], process=False)


class TestGood:
    @pytest.mark.parametrize("suffix", MESH_SUFFIXES)
    def test_every_format(self, load, suffix):
        model = load(BOX, f"my box{suffix}")
        assert model.id == "my-box"
        assert model.extents_m == pytest.approx((0.06, 0.04, 0.05))
        assert model.vertices.mean(axis=0) == pytest.approx(0, abs=1e-7)
        assert len(model.pieces) == 1
        assert model.mass_kg == pytest.approx(BOX.volume * 500)

    @pytest.mark.parametrize(
        ("options", "mass"),
        [
            ({"mass_kg": 0.2}, 0.2),
            ({"density_kg_m3": 1000}, 0.12),
            ({"density_kg_m3": 1e6}, 1.0),
            ({"density_kg_m3": 1}, 0.01),
            ({"density_kg_m3": 1, "mass_range_kg": (0.05, 0.06)}, 0.05),
        ],
    )
    def test_mass(self, load, options, mass):
        model = load(BOX, **options)
        assert model.mass_kg == pytest.approx(mass)
        assert model.inertia[0, 0] == pytest.approx(mass / 12 * (0.04**2 + 0.05**2))

    def test_names_in_an_old_encoding(self, load):
        text = BOX.export(file_type="obj").encode()
        model = load(
            "# K\N{LATIN SMALL LETTER U WITH DIAERESIS}che\n".encode("latin-1") + text, "a.obj"
        )
        assert model.extents_m == pytest.approx((0.06, 0.04, 0.05))

    def test_several_geometries_are_one_object(self, tmp_path, cache):
        lid = trimesh.creation.box((0.06, 0.04, 0.01))
        scene = trimesh.Scene([BOX])
        scene.add_geometry(lid, transform=trimesh.transformations.translation_matrix([0, 0, 0.03]))
        scene.export(tmp_path / "a.glb")
        model = load_object(tmp_path / "a.glb", cache=cache)  # the format says metres: no warning
        assert model.extents_m == pytest.approx((0.06, 0.04, 0.06))
        assert len(model.pieces) == 1

    def test_texture_and_its_coordinates(self, tmp_path, cache):
        picture = np.random.default_rng(0).integers(0, 256, (4, 4, 3), dtype=np.uint8)
        corners = BOX.vertices[BOX.faces].reshape(-1, 3)
        uv = np.random.default_rng(1).uniform(0, 1, (36, 2))
        material = trimesh.visual.material.SimpleMaterial(image=Image.fromarray(picture))
        visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        faces = np.arange(36).reshape(-1, 3)
        mesh = trimesh.Trimesh(corners, faces, visual=visual, process=False)
        mesh.export(tmp_path / "a.obj")
        model = load_object(tmp_path / "a.obj", unit="m", cache=cache)
        np.testing.assert_array_equal(model.texture.image, picture)
        assert model.texture.uv == pytest.approx(uv, abs=1e-6)
        assert model.vertices == pytest.approx(corners, abs=1e-6)

    def test_pictures_of_two_parts_side_by_side(self, tmp_path, cache):
        scene = trimesh.Scene()
        for x, color in ((0.0, (255, 0, 0)), (0.03, (0, 0, 255))):
            part = trimesh.creation.box((0.04, 0.04, 0.04))
            part.apply_translation([x, 0, 0])
            image = Image.new("RGB", (8, 8), color)
            uv = np.random.default_rng(2).uniform(0, 1, (8, 2))
            material = trimesh.visual.material.PBRMaterial(baseColorTexture=image)
            part.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
            scene.add_geometry(part)
        scene.export(tmp_path / "a.glb")
        texture = load_object(tmp_path / "a.glb", cache=cache).texture
        rows, columns = texture.image.shape[:2]
        u = np.round(texture.uv[:, 0] * columns - 0.5).astype(int)
        v = np.round((1 - texture.uv[:, 1]) * rows - 0.5).astype(int).clip(0, rows - 1)
        seen = texture.image[v, u]
        assert sorted(map(tuple, np.unique(seen, axis=0).tolist())) == [(0, 0, 255), (255, 0, 0)]

    def test_the_second_time_is_from_the_cache(self, load, monkeypatch):
        bar = trimesh.creation.box((0.1, 0.02, 0.02))
        cross = trimesh.util.concatenate([bar, trimesh.creation.box((0.02, 0.1, 0.02))])
        first = load(cross, "cross.obj")
        monkeypatch.setattr(pieces, "_decompose", lambda *_: pytest.fail("computed again"))
        again = load(cross, "cross.obj")
        assert [p.tobytes() for p in first.pieces] == [p.tobytes() for p in again.pieces]
        assert first.inertia.tobytes() == again.inertia.tobytes()


class TestUnits:
    @pytest.mark.parametrize(
        ("unit", "factor"), [("m", 1), ("cm", 100), ("mm", 1000), ("inch", 1 / 0.0254)]
    )
    def test_stated(self, load, unit, factor):
        scaled = BOX.copy().apply_scale(factor)
        assert load(scaled, unit=unit).extents_m == pytest.approx((0.06, 0.04, 0.05))

    @pytest.mark.parametrize(
        ("factor", "unit"), [(1, "m"), (0.1, "m"), (30, "m"), (1000, "mm"), (100, "mm")]
    )
    def test_guessed_with_a_warning(self, load, factor, unit):
        with pytest.warns(UnitWarning, match=f"unit={unit!r}, --unit {unit}"):
            model = load(BOX.copy().apply_scale(factor), unit=None)
        assert model.extents_m.max() == pytest.approx(0.06 * factor / (1000 if unit == "mm" else 1))

    @pytest.mark.parametrize("factor", [1e-2, 50, 1e5])
    def test_neither(self, load, factor):
        with pytest.raises(FileFormatError, match=r"neither metres .*state its unit"):
            load(BOX.copy().apply_scale(factor), unit=None)

    def test_enormous_and_tiny(self, load):
        with pytest.raises(
            FileFormatError, match=r"enormous: 60 m long with its unit m.*0\.005 to 2 m"
        ):
            load(BOX.copy().apply_scale(1000))
        with pytest.raises(FileFormatError, match="tiny: 6e-05 m"):
            load(BOX, unit="mm")
        with pytest.raises(FileFormatError, match=r"enormous.*as the format has it"):
            load(BOX.copy().apply_scale(1000), "a.glb", unit=None)

    def test_any_size_fits_a_gripper(self, load):
        gripper = load_gripper("franka")
        sizes = [
            load(BOX.copy().apply_scale(f), unit=None, fit_to=gripper).extents_m
            for f in (1e-3, 1e4)
        ]
        assert sizes[0] == pytest.approx(sizes[1], rel=1e-5)


class TestEgadScale:
    def test_longest_side_becomes_the_opening(self):
        assert egad_scale(BOX.vertices * [1, 1, 0.1], 0.08) == pytest.approx(0.08 / 0.06)

    def test_unless_the_shortest_is_then_too_long(self):
        cube = trimesh.creation.box((0.05, 0.05, 0.05))
        assert egad_scale(cube.vertices, 0.08) == pytest.approx(0.8 * 0.08 / 0.05)
        assert egad_scale(BOX.vertices * [1, 1, 1], 0.08) == pytest.approx(0.08 / 0.06)

    @settings(max_examples=15)
    @given(st.integers(0, 10_000), st.tuples(*[st.floats(0.2, 1)] * 3))
    def test_turning_the_mesh_changes_nothing(self, seed, stretch):
        points = np.random.default_rng(seed).normal(size=(12, 3)) * stretch
        turned = points @ Rotation.random(rng=seed).as_matrix().T + 3
        assert egad_scale(points, 0.1) == pytest.approx(egad_scale(turned, 0.1), rel=1e-6)

    @pytest.mark.parametrize("seed", range(3))
    def test_box_agrees_with_trying_all(self, seed):
        """Every face of the hull, and on it every edge of the shadow."""
        points = np.random.default_rng(seed).normal(size=(30, 3)) * (1, 0.5, 0.3)
        boxes = []
        for normal in ConvexHull(points).equations[:, :3]:
            turned = points @ Rotation.align_vectors([0, 0, 1], normal)[0].as_matrix().T
            shadow = turned[:, :2][ConvexHull(turned[:, :2]).vertices]
            for x, y in np.roll(shadow, 1, axis=0) - shadow:
                across = turned[:, :2] @ np.array([[x, -y], [y, x]]) / np.hypot(x, y)
                boxes.append(np.sort([*np.ptp(across, axis=0), np.ptp(turned[:, 2])]))
        assert box_sides(points) == pytest.approx(min(boxes, key=np.prod))
        with_trimesh = trimesh.bounds.oriented_bounds(points)[1]
        assert box_sides(points).prod() <= with_trimesh.prod() * (1 + 1e-9)

    def test_refuses(self):
        with pytest.raises(InvalidInputError, match="opening_m"):
            egad_scale(BOX.vertices, 0)


class TestMended:
    """Meshes with defects that can be helped: they become bodies, and it is said."""

    def test_inside_out(self, load):
        assert load(trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1])).mass_kg == pytest.approx(
            0.06
        )

    @pytest.mark.parametrize("turned", [(0,), (1,), (0, 1)])
    @pytest.mark.parametrize("apart", [0.1, 0.06])
    def test_bodies_of_which_some_are_inside_out(self, load, turned, apart):
        bodies = [BOX.copy(), trimesh.creation.box((0.05, 0.04, 0.05))]
        bodies[1].apply_translation([apart, 0, 0])
        for number in turned:
            bodies[number].invert()
        model = load(trimesh.util.concatenate(bodies))
        assert model.mass_kg == pytest.approx(500 * (BOX.volume + 0.05 * 0.04 * 0.05))
        assert np.ptp(np.concatenate(model.pieces)[:, 0]) == pytest.approx(apart + 0.055)

    def test_a_hollow_stays_one(self, load):
        inner = trimesh.creation.box((0.04, 0.02, 0.03))
        inner.invert()
        for whole in (False, True):
            mesh = trimesh.util.concatenate([BOX, inner])
            if whole:
                mesh.invert()
            model = load(mesh)
            assert model.mass_kg == pytest.approx(500 * (BOX.volume - 0.04 * 0.02 * 0.03))

    @pytest.mark.parametrize("stray", [(np.nan, 0, 0), (5, 5, 5)])
    def test_points_that_no_triangle_uses(self, tmp_path, cache, stray):
        """Beside a body, and beside a surface that walls are made of."""
        for name, faces in (("box", BOX.faces), ("open", BOX.faces[2:])):
            text = "".join("v {} {} {}\n".format(*v) for v in [stray, *BOX.vertices])
            text += "".join("f {} {} {}\n".format(*(face + 2)) for face in faces)
            (tmp_path / f"{name}.obj").write_text(text)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", MeshWarning)
                model = load_object(tmp_path / f"{name}.obj", unit="m", cache=cache)
            assert model.extents_m.max() < 0.07

    def test_faces_turned_every_way(self, load):
        faces = np.array(BALL.faces)
        faces[::3] = faces[::3, ::-1]
        with pytest.warns(MeshWarning, match="wrongly turned edges mended"):
            model = load(trimesh.Trimesh(BALL.vertices, faces, process=False))
        assert model.mass_kg == pytest.approx(BALL.volume * 500, rel=1e-6)

    def test_a_small_hole_is_filled(self, load):
        keep = np.ones(len(BALL.faces), bool)
        keep[BALL.vertex_faces[7][BALL.vertex_faces[7] >= 0]] = False
        with pytest.warns(MeshWarning, match=r"5 open .* mended"):
            model = load(without(BALL, keep))
        assert model.mass_kg == pytest.approx(BALL.volume * 500, rel=5e-3)

    def test_faces_doubled_and_without_area(self, load):
        faces = [*BOX.faces, BOX.faces[0], BOX.faces[3], BOX.faces[3, ::-1], [0, 0, 1]]
        model = load(trimesh.Trimesh(BOX.vertices, faces, process=False))
        assert model.mass_kg == pytest.approx(0.06)
        assert len(model.faces) == 12

    def test_dirt_beside_it_is_left_out(self, load):
        speck = trimesh.creation.icosphere(1, 0.001).apply_translation([0.3, 0, 0])
        with pytest.warns(MeshWarning, match="80 triangles of specks"):
            model = load(trimesh.util.concatenate([BOX, speck]))
        assert model.extents_m == pytest.approx((0.06, 0.04, 0.05))

    def test_hundreds_of_thousands_of_faces(self, load):
        ball = trimesh.creation.icosphere(7, 0.04)
        with pytest.warns(
            MeshWarning, match=r"327680 triangles simplified to \d+, moved by at most"
        ):
            model = load(ball)
        assert len(model.faces) <= 100_000
        distance = np.linalg.norm(model.vertices, axis=1)
        assert distance == pytest.approx(0.04, abs=0.001 * 0.08)

    def test_a_box_without_lid_becomes_walls(self, load):
        """Open as it is, its walls are given a thickness; the inside stays empty."""
        top = BOX.triangles_center[:, 2] > 0.024
        with pytest.warns(MeshWarning, match="drawn anew") as said:
            model = load(without(BOX, ~top), tolerance_m=0.003)
        assert all(issubclass(w.category, MeshWarning) for w in said)
        assert model.extents_m == pytest.approx((0.06, 0.04, 0.05), abs=0.0015)
        assert 0.05 * BOX.volume < model.mass_kg / 500 or model.mass_kg == 0.01
        assert len(model.pieces) >= 5
        middle = [np.abs(p).min(axis=0).max() for p in model.pieces]
        assert min(middle) > 0.005

    def test_a_surface_with_gaps_keeps_its_inside(self, monkeypatch):
        """Triangles that nearly meet enclose the body they are meant to."""
        monkeypatch.setattr(_mend, "_CELLS", 64)  # quicker
        center = BALL.triangles_center[:, None]
        shrunk = center + 0.97 * (BALL.triangles - center)
        found = mend(shrunk.reshape(-1, 3) / 0.08, np.arange(shrunk.size // 3).reshape(-1, 3))
        assert open_edges(found.vertices, found.faces) == 0
        body = trimesh.Trimesh(found.vertices, found.faces)
        assert body.volume == pytest.approx(BALL.volume / 0.08**3, rel=0.03)
        assert "drawn anew" in found.remarks[0]

    def test_a_sheet_drawn_from_both_sides_becomes_a_wall(self, monkeypatch):
        monkeypatch.setattr(_mend, "_CELLS", 64)  # quicker
        half = without(BALL, BALL.triangles_center[:, 2] < 0)
        faces = np.concatenate([half.faces, half.faces[:, ::-1]])
        found = mend(np.array(half.vertices) / 0.08, faces.astype(np.int32))
        body = trimesh.Trimesh(found.vertices, found.faces)
        wall = 2.4 / 64
        assert body.volume == pytest.approx(half.area / 0.08**2 * wall, rel=0.2)

    def test_a_lost_texture_is_said(self, tmp_path, cache):
        corners = BALL.vertices[BALL.faces[1:]].reshape(-1, 3)
        image = Image.new("RGB", (4, 4), (9, 9, 9))
        visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(corners), 2)), image=image)
        faces = np.arange(len(corners)).reshape(-1, 3)
        trimesh.Trimesh(corners, faces, visual=visual, process=False).export(tmp_path / "a.obj")
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", GraspmapWarning)
            assert load_object(tmp_path / "a.obj", unit="m", cache=cache).texture is None
        words = [str(w.message) for w in said]
        assert re.search("3 open .* mended", words[0])
        assert "texture does not fit" in words[1]


class TestRefused:
    def test_no_file(self, tmp_path):
        with pytest.raises(MissingFileError, match="no such file"):
            load_object(tmp_path / "none.obj")
        with pytest.raises(FileFormatError, match="folder"):
            load_object(tmp_path)

    @pytest.mark.parametrize(
        ("name", "content", "words"),
        [
            ("a.obj", b"", "the file is empty"),
            ("a.obj", b"this is a letter\nto a friend\n", "no triangle"),
            ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangle"),
            ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "cannot be read as .obj"),
            ("a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "1 of 3 vertices are NaN"),
            ("a.obj", b"v 1 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n", "1 of 3 vertices are NaN"),
            ("a.obj", b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "coincide"),
            ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n", "flat"),
            ("a.obj", b"v 0 0 0\nv 1 0 0\nv .5 0 0\nf 1 2 3\n", "flat"),
            ("a.obj", bytes(range(256)) * 3, "no triangle"),
            ("a.off", b"OFF\n\xff\n", "cannot be read as .off"),
            ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 9\n", "cannot be read as .ply"),
            ("a.stl", b"\0" * 200, "no triangle"),
            ("a.stl", bytes(range(256)) * 3, "cannot be read as .stl"),
            ("a.glb", b"glTF" + b"\0" * 40, "cannot be read as .glb"),
            ("a.off", b"OFF\n9 9 9\n1 2\n", "cannot be read as .off"),
            ("a.jpg", b"picture", "'.jpg' is no mesh format"),
            ("a", b"picture", "'no ending' is no mesh format"),
        ],
    )
    def test_files(self, load, name, content, words):
        with pytest.raises(FileFormatError, match=words) as caught:
            load(content, name)
        assert caught.value.path.name == name
        assert caught.value.remedy

    @pytest.mark.parametrize("suffix", [".stl", ".ply", ".glb"])
    @pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
    def test_truncated(self, load, tmp_path, suffix, share):
        BALL.export(tmp_path / f"whole{suffix}")
        content = (tmp_path / f"whole{suffix}").read_bytes()
        with pytest.raises(FileFormatError, match=f"cannot be read as {suffix}"):
            load(content[: int(share * len(content))], f"a{suffix}")

    def test_a_tangle_of_triangles(self, load):
        points = np.random.default_rng(0).uniform(-0.05, 0.05, (900, 3))
        with pytest.raises(FileFormatError, match=r"is no body.*tangle"):
            load(trimesh.Trimesh(points, np.arange(900).reshape(-1, 3), process=False))

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"unit": "feet"}, "m, cm, mm, inch"),
            ({"mass_kg": -1}, "mass_kg"),
            ({"mass_range_kg": (2, 1)}, "mass_range_kg"),
            ({"tolerance_m": 0}, "tolerance_m"),
            ({"id": "a/b"}, "object id"),
        ],
    )
    def test_arguments(self, load, options, words):
        with pytest.raises((InvalidInputError, UnknownNameError), match=words):
            load(BOX, **options)


class TestReal:
    """Meshes of others, read as their users would."""

    @pytest.mark.parametrize("name", ["G2", "C0"])
    def test_egad(self, data_dir, cache, name):
        gripper = load_gripper("franka")
        path = data_dir / "egad" / f"{name}.obj"
        model = load_object(path, fit_to=gripper, tolerance_m=0.004, cache=cache)
        box = trimesh.bounds.oriented_bounds(model.vertices, angle_digits=3)[1]
        allowed = np.array([0.8, 1]) * gripper.max_opening_m
        assert max(np.sort(box)[[0, 2]] / allowed) == pytest.approx(1, abs=0.02)
        hulls = sum(trimesh.convex.convex_hull(p).volume for p in model.pieces)
        volume = trimesh.Trimesh(model.vertices, model.faces).volume
        assert 0.9 * volume < hulls < 1.3 * volume

    def test_egad_is_in_millimetres(self, data_dir, cache):
        with pytest.warns(UnitWarning, match="taken for mm, so it is 0.07 m long"):
            load_object(data_dir / "egad" / "G2.obj", tolerance_m=0.004, cache=cache)

    def test_ycb(self, data_dir, cache):
        name = "013_apple"
        model = load_object(
            data_dir / "ycb" / name / "textured.obj", unit="m", tolerance_m=0.003, cache=cache
        )
        assert model.id == name
        assert model.texture.image.shape == (1024, 1024, 3)
        assert len(model.texture.uv) == len(model.vertices)
        assert len(model.pieces) < 10


def test_ids(tmp_path):
    assert default_id(tmp_path / "003_cracker_box" / "textured.obj") == "003_cracker_box"
    assert default_id(tmp_path / "a b" / "hammer (1).stl") == "hammer-1"
    assert default_id(tmp_path / "ä.stl") == "object"
