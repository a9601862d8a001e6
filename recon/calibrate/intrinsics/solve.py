"""From views of a board to a camera: OpenCV's solvers, what they leave over, and how certain the result is.

Model of a corner: the board's point through the view's pose (6 unknowns for each view), the lens and the matrix. OpenCV
finds the least squares. The residuals are those of `Camera.project`, the model that the rest of the
package uses, so that a difference between the two would show as an error.

A picture whose error (root mean square over its corners) is more than `DROP_FACTOR` times that of the median picture
is left out, and the rest solved again, up to `ROUNDS` times. Errors of good pictures lie within a factor of two of the
median, whatever the lens; a picture beyond three has moved, bent or wrongly read corners, and since least squares are
not robust, one of those moves the focal length by more than all others determine it. Errors below `DROP_FLOOR_PX` are
those of a good detector and never dropped. Dropped pictures are listed with their error under the final camera.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.calibrate.intrinsics.board import Board
from recon.calibrate.intrinsics.views import BoardView, BoardViews
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
    points = views.board.points_m
    used = views.views
    camera, fitted = _solve(used, points, views.image_size_px, model, name)
    for _ in range(ROUNDS):
        errors = np.array([view.rms_px for view in fitted])
        good = errors <= max(DROP_FACTOR * float(np.median(errors)), DROP_FLOOR_PX)
        if good.all() or good.sum() < MIN_VIEWS:
            break
        used = [view for view, is_good in zip(used, good, strict=True) if is_good]
        camera, fitted = _solve(used, points, views.image_size_px, model, name)
    every = {view.name: view for view in fitted}
    for view in views.views:
        if view.name not in every:
            every[view.name] = replace(_fitted_view(view, points, camera, *_pose(view, points, camera)), used=False)
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


def _pose(view: BoardView, points: Array, camera: Camera) -> tuple[Array, Array]:
    """Pose of the board in a picture that the camera was not found from."""
    rays, valid = camera.rays(view.xy_px)
    flat = rays[valid, :2] / rays[valid, 2:]
    objects = points[view.ids][valid]
    if len(flat) >= 4:
        found, rotation, translation = cv2.solvePnP(objects, flat, np.eye(3), None)
        if found:
            return np.asarray(rotation, dtype=float), np.asarray(translation, dtype=float)
    return np.zeros(3), np.array([0.0, 0.0, 1.0])


def _sigma(views: Sequence[_FittedBoardView], points: Array, camera: Camera) -> Array:
    """Standard deviations of the camera's parameters, with the poses marginalised.

    With the Jacobian [A B] of a view's residuals to camera and pose, the information about the camera is the sum of
    A'A - A'B (B'B)^-1 B'A, and the variance of a residual their sum of squares over the degrees of freedom.
    """
    n = 4 + camera.distortion.size
    information = np.zeros((n, n))
    squares, count = 0.0, 0
    for view in views:
        a, b = _jacobian(view, points, camera)
        cross = b.T @ a
        information += a.T @ a - cross.T @ np.linalg.lstsq(b.T @ b, cross, rcond=None)[0]
        squares += float((view.residual_px**2).sum())
        count += view.residual_px.size
    variance = squares / max(1, count - n - 6 * len(views))
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))  # coefficients and pixels differ by many orders
    try:
        inverse = np.linalg.inv(information * np.outer(scale, scale))
    except np.linalg.LinAlgError:
        return np.full(n, np.inf)
    diagonal = np.diag(inverse)
    return np.where(diagonal > 0, np.sqrt(variance * np.abs(diagonal)) * scale, np.inf)


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
