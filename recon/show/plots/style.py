"""Define the style of all figures, and write figures to files.

Figures are as wide as a page (180 mm) or a column (85 mm), with text of 8 points. Colours are from the palette of Okabe
and Ito without yellow, which is pale on paper. Lines that have to be distinguished also differ in dashes. Times have
the colours of viridis without its palest tenth.

A figure is laid out once, at the end of its `drawing` block. All files are byte-identical for the same data and version
of matplotlib. The user's matplotlib settings have no effect and are not changed.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.style as mpl_style
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from recon.animal.body import Side
from recon.base.arrays import Array
from recon.base.files import staged_folder, write_bytes
from recon.fit.regions import radius
from recon.gait.stances import INTERVAL, interval_of

WIDTH_MM = 180.0
"""Width in mm of a figure as wide as a page."""
COLUMN_MM = 85.0
"""Width in mm of a figure as wide as a column."""
NARROW_MM = 120.0
"""Largest width in mm of a figure that counts as one column wide."""
PAGE_MM = 235.0
"""Height in mm of a page within its margins."""
MM = 1 / 25.4
"""One millimetre in inches."""
PNG_DPI = 200
"""Resolution in dots per inch of a PNG for a screen."""
PRINT_DPI = 600
"""Resolution in dots per inch of a picture for print."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
SIDE_COLOURS: Mapping[Side | None, str] = {"left": COLOURS[0], "right": COLOURS[1], None: COLOURS[-1]}
"""Colours of the left and the right side of the animal, and of the rest."""
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
MAX_DOTS = 500
"""Maximum number of dots in a line. More dots would touch and take long to draw."""
GREY, PALE = "#666666", "#BBBBBB"
SMALL = 7.0
"""Size of ticks, legends and captions in points."""

_SHEET = Path(__file__).with_name("recon.mplstyle")


@dataclass(frozen=True)
class Print:
    """Settings of the figures drawn for a paper."""

    width_mm: float
    panel: Any = None
    """Panel of a larger figure into which the next figure is drawn, or None for a separate figure."""


_PRINT: ContextVar[Print | None] = ContextVar("print", default=None)
PRINT_POINTS = 7.0
_PRINT_SIZES = (
    *("font.size", "axes.titlesize", "axes.labelsize", "figure.titlesize", "xtick.labelsize", "ytick.labelsize"),
    "legend.fontsize",
)


@contextmanager
def printing(width_mm: float, panel: Any = None) -> Iterator[None]:
    """Return a context manager in which figures are drawn for a paper: `width_mm` wide, in small type, without titles.

    `panel` is a panel of a larger figure into which the next figure is drawn, or None for a separate figure.
    """
    token = _PRINT.set(Print(width_mm, panel))
    try:
        yield
    finally:
        _PRINT.reset(token)


def page_width_mm() -> float:
    """Return the width of full-page figures in mm, which is `WIDTH_MM` outside a `printing` block."""
    printed = _PRINT.get()
    return WIDTH_MM if printed is None else printed.width_mm


def is_printing() -> bool:
    """Return whether figures are drawn for a paper, in which a caption replaces the text below them."""
    return _PRINT.get() is not None


@contextmanager
def drawing(height_mm: float, width_mm: float = WIDTH_MM, title: str | None = None) -> Iterator[Figure]:
    """Yield a new figure to draw on, which is laid out at the end of the block.

    `title` is the text at the top; None leaves no space for a title.
    """
    printed = _PRINT.get()
    with _settings():
        if printed is not None and printed.panel is not None:
            yield printed.panel
            return
        width_mm = width_mm if printed is None else printed.width_mm
        figure = Figure(figsize=(width_mm * MM, height_mm * MM), layout="constrained")
        FigureCanvasAgg(figure)
        if title is not None and printed is None:
            figure.suptitle(title)
        yield figure
        if not figure.axes:
            figure.text(0.5, 0.5, "no data", ha="center", va="center", color=GREY)
        elif layout := figure.get_layout_engine():
            layout.execute(figure)
        figure.set_layout_engine(None)


def save(figure: Figure, folder: str | Path, stem: str) -> tuple[Path, Path]:
    """Write stem.png (`PNG_DPI`) and stem.svg (with text that can be edited) into a folder, and return their paths.

    The folder is created if it does not exist.
    """
    with staged_folder(folder) as staging:
        write_bytes(staging / f"{stem}.png", png_of(figure))
        write_bytes(staging / f"{stem}.svg", _content(figure, "svg"))
    return Path(folder) / f"{stem}.png", Path(folder) / f"{stem}.svg"


_SVG_HEAD = 2_000
"""Number of characters that an SVG file has in addition to the element that a page needs."""


def svg_of(figure: Figure, largest: int) -> str | None:
    """Return a figure's <svg> element for a page, transparent and with text that can be selected.

    Return None if the element would have more than `largest` characters.
    """
    try:
        text = _content(figure, "svg", into=_LimitedFile(largest + _SVG_HEAD), transparent=True).decode()
    except _FileTooLargeError:
        return None
    svg = re.sub(r"<metadata>.*?</metadata>|<style .*?</style>", "", text[text.index("<svg") :], flags=re.DOTALL)
    return svg if len(svg) <= largest else None


class _FileTooLargeError(Exception):
    pass


class _LimitedFile(io.BytesIO):
    """File in memory that cannot have more than `largest` bytes, so that no time is spent on writing the rest."""

    def __init__(self, largest: int) -> None:
        super().__init__()
        self.largest = largest

    def write(self, content: Any) -> int:
        """Write bytes, or raise _FileTooLargeError."""
        if self.tell() + len(content) > self.largest:
            raise _FileTooLargeError
        return super().write(content)


def png_of(figure: Figure, dpi: float = PNG_DPI, transparent: bool = False) -> bytes:
    """Return the PNG of a figure, optionally without background."""
    return _content(figure, "png", dpi=dpi, transparent=transparent)


def printed_content(figure: Figure, kind: str) -> bytes:
    """Return a figure for a paper as PDF with embedded fonts, SVG with letters as outlines, or PNG of `PRINT_DPI`."""
    options: dict[str, Any] = {"dpi": PRINT_DPI} if kind == "png" else {}
    return _content(figure, kind, fonts="path", **options)


def _content(figure: Figure, kind: str, fonts: str = "none", into: io.BytesIO | None = None, **options: Any) -> bytes:
    """Return the content of a figure's file, without metadata that changes from run to run.

    `into` is an empty file in memory to write into, by default a new one.
    """
    content = io.BytesIO() if into is None else into
    left_out = {"png": ("Software",), "svg": ("Date", "Creator"), "pdf": ("CreationDate", "Creator", "Producer")}[kind]
    with _settings(), mpl.rc_context({"svg.fonttype": fonts, "pdf.fonttype": 42}):
        figure.savefig(content, format=kind, metadata=dict.fromkeys(left_out), **options)
    return content.getvalue()


def _settings() -> AbstractContextManager[None]:
    sizes = {} if _PRINT.get() is None else dict.fromkeys(_PRINT_SIZES, PRINT_POINTS)
    return mpl_style.context(["default", _SHEET, sizes])


def look(i: int) -> dict[str, Any]:
    """Return the colour and dashes of the i-th line of a plot, which differ for up to 28 lines."""
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": DASHES[i % len(DASHES)]}


def foot_colour(foot: str) -> str:
    """Return blue for left feet and orange for right feet, by their labels (LH, RF and so on)."""
    return COLOURS[foot.startswith("R")]


def dots(count: int, size: float) -> dict[str, Any]:
    """Return the marker of a line through `count` samples, or no marker if the markers would touch."""
    return {"marker": "o", "ms": size} if count <= MAX_DOTS else {}


BAND_SIGMAS = radius(INTERVAL)
"""Half width of a 90 % band in standard deviations."""
BAND_ALPHA = 0.2
"""Opacity of a band."""


def draw_band(axes: Axes, time_s: Array, value: Array, sigma: Array | float, colour: str, least: float = 0.0) -> None:
    """Draw the 90 % band of a value (N,) from its standard deviation (N,), never below `least`."""
    _, low, high = interval_of(value, sigma)
    axes.fill_between(time_s, np.maximum(low, least), high, color=colour, alpha=BAND_ALPHA, lw=0)


def legend_shape(labels: Sequence[str], width_mm: float = WIDTH_MM) -> tuple[int, float]:
    """Return the number of columns of a legend that fits a width, and the legend's height in mm."""
    longest = max((len(label) for label in labels), default=0)
    columns = int(np.clip((width_mm - 4) / (1.2 * longest + 15), 1, max(len(labels), 1)))
    return columns, 3.9 * -(-len(labels) // columns)


def add_legend(figure: Figure, handles: Sequence[Artist], labels: Sequence[str], width_mm: float = WIDTH_MM) -> None:
    """Add a legend to a figure, below everything else."""
    width_mm = min(width_mm, page_width_mm())
    figure.legend(handles, labels, loc="outside lower left", ncols=legend_shape(labels, width_mm)[0])


FILLED = 0.8
"""Fraction of a panel's height above which a band counts as filling the panel, so that the value is not known."""


def is_filled(low: Array, high: Array, bottom: float, top: float) -> bool:
    """Return whether a band (N,) fills a panel from `bottom` to `top`."""
    known = np.isfinite(low) & np.isfinite(high)
    if not known.any() or not top > bottom:
        return False
    inside = np.clip(high[known], bottom, top) - np.clip(low[known], bottom, top)
    return bool(inside.mean() >= FILLED * (top - bottom))


def blank(axes: Axes, text: str = "no data") -> None:
    """Write a remark into axes that have no plot."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY)
    axes.set_xticks([])
    axes.set_yticks([])


def plain_logarithm(axis: Axis) -> None:
    """Give a logarithmic axis few ticks, labelled with plain numbers."""
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(LogLocator(subs=(1.0,) if high > 30 * low else (1.0, 2.0, 5.0), numticks=7))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def time_colours(time_s: Array) -> tuple[ListedColormap, Normalize]:
    """Return a colour map for times, and its range from the first to the last known time."""
    known_s = time_s[np.isfinite(time_s)]
    low, high = (float(known_s.min()), float(known_s.max())) if len(known_s) else (0.0, 1.0)
    colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.9, 256))
    return ListedColormap(colours), Normalize(low, high if high > low else low + 1.0)


def grid_shape(count: int, width_mm: float, aspect: float, least: int = 1) -> tuple[int, int]:
    """Return the numbers of rows and columns of `count` panels on a page, each `aspect` times as high as wide.

    There are at least `least` columns, unless there are fewer panels.
    """
    columns = min(least, count)
    while -(-count // columns) * aspect * width_mm / columns > PAGE_MM:
        columns += 1
    return -(-count // columns), columns


def round_below(value: float) -> float:
    """Return the largest number of the form 1, 2 or 5 times a power of ten that is at most `value`."""
    if not value > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(f for f in (1, 2, 5) if f * power <= value * (1 + 1e-9)) * power)
