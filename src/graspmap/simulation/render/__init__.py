"""Pictures of a tabletop: colour, depth, mask, normals, and depth as a stereo camera sees it."""

from graspmap.simulation.render.appearance import (
    Appearance,
    plain_appearance,
    sample_appearance,
)
from graspmap.simulation.render.randomisation import Randomisation, load_randomisation
from graspmap.simulation.render.rendering import Rendering, render
from graspmap.simulation.render.stereo import Sensor, sample_sensor, stereo_depth
from graspmap.simulation.render.view import (
    OutOfViewError,
    View,
    check_in_view,
    jacquard_view,
    sample_view,
)

__all__ = [
    "Appearance",
    "OutOfViewError",
    "Randomisation",
    "Rendering",
    "Sensor",
    "View",
    "check_in_view",
    "jacquard_view",
    "load_randomisation",
    "plain_appearance",
    "render",
    "sample_appearance",
    "sample_sensor",
    "sample_view",
    "stereo_depth",
]
