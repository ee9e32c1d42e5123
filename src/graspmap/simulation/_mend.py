"""Making a closed surface of whatever triangles a file holds.

From the mildest means to the strongest: leave as it is; turn faces the same way round and fill
small holes; draw it anew on a grid. All lengths are in parts of the longest side of the mesh.
Letters in shapes: V vertices, F triangles, n cells along a side of the grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from manifold3d import Error, Manifold, Mesh64
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from graspmap.simulation import _child
from graspmap.simulation.hulls import arrays, hull_volume
from graspmap.simulation.solids import mass_properties, open_edges, places

Floats = NDArray[np.float64]
Faces = NDArray[np.int32]

MOST_FACES = 100_000
_FINEST, _COARSEST = 0.0005, 0.01  # what simplifying may move the surface by
_FLAT = 1e-4  # thickness below which a mesh is a sheet of paper
_CELLS = 128
_MARGIN = 6  # free cells round the mesh
_SEALS = (0.0, 1.0, 2.0, 3.0)  # cells by which the surface is thickened to close gaps
_CLOSED_SHARE = 0.1  # of the cells of the surface: what it must enclose to count as closed
_SMALL_HOLE = 0.2  # longest side of a hole that is simply filled
_ASKED = 8  # points of a shell that say whether it lies in another
_MOST_SAMPLES = 6_000_000  # a mesh with more, in half cells, is no surface of anything
_SPECK = 1e-3  # of the whole volume: smaller bodies beside it are dirt
_WALL = 1.2  # half the thickness of what an open surface becomes, cells
_SIMPLIFY_S = 120.0


class CannotMendError(Exception):
    """No body can be made of the triangles; the text says why."""


@dataclass(frozen=True, eq=False)
class Mended:
    """A closed surface.

    Args:
        vertices: (V, 3).
        faces: (F, 3), counter-clockwise seen from outside.
        kept: (V,) for each vertex its number before; None where the vertices are new.
        remarks: What was done to it, in words.
    """

    vertices: Floats
    faces: Faces
    kept: NDArray[np.int64] | None
    remarks: tuple[str, ...] = ()


def mend(vertices: Floats, faces: Faces) -> Mended:
    """A closed surface with a volume above zero.

    Args:
        vertices: (V, 3) whose box has a longest side of 1.
        faces: (F, 3).

    Raises:
        CannotMendError: The triangles are flat, or hold nothing.
    """
    faces = _real(vertices, faces)
    if not len(faces):
        raise CannotMendError("all its triangles are without area")
    _check_thickness(vertices[np.unique(faces)])
    remarks: list[str] = []
    kept: NDArray[np.int64] | None = np.arange(len(vertices))
    if len(faces) > MOST_FACES:
        count = len(faces)
        vertices, faces, moved = _simplified(vertices, faces)
        kept = None
        remarks.append(
            f"{count} triangles simplified to {len(faces)}, moved by at most {moved:.2g} of its "
            "length"
        )
    turned = _turned(vertices, faces)
    if turned is None:
        turned = _turned(vertices, _distinct(vertices, faces))
    if turned is None:
        kept = None
        vertices, turned, remark = _closed(vertices, faces)
        remarks.append(remark)
    clean = _without_specks(vertices, turned)
    if len(clean) < len(turned):
        remarks.append(f"{len(turned) - len(clean)} triangles of specks beside it left out")
    used = np.unique(clean).astype(np.int64)
    faces = np.searchsorted(used, clean).astype(np.int32)
    return Mended(vertices[used], faces, None if kept is None else used, tuple(remarks))


def _closed(vertices: Floats, faces: Faces) -> tuple[Floats, Faces, str]:
    """A closed surface in place of an open one, and what was done."""
    faces = _distinct(vertices, faces)
    holes = open_edges(vertices, faces)
    what = f"{holes} open or wrongly turned edges" if holes else "overlapping surfaces"
    filled = _filled(vertices, faces)
    if filled is not None:
        return *filled, f"{what} mended"
    return (
        *_redrawn(vertices, faces),
        f"{what} could not be mended: it was drawn anew on a grid of {_CELLS} cells along its "
        f"length, and what encloses nothing became a wall {2 * _WALL:g} cells thick",
    )


def _without_specks(vertices: Floats, faces: Faces) -> Faces:
    """Without the bodies that are too small to matter."""
    label = shells(vertices, faces)
    share = np.abs(_shares(vertices, faces, label))
    return np.asarray(faces[(share > _SPECK * share.sum())[label]])


def _real(vertices: Floats, faces: Faces) -> Faces:
    """The faces whose corners are three different places."""
    corners = places(vertices)[faces]
    return np.asarray(faces[(corners != np.roll(corners, 1, axis=1)).all(axis=1)])


def _distinct(vertices: Floats, faces: Faces) -> Faces:
    """Of faces with the same corners one; none of a pair that look opposite ways.

    Such pairs enclose nothing. Where all faces are such pairs, it is a sheet drawn from both sides,
    of which one is left.
    """
    corners = places(vertices)[faces]
    low = corners.argmin(axis=1)
    first, second, third = (
        np.take_along_axis(corners, (low + i)[:, None] % 3, axis=1)[:, 0] for i in range(3)
    )
    sense = np.where(second < third, 1, -1)
    key = places(np.column_stack([first, np.minimum(second, third), np.maximum(second, third)]))
    net = np.bincount(key, sense)
    one = np.unique(key, return_index=True)[1]
    single = one[net != 0]
    return np.asarray(faces[np.sort(single if len(single) else one)])


def _welded(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    """With one vertex for each place."""
    place = places(vertices)
    first = np.unique(place, return_index=True)[1]
    return vertices[first], place[faces].astype(np.int32)


def _check_thickness(points: Floats) -> None:
    spread = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(spread.T @ spread)
    thickness = float(np.ptp(spread @ axes[:, 0]))
    if thickness < _FLAT:
        raise CannotMendError(
            f"it is flat: {thickness:.1g} of its length thick, {_FLAT:g} is the least"
        )


def _simplified(vertices: Floats, faces: Faces) -> tuple[Floats, Faces, float]:
    """Fewer triangles, and how far the surface may have moved."""
    body = _manifold(vertices, faces)
    if body is not None:
        fewer, moved = _lighter(body, _FINEST)
        return (*arrays(fewer), moved)
    try:
        found = _child.call(
            "simplify",
            {"vertices": vertices, "faces": faces, "count": np.array(MOST_FACES)},
            _SIMPLIFY_S,
        )
    except _child.ChildError as error:
        raise CannotMendError(
            f"its {len(faces)} triangles could not be simplified: {error}"
        ) from error
    vertices, faces = found["vertices"], found["faces"]
    return vertices, _real(vertices, faces), 1 / np.sqrt(len(faces))


def _lighter(body: Manifold, tolerance: float) -> tuple[Manifold, float]:
    """With fewer triangles, and how far its surface may have moved."""
    fewer = body.simplify(tolerance)
    while fewer.num_tri() > MOST_FACES and tolerance < _COARSEST:
        tolerance *= 2
        fewer = body.simplify(tolerance)
    return fewer, tolerance


def _manifold(vertices: Floats, faces: Faces) -> Manifold | None:
    points, corners = _welded(vertices, faces)
    mesh: Any = Mesh64(points, corners.astype(np.uint64))
    body = Manifold(mesh)
    return body if body.status() == Error.NoError and body.volume() > 0 else None


def _turned(vertices: Floats, faces: Faces) -> Faces | None:
    """The faces of a closed surface, looking outwards; None where it is not closed."""
    if open_edges(vertices, faces):
        return None
    faces = _bodies_outwards(vertices, faces)
    volume = mass_properties(vertices, faces).volume_m3
    # Shells that run into each other count twice, but nothing can be larger than its hull.
    sound = 0 < volume <= 1.5 * hull_volume(vertices) and _manifold(vertices, faces) is not None
    return faces if sound else None


def _bodies_outwards(vertices: Floats, faces: Faces) -> Faces:
    """With every shell that looks inwards turned, unless it is the wall of a hollow in another."""
    label = shells(vertices, faces)
    shares = _shares(vertices, faces, label)
    if shares.sum() < 0:
        faces, shares = np.ascontiguousarray(faces[:, ::-1]), -shares
    inwards = shares < 0
    if not inwards.any():
        return faces
    corners = vertices[faces[~inwards[label]]]
    wrong = [
        shell
        for shell in np.flatnonzero(inwards)
        if not _enclosed(vertices[np.unique(faces[label == shell])[:_ASKED]], corners)
    ]
    return np.where(np.isin(label, wrong)[:, None], faces[:, ::-1], faces)


def _enclosed(points: Floats, corners: Floats) -> bool:
    """Whether all points lie inside closed surfaces: the solid angle of these is a whole sphere.

    Args:
        points: (P, 3) points.
        corners: (F, 3, 3) corners of the triangles, counter-clockwise seen from outside.

    References:
        A. van Oosterom, J. Strackee: The solid angle of a plane triangle, 1983.
    """
    for point in points:
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        ab, bc, ca = ((u * v).sum(axis=1) for u, v in ((a, b), (b, c), (c, a)))
        volume = (a * np.cross(b, c)).sum(axis=1)
        angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum()
        if angle < 2 * np.pi:
            return False
    return True


def _filled(vertices: Floats, faces: Faces) -> tuple[Floats, Faces] | None:
    """With faces turned alike and small holes filled; None where it does not become a body."""
    import trimesh

    mesh = trimesh.Trimesh(*_welded(vertices, faces), process=False)
    trimesh.repair.fix_winding(mesh)  # type: ignore[no-untyped-call]
    welded = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int32)
    points, triangles = _with_lids(*welded)
    if open_edges(points, triangles):
        return None
    label = shells(points, triangles)
    inwards = _shares(points, triangles, label) < 0
    triangles = np.where(inwards[label][:, None], triangles[:, ::-1], triangles)
    turned = _turned(points, triangles)
    return None if turned is None else (points, turned)


def _with_lids(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    """With a fan of triangles over each small hole."""
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2).astype(np.int64)
    forward, backward = edges @ [len(vertices), 1], edges @ [1, len(vertices)]
    rim = edges[~np.isin(forward, backward)]
    if not len(rim):
        return vertices, faces
    graph = coo_matrix((np.ones(len(rim)), rim.T), shape=(len(vertices),) * 2)
    label = connected_components(graph, directed=False)[1][rim[:, 0]]
    points, lids = [vertices], [faces]
    count = len(vertices)
    for loop in np.unique(label):
        around = rim[label == loop]
        corners = vertices[np.unique(around)]
        if np.ptp(corners, axis=0).max() <= _SMALL_HOLE:
            points.append(corners.mean(axis=0, keepdims=True))
            middle = np.full(len(around), count)
            lids.append(np.column_stack([around[:, 1], around[:, 0], middle]).astype(np.int32))
            count += 1
    return np.concatenate(points), np.concatenate(lids)


def shells(vertices: Floats, faces: Faces) -> NDArray[np.int64]:
    """(F,) number of the connected surface that each face belongs to."""
    place = places(vertices)[faces]
    pairs = np.concatenate([place[:, :2], place[:, 1:]])
    size = int(place.max()) + 1
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(size, size))
    label = connected_components(graph, directed=False)[1][place[:, 0]]
    return np.unique(label, return_inverse=True)[1].reshape(-1)


def _shares(vertices: Floats, faces: Faces, label: NDArray[np.int64]) -> Floats:
    """Volume inside each of the shells."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return np.bincount(label, (a * np.cross(b, c)).sum(axis=1)) / 6


def _redrawn(vertices: Floats, faces: Faces) -> tuple[Floats, Faces]:
    """The surface between inside and outside on a grid; walls where there is no inside."""
    from skimage.measure import marching_cubes

    cell = 1 / _CELLS
    low = vertices.min(axis=0) - _MARGIN * cell
    surface = _marked((vertices - low) / cell, faces)
    level = ndimage.gaussian_filter(_level(surface), 0.7)
    points, triangles, _, _ = marching_cubes(level, 0.0)  # type: ignore[no-untyped-call]
    body = _manifold(low + points.astype(np.float64) * cell, triangles)
    if body is None:
        raise CannotMendError("its triangles enclose nothing")
    parts = body.decompose()
    largest = max(part.volume() for part in parts)
    kept = [part for part in parts if part.volume() > 0.01 * largest]
    return arrays(_lighter(Manifold.compose(kept), 0.2 * cell)[0])


def _marked(vertices: Floats, faces: Faces) -> NDArray[np.bool_]:
    """The cells, of side 1, that triangles run through; a margin round them stays free."""
    surface = np.zeros(np.ceil(vertices.max(axis=0)).astype(int) + _MARGIN + 1, np.bool_)
    corners = vertices[faces]
    longest = np.sqrt(((corners - np.roll(corners, 1, axis=1)) ** 2).sum(axis=2)).max(axis=1)
    steps = np.maximum(np.ceil(2 * longest), 1).astype(np.int64)  # half a cell each
    if (steps**2).sum() > _MOST_SAMPLES:
        raise CannotMendError("it is open, and a tangle of triangles")
    for count in np.unique(steps):
        i, j = np.mgrid[0 : count + 1, 0 : count + 1].reshape(2, -1)[:, :, None] / count
        inside = (i + j <= 1 + 1e-9)[:, 0]
        weights = np.concatenate([i, j, 1 - i - j], axis=1)[inside]
        group = corners[steps == count]
        chunk = max(1, 1_000_000 // len(weights))
        for start in range(0, len(group), chunk):
            points = np.einsum("sc,tcx->tsx", weights, group[start : start + chunk])
            cells = np.round(points).astype(np.int64).reshape(-1, 3)
            surface[cells[:, 0], cells[:, 1], cells[:, 2]] = True
    return surface


def _level(surface: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Below zero inside, on a grid whose cells at the surface are marked.

    Gaps of a few cells do not matter: the surface is made thicker until it encloses something, and
    the level is the middle between what is then inside and outside.
    """
    away = ndimage.distance_transform_edt(~surface)
    wall = away - _WALL
    for thick in _SEALS:
        label, _ = ndimage.label(away > thick)
        outside = label == label[0, 0, 0]
        inside = (label > 0) & ~outside
        if inside.sum() > _CLOSED_SHARE * (away <= thick).sum():
            to_inside = ndimage.distance_transform_edt(~inside)
            middle = (to_inside - ndimage.distance_transform_edt(~outside)) / 2
            return np.asarray(np.where(to_inside > thick + 3, np.minimum(middle, wall), middle))
    return np.asarray(wall)
