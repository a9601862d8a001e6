"""A picture of a calibration: where the board was, how large the errors are, and how the lens bends lines."""

from __future__ import annotations

import cv2
import numpy as np

from recon.base.arrays import Array
from recon.calibrate.intrinsics.checks import coverage
from recon.calibrate.intrinsics.solve import Calibration
from recon.geometry.camera import Camera
from recon.io.video import Image

MAX_SIDE_PX = 1400
MARGIN_PX, FOOT_PX = 40, 90
PAPER, FRAME, COVERED, GRID, INK = (255, 255, 255), (243, 243, 243), (225, 232, 220), (190, 170, 140), (40, 40, 40)
DROPPED = (60, 60, 230)
FONT = cv2.FONT_HERSHEY_SIMPLEX
SHIFT = 4


def draw(calibration: Calibration) -> Image:
    """Picture (height, width, 3; blue, green, red).

    Shaded: covered by a board. Lines: a square grid as this lens sees it. Dots: all corners, coloured by their
    picture's error; red crosses: those of pictures that were left out.
    """
    camera = calibration.camera
    width, height = camera.image_size_px
    scale = MAX_SIDE_PX / max(width, height)
    inner_w, inner_h = round(width * scale), round(height * scale)
    image = np.full((inner_h + 2 * MARGIN_PX + FOOT_PX, inner_w + 2 * MARGIN_PX, 3), PAPER, dtype=np.uint8)
    inside = image[MARGIN_PX : MARGIN_PX + inner_h, MARGIN_PX : MARGIN_PX + inner_w]
    covered = cv2.resize(coverage(calibration).astype(np.uint8), (inner_w, inner_h), interpolation=cv2.INTER_NEAREST)
    inside[:] = np.where(covered[..., None] > 0, COVERED, FRAME)

    def place(xy_px: Array) -> np.ndarray:
        """Fixed-point coordinates (..., 2) in the drawing."""
        return np.rint((((xy_px + 0.5) * scale - 0.5) + MARGIN_PX) * 2**SHIFT).astype(np.int32)

    for line in _grid_lines(camera):
        cv2.polylines(image, [place(line)], False, GRID, 1, cv2.LINE_AA, SHIFT)
    last = (MARGIN_PX + inner_w - 1, MARGIN_PX + inner_h - 1)
    cv2.rectangle(image, (MARGIN_PX, MARGIN_PX), last, INK, 1)

    top = max(view.rms_px for view in calibration.used)
    for view in calibration.views:
        spots = place(view.xy_px)
        for x, y in spots:
            if view.used:
                colour = _colours(np.array([view.rms_px / top]))[0]
                cv2.circle(image, (int(x), int(y)), 4 << SHIFT, colour, -1, cv2.LINE_AA, SHIFT)
            else:
                cv2.drawMarker(image, (int(x) >> SHIFT, int(y) >> SHIFT), DROPPED, cv2.MARKER_TILTED_CROSS, 9, 1)
    _legend(image, calibration, top, (MARGIN_PX, 2 * MARGIN_PX + inner_h))
    return image


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


def _legend(image: Image, calibration: Calibration, top: float, corner: tuple[int, int]) -> None:
    x, y = corner
    bar_w = 300
    bar = _colours(np.linspace(0, 1, bar_w))
    image[y : y + 16, x : x + bar_w] = np.array(bar, dtype=np.uint8)[None]
    for share in (0.0, 0.5, 1.0):
        label = f"{share * top:.2f}" + " px" * (share == 1.0)
        cv2.putText(image, label, (x + round(share * bar_w) - 12, y + 36), FONT, 0.5, INK, 1, cv2.LINE_AA)
    cv2.putText(image, "error of the picture (root mean square)", (x, y + 58), FONT, 0.5, INK, 1, cv2.LINE_AA)
    dropped = len(calibration.views) - len(calibration.used)
    camera = calibration.camera
    notes = [
        f"{camera.model}, {camera.image_size_px[0]}x{camera.image_size_px[1]} px, {len(calibration.used)} pictures",
        f"reprojection error {calibration.rms_px:.2f} px",
        f"covered: {coverage(calibration).mean():.0%} of the picture",
    ]
    if dropped:
        notes[0] += f", {dropped} left out (red)"
    for number, note in enumerate(notes):
        cv2.putText(image, note, (x + bar_w + 60, y + 14 + 22 * number), FONT, 0.5, INK, 1, cv2.LINE_AA)


def _colours(shares: Array) -> list[tuple[int, int, int]]:
    values = np.rint(255 * np.clip(shares, 0, 1)).astype(np.uint8).reshape(-1, 1)
    colours = cv2.applyColorMap(values, cv2.COLORMAP_VIRIDIS).reshape(-1, 3)
    return [(int(b), int(g), int(r)) for b, g, r in colours]
