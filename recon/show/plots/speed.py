"""Speed and acceleration of a joint over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.arrays import Array
from recon.gait.kinematics import JointKinematics
from recon.show.plots.style import GREY, WIDTH_MM, add_legend, blank, dots, draw_band, drawing, legend_shape, look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D


BAND_ROOM = 1.6
"""Bands may take the axis up to this times the highest curve: at a spline's ends they are several times as wide."""


def speeds(
    curves: Mapping[str, JointKinematics],
    title: str = "",
    width_mm: float = WIDTH_MM,
    unknown: bool = False,
    acceleration: bool = True,
) -> Figure:
    """Speed and acceleration of one joint or of several, by name, with bands of one sigma where known.

    Dots are frames, the rest is the spline between them; it is open where the path is not known. The legend gives the
    peak, which has a ring. unknown: that they are errors of the path rather than speeds; grey, without peaks.
    acceleration: whether it is drawn, too.
    """
    peaks = ["not known, errors of the path" if unknown else _peak(motion, acceleration) for motion in curves.values()]
    labels = [f"{name}: {peak}" for name, peak in zip(curves, peaks, strict=True)]
    rows = 2 if acceleration else 1
    with drawing(14 + 42 * rows + legend_shape(labels, width_mm)[1], width_mm, title) as figure:
        above, below = figure.subplots(2, 1, sharex=True) if acceleration else [figure.subplots()] * 2
        handles = []
        for i, motion in enumerate(curves.values()):
            handles.append(_curve(above, i, motion, motion.speed_m_s, motion.speed_sigma_m_s, unknown))
            if acceleration:
                _curve(below, i, motion, motion.acceleration_m_s2, motion.acceleration_sigma_m_s2, unknown)
        for axes, unit, values, sigmas in (
            (above, "speed (m/s)", "speed_m_s", "speed_sigma_m_s"),
            (below, "acceleration (m/s²)", "acceleration_m_s2", "acceleration_sigma_m_s2"),
        )[:rows]:
            axes.set_ylabel(unit)
            _limit(axes, [(getattr(m, values), getattr(m, sigmas)) for m in curves.values()])
        below.set_xlabel("time (s)")
        add_legend(figure, handles, labels, width_mm)
    return figure


def _curve(axes: Axes, i: int, motion: JointKinematics, value: Array, sigma: Array | None, unknown: bool) -> Line2D:
    style: dict[str, Any] = look(i) | ({"color": GREY} if unknown else {})
    t = motion.series.time_s
    every = motion.series.oversampling
    (line,) = axes.plot(t, value, **dots(len(t) // every, 2.2), markevery=every, zorder=3, **style)
    if sigma is not None:
        draw_band(axes, t, value, sigma, style["color"])
    if np.isfinite(value).any() and not unknown:
        k = int(np.nanargmax(value))
        axes.plot(t[k], value[k], "o", ms=6, mfc="none", mec=style["color"], mew=1.0, zorder=4)
    return line


def _peak(motion: JointKinematics, acceleration: bool) -> str:
    if not np.isfinite(motion.peak_speed_m_s):
        return "no data"
    speed = f"{motion.peak_speed_m_s:.2f}{_deviation(motion.peak_speed_sigma_m_s, 2)} m/s"
    text = f"peak {speed} at {motion.peak_speed_time_s:.3f} s"
    if acceleration:
        spread = _deviation(motion.peak_acceleration_sigma_m_s2, 0)
        text += f", {motion.peak_acceleration_m_s2:.0f}{spread} m/s²"
    return text


def _deviation(sigma: float, digits: int) -> str:
    return "" if np.isnan(sigma) else f" ± {sigma:.{digits}f}"


def _limit(axes: Axes, series: list[tuple[Array, Array | None]]) -> None:
    highest = np.max([np.nanmax(v) for v, _ in series if np.isfinite(v).any()], initial=-np.inf)
    if not np.isfinite(highest):
        blank(axes)
        return
    tops = [np.nanmax(v + s) for v, s in series if s is not None and np.isfinite(v + s).any()]
    top = min(np.max(tops, initial=highest), BAND_ROOM * highest)
    axes.set_ylim(0, 1.06 * top if top > 0 else 1.0)
