"""Draw the path of a chain's end effector over time, with the boundaries of its strides."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from recon.gait.end_effector import EndEffector
from recon.gait.gait import Stride
from recon.show.plots import style

_RULE = (
    "| boundary: the horizontal position is a local minimum, the horizontal velocity crosses zero upwards"
    "\n○ nearest extremum of the height"
)


def stride_boundaries(effector: EndEffector, stride: Stride | None = None) -> Figure:
    """Draw a foot's horizontal position, height and horizontal velocity relative to the body.

    Lines mark the boundaries between strides, and circles the nearest extrema of the height. The phase portraits show
    the shaded stride.
    """
    curves = (
        (effector.forward_m, "forwards (m)"),
        (effector.up_m, "height (m)"),
        (effector.forward_rate_m_s, "velocity,\nforwards (m/s)"),
    )
    with style.drawing(100, title=f"{effector.foot} relative to the body") as figure:
        rows = figure.subplots(3, 1, sharex=True)
        for i, (axes, (values, label)) in enumerate(zip(rows, curves, strict=True)):
            if stride is not None:
                axes.axvspan(stride.start_s, stride.end_s, color=style.PALE, alpha=0.5, lw=0, zorder=0, gid="stride")
            axes.plot(effector.time_s, values, **style.look(i))
            for at_s in effector.boundaries_s:
                axes.axvline(at_s, color="k", lw=0.7, zorder=1, gid="boundary")
            axes.set_ylabel(label)
            axes.margins(x=0.01)
        heights = np.interp(effector.height_extrema_s, effector.time_s, effector.up_m)
        rows[1].plot(effector.height_extrema_s, heights, "o", mfc="w", mec="k", ms=4.5, zorder=4)
        lows = np.interp(effector.boundaries_s, effector.time_s, effector.forward_m)
        rows[0].plot(effector.boundaries_s, lows, "kv", ms=4, zorder=4)
        rows[2].axhline(0.0, color=style.GREY, lw=0.6, zorder=1)
        shaded = "" if stride is None else "   grey: the time span of the phase portraits"
        rows[-1].set_xlabel(f"time (s)\n\n{_RULE}{shaded}", fontsize=style.SMALL)
        figure.align_ylabels()
    return figure
