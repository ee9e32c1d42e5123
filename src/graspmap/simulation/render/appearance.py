"""Appearance: what a picture looks like, apart from where things are. Small, and plain JSON.

`Appearance.model_dump()` gives it as plain values, `Appearance.model_validate` reads them back.
Colours are linear red, green, blue from 0 to 1.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from graspmap.simulation.render.randomisation import (
    LightSection,
    NoiseSection,
    Randomisation,
    TableSection,
    Weights,
)
from graspmap.simulation.render.view import turn
from graspmap.simulation.tabletop import PlacedObject, Tabletop

Colour = tuple[float, float, float]
Point = tuple[float, float, float]
ObjectPattern = Literal[
    "plain", "stripes", "checker", "noise", "wood", "speckle", "marble", "patches", "picture"
]
TablePattern = Literal["plain", "planks", "cloth", "noise", "tiles", "speckle", "marble"]
Share = Annotated[float, Field(ge=0, le=1)]


class _Value(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Finish(_Value):
    """How a surface takes and gives light.

    Attributes:
        roughness: From a mirror (0.05) to chalk (1).
        reflectance: Of light that comes straight, for what is no metal.
        metal: Whether reflections take the surface's colour.
        glass: How much of what lies behind shows through.
    """

    roughness: Annotated[float, Field(ge=0.05, le=1)] = 0.7
    reflectance: Share = 0.03
    metal: Share = 0.0
    glass: Share = 0.0


class ObjectLook(_Value):
    """What an object looks like.

    Attributes:
        pattern: Pattern in the object's own space; ``"picture"`` is its own picture.
        colours: Three colours; patterns use one, two or all.
        scale_m: Size of the pattern's parts.
        axis: Direction of stripes and fibres in the object's space, unit length.
        seed: Of the pattern.
        finish: How it takes light.
        crease_deg: Edges sharper than this look sharp, others round.
    """

    pattern: ObjectPattern = "plain"
    colours: tuple[Colour, Colour, Colour] = ((0.5, 0.5, 0.5),) * 3
    scale_m: Annotated[float, Field(gt=0)] = 0.02
    axis: Point = (0.0, 0.0, 1.0)
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    finish: Finish = Finish()
    crease_deg: Annotated[float, Field(ge=0, le=180)] = 40.0


class TableLook(_Value):
    """What the table looks like.

    Attributes:
        pattern: Pattern on the table.
        colours: Three colours.
        scale_m: Size of the pattern's parts.
        angle_deg: Turn of the pattern.
        seed: Of the pattern.
        finish: How it takes light.
    """

    pattern: TablePattern = "plain"
    colours: tuple[Colour, Colour, Colour] = ((0.4, 0.4, 0.4),) * 3
    scale_m: Annotated[float, Field(gt=0)] = 0.1
    angle_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0
    finish: Finish = Finish()


class Light(_Value):
    """Lamps; strengths are those on a surface that faces them.

    Attributes:
        position_m: World position of the lamp's middle.
        radius_m: Of the lamp, a disk that faces the world's origin; 0 gives a sharp shadow.
        samples: Points of the lamp, and of the sky, at which shadows are computed; with few, a
            soft shadow on a clean table shows steps.
        key: Light of the lamp by colour channel.
        fill_direction: Unit vector to a second lamp that throws no shadow.
        fill: Its light.
        ambient: Light from the sky.
    """

    position_m: Point = (-0.5, 0.6, 1.4)
    radius_m: Annotated[float, Field(ge=0)] = 0.12
    samples: Annotated[int, Field(ge=1, le=64)] = 16
    key: Colour = (0.75, 0.75, 0.75)
    fill_direction: Point = (0.6, -0.48, 0.64)
    fill: Colour = (0.1, 0.1, 0.1)
    ambient: Colour = (0.4, 0.4, 0.4)


class Film(_Value):
    """What the colour camera does to the light.

    Attributes:
        exposure: Factor on all light; 1 makes a white sheet on the table nearly white.
        white_balance: Gains of red, green and blue.
        vignette: Loss of light in the corners.
        blur_px: Standard deviation of the blur, pixels of a picture 1024 wide.
        read: Standard deviation of the noise in the dark, of full white.
        shot: The same at full white; it grows with the root of the light.
        seed: Of the noise.
    """

    exposure: Annotated[float, Field(gt=0)] = 1.0
    white_balance: Colour = (1.0, 1.0, 1.0)
    vignette: Share = 0.0
    blur_px: Annotated[float, Field(ge=0, le=3)] = 0.0
    read: Share = 0.0
    shot: Share = 0.0
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0


class Appearance(_Value):
    """What a picture looks like.

    Attributes:
        objects: Look of each object, in the tabletop's order.
        table: Look of the table.
        light: Lamps.
        film: What the camera adds.
    """

    objects: tuple[ObjectLook, ...]
    table: TableLook = TableLook()
    light: Light = Light()
    film: Film = Film()


def sample_appearance(
    tabletop: Tabletop, randomisation: Randomisation, rng: np.random.Generator
) -> Appearance:
    """A look at random.

    Args:
        tabletop: What will be seen.
        randomisation: Amounts.
        rng: Source of everything random.
    """
    table = _table(randomisation.table, rng)
    light = _light(randomisation.light, rng)
    film = _film(randomisation.noise, rng)
    looks = tuple(_object(placed, randomisation, rng) for placed in tabletop.objects)
    return Appearance(objects=looks, table=table, light=light, film=film)


def plain_appearance(tabletop: Tabletop, seed: int = 0) -> Appearance:
    """A calm look that shows shapes well: coloured plastic on a grey table."""
    rng = np.random.default_rng([seed, len(tabletop.objects)])
    looks = []
    for _ in tabletop.objects:
        colour = _colour(rng, (0.55, 0.75), (0.75, 0.9))
        finish = Finish(roughness=0.45, reflectance=0.04)
        looks.append(ObjectLook(colours=(colour, colour, colour), finish=finish))
    return Appearance(objects=tuple(looks), light=Light(samples=32))


def _rounded(*values: float) -> tuple[float, ...]:
    """Few digits: a record of the picture stays readable."""
    return tuple(round(float(value), 5) for value in values)


def _pick(rng: np.random.Generator, weights: Weights) -> str:
    """A name, with the chance that its weight gives it."""
    named = weights.model_dump()
    left = rng.random() * sum(named.values())
    possible = {name: weight for name, weight in named.items() if weight}
    for name, weight in possible.items():
        left -= weight
        if left < 0:
            return name
    return next(reversed(possible))


def _seed(rng: np.random.Generator) -> int:
    return int(rng.integers(2**31))


def _colour(
    rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]
) -> Colour:
    """Of any hue; linear light."""
    return _from_hsv(rng.random(), rng.uniform(*saturation), rng.uniform(*value))


def _from_hsv(hue: float, saturation: float, value: float) -> Colour:
    """Linear light of a hue (0 to 1 around the circle), saturation and value."""
    from graspmap.simulation.render._film_kernel import linear

    channels = []
    for shift in (5.0, 3.0, 1.0):
        place = (shift + 6.0 * hue) % 6.0
        channels.append(linear(value * (1.0 - saturation * max(0.0, min(place, 4.0 - place, 1.0)))))
    red, green, blue = _rounded(*channels)
    return red, green, blue


def _object(
    placed: PlacedObject, randomisation: Randomisation, rng: np.random.Generator
) -> ObjectLook:
    colours, textures = randomisation.colours, randomisation.textures
    pattern = _pick(rng, textures.patterns)
    material = _pick(rng, textures.materials)
    scale = _spread(rng, *textures.scale_m)
    contrast = rng.uniform(*textures.contrast)
    hue, saturation, value = (
        rng.random(),
        rng.uniform(*colours.saturation),
        rng.uniform(*colours.value),
    )
    second_hue, second_value = rng.random(), rng.uniform(*colours.value)
    third = _colour(rng, colours.saturation, colours.value)
    cos, sin = turn(rng.uniform(-3.1, 3.1))
    axis = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (cos, 0.0, sin), (cos, sin, 0.0))
    along = axis[int(rng.integers(len(axis)))]
    seed, polish, own = _seed(rng), rng.random(), rng.random()
    if placed.model.texture is not None and own < colours.own_texture:
        pattern, material = "picture", "matte" if polish < 0.5 else "glossy"
    if pattern == "wood":
        # Wood has the colours of wood.
        hue, saturation, value = 0.055 + 0.05 * hue, 0.35 + 0.4 * saturation, 0.35 + 0.5 * value
        second_hue, second_value = hue, value * 0.55
        material = "matte" if polish < 0.6 else "glossy"
    if material in ("metal", "glass"):
        # Both are nearly without colour, and their reflections are their pattern.
        saturation *= 0.35 if material == "metal" else 0.5
        value = 0.62 + 0.38 * value
        pattern = "plain" if pattern not in ("noise", "stripes") or material == "glass" else pattern
        contrast *= 0.3
    first = _from_hsv(hue, saturation, value)
    other = _from_hsv(second_hue, saturation, second_value)
    second = _between(first, other, contrast)
    return ObjectLook(
        pattern=pattern,  # type: ignore[arg-type]
        colours=(first, second, _between(first, third, contrast)),
        scale_m=_rounded(scale)[0],
        axis=_rounded(*along),  # type: ignore[arg-type]
        seed=seed,
        finish=_finish(material, polish),
    )


def _between(first: Colour, second: Colour, share: float) -> Colour:
    red, green, blue = _rounded(*(a + (b - a) * share for a, b in zip(first, second, strict=True)))
    return red, green, blue


def _spread(rng: np.random.Generator, low: float, high: float) -> float:
    """Between two sizes; small ones as often as large ones."""
    share = rng.random()
    return low + (high - low) * share * share


def _finish(material: str, polish: float) -> Finish:
    """Numbers of a material; ``polish`` from 0 to 1 varies it."""
    if material == "metal":
        return Finish(roughness=round(0.15 + 0.4 * polish, 3), reflectance=0.6, metal=1.0)
    if material == "glass":
        return Finish(roughness=0.1, reflectance=0.05, glass=round(0.75 + 0.2 * polish, 3))
    if material == "glossy":
        return Finish(roughness=round(0.18 + 0.3 * polish, 3), reflectance=0.045)
    return Finish(roughness=round(0.65 + 0.35 * polish, 3), reflectance=0.02)


_TABLE_SCALES_M = {
    "plain": (0.2, 0.6),
    "planks": (0.06, 0.14),
    "cloth": (0.002, 0.006),
    "noise": (0.05, 0.4),
    "tiles": (0.08, 0.25),
    "speckle": (0.008, 0.03),
    "marble": (0.15, 0.5),
}
_PLANK_HUES = (0.05, 0.11)


def _table(ranges: TableSection, rng: np.random.Generator) -> TableLook:
    pattern = _pick(rng, ranges.patterns)
    pattern = "planks" if pattern == "wood" else pattern
    hue, saturation, value = (
        rng.random(),
        rng.uniform(*ranges.saturation),
        rng.uniform(*ranges.value),
    )
    contrast = rng.uniform(*ranges.contrast)
    scale = _spread(rng, *_TABLE_SCALES_M[pattern])
    if pattern == "planks":
        hue = _PLANK_HUES[0] + hue * (_PLANK_HUES[1] - _PLANK_HUES[0])
        saturation = 0.25 + 0.6 * saturation
    first = _from_hsv(hue, saturation, value)
    lighter = value > 0.6
    darker = _from_hsv(hue, min(saturation * 1.2, 1.0), value * 0.45)
    paler = _from_hsv(hue, saturation * 0.6, min(value * 1.6 + 0.1, 1.0))
    other = darker if lighter or pattern in ("planks", "tiles") else paler
    third = _from_hsv((hue + 0.5 * rng.random()) % 1.0, saturation, 0.3 + 0.6 * rng.random())
    gloss = rng.uniform(*ranges.gloss)
    return TableLook(
        pattern=pattern,  # type: ignore[arg-type]
        colours=(first, _between(first, other, contrast), _between(first, third, contrast)),
        scale_m=_rounded(scale)[0],
        angle_deg=round(rng.uniform(-180, 180), 2),
        seed=_seed(rng),
        finish=Finish(
            roughness=round(max(0.9 - 1.2 * gloss, 0.25), 3), reflectance=round(0.05 * gloss, 4)
        ),
    )


def _light(ranges: LightSection, rng: np.random.Generator) -> Light:
    cos, sin = turn(np.radians(rng.uniform(*ranges.azimuth_deg)))
    level, height = turn(np.radians(rng.uniform(*ranges.elevation_deg)))
    distance = rng.uniform(*ranges.distance_m)
    position = (distance * level * cos, distance * level * sin, distance * height)
    warmth = rng.uniform(*ranges.warmth)
    tint = (1.0 + 0.22 * warmth, 1.0 + 0.02 * warmth, 1.0 - 0.28 * warmth)
    cool = (1.0 - 0.1 * warmth, 1.0, 1.0 + 0.12 * warmth)
    key, fill = rng.uniform(*ranges.key), rng.uniform(*ranges.fill)
    ambient = rng.uniform(*ranges.ambient)
    return Light(
        position_m=_rounded(*position),  # type: ignore[arg-type]
        radius_m=_rounded(rng.uniform(*ranges.radius_m))[0],
        samples=ranges.samples,
        key=_rounded(*(key * c for c in tint)),  # type: ignore[arg-type]
        fill_direction=_rounded(-0.8 * cos, -0.8 * sin, 0.6),  # type: ignore[arg-type]
        fill=_rounded(*(fill * c for c in cool)),  # type: ignore[arg-type]
        ambient=_rounded(*(ambient * c for c in cool)),  # type: ignore[arg-type]
    )


def _film(ranges: NoiseSection, rng: np.random.Generator) -> Film:
    stops = rng.uniform(*ranges.exposure_stops)
    # 2 to a power, by a series: the C library's may differ in the last bit.
    whole = int(np.floor(stops))
    rest, term, exposure = (stops - whole) * 0.6931471805599453, 1.0, 1.0
    for k in range(1, 14):
        term *= rest / k
        exposure += term
    exposure *= 2.0**whole
    gains = rng.uniform(-ranges.white_balance, ranges.white_balance, 3)
    return Film(
        exposure=_rounded(exposure)[0],
        white_balance=_rounded(*(1.0 + gains)),  # type: ignore[arg-type]
        vignette=_rounded(rng.uniform(*ranges.vignette))[0],
        blur_px=_rounded(rng.uniform(*ranges.blur_px))[0],
        read=_rounded(rng.uniform(*ranges.read))[0],
        shot=_rounded(rng.uniform(*ranges.shot))[0],
        seed=_seed(rng),
    )
