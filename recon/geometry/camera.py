"""Project points into a camera with exact derivatives, and turn pixels back into rays.

The camera frame has x to the right, y down and z forward, in metres. The centres of pixels are at whole numbers, and
(0, 0) is the centre of the top left pixel. The pixel (u, v) of a point is given by

    (u, v, 1) = K (x', y', 1),   K = [[fx, s, ox], [0, fy, oy], [0, 0, 1]]

where (x', y') are the normalised coordinates (x/z, y/z) after the distortion of the lens (`recon.geometry.lens`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from recon.base.arrays import Array, Bools, Brief
from recon.base.errors import Problem, raise_problems
from recon.geometry.frames import euler_rotation
from recon.geometry.lens import LENS_MODELS, Lens

MIN_DEPTH_M = 1e-6
MAX_ABSOLUTE = 1e9
"""Largest absolute value that an array of a camera may contain. A larger value means that the file is damaged."""
BLOCKS: dict[str, tuple[tuple[int, ...], str]] = {
    "matrix": ((3, 3), "[[fx, s, ox], [0, fy, oy], [0, 0, 1]], fx and fy > 0"),
    "distortion": ((), "the lens coefficients"),
    "rotation": ((3, 3), "a rotation, world to camera: 3x3 or a Rodrigues vector"),
    "translation_m": ((3,), "a translation of 3 numbers"),
}
"""Shape and meaning of each array of a `Camera`; the shape is () if it depends on the lens model."""
POSE = ("rotation", "translation_m")
TILT = "radians between -pi/2 and pi/2, or 0 if the pose defines the upward direction"


@dataclass(frozen=True, eq=False, repr=False)
class Camera(Brief):
    """Camera matrix, lens distortion, picture size and, if known, pose of one calibrated camera.

    Raises
    ------
    InputError
        If a field of the camera is impossible. The error lists every such field: a wrong shape or number of
        coefficients, a value that is not finite, a focal length or picture size that is not positive, a rotation that
        is not orthonormal and right-handed to 1e-6, a tilt of more than a right angle, or a tilt in addition to a pose
        that defines the upward direction.
    """

    name: str
    """Name of the camera in its calibration file."""
    matrix: Array
    """Camera matrix K, pixels, shape (3, 3), with the skew s = K[0, 1]."""
    distortion: Array
    """Coefficients of the lens model, in OpenCV's order, shape (n,)."""
    model: str
    """Lens model, one of `LENS_MODELS`."""
    image_size_px: tuple[int, int]
    """Width and height of the picture, pixels."""
    rotation: Array | None = None
    """Rotation from the world to the camera frame, shape (3, 3); None if the pose is unknown.

    X_camera = rotation X_world + translation_m.
    """
    translation_m: Array | None = None
    """Position of the world's origin in the camera frame, shape (3,), metres; None if the pose is unknown."""
    world_z_up: bool = True
    """Whether the world's z axis points up; False if a calibration board defines the world."""
    tilt_rad: float = 0.0
    """Angle by which the camera looks down, rad; 0 is level. Used if the pose does not define the upward direction."""

    def __post_init__(self) -> None:
        for field in ("matrix", "distortion", "rotation", "translation_m"):
            value = getattr(self, field)
            if value is not None:
                array = np.array(value, dtype=float)
                array.setflags(write=False)
                object.__setattr__(self, field, array)
        object.__setattr__(self, "image_size_px", tuple(int(n) for n in self.image_size_px))
        raise_problems(Problem(f"camera {self.name!r}", *fault) for fault in self._faults())

    def _faults(self) -> Iterator[tuple[str, str, str]]:
        """Yield the name of each impossible field, its value, and the expected value."""
        sound = set[str]()
        for field, (shape, expected) in BLOCKS.items():
            array = getattr(self, field)
            if array is None:
                if field not in POSE or (self.rotation is None) != (self.translation_m is None):
                    yield field, "nothing", expected
            elif not (np.abs(array) <= MAX_ABSOLUTE).all():
                yield field, f"values up to {np.abs(array).max():g}", expected
            elif array.shape != shape and shape:
                yield field, f"shape {array.shape}", expected
            else:
                sound.add(field)
        k, lens = self.matrix, LENS_MODELS.get(self.model) if isinstance(self.model, str) else None
        if "matrix" in sound and (min(k[0, 0], k[1, 1]) <= 0 or k[1, 0] != 0 or (k[2] != (0, 0, 1)).any()):
            yield "matrix", str(k.tolist()), BLOCKS["matrix"][1]
        if lens is None:
            yield "model", repr(self.model), f"a known lens model: {', '.join(LENS_MODELS)}"
        elif "distortion" in sound and self.distortion.shape not in [(count,) for count in lens.counts]:
            expected = f"{' or '.join(map(str, lens.counts))} coefficients of a {self.model} lens"
            yield "distortion", f"{self.distortion.size} coefficients", expected
        if len(self.image_size_px) != 2 or min(self.image_size_px) <= 0:
            yield "image_size_px", str(self.image_size_px), "a width and a height above 0"
        if "rotation" in sound and not is_rotation(np.asarray(self.rotation), tolerance=1e-6):
            yield "rotation", "a matrix that is not a rotation", "an orthonormal, right-handed matrix"
        if not abs(self.tilt_rad) <= math.pi / 2 or (self.tilt_rad and self.knows_up):
            yield "tilt_rad", repr(self.tilt_rad), TILT

    @classmethod
    def from_hfov(
        cls, hfov_deg: float, image_size_px: tuple[int, int], name: str = "cam1", model: str = "pinhole"
    ) -> Camera:
        """Return a camera with a given horizontal field of view.

        Pixels are square, the principal point is in the middle of the picture, and all coefficients of the lens are 0.

        Parameters
        ----------
        hfov_deg
            Angle between the left and the right edge of the picture, in degrees.
        image_size_px
            Width and height of the picture, pixels.
        name
            Name of the camera.
        model
            Lens model, one of `LENS_MODELS`, such as "fisheye" for an equidistant lens.

        Raises
        ------
        ValueError
            If the field of view is not between 0 and 180 degrees, or the lens model is not known.
        """
        if not 0 < hfov_deg < 180:
            raise ValueError(f"the horizontal field of view must lie between 0 and 180 degrees, got {hfov_deg}")
        if model not in LENS_MODELS:
            raise ValueError(f"the lens model must be one of {', '.join(LENS_MODELS)}, got {model!r}")
        lens, (width, height) = LENS_MODELS[model], image_size_px
        coefficients, edge = np.zeros(lens.counts[0]), math.tan(math.radians(hfov_deg) / 2)
        edge_d, *_ = lens(tuple(coefficients)).distort(np.array(edge), np.array(0.0), np.array(edge * edge))
        focal = 0.5 * width / float(edge_d)
        matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
        return cls(name, matrix, coefficients, model, (width, height))

    # Projection

    def project(self, points_m: npt.ArrayLike) -> tuple[Array, Bools]:
        """Project points in the camera frame to pixels.

        Parameters
        ----------
        points_m : ndarray
            Points in the camera frame, metres, shape (..., 3).

        Returns
        -------
        pixels : ndarray
            Pixels of the points, shape (..., 2); NaN where invalid.
        valid : ndarray
            Whether each point is in front of the camera and within the range in which the distorted radius increases
            with the angle from the optical axis, shape (...). Beyond this range, a polynomial folds points back into
            the picture. A valid point may lie outside the picture (`in_image`).
        """
        pixels, _, valid = self.project_with_jacobian(points_m, jacobian=False)
        return pixels, valid

    def project_with_jacobian(self, points_m: npt.ArrayLike, jacobian: bool = True) -> tuple[Array, Array, Bools]:
        """Project points in the camera frame to pixels, with exact derivatives.

        Returns
        -------
        pixels : ndarray
            Pixels of the points, shape (..., 2), as in `project`.
        by_point : ndarray
            Derivatives of the pixels with respect to the points, px/m, shape (..., 2, 3). The derivatives are zero
            where invalid. The array is empty if `jacobian` is false.
        valid : ndarray
            Whether each point is valid, shape (...), as in `project`.
        """
        points = np.asarray(points_m, dtype=float)
        x, y, z = points.reshape(-1, 3).T
        fx, s, ox, fy, oy = self._intrinsics
        by_point = np.empty((len(z) if jacobian else 0, 2, 3))
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            a, b = x / z, y / z
            r2 = a * a + b * b
            valid = (z > MIN_DEPTH_M) & (r2 < self.lens.max_radius**2)
            xd, yd, d_aa, d_ab, d_bb = self.lens.distort(a, b, r2)
            valid &= d_aa * d_bb > d_ab * d_ab
            pixels = np.stack([fx * xd + (s * yd + ox if s else ox), fy * yd + oy], axis=-1)
            if jacobian:
                gx, gy = fx / z, fy / z
                by_point[:, 0, 0] = gx * d_aa
                by_point[:, 0, 1] = gx * d_ab
                by_point[:, 1, 0] = gy * d_ab
                by_point[:, 1, 1] = gy * d_bb
                if s:
                    by_point[:, 0, 0] += s / z * d_ab
                    by_point[:, 0, 1] += s / z * d_bb
                for row in (0, 1):
                    by_point[:, row, 2] = -(by_point[:, row, 0] * a + by_point[:, row, 1] * b)
        if not valid.all():
            if jacobian:
                by_point[~valid] = 0.0
            pixels[~valid] = np.nan
        shape = points.shape[:-1]
        return pixels.reshape(*shape, 2), by_point.reshape(*(shape if jacobian else (0,)), 2, 3), valid.reshape(shape)

    def in_image(self, pixels: npt.ArrayLike) -> Bools:
        """Return whether pixels (..., 2) lie in the picture, shape (...).

        The edges of the picture are half a pixel outside the outermost pixel centres.
        """
        uv = np.asarray(pixels, dtype=float)
        return np.asarray(((uv >= -0.5) & (uv <= np.array(self.image_size_px) - 0.5)).all(axis=-1))

    def sees(self, pixels: npt.ArrayLike, unzoomed_px: Array | None = None) -> Bools:
        """Return whether detections at pixels (..., 2) are possible, shape (...).

        A detection is possible if the pixel has a ray and is outside the picture by no more than the picture's width
        and height, because trackers and interpolation carry points beyond the edge. Pixels with NaN are not possible.
        If the camera zooms, `unzoomed_px` (..., 2) are the pixels of the same detections without zoom.
        """
        uv, size = np.asarray(pixels, dtype=float), np.array(self.image_size_px)
        seen = np.asarray(((uv >= -size) & (uv <= 2 * size)).all(axis=-1))
        seen[seen] = self.rays((uv if unzoomed_px is None else unzoomed_px)[seen])[1]
        return seen

    # Pixels to rays

    def rays(self, pixels: npt.ArrayLike) -> tuple[Array, Bools]:
        """Return unit vectors in the camera frame along the rays through pixels (..., 2).

        Returns
        -------
        rays : ndarray
            Unit vectors, shape (..., 3); NaN where invalid.
        valid : ndarray
            False for pixels that are NaN, and for pixels to which no point within the range of the lens model
            projects, shape (...).
        """
        uv, (fx, s, ox, fy, oy) = np.asarray(pixels, dtype=float), self._intrinsics
        u, v = uv.reshape(-1, 2).T
        valid = np.isfinite(u) & np.isfinite(v)
        yd = np.where(valid, v - oy, 0.0) / fy
        xd = (np.where(valid, u - ox, 0.0) - s * yd) / fx
        with np.errstate(all="ignore"):
            a, b, solved = self.lens.undistort(xd, yd)
            rays = np.stack((a, b, np.ones_like(a)), axis=-1) / np.hypot(np.hypot(a, b), 1)[:, None]
        valid &= solved
        rays[~valid] = np.nan
        return rays.reshape(*uv.shape[:-1], 3), valid.reshape(uv.shape[:-1])

    @cached_property
    def lens(self) -> Lens:
        """Return the lens model with the camera's coefficients, which distorts and undistorts rays."""
        return LENS_MODELS[self.model](self.distortion.tolist())

    @cached_property
    def _intrinsics(self) -> tuple[float, float, float, float, float]:
        (fx, s, ox), (_, fy, oy), _ = self.matrix.tolist()
        return fx, s, ox, fy, oy

    # Pose

    @property
    def has_extrinsics(self) -> bool:
        """Return whether the camera's pose is known."""
        return self.rotation is not None

    @property
    def knows_up(self) -> bool:
        """Return whether the pose defines the upward direction."""
        return self.rotation is not None and self.world_z_up

    @property
    def up(self) -> Array:
        """Return the upward unit vector (3,) in the camera frame.

        The vector follows from the pose if the world's z axis points up. Otherwise, the camera's x axis is assumed to
        be level and the camera to look down by `tilt_rad`, which gives (0, -1, 0) for a level camera.
        """
        if self.rotation is not None and self.world_z_up:
            return self.rotation[:, 2].copy()
        return np.array((0.0, -math.cos(self.tilt_rad), 0.0 - math.sin(self.tilt_rad)))

    @property
    def centre_world(self) -> Array:
        """Return the centre of projection (3,) in the world frame, metres.

        Raises
        ------
        ValueError
            If the pose is unknown.
        """
        return self.camera_to_world(np.zeros(3))

    def world_to_camera(self, points_m: npt.ArrayLike) -> Array:
        """Transform points (..., 3), metres, from the world to the camera frame.

        Raises
        ------
        ValueError
            If the pose is unknown.
        """
        rotation, translation = self._pose()
        return np.asarray(points_m, dtype=float) @ rotation.T + translation

    def camera_to_world(self, points_m: npt.ArrayLike) -> Array:
        """Transform points (..., 3), metres, from the camera to the world frame.

        Raises
        ------
        ValueError
            If the pose is unknown.
        """
        rotation, translation = self._pose()
        return (np.asarray(points_m, dtype=float) - translation) @ rotation

    def _pose(self) -> tuple[Array, Array]:
        if self.rotation is None or self.translation_m is None:
            raise ValueError(f"camera {self.name!r} has no rotation and translation, so its position is unknown")
        return self.rotation, self.translation_m

    def corrected(self, correction: Array) -> Camera:
        """Return the camera after a correction of its pose by three Euler angles, rad, and a shift, m, shape (6,).

        Points in the camera frame become X_new = R(angles) X + shift, as in `View.corrected`.

        Raises
        ------
        ValueError
            If the pose is unknown.
        """
        rotation, translation = self._pose()
        turn = euler_rotation(correction[:3])
        return replace(self, rotation=turn @ rotation, translation_m=turn @ translation + correction[3:])

    def with_focal_scale(self, log_scale: float) -> Camera:
        """Return the camera with its focal lengths multiplied by exp(log_scale)."""
        matrix = self.matrix.copy()
        matrix[:2, :2] *= math.exp(log_scale)
        return replace(self, matrix=matrix)

    def to_dict(self) -> dict[str, Any]:
        """Return the camera as a dictionary of strings, numbers and lists, without an unknown pose or a zero tilt."""
        names = ("name", "model", "image_size_px", *BLOCKS, *(["tilt_rad"] if self.tilt_rad else []), "world_z_up")
        values = {name: getattr(self, name) for name in names}
        return {name: np.asarray(value).tolist() for name, value in values.items() if value is not None}


def is_rotation(matrix: Array, tolerance: float) -> bool:
    """Return whether a 3x3 matrix is finite, orthonormal and right-handed.

    `tolerance` is the largest allowed absolute value in R R' - I.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        error = np.abs(matrix @ matrix.T - np.eye(3)).max()
    return bool(error <= tolerance and np.linalg.det(matrix) > 0)
