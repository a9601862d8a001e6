"""Draw configurations from the side, from above and from the front.

The figures show a clip along the run, coloured by time; a clip in the animal's own frame; the expected pose of a
skeleton and the ranges of its angles; and the fraction of each angle's precision that comes from the pixels over time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import MappingProxyType
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.transforms import ScaledTranslation

from recon.animal.body import Body, Side, other_side, side_of
from recon.animal.chain import UVW_BODY
from recon.animal.naming import both_sides
from recon.base.arrays import Array, Bools, Index, median
from recon.base.numbers import percent, quantity
from recon.fit.motion import MEASURED_FRACTION
from recon.gait.stances import Plane
from recon.geometry.kinematics import ROOT
from recon.show.plots import style

CONFIGURATIONS = 10
MIN_PATH = 0.1
"""Shortest path that defines a direction, relative to the animal's length."""
STYLES: dict[Side | None, tuple[Any, float, str]] = {
    "left": ((0, (2.2, 1.0)), 0.9, "left side"),
    "right": ("-", 0.9, "right side"),
    None: ("-", 1.6, "the rest"),
}
"""Dashes, line width in points, and label of the limbs on each side."""
_AXIS_FACTOR = 1.1
"""Length of the axis along the run relative to the length of the poses."""
NO_SIDES: Mapping[str, Side | None] = MappingProxyType({})
_WIDE_MM = 160.0
"""Largest width in mm of the side view and of the top view."""
_HEIGHT_MM = 120.0
"""Largest height in mm of the side and top views together."""
_MIN_MM = 18.0
"""Smallest height in mm of the side view."""
_FRONT_MM = 45.0
"""Largest height of the front view in mm, unless the side view is lower."""
_LABELS_MM = 46.0
"""Space in mm for all labels and the colour bar."""
_NUMBERS_MM = 10.0
"""Width in mm of the numbers at a vertical axis."""
_WIDE_FRONT = 0.3
"""Fraction of the figure's width that the front view takes."""


def composites(
    joints_m: Array,
    limbs: Mapping[str, Sequence[int]],
    time_s: Array,
    ground: Sequence[tuple[slice, Plane]] | None = None,
    title: str = "",
    sides: Mapping[str, Side | None] = NO_SIDES,
) -> Figure:
    """Draw up to `CONFIGURATIONS` configurations, evenly spaced among the known poses, coloured by time.

    The animal's mean motion is to the right. Positions are relative to the mean of the first configuration, except
    heights. The front view shows the animal from ahead, at its own scale.

    Parameters
    ----------
    joints_m : ndarray
        Positions of the joints in metres with z up, shape (T, J, 3).
    limbs : mapping
        Joints along each limb, keyed by the limb's name.
    time_s : ndarray
        Times of the frames in seconds, shape (T,).
    ground : sequence, optional
        Planes of the ground, each with the slice of the clip's frames for which the plane holds.
    title : str
        Title of the figure, or an empty string for none.
    sides : mapping
        Side of each limb, keyed by the limb's name. Left limbs are dashed, and limbs without a side are thick.
    """
    rows = chosen(joints_m, limbs)
    if not len(rows):
        with style.drawing(40, title=title) as figure:
            return figure
    R, origin = run_frame(joints_m, rows)
    points = (joints_m[rows] - origin) @ R.T
    width_m, depth_m, z = np.nanmax(points, axis=(0, 1)) - np.nanmin(points, axis=(0, 1)) + 0.1
    scale = min(_WIDE_MM / width_m, _HEIGHT_MM / (depth_m + z))
    side_mm = max(scale * z, _MIN_MM)
    heights = [side_mm, max(scale * depth_m, 12.0), min(side_mm, _FRONT_MM)]
    with style.drawing(sum(heights) + _LABELS_MM, title=title) as figure:
        layout = {"height_ratios": heights, "width_ratios": [_WIDE_FRONT, 1 - _WIDE_FRONT]}
        cells = figure.subplot_mosaic([["side", "side"], ["top", "top"], ["front", "key"]], **layout)
        panels = (cells["side"], 0, 2), (cells["top"], 0, 1), (cells["front"], 1, 2)
        cells["top"].sharex(cells["side"])
        cmap, norm = style.time_colours(time_s[rows])
        colours = [cmap(norm(instant_s)) for instant_s in time_s[rows]]
        for axes, horizontal, vertical in panels:
            for pose, colour in zip(points[..., [horizontal, vertical]], colours, strict=True):
                _draw_pose(axes, pose, limbs, colour, sides)
            axes.set_aspect("equal", adjustable="datalim")
            axes.locator_params(axis="y", nbins=2 if axes is cells["top"] else 4)
        # The scale follows the shared axis, which must be long enough for the height. Otherwise poses would be cut.
        middle_m = (np.nanmin(points, axis=(0, 1)) + np.nanmax(points, axis=(0, 1))) / 2
        half_m = _AXIS_FACTOR / 2 * _WIDE_MM / scale
        cells["side"].set_xlim(middle_m[0] - half_m, middle_m[0] + half_m)
        for part, plane in ground or ():
            inside = np.isin(rows, np.arange(rows.max() + 1)[part])
            if inside.any():
                _draw_ground(cells, points[inside].reshape(-1, 3), R, origin, plane)
        cells["side"].tick_params(labelbottom=False)
        labels = ("", "height"), ("along the run", "left"), ("left", "height")
        for (axes, *_), (across, upwards) in zip(panels, labels, strict=True):
            _label_axes(figure, axes, across, upwards)
        cells["key"].axis("off")
        handles = _handles({sides.get(limb) for limb in limbs}, ground is not None)
        cells["key"].legend(handles=handles, loc="center", ncols=2)
        bar = figure.colorbar(
            ScalarMappable(norm, cmap),
            ax=[*cells.values()],
            location="bottom",
            label="time (s)",
            fraction=0.04,
            aspect=60,
        )
        bar.ax.plot(time_s[rows], np.full(len(rows), 0.5), "k|", ms=5, transform=bar.ax.get_xaxis_transform())
    return figure


def _draw_ground(cells: Mapping[str, Axes], points_m: Array, R: Array, origin_m: Array, plane: Plane) -> None:
    """Draw the ground plane under points (N, 3) into the side and the front view.

    R (3, 3) and `origin_m` (3,) define the frame of the run, as `run_frame` returns them.
    """
    for axes, horizontal in ((cells["side"], 0), (cells["front"], 1)):
        ends = _ends_of_ground(points_m, horizontal)
        height_m = -plane.above(ends @ R + origin_m)
        axes.plot(ends[:, horizontal], height_m, color=style.GREY, lw=0.8, zorder=1, gid="ground")


def _label_axes(figure: Figure, axes: Axes, across: str, upwards: str) -> None:
    """Label the axes of a view in metres, without a label on the horizontal axis if `across` is empty."""
    axes.set_xlabel(across and f"{across} (m)")
    axes.set_ylabel(f"{upwards} (m)")
    # The distance of the label is fixed, because equal scales change the axis numbers after the layout.
    to_the_left = ScaledTranslation(-_NUMBERS_MM * style.MM, 0.0, figure.dpi_scale_trans)
    axes.yaxis.set_label_coords(0.0, 0.5, axes.transAxes + to_the_left)


def _draw_pose(
    axes: Axes, pose: Array, limbs: Mapping[str, Sequence[int]], colour: Any, sides: Mapping[str, Side | None]
) -> None:
    """Draw the limbs of a pose (J, 2)."""
    for limb, joints in limbs.items():
        dashes, line_width, _ = STYLES[sides.get(limb)]
        axes.plot(*pose[list(joints)].T, color=colour, lw=line_width, linestyle=dashes, zorder=2)


def _ends_of_ground(points_m: Array, horizontal: int) -> Array:
    """Return the ends (2, 3) of a line below points (N, 3), along one axis and centred along the other."""
    low_m, high_m = np.nanmin(points_m, axis=0), np.nanmax(points_m, axis=0)
    ends = np.tile([*(low_m + high_m)[:2] / 2, 0.0], (2, 1))
    ends[:, horizontal] = low_m[horizontal], high_m[horizontal]
    return ends


def chosen(joints_m: Array, limbs: Mapping[str, Sequence[int]]) -> Index:
    """Return the rows of evenly spaced poses to draw, without poses that have few known joints.

    A pose needs at least two known joints, and half as many as the pose with the most.
    """
    drawn_joints = sorted({j for joints in limbs.values() for j in joints})
    known_counts = np.isfinite(joints_m[:, drawn_joints]).all(axis=2).sum(axis=1)
    rows = np.flatnonzero((known_counts > 1) & (2 * known_counts >= known_counts.max(initial=0)))
    count = min(CONFIGURATIONS, len(rows))
    return rows[np.round(np.linspace(0, len(rows) - 1, count)).astype(int)] if count else rows


def run_frame(joints_m: Array, rows: Index) -> tuple[Array, Array]:
    """Return the rotation (3, 3) that turns the mean motion to +x, and the origin (3,), a point at height 0."""
    first, last = joints_m[rows[0]], joints_m[rows[-1]]
    origin = np.append(np.nanmean(first[:, :2], axis=0), 0.0)
    moved_m = (last - first)[np.isfinite(last - first).all(axis=1), :2]
    velocity = moved_m.mean(axis=0) if len(moved_m) else np.zeros(2)
    size = float(np.linalg.norm(np.nanmax(first, axis=0) - np.nanmin(first, axis=0)))
    if np.linalg.norm(velocity) <= MIN_PATH * size:
        return np.eye(3), origin
    c, s = velocity / np.linalg.norm(velocity)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]), origin


def _handles(sides: set[Side | None], ground: bool) -> list[Line2D]:
    visible = [look for side, look in STYLES.items() if side in sides] if sides != {None} else []
    lines = [Line2D([], [], color="k", lw=lw, linestyle=dashes, label=label) for dashes, lw, label in visible]
    return lines + [Line2D([], [], color=style.GREY, lw=0.8, label="ground")] * ground


LABELS = ("U, forwards (m)", "V, down (m)", "W, to the left (m)")
_COLOUR_KEY = "left blue, right orange; pale: first configuration, full colour: last"
_REFERENCE_KEY = "; +: the reference joint"
"""Text added to the legend if the reference joint is marked."""
_MIN_COLOUR = 0.25
"""Fraction of a side's colour in the first, palest configuration."""
_ROOM = 0.04


def in_body(body: Body, states: Array, size: Array | float, reference: str) -> Array:
    """Return the joints (T, J, 3) relative to the marker `reference`, in metres along the axes of the root segment.

    The axes are U forwards, V down and W to the left. `states` are the states of the body, shape (T, D).
    """
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
    """Draw up to ten configurations in the animal's own frame, from the side, from above and from the front.

    `joints_m` (T, J, 3) is the result of `in_body`, `limbs` has the joints along each limb by name, and `time_s` (T,)
    has the times in seconds. The first configuration is pale, and the last has the full colour of each side.
    """
    rows = chosen(joints_m, limbs)
    if not len(rows):
        with style.drawing(40.0, title=title) as figure:
            return figure
    shown = joints_m[rows]
    flat = shown[:, sorted({j for along in limbs.values() for j in along})].reshape(-1, 3)
    low, high = np.nanmin(flat, axis=0), np.nanmax(flat, axis=0)
    room = np.maximum(_ROOM * np.max(high - low), 0.5 * (0.3 * np.max(high - low) - (high - low)))
    box = np.stack([low - room, high + room], axis=1)
    has_reference = bool(((box[:, 0] < 0) & (box[:, 1] > 0)).all())
    u, v, w = np.ptp(box, axis=1)
    mm_per_m = min((style.WIDTH_MM - _LABELS_MM) / (u + w), (style.PAGE_MM - _LABELS_MM) / (v + w))
    with style.drawing(mm_per_m * (v + w) + _LABELS_MM, title=title) as figure:
        (side, front), (top, empty) = figure.subplots(2, 2, width_ratios=(u, w), height_ratios=(v, w))
        empty.remove()
        for axes, name, i, j in ((side, "UV, side", 0, 1), (front, "WV, front", 2, 1), (top, "UW, top", 0, 2)):
            for limb, along in limbs.items():
                _draw(axes, shown[:, list(along)][..., [i, j]], sides.get(limb))
            if has_reference:
                axes.plot(0, 0, "+", color=style.GREY, ms=7, zorder=0, gid="reference")
            axes.set_title(name, loc="left", fontsize=style.SMALL, color=style.GREY, pad=2)
            axes.set(xlim=box[i], ylim=box[j][:: -1 if j == 1 else 1], aspect="equal")  # V is down
            axes.set(xlabel=LABELS[i], ylabel=LABELS[j])
        key = _COLOUR_KEY + _REFERENCE_KEY if has_reference else _COLOUR_KEY
        text = f"{key}; {time_s[rows[0]]:.2f} to {quantity(float(time_s[rows[-1]]), 2, 's')}"
        figure.supxlabel(text, fontsize=style.SMALL, color=style.GREY)
    return figure


def _draw(axes: Axes, paths_m: Array, side: Side | None) -> None:
    """Draw N paths of n points, `paths_m` (N, n, 2), from the palest colour to the full colour."""
    fraction = np.linspace(_MIN_COLOUR if len(paths_m) > 1 else 1.0, 1.0, len(paths_m))[:, None]
    colours = 1.0 - fraction * (1.0 - np.array(to_rgb(style.SIDE_COLOURS[side])))
    axes.scatter(*paths_m.reshape(-1, 2).T, s=4.0, c=np.repeat(colours, paths_m.shape[1], axis=0), zorder=2)
    lines = LineCollection(list(paths_m), colors=colours, lw=1.2, capstyle="round", zorder=2)
    axes.add_collection(lines, autolim=False)


VIEWS = {"side": [0, 2], "top": [0, 1], "front": [1, 2]}
"""Indices of the coordinates to the right and upwards in each view, with x forwards, y left, z up.

The animal faces right in the side and top views, and faces the reader in the front view.
"""
_NAME_MM = 3.4
"""Height in mm of a marker's name in a figure."""
_LONG_MM = 0.42 * style.WIDTH_MM
"""Length in mm of the animal in a figure."""
_SAME_LABEL_DISTANCE = 0.01
"""Distance between markers, as a fraction of the animal's extent in a view, below which they share a label."""


def views(body: Body, title: str = "") -> Figure:
    """Draw a skeleton's expected pose from the side, from above and from the front, with its markers' names."""
    points = body.expected_points_m()
    length_m = np.ptp(points[:, 0])
    labels = {view: _labels(points[:, axes], body.markers) for view, axes in VIEWS.items()}
    names_mm = [_NAME_MM * (len(names) + 1) / 2 + 6 for names in labels.values()]
    pose_mm = [_LONG_MM * np.ptp(points[:, axes[1]]) / length_m + 8 for axes in VIEWS.values()]
    heights = np.maximum(np.maximum(names_mm, pose_mm), 30.0).tolist()
    with style.drawing(sum(heights) + 12, title=title) as figure:
        panels = figure.subplots(len(VIEWS), 1, height_ratios=heights)
        for axes, (view, coordinates) in zip(panels, VIEWS.items(), strict=True):
            _draw_limbs(axes, body, points[:, coordinates])
            for point, marker in zip(points[:, coordinates], body.markers, strict=True):
                axes.plot(*point, ".", color=style.SIDE_COLOURS[body.side_of(marker)], markersize=4)
            _name(axes, points[:, coordinates], labels[view], length_m)
            _scale(axes, points[:, coordinates], length_m)
            _frame(axes)
            axes.set_title(view, loc="left")
    return figure


def angle_ranges(body: Body, reach_sigmas: float, title: str) -> Figure:
    """Draw a skeleton for each angle, with the angle `reach_sigmas` standard deviations to either side of its mean.

    All other angles have their mean values. The figure of a left angle also stands for the right angle.
    """
    names = body.state_names[4:]
    shown_angles = [i for i, name in enumerate(names) if not (side_of(name) == "right" and other_side(name) in names)]
    mean = body.expected_points_m()
    rows, columns = style.grid_shape(len(shown_angles), style.WIDTH_MM, 0.9, least=4)
    with style.drawing(rows * 38 + 14, title=title) as figure:
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, i in zip(panels, shown_angles, strict=False):
            coordinates = VIEWS[{"y": "side", "z": "top", "x": "front"}[body.tree.axes[i + 1]]]
            _draw_limbs(axes, body, mean[:, coordinates], style.PALE)
            reach_rad = reach_sigmas * body.sigma_rad[i]
            for end, colour in ((-reach_rad, style.COLOURS[4]), (reach_rad, style.COLOURS[5])):
                moved_m = body.expected_points_m(i, end)
                _draw_limbs(axes, body, moved_m[:, coordinates], colour, (moved_m != mean).any(axis=1))
            low, high = np.degrees(body.mean_rad[i] + np.array([-reach_rad, reach_rad]))
            axes.set_title(
                f"{names[i].replace('_', ' ')}\n{quantity(low, 0, '°')} to {quantity(high, 0, '°')}",
                fontsize=style.SMALL,
            )
        for axes in panels:
            _frame(axes)
    return figure


def _draw_limbs(axes: Axes, body: Body, points: Array, colour: str | None = None, shown: Bools | None = None) -> None:
    """Draw lines along the limbs; only lines that begin or end at a marker in the mask `shown`, if it is given."""
    sides = body.limb_sides()
    for limb, along in body.limb_rows.items():
        pieces = [
            [points[a], points[b], [np.nan, np.nan]] for a, b in pairwise(along) if shown is None or shown[[a, b]].any()
        ]
        line_colour = colour or style.SIDE_COLOURS[sides[limb]]
        axes.plot(*np.reshape(pieces, (-1, 2)).T, color=line_colour, linewidth=1.2, solid_capstyle="round")


def _labels(points: Array, markers: Sequence[str]) -> list[tuple[float, float, str]]:
    """Return x, y and text of each label from left to right, with one label for markers at the same position."""
    tolerance = _SAME_LABEL_DISTANCE * float(np.ptp(points, axis=0).max())
    positions: dict[int, list[str]] = {}
    for i, marker in enumerate(markers):
        first_index = next((k for k in positions if np.linalg.norm(points[k] - points[i]) < tolerance), i)
        positions.setdefault(first_index, []).append(marker)
    labels = []
    for k, names in positions.items():
        unique_names = dict.fromkeys(both_sides(name) if other_side(name) in names else name for name in names)
        labels.append((*points[k].tolist(), ", ".join(unique_names)))
    return sorted(labels)


def _name(axes: Axes, points: Array, labels: Sequence[tuple[float, float, str]], length_m: float) -> None:
    """Write the markers' names in a column on each side of a pose, with lines to the markers."""
    (low_x, low_y), (high_x, high_y) = points.min(axis=0), points.max(axis=0)
    centre, half = (low_x + high_x) / 2, len(labels) // 2
    for column, sign, align in ((labels[:half], -1, "right"), (labels[half:], 1, "left")):
        x = centre + sign * 0.62 * length_m
        step = max(_NAME_MM / _LONG_MM * length_m, (high_y - low_y) / max(len(column), 1))
        for i, (point_x, point_y, text) in enumerate(sorted(column, key=lambda label: label[1])):
            y = (low_y + high_y) / 2 + step * (i - (len(column) - 1) / 2)
            axes.plot([point_x, x - sign * 0.01 * length_m], [point_y, y], color=style.PALE, linewidth=0.4, zorder=0)
            axes.text(x, y, text, ha=align, va="center", fontsize=style.SMALL)
    axes.set_xlim(centre - 1.15 * length_m, centre + 1.15 * length_m)


def _scale(axes: Axes, points: Array, length_of_animal_m: float) -> None:
    """Draw a scale bar below the animal, at most half as long as the animal."""
    length = style.round_below(0.5 * length_of_animal_m)
    x = float(points[:, 0].min() + points[:, 0].max() - length) / 2
    y = float(points[:, 1].min() - 0.08 * length_of_animal_m)
    axes.plot([x, x + length], [y, y], color=style.GREY, linewidth=2, solid_capstyle="butt")
    text_style = {"ha": "center", "va": "top", "fontsize": style.SMALL, "color": style.GREY}
    axes.text(x + length / 2, y - 0.02 * length_of_animal_m, f"{length:g} m", **text_style)


def _frame(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xticks([])  # ticks of an axis that is off would still be laid out, which is slow
    axes.set_yticks([])
    axes.axis("off")


_ROW_MM, _REST_MM = 3.3, 34.0
SHARES = (
    "fraction of the precision that comes from the pixels;  "
    f"grey: less than {MEASURED_FRACTION:g}, mostly from the prior"
)
"""Label of the colours for this fraction."""


def share_colours() -> ListedColormap:
    """Return colours for the fraction of the precision from the pixels, grey below `MEASURED_FRACTION`, then blue."""
    low = round(256 * MEASURED_FRACTION)
    greys, blues = mpl.colormaps["Greys"](np.linspace(0.1, 0.45, low)), mpl.colormaps["Blues"](np.linspace(0.5, 1, 256))
    return ListedColormap([*greys, *blues[:: -(-256 // (256 - low))]])


def observability(body: Body, share: Array, time_s: Array, title: str = "", whole: Array | None = None) -> Figure:
    """Draw the fraction of the angles' precision that comes from the pixels, over time, with medians.

    `share` (T, D - 4) has the fractions for the root's pitch and roll and for the joints' angles, NaN if unknown.
    `time_s` (T,) has the times in seconds. If the times are a stride, `whole` has the fractions of the whole clip, from
    which the medians are computed.
    """
    names = [name.replace("_", " ") for name in body.state_names[4:]]
    with style.drawing(min(_ROW_MM * len(names) + _REST_MM, style.PAGE_MM), title=title) as figure:
        medians = np.array([median(column) for column in (share if whole is None else whole).T])
        if np.isnan(medians).all():
            return figure
        axes, half = figure.subplots(), 0.5 * float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.5
        extent = (float(time_s[0]) - half, float(time_s[-1]) + half, len(names) - 0.5, -0.5)
        scale = {"vmin": 0, "vmax": 1, "aspect": "auto", "interpolation": "nearest"}
        image = axes.imshow(share.T, cmap=share_colours(), extent=extent, **scale)
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(axis="y", length=0)
        text_style = {"transform": axes.get_yaxis_transform(), "va": "center", "fontsize": style.SMALL}
        for row, (label, middle) in enumerate(zip(axes.get_yticklabels(), medians, strict=True)):
            text = percent(middle) if np.isfinite(middle) else "–"
            colour = "k" if middle >= MEASURED_FRACTION else style.GREY
            axes.text(1.01, row, text, color=colour, **text_style)
            label.set_color(colour)
        axes.set_xlabel(f"time (s);  right: median over {'these frames' if whole is None else 'the whole clip'}")
        bar = figure.colorbar(image, ax=axes, location="bottom", aspect=60, pad=0.01, shrink=0.7)
        bar.set_label(SHARES)
    return figure
