"""Draw what cameras show: how precise a measurement is by a camera's position, and a calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from recon.base.numbers import decimals, percent, quantity
from recon.calibrate.board_calibration import Calibration, coverage
from recon.calibrate.camera_advice import AZIMUTHS_RAD, ELEVATIONS_RAD, Advice
from recon.fit.motion import MEASURED_FRACTION
from recon.show.plots import style
from recon.show.plots.configurations import SHARES, share_colours

ROUND = {0: "ahead", 90: "left side", 180: "behind", 270: "right side"}
_PANEL_MM, _BESIDE_MM = 52.0, 26.0
WHOLE = 9.95
"""Standard deviation in degrees or centimetres from which it is written without decimals."""


def camera_advice(advices: Sequence[Advice]) -> Figure:
    """Draw how the uncertainty of a measured quantity depends on where a camera is placed.

    Colours show the fraction of the information that comes from the pixels rather than from the prior. Each added
    camera has a panel, which assumes that the cameras of the panels above are in use.
    """
    with style.drawing(_PANEL_MM * len(advices) + _BESIDE_MM) as figure:
        panels = figure.subplots(len(advices), 1, squeeze=False)[:, 0]
        target, length_m = advices[0].target.replace("_", " "), advices[0].distance_m
        figure.suptitle(f"Uncertainty of {target} by the position of a camera {length_m:{decimals(length_m)}} m away")
        for number, (axes, advice) in enumerate(zip(panels, advices, strict=True), start=1):
            _grid(axes, advice)
            if len(advices) > 1:
                axes.set_title(f"camera {number}" + (", with the first (+)" if number > 1 else ""), loc="left", pad=3)
        panels[-1].set_xlabel("azimuth around the animal, counterclockwise from above")
        bar = figure.colorbar(panels[-1].get_images()[0], ax=panels.tolist(), location="bottom", aspect=60, shrink=0.7)
        bar.set_label(f"{SHARES}\nblack frame: best position;  ±: one standard deviation")
    return figure


def _grid(axes: Axes, advice: Advice) -> None:
    degrees = np.round(np.degrees(AZIMUTHS_RAD)).astype(int)
    elevations_deg = np.round(np.degrees(ELEVATIONS_RAD)).astype(int)
    rows, columns = advice.share.shape
    axes.imshow(advice.share, cmap=share_colours(), vmin=0, vmax=1, aspect="auto", origin="lower")
    for (row, column), fraction in np.ndenumerate(advice.share):
        sigma, colour = float(advice.sigma[row, column]), "w" if fraction > (1 + MEASURED_FRACTION) / 2 else "k"
        text = f"{percent(fraction)}\n±{in_words(sigma, advice.unit)}" if np.isfinite(sigma) else "not in\nthe picture"
        axes.text(column, row, text, ha="center", va="center", fontsize=style.SMALL, color=colour)
    row, column = advice.best
    axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1, 1, fill=False, lw=2.5, clip_on=False))
    if advice.first_position is not None:
        azimuth, elevation = advice.first_position
        other_cell = np.argmin(np.abs(AZIMUTHS_RAD - azimuth)), np.argmin(np.abs(ELEVATIONS_RAD - elevation))
        axes.plot(other_cell[0] + 0.38, other_cell[1] + 0.32, "k+", ms=7, mew=1.6)
    axes.set_xticks(range(columns), [f"{d}°\n{ROUND.get(int(d), '')}" for d in degrees], fontsize=style.SMALL)
    heights = advice.distance_m * np.sin(ELEVATIONS_RAD)
    axes.set_yticks(range(rows), [f"{h:.2g} m ({r}°)" for h, r in zip(heights, elevations_deg, strict=True)])
    axes.set_ylabel("above its middle")
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set(visible=True, color=style.GREY)


def in_words(sigma: float, unit: str) -> str:
    """Return a standard deviation as a string in degrees (unit "rad") or centimetres."""
    value, name = (float(np.degrees(sigma)), "°") if unit == "rad" else (100 * sigma, "cm")
    return quantity(value, 0 if value >= WHOLE else 1, name)


def calibration(result: Calibration) -> Figure:
    """Draw the part of the picture that the boards of a calibration cover, and a square grid seen through the lens.

    Dots are corners, coloured by the error of their picture. Red crosses are the corners of pictures that were left
    out.
    """
    camera, used, covered = result.camera, result.used, coverage(result)
    width, height = camera.image_size_px
    left_out = [view for view in result.views if not view.used]
    pictures = f"{len(used)} pictures" + (f", {len(left_out)} left out (red)" if left_out else "")
    title = (
        f"{camera.model}, {width}x{height} px, {pictures}; {percent(covered.mean())} of the picture covered by a board"
    )
    with style.drawing(min(style.WIDTH_MM * height / width + 24, style.PAGE_MM), title=title) as figure:
        axes, edges = figure.subplots(), (-0.5, width - 0.5, height - 0.5, -0.5)
        axes.imshow(covered, extent=edges, cmap="Greys", vmax=4, interpolation="nearest")
        x, y = np.meshgrid(np.linspace(0, width - 1, 160), np.linspace(0, height - 1, 160))
        rays = camera.rays(np.stack((x, y), axis=-1))[0]
        ideal = np.moveaxis(rays[..., :2] / rays[..., 2:], -1, 0)
        # rays at nearly 90 degrees to the optical axis meet the plane of the grid at infinity
        step = min(float(np.nanmax(np.abs(ideal[0]))), 3.0) / 8
        for values in ideal:
            axes.contour(x, y, values, step * np.arange(-24, 25), colors=style.PALE, linewidths=0.7, linestyles="solid")
        corners_px = np.concatenate([view.xy_px for view in used])
        errors = [np.full(len(v.ids), v.rms_px) for v in used]
        dots = axes.scatter(*corners_px.T, c=np.concatenate(errors), s=4, vmin=0.0, linewidths=0)
        for view in left_out:
            axes.plot(*view.xy_px.T, "rx", markersize=3)
        axes.set(xlim=edges[:2], ylim=edges[2:], xticks=[], yticks=[])
        bar = figure.colorbar(dots, ax=axes, location="bottom", aspect=60, pad=0.02, shrink=0.7)
        bar.set_label(f"error of the picture, px (root mean square; all pictures: {result.rms_px:.2f})")
    return figure
