"""A picture of a calibration: where the board was, how large the errors are, and how the lens bends lines."""

from __future__ import annotations

from io import BytesIO

import numpy as np

from recon.base.arrays import Array
from recon.calibrate.intrinsics.checks import coverage
from recon.calibrate.intrinsics.solve import Calibration
from recon.geometry.camera import Camera

MAX_SIDE_PX, MARGIN_PX, FOOT_PX = 1400, 40, 130
_DPI = 100


def draw(calibration: Calibration) -> bytes:
    """A PNG. Shaded: covered by a board. Lines: a square grid as this lens sees it. Dots: all corners, coloured by the
    error of their picture; red crosses: those of pictures that were left out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    camera, used, covered = calibration.camera, calibration.used, coverage(calibration)
    width, height = camera.image_size_px
    inner = np.rint(np.array([width, height]) * MAX_SIDE_PX / max(width, height))
    whole = inner + np.array([2 * MARGIN_PX, MARGIN_PX + FOOT_PX])
    figure = Figure(figsize=tuple(whole / _DPI), dpi=_DPI)
    FigureCanvasAgg(figure)
    corner, size = np.array([MARGIN_PX, FOOT_PX]) / whole, inner / whole
    axes = figure.add_axes((*corner.tolist(), *size.tolist()), xticks=[], yticks=[])
    edges = (-0.5, width - 0.5, height - 0.5, -0.5)
    axes.imshow(covered, extent=edges, cmap="Greys", vmax=4, aspect="auto", interpolation="nearest")
    axes.add_collection(LineCollection(_grid_lines(camera), colors="#8caabe", linewidths=0.7))
    at, errors = np.concatenate([view.xy_px for view in used]), [np.full(len(v.ids), v.rms_px) for v in used]
    dots = axes.scatter(*at.T, c=np.concatenate(errors), s=16, vmin=0.0, linewidths=0)
    left_out = [view for view in calibration.views if not view.used]
    for view in left_out:
        axes.plot(*view.xy_px.T, "x", color="#e63c3c", markersize=5)
    axes.set(xlim=edges[:2], ylim=edges[2:])
    bar = figure.add_axes((corner[0], 0.6 * corner[1], 300 / whole[0], 16 / whole[1]))
    figure.colorbar(dots, cax=bar, orientation="horizontal").set_label("error of the picture, px (root mean square)")
    notes = (
        f"{camera.model}, {width}x{height} px, {len(used)} pictures"
        + (f", {len(left_out)} left out (red)" if left_out else ""),
        f"reprojection error {calibration.rms_px:.2f} px",
        f"covered: {covered.mean():.0%} of the picture",
    )
    figure.text(360 / whole[0] + corner[0], 0.75 * corner[1], "\n".join(notes), va="top")
    content = BytesIO()
    figure.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()


def _grid_lines(camera: Camera) -> list[Array]:
    """Lines (N, 2), px, that are straight, horizontal and vertical through an ideal lens, as this lens sees them."""
    width, height = camera.image_size_px
    border = np.concatenate([
        np.stack((np.linspace(0, width - 1, 60), np.full(60, y)), axis=1) for y in (0.0, height - 1.0)
    ] + [np.stack((np.full(60, x), np.linspace(0, height - 1, 60)), axis=1) for x in (0.0, width - 1.0)])  # fmt: skip
    rays, valid = camera.rays(border)
    flat = rays[valid, :2] / rays[valid, 2:]
    # Near a right angle from the axis, the plane of the grid is infinite.
    reach = np.minimum(np.abs(flat).max(axis=0), 3.0) if len(flat) else np.ones(2)
    step = 2 * reach[0] / 16
    fine = np.linspace(-1, 1, 400)
    lines = []
    for axis in (0, 1):
        for value in np.arange(-np.floor(reach[axis] / step), np.floor(reach[axis] / step) + 1) * step:
            line = np.ones((len(fine), 3))
            line[:, axis], line[:, 1 - axis] = value, fine * reach[1 - axis]
            xy, _ = camera.project(line)
            shown = camera.in_image(xy)
            edges = np.flatnonzero(np.diff(np.concatenate(([0], shown.astype(int), [0]))))
            lines += [xy[a:b] for a, b in edges.reshape(-1, 2) if b - a > 1]
    return lines
