"""Which angles the pixels show: the share of each over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from recon.animal import Body
from recon.base.arrays import Array, median
from recon.fit.motion import MEASURED_SHARE
from recon.show.plots.style import GREY, PAGE_MM, SMALL, drawing

if TYPE_CHECKING:
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure

_ROW_MM, _REST_MM = 3.3, 34.0


def share_colours() -> ListedColormap:
    """Colours of information fractions from 0 to 1: greys below `MEASURED_SHARE`, blues from there on."""
    import matplotlib as mpl
    from matplotlib.colors import ListedColormap

    low = round(256 * MEASURED_SHARE)
    greys, blues = mpl.colormaps["Greys"](np.linspace(0.1, 0.45, low)), mpl.colormaps["Blues"](np.linspace(0.5, 1, 256))
    return ListedColormap([*greys, *blues[:: -(-256 // (256 - low))]])


def observability(body: Body, share: Array, time_s: Array, title: str = "") -> Figure:
    """share (T, D - 4): of the precision of the root's pitch and roll and of the joints' angles, what comes from the
    pixels, NaN where unknown; time_s (T,). Over time, with the medians beside them."""
    names = [name.replace("_", " ") for name in body.state_names[4:]]
    with drawing(min(_ROW_MM * len(names) + _REST_MM, PAGE_MM), title=title) as figure:
        medians = np.array([median(of_angle) for of_angle in share.T])
        if np.isnan(medians).all():
            return figure
        axes, half = figure.subplots(), 0.5 * float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.5
        extent = (float(time_s[0]) - half, float(time_s[-1]) + half, len(names) - 0.5, -0.5)
        style = {"vmin": 0, "vmax": 1, "aspect": "auto", "interpolation": "nearest"}
        image = axes.imshow(share.T, cmap=share_colours(), extent=extent, **style)
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(axis="y", length=0)
        for row, (label, middle) in enumerate(zip(axes.get_yticklabels(), medians, strict=True)):
            text, colour = f"{middle:.0%}" if np.isfinite(middle) else "–", "k" if middle >= MEASURED_SHARE else GREY
            axes.text(1.01, row, text, transform=axes.get_yaxis_transform(), va="center", fontsize=SMALL, color=colour)
            label.set_color(colour)
        axes.set_xlabel("time (s);  right: median over these frames")
        bar = figure.colorbar(image, ax=axes, location="bottom", aspect=60, pad=0.01, shrink=0.7)
        bar.set_label(
            f"share of the precision that comes from the pixels;  grey: less than {MEASURED_SHARE:g}, mostly expected"
        )
    return figure
