"""Procedural objects: each family is sound, true to its pieces, and the same for ever."""

from __future__ import annotations

import hashlib
import inspect
import os
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from manifold3d import Manifold, OpType
from scipy.spatial import ConvexHull

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.gripper import load_gripper, profile_names
from graspmap.simulation.procedural import FAMILIES, ObjectRanges, blobs, make_object
from graspmap.simulation.procedural.draw import Draw
from graspmap.simulation.procedural.make import _choose, _sound
from graspmap.simulation.procedural.solid import Solid, hull

SHAPES = [(family, shape) for family, entry in FAMILIES.items() for shape in entry.shapes]
RANGES = ObjectRanges()
SMALL = ObjectRanges(longest_m=(0.025, 0.2), width_m=(0.005, 0.088), wall_m=(0.002, 0.005))


def digest(model):
    parts = (model.vertices, model.faces, *model.pieces, model.inertia, np.array(model.mass_kg))
    return hashlib.sha256(b"".join(p.tobytes() for p in parts)).hexdigest()


def check(model, ranges):
    mesh = trimesh.Trimesh(model.vertices, model.faces)
    assert mesh.is_watertight, model.id
    assert mesh.is_winding_consistent, model.id
    assert mesh.body_count == 1, model.id
    assert mesh.volume > 0, model.id
    assert mesh.center_mass == pytest.approx(np.zeros(3), abs=1e-6), model.id
    assert model.vertices.dtype == np.float64
    low, high = ranges.longest_m
    assert low - 1e-6 <= model.extents_m.max() <= high + 1e-6, model.id
    assert ranges.mass_kg[0] - 1e-9 <= model.mass_kg <= ranges.mass_kg[1] + 1e-9
    assert max(map(len, model.pieces)) <= 128, model.id
    for piece in model.pieces:
        assert ConvexHull(piece).volume > 0, model.id
    # Volume of the union of the hulls: a boolean, which the construction of none of them uses.
    together = Manifold.batch_boolean([Manifold.hull_points(p) for p in model.pieces], OpType.Add)
    assert together.volume() == pytest.approx(mesh.volume, rel=0.08), model.id


@pytest.mark.parametrize("family", [f for f in FAMILIES if f != "blob"])
def test_every_shape_is_sound(family):
    for number, shape in enumerate(FAMILIES[family].shapes):
        ranges = (RANGES, SMALL)[number % 2]
        check(make_object(41, 7, ranges=ranges, families=(shape,)), ranges)


@pytest.mark.parametrize("shape", ["pebble", "knot"])
def test_blobs_are_sound(shape):
    check(make_object(41, 7, families=(shape,)), RANGES)


def winding(points, triangles):
    """(N,) turns of the surface round each point: 1 inside, 0 outside (van Oosterom, Strackee)."""
    a, b, c = (triangles[None, :, i] - points[:, None] for i in range(3))
    x, y, z = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    top = (a * np.cross(b, c)).sum(-1)
    bottom = x * y * z + (a * b).sum(-1) * z + (b * c).sum(-1) * x + (c * a).sum(-1) * y
    return np.arctan2(top, bottom).sum(axis=1) / (2 * np.pi)


def distance(points, triangles):
    """(N,) to the nearest triangle: its plane where the foot lies inside, else its edges."""
    a, b, c = (triangles[None, :, i] for i in range(3))
    p = points[:, None]
    normal = np.cross(b - a, c - a)
    square = np.maximum((normal**2).sum(-1), 1e-30)
    first = (np.cross(b - a, p - a) * normal).sum(-1) / square
    second = (np.cross(p - a, c - a) * normal).sum(-1) / square
    inside = (first >= 0) & (second >= 0) & (first + second <= 1)
    best = np.where(inside, ((p - a) * normal).sum(-1) ** 2 / square, np.inf)
    for start, stop in ((a, b), (b, c), (c, a)):
        way = stop - start
        length = np.maximum((way**2).sum(-1), 1e-30)
        share = np.clip(((p - start) * way).sum(-1) / length, 0, 1)
        best = np.minimum(best, ((start + share[..., None] * way - p) ** 2).sum(-1))
    return np.sqrt(best.min(axis=1))


def samples(vertices, faces, count, rng):
    corners = vertices[faces]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    return (corners[chosen] * rng.dirichlet((1, 1, 1), count)[..., None]).sum(axis=1)


def deviations(model, count):
    """How far hulls stand out of the surface, and the surface out of the hulls, at most."""
    rng = np.random.default_rng(0)
    triangles = model.vertices[model.faces]
    each = max(3, count // len(model.pieces))
    on_hulls = np.concatenate([samples(*hull(p), each, rng) for p in model.pieces])
    out = on_hulls[winding(on_hulls, triangles) < 0.5]
    on_surface = samples(model.vertices, model.faces, 2 * count, rng)
    short = np.full(len(on_surface), np.inf)
    for piece in model.pieces:
        planes = ConvexHull(piece).equations
        short = np.minimum(short, (on_surface @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return distance(out, triangles).max(initial=0), short.max()


@pytest.mark.parametrize(
    "shape",
    ["mug", "bowl", "bottle", "vase", "torus", "link", "gutter", "wrench", "scissors", "hammer",
     "sphere", "superellipsoid", "figure", "teapot", "tube"],
)  # fmt: skip
def test_hulls_follow_the_surface(shape):
    out, short = deviations(make_object(8, 3, families=(shape,)), 150)
    assert out < 0.0006
    assert short < 0.0006


def test_a_field_without_a_body_is_drawn_again():
    """The first noise of this object is nowhere thicker than a film."""
    found = make_object(1005, 70, families=["pebble", "lump", "knot"])
    assert found.id == "pebble-000070"
    assert len(found.faces) > 100


def test_hulls_of_a_blob_follow_the_surface():
    model = make_object(8, 3, families=("lump",))
    check(model, RANGES)
    out, short = deviations(model, 150)
    assert out < 0.025 * model.extents_m.max()
    assert short < 0.025 * model.extents_m.max()


class TestIdentity:
    def test_same_number_same_bytes_whatever_was_made_before(self):
        first = [make_object(3, i, families=("handled",)) for i in range(4)]
        again = [make_object(3, i, families=("handled",)) for i in (2, 0, 3, 1)]
        assert [digest(m) for m in first] == [digest(again[i]) for i in (1, 3, 0, 2)]
        assert [m.id for m in first] == [again[i].id for i in (1, 3, 0, 2)]

    def test_same_bytes_in_another_process(self, tmp_path):
        names = ["mug", "wrench", "joined", "lump"]
        code = (
            "import hashlib, numpy as np\n"
            "from graspmap.simulation.procedural import make_object\n"
            f"{inspect.getsource(digest)}\n"
            f"for name in {names}: print(digest(make_object(5, 11, families=(name,))))"
        )
        env = os.environ | {
            "PYTHONHASHSEED": "3",
            "OMP_NUM_THREADS": "1",
            "GRASPMAP_CACHE": str(tmp_path),  # nothing that was made before
        }
        done = subprocess.run(
            [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
        )
        assert done.stdout.split() == [digest(make_object(5, 11, families=(n,))) for n in names]

    def test_pieces_of_a_blob_are_kept(self, tmp_path, monkeypatch):
        monkeypatch.setenv("GRASPMAP_CACHE", str(tmp_path))
        first = digest(make_object(5, 12, families=("pebble",)))
        (file,) = tmp_path.rglob("*.npz")
        with monkeypatch.context() as patch:
            patch.setattr(blobs, "pieces_by_cuts", lambda *_: pytest.fail("computed again"))
            assert digest(make_object(5, 12, families=("pebble",))) == first
        file.write_bytes(b"PK")
        assert digest(make_object(5, 12, families=("pebble",))) == first

    def test_ids_are_unique_and_fit_for_files(self):
        ids = [make_object(1, i, families=("extrusion",)).id for i in range(25)]
        assert len(set(ids)) == 25
        for index, name in enumerate(ids):
            assert re.fullmatch(r"[a-z0-9-]+-\d{6}", name)
            assert name.endswith(f"-{index:06d}")

    def test_other_numbers_other_objects(self):
        made = {digest(make_object(s, i, families=("box",))) for s in (0, 1) for i in (0, 1)}
        assert len(made) == 4

    def test_numbers_of_numpy_are_numbers(self):
        assert digest(make_object(np.int64(2), np.uint8(3), families=("key",))) == digest(
            make_object(2, 3, families=("key",))
        )

    def test_names_of_shapes_and_families_are_distinct(self):
        names = [*FAMILIES, *(shape for _, shape in SHAPES)]
        assert len(set(names)) == len(names)

    def test_the_mixture_has_the_shares_that_it_says(self):
        counts = dict.fromkeys(FAMILIES, 0)
        home = {shape: family for family, shape in SHAPES}
        for i in range(3000):
            name, _ = _choose(Draw(np.random.default_rng((0, i)), RANGES), None)
            counts[home[name]] += 1
        total = sum(f.weight for f in FAMILIES.values())
        for family, entry in FAMILIES.items():
            assert counts[family] / 3000 == pytest.approx(entry.weight / total, abs=0.025)


class TestMixture:
    def test_most_can_be_held_and_some_cannot(self):
        gripper = load_gripper("franka")
        ranges = ObjectRanges.for_gripper(gripper)
        models = [
            make_object(2, i, ranges=ranges, families=(f,))
            for f in ("primitive", "extrusion", "composition")
            for i in range(20)
        ]
        narrowest = np.array([m.extents_m.min() for m in models])
        share = (narrowest < gripper.max_opening_m).mean()
        assert 0.85 < share <= 1
        widest = np.array([np.median(m.extents_m) for m in models])
        assert (widest > gripper.max_opening_m).mean() > 0.05

    @pytest.mark.parametrize("shape", ["open-box", "tube", "mug", "square-tube", "plate"])
    def test_walls_are_as_thick_as_asked(self, shape):
        from studies._rays import RayCaster

        for index in range(3):
            model = make_object(6, index, families=(shape,))
            corners = model.vertices[model.faces]
            normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            areas = np.linalg.norm(normals, axis=1)
            rng = np.random.default_rng(0)
            chosen = rng.choice(len(areas), 300, p=areas / areas.sum())
            points = (corners[chosen] * rng.dirichlet((1, 1, 1), 300)[..., None]).sum(axis=1)
            inward = -normals[chosen] / areas[chosen, None]
            rays = RayCaster(corners)
            start = points + 1e-6 * inward
            hit = rays.first_hit(start, inward)
            through = rays.distances(start, inward, hit)[hit >= 0]
            assert np.percentile(through, 10) > 0.85 * RANGES.wall_m[0]

    def test_mass_is_volume_times_a_density_in_the_range(self):
        ranges = ObjectRanges(mass_kg=(0.001, 50.0), density_kg_m3=(400.0, 800.0))
        for index in range(5):
            model = make_object(0, index, ranges=ranges, families=("box",))
            density = model.mass_kg / ConvexHull(model.vertices).volume
            assert 399 < density < 801
            assert (np.linalg.eigvalsh(model.inertia) > 0).all()


class TestRanges:
    @pytest.mark.parametrize("name", profile_names())
    def test_every_shipped_gripper_has_objects(self, name):
        gripper = load_gripper(name)
        ranges = ObjectRanges.for_gripper(gripper)
        assert ranges.width_m[0] < gripper.max_opening_m < ranges.width_m[1]
        assert ranges.longest_m[1] > gripper.max_opening_m
        check(make_object(0, 0, ranges=ranges, families=("composition",)), ranges)

    @pytest.mark.parametrize(("least", "greatest"), [(0.011, 0.08), (0.03, 0.074)])
    def test_a_gripper_that_does_not_close(self, least, greatest):
        """The WidowX-250 is one: 30 to 74 mm."""
        gripper = replace(
            load_gripper("franka"), min_opening_m=least, max_opening_m=greatest,
        )  # fmt: skip
        ranges = ObjectRanges.for_gripper(gripper)
        assert ranges.width_m[0] > least
        check(make_object(0, 0, ranges=ranges, families=("composition",)), ranges)
        with pytest.raises(InvalidInputError, match="2\\.2 times the least one"):
            ObjectRanges.for_gripper(replace(gripper, min_opening_m=0.6 * greatest))

    def test_the_defaults_are_those_of_jacquards_gripper(self):
        ranges = ObjectRanges.for_gripper(load_gripper("jacquard"))
        assert ranges.longest_m == pytest.approx(RANGES.longest_m, abs=0.003)
        assert ranges.width_m == pytest.approx(RANGES.width_m)

    @pytest.mark.parametrize(
        "wrong",
        [
            {"longest_m": (0.3, 0.1)},
            {"longest_m": (0.05, 50)},
            {"longest_m": (np.nan, 0.1)},
            {"width_m": (0.0, 0.1)},
            {"width_m": (0.04, 0.1)},
            {"wall_m": (0.0001, 0.002)},
            {"wall_m": (0.002, 0.02)},
            {"aspect": (0.5, 2)},
            {"density_kg_m3": (-1, 5)},
            {"mass_kg": (0.1, np.inf)},
            {"mass_kg": 0.1},
            {"mass_kg": ("light", "heavy")},
        ],
    )
    def test_refuses(self, wrong):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            ObjectRanges(**wrong)

    @given(st.floats(0.001, 0.9), st.floats(1, 1.1))
    def test_draws_stay_in_their_ranges(self, share, factor):
        draw = Draw(np.random.default_rng(int(share * 1e6)), RANGES)
        assert RANGES.longest_m[0] <= draw.longest(share) <= RANGES.longest_m[1]
        assert RANGES.width_m[0] <= draw.width(share / 9, share) <= RANGES.width_m[1]
        assert draw.wall(share) >= RANGES.wall_m[0]
        low, high = sorted((share, share * factor))
        assert low <= draw.uniform(low, high) <= high
        middle, least = draw.sides()
        assert 1 / RANGES.aspect[1] <= least <= middle <= 1


@pytest.mark.parametrize(("seed", "index"), [(-1, 0), (0, -1), (0.5, 0), (0, None), (True, 0)])
def test_refuses_numbers(seed, index):
    with pytest.raises(InvalidInputError, match="whole number"):
        make_object(seed, index)


def test_refuses_an_unknown_family():
    with pytest.raises(UnknownNameError, match="did you mean 'mug'"):
        make_object(0, 0, families=("mugg",))


def test_unsound_solids_are_seen():
    vertices, faces = hull(np.random.default_rng(0).normal(size=(30, 3)))
    whole = Solid(vertices, faces, (vertices,))
    assert _sound(whole)
    assert not _sound(Solid(vertices, faces[1:], (vertices,)))
    assert not _sound(Solid(vertices, faces[:, ::-1], (vertices,)))
    two = np.concatenate([vertices, vertices + 10])
    assert not _sound(Solid(two, np.concatenate([faces, faces + len(vertices)]), (two,)))
