"""Shift the second of two cameras in time, and estimate the offset with `recon fit --set find-offsets=true`.

    python benchmarks/parts/out_of_step.py [FOLDER]

Each run is a folder as in `cheetah_runs.py`, used with the named camera and the camera that sees the animal from the
most different direction. The second camera's detections are taken a number of frames later, interpolated linearly
between frames. Real cameras have small time offsets of their own, and after the shift fewer frames have both cameras.
Therefore the result is compared with the estimate from the same detections without a shift. Errors are over all 24
joints. FOLDER is by default the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data. The script runs in one
thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from cameras import PRIOR, Run, errors, most_different, runs_given, solved
from markdown_table import print_table
from trajectory import body_of, prior_of

from recon.check.time_offsets import solve_time_offsets
from recon.clip import Source, views_of
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory

OFFSETS = (0.0, 0.5, -0.5, 2.3, -2.3, 5.5, -5.5)


def taken_later(source: Source, frames: float) -> Source:
    """Return a source in which each frame has the detections of `frames` frames later, where they exist."""
    keypoints = source.keypoints
    T = len(keypoints.frames)
    a, b = (np.clip(np.arange(T) + int(f(frames)), 0, T - 1) for f in (np.floor, np.ceil))
    share, inside = np.full((T, 1), frames - np.floor(frames)), remaining(T, frames)

    def moved(values: np.ndarray, share: np.ndarray) -> np.ndarray:
        return (1 - share) * values[a] + share * values[b]

    xy_px = np.where(inside[:, None, None], moved(keypoints.xy_px, share[..., None]), np.nan)
    confidence = np.where(np.isnan(xy_px[..., 0]), 0.0, moved(keypoints.confidence, share))
    return replace(source, keypoints=replace(keypoints, xy_px=xy_px, confidence=confidence))


def remaining(T: int, frames: float) -> np.ndarray:
    """Return a mask (T,) of the rows that have detections `frames` frames later."""
    at = np.arange(T) + frames
    return (at >= 0) & (at <= T - 1)


def without(source: Source, rows: np.ndarray) -> Source:
    """Return a source without the detections of some rows (T,)."""
    keypoints = source.keypoints
    xy_px = np.where(rows[:, None, None], np.nan, keypoints.xy_px)
    return replace(
        source,
        keypoints=replace(keypoints, xy_px=xy_px, confidence=np.where(rows[:, None], 0.0, keypoints.confidence)),
    )


def rows(run: Run) -> Iterator[dict]:
    """Shift a camera by each of `OFFSETS`, and yield a row with the errors of the estimated time offset."""
    body, prior, fps = body_of(run.subject), prior_of(PRIOR), run.fps
    cameras = [run.named, most_different(run)]
    first, second = (run.sources[camera] for camera in cameras)
    options = TrajectoryOptions(find_offsets=True)

    def solve(sources: tuple[Source, ...]) -> TrajectorySolution:
        return solve_trajectory(views_of(sources), body, prior, fps, options)

    def found(other: Source) -> tuple[float, float, float]:
        """Estimate the time offset, and return it with its standard deviation, frames, and the MPJPE, mm.

        `other` is the source of the second camera.
        """
        noise = (options.sigma_px, options.keypoint_noise_m(body))
        sources, solution = solve_time_offsets([first, other], [0.0, 0.0], solve, *noise)
        truth_m = np.full((len(sources[0].keypoints.frames), *run.truth_m.shape[1:]), np.nan)
        truth_m[first.keypoints.frames - sources[0].keypoints.frames[0]] = run.truth_m
        error_mm = errors(replace(run, truth_m=truth_m), solution)["mpjpe_mm"]
        return (
            sources[1].offset_s * fps + solution.time_offset_frames[1],
            solution.time_offset_sigma_frames[1],
            error_mm,
        )

    for applied in OFFSETS:
        offset, sigma, error_mm = found(taken_later(second, applied))
        own, _, own_error_mm = found(without(second, ~remaining(len(run.truth_m), -applied)))
        yield {
            "run": run.folder.name[:28],
            "offset applied": f"{applied:+.1f}",
            "estimated": f"{offset:+.2f} ± {sigma:.2f}",
            "without the shift": f"{own:+.2f}",
            "error": abs(offset - own - applied),
            "MPJPE mm": error_mm,
            "MPJPE increase mm": error_mm - own_error_mm,
            "MPJPE without estimation mm": errors(run, solved(run, cameras, body))["mpjpe_mm"] if applied == 0 else "",
        }


def main() -> None:
    runs = runs_given(__doc__)
    found = [row for run in runs for row in rows(run)]
    print_table(list(found[0]), [[f"{v:.2f}" if isinstance(v, float) else v for v in row.values()] for row in found])
    worst = {name: max(abs(row[name]) for row in found) for name in ("error", "MPJPE increase mm")}
    print(f"worst: {worst['error']:.2f} frames of error, {worst['MPJPE increase mm']:.1f} mm change of MPJPE")


if __name__ == "__main__":
    main()
