"""The doctor's look at labels: counts, sizes, and what each number of a line means."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from graspmap.data.scene import Scenes
from graspmap.doctor.report import Report
from graspmap.errors import GraspmapError
from graspmap.files import read_lines
from graspmap.geometry.grasps import Grasps


class LabelCount:
    """Counts labels file by file."""

    def __init__(self) -> None:
        self.files = 0
        self.counts: list[int] = []
        self.doubled = self.repeated = self.outside = self.zero = 0
        self.widths: list[NDArray[np.float64]] = []
        self.heights: list[NDArray[np.float64]] = []

    def add(self, grasps: Grasps | None, shape: tuple[int, int] | None) -> None:
        """Count the labels of one scene.

        Args:
            grasps: Its labels; None where it has no label file.
            shape: (rows, columns) of its picture, None where it was not opened.
        """
        if grasps is None:
            return
        self.files += 1
        self.counts.append(len(grasps))
        if not len(grasps):
            return
        rows = np.column_stack([grasps.center, grasps.angle, grasps.width, grasps.height])
        different = len(np.unique(rows, axis=0))
        self.doubled += len(rows) - different
        self.repeated += different - len(np.unique(rows[:, :4], axis=0))
        self.zero += int(((grasps.width == 0) | (grasps.height == 0)).sum())
        if shape is not None:
            low = (grasps.center >= -0.5).all(axis=1)
            high = (grasps.center <= np.array([shape[1], shape[0]]) - 0.5).all(axis=1)
            self.outside += int((~(low & high)).sum())
        self.widths.append(grasps.width)
        self.heights.append(grasps.height)

    def report(self, report: Report, section: str, side: int, size: int) -> None:
        """Write the counts into a report.

        Args:
            report: Where to.
            section: Name of the section.
            side: Longer side of the pictures, pixels; 0: no width scale is suggested.
            size: Side of the network's input for which a width scale is suggested, pixels.
        """
        total = sum(self.counts)
        if not self.files:
            report.say(section, "none", files=0, total=0)
            return
        counts = np.array(self.counts)
        different = total - self.doubled - self.repeated
        jaws = f", {different} different but for the jaw size" * (self.repeated > 0)
        report.say(
            section,
            f"{total} in {self.files} files{jaws}, {counts.min()} to {counts.max()} a scene, "
            f"median {np.median(counts):g}",
            files=self.files,
            total=total,
            different=different,
            scenes_without_grasp=int((counts == 0).sum()),
            per_scene=[int(counts.min()), float(np.median(counts)), int(counts.max())],
        )
        report.say(
            section,
            f"{self.doubled} doubled, {self.outside} centred outside the picture, {self.zero} "
            "of zero size",
            doubled=self.doubled,
            outside=self.outside,
            zero_size=self.zero,
        )
        if total:
            self._sizes(report, section, side, size)

    def _sizes(self, report: Report, section: str, side: int, size: int) -> None:
        widths, heights = np.concatenate(self.widths), np.concatenate(self.heights)
        median, most, greatest = np.percentile(widths, [50, 95, 100])
        text = (
            f"opening median {median:.4g} px, 95 % under {most:.4g}, greatest {greatest:.4g}; "
            f"jaw {heights.min():.4g} to {heights.max():.4g} px"
        )
        facts: dict[str, Any] = {
            "opening_px": {"median": median, "p95": most, "max": greatest},
            "jaw_px": [float(heights.min()), float(heights.max())],
        }
        report.say(section, text, **facts)
        if side:
            scale = greatest * size / side
            report.say(
                section,
                f"width scale: {greatest:.4g} px of these pictures, {scale:.0f} px of an input "
                f"of {size}",
                width_scale_px=float(greatest),
                width_scale_input_px=float(scale),
            )


def explain_line(kind: str, scenes: Scenes) -> list[tuple[str, str]]:
    """What each number of a label means, on the first label of the data set.

    Args:
        kind: ``"cornell"`` or ``"jacquard"``.
        scenes: The data set.

    Returns:
        (section, sentence) pairs; none where there is no label.
    """
    end = {"cornell": "cpos.txt", "jacquard": "_grasps.txt"}.get(kind)
    for index in range(len(scenes)):
        try:
            grasps = scenes.read_grasps(index)
            path = next((p for p in scenes.files(index) if end and p.name.endswith(end)), None)
            if path is not None and grasps is not None and len(grasps):
                lines = [line for _, line in read_lines(path)]
                explain = _explain_jacquard if kind == "jacquard" else _explain_cornell
                return [("a label", text) for text in explain(path, lines, grasps[0])]
        except GraspmapError:
            continue  # it is among the problems already
    return []


def _read_as(grasp: Grasps) -> str:
    x, y = grasp.center[0]
    return (
        f"read as: centre ({x:.1f}, {y:.1f}) px, angle {np.degrees(grasp.angle[0]):.1f} degrees "
        f"counter-clockwise, opening {grasp.width[0]:.1f} px, jaw {grasp.height[0]:.1f} px"
    )


def _explain_jacquard(path: Path, lines: list[str], grasp: Grasps) -> list[str]:
    x, y, theta, opening, jaw = lines[0].split(";")
    return [
        f"{path.name}, line 1: {lines[0]}",
        f"{x} x and {y} y of the centre, px from the left and the top; {theta} direction of the "
        "opening, degrees CLOCKWISE on screen",
        f"{opening} opening between the jaws, px; {jaw} size of the jaws, px",
        _read_as(grasp),
    ]


def _explain_cornell(path: Path, lines: list[str], grasp: Grasps) -> list[str]:
    corners = [lines[i : i + 4] for i in range(0, len(lines), 4)]
    first = next(four for four in corners if "nan" not in " ".join(four).lower())
    points = "  ".join(f"({', '.join(line.split())})" for line in first)
    return [
        f"{path.name}, four lines, one corner (x, y) each: {points}",
        "x px from the left, y px from the top; first to second corner is the opening, second to "
        "third the jaw",
        _read_as(grasp),
    ]
