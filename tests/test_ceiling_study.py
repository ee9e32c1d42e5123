"""The ceiling that labels set: chosen by one half of the repeats, judged by the other."""

from __future__ import annotations

import numpy as np
import pytest

from graspmap.data import example_scenes, read_scenes
from graspmap.simulation.trial import Perturbation
from studies import ceiling


@pytest.fixture(scope="module")
def scenes():
    """Three of the scenes that ship."""
    everything = read_scenes(f"jacquard:{example_scenes()}")
    return everything.subset(everything.ids[:3])


def test_without_errors_every_label_holds_again(scenes):
    choosing, judging, objects = ceiling.measure(scenes, Perturbation(0, 0, 0, 0), 3, 1, 1, 0)
    assert [len(c) for c in choosing] == [3, 3, 3]
    assert np.concatenate([*choosing, *judging]).tolist() == [1.0] * 18
    assert objects == [scenes.object_id(i) for i in range(3)]


def test_the_halves_draw_their_own_errors(scenes):
    errors = Perturbation(0.004, 0.1, 0.1, 0.1)
    choosing, judging, _ = ceiling.measure(scenes, errors, 4, 4, 1, 0)
    assert not np.array_equal(np.concatenate(choosing), np.concatenate(judging))
    assert 0.2 < np.concatenate(judging).mean() < 1


def test_it_prints_and_writes_what_it_found(scenes, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(ceiling, "read_scenes", lambda _source: scenes)
    ceiling.run(("jacquard:here",), labels=2, repeats=2, workers=1, out=tmp_path)
    printed = capsys.readouterr().out
    assert "the best of 2 holds" in printed
    assert '"scenes": 3' in (tmp_path / "ceiling.json").read_text()
