"""Test whether a fit notices that a clip comes from another camera of its file, for every view of real runs.

    python benchmarks/parts/which_camera.py [--jobs 2] [--views 4]

Every view of the cheetah-runs and plate-trials of $RECON_SHARED_DATA, or of ../shared/data, is fitted with each camera
of its run, which is chosen by name from one file. --views n uses every n-th view only. The correct camera is fitted
again with each of the correct inputs of wrong_inputs.py, such as half of the detections missing, and in a world whose
ground rises by 3 %.

- found: the fits with the finding another_camera_fits
- with a limit from the other runs: the same, with a limit of twice the largest gain of the correct camera in other runs
- error beyond its interval: the error of pose or position is above the upper end of the stated interval
- without the test: the verdict if the finding another_camera_fits did not exist
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
from arguments import parser_of
from markdown_table import print_table
from wrong_inputs import BOUNDS, CASES, Case, Clip, Given, about, cameras_of, fitted, measured, views

from recon import Camera, InputError
from recon.base.arrays import Array
from recon.check import inputs
from recon.check.likelihood import Baseline
from recon.check.other_camera import gains_of, other_camera_finding
from recon.fit.result import Finding

CODE = "another_camera_fits"
RIGHT, OTHER = "correct camera", "another camera"
SLOPE = about("y", float(np.degrees(np.arctan(0.03))))


@dataclass(frozen=True, eq=False)
class OnSlope(Clip):
    """One or two cameras of a run in a world whose ground rises by 3 % along the run."""

    def camera(self, name: str) -> Camera:
        camera = super().camera(name)
        return replace(camera, rotation=np.asarray(camera.rotation) @ SLOPE.T)

    def given(self, name: str) -> Given:
        return replace(super().given(name), R=SLOPE)


def row(clip: Clip, name: str, case: Case, given_name: str) -> dict[str, Any] | None:
    """Fit a clip with a camera of its run, and return gain, verdict and errors, or None if the fit is refused."""
    gains: list[float] = []

    def change(clip: Clip, given: Given) -> Given:
        return replace(case.change(clip, given), camera=clip.camera(given_name))

    def tested(baseline: Baseline, noise_px: Array, cameras: Sequence[Camera]) -> Iterator[Finding]:
        gains.extend(gains_of(baseline, noise_px, cameras).values())
        yield from other_camera_finding(baseline, noise_px, cameras)

    with tempfile.TemporaryDirectory() as folder, patch.object(inputs, "other_camera_finding", tested):
        try:
            motion, given = fitted(clip, Case(change, whole_file=True), Path(folder))
        except InputError:
            return None
    others = [item.numbers["others"] for item in motion.findings if item.code == CODE]
    warned = [item for item in motion.findings if item.severity != "note" and item.code != CODE]
    assert motion.verdict is not None
    level, figures = motion.verdict.level, {"pose_mm": 0.0, "position_m": 0.0} | measured(clip, given, motion)
    is_beyond = any(figures[of] > figures.get(bound, 1e9) for of, bound in BOUNDS.items())
    return {
        "camera": name,
        "run": clip.run.name,
        "gain": max(gains, default=-float("inf")),
        "found": bool(others),
        "true listed": any(clip.cameras[0] in names for names in others if isinstance(names, tuple)),
        "use": level == "use",
        "use without": level == "use" or (level == "check" and bool(others) and not warned),
        "beyond": is_beyond,
    }


def rows_of(clip: Clip) -> list[dict[str, Any]]:
    own = clip.cameras[0]
    rows = [row(clip, RIGHT if name == own else OTHER, CASES["untouched"], name) for name in cameras_of(clip.run)]
    rows.append(row(OnSlope(clip.run, clip.cameras), f"{RIGHT}, ground that rises", CASES["untouched"], own))
    right = {name: case for name, case in CASES.items() if name.startswith("right: ")}
    rows += [row(clip, f"{RIGHT}, {name.removeprefix('right: ')}", case, own) for name, case in right.items()]
    return [one for one in rows if one is not None]


def found_without_run(table: pd.DataFrame, part: pd.DataFrame) -> int:
    """Count the fits of `part` whose gain exceeds twice the largest gain of the correct camera in the other runs."""
    right = table[table["camera"] == RIGHT]
    limits = {run: 2 * right[right["run"] != run]["gain"].max() for run in part["run"].unique()}
    return int((part["gain"] > part["run"].map(limits)).sum())


def main() -> None:
    parser = parser_of(__doc__, "--jobs", "--csv")
    parser.add_argument("--views", type=int, default=1, help="every n-th view only (default: all)")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for of_clip in pool.map(rows_of, views()[:: arguments.views]):
            rows += of_clip
    if not rows:
        parser.exit(message="no recordings: nothing measured\n")
    table = pd.DataFrame(rows)
    if arguments.csv:
        table.to_csv(arguments.csv, index=False)
    figures = []
    for name in table["camera"].unique():
        part = table[table["camera"] == name]
        beyond = part[part["beyond"]]
        figures.append([name, len(part), f"{part['gain'].max():.1f}", part["found"].sum()])
        figures[-1] += [found_without_run(table, part), part["true listed"].sum() if name == OTHER else ""]
        figures[-1] += [part["use without"].sum(), part["use"].sum()]
        figures[-1] += [beyond["use without"].sum(), beyond["use"].sum()]
    header = ["camera", "fits", "largest gain", "found", "with a limit from the other runs", "true camera listed"]
    beyond_text = '"use", error beyond its interval'
    print_table([*header, '"use" without the test', '"use"', f"{beyond_text}, without the test", beyond_text], figures)


if __name__ == "__main__":
    main()
