"""Retarget real runs and the samples to the built-in robots, and measure scale, slip, limits and closure of strides.

    python benchmarks/parts/retarget.py [FOLDER] [--robot a1 --robot aibo] [--picture OUT.rrd]

Each run is fitted from the camera that its meta.json names, with the default settings. FOLDER is by default the
cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data; without any runs, only the samples are used. The script runs
in one thread. --picture writes a playback of the last clip, paused in its middle.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from arguments import parser_of, runs_of
from recordings import fit_settings, meta_of

from recon import FitSettings
from recon.api.clip_results import run_clip
from recon.fit.motion import Motion
from recon.robotics.playback import write_robot
from recon.robotics.quadruped import LEGS, builtin_robots, load_robot
from recon.robotics.retarget import Retargeting, reference_of, retarget
from recon.robotics.retarget_clip import companion

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = (
    "clip",
    "robot",
    "scale (largest)",
    "slower",
    "speed, m/s",
    "slip, mm: clip / stride",
    "margin, rad",
    "fastest rate, %",
    "below ground, mm",
    "hind feet out, mm",
    "legs apart, mm",
    "out of reach, %",
    "stride from",
    "gap, %",
    "closing, %",
    "s",
)


def fits(folder: Path, work: Path) -> Iterator[tuple[str, Motion]]:
    """Fit the sample and each run, and yield their names and fits."""
    samples = ROOT / "data" / "samples"
    yield (
        "sample, whole animal",
        fitted(
            work / "whole", FitSettings(keypoints=(samples / "whole.csv",), camera=(samples / "camera.toml",), fps=60)
        ),
    )
    for run in runs_of(folder):
        yield run.name, fitted(work / run.name, fit_settings(run, [meta_of(run)["monocular_camera"]]))


def fitted(out: Path, settings: FitSettings) -> Motion:
    run_clip(settings, out)
    return Motion.load(out)


def row(clip: str, solved: Retargeting, seconds: float) -> list[str]:
    both = (solved.clip, solved.stride)
    most = both[0].robot.stand_m / solved.animal.reference.leg_m
    slips = " / ".join(f"{1000 * motion.slip_m.max():.2f}" for motion in both)
    window, way = solved.window, both[0].pose.translation[-1, :2] - both[0].pose.translation[0, :2]
    return [
        clip,
        both[0].robot.name,
        f"{both[0].scale:.3f} ({most:.3f})",
        f"{both[0].slower:.2f}",
        f"{float(np.hypot(*way)) / both[0].time_s[-1]:.2f}",
        slips,
        f"{min(motion.margin_rad.min() for motion in both):.3f}",
        f"{100 * max(motion.rate_share.max() for motion in both):.0f}",
        f"{max(0.0, *(-1000 * motion.points(label)[..., 2].min() for motion in both for label in LEGS)):.2f}",
        f"{1000 * solved.spread_m:.0f}",
        f"{1000 * min(motion.apart_m for motion in both):.0f}",
        f"{100 * max(motion.short.mean() for motion in both):.0f}",
        {"stride": "a complete one", "return": "nearest return"}[window.source],
        f"{window.gap_percent:.0f}",
        f"{solved.stride.closing_percent:.2f}",
        f"{seconds:.1f}",
    ]


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    parser.add_argument("--robot", action="append", help="a1, aibo, or a file; may be repeated")
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    robots = [load_robot(name) for name in arguments.robot or builtin_robots()]
    print("| " + " | ".join(COLUMNS) + " |")
    print("|" + " --- |" * len(COLUMNS))
    solved = None
    with tempfile.TemporaryDirectory() as work:
        for clip, results in fits(arguments.folder, Path(work)):
            for robot in robots:
                started = time.perf_counter()
                solved = retarget(reference_of(results), robot)
                print("| " + " | ".join(row(clip, solved, time.perf_counter() - started)) + " |", flush=True)
    if arguments.picture and solved is not None:
        write_robot(solved.clip, arguments.picture, companion(solved))


if __name__ == "__main__":
    main()
