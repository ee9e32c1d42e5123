"""Randomisation: by how much pictures of the simulator vary; a strict YAML file.

`randomisation.yaml` and `plain.yaml` beside this module are shipped; a user's file has the same
keys, and what it leaves out stays as in the shipped default.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from graspmap.config import read_model
from graspmap.files import shipped_or_path

SHIPPED = {name: Path(__file__).with_name(f"{name}.yaml") for name in ("default", "plain")}
"""Files that ship, by the name that `load_randomisation` takes."""


def _ordered(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError(f"allowed: [least, greatest], not {list(limits)}")
    return limits


_Share = Annotated[float, Field(ge=0, le=1)]
_Weight = Annotated[float, Field(ge=0, le=1000)]
_Length = Annotated[float, Field(ge=0.0005, le=10)]
_Reach = Annotated[float, Field(ge=0, le=1)]
_Tilt = Annotated[float, Field(ge=-60, le=60)]
_Turn = Annotated[float, Field(ge=-180, le=180)]
_View = Annotated[float, Field(ge=5, le=120)]
_High = Annotated[float, Field(ge=20, le=90)]
_Amount = Annotated[float, Field(ge=0, le=4)]
_Stops = Annotated[float, Field(ge=-4, le=4)]
_Step = Annotated[float, Field(ge=1, le=100)]
_Pixels = Annotated[float, Field(ge=0, le=3)]

Shares = Annotated[tuple[_Share, _Share], AfterValidator(_ordered)]
Lengths = Annotated[tuple[_Length, _Length], AfterValidator(_ordered)]
Tilts = Annotated[tuple[_Tilt, _Tilt], AfterValidator(_ordered)]
Turns = Annotated[tuple[_Turn, _Turn], AfterValidator(_ordered)]
Views = Annotated[tuple[_View, _View], AfterValidator(_ordered)]
Highs = Annotated[tuple[_High, _High], AfterValidator(_ordered)]
Amounts = Annotated[tuple[_Amount, _Amount], AfterValidator(_ordered)]
Stops = Annotated[tuple[_Stops, _Stops], AfterValidator(_ordered)]
Pixels = Annotated[tuple[_Pixels, _Pixels], AfterValidator(_ordered)]
Steps = Annotated[tuple[_Step, _Step], AfterValidator(_ordered)]
Reaches = Annotated[tuple[_Reach, _Reach], AfterValidator(_ordered)]


class Section(BaseModel):
    """A strict, frozen part of a randomisation."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class Weights(Section):
    """How often each kind is drawn, relative to the others; not all may be 0."""

    @model_validator(mode="after")
    def _some(self) -> Weights:
        if not any(getattr(self, name) for name in type(self).model_fields):
            raise ValueError("allowed: at least one weight above 0")
        return self


class CameraSection(Section):
    """Where the camera stands; the default is about Jacquard's.

    Attributes:
        distance_m: From the camera to the table, along its axis.
        tilt_deg: Turn about the image's x axis; positive stands on the side of the lower edge.
        pan_deg: Turn about the image's y axis.
        roll_deg: Turn about the optical axis.
        look_at_m: How far from the world's origin, along x and along y, the axis meets the table.
        field_of_view_deg: Between the left and the right edge of the picture.
    """

    distance_m: Lengths = (1.4, 1.6)
    tilt_deg: Tilts = (0.0, 14.0)
    pan_deg: Tilts = (-4.0, 4.0)
    roll_deg: Turns = (-5.0, 5.0)
    look_at_m: _Reach = 0.03
    field_of_view_deg: Views = (29.0, 31.0)


class LightSection(Section):
    """A lamp with a soft shadow, a second one without, and light from all around.

    Attributes:
        elevation_deg: Height of the lamp above the table, as an angle.
        azimuth_deg: Its direction around the vertical, from the world's x axis.
        distance_m: From the lamp to the world's origin.
        radius_m: Of the lamp; the larger, the softer the shadow.
        key: Light of the lamp on a surface that faces it.
        fill: Light of the second lamp.
        ambient: Light from all around; in corners less of it arrives.
        warmth: Colour of the lamp, from -1 (blue) to 1 (orange).
        samples: Points of the lamp, and of the sky, at which shadows are computed.
    """

    elevation_deg: Highs = (40.0, 75.0)
    azimuth_deg: Turns = (-180.0, 180.0)
    distance_m: Lengths = (1.2, 2.5)
    radius_m: Reaches = (0.05, 0.3)
    key: Amounts = (0.55, 1.0)
    fill: Amounts = (0.0, 0.25)
    ambient: Amounts = (0.25, 0.5)
    warmth: Annotated[
        tuple[Annotated[float, Field(ge=-1, le=1)], Annotated[float, Field(ge=-1, le=1)]],
        AfterValidator(_ordered),
    ] = (-0.3, 0.5)
    samples: Annotated[int, Field(ge=1, le=64)] = 16


class ColoursSection(Section):
    """Colours of objects.

    Attributes:
        saturation: Of a colour, 0 is grey.
        value: Lightness of a colour.
        own_texture: How often an object that has a picture of its own wears it.
    """

    saturation: Shares = (0.05, 0.9)
    value: Shares = (0.15, 0.95)
    own_texture: _Share = 0.7


class PatternWeights(Weights):
    """Patterns of objects; they lie in the object's own space, so they turn with it."""

    plain: _Weight = 4.0
    stripes: _Weight = 1.0
    checker: _Weight = 0.7
    noise: _Weight = 1.0
    wood: _Weight = 1.2
    speckle: _Weight = 1.0
    marble: _Weight = 0.8
    patches: _Weight = 0.6


class MaterialWeights(Weights):
    """What objects are made of."""

    matte: _Weight = 4.0
    glossy: _Weight = 4.0
    metal: _Weight = 1.2
    glass: _Weight = 0.3


class TexturesSection(Section):
    """Surfaces of objects.

    Attributes:
        patterns: Weights of the patterns.
        materials: Weights of the materials.
        scale_m: Size of a pattern's parts.
        contrast: Between the colours of a pattern.
    """

    patterns: PatternWeights = PatternWeights()
    materials: MaterialWeights = MaterialWeights()
    scale_m: Lengths = (0.006, 0.05)
    contrast: Shares = (0.3, 1.0)


class TablePatternWeights(Weights):
    """Patterns of the table."""

    plain: _Weight = 2.0
    wood: _Weight = 2.5
    cloth: _Weight = 1.5
    noise: _Weight = 1.0
    tiles: _Weight = 1.0
    speckle: _Weight = 1.0
    marble: _Weight = 1.0


class TableSection(Section):
    """The table.

    Attributes:
        patterns: Weights of the patterns.
        saturation: Of its colours.
        value: Lightness of its colours.
        contrast: Between its colours.
        gloss: Strength of its reflections.
    """

    patterns: TablePatternWeights = TablePatternWeights()
    saturation: Shares = (0.0, 0.4)
    value: Shares = (0.35, 0.95)
    contrast: Shares = (0.1, 0.7)
    gloss: Shares = (0.0, 0.4)


class NoiseSection(Section):
    """What the colour camera does to the picture.

    Attributes:
        exposure_stops: Lighter or darker by powers of 2.
        white_balance: Greatest error of a colour channel's gain.
        vignette: Loss of light in the corners.
        blur_px: Standard deviation of the blur, pixels of a picture 1024 wide.
        read: Standard deviation of the noise in the dark, of full white.
        shot: The same at full white; it grows with the root of the light.
    """

    exposure_stops: Stops = (-0.3, 0.35)
    white_balance: _Share = 0.06
    vignette: Shares = (0.0, 0.25)
    blur_px: Pixels = (0.0, 0.8)
    read: Shares = (0.002, 0.012)
    shot: Shares = (0.002, 0.02)


class SensorSection(Section):
    """The depth camera, a stereo pair; about Jacquard's. `Sensor` says what each number does.

    Attributes:
        baseline_m: Between the two cameras.
        subpixel: Steps of disparity in a pixel (pixels: of a picture 1024 wide).
        locking: How strongly disparities are drawn to whole pixels.
        noise_px: Standard deviation of disparity that neighbours share.
        correlation_px: Size of the patches that share it.
        fine_px: Standard deviation of disparity of each pixel by itself.
        waver_px: How far edges wander.
        fattening_px: How far near things grow over what lies behind.
        shadow: Share of what the second camera does not see that becomes holes.
        dropout: Share of the pixels at a jump of disparity that become holes.
        speckle: Share of all pixels that become holes.
    """

    baseline_m: Annotated[
        tuple[Annotated[float, Field(ge=0.005, le=1)], Annotated[float, Field(ge=0.005, le=1)]],
        AfterValidator(_ordered),
    ] = (0.07, 0.09)
    subpixel: Steps = (16.0, 16.0)
    locking: Shares = (0.4, 0.8)
    noise_px: Pixels = (0.03, 0.08)
    correlation_px: Steps = (4.0, 8.0)
    fine_px: Pixels = (0.01, 0.03)
    waver_px: Pixels = (1.0, 2.0)
    fattening_px: Pixels = (0.5, 1.5)
    shadow: Shares = (0.4, 0.9)
    dropout: Shares = (0.15, 0.3)
    speckle: Shares = (0.0005, 0.002)


class Randomisation(Section):
    """By how much pictures vary. The shipped default, section by section.

    Attributes:
        camera: Where the camera stands.
        light: Lamps.
        colours: Colours of objects.
        textures: Surfaces of objects.
        table: The table.
        noise: What the colour camera adds.
        sensor: The depth camera.
    """

    camera: CameraSection = CameraSection()
    light: LightSection = LightSection()
    colours: ColoursSection = ColoursSection()
    textures: TexturesSection = TexturesSection()
    table: TableSection = TableSection()
    noise: NoiseSection = NoiseSection()
    sensor: SensorSection = SensorSection()


def load_randomisation(name_or_path: str | Path = "default") -> Randomisation:
    """A shipped randomisation by its name, or one of a user's by its path.

    Args:
        name_or_path: ``"default"``, ``"plain"`` (nothing varies but the colour of the objects), or
            a YAML file.

    Raises:
        UnknownNameError: None that ships has this name.
        MissingFileError: There is no such file.
        FileFormatError: The file is no YAML mapping.
        ConfigError: A key or a value is wrong; the error says what is allowed.
    """
    path = shipped_or_path(name_or_path, SHIPPED, what="randomisation", own="a YAML file")
    return read_model(
        path, Randomisation, what="randomisation", example=f"one of {', '.join(SHIPPED)}"
    )
