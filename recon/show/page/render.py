"""Templates filled in, and pictures as a part of a page."""

from __future__ import annotations

import base64
import re
from datetime import date
from pathlib import Path
from typing import Any

import cv2
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from recon.base.errors import printable
from recon.base.package import version
from recon.io.video import Image
from recon.show.page import GENERATED
from recon.show.plots.style import png_of, svg_of

JPEG_QUALITY = 80
PNG_DPI = 190.0
DIRECTION = re.compile("[\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Characters for the direction of text, as in names of files."""


def rendered(template: str, **content: Any) -> str:
    """A page. All text is escaped but what the template calls safe: figures."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_without_direction,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    given = {"generated": GENERATED, "version": version(), "today": date.today().isoformat()}
    return environment.get_template(template).render(given | content)


def _without_direction(value: Any) -> Any:
    """Text with codes in place of marks that would turn what follows the other way."""
    if not isinstance(value, str) or not DIRECTION.search(value):
        return value
    return type(value)(DIRECTION.sub(lambda mark: printable(mark[0]), value))


def inline(figure: Figure, largest: int) -> str:
    """A figure as it stands in a page: <svg>, or a PNG where that would have more than `largest` characters, as of a
    long clip."""
    svg = svg_of(figure)
    if len(svg) <= largest:
        return svg  # matplotlib has escaped its texts
    return f'<img alt="" src="{_data("image/png", png_of(figure, PNG_DPI, transparent=True))}">'


def jpeg(picture: Image) -> str:
    """A picture as the source of an <img>."""
    return _data("image/jpeg", cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
