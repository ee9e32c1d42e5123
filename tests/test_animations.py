"""Films of trials: what they show, and that others can play them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from graspmap.data import read_scenes
from graspmap.errors import InvalidInputError
from graspmap.evaluation import TrialPlan, animate_trials, try_grasps
from graspmap.evaluation.animations import choose
from graspmap.evaluation.film import HEIGHT_PX, WIDTH_PX, film_trial, moments
from graspmap.evaluation.tabletops import scene_world
from graspmap.geometry import Grasps
from graspmap.gripper import load_gripper
from graspmap.pictures.animation import captioned, encode_animation
from graspmap.simulation.recording import record_trial


def frame(value, shape=(40, 60)):
    return np.full((*shape, 3), value, np.uint8)


def decode(content):
    ok, film = cv2.imdecodeanimation(np.frombuffer(content, np.uint8)[None])
    assert ok
    return [cv2.cvtColor(f, cv2.COLOR_BGRA2RGB) for f in film.frames], film.durations.tolist()


def test_frames_come_back_in_order_and_time():
    frames = [frame(v) for v in (10, 120, 240)]
    frames[1][:, :30] = (250, 0, 0)  # red first
    shown, durations = decode(encode_animation(frames, [100, 50, 700]))
    assert durations == [100, 50, 700]
    for given, found in zip(frames, shown, strict=True):
        assert np.abs(given.astype(int) - found)[:, 5:25].max() <= 12
        assert np.abs(given.astype(int) - found)[:, 35:55].max() <= 12


@pytest.mark.parametrize(
    ("frames", "durations", "part"),
    [
        ([], [], "0 for 0"),
        ([frame(0)], [1, 2], "2 for 1"),
        ([frame(0)], [0], "above 0"),
        ([frame(0), frame(0, (41, 60))], [1, 1], "one size"),
        ([np.zeros((4, 4), np.uint8)], [1], "frame"),
    ],
)
def test_what_is_no_film_is_refused(frames, durations, part):
    with pytest.raises(InvalidInputError, match=part):
        encode_animation(frames, durations)


def test_captions():
    frames = [frame(90, (80, 200)), frame(200, (80, 200))]
    words = "word " * 60
    shown = captioned(frames, "title " * 20, words, corners=["a", "b"])
    heights = {f.shape for f in shown}
    assert len(heights) == 1
    assert shown[0].shape[0] > 80
    assert shown[0].shape[1] == 200
    assert (shown[0][80:] == shown[1][80:]).all()
    assert (shown[0][80:] != 255).any()
    assert (shown[0][30:80] == 90).all()  # the picture itself is left alone
    assert (shown[0][:30] != 90).any()  # but for its corner
    assert (captioned(frames, "", "")[0][80:] == 255).all()
    with pytest.raises(InvalidInputError, match="one each"):
        captioned(frames, "t", "w", corners=["a"])


@pytest.fixture(scope="module")
def tried(generated):
    """Grasps that hold, grasp air, and collide."""
    scenes = read_scenes(f"jacquard:{generated}")
    scenes = scenes.subset(scenes.ids[:2])
    grasps = {}
    for scene in scenes:
        best = scene.grasps[:1]
        low = best.replace(width=[1.0])
        aside = best.replace(center=[[12.0, 12.0]])
        grasps[scene.id] = Grasps.concatenate([best, aside, low, scene.grasps[1:2]])
    # Unlike Jacquard's, Franka's fingers do not stop above what they touch.
    gripper = load_gripper("franka")
    return scenes, try_grasps(grasps, scenes, TrialPlan(gripper, top=4))


def test_some_of_each_outcome_are_filmed(tried, tmp_path):
    scenes, result = tried
    assert {"held", "empty", "collided"} <= set(result.score.outcomes)
    done = []
    folder = tmp_path / "new" / "films"
    files = animate_trials(
        result, scenes, folder, per_outcome=1, progress=lambda *step: done.append(step)
    )
    assert len(files) == len(result.score.outcomes)
    assert done == [(i + 1, len(files)) for i in range(len(files))]
    assert [f.name.split("_")[0] for f in files] == list(result.score.outcomes)
    for file in files:
        frames, durations = decode(file.read_bytes())
        assert len(frames) == len(durations) >= 10
        assert frames[0].shape[1] == WIDTH_PX
        assert frames[0].shape[0] > HEIGHT_PX
        assert (frames[0] != frames[-1]).any()
        assert 1000 < sum(durations) < 8000
        assert file.stat().st_size < 300_000
    with pytest.raises(InvalidInputError, match="films"):
        animate_trials(result, scenes, tmp_path, per_outcome=0)


def test_films_are_of_different_scenes_where_there_are(tried):
    _, result = tried
    for outcome in result.score.outcomes:
        all_of_it = [t for t in result.tried if t.outcome == outcome]
        for count in (1, 2, 3, 100):
            chosen = choose(result, outcome, count)
            assert len(chosen) == len({*map(id, chosen)}) == min(count, len(all_of_it))
            scenes = {t.scene for t in chosen}
            assert len(scenes) == min(count, len({t.scene for t in all_of_it}))


def red(picture):
    r, g, b = (picture[..., c].astype(int) for c in range(3))
    return ((r > 90) & (g < 60) & (b < 60)).sum()


def recorded(tried, outcome):
    """Tabletop, gripper and recording of a grasp that ended so."""
    scenes, result = tried
    grasp = choose(result, outcome, 1)[0]
    world = scene_world(scenes, scenes.index(grasp.scene))
    gripper = result.plan.gripper_for(world)
    recording = record_trial(world.tabletop, grasp.placed.table, gripper)
    assert recording.result.outcome == outcome
    return world.tabletop, gripper, recording


def test_fingers_that_touch_turn_red(tried):
    film = film_trial(*recorded(tried, "collided"))
    assert len(film.frames) == len(film.durations_ms) == len(film.phases)
    assert red(film.frames[0]) == red(film.frames[-2]) == 0
    assert red(film.frames[-1]) > 50


@pytest.mark.parametrize(
    ("outcome", "phases"),
    [
        ("held", ["descend", "close", "lift"]),
        ("collided", ["descend"]),
        ("empty", ["descend", "close"]),
    ],
)
def test_what_is_shown(tried, outcome, phases):
    _, gripper, recording = recorded(tried, outcome)
    shown = moments(recording, gripper)
    seen = list(dict.fromkeys(moment.phase for moment in shown))
    # What does not hang still during the lift is held for a while after it.
    assert [phase for phase in seen if phase != "hold" or outcome != "held"] == phases
    down = [moment.tips_m for moment in shown if moment.phase == "descend"]
    assert (np.diff(down) < 0).all()  # nothing jumps up on the way down
    openings = [moment.fingers_m[1] - moment.fingers_m[0] for moment in shown]
    assert openings[0] == pytest.approx(recording.result.opening_m)
    assert openings[-1] <= openings[0] + 1e-6
    if outcome == "held":
        assert shown[-1].number == len(recording) - 1
        assert shown[-1].tips_m > down[-1] + 0.05
    if outcome == "empty":
        assert openings[-1] == pytest.approx(gripper.min_opening_m, abs=1e-3)
