"""Convex pieces: they fill the body and little more, come from the cache, and survive failures."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from manifold3d import Manifold
from scipy.spatial import ConvexHull

from graspmap.errors import InvalidInputError, UnknownNameError
from graspmap.simulation import _child, pieces
from graspmap.simulation.hulls import fewer_vertices, hull
from graspmap.simulation.pieces import PiecesWarning, convex_pieces

TORUS = trimesh.creation.torus(0.05, 0.015, major_sections=24, minor_sections=12)


def angle_bracket():
    """An L of two bars, 100 mm by 80 mm, 20 mm thick."""
    outline = [(0, 0), (0.1, 0), (0.1, 0.02), (0.02, 0.02), (0.02, 0.08), (0, 0.08)]
    from shapely import Polygon

    return trimesh.creation.extrude_polygon(Polygon(outline), 0.02)


BRACKET = angle_bracket()
LUMP = trimesh.boolean.union([BRACKET, trimesh.creation.icosphere(2, 0.03)])


def decompose(mesh, **options):
    return convex_pieces(np.array(mesh.vertices), np.array(mesh.faces), **options)


def union_volume(found):
    bodies = [Manifold.hull_points(piece) for piece in found]
    whole = bodies[0]
    for body in bodies[1:]:
        whole += body
    return whole.volume()


def same(a, b):
    return len(a) == len(b) and all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


class TestCuts:
    def test_a_bracket_is_two_bars(self, tmp_path):
        found = decompose(BRACKET, cache=tmp_path)
        assert len(found) == 2
        assert sum(ConvexHull(p).volume for p in found) == pytest.approx(BRACKET.volume, rel=1e-6)
        assert union_volume(found) == pytest.approx(BRACKET.volume, rel=1e-6)

    def test_hulls_stay_near_the_surface(self, tmp_path):
        """No hull reaches farther out of a ring than allowed, and none of it is lost."""
        found = decompose(TORUS, threshold=0.03, cache=tmp_path)
        assert 6 <= len(found) <= 40
        corners = np.concatenate(found)
        rng = np.random.default_rng(0)
        weights = rng.dirichlet(np.ones(4), 4000)
        for piece in found:
            inside = np.einsum("nk,nkx->nx", weights, piece[rng.integers(0, len(piece), (4000, 4))])
            around = np.hypot(inside[:, 0], inside[:, 1]) - 0.05
            assert (np.hypot(around, inside[:, 2]) - 0.015).max() < 1.3 * 0.03 * 0.13
        assert union_volume(found) >= 0.98 * TORUS.volume
        assert np.ptp(corners, axis=0) == pytest.approx(np.ptp(TORUS.vertices, axis=0), rel=0.02)

    def test_a_thin_bowl_stays_hollow(self, tmp_path):
        """Every vertex of a thin wall is near its hull; the hollow is not."""
        outer, inner = (Manifold.sphere(r, 24) for r in (0.08, 0.076))
        mesh = (outer - inner).trim_by_plane((0, 0, -1), 0).to_mesh64()
        bowl = trimesh.Trimesh(mesh.vert_properties[:, :3], mesh.tri_verts)
        found = decompose(bowl, threshold=0.04, cache=tmp_path)
        assert all(ConvexHull(p).volume < 0.15 * bowl.convex_hull.volume for p in found)
        assert union_volume(found) < 4 * bowl.volume

    def test_convex_bodies_are_one_piece_without_a_search(self, tmp_path, monkeypatch):
        monkeypatch.setattr(_child, "call", lambda *_, **__: pytest.fail("called"))
        ball = trimesh.creation.icosphere(4, 0.04)
        for method in ("cuts", "coacd"):
            (only,) = decompose(ball, method=method, cache=tmp_path)
            assert len(only) == 128
            assert np.linalg.norm(only, axis=1) == pytest.approx(0.04)

    @settings(max_examples=10)
    @given(st.tuples(*[st.floats(-3, 3)] * 3), st.floats(0.01, 100))
    def test_place_and_size_of_the_surface_do_not_matter(self, tmp_path, shift, scale):
        plain = decompose(BRACKET, cache=tmp_path)
        moved = np.array(BRACKET.vertices) * scale + shift
        other = convex_pieces(moved, BRACKET.faces, cache=tmp_path)
        assert len(plain) == len(other)
        for a, b in zip(plain, other, strict=True):
            assert a * scale + shift == pytest.approx(b, abs=1e-6 * scale + 1e-9)

    def test_bodies_that_run_into_each_other_are_united(self, tmp_path):
        bars = [trimesh.creation.box((0.1, 0.02, 0.02)), trimesh.creation.box((0.02, 0.1, 0.02))]
        found = decompose(trimesh.util.concatenate(bars), cache=tmp_path)
        assert len(found) == 3
        assert union_volume(found) == pytest.approx(0.02**3 * 9, rel=1e-6)

    def test_another_process_finds_the_same(self, tmp_path):
        given, out = tmp_path / "in.npz", tmp_path / "out.npz"
        np.savez(given, vertices=LUMP.vertices, faces=LUMP.faces)
        code = (
            "import sys, numpy as np; from graspmap.simulation.pieces import convex_pieces;"
            "a = np.load(sys.argv[1]); found = convex_pieces(**a, cache=sys.argv[3]);"
            "np.savez(sys.argv[2], *found)"
        )
        subprocess.run([sys.executable, "-c", code, given, out, tmp_path / "other"], check=True)
        mine = decompose(LUMP, cache=tmp_path)
        with np.load(out) as other:
            assert same(mine, [other[name] for name in other.files])
        assert len(mine) > 2


class TestFewerVertices:
    @settings(max_examples=20)
    @given(st.integers(0, 1000), st.integers(26, 200))
    def test_loses_at_most_what_it_says(self, seed, most):
        rng = np.random.default_rng(seed)
        points = rng.normal(size=(400, 3)) * rng.uniform(0.1, 1, 3)
        points /= np.linalg.norm(points, axis=1)[:, None] ** rng.integers(0, 2)
        few, lost = fewer_vertices(points, most)
        assert len(few) <= most
        assert {tuple(p) for p in few} <= {tuple(p) for p in points}
        equations = ConvexHull(few).equations
        outside = (points @ equations[:, :3].T + equations[:, 3]).max()
        assert outside == pytest.approx(lost, abs=1e-9)

    def test_keeps_small_hulls(self):
        points = np.random.default_rng(0).normal(size=(20, 3))
        few, lost = fewer_vertices(points, 128)
        assert lost == 0
        assert len(few) == len(ConvexHull(points).vertices)

    def test_hull_agrees_with_qhull(self):
        points = np.random.default_rng(1).normal(size=(300, 3))
        vertices, faces = hull(points)
        found = trimesh.Trimesh(vertices, faces)
        assert found.is_volume
        assert found.volume == pytest.approx(ConvexHull(points).volume)


class TestCache:
    def test_a_second_call_does_not_compute(self, tmp_path, monkeypatch):
        first = decompose(BRACKET, cache=tmp_path)
        monkeypatch.setattr(pieces, "_decompose", lambda *_: pytest.fail("computed again"))
        assert same(first, decompose(BRACKET, cache=tmp_path))
        assert same(first, decompose(BRACKET, cache=tmp_path, seed=7, timeout_s=1))  # not of cuts

    @pytest.mark.parametrize(
        "options", [{"threshold": 0.05}, {"max_vertices": 32}, {"method": "coacd"}]
    )
    def test_other_settings_are_other_pieces(self, tmp_path, monkeypatch, options):
        decompose(BRACKET, cache=tmp_path)
        monkeypatch.setattr(pieces, "_decompose", lambda *_: ([np.eye(3)], ""))
        assert len(decompose(BRACKET, cache=tmp_path, **options)) == 1

    @pytest.mark.parametrize("content", [b"", b"PK", b"nonsense" * 100, "cut", "flipped", "other"])
    def test_damaged_files_are_made_again(self, tmp_path, content):
        first = decompose(BRACKET, cache=tmp_path)
        (file,) = tmp_path.rglob("*.npz")
        whole = file.read_bytes()
        if content == "cut":
            content = whole[: len(whole) // 2]
        elif content == "flipped":
            middle = len(whole) // 3
            content = whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
        elif content == "other":
            np.savez(file, **{"remark": np.array(""), "00000": np.zeros((4, 2))})
            content = file.read_bytes()
        file.write_bytes(content)
        assert same(first, decompose(BRACKET, cache=tmp_path))
        assert file.read_bytes() == whole

    def test_a_folder_that_cannot_be_written_costs_time_only(self, tmp_path):
        (tmp_path / "pieces").write_text("in the way")
        assert len(decompose(BRACKET, cache=tmp_path)) == 2

    def test_several_writers(self, tmp_path):
        code = (
            "import sys, numpy as np; from graspmap.simulation.pieces import convex_pieces;"
            "a = np.load(sys.argv[1]);"
            "[convex_pieces(a['vertices'] * [1, 1, 1 + i / 9], a['faces'], cache=sys.argv[2])"
            " for i in range(30)]"
        )
        box = trimesh.creation.box((1, 2, 3))
        np.savez(tmp_path / "box.dat", vertices=box.vertices, faces=box.faces)
        command = [sys.executable, "-c", code, tmp_path / "box.dat.npz", tmp_path / "cache"]
        assert [p.wait() for p in [subprocess.Popen(command) for _ in range(2)]] == [0, 0]
        assert len(list((tmp_path / "cache").rglob("*.npz"))) == 30
        assert not list(tmp_path.rglob("*.part"))


class TestChild:
    def test_coacd_really_runs(self, tmp_path):
        found = decompose(BRACKET, threshold=0.2, method="coacd", cache=tmp_path)
        assert len(found) == 2
        assert union_volume(found) == pytest.approx(BRACKET.volume, rel=0.02)

    @staticmethod
    def program(monkeypatch, tmp_path, code):
        """Let the child run other code; returns the file in which it counts its starts."""
        starts = tmp_path / "starts"
        head = f"open({str(starts)!r}, 'a').write('x')\n"
        call = _child.call

        def other(task, arrays, timeout_s):
            return call(task, arrays, timeout_s, program=[sys.executable, "-c", head + code])

        monkeypatch.setattr(_child, "call", other)
        return starts

    def test_an_abort_is_tried_twice_and_then_cut(self, tmp_path, monkeypatch):
        starts = self.program(monkeypatch, tmp_path, "import os; os.abort()")
        with pytest.warns(PiecesWarning, match="CoACD failed: ended with code -6"):
            found = decompose(BRACKET, method="coacd", cache=tmp_path)
        assert starts.read_text() == "xx"
        assert len(found) == 2
        # The warning belongs to the pieces, and comes out of the cache with them.
        with pytest.warns(PiecesWarning, match="made by cuts"):
            assert same(found, decompose(BRACKET, method="coacd", cache=tmp_path))
        assert starts.read_text() == "xx"

    def test_a_hanging_child_is_killed(self, tmp_path, monkeypatch):
        note = tmp_path / "pid"
        code = f"import os, time; open({str(note)!r}, 'w').write(str(os.getpid())); time.sleep(99)"
        self.program(monkeypatch, tmp_path, code)
        start = time.monotonic()
        with pytest.warns(PiecesWarning, match="not done after 1 s"):
            assert len(decompose(BRACKET, method="coacd", timeout_s=1, cache=tmp_path)) == 2
        assert time.monotonic() - start < 30
        with pytest.raises(ProcessLookupError):
            os.kill(int(note.read_text()), 0)

    def test_the_last_words_of_the_child_are_told(self):
        with pytest.raises(_child.ChildError, match=r"ended with code 3.*no way") as caught:
            _child.call(
                "t",
                {},
                60,
                program=[
                    sys.executable,
                    "-c",
                    "import sys; print('no way', file=sys.stderr); sys.exit(3)",
                ],
            )
        assert not caught.value.late

    def test_silence_is_failure_too(self):
        with pytest.raises(_child.ChildError, match="ended with code 0"):
            _child.call("t", {}, 60, program=[sys.executable, "-c", ""])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"threshold": 0}, "threshold"),
        ({"threshold": np.nan}, "threshold"),
        ({"method": "vhacd"}, "cuts, coacd"),
        ({"max_vertices": 8}, "max_vertices"),
        ({"timeout_s": 0}, "timeout_s"),
    ],
)
def test_refuses_settings(tmp_path, options, words):
    with pytest.raises((InvalidInputError, UnknownNameError), match=words):
        decompose(BRACKET, cache=tmp_path, **options)


@pytest.mark.parametrize("faces", [BRACKET.faces[1:], BRACKET.faces[:, ::-1]])
def test_refuses_surfaces(tmp_path, faces):
    with pytest.raises(InvalidInputError, match="surface"):
        convex_pieces(BRACKET.vertices, faces, cache=tmp_path)
