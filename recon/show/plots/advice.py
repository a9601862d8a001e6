"""How well an angle or a joint is known, by where the camera stands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from recon.calibrate.camera_advice import Advice
from recon.fit.motion import MEASURED_SHARE
from recon.show.plots.observability import share_colours
from recon.show.plots.style import GREY, SMALL, drawing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ROUND = {0: "ahead", 90: "left side", 180: "behind", 270: "right side"}
_PANEL_MM, _REST_MM = 52.0, 26.0


def camera_advice(found: Sequence[Advice]) -> Figure:
    """One panel a camera, each beside those before it: the pixels' share by azimuth and height, and one sigma."""
    with drawing(_PANEL_MM * len(found) + _REST_MM) as figure:
        panels = figure.subplots(len(found), 1, squeeze=False)[:, 0]
        figure.suptitle(
            f"{found[0].of}: how well it is known, by where the camera is, {found[0].distance_m:.3g} m away"
        )
        for number, (axes, advice) in enumerate(zip(panels, found, strict=True), start=1):
            _grid(axes, advice)
            if len(found) > 1:
                axes.set_title(f"camera {number}" + (", with the first (+)" if number > 1 else ""), loc="left", pad=3)
        panels[-1].set_xlabel("azimuth about the animal, from above counter-clockwise")
        bar = figure.colorbar(panels[-1].get_images()[0], ax=panels.tolist(), location="bottom", aspect=60, shrink=0.7)
        bar.set_label(
            f"share of the precision that comes from the pixels;  grey: less than {MEASURED_SHARE:g}, mostly expected\n"
            "black frame: the best place;  ±: one sigma"
        )
    return figure


def _grid(axes: Axes, advice: Advice) -> None:
    from matplotlib.patches import Rectangle

    degrees = np.round(np.degrees(advice.azimuths_rad)).astype(int)
    raised = np.round(np.degrees(advice.elevations_rad)).astype(int)
    rows, columns = advice.share.shape
    axes.imshow(advice.share, cmap=share_colours(), vmin=0, vmax=1, aspect="auto", origin="lower")
    for (row, column), share in np.ndenumerate(advice.share):
        sigma, colour = float(advice.sigma[row, column]), "w" if share > (1 + MEASURED_SHARE) / 2 else "k"
        text = f"{share:.0%}\n±{in_words(sigma, advice.unit)}" if np.isfinite(sigma) else "not in\nthe picture"
        axes.text(column, row, text, ha="center", va="center", fontsize=SMALL, color=colour)
    row, column = advice.best
    axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, lw=2.5, clip_on=False))
    if advice.beside is not None:
        azimuth, elevation = advice.beside
        at = np.argmin(np.abs(advice.azimuths_rad - azimuth)), np.argmin(np.abs(advice.elevations_rad - elevation))
        axes.plot(at[0] + 0.38, at[1] + 0.32, "k+", ms=7, mew=1.6)
    axes.set_xticks(range(columns), [f"{d}°\n{ROUND.get(int(d), '')}" for d in degrees], fontsize=SMALL)
    heights = advice.distance_m * np.sin(advice.elevations_rad)
    axes.set_yticks(range(rows), [f"{h:.2g} m ({r}°)" for h, r in zip(heights, raised, strict=True)])
    axes.set_ylabel("above its middle")
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set(visible=True, color=GREY)


def in_words(sigma: float, unit: str) -> str:
    """A standard deviation in degrees, or in centimetres."""
    return f"{np.degrees(sigma):.1f}°" if unit == "rad" else f"{100 * sigma:.1f} cm"
