"""The numbers that a page of a report shows, read back from its HTML."""

from __future__ import annotations

import json
import math
import re
from html.parser import HTMLParser

import pytest

from graspmap.evaluation.report.numbers import NOTHING

VOID = {"meta", "link", "img", "br"}
UNITS = {
    "": 1.0, "%": 0.01, " points": 0.01, "°": 1.0, " s": 1.0, " ms": 1.0, " mm": 0.001, " M": 1e6,
    " degrees": math.pi / 180,
}  # fmt: skip


class Page(HTMLParser):
    """The numbers of a page, its links, and whether its elements are closed."""

    def __init__(self, text):
        super().__init__()
        self.shown, self.addresses, self.stack, self.words = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.stack

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.stack.append((tag, dict(attrs)))
        self.addresses += [v for k, v in attrs if k in ("src", "href", "xlink:href")]

    def handle_startendtag(self, _tag, attrs):
        self.addresses += [v for k, v in attrs if k in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        assert self.stack.pop()[0] == tag

    def handle_data(self, data):
        tag, attrs = self.stack[-1] if self.stack else ("", {})
        if "data-key" in attrs:
            self.shown.append((attrs["data-key"], attrs["data-value"], data))
        elif tag not in ("style", "text", "tspan"):
            self.words.append(data)


def steps_of(key):
    """The steps of a path in jq's words."""
    pattern = r'\.?"((?:[^"\\]|\\.)*)"|\.?([A-Za-z_]\w*)|\[(\d+)\]'
    found = list(re.finditer(pattern, key))
    assert "".join(match[0] for match in found) == key
    return [int(m[3]) if m[3] else m[2] if m[2] else json.loads(f'"{m[1]}"') for m in found]


def looked_up(summary, key):
    for step in steps_of(key):
        if summary is None:
            return None
        summary = summary.get(step) if isinstance(summary, dict) else summary[step]
    return summary


def check_numbers(page, summary):
    """Every marked number is the summary's, and says it as well as its digits can."""
    assert page.shown
    for key, value, text in page.shown:
        truth = looked_up(summary, key)
        assert json.loads(value) == truth, key
        if truth is None:
            assert text == NOTHING
            continue
        match = re.fullmatch(r"([+-]?[\d,]*\.?(\d*)(e-\d+)?)(\D*)", text)
        assert match, text
        unit = UNITS[match[4]]
        said = float(match[1].replace(",", "")) * unit
        half = 0.5 * float(f"1{match[3] or ''}") / 10 ** len(match[2])  # of the last digit
        assert said == pytest.approx(truth, abs=1.001 * half * unit), (key, text)
