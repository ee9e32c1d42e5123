"""The detector: frames, regions, metres, and other people's weights on real pictures."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
import torch

from graspmap import Camera, Detector, GraspMaps, Grasps, draw_maps
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.gripper import load_gripper
from graspmap.inference import (
    CalibrationCard,
    WeightsCard,
    import_weights,
    save_weights,
    shipped_weights,
)
from graspmap.inference.locate import fitted, locate, with_jaw
from graspmap.networks import GraspNetwork, make_network

SIZE = 96
CAMERA = Camera(fx=400.0, fy=400.0, cx=159.5, cy=99.5, width=320, height=200)


class Oracle(GraspNetwork):
    """A network that answers with the maps of known grasps, whatever it sees."""

    name = "oracle"

    def __init__(self, grasps: Grasps) -> None:
        super().__init__(1, 1)
        self.seen: torch.Tensor | None = None
        self._maps = draw_maps(grasps, (SIZE, SIZE), quality="strong", width_scale=50.0)

    def forward(self, x):
        self.seen = x
        return GraspMaps(*(torch.from_numpy(m)[None] for m in self._maps))


def detector_of(*grasps: tuple[float, float, float, float]) -> Detector:
    rows = np.array(grasps, dtype=float)
    network = Oracle(Grasps(rows[:, :2], rows[:, 2], rows[:, 3], rows[:, 3] / 2))
    card = WeightsCard(
        network="ggcnn2", channels="depth", bins=1, size=SIZE, view="contain", width_scale_px=50.0
    )
    return Detector(network, card)


def calibrated(detector: Detector, *knots: tuple[float, float]) -> Detector:
    """The same with a calibration."""
    score = {"ece": 0.1, "ece_interval": (0.0, 0.2), "brier": 0.1, "brier_interval": (0.0, 0.2)}
    found = {
        "knots": knots, "data": "jacquard:x", "data_hash": "manifest:0", "grippers": ("jacquard",),
        "top": 1, "trials": 9, "objects": 9, "held": 5, "before": score, "after": score,
    }  # fmt: skip
    calibration = CalibrationCard.model_validate(found)
    card = detector.card.model_copy(update={"calibration": calibration})
    return Detector(detector.network, card)


def table(rows: int = 200, columns: int = 320) -> np.ndarray:
    y, x = np.mgrid[0:rows, 0:columns]
    return (0.8 + 1e-4 * x + 2e-4 * y).astype(np.float32)


def test_grasps_come_back_in_pixels_of_the_picture():
    found = detector_of((40.0, 50.0, 0.5, 20.0)).detect(depth=table())
    scale = 320 / SIZE  # the longer side fills the input, the picture sits in its middle
    expected = ((40 + 0.5) * scale - 0.5, (50 + 0.5 - SIZE / 2) * scale + 100 - 0.5)
    assert found.grasps.center[0] == pytest.approx(expected, abs=0.5 * scale)
    assert found.grasps.angle[0] == pytest.approx(0.5, abs=math.radians(1))
    assert found.grasps.width[0] == pytest.approx(20 * scale, abs=scale)
    assert found.position_m is None


def test_quality_is_the_probability_of_the_card():
    plain = detector_of((25.0, 48.0, 0.5, 20.0), (70.0, 48.0, -0.3, 9.0), (48.0, 40.0, 1.0, 5.0))
    low, high = 0.2, 0.6
    sure = calibrated(plain, (0.0, low), (1.0, high))
    before = plain.detect(depth=table(), top=3)
    found = sure.detect(depth=table(), top=3)
    assert len(found.grasps) == 3
    assert found.grasps.center.tolist() == before.grasps.center.tolist()
    assert (np.diff(before.grasps.quality) < 0).all()
    assert (np.diff(found.grasps.quality) < 0).all()
    odds = [math.log(p / (1 - p)) for p in (low, high)]
    expected = odds[0] + before.grasps.quality * (odds[1] - odds[0])
    assert found.grasps.quality == pytest.approx(1 / (1 + np.exp(-expected)), rel=1e-12)
    assert found.maps.quality.tobytes() == before.maps.quality.tobytes()
    # What asks for a quality asks for what is shown.
    first, second = found.grasps.quality[:2].tolist()
    assert len(sure.detect(depth=table(), top=3, threshold=(first + second) / 2).grasps) == 1
    assert len(sure.detect(depth=table(), top=3, threshold=1).grasps) == 0
    # The peaks of other ways to read maps are other numbers.
    for method in ("orange", "ggcnn"):
        mapped, raw = (d.detect(depth=table(), method=method).grasps for d in (sure, plain))
        assert len(raw) == 1
        assert mapped.quality.tolist() == raw.quality.tolist()


def test_a_gripper_leaves_out_what_it_cannot_open_for():
    gripper = load_gripper("franka")  # opens 8 cm
    camera = Camera(fx=400.0, fy=400.0, cx=159.5, cy=99.5, width=320, height=200)
    depth = np.full((200, 320), 0.8, np.float32)  # 1 px of the input is 6.7 mm on the table
    detector = detector_of((20.0, 48.0, 0.5, 20.0), (70.0, 48.0, -0.3, 9.0))
    free = detector.detect(depth=depth, camera=camera, top=2)
    assert sorted((free.width_m > gripper.max_opening_m).tolist()) == [False, True]
    found = detector.detect(depth=depth, camera=camera, gripper=gripper, top=2)
    assert len(found.grasps) == len(found.position_m) == len(found.width_m) == 1
    assert found.grasps.angle[0] == pytest.approx(-0.3, abs=math.radians(1))
    jaws_px = np.array(gripper.jaw_sizes_m) * camera.fx / 0.8
    assert np.abs(jaws_px - found.grasps.height[0]).min() < 1e-3


def test_a_closed_grasp_is_opened_alike_in_pixels_and_metres():
    camera, gripper = Camera(600.0, 300.0, 159.5, 99.5, 320, 200), load_gripper("franka")
    for angle in (0.0, 0.4, math.pi / 2):
        closed = Grasps([[100.0, 90.0]], [angle], [0.0], [9.0], [0.5])
        z = np.array([0.6])
        _, grasps, width_m = fitted(closed, np.zeros(1), z, camera, gripper)
        assert width_m[0] > 0
        depth = np.full((200, 320), 0.6, np.float32)
        assert locate(grasps, depth, camera)[1] == pytest.approx(width_m)


def test_the_jaw_is_as_long_as_the_grippers_whatever_the_pixels():
    """Against the ends of the jaw, deprojected."""
    camera, gripper = Camera(600.0, 300.0, 159.5, 99.5, 320, 200), load_gripper("franka")
    for angle in (0.0, 0.4, math.pi / 2):
        grasp = Grasps([[100.0, 90.0]], [angle], [20.0], [9.0], [0.5])
        found = with_jaw(grasp, np.array([0.6]), camera, gripper)
        across = found.replace(angle=[angle + math.pi / 2], width=found.height)
        depth = np.full((200, 320), 0.6, np.float32)
        length_m = locate(across, depth, camera)[1][0]
        assert np.abs(np.array(gripper.jaw_sizes_m) - length_m).min() < 1e-9


def test_a_mask_that_the_network_does_not_see_is_told():
    mask = np.zeros((200, 320), bool)
    mask[60, 100] = True  # less than a pixel of the input
    with pytest.raises(InvalidInputError, match="smaller than a pixel"):
        detector_of((20.0, 40.0, 0.0, 20.0)).detect(depth=table(), mask=mask)


def test_a_close_up_looks_at_what_is_masked():
    """Two boxes; without a mask both are seen, with one that of the mask, as of a region."""
    depth = np.full((240, 320), 0.8, np.float32)
    depth[60:80, 40:70] -= 0.04
    depth[150:170, 230:260] -= 0.04
    camera = Camera(fx=400.0, fy=400.0, cx=159.5, cy=119.5, width=320, height=240)
    detector = Detector.load("ggcnn2-depth")
    mask = np.zeros(depth.shape, bool)
    mask[60:80, 40:70] = True
    seen = detector.prepare(depth=depth, camera=camera, mask=mask)
    asked = detector.prepare(depth=depth, camera=camera, region=(40, 60, 30, 20))
    assert seen.matrix.tolist() == asked.matrix.tolist()
    assert seen.inputs.tolist() == asked.inputs.tolist()
    both = detector.prepare(depth=depth, camera=camera)
    assert not np.allclose(both.matrix, seen.matrix)
    found = detector.detect(depth=depth, camera=camera, mask=mask)
    x, y = found.grasps.center[0]
    assert 38 <= x <= 71
    assert 58 <= y <= 81


@pytest.mark.parametrize(
    ("asked_m", "given_m"), [(0.05, 0.058), (0.079, 0.08), (0.09, 0.08), (0.094, None)]
)
def test_a_gripper_opens_with_clearance_as_far_as_it_goes(asked_m, given_m):
    gripper = load_gripper("franka")
    found = Grasps([[10.0, 20.0]], [0.3], [30.0], [9.0], [0.5])
    depth_m = np.array([asked_m * 400.0 / 30.0])  # where 30 px are so wide
    kept, grasps, width_m = fitted(found, np.array([asked_m]), depth_m, CAMERA, gripper)
    if given_m is None:
        assert len(kept) == len(grasps) == len(width_m) == 0
    else:
        assert kept.tolist() == [0]
        assert width_m.tolist() == pytest.approx([given_m])
        assert grasps.width[0] == pytest.approx(30.0 * given_m / asked_m)
        assert grasps.center.tolist() == found.center.tolist()


def test_a_gripper_needs_metres():
    gripper = load_gripper("franka")
    with pytest.raises(InvalidInputError, match="camera is missing"):
        detector_of((40.0, 50.0, 0.5, 20.0)).detect(depth=table(), gripper=gripper)


def test_top_and_order():
    found = detector_of((20.0, 40.0, 0.0, 20.0), (70.0, 50.0, 1.0, 30.0)).detect(
        depth=table(), top=5
    )
    assert len(found.grasps) == 2
    assert (np.diff(found.grasps.quality) <= 0).all()


def test_region_sets_the_scale_and_keeps_centres_inside():
    detector = detector_of((48.0, 48.0, 0.0, 20.0), (90.0, 48.0, 0.0, 20.0))
    found = detector.detect(depth=table(), region=(100, 60, 48, 96), top=5)
    # The window is the 96 px square around the region: scale 1, and only the first grasp is inside.
    assert len(found.grasps) == 1
    assert found.grasps.center[0] == pytest.approx((124, 108), abs=0.6)
    assert found.grasps.width[0] == pytest.approx(20, abs=1)


def test_mask_keeps_centres_on_it():
    mask = np.zeros((200, 320), bool)
    mask[:, 200:] = True
    found = detector_of((20.0, 40.0, 0.0, 20.0), (70.0, 50.0, 1.0, 30.0)).detect(
        depth=table(), mask=mask, top=5
    )
    assert len(found.grasps) == 1
    assert found.grasps.center[0, 0] >= 199.5


def test_grasps_outside_the_picture_are_never_returned():
    # The picture is 200 of 320 rows: input row 5 lies above it.
    detector = detector_of((40.0, 5.0, 0.0, 20.0))
    assert len(detector.detect(depth=table(), threshold=0.2).grasps) == 0
    assert (detector.detect(depth=table(), top=9).grasps.center[:, 1] >= -0.5).all()


def test_metres_against_a_closed_form():
    camera = Camera(fx=400.0, fy=400.0, cx=159.5, cy=99.5, width=320, height=200)
    depth = np.full((200, 320), 0.8, np.float32)
    depth[100, 150] = np.nan
    grasps = Grasps([[150.0, 100.0]], [0.3], [50.0], [20.0])
    position, width = locate(grasps, depth, camera)
    assert position[0] == pytest.approx(
        [(150 - 159.5) * 0.8 / 400, (100 - 99.5) * 0.8 / 400, 0.8], abs=1e-7
    )
    assert width[0] == pytest.approx(50 * 0.8 / 400, abs=1e-7)


def test_one_wild_pixel_does_not_move_a_grasp():
    camera = Camera(fx=400.0, fy=400.0, cx=159.5, cy=99.5, width=320, height=200)
    depth = np.full((200, 320), 0.8, np.float32)
    depth[100, 150] = 5.0
    position, _ = locate(Grasps([[150.0, 100.0]], [0.0], [50.0], [20.0]), depth, camera)
    assert position[0, 2] == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({}, "depth"),
        ({"depth": np.zeros((20, 30, 3), np.float32)}, "shape of depth"),
        ({"depth": np.full((20, 30), 800.0)}, "depth"),
        ({"depth": np.full((20, 30), np.nan)}, "depth"),
        ({"depth": table(20, 30), "rgb": np.zeros((20, 30), np.uint8)}, "rgb"),
        ({"depth": table(20, 30), "rgb": np.zeros((21, 30, 3), np.uint8)}, "sizes"),
        ({"depth": table(20, 30), "mask": np.ones((20, 30), np.uint8)}, "mask"),
        ({"depth": table(20, 30), "mask": np.zeros((20, 30), bool)}, "mask and region"),
        ({"depth": table(20, 30), "region": (0, 0, 0, 5)}, "region"),
        ({"depth": table(20, 30), "region": (40, 0, 5, 5)}, "region"),
        ({"depth": table(20, 30), "region": (0, 0, 5)}, "region"),
        ({"depth": table(20, 30), "region": (0, 0, 1e-300, 1e-300)}, "region"),
        ({"depth": table(20, 30), "region": (0, 0, 1e9, 1e9)}, "region"),
        ({"depth": table(20, 30), "region": "1,2,3,4"}, "region"),
        ({"depth": table(20, 30), "region": 5}, "region"),
        ({"depth": table(20, 30), "top": 0}, "top"),
        ({"depth": table(20, 30), "top": math.nan}, "top"),
        ({"depth": table(20, 30), "threshold": math.nan}, "threshold"),
        ({"depth": table(20, 30), "min_distance": math.inf, "method": "ggcnn"}, "min_distance"),
        ({"depth": table(20, 30).tolist()}, "depth"),
        ({"depth": table(20, 30), "camera": {"fx": 1}}, "camera"),
        ({"depth": table(20, 30), "gripper": "franka"}, "gripper"),
    ],
)
def test_bad_input_is_named(arguments, name):
    with pytest.raises(InvalidInputError) as caught:
        detector_of((40.0, 50.0, 0.0, 20.0)).detect(**arguments)
    assert name in caught.value.name


def test_unknown_backend_and_device(tmp_path):
    card = WeightsCard(
        network="ggcnn", channels="depth", bins=1, size=64, view="contain", width_scale_px=50.0
    )
    save_weights(tmp_path / "w.safetensors", make_network("ggcnn", 1, 1), card)
    with pytest.raises(UnknownNameError):
        Detector.load(tmp_path / "w.safetensors", backend="torhc")
    with pytest.raises(InvalidInputError, match="device"):
        Detector.load(tmp_path / "w.safetensors", device="abacus")
    with pytest.raises(InvalidInputError, match="device"):
        Detector.load(tmp_path / "w.safetensors", device="meta")


def published_ggcnn2(path, x):
    """GG-CNN2 run straight from its authors' state dict, layer by layer."""
    w = torch.load(path, weights_only=True, map_location="cpu")
    f = torch.nn.functional

    def layer(name, y, **how):
        return f.conv2d(y, w[f"{name}.weight"], w[f"{name}.bias"], **how)

    y = f.relu(layer("features.0", x, padding=5))
    y = f.max_pool2d(f.relu(layer("features.2", y, padding=2)), 2)
    y = f.relu(layer("features.5", y, padding=2))
    y = f.max_pool2d(f.relu(layer("features.7", y, padding=2)), 2)
    y = f.relu(layer("features.10", y, dilation=2, padding=4))
    y = f.relu(layer("features.12", y, dilation=4, padding=8))
    for name in ("features.15", "features.18"):  # these authors upsample instead of transposing
        y = f.interpolate(y, scale_factor=2, mode="bilinear", align_corners=True)
        y = f.relu(layer(name, y, padding=1))
    return {name: layer(f"{name}_output", y).numpy()[0] for name in ("pos", "cos", "sin", "width")}


@pytest.fixture(scope="session")
def published(data_dir):
    path = data_dir / "weights" / "ggcnn" / "ggcnn2_epoch_50_cornell_statedict.pt"
    if not path.exists():
        pytest.skip(f"no published GG-CNN2 weights at {path}")
    return path


REGION = (130, 150, 300, 300)  # on the table; the room around it is full of other things


@pytest.mark.parametrize("scene", ["0100", "0101"])
@pytest.mark.parametrize("weights", ["published", *shipped_weights()])
def test_weights_grasp_the_remote_control(data_dir, published, weights, scene):
    """The depth of these pictures is the range from a robot's base: the table looks like a bowl."""
    if weights == "published":
        detector = Detector(*import_weights("ggcnn2", published))
    else:
        detector = Detector.load(weights)
    raw = data_dir / "cornell-raw"
    rgb = cv2.cvtColor(cv2.imread(str(raw / f"pcd{scene}r.png")), cv2.COLOR_BGR2RGB)
    depth = cv2.imread(str(raw / f"pcd{scene}d.tiff"), cv2.IMREAD_UNCHANGED)
    found = detector.detect(rgb, depth, region=REGION)

    x, y, w, h = REGION
    dark = np.zeros(rgb.shape[:2], np.uint8)
    dark[y : y + h, x : x + w] = rgb[y : y + h, x : x + w].max(axis=2) < 90
    points = np.argwhere(dark)[:, ::-1].astype(np.float32)
    (cx, cy), (side_a, side_b), turn = cv2.minAreaRect(points)
    long_side = math.radians(turn if side_a > side_b else turn + 90)
    along = np.array([math.cos(long_side), math.sin(long_side)])
    offset = found.grasps.center[0] - (cx, cy)
    assert abs(offset @ along) < max(side_a, side_b) / 2
    assert abs(offset @ (-along[1], along[0])) < min(side_a, side_b) / 2
    # Across: the opening runs over the short side.
    assert abs(found.grasps.axis()[0] @ along) < math.sin(math.radians(25))
    assert found.grasps.width[0] > min(side_a, side_b) * 0.8


def test_published_weights_give_the_same_maps_as_an_independent_loading(published):
    network, _ = import_weights("ggcnn2", published)
    x = torch.randn(1, 1, 300, 300, generator=torch.Generator().manual_seed(0)).clamp(-1, 1)
    with torch.inference_mode():
        ours = network.eval()(x)
        theirs = published_ggcnn2(published, x)
    for mine, name in zip(ours, ("pos", "cos", "sin", "width"), strict=True):
        np.testing.assert_allclose(mine.numpy()[0], theirs[name], atol=1e-5)
