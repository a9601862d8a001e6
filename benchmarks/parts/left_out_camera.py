"""Predict the keypoints of a left-out camera from the other cameras, and compare with triangulation.

    python benchmarks/parts/left_out_camera.py [FOLDER] [--only runs simulated] [--cameras all two one] [--quick]

Each camera of a clip is left out once. The motion is fitted to all other cameras, to two of them, and to one. The
predicted keypoints are projected into the camera that was left out and compared with its detections: median distance in
pixels, over the points that all methods give, and the fraction of detections inside the regions that should contain 90
% of them.

The methods are the fit; robust triangulation (`recon triangulate`); triangulation with smoothing splines; and
aniposelib's optimiser, as in `peers.py`, if it can be installed (`peer_runs.py`). "Two" means the cameras with the most
different directions. With one camera, only the fit is measured.

The clips are the real runs (a folder as in `cheetah_runs.py`, by default the cheetah-runs of $RECON_SHARED_DATA),
without keypoint bias ("none"), with the bias measured in the other runs ("others"), or with the shipped detector file
("acinoset", which was measured on these runs); a recorded rat in simulated cameras, whose skeleton is drafted from an
earlier part of the recording; and a simulated mouse, person and dog whose lengths differ by 10 % from the skeleton's
(`recon.testing.rigs`). The keypoints of the rat and of the simulated animals have a constant bias, and 2 px of noise.
The script runs in one thread.

The first table has a row for each clip, the second a row for each kind of animal. "Worst" is the largest median of the
fit, over the clips of a kind, relative to the best of the other methods.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import pickle
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np
from arguments import parser_of, runs_of
from cameras import as_seen, run_of
from markdown_table import print_header, print_row, print_table
from peer_runs import PeerClip, by_peers, peer_python
from recordings import rat_poses, recordings
from trajectory import PRIOR, SKELETON, prior_of

from recon import Body, load_skeleton
from recon.animal.prior import MotionPrior, prior_from_body
from recon.animal.skeleton_file import with_detector_offsets
from recon.api.skeleton_draft import draft_from_points
from recon.clip import View, still_view
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.prediction import predicted_keypoints
from recon.fit.regions import radius
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.fit.triangulation import Triangulation, smoothed, triangulate_views
from recon.geometry.camera import Camera
from recon.testing.cameras import camera_ring
from recon.testing.rigs import FPS, MISSING, SIGMA_PX, random_clip

METHODS = "fit", "triangulated", "with splines", "aniposelib"
RAT_FPS = 50.0
"""Frame rate of the rat's recording, frames per second."""
RAT_DRAFT = slice(0, 500)
"""Frames of the rat's recording from which the skeleton is drafted."""
RAT_CLIP = slice(700, 800)
"""Frames of the rat's clip, none of which is used to draft the skeleton."""
RAT_LENGTH_M = 0.2
"""Length of the rat, metres."""
RAT_BIAS_M = 0.005
"""Standard deviation of the rat's keypoint bias along each axis, metres."""


@dataclass(frozen=True, eq=False)
class Clip:
    """A clip whose cameras are left out one after the other."""

    kind: str
    name: str
    views: list[View]
    body: Body
    prior: MotionPrior
    fps: float
    fast: bool


@dataclass(frozen=True, eq=False)
class Task:
    """Cameras of a clip to leave out, one after the other."""

    clip: Clip
    cameras: str
    """Which of the other cameras are used: all, two or one."""
    outs: tuple[int, ...]
    peer_m: dict[int, np.ndarray] = field(default_factory=dict)
    """Positions (T, J, 3) from aniposelib, metres, keyed by the camera that is left out."""


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted keypoints (T, J, 2) of a view, with covariances (T, J, 2, 2) or None."""

    xy_px: np.ndarray
    covariance_px2: np.ndarray | None = None


def triangulated_prediction(result: Triangulation, view: View) -> Prediction:
    safe = np.nan_to_num(result.points_m)
    projected, by_point, valid = view.project_with_jacobian(view.shift_to_exposure(safe))
    is_known = valid & np.isfinite(result.points_m[..., 0])
    covariance = by_point @ result.covariance_m2 @ by_point.swapaxes(-1, -2)
    covariance = covariance + (result.sigma_px**2)[:, None, None] * np.eye(2)
    return Prediction(np.where(is_known[..., None], projected, np.nan), covariance)


def predictions(
    clip: Clip, seen: Sequence[int], out: int, peer_m: np.ndarray | None, kept: Path | None
) -> tuple[dict[str, Prediction], float]:
    """Predict a left-out camera's keypoints by each method, and return them with the duration of the fit, seconds.

    `peer_m` has the positions (T, J, 3) from aniposelib, metres, or is None.

    `seen` are the indices of the cameras that are used, and `out` is the index of the left-out camera. `kept` is a file
    for the solution of the fit, or None.
    """
    views, view, made = [clip.views[c] for c in seen], clip.views[out], {}
    solution = solved(clip, views, kept)
    seconds = solution.stage_s["all"]
    made["fit"] = Prediction(*predicted_keypoints(solution, view, clip.fps))
    if len(seen) > 1:
        result = triangulate_views(views)
        made["triangulated"] = triangulated_prediction(result, view)
        made["with splines"] = triangulated_prediction(smoothed(result, clip.fps), view)
        if peer_m is not None:
            projected, valid = view.project(view.shift_to_exposure(np.nan_to_num(peer_m)))
            is_known = valid & np.isfinite(peer_m[..., 0])
            made["aniposelib"] = Prediction(np.where(is_known[..., None], projected, np.nan))
    return made, seconds


def solved(clip: Clip, views: Sequence[View], kept: Path | None) -> TrajectorySolution:
    """Fit the motion to some views, or read the fit from a file that an earlier run of this script wrote."""
    if kept is not None and kept.is_file():
        return pickle.loads(kept.read_bytes())  # files that this script wrote
    solution = solve_trajectory(views, clip.body, clip.prior, clip.fps, TrajectoryOptions(fast=clip.fast))
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(pickle.dumps(solution))
    return solution


def choices(clip: Clip, out: int, cameras: str) -> list[int]:
    others = [c for c in range(len(clip.views)) if c != out]
    if cameras == "all":
        return others
    middle = np.nanmean(triangulate_views(clip.views).points_m, axis=(0, 1))
    towards = [view.centre_m.mean(axis=0) - middle for view in clip.views]
    unit = [d / np.linalg.norm(d) for d in towards]
    if cameras == "one":
        return [max(others, key=lambda c: float(np.isfinite(clip.views[c].xy_px[..., 0]).sum()))]
    return list(min(combinations(others, 2), key=lambda pair: abs(float(unit[pair[0]] @ unit[pair[1]]))))


@dataclass(eq=False)
class Score:
    """Errors of all methods in cameras that were left out."""

    errors_px: dict[str, list[np.ndarray]] = field(default_factory=dict)
    """Errors (n,) of each method, pixels, over the points that all methods give."""
    is_inside: dict[str, list[np.ndarray]] = field(default_factory=dict)
    """Whether each detection is inside the 90 % region that a method predicts."""
    seconds: list[float] = field(default_factory=list)
    """Durations of the fits, seconds."""

    def median_px(self, method: str) -> float:
        """Return the median error of a method, pixels, or NaN if the method was not run."""
        return float(np.median(np.concatenate(self.errors_px[method]))) if method in self.errors_px else np.nan

    def inside(self, method: str) -> float:
        """Return the fraction of detections inside the 90 % regions of a method."""
        return float(np.mean(np.concatenate(self.is_inside[method]))) if method in self.is_inside else np.nan

    @property
    def ratio(self) -> float:
        """Return the fit's median error relative to the best other method, NaN if there is no other method."""
        others = [self.median_px(method) for method in METHODS[1:] if method in self.errors_px]
        return self.median_px("fit") / min(others) if others else np.nan

    @property
    def cells(self) -> tuple[str, ...]:
        """Return the cells of the table's row, in the order of `COLUMNS`."""
        medians = [number_text(self.median_px(method)) for method in METHODS]
        shares = [number_text(100 * self.inside(method), 0) for method in (METHODS[0], METHODS[2])]
        return (*medians, number_text(self.ratio), *shares)


COLUMNS = (
    *(f"{method}, px" for method in METHODS),
    "fit / best other",
    "fit inside 90 % regions, %",
    "splines inside 90 % regions, %",
)


def number_text(value: float, digits: int = 2) -> str:
    """Format a number with a fixed number of decimals, or as an empty string if it is unknown."""
    return f"{value:.{digits}f}" if np.isfinite(value) else ""


def scored(task: Task, solutions: Path | None) -> Score:
    """Leave out the cameras of a task one after the other, and return the errors of all methods."""
    clip, cameras = task.clip, task.cameras
    score = Score()
    for out in task.outs:
        view = clip.views[out].mask_outside_image()
        kept = None if solutions is None else solutions / f"{clip.kind}, {clip.name}, {out}, {cameras}.pkl"
        made, seconds = predictions(clip, choices(clip, out, cameras), out, task.peer_m.get(out), kept)
        score.seconds.append(seconds)
        off = {name: prediction.xy_px - view.xy_px for name, prediction in made.items()}
        common = np.all([np.isfinite(e[..., 0]) for e in off.values()], axis=0)
        for name, e in off.items():
            score.errors_px.setdefault(name, []).append(np.linalg.norm(e, axis=-1)[common])
            covariance = made[name].covariance_px2
            if covariance is not None:
                square = np.einsum("na,nab,nb->n", e[common], np.linalg.inv(covariance[common]), e[common])
                score.is_inside.setdefault(name, []).append(square < radius(0.9, 2) ** 2)
    return score


def together(scores: Iterable[Score]) -> Score:
    """Combine several scores into a single score."""
    total = Score()
    for score in scores:
        for mine, parts in ((total.errors_px, score.errors_px), (total.is_inside, score.is_inside)):
            for name, arrays in parts.items():
                mine.setdefault(name, []).extend(arrays)
        total.seconds += score.seconds
    return total


def real_clips(folder: Path, detectors: Sequence[str], quick: bool) -> Iterator[Clip]:
    """Yield a clip for each real run and each detector."""
    body, runs = load_skeleton(SKELETON), [run_of(path) for path in runs_of(folder.resolve())]
    for run in runs:
        for detector in detectors:
            seen = as_seen(body, run, runs, posed=True) if detector == "others" else None
            seen = seen or with_detector_offsets(body, detector)
            kind = f"cheetah, detector {detector}"
            yield Clip(kind, run.folder.name, list(run.views.values()), seen, prior_of(PRIOR), run.fps, quick)


def simulated_clips(quick: bool) -> Iterator[Clip]:
    """Yield clips of simulated animals whose lengths differ from their skeletons'."""
    for name, skeleton in (("mouse", "mouse-top"), ("person", "human-25"), ("dog", "dog-27")):
        body = load_skeleton(skeleton)
        for seed in range(1 if quick else 2):
            views, _ = random_clip(body, 0.1, 4, seed)
            yield Clip(f"simulated {name}", f"{name} {seed + 1}", views, body, prior_from_body(body), FPS, quick)


def rat_clips(quick: bool) -> Iterator[Clip]:
    """Yield clips of the recorded rat, seen by simulated cameras."""
    names, points_m = rat_poses()
    trunk = names.index("SpineL"), names.index("SpineF")
    for seed in range(1 if quick else 2):
        random = np.random.default_rng(seed)
        detected_m = points_m + in_trunk(points_m, trunk, random.normal(0, RAT_BIAS_M, (len(names), 3)))
        middle = np.mean(points_m[RAT_CLIP], axis=(0, 1)) * (1, 1, 0)
        cameras = camera_ring(4, RAT_LENGTH_M, random)
        frames, past = (
            [seen_by(camera, detected_m[part] - middle, random) for camera in cameras] for part in (RAT_CLIP, RAT_DRAFT)
        )
        drafted_m = triangulate_views(past).points_m
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "rat.toml"
            path.write_text(draft_from_points(names, drafted_m, RAT_FPS, "rat", Path("rat.csv"))[1], encoding="utf-8")
            body = load_skeleton(path)
        order = [names.index(marker) for marker in body.markers]
        views = [replace(v, xy_px=v.xy_px[:, order], confidence=v.confidence[:, order]) for v in frames]
        yield Clip("recorded rat", f"rat {seed + 1}", views, body, prior_from_body(body), RAT_FPS, quick)


def in_trunk(points_m: np.ndarray, trunk: tuple[int, int], offsets_m: np.ndarray) -> np.ndarray:
    """Turn keypoint offsets (J, 3), metres, with the heading of the trunk, and return them as (T, J, 3).

    `trunk` has the indices of the points (T, J, 3) at the rear and at the front end of the trunk.
    """
    ahead = points_m[:, trunk[1]] - points_m[:, trunk[0]]
    c, s = (ahead[:, :2] / np.linalg.norm(ahead[:, :2], axis=1, keepdims=True)).T[..., None]
    x, y, z = np.broadcast_to(offsets_m, points_m.shape).transpose(2, 0, 1)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=2)


def seen_by(camera: Camera, points_m: np.ndarray, random: np.random.Generator) -> View:
    """Simulate a camera's detections of points (T, J, 3), metres, with noise and gaps."""
    xy_px, valid = camera.project(camera.world_to_camera(points_m))
    xy_px = xy_px + random.normal(0, SIGMA_PX, xy_px.shape)
    present = valid & (random.uniform(size=valid.shape) > MISSING)
    return still_view(camera, np.where(present[..., None], xy_px, np.nan), present.astype(float))


def clips_of(options: argparse.Namespace) -> Iterator[Clip]:
    """Yield the clips that the command line selects."""
    if "runs" in options.only:
        yield from real_clips(options.folder, options.detectors, options.quick)
    if "simulated" in options.only:
        yield from simulated_clips(options.quick)
    if "rat" in options.only and recordings("rat-poses").is_dir():
        yield from rat_clips(options.quick)


def tasks_of(options: argparse.Namespace) -> list[Task]:
    """Return the tasks that the command line selects, with aniposelib's positions if it can be installed."""
    tasks = []
    for clip in clips_of(options):
        outs = [out for out, view in enumerate(clip.views) if view.present.sum() > 100]
        chosen = tuple(out for out in outs if options.outs is None or out in options.outs)
        tasks += [Task(clip, cameras, chosen) for cameras in options.cameras]
    python = None if options.no_anipose else peer_python()
    if python is None:
        return tasks
    parts = [(number, out) for number, task in enumerate(tasks) if task.cameras != "one" for out in task.outs]
    clips = [peer_clip(tasks[number], out) for number, out in parts]
    for (number, out), results in zip(parts, by_peers(python, clips, ["aniposelib"]), strict=True):
        tasks[number].peer_m[out] = results["aniposelib"][0]
    return tasks


def peer_clip(task: Task, out: int) -> PeerClip:
    """Return a clip without one of its cameras, as the input of the other programs."""
    views = [task.clip.views[c].mask_outside_image() for c in choices(task.clip, out, task.cameras)]
    return PeerClip(views, task.clip.fps, task.clip.body)


def main() -> None:
    """Print the errors for each clip, and for each kind of animal."""
    parser = parser_of(__doc__, "--quick", "--jobs", kind="cheetah-runs", only=("runs", "simulated", "rat"))
    parser.add_argument("--cameras", nargs="+", default=["all", "two", "one"])
    parser.add_argument("--detectors", nargs="+", default=["none"], help="none, others or acinoset")
    parser.add_argument("--outs", nargs="+", type=int, help="numbers of the cameras that are left out, from 0")
    parser.add_argument("--solutions", type=Path, help="folder in which the fits are kept for later runs")
    parser.add_argument("--no-anipose", action="store_true")
    options = parser.parse_args()
    scores: dict[tuple[str, str], list[Score]] = {}
    print_header(("clip", "cameras", *COLUMNS, "fit, s"))
    tasks = tasks_of(options)
    with ProcessPoolExecutor(options.jobs) as pool:
        for task, score in zip(tasks, pool.map(partial(scored, solutions=options.solutions), tasks), strict=True):
            clip, cameras = task.clip, task.cameras
            scores.setdefault((clip.kind, cameras), []).append(score)
            print_row((f"{clip.kind}: {clip.name}", cameras, *score.cells, f"{np.mean(score.seconds):.1f}"))
    rows = [
        (kind, cameras, *together(parts).cells, number_text(max(part.ratio for part in parts)))
        for (kind, cameras), parts in scores.items()
    ]
    print()
    print_table(("animal", "cameras", *COLUMNS, "worst fit / best other"), rows)


if __name__ == "__main__":
    main()
