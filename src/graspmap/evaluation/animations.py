"""Films of trials: some grasps of each outcome, as small animated pictures."""

from __future__ import annotations

import re
from pathlib import Path

from graspmap.data.scene import Scenes
from graspmap.errors import InvalidInputError
from graspmap.evaluation.film import film_trial
from graspmap.evaluation.judge import Progress
from graspmap.evaluation.tabletops import scene_world
from graspmap.evaluation.trial_results import Placed, TrialEvaluation, TriedGrasp
from graspmap.files import write_bytes
from graspmap.pictures.animation import captioned, encode_animation
from graspmap.pictures.draw import Color
from graspmap.simulation.recording import record_trial

_HELD: Color = (20, 120, 40)
_FAILED: Color = (190, 40, 20)


def animate_trials(
    evaluation: TrialEvaluation,
    scenes: Scenes,
    folder: Path | str,
    *,
    per_outcome: int = 2,
    progress: Progress | None = None,
) -> list[Path]:
    """Film some trials of each outcome, tried once more as they were.

    Args:
        evaluation: The trials.
        scenes: The scenes that they were made on.
        folder: Where ``<outcome>_<scene>_<rank>.webp`` are written; made if needed.
        per_outcome: How many films of each outcome, of different objects where there are.
        progress: Called after each film.

    Returns:
        The files, the commonest outcome first.

    Raises:
        InvalidInputError: ``per_outcome`` is below 1, or the scenes are others.
        StorageFullError: The disk is full.
        FileError: The folder cannot be written to.
    """
    if per_outcome < 1:
        raise InvalidInputError("films of each outcome", per_outcome, "1 or more")
    chosen = [
        (tried, tried.placed)
        for outcome in evaluation.score.outcomes
        for tried in choose(evaluation, outcome, per_outcome)
        if tried.placed is not None
    ]
    files = []
    for number, (tried, placed) in enumerate(chosen, start=1):
        name = re.sub(r"[^\w.-]", "_", tried.scene)
        path = Path(folder) / f"{tried.outcome}_{name}_{tried.rank}.webp"
        write_bytes(path, film_of(evaluation, scenes, tried, placed))
        files.append(path)
        if progress is not None:
            progress(number, len(chosen))
    return files


def choose(evaluation: TrialEvaluation, outcome: str, count: int) -> list[TriedGrasp]:
    """Some trials that ended alike: one of each object, then one of each scene, then others.

    Args:
        evaluation: The trials.
        outcome: How they ended.
        count: How many at most.
    """
    found = [tried for tried in evaluation.tried if tried.outcome == outcome]
    objects = {tried.object_id or tried.scene: tried for tried in reversed(found)}
    in_scenes = {tried.scene: tried for tried in reversed(found)}
    order = dict.fromkeys([*reversed(objects.values()), *reversed(in_scenes.values()), *found])
    return list(order)[:count]


def film_of(
    evaluation: TrialEvaluation, scenes: Scenes, tried: TriedGrasp, placed: Placed
) -> bytes:
    """A trial, made once more as it was, as an animated WebP.

    Args:
        evaluation: What it is part of.
        scenes: The scenes that it was made on.
        tried: The grasp and its outcome.
        placed: Where it was tried.
    """
    plan = evaluation.plan
    world = scene_world(scenes, scenes.index(tried.scene))
    gripper = plan.gripper_for(world)
    recording = record_trial(world.tabletop, placed.table, gripper, plan.settings_for(world))
    film = film_trial(world.tabletop, gripper, recording)
    held = tried.outcome == "held"
    frames = captioned(
        film.frames,
        f"{tried.outcome}: {tried.scene}",
        tried.reason,
        color=_HELD if held else _FAILED,
        corners=film.phases,
    )
    return encode_animation(frames, film.durations_ms)
