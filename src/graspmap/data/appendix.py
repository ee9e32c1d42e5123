"""Class labels of the Cornell Grasping Dataset, and the objects that can be told from them.

Each of the 885 pictures has one of 80 specific classes ("mug") and one of 9 general classes
("crockery"). The thesis's text speaks of 79 specific classes; its table lists 80.

References:
    Thesis, Appendix A, Tables A.1 (specific) and A.2 (general).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from graspmap.errors import FileFormatError
from graspmap.files import read_bytes

LABELS_FILE = Path(__file__).with_name("cornell_labels.yaml")
_TABLES = ("specific", "general")
_REMEDY = "restore it from the package"


@cache
def cornell_labels() -> Mapping[str, Mapping[str, str]]:
    """Class names of each picture: ``labels["pcd0320"] == {"specific": "mug", "general": ...}``.

    Returns:
        A read-only mapping in the order of the ids.

    Raises:
        FileFormatError: The data file of the package is damaged.
    """
    return read_label_tables(LABELS_FILE)


def read_label_tables(path: Path) -> Mapping[str, Mapping[str, str]]:
    """Read a file of class labels and check it against the counts written in it.

    Raises:
        MissingFileError: The file does not exist.
        FileFormatError: It is no such file, a count differs, or the tables do not give each
            picture exactly one class.
    """
    import yaml

    try:
        content = yaml.safe_load(read_bytes(path))
        tables = {name: _table(path, name, content[name]) for name in _TABLES}
    except (yaml.YAMLError, KeyError, TypeError, ValueError, AttributeError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(path, f"is no table of class labels ({error})", _REMEDY) from error
    specific, general = (tables[name] for name in _TABLES)
    if specific.keys() != general.keys():
        odd = sorted(specific.keys() ^ general.keys())
        raise FileFormatError(path, f"{odd[0]} has a class in one table only", _REMEDY)
    return MappingProxyType(
        {
            name: MappingProxyType({"specific": specific[name], "general": general[name]})
            for name in sorted(specific, key=_number)
        }
    )


@cache
def cornell_objects() -> Mapping[str, str]:
    """Object of each picture, as far as it can be told: ``objects["pcd0139"] == "box-0137"``.

    Each object was photographed in about four consecutive pictures, but where one ends and the
    next begins is not recorded. Neighbouring pictures of one specific class therefore form one
    group, which is never divided (numbers that do not exist, 0950 to 0999, do not end a group):
    no object can then be on both sides of a split by object. An object that came back later,
    under other numbers, cannot be recognised.
    """
    objects: dict[str, str] = {}
    group, last = "", ""
    for name, labels in cornell_labels().items():
        if labels["specific"] != last:
            last = labels["specific"]
            group = f"{last.replace(' ', '-')}-{name.removeprefix('pcd')}"
        objects[name] = group
    return MappingProxyType(objects)


def _table(path: Path, name: str, table: Mapping[str, Any]) -> dict[str, str]:
    pairs = [
        (picture, label)
        for label, members in table["members"].items()
        for picture in _members(str(members))
    ]
    doubled = [picture for picture, count in Counter(p for p, _ in pairs).items() if count > 1]
    if doubled:
        raise FileFormatError(path, f"{doubled[0]} has two {name} classes", _REMEDY)
    for what, found in (("classes", len(table["members"])), ("images", len(pairs))):
        if found != table[what]:
            raise FileFormatError(
                path, f"{name} lists {found} {what}, but says {table[what]}", _REMEDY
            )
    return dict(pairs)


def _members(ranges: str) -> Iterator[str]:
    for part in ranges.split(","):
        match = re.fullmatch(r"\s*(\d{4})(?:-(\d{4}))?\s*", part)
        if match is None:
            raise ValueError(f"{part.strip()!r} is no range of pictures")
        first = int(match[1])
        for number in range(first, int(match[2] or first) + 1):
            yield f"pcd{number:04d}"


def _number(name: str) -> int:
    return int(name.removeprefix("pcd"))
