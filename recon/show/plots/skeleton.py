"""A skeleton in its expected pose from three sides, and how far each of its angles goes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from recon.animal import Body, both_sides, other_side, side_of
from recon.base.arrays import Array, Bools
from recon.show.plots.style import COLOURS, GREY, PALE, SMALL, WIDTH_MM, drawing, grid_shape

VIEWS = {"side": [0, 2], "top": [0, 1], "front": [1, 2]}
"""Coordinates to the right and upwards, x forwards, y left, z up: the animal faces right, and in the last view us."""
_SIDE_COLOURS = {"left": COLOURS[0], "right": COLOURS[1], None: "#333333"}
_NAME_MM = 3.4
_SAME = 0.01
"""Points nearer to each other than this part of the picture share a name."""


def views(body: Body, title: str = "") -> Figure:
    """The expected pose from the side, from above and from ahead, with names in columns beside it."""
    points = body.expected_points_m()
    long = np.ptp(points[:, 0])
    labels = {view: _labels(points[:, axes], body.markers) for view, axes in VIEWS.items()}
    heights = [
        max(0.42 * WIDTH_MM * np.ptp(points[:, axes[1]]) / long + 8, _NAME_MM * (len(labels[view]) + 1) / 2 + 6, 30.0)
        for view, axes in VIEWS.items()
    ]
    with drawing(sum(heights) + 12, title=title) as figure:
        panels = figure.subplots(len(VIEWS), 1, height_ratios=heights)
        for axes, (view, coordinates) in zip(panels, VIEWS.items(), strict=True):
            _draw_limbs(axes, body, points[:, coordinates])
            for point, marker in zip(points[:, coordinates], body.markers, strict=True):
                axes.plot(*point, ".", color=_SIDE_COLOURS[body.side_of(marker)], markersize=4)
            _name(axes, points[:, coordinates], labels[view], long)
            _scale(axes, points[:, coordinates], long)
            _frame(axes)
            axes.set_title(view, loc="left")
    return figure


def angle_ranges(body: Body, reach_sigmas: float, title: str = "") -> Figure:
    """What each angle does so many standard deviations to either side of its mean, all others at their means. Where a
    left angle has a right counterpart, the left one stands for both."""
    names = body.state_names[4:]
    shown = [i for i, name in enumerate(names) if not (side_of(name) == "right" and other_side(name) in names)]
    mean = body.expected_points_m()
    rows, columns = grid_shape(len(shown), WIDTH_MM, 0.9, least=4)
    with drawing(rows * 38 + 14, title=title) as figure:
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, i in zip(panels, shown, strict=False):
            coordinates = VIEWS[{"y": "side", "z": "top", "x": "front"}[body.tree.axes[i + 1]]]
            _draw_limbs(axes, body, mean[:, coordinates], PALE)
            reach_rad = reach_sigmas * body.sigma_rad[i]
            for end, colour in ((-reach_rad, COLOURS[4]), (reach_rad, COLOURS[5])):
                moved = body.expected_points_m(i, end)
                _draw_limbs(axes, body, moved[:, coordinates], colour, (moved != mean).any(axis=1))
            low, high = np.degrees(body.mean_rad[i] + np.array([-reach_rad, reach_rad]))
            axes.set_title(f"{names[i].replace('_', ' ')}\n{low:.0f}° to {high:.0f}°", fontsize=SMALL)
        for axes in panels:
            _frame(axes)
    return figure


def _draw_limbs(axes: Axes, body: Body, points: Array, colour: str | None = None, only: Bools | None = None) -> None:
    """Lines along the limbs; only: those that end in a marker that is in it."""
    sides = body.limb_sides()
    for limb, along in body.limb_rows.items():
        parts = [
            [points[a], points[b], [np.nan, np.nan]] for a, b in pairwise(along) if only is None or only[[a, b]].any()
        ]
        own = colour or _SIDE_COLOURS[sides[limb]]
        axes.plot(*np.reshape(parts, (-1, 2)).T, color=own, linewidth=1.2, solid_capstyle="round")


def _labels(points: Array, markers: Sequence[str]) -> list[tuple[float, float, str]]:
    """(right, up, text) of every place with markers, from the left; a pair that is seen as one is named once."""
    near = _SAME * float(np.ptp(points, axis=0).max())
    places: dict[int, list[str]] = {}
    for i, marker in enumerate(markers):
        same = next((k for k in places if np.linalg.norm(points[k] - points[i]) < near), i)
        places.setdefault(same, []).append(marker)
    found = []
    for k, names in places.items():
        said = dict.fromkeys(both_sides(name) if other_side(name) in names else name for name in names)
        found.append((*points[k].tolist(), ", ".join(said)))
    return sorted(found)


def _name(axes: Axes, points: Array, labels: Sequence[tuple[float, float, str]], long: float) -> None:
    """Names in a column on each side, with lines to their points."""
    (low_x, low_y), (high_x, high_y) = points.min(axis=0), points.max(axis=0)
    centre, half = (low_x + high_x) / 2, len(labels) // 2
    for column, sign, align in ((labels[:half], -1, "right"), (labels[half:], 1, "left")):
        x = centre + sign * 0.62 * long
        step = max(_NAME_MM / (0.42 * WIDTH_MM) * long, (high_y - low_y) / max(len(column), 1))
        for i, (at_x, at_y, text) in enumerate(sorted(column, key=lambda label: label[1])):
            y = (low_y + high_y) / 2 + step * (i - (len(column) - 1) / 2)
            axes.plot([at_x, x - sign * 0.01 * long], [at_y, y], color=PALE, linewidth=0.4, zorder=0)
            axes.text(x, y, text, ha=align, va="center", fontsize=SMALL)
    axes.set_xlim(centre - 1.15 * long, centre + 1.15 * long)


def _scale(axes: Axes, points: Array, long: float) -> None:
    """A bar of at most a half of the animal's length, below it."""
    length = max(x for x in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if x < 0.5 * long or x == 0.01)
    x, y = float(points[:, 0].min() + points[:, 0].max() - length) / 2, float(points[:, 1].min() - 0.08 * long)
    axes.plot([x, x + length], [y, y], color=GREY, linewidth=2, solid_capstyle="butt")
    axes.text(x + length / 2, y - 0.02 * long, f"{length:g} m", ha="center", va="top", fontsize=SMALL, color=GREY)


def _frame(axes: Axes) -> None:
    axes.set_aspect("equal")
    axes.set_xticks([])  # an axis that is off is laid out with its ticks, for most of the time that a picture takes
    axes.set_yticks([])
    axes.axis("off")
