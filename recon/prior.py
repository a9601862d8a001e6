"""What a class of motions looks like: which poses occur, how likely they are, and how they change.

A prior is about a body's angles z = state[4:], the root's pitch and roll and the joints' angles: not about where the
animal is, where it heads or how large it is. Built-in priors are the files of `recon/priors`, statistics only.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recon.body import Body
from recon.errors import InputError, Problem
from recon.files import staged_file, write_bytes

Array = NDArray[np.float64]

ANGLES = slice(4, None)
"""The angles that a prior is about, in the state."""

NONE = "none"
"""The name of the prior that knows the body's own expectations only."""

FRAMES_PER_COMPONENT = 20
"""Fewer would let a component of the mixture be one short piece of one segment."""

POSE_FLOOR_RAD = 0.1
"""Added to the spread of every angle: no reconstruction that a prior is fitted to is exact. Held-out segments like it
best (docs/priors.md)."""
ACCELERATION_FLOOR_RAD_S2 = 10.0
MISSING_BELOW_RAD = 0.01
"""Angles that spread by less are no part of the model that the poses come from."""

_EM_ITERATIONS = 30
_K_MEANS_ITERATIONS = 50
RIDGE_PER_ROW = 0.1
"""Held-out accelerations like it best (docs/priors.md)."""
_FORMAT = 1


@dataclass(frozen=True)
class SegmentRow:
    """One continuous piece of motion that was at hand; used: whether the prior was fitted to it."""

    name: str
    frames: int
    fps: float
    speed_m_s: float
    used: bool


@dataclass(frozen=True, eq=False)
class MotionPrior:
    """Statistics of A angles, with K components.

    angles (A,): their names, state_names[4:] of the body. weights (K,), means (K, A), covariances (K, A, A): Gaussian
    mixture of the poses; mean (A,), covariance (A, A): one Gaussian of the same poses. drift (A, 2A),
    acceleration_covariance (A, A): d2z/dt2 = drift @ [z - mean, dz/dt] + noise, rad/s^2. source: where the poses come
    from; segments: what was at hand. Angles in rad, times in s.

    Raises ValueError, naming everything that does not fit together.
    """

    name: str
    angles: tuple[str, ...]
    weights: Array
    means: Array
    covariances: Array
    mean: Array
    covariance: Array
    drift: Array
    acceleration_covariance: Array
    source: str
    segments: tuple[SegmentRow, ...] = ()

    def __post_init__(self) -> None:
        arrays = {name: getattr(self, name) for name in _SHAPES}
        wrong = [
            f"{field}: {found}, expected {expected}" for field, found, expected in _misfits(arrays, len(self.angles))
        ]
        if wrong:
            raise ValueError("; ".join(wrong))


LARGEST = 1e12
"""Of a number in a prior: more can only be damage."""
_SHAPES = {
    "weights": "K",
    "means": "KA",
    "covariances": "KAA",
    "mean": "A",
    "covariance": "AA",
    "drift": "AB",  # B: 2A
    "acceleration_covariance": "AA",
}
"""The arrays of a prior, with their shapes."""


def _misfits(arrays: dict[str, Array], n_angles: int) -> list[tuple[str, str, str]]:
    """(field, found, expected) of everything that keeps arrays from being a prior of that many angles."""
    problems = []
    lengths = {"A": n_angles, "B": 2 * n_angles, "K": len(np.atleast_1d(arrays["weights"]))}
    if not lengths["K"]:
        return [("weights", "none", "one for each component")]
    for name, shape in _SHAPES.items():
        array, expected = arrays[name], tuple(lengths[letter] for letter in shape)
        if array.shape != expected:
            problems.append((name, f"shape {array.shape}", f"{expected} for {lengths['K']} components"))
        elif not (np.abs(array) < LARGEST).all():
            problems.append((name, "numbers that are not finite, or beyond all reason", "finite numbers"))
        elif shape.endswith("AA") and not _is_positive_definite(array):
            problems.append((name, "a matrix that is not positive definite", "covariances"))
        elif name == "weights" and ((array < 0).any() or abs(array.sum() - 1) > 1e-5):
            problems.append((name, f"{array.min():g} and more, {array.sum():g} in all", "shares of 1"))
    return problems


def _is_positive_definite(matrices: Array) -> bool:
    scale = np.abs(matrices).max()
    if not np.allclose(matrices, matrices.swapaxes(-1, -2), rtol=0, atol=1e-6 * scale):
        return False
    try:
        np.linalg.cholesky(matrices)
    except np.linalg.LinAlgError:
        return False
    return True


def prior_from_body(body: Body) -> MotionPrior:
    """What is used where no prior was learned: each angle on its own, as the skeleton file expects it."""
    covariance = np.diag(body.sigma_rad**2)
    n = len(body.mean_rad)
    return MotionPrior(
        name=NONE,
        angles=body.state_names[ANGLES],
        weights=np.ones(1),
        means=body.mean_rad[None].copy(),
        covariances=covariance[None].copy(),
        mean=body.mean_rad.copy(),
        covariance=covariance,
        drift=np.zeros((n, 2 * n)),
        acceleration_covariance=np.diag(body.acceleration_rad_s2**2),
        source=f"skeleton {body.name}",
    )


# -- fitting ------------------------------------------------------------------------------------------------------


def fit_prior(
    body: Body,
    segments: Sequence[tuple[str, Array, float]],
    name: str = "fitted",
    source: str = "",
    components: int = 16,
    shrink: float = 0.6,
    min_speed_m_s: float = 0.0,
    missing_sigma_rad: float = 0.15,
    apart: Sequence[str] = (),
    seed: int = 0,
) -> MotionPrior:
    """The statistics of segments, each (name, states (T, D), frames per second); NaN frames are left out.

    Every segment counts a second time mirrored left to right. shrink: how far the covariance of a component is moved
    towards the average within all of them. Segments slower than min_speed_m_s are listed, but not used.
    missing_sigma_rad: the spread of angles that do not move in the data. apart: segments of the body, such as a tail,
    whose movement neither follows from the pose nor says anything about the others'; their acceleration is noise.
    Raises InputError where there are too few frames, or apart names what is no segment with angles.
    """
    rows = tuple(
        SegmentRow(label, len(states), float(fps), speed, speed >= min_speed_m_s)
        for label, states, fps in segments
        for speed in [mean_speed_m_s(states, fps)]
    )
    used = [(states, fps) for (_, states, fps), row in zip(segments, rows, strict=True) if row.used]
    poses, (at, rates, accelerations) = _both_ways(body, used)
    n_frames = len(poses) // 2
    problems = []
    if n_frames < components * FRAMES_PER_COMPONENT:
        fits = n_frames // FRAMES_PER_COMPONENT
        expected = f"{FRAMES_PER_COMPONENT} frames for each component" + (f", so at most {fits}" if fits else "")
        problems.append(Problem("prior", "components", f"{components} for {n_frames} frames", expected))
    loose = np.array([name.rsplit("_", 1)[0] in apart for name in body.state_names[ANGLES]])
    for segment in apart:
        if not any(name.rsplit("_", 1)[0] == segment for name in body.state_names[ANGLES]):
            names = dict.fromkeys(name.rsplit("_", 1)[0] for name in body.state_names[ANGLES])
            problems.append(Problem("prior", "apart", repr(segment), f"one of {', '.join(names)}"))
    if not len(accelerations):
        problems.append(Problem("prior", "frames", "no three in a row", "segments without gaps"))
    if problems:
        raise InputError(problems)

    mean = poses.mean(axis=0)
    spread = np.cov(poses.T, bias=True)
    extra = np.diag(POSE_FLOOR_RAD**2 + np.where(_still(poses), missing_sigma_rad**2, 0.0))
    weights, means, covariances = _mixture(poses, components, shrink, extra, np.random.default_rng(seed))
    drift, left = _ridge(np.concatenate([at - mean, rates], axis=1), accelerations, loose)
    return MotionPrior(
        name=name,
        angles=body.state_names[ANGLES],
        weights=weights,
        means=means,
        covariances=covariances,
        mean=mean,
        covariance=spread + extra,
        drift=drift,
        acceleration_covariance=left + ACCELERATION_FLOOR_RAD_S2**2 * np.eye(len(mean)),
        source=source,
        segments=rows,
    )


def mean_speed_m_s(states: Array, fps: float) -> float:
    """Mean horizontal speed of the root over states (T, D), 0 if no two frames follow each other."""
    steps = np.linalg.norm(np.diff(states[:, :2], axis=0), axis=1) * fps
    return float(np.nanmean(steps)) if np.isfinite(steps).any() else 0.0


def log_likelihood(prior: MotionPrior, states: Array) -> float:
    """Mean over frames of the natural logarithm of the mixture's density (per rad^A) at states (T, D)."""
    from scipy.special import logsumexp  # slow to import

    poses = states[np.isfinite(states).all(axis=1)][:, ANGLES]
    return float(logsumexp(_log_densities(poses, prior.weights, prior.means, prior.covariances), axis=1).mean())


def as_one_gaussian(prior: MotionPrior) -> MotionPrior:
    """The same prior with its one Gaussian of poses in the place of the mixture."""
    return replace(prior, weights=np.ones(1), means=prior.mean[None], covariances=prior.covariance[None])


def _both_ways(body: Body, segments: Sequence[tuple[Array, float]]) -> tuple[Array, tuple[Array, Array, Array]]:
    """Poses (N, A); and where three follow each other, poses, rates and accelerations, each (M, A). The second half of
    each is the mirror image of the first."""
    nothing = np.empty((0, body.n_state - 4))
    parts: tuple[list[Array], ...] = ([nothing], [nothing], [nothing], [nothing])
    for states, fps in segments:
        z = states[:, ANGLES]
        whole = np.asarray(np.isfinite(z).all(axis=1))
        inner = np.nonzero(whole[:-2] & whole[1:-1] & whole[2:])[0] + 1
        rates = (z[inner + 1] - z[inner - 1]) * (fps / 2)
        accelerations = (z[inner + 1] - 2 * z[inner] + z[inner - 1]) * fps**2
        for part, values in zip(parts, (z[whole], z[inner], rates, accelerations), strict=True):
            part.append(values)
    permutation, sign = body.mirror
    direct = (np.concatenate(part) for part in parts)
    poses, *moving = (np.concatenate([x, x[:, permutation[ANGLES] - 4] * sign[ANGLES]]) for x in direct)
    at, rates, accelerations = moving
    return poses, (at, rates, accelerations)


def _still(poses: Array) -> NDArray[np.bool_]:
    """(A,): angles that do not move."""
    return poses.std(axis=0) < MISSING_BELOW_RAD


def _mixture(
    poses: Array, components: int, shrink: float, extra: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Weights (K,), means (K, A), covariances (K, A, A) of poses (N, A), by expectation-maximisation."""
    from scipy.special import logsumexp  # slow to import

    nearest = _k_means(poses / np.maximum(poses.std(axis=0), MISSING_BELOW_RAD), components, rng)
    share = np.eye(components)[nearest]
    weights, means, covariances = _maximised(poses, share, shrink, extra)
    for _ in range(_EM_ITERATIONS):
        density = _log_densities(poses, weights, means, covariances)
        share = np.exp(density - logsumexp(density, axis=1, keepdims=True))
        weights, means, covariances = _maximised(poses, share, shrink, extra)
    return weights, means, covariances


def _maximised(poses: Array, share: Array, shrink: float, extra: Array) -> tuple[Array, Array, Array]:
    count = np.maximum(share.sum(axis=0), 1e-9)
    means = share.T @ poses / count[:, None]
    own = np.empty((len(count), poses.shape[1], poses.shape[1]))
    for k, center in enumerate(means):
        off = poses - center
        own[k] = (off * share[:, k, None]).T @ off / count[k]
    weights = count / count.sum()
    within = np.tensordot(weights, own, axes=1)
    return weights, means, (1 - shrink) * own + shrink * within + extra


def _log_densities(poses: Array, weights: Array, means: Array, covariances: Array) -> Array:
    """(N, K): the logarithm of each component's density times its weight."""
    from scipy.linalg import solve_triangular  # slow to import

    densities = np.empty((len(poses), len(weights)))
    for k, (center, root) in enumerate(zip(means, np.linalg.cholesky(covariances), strict=True)):
        white = solve_triangular(root, (poses - center).T, lower=True)
        constant = np.log(np.diagonal(root)).sum() + 0.5 * len(center) * np.log(2 * np.pi)
        densities[:, k] = -0.5 * (white**2).sum(axis=0) - constant
    return densities + np.log(np.maximum(weights, 1e-300))


def _k_means(points: Array, k: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """(N,): the cluster of each point. The first centers are drawn far from each other (k-means++)."""
    centers = points[rng.integers(len(points))][None]
    squares = ((points - centers[0]) ** 2).sum(axis=1)
    for _ in range(k - 1):
        total = squares.sum()
        chance = squares / total if total > 0 else None
        centers = np.concatenate([centers, points[rng.choice(len(points), p=chance)][None]])
        squares = np.minimum(squares, ((points - centers[-1]) ** 2).sum(axis=1))
    nearest = np.full(len(points), -1, dtype=np.intp)
    for _ in range(_K_MEANS_ITERATIONS):
        distance = (centers**2).sum(axis=1) - 2 * points @ centers.T
        before, nearest = nearest, distance.argmin(axis=1)
        if (before == nearest).all():
            break
        for j in range(k):
            if (nearest == j).any():
                centers[j] = points[nearest == j].mean(axis=0)
    return nearest


def _ridge(states: Array, accelerations: Array, loose: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Drift (A, 2A) from states (M, 2A) to accelerations (M, A), and the second moment of what is left (A, A). The
    loose angles (A,) have no part in it."""
    scale = states.std(axis=0)
    n_angles = accelerations.shape[1]
    # What does not move, or only by the noise of the fit, explains nothing.
    moves = np.tile(~_still(states[:, :n_angles]) & ~loose, 2) & (scale > 0)
    scaled = np.where(moves, states / np.where(moves, scale, 1.0), 0.0)
    normal = scaled.T @ scaled + RIDGE_PER_ROW * len(scaled) * np.eye(scaled.shape[1])
    drift = np.linalg.solve(normal, scaled.T @ accelerations).T / np.where(moves, scale, 1.0)
    drift[loose] = 0.0
    left = accelerations - states @ drift.T
    return drift, np.where(loose[:, None] == loose, left.T @ left / len(left), 0.0)


# -- files --------------------------------------------------------------------------------------------------------


def builtin_priors() -> tuple[str, ...]:
    """Names of the priors that come with the package."""
    files = resources.files("recon") / "priors"
    return tuple(sorted(f.name.removesuffix(".npz") for f in files.iterdir() if f.name.endswith(".npz")))


def save_prior(prior: MotionPrior, path: str | Path) -> None:
    """Write an .npz: the arrays in single precision, the texts as JSON, no pickles."""
    path = Path(path)
    about = {
        "format": _FORMAT,
        "name": prior.name,
        "source": prior.source,
        "angles": list(prior.angles),
        "segments": [asdict(row) for row in prior.segments],
    }
    arrays = {name: getattr(prior, name).astype(np.float32) for name in _SHAPES}
    made = io.BytesIO()
    np.savez_compressed(made, about=np.array(json.dumps(about)), **arrays)
    with staged_file(path) as staged:
        write_bytes(staged, made.getvalue())


def load_prior(name_or_path: str | Path, body: Body) -> MotionPrior:
    """The built-in prior of that name, or the one in a file; "none": `prior_from_body`.

    Raises InputError, naming every problem: no such name or file, no prior, or one for other angles than the body's.
    """
    if str(name_or_path) == NONE:
        return prior_from_body(body)
    if str(name_or_path) in builtin_priors():
        content = (resources.files("recon") / "priors" / f"{name_or_path}.npz").read_bytes()
        return _parsed(content, f"prior {name_or_path}", body)
    path = Path(name_or_path)
    if not path.is_file():
        expected = f"one of {', '.join((*builtin_priors(), NONE))}, or a prior file (.npz)"
        raise InputError(Problem("--prior", "name or file", repr(str(name_or_path)), expected))
    return _parsed(path.read_bytes(), str(path), body)


def _parsed(content: bytes, source: str, body: Body) -> MotionPrior:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            stored = {key: file[key] for key in file.files}
    except Exception as error:
        # A damaged file surfaces as almost any exception of zip and numpy.
        raise InputError(Problem(source, "file", f"none that can be read ({error})", _EXPECTED)) from None
    lacking = [key for key in ("about", *_SHAPES) if key not in stored]
    if lacking:
        raise InputError([Problem(source, key, "nothing", _EXPECTED) for key in lacking])
    about, problems = _about(stored["about"], source)
    arrays = {}
    for key in _SHAPES:
        if stored[key].dtype.kind == "f":
            arrays[key] = stored[key].astype(float)
        else:
            problems.append(Problem(source, key, f"an array of {stored[key].dtype}", "floating-point numbers"))
    if about is not None and list(about["angles"]) != list(body.state_names[ANGLES]):
        problems.append(_other_angles(about["angles"], body, source))
    elif about is not None and len(arrays) == len(_SHAPES):
        found = _misfits(arrays, len(about["angles"]))
        problems += [Problem(source, field, what, expected) for field, what, expected in found]
    if about is None or problems:
        raise InputError(problems)
    for key in ("covariances", "covariance", "acceleration_covariance"):
        arrays[key] = (arrays[key] + arrays[key].swapaxes(-1, -2)) / 2
    arrays["weights"] = arrays["weights"] / arrays["weights"].sum()
    segments = tuple(SegmentRow(**row) for row in about["segments"])
    return MotionPrior(about["name"], tuple(about["angles"]), **arrays, source=about["source"], segments=segments)


_EXPECTED = "a motion prior, as `recon prior fit` writes it"


def _about(stored: np.ndarray, source: str) -> tuple[dict | None, list[Problem]]:
    """The texts of a file, None where they are not as they should be."""
    try:
        about = json.loads(str(stored))
    except json.JSONDecodeError:
        return None, [Problem(source, "about", repr(str(stored))[:60], "JSON")]
    if not isinstance(about, dict) or about.get("format") != _FORMAT:
        found = repr(about.get("format")) if isinstance(about, dict) else repr(about)[:60]
        return None, [Problem(source, "about.format", found, f"{_FORMAT}")]
    problems = [
        Problem(source, f"about.{key}", repr(about.get(key))[:60], f"a {kind}")
        for key, kind, right in (
            ("name", "text", isinstance(about.get("name"), str)),
            ("source", "text", isinstance(about.get("source"), str)),
            ("angles", "list of names", _is_list(about.get("angles"), str)),
            ("segments", "list of tables", _is_list(about.get("segments"), dict)),
        )
        if not right
    ]
    if not problems:
        fields = list(SegmentRow.__dataclass_fields__)
        problems = [
            Problem(source, f"about.segments.{i}", ", ".join(row), ", ".join(fields))
            for i, row in enumerate(about["segments"])
            if list(row) != fields
        ]
    return None if problems else about, problems


def _is_list(value: object, kind: type) -> bool:
    return isinstance(value, list) and all(isinstance(item, kind) for item in value)


def _other_angles(angles: Sequence[str], body: Body, source: str) -> Problem:
    expected = body.state_names[ANGLES]
    lacking = [name for name in expected if name not in angles]
    extra = [name for name in angles if name not in expected]
    parts = [
        *([f"{len(lacking)} missing ({_some(lacking)})"] if lacking else []),
        *([f"{len(extra)} of another body ({_some(extra)})"] if extra else []),
    ]
    found = f"{len(angles)} angles, " + (" and ".join(parts) or "in another order")
    return Problem(source, "angles", found, f"the {len(expected)} angles of {body.name}, in its order")


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
