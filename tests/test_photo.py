"""Photos: the same scene by path tracing; exact channels stay, silhouettes agree."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from graspmap import cli
from graspmap.errors import GraspmapError, InvalidInputError, MissingExtraError
from graspmap.generation import GenerationPlan, generate
from graspmap.generation.scene_file import read_record
from graspmap.geometry import Camera, RigidTransform
from graspmap.gripper import load_gripper
from graspmap.simulation.objects import ObjectModel, Texture
from graspmap.simulation.render import View, jacquard_view, render
from graspmap.simulation.render.appearance import (
    Appearance,
    Finish,
    Light,
    ObjectLook,
    TableLook,
)
from graspmap.simulation.render.photo import photo
from graspmap.simulation.tabletop import PlacedObject, Tabletop

FACES = np.array(
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ],
    np.int32,
)
CUBE = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
TURN = np.array([[0.8, -0.6, 0], [0.6, 0.8, 0], [0, 0, 1.0]])
GREY, BLACK = ((0.2, 0.2, 0.2),) * 3, ((0.0, 0.0, 0.0),) * 3
GLOOM = Light(key=(0.0, 0.0, 0.0), ambient=(1.0, 1.0, 1.0), fill=(0.0, 0.0, 0.0))


def scene(sides=(0.2, 0.12, 0.06), texture=None):
    model = ObjectModel("box", CUBE * sides, FACES, (), 0.1, np.eye(3), texture)
    placed = PlacedObject(model, RigidTransform(TURN, [0.03, -0.02, sides[2] / 2]))
    return Tabletop((placed,), None)


def look(colours=GREY, table=BLACK, light=GLOOM, **values):
    return Appearance(
        objects=(ObjectLook(colours=colours, **values),),
        table=TableLook(colours=table),
        light=light,
    )


def overlap(picture):
    """Of the mask and of the pixels that are at least half as bright as the object's inside."""
    light = (picture.rgb.mean(axis=-1) / 255) ** 2.2
    bright = light > (np.median(light[picture.mask]) + np.median(light[~picture.mask])) / 2
    return (bright & picture.mask).sum() / (bright | picture.mask).sum()


def test_a_missing_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'graspmap\[photo\]'") as caught:
        photo(scene(), jacquard_view(16), look())
    assert caught.value.extra == "photo"
    assert isinstance(caught.value, GraspmapError | ImportError)


def test_a_data_set_of_photos_is_refused_before_any_work(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    words = ["generate", "--scenes", "1", "--photo", "4", "--out", str(tmp_path / "data")]
    assert cli.main(words) == 2
    assert "pip install 'graspmap[photo]'" in capsys.readouterr().err
    assert not list((tmp_path / "data").iterdir())


class TestPhoto:
    @pytest.fixture(autouse=True)
    def mitsuba(self):
        return pytest.importorskip("mitsuba", reason="the extra photo is not installed")

    @pytest.mark.parametrize("pattern", ["plain", "checker"])
    def test_silhouette_is_the_mask(self, pattern):
        tabletop, view = scene((0.35, 0.25, 0.06)), jacquard_view(128)
        appearance = look(pattern=pattern)
        picture, exact = (
            photo(tabletop, view, appearance, samples=16),
            render(tabletop, view, appearance),
        )
        assert overlap(picture) > 0.98
        for name in ("depth", "mask", "normals", "instance"):
            assert np.array_equal(getattr(picture, name), getattr(exact, name))

    def test_an_off_centre_camera_sees_the_same(self):
        camera = Camera(250, 250, 30.5, 50.25, 96, 72)
        tabletop, view = scene(), View(camera, jacquard_view(64).T_world_camera)
        picture = photo(tabletop, view, look(), samples=16)
        assert picture.mask.sum() > 300
        assert overlap(picture) > 0.95

    def test_light_is_as_strong_as_in_the_quick_picture(self):
        light = Light(position_m=(0.3, 0.2, 1.3), radius_m=0.1, ambient=(0.3, 0.3, 0.3))
        tabletop, view = scene(), jacquard_view(32)
        appearance = look(((0.4, 0.2, 0.1),) * 3, ((0.2, 0.2, 0.3),) * 3, light)
        ours = render(tabletop, view, appearance).rgb.astype(float)
        theirs = photo(tabletop, view, appearance, samples=64).rgb.astype(float)
        assert theirs.mean(axis=(0, 1)) == pytest.approx(ours.mean(axis=(0, 1)), rel=0.1)
        assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.9

    def test_own_picture(self):
        image = np.zeros((4, 4, 3), np.uint8)
        image[:2], image[2:] = (250, 20, 20), (20, 20, 250)
        uv = np.array([(0.5, 1.0 if y > 0 else 0.0) for x, y, z in CUBE])
        tabletop, view = scene(texture=Texture(image, uv)), jacquard_view(48)
        appearance = look(pattern="picture")
        ours = render(tabletop, view, appearance)
        theirs = photo(tabletop, view, appearance, samples=16)
        a, b = ours.rgb[ours.mask].astype(float), theirs.rgb[ours.mask].astype(float)
        assert np.corrcoef((a[:, 0] - a[:, 2]), (b[:, 0] - b[:, 2]))[0, 1] > 0.95

    @pytest.mark.parametrize("finish", [Finish(glass=0.9), Finish(metal=1.0, roughness=0.3)])
    def test_glass_and_metal_leave_the_exact_channels(self, finish):
        tabletop, view = scene(), jacquard_view(32)
        appearance = look(finish=finish, light=Light())
        picture, exact = (
            photo(tabletop, view, appearance, samples=8),
            render(tabletop, view, appearance),
        )
        assert np.array_equal(picture.depth, exact.depth)
        assert np.array_equal(picture.mask, exact.mask)
        assert picture.rgb[picture.mask].std() > 0

    def test_a_data_set_of_photos_differs_in_nothing_but_colour(self, tmp_path):
        small = {"scenes": 1, "views": 1, "size_px": 96, "candidates": 20, "seed": 4}
        plain = GenerationPlan(gripper=load_gripper("jacquard"), **small)
        for name, samples in (("plain", 0), ("photo", 4), ("again", 4)):
            generate(replace(plain, photo_samples=samples), tmp_path / name, workers=0)
        names = sorted(p.relative_to(tmp_path / "plain") for p in (tmp_path / "plain").rglob("*_*"))
        assert len(names) == 8
        for name in names:
            files = [(tmp_path / kind / name).read_bytes() for kind in ("plain", "photo", "again")]
            assert files[1] == files[2]
            changes = name.name.endswith(("_RGB.png", "_scene.json"))  # that has the versions
            assert (files[0] != files[1]) == changes
        record = next((tmp_path / "photo").rglob("*_scene.json"))
        assert "mitsuba" in read_record(record).versions

    def test_refuses(self):
        with pytest.raises(InvalidInputError, match="samples"):
            photo(scene(), jacquard_view(16), look(), samples=0)
        stretched = View(Camera(50, 60, 8, 8, 16, 16), jacquard_view(16).T_world_camera)
        with pytest.raises(InvalidInputError, match="square pixels"):
            photo(scene(), stretched, look())
