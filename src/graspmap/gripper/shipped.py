"""Gripper profiles: the ones that ship, and YAML files of users."""

from __future__ import annotations

from pathlib import Path

from graspmap.config import nearest_key, read_values
from graspmap.errors import ConfigError, InvalidInputError
from graspmap.files import shipped_or_path
from graspmap.gripper.gripper import KEYS, Gripper

_SHIPPED = {path.stem: path for path in sorted(Path(__file__).with_name("profiles").glob("*.yaml"))}
_START = "`graspmap gripper show franka --yaml`"


def profile_names() -> list[str]:
    """Names of the profiles that ship with graspmap, in alphabetical order."""
    return list(_SHIPPED)


def profile_path(name_or_path: str | Path) -> Path:
    """The YAML file of a shipped profile, or of a user's; see `graspmap.files.shipped_or_path`.

    Raises:
        UnknownNameError: No profile has this name.
    """
    return shipped_or_path(name_or_path, _SHIPPED, what="gripper", own="a YAML file")


def load_gripper(name_or_path: str | Path) -> Gripper:
    """A shipped profile by its name, or a profile of one's own from a YAML file.

    Args:
        name_or_path: ``"franka"``, or the path of a YAML file with the keys of `Gripper`.

    Raises:
        UnknownNameError: No profile has this name.
        MissingFileError: There is no such file.
        FileFormatError: The file is no YAML mapping.
        ConfigError: A key or a value is wrong; the error names it and what is allowed.
    """
    path = profile_path(name_or_path)
    values = read_values(path, what="gripper", example=_START)
    for key in values:
        if key not in KEYS:
            raise ConfigError(path, key, "no such key", nearest_key(key, KEYS))
    try:
        return Gripper.from_dict(values)
    except InvalidInputError as error:
        remedy = f"allowed: {error.allowed}"
        raise ConfigError(path, error.name, f"is {error.found}", remedy) from error
