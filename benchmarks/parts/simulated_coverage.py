"""Test stated uncertainties by drawing the truth from the prior: simulation-based calibration.

    python benchmarks/parts/simulated_coverage.py [--clips 200] [--skeleton cheetah-24] [--seed 0] [--motion-s 0.16]
        [--noise-s 0.16]
    python benchmarks/parts/simulated_coverage.py --recorded dog|cheetah [--clips 200] [--noise-s 0.16]

Each clip draws a motion, a size, a camera and a detector's errors as the trajectory method expects them, and is fitted.

- angles: from the product of the Gaussians of the pose prior and the motion prior, widened so that `ERROR_TIME_S` of
  the clip carries the information that the stated uncertainty assumes
- path: straight, at 6 to 14 m/s, in all directions
- camera: 40 to 100 degrees wide; the animal is 3 to 12 m away and up to 1.5 m below
- detections: noise with a correlation time, keypoint bias, the camera's time offset, 5 % of gross outliers, and
  randomly missing points

If the uncertainty is right, the 50 and 90 % regions contain the truth in 50 and 90 % of the cases, and the rank of the
true distance in its distribution is uniform (Kolmogorov-Smirnov, p > 0.05).

With --recorded, the motions of real animals are turned about the vertical, and everything else is drawn. The recordings
are the motion capture of `dog.py`, without a learned prior, or the runs of `cameras.py`.

The solution is the joint maximum of motion and distance. At smaller distances, the same pixels need smaller angles,
which the prior prefers, although fewer motions fit. The marginal distribution of the distance accounts for this by the
determinant of the normal equations. The column "mode" has the expected shift of the distance from this effect; ranks
are also given without the shift. A motion drawn as widely as the uncertainty assumes (0.16 s) has a larger misfit than
real motions; --motion-s 0.04 gives the misfit of real motions. The noise of real detections lasts for some frames, as
with --noise-s 0.035.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import multiprocessing
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial

import dog
import numpy as np
from arguments import parser_of, runs_of
from cameras import PRIOR, run_of, states_of
from markdown_table import print_table
from recordings import recordings
from scipy.stats import kstest
from trajectory import body_of, prior_of

from recon import Body, Camera, load_skeleton
from recon.animal.prior import ANGLES, MotionPrior, builtin_priors, load_prior, prior_from_body
from recon.animal.prior_fit import as_one_gaussian
from recon.animal.skeleton_file import with_detector_offsets
from recon.base.errors import InputError
from recon.clip import View, still_view
from recon.fit import constants
from recon.fit.banded import factored
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.segment import SegmentFit
from recon.fit.terms import dynamics_term, pose_term
from recon.fit.trajectory import solve_segments, solve_trajectory
from recon.geometry.kinematics import ROOT, YAW
from recon.testing.coverage import coverage, cumulative

FPS, T = 90.0, 36
OUTLIERS, MISSING = 0.05, 0.1
END_ON_DEG = 30.0
STEP = 0.02
"""Step, in the logarithm of the distance, of a numerical derivative."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A simulated or recorded motion of n frames, with the body and the prior of its fit."""

    body: Body
    prior: MotionPrior
    fps: float
    points_m: np.ndarray
    """Positions (n, J, 3) of the body's markers at nominal size, relative to the middle of the path, metres."""
    marked_m: np.ndarray
    """Positions (n, J, 3) of the points that the detector marks, metres."""


@cache
def model(skeleton: str) -> tuple[Body, MotionPrior]:
    body = load_skeleton(skeleton)
    if not isinstance(body, Body):
        raise SystemExit(f"{skeleton}: expected a whole animal")
    marked = body
    with suppress(InputError):  # the detector is for another animal
        marked = with_detector_offsets(body, "acinoset")
    for name in builtin_priors():
        with suppress(InputError):  # the prior is for another animal
            return marked, as_one_gaussian(load_prior(name, body))
    return marked, prior_from_body(body)


def extent(body: Body) -> float:
    """Return the mean distance of a body's joints from the root at the zero pose, in units of half a metre."""
    return float(np.linalg.norm(body.tree.pose(np.zeros((1, body.n_state))).points_m[0], axis=1).mean()) / 0.5


def draw_motion(skeleton: str, motion_s: float, rng: np.random.Generator) -> Motion:
    (body, prior), alike = model(skeleton), max(motion_s * FPS, 1.0)
    A, D = len(prior.mean), body.n_state
    rows = []
    for term in (pose_term(prior, D, FPS, 1.0), dynamics_term(prior, D, FPS, 1.0)):
        for frame in term.frames(T):
            row = np.zeros((len(term.target), T, A))
            for offset, slot in zip(term.stencil, term.slots, strict=True):
                row[:, frame + offset] = slot[:, ANGLES]
            rows.append(row.reshape(-1, T * A))
    precision = np.concatenate(rows).T @ np.concatenate(rows)
    z = np.linalg.solve(np.linalg.cholesky(precision).T, rng.normal(size=T * A)) * np.sqrt(alike)
    states, heading_rad = np.zeros((T, D)), rng.uniform(-np.pi, np.pi)
    states[:, ANGLES] = prior.mean + z.reshape(T, A)
    along = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    states[:, ROOT] = extent(body) * np.outer((np.arange(T) - T / 2) / FPS * rng.uniform(6.0, 14.0), along)
    states[:, YAW] = heading_rad
    return Motion(body, prior, FPS, body.tree.pose(states).points_m, body.detected.pose(states).points_m)


@cache
def recorded_motions(animal: str) -> list[Motion]:
    """Load the recorded motions of an animal, without frames that lack a point."""
    if animal == "dog":
        body, prior = model(dog.SKELETON)
        clips = ((clip.fps, clip.markers(body)) for clip in dog.read_clips(recordings("dog-mocap")))
        return [Motion(body, prior, fps, points_m, points_m) for fps, points_m in clips]
    motions = []
    for folder in runs_of(recordings("cheetah-runs").resolve()):
        run = run_of(folder)
        body, known = with_detector_offsets(body_of(run.subject), "acinoset"), np.isfinite(run.truth_m).all(axis=(1, 2))
        marked_m = body.detected.pose(states_of(run, np.zeros(3))).points_m
        motions.append(Motion(body, prior_of(PRIOR), run.fps, run.truth_m[known], marked_m[known]))
    return motions


def recorded(animal: str, rng: np.random.Generator) -> Motion:
    """Draw at most T frames of a recorded motion, and turn them about the vertical at random."""
    motions = recorded_motions(animal)
    whole = motions[rng.integers(len(motions))]
    first = rng.integers(max(len(whole.points_m) - T, 0) + 1)
    turned = rng.uniform(-np.pi, np.pi)
    c, s = np.cos(turned), np.sin(turned)
    points_m, marked_m = (of[first : first + T] for of in (whole.points_m, whole.marked_m))
    about_m, about_z = points_m.mean(axis=(0, 1)), np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return Motion(whole.body, whole.prior, whole.fps, (points_m - about_m) @ about_z, (marked_m - about_m) @ about_z)


def lasting_noise(shape: Sequence[int], alike: float, rng: np.random.Generator) -> np.ndarray:
    """Draw noise (n, ...) of unit variance with a correlation time of `alike` frames."""
    keep = (alike - 1.0) / (alike + 1.0)
    noise = rng.normal(size=shape)
    for t in range(1, len(noise)):
        noise[t] = keep * noise[t - 1] + np.sqrt(1 - keep**2) * noise[t]
    return noise


def one_clip(skeleton: str, motion_s: float, noise_s: float, animal: str | None, seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    camera = Camera.from_hfov(rng.uniform(40.0, 100.0), (1920, 1080))
    motion = recorded(animal, rng) if animal else draw_motion(skeleton, motion_s, rng)
    body, (n, J, _) = motion.body, motion.points_m.shape
    options, scale, size = TrajectoryOptions(ground="none"), extent(body), 1.0 + body.size_sigma * rng.normal()
    blank = still_view(camera, np.zeros((n, J, 2)), np.ones((n, J)))
    setting = ClipProblem.from_views([blank], body, motion.prior, motion.fps, options)
    place_m = scale * np.array([0.0, rng.uniform(3.0, 12.0), -rng.uniform(0.0, 1.5)])
    points_m, marked_m = motion.points_m + place_m, motion.marked_m + place_m
    px_per_m = setting.px_per_m(marked_m)[0]
    late_m = marked_m + constants.TIME_OFFSET_FRAMES * rng.normal() * np.gradient(marked_m, axis=0)
    beside_m = (
        setting.shared_unknowns()[1][-1].sigma.reshape(J, 2)
        * np.sqrt(setting.correlation_frames)
        * rng.normal(size=(J, 2))
    )
    in_frame_m = np.sqrt(np.maximum(setting.in_frame_m**2 - beside_m.var(), 0.0))
    noise_px = np.hypot(options.sigma_px, in_frame_m * px_per_m[:, None])[..., None] * lasting_noise(
        (n, J, 2), max(noise_s * motion.fps, 1.0), rng
    )
    pixels, valid = blank.project(late_m)
    pixels = pixels + px_per_m[:, None, None] * beside_m + noise_px
    gross = rng.uniform(size=(n, J)) < OUTLIERS
    pixels[gross] += rng.uniform(-200, 200, size=(int(gross.sum()), 2))
    gone = (rng.uniform(size=(n, J)) < MISSING) | ~valid | ~camera.in_image(pixels)
    pixels[gone] = np.nan
    view = View(camera, blank.T_camera_world, pixels, (~gone).astype(float))
    rear, front = (points_m[:, body.markers.index(marker)].mean(axis=0) for marker in body.forward)
    x, y = (front - rear)[:2]
    return _scored(ClipProblem.from_views([view], body, motion.prior, motion.fps, options), size * points_m) | {
        "end on": float(abs(x) < np.sin(np.radians(END_ON_DEG)) * np.hypot(x, y)),
        "seen": float(1 - gone.mean()),
    }


def _scored(setting: ClipProblem, truth_m: np.ndarray) -> dict[str, float]:
    body, prior = setting.body, setting.prior
    solution = solve_trajectory(setting.views, body, prior, setting.fps, setting.options)
    off = solution.joints_m - truth_m
    centred = off - off.mean(axis=1, keepdims=True)
    if not np.isfinite(off).all():
        return {}
    row = {}
    tail = [i for i, marker in enumerate(body.markers) if "tail" in marker]
    for what, e, C in (("pose", centred, solution.relative_covariance_m2), ("position", off, solution.covariance_m2)):
        row |= {f"{what} 90": coverage(e, C, 0.9), f"{what} 50": coverage(e, C, 0.5)}
        if what == "pose" and tail:
            row["tail 90"] = coverage(e[:, tail], C[:, tail], 0.9)
    t = len(truth_m) // 2
    j = int(np.argmin(np.linalg.norm(truth_m[t] - truth_m[t].mean(axis=0), axis=1)))
    ray = truth_m[t, j] / np.linalg.norm(truth_m[t, j])
    sigma_m = float(np.sqrt(ray @ solution.covariance_m2[t, j] @ ray))
    found, true = (np.linalg.norm(points[t].mean(axis=0)) for points in (solution.joints_m, truth_m))
    mode = mode_shift(setting, *solve_segments(setting))
    return row | {
        "mpjpe mm": 1000 * float(np.linalg.norm(centred, axis=-1).mean()),
        "rank": cumulative(float(true - found) / sigma_m),
        "rank without": cumulative(float(true - found * np.exp(-mode)) / sigma_m),
        "too far": float(np.log(found / true)),
        "mode": mode,
        "misfit": solution.segments[0].prior_misfit or np.nan,
    }


def mode_shift(setting: ClipProblem, solved: SegmentFit) -> float:
    """Return the expected shift of the log distance from the maximum of its own distribution to the joint maximum.

    The log distance has the density exp(-cost / l) / sqrt(det H). The other unknowns are optimal for each distance, H
    is their normal matrix, and l is the usual squared misfit of a prior that fits. The maximum of the density differs
    from the minimum of the cost by the slope of the log determinant times a variance.
    """
    problem, states = solved.problem, solved.estimate.states

    def at(states: np.ndarray) -> tuple[float, float, np.ndarray]:
        """Return half the log determinant, the variance of the log distance, and the states' derivative by it."""
        middle_m = setting.body.tree.pose(states).points_m.mean(axis=1)
        by_state = np.zeros(states.shape)
        by_state[:, ROOT] = middle_m / np.sum(middle_m**2, axis=1, keepdims=True) / len(states)
        H = factored(problem.normal(states).blocks)
        followed = H.unwhiten(H.whiten(by_state))
        variance = float(np.sum(by_state * followed))
        return float(np.log(H.band[0]).sum() + np.log(variance) / 2), variance, followed / variance

    _, variance, along = at(states)
    slope = (at(states + STEP * along)[0] - at(states - STEP * along)[0]) / (2 * STEP)
    return constants.MISFIT_USUAL * variance * slope


def summary(label: str, rows: Sequence[dict[str, float]]) -> list[object]:
    table = {name: np.array([row.get(name, np.nan) for row in rows]) for name in rows[0]}
    shares = [f"{np.nanmean(table[name]):.0%}" if name in table else "" for name in _SHARES]
    p, p_without = (f"{kstest(table[name], 'uniform').pvalue:.2g}" for name in ("rank", "rank without"))
    far, mode = (f"{np.mean(table[name]):+.1%}" for name in ("too far", "mode"))
    cells = [
        label,
        len(rows),
        f"{np.median(table['misfit']):.1f}",
        *shares,
        far,
        f"{np.mean(table['rank'] < 0.5):.0%}",
    ]
    return [*cells, p, mode, p_without, f"{np.mean(table['mpjpe mm']):.0f}"]


_SHARES = ("pose 90", "pose 50", "tail 90", "position 90", "position 50")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--clips", type=int, default=200)
    parser.add_argument("--skeleton", default="cheetah-24")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--motion-s", type=float, default=constants.ERROR_TIME_S)
    parser.add_argument("--noise-s", type=float, default=constants.ERROR_TIME_S)
    parser.add_argument("--recorded", choices=("dog", "cheetah"))
    given = parser.parse_args()
    with multiprocessing.Pool(2) as pool:
        seeds = range(given.seed, given.seed + given.clips)
        rows = pool.map(
            partial(one_clip, given.skeleton, given.motion_s, given.noise_s, given.recorded), seeds, chunksize=1
        )
    solved = [row for row in rows if "rank" in row]
    print(f"{given.recorded or given.skeleton}: {len(solved)} of {len(rows)} clips with a pose in every frame\n")
    head = ["clips", "number", "misfit", *_SHARES, "too far", "truth nearer", "ranks uniform, p"]
    head += ["mode", "p without", "mpjpe_mm"]
    end_on = [row for row in solved if row["end on"]]
    few = [row for row in solved if row["seen"] < 0.6]
    groups = [("all", solved), ("seen from ahead or behind", end_on), ("less than 60 % of the points", few)]
    print_table(head, [summary(label, of) for label, of in groups if of])


if __name__ == "__main__":
    main()
