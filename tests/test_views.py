"""What a detector sees of a picture under the habits of others."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from graspmap.data.scene import Scene
from graspmap.evaluation.views import look
from graspmap.geometry.grasps import Grasps


def numbered(rows: int, columns: int, labels: Grasps | None = None) -> Scene:
    """Every pixel of the depth is another number."""
    depth = np.arange(1, rows * columns + 1, dtype=np.float32).reshape(rows, columns)
    rgb = np.stack([depth % 251, depth % 241, depth % 239], axis=-1).astype(np.uint8)
    return Scene("scene", rgb=rgb, depth=depth, grasps=labels)


@given(
    rows=st.integers(5, 40),
    columns=st.integers(5, 40),
    view=st.sampled_from(["whole", "labels", "augmented"]),
    seed=st.integers(0, 1000),
)
def test_every_seen_pixel_is_the_pixel_that_the_matrix_says(rows, columns, view, seed):
    rng = np.random.default_rng(seed)
    center = rng.uniform(0, [columns, rows], (3, 2))
    scene = numbered(rows, columns, Grasps(center, [0, 0, 0], [5, 5, 5], [2, 2, 2]))
    seen = look(scene, view, rng)
    v, u = np.mgrid[: seen.depth.shape[0], : seen.depth.shape[1]]
    x, y, one = np.tensordot(seen.matrix, np.stack([u, v, np.ones_like(u)]), axes=1)
    assert (one == 1).all()
    assert (x == x.round()).all()
    x, y = x.astype(int), y.astype(int)
    assert (seen.depth == scene.depth[y, x]).all()
    assert (seen.rgb == scene.rgb[y, x]).all()


def test_the_window_about_the_labels_is_about_them_and_inside():
    labels = Grasps([[100, 60], [120, 80]], [0, 0], [9, 9], [4, 4])
    seen = look(numbered(120, 160, labels), "labels", np.random.default_rng(0))
    assert seen.depth.shape == (75, 75)  # 300 of 480 pixels of the shorter side
    middle = (seen.matrix @ [37.5, 37.5, 1])[:2]
    # Their middle is (110, 70); the window is moved up into the picture.
    assert middle == pytest.approx([110, 70], abs=0.5)
    corner = look(
        numbered(120, 160, labels.transformed(np.array([[1, 0, 45], [0, 1, 45.0]]))),
        "labels",
        np.random.default_rng(0),
    )
    assert (corner.matrix @ [74, 74, 1])[:2] == pytest.approx([159, 119])


def test_augmented_pictures_show_all_turns_and_zooms():
    scene = numbered(100, 140)
    seen = [look(scene, "augmented", np.random.default_rng(seed)) for seed in range(200)]
    sides = [len(view.depth) for view in seen]
    assert min(sides) < 55 < 95 < max(sides)
    turns = {tuple(np.round(view.matrix[0, :2]).astype(int)) for view in seen}
    assert turns == {(1, 0), (0, 1), (-1, 0), (0, -1)}
