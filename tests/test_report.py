"""The report: every number is the summary's, nothing is loaded from elsewhere, and it fits."""

from __future__ import annotations

import copy
import html
import json
import re
import shutil
import subprocess
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap import cli
from graspmap.data import read_scenes
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.evaluation import TrialPlan, evaluate_detector, try_grasps
from graspmap.evaluation.report.gallery import Exhibit, choose_scenes, make_gallery
from graspmap.evaluation.report.numbers import NOTHING, Numbers, as_text, key_of
from graspmap.evaluation.report.page import write_report
from graspmap.geometry.affine import translation
from graspmap.geometry.grasps import Grasps
from graspmap.inference import WeightsCard, save_weights
from graspmap.maps.grasp_maps import GraspMaps
from graspmap.networks import make_network
from graspmap.simulation.shake import Shake
from graspmap.simulation.trial import Perturbation
from page_numbers import Page, check_numbers, steps_of

NASTY = "<b>&\"'x"
THRESHOLDS = ("0.25", "0.30", "0.50", "0.75")


def score(rng, trials=20):
    held = int(rng.integers(0, trials + 1))
    share = held / trials
    ends = [max(0.0, share - 0.1), min(1.0, share + 0.1)]
    return {"trials": trials, "held": held, "success": share, "interval": ends}


def rectangles(rng):
    success = dict(zip(THRESHOLDS, sorted(rng.random(4).tolist(), reverse=True), strict=True))
    interval = {t: [p - 0.04321, p + 0.01234] for t, p in success.items()}
    miou, auc = rng.random(2).tolist()
    return {"success": success, "interval": interval, "miou": miou, "auc": auc}


def best(rng):
    return {**score(rng), "robust_success": 0.321, "robust_interval": [0.21, 0.43]}


def settings():
    """Trials as a plan with everything tells them."""
    shake = Shake(acceleration_m_s2=4.5)
    plan = TrialPlan(
        top=2, jaw=0.02, shake=shake, perturbation=Perturbation(0.002, 0.035, 0.1, 0.2), repeats=9
    )
    return {**plan.to_dict(), "depth": NASTY}


def full_summary():
    """A summary with every section, and names that would break a page."""
    rng = np.random.default_rng(0)
    steps = {f"p{p}_ms": 1.234 * p for p in (50, 90, 99)} | {"mean_ms": 70.5}
    bins = [
        {"low": i / 4, "high": (i + 1) / 4, "count": 10 * i, "quality": i / 4 + 0.1 if i else None,
         "held": i / 5 if i else None, "interval": [i / 6, i / 4] if i else None}
        for i in range(4)
    ]  # fmt: skip
    cells = rng.random((7, 7)).tolist()
    cells[0][0] = None
    return {
        "data": f"jacquard:/data/{NASTY}",
        "scenes": 1234,
        "protocol": "strict",
        **rectangles(rng),
        "miou_interval": [0.4, 0.6],
        "confidence": 0.95,
        "cluster": "object",
        "without_prediction": [NASTY],
        "without_labels": ["b"],
        "per_scene": "per_scene.csv",
        "command": f"graspmap evaluate --data {NASTY}",
        "split": {"part": "test", "hash": "0123456789abcdef"},
        "detector": {"kind": "weights", "file": NASTY, "network": "ggcnn2", "channels": "depth",
                     "bins": 3, "size": 320, "parameters": 66676, "multiply_adds": 1234567890,
                     "sha256": "ab" * 32},
        "max_angle_deg": 30,
        "curve": {"thresholds": [0.0, 0.5, 1.0], "success": [1.0, 0.4, 0.0]},
        "angles": {"5": 0.123, "30": 0.456},
        "top": {k: rectangles(rng) for k in ("1", "2")},
        "protocols": {k: rectangles(rng) for k in ("strict", "ggcnn", "orange")},
        "quirks": [{"name": NASTY, "summary": NASTY, "success": 0.7, "change": -0.0123,
                    "interval": [-0.03, 0.002]}],
        "baselines": {
            "centre": {"summary": NASTY, **rectangles(rng)},
            "moments": {**rectangles(rng), "trials": {**score(rng), "best": best(rng)}},
        },
        "trials": {
            **score(rng, 500), "scenes": 250, "grippers": ["franka"], "object_mean": 0.5,
            "outcomes": {"held": 300, "slipped": 200}, "robust_success": 0.456,
            "robust_interval": [0.4, 0.5], "best": best(rng), "settings": settings(),
            "skipped": {"a": NASTY}, "seconds": 1234.56,
            "per_object": {f"{NASTY}.{i}": score(rng) for i in range(12)},
            "per_rank": {str(i): score(rng) for i in range(2)},
            "one_of_first": {str(i + 1): score(rng) for i in range(2)},
            "per_difficulty": {k: score(rng) for k in ("easy", "medium", "hard")},
            "per_family": {k: score(rng) for k in ("blob", "shell")},
        },
        "calibration": {"trials": 500, "ece": 0.0321, "ece_interval": [0.02, 0.05], "brier": 0.2,
                        "brier_interval": [0.1, 0.3], "reliability": 0.011, "resolution": 0.022,
                        "uncertainty": 0.24, "within_bins": -0.003, "base_rate": 0.6, "bins": bins},
        "tasks": {
            "saliency": {"pictures": 9, "mae": 0.0512, "mae_interval": [0.04, 0.06],
                         "f_measure": 0.9, "f_measure_interval": None, "f_mean": None,
                         "precision": [0.1, 0.5, 0.9], "recall": [1.0, 0.8, 0.1]},
            "depth": {"mae_m": 0.0123, "mae_m_interval": [0.01, 0.02], "within_1_25": 0.987},
            "category": {"accuracy": 0.7, "accuracy_interval": [0.6, 0.8], "majority": 0.4,
                         "classes": ["mug", NASTY], "confusion": [[5, 1], [2, 7]],
                         "precision": [0.71, 0.88], "recall": [None, 0.78]},
        },
        "speed": {"network": "ggcnn2", "parameters": 66676, "multiply_adds": 1234567890,
                  "device": "cpu", "picture": {"id": "a", "width": 640, "height": 480},
                  "settings": [{"backend": "torch", "threads": 2, "gripper": None, "top": 1,
                                "repeats": 100, "prepare": steps, "forward": steps,
                                "decode": steps, "total": steps}]},
        "egad": {
            **score(rng, 960), "meshes": "/egad", "gripper": "franka", "depth": "stereo",
            "trials_per_object": 20, "objects": 48, "size_px": 512, "distance_m": [0.475, 0.525],
            "one_of_first": {k: score(rng) for k in ("1", "2")},
            "outcomes": {"held": 500, "empty": 460},
            "candidates": {"trials": 9999, "held": 1234, "success": 0.1234},
            "ceiling": score(rng, 960), "robust_success": 0.3, "robust_interval": [0.2, 0.4],
            "per_object": {f"A{i}": {**score(rng), "ceiling": score(rng)} for i in range(1, 3)},
            "grid": {"rows": list("ABCDEFG"), "columns": list("0123456"), "success": cells,
                     "ceiling": cells, "row_means": rng.random(7).tolist(),
                     "row_intervals": [[0.1, 0.2]] * 7, "column_means": rng.random(7).tolist(),
                     "column_intervals": [[0.3, 0.4]] * 7, "mean": 0.5, "missing": ["A0"],
                     "outside": [NASTY]},
            "published": [{"name": "thesis", "success": 0.77, "trials": 980, "source": "Fig. 5.7"}],
            "broken": {"B0": NASTY}, "skipped": {}, "seconds": 99.9,
        },
    }  # fmt: skip


UNSEEN = re.compile(
    r"curve\.|tasks\.saliency\.(precision|recall)|tasks\.category\.confusion"
    r"|top\..*\.(miou|auc)|baselines\.moments\.trials\.(best\.)?(trials|held)"
    r"|baselines\.moments\.trials\.(success|interval)|trials\.settings\.shake\.[^a]"
    r"|egad\.one_of_first\.\"1\""
    r"|egad\.grid\.(success|ceiling)|egad\.per_object\..*\.ceiling\.(trials|held|interval)"
)
"""What is drawn and not written, or of which a page shows a part."""


def leaves(value, *path):
    """Paths of all numbers in a summary."""
    if isinstance(value, dict):
        return [leaf for k, v in value.items() for leaf in leaves(v, *path, k)]
    if isinstance(value, list):
        return [leaf for i, v in enumerate(value) for leaf in leaves(v, *path, i)]
    return [path] if isinstance(value, int | float) else []


@pytest.fixture(scope="module")
def gallery():
    rng = np.random.default_rng(0)
    pictures = {
        f"picture {i}": rng.integers(0, 255, (40 + i, 50, 3), dtype=np.uint8) for i in range(5)
    }
    numbers = {"overlap": 0.123456, "quality": None}
    return [
        Exhibit(NASTY, "best", f"Right {NASTY}", numbers, pictures, b"RIFF"),
        Exhibit("b", "worst", "Wrong.", numbers, dict(list(pictures.items())[:2])),
    ]


@pytest.fixture(scope="module")
def written(tmp_path_factory, gallery):
    folder = tmp_path_factory.mktemp("report")
    return write_report(folder, full_summary(), gallery)


def test_every_number_is_the_summarys_and_none_is_left_out(written, gallery):
    page = Page(written.read_text())
    summary = {**full_summary(), "gallery": [exhibit.to_dict() for exhibit in gallery]}
    check_numbers(page, summary)
    shown = {key for key, _, _ in page.shown}
    missing = [key_of(*path) for path in leaves(summary) if key_of(*path) not in shown]
    assert not [key for key in missing if not UNSEEN.match(key)]


def test_a_page_of_other_numbers_is_noticed(written, gallery):
    page = Page(written.read_text())
    other = copy.deepcopy(full_summary())
    other["gallery"] = [exhibit.to_dict() for exhibit in gallery]
    other["trials"]["per_object"][f"{NASTY}.3"]["held"] += 1
    with pytest.raises(AssertionError, match="per_object"):
        check_numbers(page, other)


def test_the_page_needs_nothing_but_itself(written):
    text = written.read_text()
    for address in Page(text).addresses:
        assert address.startswith(("data:", "#")), address
    assert "<script" not in text
    assert not re.search(r"url\((?!#)|@import", text)


def test_what_others_wrote_is_text(written):
    text = written.read_text()
    assert NASTY not in text
    assert html.escape(NASTY, quote=False) in html.unescape(text).replace(
        NASTY, html.escape(NASTY, quote=False)
    )
    words = " ".join(Page(text).words)
    assert words.count(NASTY) >= 5  # data, weights, quirk, object, scene


def test_what_counts_all_grasps_and_what_the_best_is_said(tmp_path):
    summary = full_summary()
    page = write_report(tmp_path / "a", summary).read_text()
    cards = page[page.index('class="cards"') : page.index("<section")]
    assert 'data-key="trials.best.success"' in cards
    assert 'data-key="trials.best.robust_success"' in cards
    assert 'data-key="trials.success"' not in cards
    assert "The best of each scene alone is what counts above" in cards
    assert "What needs no learning" in page
    assert 'data-key="baselines.moments.trials.best.success"' in page
    # A report of one grasp a scene, made before the best were scored apart.
    for trials in (summary["trials"], summary["baselines"]["moments"]["trials"]):
        trials.pop("best")
    summary["trials"]["per_rank"] = {"0": summary["trials"]["per_rank"]["0"]}
    del summary["trials"]["settings"]
    old = write_report(tmp_path / "b", summary).read_text()
    check_numbers(Page(old), {**summary, "gallery": []})
    assert 'data-key="trials.robust_success"' in old
    assert 'data-key="baselines.moments.trials.success"' in old
    assert "counts above" not in old


def test_every_object_only_where_that_is_more(tmp_path):
    summary = full_summary()
    objects = {f"o{i}": {"trials": 2, "held": 1, "success": 0.5, "interval": [0.1, 0.9]}
               for i in range(10)}  # fmt: skip
    summary["trials"]["per_object"] = objects
    del summary["egad"]
    assert "Every object" not in write_report(tmp_path, summary).read_text()
    objects["o3"] |= {"held": 2, "success": 1.0}
    assert "Every object" in write_report(tmp_path, summary).read_text()


def test_objects_outside_the_grid_of_egad(tmp_path):
    summary = full_summary()
    page = write_report(tmp_path, summary).read_text()
    assert "1 object has no place in the grid" in page
    summary["egad"]["grid"] = None
    page = write_report(tmp_path, summary).read_text()
    assert "so there is no grid" in page
    assert "Rows and columns" not in page


def test_the_heat_map_says_the_grid(written):
    svg = re.search(r'<section id="egad">.*?</svg>', written.read_text(), re.DOTALL)[0]
    said = [t for t in re.findall(r">([^<]*)</text>", svg) if t.isdigit()]
    cells = [v for row in full_summary()["egad"]["grid"]["success"] for v in row if v is not None]
    percents = [f"{100 * v:.0f}" for v in cells]
    remaining = iter(said)
    assert all(any(p == s for s in remaining) for p in percents)  # in this order, means between


def test_the_same_summary_gives_the_same_bytes(written, tmp_path, gallery):
    again = write_report(tmp_path / "a", full_summary(), gallery)
    assert again.read_bytes() == written.read_bytes()


@pytest.mark.parametrize(
    "keys",
    [
        # What a predictions file without trials gives; and EGAD alone.
        ("data", "scenes", "protocol", "success", "interval", "miou", "miou_interval", "auc",
         "confidence", "cluster", "max_angle_deg", "without_prediction", "without_labels"),
        ("egad",),
        ("egad", "detector", "speed"),
    ],
)  # fmt: skip
def test_what_a_summary_lacks_is_left_out(tmp_path, keys):
    summary = {k: v for k, v in full_summary().items() if k in keys}
    page = Page(write_report(tmp_path, summary).read_text())
    check_numbers(page, summary)
    assert {steps_of(key)[0] for key, _, _ in page.shown} <= set(keys)


def test_the_page_of_the_command_says_what_its_json_says(generated, tmp_path, capsys):
    weights = tmp_path / "w.safetensors"
    card = WeightsCard(network="ggcnn2", channels="depth", size=64, width_scale_px=30.0)
    save_weights(weights, make_network("ggcnn2", 1, 1), card)
    data = ["--data", f"jacquard:{generated}", "--weights", str(weights)]
    assert cli.main(["evaluate", *data, "--top", "2", "--out", str(tmp_path / "out")]) == 0
    assert "report.html" in capsys.readouterr().out
    summary = json.loads((tmp_path / "out/evaluation.json").read_text())
    assert len(summary["gallery"]) == 3
    page = Page((tmp_path / "out/report.html").read_text())
    check_numbers(page, summary)
    assert {'success."0.25"', "miou", "gallery[0].overlap"} <= {k for k, _, _ in page.shown}


def test_it_fits_a_laptop_and_a_phone_without_a_complaint(written, tmp_path):
    names = ("chromium", "chromium-browser", "google-chrome", "chrome")
    browser = next(filter(None, map(shutil.which, names)), None)
    if browser is None:
        pytest.skip("no Chromium on this machine")
    page = html.escape(written.read_text().replace("<details>", "<details open>"))
    frames = "".join(
        f'<iframe style="width:{width}px;height:800px;border:0" srcdoc="{page}"></iframe>'
        for width in (1366, 390)
    )
    # A window of Chromium is at least 500 px wide; a frame in it can be narrower.
    measure = """<script>onload = () => {
      const found = [...document.querySelectorAll("iframe")].map(frame => {
        const root = frame.contentDocument.documentElement;
        return [root.clientWidth, root.scrollWidth, root.querySelectorAll("section").length];
      });
      document.body.innerHTML = "";
      document.body.dataset.found = JSON.stringify(found);
    }</script>"""
    file = tmp_path / "frames.html"
    file.write_text(f"<!DOCTYPE html><body>{frames}{measure}</body>")
    words = ["--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0"]
    done = subprocess.run(
        [browser, *words, f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", file.as_uri()],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    (found,) = re.findall(r'data-found="([^"]*)"', done.stdout)
    for (inner, needed, sections), width in zip(json.loads(found), (1366, 390), strict=True):
        assert width - 20 <= inner <= width
        assert needed <= inner
        assert sections == 9
    assert "CONSOLE" not in done.stderr, done.stderr


# --- numbers ----------------------------------------------------------------------------------

NAMES = st.text(max_size=5) | st.sampled_from(["0.25", "a.b", 'q"', "per_scene", "[0]"])


@given(st.lists(NAMES | st.integers(0, 99), min_size=1, max_size=4))
def test_a_key_leads_back_to_its_steps(steps):
    assert steps_of(key_of(*steps)) == steps


@given(st.floats(-2, 2))
def test_a_number_is_written_as_well_as_its_digits_can(value):
    assert float(as_text("share", value).rstrip("%")) / 100 == pytest.approx(value, abs=0.00051)
    assert float(as_text("number", value)) == pytest.approx(value, abs=0.00051)


def test_odd_numbers():
    assert as_text("share", None) == as_text("share", float("nan")) == NOTHING
    assert as_text("number", float("-inf")) == "-∞"
    assert as_text("change", 0.0123) == "+1.2 points"
    assert Numbers({"a": [1]}).get("a", 3) is None
    assert Numbers({"a": 1}).get("a", "b") is None
    with pytest.raises(UnknownNameError, match="did you mean 'share'"):
        as_text("shar", 1.0)


# --- gallery ----------------------------------------------------------------------------------


def result(name, iou, quality=0.5, object_id=None):
    grasp = Grasps([[5, 5]], [0], [4], [2], [quality])
    return SimpleNamespace(id=name, object_id=object_id, iou=iou, grasp=grasp)


@given(
    st.lists(st.tuples(st.sampled_from([0.0, 0.2, 0.6, 0.9]), st.sampled_from("ab")), max_size=20),
    st.integers(1, 4),
)
def test_choice_of_scenes(drawn, each):
    results = [result(f"s{i}", iou, object_id=name) for i, (iou, name) in enumerate(drawn)]
    chosen = choose_scenes(results, {}, each=each, seed=1)
    kinds = {why: [r for r, w in chosen if w == why] for why in ("best", "worst", "random")}
    names = [r.id for r, _ in chosen]
    assert len(set(names)) == len(names)
    assert len(kinds["best"]) == min(each, len(results))
    assert all(len(found) <= each for found in kinds.values())
    assert len(names) >= min(2 * each, len(results))
    if results:
        assert kinds["best"][0].iou == max(r.iou for r in results)
    if kinds["worst"]:
        others = [r.iou for r in results if r not in kinds["best"]]
        assert kinds["worst"][0].iou == min(others)
    if len(kinds["best"]) > 1 and len({r.object_id for r in results}) > 1:
        assert len({r.object_id for r in kinds["best"]}) > 1


def test_trials_come_before_overlap_and_sure_failures_first():
    results = [result("a", 0.9), result("b", 0.1), result("c", 0.0, 0.2), result("d", 0.0, 0.9)]
    ends = {"a": "empty", "b": "held", "c": "empty", "d": "held"}
    tried = {name: SimpleNamespace(outcome=outcome) for name, outcome in ends.items()}
    assert choose_scenes(results, tried, each=1)[0][0].id == "b"
    found = choose_scenes(results, {}, each=1)
    assert [(r.id, why) for r, why in found][:2] == [("a", "best"), ("d", "worst")]
    with pytest.raises(InvalidInputError, match="scenes of each kind"):
        choose_scenes(results, {}, each=0)


class Oracle:
    """Says the first label, with maps as a network of ours has them."""

    def __init__(self, scenes):
        self.labels = {scene.rgb.tobytes(): scene.grasps for scene in scenes}

    def detect(self, rgb, _depth, *, top, method):  # noqa: ARG002
        maps = GraspMaps(*np.random.default_rng(0).random((4, 1, 32, 32), dtype=np.float32))
        scale = np.diag([32 / 128, 32 / 128, 1.0])
        return SimpleNamespace(grasps=self.labels[rgb.tobytes()][:top], maps=maps, matrix=scale)


def test_another_grasp_that_was_tried_is_said_and_drawn(generated):
    scenes = read_scenes(f"jacquard:{generated}")
    evaluation = evaluate_detector(Oracle(scenes), scenes, jaw="given")
    measured = {r.id: r.grasp for r in evaluation.results}
    first, second, third = measured
    beside = measured[second].transformed(translation(6.0, 0.0))
    turned = measured[first].replace(
        angle=measured[first].angle + np.pi, width=measured[first].width + 5.0
    )
    grasps = {first: turned, second: beside, third: Grasps.empty()}
    trials = try_grasps(grasps, scenes, TrialPlan(), workers=1)
    shown = {e.scene: e for e in make_gallery(evaluation, scenes, trials=trials, each=1)}
    assert "cannot open" not in shown[first].words  # half a turn, with clearance: the same grasp
    assert "The gripper cannot open that wide; its next grasp was tried: " in shown[second].words
    assert shown[third].words.endswith("open that wide, and there is no other grasp to try.")

    def yellow(exhibit):
        picture = exhibit.pictures["labels and detection"].astype(int)
        return (np.abs(picture - (255, 190, 0)).max(axis=-1) < 12).sum()

    assert yellow(shown[second]) > 100
    assert yellow(shown[second]) > 5 * max(yellow(shown[first]), yellow(shown[third]))
    assert make_gallery(evaluation, scenes, each=1)[0].words == "Right at IoU 0.25."


def test_a_gallery_of_generated_scenes(generated):
    scenes = read_scenes(f"jacquard:{generated}")
    detector = Oracle(scenes)
    evaluation = evaluate_detector(detector, scenes, jaw="given")
    grasps = {evaluation.results[0].id: evaluation.results[0].grasp}
    trials = try_grasps(grasps, scenes.subset(list(grasps)), TrialPlan(), workers=1)
    exhibits = make_gallery(evaluation, scenes, detector=detector, trials=trials, each=1)
    assert [exhibit.why for exhibit in exhibits] == ["best", "worst", "random"]
    assert {exhibit.scene for exhibit in exhibits} == set(scenes.ids)
    for exhibit in exhibits:
        assert exhibit.numbers["overlap"] == pytest.approx(1)
        assert exhibit.words.startswith("Right at IoU 0.25.")
        assert len(exhibit.pictures) == 5
        assert {max(picture.shape) for picture in exhibit.pictures.values()} == {360}
    (filmed,) = (exhibit for exhibit in exhibits if exhibit.film is not None)
    assert filmed.scene in grasps
    assert "trial" in filmed.words
    frames = cv2.imdecodeanimation(np.frombuffer(filmed.film, np.uint8)[None])[1].frames
    assert len(frames) > 10
    plain = make_gallery(evaluation, scenes, each=1)
    assert [len(exhibit.pictures) for exhibit in plain] == [2, 2, 2]
