"""Strict YAML for any model: what test_experiment.py does not reach through experiments."""

from __future__ import annotations

from typing import Annotated

import pytest
from pydantic import BaseModel, ConfigDict, Field

from graspmap.config import nearest_key, read_model, read_values
from graspmap.errors import ConfigError, FileFormatError, MissingFileError


class Light(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    share: Annotated[tuple[float, float], Field()]
    name: str = "sun"


class Studio(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    light: Light
    count: Annotated[int, Field(ge=0)] = 1


@pytest.fixture
def file(tmp_path):
    def write(text: str):
        path = tmp_path / "studio.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_model_of_any_kind(file):
    path = file("\ufefflight: {share: [0, 0.5]}")
    assert read_model(path, Studio, what="studio") == Studio(light=Light(share=(0.0, 0.5)))
    changed = read_model(path, Studio, what="studio", overrides=["--light.name", "lamp"])
    assert changed.light.name == "lamp"


def test_flags_are_recommended_only_where_there_are_any(file):
    path = file("light: {}")
    for overrides, remedy in ((None, "add it"), ((), "add it, or pass --light.share VALUE")):
        with pytest.raises(ConfigError) as caught:
            read_model(path, Studio, what="studio", overrides=overrides)
        assert (caught.value.key, caught.value.remedy) == ("light.share", remedy)


def test_messages_name_what_was_read(tmp_path, file):
    with pytest.raises(MissingFileError, match=r"no such studio file; check the path$"):
        read_model(tmp_path / "none", Studio, what="studio")
    with pytest.raises(MissingFileError, match="or start from studio"):
        read_values(tmp_path / "none", what="studio", example="studio.yaml")
    with pytest.raises(FileFormatError, match="no mapping"):
        read_values(file("- 1"), what="studio")


def test_plain_values(file):
    text = "a: 1\nb: [yes, 1e-3, null, true]\nc: {d: 0x10}\n"
    values = read_values(file(text), what="values")
    assert values == {"a": 1, "b": ["yes", 0.001, None, True], "c": {"d": "0x10"}}
    with pytest.raises(FileFormatError, match="holds a date"):
        read_values(file("a: !!timestamp 2001-01-01"), what="values")


def test_the_nearest_key_or_the_keys_of_the_section():
    known = ["light", "light.share", "light.name", "count"]
    assert nearest_key("light.shar", known) == "did you mean light.share?"
    assert nearest_key("share", known) == "did you mean light.share?"
    assert nearest_key("zzz", known) == "allowed here: count, light"
