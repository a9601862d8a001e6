"""Measure errors, intervals and verdicts of `recon fit` for pairs of cameras as calibrated, and with one turned.

    python benchmarks/parts/pairs.py [--jobs 2] [--pairs 2] [--degrees 0 1 3 6] [--turned second] [--cameras two]

The fits use the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data. "two" is the named camera of each run with
each of the `--pairs` other cameras that have the most detections, by default with all others. One of the two is turned
about its centre, in separate fits for each of its axes (tilt, pan, roll). "one" is the named camera, and "all" are all
cameras of a run, both unchanged. Clips are fitted like `recon fit --fast`; --set changes the settings of the fits.

The columns are the number of fits that refined a camera; the errors of pose and position, as means over the fits; the
fraction of the joints' world coordinates inside 90 % intervals, for all fits and for the worst; and the verdicts. The
last table lists the fits of unchanged cameras that are "do not use", with the findings that explain this. Each job has
one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from arguments import parser_of, runs_of, settings_of
from markdown_table import print_table
from recordings import recordings
from scipy.spatial.transform import Rotation
from wrong_inputs import Case, Clip, Given, cameras_of, errors, fitted, truth_on

from recon import InputError
from recon.api.clip import PAIR_REFINED
from recon.fit import constants
from recon.fit.result import LEVELS
from recon.testing.coverage import coordinate_coverage

COLUMNS = (
    *("cameras", "fits", "refined", "pose, mm", "position, mm", "coordinates inside 90 %, worst fit"),
    "use / check / do not use",
)


@dataclass(frozen=True)
class Outcome:
    """Errors, coverage and verdict of one fit."""

    label: str
    name: str
    """Name of the run and of its cameras."""
    is_refined: bool
    pose_mm: float
    position_mm: float
    inside: float
    """Fraction of the joints' world coordinates inside their 90 % intervals."""
    level: str
    """Level of the verdict: use, check or do not use."""
    codes: tuple[str, ...]
    """Codes of the findings that are errors or warnings."""


@dataclass(frozen=True, eq=False)
class Task:
    """One fit, with its cameras and the angle by which one camera of a pair is turned."""

    label: str
    clip: Clip
    degrees: float = 0.0
    axis: int = 0
    """Index in `AXES` of the camera's axis of rotation."""
    turned: str = "second"


AXES = "tilt", "pan", "roll"
"""Names of the rotations about a camera's x, y and z axes."""


def turn(task: Task, settings: dict[str, str]) -> Callable[[Clip, Given], Given]:
    """Return a change that turns one camera of a pair and adds the settings of the fit."""
    turned_camera = task.clip.cameras[-1 if task.turned == "second" else 0]

    def change(clip: Clip, given: Given) -> Given:
        given = replace(given, settings={"fast": True} | settings)
        if given.camera.name != turned_camera:
            return given
        by = Rotation.from_rotvec(np.radians(task.degrees) * np.eye(3)[task.axis]).as_matrix()
        return given.turned(by)

    return change


def tasks(options: argparse.Namespace) -> Iterator[Task]:
    """Yield the fits that the command line selects."""
    for run in runs_of(recordings("cheetah-runs")):
        names = cameras_of(run)
        others = sorted(names[1:], key=partial(detections, run), reverse=True)[: options.pairs]
        pairs = [Clip(run, (names[0], name)) for name in others]
        if "two" in options.cameras:
            if 0 in options.degrees:
                yield from (Task("two", pair) for pair in pairs)
            for degrees, turned in product([d for d in options.degrees if d], options.turned):
                label = f"two, the {turned} turned by {degrees:g}°"
                yield from (Task(label, pair, degrees, axis, turned) for pair in pairs for axis in range(3))
        yield from (Task("one", Clip(run, (names[0],))) for label in options.cameras if label == "one")
        yield from (Task("all", Clip(run, tuple(names))) for label in options.cameras if label == "all")


def detections(run: Path, camera: str) -> int:
    """Count the detections of a camera in a run."""
    return int(np.isfinite(Clip(run, (camera,)).given(camera).xy_px[..., 0]).sum())


def outcome(settings: dict[str, str], task: Task) -> Outcome | None:
    """Fit a clip, and return errors, coverage and verdict, or None if the clip is refused or has no pose."""
    clip = task.clip
    with tempfile.TemporaryDirectory() as folder:
        try:
            motion, given = fitted(clip, Case(turn(task, settings), both=True, two=True), Path(folder))
        except InputError:
            return None
    off_m = motion.joints_m - truth_on(clip, given, motion)
    known = np.isfinite(off_m).all(axis=(1, 2))
    if not known.any() or motion.verdict is None:
        return None
    R = motion.T_reference_world[:3, :3]
    inside = coordinate_coverage(off_m[known], (R @ motion.solution.covariance_m2 @ R.T)[known], 0.9)
    pose_mm, position_m = errors(off_m[known])
    serious = tuple(sorted({item.code for item in motion.findings if item.severity != "note"}))
    is_refined = any(item.code in PAIR_REFINED for item in motion.findings)
    name = f"{clip.run.name}, {' + '.join(clip.cameras)}"
    if task.degrees:
        name += f", {AXES[task.axis]}"
    return Outcome(task.label, name, is_refined, pose_mm, 1000 * position_m, inside, motion.verdict.level, serious)


def main() -> None:
    """Print a row for each kind of cameras, and the fits with the verdict "do not use"."""
    parser = parser_of(__doc__, "--jobs", "--set")
    parser.add_argument("--pairs", type=int, help="number of pairs of each run (default: all)")
    parser.add_argument(
        "--turned", nargs="+", choices=["second", "first"], default=["second"], help="which of two cameras is turned"
    )
    parser.add_argument("--every", action="store_true", help="print every fit")
    parser.add_argument(
        "--turned-share",
        type=float,
        default=constants.TURNED_SHARE,
        help="value of TURNED_SHARE (default: %(default)s)",
    )
    parser.add_argument("--degrees", nargs="+", type=float, default=[0.0, 1.0, 3.0, 6.0])
    parser.add_argument("--cameras", nargs="+", choices=["one", "two", "all"], default=["one", "two", "all"])
    options = parser.parse_args()
    every_task = [*tasks(options)]
    turned_share = (constants, "TURNED_SHARE", options.turned_share)
    with ProcessPoolExecutor(options.jobs, initializer=setattr, initargs=turned_share) as pool:
        outcomes = [*pool.map(partial(outcome, settings_of(options)), every_task)]
    fits = [fit for fit in outcomes if fit is not None]
    rows = []
    for label in dict.fromkeys(task.label for task in every_task):
        of_label = [fit for fit in fits if fit.label == label]
        if not of_label:
            continue
        inside = [fit.inside for fit in of_label]
        levels = " / ".join(str(sum(fit.level == level for fit in of_label)) for level in reversed(LEVELS))
        means = [f"{np.mean([getattr(fit, name) for fit in of_label]):.0f}" for name in ("pose_mm", "position_mm")]
        shares = f"{np.mean(inside):.0%}, {min(inside):.0%}"
        rows.append([label, len(of_label), sum(fit.is_refined for fit in of_label), *means, shares, levels])
    print_table(COLUMNS, rows)
    if options.every:
        cells = [
            (
                f.label,
                f.name,
                f"{f.pose_mm:.0f}",
                f"{f.position_mm:.0f}",
                f"{f.inside:.0%}",
                f.level,
                ", ".join(f.codes),
            )
            for f in fits
        ]
        print_table(("cameras", "fit", "pose, mm", "position, mm", "inside", "verdict", "findings"), cells)
    untouched = [fit for fit in fits if "turned" not in fit.label and fit.level == LEVELS[0]]
    print_table(
        ("do not use", "pose, mm", "findings"), [(f.name, f"{f.pose_mm:.0f}", ", ".join(f.codes)) for f in untouched]
    )


if __name__ == "__main__":
    main()
