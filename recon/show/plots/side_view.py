"""Draw the animal from the side at evenly spaced times of one stride or of the clip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.typing import LineStyleType

from recon.animal.body import Side
from recon.base.arrays import Array, Bools, Index
from recon.base.numbers import quantity
from recon.gait.stances import Plane
from recon.show.plots import style
from recon.show.plots.configurations import run_frame

POSES = 6
"""Number of poses in a row of a figure as wide as a page."""
NARROW_POSES = 3
"""Number of poses in a row of a figure as wide as a column."""
_POSE_SPACING = 1.1
"""Distance between the poses in a row, relative to the length of the longest pose."""
_WIDTHS: Mapping[Side | None, float] = {"left": 1.0, "right": 1.0, None: 1.4}


def side_view(
    joints_m: Array,
    limbs: Mapping[str, Sequence[int]],
    sides: Mapping[str, Side | None],
    during: Bools,
    time_s: Array,
    grounds: Sequence[tuple[slice, Plane]] | None = None,
    of_stride: bool = True,
) -> Figure:
    """Draw `POSES` evenly spaced configurations side by side, with the animal running to the right.

    Parameters
    ----------
    joints_m : ndarray
        Positions of the joints in metres with z up, shape (T, J, 3).
    limbs, sides : mapping
        Joints and side of each limb, keyed by the limb's name. Left limbs are blue and dashed, right limbs orange, and
        others black.
    during : ndarray
        Mask (T,) of the frames of the stride, or of the whole clip if it has no stride.
    time_s : ndarray
        Times of the frames in seconds, shape (T,).
    grounds : sequence, optional
        Planes of the ground, each with the slice of the clip's frames for which the plane holds. Without a plane, a
        line touches the lowest foot.
    of_stride : bool
        Whether `during` is a stride. Poses are then labelled with the percent of the stride, otherwise with times in
        seconds.
    """
    drawn = sorted({joint for joints in limbs.values() for joint in joints})
    known = during & (np.isfinite(joints_m[:, drawn]).all(axis=2).mean(axis=1) >= 0.5)
    rows = np.flatnonzero(known)
    if len(rows) < 2:
        with style.drawing(40) as figure:
            return figure
    width_mm = style.page_width_mm()
    per_line = POSES if width_mm > style.NARROW_MM else NARROW_POSES
    start_s, end_s = time_s[rows[0]], time_s[rows[-1]]
    wanted_s = start_s + np.arange(POSES) / POSES * (end_s - start_s)
    chosen = rows[[int(np.argmin(np.abs(time_s[rows] - at_s))) for at_s in wanted_s]]
    R, origin = run_frame(joints_m, rows)
    poses = (joints_m[chosen] - origin) @ R.T
    low_x, high_x = np.nanmin(poses[:, drawn, 0], axis=1), np.nanmax(poses[:, drawn, 0], axis=1)
    step_m = _POSE_SPACING * float((high_x - low_x).max())
    ground_m = _ground_m(joints_m, poses, chosen, drawn, grounds)
    tall_m = float(np.nanmax(poses[:, drawn, 2] - ground_m[:, None]))
    lines = -(-POSES // per_line)
    panel_mm = (width_mm - 4) / per_line * tall_m / step_m + 9
    with style.drawing(lines * panel_mm + 8) as figure:
        panels = figure.subplots(lines, 1, squeeze=False)[:, 0]
        for line, axes in enumerate(panels):
            for column in range(per_line):
                i = line * per_line + column
                shift = np.array([column * step_m - 0.5 * (low_x[i] + high_x[i]), -ground_m[i]])
                _draw_pose(axes, poses[i][:, [0, 2]] + shift, limbs, sides)
                text = f"{100 * i / POSES:.0f} %" if of_stride else quantity(float(time_s[chosen[i]]), 2, "s")
                axes.text(column * step_m, -0.06 * tall_m, text, ha="center", va="top", fontsize=style.SMALL)
            axes.axhline(0, color=style.GREY, lw=0.8, zorder=1)
            axes.set_xlim(-0.5 * step_m, (per_line - 0.5) * step_m)
            axes.set_ylim(-0.4 * tall_m, 1.05 * tall_m)
            axes.set_aspect("equal")
            axes.axis("off")
        _scale_bar(panels[-1], step_m, per_line, tall_m)
        _add_sides(figure, {sides.get(limb) for limb in limbs})
    return figure


def _draw_pose(axes: Axes, points: Array, limbs: Mapping[str, Sequence[int]], sides: Mapping[str, Side | None]) -> None:
    """Draw the limbs of one pose from its joints (J, 2)."""
    for limb, joints in limbs.items():
        side = sides.get(limb)
        look = {"color": style.SIDE_COLOURS[side], "lw": _WIDTHS[side], "zorder": 2 if side == "left" else 3}
        axes.plot(*points[list(joints)].T, linestyle=_dashes(side), **look)


def _add_sides(figure: Figure, present: set[Side | None]) -> None:
    """Add a legend of the sides of the limbs that are present."""
    names: dict[Side | None, str] = {"left": "left", "right": "right", None: "trunk, head and tail"}
    handles = [
        Line2D([], [], color=style.SIDE_COLOURS[side], lw=_WIDTHS[side], label=label, linestyle=_dashes(side))
        for side, label in names.items()
        if side in present
    ]
    style.add_legend(figure, handles, [str(handle.get_label()) for handle in handles])


def _dashes(side: Side | None) -> LineStyleType:
    return (0, (3, 1)) if side == "left" else "-"


def _ground_m(
    joints_m: Array,
    poses: Array,
    chosen: Index,
    drawn: Sequence[int],
    grounds: Sequence[tuple[slice, Plane]] | None,
) -> Array:
    """Return the height of the ground under each of N poses in metres, shape (N,)."""
    heights = np.nanmin(poses[:, drawn, 2], axis=1)
    lowest = heights.copy()
    for i, row in enumerate(chosen):
        for part, plane in grounds or ():
            first, stop, _ = part.indices(len(joints_m))
            if first <= row < stop:
                below = np.append(np.nanmean(joints_m[row, :, :2], axis=0), 0.0)
                heights[i] = -float(plane.above(below[None])[0])
    # The ground must not be above a foot, which may be below the plane because of noise or in a part without a plane.
    return np.minimum(heights, lowest + 0.02)


def _scale_bar(axes: Axes, step_m: float, per_line: int, tall_m: float) -> None:
    """Draw a scale bar of a round length, in metres, at the lower right of a row of poses.

    The row has `per_line` poses, `step_m` apart, and the tallest pose is `tall_m` high.
    """
    length_m = style.round_below(0.35 * step_m)
    end = (per_line - 0.5) * step_m - 0.02 * step_m
    y = -0.1 * tall_m
    axes.plot([end - length_m, end], [y, y], color="k", lw=1.2, solid_capstyle="butt")
    axes.text(end - 0.5 * length_m, y - 0.04 * tall_m, f"{length_m:g} m", ha="center", va="top", fontsize=style.SMALL)
