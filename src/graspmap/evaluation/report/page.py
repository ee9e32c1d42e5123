"""The page of an evaluation: one HTML file that needs no network and no other file."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader
from markupsafe import Markup

from graspmap import __version__
from graspmap.evaluation.report.charts import report_plots
from graspmap.evaluation.report.gallery import Exhibit
from graspmap.evaluation.report.numbers import Numbers, as_text
from graspmap.files import write_text
from graspmap.pictures.draw import encode
from graspmap.pictures.plots import Plot

REPORT_FILE = "report.html"

_HARDEST = 10
_ROWS = 500
"""Objects that are listed one by one; a page of thousands would open slowly."""


def write_report(
    folder: Path | str, summary: Mapping[str, Any], gallery: Sequence[Exhibit] = ()
) -> Path:
    """Write ``report.html``: what an evaluation found, for people.

    It shows what the summary holds and leaves out what it lacks. Each number carries its path in
    the summary (``data-key``) and its value there (``data-value``); those of the gallery stand
    under ``gallery``, as `Exhibit.to_dict` gives them.

    Args:
        folder: Where it is written; made if needed.
        summary: What ``evaluation.json`` holds.
        gallery: Scenes to show, see `graspmap.evaluation.report.gallery.make_gallery`.

    Returns:
        The file.

    Raises:
        StorageFullError: The disk is full.
        FileError: The folder cannot be written to.
    """
    data = {**summary, "gallery": [exhibit.to_dict() for exhibit in gallery]}
    path = Path(folder) / REPORT_FILE
    text = render_page(
        "report.html.j2", data, report_plots(data), gallery=gallery, objects=_objects(data)
    )
    write_text(path, text)
    return path


def render_page(
    template: str, data: Mapping[str, Any], plots: Mapping[str, Plot], **more: Any
) -> str:
    """A page of one template.

    Args:
        template: Name of the template beside this module.
        data: What the page's numbers are looked up in; its top keys are names in the template.
        plots: Plots by name.
        more: Further names of the template.
    """
    numbers = Numbers(data)
    pages = Environment(
        loader=PackageLoader("graspmap.evaluation.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return pages.get_template(template).render(
        data=data,
        get=numbers.get,
        n=numbers.show,
        interval=numbers.interval,
        as_text=as_text,
        plots={name: Markup(plot.svg(name)) for name, plot in plots.items()},
        jpeg_uri=lambda picture: data_uri(encode(picture, ".jpg"), "image/jpeg"),
        webp_uri=lambda film: data_uri(film, "image/webp"),
        version=__version__,
        **more,
    )


def data_uri(content: bytes, kind: str) -> str:
    """A file's content as an address that holds it.

    Args:
        content: The bytes.
        kind: Its type, for example ``image/webp``.
    """
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _objects(data: Mapping[str, Any]) -> dict[str, list[str]]:
    """Names of the objects that were tried: the hardest first, and how many are not listed."""
    scores = (data.get("trials") or {}).get("per_object") or {}
    order = sorted(scores, key=lambda name: (scores[name]["success"], -scores[name]["trials"]))
    failing = [name for name in order if scores[name]["held"] < scores[name]["trials"]]
    return {"hardest": failing[:_HARDEST], "all": order[:_ROWS], "more": order[_ROWS:]}
