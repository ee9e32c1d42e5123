"""The doctor's look at data sets of labelled scenes.

All label files are read; of the pictures at most `MOST_PICTURES` scenes, evenly spread.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from graspmap.data import files
from graspmap.data.cornell import CornellScenes, read_labels
from graspmap.data.jacquard import JacquardScenes
from graspmap.data.kinds import read_scenes
from graspmap.data.png import png_shape
from graspmap.data.scene import Scene, Scenes
from graspmap.doctor.axes import READINGS, AxisVotes
from graspmap.doctor.labels import LabelCount, explain_line
from graspmap.doctor.report import Report, Update, nothing
from graspmap.errors import FileError, GraspmapError

MOST_PICTURES = 1000
"""Scenes whose pictures are opened, unless all are asked for."""
_SIZE = 300
"""Side of a network's input for which a width scale is suggested, pixels."""
_NEAR_M, _FAR_M = 0.1, 10.0
"""What depth cameras for grasping measure; medians outside are another unit."""


def examine_scenes(
    root: Path, *, kind: str, progress: Update = nothing, everything: bool = False
) -> Report:
    """Look through a data set of scenes.

    Args:
        root: Its folder.
        kind: One of `graspmap.data.KINDS`.
        progress: Called with (done, total).
        everything: Open the pictures of all scenes, however many there are.

    Raises:
        DatasetNotFoundError: The folder does not exist or holds no such scene.
    """
    scenes = read_scenes(f"{kind}:{root}")
    report = Report(kind, root)
    look = _Look(report, scenes)
    opened = range(len(scenes))
    if not everything and len(scenes) > MOST_PICTURES:
        opened = sorted({round(i) for i in np.linspace(0, len(scenes) - 1, MOST_PICTURES)})  # type: ignore[assignment]
    wanted = set(opened)
    for index in range(len(scenes)):
        progress(index, len(scenes))
        look.at(index, pictures=index in wanted)
    look.strays()
    look.finish(len(wanted))
    return report


class _Look:
    """What is gathered while the scenes pass by, and the report at the end."""

    def __init__(self, report: Report, scenes: Scenes) -> None:
        self.report, self.scenes = report, scenes
        self.labels = LabelCount()
        self.negatives = LabelCount()
        self.votes = AxisVotes()
        self.parts: Counter[str] = Counter()
        self.sizes: Counter[tuple[int, int]] = Counter()
        self.depth: dict[str, list[NDArray[np.float64]]] = {}
        self.cover: list[float] = []
        self.dropped: dict[str, int] = {}
        self.on_mask: list[NDArray[np.bool_]] = []
        self.broken: set[int] = set()
        self.openable = {"rgb": 0, "depth": 0, "labels": 0}

    def at(self, index: int, *, pictures: bool) -> None:
        """Look at one scene."""
        names = [path.name for path in _all_files(self.scenes, index)]
        self.parts.update(_part(name) for name in names)
        try:
            grasps = self.scenes.read_grasps(index)
            scene = self.scenes.read(index) if pictures else None
        except GraspmapError as error:
            self.broken.add(index)
            self._blame(index, error)
            return
        self._dropped(index)
        shape = scene.shape if scene is not None else png_shape(_all_files(self.scenes, index)[0])
        self.labels.add(grasps, shape)
        self.openable["labels"] += grasps is not None and len(grasps) > 0
        if scene is not None:
            self._pictures(index, scene)

    def _pictures(self, index: int, scene: Scene) -> None:
        self.sizes[scene.shape[1], scene.shape[0]] += 1
        self.openable["rgb"] += scene.rgb is not None
        self.openable["depth"] += scene.depth is not None
        self.negatives.add(scene.negatives, scene.shape)
        self.votes.add(scene)
        if scene.depth is not None:
            own = "perfect" if self.report.kind == "jacquard" else "depth"
            self._depth(own, scene.depth, _path_of(self.scenes, index, "depth"))
        if isinstance(self.scenes, JacquardScenes):
            stereo = self.scenes.paths(index).stereo_depth
            if stereo is not None:
                self._second_depth(index, stereo, scene.shape)
        if scene.mask is not None:
            self._mask(index, scene)

    def _second_depth(self, index: int, path: Path, shape: tuple[int, int]) -> None:
        try:
            depth = files.read_depth(path)
        except FileError as error:
            self._complain(index, path, error.problem)
            return
        if depth.shape != shape:
            found = f"{depth.shape[1]} x {depth.shape[0]}"
            self._complain(index, path, f"is {found} px, its colour {shape[1]} x {shape[0]} px")
            return
        self._depth("stereo", depth, path)

    def _depth(self, name: str, depth_m: NDArray[np.float32], path: Path) -> None:
        known = depth_m[np.isfinite(depth_m)]
        if not known.size:
            self.report.complain(path, "has no measured pixel at all")
            return
        nearest, low, middle, high, farthest = np.percentile(known, [0, 0.1, 50, 99.9, 100])
        holes = 1 - known.size / depth_m.size
        row = np.array([low, high, holes, middle, nearest, farthest])
        self.depth.setdefault(name, []).append(row)
        if not _NEAR_M <= middle <= _FAR_M:
            text = f"its median depth is {middle:.4g} m: is that really metres?"
            self.report.complain(path, text, hides=False)
        elif holes > 0.5:
            self.report.complain(path, f"{holes:.0%} of its depth is missing", hides=False)

    def _mask(self, index: int, scene: Scene) -> None:
        assert scene.mask is not None  # for the type checker
        share = float(scene.mask.mean())
        path = _path_of(self.scenes, index, "mask")
        self.cover.append(share)
        if share in (0.0, 1.0):
            self.report.complain(path, "is empty" if not share else "covers the whole picture")
            return
        if scene.grasps is None or not len(scene.grasps):
            return
        hit = _inside(scene.mask, scene.grasps.center)
        self.on_mask.append(hit)
        if hit.mean() < 0.2:
            text = f"only {hit.mean():.0%} of the label centres lie on it: another scene's mask?"
            self.report.complain(path, text, hides=False)

    def _blame(self, index: int, error: GraspmapError) -> None:
        """Name every broken file of a scene that cannot be read."""
        found = 0
        for path in _all_files(self.scenes, index):
            try:
                _probe(path)
            except FileError as problem:
                self.report.complain(path, problem.problem)
                found += 1
        first = getattr(error, "path", None)
        named = {problem.path for problem in self.report.problems}
        if not found or (first is not None and str(first) not in named):
            where = first or self.scenes.ids[index]
            self.report.complain(where, getattr(error, "problem", str(error)))

    def _complain(self, index: int, path: Path, text: str) -> None:
        self.broken.add(index)
        self.report.complain(path, text)

    def strays(self) -> None:
        """Name files that belong to no scene, and scenes that lack what the others have."""
        scenes, report = self.scenes, self.report
        used = {path for i in range(len(scenes)) for path in _all_files(scenes, i)}
        patterns = _PATTERNS[report.kind]
        for path in sorted(p for pattern in patterns for p in report.root.rglob(pattern)):
            # macOS keeps a hidden file beside each; hidden folders hold what is nobody's scene.
            hidden = any(part.startswith(".") for part in path.relative_to(report.root).parts)
            if path not in used and path.is_file() and not hidden:
                report.complain(path, "belongs to no scene: its colour picture is missing")
        for part, count in sorted(self.parts.items()):
            if part in _EXPECTED and len(scenes) / 2 <= count < len(scenes):
                for index in range(len(scenes)):
                    names = {_part(path.name) for path in _all_files(scenes, index)}
                    if part not in names:
                        report.complain(scenes.ids[index], f"has no {part}, unlike most scenes")

    def finish(self, opened: int) -> None:
        """Write the sections of the report."""
        report, scenes = self.report, self.scenes
        report.count = len(scenes) - len(self.broken)
        objects = {scenes.object_id(i) for i in range(len(scenes))} - {None}
        report.good_for = self._good_for()
        sampled = "" if opened == len(scenes) else f"; pictures of {opened} opened"
        broken = f", {len(self.broken)} of them broken" if self.broken else ""
        report.say(
            "scenes",
            f"{len(scenes)}{broken}, {len(objects)} objects or groups{sampled}",
            total=len(scenes),
            broken=len(self.broken),
            objects=len(objects),
            opened=opened,
        )
        use = ", ".join(report.good_for) or "nothing"
        why = "" if self.openable["labels"] else " (no labels: neither training nor evaluation)"
        report.say("good for", use + why)
        parts = ", ".join(f"{name} {self.parts[name]}" for name in sorted(self.parts))
        report.say("files", parts, **{k.replace(" ", "_"): v for k, v in self.parts.items()})
        sizes = {f"{w}x{h}": n for (w, h), n in self.sizes.most_common()}
        shown = ", ".join(f"{size} ({n})" for size, n in list(sizes.items())[:4])
        more = f" and {len(sizes) - 4} other sizes" if len(sizes) > 4 else ""
        report.say("pictures", (shown or "none could be opened") + more, sizes=sizes)
        self._label_lines()
        self._depth_lines()
        self._mask_lines()
        self._axis_lines()

    def _good_for(self) -> tuple[str, ...]:
        if not self.report.count:
            return ()
        seen = [name for name in ("rgb", "depth") if self.openable[name]]
        uses = [f"detect ({' and '.join(seen)})"] if seen else []
        return (*uses, "train", "evaluate") if self.openable["labels"] else tuple(uses)

    def _label_lines(self) -> None:
        side = max((max(size) for size in self.sizes), default=0)
        self.labels.report(self.report, "labels", side, _SIZE)
        if isinstance(self.scenes, CornellScenes):
            self._cornell_lines()
        for section, sentence in explain_line(self.report.kind, self.scenes):
            self.report.say(section, sentence)

    def _dropped(self, index: int) -> None:
        if not isinstance(self.scenes, CornellScenes):
            return
        paths = self.scenes.paths(index)
        for path in (paths.positives, paths.negatives):
            if path is not None and (count := read_labels(path).dropped):
                self.dropped[path.name] = count

    def _cornell_lines(self) -> None:
        if self.negatives.files:
            self.negatives.report(self.report, "negatives", 0, 0)
        if self.labels.files or self.negatives.files:
            total = sum(self.dropped.values())
            where = f" (in {', '.join(sorted(self.dropped)[:5])})" if total else ""
            text = f"{total} more rectangles left out: NaN or without area{where}"
            self.report.say("labels", text, dropped=total, dropped_by_file=self.dropped)

    def _depth_lines(self) -> None:
        for name, rows in self.depth.items():
            table = np.array(rows)
            holes = table[:, 2]
            low, high = float(table[:, 0].min()), float(table[:, 1].max())
            nearest, farthest = float(table[:, 4].min()), float(table[:, 5].max())
            missing = (
                "no holes"
                if not holes.max()
                else f"holes {holes.mean():.2%} on average, {holes.max():.2%} at most"
            )
            self.report.say(
                "depth",
                f"{name}: {low:.3f} to {high:.3f} m but for stray pixels ({nearest:.3f} to "
                f"{farthest:.3f}), median {np.median(table[:, 3]):.3f}, {missing}",
                **{
                    name: {
                        "scenes": len(rows),
                        "nearest_m": nearest,
                        "farthest_m": farthest,
                        "low_m": low,
                        "high_m": high,
                        "median_m": float(np.median(table[:, 3])),
                        "holes_mean": float(holes.mean()),
                        "holes_max": float(holes.max()),
                    }
                },
            )
        if not self.depth:
            self.report.say("depth", "none: colour only")
        elif self.parts["depth"] and not self.parts["point cloud"]:
            self.report.say(
                "depth",
                "a d.tiff of this data set usually holds the distance from the origin of its point "
                "cloud, holes filled, not z along the camera's axis: no grasps in metres from it",
            )

    def _mask_lines(self) -> None:
        if not self.cover:
            self.report.say("mask", "none")
            return
        on = float(np.concatenate(self.on_mask).mean()) if self.on_mask else None
        centres = "" if on is None else f"; {on:.1%} of the label centres lie on it"
        self.report.say(
            "mask",
            f"covers {min(self.cover):.1%} to {max(self.cover):.1%} of the picture{centres}",
            cover_min=min(self.cover),
            cover_max=max(self.cover),
            centers_on_mask=on,
        )

    def _axis_lines(self) -> None:
        evidence = self.votes.evidence()
        if not evidence.count:
            return
        fits = ", ".join(f"{name} {fit:.2f}" for name, fit in evidence.fit.items())
        if evidence.best is None:
            verdict = f"{evidence.count} labels are too few to tell"
        elif evidence.best == "as read":
            verdict = "right: no other reading fits the pictures better"
        else:
            verdict = f"DOUBTFUL: the labels fit better {READINGS[evidence.best]}"
            self.report.complain(
                self.report.root,
                f"the labels fit the pictures better {READINGS[evidence.best]} ({fits}); look at "
                "the contact sheet (--sheet FILE)",
                hides=False,
            )
        self.report.say(
            "axes",
            f"{verdict}; change along the opening (0.5 is chance): {fits}"
            if evidence.fit
            else verdict,
            fit=evidence.fit,
            labels=evidence.count,
            best=evidence.best,
        )


_EXPECTED = ("mask", "perfect depth", "stereo depth", "labels", "depth")
_PATTERNS = {
    "cornell": ("pcd????cpos.txt", "pcd????cneg.txt", "pcd????d.tiff", "pcd????.txt"),
    "jacquard": (
        "*_grasps.txt",
        "*_mask.png",
        "*_perfect_depth.tiff",
        "*_stereo_depth.tiff",
    ),
}
_PARTS = {
    "_RGB.png": "colour",
    "_mask.png": "mask",
    "_perfect_depth.tiff": "perfect depth",
    "_stereo_depth.tiff": "stereo depth",
    "_grasps.txt": "labels",
    "_camera.json": "camera",
    "_negatives.txt": "failed grasps",
    "_scene.json": "scene record",
    "r.png": "colour",
    "d.tiff": "depth",
    "cpos.txt": "labels",
    "cneg.txt": "negative labels",
    ".txt": "point cloud",
}


def _part(name: str) -> str:
    """What a file of a scene holds, from the end of its name."""
    return next((part for end, part in _PARTS.items() if name.endswith(end)), "other")


def _all_files(scenes: Scenes, index: int) -> tuple[Path, ...]:
    """All files of a scene, also those that the reader leaves alone."""
    if isinstance(scenes, JacquardScenes | CornellScenes):
        paths = scenes.paths(index)
        found = (getattr(paths, field.name) for field in fields(paths))
        return tuple(path for path in found if path is not None)
    return scenes.files(index)


def _path_of(scenes: Scenes, index: int, part: str) -> Path:
    ends = {"depth": ("depth", "perfect depth", "point cloud"), "mask": ("mask",)}[part]
    return next((p for p in scenes.files(index) if _part(p.name) in ends), scenes.root)


def _probe(path: Path) -> None:
    part = _part(path.name)
    if part == "colour":
        files.read_rgb(path)
    elif part == "mask":
        files.read_mask(path)
    elif part.endswith("depth"):
        files.read_depth(path)


def _inside(mask: NDArray[np.bool_], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(N,) whether each point (x, y) lies on a True pixel."""
    x, y = np.rint(points).astype(int).T
    seen = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
    hit = np.zeros(len(points), dtype=bool)
    hit[seen] = mask[y[seen], x[seen]]
    return hit
