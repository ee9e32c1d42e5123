"""Scene: what every data set gives, and the sequence of scenes that a reader is.

Letters in shapes: H rows, W columns of the image.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from graspmap.errors import InvalidInputError
from graspmap.geometry.camera import Camera
from graspmap.geometry.grasps import Grasps
from graspmap.geometry.transforms import RigidTransform

Rgb = NDArray[np.uint8]
Depth = NDArray[np.float32]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Scene:
    """One picture of objects on a table, with what is known about it.

    Args:
        id: Name that is unique within its data set.
        rgb: (H, W, 3) uint8 colour, red first, or None.
        depth: (H, W) float32 metres along the camera's z, NaN where there is none, or None.
        mask: (H, W) bool, True on the object, or None.
        grasps: Labelled grasps that succeed; None where the scene has no labels (an empty
            `Grasps` says that it has labels and none succeeds).
        negatives: Labelled grasps that fail, or None.
        camera: Intrinsics of this picture, or None.
        T_world_camera: Pose of the camera over the table, which is the plane z = 0 of the world (z
            up, metres), or None.
        object_id: Object (or set of objects) shown; scenes with one object_id stay together in
            an object-wise split.
        labels: Class names by kind, for example ``{"specific": "mug", "general": "crockery"}``.

    Raises:
        InvalidInputError: No picture at all, a wrong type or shape, or pictures of unequal size.
    """

    id: str
    rgb: Rgb | None = None
    depth: Depth | None = None
    mask: Mask | None = None
    grasps: Grasps | None = None
    negatives: Grasps | None = None
    camera: Camera | None = None
    T_world_camera: RigidTransform | None = None
    object_id: str | None = None
    labels: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        expected: tuple[tuple[str, Any, tuple[int, ...], Any], ...] = (
            ("rgb", self.rgb, (3,), np.uint8),
            ("depth", self.depth, (), np.float32),
            ("mask", self.mask, (), np.bool_),
        )
        sizes = {}
        for name, image, channels, dtype in expected:
            if image is None:
                continue
            if image.ndim != 2 + len(channels) or image.shape[2:] != channels:
                raise InvalidInputError(
                    f"shape of {name} of scene {self.id}",
                    image.shape,
                    f"(H, W{', 3' * len(channels)})",
                )
            if image.dtype != dtype:
                raise InvalidInputError(
                    f"type of {name} of scene {self.id}", image.dtype, np.dtype(dtype).name
                )
            sizes[name] = image.shape[:2]
        if self.rgb is None and self.depth is None:
            raise InvalidInputError(f"scene {self.id}", "without rgb and depth", "at least one")
        if len(set(sizes.values())) > 1:
            raise InvalidInputError(
                f"image sizes of scene {self.id}", sizes, "equal (rows, columns)"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of its pictures."""
        image = self.rgb if self.rgb is not None else self.depth
        assert image is not None  # for the type checker; __post_init__ saw to it
        return int(image.shape[0]), int(image.shape[1])


class Scenes(Sequence[Scene], ABC):
    """The scenes of one data set, read from disk one at a time; random access, picklable.

    Attributes:
        kind: Kind of data set, as in ``kind:directory``.
        root: Its folder.
        ids: Scene names, sorted the same way on every machine.
        camera: The camera that pictures are taken for, whatever the data set says; None: as it
            says.
    """

    kind: str
    root: Path
    ids: tuple[str, ...]
    camera: Camera | None = None

    @abstractmethod
    def read(self, index: int) -> Scene:
        """Scene number ``index`` (0 to len - 1), read from its files.

        Raises:
            FileError: A file is missing or damaged; the error names it.
        """

    @abstractmethod
    def read_grasps(self, index: int) -> Grasps | None:
        """Labelled grasps of scene ``index`` without opening its pictures."""

    @abstractmethod
    def files(self, index: int) -> tuple[Path, ...]:
        """The files that scene ``index`` is read from (those that exist)."""

    @abstractmethod
    def object_id(self, index: int) -> str | None:
        """Object of scene ``index`` without opening its pictures."""

    def index(self, value: Any, start: int = 0, stop: int | None = None) -> int:
        """Position of the scene with id ``value`` (a `Scene` is looked up by its id)."""
        name = value.id if isinstance(value, Scene) else value
        return self.ids.index(name, start, len(self.ids) if stop is None else stop)

    def subset(self, ids: Sequence[str]) -> Scenes:
        """The scenes named ``ids``, in that order.

        Raises:
            InvalidInputError: An id is not in this data set.
        """
        return _Subset(self, ids)

    def __len__(self) -> int:
        return len(self.ids)

    @overload
    def __getitem__(self, index: int) -> Scene: ...
    @overload
    def __getitem__(self, index: slice) -> Scenes: ...
    def __getitem__(self, index: int | slice) -> Scene | Scenes:
        """One scene, or those of a slice without reading them."""
        if isinstance(index, slice):
            return self.subset(self.ids[index])
        if not -len(self) <= index < len(self):
            raise IndexError(f"scene {index} of {len(self)} in {self.root}")
        return self.read(index % len(self))

    def __iter__(self) -> Iterator[Scene]:
        return (self.read(i) for i in range(len(self)))


class _Subset(Scenes):
    """Some scenes of another data set, in an order of their own."""

    def __init__(self, parent: Scenes, ids: Sequence[str]) -> None:
        positions = {name: i for i, name in enumerate(parent.ids)}
        missing = [name for name in ids if name not in positions]
        if missing:
            raise InvalidInputError(
                "scene ids",
                f"{len(missing)} that {parent.kind}:{parent.root} lacks, first {missing[0]!r}",
                f"ids of its {len(parent)} scenes",
            )
        self.kind, self.root, self.ids = parent.kind, parent.root, tuple(ids)
        self.camera = parent.camera
        self._parent, self._positions = parent, [positions[name] for name in ids]

    def read(self, index: int) -> Scene:
        return self._parent.read(self._positions[index])

    def read_grasps(self, index: int) -> Grasps | None:
        return self._parent.read_grasps(self._positions[index])

    def files(self, index: int) -> tuple[Path, ...]:
        return self._parent.files(self._positions[index])

    def object_id(self, index: int) -> str | None:
        return self._parent.object_id(self._positions[index])
