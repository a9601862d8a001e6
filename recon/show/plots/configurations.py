"""Configurations through a clip, from the side, from above and from ahead: along the run, coloured by time; and in the
animal's own frame, left and right in colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from recon.animal import Body, Side
from recon.animal.chain import UVW_BODY
from recon.base.arrays import Array, Index
from recon.gait.gait import Plane
from recon.geometry.kinematics import ROOT
from recon.show.plots.style import COLOURS, GREY, PAGE_MM, SMALL, WIDTH_MM, drawing, time_colours

CONFIGURATIONS = 10
STILL = 0.1
"""A path shorter than this part of the animal has no direction."""
STYLES: dict[Side | None, tuple[Any, float, str]] = {
    "left": ((0, (2.2, 1.0)), 0.9, "left side"),
    "right": ("-", 0.9, "right side"),
    None: ("-", 1.6, "the rest"),
}
"""Styles of the limbs of each side: dashes, width, and what to call them."""
NO_SIDES: Mapping[str, Side | None] = MappingProxyType({})
_WIDE_MM, _HEIGHT_MM, _FRONT_MM, _LABELS_MM = 160.0, 120.0, 45.0, 36.0
"""The width and height of the side and top view together at most, the front view's height, and room for all names."""


def composites(
    joints_m: Array,
    limbs: Mapping[str, Sequence[int]],
    time_s: Array,
    ground: Sequence[tuple[slice, Plane]] | None = None,
    title: str = "",
    sides: Mapping[str, Side | None] = NO_SIDES,
) -> Figure:
    """Up to `CONFIGURATIONS` configurations, evenly spaced among the known ones, coloured by time.

    joints_m (T, J, 3): metres, upright, z up; time_s (T,). limbs: joints along each, by name; sides: of the limbs,
    those on the left are dashed, and those without a side thick. ground: planes with the rows that they lie under. The
    mean motion is turned to run to the right; places count from the mean of the first configuration, heights are as
    given. The front view looks back at the animal and has its own scale.
    """
    rows = chosen(joints_m, limbs)
    if not len(rows):
        with drawing(40, title=title) as figure:
            return figure
    R, origin = run_frame(joints_m, rows)
    points = (joints_m[rows] - origin) @ R.T
    x, y, z = np.nanmax(points, axis=(0, 1)) - np.nanmin(points, axis=(0, 1)) + 0.1
    scale = min(_WIDE_MM / x, _HEIGHT_MM / (y + z))
    heights = [max(scale * z, 16.0), max(scale * y, 12.0), _FRONT_MM]
    with drawing(sum(heights) + _LABELS_MM, title=title) as figure:
        cells = figure.subplot_mosaic([["side", "side"], ["top", "top"], ["front", "key"]], height_ratios=heights)
        views = (cells["side"], 0, 2), (cells["top"], 0, 1), (cells["front"], 1, 2)
        cells["top"].sharex(cells["side"])
        cmap, norm = time_colours(time_s[rows])
        for axes, i, j in views:
            for pose, t in zip(points, time_s[rows], strict=True):
                for limb, joints in limbs.items():
                    dashes, thick, _ = STYLES[sides.get(limb)]
                    style = {"color": cmap(norm(t)), "lw": thick, "linestyle": dashes, "zorder": 2}
                    axes.plot(*pose[list(joints)][:, [i, j]].T, **style)
            axes.set_aspect("equal", adjustable="datalim")
            axes.locator_params(axis="y", nbins=4)
        for part, plane in ground or ():
            inside = np.isin(rows, np.arange(rows.max() + 1)[part])
            if inside.any():
                own = points[inside].reshape(-1, 3)
                low, high = np.nanmin(own, axis=0), np.nanmax(own, axis=0)
                for axes, i in ((cells["side"], 0), (cells["front"], 1)):
                    ends = np.tile([*(low + high)[:2] / 2, 0.0], (2, 1))
                    ends[:, i] = low[i], high[i]
                    axes.plot(ends[:, i], -plane.above(ends @ R + origin), color=GREY, lw=0.8, zorder=1, gid="ground")
        cells["side"].tick_params(labelbottom=False)
        for (axes, *_), across, up in zip(
            views, ("", "along the run (m)", "left (m)"), ("height", "left", "height"), strict=True
        ):
            axes.set_xlabel(across)
            axes.set_ylabel(f"{up} (m)")
        cells["key"].axis("off")
        cells["key"].legend(handles=_handles({sides.get(limb) for limb in limbs}, ground is not None), loc="center")
        bar = figure.colorbar(ScalarMappable(norm, cmap), ax=cells["key"], location="bottom", label="time (s)")
        bar.ax.plot(time_s[rows], np.full(len(rows), 0.5), "k|", ms=5, transform=bar.ax.get_xaxis_transform())
    return figure


def chosen(joints_m: Array, limbs: Mapping[str, Sequence[int]]) -> Index:
    """Rows of the configurations that are drawn, of those with at least half as many known joints as any."""
    drawn = sorted({j for joints in limbs.values() for j in joints})
    known = np.isfinite(joints_m[:, drawn]).all(axis=2).sum(axis=1)
    rows = np.flatnonzero((known > 1) & (2 * known >= known.max(initial=0)))
    count = min(CONFIGURATIONS, len(rows))
    return rows[np.round(np.linspace(0, len(rows) - 1, count)).astype(int)] if count else rows


def run_frame(joints_m: Array, rows: Index) -> tuple[Array, Array]:
    """R (3, 3), which turns the mean motion to +x, and the point (3,) that becomes the origin, at height 0."""
    first, last = joints_m[rows[0]], joints_m[rows[-1]]
    origin = np.append(np.nanmean(first[:, :2], axis=0), 0.0)
    moved = (last - first)[np.isfinite(last - first).all(axis=1), :2]
    velocity = moved.mean(axis=0) if len(moved) else np.zeros(2)
    size = float(np.linalg.norm(np.nanmax(first, axis=0) - np.nanmin(first, axis=0)))
    if np.linalg.norm(velocity) <= STILL * size:
        return np.eye(3), origin
    c, s = velocity / np.linalg.norm(velocity)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), origin


def _handles(sides: set[Side | None], ground: bool) -> list[Line2D]:
    shown = [style for side, style in STYLES.items() if side in sides] if sides != {None} else []
    lines = [Line2D([], [], color="k", lw=lw, linestyle=dashes, label=label) for dashes, lw, label in shown]
    return lines + [Line2D([], [], color=GREY, lw=0.8, label="ground")] * ground


# -- in the animal's own frame ------------------------------------------------------------------------------------

SIDE_COLOURS: Mapping[Side | None, str] = {"left": COLOURS[0], "right": COLOURS[1], None: COLOURS[-1]}
LABELS = ("U, forwards (m)", "V, down (m)", "W, to the left (m)")
_SAYS = "left blue, right orange; pale: first, full colour: last configuration; +: the reference joint"
_PALEST = 0.25
"""The palest share of a side's colour, in the first configuration."""
_ROOM = 0.04


def in_body(body: Body, states: Array, size: Array | float, reference: str) -> Array:
    """Joints (T, J, 3) along U forwards, V down, W to the left of the root segment, relative to the marker `reference`,
    metres, for states (T, D) and sizes."""
    turned = states.copy()
    turned[:, ROOT] = 0.0
    turned[:, 3:6] = 0.0
    points = body.tree.pose(turned, size).points_m
    points = np.where(np.isfinite(states[:, :1, None]), points, np.nan)
    return (points - points[:, [body.markers.index(reference)]]) @ UVW_BODY.T


def body_fixed(
    joints_m: Array,
    limbs: Mapping[str, Sequence[int]],
    time_s: Array,
    sides: Mapping[str, Side | None] = NO_SIDES,
    title: str = "",
) -> Figure:
    """Up to ten configurations on top of each other, from the side, from above and from ahead at one scale, as large as
    the page allows.

    joints_m (T, J, 3): as `in_body` gives them; limbs: joints along each, by name; time_s (T,). The first configuration
    is pale, the last has the full colour of its side.
    """
    rows = chosen(joints_m, limbs)
    if not len(rows):
        with drawing(40.0, title=title) as figure:
            return figure
    shown = joints_m[rows]
    flat = shown[:, sorted({j for along in limbs.values() for j in along})].reshape(-1, 3)
    low, high = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
    room = np.maximum(_ROOM * np.max(high - low), 0.5 * (0.3 * np.max(high - low) - (high - low)))
    box = np.stack([low - room, high + room], axis=1)
    u, v, w = np.ptp(box, axis=1)
    mm_per_m = min((WIDTH_MM - _LABELS_MM) / (u + w), (PAGE_MM - _LABELS_MM) / (v + w))
    with drawing(mm_per_m * (v + w) + _LABELS_MM, title=title) as figure:
        (side, front), (top, empty) = figure.subplots(2, 2, width_ratios=(u, w), height_ratios=(v, w))
        empty.remove()
        for axes, name, i, j in ((side, "UV, side", 0, 1), (front, "WV, front", 2, 1), (top, "UW, top", 0, 2)):
            for limb, along in limbs.items():
                _draw(axes, shown[:, list(along)][..., [i, j]], sides.get(limb))
            axes.plot(0, 0, "+", color=GREY, ms=7, zorder=0, gid="reference")
            axes.set_title(name, loc="left", fontsize=SMALL, color=GREY, pad=2)
            axes.set(xlim=box[i], ylim=box[j][:: -1 if j == 1 else 1], aspect="equal")  # V is down
            axes.set(xlabel=LABELS[i], ylabel=LABELS[j])
        says = f"{_SAYS}; {time_s[rows[0]]:.2f} to {time_s[rows[-1]]:.2f} s"
        figure.supxlabel(says, fontsize=SMALL, color=GREY)
    return figure


def _draw(axes: Axes, paths_m: Array, side: Side | None) -> None:
    """paths_m (N, n, 2), the first the palest."""
    share = np.linspace(_PALEST if len(paths_m) > 1 else 1.0, 1.0, len(paths_m))[:, None]
    colours = 1.0 - share * (1.0 - np.array(to_rgb(SIDE_COLOURS[side])))
    axes.scatter(*paths_m.reshape(-1, 2).T, s=4.0, c=np.repeat(colours, paths_m.shape[1], axis=0), zorder=2)
    lines = LineCollection(list(paths_m), colors=colours, lw=1.2, capstyle="round", zorder=2)
    axes.add_collection(lines, autolim=False)
