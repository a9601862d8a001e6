"""Vertical forces of the feet over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from recon.gait.dynamics import Dynamics
from recon.gait.gait import Gait
from recon.show.plots.footfall import ROWS
from recon.show.plots.style import COLOURS, drawing

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def forces(d: Dynamics, gait: Gait) -> Figure:
    """Footfalls above, and beneath each other the vertical force of each foot in body weights with the band that holds
    it with 90 %; below, the height of the centre of mass with one standard deviation."""
    feet = [foot for foot in ROWS if foot in d.force] or list(d.force)
    with drawing(26.0 + 24.0 * (len(feet) + 1)) as figure:
        heights = [0.7, *[1.0] * len(feet), 1.0]
        panels = figure.subplots(len(feet) + 2, 1, sharex=True, gridspec_kw={"height_ratios": heights})
        top, *below, last = panels
        time_s = gait.tracks.time_s
        for row, foot in enumerate(feet):
            own, colour = [s for s in gait.stances if s.foot == foot], COLOURS[row % len(COLOURS)]
            top.broken_barh([(s.start_s, s.duration_s) for s in own], (row - 0.35, 0.7), color=colour, alpha=0.6)
            middle, low, high = d.force[foot].T
            below[row].fill_between(time_s, low, high, color=colour, alpha=0.25, lw=0)
            below[row].plot(time_s, middle, color=colour)
            below[row].set_ylabel(foot)
            below[row].set_ylim(bottom=0)
        top.set_yticks(range(len(feet)), feet)
        top.invert_yaxis()
        top.set_title("stances, and vertical force of each foot (body weights; band: 90 %)")
        series = d.centre.series
        sigma = np.zeros_like(series.value[:, 2]) if series.value_sigma is None else series.value_sigma[:, 2]
        height = series.value[:, 2] - d.ground_m
        last.fill_between(series.time_s, height - sigma, height + sigma, color="0.5", alpha=0.25, lw=0)
        last.plot(series.time_s, height, color="k")
        last.set_ylabel("centre of\nmass (m)")
        last.set_xlabel("time (s)")
    return figure
