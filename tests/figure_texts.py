"""Find the texts of a figure, and texts or lines that the edges of the figure or its axes cut off."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.text import Text

from recon.show.plots import style


def drawn_texts(figure: Figure) -> Iterator[Text]:
    """Yield the visible texts of a figure; of tick labels, only those within the limits of their axes."""
    hidden: set[Artist] = set()
    for axes in [*figure.axes, *(child for parent in figure.axes for child in parent.child_axes)]:
        for axis in (axes.xaxis, axes.yaxis):
            shown = {*axis._update_ticks()} if axis.get_visible() and axes.axison else set()  # type: ignore[attr-defined]
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if tick not in shown:
                    hidden |= {tick.label1, tick.label2}
            if not axes.axison:
                hidden |= {axis.label, axis.offsetText}
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and text not in hidden:
            yield text


def cut_off(figure: Figure) -> list[str]:
    """Return the texts that reach beyond the edges of a figure as it is saved."""
    with style._settings():
        figure.draw_without_rendering()
        renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
        edge = figure.bbox
        return [
            text.get_text()
            for text in drawn_texts(figure)
            if (box := text.get_window_extent(renderer)).x0 < edge.x0 - 1
            or box.y0 < edge.y0 - 1
            or box.x1 > edge.x1 + 1
            or box.y1 > edge.y1 + 1
        ]


def beyond_axes(figure: Figure) -> list[str]:
    """Return the labels of lines and markers whose data reach beyond their axes and are partly hidden."""
    labels = []
    for axes in figure.axes:
        for line in axes.lines:
            if line.get_transform() != axes.transData or not line.get_visible():
                continue
            xy = np.asarray(line.get_xydata(), dtype=float)
            xy = axes.transAxes.inverted().transform(axes.transData.transform(xy[np.isfinite(xy).all(axis=1)]))
            if len(xy) and (xy.min() < -0.01 or xy.max() > 1.01):
                labels.append(f"{axes.get_title() or axes.get_ylabel()}: {line.get_label()}")
    return labels
