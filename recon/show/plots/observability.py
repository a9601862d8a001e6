"""Which angles the pixels show: the share of each over time, and by where the camera stands; and what a calibration
rests on."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from recon.animal import Body
from recon.base.arrays import Array, median
from recon.calibrate.boards import Calibration, coverage
from recon.calibrate.camera_advice import Advice
from recon.fit.motion import MEASURED_SHARE
from recon.show.plots.style import GREY, PAGE_MM, PALE, SMALL, WIDTH_MM, drawing

_ROW_MM, _REST_MM = 3.3, 34.0
_SHARES = f"share of the precision that comes from the pixels;  grey: less than {MEASURED_SHARE:g}, mostly expected"


def share_colours() -> ListedColormap:
    """Colours of information fractions from 0 to 1: greys below `MEASURED_SHARE`, blues from there on."""
    low = round(256 * MEASURED_SHARE)
    greys, blues = mpl.colormaps["Greys"](np.linspace(0.1, 0.45, low)), mpl.colormaps["Blues"](np.linspace(0.5, 1, 256))
    return ListedColormap([*greys, *blues[:: -(-256 // (256 - low))]])


def observability(body: Body, share: Array, time_s: Array, title: str = "") -> Figure:
    """share (T, D - 4): of the precision of the root's pitch and roll and of the joints' angles, what comes from the
    pixels, NaN where unknown; time_s (T,). Over time, with the medians beside them."""
    names = [name.replace("_", " ") for name in body.state_names[4:]]
    with drawing(min(_ROW_MM * len(names) + _REST_MM, PAGE_MM), title=title) as figure:
        medians = np.array([median(of_angle) for of_angle in share.T])
        if np.isnan(medians).all():
            return figure
        axes, half = figure.subplots(), 0.5 * float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.5
        extent = (float(time_s[0]) - half, float(time_s[-1]) + half, len(names) - 0.5, -0.5)
        style = {"vmin": 0, "vmax": 1, "aspect": "auto", "interpolation": "nearest"}
        image = axes.imshow(share.T, cmap=share_colours(), extent=extent, **style)
        axes.set_yticks(range(len(names)), names)
        axes.tick_params(axis="y", length=0)
        for row, (label, middle) in enumerate(zip(axes.get_yticklabels(), medians, strict=True)):
            text, colour = f"{middle:.0%}" if np.isfinite(middle) else "–", "k" if middle >= MEASURED_SHARE else GREY
            axes.text(1.01, row, text, transform=axes.get_yaxis_transform(), va="center", fontsize=SMALL, color=colour)
            label.set_color(colour)
        axes.set_xlabel("time (s);  right: median over these frames")
        bar = figure.colorbar(image, ax=axes, location="bottom", aspect=60, pad=0.01, shrink=0.7)
        bar.set_label(_SHARES)
    return figure


# -- by where the camera stands -------------------------------------------------------------------------------------

ROUND = {0: "ahead", 90: "left side", 180: "behind", 270: "right side"}
_PANEL_MM, _BESIDE_MM = 52.0, 26.0


def camera_advice(found: Sequence[Advice]) -> Figure:
    """One panel a camera, each beside those before it: the pixels' share by azimuth and height, and one sigma."""
    with drawing(_PANEL_MM * len(found) + _BESIDE_MM) as figure:
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
        bar.set_label(f"{_SHARES}\nblack frame: the best place;  ±: one sigma")
    return figure


def _grid(axes: Axes, advice: Advice) -> None:
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


# -- a calibration ----------------------------------------------------------------------------------------------------


def calibration(found: Calibration) -> Figure:
    """Shaded: covered by a board. Lines: a square grid as this lens sees it. Dots: all corners, coloured by the error
    of their picture; red crosses: those of pictures that were left out."""
    camera, used, covered = found.camera, found.used, coverage(found)
    width, height = camera.image_size_px
    left_out = [view for view in found.views if not view.used]
    pictures = f"{len(used)} pictures" + (f", {len(left_out)} left out (red)" if left_out else "")
    title = f"{camera.model}, {width}x{height} px, {pictures}; covered: {covered.mean():.0%} of the picture"
    with drawing(min(WIDTH_MM * height / width + 24, PAGE_MM), title=title) as figure:
        axes, edges = figure.subplots(), (-0.5, width - 0.5, height - 0.5, -0.5)
        axes.imshow(covered, extent=edges, cmap="Greys", vmax=4, interpolation="nearest")
        x, y = np.meshgrid(np.linspace(0, width - 1, 160), np.linspace(0, height - 1, 160))
        rays = camera.rays(np.stack((x, y), axis=-1))[0]
        ideal = np.moveaxis(rays[..., :2] / rays[..., 2:], -1, 0)
        # near a right angle from the axis, the plane of the grid is infinite
        step = min(float(np.nanmax(np.abs(ideal[0]))), 3.0) / 8
        for values in ideal:
            axes.contour(x, y, values, step * np.arange(-24, 25), colors=PALE, linewidths=0.7, linestyles="solid")
        at, errors = np.concatenate([view.xy_px for view in used]), [np.full(len(v.ids), v.rms_px) for v in used]
        dots = axes.scatter(*at.T, c=np.concatenate(errors), s=4, vmin=0.0, linewidths=0)
        for view in left_out:
            axes.plot(*view.xy_px.T, "rx", markersize=3)
        axes.set(xlim=edges[:2], ylim=edges[2:], xticks=[], yticks=[])
        bar = figure.colorbar(dots, ax=axes, location="bottom", aspect=60, pad=0.02, shrink=0.7)
        bar.set_label(f"error of the picture, px (root mean square; of all {found.rms_px:.2f})")
    return figure
