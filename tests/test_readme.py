"""The README's lines of Python run as they stand."""

from __future__ import annotations

import re
from pathlib import Path

import torch

from graspmap.inference import WeightsCard, save_weights, shipped
from graspmap.networks import make_network

README = Path(__file__).parents[1] / "README.md"


def test_the_ten_lines_run(tmp_path, monkeypatch, capsys):
    card = WeightsCard(
        network="ggcnn2", channels="rgbd", bins=1, size=96, view="contain", width_scale_px=40.0
    )
    network = make_network("ggcnn2", 4, 1)
    with torch.no_grad():
        network.heads.layer.bias[0] += 10  # untrained, but sure that everything can be grasped
    save_weights(tmp_path / "tiny.safetensors", network, card)
    monkeypatch.setattr(shipped, "_FOLDER", tmp_path)
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(code, "README.md", "exec"), {})
    assert capsys.readouterr().out.count("frame, opening") >= 1


def test_the_files_it_names_exist():
    for target in re.findall(r"\]\(([^)#]+)\)", README.read_text(encoding="utf-8")):
        assert (README.parent / target).exists(), target
