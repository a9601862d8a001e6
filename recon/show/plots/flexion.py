"""Draw the joints' flexion over the stride, left and right, with stance bars below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from recon.animal.anatomy import FLEXES_CAUDALLY
from recon.animal.body import Side
from recon.gait.flexion import PERCENT, StrideCurve
from recon.gait.stances import interval_of
from recon.show.plots import style

COLUMNS = 3
"""Number of panels in a row of a figure as wide as a page."""
NARROW_COLUMNS = 2
"""Number of panels in a row of a figure as wide as a column."""
_PANEL_MM = 42.0
"""Height in mm of a panel with its stance bars."""
_AROUND_MM = 24.0
"""Height in mm of labels and legend around the panels."""
_BARS = 0.16
"""Fraction of a panel's height that the stance bars below the curves take."""


def joint_flexion(curves: Sequence[StrideCurve], title: str = "") -> Figure:
    """Draw the mean flexion of each joint over the stride.

    Left joints are blue and dashed, right joints orange, and middle joints black. Bands, which need three strides,
    contain 90 % of further strides, and thin lines are the 90 % interval of the fit. Bars below the curves show the
    stance of the limb's foot, from its touch-down at 0 %.
    """
    names = [joint for joint in FLEXES_CAUDALLY if any(curve.joint == joint for curve in curves)]
    columns = COLUMNS if style.page_width_mm() > style.NARROW_MM else NARROW_COLUMNS
    rows = -(-len(names) // columns)
    with style.drawing(rows * _PANEL_MM + _AROUND_MM, title=title or None) as figure:
        if not names:
            return figure
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
        for axes, joint in zip(panels, names, strict=False):
            curves_of_joint = [curve for curve in curves if curve.joint == joint]
            for curve in curves_of_joint:
                _draw_curve(axes, curve)
            _draw_stances(axes, curves_of_joint)
            axes.set_title(joint.replace("_", " "), loc="left", pad=3)
            axes.set_xlim(0, 100)
            axes.locator_params(axis="y", nbins=5)
        for axes in panels[len(names) :]:
            axes.set_axis_off()
        for i, axes in enumerate(panels[: len(names)]):
            axes.tick_params(labelbottom=True)
            if i % columns == 0:
                axes.set_ylabel("flexion (°)")
            if i + columns >= len(names):
                axes.set_xlabel("stride (%)")
        _add_legend(figure, curves)
    return figure


def _draw_curve(axes: Axes, curve: StrideCurve) -> None:
    colour, dashes = style.SIDE_COLOURS[curve.side], (0, (4, 1.2)) if curve.side == "left" else "-"
    mean = np.degrees(curve.mean_rad)
    axes.plot(PERCENT, mean, color=colour, lw=1.3, linestyle=dashes, zorder=3)
    reach = np.degrees(curve.between_reach_rad)
    if np.isfinite(reach).any():
        axes.fill_between(PERCENT, mean - reach, mean + reach, color=colour, alpha=style.BAND_ALPHA, lw=0)
    if np.isfinite(curve.posterior_sigma_rad).any():
        for end in interval_of(mean, np.degrees(curve.posterior_sigma_rad))[1:]:
            axes.plot(PERCENT, end, color=colour, lw=0.5, zorder=2)


def _draw_stances(axes: Axes, curves: Sequence[StrideCurve]) -> None:
    low, high = axes.get_ylim()
    axes.set_ylim(low - _BARS / (1 - _BARS) * (high - low), high)
    transform, height = axes.get_xaxis_transform(), _BARS / 2.6
    for row, curve in enumerate(curves):
        corner = 0.0, _BARS - (row + 1.15) * height
        look = {"color": style.SIDE_COLOURS[curve.side], "alpha": 0.75, "lw": 0}
        axes.add_patch(Rectangle(corner, 100 * curve.duty_factor, 0.75 * height, transform=transform, **look))
    axes.axhline(low, color=style.PALE, lw=0.5, zorder=0)


def _add_legend(figure: Figure, curves: Sequence[StrideCurve]) -> None:
    handles: list[Line2D | Patch] = []
    labels: dict[Side | None, str] = {"left": "left", "right": "right", None: "middle"}
    for side, label in labels.items():
        curves_of_side = [curve for curve in curves if curve.side == side]
        if curves_of_side:
            counts = sorted({curve.strides for curve in curves_of_side})
            strides = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
            dashes = (0, (4, 1.2)) if side == "left" else "-"
            text = f"{label}, {strides} stride{'s' * (counts[-1] > 1)}"
            handles.append(Line2D([], [], color=style.SIDE_COLOURS[side], lw=1.3, linestyle=dashes, label=text))
    if any(np.isfinite(curve.between_reach_rad).any() for curve in curves):
        handles.append(Patch(color=style.GREY, alpha=style.BAND_ALPHA, lw=0, label="90 % of further strides"))
    if any(np.isfinite(curve.posterior_sigma_rad).any() for curve in curves):
        handles.append(Line2D([], [], color=style.GREY, lw=0.5, label="90 % from the fit's uncertainty"))
    handles.append(Patch(color=style.GREY, alpha=0.75, lw=0, label="bars: stance"))
    style.add_legend(figure, handles, [str(handle.get_label()) for handle in handles])
