"""Side, top and front views of the configurations through a clip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.animal import Side
from recon.base.arrays import Array, Index
from recon.gait.gait import Plane
from recon.show.plots.style import GREY, SMALL, WIDTH_MM, blank, drawing, time_colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

Boxes = list[tuple[float, float]]

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
_LEFT_MM, _RIGHT_MM, _TOP_MM, _GAP_MM, _LABELS_MM = 14.0, 4.0, 6.0, 3.0, 10.0
_HEIGHT_MM, _FRONT_MM = 120.0, 45.0
"""Side and top view together, and the front view, at most."""
_LEAST_MM = (0.0, 12.0, 16.0)
"""Side and top view, at least: their axes' names have to fit."""


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
            blank(figure.subplots())
        return figure
    R, origin = run_frame(joints_m, rows)
    points = (joints_m[rows] - origin) @ R.T
    close = _boxes(points)
    x, y, z = (box[1] - box[0] for box in close)
    wide = WIDTH_MM - _LEFT_MM - _RIGHT_MM
    scale = min(wide / x, _HEIGHT_MM / (y + z))
    front = min(_FRONT_MM / z, wide / 2 / y)
    more = [max(0.0, mm / scale - (box[1] - box[0])) / 2 for box, mm in zip(close, _LEAST_MM, strict=True)]
    boxes = [(box[0] - m, box[1] + m) for box, m in zip(close, more, strict=True)]
    tall = [scale * (box[1] - box[0]) for box in boxes]
    height = _TOP_MM + tall[2] + _GAP_MM + tall[1] + 2 * _LABELS_MM + _GAP_MM + front * z
    with drawing(height) as figure:
        figure.set_layout_engine("none")

        def place(left: float, top: float, width: float, tall: float, **options) -> Axes:
            rectangle = left / WIDTH_MM, 1 - (top + tall) / height, width / WIDTH_MM, tall / height
            return figure.add_axes(rectangle, **options)

        side = place(_LEFT_MM, _TOP_MM, tall[0], tall[2])
        above = place(_LEFT_MM, _TOP_MM + tall[2] + _GAP_MM, tall[0], tall[1], sharex=side)
        lowest = height - _LABELS_MM - front * z
        ahead = place(_LEFT_MM, lowest, front * y, front * z)
        views = ((side, 0, 2, boxes, scale), (above, 0, 1, boxes, scale), (ahead, 1, 2, close, front))
        from matplotlib.cm import ScalarMappable
        from matplotlib.ticker import MaxNLocator

        cmap, norm = time_colours(time_s[rows])
        for axes, i, j, limits, mm_per_m in views:
            for pose, t in zip(points, time_s[rows], strict=True):
                for limb, joints in limbs.items():
                    dashes, thick, _ = STYLES[sides.get(limb)]
                    style = {"color": cmap(norm(t)), "lw": thick, "linestyle": dashes, "zorder": 2}
                    axes.plot(*pose[list(joints)][:, [i, j]].T, **style)
            axes.set_xlim(*limits[i])
            axes.set_ylim(*limits[j])
            axes.set_aspect("equal")
            for axis, at, label_mm in ((axes.xaxis, i, 5.0), (axes.yaxis, j, 4.0)):
                span = limits[at][1] - limits[at][0]
                bins = int(np.clip(mm_per_m * span / (label_mm if span > 0.2 else 2 * label_mm), 1, 9))
                axis.set_major_locator(MaxNLocator(bins, steps=[1, 2, 5, 10], min_n_ticks=1))
        for part, plane in ground or ():
            inside = np.isin(rows, np.arange(rows.max() + 1)[part])
            if not inside.any():
                continue
            own = close if inside.all() else _boxes(points[inside])
            for axes, i in ((side, 0), (ahead, 1)):
                ends = np.tile([sum(box) / 2 for box in own], (2, 1))
                ends[:, 2] = 0.0
                ends[:, i] = axes.get_xlim() if inside.all() else own[i]
                axes.plot(ends[:, i], -plane.above(ends @ R + origin), color=GREY, lw=0.8, zorder=1, gid="ground")
        side.tick_params(bottom=False, labelbottom=False)
        side.spines["bottom"].set_visible(False)
        names = (
            ("side", "", "height (m)"),
            ("top", "along the run (m)", "left (m)"),
            ("front", "left (m)", "height (m)"),
        )
        for (axes, *_), (name, across, up) in zip(views, names, strict=True):
            axes.set_title(name, loc="left", pad=2, fontsize=SMALL, color=GREY)
            axes.set_xlabel(across)
            axes.set_ylabel(up)
        figure.suptitle(title, y=1 - 1 / height, va="top")

        # The rest of the lowest row: what the colours and dashes mean.
        left = _LEFT_MM + front * y + 15
        bar = place(left, lowest + 12, WIDTH_MM - _RIGHT_MM - left - 5, 3)
        figure.colorbar(ScalarMappable(norm, cmap), cax=bar, orientation="horizontal", label="time (s)")
        bar.plot(time_s[rows], np.full(len(rows), 0.5), "k|", ms=5, transform=bar.get_xaxis_transform(), clip_on=False)
        corner = left / WIDTH_MM, 1 - (lowest + 26) / height
        handles = _handles({sides.get(limb) for limb in limbs}, ground is not None)
        figure.legend(handles=handles, loc="upper left", ncols=2, bbox_to_anchor=corner)
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
    from matplotlib.lines import Line2D

    shown = [style for side, style in STYLES.items() if side in sides] if sides != {None} else []
    lines = [Line2D([], [], color="k", lw=lw, linestyle=dashes, label=label) for dashes, lw, label in shown]
    return lines + [Line2D([], [], color=GREY, lw=0.8, label="ground")] * ground


def _boxes(points: Array) -> Boxes:
    """Ranges of x, y and z, with a margin and not too narrow."""
    flat = points.reshape(-1, 3)
    low, high = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
    size = float(np.nanmax(np.nanmax(points, axis=1) - np.nanmin(points, axis=1))) or 1.0
    middle, half = (low + high) / 2, np.maximum((high - low) / 2 + 0.05 * size, 0.15 * size)
    return [(float(m - h), float(m + h)) for m, h in zip(middle, half, strict=True)]
