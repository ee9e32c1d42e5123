"""``graspmap doctor``: what is in a folder, what is broken, what it is good for."""

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
from graspmap.cli.progress import progress
from graspmap.errors import InvalidInputError


@dataclass(frozen=True)
class Doctor:
    """Look through a data set, object meshes or weights files, and say what is there.

    Example:
      graspmap doctor jacquard:DIR --sheet sheet.png

    Reads every label and the pictures, names missing and broken files, counts labels, checks units
    of depth, masks, and whether the labels' axes and angles fit the pictures, and explains each
    number of a label line. Kinds: cornell, jacquard, meshes, weights. Exit code 2: nothing usable.
    """

    data: Annotated[tyro.conf.Positional[str], option("KIND:DIR")]
    """The folder; without KIND: the kind is found out from its files."""
    sheet: Annotated[Path | None, option("F")] = None
    """Write a contact sheet (.png or .jpg) with labels drawn on scenes."""
    everything: bool = False
    """Open all pictures, also of a data set with more than 1000 scenes."""
    json: Annotated[Path | None, option("F")] = None
    """Write the report as JSON to this file, - for standard output."""


def run(argv: Sequence[str]) -> int:
    """Run ``graspmap doctor``."""
    flags = parse(Doctor, argv, "graspmap doctor")
    output_file(flags.sheet, "--sheet", PICTURE_SUFFIXES)
    output_file(flags.json, "--json")
    from graspmap.doctor import contact_sheet_of, examine

    with progress("looking") as update:
        report = examine(flags.data, progress=update, everything=flags.everything)
    tell = teller(flags.json)
    tell(report.text())
    if flags.sheet is not None:
        if report.kind not in ("cornell", "jacquard"):
            raise InvalidInputError("--sheet", f"asked for {report.kind}", "data sets of scenes")
        write_picture(flags.sheet, contact_sheet_of(f"{report.kind}:{report.root}"))
        tell(f"  contact sheet: {flags.sheet}")
    write_json(report.to_dict(), flags.json)
    return 0 if report.usable else 2
