"""``graspmap gripper``: profiles of grippers, and a detector for one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from graspmap.cli.frame import (
    PICTURE_SUFFIXES,
    option,
    output_file,
    parse,
    teller,
    write_json,
    write_picture,
)
from graspmap.errors import InvalidInputError, UnknownNameError

_HELP = """usage: graspmap gripper list [--json F]
       graspmap gripper show NAME|FILE [--out F.png] [--json F]
       graspmap gripper show NAME --yaml > mine.yaml
       graspmap gripper train NAME|FILE --out DIR [options]

A profile says what a parallel-jaw gripper is: openings, fingers, force, friction. Four of them
ship with graspmap; a YAML file of your own stands wherever a name does.

A profile of your own:
  graspmap gripper show franka --yaml > mine.yaml     start from the nearest one
  (change the numbers: each key says its unit, a comment what it means)
  graspmap gripper show mine.yaml --out mine.png      check it, and look at it to scale
  graspmap gripper train mine.yaml --out mine         scenes, training, trials: a detector for it

graspmap gripper COMMAND --help lists the options of one.

All keys, with the numbers of franka:
"""


@dataclass(frozen=True)
class List:
    """List the profiles that ship with graspmap.

    Example:
      graspmap gripper list
    """

    json: Annotated[Path | None, option("F")] = None
    """Write their numbers as JSON to this file, - for standard output."""


@dataclass(frozen=True)
class Show:
    """Check a gripper's profile, say what it means, and draw it to scale.

    Example:
      graspmap gripper show franka --out franka.png
    """

    gripper: Annotated[tyro.conf.Positional[str], option("NAME|FILE")]
    """A profile that ships with graspmap, or a YAML file of your own."""
    out: Annotated[Path | None, option("F.png")] = None
    """Draw it to scale, with its measures, into this picture (.png or .jpg)."""
    yaml: bool = False
    """Print the profile's file with its comments, and nothing else: a start for your own."""
    json: Annotated[Path | None, option("F")] = None
    """Write its numbers as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap gripper``."""
    if not argv or argv[0] in ("-h", "--help"):
        from graspmap.gripper import load_gripper, profile_path

        text = profile_path(load_gripper("franka").name).read_text(encoding="utf-8")
        keys = [line for line in text.splitlines() if line and not line.startswith("#")]
        print(_HELP + "\n".join(f"  {line}" for line in keys))
        return 0 if argv else 2
    commands = {"list": _list, "show": _show, "train": _train}
    if argv[0] not in commands:
        raise UnknownNameError("gripper command", argv[0], commands)
    commands[argv[0]](argv[1:])
    return 0


def _train(argv: Sequence[str]) -> None:
    from graspmap.cli import gripper_train

    gripper_train.train(argv)


def _list(argv: Sequence[str]) -> None:
    flags = parse(List, argv, "graspmap gripper list")
    output_file(flags.json, "--json")
    from graspmap.gripper import load_gripper, profile_names

    grippers = [load_gripper(name) for name in profile_names()]
    tell = teller(flags.json)
    width = max(len(gripper.name) for gripper in grippers)
    for gripper in grippers:
        low, high = 1000 * gripper.min_opening_m, 1000 * gripper.max_opening_m
        span = f"{low:g} to {high:g} mm"
        tell(f"{gripper.name:<{width}}  {span:>11}  {gripper.force_n:>3g} N  {gripper.description}")
    write_json([gripper.to_dict() for gripper in grippers], flags.json)


def _show(argv: Sequence[str]) -> None:
    flags = parse(Show, argv, "graspmap gripper show")
    output_file(flags.out, "--out", PICTURE_SUFFIXES)
    output_file(flags.json, "--json", keep=[Path(flags.gripper), flags.out])
    if flags.yaml and str(flags.json) == "-":
        raise InvalidInputError("--json -", "given with --yaml", "one of them on standard output")
    from graspmap.files import read_text
    from graspmap.gripper import load_gripper, profile_path
    from graspmap.pictures import gripper_picture

    gripper = load_gripper(flags.gripper)
    tell = teller(flags.json)
    if flags.yaml:
        print(read_text(profile_path(flags.gripper)), end="")
    else:
        tell(f"{gripper.name}: {gripper.description or 'no description'}")
        for sentence in gripper.words():
            tell(f"  {sentence}")
    if flags.out is not None:
        write_picture(flags.out, gripper_picture(gripper))
        if not flags.yaml:
            tell(f"  picture: {flags.out}")
    write_json(gripper.to_dict(), flags.json)
