"""Points on pictures: predictions, and labels beside them."""

from __future__ import annotations

import colorsys

import cv2
import numpy as np

from recon.base.arrays import Array
from recon.io.video import Image
from recon.show.overlay import Colour, draw_circle, draw_line, draw_text

LEAST_WIDTH_PX = 560
"""Smaller pictures are enlarged."""
LABEL, LINE = (255, 255, 255), (60, 60, 230)


def colours(count: int) -> list[Colour]:
    """One for each keypoint, blue, green, red: evenly around the colour wheel, bright and dark by turns."""
    found = []
    for k in range(count):
        r, g, b = colorsys.hsv_to_rgb(k / max(count, 1), 0.85, 1.0 if k % 2 == 0 else 0.75)
        found.append((round(255 * b), round(255 * g), round(255 * r)))
    return found


def draw_points(picture: Image, xy_px: Array, likelihood: Array, likelihood_min: float) -> Image:
    """A copy with dots at points (K, 2); those less likely than likelihood_min are rings."""
    drawn = picture.copy()
    radius = max(2.0, max(picture.shape[:2]) / 160)
    for at, how, colour in zip(xy_px, likelihood, colours(len(xy_px)), strict=True):
        if np.isfinite(at).all():
            likely = how >= likelihood_min
            if likely:
                draw_circle(drawn, at, radius + 1, (0, 0, 0), -1)
            draw_circle(drawn, at, radius if likely else 0.7 * radius, colour, -1 if likely else 1)
    return drawn


def draw_comparison(picture: Image, label_px: Array, xy_px: Array, title: str) -> Image:
    """A copy, enlarged, with a ring at each label, a dot at its prediction, and a line between them."""
    factor = max(1, -(-LEAST_WIDTH_PX // picture.shape[1]))
    drawn = np.asarray(cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC), np.uint8)
    radius = max(3.0, drawn.shape[1] / 160)
    for label, at, colour in zip(label_px, xy_px, colours(len(xy_px)), strict=True):
        if np.isfinite(label).all():
            a, b = (factor * (p + 0.5) - 0.5 for p in (label, at))
            draw_line(drawn, a, b, LINE, 1)
            draw_circle(drawn, a, radius + 1, LABEL, 1)
            draw_circle(drawn, b, 0.6 * radius, colour, -1)
    draw_text(drawn, title, (8, 20), 0.5, LABEL)
    return drawn
