"""Compare recon with other programs for several calibrated cameras, on the same runs.

    python benchmarks/parts/peers.py [FOLDER] [--cases clean late ...] [--quick]

The other programs are aniposelib and Pose2Sim, in an environment of their own (`peer_runs.py`); without a network
nothing is compared. Each run is a folder as in `cheetah_runs.py`, and each case changes its detections or its second
camera. All programs get the same detections, lenses and poses. The other programs get pixels without lens distortion.
aniposelib also gets the pairs of keypoints whose distance is constant, and the robust subsets of `recon triangulate`.
recon fits as `recon fit` does, with the built-in skeleton and without the keypoint bias that was measured on these runs
(`--set detector=none`).

The truth is a trajectory estimate of a skeleton from all cameras. This favours programs that have a skeleton, and the
joints are inside the body, where a detector's keypoints need not be. "without offsets" is the MPJPE after each joint's
mean offset over the run is subtracted, in a frame that turns with the trunk. "median" is the median of all joints'
centred errors, which a few gross errors do not change. "delivered" is the fraction of the true joints that have a
position; errors are over the joints with a position. "two" cameras are the named camera and the camera with the most
different direction. Times are processor times, with all checks for recon, and without files, compilation and the search
of subsets for the others. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from arguments import parser_of, runs_or_exit
from cameras import Run, most_different, run_of
from markdown_table import print_table
from peer_runs import ENVIRONMENT, PeerClip, Result, by_peers, peer_python
from trajectory import body_of

import recon
from recon import FitSettings, fit_clip
from recon.clip import Keypoints, View
from recon.gait.evaluation import aligned, joint_errors, score
from recon.io.deeplabcut import write_csv

LABELS = {"recon": "recon", "aniposelib": "aniposelib 0.7.2", "pose2sim": "Pose2Sim 0.10.49"}
HIDDEN_FRAMES, LATE_FRAMES, TURN_DEG = 15, 2, 2.0
HIDDEN, WITHOUT_LIMB = "a fore leg hidden for 15 frames", ("knee", "ankle", "paw")

MEASURES = (
    *("MPE, mm", "MPJPE, mm", "PA-MPJPE, mm", "without offsets, mm", "median, mm"),
    *("delivered, %", 'verdict "use"', "ms per frame"),
)
"""Columns of numbers; a cell of the last table has the numbers of recon, aniposelib and Pose2Sim."""

Change = Callable[[Sequence[View]], list[View]]


def with_pixels(view: View, xy_px: np.ndarray) -> View:
    """Return a view with its detections replaced by other pixels (T, K, 2), NaN if missing."""
    return replace(view, xy_px=xy_px, confidence=np.isfinite(xy_px[..., 0]).astype(float))


def clean(views: Sequence[View]) -> list[View]:
    return [*views]


def outliers(views: Sequence[View]) -> list[View]:
    """Move a fifth of the detections to random positions in the picture."""
    random = np.random.default_rng(0)
    changed = []
    for view in views:
        is_wrong = random.uniform(size=view.xy_px.shape[:2]) < 0.2
        anywhere_px = random.uniform((0, 0), view.camera.image_size_px, view.xy_px.shape)
        is_wrong &= np.isfinite(view.xy_px[..., 0])
        changed.append(with_pixels(view, np.where(is_wrong[..., None], anywhere_px, view.xy_px)))
    return changed


def missing(views: Sequence[View]) -> list[View]:
    """Leave out half of the detections."""
    random = np.random.default_rng(1)
    is_missing = [random.uniform(size=view.xy_px.shape[:2]) < 0.5 for view in views]
    return [
        with_pixels(v, np.where(gone[..., None], np.nan, v.xy_px)) for v, gone in zip(views, is_missing, strict=True)
    ]


def hidden_part(frames: int) -> tuple[slice, list[int]]:
    """Return the rows and joints of the left fore leg that the case hides."""
    first = (frames - HIDDEN_FRAMES) // 2
    joints = [body_of().markers.index(f"l_front_{joint}") for joint in WITHOUT_LIMB]
    return slice(first, first + HIDDEN_FRAMES), joints


def hidden(views: Sequence[View]) -> list[View]:
    """Hide the left fore leg from all cameras, in the middle of the clip."""
    changed = []
    for view in views:
        xy_px = view.xy_px.copy()
        rows, joints = hidden_part(len(xy_px))
        xy_px[rows, joints] = np.nan
        changed.append(with_pixels(view, xy_px))
    return changed


def late(views: Sequence[View]) -> list[View]:
    """Give the second camera the detections of earlier frames."""
    xy_px = np.full_like(views[1].xy_px, np.nan)
    xy_px[LATE_FRAMES:] = views[1].xy_px[:-LATE_FRAMES]
    return [views[0], with_pixels(views[1], xy_px), *views[2:]]


def turned(views: Sequence[View]) -> list[View]:
    """Turn the second camera about the vertical axis of its picture."""
    turn = np.array([0.0, np.radians(TURN_DEG), 0.0, 0.0, 0.0, 0.0])
    return [views[0], views[1].corrected(turn), *views[2:]]


CASES: dict[str, tuple[str, Change]] = {
    "clean": ("as recorded", clean),
    "outliers": ("a fifth of the points at random positions", outliers),
    "missing": ("half of the points missing", missing),
    "hidden": (HIDDEN, hidden),
    "late": (f"one camera {LATE_FRAMES} frames late", late),
    "turned": (f"one camera turned by {TURN_DEG:g}°", turned),
}


def by_recon(views: Sequence[View], fps: float) -> Result:
    """Write detections and cameras as files, fit them by recon, and return positions, time and verdict."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        names, files, cameras = [f"cam{i}" for i in range(len(views))], [], []
        for camera_name, view in zip(names, views, strict=True):
            pose, path = view.T_camera_world, folder / f"{camera_name}.csv"
            cameras.append(replace(view.camera, name=camera_name, rotation=pose[:3, :3], translation_m=pose[:3, 3]))
            frames = np.arange(len(view.xy_px))
            write_csv(Keypoints(body_of().markers, view.xy_px, view.confidence, frames, fps=fps), path)
            files.append(path)
        recon.write_cameras(cameras, folder / "cameras.toml")
        settings = FitSettings(
            keypoints=tuple(files),
            camera=(folder / "cameras.toml",),
            camera_name=tuple(names),
            fps=fps,
            detector="none",
        )
        began = time.process_time()
        motion = fit_clip(settings)
        taken_s = time.process_time() - began
    joints_m = np.full((len(views[0].xy_px), *motion.joints_m.shape[1:]), np.nan)
    joints_m[motion.frames] = motion.joints_m
    return joints_m, taken_s, motion.verdict.level if motion.verdict is not None else ""


def without_offsets(errors_m: np.ndarray, truth_m: np.ndarray) -> np.ndarray:
    """Return errors (T, J, 3) without each joint's mean over the run, in a frame that turns with the trunk."""
    markers = body_of().markers
    ahead = truth_m[:, markers.index("neck_base")] - truth_m[:, markers.index("tail_base")]
    c, s = (ahead[:, :2] / np.linalg.norm(ahead[:, :2], axis=1, keepdims=True)).T
    zero, one = np.zeros_like(c), np.ones_like(c)
    R_trunk_world = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]]).transpose(2, 0, 1)
    turned_m = np.einsum("tab,tjb->tja", R_trunk_world, errors_m)
    return turned_m - np.nanmean(turned_m, axis=0)


def scored(points_m: np.ndarray, truth_m: np.ndarray) -> list[float]:
    """Return MPE, MPJPE, PA-MPJPE, MPJPE without offsets and median, mm, and the fraction of joints with a position."""
    is_true = np.isfinite(truth_m[..., 0])
    centred_m = aligned(points_m, truth_m)
    offsets_removed = without_offsets(centred_m - truth_m, truth_m)
    errors_m = [
        joint_errors(points_m, truth_m),
        joint_errors(centred_m, truth_m),
        joint_errors(aligned(points_m, truth_m, scale=True, turn=True), truth_m),
        np.linalg.norm(offsets_removed, axis=2),
    ]
    delivered = float(np.isfinite(points_m[..., 0])[is_true].mean())
    median_mm = 1000 * float(np.nanmedian(errors_m[1]))
    return [*(1000 * score(error_m).mean for error_m in errors_m), median_mm, delivered]


def hidden_error_mm(points_m: np.ndarray, truth_m: np.ndarray) -> tuple[float, float]:
    """Return the mean centred error of the joints that the case hides, mm, and the fraction that has a position."""
    rows, joints = hidden_part(len(truth_m))
    error_m = joint_errors(aligned(points_m, truth_m), truth_m)[rows, joints]
    return 1000 * float(np.nanmean(error_m)), float(np.isfinite(error_m).mean())


def chosen(run: Run, count: str) -> list[View]:
    """Return "all" or "two" views of a run, the named camera first and the most different second."""
    pair = [run.named, most_different(run)]
    others = [] if count == "two" else [camera for camera in run.views if camera not in pair]
    return [run.views[camera].mask_outside_image() for camera in (*pair, *others)]


def side_by_side(rows: Sequence[Sequence[str]]) -> list[list[str]]:
    """Merge the rows of all programs into a row for each case, with the numbers in a cell separated by semicolons."""
    by_case: dict[tuple[str, str], list[Sequence[str]]] = {}
    for row in rows:
        by_case.setdefault((row[0], row[1]), []).append(row[3:])
    joined = []
    for case, numbers in by_case.items():
        cells = [[cell for cell in column if cell != "-"] for column in zip(*numbers, strict=True)]
        joined.append([*case, *("; ".join(column) for column in cells)])
    return joined


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    parser.add_argument("--cameras", nargs="+", choices=["all", "two"], default=["all", "two"])
    parser.add_argument("--cases", nargs="+", choices=[*CASES], default=[*CASES], metavar="CASE")
    parser.add_argument("--quick", action="store_true", help="the first run only")
    options = parser.parse_args()
    runs = runs_or_exit(parser, options.folder.resolve())[: 1 if options.quick else None]
    python = peer_python()
    if python is None:
        print(f"aniposelib and Pose2Sim could not be installed into {ENVIRONMENT}, so nothing was compared.")
        return
    warnings.simplefilter("ignore", RuntimeWarning)  # means of joints that a program never delivers
    jobs = [(count, case, run) for count in options.cameras for case in options.cases for run in map(run_of, runs)]
    clips = [PeerClip(CASES[case][1](chosen(run, count)), run.fps, body_of()) for count, case, run in jobs]
    table: dict[tuple[str, str, str], list[list[float]]] = {}
    hidden_table: dict[tuple[str, str], list[tuple[float, float]]] = {}
    verdicts: dict[tuple[str, str], list[str]] = {}
    for (count, case, run), clip, others in zip(jobs, clips, by_peers(python, clips), strict=True):
        results = {"recon": by_recon(clip.views, clip.fps), **others}
        verdicts.setdefault((count, case), []).append(results["recon"][2])
        for name, (points_m, taken_s, _) in results.items():
            ms = 1000 * taken_s / len(points_m)
            table.setdefault((count, case, name), []).append([*scored(points_m, run.truth_m), ms])
            if case == "hidden":
                hidden_table.setdefault((count, name), []).append(hidden_error_mm(points_m, run.truth_m))
    rows, hidden_rows = [], []
    for (count, case, name), by_run in table.items():
        *errors_mm, delivered, ms = np.nanmean(by_run, axis=0)
        used = f"{verdicts[count, case].count('use')} of {len(runs)}" if name == "recon" else "-"
        cells = (*(f"{error:.0f}" for error in errors_mm), f"{100 * delivered:.0f}", used, f"{ms:.0f}")
        rows.append([count, CASES[case][0], LABELS[name], *cells])
    for (count, name), errors in hidden_table.items():
        error_mm, delivered = np.nanmean(errors, axis=0)
        hidden_rows.append([count, LABELS[name], f"{error_mm:.0f}", f"{100 * delivered:.0f}"])
    print_table(["cameras", "case", "program", *MEASURES], rows)
    if hidden_rows:
        print_table(["cameras", "program", "hidden joints, mm", "delivered, %"], hidden_rows)
    print_table(["cameras", "case", *MEASURES], side_by_side(rows))


if __name__ == "__main__":
    main()
