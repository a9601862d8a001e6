"""Configurations over time in the animal's own frame: side, top and front views, left and right in colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from recon.animal import Body, Side
from recon.animal.chain import UVW_BODY
from recon.base.arrays import Array
from recon.geometry.kinematics import ROOT
from recon.show.plots.composite import NO_SIDES, chosen
from recon.show.plots.style import COLOURS, GREY, MM, PAGE_MM, SMALL, WIDTH_MM, blank, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIDE_COLOURS: Mapping[Side | None, str] = {"left": COLOURS[0], "right": COLOURS[1], None: COLOURS[-1]}
SIDE_NAMES: dict[Side | None, str] = {"left": "left", "right": "right", None: "middle"}
VIEWS = (("UV, side", 0, 1), ("UW, top", 0, 2), ("WV, front", 2, 1))
LABELS = ("U, forwards (m)", "V, down (m)", "W, to the left (m)")
SHORT = ("U (m)", "V (m)", "W (m)")
_SAYS = "U forwards, V down, W to the left of +, the reference joint; pale: first, full colour: last configuration"
_PALEST = 0.25
"""Of a side's colour, in the first configuration."""
_ROOM = 0.04
_MARGIN_MM = 16.0
"""Beside or below a panel, for its axis."""


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
    """Up to ten configurations on top of each other, from the side, from above and from ahead at one scale.

    joints_m (T, J, 3): as `in_body` gives them; limbs: joints along each, by name; time_s (T,). The first configuration
    is pale, the last has the full colour of its side.
    """
    rows = chosen(joints_m, limbs)
    box = _extents(joints_m[rows], limbs)
    u, v, w = np.ptp(box, axis=1).tolist()
    scale = min((WIDTH_MM - 2 * _MARGIN_MM) / (u + w), (PAGE_MM - 90) / (v + w))
    with drawing(scale * (v + w) + 2 * _MARGIN_MM + 6 * bool(title), title=title) as figure:
        if not len(rows):
            return figure
        (side, front), (top, rest) = figure.subplots(2, 2, width_ratios=(u, w), height_ratios=(v, w))
        for axes, (name, i, j) in zip((side, top, front), VIEWS, strict=True):
            for limb, along in limbs.items():
                _draw(axes, joints_m[rows][:, list(along)][..., [i, j]], sides.get(limb))
            _frame(axes, name, (i, j), box)
        _key(rest, {sides.get(limb) for limb in limbs}, time_s[rows])
    return figure


def limbs_apart(
    joints_m: Array,
    limbs: Mapping[str, Sequence[int]],
    time_s: Array,
    sides: Mapping[str, Side | None] = NO_SIDES,
    title: str = "",
) -> Figure:
    """As `body_fixed`, a row for the spine with all else in the middle, and one for each limb of a side."""
    rows = chosen(joints_m, limbs)
    middle = {limb: along for limb, along in limbs.items() if sides.get(limb) is None}
    groups = {"spine" if sides else "all": middle} if middle else {}
    groups |= {limb: {limb: along} for limb, along in limbs.items() if sides.get(limb) is not None}
    boxes = [_extents(joints_m[rows], drawn) for drawn in groups.values()]
    spans = [np.ptp(box, axis=1) for box in boxes]
    most_mm = (PAGE_MM - 8) / max(len(groups), 1) - _MARGIN_MM
    scales = [min((WIDTH_MM - 3 * _MARGIN_MM - 2) / (2 * u + w), most_mm / max(v, w)) for u, v, w in spans]
    tall = [scale * max(v, w) + _MARGIN_MM for scale, (_, v, w) in zip(scales, spans, strict=True)]
    height = sum(tall) + 6.0 + 6.0 * bool(title)
    with drawing(height if len(rows) else 40.0) as figure:
        figure.suptitle(title, y=1 - 1 / height, va="top")
        if not len(rows):
            blank(figure.subplots())
            return figure
        figure.set_layout_engine("none")
        top = 6.0 * bool(title) + 4.0
        for (name, drawn), box, span, scale, row_mm in zip(groups.items(), boxes, spans, scales, tall, strict=True):
            left = _MARGIN_MM - 3.0
            for view, i, j in VIEWS:
                wide, high = scale * span[i], scale * span[j]
                place = left / WIDTH_MM, 1 - (top + high) / height, wide / WIDTH_MM, high / height
                axes = figure.add_axes(place)
                for limb, along in drawn.items():
                    _draw(axes, joints_m[rows][:, list(along)][..., [i, j]], sides.get(limb))
                _frame(axes, f"{name}: {view}" if (i, j) == (0, 1) else view, (i, j), box, SHORT)
                left += wide + _MARGIN_MM
            top += row_mm
        figure.text(0.5, 1 / height, _SAYS, ha="center", va="bottom", fontsize=SMALL, color=GREY)
    return figure


def _draw(axes: Axes, paths_m: Array, side: Side | None) -> None:
    """paths_m (N, n, 2), the first the palest."""
    from matplotlib.collections import LineCollection

    colours = _shades(side, len(paths_m))
    axes.scatter(*paths_m.reshape(-1, 2).T, s=4.0, c=np.repeat(colours, paths_m.shape[1], axis=0), zorder=2)
    axes.add_collection(
        LineCollection(list(paths_m), colors=colours, lw=1.2, capstyle="round", zorder=2), autolim=False
    )


def _shades(side: Side | None, count: int) -> Array:
    """(count, 3)"""
    from matplotlib.colors import to_rgb

    share = np.linspace(_PALEST if count > 1 else 1.0, 1.0, count)[:, None]
    return 1.0 - share * (1.0 - np.array(to_rgb(SIDE_COLOURS[side])))


def _frame(axes: Axes, name: str, at: tuple[int, int], box: Array, labels: Sequence[str] = LABELS) -> None:
    axes.plot(0, 0, "+", color=GREY, ms=7, zorder=0, gid="reference")
    axes.set_title(name, loc="left", fontsize=SMALL, color=GREY, pad=2)
    axes.set_xlim(*box[at[0]])
    low, high = box[at[1]]
    axes.set_ylim((high, low) if at[1] == 1 else (low, high))  # V is down
    axes.set_aspect("equal")
    axes.set_xlabel(labels[at[0]])
    axes.set_ylabel(labels[at[1]])
    from matplotlib.ticker import MaxNLocator

    place, figure = axes.get_position(), axes.get_figure(root=True)
    assert figure is not None
    height_mm = figure.get_size_inches()[1] / MM
    for axis, room in ((axes.xaxis, place.width * WIDTH_MM / 8), (axes.yaxis, place.height * height_mm / 5)):
        axis.set_major_locator(MaxNLocator(int(np.clip(room, 1, 6)), steps=[1, 2, 5, 10], min_n_ticks=1))


def _key(axes: Axes, shown: set[Side | None], time_s: Array) -> None:
    """Colours by side and time."""
    kinds: list[Side | None] = [side for side in SIDE_COLOURS if side in shown]
    axes.imshow(
        np.stack([_shades(side, len(time_s)) for side in kinds]), aspect="auto", interpolation="nearest", origin="lower"
    )
    axes.set_yticks(range(len(kinds)), [SIDE_NAMES[side] for side in kinds])
    ends = sorted({0, len(time_s) - 1})
    axes.set_xticks(ends, [f"{time_s[i]:.2f} s" for i in ends])
    axes.tick_params(length=0)
    axes.set_box_aspect(0.5)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _extents(joints_m: Array, limbs: Mapping[str, Sequence[int]]) -> Array:
    """(3, 2): lowest and highest U, V and W, with some room."""
    flat = joints_m[:, sorted({j for along in limbs.values() for j in along})].reshape(-1, 3)
    flat = flat[np.isfinite(flat).all(axis=1)]
    if not len(flat):
        return np.tile([-1.0, 1.0], (3, 1))
    low, high = flat.min(axis=0), flat.max(axis=0)
    room = np.maximum(_ROOM * np.max(high - low), 0.5 * (0.3 * np.max(high - low) - (high - low)))
    return np.stack([low - room, high + room], axis=1)
