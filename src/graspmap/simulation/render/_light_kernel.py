"""Compiled light: what colour a surface has under the lamps.

Letters in shapes: n points, N objects.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.simulation.render._compiled import compiled
from graspmap.simulation.render._texture_kernel import GLASS, METAL, REFLECTANCE, ROUGHNESS

Floats = NDArray[np.float64]

# Places in the numbers of the whole scene's light.
KEY, KEY_COLOUR, FILL, FILL_COLOUR, SKY, GROUND = 0, 3, 6, 9, 12, 15
LENGTH = 18
"""Numbers of the scene's light: position of the lamp, its colour, direction to the second lamp, its
colour, colour from above, colour of the table."""


@compiled
def light_numbers(light: Floats) -> Any:
    """The scene's light as six triples: lamp, its colour, second lamp, its colour, sky, ground."""
    return (
        (light[KEY], light[KEY + 1], light[KEY + 2]),
        (light[KEY_COLOUR], light[KEY_COLOUR + 1], light[KEY_COLOUR + 2]),
        (light[FILL], light[FILL + 1], light[FILL + 2]),
        (light[FILL_COLOUR], light[FILL_COLOUR + 1], light[FILL_COLOUR + 2]),
        (light[SKY], light[SKY + 1], light[SKY + 2]),
        (light[GROUND], light[GROUND + 1], light[GROUND + 2]),
    )


@compiled
def surroundings(x: float, y: float, z: float, rough: float) -> Any:
    """How much of the sky and of the table a mirror sees in a direction, in a room with a window.

    Args:
        x: Unit direction, as are y and z.
        y: See x.
        z: See x.
        rough: Roughness of the mirror; it blurs.
    """
    up = min(max(z / (0.16 + 1.2 * rough) + 0.5, 0.0), 1.0)
    # The window is a band in the walls.
    band = min(max((x * 0.8 + y * 0.6 - 0.45) / (0.1 + rough) + 0.5, 0.0), 1.0)
    band *= min(max((0.75 - z) / (0.15 + rough) + 0.5, 0.0), 1.0)
    sky = (0.55 + 0.75 * min(max(z, 0.0), 1.0)) * (0.6 + 1.3 * band)
    return sky * up, (0.35 + 0.35 * rough) * (1.0 - up)


@compiled
def _highlight(n: Any, to_lamp: Any, eye: Any, facing: float, view: float, rough: float) -> Any:
    """How strongly a surface mirrors the lamp."""
    hx, hy, hz = to_lamp[0] + eye[0], to_lamp[1] + eye[1], to_lamp[2] + eye[2]
    size = hx * hx + hy * hy + hz * hz + 1e-12
    cosine = max(n[0] * hx + n[1] * hy + n[2] * hz, 0.0)
    alpha = rough * rough
    square, half = alpha * alpha, alpha * 0.5
    width = cosine * cosine / size * (square - 1.0) + 1.0
    masking = (facing * (1.0 - half) + half) * (view * (1.0 - half) + half)
    return min(square / (width * width * 4.0 * masking), 12.0) * facing


@compiled
def _channel(
    own: float, base: float, metal: float, diffuse: float, seen: float, shine: float, grazing: float
) -> float:
    """One colour channel of what leaves a surface."""
    tint = base + (own - base) * metal
    mirror = tint + (1.0 - tint) * grazing
    return own * (1.0 - metal) * (1.0 - mirror) * diffuse + mirror * seen + tint * shine


@compiled
def shaded(
    finish: Any,
    numbers: Any,
    own: Any,
    p: Any,
    n: Any,
    eye: Any,
    lamp: float,
    sky: float,
) -> Any:
    """Linear red, green, blue that leave a surface towards the eye; there is no choice in it.

    Args:
        finish: Roughness, metal and reflectance.
        numbers: The scene's light, of `light_numbers`.
        own: Own colour.
        p: World point.
        n: Unit normal.
        eye: Unit direction to the camera.
        lamp: Share of the lamp that it sees.
        sky: Light from above.

    References:
        B. Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007
        (the distribution GGX); C. Schlick, "An inexpensive BRDF model", 1994.
    """
    rough, metal, base = finish
    place, key, fill, fill_colour, above, ground = numbers
    lx, ly, lz = place[0] - p[0], place[1] - p[1], place[2] - p[2]
    near = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * near, ly * near, lz * near
    facing = max(n[0] * lx + n[1] * ly + n[2] * lz, 0.0)
    second = max(n[0] * fill[0] + n[1] * fill[1] + n[2] * fill[2], 0.0)
    open_ = 0.35 + 0.65 * min(sky * 1.2, 1.0)
    first, second, bounce = facing * lamp, second * open_, (0.3 - 0.3 * n[2]) * open_
    view = max(n[0] * eye[0] + n[1] * eye[1] + n[2] * eye[2], 1e-3)
    shine = _highlight(n, (lx, ly, lz), eye, facing, view, rough) * lamp
    rx, ry, rz = 2.0 * view * n[0] - eye[0], 2.0 * view * n[1] - eye[1], 2.0 * view * n[2] - eye[2]
    up, down = surroundings(rx, ry, rz, rough)
    up, down = up * open_, down * open_
    grazing = (1.0 - view) * (1.0 - view)
    grazing = grazing * grazing * (1.0 - view) * (1.0 - 0.7 * rough)
    # A surface that mirrors nothing does not do so at an angle either.
    grazing *= min(base * 50.0, 1.0)
    red = first * key[0] + second * fill_colour[0] + sky * above[0] + bounce * ground[0]
    green = first * key[1] + second * fill_colour[1] + sky * above[1] + bounce * ground[1]
    blue = first * key[2] + second * fill_colour[2] + sky * above[2] + bounce * ground[2]
    seen = up * above[0] + down * ground[0]
    red = _channel(own[0], base, metal, red, seen, shine * key[0], grazing)
    seen = up * above[1] + down * ground[1]
    green = _channel(own[1], base, metal, green, seen, shine * key[1], grazing)
    seen = up * above[2] + down * ground[2]
    blue = _channel(own[2], base, metal, blue, seen, shine * key[2], grazing)
    return red, green, blue


@compiled
def leave_table(
    finish: Any,
    light: Floats,
    colour: Floats,
    point: Floats,
    back: Floats,
    lamp: Floats,
    sky: Floats,
    out: Floats,
) -> None:
    """Light that leaves points of the table towards the camera.

    Args:
        finish: Roughness, metal and reflectance.
        light: Numbers of the scene's light.
        colour: (3, n) own colour.
        point: (3, n) world.
        back: (3, n) unit direction to the camera.
        lamp: (n,) share of the lamp.
        sky: (n,) light from above.
        out: (3, n) out: linear colour.
    """
    numbers = light_numbers(light)
    for i in range(len(lamp)):
        own, p = (colour[0, i], colour[1, i], colour[2, i]), (point[0, i], point[1, i], point[2, i])
        b = (back[0, i], back[1, i], back[2, i])
        out[0, i], out[1, i], out[2, i] = shaded(
            finish, numbers, own, p, (0.0, 0.0, 1.0), b, lamp[i], sky[i]
        )


@compiled
def leave_objects(
    rows: Floats,
    owner: NDArray[np.int16],
    light: Floats,
    colour: Floats,
    point: Floats,
    smooth: Floats,
    back: Floats,
    lamp: Floats,
    sky: Floats,
    out: Floats,
) -> None:
    """The same of points of objects.

    Args:
        rows: (N + 1, LENGTH) numbers of surfaces.
        owner: (n,) which of them each point is on.
        light: Numbers of the scene's light.
        colour: (3, n) own colour.
        point: (3, n) world.
        smooth: (3, n) unit normal.
        back: (3, n) unit direction to the camera.
        lamp: (n,) share of the lamp.
        sky: (n,) light from above.
        out: (3, n) out: linear colour.
    """
    numbers = light_numbers(light)
    for i in range(len(lamp)):
        k = owner[i]
        finish = (rows[k, ROUGHNESS], rows[k, METAL], rows[k, REFLECTANCE])
        own, p = (colour[0, i], colour[1, i], colour[2, i]), (point[0, i], point[1, i], point[2, i])
        n, b = (smooth[0, i], smooth[1, i], smooth[2, i]), (back[0, i], back[1, i], back[2, i])
        out[0, i], out[1, i], out[2, i] = shaded(finish, numbers, own, p, n, b, lamp[i], sky[i])


@compiled
def see_through(
    rows: Floats,
    owner: NDArray[np.int16],
    light: Floats,
    own: Floats,
    smooth: Floats,
    back: Floats,
    behind: Floats,
    out: Floats,
) -> None:
    """Add to glass what lies behind it, darker where it goes askew, and what it mirrors.

    Args:
        rows: (N + 1, LENGTH) numbers of surfaces.
        owner: (n,) which of them each point is on.
        light: Numbers of the scene's light.
        own: (3, n) own colour.
        smooth: (3, n) unit normal.
        back: (3, n) unit direction to the camera.
        behind: (3, n) colour of what lies behind.
        out: (3, n) in and out: linear colour.
    """
    for i in range(len(owner)):
        clear, base = rows[owner[i], GLASS], rows[owner[i], REFLECTANCE]
        facing = smooth[0, i] * back[0, i] + smooth[1, i] * back[1, i] + smooth[2, i] * back[2, i]
        askew = 1.0 - facing
        through = clear * (0.25 + 0.75 * facing * (2.0 - facing))
        mirror = 0.6 * clear * (askew * askew * askew + base)
        for k in range(3):
            seen = through * behind[k, i] * (0.55 + 0.45 * own[k, i])
            out[k, i] = out[k, i] * (1.0 - 0.85 * clear) + seen + mirror * light[SKY + k]
