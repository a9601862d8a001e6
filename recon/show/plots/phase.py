"""Phase space: phase portraits, the rate of an angle over it, coloured by time; and vector fields, the velocity of each
link's tip in its parent's frame, along time."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.quiver import Quiver

from recon.base.arrays import Array, Bools
from recon.fit.motion import MEASURED_SHARE
from recon.gait.phase import Closure, LinkField, Portrait, field_means
from recon.show.plots import style

SHADES = 60
"""Pieces of one colour in a path."""
_LEAST = (0.05, 0.5)
"""Half of the least range of an axis, degrees and degrees per second."""
_ASPECT, _REST_MM = 0.9, 24.0
_BAND, _UNSEEN = "#E6E6E6", "#9A9A9A"
"""The opacity of a band of one standard deviation about a path, and of a path that is mostly expected."""
_ALONG = 0.25
"""Standard deviations between ellipses of a band."""


def phase_portraits(
    portraits: Mapping[str, Portrait],
    closed: Mapping[str, Closure] | None = None,
    title: str = "",
    shares: Mapping[str, float] | None = None,
) -> Figure:
    """(angle, rate) in degrees and degrees per second, one panel for each angle, on one page.

    closed: degrees of closure; shares: of the angle's precision, what comes from the pixels, both by the same names.
    With less than `MEASURED_SHARE` the path is grey. One standard deviation is a band. Each panel has its own axes.
    """
    count = len(portraits)
    width = style.COLUMN_MM if count == 1 else style.WIDTH_MM
    rows, columns = style.grid_shape(count, width, _ASPECT, 2 if count == 4 else 3) if count else (0, 1)
    with style.drawing(rows * _ASPECT * min(width / columns, 60.0) + _REST_MM, width, title=title) as figure:
        if not count:
            return figure
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        colours = style.time_colours(np.concatenate([p.time_s[_known(p)] for p in portraits.values()]))
        for axes, (name, portrait) in zip(panels, portraits.items(), strict=False):
            value, share = (closed or {}).get(name), (shares or {}).get(name, np.nan)
            heading = name.removesuffix("_rad") + (f"\n{share:.0%} from pixels" if np.isfinite(share) else "")
            if value is not None:
                angle, plane = _percent(value.angle, value.angle_sigma), _percent(value.plane, value.plane_sigma)
                heading += f"\n{angle} / {plane} %"
            unseen = share < MEASURED_SHARE
            axes.set_title(heading, fontsize=style.SMALL, pad=3, color=style.GREY if unseen else "k")
            _draw(axes, portrait, None if unseen else colours)
        for axes in panels[count:]:
            axes.set_axis_off()
        gap = "\n" if count == 1 else "   "
        marks = "○ start   ■ end" + (f"{gap}%: degree of closure, of the angle / in the plane" if closed else "")
        if any(np.isfinite(portrait.angle_sigma_rad).any() for portrait in portraits.values()):
            marks += f"{gap}band, ±: one sigma"
        if shares:
            marks += (
                f"\ngrey path: mostly expected, with less than {MEASURED_SHARE:.0%} of its precision from the pixels"
            )
        figure.supxlabel(f"angle (deg)\n{marks}", fontsize=8)
        figure.supylabel("rate (deg/s)", fontsize=8)
        scale = ScalarMappable(colours[1], colours[0])
        figure.colorbar(scale, ax=panels.tolist(), location="right", aspect=50, label="time (s)", pad=0.01)
    return figure


def _known(portrait: Portrait) -> Bools:
    return np.isfinite(portrait.angle_rad) & np.isfinite(portrait.rate_rad_s)


def _draw(axes: Axes, portrait: Portrait, colours: tuple[ListedColormap, Normalize] | None) -> None:
    """colours: of the times; None: grey."""
    known = np.flatnonzero(_known(portrait))
    if not len(known):
        style.blank(axes)
        return
    path = np.degrees(np.column_stack([portrait.angle_rad, portrait.rate_rad_s]))
    cuts = np.unique(np.linspace(known[0], known[-1], SHADES + 1).astype(int))
    pieces = [path[a : b + 1] for a, b in pairwise(cuts)]
    middles = [float(np.mean(portrait.time_s[[a, b]])) for a, b in pairwise(cuts)]
    if colours is None:
        lines = LineCollection(pieces, color=_UNSEEN, lw=1.2, capstyle="round")
    else:
        lines = LineCollection(pieces, cmap=colours[0], norm=colours[1], lw=1.2, capstyle="round")
        lines.set_array(np.array(middles))
    axes.add_collection(lines, autolim=False)
    axes.update_datalim(path[known])
    if np.isfinite(portrait.angle_sigma_rad).any():
        _band(
            axes, path[known], np.degrees(np.column_stack([portrait.angle_sigma_rad, portrait.rate_sigma_rad_s]))[known]
        )
    # What does not move should not look as if it did.
    middle = (path[known].min(axis=0) + path[known].max(axis=0)) / 2
    axes.update_datalim([middle - _LEAST, middle + _LEAST])
    axes.autoscale_view()
    axes.plot(*path[known[0]], "o", ms=4, mfc="w", mec="k", mew=0.9, zorder=3)
    axes.plot(*path[known[-1]], "s", ms=4, mfc="k", mec="k", zorder=3)
    axes.locator_params(nbins=4, steps=[1, 2, 5, 10])
    axes.ticklabel_format(useOffset=False)
    axes.tick_params(labelsize=6, pad=1.5, length=2)


def _band(axes: Axes, path: Array, sigma: Array) -> None:
    """Ellipses of one standard deviation along a path (N, 2), close enough to look like one shape, which they are."""
    steps = np.linalg.norm(np.diff(path, axis=0) / np.maximum(sigma[1:], 1e-12), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    some = np.unique(np.searchsorted(along, np.arange(0.0, along[-1] + _ALONG, _ALONG)).clip(max=len(path) - 1))
    circle = Path.unit_circle()
    corners = path[some, None] + sigma[some, None] * np.asarray(circle.vertices)
    codes = np.tile(np.asarray(circle.codes), len(some))
    axes.add_artist(PathPatch(Path(corners.reshape(-1, 2), codes), fc=_BAND, lw=0))
    axes.update_datalim(np.concatenate([path - sigma, path + sigma]))


def _percent(value: float, sigma: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.0f}±{sigma:.0f}" if np.isfinite(sigma) else f"{value:.0f}"


# -- vector fields ----------------------------------------------------------------------------------------------------

ARROWS = 45
"""At most, in a row."""
_ROW_MM, _ABOUT_MM = 24.0, 26.0
_LONGEST = 0.46
"""The longest arrow, as a share of the height of a row."""


def vector_fields(fields: tuple[LinkField, ...], time_s: Array, title: str = "") -> Figure:
    """One row per link: arrows (dx, dy) along time and the speed in the plane, to the same scale; time_s (T,).

    Right is along the parent, up is the normal to it. Arrows are left out evenly where there are more than `ARROWS`.
    Grey is a link whose mean speed is below its deviation: it may as well stand still, or move much more.
    """
    every = max(1, -(-len(time_s) // ARROWS))
    fastest = max((np.nanmax(f.speed_m_s) for f in fields if np.isfinite(f.speed_m_s).any()), default=np.nan)
    height = min(_ROW_MM * len(fields), style.PAGE_MM - _ABOUT_MM) + _ABOUT_MM
    with style.drawing(height, title=title or " ") as figure:
        if not fields:
            return figure
        panels = figure.subplots(len(fields), 2, sharex="col", squeeze=False, width_ratios=(2, 1))
        keyed = False
        for (left, right), field in zip(panels, fields, strict=True):
            name, parent = (f"{a} → {b}" for a, b in (field.link, field.parent))
            left.set_title(f"{name}  in the frame of  {parent}", loc="left", pad=2, fontsize=style.SMALL)
            left.set_yticks([])
            left.spines["left"].set_visible(False)
            if not np.isfinite(field.speed_m_s).any():
                style.blank(left)
                style.blank(right)
                continue
            means = field_means((field,)).iloc[0]
            colour = style.GREY if means["speed_sigma_m_s"] > means["speed_m_s"] else style.COLOURS[0]
            arrows = _arrows(left, field, time_s, every, float(fastest), colour)
            if not keyed:
                _key(left, arrows, float(fastest), every, height)
                keyed = True
            right.plot(time_s, field.speed_m_s, color=colour, **style.dots(len(time_s), 1.8))
            if np.isfinite(field.speed_sigma_m_s).any():
                style.draw_band(right, time_s, field.speed_m_s, field.speed_sigma_m_s, colour)
            right.set_ylim(0, 1.08 * fastest or 1.0)
            right.locator_params(axis="y", nbins=3)
            speed, sigma = means["speed_m_s"], means["speed_sigma_m_s"]
            text = f"mean {speed:.2f}{f', sigma {sigma:.2f}' if np.isfinite(sigma) else ''} m/s"
            right.set_title(
                text, loc="right", pad=2, fontsize=style.SMALL, color="k" if colour != style.GREY else style.GREY
            )
        room = 0.08 * float(np.ptp(time_s)) or 0.5
        panels[0, 0].set_xlim(time_s[0] - room, time_s[-1] + room)
        for axes in panels[:-1, 0]:
            axes.spines["bottom"].set_visible(False)
            axes.tick_params(bottom=False)
        panels[-1, 0].set_xlabel("time (s);  → along the parent, ↑ normal to it")
        banded = any(np.isfinite(field.speed_sigma_m_s).any() for field in fields)
        panels[-1, 1].set_xlabel("time (s)" + (";  band: one sigma" if banded else ""))
        panels[len(fields) // 2, 1].set_ylabel("speed in the plane (m/s)")
    return figure


def _arrows(axes: Axes, field: LinkField, time_s: Array, every: int, fastest: float, colour: str) -> Quiver:
    known = np.isfinite(field.velocity_m_s[:, :2]).all(axis=1) & (np.arange(len(time_s)) % every == 0)
    axes.axhline(0, color=style.PALE, lw=0.6, zorder=1)
    dx, dy = field.velocity_m_s[known, :2].T
    scale = {"angles": "uv", "scale_units": "height", "scale": (fastest or 1.0) / _LONGEST, "units": "inches"}
    looks = {"width": 0.013, "headwidth": 4, "clip_on": False, "color": colour, "zorder": 2}
    arrows = axes.quiver(time_s[known], np.zeros(known.sum()), dx, dy, **scale, **looks)
    arrows.set_in_layout(False)
    return arrows


def _key(axes: Axes, arrows: Quiver, fastest: float, every: int, height_mm: float) -> None:
    size = style.round_below(fastest / 2)
    shown = "" if every == 1 else f" (one frame of {every})"
    place = {"X": 0.73, "Y": 1 - 3.0 / height_mm, "coordinates": "figure", "labelpos": "E"}
    axes.quiverkey(arrows, U=size, label=f"{size:g} m/s{shown}", fontproperties={"size": style.SMALL}, **place)
