"""Compare the errors that a fit of one camera states with its true errors, for every view of real runs.

    python benchmarks/parts/stated_errors.py [FOLDER] [--quick] [--set path=free ...]

Each run of FOLDER, by default the cheetah-runs of $RECON_SHARED_DATA, has camN.csv, scene.json, truth.csv and
meta.json. Every view is fitted like `recon fit` without further options, so the animal's size is not known. --quick
uses only the camera that meta.json names.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from arguments import parser_of, runs_of, settings_of
from markdown_table import percent, print_table
from recordings import fit_settings, meta_of

from recon import Pose3D, evaluate, fit_clip, read_pose3d
from recon.fit.result import ExpectedError

HEADER = (
    *("run", "camera", "verdict", "pose error, mm", "stated", "at least", "at most"),
    *("position error, m", "stated", "at least", "at most"),
)


def view_row(run: Path, camera: int, options: dict[str, Any]) -> tuple[list[str], bool, bool]:
    """Fit one view, and return its table row and whether pose and position error are within the stated bounds."""
    motion = fit_clip(fit_settings(run, [camera], **options))
    verdict = motion.verdict
    assert verdict is not None
    score = evaluate(Pose3D(motion.names, motion.joints_m, motion.frames), read_pose3d(run / "truth.csv"))
    pose_m, position_m = score.mpjpe_m.mean, score.position_m
    cells = [run.name, str(camera), verdict.level, f"{1000 * pose_m:.0f}"]
    cells += [f"{1000 * value:.0f}" for value in values_of(verdict.pose_m)]
    cells += [f"{position_m:.2f}", *(f"{value:.2f}" for value in values_of(verdict.position_m))]
    return cells, holds(verdict.pose_m, pose_m), holds(verdict.position_m, position_m)


def values_of(expected: ExpectedError | None) -> tuple[float, float, float]:
    """Return the expected error and the ends of its 90 % interval, or NaN if the verdict states no error."""
    return (np.nan, np.nan, np.nan) if expected is None else (expected.expected, expected.low, expected.high)


def holds(expected: ExpectedError | None, error_m: float) -> bool:
    """Return whether a true error, m, is at most the upper end of the stated 90 % interval."""
    return expected is not None and error_m <= expected.high


def main() -> None:
    parser = parser_of(__doc__, "--quick", "--set", kind="cheetah-runs")
    arguments = parser.parse_args()
    options = settings_of(arguments)
    rows = []
    for run in runs_of(arguments.folder):
        meta = meta_of(run)
        cameras = [meta["monocular_camera"]] if arguments.quick else meta["cameras"]
        rows += [view_row(run, camera, options) for camera in cameras]
    if not rows:
        parser.exit(message=f"no runs in {arguments.folder}: nothing measured\n")
    print_table(HEADER, [cells for cells, _, _ in rows])
    pose, position = (percent(float(np.mean([row[part] for row in rows]))) for part in (1, 2))
    print(f"Not beyond the upper end of the stated interval: {pose} of poses, {position} of positions.")


if __name__ == "__main__":
    main()
