"""The same work done the usual way: scikit-image for pictures, plain PyTorch for networks.

Written for this comparison, in the manner in which grasp networks are commonly trained: each
label is a polygon that is rasterised, pictures are rotated, zoomed and resized one step at a time,
overlap is counted on a pixel grid, maps are smoothed whole before the best pixel is looked for.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch
from PIL import Image
from skimage import draw, feature, filters, io, transform
from torch import nn

from graspmap import Grasps


def read_rectangles(path: Path) -> list[tuple[float, float, float, float, float]]:
    """Lines of a Jacquard label file as (x, y, angle, opening, jaw)."""
    rows = []
    for line in path.read_text().split():
        x, y, theta, opening, jaw = map(float, line.split(";"))
        rows.append((x, y, -np.radians(theta), opening, jaw))
    return rows


def corners(x: float, y: float, angle: float, opening: float, jaw: float) -> np.ndarray:
    """(4, 2) corners as (row, column)."""
    dx, dy = np.cos(angle), -np.sin(angle)
    points = []
    for u, v in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        column = x + u * opening / 2 * dx - v * jaw / 2 * dy
        row = y + u * opening / 2 * dy + v * jaw / 2 * dx
        points.append((row, column))
    return np.array(points)


def draw_maps(
    rectangles: list[tuple[float, float, float, float, float]], side: int, bins: int
) -> np.ndarray:
    """(4, bins, side, side) Gaussian maps, one rasterised polygon and one formula a grasp."""
    maps = np.zeros((4, bins, side, side))
    rows, columns = np.mgrid[0:side, 0:side]
    for x, y, angle, opening, jaw in rectangles:
        third = corners(x, y, angle, opening / 3, jaw)
        r, c = draw.polygon(third[:, 0], third[:, 1], (side, side))
        b = int(np.floor((angle + np.pi / 2) / np.pi * bins)) % bins
        if bins == 1:
            maps[0, 0, r, c] = 1.0
        else:
            u = (columns - x) / max(opening / 6, 1e-9)
            v = (rows - y) / max(jaw / 2, 1e-9)
            gauss = np.exp(-(u**2 + v**2) / 2)
            inside = np.zeros((side, side), bool)
            inside[r, c] = True
            maps[0, b] = np.where(inside, np.maximum(maps[0, b], gauss), maps[0, b])
        maps[1, b, r, c] = np.cos(2 * angle)
        maps[2, b, r, c] = np.sin(2 * angle)
        maps[3, b, r, c] = opening
    return maps


def sample(stem: str, side: int, angle: float, zoom: float) -> tuple[np.ndarray, np.ndarray]:
    """One augmented RGB-D training sample from the original files of a Jacquard scene.

    Args:
        stem: Path of the scene's files without ``_RGB.png`` and so on.
        side: Side of the network's input, pixels.
        angle: Rotation, radians.
        zoom: Part of the picture that fills the frame.
    """
    rgb = io.imread(stem + "_RGB.png")[..., :3]
    depth = np.asarray(Image.open(stem + "_perfect_depth.tiff"), dtype=np.float32)
    full = rgb.shape[0]
    holes = (~np.isfinite(depth) | (depth <= 0)).astype(np.uint8)
    scale = np.abs(depth).max()
    depth = cv2.inpaint(depth / scale, holes, 1, cv2.INPAINT_NS) * scale
    margin = int(full * (1 - zoom) / 2)
    pictures = []
    for picture in (rgb, depth):
        turned = transform.rotate(picture, np.degrees(angle), mode="edge", preserve_range=True)
        cut = turned[margin : full - margin, margin : full - margin]
        pictures.append(transform.resize(cut, (side, side), preserve_range=True))
    colour = pictures[0] / 255.0
    colour = colour - colour.mean()
    distance = np.clip(pictures[1] - pictures[1].mean(), -1, 1)
    stacked = np.concatenate([distance[None], colour.transpose(2, 0, 1)]).astype(np.float32)
    factor = side / (full * zoom)
    c, s = np.cos(angle), np.sin(angle)
    moved = []
    for x, y, theta, opening, jaw in read_rectangles(Path(stem + "_grasps.txt")):
        dx, dy = x - full / 2, y - full / 2
        moved.append(
            (
                (c * dx + s * dy) * factor + side / 2,
                (-s * dx + c * dy) * factor + side / 2,
                (theta + angle + np.pi / 2) % np.pi - np.pi / 2,
                opening * factor,
                jaw * factor,
            )
        )
    return stacked, draw_maps(moved, side, 1).astype(np.float32)


def best_overlap(predicted: Grasps, labels: Grasps) -> float:
    """Greatest pixel-counted overlap of one grasp with labels within 30 degrees."""
    best = 0.0
    p = predicted.corners()[0]
    for i, quad in enumerate(labels.corners()):
        turn = abs((predicted.angle[0] - labels.angle[i] + np.pi / 2) % np.pi - np.pi / 2)
        if turn > np.pi / 6:
            continue
        r1, c1 = draw.polygon(p[:, 1], p[:, 0])
        r2, c2 = draw.polygon(quad[:, 1], quad[:, 0])
        high = max(r1.max(initial=0), r2.max(initial=0)) + 1
        wide = max(c1.max(initial=0), c2.max(initial=0)) + 1
        canvas = np.zeros((high, wide))
        canvas[r1, c1] += 1
        canvas[r2, c2] += 1
        union = np.count_nonzero(canvas)
        best = max(best, np.count_nonzero(canvas == 2) / union if union else 0.0)
    return best


def find_grasp(maps: np.ndarray) -> tuple[int, int, float, float] | None:
    """Best pixel of (4, 1, side, side) maps after smoothing everything: (x, y, angle, width)."""
    quality = filters.gaussian(maps[0, 0], 2.0, preserve_range=True)
    angle = 0.5 * np.arctan2(maps[2, 0], maps[1, 0])
    angle = filters.gaussian(angle, 2.0, preserve_range=True)
    width = filters.gaussian(maps[3, 0], 1.0, preserve_range=True)
    peaks = feature.peak_local_max(quality, min_distance=20, threshold_abs=0.2, num_peaks=1)
    for row, column in peaks:
        return int(column), int(row), float(angle[row, column]), float(width[row, column])
    return None


class PlainGGCNN2(nn.Module):
    """GG-CNN2 from its layer table, nothing else."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.trunk = nn.Sequential(
            nn.Conv2d(channels, 16, 11, padding=5), nn.ReLU(),
            nn.Conv2d(16, 16, 5, padding=2), nn.ReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(16, 16, 5, padding=2), nn.ReLU(),
            nn.Conv2d(16, 16, 5, padding=2), nn.ReLU(),
            nn.MaxPool2d(2),
            nn.Conv2d(16, 32, 5, dilation=2, padding=4), nn.ReLU(),
            nn.Conv2d(32, 32, 5, dilation=4, padding=8), nn.ReLU(),
            nn.ConvTranspose2d(32, 16, 3, stride=2, padding=1, output_padding=1), nn.ReLU(),
            nn.ConvTranspose2d(16, 16, 3, stride=2, padding=1, output_padding=1), nn.ReLU(),
        )  # fmt: skip
        self.heads = nn.ModuleList(nn.Conv2d(16, 1, 1) for _ in range(4))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(B, channels, S, S) to (B, 4, S, S)."""
        features = self.trunk(x)
        return torch.cat([head(features) for head in self.heads], dim=1)
