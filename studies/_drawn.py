"""Drawn scenes of a few shapes: something to memorise, with every kind of truth there is."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from graspmap.data import Scene
from graspmap.data.scene import Scenes
from graspmap.geometry import Grasps

SHAPES = ("bar", "disc", "ring", "cross")


class DrawnScenes(Scenes):
    """Objects of some shapes on a table, drawn from a seed; each with grasps that suit it.

    Args:
        count: Scenes.
        seed: Of the scenes.
        side: Of the pictures, pixels.
    """

    kind = "drawn"

    def __init__(self, count: int, seed: int, side: int) -> None:
        self.root = Path("drawn")
        self.count, self.seed, self.side = count, seed, side
        self.ids = tuple(f"{i:04d}" for i in range(count))

    def read(self, index: int) -> Scene:
        """Scene number ``index``."""
        rng = np.random.default_rng((self.seed, index))
        mask, grasps = _draw(SHAPES[index % len(SHAPES)], self.side, rng)
        ground, paint = rng.integers(60, 120, 3), rng.integers(140, 255, 3)
        rgb = np.where(mask[..., None], paint, ground) + rng.normal(0, 6, (*mask.shape, 3))
        # A table that slopes a little, an object of 4 cm on it, the noise of a camera.
        depth = 0.7 + 0.02 * np.linspace(0, 1, self.side)[:, None] - 0.04 * mask
        depth = depth + rng.normal(0, 0.0005, mask.shape)
        return Scene(
            self.ids[index],
            np.clip(rgb, 0, 255).astype(np.uint8),
            depth.astype(np.float32),
            mask,
            grasps,
            object_id=self.object_id(index),
            labels={"specific": self.object_id(index), "general": "drawn"},
        )

    def read_grasps(self, index: int) -> Grasps | None:
        """Labelled grasps of scene ``index``."""
        return self.read(index).grasps

    def files(self, index: int) -> tuple[Path, ...]:  # noqa: ARG002  # there are none
        """No files: all follows from the seed."""
        return ()

    def object_id(self, index: int) -> str:
        """Shape of scene ``index``."""
        return SHAPES[index % len(SHAPES)]


def _draw(shape: str, side: int, rng: np.random.Generator) -> tuple[np.ndarray, Grasps]:
    """Mask and grasps of one object."""
    unit = side / 64
    center = rng.uniform(0.4, 0.6, 2) * side
    turn = rng.uniform(-np.pi / 2, np.pi / 2)
    axis = np.array([np.cos(turn), -np.sin(turn)])
    picture = np.zeros((side, side), np.uint8)
    jaw, margin = 6 * unit, 5 * unit
    if shape in ("disc", "ring"):
        radius = rng.uniform(7, 10) * unit
        middle = (round(center[0]), round(center[1]))
        cv2.circle(picture, middle, round(radius), 1, -1)
        wall = 4 * unit
        if shape == "ring":
            cv2.circle(picture, middle, round(radius - wall), 0, -1)
        angles = turn + np.arange(4) * np.pi / 4
        if shape == "disc":
            return picture > 0, _grasps(np.tile(center, (4, 1)), angles, 2 * radius + margin, jaw)
        angles = turn + np.arange(4) * np.pi / 2
        outward = np.column_stack([np.cos(angles), -np.sin(angles)])
        return picture > 0, _grasps(
            center + (radius - wall / 2) * outward, angles, wall + margin, jaw
        )
    arms = [turn] if shape == "bar" else [turn, turn + np.pi / 2]
    length, width = rng.uniform(34, 44) * unit, rng.uniform(6, 9) * unit
    places, angles = [], []
    for arm in arms:
        box = cv2.boxPoints((tuple(map(float, center)), (length, width), -np.degrees(arm)))
        cv2.fillPoly(picture, [np.round(box).astype(np.int32)], 1)
        axis = np.array([np.cos(arm), -np.sin(arm)])
        for along in (-0.35, 0.0, 0.35) if shape == "bar" else (-0.35, 0.35):
            places.append(center + along * length * axis)
            angles.append(arm + np.pi / 2)
    return picture > 0, _grasps(np.array(places), np.array(angles), width + margin, jaw)


def _grasps(center: np.ndarray, angle: np.ndarray, opening: float, jaw: float) -> Grasps:
    ones = np.ones(len(center))
    return Grasps(center, angle, opening * ones, jaw * ones)
