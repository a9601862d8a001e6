"""Parameters of inverse kinematics' methods, fitted to each configuration of a stride by itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.arrays import Array
from recon.robotics.ik.fit import FittedSeries
from recon.show.plots.style import GREY, SMALL, add_legend, drawing, legend_shape, look, plain_logarithm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = {
    "transpose": ("alpha of the transpose (1/m²)", "linear"),
    "gradient-projection": ("k of gradient projection (1/s)", "linear"),
    "damped": ("lambda of damping (m), 0.0001: none", "log"),
    "selectively-damped": ("gamma_max (rad)", "log"),
}
"""Of methods with one parameter: what it is called, and its axis."""


def parameter_series(
    time_s: Array, found: Mapping[str, FittedSeries], joints: Sequence[str], title: str = ""
) -> Figure:
    """Over the times (F,) of a stride: the share of the joint rates that each method explains, the factor alpha with
    which it would explain the most, and the parameters that are found, of the weights one for each of joints (n,)."""
    single = [name for name in _PANELS if name in found]
    rows = 1 + -(-len(single) // 2)
    legend_mm = legend_shape(list(found))[1] + legend_shape(joints)[1]
    with drawing(38 * (rows + ("weighted" in found)) + 18 + legend_mm, title=title) as figure:
        parts: Any = figure.subfigures(2, 1, height_ratios=(rows, 1.15)) if "weighted" in found else (figure, None)
        upper, lower = parts
        panels = np.ravel(upper.subplots(rows, 2, sharex=True, squeeze=False))
        for k, (name, series) in enumerate(found.items()):
            panels[0].plot(time_s, 100 * series.explained, **look(k), label=name)
            panels[1].plot(time_s, series.alpha, **look(k))
            if name in _PANELS:
                axes, (label, scale) = panels[2 + single.index(name)], _PANELS[name]
                axes.plot(time_s, series.parameter[:, 0], **look(k), marker="o", ms=2)
                if scale == "log":
                    _logarithmic(axes, series.parameter)
                axes.set_title(label, loc="left", fontsize=SMALL, color=GREY)
        panels[0].set_title("explained of the joint rates (%)", loc="left", fontsize=SMALL, color=GREY)
        panels[0].set_ylim(0, 105)
        panels[1].set_title("best factor alpha on the rates", loc="left", fontsize=SMALL, color=GREY)
        for axes in panels[2 + len(single) :]:
            axes.set_axis_off()
        for axes in panels[2 * (rows - 1) :]:
            axes.set_xlabel("time (s)")
        add_legend(upper, *panels[0].get_legend_handles_labels())
        if lower is not None:
            _weights(lower.subplots(), time_s, found["weighted"].parameter)
            add_legend(lower, lower.axes[0].get_lines(), joints)
    return figure


def _weights(axes: Axes, time_s: Array, weights: Array) -> None:
    for k, of_joint in enumerate(weights.T):
        axes.plot(time_s, of_joint, **look(k))
    _logarithmic(axes, weights)
    axes.set_xlabel("time (s)")
    axes.set_title("weights, mean 1; large: a joint that is spared", loc="left", fontsize=SMALL, color=GREY)


def _logarithmic(axes: Axes, values: Array) -> None:
    """Without powers in the ticks, and no axis within less than a power of ten."""
    axes.set_yscale("log")
    axes.set_ylim(values.min() / 3, values.max() * 4)
    plain_logarithm(axes.yaxis)
