"""Draw stances, vertical forces, speeds and vector fields over time, and phase portraits.

A phase portrait shows the rate of an angle against the angle, coloured by time. A vector field shows the velocity of
each link's tip in its parent's frame over time.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.quiver import Quiver
from matplotlib.ticker import MaxNLocator

from recon.base.arrays import Array, Bools
from recon.base.numbers import decimals, percent, plus_minus, quantity
from recon.fit.motion import MEASURED_FRACTION
from recon.gait.dynamics import Dynamics
from recon.gait.gait import Gait
from recon.gait.kinematics import JointKinematics
from recon.gait.phase import Closure, LinkField, Portrait, means_of_field
from recon.gait.series import Series
from recon.gait.stances import FOOT_ROWS, Stance, interval_of
from recon.show.plots import style

HATCHES = ("", "////", "....", "xxxx")
_BAR = 0.76
"""Height of a foot's bars for all gaits together, as a fraction of the height of the foot's row."""
FINE = 0.01
"""Duration of a stance, as a fraction of the clip's, below which intervals and strides would hide the stances."""


def footfall(gaits: Mapping[str, Gait], fps: float, title: str = "", has_caption: bool = True) -> Figure:
    """Draw the stances of each foot over time, as found by one or several methods.

    `gaits` has the gait found by each method, keyed by the method's name. The bars of several methods are above each
    other. The second axis counts frames, and frame 0 is at 0 s. Left feet are blue and right feet orange, or each gait
    has a colour. A stance that is cut by the clip, and so may last longer, has an arrow instead of an edge. Lines
    across the edges are the 90 % intervals of touch-downs, in the upper half, and of lift-offs, in the lower half. Thin
    lines with ticks are complete strides. A long clip has neither intervals nor strides, because they would hide the
    stances. If `has_caption`, the name of each gait and its criterion are at the bottom.
    """
    is_captioned = has_caption and not style.is_printing()
    captions = [_caption(name, gait) for name, gait in gaits.items()] if is_captioned else []
    is_fine = all(map(shows_intervals, gaits.values()))
    lines = sum(caption.count("\n") + 1 for caption in captions)
    other_feet = [foot for gait in gaits.values() for foot in gait.tracks.feet if foot not in FOOT_ROWS]
    feet = [foot for foot in FOOT_ROWS if any(foot in g.tracks.feet for g in gaits.values())] + list(
        dict.fromkeys(other_feet)
    )
    with style.drawing(9.0 * len(feet) + 32 + 3.4 * lines + 4 * bool(title), title=title) as figure:
        if not gaits:
            return figure
        axes = figure.subplots()
        bar_height = _BAR / len(gaits)
        for m, gait in enumerate(gaits.values()):
            row_of_foot = {foot: row - _BAR / 2 + (m + 0.5) * bar_height for row, foot in enumerate(feet)}
            strides = gait.strides if is_fine else ()
            points = [(t_s, row_of_foot[s.foot]) for s in strides for t_s in (s.start_s, s.end_s)]
            ends = np.array(points, dtype=float).reshape(-1, 2, 2)
            axes.add_collection(LineCollection([*ends], color="k", lw=0.7, zorder=3.5), autolim=False)
            axes.plot(*ends.reshape(-1, 2).T, "k|", ms=5, zorder=3.5)
            for foot, y in row_of_foot.items():
                colour = style.foot_colour(foot) if len(gaits) == 1 else style.COLOURS[m % len(style.COLOURS)]
                _bars(axes, [s for s in gait.stances if s.foot == foot], y, 0.86 * bar_height, colour, m, is_fine)
        axes.set_yticks(range(len(feet)), feet)
        axes.set_ylim(len(feet) - 0.5, -0.5)
        axes.tick_params(axis="y", length=0)
        for row in range(1, len(feet)):
            axes.axhline(row - 0.5, color=style.PALE, lw=0.5, zorder=0)
        times = np.concatenate([g.tracks.time_s for g in gaits.values()])
        margin_s = 0.02 * float(np.ptp(times)) or 0.5 / fps
        axes.set_xlim(times.min() - margin_s, times.max() + margin_s)
        if captions:
            axes.set_xlabel("\n\n".join(["time (s)", "\n".join(captions)]), loc="left", fontsize=style.SMALL)
        else:
            axes.set_xlabel("time (s)")
        frames = axes.secondary_xaxis("top", functions=(lambda t: np.multiply(t, fps), lambda f: np.divide(f, fps)))
        frames.set_xlabel("frame")
        frames.xaxis.set_major_locator(MaxNLocator("auto", integer=True, steps=[1, 2, 5, 10]))
        if not any(g.stances for g in gaits.values()):
            axes.text(0.5, 0.5, "no stances", transform=axes.transAxes, ha="center", va="center")
        _legend(figure, gaits, feet, is_fine)
    return figure


def shows_intervals(gait: Gait) -> bool:
    """Return whether a gait's stances are long enough in a figure for intervals and strides to be drawn over them."""
    durations_s = [stance.duration_s for stance in gait.stances]
    return not durations_s or float(np.median(durations_s)) >= FINE * float(np.ptp(gait.tracks.time_s))


def _bars(axes: Axes, stances: Sequence[Stance], y: float, height: float, colour: str, m: int, is_fine: bool) -> None:
    """Draw the stance bars of one foot in the m-th gait, with the intervals of their ends if `is_fine`."""
    low, high, edges = y - height / 2, y + height / 2, []
    axes.broken_barh([(s.start_s, s.duration_s) for s in stances], (low, height), **_fill(colour, m), lw=0, zorder=2)
    for stance in stances:
        # A bar has an edge only where the stance begins or ends.
        left, right = stance.start_s, stance.end_s
        edges += [[(left, low), (right, low)], [(left, high), (right, high)]]
        edges += [[(left, low), (left, high)]] * stance.begins + [[(right, low), (right, high)]] * stance.ends
        for cut_s, marker in [(left, "<")] * (not stance.begins) + [(right, ">")] * (not stance.ends):
            axes.plot(cut_s, y, marker=marker, ms=4, color=colour, mec="w", mew=0.4, zorder=4, clip_on=False)
    lines = LineCollection(edges, color=colour, lw=1.1, capstyle="projecting", zorder=3)
    axes.add_collection(lines, autolim=False)
    if not is_fine:
        return
    intervals = np.array(
        [interval for stance in stances for interval in (stance.start_interval_s, stance.end_interval_s)]
    )
    # The two lines have different heights, because the intervals of a short stance would overlap.
    offsets = y + height / 4 * np.tile([-1, 1], len(stances))
    rows = zip(intervals, offsets, strict=True)
    segments = [np.array([(a, row), (b, row)]) for (a, b), row in rows if np.isfinite(a)]
    axes.add_collection(LineCollection(segments, color="0.35", lw=0.7, zorder=3.2), autolim=False)


def _caption(name: str, gait: Gait) -> str:
    text = f"{name}: {gait.name.name} ({gait.name.criterion})"
    if gait.strides:
        length_m, frequency_hz = gait.stride_length_m, gait.stride_frequency_hz
        text += f"; stride {length_m:{decimals(length_m)}} m, {frequency_hz:{decimals(frequency_hz)}} Hz"
    return textwrap.fill(text, 125)


def _legend(figure: Figure, gaits: Mapping[str, Gait], feet: Sequence[str], is_fine: bool) -> None:
    looks = {name: (style.COLOURS[m % len(style.COLOURS)], m) for m, name in enumerate(gaits)}
    if len(gaits) == 1:
        looks = {f"{'right' if foot.startswith('R') else 'left'} foot": (style.foot_colour(foot), 0) for foot in feet}
    handles: list = [Patch(**_fill(*look), label=name) for name, look in looks.items()]
    if not all(s.begins and s.ends for g in gaits.values() for s in g.stances):
        handles.append(Line2D([], [], linestyle="", marker=">", ms=4, color="k", label="cut by the clip"))
    if is_fine and any(np.isfinite((s.start_sigma_s, s.end_sigma_s)).any() for g in gaits.values() for s in g.stances):
        handles.append(Line2D([], [], color="0.35", lw=0.7, label="90 % interval of each end"))
    if is_fine and any(g.strides for g in gaits.values()):
        handles.append(Line2D([], [], color="k", lw=0.7, marker="|", ms=5, label="complete stride"))
    style.add_legend(figure, handles, [h.get_label() for h in handles])


def _fill(colour: str, m: int) -> dict[str, Any]:
    """Return the fill colour, hatch and edge of the stance bars of the m-th gait."""
    return {"fc": [0.55 + 0.45 * c for c in to_rgb(colour)], "ec": colour, "hatch": HATCHES[m % len(HATCHES)]}


def forces(dynamics: Dynamics, gait: Gait) -> Figure:
    """Draw footfalls, the vertical force of each foot in body weights, and the height of the centre of mass.

    Forces and the height have 90 % bands.
    """
    feet = [foot for foot in FOOT_ROWS if foot in dynamics.force] or list(dynamics.force)
    with style.drawing(26.0 + 24.0 * (len(feet) + 1)) as figure:
        heights = [0.7, *[1.0] * len(feet), 1.0]
        top, *below, last = figure.subplots(len(feet) + 2, 1, sharex=True, gridspec_kw={"height_ratios": heights})
        time_s = gait.tracks.time_s
        for row, foot in enumerate(feet):
            foot_stances, colour = [s for s in gait.stances if s.foot == foot], style.foot_colour(foot)
            _bars(top, foot_stances, row, 0.7, colour, 0, shows_intervals(gait))
            middle, low, high = dynamics.force[foot].T
            below[row].fill_between(time_s, low, high, color=colour, alpha=0.25, lw=0)
            below[row].plot(time_s, dynamics.force[foot][:, 1:], color=colour, lw=0.4)
            below[row].plot(time_s, middle, color=colour)
            below[row].text(0.005, 0.94, foot, transform=below[row].transAxes, va="top")
            below[row].sharey(below[0])
            if np.isnan(middle).any() and not np.nan_to_num(middle).any():
                text_style = {"transform": below[row].transAxes, "ha": "center", "va": "center", "color": style.GREY}
                below[row].text(0.5, 0.5, "not known: the clip cuts its stances", **text_style)
                below[row].tick_params(left=False, labelleft=False)  # all feet share this axis
        top.set_yticks(range(len(feet)), feet)
        top.invert_yaxis()
        if not style.is_printing():
            key = "bands: 90 %; gaps: stances that the clip cuts; left blue, right orange"
            top.set_title(f"stances, and vertical force of each foot ({key})", loc="left")
        # The label of all feet is beside the middle of their panels.
        below[len(feet) // 2].set_ylabel("vertical force (body weights)", y=1.0 - len(feet) % 2 / 2)
        below[0].set_ylim(bottom=0)
        series = dynamics.centre.series
        height = series.value[:, 2] - dynamics.ground_m
        style.draw_band(last, series.time_s, height, np.nan_to_num(series.value_sigma[:, 2]), "0.5", least=-np.inf)
        last.plot(series.time_s, height, color="k")
        last.set_ylabel("height of the\ncentre of mass (m)")
        last.set_xlabel("time (s)")
    return figure


BAND_ROOM = 3.0
"""Largest height of a speed axis relative to the highest curve, so that the curve fills a third of the panel.

Bands may be higher, such as the bands of accelerations from one camera, or at the ends of a spline.
"""


def speeds(
    curves: Mapping[str, JointKinematics],
    title: str = "",
    width_mm: float = style.WIDTH_MM,
    unknown: bool = False,
    acceleration: bool = True,
) -> Figure:
    """Draw speed and acceleration of one or several joints over time, with 90 % bands if they are known.

    Dots are frames, and the line between them is a spline. The line has gaps where the path is unknown. The legend
    states the peak, which a ring marks. If `unknown` is true, the speeds are mostly errors of the fitted path, and are
    drawn in grey and without peaks. `acceleration` adds a panel of the acceleration.
    """
    peaks = ["not known, errors of the path" if unknown else _peak(motion, acceleration) for motion in curves.values()]
    labels = [f"{name}: {peak}" for name, peak in zip(curves, peaks, strict=True)]
    speeds_m_s = [(motion.speed_m_s, motion.speed_sigma_m_s) for motion in curves.values()]
    quantities = [("speed", "m/s", speeds_m_s)]
    if acceleration:
        accelerations_m_s2 = [(motion.acceleration_m_s2, motion.acceleration_sigma_m_s2) for motion in curves.values()]
        quantities.append(("acceleration", "m/s²", accelerations_m_s2))
    height_mm = 14 + 42 * len(quantities) + style.legend_shape(labels, width_mm)[1]
    with style.drawing(height_mm, width_mm, title) as figure:
        panels, lines = figure.subplots(len(quantities), 1, sharex=True, squeeze=False)[:, 0], []
        for axes, (name, unit, pairs) in zip(panels, quantities, strict=True):
            series = [motion.series for motion in curves.values()]
            lines = [
                _curve(axes, i, one_series, *pair, unknown)
                for i, (one_series, pair) in enumerate(zip(series, pairs, strict=True))
            ]
            axes.set_ylabel(f"{name} ({unit})")
            _limit(axes, pairs)
        banded = any(np.isfinite(motion.speed_sigma_m_s).any() for motion in curves.values())
        panels[-1].set_xlabel("time (s)" + ("; bands and ±: 90 %" if banded else ""))
        style.add_legend(figure, lines, labels, width_mm)
    return figure


def _curve(axes: Axes, i: int, series: Series, value: Array, sigma: Array, unknown: bool) -> Line2D:
    line_style: dict[str, Any] = style.look(i) | ({"color": style.GREY} if unknown else {})
    time_s, every = series.time_s, series.oversampling
    (line,) = axes.plot(time_s, value, **style.dots(len(time_s) // every, 2.2), markevery=every, zorder=3, **line_style)
    if np.isfinite(sigma).any():
        style.draw_band(axes, time_s, value, sigma, line_style["color"])
    if np.isfinite(value).any() and not unknown:
        k = int(np.nanargmax(value))
        axes.plot(time_s[k], value[k], "o", ms=6, mfc="none", mec=line_style["color"], mew=1.0, zorder=4)
    return line


def _peak(motion: JointKinematics, acceleration: bool) -> str:
    if not np.isfinite(motion.peak_speed_m_s):
        return "no data"
    speed = plus_minus(motion.peak_speed_m_s, style.BAND_SIGMAS * motion.peak_speed_sigma_m_s, "m/s", default=".2f")
    text = f"peak {speed} at {quantity(motion.peak_speed_time_s, 3, 's')}"
    if acceleration:
        sigma = style.BAND_SIGMAS * motion.peak_acceleration_sigma_m_s2
        text += f", {plus_minus(motion.peak_acceleration_m_s2, sigma, 'm/s²', default='.0f')}"
    return text


def _limit(axes: Axes, series: list[tuple[Array, Array]]) -> None:
    highest = np.max([np.nanmax(v) for v, _ in series if np.isfinite(v).any()], initial=-np.inf)
    if not np.isfinite(highest):
        style.blank(axes)
        return
    tops = [np.nanmax(v + style.BAND_SIGMAS * s) for v, s in series if np.isfinite(v + s).any()]
    top = min(np.max(tops, initial=highest), BAND_ROOM * highest)
    axes.set_ylim(0, 1.06 * top if top > 0 else 1.0)


SHADES = 60
"""Number of colours into which the path of a phase portrait is divided."""
_MIN_HALF_RANGES = (0.05, 0.5)
"""Half of the smallest range of the axes of a phase portrait, in degrees and in degrees per second."""
_ASPECT, _REST_MM = 0.9, 24.0
_BAND = "#E6E6E6"
"""Colour of the band around the path of a phase portrait."""
_UNSEEN = "#9A9A9A"
"""Colour of the path of a phase portrait that comes mostly from the prior."""
_ELLIPSE_SPACING = 0.25
"""Distance between successive ellipses of a phase portrait's band, relative to their half axes."""


MAX_PRINTED_PORTRAITS = 6
"""Largest number of phase portraits in a figure for a paper."""
_EXACT_RAD = 1e-6
"""Smallest standard deviation, in radians, by which the range of an angle is divided."""


def phase_portraits(
    portraits: Mapping[str, Portrait],
    closed: Mapping[str, Closure] | None = None,
    title: str = "",
    shares: Mapping[str, float] | None = None,
) -> Figure:
    """Draw phase portraits, in degrees and degrees per second, with a panel for each angle on one page.

    `closed` has the degree of closure of each angle by name, and `shares` the fraction of its precision that comes from
    the pixels. The path of an angle is grey if this fraction is below `MEASURED_FRACTION`. Bands are the 90 % intervals
    of angle and rate. Each panel has its own axes.
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
            value, fraction = (closed or {}).get(name), (shares or {}).get(name, np.nan)
            heading = name.removesuffix("_rad").replace("_", " ") + (
                f"\n{percent(fraction)} from pixels" if np.isfinite(fraction) else ""
            )
            if value is not None:
                angle, plane = _percent(value.angle, value.angle_sigma), _percent(value.plane, value.plane_sigma)
                heading += f"\n{angle} / {plane} %"
            is_unseen = fraction < MEASURED_FRACTION
            axes.set_title(heading, fontsize=style.SMALL, pad=3, color=style.GREY if is_unseen else "k")
            _draw(axes, portrait, None if is_unseen else colours)
        for axes in panels[count:]:
            axes.set_axis_off()
        gap = "\n" if count == 1 else "   "
        marks = "○ start   ■ end" + (f"{gap}%: degree of closure, of the angle / in the plane" if closed else "")
        if any(np.isfinite(portrait.angle_sigma_rad).any() for portrait in portraits.values()):
            marks += f"{gap}band, ±: 90 %"
        if shares:
            marks += (
                "\nfrom pixels: fraction of the angle's precision, over the whole clip;  "
                f"grey: less than {percent(MEASURED_FRACTION)}, mostly from the prior"
            )
        figure.supxlabel(f"angle (deg)\n{marks}", fontsize="medium")
        figure.supylabel("rate (deg/s)", fontsize="medium")
        scale = ScalarMappable(colours[1], colours[0])
        figure.colorbar(scale, ax=panels.tolist(), location="right", aspect=50, label="time (s)", pad=0.01)
    return figure


def clearest_portraits(
    portraits: Mapping[str, Portrait], shares: Mapping[str, float], count: int = MAX_PRINTED_PORTRAITS
) -> dict[str, Portrait]:
    """Return the phase portraits of the angles whose range is largest relative to their uncertainty.

    Parameters
    ----------
    portraits
        Phase portraits, keyed by the names of the angles, whose order the result keeps.
    shares
        Fraction of each angle's precision that comes from the pixels. Angles below `MEASURED_FRACTION` are left out,
        unless no angle would remain.
    count
        Largest number of portraits.
    """

    def clarity(name: str) -> float:
        portrait = portraits[name]
        known = portrait.angle_rad[_known(portrait)]
        sigma_rad = (
            float(np.nanmedian(portrait.angle_sigma_rad)) if np.isfinite(portrait.angle_sigma_rad).any() else 1.0
        )
        return float(np.ptp(known)) / max(sigma_rad, _EXACT_RAD) if len(known) else 0.0

    seen = [name for name in portraits if not shares.get(name, 1.0) < MEASURED_FRACTION] or [*portraits]
    best = sorted(seen, key=clarity, reverse=True)[:count]
    return {name: portrait for name, portrait in portraits.items() if name in best}


def _known(portrait: Portrait) -> Bools:
    return np.isfinite(portrait.angle_rad) & np.isfinite(portrait.rate_rad_s)


def _draw(axes: Axes, portrait: Portrait, colours: tuple[ListedColormap, Normalize] | None) -> None:
    """Draw one phase portrait in the colours of the times, or in grey if `colours` is None."""
    rows = np.flatnonzero(_known(portrait))
    if not len(rows):
        style.blank(axes)
        return
    path = np.degrees(np.column_stack([portrait.angle_rad, portrait.rate_rad_s]))
    cuts = np.unique(np.linspace(rows[0], rows[-1], SHADES + 1).astype(int))
    pieces = [path[a : b + 1] for a, b in pairwise(cuts)]
    middles = [float(np.mean(portrait.time_s[[a, b]])) for a, b in pairwise(cuts)]
    shades: dict[str, Any] = {"color": _UNSEEN}
    if colours is not None:
        shades = {"cmap": colours[0], "norm": colours[1], "array": np.array(middles)}
    axes.add_collection(LineCollection(pieces, lw=1.2, capstyle="round", **shades), autolim=False)
    axes.update_datalim(path[rows])
    if np.isfinite(portrait.angle_sigma_rad).any():
        sigma = np.degrees(np.column_stack([portrait.angle_sigma_rad, portrait.rate_sigma_rad_s]))
        _band(axes, path[rows], style.BAND_SIGMAS * sigma[rows])
    # The axes have a smallest range, so that a constant angle does not look like a motion.
    middle = (path[rows].min(axis=0) + path[rows].max(axis=0)) / 2
    axes.update_datalim([middle - _MIN_HALF_RANGES, middle + _MIN_HALF_RANGES])
    axes.autoscale_view()
    axes.plot(*path[rows[0]], "o", ms=4, mfc="w", mec="k", mew=0.9, zorder=3)
    axes.plot(*path[rows[-1]], "s", ms=4, mfc="k", mec="k", zorder=3)
    axes.locator_params(nbins=4, steps=[1, 2, 5, 10])
    axes.ticklabel_format(useOffset=False)
    axes.tick_params(labelsize=6, pad=1.5, length=2)


def _band(axes: Axes, path: Array, half: Array) -> None:
    """Draw ellipses with half axes (N, 2) along a path (N, 2), close enough to look like one shape."""
    steps = np.linalg.norm(np.diff(path, axis=0) / np.maximum(half[1:], 1e-12), axis=1)
    arc_length = np.concatenate([[0.0], np.cumsum(steps)])
    chosen = np.unique(
        np.searchsorted(arc_length, np.arange(0.0, arc_length[-1] + _ELLIPSE_SPACING, _ELLIPSE_SPACING)).clip(
            max=len(path) - 1
        )
    )
    circle = Path.unit_circle()
    corners = path[chosen, None] + half[chosen, None] * np.asarray(circle.vertices)
    codes = np.tile(np.asarray(circle.codes), len(chosen))
    axes.add_artist(PathPatch(Path(corners.reshape(-1, 2), codes), fc=_BAND, lw=0))
    axes.update_datalim(np.concatenate([path - half, path + half]))


def _percent(value: float, sigma: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.0f}±{style.BAND_SIGMAS * sigma:.0f}" if np.isfinite(sigma) else f"{value:.0f}"


MAX_ARROWS = 45
"""Largest number of arrows in a row of a vector field."""
_ROW_MM, _ABOUT_MM = 24.0, 26.0
_ARROW_LENGTH = 0.46
"""Length of the longest arrow of a vector field relative to the height of a row."""


def vector_fields(fields: tuple[LinkField, ...], time_s: Array, title: str = "") -> Figure:
    """Draw the velocity of each link's tip in the plane over time, as arrows and as a curve of its speed.

    Each link has a row, and all rows have the same scale. `time_s` (T,) has the times in seconds. Right is along the
    parent, and up is perpendicular to the parent. At most `MAX_ARROWS` evenly spaced arrows are drawn. A link is grey
    if its mean speed is below its standard deviation. A speed whose band would fill its panel is left out.
    """
    every = max(1, -(-len(time_s) // MAX_ARROWS))
    fastest = max((np.nanmax(f.speed_m_s) for f in fields if np.isfinite(f.speed_m_s).any()), default=np.nan)
    height = min(_ROW_MM * len(fields), style.PAGE_MM - _ABOUT_MM) + _ABOUT_MM
    with style.drawing(height, title=title or " ") as figure:
        if not fields:
            return figure
        panels = figure.subplots(len(fields), 2, sharex="col", squeeze=False, width_ratios=(2, 1))
        arrows = None
        for (left, right), field in zip(panels, fields, strict=True):
            name, parent = (f"{a} → {b}" for a, b in (field.link, field.parent))
            left.set_title(f"{name}  in the frame of  {parent}", loc="left", pad=2, fontsize=style.SMALL)
            left.set_yticks([])
            left.spines["left"].set_visible(False)
            if not np.isfinite(field.speed_m_s).any():
                style.blank(left)
                style.blank(right)
                continue
            means = means_of_field(field)
            speed, sigma = means.speed_m_s, means.speed_sigma_m_s
            is_grey = sigma > speed
            colour = style.GREY if is_grey else style.COLOURS[0]
            quiver = _arrows(left, field, time_s, every, float(fastest), colour)
            if arrows is None:
                _key(left, arrows := quiver, float(fastest), every, height)
            top_m_s = float(1.08 * fastest or 1.0)
            _, low, high = interval_of(field.speed_m_s, field.speed_sigma_m_s)
            if style.is_filled(low, high, 0.0, top_m_s):
                style.blank(right, "not known: the 90 % band\nwould fill the panel")
            else:
                right.plot(time_s, field.speed_m_s, color=colour, **style.dots(len(time_s), 1.8))
                if np.isfinite(field.speed_sigma_m_s).any():
                    style.draw_band(right, time_s, field.speed_m_s, field.speed_sigma_m_s, colour)
                right.set_ylim(0, top_m_s)
                right.locator_params(axis="y", nbins=3)
            text = f"mean {plus_minus(speed, style.BAND_SIGMAS * sigma, 'm/s', default='.2f')}"
            right.set_title(text, loc="right", pad=2, fontsize=style.SMALL, color=style.GREY if is_grey else "k")
        margin_s = 0.08 * float(np.ptp(time_s)) or 0.5
        panels[0, 0].set_xlim(time_s[0] - margin_s, time_s[-1] + margin_s)
        for axes in panels[:-1, 0]:
            axes.spines["bottom"].set_visible(False)
            axes.tick_params(bottom=False)
        panels[-1, 0].set_xlabel("time (s);  → along the parent, ↑ perpendicular to it")
        banded = any(np.isfinite(field.speed_sigma_m_s).any() for field in fields)
        panels[-1, 1].set_xlabel("time (s)" + (";  band, ±: 90 %" if banded else ""))
        panels[len(fields) // 2, 1].set_ylabel("speed in the plane (m/s)")
    return figure


def _arrows(axes: Axes, field: LinkField, time_s: Array, every: int, fastest: float, colour: str) -> Quiver:
    is_drawn = np.isfinite(field.velocity_m_s[:, :2]).all(axis=1) & (np.arange(len(time_s)) % every == 0)
    axes.axhline(0, color=style.PALE, lw=0.6, zorder=1)
    dx, dy = field.velocity_m_s[is_drawn, :2].T
    scale = {"angles": "uv", "scale_units": "height", "scale": (fastest or 1.0) / _ARROW_LENGTH, "units": "inches"}
    looks = {"width": 0.013, "headwidth": 4, "clip_on": False, "color": colour, "zorder": 2}
    arrows = axes.quiver(time_s[is_drawn], np.zeros(is_drawn.sum()), dx, dy, **scale, **looks)
    arrows.set_in_layout(False)
    return arrows


def _key(axes: Axes, arrows: Quiver, fastest: float, every: int, height_mm: float) -> None:
    size = style.round_below(fastest / 2)
    note = "" if every == 1 else f" (one frame of {every})"
    position = {"X": 0.73, "Y": 1 - 3.0 / height_mm, "coordinates": "figure", "labelpos": "E"}
    axes.quiverkey(arrows, U=size, label=f"{size:g} m/s{note}", fontproperties={"size": style.SMALL}, **position)
