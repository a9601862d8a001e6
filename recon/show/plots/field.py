"""Vector fields: the velocity of each link's tip in its parent's frame, along time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from recon.base.arrays import Array
from recon.gait.phase import LinkField, field_means
from recon.show.plots.style import COLOURS, GREY, PAGE_MM, PALE, SMALL, blank, dots, draw_band, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.quiver import Quiver


ARROWS = 45
"""At most, in a row."""
_ROW_MM, _REST_MM = 24.0, 26.0
_LONGEST = 0.46
"""The longest arrow, as a share of the height of a row."""


def vector_fields(fields: tuple[LinkField, ...], time_s: Array, title: str = "") -> Figure:
    """One row per link: arrows (dx, dy) along time and the speed in the plane, to the same scale; time_s (T,).

    Right is along the parent, up is the normal to it. Arrows are left out evenly where there are more than `ARROWS`.
    Grey is a link whose mean speed is below its deviation: it may as well stand still, or move much more.
    """
    every = max(1, -(-len(time_s) // ARROWS))
    fastest = max((np.nanmax(f.speed_m_s) for f in fields if np.isfinite(f.speed_m_s).any()), default=np.nan)
    height = min(_ROW_MM * len(fields), PAGE_MM - _REST_MM) + _REST_MM
    with drawing(height, title=title or " ") as figure:
        if not fields:
            return figure
        panels = figure.subplots(len(fields), 2, sharex="col", squeeze=False, width_ratios=(2, 1))
        keyed = False
        for (left, right), field in zip(panels, fields, strict=True):
            name, parent = (f"{a} → {b}" for a, b in (field.link, field.parent))
            left.set_title(f"{name}  in the frame of  {parent}", loc="left", pad=2, fontsize=SMALL)
            left.set_yticks([])
            left.spines["left"].set_visible(False)
            if not np.isfinite(field.speed_m_s).any():
                blank(left)
                blank(right)
                continue
            means = field_means((field,)).iloc[0]
            colour = GREY if means["speed_sigma_m_s"] > means["speed_m_s"] else COLOURS[0]
            arrows = _arrows(left, field, time_s, every, float(fastest), colour)
            if not keyed:
                _key(left, arrows, float(fastest), every, height)
                keyed = True
            right.plot(time_s, field.speed_m_s, color=colour, **dots(len(time_s), 1.8))
            if (sigma := field.speed_sigma_m_s) is not None:
                draw_band(right, time_s, field.speed_m_s, sigma, colour)
            right.set_ylim(0, 1.08 * fastest or 1.0)
            right.locator_params(axis="y", nbins=3)
            speed, sigma = means["speed_m_s"], means["speed_sigma_m_s"]
            text = f"mean {speed:.2f}{f', sigma {sigma:.2f}' if np.isfinite(sigma) else ''} m/s"
            right.set_title(text, loc="right", pad=2, fontsize=SMALL, color="k" if colour != GREY else GREY)
        room = 0.08 * float(np.ptp(time_s)) or 0.5
        panels[0, 0].set_xlim(time_s[0] - room, time_s[-1] + room)
        for axes in panels[:-1, 0]:
            axes.spines["bottom"].set_visible(False)
            axes.tick_params(bottom=False)
        panels[-1, 0].set_xlabel("time (s);  → along the parent, ↑ normal to it")
        banded = any(field.speed_sigma_m_s is not None for field in fields)
        panels[-1, 1].set_xlabel("time (s)" + (";  band: one sigma" if banded else ""))
        panels[len(fields) // 2, 1].set_ylabel("speed in the plane (m/s)")
    return figure


def _arrows(axes: Axes, field: LinkField, time_s: Array, every: int, fastest: float, colour: str) -> Quiver:
    known = np.isfinite(field.velocity_m_s[:, :2]).all(axis=1) & (np.arange(len(time_s)) % every == 0)
    axes.axhline(0, color=PALE, lw=0.6, zorder=1)
    dx, dy = field.velocity_m_s[known, :2].T
    scale = {"angles": "uv", "scale_units": "height", "scale": (fastest or 1.0) / _LONGEST, "units": "inches"}
    style = {"width": 0.013, "headwidth": 4, "clip_on": False, "color": colour, "zorder": 2}
    arrows = axes.quiver(time_s[known], np.zeros(known.sum()), dx, dy, **scale, **style)
    arrows.set_in_layout(False)
    return arrows


def _key(axes: Axes, arrows: Quiver, fastest: float, every: int, height_mm: float) -> None:
    size = _round(fastest / 2)
    shown = "" if every == 1 else f" (one frame of {every})"
    place = {"X": 0.73, "Y": 1 - 3.0 / height_mm, "coordinates": "figure", "labelpos": "E"}
    axes.quiverkey(arrows, U=size, label=f"{size:g} m/s{shown}", fontproperties={"size": SMALL}, **place)


def _round(value: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten below."""
    if not value > 0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(f for f in (1, 2, 5) if f * power <= value * (1 + 1e-9)) * power)
