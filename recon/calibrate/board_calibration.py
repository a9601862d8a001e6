"""Calibrate a camera from views of a board, and check the quality of the calibration.

Each corner is modelled as a point of the board that is moved by the view's pose (6 unknowns per view) and projected by
the lens and the camera matrix. OpenCV minimises the squared errors. The residuals are computed by `Camera.project`, the
model that the rest of the package uses, so that a difference between the two models would show as an error.

A picture whose error (root mean square over its corners) exceeds `DROP_FACTOR` times the median over pictures probably
has a board that moved or bent, or wrongly detected corners. It is left out, and the remaining pictures are solved
again, up to `ROUNDS` times. Least squares are not robust, so one such picture can change the focal length by more than
the uncertainty from all the others. Errors below `DROP_FLOOR_PX` are typical of a good detector, and are no reason to
leave a picture out. The report lists the pictures that were left out, with their errors.

Each quantity that is checked has two limits. Beyond the first, there is a warning. Beyond the second, the calibration
is refused. Three properties matter for a reconstruction. The first is the focal length. An error of 1 % changes every
distance from the camera by 1 %, which is small compared with the uncertainty of an animal's size, 3 to 10 %. The second
is the principal point, where an error of 1 % of the width is about 0.6 degrees. The third is that the lens model is
valid in the whole picture, since the animal may be anywhere in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np
from cv2.typing import MatLike
from scipy.linalg import block_diag

from recon.base.arrays import Array, Bools
from recon.base.errors import InputError, Problem
from recon.calibrate.boards import Board, BoardView, BoardViews
from recon.geometry.camera import Camera
from recon.geometry.lens import LENS_MODELS

DROP_FACTOR = 3.0
DROP_FLOOR_PX = 0.3
ROUNDS = 3
COVERAGE_COLUMNS = 320
MIN_VIEWS = 3
"""Minimum number of views, one more than necessary.

A view of a plane gives two equations, and the camera matrix has four unknowns.
"""
FISHEYE_STARTS_DEG = (60.0, 100.0, 140.0, 180.0)
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)


@dataclass(frozen=True)
class _FittedBoardView(BoardView):
    """Picture of a board with N detected corners, and the fitted pose of the board."""

    rotation: Array
    """Rotation of X_camera = rotation X_board + translation_m, shape (3, 3)."""
    translation_m: Array
    """Translation from the board frame to the camera frame, shape (3,)."""
    residual_px: Array
    """Projected minus detected corners, shape (N, 2)."""
    used: bool
    """Whether the picture was used; False for an outlier."""

    @cached_property
    def rms_px(self) -> float:
        """Return the root mean square reprojection error of the corners, px."""
        return math.sqrt((self.residual_px**2).sum(axis=1).mean())

    @cached_property
    def max_px(self) -> float:
        """Return the largest reprojection error of a corner, px."""
        return float(np.linalg.norm(self.residual_px, axis=1).max())

    @property
    def tilt_rad(self) -> float:
        """Return the angle between the board and the image plane, rad."""
        return math.acos(min(1.0, abs(float(self.rotation[2, 2]))))


@dataclass(frozen=True)
class Calibration:
    """A calibrated camera with its uncertainty, and the views of the board from which it was calibrated."""

    camera: Camera
    board: Board
    views: tuple[_FittedBoardView, ...]
    sigma: tuple[float, ...]
    """Standard deviation of each of `parameters`, from the residuals and the geometry of the views.

    Errors of the lens model are not included.
    """

    @cached_property
    def used(self) -> tuple[_FittedBoardView, ...]:
        """Return the views from which the camera was calibrated, which exclude outliers."""
        return tuple(view for view in self.views if view.used)

    @cached_property
    def rms_px(self) -> float:
        """Return the root mean square distance (px) between projected and detected corners in the used pictures."""
        residual = np.concatenate([view.residual_px for view in self.used])
        return math.sqrt((residual**2).sum(axis=1).mean())

    @property
    def parameters(self) -> dict[str, float]:
        """Return fx, fy, cx, cy (px) and the lens coefficients, keyed by their names."""
        matrix = self.camera.matrix
        values = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *self.camera.distortion)
        names = ("fx", "fy", "cx", "cy", *self.camera.lens.coefficients)
        return {name: float(value) for name, value in zip(names, values, strict=False)}


def calibrate(views: BoardViews, model: str, name: str = "cam1") -> Calibration:
    """Find the camera that fits the views best.

    Parameters
    ----------
    views : BoardViews
        Pictures of the board.
    model : str
        Name of the lens model.
    name : str
        Name of the camera.

    Returns
    -------
    Calibration
        The camera, its uncertainty, and the views that were used.

    Raises
    ------
    InputError
        If there are too few views, or if they do not determine a camera.
    """
    if len(views.views) < MIN_VIEWS:
        found_views = f"the board in {len(views.views)} of {views.examined} pictures"
        raise InputError(
            Problem("pictures", "views", found_views, f"the board in {MIN_VIEWS} pictures or more; 12 to 40 are good")
        )
    left_out = dict[str, _FittedBoardView]()
    camera, fitted = _solve(views, model, name)
    for _ in range(ROUNDS):
        errors = np.array([view.rms_px for view in fitted])
        is_good = errors <= max(DROP_FACTOR * float(np.median(errors)), DROP_FLOOR_PX)
        if is_good.all() or is_good.sum() < MIN_VIEWS:
            break
        outliers = [view for view, keep in zip(fitted, is_good, strict=True) if not keep]
        left_out |= {view.name: replace(view, used=False) for view in outliers}
        used = tuple(view for view in fitted if view.name not in left_out)
        camera, fitted = _solve(replace(views, views=used), model, name)
    all_views = left_out | {view.name: view for view in fitted}
    sigma = _sigma(fitted, views.board.points_m, camera)
    return Calibration(camera, views.board, tuple(all_views[view.name] for view in views.views), tuple(sigma.tolist()))


_Solution = tuple[MatLike, MatLike, Sequence[MatLike], Sequence[MatLike]]
"""Camera matrix, distortion, and rotation vectors and translations of the views."""


def _solve(views: BoardViews, model: str, name: str) -> tuple[Camera, list[_FittedBoardView]]:
    points, size, lens = views.board.points_m, views.image_size_px, LENS_MODELS[model]
    try:
        solve = _solve_fisheye if lens.opencv == "fisheye" else _solve_standard
        matrix, distortion, rotations, translations = solve(views.views, points, size, lens.calibrated)
        camera = Camera(name, np.asarray(matrix, dtype=float), np.asarray(distortion, dtype=float), model, size)
    except (cv2.error, ValueError) as error:
        expected = "views with different tilts, over the whole picture"
        raise InputError(Problem("pictures", f"{model} model", "no solution", expected)) from error
    fitted = []
    for view, rotation_vector, translation_vector in zip(views.views, rotations, translations, strict=True):
        rotation = np.asarray(cv2.Rodrigues(rotation_vector)[0], dtype=float)
        translation = np.asarray(translation_vector, dtype=float).ravel()
        projected, valid = camera.project(points[view.ids] @ rotation.T + translation)
        # If the lens model folds, there is no projection, and the error is set to a very large finite value.
        residual = np.where(valid[:, None], projected - view.xy_px, math.hypot(*size))
        fitted.append(_FittedBoardView(view.name, view.ids, view.xy_px, rotation, translation, residual, used=True))
    return camera, fitted


def _solve_standard(views: Sequence[BoardView], points: Array, size: tuple[int, int], coefficients: int) -> _Solution:
    """Calibrate with OpenCV's standard lens model, with its first five coefficients or with none."""
    fixed = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    objects = [points[view.ids].astype(np.float32) for view in views]
    images = [view.xy_px.astype(np.float32).reshape(-1, 1, 2) for view in views]
    _, matrix, distortion, rotations, translations = cv2.calibrateCamera(
        objects, images, size, np.eye(3), np.zeros(5), flags=0 if coefficients else fixed, criteria=_CRITERIA
    )
    return matrix, np.ravel(distortion)[:coefficients], rotations, translations


def _solve_fisheye(views: Sequence[BoardView], points: Array, size: tuple[int, int], coefficients: int) -> _Solution:
    """Calibrate with OpenCV's fisheye model from several initial fields of view, as the result depends on them."""
    objects = [points[view.ids].reshape(1, -1, 3) for view in views]
    images = [view.xy_px.reshape(1, -1, 2) for view in views]
    names = ("CALIB_USE_INTRINSIC_GUESS", "CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW")
    # OpenCV 4 has separate flags for fisheye lenses. OpenCV 5 has the same flags for all lenses.
    flags = sum(getattr(cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2, name) for name in names)
    solutions: list[Any] = []
    for field_deg in FISHEYE_STARTS_DEG:
        focal = size[0] / math.radians(field_deg)
        guess = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
        inputs = (objects, images, size, guess, np.zeros(coefficients))
        with suppress(cv2.error):  # some initial values lead to no solution
            solutions.append(cv2.fisheye.calibrate(*inputs, flags=flags, criteria=_CRITERIA))
    finite_solutions = [solution for solution in solutions if math.isfinite(solution[0])]
    if not finite_solutions:
        raise ValueError("no finite solution")
    _, matrix, distortion, rotations, translations = min(finite_solutions, key=lambda solution: solution[0])
    return matrix, np.ravel(distortion), rotations, translations


def _sigma(views: Sequence[_FittedBoardView], points: Array, camera: Camera) -> Array:
    """Return the standard deviations of the camera's parameters, infinite for undetermined parameters.

    The unknowns are the parameters and the poses. The variance of the residuals is their sum of squares divided by the
    degrees of freedom.
    """
    by_camera, by_pose = zip(*(_jacobian(view, points, camera) for view in views), strict=True)
    jacobian = np.hstack([np.vstack(by_camera), block_diag(*by_pose)])
    residual, n = np.concatenate([view.residual_px for view in views]), 4 + camera.distortion.size
    # Columns are scaled because lens coefficients and pixels differ by many orders of magnitude.
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-150)
    try:
        inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    except np.linalg.LinAlgError:
        return np.full(n, np.inf)
    diagonal, variance = np.diag(inverse)[:n], np.sum(residual**2) / max(1, residual.size - len(scale))
    return np.where(diagonal > 0, np.sqrt(variance * np.abs(diagonal)) / scale[:n], np.inf)


def _jacobian(view: _FittedBoardView, points: Array, camera: Camera) -> tuple[Array, Array]:
    """Return the derivatives of a view's pixels with respect to camera (2N, 4 + coefficients) and pose (2N, 6)."""
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


Verdict = Literal["ok", "warning", "refused"]


@dataclass(frozen=True)
class _CalibrationCheck:
    """Measured value of one property of a calibration, with its limits."""

    name: str
    quantity: str
    unit: str
    warn: float
    """Limit beyond which there is a warning: a minimum if `at_least`, otherwise a maximum."""
    refuse: float
    """Limit beyond which the calibration is refused: a minimum if `at_least`, otherwise a maximum."""
    at_least: bool
    advice: str
    value: float

    @property
    def verdict(self) -> Verdict:
        """Return whether the value is within its limits (ok), beyond the first (warning) or the second (refused)."""
        if self._beyond(self.refuse):
            return "refused"
        return "warning" if self._beyond(self.warn) else "ok"

    def _beyond(self, bound: float) -> bool:
        """Return whether the value is beyond a bound. NaN is beyond every bound, and nothing is beyond a NaN bound."""
        return not math.isnan(bound) and not (self.value >= bound if self.at_least else self.value <= bound)

    def __str__(self) -> str:
        """Return the measured value and, if it is beyond a limit, the limit, the difference and advice."""
        bound = self.refuse if self.verdict == "refused" else self.warn
        unit = f" {self.unit}" if self.unit else ""
        if self.verdict == "ok":
            return f"{self.name}: {self.quantity} {self.value:.3g}{unit}"
        side = "at least" if self.at_least else "at most"
        return (
            f"{self.name}: {self.quantity} {self.value:.3g}{unit}, {side} {bound:g}{unit} needed "
            f"({abs(self.value - bound):.2g} {'short' if self.at_least else 'over'}): {self.advice}"
        )


LIMITS = (
    # Three pictures determine the matrix, and two more the lens. With six, an error in one of them is still visible.
    ("images", "pictures used", "", 10, 6, True, "take more pictures"),
    # If one in four is an outlier, the median itself is uncertain.
    ("dropped", "pictures left out as outliers", "%", 10, 25, False, "keep the board flat and still"),
    # Corners are detected to within 0.05 to 0.3 px. Larger errors mean a wrong lens model or board. Pictures wider than
    # 1920 px are scaled to that width.
    ("rms", "reprojection error (in pictures scaled to at most 1920 px)", "px", 0.5, 1.0, False,
     "check --board, --model, and that the board is flat"),
    # The lens is measured inside this area and extrapolated by polynomials outside it.
    ("coverage", "fraction of the picture that the board covered", "%", 60, 30, True,
     "move the board over the whole picture"),
    # The distortion is largest at the borders.
    ("border", "widest strip along a border without a corner", "% of the side", 12, math.nan, False,
     "hold the board at the borders, partly outside if it is a ChArUco board"),
    # Parallel boards cannot distinguish a longer focal length from a longer distance.
    ("tilt", "largest angle between two boards", "degrees", 40, 20, True, "tilt the board by 30 to 45 degrees"),
    # If boards are tilted about one axis only, perspective determines only one of fx and fy.
    ("tilt axes", "spread of the tilt in its least varied direction", "degrees", 6, 2, True,
     "tilt the board sideways as well as forwards"),
    # Errors of the lens model are not included. The true error may be three times as large.
    ("focal length", "standard deviation of fx or fy", "%", 0.3, 1.0, False, "take more pictures, closer and tilted"),
    ("principal point", "standard deviation of cx or cy", "% of the width", 0.3, 1.0, False,
     "take more pictures, tilted and at the borders"),
    # The pixels of modern sensors are square to within 0.1 %.
    ("aspect", "difference between fx and fy", "%", 0.5, 5.0, False, "check that the video is not stretched"),
    # Lenses are centred to within about 2 %.
    ("centre", "distance of the principal point from the middle", "% of the width", 5, 15, False,
     "check that the picture is not cropped"),
    # No ray exists where the fitted polynomial is not monotonic. A circular fisheye picture always has such corners.
    ("folded", "part of the picture without a ray in the lens model", "%", 0.0, 5.0, False,
     "cover the borders, or use another --model"),
)  # fmt: skip
"""Fields of each `_CalibrationCheck`, without the measured value."""


def check(calibration: Calibration) -> tuple[_CalibrationCheck, ...]:
    """Compare a calibration with every limit in `LIMITS`, and return the checks."""
    measured = _pictures_measured(calibration) | _lens_measured(calibration)
    return tuple(_CalibrationCheck(*limit, value=float(measured[limit[0]])) for limit in LIMITS)


def _pictures_measured(calibration: Calibration) -> dict[str, float]:
    """Return the measured quantities of `LIMITS` that describe the pictures, keyed by their names."""
    used, (width, height) = calibration.used, calibration.camera.image_size_px
    corners = np.concatenate([view.xy_px for view in used])
    gaps = [*(corners.min(axis=0) / (width, height)), *(1 - (corners.max(axis=0) + 1) / (width, height))]
    # All normals point away from the camera. Their first two coordinates are sines of the tilt about the two axes.
    normals = np.array([view.rotation[:, 2] * np.sign(view.rotation[2, 2] or 1.0) for view in used])
    angles = np.arccos(np.clip(normals @ normals.T, -1, 1))
    least_variance = np.linalg.eigvalsh(np.cov(normals[:, :2].T, bias=True))[0]
    return {
        "images": len(used),
        "dropped": 100 * (1 - len(used) / len(calibration.views)),
        "rms": calibration.rms_px / max(1.0, max(width, height) / 1920),
        "coverage": 100 * coverage(calibration).mean(),
        "border": 100 * max(0.0, *gaps),
        "tilt": math.degrees(angles.max()),
        "tilt axes": math.degrees(math.sqrt(max(0.0, least_variance))),
    }


def _lens_measured(calibration: Calibration) -> dict[str, float]:
    """Return the measured quantities of `LIMITS` that describe the lens, keyed by their names."""
    values, sigma = calibration.parameters, calibration.sigma
    width, height = calibration.camera.image_size_px
    y, x = np.mgrid[0 : height - 1 : 41j, 0 : width - 1 : 41j]
    has_ray = calibration.camera.rays(np.stack((x, y), axis=-1))[1]
    return {
        "focal length": 100 * max(sigma[0] / values["fx"], sigma[1] / values["fy"]),
        "principal point": 100 * max(sigma[2:4]) / width,
        "aspect": 100 * abs(values["fx"] / values["fy"] - 1),
        "centre": 100 * math.hypot(values["cx"] - (width - 1) / 2, values["cy"] - (height - 1) / 2) / width,
        "folded": 100 * (1 - has_ray.mean()),
    }


def coverage(calibration: Calibration) -> Bools:
    """Return a mask (rows, columns) of the cells of the picture that the corners of a used picture surround."""
    width, height = calibration.camera.image_size_px
    scale = COVERAGE_COLUMNS / width
    mask = np.zeros((max(1, round(height * scale)), COVERAGE_COLUMNS), dtype=np.uint8)
    for view in calibration.used:
        hull = cv2.convexHull(((view.xy_px + 0.5) * scale - 0.5).astype(np.float32))
        cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
    return mask.astype(bool)
