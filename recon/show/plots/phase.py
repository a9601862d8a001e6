"""Phase portraits: rate over angle, coloured by time."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from recon.base.arrays import Array, Bools
from recon.fit.motion import MEASURED_SHARE
from recon.gait.phase import Closure, Portrait
from recon.show.plots.style import COLUMN_MM, GREY, SMALL, WIDTH_MM, blank, drawing, grid_shape, time_colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap, Normalize
    from matplotlib.figure import Figure


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
    width = COLUMN_MM if count == 1 else WIDTH_MM
    rows, columns = grid_shape(count, width, _ASPECT, 2 if count == 4 else 3) if count else (0, 1)
    with drawing(rows * _ASPECT * min(width / columns, 60.0) + _REST_MM, width, title=title) as figure:
        if not count:
            return figure
        from matplotlib.cm import ScalarMappable

        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        colours = time_colours(np.concatenate([p.time_s[_known(p)] for p in portraits.values()]))
        for axes, (name, portrait) in zip(panels, portraits.items(), strict=False):
            value, share = (closed or {}).get(name), (shares or {}).get(name, np.nan)
            heading = name.removesuffix("_rad") + (f"\n{share:.0%} from pixels" if np.isfinite(share) else "")
            if value is not None:
                angle, plane = _percent(value.angle, value.angle_sigma), _percent(value.plane, value.plane_sigma)
                heading += f"\n{angle} / {plane} %"
            unseen = share < MEASURED_SHARE
            axes.set_title(heading, fontsize=SMALL, pad=3, color=GREY if unseen else "k")
            _draw(axes, portrait, None if unseen else colours)
        for axes in panels[count:]:
            axes.set_axis_off()
        gap = "\n" if count == 1 else "   "
        marks = "○ start   ■ end" + (f"{gap}%: degree of closure, of the angle / in the plane" if closed else "")
        if any(portrait.angle_sigma_rad is not None for portrait in portraits.values()):
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
    from matplotlib.collections import LineCollection

    known = np.flatnonzero(_known(portrait))
    if not len(known):
        blank(axes)
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
    if portrait.angle_sigma_rad is not None and portrait.rate_sigma_rad_s is not None:
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
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

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
