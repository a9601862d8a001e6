"""Test the trajectory method on real runs, compared with the multi-camera reconstruction, and on simulated clips.

    python benchmarks/parts/trajectory.py [FOLDER] [--only accuracy] [--csv TABLE.csv]

Each run is a folder as in `cheetah_runs.py`. Every camera view is fitted separately; the other cameras only provide the
truth. Keypoints are assumed to have no bias. Errors are over all 24 joints. FOLDER is by default the cheetah-runs of
$RECON_SHARED_DATA, or of ../shared/data; without any runs, only simulated clips are used. The script runs in one
thread. Parts that measure no times run in two processes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from arguments import parser_of, runs_of
from changed_constants import options_with
from cheetah_runs import PUBLISHED, view_row
from recordings import camera_of, meta_of, truth_at

from recon import Body, Camera, load_skeleton, read_keypoints, read_pose3d
from recon.animal.body import other_side
from recon.animal.chain import load_chain
from recon.animal.prior import MotionPrior, load_prior
from recon.animal.prior_fit import as_one_gaussian
from recon.api.clip_inputs import arrange
from recon.api.model_settings import PriorFitSettings
from recon.api.prior_fit import run_prior_fit
from recon.clip import View, clean, still_view
from recon.fit import constants
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.points import solve_points
from recon.fit.regions import radius, sigmas
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.gait.clip import POSE_ERROR_TIME, POSITION_ERROR_TIME, error_time_s
from recon.gait.evaluation import aligned, joint_errors, score
from recon.gait.series import Errors, series_kinematics
from recon.geometry.frames import inverse, moved, rigid
from recon.testing.gallop import gallop

SKELETON, PRIOR = "cheetah-24", "running-cheetah"
ONE_GAUSSIAN = "one Gaussian"
VISIBLE = 0.8
"""Fraction of the truth inside the picture from which a view can count as the worst view."""
HOLE = 10
GROUPS = {
    "head": ("nose", "l_eye", "r_eye"),
    "trunk": ("neck_base", "spine", "tail_base", "l_shoulder", "r_shoulder", "l_hip", "r_hip"),
    "tail": ("tail1", "tail2"),
    "fore legs": tuple(f"{s}_front_{part}" for s in "lr" for part in ("knee", "ankle", "paw")),
    "hind legs": tuple(f"{s}_back_{part}" for s in "lr" for part in ("knee", "ankle", "paw")),
}
FPS = 90.0
SIMULATED_CAMERA = Camera.from_hfov(60.0, (1920, 1080))
CAMERA_FROM_LEVEL = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])

Rows = list[dict]


@dataclass(frozen=True)
class Job:
    """One view, with the settings of its fit."""

    run: Path
    camera: int
    subject: bool = True
    """Whether the fit has the animal's own lengths."""
    scale: float = 1.0
    """Factor by which all lengths are scaled."""
    prior: str = PRIOR
    options: dict = field(default_factory=dict)
    """Options of the fit and constants of the solver that differ from the defaults."""
    change: str = "nothing"
    """Key of `CHANGES`, or "projected" for the truth's projections as detections."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Errors of a fit of one view, and the uncertainty that the fit states."""

    job: Job
    centred_m: np.ndarray
    """Errors (T, J) with both poses centred, metres."""
    off_m: np.ndarray
    """Errors (T, J) in the camera's frame, metres."""
    inside_relative: np.ndarray
    """Whether each centred true joint is inside its 90 % region, shape (T, J): 1.0, 0.0, or NaN if unknown."""
    inside_place: np.ndarray
    """Whether each true joint in the camera's frame is inside its 90 % region, shape (T, J): 1.0, 0.0, or NaN."""
    sigma_m: np.ndarray
    """Stated standard deviation (T,) of the joints within the pose, metres, RMS over the joints."""
    too_far_m: float
    """Mean distance of the animal's middle from the camera minus the true distance, metres."""
    visible: float
    """Fraction of the true joints inside the picture."""
    reference_px: float
    """Median distance of the truth's projections from the detections, pixels."""
    flags: tuple[tuple[str, ...], ...]
    status: str
    size: float
    size_sigma: float
    solve_s: float

    @property
    def named(self) -> bool:
        return self.job.camera == meta_of(self.job.run)["monocular_camera"]

    @property
    def mpjpe_mm(self) -> float:
        return 1000 * score(self.centred_m).mean

    @property
    def mpe_mm(self) -> float:
        return 1000 * score(self.off_m).mean


@cache
def body_of(subject: str | None = None, scale: float = 1.0) -> Body:
    body = load_skeleton(SKELETON, subject)
    segments = tuple(replace(s, offset_m=tuple(scale * x for x in s.offset_m)) for s in body.tree.segments)
    markers = tuple(replace(m, offset_m=tuple(scale * x for x in m.offset_m)) for m in body.tree.markers)
    return replace(body, tree=replace(body.tree, segments=segments, markers=markers))


def prior_of(name: str) -> MotionPrior:
    body = body_of()
    return as_one_gaussian(load_prior(PRIOR, body)) if name == ONE_GAUSSIAN else load_prior(name, body)


@cache
def truth_of(run: Path) -> np.ndarray:
    """Return the true positions (T, J, 3) of the body's markers in all frames of the truth, world, metres."""
    truth = read_pose3d(run / "truth.csv")
    return truth.xyz_m[:, [truth.names.index(m) for m in body_of().markers]]


@cache
def view_of(run: Path, camera: int) -> tuple[Camera, np.ndarray, np.ndarray, np.ndarray]:
    """Return camera, detections (T, J, 2), px, confidence (T, J) and truth (T, J, 3) in the camera's frame, m."""
    keypoints, _ = clean(replace(read_keypoints(run / f"cam{camera}.csv"), fps=meta_of(run)["fps"]), 0.5)
    keypoints, lens = arrange(keypoints, body_of().markers), camera_of(run, f"cam{camera}")
    truth_m = lens.world_to_camera(truth_at(run, keypoints.frames, body_of().markers))
    return lens, keypoints.xy_px, keypoints.confidence, truth_m


def _hole(xy_px: np.ndarray) -> slice:
    return slice(len(xy_px) // 2 - HOLE // 2, len(xy_px) // 2 - HOLE // 2 + HOLE)


def _without_middle(xy_px: np.ndarray) -> slice:
    xy_px[_hole(xy_px)] = np.nan
    return _hole(xy_px)


def _without_hind_legs(xy_px: np.ndarray) -> slice:
    xy_px[: len(xy_px) // 2, [body_of().markers.index(m) for m in GROUPS["hind legs"]]] = np.nan
    return slice(0, len(xy_px) // 2)


def _swapped(xy_px: np.ndarray) -> slice:
    markers = body_of().markers
    xy_px[_hole(xy_px)] = xy_px[_hole(xy_px)][:, [markers.index(other_side(m)) for m in markers]]
    return _hole(xy_px)


def _moved(xy_px: np.ndarray) -> slice:
    rng = np.random.default_rng(5)
    wrong = rng.uniform(size=xy_px.shape[:2]) < 0.3
    xy_px[wrong] += rng.uniform(-300, 300, (int(wrong.sum()), 2))
    return slice(0, 0)


CHANGES: dict[str, Callable[[np.ndarray], slice]] = {
    "nothing": lambda xy_px: slice(0, 0),
    "ten frames of nothing": _without_middle,
    "no hind legs in the first half": _without_hind_legs,
    "left and right swapped for ten frames": _swapped,
    "30 % moved by up to 300 px in x and y": _moved,
}
"""Functions that change detections (T, J, 2) in place, and return the frames that are excluded from the scores."""


def solution_of(job: Job) -> TrajectorySolution:
    lens, xy_px, confidence, truth_m = view_of(job.run, job.camera)
    if job.change == "projected":
        xy_px, _ = lens.project(truth_m)
    else:
        CHANGES[job.change](xy_px := xy_px.copy())
    meta = meta_of(job.run)
    body = body_of(meta["subject"] if job.subject else None, job.scale)
    trusted = np.where(np.isfinite(xy_px[..., 0]), 1.0 if job.change == "projected" else confidence, 0.0)
    views, body = [still_view(lens, xy_px, trusted)], replace(body, keypoint_offset_m={})
    with options_with(job.options) as options:
        return solve_trajectory(views, body, prior_of(job.prior), meta["fps"], options)


def fit(job: Job) -> Fit:
    lens, xy_px, _, truth_m = view_of(job.run, job.camera)
    solution = solution_of(job)
    projected, valid = lens.project(truth_m)
    found = solution.joints_camera_m
    centred = found - found.mean(axis=1, keepdims=True) - truth_m + truth_m.mean(axis=1, keepdims=True)
    return Fit(
        job=job,
        centred_m=joint_errors(aligned(found, truth_m), truth_m),
        off_m=joint_errors(found, truth_m),
        inside_relative=_inside(centred, _in_camera(solution, solution.relative_covariance_m2)),
        inside_place=_inside(found - truth_m, _in_camera(solution, solution.covariance_m2)),
        sigma_m=np.sqrt(np.trace(solution.relative_covariance_m2, axis1=2, axis2=3).mean(axis=1)),
        too_far_m=float(np.nanmean(_distance_m(found) - _distance_m(truth_m))),
        visible=float(np.mean(valid & lens.in_image(projected))),
        reference_px=float(np.nanmedian(np.linalg.norm(projected - xy_px, axis=-1))),
        flags=solution.flags,
        status=solution.status,
        size=solution.size,
        size_sigma=solution.size_sigma,
        solve_s=solution.stage_s["all"],
    )


def _distance_m(points_m: np.ndarray) -> np.ndarray:
    """Return the distance of the middle of the points (T, J, 3) from the camera, shape (T,), m."""
    return np.linalg.norm(points_m.mean(axis=1), axis=-1)


def _in_camera(solution: TrajectorySolution, covariance_m2: np.ndarray) -> np.ndarray:
    """Rotate covariances (T, J, 3, 3) from the world frame to the camera frame."""
    R = solution.views[0].rotation
    return R @ covariance_m2 @ R.T


def _inside(error_m: np.ndarray, covariance_m2: np.ndarray) -> np.ndarray:
    """Return whether each error (T, J, 3) is inside the 90 % region: 1.0, 0.0, or NaN without truth or solution."""
    off = sigmas(error_m, covariance_m2)
    return np.where(np.isfinite(off), off < radius(0.9, 3), np.nan)


def fits(jobs: Iterable[Job], processes: int = 2) -> list[Fit]:
    jobs = list(jobs)
    if processes == 1:
        return [fit(job) for job in jobs]
    with multiprocessing.Pool(processes) as pool:
        return pool.map(fit, jobs, chunksize=1)


def views(runs: Sequence[Path], named_only: bool = False) -> list[Job]:
    return [
        Job(run, camera)
        for run in runs
        for camera in meta_of(run)["cameras"]
        if not named_only or camera == meta_of(run)["monocular_camera"]
    ]


def mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def without_2019(found: Sequence[Fit]) -> list[Fit]:
    return [f for f in found if not f.job.run.name.startswith("2019")]


def summary(label: str, found: Sequence[Fit]) -> dict:
    """Summarise the errors of several fits as a table row."""
    named = [f for f in found if f.named]
    row = {
        "method": label,
        "named mpjpe_mm": mean(f.mpjpe_mm for f in named),
        "named mpe_mm": mean(f.mpe_mm for f in named),
        "mpe_mm without 2019": mean(f.mpe_mm for f in without_2019(named)),
    }
    if len(found) > len(named):
        row["median of all views mpjpe_mm"] = float(np.median([f.mpjpe_mm for f in found]))
        row["worst seen view mpjpe_mm"] = max(f.mpjpe_mm for f in found if f.visible >= VISIBLE)
    return row


def accuracy(runs: Sequence[Path]) -> dict[str, Rows]:
    full = fits(views(runs), processes=1)
    fast = fits([replace(job, options={"fast": True}) for job in views(runs)], processes=1)
    rows = [
        {
            "run": f.job.run.name,
            "cam": f"{f.job.camera}{' *' if f.named else ''}",
            "frames": len(f.flags),
            "visible": f.visible,
            "reference px": f.reference_px,
            "mpjpe_mm": f.mpjpe_mm,
            "mpe_mm": f.mpe_mm,
            "too far m": f.too_far_m,
            "inside 90 %": float(np.nanmean(f.inside_relative)),
            "solve_s": f.solve_s,
            "frames flagged": sum(map(bool, f.flags)),
            "status": f.status,
            "fast mpjpe_mm": g.mpjpe_mm,
            "fast solve_s": g.solve_s,
        }
        for f, g in zip(full, fast, strict=True)
    ]
    compared = [
        summary("trajectory, subject", full) | {"solve_s": mean(f.solve_s for f in full)},
        summary("trajectory, subject, fast", fast) | {"solve_s": mean(f.solve_s for f in fast)},
    ]
    metas = [meta_of(run) for run in runs]
    compared += [_frame_method(runs, metas), *_published_methods(runs, metas)]
    by_run = [
        {"run": run.name, "trajectory mm": next(f.mpjpe_mm for f in full if f.named and f.job.run == run)}
        | {f"{name} mm": p["mpjpe_mm"] for name, p in meta.get("published", {}).items()}
        for run, meta in zip(runs, metas, strict=True)
    ]
    return {
        "accuracy, all views": rows,
        "accuracy, compared": compared,
        "accuracy, MPJPE of the named views by run": by_run,
    }


def _frame_method(runs: Sequence[Path], metas: Sequence[dict]) -> dict:
    """Fit the named views by the frame method with the published settings, and summarise the errors."""
    frame = [view_row(run, meta["monocular_camera"], PUBLISHED) for run, meta in zip(runs, metas, strict=True)]
    return {
        "method": "frame, nine joints, published ratios",
        "named mpjpe_mm": mean(r["mpjpe_mm"] for r in frame),
        "named mpe_mm": mean(r["mpe_mm"] for r in frame),
        "mpe_mm without 2019": mean(r["mpe_mm"] for r in frame if not r["run"].startswith("2019")),
        "solve_s": mean(r["clip_s"] for r in frame),
    }


def _published_methods(runs: Sequence[Path], metas: Sequence[dict]) -> Iterator[dict]:
    for name in metas[0].get("published", {}):
        published = [meta["published"][name] for meta in metas]
        earlier = [p for p, run in zip(published, runs, strict=True) if not run.name.startswith("2019")]
        yield {
            "method": f"published: {name}",
            "named mpjpe_mm": mean(p["mpjpe_mm"] for p in published),
            "named mpe_mm": mean(p["mpe_mm"] for p in published),
            "mpe_mm without 2019": mean(p["mpe_mm"] for p in earlier),
            "solve_s": mean(p["solve_s"] for p in published),
        }


def size(runs: Sequence[Path]) -> dict[str, Rows]:
    rows = []
    for label, own, scale in (
        ("subject", True, 1.0),
        ("default proportions", False, 1.0),
        ("default x 0.85", False, 0.85),
        ("default x 1.15", False, 1.15),
    ):
        found = fits(replace(job, subject=own, scale=scale) for job in views(runs))
        bodies = {run: body_of(meta_of(run)["subject"] if own else None, scale) for run in runs}
        true = {run: solve_points(body, truth_of(run), None)[2] for run, body in bodies.items()}
        for part, some in (("named", [f for f in found if f.named]), ("all", found)):
            off = [(f.size - true[f.job.run]) / f.size_sigma for f in some]
            rows.append(
                {
                    "lengths": label,
                    "views": part,
                    "mpjpe_mm": mean(f.mpjpe_mm for f in some),
                    "mpe_mm": mean(f.mpe_mm for f in some),
                    "size found": mean(f.size for f in some),
                    "its sigma": mean(f.size_sigma for f in some),
                    "true size": mean(true[f.job.run] for f in some),
                    "within 2 sigma": mean(abs(z) < 2 for z in off),
                }
            )
    return {"size": rows}


def uncertainty(runs: Sequence[Path]) -> dict[str, Rows]:
    found = fits(views(runs))
    groups = {"all joints": body_of().markers, **GROUPS}
    rows = []
    for part, some in (("named", [f for f in found if f.named]), ("all", found)):
        for label, inside in (("relative", "inside_relative"), ("position", "inside_place")):
            row: dict[str, object] = {"views": part, "covariance": label}
            for group, markers in groups.items():
                columns = [body_of().markers.index(m) for m in markers]
                values = np.concatenate([getattr(f, inside)[:, columns].ravel() for f in some])
                row[group] = float(np.nanmean(values))
            row["worst view"] = min(float(np.nanmean(getattr(f, inside))) for f in some)
            rows.append(row)
    holes = fits(replace(job, change="ten frames of nothing") for job in views(runs, named_only=True))
    grown = []
    for f in holes:
        hole = np.zeros(len(f.sigma_m), dtype=bool)
        hole[_hole(f.sigma_m)] = True
        centred_mm = 1000 * score(f.centred_m).per_frame
        inside, outside = np.nanmean(f.sigma_m[hole]), np.nanmean(f.sigma_m[~hole])
        grown.append(
            {
                "run": f.job.run.name,
                "sigma in the gap mm": 1000 * float(inside),
                "outside mm": 1000 * float(outside),
                "ratio": float(inside / outside),
                "mpjpe_mm in the gap": float(np.nanmean(centred_mm[hole])),
                "mpjpe_mm outside": float(np.nanmean(centred_mm[~hole])),
            }
        )
    return {"uncertainty: fraction of the truth in the 90 % regions": rows, "uncertainty: a gap of ten frames": grown}


def rates(runs: Sequence[Path]) -> dict[str, Rows]:
    """Compare the errors of velocities and accelerations with the standard deviations that `recon.gait.clip` states."""
    with multiprocessing.Pool(2) as pool:
        found = pool.map(_rate_errors, views(runs), chunksize=1)
    rows = []
    for part in ("pose", "position"):
        values = np.concatenate([f[part] for f in found])
        root = np.sqrt(np.mean(values**2, axis=0))
        row: dict[str, object] = {"errors of the": part}
        for name, i in (("position m", 0), ("velocity m/s", 2), ("acceleration m/s2", 4)):
            row |= {f"{name}, error": root[i], f"{name}, sigma": root[i + 1]}
        rows.append(row)
    return {"rates: root mean square errors and what is stated": rows}


def _rate_errors(job: Job) -> dict[str, np.ndarray]:
    """Return errors and standard deviations, all axes together, of position, velocity and acceleration of a fit."""
    solution, truth_m = solution_of(job), view_of(job.run, job.camera)[3]
    time_s = np.arange(len(truth_m)) / meta_of(job.run)["fps"]
    found, middle = solution.joints_camera_m, solution.joints_camera_m.mean(axis=1, keepdims=True)
    true_middle = truth_m.mean(axis=1, keepdims=True)
    of_middle = (solution.covariance_m2 - solution.relative_covariance_m2).mean(axis=1, keepdims=True)
    pose_m2, place_m2 = (_in_camera(solution, c) for c in (solution.relative_covariance_m2, of_middle))
    by_size = solution.size_sigma / solution.size * middle
    parts = {
        "pose": (found - middle - truth_m + true_middle, pose_m2, 0 * found, POSE_ERROR_TIME),
        "position": (middle - true_middle, place_m2, by_size, POSITION_ERROR_TIME),
    }
    rows = {}
    last_s = error_time_s(found, meta_of(job.run)["fps"])
    for part, (off, covariance, size_m, lasts) in parts.items():
        rest = np.sqrt(np.maximum(np.diagonal(covariance, axis1=2, axis2=3) - size_m**2, 1e-12))
        errors = Errors(size_m, np.inf), Errors(rest, lasts * last_s)
        rows[part] = np.concatenate(
            [_rate_rows(time_s, off[:, j], [e[:, j] for e in errors]) for j in range(off.shape[1])]
        )
    return rows


def _rate_rows(time_s: np.ndarray, off_m: np.ndarray, errors: Sequence[Errors]) -> np.ndarray:
    moved = series_kinematics(time_s, off_m, errors, oversampling=1)
    columns = (
        *(moved.value, moved.value_sigma, moved.rate, moved.rate_sigma),
        *(moved.acceleration, moved.acceleration_sigma),
    )
    rows = np.stack([np.linalg.norm(np.asarray(c, float), axis=1) for c in columns], axis=1)
    return rows[np.isfinite(rows).all(axis=1)]


def ablation(runs: Sequence[Path]) -> dict[str, Rows]:
    one_gaussian, none = {"prior": ONE_GAUSSIAN}, {"prior": "none"}
    variants: list[tuple[str, dict, dict]] = [
        ("everything", {}, {}),
        ("no learned prior", none, {}),
        ("one Gaussian for the mixture", one_gaussian, {}),
        ("no motion prior (weight 1e-3)", {}, {"MOTION_WEIGHT": 1e-3}),
        ("no heading (1e3 m/s across)", {}, {"LATERAL_M_S": 1e3}),
        ("no root acceleration (1e3 m/s2)", {}, {"ACCELERATION_M_S2": (1e3, 1e3, 1e3)}),
        ("no climb (1e3 m/s)", {}, {"CLIMB_M_S": 1e3}),
        ("no ground, no stance", {}, {"ground": "none"}),
        ("wide robust loss (c = 30)", {}, {"ROBUST_C": 30.0}),
        ("one noise round of three", {}, {"NOISE_ROUNDS": 1}),
        ("fewer starts, looser (fast)", {}, {"fast": True}),
    ]
    poses = runs[0].parents[1] / "cheetah-poses"
    with tempfile.TemporaryDirectory() as folder:
        if poses.is_dir():
            path = Path(folder) / "all-segments.npz"
            run_prior_fit(
                PriorFitSettings(
                    poses=(poses / "training_positions.csv",),
                    out=path,
                    skeleton=SKELETON,
                    fps=str(poses / "segments.json"),
                    subject="phantom",
                    apart=("tail_1", "tail_2"),
                )
            )
            variants.append(("prior of all segments, including slow ones", {"prior": str(path)}, {}))
        rows = [
            summary(label, fits(replace(job, options=options, **how) for job in views(runs)))
            for label, how, options in variants
        ]
    for row in rows:
        row["change mm"] = row["named mpjpe_mm"] - rows[0]["named mpjpe_mm"]
    return {"ablation": [{"left out": row.pop("method"), **row} for row in rows]}


def robustness(runs: Sequence[Path]) -> dict[str, Rows]:
    rows = []
    base = {f.job.run: f for f in fits(views(runs, named_only=True))}
    for change in list(CHANGES)[1:]:
        found = fits(replace(job, change=change) for job in views(runs, named_only=True))
        before, after, flagged, disturbed = [], [], 0, 0
        for f in found:
            hit = CHANGES[change](np.zeros((*f.centred_m.shape, 2)))
            scored = np.ones(len(f.flags), dtype=bool)
            scored[hit] = False
            after.append(1000 * np.nanmean(f.centred_m[scored]))
            before.append(1000 * np.nanmean(base[f.job.run].centred_m[scored]))
            flagged += sum(map(bool, f.flags[hit]))
            disturbed += len(f.flags[hit])
        ratio = np.array(after) / before
        rows.append(
            {
                "change": change,
                "untouched mpjpe_mm": mean(before),
                "mpjpe_mm": mean(after),
                "ratio of means": mean(after) / mean(before),
                "worst run's ratio": float(ratio.max()),
                "flagged in it": f"{flagged} of {disturbed}" if disturbed else "-",
                "flagged outside": sum(sum(map(bool, f.flags)) for f in found) - flagged,
            }
        )
    return {"robustness, named views": rows, "noise-free: the truth projected": noise_free(runs)}


def noise_free(runs: Sequence[Path]) -> Rows:
    exact = {"sigma_px": 1.0, "keypoint_sigma_m": 0.005}
    rows = []
    for label, options in (
        ("as it is", {}),
        ("no ground, no stance", {"ground": "none"}),
        ("pose priors / 100", {"POSE_WEIGHT": 0.01}),
        ("motion prior / 100", {"MOTION_WEIGHT": 0.01}),
        ("all three / 100", {"POSE_WEIGHT": 0.01, "MOTION_WEIGHT": 0.01}),
        ("no heading", {"LATERAL_M_S": 1e3}),
        ("noise 0.1 px, 0.5 mm", {"sigma_px": 0.1, "keypoint_sigma_m": 0.0005}),
    ):
        found = fits(replace(job, change="projected", options=exact | options) for job in views(runs))
        worst = max(found, key=lambda f: f.mpjpe_mm)
        rows.append(
            {
                "options": label,
                "mpjpe_mm mean": mean(f.mpjpe_mm for f in found),
                "median mm": float(np.median([f.mpjpe_mm for f in found])),
                "worst mm": worst.mpjpe_mm,
                "worst view": f"{worst.job.run.name} cam{worst.job.camera}",
                "named mean mm": mean(f.mpjpe_mm for f in found if f.named),
                "mpe_mm mean": mean(f.mpe_mm for f in found),
                "not converged": sum(f.status != "converged" for f in found),
            }
        )
    return rows


def times(runs: Sequence[Path]) -> dict[str, Rows]:
    rows = []
    for label, options in (("full", {}), ("fast", {"fast": True})):
        found = fits([replace(job, options=options) for job in views(runs)], processes=1)
        seconds = np.array([f.solve_s for f in found])
        rows.append(
            {
                "method": label,
                "median s": float(np.median(seconds)),
                "worst s": float(seconds.max()),
                "median ms per frame": 1000 * float(np.median(seconds / [len(f.flags) for f in found])),
                "named mpjpe_mm": mean(f.mpjpe_mm for f in found if f.named),
            }
        )
    return {"time of a clip, one thread": rows}


def circling(T: int, cameras: int = 1, fps: float = FPS) -> tuple[list[View], np.ndarray]:
    """Simulate views of an animal that runs in a circle, and return them with its joints (T, J, 3), world, metres.

    The circle has a radius of 6 m, and the animal is 10 to 22 m from the first camera. Detections have 3 px of noise,
    and 5 % are missing. The animal makes three strides per second, in which its pose varies along the two directions of
    largest variance in the prior. The second camera is at the same distance from the middle, a quarter of the circle
    further on.
    """
    body, prior, rng = body_of("phantom"), prior_of(PRIOR), np.random.default_rng(0)
    values, vectors = np.linalg.eigh(prior.covariance)
    t = np.arange(T) / fps
    swing, round_rad = 2 * np.pi * 3.0 * t, 2 * np.pi * t / 6.0
    states = np.zeros((T, body.n_state))
    states[:, 4:] = (
        prior.mean
        + np.outer(np.cos(swing), vectors[:, -1] * np.sqrt(values[-1]))
        + np.outer(np.sin(swing), vectors[:, -2] * np.sqrt(values[-2]))
    )
    states[:, 0], states[:, 1], states[:, 2] = 6 * np.cos(round_rad), 16 + 6 * np.sin(round_rad), -0.3
    states[:, 3] = round_rad + np.pi / 2
    joints_m = body.tree.pose(states).points_m
    views = []
    for turn in np.pi / 2 * np.arange(cameras):
        # Turn the world about the middle of the circle, at which the camera looks.
        about = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
        middle = np.array([0.0, 16.0, 0.0])
        pose = rigid(CAMERA_FROM_LEVEL, np.zeros(3)) @ rigid(about, middle - about @ middle)
        xy_px = SIMULATED_CAMERA.project(moved(pose, joints_m))[0] + 3.0 * rng.normal(size=(*joints_m.shape[:2], 2))
        xy_px[rng.random(joints_m.shape[:2]) < 0.05] = np.nan
        views.append(View(SIMULATED_CAMERA, pose, xy_px, np.isfinite(xy_px[..., 0]).astype(float)))
    return views, joints_m


def solved(views: Sequence[View]) -> TrajectorySolution:
    return solve_trajectory(views, body_of("phantom"), prior_of(PRIOR), FPS)


def errors_mm(solution: TrajectorySolution, joints_m: np.ndarray) -> np.ndarray:
    """Return the mean distance (T,) of the joints from the truth in each frame, both poses centred, mm."""
    return 1000 * score(joint_errors(aligned(solution.joints_m, joints_m), joints_m)).per_frame


def scaling_row(T: int, cameras: int) -> dict:
    views, joints_m = circling(T, cameras)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    start = time.perf_counter()
    solution = solved(views)
    seconds = time.perf_counter() - start
    return {
        "frames": T,
        "cameras": cameras,
        "seconds": seconds,
        "ms per frame": 1000 * seconds / T,
        "peak memory MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "before the fit MB": before,
        "mpjpe_mm": float(np.nanmean(errors_mm(solution, joints_m))),
        "worst frame mm": float(np.nanmax(errors_mm(solution, joints_m))),
        "flagged": sum(map(bool, solution.flags)),
        "status": solution.status,
    }


def scaling() -> dict[str, Rows]:
    rows = []
    for cameras in (1, 2):
        for T in (100, 1000, 10000):  # one process each, because peak memory is measured per process
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                rows.append(pool.apply(scaling_row, (T, cameras)))
    return {"scaling: a simulated animal runs in circles": rows}


def long_hole() -> dict[str, Rows]:
    """Measure a clip of 200 frames with 40 consecutive frames without detections."""
    rows, hole, scored = [], slice(80, 120), np.r_[0:80, 120:200]
    (circle,), joints_m = circling(200)
    clip, chain = gallop(fps=200.0, n_frames=200), load_chain("cheetah-8u")
    columns = [clip.keypoints.names.index(name) for name in chain.body.keypoint_names(clip.side)]
    gallop_px = clip.keypoints.xy_px[:, columns] + 2.0 * np.random.default_rng(0).normal(size=(200, len(columns), 2))
    galloping = still_view(clip.camera, gallop_px, np.isfinite(gallop_px[..., 0]).astype(float))
    gallop_m = moved(inverse(galloping.T_camera_world), clip.camera.world_to_camera(clip.truth_m[:, columns]))

    def chain_solved(views: Sequence[View]) -> TrajectorySolution:
        return solve_trajectory(views, chain.body, load_prior("none", chain.body), 200.0)

    for label, solve, seen, truth_m in (
        ("whole animal in a circle, 90 Hz", solved, circle, joints_m),
        ("the chain's gallop, 200 Hz", chain_solved, galloping, gallop_m),
    ):
        before = errors_mm(solve([seen]), truth_m)
        missing_px = seen.xy_px.copy()
        missing_px[hole] = np.nan
        solution = solve([replace(seen, xy_px=missing_px)])
        after = errors_mm(solution, truth_m)
        rows.append(
            {
                "clip": label,
                "untouched mpjpe_mm": float(np.nanmean(before[scored])),
                "mpjpe_mm outside the gap": float(np.nanmean(after[scored])),
                "ratio": float(np.nanmean(after[scored]) / np.nanmean(before[scored])),
                "mpjpe_mm in the gap": float(np.nanmean(after[hole])),
                "flagged in it": f"{sum(map(bool, solution.flags[hole]))} of 40",
                "flagged outside": sum(map(bool, solution.flags)) - sum(map(bool, solution.flags[hole])),
            }
        )
    return {"robustness: 40 of 200 simulated frames without detections": rows}


def print_table(title: str, rows: Rows) -> None:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    print(f"\n### {title}\n")
    print("| " + " | ".join(columns) + " |")
    print("|" + " --- |" * len(columns))
    for row in rows:
        print("| " + " | ".join(cell(name, row.get(name)) for name in columns) + " |")


def cell(name: str, value: object) -> str:
    if not isinstance(value, float):
        return "-" if value is None else str(value)
    return f"{value:.1f}" if "mm" in name or "ms " in name or "MB" in name else f"{value:.3g}"


REAL: dict[str, Callable[[Sequence[Path]], dict[str, Rows]]] = {
    "accuracy": accuracy,
    "size": size,
    "uncertainty": uncertainty,
    "rates": rates,
    "ablation": ablation,
    "robustness": robustness,
    "time": times,
}
SIMULATED: dict[str, Callable[[], dict[str, Rows]]] = {"robustness": long_hole, "scaling": scaling}


def main() -> None:
    names = list(dict.fromkeys((*REAL, *SIMULATED)))
    arguments = parser_of(__doc__, "--csv", kind="cheetah-runs", only=names).parse_args()
    runs = runs_of(arguments.folder.resolve())
    if not runs:
        print(f"no runs in {arguments.folder}: simulated clips only")
    print_table(
        f"{SKELETON}, prior {PRIOR}",
        [{"hyper-parameter": f.name, "value": str(f.default)} for f in fields(TrajectoryOptions)]
        + [{"hyper-parameter": name, "value": str(value)} for name, value in vars(constants).items() if name.isupper()],
    )
    written: Rows = []
    for name in names:
        tables: dict[str, Rows] = {}
        if name in arguments.only:
            tables |= REAL[name](runs) if runs and name in REAL else {}
            tables |= SIMULATED[name]() if name in SIMULATED else {}
        for title, rows in tables.items():
            print_table(title, rows)
            written += [{"table": title, **row} for row in rows]
    if arguments.csv:
        pd.DataFrame(written).to_csv(arguments.csv, index=False)


if __name__ == "__main__":
    main()
