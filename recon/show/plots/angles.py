"""An angle over time with its uncertainty, the left side's and the right side's in one figure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from recon.animal import both_sides, side_of
from recon.base.arrays import Array, Bools
from recon.clip.keypoints import frame_ranges
from recon.show.plots.style import COLOURS, GREY, PALE, SMALL, drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ANGLES_MM = (62.0, 36.0)
"""Width and height: three are a page wide."""
_BOX = (0.12, 0.21, 0.85, 0.64)


AngleCurve = tuple[Array, Array, bool]
"""One angle of a clip of T frames: (T,) rad, NaN where there is none, its standard deviation (T,), and whether the
pixels say more of it than what was expected."""


def together(curves: Mapping[str, AngleCurve]) -> dict[str, dict[str, AngleCurve]]:
    """By title: an angle with its counterpart of the other side."""
    pairs: dict[str, dict[str, AngleCurve]] = {}
    for name, curve in curves.items():
        pairs.setdefault(both_sides(name).replace("_", " "), {})[name] = curve
    return pairs


def angle_over_time(time_s: Array, curves: Mapping[str, AngleCurve], doubtful: Bools, title: str = "") -> Figure:
    """Degrees, with a band of one standard deviation; the left side's are blue, the right side's orange, those that are
    mostly expected grey. time_s (T,); doubtful (T,): frames with a grey background."""
    width, height = ANGLES_MM
    with drawing(height, width) as figure:
        figure.set_layout_engine("none")  # which takes longer than all the rest
        axes = figure.add_axes(_BOX)
        for name, (angle_rad, sigma_rad, measured) in curves.items():
            side = side_of(name)
            colour = {"left": COLOURS[0], "right": COLOURS[1], None: "k"}[side] if measured else GREY
            degrees, spread = np.degrees(angle_rad), np.degrees(sigma_rad)
            axes.plot(time_s, degrees, color=colour, lw=1.0, linestyle=(0, (4, 1.2)) if side == "left" else "-")
            axes.fill_between(time_s, degrees - spread, degrees + spread, color=colour, alpha=0.2, lw=0)
        half = 0.5 * float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.5
        for first, stop in frame_ranges(np.flatnonzero(doubtful)):
            ends = float(time_s[first]) - half, float(time_s[stop - 1]) + half
            axes.axvspan(*ends, color=PALE, alpha=0.4, lw=0, zorder=0)
        axes.set_xlim(time_s[0] - half, time_s[-1] + half)
        axes.locator_params(axis="y", nbins=5)
        axes.locator_params(axis="x", nbins=6)
        axes.set_xlabel("time (s)", fontsize=SMALL, labelpad=1)
        axes.set_title(f"{title} (°)", loc="left", pad=3)
    return figure
