"""Evaluation: fake detectors whose score has a closed form, prediction files, and baselines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.data import read_predictions, read_scenes, write_predictions
from graspmap.data.files import write_rgb
from graspmap.data.scene import Scene, Scenes
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.evaluation import (
    CenterGrasp,
    center_grasp_baseline,
    evaluate_detector,
    evaluate_predictions,
    to_predictions,
)
from graspmap.evaluation.baselines import median_angle
from graspmap.geometry.affine import resize, rotation
from graspmap.geometry.grasps import Grasps, angle_difference
from graspmap.metrics import PROTOCOLS, QUIRKS, best_overlap

DEGREE = np.pi / 180
SIDE = 100


class FakeScenes(Scenes):
    """Scenes in memory; the first pixel of each picture holds its index."""

    kind = "fake"
    root = Path("nowhere")

    def __init__(self, labels: list[Grasps | None], *, objects: list[str | None] | None = None):
        self.ids = tuple(f"scene{i:03d}" for i in range(len(labels)))
        self.labels, self.objects = labels, objects or [f"object{i // 4}" for i in range(99)]
        self.opened: list[int] = []

    def read(self, index: int) -> Scene:
        self.opened.append(index)
        rgb = np.zeros((SIDE, SIDE, 3), np.uint8)
        rgb[0, 0] = index
        return Scene(self.ids[index], rgb=rgb, grasps=self.labels[index])

    def read_grasps(self, index: int) -> Grasps | None:
        return self.labels[index]

    def files(self, index: int) -> tuple[Path, ...]:  # noqa: ARG002
        return ()

    def object_id(self, index: int) -> str | None:
        return self.objects[index]


@dataclass
class Found:
    grasps: Grasps


class Cheat:
    """Knows the labels and hands out the first, changed by ``change``."""

    def __init__(self, scenes: FakeScenes, change=lambda grasps: grasps):
        self.scenes, self.change, self.methods = scenes, change, set()

    def detect(self, rgb, _depth, *, top, method) -> Found:
        self.methods.add(method)
        return Found(self.change(self.scenes.labels[int(rgb[0, 0, 0])])[:top])


class Guess:
    """A grasp of the right size and angle at a place drawn at random."""

    def __init__(self, seed: int, side: float):
        self.rng, self.side = np.random.default_rng(seed), side

    def detect(self, _rgb, _depth, **_options: Any) -> Found:
        center = self.rng.uniform(-0.5, SIDE - 0.5, (1, 2))
        return Found(Grasps(center, [0.0], [self.side], [self.side]))


def labels(rng: np.random.Generator, count: int = 3) -> Grasps:
    """Grasps twice as wide as high, as the custom for predictions has them."""
    width = rng.uniform(10, 40, count)
    return Grasps(
        rng.uniform(20, 80, (count, 2)),
        rng.uniform(-np.pi / 2, np.pi / 2, count),
        width,
        width / 2,
        rng.random(count),
    )


def fake_scenes(count: int = 12, seed: int = 0) -> FakeScenes:
    rng = np.random.default_rng(seed)
    return FakeScenes([labels(rng, 1 + i % 3) for i in range(count)])


# --- detectors --------------------------------------------------------------------------------


@pytest.mark.parametrize("jaw", ["half", "given"])
@pytest.mark.parametrize("protocol", ["strict", "ggcnn", "orange"])
def test_handing_out_the_labels_scores_all(jaw, protocol):
    scenes = fake_scenes()
    cheat = Cheat(scenes)
    got = evaluate_detector(cheat, scenes, jaw=jaw, protocol=protocol)
    assert set(got.score.success.values()) == {1.0}
    assert got.score.miou == pytest.approx(1)
    assert got.score.auc == pytest.approx(1, abs=0.011 if protocol == "orange" else 1e-12)
    assert got.scenes == 12
    assert got.without_prediction == got.without_labels == ()
    assert cheat.methods == {{"strict": "refined"}.get(protocol, protocol)}


def one_label_scenes() -> FakeScenes:
    rng = np.random.default_rng(1)
    return FakeScenes([labels(rng, 1).replace(width=40, height=20) for _ in range(10)])


@pytest.mark.parametrize("shift", [0, 5, 10, 20, 24, 23.999, 39, 50])
def test_a_shift_scores_its_closed_form(shift):
    scenes = one_label_scenes()

    def move(grasps: Grasps) -> Grasps:
        return grasps.replace(center=grasps.center + shift * grasps.axis())

    iou = max(0.0, 40 - shift) / min(40 + shift, 80)
    got = evaluate_detector(Cheat(scenes, move), scenes)
    assert got.score.miou == pytest.approx(iou, abs=1e-12)
    if shift != 24:  # exactly 0.25: rounding decides scene by scene
        assert got.score.success[0.25] == (iou > 0.25)
    else:
        assert iou == 0.25


@pytest.mark.parametrize(("turn", "right"), [(0, 1), (29.9, 1), (30, 1), (30.1, 0), (90, 0)])
def test_a_turn_of_more_than_thirty_degrees_is_wrong(turn, right):
    scenes = one_label_scenes()
    for sign in (-1, 1):
        got = evaluate_detector(
            Cheat(scenes, lambda g, s=sign: g.replace(angle=g.angle + s * turn * DEGREE)), scenes
        )
        assert got.score.success[0.25] == right
        assert (got.score.miou > 0) == right


@pytest.mark.parametrize("factor", [0.3, 0.5, 1.0, 1.9, 2.1, 5.0])
def test_a_widened_grasp_scores_its_closed_form(factor):
    """The jaw follows the opening ("half"), so the rectangle grows both ways."""
    scenes = one_label_scenes()
    wide = Cheat(scenes, lambda g: g.replace(width=g.width * factor))
    iou = min(factor**2, 1 / factor**2)
    assert evaluate_detector(wide, scenes).score.miou == pytest.approx(iou, abs=1e-12)
    given = evaluate_detector(wide, scenes, jaw="given").score.miou
    assert given == pytest.approx(min(factor, 1 / factor), abs=1e-12)


def test_grasping_at_random_scores_its_closed_form():
    """A square of side s placed evenly over a picture of side W hits another one inside it.

    Its overlap exceeds t where (1 - |u|)(1 - |v|) > c = 2 t / (1 + t), u and v being the shifts
    in units of s; that region measures 4 (1 - c + c ln c) s^2.
    """
    side, count = 20.0, 255
    center = Grasps([[49.5, 49.5]], [0.0], [side], [side])
    scenes = FakeScenes([center] * count, objects=[None] * count)
    runs = [evaluate_detector(Guess(s, side), scenes, jaw="given") for s in range(8)]
    for threshold in (0.25, 0.5):
        c = 2 * threshold / (1 + threshold)
        expected = 4 * (1 - c + c * np.log(c)) * side**2 / SIDE**2
        success = np.mean([run.score.success[threshold] for run in runs])
        error = np.sqrt(expected * (1 - expected) / (8 * count))
        assert abs(success - expected) < 3 * error


def test_a_detector_that_finds_nothing_fails_everywhere():
    scenes = fake_scenes()
    got = evaluate_detector(Cheat(scenes, lambda _: Grasps.empty()), scenes)
    assert got.score.success[0.25] == got.score.miou == 0
    assert got.without_prediction == scenes.ids
    assert [row["x"] for row in got.rows()] == [None] * 12


def test_scenes_without_labels_are_left_out_and_not_even_opened(caplog):
    scenes = fake_scenes(4)
    scenes.labels[1], scenes.labels[2] = None, Grasps.empty()
    got = evaluate_detector(Cheat(scenes), scenes)
    assert got.without_labels == ("scene001", "scene002")
    assert got.scenes == 2
    assert scenes.opened == [0, 3]
    assert "2 scenes without labels" in caplog.text


def test_no_labels_at_all():
    with pytest.raises(InvalidInputError, match="fake:nowhere is none in 2 scenes"):
        evaluate_detector(Cheat(fake_scenes()), FakeScenes([None, Grasps.empty()]))
    with pytest.raises(InvalidInputError, match="none in 0 scenes"):
        evaluate_detector(Cheat(fake_scenes()), FakeScenes([]))


def test_an_error_of_the_detector_names_the_scene():
    class Blind:
        def detect(self, *_pictures, **_options):
            raise InvalidInputError("depth", "missing", "an image")

    with pytest.raises(InvalidInputError, match="scene000 of fake:nowhere: depth is missing"):
        evaluate_detector(Blind(), fake_scenes())


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"protocol": "strickt"}, UnknownNameError),
        ({"cluster": "picture"}, InvalidInputError),
        ({"jaw": "full"}, InvalidInputError),
        ({"confidence": 95}, InvalidInputError),
        ({"thresholds": (25,)}, InvalidInputError),
    ],
)
def test_evaluation_refuses(options, error):
    scenes = fake_scenes(2)
    with pytest.raises(error):
        evaluate_detector(Cheat(scenes), scenes, **options)


def test_progress_and_reproducible_intervals():
    scenes, seen = fake_scenes(), []
    uneven = Cheat(scenes, lambda grasps: grasps.replace(width=grasps.center[:, 0]))
    first = evaluate_detector(
        uneven, scenes, progress=lambda done, total: seen.append((done, total))
    )
    assert seen == [(i + 1, 12) for i in range(12)]
    assert first.score == evaluate_detector(uneven, scenes).score
    other = evaluate_detector(uneven, scenes, seed=1).score
    assert first.score.success == other.success
    assert first.score.miou_interval != other.miou_interval


def test_intervals_by_object_are_wider():
    rng = np.random.default_rng(2)
    names = [f"object{i // 8}" for i in range(96)]
    scenes = FakeScenes([labels(rng, 1) for _ in names], objects=names)
    good = {f"object{i}" for i in range(0, 12, 2)}

    def some(grasps: Grasps) -> Grasps:
        index = next(i for i, known in enumerate(scenes.labels) if known is grasps)
        return grasps if names[index] in good else Grasps.empty()

    def size(cluster):
        got = evaluate_detector(Cheat(scenes, some), scenes, cluster=cluster)
        low, high = got.score.interval[0.25]
        return high - low

    assert size("object") > 2 * size("scene")
    scenes.objects = [None] * 96  # unknown objects are each their own
    assert size("object") == size("scene")


# --- predictions ------------------------------------------------------------------------------


def test_predictions_in_pixels_of_the_picture():
    scenes = fake_scenes()
    predictions = dict(zip(scenes.ids, scenes.labels, strict=True))
    got = evaluate_predictions(predictions, scenes)
    assert got.score.miou == pytest.approx(1)
    assert scenes.opened == []
    # Best first: only the first of several is judged.
    worse = {
        name: Grasps.concatenate([g.replace(center=0 * g.center), g])
        for name, g in predictions.items()
    }
    assert evaluate_predictions(worse, scenes).score.miou < 0.2


def test_the_jaw_of_a_prediction_counts_as_given():
    scenes = one_label_scenes()
    low = {n: g.replace(height=10) for n, g in zip(scenes.ids, scenes.labels, strict=True)}
    assert evaluate_predictions(low, scenes).score.miou == pytest.approx(0.5)
    assert evaluate_predictions(low, scenes, jaw="half").score.miou == pytest.approx(1)


def test_a_scene_without_prediction_is_a_failure():
    scenes = fake_scenes(4)
    predictions = {scenes.ids[0]: scenes.labels[0], scenes.ids[2]: Grasps.empty()}
    got = evaluate_predictions(predictions, scenes)
    assert got.score.success[0.25] == 0.25
    assert got.without_prediction == scenes.ids[1:]


def test_predictions_for_unknown_scenes_name_the_nearest():
    scenes = fake_scenes(20)
    predictions = {"scene0012": scenes.labels[0], "scene003": scenes.labels[3]}
    with pytest.raises(InvalidInputError) as caught:
        evaluate_predictions(predictions, scenes)
    assert "1 of 2" in str(caught.value)
    assert "'scene0012' (nearest: scene012)" in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(InvalidInputError, match=r": 'zzz'; allowed: ids of its 20 scenes$"):
        evaluate_predictions({"zzz": scenes.labels[0]}, scenes)


def test_predictions_of_a_whole_set_may_judge_a_part():
    scenes = fake_scenes()
    predictions = dict(zip(scenes.ids, scenes.labels, strict=True))
    part = scenes.subset(scenes.ids[:3])
    with pytest.raises(InvalidInputError, match="9 of 12 not in"):
        evaluate_predictions(predictions, part)
    got = evaluate_predictions(predictions, part, known_ids=scenes.ids)
    assert got.scenes == 3
    assert got.score.miou == pytest.approx(1)


class PngScenes(FakeScenes):
    """Jacquard by name, with pictures of another size than Jacquard's on disk."""

    kind = "jacquard"

    def __init__(self, labels, folder: Path, shape=(SIDE, SIDE), suffix=".png"):
        super().__init__(labels)
        self.path = folder / f"picture{suffix}"
        write_rgb(self.path, np.zeros((*shape, 3), np.uint8))

    def files(self, index: int) -> tuple[Path, ...]:  # noqa: ARG002
        return (self.path,)


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_predictions_for_jacquard_are_scaled_from_1024_px(tmp_path, suffix):
    rng = np.random.default_rng(3)
    scenes = PngScenes([labels(rng) for _ in range(5)], tmp_path, suffix=suffix)
    large = [g.transformed(resize(1024 / SIDE)) for g in scenes.labels]
    got = evaluate_predictions(dict(zip(scenes.ids, large, strict=True)), scenes)
    assert got.score.miou == pytest.approx(1)
    np.testing.assert_allclose(got.results[0].grasp.center, scenes.labels[0].center[:1])
    # Only the first bytes of a PNG are looked at; other pictures have to be read.
    assert bool(scenes.opened) == (suffix != ".png")


def test_predictions_for_jacquard_of_full_size_stay(tmp_path):
    rng = np.random.default_rng(4)
    scenes = PngScenes([labels(rng)], tmp_path, shape=(1024, 1024))
    got = evaluate_predictions({scenes.ids[0]: scenes.labels[0]}, scenes)
    assert got.results[0].grasp == scenes.labels[0][0]


def test_predictions_for_jacquard_need_square_pictures(tmp_path):
    scenes = PngScenes([labels(np.random.default_rng(5))], tmp_path, shape=(90, 100))
    with pytest.raises(InvalidInputError, match="scene000 is 100 x 90; allowed: a square"):
        evaluate_predictions({scenes.ids[0]: scenes.labels[0]}, scenes)


def test_jacquard_s_own_labels_score_all(data_dir):
    from graspmap.data import read_scenes
    from graspmap.data.jacquard import JacquardScenes

    scenes = read_scenes(f"jacquard:{data_dir / 'jacquard'}")
    assert isinstance(scenes, JacquardScenes)
    predictions = {name: scenes.read_grasps(i) for i, name in enumerate(scenes.ids)}
    got = evaluate_predictions(predictions, scenes)
    assert got.scenes == len(scenes)
    assert got.score.success[0.75] == 1
    assert got.score.miou == pytest.approx(1)
    turned = {n: g[:1].replace(angle=g.angle[:1] + np.pi / 2) for n, g in predictions.items()}
    assert evaluate_predictions(turned, scenes).score.success[0.25] < 0.3


def test_predictions_through_a_file_of_the_server_s_format(data_dir, tmp_path):
    from graspmap.data import read_predictions, read_scenes, write_predictions

    scenes = read_scenes(f"jacquard:{data_dir / 'jacquard'}")
    predictions = {name: scenes.read_grasps(i)[:1] for i, name in enumerate(scenes.ids)}
    write_predictions(tmp_path / "predictions.txt", predictions, size_px=1024)
    got = evaluate_predictions(read_predictions(tmp_path / "predictions.txt"), scenes)
    assert got.score.miou == pytest.approx(1, abs=5e-3)  # two decimals


# --- baselines --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["jacquard", "cornell"])
def test_what_a_detector_said_goes_through_a_file(generated, tmp_path, kind):
    scenes = read_scenes(f"jacquard:{generated}")
    scenes.kind = kind  # files of other kinds speak of the picture's own pixels
    said = evaluate_detector(center_grasp_baseline(scenes), scenes)
    write_predictions(tmp_path / "p.txt", to_predictions(said, scenes), size_px=1024)
    read = evaluate_predictions(read_predictions(tmp_path / "p.txt"), scenes)
    for mine, theirs in zip(said.results, read.results, strict=True):
        np.testing.assert_allclose(mine.grasp.center, theirs.grasp.center, atol=0.01)
        assert mine.iou == pytest.approx(theirs.iou, abs=0.01)


def test_center_baseline_is_the_median_at_the_centre():
    rng = np.random.default_rng(6)
    angle = (80 + rng.normal(0, 15, 200)) * DEGREE  # many beyond 90, which is -90
    grasps = Grasps(rng.uniform(0, SIDE, (200, 2)), angle, rng.uniform(10, 30, 200), np.ones(200))
    baseline = center_grasp_baseline(FakeScenes([grasps[:120], None, grasps[120:]]))
    assert baseline.width == np.median(grasps.width)
    assert angle_difference(baseline.angle, 80 * DEGREE) < 4 * DEGREE
    found = baseline.detect(np.zeros((60, 101, 3), np.uint8), None, top=3, method="refined").grasps
    assert found.center.tolist() == [[50.0, 29.5]]
    assert found.height[0] == found.width[0] / 2
    assert baseline.detect(None, np.zeros((60, 101), np.float32)).grasps == found


@given(seed=st.integers(0, 2**32), count=st.integers(1, 40), turn=st.floats(-4, 4))
def test_median_angle_is_least_far_and_turns_along(seed, count, turn):
    angle = np.random.default_rng(seed).uniform(-np.pi / 2, np.pi / 2, count)

    def distance(candidate):
        return angle_difference(candidate, angle).mean()

    best = median_angle(angle)
    # The mean distance changes by at most the turn, so half a degree of grid costs at most this.
    assert distance(best) <= min(distance(c) for c in angle) + 1 * DEGREE
    turned = Grasps(np.zeros((count, 2)), angle, np.ones(count), np.ones(count))
    turned = turned.transformed(rotation(turn)).angle
    gap = angle_difference(median_angle(turned), turned).mean() - distance(best)
    assert abs(gap) <= 1 * DEGREE


def test_center_baseline_measured():
    """Labels at the centre: the baseline finds them all; labels far away: none."""
    near = Grasps([[49.5, 49.5]], [0.3], [30], [15])
    far = near.replace(center=[[80.0, 80.0]])
    scenes = FakeScenes([near, far, near, near])
    got = evaluate_detector(center_grasp_baseline(scenes), scenes)
    assert got.score.success[0.75] == 0.75


def test_center_baseline_refuses():
    with pytest.raises(InvalidInputError, match="labels of fake:nowhere is none"):
        center_grasp_baseline(FakeScenes([None]))
    with pytest.raises(InvalidInputError):
        CenterGrasp(0.0, 10.0).detect(None, None)


# --- several protocols at once -----------------------------------------------------------------


class Pointer(FakeScenes):
    """Two bright pixels say where the one label is and which way it points."""

    def read(self, index: int) -> Scene:
        rgb = super().read(index).rgb.copy()
        grasp = self.labels[index]
        (x, y), axis = grasp.center[0].astype(int), np.round(6 * grasp.axis()[0]).astype(int)
        rgb[y, x], rgb[y + axis[1], x + axis[0]] = 255, 200
        return Scene(self.ids[index], rgb=rgb, grasps=grasp)


class Eye:
    """Sees the bright pixels of whatever picture it gets; nothing where they are out of sight."""

    def __init__(self):
        self.shapes = []

    def detect(self, rgb, _depth, *, top, method) -> Found:  # noqa: ARG002
        self.shapes.append(rgb.shape[:2])
        places = [np.argwhere(rgb[..., 0] == value) for value in (255, 200)]
        if not all(map(len, places)):
            return Found(Grasps.empty())
        (y, x), (y2, x2) = places[0][0], places[1][0]
        return Found(Grasps([[x, y]], [np.arctan2(y - y2, x2 - x)], [20.0], [10.0]))


def pointed() -> Pointer:
    rng = np.random.default_rng(4)
    turns = [-np.pi / 2, 0.0]
    found = [Grasps([rng.integers(40, 60, 2)], [turns[i % 2]], [20.0], [10.0]) for i in range(8)]
    return Pointer(found)


def test_habits_are_judged_beside_strict_on_what_each_of_them_shows():
    eye, scenes = Eye(), pointed()
    also = [*list(PROTOCOLS.values())[1:], *QUIRKS.values()]
    got = evaluate_detector(eye, scenes, also=also)
    # Right in every frame: cut out and turned pictures are taken back to the whole one.
    assert got.score.success[0.75] == 1.0
    by_name = {other.protocol.name: other.score for other in got.others}
    assert list(by_name) == [protocol.name for protocol in also]
    assert all(score.success[0.75] == 1.0 for score in by_name.values())
    summary = got.to_dict()
    assert list(summary["protocols"]) == ["strict", "ggcnn", "orange"]
    assert [quirk["name"] for quirk in summary["quirks"]] == list(QUIRKS)
    assert all(quirk["change"] == 0 for quirk in summary["quirks"])
    # Whole pictures for each of three decodings, windows, and augmented pictures: five looks.
    assert len(eye.shapes) == 5 * len(scenes)
    assert eye.shapes.count((62, 62)) >= len(scenes)  # 100 px * 300 / 480


def test_a_habit_that_helps_has_its_price():
    """A detector that sees small pictures only gains by the window, and by nothing else."""

    class Nearsighted(Eye):
        def detect(self, rgb, depth, *, top, method) -> Found:
            if len(rgb) > 90:
                return Found(Grasps([[5, 5]], [0.0], [20.0], [10.0]))
            return super().detect(rgb, depth, top=top, method=method)

    got = evaluate_detector(Nearsighted(), pointed(), also=list(QUIRKS.values())).to_dict()
    change = {quirk["name"]: quirk["change"] for quirk in got["quirks"]}
    assert got["success"]["0.25"] == 0.0
    assert change["crop about the labels"] == 1.0
    assert change["pixel overlap"] == change["plain argmax"] == 0.0
    prices = {quirk["name"]: quirk["interval"] for quirk in got["quirks"]}
    assert prices["crop about the labels"][0] > 0.3  # eight scenes


def test_protocols_are_counted_once():
    with pytest.raises(InvalidInputError, match="each of them once"):
        evaluate_detector(Eye(), pointed(), also=["ggcnn", "ggcnn"])


@given(seed=st.integers(0, 200))
def test_one_of_the_first_k_is_right_as_a_brute_force_counts(seed):
    rng = np.random.default_rng(seed)
    scenes = fake_scenes(6, seed)
    predictions = {name: labels(rng, 4) for name in scenes.ids[1:]}
    for i, name in enumerate(scenes.ids[1:], start=1):
        if rng.random() < 0.7:  # one of them is a label
            known = predictions[name]
            place = int(rng.integers(4))
            parts = [known[:place], scenes.labels[i][:1], known[place + 1 :]]
            predictions[name] = Grasps.concatenate(parts)
    got = evaluate_predictions(predictions, scenes, top=4).to_dict()
    for k in range(1, 5):
        right = 0
        for i, name in enumerate(scenes.ids):
            first = predictions.get(name, Grasps.empty())[:k]
            right += bool(len(first)) and bool((best_overlap(first, scenes.labels[i]) > 0.5).any())
        assert got["top"][str(k)]["success"]["0.50"] == pytest.approx(right / 6)
