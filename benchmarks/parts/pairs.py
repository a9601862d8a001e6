"""Pairs of cameras as calibrated, and with the second one turned: errors, intervals and verdicts of `recon fit`.

    python benchmarks/parts/pairs.py [--jobs 2] [--pairs 2] [--degrees 0 1 3 6] [--cameras two one all]

The cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data. Two: the named camera of each run with `--pairs` others,
those with the most detections; by default with all others. The second camera is turned about a random axis through its
centre. One: the named camera; all: all cameras of a run, both untouched. Fits are those of `recon fit --fast`, with
other settings by --set.

Columns: how many fits refined the second camera; means over the fits of the errors of pose and position; the share of
the joints' coordinates in the world inside 90 % intervals, of all fits and of the worst; and the verdicts. Then, the
fits of untouched cameras that are "do not use", with the findings that say why. One thread for each job.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from arguments import parser_of, runs_of, settings_of
from markdown_table import print_table
from recordings import recordings
from scipy.spatial.transform import Rotation
from wrong_inputs import Case, Clip, Given, cameras_of, errors, fitted, truth_on

from recon import InputError
from recon.api.clip import PAIR_REFINED
from recon.fit.result import LEVELS
from recon.testing.coverage import coordinate_coverage

COLUMNS = (
    *("cameras", "fits", "refined", "pose, mm", "position, mm", "coordinates inside 90 %, worst fit"),
    "use / check / do not use",
)


@dataclass(frozen=True)
class Outcome:
    """One fit."""

    label: str
    name: str
    """The run and its cameras."""
    is_refined: bool
    pose_mm: float
    position_mm: float
    inside: float
    level: str
    codes: tuple[str, ...]
    """Codes of errors and warnings."""


def turned(degrees: float, settings: dict[str, str]) -> Callable[[Clip, Given], Given]:
    """Return the change that turns a camera about a random axis."""

    def change(clip: Clip, given: Given) -> Given:
        axis = np.random.default_rng(sum(map(ord, "".join(clip.cameras)))).normal(size=3)
        turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
        camera = given.camera
        assert camera.rotation is not None
        assert camera.translation_m is not None
        camera = replace(camera, rotation=turn @ camera.rotation, translation_m=turn @ camera.translation_m)
        return replace(given, camera=camera, told={"fast": True} | settings)

    return change


def tasks(cameras: Sequence[str], pairs: int | None, degrees: Sequence[float]) -> Iterator[tuple[str, Clip, float]]:
    """Yield the label, the clip and the turn of each fit."""
    for run in runs_of(recordings("cheetah-runs")):
        names = cameras_of(run)
        others = sorted(names[1:], key=partial(detections, run), reverse=True)[:pairs]
        if "two" in cameras:
            for angle in degrees:
                label = f"two, the second turned by {angle:g}°" if angle else "two"
                yield from ((label, Clip(run, (names[0], name)), angle) for name in others)
        yield from (("one", Clip(run, (names[0],)), 0.0) for label in cameras if label == "one")
        yield from (("all", Clip(run, tuple(names)), 0.0) for label in cameras if label == "all")


def detections(run: Path, camera: str) -> int:
    """Return how many keypoints a camera sees."""
    return int(np.isfinite(Clip(run, (camera,)).given(camera).xy_px[..., 0]).sum())


def outcome(settings: dict[str, str], task: tuple[str, Clip, float]) -> Outcome | None:
    """Fit a clip; None if it is refused or has no pose."""
    label, clip, degrees = task
    with tempfile.TemporaryDirectory() as folder:
        try:
            motion, given = fitted(
                clip, Case(turned(degrees, settings), both=len(clip.cameras) != 2, two=True), Path(folder)
            )
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
    return Outcome(label, name, is_refined, pose_mm, 1000 * position_m, inside, motion.verdict.level, serious)


def main() -> None:
    """Print a row for each kind of cameras, and the fits that are not to be used."""
    parser = parser_of(__doc__, "--jobs", "--set")
    parser.add_argument("--pairs", type=int, help="only so many pairs of each run")
    parser.add_argument("--degrees", nargs="+", type=float, default=[0.0, 1.0, 3.0, 6.0])
    parser.add_argument("--cameras", nargs="+", choices=["one", "two", "all"], default=["one", "two", "all"])
    options = parser.parse_args()
    every_task = [*tasks(options.cameras, options.pairs, options.degrees)]
    with ProcessPoolExecutor(options.jobs) as pool:
        outcomes = [*pool.map(partial(outcome, settings_of(options)), every_task)]
    fits = [fit for fit in outcomes if fit is not None]
    rows = []
    for label in dict.fromkeys(label for label, _, _ in every_task):
        of_label = [fit for fit in fits if fit.label == label]
        if not of_label:
            continue
        inside = [fit.inside for fit in of_label]
        levels = " / ".join(str(sum(fit.level == level for fit in of_label)) for level in reversed(LEVELS))
        means = [f"{np.mean([getattr(fit, name) for fit in of_label]):.0f}" for name in ("pose_mm", "position_mm")]
        shares = f"{np.mean(inside):.0%}, {min(inside):.0%}"
        rows.append([label, len(of_label), sum(fit.is_refined for fit in of_label), *means, shares, levels])
    print_table(COLUMNS, rows)
    untouched = [fit for fit in fits if "turned" not in fit.label and fit.level == LEVELS[0]]
    print_table(
        ("do not use", "pose, mm", "findings"), [(f.name, f"{f.pose_mm:.0f}", ", ".join(f.codes)) for f in untouched]
    )


if __name__ == "__main__":
    main()
