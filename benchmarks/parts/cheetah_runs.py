"""Run the frame method on every camera view of real runs, and compare with the multi-camera reconstruction.

    python benchmarks/parts/cheetah_runs.py FOLDER [--csv TABLE.csv] [--set robust_c=6 ...]

Each run is a folder with camN.csv (DeepLabCut), scene.json (AcinoSet), truth.csv and meta.json (subject, fps, cameras,
monocular_camera). Every view is fitted with the default settings and the published link ratios, and again with the
lengths measured for the subject. The view of the named camera is also fitted without the Gaussian priors. FOLDER is by
default the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pandas as pd
from arguments import parser_of, runs_or_exit, settings_of
from recordings import fit_settings, meta_of

from recon import InputError, Motion, Pose3D, evaluate, fit_clip, read_pose3d
from recon.animal.skeleton_file import builtin_names
from recon.thesis.solution import FrameSolution

PUBLISHED = "cheetah-8u"


def view_row(run: Path, camera: int, skeleton: str, **options) -> dict:
    """Fit one view by the frame method, and return its errors and times for the table."""
    settings = fit_settings(run, [camera], method="frame", skeleton=skeleton, **options)
    start = time.perf_counter()
    motion = fit_clip(settings)
    solution = motion.solution
    assert isinstance(solution, FrameSolution)
    seconds = time.perf_counter() - start
    truth = read_pose3d(run / "truth.csv")
    score = evaluate(Pose3D(motion.names, motion.joints_m, motion.frames), truth)
    off = heading_off_deg(motion, solution, truth)
    reports = [r for r in solution.reports if r is not None]
    base = solution.chain_states[motion.solved, solution.chain.base_index]
    return {
        "run": run.name,
        "cam": camera,
        "named": camera == meta_of(run).get("monocular_camera"),
        "skeleton": skeleton,
        "side": motion.side,
        "frames": len(motion.frames),
        "converged": solution.status.count("converged"),
        "failed": solution.status.count("not_converged"),
        "no_data": solution.status.count("no_data"),
        "best90_px": best_90_px(motion),
        "mpjpe_mm": 1000 * score.mpjpe_m.mean,
        "mpe_mm": 1000 * score.mpe_m.mean,
        "pa_mm": 1000 * score.pa_mpjpe_m.mean,
        "heading_off_deg": off,
        "base_m": base.mean() if len(base) else np.nan,
        "base_min_m": base.min() if len(base) else np.nan,
        "base_max_m": base.max() if len(base) else np.nan,
        "iterations": np.median([r.iterations for r in reports]) if reports else np.nan,
        "evaluations": np.median([r.function_evaluations for r in reports]) if reports else np.nan,
        "starts": np.mean([r.starts for r in reports]) if reports else np.nan,
        "ms_per_frame": 1000 * np.median([r.solve_s for r in reports]) if reports else np.nan,
        "clip_s": seconds,
    }


def best_90_px(motion: Motion) -> float:
    """Return the mean reprojection error of the 90 % of detections with the smallest errors."""
    distance_px = motion.pictures[0].distance_px
    distance = np.sort(distance_px[np.isfinite(distance_px)])
    return float(distance[: int(0.9 * len(distance))].mean()) if len(distance) else np.nan


def heading_off_deg(motion: Motion, solution: FrameSolution, truth: Pose3D) -> float:
    """Return the median angle between the fit's direction of travel and the true trunk, both horizontal."""
    rear, front = (motion.names[joint] for joint in motion.forward)
    _, here, there = np.intersect1d(motion.frames, truth.frames, return_indices=True)
    trunk = truth.xyz_m[there, truth.names.index(front)] - truth.xyz_m[there, truth.names.index(rear)]
    heading = motion.camera.camera_to_world(solution.travel.heading[here]) - motion.camera.centre_world
    cosine = np.sum(heading[:, :2] * trunk[:, :2], axis=1) / np.linalg.norm(trunk[:, :2], axis=1)
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))


def print_table(rows: list[dict], title: str) -> None:
    columns = {
        "run": "{:.34}",
        "cam": "{}",
        "side": "{}",
        "frames": "{}",
        "failed": "{}",
        "no_data": "{}",
        "best90_px": "{:.1f}",
        "mpjpe_mm": "{:.0f}",
        "mpe_mm": "{:.0f}",
        "pa_mm": "{:.0f}",
        "heading_off_deg": "{:.0f}",
        "base_m": "{:.3f}",
        "base_min_m": "{:.3f}",
        "base_max_m": "{:.3f}",
        "iterations": "{:.0f}",
        "evaluations": "{:.0f}",
        "starts": "{:.2f}",
        "ms_per_frame": "{:.1f}",
    }
    print(f"\n### {title}\n")
    print("| " + " | ".join(columns) + " |")
    print("|" + " --- |" * len(columns))
    for row in rows:
        cells = [form.format(row[name]) for name, form in columns.items()]
        cells[1] += " *" if row["named"] else ""
        print("| " + " | ".join(cells) + " |")
    table = pd.DataFrame(rows)
    named = table[table["named"]]
    print(
        f"\n{len(table)} views: reprojection of the best 90 % median {table['best90_px'].median():.1f} px, "
        f"worst {table['best90_px'].max():.1f} px; MPJPE median {table['mpjpe_mm'].median():.0f} mm, mean "
        f"{table['mpjpe_mm'].mean():.0f} mm; MPE mean {table['mpe_mm'].mean():.0f} mm; heading off by "
        f"{table['heading_off_deg'].median():.0f} (median), {table['heading_off_deg'].max():.0f} degrees (worst); "
        "frames that did not converge: "
        f"{table['failed'].sum()} of {table['frames'].sum()}; {table['ms_per_frame'].median():.1f} ms per frame.\n"
        f"Named views (*): MPJPE mean {named['mpjpe_mm'].mean():.1f} mm, MPE mean {named['mpe_mm'].mean():.0f} mm."
    )


def main() -> None:
    parser = parser_of(__doc__, "--csv", "--set", kind="cheetah-runs")
    arguments = parser.parse_args()
    changed, runs = settings_of(arguments), runs_or_exit(parser, arguments.folder)
    tables: dict[str, list[dict]] = {"published link ratios": [], "measured lengths": [], "without Gaussian priors": []}
    for run in runs:
        meta = meta_of(run)
        measured = f"{PUBLISHED}-{meta['subject']}"
        for camera in meta["cameras"]:
            jobs = [("published link ratios", PUBLISHED, {})]
            if measured in builtin_names():
                jobs.append(("measured lengths", measured, {}))
            if camera == meta.get("monocular_camera"):
                jobs.append(("without Gaussian priors", PUBLISHED, {"angle_prior": "none"}))
            for title, skeleton, options in jobs:
                try:
                    tables[title].append(view_row(run, camera, skeleton, **options, **changed))
                except InputError as error:
                    print(f"{run.name} cam{camera}: left out: {error}")
    for title, rows in tables.items():
        if rows:
            print_table(rows, title)
    if arguments.csv:
        rows = [{"table": title, **row} for title, table in tables.items() for row in table]
        pd.DataFrame(rows).to_csv(arguments.csv, index=False)


if __name__ == "__main__":
    main()
