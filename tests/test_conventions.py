"""CONVENTIONS.md: its examples run, its tests exist, and the rules of the maps."""

from __future__ import annotations

import ast
import doctest
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.errors import InvalidInputError
from graspmap.geometry import angle_difference
from graspmap.maps.grasp_maps import GraspMaps, bin_centers, bin_of

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "CONVENTIONS.md"
HALF = np.pi / 2


def test_examples_give_what_they_show():
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert tried >= 7
    assert failed == 0


def test_named_tests_exist():
    named = re.findall(r"`(tests/\w+\.py)::(\w+)`", PAGE.read_text())
    assert len(named) > 20
    missing = []
    for file, test in named:
        path = ROOT / file
        nodes = ast.walk(ast.parse(path.read_text())) if path.exists() else []
        if test not in {n.name for n in nodes if isinstance(n, ast.FunctionDef)}:
            missing.append(f"{file}::{test}")
    assert not missing


def test_maps_come_in_one_order():
    arrays = [np.full((2, 3, 4), float(i)) for i in range(4)]
    maps = GraspMaps(quality=arrays[0], cos=arrays[1], sin=arrays[2], width=arrays[3])
    assert all(a is b for a, b in zip(maps, arrays, strict=True))
    assert (maps.bins, maps.shape) == (2, (3, 4))
    batch = GraspMaps(*(np.stack([a, a + 10]) for a in arrays))
    assert (batch.bins, batch.shape) == (2, (3, 4))
    assert batch.item(1).width[0, 0, 0] == 13
    with pytest.raises(InvalidInputError, match="shapes"):
        GraspMaps(*arrays[:3], np.zeros((1, 3, 4)))
    with pytest.raises(InvalidInputError, match="shapes"):
        GraspMaps(*(np.zeros((3, 4)) for _ in range(4)))


@given(st.floats(-HALF, HALF, exclude_max=True))
def test_angle_from_its_double(angle):
    recovered = np.arctan2(np.sin(2 * angle), np.cos(2 * angle)) / 2
    assert angle_difference(recovered, angle) < 1e-12


@given(st.integers(1, 24), st.floats(-HALF, HALF, exclude_max=True))
def test_every_angle_lies_in_its_bin(bins, angle):
    number = bin_of(np.array([angle]), bins)[0]
    assert 0 <= number < bins
    low = -HALF + number * np.pi / bins
    assert low - 1e-12 <= angle <= low + np.pi / bins + 1e-12


@pytest.mark.parametrize("bins", [1, 2, 3, 4, 6, 18])
def test_bins_are_half_open_and_start_at_the_vertical(bins):
    numbers = np.arange(bins)
    assert bin_of(bin_centers(bins), bins).tolist() == numbers.tolist()
    step = np.pi / bins
    just_above = -HALF + numbers * step + 1e-9
    just_below = -HALF + (numbers + 1) * step - 1e-9
    assert bin_of(just_above, bins).tolist() == numbers.tolist()
    assert bin_of(just_below, bins).tolist() == numbers.tolist()
    assert bin_of(np.array([-HALF]), bins)[0] == 0
