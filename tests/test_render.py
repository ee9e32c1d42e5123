"""Rendering: closed forms, rays in double precision as the oracle, and what a picture must show."""

from __future__ import annotations

import hashlib
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.geometry import Camera, RigidTransform
from graspmap.simulation.objects import ObjectModel, Texture
from graspmap.simulation.render import (
    Randomisation,
    View,
    jacquard_view,
    plain_appearance,
    render,
    sample_appearance,
    sample_view,
)
from graspmap.simulation.render.appearance import Appearance, Film, Light, ObjectLook, TableLook
from graspmap.simulation.tabletop import PlacedObject, Tabletop
from studies._rays import RayCaster

BOX_FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ],
    np.int32,
)
CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
UPRIGHT = np.eye(3)


def about(axis, degrees):
    """Rotation about a coordinate axis."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    out = np.eye(3)
    out[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return out


def mesh(vertices, faces, name="object", texture=None):
    return ObjectModel(
        name, np.array(vertices, float), np.array(faces, np.int32), (), 0.1, np.eye(3), texture
    )


def box(*sides, name="box"):
    return mesh(CUBE * sides, BOX_FACES, name)


def ball(radius, steps=48):
    """A ball of `steps` rings, each point exactly on the sphere."""
    polar = np.linspace(0, np.pi, steps + 1)[1:-1]
    around = np.arange(2 * steps) * np.pi / steps
    p, a = np.meshgrid(polar, around, indexing="ij")
    rings = np.stack([np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)], -1).reshape(-1, 3)
    vertices = radius * np.concatenate([rings, [(0, 0, 1), (0, 0, -1)]])
    n, top, faces = 2 * steps, len(vertices) - 2, []
    for k in range(n):
        after = (k + 1) % n
        faces += [(top, k, after), (top + 1, (steps - 2) * n + after, (steps - 2) * n + k)]
        for r in range(steps - 2):
            a, b, c, d = r * n + k, r * n + after, (r + 1) * n + k, (r + 1) * n + after
            faces += [(a, c, d), (a, d, b)]
    return mesh(vertices, faces, "ball")


def at(model, x=0.0, y=0.0, rotation=UPRIGHT, lift=0.0):
    """A model on the table."""
    low = (model.vertices @ np.asarray(rotation).T)[:, 2].min()
    return PlacedObject(model, RigidTransform(rotation, [x, y, lift - low]))


def table(*placed):
    return Tabletop(placed, None)


def plain(tabletop, **light):
    looks = tuple(ObjectLook(colours=((0.6, 0.2, 0.1),) * 3) for _ in tabletop.objects)
    return Appearance(objects=looks, light=Light(**light))


def world_points(view, depth):
    camera = view.camera
    y, x = np.mgrid[: camera.height, : camera.width]
    return view.T_world_camera.apply(camera.deproject(np.stack([x, y], -1), depth))


def ground_depth(view):
    """Depth of the bare table by its equation."""
    camera, pose = view.camera, view.T_world_camera
    y, x = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(x.shape)], 2)
    return -pose.translation[2] / (rays @ pose.rotation[2])


class TestDepth:
    def test_bare_table_is_as_jacquards(self):
        view = jacquard_view(1024)
        small = jacquard_view(96)
        depth = render(table(), small, Appearance(objects=())).depth
        assert depth == pytest.approx(ground_depth(small), abs=1e-6)
        assert ground_depth(view).min() == pytest.approx(1.432, abs=0.001)
        assert ground_depth(view).max() == pytest.approx(1.574, abs=0.001)
        assert depth[0].mean() > depth[-1].mean()

    def test_top_of_a_box_lies_in_its_plane(self):
        view, tabletop = jacquard_view(128), table(at(box(0.2, 0.15, 0.08), 0.01, -0.02))
        picture = render(tabletop, view, plain(tabletop))
        points = world_points(view, picture.depth)
        top = picture.mask & (picture.normals[..., 2] > 0.999)
        assert top.sum() > 500
        assert points[top][:, 2] == pytest.approx(0.08, abs=1e-6)
        side = picture.mask & (picture.normals[..., 1] < -0.999)
        assert side.sum() > 20
        assert points[side][:, 1] == pytest.approx(-0.02 - 0.075, abs=1e-6)

    def test_tilted_plane(self):
        view = jacquard_view(96)
        turn = about("z", 40) @ about("x", 25)
        tabletop = table(at(box(0.25, 0.25, 0.05), rotation=turn))
        picture = render(tabletop, view, plain(tabletop))
        normal, placed = turn[:, 2], tabletop.objects[0].T_world_object
        on_top = picture.mask & (picture.normals @ normal > 0.9999)
        assert on_top.sum() > 300
        away = (world_points(view, picture.depth)[on_top] - placed.translation) @ normal
        assert away == pytest.approx(0.025, abs=1e-6)

    def test_ball_against_the_quadratic_equation(self):
        view, radius, steps = jacquard_view(128), 0.1, 96
        tabletop = table(at(ball(radius, steps), 0.03, 0.02))
        picture = render(tabletop, view, plain(tabletop))
        center = tabletop.objects[0].T_world_object.translation
        away = np.linalg.norm(world_points(view, picture.depth)[picture.mask] - center, axis=1)
        # A facet lies within the sphere by at most its sagitta.
        sagitta = radius * (1 - math.cos(math.pi / steps / math.sqrt(2)) ** 2)
        assert away.max() <= radius + 1e-6
        assert away.min() >= radius - sagitta - 1e-6
        camera, origin = view.camera, view.T_world_camera.translation
        y, x = np.nonzero(picture.mask)
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(len(x))])
        rays = view.T_world_camera.rotation @ rays
        a, b = (rays**2).sum(0), rays.T @ (origin - center)
        c = ((origin - center) ** 2).sum() - radius**2
        # Near the silhouette a facet's depth says little.
        inside = b**2 - a * c > (0.2 * radius) ** 2 * a
        exact = (-b - np.sqrt(np.maximum(b**2 - a * c, 0))) / a
        found = picture.depth[y, x]
        assert inside.mean() > 0.95
        assert found[inside] == pytest.approx(exact[inside], abs=30 * sagitta)
        assert np.median(found - exact) < 2 * sagitta

    @given(st.integers(0, 2**32))
    @settings(max_examples=15)
    def test_any_triangles_against_rays_in_double_precision(self, seed):
        rng = np.random.default_rng(seed)
        count, view = 40, jacquard_view(24)
        corners = rng.uniform(-0.3, 0.3, (count, 1, 3)) + rng.uniform(-0.1, 0.1, (count, 3, 3))
        model = mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
        tabletop = table(PlacedObject(model, RigidTransform(np.eye(3), [0, 0, 0.2])))
        picture = render(tabletop, view, plain(tabletop))
        y, x = np.mgrid[:24, :24]
        camera = view.camera
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, x * 0 + 1.0], -1)
        directions = rays.reshape(-1, 3) @ view.T_world_camera.rotation.T
        origins = np.broadcast_to(view.T_world_camera.translation, directions.shape)
        corners[..., 2] += 0.2
        best = ground_depth(view).ravel()
        near_edge = np.zeros(len(best), bool)
        for a, b, c in corners:
            normal = np.cross(b - a, c - a)
            t = ((a - origins) @ normal) / (directions @ normal)
            p = origins + t[:, None] * directions
            inner = [
                np.cross(q - o, p - o) @ normal / (normal @ normal)
                for o, q in ((a, b), (b, c), (c, a))
            ]
            least = np.min(inner, axis=0)
            near_edge |= np.abs(least) < 1e-9
            best = np.where((least > 0) & (t > 0) & (t < best), t, best)
        found = picture.depth.ravel().astype(float)
        assert found[~near_edge] == pytest.approx(best[~near_edge], abs=1e-6)

    def test_agrees_with_the_ray_caster(self):
        view = jacquard_view(96)
        tabletop = table(
            at(ball(0.05), 0.1, 0.05),
            at(box(0.1, 0.05, 0.12), -0.1, 0.0, about("z", 30)),
            at(ball(0.03), -0.1, 0.0, lift=0.12),
        )
        picture = render(tabletop, view, plain(tabletop))
        triangles = np.concatenate([placed.triangles() for placed in tabletop.objects])
        owner = np.repeat(range(3), [len(p.model.faces) for p in tabletop.objects])
        camera, pose = view.camera, view.T_world_camera
        y, x = np.mgrid[:96, :96]
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, x * 0 + 1.0], -1)
        directions = rays.reshape(-1, 3) @ pose.rotation.T
        origins = np.broadcast_to(pose.translation, directions.shape)
        caster = RayCaster(triangles)
        hit = caster.first_hit(origins, directions)
        distance = caster.distances(origins, directions, hit)
        instance = np.where(hit >= 0, owner[hit], -1)
        same = instance == picture.instance.ravel()
        assert same.mean() > 0.9995  # single precision may decide otherwise at a silhouette
        seen = same & (hit >= 0)
        assert picture.depth.ravel()[seen] == pytest.approx(distance[seen], abs=1e-5)
        assert np.median(np.abs(picture.depth.ravel()[seen] - distance[seen])) < 1e-7

    def test_past_the_horizon_there_is_none(self):
        look_up = RigidTransform(about("x", -85), [0, 0, 0.5])
        view = View(Camera.from_field_of_view(1.0, 64, 64), look_up)
        picture = render(table(), view, Appearance(objects=()))
        assert np.isnan(picture.depth[:20]).all()
        assert np.isfinite(picture.depth[-10:]).all()
        assert np.isnan(picture.normals[:20]).all()
        assert not picture.mask.any()

    def test_an_open_surface_is_seen_from_both_sides(self):
        view = jacquard_view(64)
        for faces in ([(0, 1, 2)], [(0, 2, 1)]):
            model = mesh([(-0.1, -0.1, 0.0), (0.1, -0.1, 0.0), (0.0, 0.15, 0.0)], faces)
            tabletop = table(at(model, lift=0.05))
            picture = render(tabletop, view, plain(tabletop))
            assert picture.mask.sum() > 50
            assert (picture.normals[picture.mask][:, 2] > 0.999).all()


class TestChannels:
    def scene(self):
        tabletop = table(
            at(ball(0.05), 0.12, 0.05),
            at(box(0.1, 0.05, 0.12), -0.1, 0.0, about("z", 30)),
            at(box(0.3, 0.02, 0.01), 0.0, -0.15),
        )
        view = sample_view(Randomisation(), np.random.default_rng(5), 128)
        return tabletop, view, render(tabletop, view, plain(tabletop))

    def test_types_and_shapes(self):
        _, _, picture = self.scene()
        assert (picture.rgb.shape, picture.rgb.dtype) == ((128, 128, 3), np.uint8)
        assert (picture.depth.shape, picture.depth.dtype) == ((128, 128), np.float32)
        assert (picture.mask.shape, picture.mask.dtype) == ((128, 128), np.bool_)
        assert (picture.normals.shape, picture.normals.dtype) == ((128, 128, 3), np.float32)
        assert (picture.instance.shape, picture.instance.dtype) == ((128, 128), np.int16)

    def test_mask_is_what_stands_above_the_table(self):
        _, view, picture = self.scene()
        height = world_points(view, picture.depth)[..., 2]
        assert np.abs(height[~picture.mask]).max() < 1e-6
        assert height[picture.mask].min() > -1e-6
        assert (height > 1e-6)[picture.mask].mean() > 0.999
        assert np.array_equal(picture.mask, picture.instance >= 0)

    def test_normals_are_unit_and_face_the_camera(self):
        _, view, picture = self.scene()
        normals = picture.normals.astype(float)
        assert np.linalg.norm(normals, axis=-1) == pytest.approx(1.0, abs=1e-6)
        towards = view.T_world_camera.translation - world_points(view, picture.depth)
        assert ((normals * towards).sum(axis=-1) > 0).all()
        assert (normals[~picture.mask] == (0, 0, 1)).all()

    def test_normals_of_a_ball_point_away_from_its_centre(self):
        tabletop, view, picture = self.scene()
        seen = picture.instance == 0
        radial = (
            world_points(view, picture.depth) - tabletop.objects[0].T_world_object.translation
        )[seen]
        radial /= np.linalg.norm(radial, axis=1, keepdims=True)
        cosine = (radial * picture.normals[seen]).sum(axis=1)
        assert np.degrees(np.arccos(np.minimum(np.median(cosine), 1))) < 0.5
        assert cosine.min() > 0.98

    def test_numbers_of_the_objects(self):
        tabletop, view, picture = self.scene()
        for number, placed in enumerate(tabletop.objects):
            top = placed.T_world_object.translation.copy()
            top[2] = placed.triangles()[..., 2].max()
            x, y = view.camera.project(view.T_world_camera.inverse().apply(top))
            assert picture.instance[round(y), round(x)] == number
        assert set(np.unique(picture.instance)) == {-1, 0, 1, 2}


class TestColour:
    def shadow(self, tabletop, view, **light):
        """(H, W) how much darker the table is for the objects' being there."""
        look = plain(tabletop, **light)
        with_object = render(tabletop, view, look)
        bare = render(table(), view, look.model_copy(update={"objects": ()}))
        darker = bare.rgb.astype(int).sum(-1) - with_object.rgb.astype(int).sum(-1)
        return np.where(with_object.mask, 0, darker)

    @pytest.mark.parametrize(("x", "y"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
    def test_shadow_falls_away_from_the_lamp(self, x, y):
        view, tabletop = jacquard_view(96), table(at(ball(0.05)))
        darker = self.shadow(tabletop, view, position_m=(0.9 * x, 0.9 * y, 1.2))
        rows, columns = np.nonzero(darker > 60)
        assert len(rows) > 20
        middle = world_points(view, ground_depth(view).astype(np.float32))[rows, columns].mean(0)
        assert middle[0] * x + middle[1] * y < -0.03
        assert abs(middle[0] * y) + abs(middle[1] * x) < 0.02

    def test_shadow_of_a_point_ends_where_geometry_says(self):
        view, tabletop = jacquard_view(256), table(at(box(0.1, 0.1, 0.1)))
        lamp = np.array([-1.0, 0.0, 1.0])
        darker = self.shadow(tabletop, view, position_m=tuple(lamp), radius_m=0.0, samples=1)
        ground = world_points(view, ground_depth(view).astype(np.float32))
        row = int(np.abs(ground[:, 128, 1]).argmin())
        dark = ground[row, darker[row] > 60, 0]
        # The upper edge at x = 0.05, z = 0.1 falls along the ray from the lamp.
        expected = 0.05 + (0.05 - lamp[0]) * 0.1 / (lamp[2] - 0.1)
        assert dark.max() == pytest.approx(expected, abs=0.004)

    def test_a_larger_lamp_has_a_softer_shadow(self):
        view, tabletop = jacquard_view(128), table(at(box(0.1, 0.1, 0.1)))
        between = []
        for radius in (0.0, 0.1, 0.3):
            darker = self.shadow(tabletop, view, position_m=(-0.9, 0.0, 1.1), radius_m=radius)
            dark = np.percentile(darker[darker > 0], 95)
            between.append(((darker > 0.3 * dark) & (darker < 0.8 * dark)).sum())
        assert between[0] < between[1] < between[2]

    def test_the_lit_side_is_brighter(self):
        view, tabletop = jacquard_view(96), table(at(ball(0.1)))
        picture = render(tabletop, view, plain(tabletop, position_m=(1.2, 0.0, 0.8)))
        columns = np.nonzero(picture.mask)[1]
        light = picture.rgb.astype(int).sum(-1)
        middle = int(np.median(columns))
        right = picture.mask & (np.arange(96) > middle + 4)
        left = picture.mask & (np.arange(96) < middle - 4)
        assert light[right].mean() > 1.3 * light[left].mean()

    def test_own_picture_lies_where_uv_says(self):
        image = (
            np.array([[(255, 0, 0), (0, 255, 0)], [(0, 0, 255), (255, 255, 255)]], np.uint8)
            .repeat(16, 0)
            .repeat(16, 1)
        )
        corners = np.array([(-0.1, -0.1, 0), (0.1, -0.1, 0), (0.1, 0.1, 0), (-0.1, 0.1, 0)])
        uv = np.array([(0, 0), (1, 0), (1, 1), (0, 1.0)])
        model = mesh(corners, [(0, 1, 2), (0, 2, 3)], texture=Texture(image, uv))
        view = jacquard_view(96)
        for turn, order in ((UPRIGHT, (0, 1, 2, 3)), (about("z", 180), (3, 2, 1, 0))):
            tabletop = table(at(model, rotation=turn, lift=0.01))
            look = ObjectLook(pattern="picture")
            picture = render(tabletop, view, Appearance(objects=(look,)))
            found = []
            for x, y in ((-0.05, 0.05), (0.05, 0.05), (-0.05, -0.05), (0.05, -0.05)):
                pixel = view.camera.project(view.T_world_camera.inverse().apply([x, y, 0.01]))
                found.append(picture.rgb[round(pixel[1]), round(pixel[0])].astype(int))
            named = [found[k] for k in order]  # upper left, upper right, lower left, lower right
            assert named[0][0] > 150 > 2 * named[0][1:].max()
            assert named[1][1] > 150 > 2 * named[1][[0, 2]].max()
            assert named[2][2] > 150 > 2 * named[2][:2].max()
            assert named[3].min() > 150

    def test_a_pattern_turns_with_its_object(self):
        view = View(
            Camera.from_field_of_view(0.5, 97, 97),
            RigidTransform(np.diag([1.0, -1.0, -1.0]), [0, 0, 1.0]),
        )
        look = ObjectLook(
            pattern="checker", colours=((0.9, 0.9, 0.9), (0.02, 0.02, 0.02), (0, 0, 0))
        )
        overhead = Light(position_m=(0.0, 0.0, 3.0), radius_m=0.0)
        pictures = []
        for degrees in (0, 90):
            tabletop = table(at(box(0.2, 0.2, 0.02), rotation=about("z", degrees)))
            appearance = Appearance(objects=(look,), light=overhead)
            pictures.append(render(tabletop, view, appearance).rgb.astype(int))
        assert np.median(np.abs(np.rot90(pictures[0]) - pictures[1])) <= 1
        assert np.abs(pictures[0] - pictures[1]).mean() > 5

    @pytest.mark.parametrize("kind", ["metal", "glass"])
    def test_materials_change_colour_alone(self, kind):
        tabletop, view = table(at(ball(0.06))), jacquard_view(64)
        dull = plain(tabletop)
        finish = {"metal": {"metal": 1.0, "roughness": 0.2}, "glass": {"glass": 0.9}}[kind]
        look = dull.objects[0].model_copy(
            update={"finish": dull.objects[0].finish.model_copy(update=finish)}
        )
        first = render(tabletop, view, dull)
        second = render(tabletop, view, dull.model_copy(update={"objects": (look,)}))
        assert np.array_equal(first.depth, second.depth)
        assert np.array_equal(first.mask, second.mask)
        assert np.abs(first.rgb.astype(int) - second.rgb)[first.mask].mean() > 10

    def test_smooth_edges_leave_the_inside_alone(self):
        tabletop, view = table(at(box(0.2, 0.15, 0.08), rotation=about("z", 20))), jacquard_view(64)
        look = Appearance(
            objects=(ObjectLook(colours=((0.9, 0.9, 0.9),) * 3),),
            table=TableLook(colours=((0.02, 0.02, 0.02),) * 3),
            light=Light(radius_m=0.0, key=(0.0, 0.0, 0.0), ambient=(1.0, 1.0, 1.0)),
        )
        picture = render(tabletop, view, look)
        bright = picture.rgb[..., 1].astype(int)
        top = picture.mask & (picture.normals[..., 2] > 0.999)
        levels = np.unique(bright)
        assert (
            (levels > bright[~picture.mask].min() + 30) & (levels < bright[top].max() - 30)
        ).any()


class TestSameBytes:
    def digest(self, picture):
        return [hashlib.sha256(array.tobytes()).hexdigest() for array in vars(picture).values()]

    def test_twice(self):
        tabletop = table(at(ball(0.05), 0.1), at(box(0.1, 0.05, 0.1), -0.1))
        digests = []
        for _ in range(2):
            rng = np.random.default_rng(8)
            view = sample_view(Randomisation(), rng, 64)
            appearance = sample_appearance(tabletop, Randomisation(), rng)
            digests.append(self.digest(render(tabletop, view, appearance)))
        assert digests[0] == digests[1]

    def test_from_the_record_of_the_appearance(self):
        tabletop, view = table(at(ball(0.05))), jacquard_view(64)
        appearance = sample_appearance(tabletop, Randomisation(), np.random.default_rng(2))
        record = json.loads(json.dumps(appearance.model_dump()))
        again = Appearance.model_validate(record)
        assert self.digest(render(tabletop, view, appearance)) == self.digest(
            render(tabletop, view, again)
        )

    @pytest.mark.slow
    @pytest.mark.skipif(
        "GRASPMAP_SLOW_TESTS" not in os.environ,
        reason="compiles everything again; set GRASPMAP_SLOW_TESTS=1 to run it",
    )
    def test_on_a_processor_without_wide_registers(self, tmp_path):
        program = (
            "import hashlib, sys; sys.path.insert(0, sys.argv[1]); import test_render as t\n"
            "import numpy as np\n"
            "scene = t.table(t.at(t.ball(0.05, 16), 0.1), t.at(t.box(0.1, 0.05, 0.1), -0.1))\n"
            "rng = np.random.default_rng(3)\n"
            "view = t.sample_view(t.Randomisation(), rng, 96)\n"
            "look = t.sample_appearance(scene, t.Randomisation(), rng)\n"
            "print(t.TestSameBytes().digest(t.render(scene, view, look)))\n"
        )
        plain_processor = {
            "NUMBA_CPU_NAME": "generic",
            "NUMBA_CPU_FEATURES": "",
            "NUMBA_CACHE_DIR": str(tmp_path),
            "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX2 FMA3",
            "OPENBLAS_CORETYPE": "Prescott",
            "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
        }
        here = str(Path(__file__).parent)
        outputs = [
            subprocess.run(
                [sys.executable, "-c", program, here],
                env=os.environ | more,
                capture_output=True,
                text=True,
                check=True,
            ).stdout
            for more in ({}, plain_processor)
        ]
        assert outputs[0] == outputs[1]


class TestFilm:
    def test_noise_and_vignette(self):
        view = jacquard_view(96)
        look = Appearance(objects=(), table=TableLook(colours=((0.4, 0.4, 0.4),) * 3))
        clean = render(table(), view, look).rgb.astype(int)
        noisy = render(table(), view, look.model_copy(update={"film": Film(read=0.02, seed=4)}))
        error = noisy.rgb.astype(int) - clean
        assert error.std() == pytest.approx(0.02 * 255, rel=0.05)
        assert abs(error.mean()) < 0.2
        dark = render(table(), view, look.model_copy(update={"film": Film(vignette=0.5)})).rgb
        assert dark[0, 0].mean() < 0.8 * clean[0, 0].mean()
        assert dark[48, 48].mean() == pytest.approx(clean[48, 48].mean(), abs=1)

    def test_exposure(self):
        view, look = jacquard_view(32), Appearance(objects=())
        means = [
            render(table(), view, look.model_copy(update={"film": Film(exposure=e)})).rgb.mean()
            for e in (0.25, 1.0, 2.0)
        ]
        assert means[0] < means[1] < means[2]


class TestRefuses:
    def test_looks_for_other_objects(self):
        tabletop = table(at(ball(0.05)))
        with pytest.raises(InvalidInputError, match="one look for each"):
            render(tabletop, jacquard_view(32), Appearance(objects=()))

    def test_a_camera_under_the_table(self):
        below = View(jacquard_view(32).camera, RigidTransform(np.eye(3), [0, 0, -1.0]))
        with pytest.raises(InvalidInputError, match="above the table"):
            render(table(), below, Appearance(objects=()))

    def test_plain_appearance_fits_any_tabletop(self):
        tabletop = table(at(ball(0.05), 0.1), at(box(0.1, 0.05, 0.1), -0.1))
        appearance = plain_appearance(tabletop, seed=3)
        assert appearance == plain_appearance(tabletop, seed=3)
        assert len(appearance.objects) == 2
