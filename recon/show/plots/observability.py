"""Which angles the pixels show: the share of each, on the skeleton and over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from recon.animal import Body, side_of
from recon.base.arrays import Array, median
from recon.fit.motion import MEASURED_SHARE
from recon.geometry.kinematics import AXES, Marker, Tree
from recon.show.plots.skeleton import VIEWS, draw_limbs, expected_pose
from recon.show.plots.style import GREY, PAGE_MM, PALE, SMALL, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure, SubFigure

SEEN_ALONG = {"y": ("side", "swing: pitch, theta"), "z": ("top", "spread: yaw, phi"), "x": ("side", "twist: roll")}
"""The view for rotations about each axis, and what they are called."""
_VIEWS_MM, _ROW_MM, _REST_MM = 38.0, 3.3, 34.0


def share_colours() -> ListedColormap:
    """Of shares from 0 to 1: greys below `MEASURED_SHARE`, blues from there on."""
    import matplotlib as mpl
    from matplotlib.colors import ListedColormap

    low = round(256 * MEASURED_SHARE)
    greys, blues = mpl.colormaps["Greys"](np.linspace(0.1, 0.45, low)), mpl.colormaps["Blues"](np.linspace(0.5, 1, 256))
    return ListedColormap([*greys, *blues[:: -(-256 // (256 - low))]])


def observability(body: Body, share: Array, time_s: Array, title: str = "") -> Figure:
    """share (T, D - 4): of the precision of the root's pitch and roll and of the joints' angles, what comes from the
    pixels, NaN where unknown; time_s (T,).

    Above, the medians on the skeleton in its expected pose, which faces right, at the joints that turn: the left halves
    of the dots are those of the left side. Below, all of them over time.
    """
    names = body.state_names[4:]
    height = min(_VIEWS_MM + _ROW_MM * len(names) + _REST_MM, PAGE_MM)
    with drawing(height, title=title) as figure:
        medians = np.array([median(of_angle) for of_angle in share.T])
        if np.isnan(medians).all():
            return figure
        colours = share_colours()
        parts = figure.subfigures(2, 1, squeeze=False, height_ratios=(_VIEWS_MM, height - _VIEWS_MM))
        above, below = parts[:, 0]
        for axes, axis in zip(above.subplots(1, 3), SEEN_ALONG, strict=True):
            _on_skeleton(axes, body, medians, axis, colours)
        above.supxlabel("halves of a dot: the left and the right side;  the large one: the root", fontsize=SMALL)
        _over_time(below, names, share, medians, time_s, colours)
    return figure


def _on_skeleton(axes: Axes, body: Body, medians: Array, axis: str, colours: ListedColormap) -> None:
    view, called = SEEN_ALONG[axis]
    coordinates, segments = VIEWS[view], body.tree.segments
    draw_limbs(axes, body, expected_pose(body)[:, coordinates], PALE)
    origins = Tree(segments, tuple(Marker(s.name, s.name) for s in segments))
    places = expected_pose(replace(body, tree=origins))[:, coordinates]
    turning = [
        (segment, place, about)
        for segment, place in zip(segments, places, strict=True)
        for about in AXES[segment.joint]
    ]
    for (segment, place, about), share in zip(turning[1:], medians, strict=True):  # without the root's yaw
        if about == axis:
            halves = {"left": "left", "right": "right", None: "full"}[side_of(segment.name)]
            colour = colours(float(share)) if np.isfinite(share) else "none"
            axes.plot(
                *place,
                "o",
                ms=8 if segment.parent else 12,  # another segment may begin where the root does
                mfc=colour,
                mec=GREY,
                mew=0.5,
                fillstyle=halves,
                mfcalt="none",
                zorder=3,
                clip_on=False,
            )
    axes.set_aspect("equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.axis("off")
    axes.set_title(f"{called}\n({view})", fontsize=SMALL)


def _over_time(
    figure: SubFigure, names: Sequence[str], share: Array, medians: Array, time_s: Array, colours: ListedColormap
) -> None:
    axes = figure.subplots()
    half = 0.5 * float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.5
    extent = (float(time_s[0]) - half, float(time_s[-1]) + half, len(names) - 0.5, -0.5)
    image = axes.imshow(share.T, cmap=colours, vmin=0, vmax=1, aspect="auto", interpolation="nearest", extent=extent)
    for row, middle in enumerate(medians):
        text = f"{middle:.0%}" if np.isfinite(middle) else "–"
        colour = "k" if middle >= MEASURED_SHARE else GREY
        axes.text(1.01, row, text, transform=axes.get_yaxis_transform(), va="center", fontsize=SMALL, color=colour)
    axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    for label, middle in zip(axes.get_yticklabels(), medians, strict=True):
        label.set_color("k" if middle >= MEASURED_SHARE else GREY)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("time (s);  right: median over these frames")
    bar = figure.colorbar(image, ax=axes, location="bottom", aspect=60, pad=0.01, shrink=0.7)
    bar.set_label(
        f"share of the precision that comes from the pixels;  grey: less than {MEASURED_SHARE:g}, mostly expected"
    )
