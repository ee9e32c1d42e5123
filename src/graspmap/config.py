"""Strict YAML files and their flags: wrong keys and values are errors that say what is right.

A file holds sections, text, numbers and lists; `read_model` gives it as a pydantic model,
`read_values` as plain values.
"""

from __future__ import annotations

import difflib
import io
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import yaml

from graspmap.errors import ConfigError, FileFormatError, MissingFileError
from graspmap.files import read_text

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

_MOST_VALUES = 10_000
COMMAND_LINE = "command line"
"""Stands for the file in errors about a flag."""

Model = TypeVar("Model", bound="BaseModel")


def read_model(
    path: Path | str,
    model: type[Model],
    *,
    what: str,
    example: str = "",
    overrides: Mapping[str, Any] | Sequence[str] | None = None,
) -> Model:
    """Read a YAML file as a pydantic model.

    Args:
        path: The file.
        model: Its keys and what they allow; extra keys should be forbidden.
        what: What the file describes, for messages: ``"experiment"``.
        example: Where a user finds one to start from, for messages: ``"one in experiments/"``.
        overrides: Values that replace those of the file: by dotted key, or the flags of a command
            line such as ``["--training.epochs", "10"]``; None where there can be none.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: The file is no YAML mapping.
        ConfigError: A key or a value is wrong; the error names the nearest key, or what is
            allowed.
    """
    file = Path(path)
    values = _read_mapping(file, what, example)
    flags = overrides if isinstance(overrides, Mapping) else parse_overrides(overrides or ())
    for key, value in flags.items():
        _set(values, key, value)
    _check_plain(values, file)
    from pydantic import ValidationError

    try:
        # The JSON door of the strict mode takes lists where tuples are wanted and nothing else.
        return model.model_validate_json(json.dumps(values))
    except ValidationError as error:
        given = None if overrides is None else frozenset(flags)
        raise _config_error(error, set(_keys(model)), file, given) from None


def read_values(path: Path | str, *, what: str, example: str = "") -> dict[str, Any]:
    """Read a YAML file as plain values: text, numbers, lists and dictionaries.

    Args:
        path: The file.
        what: What it describes, for messages.
        example: Where a user finds one to start from, for messages.

    Raises:
        MissingFileError: There is no such file.
        FileFormatError: The file is no YAML mapping of plain values.
    """
    values = _read_mapping(Path(path), what, example)
    _check_plain(values, Path(path))
    return values


def _read_mapping(file: Path, what: str, example: str) -> dict[str, Any]:
    start = f", or start from {example}" if example else ""
    try:
        text = read_text(file)
    except MissingFileError as error:
        raise MissingFileError(file, f"no such {what} file", f"check the path{start}") from error
    values = _load(text, file)
    if not isinstance(values, dict):
        raise FileFormatError(file, "holds no mapping", f"write `key: value` lines{start}")
    return values


def parse_overrides(flags: Sequence[str]) -> dict[str, Any]:
    """Turn ``["--training.epochs", "10", "--data.size=224"]`` into values by dotted key.

    Values are YAML: ``null``, ``true``, ``1e-3``, ``[0.5, 1.0]``; anything else is text.

    Raises:
        ConfigError: A flag does not start with ``--``, has no value, or is given twice.
    """
    values: dict[str, Any] = {}
    rest = iter(flags)
    for flag in rest:
        if not flag.startswith("--") or len(flag) < 3:
            raise ConfigError(
                COMMAND_LINE, flag, "is no flag", "write values as --section.key value"
            )
        key, equals, text = flag[2:].partition("=")
        key = key.replace("-", "_")
        if not equals:
            text = next(rest, "--")
            if text.startswith("--"):
                raise ConfigError(COMMAND_LINE, f"--{key}", "has no value", "write --key value")
        if key in values:
            raise ConfigError(COMMAND_LINE, f"--{key}", "is given twice", "give it once")
        values[key] = _load(text, COMMAND_LINE, f"--{key}")
    return values


class _Loader(yaml.SafeLoader):
    """YAML 1.2's idea of scalars (1e-3 is a number, `off` and `no` are text); no double keys."""


_Loader.yaml_implicit_resolvers = {}
for _tag, _pattern, _first in (
    ("null", r"null|Null|NULL|~|", [*"nN~", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", [*"tTfF"]),
    ("int", r"[-+]?[0-9]+", [*"-+0123456789"]),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        [*"-+.0123456789"],
    ),
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _first
    )


def _integer(loader: _Loader, node: yaml.ScalarNode) -> int:
    # The inherited constructor reads 010 as eight.
    return int(str(loader.construct_scalar(node)))


def _mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    seen: dict[Any, int] = {}
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)
        line = key_node.start_mark.line + 1
        if not isinstance(key, str):
            raise yaml.constructor.ConstructorError(
                None, None, f"key {key!r} is no text", key_node.start_mark
            )
        if key in seen:
            raise yaml.constructor.ConstructorError(
                None, None, f"key {key!r} is already in line {seen[key]}", key_node.start_mark
            )
        seen[key] = line
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:int", _integer)
_Loader.add_constructor("tag:yaml.org,2002:map", _mapping)


def _load(text: str, path: Path | str, key: str | None = None) -> Any:
    try:
        return yaml.load(io.StringIO(text), Loader=_Loader)  # a SafeLoader
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}: " if mark is not None else ""
        problem = f"{where}{getattr(error, 'problem', None) or error}"
        if key is not None:
            raise ConfigError(path, key, f"no YAML value ({problem})", "quote the text") from error
        raise FileFormatError(path, f"no YAML ({problem})", "mend that line") from error


def _check_plain(values: dict[str, Any], path: Path) -> None:
    """See that the values are text, numbers, lists and sections, and not too many.

    A few lines of YAML can stand for billions of values, by aliases of aliases.

    Raises:
        FileFormatError: They are not.
    """
    remedy = "give text, numbers, lists and sections only"
    rest: list[Any] = [values]
    for _ in range(_MOST_VALUES):
        if not rest:
            return
        value = rest.pop()
        if isinstance(value, dict):
            rest += [*value, *value.values()]
        elif isinstance(value, list):
            rest += value
        elif isinstance(value, str):
            # A zero byte or half a character can be in no name of a file.
            if re.search("[\0\ud800-\udfff]", value):
                raise FileFormatError(path, f"holds {_short(value)}, which is no text", remedy)
        elif not (value is None or isinstance(value, bool | int | float)):
            raise FileFormatError(path, f"holds a {type(value).__name__}", remedy)
    raise FileFormatError(path, f"holds more than {_MOST_VALUES} values", remedy)


def _set(values: dict[str, Any], key: str, value: Any) -> None:
    """Put ``value`` at a dotted key, making the sections on the way."""
    *sections, last = key.split(".")
    for section in sections:
        inner = values.get(section)
        if not isinstance(inner, dict):
            inner = values[section] = {}
        values = inner
    values[last] = value


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Every dotted key, sections too."""
    from pydantic import BaseModel

    for name, info in model.model_fields.items():
        yield f"{prefix}{name}"
        # A section, or one that may be null.
        for kind in (info.annotation, *get_args(info.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from _keys(kind, f"{prefix}{name}.")


def _config_error(
    error: ValidationError, known: set[str], path: Path, overridden: frozenset[str] | None
) -> ConfigError:
    """The first wrong key (or else value) of a failed validation, as one line."""
    issues = error.errors(include_url=False, include_context=False)
    issue = next((i for i in issues if i["type"] == "extra_forbidden"), issues[0])
    parts = [str(part) for part in issue["loc"]]
    where: Path | str = path
    if issue["type"] == "extra_forbidden":
        key = ".".join(parts)
        problem, remedy = "no such key", nearest_key(key, known)
    else:
        # A union adds the name of its branch to the place; the key ends before it.
        while len(parts) > 1 and ".".join(parts) not in known:
            parts.pop()
        key = ".".join(parts)
        same = [i for i in issues if ".".join(map(str, i["loc"])).startswith(key)]
        key = key or "the file"
        if issue["type"] == "missing":
            problem = "is missing"
            remedy = "add it" if overridden is None else f"add it, or pass --{key} VALUE"
        else:
            problem = f"is {_short(issue['input'])}"
            remedy = "allowed: " + " or ".join(dict.fromkeys(_allowed(i["msg"]) for i in same))
    if any(key == flag or flag.startswith(f"{key}.") for flag in overridden or ()):
        where, key = COMMAND_LINE, f"--{key}"
    return ConfigError(where, key, problem, remedy)


def nearest_key(key: str, known: Iterable[str]) -> str:
    """What the user may have meant by an unknown dotted key, or the keys of its section."""
    known = set(known)
    section, _, last = key.rpartition(".")
    siblings = {k.rpartition(".")[2]: k for k in sorted(known) if k.rpartition(".")[0] == section}
    near = [siblings[name] for name in difflib.get_close_matches(last, siblings, n=1)]
    # The right key in the wrong section, or a misspelling of it.
    near = near or [k for k in sorted(known) if k.rpartition(".")[2] == last]
    near = near or difflib.get_close_matches(key, sorted(known), n=1, cutoff=0.85)
    return f"did you mean {near[0]}?" if near else f"allowed here: {', '.join(siblings)}"


def _allowed(message: str) -> str:
    return re.sub(r"^(Input should be|Value error, allowed:) ", "", message)


def _short(value: Any) -> str:
    text = repr(value) if not isinstance(value, dict) else "{" + ", ".join(map(str, value)) + "}"
    return text if len(text) <= 60 else f"{text[:57]}..."
