"""Detector: pictures in, grasps out.

Letters in shapes: H rows, W columns of the picture; S side of the network's input; N grasps.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from graspmap.data.images import check_depth_m, to_input, warp
from graspmap.data.windows import close_up_m, input_window, shown_table
from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.gripper import Gripper
from graspmap.inference.locate import fitted, locate, with_jaw
from graspmap.inference.request import (
    allowed_pixels,
    bounds,
    check_pictures,
    check_region,
    check_request,
)
from graspmap.inference.shipped import default_weights, weights_path
from graspmap.inference.weights import WeightsCard, load_weights, weights_hash
from graspmap.maps.find import find_grasps
from graspmap.maps.grasp_maps import GraspMaps
from graspmap.networks import GraspNetwork, multiply_adds, parameter_count

BACKENDS = ("torch",)
_LOG = logging.getLogger(__name__)
_ASSUMED_VIEW_RAD = math.radians(57)  # of the longer side: between Kinect and RealSense
_SPARE = 20
"""Grasps looked at for each one asked for, where a gripper may rule some out."""


@dataclass(frozen=True, eq=False)
class Detection:
    """What a detector says about one picture.

    Args:
        grasps: (N) grasps in pixels of the whole picture, best first. Their quality is the
            probability that they hold, where the card has a calibration, else the network's own.
        maps: (bins, S, S) grasp maps over the network's input, float32, as the network gives them.
        matrix: (3, 3) map from pixels of the picture to pixels of the input.
        position_m: (N, 3) grasp centres in the camera's frame (z forward), metres; None without
            a camera or without depth.
        width_m: (N,) openings in metres at the depth of the centres; None likewise.
    """

    grasps: Grasps
    maps: GraspMaps[NDArray[np.float32]]
    matrix: NDArray[np.float64]
    position_m: NDArray[np.float64] | None = None
    width_m: NDArray[np.float64] | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """A picture as a network takes it.

    Attributes:
        inputs: (C, S, S) float32 input of the network.
        matrix: (3, 3) map from pixels of the picture to pixels of the input.
        allowed: (S, S) where grasps may be centred.
        depth_m: (H, W) depth of the picture, metres, NaN where there is none; None without.
    """

    inputs: NDArray[np.float32]
    matrix: NDArray[np.float64]
    allowed: NDArray[np.bool_]
    depth_m: NDArray[np.floating[Any]] | None


class Detector:
    """A network with its card, ready to detect grasps in pictures of any size.

    Args:
        network: The network; it is put into evaluation mode on ``device``.
        card: What the network expects (channels, input size, width scale).
        device: A torch device, for example ``"cpu"`` or ``"cuda"``.

    Raises:
        InvalidInputError: The device is not available.
    """

    def __init__(self, network: GraspNetwork, card: WeightsCard, *, device: str = "cpu") -> None:
        try:
            if torch.device(device).type == "meta":  # PyTorch's device for shapes without numbers
                raise RuntimeError("no device that computes")
            self._network = network.eval().to(device)
        except (RuntimeError, AssertionError) as error:
            raise InvalidInputError("device", repr(device), "a torch device of this machine") from (
                error
            )
        self.card = card
        self.device = device
        self._probability = None if card.calibration is None else card.calibration.quality_map

    @classmethod
    def load(
        cls, weights: Path | str | None = None, backend: str = "torch", *, device: str = "cpu"
    ) -> Detector:
        """A detector from a weights file of graspmap.

        Args:
            weights: A ``.safetensors`` file written by training or by ``graspmap weights import``,
                or the name of weights that ship with graspmap (`graspmap weights list`); None: the
                best that ship (`default_weights`).
            backend: What runs the network; ``"torch"``.
            device: A torch device.

        Raises:
            WeightsError: The file is damaged or not of graspmap.
            MissingFileError: There is no such file.
            UnknownNameError: There is no such backend, or no weights of this name ship.
            InvalidInputError: The device is not available, or no weights ship.
        """
        if backend not in BACKENDS:
            raise UnknownNameError("backend", backend, BACKENDS)
        path = default_weights() if weights is None else weights_path(weights)
        network, card = load_weights(path)
        return cls(network, card, device=device)

    @property
    def network(self) -> GraspNetwork:
        """The network, in evaluation mode on the detector's device."""
        return self._network

    def describe(self) -> dict[str, Any]:
        """What it is and what it costs, for JSON: network, input, parameters, multiply-adds.

        Its hash is that of `graspmap.inference.weights_hash`.
        """
        card = self.card
        return {
            "network": card.network,
            "channels": card.channels,
            "bins": card.bins,
            "size": card.size,
            "parameters": parameter_count(self._network),
            "multiply_adds": multiply_adds(self._network, card.size, card.size),
            "hash": weights_hash(self._network, card),
            "calibrated": card.calibration is not None,
        }

    def predict(self, inputs: NDArray[np.float32]) -> GraspMaps[NDArray[np.float32]]:
        """Maps of prepared inputs, as the network gives them.

        Args:
            inputs: (B, C, S, S) float32, prepared by `graspmap.data.to_input`.

        Returns:
            (B, bins, S, S) float32 maps; the width is still divided by the width scale.
        """
        with torch.inference_mode():
            maps = self._network(torch.from_numpy(inputs).to(self.device))
            return GraspMaps(*(m.float().cpu().numpy() for m in maps))

    def detect(
        self,
        rgb: NDArray[np.uint8] | None = None,
        depth: NDArray[np.floating[Any]] | None = None,
        *,
        camera: Camera | None = None,
        gripper: Gripper | None = None,
        top: int = 1,
        region: Sequence[float] | None = None,
        mask: NDArray[np.bool_] | None = None,
        method: Literal["refined", "ggcnn", "orange"] = "refined",
        threshold: float | None = None,
        min_distance: float | None = None,
    ) -> Detection:
        """The best grasps of one picture: `prepare`, `predict`, `decode`.

        Args:
            rgb: (H, W, 3) uint8, red first; needed by networks that look at colour.
            depth: (H, W) metres, NaN or 0 where there is none; needed by networks that look at
                depth, and for grasps in metres.
            camera: Intrinsics of the picture; gives `position_m` and `width_m`.
            gripper: Leaves out grasps wider than it opens, gives the others some clearance (see
                `graspmap.inference.locate.fitted`) and its jaw size; needs camera and depth.
            top: How many grasps at most.
            region: (x, y, width, height) in pixels: the network looks at the square around it, one
                that sees close-ups at what stands on the table inside it; grasps are centred inside
                it.
            mask: (H, W) bool: grasps are centred where it is True; a network that sees close-ups
                looks at what it marks, where there is no region.
            method: Decoding, see `graspmap.find_grasps`. A calibration is one of ``refined``; by
                the others, quality stays the network's own.
            threshold: Least quality of a grasp; None takes the default of the decoding.
            min_distance: Least distance between two centres in pixels of the network's input;
                None takes the default of the decoding.

        Raises:
            InvalidInputError: A picture is missing or has the wrong shape or unit, the region or
                the mask leaves nothing, ``top`` is below 1.
        """
        check_request(top, depth, camera, gripper, threshold)
        prepared = self.prepare(rgb, depth, camera=camera, region=region, mask=mask)
        return self.decode(
            prepared,
            self.predict(prepared.inputs[None]).item(0),
            camera=camera,
            gripper=gripper,
            top=top,
            method=method,
            threshold=threshold,
            min_distance=min_distance,
        )

    def prepare(
        self,
        rgb: NDArray[np.uint8] | None = None,
        depth: NDArray[np.floating[Any]] | None = None,
        *,
        camera: Camera | None = None,
        region: Sequence[float] | None = None,
        mask: NDArray[np.bool_] | None = None,
    ) -> Prepared:
        """The first step of `detect`: from a picture to the network's input.

        Args:
            rgb: As in `detect`, like all of them.
            depth: Metres.
            camera: Gives the scale to networks that see a close-up; without it that of common
                depth cameras is assumed, with a warning.
            region: Where the network looks.
            mask: Where grasps are centred.

        Raises:
            InvalidInputError: As in `detect`.
        """
        shape = self._check(rgb, depth, mask, camera)
        if depth is not None and self.card.channels == "rgb" and not (depth > 0).any():
            depth = None  # nothing was measured, and nobody looks at it
        if depth is not None:
            depth = check_depth_m(depth, "the picture")
        view, size = self.card.view, self.card.size
        close_up = close_up_m(view) is not None
        if camera is None and close_up:
            camera = _assumed_camera(shape)
        where = None if region is None else check_region(region, shape)
        allowed = allowed_pixels(shape, where, mask)
        if where is None and mask is not None and close_up:
            where = bounds(mask)  # a close-up is about one thing: that of the mask
        measured = self.card.channels != "rgb" and self.card.depth_zero == "table"
        table = None
        if depth is not None and (measured or close_up):
            table = shown_table(depth, where, view=view, camera=camera)
        matrix = input_window(
            shape, size, view=view, region_xywh=where, depth_m=depth, camera=camera, table=table
        )
        inputs = to_input(
            rgb,
            depth,
            self.card.channels,
            matrix,
            size,
            depth_zero=self.card.depth_zero,
            table=table,
        )
        seen = warp(allowed, matrix, size, fill=False)
        if not seen.any():
            found = "outside what the network sees, or smaller than a pixel of it"
            raise InvalidInputError("mask and region", found, "a larger mask, or a region about it")
        return Prepared(inputs, matrix, seen, depth)

    def decode(
        self,
        prepared: Prepared,
        maps: GraspMaps[NDArray[np.float32]],
        *,
        camera: Camera | None = None,
        gripper: Gripper | None = None,
        top: int = 1,
        method: Literal["refined", "ggcnn", "orange"] = "refined",
        threshold: float | None = None,
        min_distance: float | None = None,
    ) -> Detection:
        """The last step of `detect`: from maps to grasps in the picture.

        Args:
            prepared: What `prepare` made of the picture.
            maps: (bins, S, S) what `predict` says of it.
            camera: As in `detect`, like all that follow.
            gripper: What grasps have to fit.
            top: How many.
            method: Decoding.
            threshold: Least quality.
            min_distance: Least distance of two centres.

        Raises:
            InvalidInputError: As in `detect`.
        """
        depth, matrix = prepared.depth_m, prepared.matrix
        check_request(top, depth, camera, gripper, threshold)
        probability = self._probability if method == "refined" else None
        if probability is not None and threshold is not None:
            threshold = float(probability.inverse(threshold))
        found = find_grasps(
            maps,
            top if gripper is None else top * _SPARE,
            width_scale=self.card.width_scale_px,
            method=method,
            mask=prepared.allowed,
            threshold=threshold,
            min_distance=min_distance,
        )
        if probability is not None:
            found = found.replace(quality=probability(found.quality))
        grasps = found.transformed(np.linalg.inv(matrix))
        position_m, width_m = None, None
        if camera is not None and depth is not None:
            position_m, width_m = locate(grasps, depth, camera)
            if gripper is not None:
                depths_m = position_m[:, 2]
                kept, grasps, width_m = fitted(grasps, width_m, depths_m, camera, gripper)
                grasps, position_m, width_m = grasps[:top], position_m[kept][:top], width_m[:top]
                grasps = with_jaw(grasps, position_m[:, 2], camera, gripper)
        return Detection(grasps, maps, matrix, position_m, width_m)

    def _check(
        self,
        rgb: NDArray[np.uint8] | None,
        depth: NDArray[np.floating[Any]] | None,
        mask: NDArray[np.bool_] | None,
        camera: Camera | None,
    ) -> tuple[int, int]:
        """Size (H, W) that all pictures share."""
        needed: dict[str, NDArray[Any] | None] = {}
        if self.card.channels in ("depth", "rgbd"):
            needed["depth"] = depth
        if self.card.channels in ("rgb", "rgbd"):
            needed["rgb"] = rgb
        for name, image in needed.items():
            if image is None:
                raise InvalidInputError(
                    name, "missing", f"an image: {self.card.network} sees {self.card.channels}"
                )
        check_pictures(rgb, depth, mask)
        sizes = {
            name: (int(image.shape[0]), int(image.shape[1]))
            for name, image in (("rgb", rgb), ("depth", depth), ("mask", mask))
            if image is not None
        }
        if camera is not None:
            sizes["camera"] = (camera.height, camera.width)
        if len(set(sizes.values())) != 1:
            raise InvalidInputError("sizes (rows, columns)", sizes, "equal ones")
        return next(iter(sizes.values()))


@lru_cache(maxsize=8)
def _assumed_camera(shape: tuple[int, int]) -> Camera:
    """A depth camera as they are mostly, for a picture whose own is not known; told once."""
    _LOG.warning(
        "the scale of a picture of %d x %d px is not known: a field of view of %.0f degrees is "
        "assumed; give its camera",
        *reversed(shape),
        math.degrees(_ASSUMED_VIEW_RAD),
    )
    rows, columns = shape
    camera = Camera.from_field_of_view(_ASSUMED_VIEW_RAD, max(shape), 1)
    return Camera(camera.fx, camera.fy, (columns - 1) / 2, (rows - 1) / 2, columns, rows)
