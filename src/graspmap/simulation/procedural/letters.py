"""Capital letters and digits as strokes of one width: a font of our own.

A character lives in a box 0 <= x <= its width, 0 <= y <= 6 (y up). A stroke is a list of points;
("arc", x, y, rx, ry, from, to) in it stands for the points of an elliptic arc, in degrees,
counter-clockwise from the right.
"""

from __future__ import annotations

import math

import shapely
from shapely.geometry.base import BaseGeometry

Point = tuple[float, float]
Arc = tuple[str, float, float, float, float, float, float]
Stroke = list[Point | Arc]

HEIGHT = 6.0
"""Of every character, in units of the font."""

_ARC_STEP_DEG = 22.5


def _arc(x: float, y: float, rx: float, ry: float, start: float, stop: float) -> Arc:
    return ("arc", x, y, rx, ry, start, stop)


_ROUND = _arc(2, 3, 2, 3, 0, 360)

GLYPHS: dict[str, list[Stroke]] = {
    "A": [[(0, 0), (2, 6), (4, 0)], [(0.7, 2), (3.3, 2)]],
    "B": [
        [(0, 3), (0, 6), (2, 6), _arc(2, 4.5, 1.5, 1.5, 90, -90), (0, 3)],
        [(0, 3), (2.2, 3), _arc(2.2, 1.5, 1.5, 1.5, 90, -90), (0, 0), (0, 3)],
    ],
    "C": [[_arc(2.2, 3, 2.2, 3, 50, 310)]],
    "D": [[(0, 0), (0, 6), (1.2, 6), _arc(1.2, 3, 2.6, 3, 90, -90), (0, 0)]],
    "E": [[(3.5, 6), (0, 6), (0, 0), (3.5, 0)], [(0, 3), (3, 3)]],
    "F": [[(3.5, 6), (0, 6), (0, 0)], [(0, 3), (3, 3)]],
    "G": [[_arc(2.2, 3, 2.2, 3, 50, 360), (2.5, 3)]],
    "H": [[(0, 0), (0, 6)], [(4, 0), (4, 6)], [(0, 3), (4, 3)]],
    "I": [[(0, 0), (0, 6)]],
    "J": [[(3, 6), (3, 1.6), _arc(1.5, 1.6, 1.5, 1.6, 0, -180)]],
    "K": [[(0, 0), (0, 6)], [(3.8, 6), (0, 2.6)], [(1.3, 3.8), (3.9, 0)]],
    "L": [[(0, 6), (0, 0), (3.5, 0)]],
    "M": [[(0, 0), (0, 6), (2.5, 2), (5, 6), (5, 0)]],
    "N": [[(0, 0), (0, 6), (4, 0), (4, 6)]],
    "O": [[_ROUND]],
    "P": [[(0, 0), (0, 6), (2, 6), _arc(2, 4.3, 1.7, 1.7, 90, -90), (0, 2.6)]],
    "Q": [[_ROUND], [(2.4, 1.6), (4.2, -0.2)]],
    "R": [
        [(0, 0), (0, 6), (2, 6), _arc(2, 4.4, 1.6, 1.6, 90, -90), (0, 2.8)],
        [(1.8, 2.8), (3.8, 0)],
    ],
    "S": [[_arc(1.9, 4.45, 1.8, 1.55, 35, 270), _arc(1.9, 1.45, 1.9, 1.45, 90, -145)]],
    "T": [[(0, 6), (4, 6)], [(2, 6), (2, 0)]],
    "U": [[(0, 6), (0, 2), _arc(2, 2, 2, 2, 180, 360), (4, 6)]],
    "V": [[(0, 6), (2, 0), (4, 6)]],
    "W": [[(0, 6), (1.4, 0), (2.8, 5), (4.2, 0), (5.6, 6)]],
    "X": [[(0, 0), (4, 6)], [(0, 6), (4, 0)]],
    "Y": [[(0, 6), (2, 3), (4, 6)], [(2, 3), (2, 0)]],
    "Z": [[(0, 6), (4, 6), (0, 0), (4, 0)]],
    "0": [[_ROUND]],
    "1": [[(0, 4.6), (1.6, 6), (1.6, 0)], [(0.2, 0), (3, 0)]],
    "2": [[_arc(1.9, 4.2, 1.9, 1.8, 160, -35), (0, 0), (4, 0)]],
    "3": [[_arc(1.8, 4.5, 1.7, 1.5, 150, -90), _arc(1.8, 1.5, 1.9, 1.5, 90, -150)]],
    "4": [[(3, 0), (3, 6), (0, 1.8), (4.2, 1.8)]],
    "5": [[(3.6, 6), (0.5, 6), (0.3, 3.3), _arc(1.8, 1.9, 2, 1.9, 130, -145)]],
    "6": [[_arc(1.9, 1.9, 1.9, 1.9, 0, 360)], [_arc(3.2, 1.9, 3.2, 4.1, 180, 95)]],
    "7": [[(0, 6), (4, 6), (1.2, 0)]],
    "8": [[_arc(2, 4.5, 1.6, 1.5, 0, 360)], [_arc(2, 1.5, 2, 1.5, 0, 360)]],
    "9": [[_arc(1.9, 4.1, 1.9, 1.9, 0, 360)], [_arc(0.6, 4.1, 3.2, 4.1, 0, -85)]],
}
"""Strokes of each character."""


def glyph(character: str, weight: float) -> BaseGeometry:
    """A character's outline.

    Args:
        character: One of `GLYPHS`.
        weight: Width of the strokes in units of the font.
    """
    bands = []
    for stroke in GLYPHS[character]:
        points = _points(stroke)
        around = math.dist(points[0], points[-1]) < 1e-9
        line = shapely.LinearRing(points[:-1]) if around else shapely.LineString(points)
        bands.append(line.buffer(weight / 2, cap_style="square", join_style="mitre", mitre_limit=2))
    return shapely.union_all(bands)


def _points(stroke: Stroke) -> list[Point]:
    points: list[Point] = []
    for item in stroke:
        if len(item) == 2:
            points.append(item)
        else:
            _, x, y, rx, ry, start, stop = item
            steps = max(2, round(abs(stop - start) / _ARC_STEP_DEG))
            for i in range(steps + 1):
                t = math.radians(start + (stop - start) * i / steps)
                points.append((x + rx * math.cos(t), y + ry * math.sin(t)))
    return points
