"""The doctor: right about good data, and about each way in which data can be wrong."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import trimesh

from graspmap.data import Scene, write_jacquard
from graspmap.doctor import examine
from graspmap.doctor.axes import AxisVotes
from graspmap.doctor.meshes import read_mesh
from graspmap.errors import (
    DatasetNotFoundError,
    FileFormatError,
    InvalidInputError,
    MissingFileError,
    UnknownNameError,
)
from graspmap.geometry import Grasps

SIDE = 120


def bar_scene(rng, name, *, mirror=False, turn=0.0):
    """A bright bar on a dark table, with the grasps across it (and no others)."""
    angle = rng.uniform(0.3, 1.2) * rng.choice([-1, 1])  # of the bar; never along an image axis
    center = rng.uniform(45, 75, 2)
    y, x = np.mgrid[:SIDE, :SIDE]
    along = (x - center[0]) * np.cos(angle) - (y - center[1]) * np.sin(angle)
    across = (x - center[0]) * np.sin(angle) + (y - center[1]) * np.cos(angle)
    mask = (np.abs(along) < 32) & (np.abs(across) < 6)
    rgb = np.where(mask[..., None], 220, 60).astype(np.uint8).repeat(3, axis=2)
    depth = np.where(mask, 0.45, 0.5).astype(np.float32)
    offsets = np.linspace(-24, 24, 7)
    centers = center + offsets[:, None] * [np.cos(angle), -np.sin(angle)]
    angles = np.full(7, angle + np.pi / 2) + turn
    grasps = Grasps(centers, -angles if mirror else angles, np.full(7, 20.0), np.full(7, 6.0))
    return Scene(name, rgb, depth, mask, grasps)


@pytest.fixture
def jacquard(tmp_path):
    rng = np.random.default_rng(0)
    for i in range(6):
        scene = bar_scene(rng, f"{i}_bar{i // 2}")
        write_jacquard(scene, tmp_path, stereo_depth=scene.depth)
    return tmp_path


def file_of(root, end):
    return next(iter(sorted(root.rglob(f"0_*{end}"))))


def named(report, path):
    return [p.text for p in report.problems if p.path == str(path)]


def test_a_good_data_set_has_no_problems(jacquard):
    report = examine(f"jacquard:{jacquard}")
    facts = report.to_dict()
    assert report.problems == []
    assert (report.count, facts["scenes"]["objects"]) == (6, 3)
    assert facts["labels"]["total"] == 42
    assert facts["labels"]["width_scale_px"] == pytest.approx(20)
    assert facts["pictures"]["sizes"] == {f"{SIDE}x{SIDE}": 6}
    assert facts["depth"]["perfect"]["low_m"] == pytest.approx(0.45, abs=1e-4)
    assert facts["mask"]["centers_on_mask"] == 1.0
    assert facts["axes"]["best"] == "as read"
    assert facts["files"] == {
        "colour": 6, "mask": 6, "perfect_depth": 6, "stereo_depth": 6, "labels": 6,
    }  # fmt: skip
    assert report.good_for == ("detect (rgb and depth)", "train", "evaluate")
    assert "degrees CLOCKWISE" in report.text()


def test_the_kind_is_found_out(jacquard):
    assert examine(jacquard).kind == "jacquard"


@pytest.mark.parametrize(
    ("end", "content", "part"),
    [
        ("_RGB.png", b"", "empty"),
        ("_mask.png", b"no picture", "picture"),
        ("_perfect_depth.tiff", b"II*\0", "picture"),
        ("_stereo_depth.tiff", b"II*\0", "picture"),
        ("_grasps.txt", b"1;2;3;4\n", "line 1 has 4 numbers"),
        ("_grasps.txt", b"1;2;3;4;5;6\n", "line 1 has 6 numbers"),
        ("_grasps.txt", b"1;2;3;4;5\n1;nan;3;4;5\n", "line 2"),
        ("_grasps.txt", b"1;2;3;-4;5\n", "line 1"),
        ("_grasps.txt", b"1;2;3;0;5\n", "line 1"),
    ],
)
def test_each_broken_file_is_named(jacquard, end, content, part):
    path = file_of(jacquard, end)
    path.write_bytes(content)
    report = examine(f"jacquard:{jacquard}")
    (text,) = named(report, path)
    assert part in text
    assert report.count == 5
    assert len(report.problems) == 1


def test_two_broken_files_of_one_scene_are_both_named(jacquard):
    for end in ("_mask.png", "_grasps.txt"):
        file_of(jacquard, end).write_bytes(b"x")
    report = examine(jacquard)
    assert len(report.problems) == 2
    assert report.count == 5


def test_a_file_that_most_scenes_have_is_missed(jacquard):
    file_of(jacquard, "_mask.png").unlink()
    (problem,) = examine(jacquard).problems
    assert "has no mask" in problem.text


def test_a_stray_file_is_named(jacquard):
    file_of(jacquard, "_RGB.png").unlink()
    report = examine(jacquard)
    assert report.count == 5
    assert sum("belongs to no scene" in p.text for p in report.problems) == 4


def test_what_macos_leaves_beside_each_file_is_no_stray(jacquard):
    for path in list(jacquard.rglob("*_*.*")):
        path.with_name(f"._{path.name}").write_bytes(b"Mac OS X")
    (jacquard / ".Trash").mkdir()
    (jacquard / ".Trash" / "0_gone_mask.png").write_bytes(b"")
    assert examine(jacquard).problems == []


def test_labels_outside_and_doubled_are_counted(jacquard):
    path = file_of(jacquard, "_grasps.txt")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[0], "500;500;0;20;6"]) + "\n")
    labels = examine(jacquard).to_dict()["labels"]
    assert (labels["doubled"], labels["outside"]) == (1, 1)


def test_repeated_jaws_are_not_called_doubled(jacquard):
    path = file_of(jacquard, "_grasps.txt")
    path.write_text(path.read_text() + "\n".join(
        ";".join([*line.split(";")[:4], "12"]) for line in path.read_text().splitlines()
    ) + "\n")  # fmt: skip
    labels = examine(jacquard).to_dict()["labels"]
    assert labels["doubled"] == 0
    assert (labels["total"], labels["different"]) == (49, 42)


@pytest.mark.parametrize(
    ("scale", "part"), [(1000.0, "millimetres"), (0.01, "is that really metres?")]
)
def test_depth_in_another_unit(tmp_path, scale, part):
    scene = bar_scene(np.random.default_rng(1), "0_bar")
    scaled = Scene(scene.id, scene.rgb, scene.depth * np.float32(scale), scene.mask, scene.grasps)
    write_jacquard(scaled, tmp_path)
    report = examine(tmp_path)
    assert part in named(report, file_of(tmp_path, "_perfect_depth.tiff"))[0]


def test_depth_without_a_measurement(tmp_path):
    scene = bar_scene(np.random.default_rng(1), "0_bar")
    holes = np.full((SIDE, SIDE), np.nan, np.float32)
    write_jacquard(Scene(scene.id, scene.rgb, holes, scene.mask, scene.grasps), tmp_path)
    assert "no measured pixel" in examine(tmp_path).problems[0].text


@pytest.mark.parametrize(("mask", "part"), [(np.zeros, "empty"), (np.ones, "whole picture")])
def test_masks_that_say_nothing(tmp_path, mask, part):
    scene = bar_scene(np.random.default_rng(1), "0_bar")
    write_jacquard(
        Scene(scene.id, scene.rgb, None, mask((SIDE, SIDE), bool), scene.grasps), tmp_path
    )
    assert part in examine(tmp_path).problems[0].text


def test_a_mask_of_another_scene(tmp_path):
    scene = bar_scene(np.random.default_rng(1), "0_bar")
    corner = np.zeros((SIDE, SIDE), bool)
    corner[:9, :9] = True
    write_jacquard(Scene(scene.id, scene.rgb, None, corner, scene.grasps), tmp_path)
    assert "another scene's mask" in examine(tmp_path).problems[0].text


@pytest.mark.parametrize("masked", [True, False])
@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, "as read"),
        ({"mirror": True}, "mirrored"),
        ({"turn": np.pi / 2}, "quarter turn"),
    ],
)
def test_wrong_angles_are_recognised(change, verdict, masked):
    rng, votes = np.random.default_rng(3), AxisVotes()
    for i in range(12):
        scene = bar_scene(rng, str(i), **change)
        votes.add(scene if masked else Scene(scene.id, scene.rgb, None, None, scene.grasps))
    assert votes.evidence().best == verdict


def test_swapped_axes_are_recognised():
    rng, votes = np.random.default_rng(3), AxisVotes()
    for i in range(20):
        scene = bar_scene(rng, str(i))
        swapped = Grasps(
            scene.grasps.center[:, ::-1],
            np.pi / 2 - scene.grasps.angle,
            scene.grasps.width,
            scene.grasps.height,
        )
        votes.add(Scene(scene.id, scene.rgb, None, scene.mask, swapped))
    assert votes.evidence().best == "swapped"


def test_few_labels_give_no_verdict():
    votes = AxisVotes()
    votes.add(bar_scene(np.random.default_rng(0), "a"))
    assert votes.evidence().best is None


def test_a_doubtful_data_set_is_complained_about(tmp_path):
    rng = np.random.default_rng(0)
    for i in range(8):
        write_jacquard(bar_scene(rng, f"{i}_bar", mirror=True), tmp_path)
    report = examine(tmp_path)
    assert "sign of the angle" in report.problems[0].text
    assert not report.problems[0].hides
    assert report.usable


def write_cornell(root, lines, number=100):
    import cv2

    root.mkdir(exist_ok=True)
    cv2.imwrite(str(root / f"pcd{number:04d}r.png"), np.zeros((48, 64, 3), np.uint8))
    (root / f"pcd{number:04d}cpos.txt").write_text("\n".join(lines) + "\n")


RECTANGLE = ["10 10", "30 10", "30 20", "10 20"]


def test_cornell_counts_dropped_rectangles(tmp_path):
    write_cornell(tmp_path, [*RECTANGLE, "nan nan", *RECTANGLE[1:], *["5 5"] * 4])
    report = examine(f"cornell:{tmp_path}")
    labels = report.to_dict()["labels"]
    assert (labels["total"], labels["dropped"]) == (1, 2)
    assert labels["opening_px"]["max"] == pytest.approx(20)
    assert "first to second corner is the opening" in report.text()


@pytest.mark.parametrize(
    ("lines", "part"),
    [(RECTANGLE[:3], "rectangle"), ([*RECTANGLE[:3], "1 2 3"], "line 4"), (["a b"] * 4, "line 1")],
)
def test_cornell_names_damaged_labels(tmp_path, lines, part):
    write_cornell(tmp_path, RECTANGLE, 100)
    write_cornell(tmp_path, lines, 101)
    report = examine(tmp_path)
    assert part in named(report, tmp_path / "pcd0101cpos.txt")[0]
    assert report.count == 1


def test_cornell_without_labels_is_for_detection_only(tmp_path):
    write_cornell(tmp_path, RECTANGLE)
    (tmp_path / "pcd0100cpos.txt").unlink()
    assert examine(tmp_path).good_for == ("detect (rgb)",)


def test_what_is_no_data_set(tmp_path, jacquard):
    with pytest.raises(MissingFileError):
        examine(f"cornell:{tmp_path / 'nowhere'}")
    with pytest.raises(DatasetNotFoundError):
        examine(f"cornell:{jacquard}")
    with pytest.raises(UnknownNameError, match="did you mean 'cornell'"):
        examine("cornel:somewhere")
    with pytest.raises(InvalidInputError):
        examine("cornell:")


def test_an_empty_folder_and_a_mixed_one(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetNotFoundError):
        examine(tmp_path / "empty")
    write_cornell(tmp_path, RECTANGLE)
    write_jacquard(bar_scene(np.random.default_rng(0), "0_bar"), tmp_path)
    with pytest.raises(InvalidInputError, match="not clear"):
        examine(tmp_path)


CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) * 0.1
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def obj():
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE]
    return "\n".join([*lines, *("f " + " ".join(f"{i + 1}//1" for i in q) for q in QUADS)]).encode()


def triangles():
    return [(CUBE[q[0]], CUBE[q[i]], CUBE[q[i + 1]]) for q in QUADS for i in (1, 2)]


def stl_binary():
    rows = [struct.pack("<12fH", 0, 0, 0, *np.concatenate(t), 0) for t in triangles()]
    return b"\0" * 80 + struct.pack("<I", len(rows)) + b"".join(rows)


def stl_text():
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in t)
        + "endloop\nendfacet\n"
        for t in triangles()
    )
    return f"solid cube\n{facets}endsolid\n".encode()


def ply(form):
    head = (
        f"ply\nformat {form} 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
        "property float z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if form == "ascii":
        rows = [" ".join(map(str, v)) for v in CUBE] + ["4 " + " ".join(map(str, q)) for q in QUADS]
        return head + "\n".join(rows).encode()
    order = "<" if "little" in form else ">"
    return (
        head
        + CUBE.astype(f"{order}f4").tobytes()
        + b"".join(struct.pack(f"{order}B4i", 4, *q) for q in QUADS)
    )


def by_trimesh(form):
    content = trimesh.creation.box((0.1, 0.1, 0.1)).export(file_type=form)
    return content if isinstance(content, bytes) else content.encode()


FORMS = {
    "a.glb": lambda: by_trimesh("glb"),
    "a.off": lambda: by_trimesh("off"),
    "a.obj": obj,
    "b.stl": stl_binary,
    "c.stl": stl_text,
    "a.ply": lambda: ply("ascii"),
    "b.ply": lambda: ply("binary_little_endian"),
    "c.ply": lambda: ply("binary_big_endian"),
}


@pytest.mark.parametrize("name", FORMS)
def test_every_form_of_mesh_is_the_same_cube(tmp_path, name):
    (tmp_path / name).write_bytes(FORMS[name]())
    mesh = read_mesh(tmp_path / name)
    assert mesh.extents == pytest.approx([0.1] * 3)
    assert len(mesh.faces) == 12
    assert (mesh.edge_uses() == 2).all()
    assert len(mesh.edge_uses()) == 18


@pytest.mark.parametrize("name", [n for n in FORMS if n != "c.stl"])
def test_damaged_meshes_are_named(tmp_path, name):
    content = FORMS[name]()
    for damaged in (b"", content[: len(content) * 2 // 3]):
        (tmp_path / name).write_bytes(damaged)
        if name == "a.obj" and damaged:
            continue  # text that ends early may still be a whole mesh
        with pytest.raises(FileFormatError, match=name):
            read_mesh(tmp_path / name)


def test_a_mesh_whose_comments_are_no_unicode(tmp_path):
    (tmp_path / "a.obj").write_bytes(b"# Gr\xf6\xdfe in Metern\no B\xe4r\n" + obj())
    assert read_mesh(tmp_path / "a.obj").extents == pytest.approx([0.1] * 3)


@pytest.mark.parametrize("bad", ["nan", "inf"])
def test_a_mesh_with_vertices_that_are_none(tmp_path, bad):
    (tmp_path / "a.obj").write_text(f"v {bad} 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(FileFormatError, match="NaN or infinite"):
        read_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize(
    "content", ["# nothing\n", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "v 0 0 0\nl 1 1\n"]
)
def test_a_mesh_without_faces(tmp_path, content):
    (tmp_path / "a.obj").write_text(content)
    with pytest.raises(FileFormatError, match="no faces"):
        read_mesh(tmp_path / "a.obj")


def test_one_mesh_and_all_its_parts(tmp_path):
    scene = trimesh.Scene()
    for x in (0.0, 0.3):
        box = trimesh.creation.box((0.1, 0.1, 0.1))
        scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([x, 0, 0]))
    (tmp_path / "two.glb").write_bytes(scene.export(file_type="glb"))
    report = examine(f"meshes:{tmp_path / 'two.glb'}")
    (item,) = report.to_dict()["items"].values()
    assert item["extents"] == pytest.approx([0.4, 0.1, 0.1])
    assert (item["faces"], item["closed"]) == (24, True)


def test_a_flat_point_is_complained_about(tmp_path):
    (tmp_path / "a.obj").write_text("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n")
    for root in (tmp_path, tmp_path / "a.obj"):
        assert "no extent" in named(examine(f"meshes:{root}"), tmp_path / "a.obj")[0]


def test_meshes_with_a_hole_are_told_apart(tmp_path):
    (tmp_path / "whole.obj").write_bytes(obj())
    (tmp_path / "open.obj").write_bytes(obj().rpartition(b"\n")[0])
    (tmp_path / "broken.obj").write_bytes(b"v 0 0 0\nf 1 2 3\n")
    report = examine(f"meshes:{tmp_path}")
    assert report.count == 2
    assert "open.obj" in dict(report.lines)["surface"]
    assert "lacks" in named(report, tmp_path / "broken.obj")[0]
    assert report.to_dict()["size"]["unit"] == "m"


def test_real_cornell_colour(data_dir):
    report = examine(data_dir / "cornell-rgb")
    facts = report.to_dict()
    assert (report.kind, report.count, report.problems) == ("cornell", 522, [])
    assert facts["labels"]["total"] == 2949
    assert facts["labels"]["outside"] == 19
    assert facts["axes"]["best"] == "as read"


def test_real_cornell_scenes(data_dir):
    report = examine(data_dir / "cornell-raw")
    assert (report.kind, report.count) == ("cornell", 2)
    assert report.good_for == ("detect (rgb and depth)",)
    assert report.to_dict()["pictures"]["sizes"] == {"640x480": 2}


def test_real_jacquard(data_dir):
    report = examine(data_dir / "jacquard")
    facts = report.to_dict()
    assert (report.kind, report.count, report.problems) == ("jacquard", 23, [])
    assert (facts["labels"]["total"], facts["labels"]["different"]) == (2496, 652)
    assert facts["labels"]["opening_px"]["max"] == 207
    assert facts["depth"]["stereo"]["holes_mean"] > 0 == facts["depth"]["perfect"]["holes_mean"]
    assert facts["axes"]["best"] == "as read"


@pytest.mark.parametrize(("folder", "count", "unit"), [("egad", 25, "mm"), ("ycb", 12, "m")])
def test_real_meshes(data_dir, folder, count, unit):
    report = examine(data_dir / folder)
    assert (report.kind, report.count, report.problems) == ("meshes", count, [])
    assert report.to_dict()["size"]["unit"] == unit
    assert report.to_dict()["surface"]["closed"] == count


def test_home_is_found_and_nothing_is_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(MissingFileError, match=str(tmp_path / "nowhere")):
        examine("jacquard:~/nowhere")
    with pytest.raises(InvalidInputError):
        examine("")
