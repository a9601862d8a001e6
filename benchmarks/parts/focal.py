"""Measure the errors that a wrong focal length causes, as with a guess in `recon fit --hfov-deg`.

    python benchmarks/parts/focal.py [FOLDER] [--only factors lens]

Each run is a folder as in `cheetah_runs.py`. Every camera is used alone with its focal length multiplied by a factor;
the lens distortion stays the same. The table has means over all views: MPJPE over all 24 joints after removing each
pose's middle; the logarithm of the animal's estimated over its true distance; and the speed relative to the speed with
the true focal length. Then all cameras of each run are used with the last focal length 10 % too long, fixed or with
`--set focal-sigma=0.1`. FOLDER is by default the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data. The script
runs in one thread.

The part `lens` fits every view with its calibration, but without the pose of the camera, and with the true horizontal
field of view in place of the calibration: as a fisheye lens, as a stated pinhole, and without a stated lens. The true
tilt of the camera is given. The table has the errors in the camera's frame and the verdicts.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from arguments import parser_of, runs_or_exit
from cameras import PRIOR, Run, cameras_of, errors, log_distance_ratio, run_of
from markdown_table import print_table
from trajectory import body_of, prior_of
from wrong_inputs import errors as pose_and_position

from recon import Camera, FitSettings, fit_clip, write_camera
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory

WRONG = 1.1
FACTORS = (0.7, 0.85, 0.95, 1.0, 1.05, 1.15, 1.3)


def solved(run: Run, camera: int, factor: float) -> TrajectorySolution:
    view = run.views[camera]
    matrix = view.camera.matrix.copy()
    matrix[[0, 1], [0, 1]] *= factor
    wrong = replace(view, camera=replace(view.camera, matrix=matrix))
    return solve_trajectory([wrong], body_of(run.subject), prior_of(PRIOR), run.fps)


def speed_m_s(run: Run, solution: TrajectorySolution) -> float:
    path = solution.joints_m.mean(axis=1)
    return float(np.nanmedian(np.linalg.norm(np.diff(path, axis=0), axis=1)) * run.fps)


def sought(run: Run) -> list[str]:
    views = [run.views[camera] for camera in cameras_of(run)["all"]]
    wrong = [*views[:-1], views[-1].with_focal_scale(float(np.log(WRONG)))]
    body, prior = body_of(run.subject), prior_of(PRIOR)
    held = solve_trajectory(wrong, body, prior, run.fps)
    found, as_is = (
        solve_trajectory(of, body, prior, run.fps, TrajectoryOptions(focal_sigma=0.1)) for of in (wrong, views)
    )
    factors = np.exp(found.focal[-1]), np.exp(as_is.focal[-1])
    return [
        run.folder.name[:28],
        f"{WRONG * factors[0]:.3f} ± {found.focal_sigma[-1]:.3f}",
        f"{factors[1]:.3f}",
        *(f"{errors(run, solution)['mpjpe_mm']:.1f}" for solution in (held, found, as_is)),
    ]


LENSES = {
    "calibrated": None,
    "field of view, `lens=fisheye`": {"lens": "fisheye"},
    "field of view, `lens=pinhole`": {"lens": "pinhole"},
    "field of view, lens not stated": {},
}
"""Settings of a fit for each way to give the lens; None for a camera file."""


def field_of_view_deg(camera: Camera) -> float:
    """Return the angle between the left and the right edge of a picture, degrees."""
    width, height = camera.image_size_px
    left, right = (camera.rays((x, (height - 1) / 2))[0] for x in (-0.5, width - 0.5))
    return float(np.degrees(np.arccos(left @ right)))


def lens_row(run: Run, number: int, lens: dict[str, Any] | None) -> dict[str, Any]:
    """Fit a view with a lens given in one of the ways of `LENSES`, and return its errors and its verdict."""
    true = run.views[number].camera
    assert true.rotation is not None
    up = true.rotation[:, 2]
    tilt = {"tilt_deg": float(np.degrees(np.arctan2(-up[2], -up[1])))}
    clip: dict[str, Any] = {"keypoints": run.folder / f"cam{number}.csv", "fps": run.fps}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "camera.toml"
        write_camera(replace(true, rotation=None, translation_m=None, name="camera"), file)
        rough: dict[str, Any] = {"hfov_deg": field_of_view_deg(true), "image_size_px": true.image_size_px}
        camera: dict[str, Any] = {"camera": file} if lens is None else rough | lens
        motion = fit_clip(FitSettings(**clip, **tilt, **camera))
    T_camera_world = motion.solution.views[0].T_camera_world
    found_m = motion.solution.joints_m @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    true_m = true.world_to_camera(run.truth_m)
    off_m = found_m - true_m
    pose_mm, position_m = pose_and_position(off_m[np.isfinite(off_m).all(axis=(1, 2))])
    far = [np.nanmedian(np.linalg.norm(np.nanmean(points_m, axis=1), axis=-1)) for points_m in (found_m, true_m)]
    verdict = motion.verdict
    assert verdict is not None
    limits = (verdict.pose_m, verdict.position_m)
    errors_m = (pose_mm / 1000, position_m)
    beyond = [limit is None or error_m > limit.high for limit, error_m in zip(limits, errors_m, strict=True)]
    figures = {"pose_mm": pose_mm, "position_m": position_m, "far": far[0] / far[1]}
    return figures | {"level": verdict.level, "beyond": beyond}


def print_lenses(runs: Sequence[Run]) -> None:
    """Print the errors and verdicts of all views for each way to give the lens."""
    cells = []
    for label, lens in LENSES.items():
        rows = [lens_row(run, number, lens) for run in runs for number in run.views]
        levels = [row["level"] for row in rows]
        beyond = np.sum([row["beyond"] for row in rows if row["level"] == "use"], axis=0)
        distance = np.exp(np.mean(np.log([row["far"] for row in rows]))) - 1
        cells.append(
            [
                label,
                f"{np.mean([row['pose_mm'] for row in rows]):.0f}",
                f"{np.mean([row['position_m'] for row in rows]):.2f}",
                f"{100 * distance:+.0f} %",
                " / ".join(str(levels.count(level)) for level in ("use", "check", "do not use")),
                ", ".join(str(int(count)) for count in np.broadcast_to(beyond, 2)),
            ]
        )
    print_table(
        ["lens", "MPJPE, mm", "MPE, m", "too far", "use / check / do not use", '"use", pose, position beyond'], cells
    )


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs", only=("factors", "lens"))
    arguments = parser.parse_args()
    runs = [run_of(run) for run in runs_or_exit(parser, arguments.folder.resolve())]
    if "factors" in arguments.only:
        print_factors(runs)
    if "lens" in arguments.only:
        print_lenses(runs)


def print_factors(runs: Sequence[Run]) -> None:
    """Print the errors of fits with a wrong focal length, and of fits that estimate it."""
    found: dict[float, list[list[float]]] = {}
    for run in runs:
        for camera in run.views:
            speed = speed_m_s(run, solved(run, camera, 1.0))
            for factor in FACTORS:
                solution = solved(run, camera, factor)
                of_view = [errors(run, solution)["mpjpe_mm"], log_distance_ratio(run, solution)]
                found.setdefault(factor, []).append([*of_view, speed_m_s(run, solution) / speed - 1])
    rows = []
    for factor in FACTORS:
        mpjpe, far, faster = np.mean(found[factor], axis=0)
        rows.append([f"{factor - 1:+.0%}", f"{mpjpe:.1f}", f"{np.expm1(far):+.0%}", f"{faster:+.0%}"])
    columns = [
        "run",
        "estimated / true focal length",
        "the same, with the true length given",
        "MPJPE, fixed",
        "MPJPE, estimated",
        "MPJPE, estimated from the true one",
    ]
    print_table(columns, [sought(run) for run in runs])
    print_table(["focal length off by", "MPJPE mm", "too far", "faster"], rows)


if __name__ == "__main__":
    main()
