"""Whether a calibration is good enough to use: measured values, limits, and why the limits are where they are.

Each limit has two steps: beyond the first it is a warning, beyond the second a reason to refuse. What matters for a
reconstruction is the scale of the picture (the focal length: 1 % is 1 % of every distance from the camera, and little
beside the 3 to 10 % to which an animal's size is known), the direction of the axis (the principal point: 1 % of the
width is about 0.6 degrees), and a lens model that holds where the animal is, which is anywhere in the picture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from recon.base.arrays import Array, Bools
from recon.calibrate.intrinsics.solve import Calibration

Verdict = Literal["ok", "warning", "refused"]


@dataclass(frozen=True)
class _CalibrationCheck:
    """A measured value, and what it is held against."""

    name: str
    what: str
    unit: str
    warn: float
    """A warning where the value is beyond it (below it, if `at_least`)."""
    refuse: float
    """A reason to refuse where the value is beyond it (below it, if `at_least`)."""
    at_least: bool
    advice: str
    value: float = math.nan

    @property
    def verdict(self) -> Verdict:
        if self._beyond(self.refuse):
            return "refused"
        return "warning" if self._beyond(self.warn) else "ok"

    def _beyond(self, bound: float) -> bool:
        """Never of a bound that is NaN, and always of a value that is."""
        return not math.isnan(bound) and not (self.value >= bound if self.at_least else self.value <= bound)

    def __str__(self) -> str:
        """What was found, the limit that it is beyond, by how much, and what to do."""
        bound = self.refuse if self.verdict == "refused" else self.warn
        unit = f" {self.unit}" if self.unit else ""
        if self.verdict == "ok":
            return f"{self.name}: {self.what} {self.value:.3g}{unit}"
        side = "at least" if self.at_least else "at most"
        return (
            f"{self.name}: {self.what} {self.value:.3g}{unit}, {side} {bound:g} wanted "
            f"({abs(self.value - bound):.2g} {'short' if self.at_least else 'over'}): {self.advice}"
        )


LIMITS = (
    _CalibrationCheck(
        "images", "pictures used", "", 10, 6, True, "take more pictures"
    ),  # three determine the matrix, two more the lens; with six an error of one can still be seen in the others
    _CalibrationCheck(
        "dropped", "pictures left out as outliers", "%", 10, 25, False, "look for a board that bends, or moves"
    ),  # one in four is no exception any more: the median itself is in doubt
    _CalibrationCheck(
        "rms", "reprojection error", "px of 1920", 0.5, 1.0, False, "check the board's numbers, flatness, and --model"
    ),  # corners are found to 0.05-0.3 px; more is a wrong lens model or board. Relative to the width above 1920
    _CalibrationCheck(
        "coverage", "share of the picture where the board was", "%", 60, 30, True, "move the board over all of it"
    ),  # the lens is measured there and extrapolated elsewhere, by polynomials
    _CalibrationCheck(
        "border", "widest strip along a border without a corner", "% of the side", 12, math.nan, False,
        "hold the board at the borders, partly outside if it is a ChArUco board",
    ),  # the distortion is largest there
    _CalibrationCheck(
        "tilt", "largest angle between two boards", "degrees", 40, 20, True, "tilt the board by 30 to 45 degrees"
    ),  # parallel boards say nothing new: a longer focal length and a longer distance look alike
    _CalibrationCheck(
        "tilt axes", "spread of the tilt in its least varied direction", "degrees", 6, 2, True,
        "tilt the board sideways as well as forwards",
    ),  # about one axis, only one of fx and fy is determined by perspective
    _CalibrationCheck(
        "focal length", "standard deviation of fx or fy", "%", 0.3, 1.0, False, "take more pictures, closer and tilted"
    ),  # what the lens model cannot express is not in it: take it for a third of the truth
    _CalibrationCheck(
        "principal point", "standard deviation of cx or cy", "% of the width", 0.3, 1.0, False,
        "take more pictures, tilted and at the borders",
    ),
    _CalibrationCheck(
        "aspect", "difference between fx and fy", "%", 0.5, 5.0, False, "check that the video is not stretched"
    ),  # pixels of today's sensors are square to 0.1 %
    _CalibrationCheck(
        "centre", "distance of the principal point from the middle", "% of the width", 5, 15, False,
        "check that the picture is not cropped",
    ),  # lenses are centred to some 2 %
    _CalibrationCheck(
        "folded", "part of the picture where the lens model has no ray", "%", 0.0, 5.0, False,
        "cover the borders, or use another --model",
    ),  # there the fitted polynomial turns back; a circular fisheye picture has such corners by nature
)  # fmt: skip
"""Without their values."""


def check(calibration: Calibration) -> tuple[_CalibrationCheck, ...]:
    """The checks of a calibration: those of `LIMITS`, with their values."""
    camera, used = calibration.camera, calibration.used
    width, height = camera.image_size_px
    values, sigma = calibration.parameters, calibration.sigma
    covered = coverage(calibration)
    corners = np.concatenate([view.xy_px for view in used])
    gaps = [*(corners.min(axis=0) / (width, height)), *(1 - (corners.max(axis=0) + 1) / (width, height))]
    normals = np.array([view.rotation[:, 2] * np.sign(view.rotation[2, 2] or 1.0) for view in used])
    measured = {
        "images": len(used),
        "dropped": 100 * (1 - len(used) / len(calibration.views)),
        "rms": calibration.rms_px / max(1.0, max(width, height) / 1920),
        "coverage": 100 * covered.mean(),
        "border": 100 * max(0.0, *gaps),
        "tilt": math.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1)).max()),
        "tilt axes": math.degrees(math.sqrt(max(0.0, np.linalg.eigvalsh(np.cov(normals[:, :2].T, bias=True))[0]))),
        "focal length": 100 * max(sigma[0] / values["fx"], sigma[1] / values["fy"]),
        "principal point": 100 * max(sigma[2:4]) / width,
        "aspect": 100 * abs(values["fx"] / values["fy"] - 1),
        "centre": 100 * math.hypot(values["cx"] - (width - 1) / 2, values["cy"] - (height - 1) / 2) / width,
        "folded": 100 * (1 - camera.rays(_pixel_grid(width, height))[1].mean()),
    }
    return tuple(replace(limit, value=float(measured[limit.name])) for limit in LIMITS)


def coverage(calibration: Calibration, columns: int = 320) -> Bools:
    """Which cells of the picture lie among the corners of some picture that was used: (rows, columns)."""
    width, height = calibration.camera.image_size_px
    scale = columns / width
    mask = np.zeros((max(1, round(height * scale)), columns), dtype=np.uint8)
    for view in calibration.used:
        hull = cv2.convexHull(((view.xy_px + 0.5) * scale - 0.5).astype(np.float32))
        cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
    return mask.astype(bool)


def _pixel_grid(width: int, height: int) -> Array:
    y, x = np.mgrid[0 : height - 1 : 41j, 0 : width - 1 : 41j]
    return np.stack((x, y), axis=-1)
