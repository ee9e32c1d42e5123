"""Appearances and randomisations: what is drawn, what is recorded, what a file may say."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from graspmap.errors import ConfigError, MissingFileError
from graspmap.geometry import RigidTransform
from graspmap.simulation.objects import ObjectModel, Texture
from graspmap.simulation.render import (
    Appearance,
    Randomisation,
    Sensor,
    load_randomisation,
    sample_appearance,
    sample_sensor,
)
from graspmap.simulation.render.appearance import ObjectLook
from graspmap.simulation.render.randomisation import SHIPPED
from graspmap.simulation.tabletop import PlacedObject, Tabletop

CORNERS = np.array([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)], float)
FACES = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)], np.int32)


def tabletop(count=2, textured=False):
    texture = Texture(np.zeros((2, 2, 3), np.uint8), np.zeros((4, 2))) if textured else None
    model = ObjectModel("corner", CORNERS, FACES, (), 0.1, np.eye(3), texture)
    return Tabletop((PlacedObject(model, RigidTransform.identity()),) * count, None)


class TestSample:
    @given(st.integers(0, 2**32))
    @settings(max_examples=40)
    def test_is_valid_and_survives_json(self, seed):
        appearance = sample_appearance(tabletop(3), Randomisation(), np.random.default_rng(seed))
        record = json.dumps(appearance.model_dump())
        assert Appearance.model_validate(json.loads(record)) == appearance
        assert len(appearance.objects) == 3
        assert len(record) < 4000
        for look in (*appearance.objects, appearance.table):
            assert np.min(look.colours) >= 0
            assert np.max(look.colours) <= 1

    def test_same_seed_same_look(self):
        first, second, other = (
            sample_appearance(tabletop(), Randomisation(), np.random.default_rng(seed))
            for seed in (1, 1, 2)
        )
        assert first == second != other

    def test_weights_decide(self):
        patterns = dict.fromkeys(Randomisation().textures.patterns.model_dump(), 0.0)
        materials = dict.fromkeys(Randomisation().textures.materials.model_dump(), 0.0)
        tables = dict.fromkeys(Randomisation().table.patterns.model_dump(), 0.0)
        randomisation = Randomisation.model_validate(
            {
                "textures": {
                    "patterns": patterns | {"checker": 1.0, "stripes": 3.0},
                    "materials": materials | {"matte": 2.0},
                },
                "table": {"patterns": tables | {"cloth": 0.1}},
            }
        )
        drawn = [
            sample_appearance(tabletop(1), randomisation, np.random.default_rng(seed))
            for seed in range(200)
        ]
        share = np.mean([look.objects[0].pattern == "stripes" for look in drawn])
        assert {look.objects[0].pattern for look in drawn} == {"checker", "stripes"}
        assert share == pytest.approx(0.75, abs=0.1)
        assert {look.table.pattern for look in drawn} == {"cloth"}
        assert all(look.objects[0].finish.metal == 0 for look in drawn)

    def test_own_picture_is_worn_as_often_as_said(self):
        worn = {}
        for own, textured in ((1.0, True), (0.0, True), (1.0, False)):
            randomisation = Randomisation.model_validate({"colours": {"own_texture": own}})
            looks = [
                sample_appearance(tabletop(1, textured), randomisation, np.random.default_rng(seed))
                for seed in range(20)
            ]
            worn[own, textured] = {look.objects[0].pattern == "picture" for look in looks}
        assert worn == {(1.0, True): {True}, (0.0, True): {False}, (1.0, False): {False}}

    def test_lamp_stands_where_the_ranges_say(self):
        ranges = Randomisation().light
        for seed in range(30):
            light = sample_appearance(
                tabletop(1), Randomisation(), np.random.default_rng(seed)
            ).light
            distance = np.linalg.norm(light.position_m)
            height = np.degrees(np.arcsin(light.position_m[2] / distance))
            assert ranges.distance_m[0] - 1e-4 <= distance <= ranges.distance_m[1] + 1e-4
            assert ranges.elevation_deg[0] - 0.01 <= height <= ranges.elevation_deg[1] + 0.01

    def test_plain_varies_in_colour_alone(self):
        plain = load_randomisation("plain")
        first, second = (
            sample_appearance(tabletop(1), plain, np.random.default_rng(seed)) for seed in (1, 2)
        )
        assert (first.table.colours, first.light) == (second.table.colours, second.light)
        assert (first.film.read, first.film.shot, first.film.exposure) == (0, 0, 1)
        assert first.objects[0].colours != second.objects[0].colours

    def test_a_wrong_record_is_refused(self):
        with pytest.raises(ValidationError):
            ObjectLook.model_validate({"pattern": "tartan"})


class TestRandomisation:
    def test_shipped_default_is_the_default(self):
        assert load_randomisation() == Randomisation() == load_randomisation("default")

    def test_every_key_stands_in_the_shipped_default(self):
        text = SHIPPED["default"].read_text(encoding="utf-8")
        for section, values in Randomisation().model_dump().items():
            assert f"\n{section}:" in text
            assert all(f"  {key}:" in text for key in values)

    def test_a_file_may_leave_things_out(self, tmp_path):
        path = tmp_path / "mine.yaml"
        path.write_text("light: {samples: 4}\n")
        randomisation = load_randomisation(path)
        assert randomisation.light.samples == 4
        assert randomisation.camera == Randomisation().camera

    @pytest.mark.parametrize(
        ("text", "problem"),
        [
            ("camra: {}", "camera"),
            ("camera: {tilt: [0, 1]}", "tilt_deg"),
            ("camera: {tilt_deg: [10, 0]}", "least, greatest"),
            ("camera: {tilt_deg: [0, 89]}", "60"),
            ("camera: {tilt_deg: 10}", "tilt_deg"),
            ("camera: {distance_m: [0, 1]}", "distance_m"),
            ("light: {samples: 0}", "samples"),
            ("table: {patterns: {oak: 1.0}}", "oak"),
            (
                "textures: {materials: {matte: 0, glossy: 0, metal: 0, glass: 0}}",
                "at least one weight",
            ),
            ("noise: {read: [0, .nan]}", "read"),
            ("sensor: {subpixel: [0, 16]}", "subpixel"),
        ],
    )
    def test_refuses(self, tmp_path, text, problem):
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        with pytest.raises(ConfigError, match=problem) as caught:
            load_randomisation(path)
        assert caught.value.path == path

    def test_missing_file(self, tmp_path):
        with pytest.raises(MissingFileError, match="plain"):
            load_randomisation(tmp_path / "none.yaml")


class TestSensor:
    def test_lies_within_the_ranges(self):
        ranges = Randomisation().sensor
        sensor = sample_sensor(Randomisation(), np.random.default_rng(0))
        for name, (low, high) in ranges.model_dump().items():
            assert low <= getattr(sensor, name) <= high

    def test_plain_is_the_measured_one(self):
        assert sample_sensor(load_randomisation("plain"), np.random.default_rng(0)) == Sensor()
