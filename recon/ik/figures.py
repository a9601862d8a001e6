"""Draw how each method moves a chain to a target or along a path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from recon.base.arrays import Array
from recon.ik.chain import SerialChain
from recon.ik.drive import Run
from recon.ik.limb import VECTORS, vector_names
from recon.show.plots import style

VIEWS = {
    "UVW": (("side", 0, 1, "forwards (m)", "down (m)"), ("top", 0, 2, "forwards (m)", "to the left (m)")),
    "xyz": (("side", 0, 2, "forwards (m)", "up (m)"), ("top", 0, 1, "forwards (m)", "to the left (m)")),
}
"""Views of each base frame of a chain: name, indices of the two drawn coordinates, and labels of the two axes."""
_ROOM = 0.06
_SINGLE = {
    "damped_lambda_m": "lambda (m)",
    "selectively-damped_gamma_max_rad": "gamma_max (rad)",
    "gradient-projection_k_1_s": "k, differences",
    "transpose_alpha_1_m2": "transpose",
}
"""Legend label of each column of the parameter table that holds a method's only parameter."""


def task_space(
    moves: Mapping[str, Run],
    chain: SerialChain,
    aim_m: Array | None = None,
    base: Literal["UVW", "xyz"] = "UVW",
) -> Figure:
    """Draw the path of the end effector for each method, in the plane, or in space from the side and from above.

    The chain is drawn at the start and, for each method, at the end. `aim_m` is the target (dim,), drawn as a cross, or
    the requested path (K, dim). `base` names the axes of the base frame: "UVW" for forwards, down and left, "xyz" for
    forwards, left and up. Planar chains have U and V.
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
    """Draw the angle of each joint in degrees, over the iterations to a target or the time along a path.

    Every method has a line, and every joint in `names` (n,) has a panel.
    """
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


def parameter_series(series: pd.DataFrame, joints: Sequence[str]) -> Figure:
    """Draw the parameters of `fit_parameter_series`, which are fitted to each configuration, over the stride.

    The panels are the damping lambda and gamma_max, the weights of the joints, the vector g, k and the alpha of the
    transpose, and the factor alpha of every method, including the extended Jacobian. A panel without values is left
    out.
    """
    alphas = [str(name) for name in series if str(name).endswith("_best_alpha")]
    panels = {
        "damping": (("damped_lambda_m", "selectively-damped_gamma_max_rad"), True),
        "weights w,\nmean 1": (tuple(f"weighted_{joint}" for joint in joints), True),
        "vector g\n(rad/s)": (tuple(f"{kind}_{name}" for kind in VECTORS for name in vector_names(joints)), False),
        "k (1/s)": (("gradient-projection_k_1_s",), False),
        "alpha (1/m²)": (("transpose_alpha_1_m2",), False),
        "alpha, factor\non all rates": (tuple(alphas), False),
    }
    shown = {
        label: ([name for name in names if name in series and series[name].notna().any()], is_log)
        for label, (names, is_log) in panels.items()
    }
    shown = {label: panel for label, panel in shown.items() if panel[0]}
    with style.drawing(36 * len(shown) + 8) as figure:
        rows = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        for axes, (label, (names, is_log)) in zip(rows, shown.items(), strict=True):
            for k, name in enumerate(names):
                axes.plot(series["time_s"], series[name], **style.look(k), label=_parameter_label(name))
            if is_log:
                axes.set_yscale("log")
                style.plain_logarithm(axes.yaxis)
            axes.set_ylabel(label)
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=style.SMALL - 1, frameon=False)
        rows[-1].set_xlabel("time (s)")
        figure.align_ylabels()
    return figure


def _parameter_label(column: str) -> str:
    if column in _SINGLE:
        return _SINGLE[column]
    label = column.removesuffix("_best_alpha")
    for prefix in ("weighted_", *(f"{kind}_" for kind in VECTORS)):
        if label.startswith(f"{prefix}g"):  # a component of g, such as "g1_theta_9"
            return label.removeprefix(prefix).replace("_", ", ", 1)
        label = label.removeprefix(prefix)
    return label


def _outcome(move: Run) -> str:
    """Return a few words for the plot's legend on why a run failed, or an empty string if it did not fail."""
    if not move.note:
        return ""
    failure = move.note.split(":")[0].split(" (")[0]
    return f" (not reached, {failure})" if move.driven else f" ({failure})"
