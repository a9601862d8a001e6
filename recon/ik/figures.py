"""Figures of motions to a target or along a path, by method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

from recon.base.arrays import Array
from recon.ik.chain import SerialChain
from recon.ik.drive import Run
from recon.show.plots import style

VIEWS = {
    "UVW": (("side", 0, 1, "forwards (m)", "down (m)"), ("top", 0, 2, "forwards (m)", "to the left (m)")),
    "xyz": (("side", 0, 2, "forwards (m)", "up (m)"), ("top", 0, 1, "forwards (m)", "to the left (m)")),
}
"""The views of the base frames of `recon.ik.chain`: name, coordinates, and what the axes are called."""
_ROOM = 0.06


def task_space(
    moves: Mapping[str, Run],
    chain: SerialChain,
    aim_m: Array | None = None,
    base: Literal["UVW", "xyz"] = "UVW",
) -> Figure:
    """Draw the end effector's path of each method, in the plane, or in space from the side and from above.

    The chain is drawn at the start and, for each method, at the end. aim_m: the target (dim,), a cross, or the
    requested path (K, dim). base: the meaning of the coordinates: forwards, down and left, or forwards, left and up;
    two are U and V.
    """
    labels, first = [f"{name}{_outcome(move)}" for name, move in moves.items()], next(iter(moves.values()))
    aims = () if aim_m is None else ("path to follow",) if aim_m.ndim == 2 else ("target",)
    marks, start, first_chain, aim = ("start", "chain at the start", *aims), [], [], []
    with style.drawing(92 + style.legend_shape([*labels, *marks])[1]) as figure:
        views = VIEWS[base][: chain.dim - 1]
        panels = np.ravel(figure.subplots(1, len(views), squeeze=False))
        for axes, (view, i, j, across, upwards) in zip(panels, views, strict=True):
            first_look = {"color": style.GREY, "lw": 2.2, "alpha": 0.5, "marker": "o", "ms": 2, "zorder": 1}
            first_chain = axes.plot(*chain.positions(first.q[0])[:, [i, j]].T, **first_look)
            if aim_m is not None and aim_m.ndim == 2:
                aim = axes.plot(*aim_m[:, [i, j]].T, color=style.PALE, lw=3.5, zorder=1, gid="path")
            elif aim_m is not None:
                aim = axes.plot(*aim_m[[i, j]], "+", color="k", ms=10, mew=1.2, zorder=5, gid="target")
            for k, move in enumerate(moves.values()):
                drawn = style.look(k)
                last = chain.positions(move.q[-1])[:, [i, j]]
                axes.plot(*last.T, **drawn, marker="o", ms=2, lw=0.7, alpha=0.8, zorder=2)
                axes.plot(*move.end_m[:, [i, j]].T, **drawn, zorder=3, label=labels[k])
                axes.plot(*move.end_m[-1, [i, j]], "o", ms=3.5, color=drawn["color"], zorder=4)
            start = axes.plot(*first.end_m[0, [i, j]], "o", mfc="w", mec="k", ms=5, zorder=5)
            axes.set_xlabel(across)
            axes.set_ylabel(upwards)
            axes.set_aspect("equal", adjustable="datalim")
            axes.margins(_ROOM)
            if upwards.startswith("down"):
                axes.invert_yaxis()
            if chain.dim == 3:
                axes.set_title(view, loc="left", fontsize=style.SMALL, color=style.GREY)
        paths, _ = panels[0].get_legend_handles_labels()
        style.add_legend(figure, [*paths, *start, *first_chain, *aim], [*labels, *marks])
    return figure


def joint_space(moves: Mapping[str, Run], names: Sequence[str]) -> Figure:
    """Draw each joint's angle (deg) by method, over the iterations to a target or the time along a path. names (n,)."""
    n, driven = len(names), any(move.driven for move in moves.values())
    least, aspect = (3, 0.62) if n <= 6 else (5, 0.9)
    rows, columns = style.grid_shape(n, style.WIDTH_MM, aspect, least)
    labels = [f"{name}{_outcome(move)}" for name, move in moves.items()]
    with style.drawing(rows * aspect * style.WIDTH_MM / columns + 14 + style.legend_shape(labels)[1]) as figure:
        panels = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for joint, axes in enumerate(panels[:n]):
            for k, move in enumerate(moves.values()):
                along = np.arange(len(move.q)) if driven else move.time_s
                axes.plot(along, np.degrees(move.q[:, joint]), **style.look(k))
            axes.set_title(names[joint], fontsize=style.SMALL, pad=2)
            axes.locator_params(axis="y", nbins=4)
        for axes in panels[n:]:
            axes.set_axis_off()
        for axes in panels[max(0, n - columns) : n]:
            axes.set_xlabel("iteration" if driven else "time (s)")
            axes.tick_params(labelbottom=True)
        figure.supylabel("angle (deg)", fontsize=8)
        style.add_legend(figure, panels[0].get_lines(), labels)
    return figure


def _outcome(move: Run) -> str:
    """Return what failed in a run, in a few words."""
    if not move.note:
        return ""
    failure = move.note.split(":")[0].split(" (")[0]
    return f" (not reached, {failure})" if move.driven else f" ({failure})"
