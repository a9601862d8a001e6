"""Exchange left and right in one of three or more cameras of real runs, and count the swaps that findings name.

    python benchmarks/parts/swaps_of_several.py [FOLDER] [--first 0] [--every 6] [--csv TABLE.csv]

Each run is a folder as in `cheetah_runs.py`. A clip has the files of three or more cameras: one camera, and those that
follow it in the run's list. It is fitted by `recon fit` as recorded, and with left and right exchanged in its first
camera. A planted swap counts as named if a finding is on this camera, on exactly these keypoints, and on frames that
overlap the exchanged frames by at least half. Other findings on swaps are checked by the reconstruction from all
cameras: they are confirmed if its projections are closer to the exchanged keypoints, and otherwise false. FOLDER is by
default the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from arguments import parser_of, runs_or_exit
from left_right_swaps import SWAP, UNCLEAR, View, agreed, stretch_of, view_in_run
from markdown_table import print_table
from recordings import fit_settings, meta_of
from trajectory import GROUPS

from recon import FitSettings, Motion, fit_clip, read_keypoints
from recon.animal.body import other_side
from recon.check.swaps import exchanged_rows
from recon.fit.result import Finding
from recon.io.deeplabcut import write_csv

LEAST = 3
"""Smallest number of cameras of a clip."""
CASES: dict[str, tuple[str | None, float | int]] = {
    "nothing": (None, 0),
    "all, 5 frames": (None, 5),
    "all, 10 frames": (None, 10),
    "all, whole clip": (None, 1.0),
    "fore legs, 10 frames": ("fore legs", 10),
    "fore legs, second half": ("fore legs", 0.5),
    "hind legs, 10 frames": ("hind legs", 10),
    "hind legs, second half": ("hind legs", 0.5),
}
"""Exchanged keypoints (a key of `trajectory.GROUPS`, or None for all), and a number of frames in the middle of the clip
or a fraction of the clip at its end."""
FIT = ["run", "cameras", "case"]
"""Columns that are the same in all rows of a fit."""


@dataclass(frozen=True)
class Clip:
    """Cameras of a run, with left and right exchanged in the first one."""

    run: Path
    cameras: tuple[int, ...]
    case: str


def clips_of(run: Path, first: int, every: int) -> Iterator[Clip]:
    cameras = meta_of(run)["cameras"]
    ring = (*cameras, *cameras)
    for count in range(LEAST, len(cameras) + 1):
        for number in range(first, len(cameras), every):
            of_clip = ring[number : number + count]
            for case in CASES:
                if case != "nothing" or count < len(cameras) or number == first:
                    yield Clip(run, of_clip, case)


def exchanged_frames(case: str, T: int) -> slice:
    _, length = CASES[case]
    if isinstance(length, int):
        return slice(T // 2 - length // 2, T // 2 - length // 2 + length)
    return slice(T - round(length * T), T)


def permutation_of(case: str, names: Sequence[str]) -> np.ndarray:
    """Return the permutation (J,) of keypoints with which a case exchanges left and right."""
    group, _ = CASES[case]
    within = () if case == "nothing" else GROUPS[group] if group else names
    return np.array([list(names).index(other_side(name)) if name in within else j for j, name in enumerate(names)])


def settings_of(clip: Clip, folder: Path) -> FitSettings:
    """Return the settings of the fit of a clip, after writing the changed file into a folder."""
    paths = [clip.run / f"cam{camera}.csv" for camera in clip.cameras]
    if clip.case != "nothing":
        file = read_keypoints(paths[0])
        rows = exchanged_frames(clip.case, len(file.frames))
        changed = exchanged_rows(file, rows, permutation_of(clip.case, file.names))
        paths[0] = folder / paths[0].name
        write_csv(replace(file, **changed, fps=None), paths[0])
    return fit_settings(clip.run, clip.cameras, keypoints=tuple(paths))


@cache
def recorded(run: Path, camera: int) -> View:
    return view_in_run(run, camera)


def as_fitted(clip: Clip, number: int) -> View:
    """Return the view with index `number` of a clip, with its exchanged keypoints and the reconstruction."""
    view = recorded(clip.run, clip.cameras[number])
    if number or clip.case == "nothing":
        return view
    rows = exchanged_frames(clip.case, len(view.xy_px))
    return with_sides_exchanged(view, rows, permutation_of(clip.case, view.file.names))


def with_sides_exchanged(view: View, rows: slice, permutation: np.ndarray) -> View:
    return replace(view, file=replace(view.file, **exchanged_rows(view.file, rows, permutation)))


def is_planted(clip: Clip, motion: Motion, found: Finding) -> bool:
    """Return whether a finding is on the exchanged keypoints of a clip, and on about the exchanged frames."""
    if clip.case == "nothing" or found.camera != f"cam{clip.cameras[0]}":
        return False
    stretch, rows = stretch_of(motion, found), exchanged_frames(clip.case, len(motion.frames))
    both = min(stretch.rows.stop, rows.stop) - max(stretch.rows.start, rows.start)
    either = max(stretch.rows.stop, rows.stop) - min(stretch.rows.start, rows.start)
    return np.array_equal(stretch.permutation, permutation_of(clip.case, motion.names)) and 2 * both >= either


def rows_of(clip: Clip) -> Iterator[dict[str, Any]]:
    """Fit a clip, and yield a row for each finding on a swap, or a row without a finding."""
    with tempfile.TemporaryDirectory() as folder:
        motion = fit_clip(settings_of(clip, Path(folder)))
    row = {"run": clip.run.name, "cameras": " ".join(map(str, clip.cameras)), "count": len(clip.cameras)}
    row |= {"case": clip.case, "checks_s": motion.solution.stage_s["input_findings"]}
    row |= {"solve_s": motion.solution.stage_s["all"], "code": "", "planted": False, "confirmed": False}
    swaps = [found for found in motion.findings if found.code in (SWAP, UNCLEAR)]
    names = [source.camera.name for source in motion.sources]
    views = [as_fitted(clip, number) for number in range(len(names))]
    for found in swaps:
        number, stretch = names.index(str(found.camera)), stretch_of(motion, found)
        yield row | {
            "code": found.code,
            "camera": found.camera,
            "frames": "{} to {}".format(*found.frames) if found.frames else "all",
            "part": found.numbers["part"],
            "gain": found.numbers["log_likelihood_ratio"],
            "planted": is_planted(clip, motion, found),
            "confirmed": agreed(views[number], motion.solution.noise_px[number], stretch),
        }
        views[number] = with_sides_exchanged(views[number], stretch.rows, stretch.permutation)
    if not swaps:
        yield row


def print_counts(table: pd.DataFrame, by: str) -> None:
    """Print how many planted swaps are named, and how many other findings are confirmed and false."""
    titles = {"case": "exchanged", "count": "cameras"}
    head = [titles.get(by, by), "fits", "planted swap named", "or as possible", "other swaps: confirmed", "false"]
    counted = []
    for name, rows in table.groupby(by, sort=False):
        found, planted = rows[rows["code"] != ""], rows["case"] != "nothing"
        named = [
            len(found[found["planted"] & found["code"].isin(codes)].groupby(FIT))
            for codes in ((SWAP,), (SWAP, UNCLEAR))
        ]
        others = [found[~found["planted"] & (found["confirmed"] == is_confirmed)] for is_confirmed in (True, False)]
        counts = [f"{(one['code'] == SWAP).sum()}, possible {(one['code'] == UNCLEAR).sum()}" for one in others]
        fits = len(rows[planted].groupby(FIT))
        counted.append([name, len(rows.groupby(FIT)), f"{named[0]} of {fits}", named[1], *counts])
    print_table(head, counted)


def print_recorded(table: pd.DataFrame) -> None:
    """Print the swaps that findings on the clips as recorded name, and in how many of the clips with that camera."""
    recorded_clips = table[table["case"] == "nothing"]
    found, rows = recorded_clips[recorded_clips["code"] != ""], []
    for (run, camera, part), swaps in found.groupby(["run", "camera", "part"]):
        of_run = recorded_clips[recorded_clips["run"] == run].drop_duplicates(FIT)
        clips = sum(str(camera).removeprefix("cam") in cameras.split() for cameras in of_run["cameras"])
        named = [len(swaps[swaps["code"] == code].groupby(FIT)) for code in (SWAP, UNCLEAR)]
        confirmed = f"{swaps['confirmed'].sum()} of {len(swaps)}"
        rows.append(
            [run, camera, part, ", ".join(sorted(set(swaps["frames"]))), f"{named[0]} of {clips}", named[1], confirmed]
        )
    print_table(["run", "camera", "keypoints", "frames", "named", "named as possible", "confirmed"], rows)


def main() -> None:
    parser = parser_of(__doc__, "--csv", kind="cheetah-runs")
    parser.add_argument("--first", type=int, default=0, help="index of the first camera with exchanged keypoints")
    parser.add_argument("--every", type=int, default=6, help="exchange the keypoints of every n-th camera")
    arguments = parser.parse_args()
    runs = runs_or_exit(parser, arguments.folder)
    clips = [clip for run in runs for clip in clips_of(run, arguments.first, arguments.every)]
    table = pd.DataFrame([row for clip in clips for row in rows_of(clip)])
    if arguments.csv:
        table.to_csv(arguments.csv, index=False)
    for by in ("case", "count", "run"):
        print_counts(table, by)
    print_recorded(table)


if __name__ == "__main__":
    main()
