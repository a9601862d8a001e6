"""Define motion priors, which state how likely poses are in a kind of motion, and how poses change.

A prior describes the angles z = state[4:] of a body: the root's pitch and roll, and the joints' angles. Built-in priors
are the files in `recon/animal/priors`, .npz without pickles. `recon.animal.prior_fit` creates priors.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import ConfigDict

from recon.animal.body import Body
from recon.base import documents
from recon.base.arrays import Array
from recon.base.documents import FileTable
from recon.base.errors import InputError, Problem, raise_problems

ANGLES = slice(4, None)
"""Columns of the state whose angles a motion prior describes."""
NONE = "none"
"""Name of the prior that consists only of the expected angles in the skeleton file."""
MAX_ABSOLUTE = 1e12
"""Largest absolute value in the arrays of a valid prior. A larger value means that the file is damaged."""
SHAPES = {
    "weights": "K",
    "means": "KA",
    "covariances": "KAA",
    "mean": "A",
    "covariance": "AA",
    "drift": "AB",  # B stands for 2A
    "acceleration_covariance": "AA",
}
"""Shape of each array of a prior, with K components and A angles."""


@dataclass(frozen=True)
class SegmentRow:
    """Continuous segment of motion for fitting a prior; `used` is false if the segment was too slow."""

    name: str
    frames: int
    fps: float
    speed_m_s: float
    used: bool


@dataclass(frozen=True, eq=False)
class MotionPrior:
    """Statistics of the poses and accelerations of A angles in a kind of motion, with a mixture of K Gaussians.

    Raises
    ------
    ValueError
        If an array has the wrong shape, or is not a valid covariance or weight. The error lists every problem.
    """

    name: str
    angles: tuple[str, ...]
    """Names of the A angles, which are `state_names[4:]` of the body."""
    weights: Array
    """Weights of the Gaussians in the mixture of poses, shape (K,), which add up to 1."""
    means: Array
    """Means of the Gaussians in the mixture, shape (K, A), rad."""
    covariances: Array
    """Covariances of the Gaussians in the mixture, shape (K, A, A), rad^2."""
    mean: Array
    """Mean of a single Gaussian of the same poses, shape (A,), rad."""
    covariance: Array
    """Covariance of the single Gaussian, shape (A, A), rad^2."""
    drift: Array
    """Matrix of the linear model of accelerations, d2z/dt2 = drift @ [z - mean, dz/dt] + noise, shape (A, 2A)."""
    acceleration_covariance: Array
    """Covariance of the noise in the linear model of accelerations, rad^2/s^4, shape (A, A)."""
    source: str
    """Description of the data from which the poses were taken."""
    segments: tuple[SegmentRow, ...] = ()
    """Continuous segments of motion that were given to fit the prior, used or not."""

    def __post_init__(self) -> None:
        wrong = array_problems({name: getattr(self, name) for name in SHAPES}, len(self.angles))
        if wrong:
            raise ValueError("; ".join(f"{field}: {value}, expected {expected}" for field, value, expected in wrong))

    @cached_property
    def pose_whitener(self) -> Array:
        """Return the matrix L', where L L' is the inverse of the covariance of the poses, shape (A, A).

        Multiplied by L', a deviation of a pose from the mean has unit covariance.
        """
        return _whitener(self.covariance)

    @cached_property
    def mixture_whiteners(self) -> Array:
        """Return the matrices of `pose_whitener` for the K components of the mixture, shape (K, A, A)."""
        return _whitener(self.covariances)

    @cached_property
    def acceleration_whitener(self) -> Array:
        """Return the matrix of `pose_whitener` for the noise of the accelerations, shape (A, A)."""
        return _whitener(self.acceleration_covariance)

    def with_accelerations(self, scale: Array) -> MotionPrior:
        """Return the prior with the standard deviation of each angle's acceleration multiplied by a factor (A,)."""
        return replace(self, acceleration_covariance=self.acceleration_covariance * np.outer(scale, scale))


def _whitener(covariance: Array) -> Array:
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).swapaxes(-1, -2), dtype=np.float64)


def array_problems(arrays: dict[str, Array], n_angles: int) -> list[tuple[str, str, str]]:
    """Return the problems with the arrays of a prior, each as (field, found, expected)."""
    problems = []
    lengths = {"A": n_angles, "B": 2 * n_angles, "K": len(np.atleast_1d(arrays["weights"]))}
    if not lengths["K"]:
        return [("weights", "no weights", "one number for each component")]
    for name, shape in SHAPES.items():
        array, expected = arrays[name], tuple(lengths[letter] for letter in shape)
        if array.shape != expected:
            problems.append((name, f"shape {array.shape}", f"{expected} for {lengths['K']} components"))
        elif not (np.abs(array) < MAX_ABSOLUTE).all():
            problems.append((name, "numbers that are not finite, or impossibly large", "finite numbers"))
        elif shape.endswith("AA") and not _is_positive_definite(array):
            problems.append((name, "a matrix that is not positive definite", "covariances"))
        elif name == "weights" and ((array < 0).any() or abs(array.sum() - 1) > 1e-5):
            actual = f"weights from {array.min():g} that add up to {array.sum():g}"
            problems.append((name, actual, "weights of at least 0 that add up to 1"))
    return problems


def _is_positive_definite(matrices: Array) -> bool:
    symmetric = np.allclose(matrices, matrices.swapaxes(-1, -2), rtol=0, atol=1e-6 * np.abs(matrices).max())
    return symmetric and bool(np.linalg.eigvalsh(matrices).min() > 0)


def prior_from_body(body: Body) -> MotionPrior:
    """Return a prior of independent angles, with the expected values and standard deviations in the skeleton file."""
    mean, covariance, n = body.mean_rad, np.diag(body.sigma_rad**2), len(body.mean_rad)
    dynamics = np.zeros((n, 2 * n)), np.diag(body.acceleration_rad_s2**2)
    arrays = (np.ones(1), mean[None], covariance[None], mean, covariance, *dynamics)
    return MotionPrior(NONE, body.state_names[ANGLES], *arrays, source=f"skeleton {body.name}")


def mean_speed_m_s(states: Array, fps: float) -> float:
    """Return the mean horizontal speed of the root over states (T, D), m/s; 0 without consecutive frames."""
    steps = np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1) * fps
    return float(np.nanmean(steps)) if np.isfinite(steps).any() else 0.0


_EXPECTED = "a motion prior, as `recon prior fit` writes it"


class _About(FileTable):
    model_config = ConfigDict(extra="ignore", frozen=True)

    format: Literal[1]
    name: str
    source: str
    angles: list[str]
    segments: list[SegmentRow]


def builtin_priors() -> tuple[str, ...]:
    """Return the names of the built-in priors."""
    return documents.builtin_names("animal/priors", ".npz")


def load_prior(name_or_path: str | Path | None, body: Body) -> MotionPrior:
    """Load a prior by its built-in name or from a file.

    The name "none" selects `prior_from_body`. None selects the first built-in prior for a body with the same angles, or
    `prior_from_body` if there is no such prior.

    Raises
    ------
    InputError
        If the file is not a prior for this body. The error lists every problem.
    """
    if name_or_path is None:
        for name in builtin_priors():
            with suppress(InputError):  # the prior belongs to another animal
                return load_prior(name, body)
    if name_or_path is None or str(name_or_path) == NONE:
        return prior_from_body(body)
    read = _builtin_prior if str(name_or_path) in builtin_priors() else _read_prior
    return read(str(name_or_path), body.name, body.state_names[ANGLES])


@cache
def _builtin_prior(name: str, body: str, angles: tuple[str, ...]) -> MotionPrior:
    """Return a built-in prior, which is read only once because each clip of a batch needs it."""
    return _read_prior(name, body, angles)


def _read_prior(name_or_path: str, body: str, angles: tuple[str, ...]) -> MotionPrior:
    names = (*builtin_priors(), NONE)
    content, source = documents.named_file(name_or_path, "animal/priors", ".npz", "--prior", "prior", names)
    with documents.damage_as_input_error(source, _EXPECTED, "file"):
        stored = documents.arrays_of(content, f"{documents.KINDS}U")
        text = str(stored.get("about", ""))
    lacking = [key for key in ("about", *SHAPES) if key not in stored]
    if lacking:
        raise InputError([Problem(source, key, "nothing", _EXPECTED) for key in lacking])
    description = documents.validated(_About, documents.parse_json(text, source, _EXPECTED), source)
    if description.angles != [*angles]:
        missing = [name for name in angles if name not in description.angles]
        extra = [name for name in description.angles if name not in angles]
        differing = (("missing", missing), ("of another body", extra))
        details = [f"{len(names)} {kind} ({', '.join(names[:3])})" for kind, names in differing if names]
        detail = f"{len(description.angles)} angles, {' and '.join(details) or 'in another order'}"
        expected = f"the {len(angles)} angles of {body}, in its order"
        raise InputError(Problem(source, "angles", detail, expected))
    raise_problems(
        Problem(source, key, f"an array of {stored[key].dtype}", "floating-point numbers")
        for key in SHAPES
        if stored[key].dtype.kind != "f"
    )
    with np.errstate(invalid="ignore"):  # damaged floats can be signalling NaNs
        arrays = {key: stored[key].astype(float) for key in SHAPES}
    raise_problems(Problem(source, *misfit) for misfit in array_problems(arrays, len(description.angles)))
    for key in ("covariances", "covariance", "acceleration_covariance"):
        arrays[key] = (arrays[key] + arrays[key].swapaxes(-1, -2)) / 2
    arrays["weights"] = arrays["weights"] / arrays["weights"].sum()
    return MotionPrior(
        description.name,
        tuple(description.angles),
        **arrays,
        source=description.source,
        segments=tuple(description.segments),
    )
