"""Measure the frame method on every view of real runs: peak speeds, poses, 90 % intervals, verdicts and effort.

    python benchmarks/parts/frame_method.py [FOLDER] [--only RUN ...] [--quick] [--set path=free ...]
        [--csv ROWS | --rows ROWS ...]

Each run of FOLDER, by default the cheetah-runs of $RECON_SHARED_DATA, has camN.csv, scene.json, truth.csv and
meta.json. Every view is fitted like `recon frame`. The true peak speed is the largest speed of the reference joint in
the frames, from the spline through the reconstruction of all cameras. A speed counts as stated if
`ClipAnalysis.why_no_speed` is None. --quick uses only the camera named in meta.json. --rows shows rows that --csv
wrote, for example of runs that were measured at the same time. The last lines summarise all runs, and all runs except
one, because the parameters of the method were chosen on all runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from arguments import parser_of, runs_of, settings_of
from cheetah_runs import PUBLISHED
from markdown_table import percent, print_table
from recordings import fit_settings, meta_of

from recon import Motion, Pose3D, evaluate, fit_clip, read_pose3d
from recon.cli.analyse import ACCELERATION_KNOWN_M_S2
from recon.fit.regions import radius
from recon.gait.clip import ClipAnalysis
from recon.gait.kinematics import frame_times, net_acceleration
from recon.gait.series import frame_jitter_m, series_kinematics
from recon.gait.stances import INTERVAL
from recon.thesis.solution import frame_solution

WITHIN = 0.3
"""Largest relative error of a stated peak speed that counts as near the truth."""
POOR_MM = 160.0
"""MPJPE above which no pose may have the verdict "use", mm."""


def view_row(run: Path, camera: int, options: dict[str, Any]) -> dict[str, Any]:
    """Fit one view by the frame method, and return its errors, intervals and effort by column."""
    settings = fit_settings(run, [camera], method="frame", skeleton=PUBLISHED, **options)
    motion, truth = fit_clip(settings), read_pose3d(run / "truth.csv")
    analysis, solution = ClipAnalysis(motion), frame_solution(motion)
    reference = analysis.reference_motion
    error_mm = 1000 * evaluate(Pose3D(motion.names, motion.joints_m, motion.frames), truth).mpjpe_m.mean
    verdict, distance_px = motion.verdict, motion.pictures[0].distance_px
    assert verdict is not None
    stated = verdict.pose_m
    return {
        "run": run.name,
        "camera": camera,
        "named": camera == meta_of(run).get("monocular_camera"),
        "verdict": verdict.level,
        "true_peak_m_s": true_peak_m_s(motion, truth),
        "peak_m_s": reference.peak_speed_m_s,
        "sigma_m_s": reference.peak_speed_sigma_m_s,
        "speed_stated": analysis.why_no_speed is None,
        "true_acceleration_m_s2": true_acceleration_m_s2(motion, truth),
        "acceleration_m_s2": analysis.net_acceleration_m_s2[0],
        "acceleration_sigma_m_s2": analysis.net_acceleration_m_s2[1],
        "mpjpe_mm": error_mm,
        "low_mm": 1000 * stated.low if stated else np.nan,
        "high_mm": 1000 * stated.high if stated else np.nan,
        "jitter_m": depth_jitter_m(motion),
        "error_px": float(distance_px[np.isfinite(distance_px)].mean()),
        "iterations": float(np.nanmedian(solution.reported("iterations"))),
        "evaluations": float(np.nanmedian(solution.reported("function_evaluations"))),
    }


def depth_jitter_m(motion: Motion) -> float:
    """Return the jitter of the reference joint from frame to frame along the line of sight, metres."""
    from_camera_m = motion.joints_m[:, motion.names.index(motion.reference)] - motion.solution.views[0].centre_m
    return float(frame_jitter_m(np.linalg.norm(from_camera_m, axis=1)[:, None])[0])


def true_peak_m_s(motion: Motion, truth: Pose3D) -> float:
    """Return the largest true speed of the reference joint in the frames, m/s."""
    joint = truth.names.index(motion.reference)
    time_s = frame_times(truth.frames, motion.fps)
    rate = series_kinematics(time_s, truth.xyz_m[:, joint], oversampling=1).rate
    return float(np.nanmax(np.linalg.norm(rate, axis=1)))


def true_acceleration_m_s2(motion: Motion, truth: Pose3D) -> float:
    """Return the true acceleration of the reference joint along its path, m/s², over the frames of the fit."""
    joint = truth.names.index(motion.reference)
    rows = np.isin(truth.frames, motion.frames[motion.solved])
    time_s = frame_times(truth.frames[rows], motion.fps)
    return net_acceleration(time_s, truth.xyz_m[rows, joint])[0]


def expectation_line(table: pd.DataFrame) -> str:
    """Return a sentence that compares the pose errors with the errors that the verdict expects."""
    ratio = table["mpjpe_mm"] / np.sqrt(table["low_mm"] * table["high_mm"])
    by_run = [ratio[table["run"] != run].median() for run in table["run"].unique()]
    return (
        f"Pose error relative to the expected one: median {ratio.median():.2f} ({min(by_run):.2f} to {max(by_run):.2f} "
        "with one run left out)."
    )


def acceleration_lines(table: pd.DataFrame) -> list[str]:
    """Return sentences on how often the intervals of the acceleration along the path contain the truth."""
    off = (table["acceleration_m_s2"] - table["true_acceleration_m_s2"]).abs()
    sigma = table["acceleration_sigma_m_s2"]
    stated = sigma <= ACCELERATION_KNOWN_M_S2
    holds = off <= radius(INTERVAL) * sigma
    return [
        f"Acceleration along the path: stated in {stated.sum()} of {len(table)} views (standard deviation of at most "
        f"{ACCELERATION_KNOWN_M_S2:g} m/s2); its 90 % interval holds in {percent(holds[stated].mean())} of these "
        f"and in {percent(holds.mean())} of all; off by {off[stated].median():.1f} m/s2 (median), stated standard "
        f"deviation {sigma[stated].median():.1f}."
    ]


def pose_holds(table: pd.DataFrame) -> float:
    """Return the fraction of views whose pose error is within the verdict's 90 % interval."""
    holds = (table["mpjpe_mm"] >= table["low_mm"]) & (table["mpjpe_mm"] <= table["high_mm"])
    return float(holds[table["low_mm"].notna()].mean())


def summary(table: pd.DataFrame) -> list[str]:
    """Summarise the errors of all views as cells of a table row, such as the number of stated peak speeds."""
    stated = table[table["speed_stated"]]
    ratio = stated["peak_m_s"] / stated["true_peak_m_s"]
    off = (stated["peak_m_s"] - stated["true_peak_m_s"]).abs()
    usable, named = table[table["verdict"] == "use"], table[table["named"]]
    is_wrong = usable["speed_stated"] & ((usable["peak_m_s"] / usable["true_peak_m_s"] - 1).abs() > WITHIN)
    return [
        f"{len(stated)} of {len(table)}",
        f"{np.mean((ratio - 1).abs() <= WITHIN):.0%}",
        f"{np.mean(off <= radius(INTERVAL) * stated['sigma_m_s']):.0%}",
        f"{pose_holds(table):.0%}",
        f"{int((usable['mpjpe_mm'] > POOR_MM).sum())} / {int(is_wrong.sum())} of {len(usable)}",
        f"{named['mpjpe_mm'].mean():.0f}, {table['mpjpe_mm'].mean():.0f}",
        f"{table['error_px'].median():.1f}",
        f"{table['jitter_m'].median():.3f} ({table['jitter_m'].min():.3f} to {table['jitter_m'].max():.3f})",
        f"{table['iterations'].median():.0f}, {table['evaluations'].median():.0f}",
    ]


def main() -> None:
    parser = parser_of(__doc__, "--quick", "--set", "--csv", kind="cheetah-runs")
    parser.add_argument("--only", nargs="+", default=[], metavar="RUN", help="runs whose names begin so")
    parser.add_argument("--rows", nargs="+", default=[], metavar="CSV", help="rows of earlier runs with --csv")
    arguments = parser.parse_args()
    options = settings_of(arguments)
    rows = []
    for run in () if arguments.rows else runs_of(arguments.folder):
        if arguments.only and not run.name.startswith(tuple(arguments.only)):
            continue
        meta = meta_of(run)
        cameras = [meta["monocular_camera"]] if arguments.quick else meta["cameras"]
        rows += [view_row(run, camera, options) for camera in cameras]
    if not rows and not arguments.rows:
        parser.exit(message=f"no runs in {arguments.folder}: nothing measured\n")
    table = pd.concat([pd.DataFrame(rows), *map(pd.read_csv, arguments.rows)], ignore_index=True)
    if arguments.csv:
        table.to_csv(arguments.csv, index=False)
    cells = [
        [
            *(str(row.run)[:26], f"{row.camera}{' *' if row.named else ''}", row.verdict, f"{row.true_peak_m_s:.1f}"),
            f"{row.peak_m_s:.1f} ± {row.sigma_m_s:.1f}{'' if row.speed_stated else ' (not stated)'}",
            *(f"{row.mpjpe_mm:.0f} ({row.low_mm:.0f} to {row.high_mm:.0f})", f"{row.error_px:.1f}"),
            *(f"{row.iterations:.0f}", f"{row.evaluations:.0f}"),
        ]
        for row in table.itertuples()
    ]
    print_table(
        ["run", "camera", "verdict", "true peak m/s", "peak", "MPJPE mm", "px", "iterations", "evaluations"], cells
    )
    print()
    names = "runs, speed stated, near the truth, inside 90 %, pose inside 90 %, use: poor pose / wrong peak, "
    names += "MPJPE mm (named; all), px, depth jitter m, "
    names += "iterations and evaluations"
    lines = [["all", *summary(table)]]
    runs = list(dict.fromkeys(table["run"]))
    for run in runs if len(runs) > 1 else ():
        lines.append([f"without {run[:26]}", *summary(table[table["run"] != run])])
    print_table(names.split(", "), lines)
    print()
    print("\n".join([expectation_line(table), "", *acceleration_lines(table)]))


if __name__ == "__main__":
    main()
