"""A trial as moving pictures: gripper and objects seen from the side and above.

World frame: the table is the plane z = 0, z up, metres. Grasp frame: origin on the table under the
middle of the opening, x along the opening, z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspmap.geometry.camera import Camera
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import Gripper
from graspmap.pictures.draw import Picture
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.outcomes import Outcome
from graspmap.simulation.recording import TrialRecording
from graspmap.simulation.render import Appearance, View, render
from graspmap.simulation.render.appearance import Colour, Finish, Light, ObjectLook, TableLook
from graspmap.simulation.render.appearance import Film as FilmStock
from graspmap.simulation.tabletop import PlacedObject, Tabletop

Floats = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX = 320, 240
_FRAME_MS = 70
_SLOWER = 0.7  # of the real speed: a grasp takes about two seconds
_FIRST_MS, _LAST_MS = 500, 1500
_WAY_DOWN = 12  # frames
_HIGHER_M = 0.04  # above where the recording begins

_FIELD_OF_VIEW_RAD = math.radians(28.0)  # of the picture's width
_ELEVATION_RAD = math.radians(26.0)
_ASIDE_RAD = math.radians(24.0)  # from square to the opening, so that no finger hides the object
_FINGER_SEEN_M = 0.07  # of the fingers, above their tips
_NEAR_M = 0.18  # what is farther from the grasp need not be in the picture
_MARGIN = 1.06
_PALM_THICKNESS_M = 0.02

_OBJECTS: tuple[Colour, ...] = (
    (0.78, 0.42, 0.06),
    (0.05, 0.35, 0.42),
    (0.45, 0.55, 0.08),
    (0.40, 0.12, 0.40),
    (0.10, 0.30, 0.12),
    (0.62, 0.30, 0.34),
)
_STEEL: Colour = (0.42, 0.45, 0.50)
_BODY: Colour = (0.26, 0.27, 0.29)
_RED: Colour = (0.75, 0.03, 0.02)
_TABLE: Colour = (0.60, 0.60, 0.58)

# Triangles of a box whose corner 4 x + 2 y + z lies at the upper end of x, y, z where the bit is 1.
_BOX = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Film:
    """Frames of a trial.

    Attributes:
        frames: (HEIGHT_PX, WIDTH_PX, 3) pictures.
        durations_ms: How long each is shown.
        phases: What the gripper does in each.
    """

    frames: tuple[Picture, ...]
    durations_ms: tuple[int, ...]
    phases: tuple[str, ...]


def film_trial(tabletop: Tabletop, gripper: Gripper, recording: TrialRecording) -> Film:
    """Film a recorded trial.

    Of grasps that the height map alone decided, there is no more than the way down: fingers that
    touch turn red, fingers with nothing between them close on nothing.

    Args:
        tabletop: The tabletop that it was made on.
        gripper: The gripper.
        recording: The trial.
    """
    shown = moments(recording, gripper)
    view = _view(tabletop, recording)
    touched = recording.result.outcome is Outcome.COLLIDED
    frames = [
        _frame(tabletop, gripper, recording, moment, view, red=touched and moment is shown[-1])
        for moment in shown
    ]
    durations = [_FRAME_MS] * len(frames)
    durations[0], durations[-1] = _FIRST_MS, _LAST_MS
    return Film(tuple(frames), tuple(durations), tuple(moment.phase for moment in shown))


@dataclass(frozen=True, eq=False)
class Moment:
    """Where everything is at one time.

    Attributes:
        number: Moment of the recording that says where the objects are.
        phase: What the gripper does.
        fingers_m: Inner faces of the left and the right finger, along the opening.
        tips_m: Height of the finger tips.
    """

    number: int
    phase: str
    fingers_m: tuple[float, float]
    tips_m: float


def moments(recording: TrialRecording, gripper: Gripper) -> list[Moment]:
    """What is shown: the way down, and some of the moments after it, the last one always.

    Args:
        recording: The trial.
        gripper: The gripper.
    """
    step = _SLOWER * _FRAME_MS / 1000
    down = recording.phases.count("descend")
    last = _moment(recording, down - 1)
    # Nothing is simulated on the way down: it may begin higher, and take longer.
    start = float(recording.tips_m[0]) + _HIGHER_M
    chosen = [
        Moment(last.number, "descend", last.fingers_m, tips)
        for tips in np.linspace(start, last.tips_m, _WAY_DOWN).tolist()
    ]
    after = len(recording) - down
    if after:
        seconds = float(recording.times_s[-1] - recording.times_s[down - 1])
        shown = np.linspace(down, len(recording) - 1, max(1, round(seconds / step)))
        chosen += [_moment(recording, int(number)) for number in np.unique(shown.round())]
    elif recording.result.outcome is Outcome.EMPTY:
        half, closed = last.fingers_m[1], gripper.min_opening_m / 2
        frames = max(2, round((half - closed) / gripper.closing_speed_m_s / step))
        chosen += [
            Moment(last.number, "close", (-place, place), last.tips_m)
            for place in np.linspace(half, closed, frames + 1)[1:].tolist()
        ]
    return chosen


def _moment(recording: TrialRecording, number: int) -> Moment:
    left, right = recording.finger_places_m[number].tolist()
    return Moment(number, recording.phases[number], (left, right), float(recording.tips_m[number]))


def _frame(
    tabletop: Tabletop,
    gripper: Gripper,
    recording: TrialRecording,
    moment: Moment,
    view: View,
    *,
    red: bool,
) -> Picture:
    things = [
        PlacedObject(placed.model, recording.T_world_object(moment.number, index))
        for index, placed in enumerate(tabletop.objects)
    ]
    looks = [_look(placed, index) for index, placed in enumerate(tabletop.objects)]
    hand = _hand(gripper, recording, moment)
    finger = _plain(_RED if red else _STEEL, 0.35)
    scene = Tabletop((*things, *hand), tabletop.height_map)
    appearance = Appearance(
        objects=(*looks, finger, finger, _plain(_BODY, 0.5)),
        table=TableLook(colours=(_TABLE,) * 3, finish=Finish(roughness=0.9, reflectance=0.02)),
        light=_light(recording, view),
        film=FilmStock(exposure=1.25),
    )
    return render(scene, view, appearance).rgb


def _hand(
    gripper: Gripper, recording: TrialRecording, moment: Moment
) -> tuple[PlacedObject, PlacedObject, PlacedObject]:
    """Left and right finger, palm."""
    length, thick = gripper.finger_length_m, gripper.finger_thickness_m
    left, right = moment.fingers_m
    finger = (thick, recording.jaw_m, length)
    middle = moment.tips_m + length / 2
    palm = (*gripper.palm_size_m, _PALM_THICKNESS_M)
    above = moment.tips_m + length + _PALM_THICKNESS_M / 2
    T_world_grasp = _grasp_frame(recording)
    return (
        _box(finger, (left - thick / 2, 0.0, middle), T_world_grasp),
        _box(finger, (right + thick / 2, 0.0, middle), T_world_grasp),
        _box(palm, (0.0, 0.0, above), T_world_grasp),
    )


def _grasp_frame(recording: TrialRecording) -> RigidTransform:
    half = recording.angle / 2
    place = np.append(recording.center_m, 0.0)
    return RigidTransform.from_quaternion((0.0, 0.0, math.sin(half), math.cos(half)), place)


def _box(
    size_m: tuple[float, ...], middle_m: tuple[float, ...], T_world_grasp: RigidTransform
) -> PlacedObject:
    """A box for pictures; nothing weighs it."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = np.array(_BOX, dtype=np.int32)
    model = ObjectModel("gripper", signs * np.array(size_m) / 2, faces, (), 0.0, np.zeros((3, 3)))
    return PlacedObject(model, T_world_grasp @ RigidTransform(np.eye(3), np.array(middle_m)))


def _look(placed: PlacedObject, number: int) -> ObjectLook:
    look = _plain(_OBJECTS[number % len(_OBJECTS)], 0.5)
    if placed.model.texture is None:
        return look
    return look.model_copy(update={"pattern": "picture"})


def _plain(colour: Colour, roughness: float) -> ObjectLook:
    finish = Finish(roughness=roughness, reflectance=0.04)
    return ObjectLook(colours=(colour,) * 3, finish=finish)


def _light(recording: TrialRecording, view: View) -> Light:
    """A lamp over the camera's left shoulder, and one at the camera that throws no shadow."""
    right, back = view.T_world_camera.rotation[:, 0], -view.T_world_camera.rotation[:, 2]
    x, y = (recording.center_m + 0.6 * back[:2] - 0.5 * right[:2]).tolist()
    fill_x, fill_y, fill_z = back.tolist()
    return Light(
        position_m=(x, y, 1.3),
        radius_m=0.06,
        samples=8,
        fill_direction=(fill_x, fill_y, fill_z),
        fill=(0.45, 0.45, 0.45),
    )


def _view(tabletop: Tabletop, recording: TrialRecording) -> View:
    """From the side of the opening, so near that everything that matters just fits."""
    axis = np.array([math.cos(recording.angle), math.sin(recording.angle)])
    across = np.array([-axis[1], axis[0]])
    # From the side of the scene's own camera, which looks along the world's y.
    across = -across if across[1] > 0 else across
    level = math.cos(_ASIDE_RAD) * across + math.sin(_ASIDE_RAD) * axis
    back = np.append(math.cos(_ELEVATION_RAD) * level, math.sin(_ELEVATION_RAD))
    x = np.array([-level[1], level[0], 0.0])
    rotation = np.column_stack([x, np.cross(-back, x), -back])
    focal = WIDTH_PX / 2 / math.tan(_FIELD_OF_VIEW_RAD / 2)
    camera = Camera(focal, focal, (WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2, WIDTH_PX, HEIGHT_PX)
    return View(camera, RigidTransform(rotation, _eye(_seen(tabletop, recording), rotation, focal)))


def _seen(tabletop: Tabletop, recording: TrialRecording) -> Floats:
    """(N, 3) points that must be in the picture."""
    frame, points = _grasp_frame(recording), []
    for moment in (0, len(recording) - 1):
        for index, placed in enumerate(tabletop.objects):
            vertices = recording.T_world_object(moment, index).apply(placed.model.vertices)
            away = np.linalg.norm(vertices[:, :2] - recording.center_m, axis=1)
            points.append(vertices[away < _NEAR_M])
        tip = float(recording.tips_m[moment])
        fingers = [
            (place, 0.0, z)
            for place in recording.finger_places_m[0].tolist()
            for z in (tip, tip + _FINGER_SEEN_M)
        ]
        points.append(frame.apply(np.array(fingers)))
    return np.concatenate(points)


def _eye(points: Floats, rotation: Floats, focal: float) -> Floats:
    """Where the camera stands so that all points just fit."""
    seen = points @ rotation
    half = np.array([WIDTH_PX, HEIGHT_PX]) / 2 / focal / _MARGIN
    # A point p fits where |p_k - e_k| <= half_k (p_z - e_z) for the eye e and k = x, y: the least
    # of p_k + half_k p_z and the greatest of p_k - half_k p_z bound the eye from both sides.
    below = (seen[:, :2] + half * seen[:, 2:]).min(axis=0)
    above = (seen[:, :2] - half * seen[:, 2:]).max(axis=0)
    nearest = ((below - above) / (2 * half)).min()
    return np.asarray(rotation @ np.append((below + above) / 2, nearest))
