"""The record of a generated scene: all that it takes to try a grasp on it later.

``<i>_<object>_scene.json`` beside the pictures holds the objects and where they lie, the camera,
the gripper and the settings that the labels were tried with, the light and the colours, the seeds,
and the versions of what made them. `SceneRecord.tabletop` makes the very tabletop again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from graspmap.data.jacquard import SUFFIXES
from graspmap.errors import FileFormatError, InvalidInputError
from graspmap.files import read_text, write_text
from graspmap.generation.sources import Fingerprint, Source
from graspmap.geometry.camera import Camera
from graspmap.geometry.transforms import RigidTransform
from graspmap.gripper import Gripper
from graspmap.simulation.objects import ObjectModel
from graspmap.simulation.render import Appearance, View
from graspmap.simulation.settings import TrialSettings
from graspmap.simulation.tabletop import PlacedObject, Tabletop

_REMEDY = "make the scene again, or copy the file again"
_MADE_FROM = {"procedural": ("seed", "index"), "mesh": ("hash",)}
"""What tells objects apart, by the kind of their source."""
_LIBRARIES = ("graspmap", "mujoco", "manifold3d", "numba", "numpy")
_PHOTO_LIBRARIES = ("mitsuba", "drjit")
_SETTINGS, _APPEARANCE = TypeAdapter(TrialSettings), TypeAdapter(Appearance)

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class RecordedObject:
    """An object of a recorded scene.

    Args:
        id: Its name.
        source: What it is made from.
        fingerprint: What it looked like, to see that the same is made again.
        T_world_object: Where it lies.
    """

    id: str
    source: Source
    fingerprint: Fingerprint
    T_world_object: RigidTransform

    def model(self, root: Path) -> ObjectModel:
        """Make the object again.

        Args:
            root: Folder of the data set; model files are named from there.

        Raises:
            FileError: Its model file is missing or damaged.
            InvalidInputError: What is made now is another object: graspmap has changed since.
        """
        model = self.source.model(self.id, root)
        self.fingerprint.check(model)
        return model


@dataclass(frozen=True)
class SceneRecord:
    """All that it takes to try a grasp on a scene, and where the scene came from.

    Args:
        id: Name of the scene, ``<i>_<object>``.
        objects: What lies on the table.
        view: The camera that took its pictures.
        gripper: The gripper that its labels hold for.
        settings: Of the trials that gave its labels.
        seed: Numbers that the scene was drawn from: (seed, item, attempt, view, try).
        appearance: Light, colours and surfaces of the colour picture.
        versions: Of graspmap and of the libraries that the result follows from.
        root: Folder of the data set; None before it is written.
    """

    id: str
    objects: tuple[RecordedObject, ...]
    view: View
    gripper: Gripper
    settings: TrialSettings
    seed: tuple[int, ...]
    appearance: Appearance
    versions: Mapping[str, str]
    root: Path | None = None

    def tabletop(self) -> Tabletop:
        """The objects on the table as they were when the labels were tried.

        Raises:
            FileError: A model file is missing or damaged.
            InvalidInputError: This version of graspmap makes other objects.
        """
        root = Path() if self.root is None else self.root
        return Tabletop.of(
            tuple(PlacedObject(item.model(root), item.T_world_object) for item in self.objects)
        )


@cache
def versions(*, photo: bool = False) -> dict[str, str]:
    """Versions of graspmap and of the libraries that a generated scene follows from.

    Args:
        photo: Whether its colours are path traced.
    """
    libraries = (*_LIBRARIES, *_PHOTO_LIBRARIES) if photo else _LIBRARIES
    return {name: metadata.version(name) for name in libraries}


def write_record(record: SceneRecord, folder: Path) -> Path:
    """Write a record as ``<id>_scene.json``; reading it back gives the same record.

    Returns:
        The path of the file.

    Raises:
        StorageFullError: The disk is full.
        FileError: Writing there is not allowed.
    """
    file = _File(
        id=record.id,
        objects=tuple(
            _Object(
                id=item.id,
                labels=item.source.labels(item.id),
                source=item.source,
                fingerprint=item.fingerprint,
                T_world_object=_rows(item.T_world_object),
            )
            for item in record.objects
        ),
        camera=record.view.camera.to_dict(),
        T_world_camera=_rows(record.view.T_world_camera),
        gripper=record.gripper.to_dict(),
        settings=_SETTINGS.dump_python(record.settings, mode="json"),
        seed=record.seed,
        appearance=_APPEARANCE.dump_python(record.appearance, mode="json"),
        versions=dict(record.versions),
    )
    path = folder / f"{record.id}{SUFFIXES['record']}"
    write_text(path, json.dumps(file.model_dump(mode="json"), indent=1) + "\n")
    return path


def read_record(path: Path) -> SceneRecord:
    """Read the record of a scene.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: It is no record, or a key or value in it is wrong; the error names it.
    """
    try:
        file = _File.model_validate_json(read_text(path))
        return SceneRecord(
            id=file.id,
            objects=tuple(
                RecordedObject(
                    item.id, item.source, item.fingerprint, _transform(item.T_world_object)
                )
                for item in file.objects
            ),
            view=View(Camera.from_dict(file.camera), _transform(file.T_world_camera)),
            gripper=Gripper.from_dict(file.gripper),
            settings=_SETTINGS.validate_json(json.dumps(file.settings)),
            seed=file.seed,
            appearance=_APPEARANCE.validate_json(json.dumps(file.appearance)),
            versions=file.versions,
            root=path.parent.parent,
        )
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(map(str, first["loc"])) or "the whole"
        raise FileFormatError(
            path, f"is no record of a scene ({place}: {first['msg']})", _REMEDY
        ) from error
    except InvalidInputError as error:
        raise FileFormatError(path, f"is no record of a scene ({error})", _REMEDY) from error


def read_object_keys(path: Path) -> frozenset[tuple[str, ...]]:
    """What the objects of a recorded scene are made from: equal keys are equal objects.

    Only that is read and checked, so that thousands of records take a second. Objects whose record
    does not say what they are made from have no key.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: It is no record.
    """
    try:
        sources = [item.get("source", {}) for item in json.loads(read_text(path))["objects"]]
        return frozenset(
            (source["kind"], *(str(source[name]) for name in _MADE_FROM[source["kind"]]))
            for source in sources
            if source
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(path, f"is no record of a scene ({error!r})", _REMEDY) from error


def find_record(files: Iterable[Path]) -> Path | None:
    """The record of a scene that graspmap generated, from the scene's files; None without one."""
    for path in files:
        if path.name.endswith(SUFFIXES["rgb"]):
            name = path.name.removesuffix(SUFFIXES["rgb"])
            record = path.with_name(name + SUFFIXES["record"])
            return record if record.is_file() else None
    return None


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


class _Object(_Strict):
    id: str
    labels: dict[str, str] = {}  # older records have none
    source: Source
    fingerprint: Fingerprint
    T_world_object: Rows


class _File(_Strict):
    format: Literal["graspmap-scene-1"] = "graspmap-scene-1"
    id: str
    objects: tuple[_Object, ...]
    camera: dict[str, Any]
    T_world_camera: Rows
    gripper: dict[str, Any]
    settings: dict[str, Any]
    seed: tuple[int, ...]
    appearance: dict[str, Any]
    versions: dict[str, str]


def _rows(transform: RigidTransform) -> Rows:
    return tuple(map(tuple, transform.matrix.tolist()))


def _transform(rows: Rows) -> RigidTransform:
    return RigidTransform.from_matrix(np.array(rows))
