"""Distort and undistort rays by lens models, each of which is a class in the table `LENS_MODELS`.

A lens model converts the normalised coordinates (a, b) = (x/z, y/z) of a point to distorted coordinates, which the
camera matrix converts to pixels. The models are OpenCV's (modules calib3d and fisheye):

- "pinhole": no distortion, no coefficients.
- "radtan": radial-tangential, k1 k2 p1 p2 [k3 [k4 k5 k6]]; with 8 coefficients the radial part is rational.
- "fisheye": equidistant, k1 k2 k3 k4; theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

To add a model, write a class with `distort` and `max_radius`, add it to `LENS_MODELS`, and add a line to
tests/geometry/test_camera.py. OpenSfM's names of lenses are in `recon.io.camera_files`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Polynomial, polynomial

from recon.base.arrays import Array, Bools

_ANGLES = 2048
"""Number of samples of the radial distortion, whose interpolated inverse is the start value of Newton's method."""
_MAX_RADIUS = 1e8
"""Largest radius, in normalised coordinates, at which the radial distortion is sampled."""


class Lens:
    """Base class of lens models, whose instances have the coefficients of one lens."""

    name: ClassVar[str]
    """Name of the lens model in recon's own files and options."""
    coefficients: ClassVar[tuple[str, ...]] = ()
    """Names of all coefficients of the lens model, in OpenCV's order."""
    counts: ClassVar[tuple[int, ...]] = (0,)
    """Allowed numbers of coefficients in a camera file. The other coefficients are then 0."""
    aliases: ClassVar[tuple[str, ...]] = ()
    """Names of the lens model in ROS (`distortion_model`) and other files."""
    colmap: ClassVar[Mapping[str, str]] = {}
    """COLMAP's names of this lens model, each with the model's parameters in COLMAP's order.

    The parameters are f or fx and fy, cx, cy, and names of `coefficients`.
    """
    opencv: ClassVar[Literal["standard", "fisheye"] | None] = None
    """OpenCV's set of functions that calibrates the lens model from pictures of a board; None if there is none."""
    calibrated: ClassVar[int] = 0
    """Number of coefficients that OpenCV's calibration functions estimate."""

    def __init__(self, coefficients: Sequence[float]) -> None:
        self.k = (*coefficients, *[0.0] * (len(self.coefficients) - len(coefficients)))

    @cached_property
    def max_radius(self) -> float:
        """Return the radius sqrt(a^2 + b^2) up to which the distorted radius increases; inf without a limit."""
        return math.inf

    def distort(self, a: Array, b: Array, r2: Array) -> tuple[Any, ...]:
        """Return the distorted coordinates of points, with exact derivatives.

        Parameters
        ----------
        a, b : ndarray
            Normalised coordinates x/z and y/z of the points, shape (N,).
        r2 : ndarray
            Squared radius a^2 + b^2, shape (N,).

        Returns
        -------
        tuple of ndarray
            The distorted coordinates a' and b', and the derivatives da'/da, da'/db and db'/db. In every model, db'/da
            equals da'/db.
        """
        raise NotImplementedError

    @cached_property
    def _radial(self) -> tuple[Array, Array]:
        """Return samples of the distorted radius, and the angles between their rays and the optical axis, rad."""
        angles = np.linspace(0.0, math.atan(min(self.max_radius, _MAX_RADIUS)), _ANGLES)
        r, zero = np.tan(angles), np.zeros(_ANGLES)
        ahead, opposite = (self.distort(a, zero, r * r)[0] for a in (r, -r))
        return 0.5 * (ahead - opposite), angles  # cancels the tangential part, the same on both sides

    def undistort(self, xd: Array, yd: Array) -> tuple[Array, Array, Bools]:
        """Return the undistorted coordinates a and b of points, and whether they exist, each of shape (N,)."""
        radius_d, (radii_d, angles) = np.hypot(xd, yd), self._radial
        scale = np.where(radius_d > 0, np.tan(np.interp(radius_d, radii_d, angles)) / radius_d, 1.0)
        # The tangential distortion can move pixels beyond the largest radius that the radial distortion reaches.
        scale = np.where(radius_d < radii_d[-1], scale, 0.95 * scale)
        a, b, tolerance = scale * xd, scale * yd, 1e-14 * (1 + radius_d)
        # Newton's method for the whole distortion starts from the inverse of the radial distortion.
        error = determinant = np.full(a.shape, np.inf)
        for _ in range(30):
            x, y, d_aa, d_ab, d_bb = self.distort(a, b, a * a + b * b)
            ex, ey = xd - x, yd - y
            error, determinant = np.hypot(ex, ey), d_aa * d_bb - d_ab * d_ab
            if (error <= tolerance).all():
                break
            a, b = a + (d_bb * ex - d_ab * ey) / determinant, b + (d_aa * ey - d_ab * ex) / determinant
        return a, b, (error <= 100 * tolerance) & (determinant > 0) & (np.hypot(a, b) < self.max_radius)


class _RadialTangential(Lens):
    name = "radtan"
    coefficients = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    counts = (4, 5, 8)
    aliases = (
        "plumb_bob",
        "rational_polynomial",
        "radial_tangential",
        "radial-tangential",
        "brown",
        "brown_conrady",
        "brown-conrady",
        "opencv",
        "standard",
    )
    colmap: ClassVar[Mapping[str, str]] = {
        "SIMPLE_RADIAL": "f cx cy k1",
        "RADIAL": "f cx cy k1 k2",
        "OPENCV": "fx fy cx cy k1 k2 p1 p2",
        "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    }
    opencv = "standard"
    calibrated = 5

    @cached_property
    def max_radius(self) -> float:
        k = self.k
        # d(r N/D)/dr has the sign of N D + 2 q (N' D - N D'), q = r^2, up to the first pole of N/D.
        n, d = Polynomial((1, k[0], k[1], k[4])), Polynomial((1, k[5], k[6], k[7]))
        slope = n * d + Polynomial((0, 2)) * (n.deriv() * d - n * d.deriv())
        return math.sqrt(min(_first_positive_root(slope.coef), _first_positive_root(d.coef)))

    def distort(self, a: Array, b: Array, r2: Array) -> tuple[Any, ...]:
        k1, k2, p1, p2, k3, k4, k5, k6 = self.k
        f = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))  # the radial factor; df is its derivative with respect to r2
        df = k1 + r2 * (2 * k2 + r2 * (3 * k3))
        if k4 or k5 or k6:
            denominator = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
            f = f / denominator
            df = (df - f * (k4 + r2 * (2 * k5 + r2 * (3 * k6)))) / denominator
        df2, ab = 2 * df, a * b
        return (
            a * f + 2 * p1 * ab + p2 * (r2 + 2 * a * a),
            b * f + p1 * (r2 + 2 * b * b) + 2 * p2 * ab,
            f + df2 * a * a + 2 * p1 * b + 6 * p2 * a,
            df2 * ab + 2 * p1 * a + 2 * p2 * b,
            f + df2 * b * b + 6 * p1 * b + 2 * p2 * a,
        )


class _Pinhole(Lens):
    name = "pinhole"
    colmap: ClassVar[Mapping[str, str]] = {"SIMPLE_PINHOLE": "f cx cy", "PINHOLE": "fx fy cx cy"}
    opencv = "standard"

    def distort(self, a: Array, b: Array, r2: Array) -> tuple[Any, ...]:
        return a, b, 1.0, 0.0, 1.0

    def undistort(self, xd: Array, yd: Array) -> tuple[Array, Array, Bools]:
        return xd, yd, np.ones(xd.shape, dtype=bool)


class _Fisheye(Lens):
    name = "fisheye"
    coefficients = ("k1", "k2", "k3", "k4")
    counts = (4,)
    aliases = ("equidistant", "equi", "kannala_brandt", "kannala-brandt", "kb4", "opencv_fisheye")
    colmap: ClassVar[Mapping[str, str]] = {"OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4"}
    opencv = "fisheye"
    calibrated = 4

    @cached_property
    def max_radius(self) -> float:
        k = self.k
        theta2 = _first_positive_root((1.0, 3 * k[0], 5 * k[1], 7 * k[2], 9 * k[3]))
        return math.tan(math.sqrt(theta2)) if theta2 < (math.pi / 2) ** 2 else math.inf

    def distort(self, a: Array, b: Array, r2: Array) -> tuple[Any, ...]:
        # The offset avoids 0/0 on the optical axis and is lost in rounding everywhere else.
        r = np.sqrt(r2 + 1e-30)
        k1, k2, k3, k4 = self.k
        t2 = (theta := np.arctan(r)) ** 2
        f = theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))) / r
        slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * (9 * k4))))
        df2 = (slope / (1 + r2) - f) / (r * r)
        return a * f, b * f, f + df2 * a * a, df2 * a * b, f + df2 * b * b


LENS_MODELS: dict[str, type[Lens]] = {lens.name: lens for lens in (_Pinhole, _RadialTangential, _Fisheye)}
"""Class of each lens model, with the model's name as the key."""


def lens_named(text: str) -> str | None:
    """Return recon's name for the lens model that a file calls `text`, or None if recon does not know this model."""
    written = text.strip().replace(" ", "_")
    return next((lens.name for lens in LENS_MODELS.values() if written in (lens.name, *lens.aliases)), None)


# Functions that the models share


def _first_positive_root(coefficients: npt.ArrayLike) -> float:
    """Return the smallest positive real root of a polynomial; inf without such a root.

    The coefficients are in the order of increasing powers.
    """
    array = np.asarray(coefficients, dtype=float)
    trimmed = np.trim_zeros(np.where(np.abs(array) < 1e-100, 0.0, array), "b")  # polyroots divides by the last one
    roots = polynomial.polyroots(trimmed) if trimmed.size > 1 else np.zeros(0)
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(real.min(initial=math.inf))
