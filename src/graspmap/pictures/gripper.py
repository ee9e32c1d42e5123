"""A drawing of a gripper to scale: open and closed seen along the jaw, and from the side.

Views are seen level, with the palm above and the fingers hanging down. A view's points are (u, v):
u to the right of its middle, v below the palm, metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from graspmap.errors import InvalidInputError
from graspmap.gripper import Gripper
from graspmap.pictures.draw import INK, JAW, OPENING, PAPER, Color, Picture, text_width, write_text

_METAL: Color = (206, 210, 216)
_BODY: Color = (168, 174, 182)
_OBJECT: Color = (244, 232, 206)
_MEASURE: Color = (110, 114, 122)
_TABLE: Color = (150, 130, 100)
_SIDE = 96  # px left free beside each view for its measures
_TOP = 104
_LINE = 26
_SMALL = 0.42  # size of the letters of measures
_WHOLE = 1.3  # height of body and flange, in heights of the body
_AHEAD = 5  # px, half the width of an arrow's head
_SHIFT = 4  # cv2 takes coordinates in 1/16 pixel


def gripper_picture(gripper: Gripper, *, width: int = 1280) -> Picture:
    """A gripper to scale with its measures: open, closed, and from the side.

    Args:
        gripper: The gripper.
        width: Columns of the picture, at least 800.

    Returns:
        (H, ``width``, 3) picture; H follows from the gripper.

    Raises:
        InvalidInputError: The picture is too narrow.
    """
    if width < 800:
        raise InvalidInputError("width of the picture", width, "at least 800 pixels")
    body = _body_height(gripper)
    spans = (
        max(gripper.palm_size_m[0], gripper.max_opening_m + 2 * gripper.finger_thickness_m),
        max(gripper.palm_size_m[0], gripper.min_opening_m + 2 * gripper.finger_thickness_m),
        max(gripper.palm_size_m[1], gripper.jaw_sizes_m[-1]),
    )
    scale = (width - 6 * _SIDE) / sum(spans)
    scale = min(scale, 0.6 * width / (gripper.finger_length_m + _WHOLE * body))
    below = 64 + _LINE * max(2, len(gripper.jaw_sizes_m))
    bottom = _TOP + 40 + round(scale * (_WHOLE * body + gripper.finger_length_m)) + below
    words = gripper.words()
    picture = np.full((bottom + _LINE * (len(words) + 1), width, 3), PAPER, dtype=np.uint8)
    title = f"{gripper.name}{': ' if gripper.description else ''}{gripper.description}"
    write_text(picture, title, (24, 40), size=0.8)
    free = (width - scale * sum(spans)) / 6
    middle, views = 0.0, []
    for span in spans:
        middle += free + scale * span / 2
        views.append(_View(picture, middle, _TOP + 40 + scale * _WHOLE * body, scale))
        middle += scale * span / 2 + free
    _front(views[0], gripper, gripper.max_opening_m, "open")
    _front(views[1], gripper, gripper.min_opening_m, "closed")
    _side(views[2], gripper)
    for number, sentence in enumerate(words):
        write_text(picture, sentence, (24, bottom + _LINE * number), size=0.5)
    _ruler(picture, scale, bottom + _LINE * (len(words) - 1))
    return picture


class _View:
    """Draws metres onto a part of a picture.

    Args:
        picture: Where, changed.
        x: Column of u = 0.
        y: Row of v = 0.
        scale: Pixels a metre.
    """

    def __init__(self, picture: Picture, x: float, y: float, scale: float) -> None:
        self._picture, self._x, self._y, self._scale = picture, x, y, scale

    def box(
        self, u: tuple[float, float], v: tuple[float, float], fill: Color | None,
        rim: Color | None = INK,
    ) -> None:  # fmt: skip
        """An upright rectangle."""
        import cv2

        corners = [self._fixed(*self._pixel(a, b)) for a, b in zip(
            (u[0], u[1], u[1], u[0]), (v[0], v[0], v[1], v[1]), strict=True)]  # fmt: skip
        points = np.array(corners, dtype=np.int32)
        if fill is not None:
            cv2.fillConvexPoly(self._picture, points, fill, cv2.LINE_AA, _SHIFT)
        if rim is not None:
            cv2.polylines(self._picture, [points], True, rim, 1, cv2.LINE_AA, _SHIFT)

    def across(
        self, u: tuple[float, float], v: float, away: float, text: str, color: Color = _MEASURE,
        beside: float | None = None,
    ) -> None:  # fmt: skip
        """A level measure from u[0] to u[1], ``away`` pixels below v (above, where negative).

        Its words stand over or under it; where there is no room below, or ``beside`` gives a u,
        at its right.
        """
        (x0, y0), (x1, _) = self._pixel(u[0], v), self._pixel(u[1], v)
        y = y0 + away
        for x in (x0, x1):
            self._line((x, y0 + np.sign(away) * 4), (x, y + np.sign(away) * 5), _MEASURE)
        self._arrows((x0, y), (x1, y), color)
        width = text_width(text, _SMALL)
        if beside is None and (away < 0 or x1 - x0 > width + 8):
            self.write(text, (x0 + x1) / 2, y + 18 if away > 0 else y - 9, color)
        else:
            right = x1 if beside is None else self._pixel(beside, v)[0]
            self.write(text, right + 24 + width / 2, y + 5, color)

    def down(self, v: tuple[float, float], u: float, away: float, text: str) -> None:
        """An upright measure from v[0] to v[1], ``away`` pixels right of u (left: negative)."""
        (x0, y0), (_, y1) = self._pixel(u, v[0]), self._pixel(u, v[1])
        x = x0 + away
        for y in (y0, y1):
            self._line((x0 + np.sign(away) * 4, y), (x + np.sign(away) * 5, y), _MEASURE)
        self._arrows((x, y0), (x, y1), _MEASURE)
        half = text_width(text, _SMALL) / 2 + 9
        self.write(text, x + np.sign(away) * half, (y0 + y1) / 2 + 5, _MEASURE)

    def level(self, u: tuple[float, float], v: float, color: Color) -> None:
        """A dashed level line."""
        (x0, y), (x1, _) = self._pixel(u[0], v), self._pixel(u[1], v)
        for x in np.arange(x0, x1, 9.0):
            self._line((x, y), (min(x + 5, x1), y), color)

    def caption(self, text: str) -> None:
        """Words over the view."""
        self.write(text, self._x, _TOP - 26, INK, size=0.55)

    def label(self, text: str, u: tuple[float, float], v: tuple[float, float]) -> None:
        """Words in the middle of a rectangle, if they fit."""
        (x0, y0), (x1, y1) = self._pixel(u[0], v[0]), self._pixel(u[1], v[1])
        if x1 - x0 > text_width(text, _SMALL) + 8 and y1 - y0 > 18:
            self.write(text, (x0 + x1) / 2, (y0 + y1) / 2 + 5, _TABLE)

    def write(self, text: str, x: float, y: float, color: Color, size: float = _SMALL) -> None:
        """Words with their middle at column x, on row y."""
        width = text_width(text, size)
        left = min(max(4.0, x - width / 2), self._picture.shape[1] - width - 4.0)
        write_text(self._picture, text, (left, y), size=size, color=color)

    def _arrows(self, a: tuple[float, float], b: tuple[float, float], color: Color) -> None:
        """A line with heads at both ends; heads point inwards from outside where it is short."""
        start, end = np.array(a), np.array(b)
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length if length > 1e-6 else np.array([1.0, 0.0])
        across = np.array([-along[1], along[0]])
        inside = length > 26
        if not inside:
            self._line(tuple(start - 16 * along), tuple(start), color)
            self._line(tuple(end), tuple(end + 16 * along), color)
        self._line(a, b, color)
        for tip, way in ((start, 1 if inside else -1), (end, -1 if inside else 1)):
            for turn in (-1, 1):
                head = tip + 9 * way * along + turn * _AHEAD * 0.7 * across
                self._line(tuple(tip), tuple(head), color)

    def _line(self, a: Sequence[float], b: Sequence[float], color: Color) -> None:
        import cv2

        ends = self._fixed(*a), self._fixed(*b)
        cv2.line(self._picture, *ends, color, 1, cv2.LINE_AA, shift=_SHIFT)

    def _pixel(self, u: float, v: float) -> tuple[float, float]:
        # Whole pixels: lines that run between two of them are pale and blurred.
        return round(self._x + self._scale * u), round(self._y + self._scale * v)

    def _fixed(self, x: float, y: float) -> tuple[int, int]:
        return round(x * 2**_SHIFT), round(y * 2**_SHIFT)


def _body_height(gripper: Gripper) -> float:
    """Height at which the body above the palm is drawn; no profile says how high it is."""
    return float(np.clip(0.4 * gripper.finger_length_m, 0.02, 0.05))


def _draw_body(view: _View, palm: float, height: float) -> None:
    """What carries the fingers, and the flange on top of it."""
    view.box((-palm / 5, palm / 5), (-_WHOLE * height, -height), _METAL)
    view.box((-palm / 2, palm / 2), (-height, 0), _BODY)


def _front(view: _View, gripper: Gripper, opening: float, name: str) -> None:
    """The gripper seen along its jaw."""
    tip, thick, palm = gripper.finger_length_m, gripper.finger_thickness_m, gripper.palm_size_m[0]
    inner, outer, body = opening / 2, opening / 2 + thick, _body_height(gripper)
    wide = max(palm / 2, outer)
    is_open = opening == gripper.max_opening_m
    if is_open:
        top = tip - gripper.max_depth_m
        table = tip + gripper.table_clearance_m
        held = (-0.6 * inner, 0.6 * inner), (top, table)
        view.box(*held, _OBJECT, None)
        view.label("object", *held)
        view.level((-inner, inner), top, _TABLE)
        view.box((-wide, wide), (table, table), None, _TABLE)
    if outer > palm / 2:  # what the fingers slide along reaches beyond the palm
        view.box((-outer, outer), (-0.3 * body, 0), _METAL)
    _draw_body(view, palm, body)
    for side in (-1, 1):
        a, b = sorted((side * inner, side * outer))
        view.box((a, b), (0, tip), _METAL)
        pad = min(0.25 * thick, 0.003)
        a, b = sorted((side * inner, side * (inner + pad)))
        view.box((a, b), (tip - min(gripper.max_depth_m, tip), tip), JAW, None)
    view.caption(name)
    view.across((-inner, inner), tip, 30, _mm(opening), OPENING)
    if is_open:
        view.across((-palm / 2, palm / 2), -_WHOLE * body, -14, f"palm {_mm(palm)}")
        view.down((0, tip), -wide, -22, _mm(tip))
        view.down((tip - gripper.max_depth_m, tip), wide, 22, _mm(gripper.max_depth_m))
    else:
        view.across((inner, outer), tip, 62, _mm(thick))


def _side(view: _View, gripper: Gripper) -> None:
    """The gripper seen along its opening."""
    tip, palm, body = gripper.finger_length_m, gripper.palm_size_m[1], _body_height(gripper)
    jaws = gripper.jaw_sizes_m
    _draw_body(view, palm, body)
    for jaw in reversed(jaws):
        view.box((-jaw / 2, jaw / 2), (0, tip), _METAL)
    for jaw in reversed(jaws):
        half = gripper.jaw_contact_share * jaw / 2
        view.box((-half, half), (tip - gripper.max_depth_m, tip), _shade(jaws.index(jaw)), None)
    view.caption("from the side")
    view.across((-palm / 2, palm / 2), -_WHOLE * body, -14, f"palm {_mm(palm)}")
    for number, jaw in enumerate(jaws):
        text = f"jaw {_mm(jaw)}"
        view.across((-jaw / 2, jaw / 2), tip, 30 + _LINE * number, text, JAW, jaws[-1] / 2)


def _shade(number: int) -> Color:
    """Blue, paler for each larger jaw."""
    pale = min(0.75, 0.2 * number)
    red, green, blue = (round(c + pale * (255 - c)) for c in JAW)
    return red, green, blue


def _ruler(picture: Picture, scale: float, y: float) -> None:
    """A bar of a round length, to measure by."""
    length = next((m for m in (0.1, 0.05, 0.02, 0.01) if m * scale <= 260), 0.005)
    view = _View(picture, picture.shape[1] - 60 - scale * length / 2, y, scale)
    for part in range(5):
        u = -length / 2 + part * length / 5
        fill = INK if part % 2 == 0 else PAPER
        view.box((u, u + length / 5), (0, 6 / scale), fill)
    view.write(_mm(length), picture.shape[1] - 60 - scale * length / 2, y - 8, INK)


def _mm(metres: float) -> str:
    return f"{1000 * metres:.4g} mm"
