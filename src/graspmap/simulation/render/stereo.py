"""Stereo depth: what a depth camera made of two cameras says of a tabletop.

Letters in shapes: H rows, W columns.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from graspmap.errors import InvalidInputError
from graspmap.simulation.render import _raster_kernel, _stereo_kernel
from graspmap.simulation.render._pack import pack_eye, pack_points
from graspmap.simulation.render.randomisation import Randomisation, Section
from graspmap.simulation.render.rendering import Rendering
from graspmap.simulation.render.view import View
from graspmap.simulation.tabletop import Tabletop

_WIDTH_PX = 1024
_Share = Annotated[float, Field(ge=0, le=1)]
_Pixels = Annotated[float, Field(ge=0, le=20)]


class Sensor(Section):
    """A pair of cameras that measures depth by disparity.

    The second camera stands ``baseline_m`` along the first one's x axis. Disparities and pixels
    are those of a picture 1024 wide, whatever the size of the picture, so that depth has the same
    errors in metres at every size.

    The defaults were measured on 23 pairs of perfect and stereo depth of Jacquard's samples
    (`python -m studies stereo_sensor`): baseline 8.0 cm and 1/16 px (the values of 1 / depth lie on
    one lattice), second camera on the right (53 % of the pixels that it cannot see are holes; of
    those that it could not see from the left, 16 %), disparities drawn to whole pixels by 0.8 (an
    error of up to 0.2 px, or 3 mm: the steps that one sees on the table), 0.03 to 0.05 px of noise
    about that, holes in 18 % of the pixels within 1 px of a jump of disparity, 7 % at 2 to 3 px,
    4 % at 4 to 5 px, and 0.14 % far from any object.

    Attributes:
        baseline_m: Between the two cameras.
        subpixel: Steps of disparity in a pixel.
        locking: How strongly disparities are drawn to whole pixels: a distance x to the nearest
            becomes x (1 - locking (1 - 2.2 x^2)).
        noise_px: Standard deviation of disparity that neighbours share.
        correlation_px: Size of the patches that share it.
        fine_px: Standard deviation of disparity of each pixel by itself.
        waver_px: How far edges wander, standard deviation.
        fattening_px: How far near things grow over what lies behind.
        shadow: Share of what the second camera does not see that becomes holes; the rest is
            taken from around it.
        dropout: Share of the pixels at a jump of disparity that become holes; it falls with the
            distance.
        speckle: Share of all pixels that become holes.
    """

    baseline_m: Annotated[float, Field(ge=0.005, le=1)] = 0.08
    subpixel: Annotated[float, Field(ge=1, le=4096)] = 16.0
    locking: _Share = 0.8
    noise_px: _Pixels = 0.05
    correlation_px: Annotated[float, Field(ge=1, le=100)] = 5.0
    fine_px: _Pixels = 0.02
    waver_px: _Pixels = 1.5
    fattening_px: _Pixels = 1.0
    shadow: _Share = 0.53
    dropout: _Share = 0.24
    speckle: _Share = 0.0014


def sample_sensor(randomisation: Randomisation, rng: np.random.Generator) -> Sensor:
    """A depth camera at random, within the ranges of ``randomisation.sensor``."""
    values = {
        name: round(float(rng.uniform(*limits)), 5)
        for name, limits in randomisation.sensor.model_dump().items()
    }
    return Sensor(**values)


def stereo_depth(
    tabletop: Tabletop,
    view: View,
    rendering: Rendering,
    sensor: Sensor,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """Depth as a stereo camera measures it.

    Args:
        tabletop: What is seen.
        view: Of the first camera.
        rendering: The picture of the same tabletop from the same view.
        sensor: The pair of cameras.
        rng: Source of everything random.

    Returns:
        (H, W) float32 metres, NaN in holes.

    Raises:
        InvalidInputError: The rendering is of another size than the view.
    """
    shape = (view.camera.height, view.camera.width)
    if rendering.depth.shape != shape:
        raise InvalidInputError("shape of the rendering", rendering.depth.shape, str(shape))
    eye = pack_eye(view)
    fx, fy, cx, cy = eye.focal
    # The second camera, in the first one's frame, stands at (baseline, 0, 0).
    world, faces = pack_points(tabletop)
    seen = np.empty(world.shape)
    _raster_kernel.to_frame(world, eye.rotation, eye.origin, seen)
    seen[:, 0] -= sensor.baseline_m
    margin = shape[1]
    wide = (shape[0], 3 * margin)
    window = _raster_kernel.pixel_bounds(seen, (fx, fy, cx + margin, cy), wide)
    top, bottom, left, right = window
    second = np.full((bottom - top, right - left), np.inf)
    triangle, drawn = np.empty(second.shape, np.int32), np.full(len(faces), 2, np.uint8)
    focal = (fx, fy, cx + margin - left, cy - top)
    _raster_kernel.draw_triangles(seen, faces, drawn, focal, second, triangle)
    hidden = np.empty(shape, np.bool_)
    _stereo_kernel.mark_hidden(
        rendering.depth,
        second,
        (top, bottom, left - margin, right - margin),
        fx * sensor.baseline_m,
        hidden,
    )
    scale = shape[1] / _WIDTH_PX
    strength = fx * sensor.baseline_m / scale
    disparity = strength / rendering.depth.astype(np.float64)
    edge, found = np.empty(shape), np.empty(shape)
    _stereo_kernel.edge_distance(disparity, int(np.ceil(7 * scale)), edge)
    _stereo_kernel.match(
        disparity, edge, hidden, scale, _numbers(sensor), int(rng.integers(2**24)), found
    )
    with np.errstate(divide="ignore"):
        depth = strength / found
    return np.where(found > 0, depth, np.nan).astype(np.float32)


def _numbers(sensor: Sensor) -> NDArray[np.float64]:
    return np.array(
        [
            sensor.subpixel,
            sensor.locking,
            sensor.noise_px,
            sensor.correlation_px,
            sensor.fine_px,
            sensor.waver_px,
            sensor.fattening_px,
            sensor.shadow,
            sensor.dropout,
            sensor.speckle,
        ]
    )
