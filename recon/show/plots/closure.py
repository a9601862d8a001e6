"""Degrees of closure of joints' paths, by method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from recon.robotics.ik.drive import Closures
from recon.show.plots.style import COLOURS, GREY, MARKERS, PALE, SMALL, add_legend, drawing, legend_shape

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ROW = 0.7
"""Of a joint's row, all methods together."""


def closures(found: Mapping[str, Closures], names: Sequence[str] | None = None, title: str = "") -> Figure:
    """Closure of each joint's path (percent) by method: of the angle, and in the (angle, rate) plane. names (n,).

    A joint that does not move has no closure and no mark.
    """
    n = next((len(c.angle) for c in found.values()), 0)
    row_mm, legend_mm = max(6.0, 1.5 * len(found)), legend_shape([*found])[1]
    with drawing(row_mm * n + 20 + legend_mm, title=title) as figure:
        if not n:
            return figure
        panels = figure.subplots(1, 2, sharey=True)
        for axes, kind in zip(panels, ("angle", "plane"), strict=True):
            for k, (name, values) in enumerate(found.items()):
                rows = [j + _ROW * ((k + 0.5) / len(found) - 0.5) for j in range(n)]
                axes.plot(
                    getattr(values, kind),
                    rows,
                    linestyle="",
                    marker=MARKERS[k % len(MARKERS)],
                    color=COLOURS[k % len(COLOURS)],
                    mfc=COLOURS[k % len(COLOURS)] if k < len(COLOURS) else "w",
                    ms=4,
                    label=name,
                    clip_on=False,
                )
            for row in range(n):
                if not any(np.isfinite(getattr(values, kind)[row]) for values in found.values()):
                    axes.text(1.5, row, "does not move", va="center", fontsize=SMALL, color=GREY)
            for row in range(1, n):
                axes.axhline(row - 0.5, color=PALE, lw=0.5, zorder=0)
            axes.set_xlim(0, 100)
            axes.grid(axis="x", color=PALE, lw=0.4)
            axes.set_axisbelow(True)
            axes.set_xlabel("of the angle (%)" if kind == "angle" else "in the (angle, rate) plane (%)")
        panels[0].set_yticks(range(n), [f"joint {j + 1}" for j in range(n)] if names is None else names)
        panels[0].set_ylim(n - 0.5, -0.5)
        add_legend(figure, *panels[0].get_legend_handles_labels())
    return figure
