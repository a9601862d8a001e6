"""Plant faults in real clips, and count the faults found, false findings in unchanged clips, and remaining errors.

    python benchmarks/parts/left_right_swaps.py [FOLDER ...] [--views 1] [--csv TABLE.csv]

Each run is a folder as in `cheetah_runs.py`, or with one calibration file for each camera. Every view is changed in its
file or in the settings of `recon fit`, and fitted. Errors are means of the joints' distances, both poses centred. By
default FOLDER is the cheetah-runs and plate-trials of $RECON_SHARED_DATA, or of ../shared/data; without runs, nothing
is measured. --views n uses every n-th view only. For each run, --folds prints the margin of swaps that is chosen on all
other runs. --others lists the findings in unchanged clips of other animals: dogs as in `dog.py`, with a prior from the
other clips and with independent angles, and a horse labelled by hand, with a guessed camera. These clips come from the
dog-mocap and the horse-side of $RECON_SHARED_DATA.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import dog
import numpy as np
import pandas as pd
from arguments import parser_of, runs_of
from markdown_table import print_header, print_row
from recordings import fit_settings, meta_of, recordings
from trajectory import GROUPS, PRIOR, body_of, prior_of, view_of

from recon import Camera, FitSettings, Motion, fit_clip, read_keypoints
from recon.animal.body import other_side
from recon.animal.prior import prior_from_body
from recon.animal.prior_fit import fit_prior
from recon.animal.skeleton_file import builtin_subjects
from recon.check import likelihood
from recon.check.inputs import input_findings
from recon.check.likelihood import baseline_of
from recon.check.swap_repair import swap_improves
from recon.check.swaps import Stretch, swaps
from recon.clip import Keypoints, Source, clean, views_of
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.gait.evaluation import aligned, joint_errors
from recon.io.deeplabcut import write_csv

SWAP, UNCLEAR, OUTLIERS = "left_right_swap", "left_right_swap_possible", "gross_outliers"
TEN = 10
"""Number of frames in the middle of a clip whose left and right keypoints are exchanged."""
END = 12
"""Number of frames with gross outliers at an end of a clip."""
FALSE = 0.02
"""Largest tolerable fraction of frames of unchanged clips with a false finding."""
LEGS = {"fore": "fore legs exchanged, second half", "hind": "hind legs exchanged, second half"}
FOLDED = ("untouched", "ten frames exchanged", *LEGS.values(), "whole clip exchanged")
MARGINS = (5.0, 8.0, 10.0, 12.0, 15.0, 18.0, 20.0, 25.0, 30.0)
"""Values of `recon.check.likelihood.REPORTED_GAIN` to try."""
WORSE = 1.02
"""Largest tolerable factor by which a correction increases the error of a clip."""
SPARE = 1.2
"""Factor on the smallest sufficient margin, because other runs may need a larger margin."""
Change = Callable[["View"], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class View:
    """One camera's view of a run: keypoints, lens and truth."""

    run: Path
    camera: int
    file: Keypoints
    """Keypoints of the file, in the order of the body's markers."""
    lens: Camera
    truth_m: np.ndarray
    """True positions (T, J, 3) in the camera's frame, NaN if unknown."""

    @property
    def size_px(self) -> tuple[int, int]:
        return self.lens.image_size_px

    @property
    def xy_px(self) -> np.ndarray:
        return self.file.xy_px

    @property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng(self.camera)


def _opposites(names: tuple[str, ...], group: str | None) -> np.ndarray:
    within = names if group is None else GROUPS[group]
    return np.array([names.index(other_side(n)) if n in within else i for i, n in enumerate(names)])


def _exchanged(view: View, first: int, stop: int, group: str | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Exchange left and right keypoints in some frames, and return the points and a mask (T,) of the changed frames."""
    xy_px, frames = view.xy_px.copy(), np.zeros(len(view.xy_px), dtype=bool)
    xy_px[first:stop] = xy_px[first:stop][:, _opposites(view.file.names, group)]
    frames[first:stop] = True
    return xy_px, frames


def _gross_outliers(view: View, frames: slice) -> tuple[np.ndarray, np.ndarray]:
    xy_px, changed = view.xy_px.copy(), np.zeros(len(view.xy_px), dtype=bool)
    xy_px[frames] = view.rng.uniform((0, 0), view.size_px, xy_px[frames].shape)
    changed[frames] = True
    return xy_px, changed


def _outliers(view: View) -> tuple[np.ndarray, np.ndarray]:
    xy_px, wrong = view.xy_px.copy(), view.rng.uniform(size=view.xy_px.shape[:2]) < 0.3
    xy_px[wrong] = view.rng.uniform((0, 0), view.size_px, (int(wrong.sum()), 2))
    return xy_px, np.zeros(len(xy_px), dtype=bool)


def _everywhere(points: Callable[[View], np.ndarray]) -> Change:
    return lambda view: (points(view), np.ones(len(view.xy_px), dtype=bool))


@dataclass(frozen=True)
class Case:
    """A fault of a clip's keypoints or settings."""

    change: Change
    """Function that returns the changed keypoints (T, J, 2) of a view, and a mask (T,) of the changed frames."""
    code: str | None = None
    """Code of the expected finding; None if none is expected."""
    wrong_settings: Callable[[View], dict[str, Any]] = field(default=lambda view: {})
    """Function that returns wrong settings for the fit of a view."""
    mends: bool = False
    """Whether to fit the clip with --fix-swaps as well."""


def _other_camera(view: View) -> dict[str, Any]:
    cameras = meta_of(view.run)["cameras"]
    other = cameras[(cameras.index(view.camera) + 1) % len(cameras)]
    return {"camera_name": f"cam{other}"}


def _as_given(view: View) -> tuple[np.ndarray, np.ndarray]:
    return view.xy_px, np.zeros(len(view.xy_px), dtype=bool)


def _half(view: View) -> int:
    return len(view.xy_px) // 2


CASES = {
    "untouched": Case(_as_given, mends=True),
    "ten frames exchanged": Case(lambda v: _exchanged(v, _half(v) - TEN // 2, _half(v) + TEN // 2), SWAP, mends=True),
    "fore legs exchanged, second half": Case(
        lambda v: _exchanged(v, _half(v), len(v.xy_px), "fore legs"), SWAP, mends=True
    ),
    "hind legs exchanged, second half": Case(
        lambda v: _exchanged(v, _half(v), len(v.xy_px), "hind legs"), SWAP, mends=True
    ),
    "whole clip exchanged": Case(lambda v: _exchanged(v, 0, len(v.xy_px)), SWAP, mends=True),
    "y up": Case(_everywhere(lambda v: np.array([0, v.size_px[1] - 1]) + v.xy_px * [1, -1]), "keypoints_y_up"),
    "upside down": Case(_everywhere(lambda v: np.subtract(v.size_px, 1) - v.xy_px), "picture_upside_down"),
    "from 0 to 1": Case(_everywhere(lambda v: v.xy_px / v.size_px), "keypoints_normalised"),
    "video of half the size": Case(_everywhere(lambda v: v.xy_px / 2), "smaller_video"),
    "next camera of the file": Case(_as_given, "other_camera_named", _other_camera),
    "half the frame rate": Case(_as_given, "frame_rate", lambda v: {"fps": meta_of(v.run)["fps"] / 2}),
    "twice the frame rate": Case(_as_given, "frame_rate", lambda v: {"fps": meta_of(v.run)["fps"] * 2}),
    "30 % outliers": Case(_outliers),
    "gross outliers at the start": Case(lambda v: _gross_outliers(v, slice(0, END)), OUTLIERS),
    "gross outliers at the end": Case(lambda v: _gross_outliers(v, slice(-END, None)), OUTLIERS),
}


def view_in_run(run: Path, camera: int) -> View:
    lens, xy_px, confidence, truth_m = view_of(run, camera)
    file = replace(read_keypoints(run / f"cam{camera}.csv"), names=body_of().markers)
    return View(run, camera, replace(file, xy_px=xy_px, confidence=confidence, fps=meta_of(run)["fps"]), lens, truth_m)


def fitted(view: View, case: Case, folder: Path, **more_settings: Any) -> tuple[Motion, np.ndarray]:
    """Fit the view of a case, and return the motion and a mask of the changed frames."""
    xy_px, changed = case.change(view)
    path = folder / f"cam{view.camera}.csv"
    write_csv(replace(view.file, xy_px=xy_px, fps=None), path)
    subject = meta_of(view.run)["subject"]
    known = {"keypoints": path, "subject": subject if subject in builtin_subjects() else None}
    options = known | case.wrong_settings(view) | more_settings
    return fit_clip(fit_settings(view.run, (view.camera,), **options)), changed


def error_mm(view: View, motion: Motion, frames: np.ndarray) -> float:
    """Return the mean distance of a motion's joints from the truth, mm, over the frames of a mask (T,)."""
    truth_m = view.truth_m[frames]
    if not np.isfinite(motion.joints_camera_m[frames]).any():
        return np.nan
    return 1000 * float(np.nanmean(joint_errors(aligned(motion.joints_camera_m[frames], truth_m), truth_m)))


def findings_on_input(motion: Motion) -> list[Finding]:
    """Return the findings of a fit that concern its keypoints."""
    return [one for one in motion.findings if one.code in {SWAP, *(case.code for case in CASES.values())}]


def stretch_of(motion: Motion, one: Finding) -> Stretch:
    """Return the frames of a finding on a swap, and the permutation of the swapped keypoints."""
    permutation, to = np.arange(len(motion.names)), [motion.names.index(name) for name in one.names("keypoints")]
    permutation[to] = _opposites(motion.names, None)[to]
    first, stop = np.searchsorted(motion.frames, one.frames or ())
    return Stretch(slice(int(first), int(stop)), permutation)


def named(motion: Motion, code: str, markers: tuple[int, ...] | None = None) -> np.ndarray:
    """Return a mask (T,) of the frames of the findings with a code.

    If `markers` is given, only findings on exactly these keypoints count.
    """
    frames = np.zeros(len(motion.frames), dtype=bool)
    for one in findings_on_input(motion):
        if one.code == code and (markers is None or markers == stretch_of(motion, one).markers):
            frames[slice(*(np.searchsorted(motion.frames, one.frames) if one.frames else (0, None)))] = True
    return frames


def agreed(view: View, sigma_px: np.ndarray, one: Stretch) -> bool:
    """Return whether the reconstruction from all cameras confirms that the detector exchanged the keypoints.

    `sigma_px` is the standard deviation of each detection in the fit, pixels, shape (T, J).
    """
    projected, _ = view.lens.project(view.truth_m)
    q = [np.sum((to - view.xy_px) ** 2, axis=-1) / sigma_px**2 for to in (projected, projected[:, one.permutation])]
    return float(np.nansum((np.log1p(q[0] / 3.0) - np.log1p(q[1] / 3.0))[one.rows][:, [*one.markers]])) > 0.0


def _wanted(names: tuple[str, ...], name: str) -> tuple[int, ...]:
    """Return the indices of the keypoints that the case `name` exchanges."""
    permutation = _opposites(names, {"fore": "fore legs", "hind": "hind legs"}.get(name[:4]))
    return tuple(int(j) for j in np.flatnonzero(permutation != np.arange(len(permutation))))


def row(view: View, name: str, case: Case, folder: Path, untouched_mm: float) -> dict[str, Any]:
    """Fit a view with the fault of a case, and return a row of results.

    The row has these columns among others:

    - kind_right: a finding of the right kind names the right keypoints
    - frames_right: the frames of this finding overlap the changed frames by at least half
    - other_flags: fraction of the unchanged frames that have a finding about frames
    - real_flags: fraction of the unchanged frames that have a finding which the reconstruction confirms
    """
    began = time.process_time()
    motion, changed = fitted(view, case, folder)
    seconds, others = time.process_time() - began, ~changed
    wanted = _wanted(motion.names, name) if case.code == SWAP else None
    found, flagged = named(motion, case.code or "", wanted), named(motion, SWAP) | named(motion, OUTLIERS)
    found_swaps = [one for one in motion.findings if one.code == SWAP]
    real = tuple(one for one in found_swaps if agreed(view, motion.solution.noise_px[0], stretch_of(motion, one)))
    real = named(replace(motion, findings=real), SWAP)
    scored = others if case.code == OUTLIERS else np.ones(len(changed), dtype=bool)
    mm = {"mm": error_mm(view, motion, scored)}
    if case.mends:
        mm["mended_mm"] = error_mm(view, fitted(view, case, folder, fix_swaps=True)[0], scored)
    return {
        "run": view.run.name,
        "cam": view.camera,
        "case": name,
        "kind_right": bool(found.any()),
        "frames_right": bool((found & changed).sum() >= 0.5 * (found | changed).sum()) and bool(found.any()),
        "changed_flagged": float(found[changed].mean()) if changed.any() else np.nan,
        "other_flags": float(flagged[others].mean()) if others.any() else np.nan,
        "real_flags": float(real[others].mean()) if others.any() else np.nan,
        "wrong": float((named(motion, SWAP) & ~real).mean()),
        "unclear": any(one.code == UNCLEAR for one in motion.findings),
        "kinds": " ".join(sorted({one.code for one in findings_on_input(motion)})),
        "untouched_mm": untouched_mm,
        "checks_s": motion.solution.stage_s["input_findings"],
        "solve_s": motion.solution.stage_s["all"],
        "cpu_s": seconds,
        **mm,
    }


def rows_of(view: View, only: str | None) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as folder:
        motion, _ = fitted(view, CASES["untouched"], Path(folder))
        everywhere = np.ones(len(motion.frames), dtype=bool)
        rows = []
        for name, case in CASES.items():
            if only is None or only in name:
                scored = ~case.change(view)[1] if case.code == OUTLIERS else everywhere
                rows.append(row(view, name, case, Path(folder), error_mm(view, motion, scored)))
        return rows


def print_tables(table: pd.DataFrame) -> None:
    """Print how many faults are found and how large the errors are before and after the correction.

    "Worst" is the largest ratio of the error of a view after the correction to the error before.
    """
    head = ["case", "views", "kind named", "frames right", "or unclear", "others flagged", "of which real"]
    print_header([*head, "error / untouched", "corrected / untouched", "worst: corrected / not"])
    for name, of_case in table.groupby("case", sort=False):

        def ratio(column: str, of_case: pd.DataFrame = of_case) -> str:
            if column not in of_case or of_case[column].isna().all():
                return ""
            return f"{of_case[column].sum() / of_case['untouched_mm'].sum():.2f}"

        case = CASES[str(name)]
        print_row(
            [
                name,
                len(of_case),
                f"{of_case['kind_right'].mean():.0%}" if case.code else "",
                f"{of_case['frames_right'].mean():.0%}" if case.code else "",
                f"{(of_case['unclear'] | of_case['kind_right']).mean():.0%}" if case.code in (SWAP, None) else "",
                f"{of_case['other_flags'].mean():.1%}",
                f"{of_case['real_flags'].mean():.1%}",
                ratio("mm"),
                ratio("mended_mm"),
                f"{(of_case['mended_mm'] / of_case['mm']).max():.2f}" if case.mends else "",
            ]
        )
    untouched = table[table["case"] == "untouched"]
    if len(untouched):
        wrong = untouched["kinds"].ne("").sum()
        print(
            f"\nUntouched: something is named in {wrong} of {len(untouched)} views. The checks took "
            f"{untouched['checks_s'].sum() / untouched['solve_s'].sum():.2f} times the time of the solution.\n"
        )
        print_by_run(table)


def print_by_run(table: pd.DataFrame) -> None:
    print_header(["run", "views", "untouched frames named wrongly", "of all cases", "worst: corrected / not"])
    for run, rows in table.groupby("run"):
        untouched = rows[rows["case"] == "untouched"]
        worst = (rows["mended_mm"] / rows["mm"]).max()
        print_row([run, len(untouched), f"{untouched['wrong'].mean():.1%}", f"{rows['wrong'].mean():.1%}", worst])


@contextmanager
def least_margin() -> Iterator[None]:
    """Report all swaps that exceed the smallest of `MARGINS`, within a `with` block."""
    given, likelihood.REPORTED_GAIN = likelihood.REPORTED_GAIN, MARGINS[0]
    try:
        yield
    finally:
        likelihood.REPORTED_GAIN = given


def margin_rows(view: View, name: str, case: Case, folder: Path) -> list[dict[str, Any]]:
    """Fit a view with the fault of a case, and return the results with each of `MARGINS`.

    Each row states whether the planted exchange is found, the fraction of frames that are named wrongly, and the error
    of the corrected clip relative to the error of the uncorrected clip.
    """
    motion, changed = fitted(view, case, folder)
    solution, everywhere = motion.solution, np.ones(len(changed), dtype=bool)
    setting = ClipProblem.from_views(solution.views, motion.body, prior_of(PRIOR), motion.fps, TrajectoryOptions())
    setting = replace(setting, prior_weight=min(segment.prior_weight for segment in solution.segments))
    given = baseline_of(setting, 0, solution.states, solution.size)
    with least_margin():
        trials = swaps(given, any(segment.unlike_prior for segment in solution.segments))
    ratios, wrong, right, mended = [1.0], [np.zeros(len(changed), dtype=bool)], [False], view_in(view, case)
    mm = error_mm(view, motion, everywhere)
    for trial in trials:
        rows, permutation = trial.stretch.rows, trial.stretch.permutation
        xy_px = mended.xy_px.copy()
        wrongly = wrong[-1].copy()
        wrongly[rows] |= not agreed(mended, solution.noise_px[0], trial.stretch)
        xy_px[rows] = xy_px[rows][:, permutation]
        mended = replace(mended, file=replace(mended.file, xy_px=xy_px))
        again, _ = fitted(mended, CASES["untouched"], folder)
        assert isinstance(solution, TrajectorySolution)
        assert isinstance(again.solution, TrajectorySolution)
        if not swap_improves(again.solution, solution):
            break  # this swap would be neither reported nor corrected
        wrong.append(wrongly)
        ratios.append(error_mm(view, again, everywhere) / mm)
        overlap = 2 * changed[rows].sum() >= (changed | _of(rows, len(changed))).sum()
        right.append(
            right[-1] or (case.code == SWAP and overlap and trial.stretch.markers == _wanted(motion.names, name))
        )
    found = []
    for margin in MARGINS:
        passed = [trial.ratio > margin and trial.clear for trial in trials]
        n = min(next((i for i, one in enumerate(passed) if not one), len(passed)), len(ratios) - 1)
        unclear = n < len(trials) and trials[n].ratio > margin
        said = {"wrong": wrong[n].mean(), "mended": ratios[n], "right": right[n], "unclear": unclear}
        found.append({"run": view.run.name, "case": name, "margin": margin, **said})
    return found


def view_in(view: View, case: Case) -> View:
    return replace(view, file=replace(view.file, xy_px=case.change(view)[0]))


def _of(rows: slice, T: int) -> np.ndarray:
    frames = np.zeros(T, dtype=bool)
    frames[rows] = True
    return frames


def print_folds(table: pd.DataFrame) -> None:
    """Print, for each run, the margin chosen on all other runs, and its results on this run.

    The chosen margin is the smallest one with which, in the other runs, at most `FALSE` of the frames are named wrongly
    and the correction increases the error of no clip, unchanged or with a planted exchange, by more than the factor
    `WORSE`. It is multiplied by `SPARE`. The last row is for all runs.
    """
    head = ["left out", "margin", "named wrongly", "with exchanges", "worst corrected / not", "ten frames", "fore legs"]
    print_header([*head, "hind legs", "whole clip", "right or unclear"])
    for run in [*table["run"].unique(), "none"]:
        rest = table[table["run"] != run]
        wrong = rest.groupby(["margin", "run"])["wrong"].mean().groupby("margin").max()
        allowed = (wrong <= FALSE) & (rest.groupby("margin")["mended"].max() <= WORSE)
        least = SPARE * next((margin for margin in MARGINS if allowed[margin]), MARGINS[-1])
        best = next((margin for margin in MARGINS if margin >= least), MARGINS[-1])
        part = (table if run == "none" else table[table["run"] == run]).loc[lambda t, best=best: t["margin"] == best]
        untouched, of_case = part[part["case"] == "untouched"], part[part["case"] != "untouched"]
        found = [f"{int(one.sum())} of {len(one)}" for _, one in of_case.groupby("case", sort=False)["right"]]
        found_or_unclear = f"{int((of_case['right'] | of_case['unclear']).sum())} of {len(of_case)}"
        shares = [f"{one['wrong'].mean():.1%}" for one in (untouched, of_case)]
        print_row([run, f"{best:.0f}", *shares, f"{part['mended'].max():.2f}", *found, found_or_unclear])


def dog_rows(folder: Path) -> list[dict[str, Any]]:
    body, clips = dog.body_of(), dog.read_clips(folder)
    solved, plain, rows = dog.solve(clips), prior_from_body(body), []
    for one in solved:
        known = [(other.clip.name, other.states, other.clip.fps) for other in solved if other is not one]
        for prior in (fit_prior(body, known, "the other clips"), plain):
            camera, truth_m = dog.side_view(one.clip)[0], one.clip.markers(body)
            px, _ = camera.project(camera.world_to_camera(truth_m))
            px = px + np.random.default_rng(clips.index(one.clip)).normal(0, dog.NOISE_PX, px.shape)
            keypoints = Keypoints(body.markers, px, np.ones(px.shape[:2]), np.arange(len(px)), one.clip.fps)
            source = Source(camera, *clean(keypoints, 0.0), body.markers)
            solution = solve_trajectory(views_of([source]), body, prior, one.clip.fps)
            motion = Motion((source,), None, "", solution)
            found = input_findings(motion, prior, TrajectoryOptions(), (None,))
            rows.append(_others(f"dog {one.clip.name}", len(px), prior.name, found))
    return rows


def horse_rows(folder: Path) -> list[dict[str, Any]]:
    settings: dict[str, Any] = {"keypoints": folder / "CollectedData_Byron.csv", "skeleton": "horse-22", "fps": 24.0}
    motion = fit_clip(FitSettings(**settings, hfov_deg=50.0, image_size_px=(288, 162)))
    return [_others("horse", len(motion.frames), "none", findings_on_input(motion))]


def _others(name: str, T: int, prior: str, found: Sequence[Finding]) -> dict[str, Any]:
    named = np.zeros(T, dtype=bool)
    for one in found:
        if one.code in (SWAP, OUTLIERS):
            named[slice(*(one.frames or (0, None)))] = True
    rest = sorted({one.code for one in found} - {SWAP, OUTLIERS})
    return {"clip": name, "frames": T, "prior": prior, "frames named": named.mean(), "else named": ", ".join(rest)}


def print_others(table: pd.DataFrame) -> None:
    print_header(list(table.columns))
    for row in table.itertuples(index=False):
        print_row([*row[:3], f"{row[3]:.1%}", row[4]])


def main() -> None:
    parser = parser_of(__doc__, "--csv")
    both = [recordings("cheetah-runs"), recordings("plate-trials")]
    parser.add_argument("folder", type=Path, nargs="*", default=both)
    parser.add_argument("--views", type=int, default=1, help="every n-th view only (default: all)")
    parser.add_argument("--first", type=int, default=0, help="number of the first view, from 0")
    parser.add_argument("--only", help="only cases whose names contain this text")
    parser.add_argument("--folds", action="store_true", help="choose the margin with each run left out")
    parser.add_argument("--others", action="store_true", help="list the findings in clips of other animals")
    arguments = parser.parse_args()
    runs = sorted(run for folder in arguments.folder for run in runs_of(folder))
    if not runs:
        parser.exit(message=f"no runs in {', '.join(map(str, arguments.folder))}: nothing measured\n")
    if arguments.others:
        print_others(pd.DataFrame(dog_rows(recordings("dog-mocap")) + horse_rows(recordings("horse-side"))))
        return
    views = [(run, camera) for run in runs for camera in meta_of(run)["cameras"]]
    rows = []
    for run, camera in views[arguments.first :: arguments.views]:
        view = view_in_run(run, camera)
        if arguments.folds:
            with tempfile.TemporaryDirectory() as folder:
                rows += [row for name in FOLDED for row in margin_rows(view, name, CASES[name], Path(folder))]
        else:
            rows += rows_of(view, arguments.only)
    table = pd.DataFrame(rows)
    if arguments.csv:
        table.to_csv(arguments.csv, index=False)
    (print_folds if arguments.folds else print_tables)(table)


if __name__ == "__main__":
    main()
