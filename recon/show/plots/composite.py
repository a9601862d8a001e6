"""Side, top and front views of the configurations through a clip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.animal import Side
from recon.base.arrays import Array, Index
from recon.gait.gait import Plane
from recon.show.plots.style import GREY, blank, drawing, time_colours

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

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
            blank(figure.subplots())
        return figure
    from matplotlib.cm import ScalarMappable

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
    from matplotlib.lines import Line2D

    shown = [style for side, style in STYLES.items() if side in sides] if sides != {None} else []
    lines = [Line2D([], [], color="k", lw=lw, linestyle=dashes, label=label) for dashes, lw, label in shown]
    return lines + [Line2D([], [], color=GREY, lw=0.8, label="ground")] * ground
