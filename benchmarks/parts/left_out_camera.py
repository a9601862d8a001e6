"""A camera that was left out: how well the other cameras predict its keypoints, compared with triangulation.

    python benchmarks/parts/left_out_camera.py [FOLDER] [--only runs simulated] [--cameras all two one] [--quick]

Each camera of a clip is left out once. The motion is fitted to all others, to two of them, and to one; the predicted
keypoints are projected into the camera that was left out, and compared with its detections: median distance in pixels,
over the points that all methods give, and the share of detections inside the regions that should hold 90 % of them.

The methods: the fit; robust triangulation (`recon triangulate`); the same with smoothing splines; aniposelib
(`triangulate_optim`, its defaults), if it is installed. Two cameras: those with the most different directions. One
camera: the fit only.

The clips: the real runs (a folder as in `cheetah_runs.py`, without it the cheetah-runs of $RECON_SHARED_DATA), with
keypoints on the markers ("none") and where the shipped detector has them, which was measured on these runs; a simulated
mouse, rat-sized mouse and person whose lengths are 10 % off the skeleton's, whose keypoints lie off the markers all the
time, and 2 px of noise (`recon.testing.rigs`). One thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from arguments import parser_of
from cameras import run_of
from markdown_table import print_header, print_row
from trajectory import PRIOR, SKELETON, prior_of

from recon import Body, load_skeleton
from recon.animal.prior import MotionPrior, prior_from_body
from recon.animal.skeleton_file import with_detector_offsets
from recon.clip import View
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.posterior import radius
from recon.fit.prediction import predicted_keypoints
from recon.fit.trajectory import solve_trajectory
from recon.fit.triangulation import Triangulation, smoothed, triangulate_views
from recon.testing.rigs import FPS, random_clip

METHODS = "fit", "triangulated", "with splines", "aniposelib"
OUTLIER_PX = 200.0
"""Detections this far from everything are the detector's errors, and count in no share."""


@dataclass(frozen=True, eq=False)
class Clip:
    """A clip to leave cameras out of."""

    name: str
    views: list[View]
    body: Body
    prior: MotionPrior
    fps: float
    fast: bool


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted keypoints (T, J, 2) of a view with covariances (T, J, 2, 2), or None without."""

    xy_px: np.ndarray
    covariance_px2: np.ndarray | None = None


def triangulated_prediction(result: Triangulation, view: View) -> Prediction:
    safe = np.nan_to_num(result.points_m)
    projected, by_point, valid = view.project_with_jacobian(view.shift_to_exposure(safe))
    is_known = valid & np.isfinite(result.points_m[..., 0])
    covariance = by_point @ result.covariance_m2 @ by_point.swapaxes(-1, -2)
    covariance = covariance + (result.sigma_px**2)[:, None, None] * np.eye(2)
    return Prediction(np.where(is_known[..., None], projected, np.nan), covariance)


def aniposelib_prediction(views: Sequence[View], out: View) -> Prediction | None:
    """Points by aniposelib, from undistorted keypoints in cameras of focal length 1."""
    try:
        from aniposelib.cameras import Camera as AniposeCamera  # pyright: ignore[reportMissingImports]
        from aniposelib.cameras import CameraGroup  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    cameras, points = [], []
    for view in views:
        rays = view.rays() @ view.rotation.T
        with np.errstate(invalid="ignore", divide="ignore"):
            plane = rays[..., :2] / rays[..., 2:]
        focal_px = float(np.mean(view.focal_px))
        from cv2 import Rodrigues

        cameras.append(
            AniposeCamera(
                matrix=np.diag([focal_px, focal_px, 1.0]),
                dist=np.zeros(5),
                rvec=Rodrigues(view.T_camera_world[:3, :3])[0].ravel(),
                tvec=view.T_camera_world[:3, 3],
            )
        )
        points.append(focal_px * plane)
    group = CameraGroup(cameras)
    try:
        points_m = group.triangulate_optim(np.array(points), init_progress=False, init_ransac=len(views) > 2)
    except Exception as error:  # of scipy, where too few points are seen
        print(f"aniposelib: {error}")
        return None
    projected, valid = out.project(np.nan_to_num(out.shift_to_exposure(points_m)))
    is_known = valid & np.isfinite(points_m[..., 0])
    return Prediction(np.where(is_known[..., None], projected, np.nan))


def predictions(clip: Clip, seen: Sequence[int], out: int, anipose: bool) -> tuple[dict[str, Prediction], float]:
    views, view, made = [clip.views[c] for c in seen], clip.views[out], {}
    began = time.perf_counter()
    solution = solve_trajectory(views, clip.body, clip.prior, clip.fps, TrajectoryOptions(fast=clip.fast))
    seconds = time.perf_counter() - began
    made["fit"] = Prediction(*predicted_keypoints(solution, view))
    if len(seen) > 1:
        result = triangulate_views(views)
        made["triangulated"] = triangulated_prediction(result, view)
        made["with splines"] = triangulated_prediction(smoothed(result, clip.fps), view)
        other = aniposelib_prediction(views, view) if anipose else None
        if other is not None:
            made["aniposelib"] = other
    return made, seconds


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


def scored(clip: Clip, cameras: str, outs: Sequence[int], anipose: bool) -> dict[str, object]:
    errors: dict[str, list[np.ndarray]] = {}
    inside: dict[str, list[np.ndarray]] = {}
    seconds = 0.0
    for out in outs:
        view = clip.views[out].mask_outside_image()
        made, took = predictions(clip, choices(clip, out, cameras), out, anipose)
        seconds += took
        off = {name: p.xy_px - view.xy_px for name, p in made.items()}
        common = np.all([np.isfinite(e[..., 0]) for e in off.values()], axis=0)
        for name, e in off.items():
            errors.setdefault(name, []).append(np.linalg.norm(e, axis=-1)[common])
            covariance = made[name].covariance_px2
            if covariance is not None:
                square = np.einsum("na,nab,nb->n", e[common], np.linalg.inv(covariance[common]), e[common])
                inside.setdefault(name, []).append(square < radius(0.9, 2) ** 2)
    row: dict[str, object] = {"clip": clip.name, "cameras": cameras}
    for name in METHODS:
        row[f"{name}, px"] = np.median(np.concatenate(errors[name])) if name in errors else ""
    rivals = [float(row[f"{name}, px"]) for name in METHODS[1:] if name in errors]  # type: ignore[arg-type]
    row["fit / best other"] = float(row["fit, px"]) / min(rivals) if rivals else ""  # type: ignore[arg-type]
    for name in METHODS[:3:2]:
        row[f"{name} inside 90 %"] = f"{100 * np.mean(np.concatenate(inside[name])):.0f}" if name in inside else ""
    row["fit, s"] = seconds / len(outs)
    return row


def real_clips(folder: Path, detectors: Sequence[str], quick: bool) -> Iterator[Clip]:
    body = load_skeleton(SKELETON)
    for path in sorted(folder.resolve().glob("*/meta.json")):
        run = run_of(path.parent)
        for detector in detectors:
            seen = with_detector_offsets(body, detector)
            yield Clip(
                f"{path.parent.name}, {detector}", list(run.views.values()), seen, prior_of(PRIOR), run.fps, quick
            )


def simulated_clips(quick: bool) -> Iterator[Clip]:
    for name, skeleton in (("mouse", "mouse-top"), ("person", "human-25"), ("dog", "dog-27")):
        body = load_skeleton(skeleton)
        for seed in range(1 if quick else 2):
            views, _ = random_clip(body, 0.1, 4, seed)
            yield Clip(f"{name} {seed + 1}", views, body, prior_from_body(body), FPS, quick)


def main() -> None:
    parser = parser_of(__doc__, "--quick", kind="cheetah-runs", only=("runs", "simulated"))
    parser.add_argument("--cameras", nargs="+", default=["all", "two", "one"])
    parser.add_argument("--detectors", nargs="+", default=["none", "acinoset"])
    parser.add_argument("--runs", nargs="+", type=int, help="numbers of the runs, from 0")
    parser.add_argument("--frames", type=int, help="only so many frames, the middle ones")
    parser.add_argument("--outs", type=int, help="only so many cameras are left out")
    parser.add_argument("--no-anipose", action="store_true")
    given = parser.parse_args()
    clips: list[Clip] = []
    if "runs" in given.only:
        every = list(real_clips(given.folder, given.detectors, given.quick))
        count = len(given.detectors)
        clips += [c for i, c in enumerate(every) if given.runs is None or i // count in given.runs]
    if "simulated" in given.only:
        clips += list(simulated_clips(given.quick))
    header_printed = False
    ratios: dict[str, list[float]] = {}
    for clip in clips:
        if given.frames and given.frames < len(clip.views[0].xy_px):
            first = (len(clip.views[0].xy_px) - given.frames) // 2
            clip = replace(clip, views=[view.part(slice(first, first + given.frames)) for view in clip.views])
        outs = [o for o, v in enumerate(clip.views) if v.present.sum() > 100][: given.outs]
        for cameras in given.cameras:
            row = scored(clip, cameras, outs, not given.no_anipose)
            if not header_printed:
                print_header(tuple(row))
                header_printed = True
            print_row(tuple(f"{v:.2f}" if isinstance(v, float) else v for v in row.values()))
            if row["fit / best other"] != "":
                ratios.setdefault(cameras, []).append(float(row["fit / best other"]))  # type: ignore[arg-type]
    for cameras, values in ratios.items():
        print(f"\nCameras {cameras}: fit / best other, mean {np.mean(values):.3f}, worst {np.max(values):.3f}")


if __name__ == "__main__":
    main()
