"""From views of a board to a camera: OpenCV's solvers, what they leave over, and how certain the result is.

Model of a corner: the board's point through the view's pose (6 unknowns for each view), the lens and the matrix. OpenCV
finds the least squares. The residuals are those of `Camera.project`, the model that the rest of the
package uses, so that a difference between the two would show as an error.

A picture whose error (root mean square over its corners) is more than `DROP_FACTOR` times that of the median picture
is left out, and the rest solved again, up to `ROUNDS` times. Errors of good pictures lie within a factor of two of the
median, whatever the lens; a picture beyond three has moved, bent or wrongly read corners, and since least squares are
not robust, one of those moves the focal length by more than all others determine it. Errors below `DROP_FLOOR_PX` are
those of a good detector and never dropped. Dropped pictures are listed with the error for which they were.

**Whether it is good enough to use.** Each limit has two steps: beyond the first it is a warning, beyond the second a
reason to refuse. What matters for a reconstruction is the scale of the picture (the focal length: 1 % is 1 % of every
distance from the camera, and little beside the 3 to 10 % to which an animal's size is known), the direction of the axis
(the principal point: 1 % of the width is about 0.6 degrees), and a lens model that holds where the animal is, which is
anywhere in the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np
from scipy.linalg import block_diag

from recon.base.arrays import Array, Bools
from recon.base.errors import InputError, Problem
from recon.calibrate.boards import Board, BoardView, BoardViews
from recon.geometry.camera import Camera
from recon.geometry.lens import LENS_MODELS

DROP_FACTOR = 3.0
DROP_FLOOR_PX = 0.3
ROUNDS = 3
MIN_VIEWS = 3
"""Each view of a plane gives two equations for the four numbers of the matrix; one more than needed."""
FISHEYE_STARTS_DEG = (60.0, 100.0, 140.0, 180.0)
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)


@dataclass(frozen=True)
class _FittedBoardView(BoardView):
    """One picture, of N corners."""

    rotation: Array
    """(3, 3): X_camera = rotation X_board + translation_m."""
    translation_m: Array
    """(3,)"""
    residual_px: Array
    """(N, 2), projected less found."""
    used: bool
    """Whether it counted, or was left out as an outlier."""

    @cached_property
    def rms_px(self) -> float:
        return math.sqrt((self.residual_px**2).sum(axis=1).mean())

    @cached_property
    def max_px(self) -> float:
        return float(np.linalg.norm(self.residual_px, axis=1).max())

    @property
    def tilt_rad(self) -> float:
        """Angle between the board and the picture's plane."""
        return math.acos(min(1.0, abs(float(self.rotation[2, 2]))))


@dataclass(frozen=True)
class Calibration:
    """A camera and what it was found from."""

    camera: Camera
    board: Board
    views: tuple[_FittedBoardView, ...]
    sigma: tuple[float, ...]
    """One standard deviation of each parameter (see `parameters`), from the residuals and the views' geometry; what
    the lens model cannot express is not in it."""

    @cached_property
    def used(self) -> tuple[_FittedBoardView, ...]:
        return tuple(view for view in self.views if view.used)

    @cached_property
    def rms_px(self) -> float:
        """Root mean square distance of projected and found corners, over the pictures that were used."""
        residual = np.concatenate([view.residual_px for view in self.used])
        return math.sqrt((residual**2).sum(axis=1).mean())

    @property
    def parameters(self) -> dict[str, float]:
        """fx, fy, cx, cy (px) and the lens's coefficients, by name."""
        matrix = self.camera.matrix
        values = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *self.camera.distortion)
        names = ("fx", "fy", "cx", "cy", *self.camera.lens.coefficients)
        return {name: float(value) for name, value in zip(names, values, strict=False)}


def calibrate(views: BoardViews, model: str, name: str = "cam1") -> Calibration:
    """The camera that explains the views best. Raises InputError where they are too few or determine nothing."""
    if len(views.views) < MIN_VIEWS:
        found = f"the board in {len(views.views)} of {views.examined} pictures"
        raise InputError(Problem("pictures", "views", found, f"{MIN_VIEWS} or more; 12 to 40 are good"))
    points, left_out = views.board.points_m, dict[str, _FittedBoardView]()
    camera, fitted = _solve(views.views, points, views.image_size_px, model, name)
    for _ in range(ROUNDS):
        errors = np.array([view.rms_px for view in fitted])
        good = errors <= max(DROP_FACTOR * float(np.median(errors)), DROP_FLOOR_PX)
        if good.all() or good.sum() < MIN_VIEWS:
            break
        bad = [view for view, is_good in zip(fitted, good, strict=True) if not is_good]
        left_out |= {view.name: replace(view, used=False) for view in bad}
        used = [view for view in fitted if view.name not in left_out]
        camera, fitted = _solve(used, points, views.image_size_px, model, name)
    every = left_out | {view.name: view for view in fitted}
    sigma = _sigma(fitted, points, camera)
    return Calibration(camera, views.board, tuple(every[view.name] for view in views.views), tuple(sigma.tolist()))


def _fitted_view(
    view: BoardView, points: Array, camera: Camera, rotation_vector: Array, translation: Array
) -> _FittedBoardView:
    rotation = np.asarray(cv2.Rodrigues(rotation_vector)[0], dtype=float)
    translation = np.ravel(translation)
    projected, valid = camera.project(points[view.ids] @ rotation.T + translation)
    # Where the lens model folds there is no projection: as wrong as can be, and finite.
    far = float(np.hypot(*camera.image_size_px))
    residual = np.where(valid[:, None], projected - view.xy_px, far)
    return _FittedBoardView(view.name, view.ids, view.xy_px, rotation, translation, residual, used=True)


def _solve(
    views: Sequence[BoardView], points: Array, size: tuple[int, int], model: str, name: str
) -> tuple[Camera, list[_FittedBoardView]]:
    try:
        solve = _solve_fisheye if LENS_MODELS[model].opencv == "fisheye" else _solve_standard
        matrix, distortion, rotations, translations = solve(views, points, size, LENS_MODELS[model].calibrated)
        camera = Camera(name, matrix, distortion, model, size)
    except (cv2.error, ValueError) as error:
        expected = "boards tilted in different ways, over the whole picture"
        raise InputError(Problem("pictures", f"{model} model", "no solution", expected)) from error
    poses = zip(views, rotations, translations, strict=True)
    return camera, [_fitted_view(view, points, camera, rotation, place) for view, rotation, place in poses]


def _solve_standard(views: Sequence[BoardView], points: Array, size: tuple[int, int], coefficients: int) -> Any:
    """With OpenCV's first five coefficients, or with none."""
    fixed = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    objects = [points[view.ids].astype(np.float32) for view in views]
    images = [view.xy_px.astype(np.float32).reshape(-1, 1, 2) for view in views]
    _, matrix, distortion, rotations, translations = cv2.calibrateCamera(
        objects, images, size, np.eye(3), np.zeros(5), flags=0 if coefficients else fixed, criteria=_CRITERIA
    )
    return matrix, np.ravel(distortion)[:coefficients], rotations, translations


def _solve_fisheye(views: Sequence[BoardView], points: Array, size: tuple[int, int], coefficients: int) -> Any:
    """Started from several fields of view, because OpenCV keeps to the one it is given."""
    objects = [points[view.ids].reshape(1, -1, 3) for view in views]
    images = [view.xy_px.reshape(1, -1, 2) for view in views]
    names = ("CALIB_USE_INTRINSIC_GUESS", "CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW")
    # OpenCV 4 has flags of its own for fisheyes, of other values; OpenCV 5 has one set for all lenses.
    flags = sum(getattr(cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2, name) for name in names)
    best: Any = None
    failure: cv2.error | None = None
    for field_deg in FISHEYE_STARTS_DEG:
        focal = size[0] / math.radians(field_deg)
        guess = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
        try:
            start = np.zeros(coefficients)
            found = cv2.fisheye.calibrate(objects, images, size, guess, start, flags=flags, criteria=_CRITERIA)
        except cv2.error as error:
            failure = error
            continue
        if math.isfinite(found[0]) and (best is None or found[0] < best[0]):
            best = found
    if best is None:
        raise failure or ValueError("no finite solution")
    _, matrix, distortion, rotations, translations = best
    return matrix, np.ravel(distortion), rotations, translations


def _sigma(views: Sequence[_FittedBoardView], points: Array, camera: Camera) -> Array:
    """Standard deviations of the camera's parameters, infinite where the pictures do not tell them: of all unknowns,
    those and the poses, by the Jacobian of all residuals, whose variance is their sum of squares over the degrees of
    freedom."""
    by_camera, by_pose = zip(*(_jacobian(view, points, camera) for view in views), strict=True)
    jacobian = np.hstack([np.vstack(by_camera), block_diag(*by_pose)])
    residual, n = np.concatenate([view.residual_px for view in views]), 4 + camera.distortion.size
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-150)  # coefficients and pixels differ by many orders
    try:
        inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    except np.linalg.LinAlgError:
        return np.full(n, np.inf)
    diagonal, variance = np.diag(inverse)[:n], np.sum(residual**2) / max(1, residual.size - len(scale))
    return np.where(diagonal > 0, np.sqrt(variance * np.abs(diagonal)) / scale[:n], np.inf)


def _jacobian(view: _FittedBoardView, points: Array, camera: Camera) -> tuple[Array, Array]:
    """Derivatives of a view's pixels with respect to the camera (2N, 4 + coefficients) and the pose (2N, 6)."""
    rotation = np.asarray(cv2.Rodrigues(view.rotation)[0], dtype=float)
    objects = points[view.ids].reshape(-1, 1, 3)
    pose, n = (rotation, view.translation_m), camera.distortion.size
    if camera.lens.opencv == "fisheye":
        _, jacobian = cv2.fisheye.projectPoints(objects, *pose, camera.matrix, camera.distortion)
        jacobian = np.asarray(jacobian, dtype=float)
        return jacobian[:, : 4 + n], jacobian[:, 8:14]
    five = np.pad(camera.distortion, (0, 5 - n))
    jacobian = np.asarray(cv2.projectPoints(objects, *pose, camera.matrix, five)[1], dtype=float)
    return jacobian[:, 6 : 10 + n], jacobian[:, :6]


# -- checks ---------------------------------------------------------------------------------------------------------

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
    y, x = np.mgrid[0 : height - 1 : 41j, 0 : width - 1 : 41j]
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
        "folded": 100 * (1 - camera.rays(np.stack((x, y), axis=-1))[1].mean()),
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
