"""A skeleton in its expected pose from three sides, and how far each of its angles goes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from recon.animal import Body, both_sides, other_side, side_of
from recon.base.arrays import Array, Bools
from recon.show.plots.style import COLOURS, GREY, PALE, SMALL, WIDTH_MM, drawing, grid_shape

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


VIEWS = {"side": (0, 2), "top": (0, 1), "front": (1, 2)}
"""Coordinates to the right and upwards, x forwards, y left, z up: the animal faces right, and in the last view us."""
_SIDE_COLOURS = {"left": COLOURS[0], "right": COLOURS[1], None: "#333333"}
_LOW, _HIGH = COLOURS[4], COLOURS[5]
_NAME_MM = 3.4
_SAME = 0.01
"""Points nearer to each other than this part of the picture share a name."""


def views(body: Body, title: str = "") -> Figure:
    """The expected pose from the side, from above and from ahead, with names."""
    points = expected_pose(body)
    labels = {view: _labels(points[:, axes], body.markers) for view, axes in VIEWS.items()}
    across = np.ptp(points[:, [0]])
    heights = []
    for view, axes in VIEWS.items():
        shape = np.ptp(points[:, axes[1]]) / across * 0.42 * WIDTH_MM
        names = max(map(len, _columns(labels[view])))
        heights.append(max(shape + 8, _NAME_MM * names + 6, 30.0))
    with drawing(sum(heights) + 12, title=title) as figure:
        panels = figure.subplots(len(VIEWS), 1, height_ratios=heights)
        for axes, (view, coordinates) in zip(panels, VIEWS.items(), strict=True):
            draw_limbs(axes, body, points[:, coordinates])
            for point, marker in zip(points[:, coordinates], body.markers, strict=True):
                axes.plot(*point, ".", color=_SIDE_COLOURS[body.side_of(marker)], markersize=4)
            _name(axes, points[:, coordinates], labels[view], across)
            _scale(axes, points[:, coordinates], across)
            _frame(axes, view)
    return figure


def angle_ranges(body: Body, low: Sequence[str], high: Sequence[str], reach_rad: Array, title: str = "") -> Figure:
    """What each angle does at both ends of its expected range, all others at their means.

    reach_rad (D - 4,): from the mean to either end, in the order of state[4:]; low, high: texts for the ends. Where a
    left angle has a right counterpart, the left one stands for both.
    """
    names = body.state_names[4:]
    shown = [i for i, name in enumerate(names) if not (side_of(name) == "right" and other_side(name) in names)]
    mean = expected_pose(body)
    rows, columns = grid_shape(len(shown), WIDTH_MM, 0.9, least=4)
    with drawing(rows * 38 + 14, title=title) as figure:
        panels = figure.subplots(rows, columns, squeeze=False).flat
        for axes, i in zip(panels, shown, strict=False):
            view = {"y": "side", "z": "top", "x": "front"}[body.tree.axes[i + 1]]
            coordinates = VIEWS[view]
            draw_limbs(axes, body, mean[:, coordinates], PALE)
            for end, colour in ((-1, _LOW), (1, _HIGH)):
                moved = expected_pose(body, i, end * reach_rad[i])
                draw_limbs(axes, body, moved[:, coordinates], colour, only=np.any(moved != mean, axis=1))
            axes.set_title(f"{names[i].replace('_', ' ')}\n{low[i]} to {high[i]}", fontsize=SMALL)
            _frame(axes, "")
        for axes in figure.axes[len(shown) :]:
            axes.set_visible(False)
    return figure


def expected_pose(body: Body, angle: int | None = None, off_rad: float = 0.0) -> Array:
    """(J, 3): markers with all angles at their means, but for one of state[4:]; the root's origin is zero."""
    state = np.concatenate([np.zeros(4), body.mean_rad])
    if angle is not None:
        state[4 + angle] += off_rad
    return body.tree.pose(state[None]).points_m[0]


def draw_limbs(axes: Axes, body: Body, points: Array, colour: str | None = None, only: Bools | None = None) -> None:
    """Lines along the limbs; only: those that lead to a marker that is in it. One call for each colour: lines are slow
    to lay out."""
    lines: dict[str, list[Array]] = {}
    sides = body.limb_sides()
    for limb, along in body.limb_rows.items():
        own = colour or _SIDE_COLOURS[sides[limb]]
        for a, b in pairwise(along):
            if only is None or only[a] or only[b]:
                lines.setdefault(own, []).append(np.stack([points[a], points[b], [np.nan, np.nan]]))
    for own, parts in lines.items():
        axes.plot(*np.concatenate(parts).T, color=own, linewidth=1.2, solid_capstyle="round")


def _labels(points: Array, markers: Sequence[str]) -> list[tuple[float, float, str]]:
    """(right, up, text) of every place with markers; a pair that is seen as one is named once."""
    near = _SAME * float(np.ptp(points, axis=0).max())
    places: list[tuple[Array, list[str]]] = []
    for point, marker in zip(points, markers, strict=True):
        same = next((names for place, names in places if np.linalg.norm(place - point) < near), None)
        if same is None:
            places.append((point, [marker]))
        else:
            same.append(marker)
    return [(float(x), float(y), ", ".join(_paired(names))) for (x, y), names in places]


def _paired(names: Sequence[str]) -> list[str]:
    """l_paw and r_paw -> l/r_paw."""
    return list(dict.fromkeys(both_sides(name) if other_side(name) in names else name for name in names))


def _columns(labels: Sequence[tuple[float, float, str]]) -> tuple[list, list]:
    """Those that are named on the left and on the right of the picture, from below."""
    order = sorted(labels)
    half = len(order) // 2
    return sorted(order[:half], key=lambda label: label[1]), sorted(order[half:], key=lambda label: label[1])


def _name(axes: Axes, points: Array, labels: Sequence[tuple[float, float, str]], across: float) -> None:
    """Names in a column on each side, with lines to their points."""
    (low_x, low_y), (high_x, high_y) = points.min(axis=0), points.max(axis=0)
    centre = (low_x + high_x) / 2
    for column, sign, align in zip(_columns(labels), (-1, 1), ("right", "left"), strict=True):
        x = centre + sign * 0.62 * across
        step = max(_NAME_MM / (0.42 * WIDTH_MM) * across, (high_y - low_y) / max(len(column), 1))
        first = (low_y + high_y) / 2 - step * (len(column) - 1) / 2
        for i, (at_x, at_y, text) in enumerate(column):
            y = first + i * step
            axes.plot([at_x, x - sign * 0.01 * across], [at_y, y], color=PALE, linewidth=0.4, zorder=0)
            axes.text(x, y, text, ha=align, va="center", fontsize=SMALL)
    axes.set_xlim(centre - 1.15 * across, centre + 1.15 * across)


def _scale(axes: Axes, points: Array, across: float) -> None:
    """A bar of at most a half of the animal's length, below it."""
    length = max(x for x in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0) if x < 0.5 * across or x == 0.01)
    x, y = float(points[:, 0].min() + points[:, 0].max() - length) / 2, float(points[:, 1].min() - 0.08 * across)
    axes.plot([x, x + length], [y, y], color=GREY, linewidth=2, solid_capstyle="butt")
    axes.text(x + length / 2, y - 0.02 * across, f"{length:g} m", ha="center", va="top", fontsize=SMALL, color=GREY)


def _frame(axes: Axes, title: str) -> None:
    axes.set_aspect("equal")
    axes.set_xticks([])  # an axis that is off is laid out with its ticks, for most of the time that a picture takes
    axes.set_yticks([])
    axes.axis("off")
    if title:
        axes.set_title(title, loc="left")
