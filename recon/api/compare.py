"""Compare the strides and speeds of several clips by group, with the uncertainty of each.

The mean of a clip has a standard deviation s, from the scatter of its strides and the uncertainty of the fit. Clips of
a group vary by a further standard deviation tau. The mean of the group weights each clip by 1 / (s^2 + tau^2), with tau
from the method of moments (DerSimonian and Laird 1986). If the animal's size is taken from the average of the species,
the error of the size is common to all clips. This error then adds to the uncertainty of mean lengths and speeds,
however many clips there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from recon.api.analysis_settings import NO_COMPARE_OUT, SPEED_NAMES, CompareSettings
from recon.api.experiment import (
    ALL,
    MODEL,
    RUNS,
    SPEED,
    VARIANCES,
    Experiment,
    design_of_names,
    design_of_table,
    model_experiment,
)
from recon.base.arrays import Array
from recon.base.documents import read_toml, require_file
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.files import relative_path, write_bytes
from recon.base.outputs import Output
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.base.tables import write_frame
from recon.check.codes import names_text
from recon.check.verdict import usable
from recon.fit.motion import Motion
from recon.fit.motion_forms import CONFIG, MOTION
from recon.gait.clip import ClipAnalysis, analyse
from recon.gait.quantities import GaitQuantity, event_sigma_s, path_speed_sigma, shared_sigma_columns
from recon.show.page.compare_page import compare_page, value_with_interval
from recon.show.page.own_page import COMPARE_PAGE, PAGE
from recon.show.page.pages import median_error_px
from recon.show.plots.style import COLOURS, SMALL, drawing, png_of

STRIDES, CLIPS, GROUPS, FIGURE = "strides.csv", "clips.csv", "groups.csv", "comparison.png"
DIGITS = 6
"""Significant digits of numbers in the CSV tables. The Parquet tables have all digits."""
QUANTITIES = {
    "speed_m_s": ("speed (m/s)", True),
    "stride_length_m": ("stride length (m)", True),
    "stride_frequency_hz": ("stride frequency (Hz)", False),
    "duty_factor": ("duty factor", False),
}
"""Title of each compared quantity, and whether the quantity is proportional to the animal's size, by column."""
WITH_SIZE = {name: with_size for name, (_, with_size) in QUANTITIES.items()}


@dataclass(frozen=True)
class Comparison:
    """Clips and groups of a comparison, and the excluded results."""

    clips: pd.DataFrame
    groups: pd.DataFrame
    left_out: Sequence[str]
    """Names of the excluded results."""
    notes: Sequence[str]
    experiment: Experiment | None = None
    """Mixed models of the quantities; None without a design."""


@dataclass(frozen=True)
class _Results:
    """Results that a comparison uses, by their names, and results that it leaves out, with notes on the reasons."""

    folders: Mapping[str, Path]
    motions: Mapping[str, Motion]
    """Motions of the results that are used, keyed by the names of the results."""
    levels: Mapping[str, str]
    left_out: Sequence[str]
    notes: Sequence[str]


def run_compare(settings: CompareSettings, progress: Progress = silent) -> Comparison:
    """Compare the strides and speeds of several clips, and write tables, a figure and a page.

    Raises
    ------
    InputError
        If the folders, the table or the design cannot be used.
    """
    if settings.out is None:
        raise InputError(NO_COMPARE_OUT)
    folders = _result_folders(settings.folders)
    names = [*folders]
    design = _design(settings, names)
    covariates = [SPEED if name in SPEED_NAMES else name for name in settings.covariate]
    group_by_clip = _groups(settings.table, settings.by, names) if design is None else design["group"].to_dict()
    output = Output(settings.out, "compare", settings.overwrite, input_paths(settings), content="a comparison")
    tables = (GROUPS, STRIDES, CLIPS, *(() if design is None else (RUNS, MODEL, VARIANCES)))
    output.require([*tables, *map(_parquet, tables), FIGURE, COMPARE_PAGE])
    results = _load(settings, folders)
    rows, clip_rows = [], []
    for i, (name, motion) in enumerate(results.motions.items()):
        progress("analysis", i / len(names))
        analysis = analyse(motion)
        labels = {"group": group_by_clip[name], "clip": name, "verdict": results.levels[name]}
        labels |= {} if design is None else design.loc[name].to_dict()
        clip_strides = [labels | row for row in _stride_rows(analysis)]
        rows += clip_strides
        clip_rows.append(labels | _clip_row(analysis, clip_strides))
    clips = pd.DataFrame(clip_rows)
    strides = pd.DataFrame(rows, columns=None if rows else [*clip_rows[0]][:3])
    written = {STRIDES: strides, CLIPS: clips}
    shown, experiment = clips, None
    if design is not None:
        experiment = model_experiment(clips, strides, WITH_SIZE, covariates)
        shown = experiment.runs
        written |= {RUNS: shown, MODEL: experiment.effects, VARIANCES: experiment.variances}
    notes = [*results.notes, *_by_period(clips), *_same_runs(results, design)]
    notes += experiment.notes if experiment else ()
    groups = written[GROUPS] = _group_rows(shown)
    progress("tables", 0.95)
    by = settings.by or ("group" if len(groups) > 1 else "")
    with output.staged() as staging:
        for name, table in written.items():
            write_frame(table, staging / name, digits=DIGITS)
            table.to_parquet(staging / _parquet(name), index=False)
        write_bytes(staging / FIGURE, png_of(_figure(shown, groups)))
        page = _page(settings.out, shown, groups, results, notes, by, experiment)
        write_bytes(staging / COMPARE_PAGE, page.encode())
    return Comparison(shown, groups, results.left_out, notes, experiment)


def _parquet(name: str) -> str:
    return name.replace(".csv", ".parquet")


def _result_folders(paths: Sequence[Path]) -> dict[str, Path]:
    """Return the results folders among `paths` and in the batches among `paths`, keyed by their names.

    Raises
    ------
    InputError
        If a folder has no results, or several folders have the same name.
    """
    folders = []
    for path in [path for path in paths if not path.is_file()] or paths:  # all/* also matches the batch's own files
        inside = [path / MOTION] if (path / MOTION).is_file() else sorted(path.glob(f"*/{MOTION}"))
        if not inside:
            raise InputError(Problem(path, "folder", "no results", "a folder of results, or of a batch"))
        folders += [path.parent for path in inside]
    names = [folder.absolute().name for folder in folders]
    raise_problems(
        Problem(n, "clip", f"{names.count(n)} folders of that name", "one folder of each name")
        for n in {*names}
        if names.count(n) > 1
    )
    return dict(zip(names, folders, strict=True))


def _design(settings: CompareSettings, names: Sequence[str]) -> pd.DataFrame | None:
    """Return the camera, run, animal, group and covariates of each clip, or None without a design."""
    if settings.design is not None:
        columns = [name for name in settings.covariate if name not in SPEED_NAMES]
        return design_of_table(settings.design, names, settings.by or "group", columns)
    return design_of_names(settings.names, names) if settings.names is not None else None


def _load(settings: CompareSettings, folders: Mapping[str, Path]) -> _Results:
    """Load the results, without copies and without results that must not be used.

    Raises
    ------
    InputError
        If no result is left.
    """
    motions = collect_problems(*(lambda path=path: Motion.load(path) for path in folders.values()))
    loaded = dict(zip(folders, motions, strict=True))
    levels = {name: motion.verdict.level if motion.verdict else "" for name, motion in loaded.items()}
    usable_motions = {
        name: motion for name, motion in loaded.items() if settings.anyway or levels[name] != "do not use"
    }
    copies = _copies(usable_motions, folders)
    counting = {name: motion for name, motion in usable_motions.items() if name not in copies}
    if not counting:  # raise an error with the reason for each folder
        pairs = zip(loaded.values(), folders.values(), strict=True)
        collect_problems(*(partial(usable, *motion_and_folder, anyway=False) for motion_and_folder in pairs))
    notes = []
    if copies:
        copied = names_text([f"{copy} (of {kept})" for copy, kept in copies.items()])
        notes.append(f"Left out because they have the same keypoints and cameras as another result: {copied}.")
    if left_out := [name for name in loaded if name not in usable_motions]:
        notes.append(f'Left out because their verdict is "do not use": {names_text(left_out)}. --anyway includes them.')
    return _Results(folders, counting, levels, [*left_out, *copies], notes)


def _by_period(clips: pd.DataFrame) -> Iterator[str]:
    """Yield a note on the clips whose stride length and frequency do not come from complete strides."""
    names = [str(name) for name in clips.loc[clips["stride_frequency_hz_source"] == "period of the motion", "clip"]]
    if names:
        yield (
            f"No foot completes a stride in {names_text(names)}: stride length, stride frequency and duty factor come "
            "from the period of the motion."
        )


def _same_runs(results: _Results, design: pd.DataFrame | None) -> Iterator[str]:
    """Yield a note on pairs of results that probably show the same run, but are counted separately."""
    files = {name: _files_by_camera(motion, results.folders[name]) for name, motion in results.motions.items()}
    fields = {} if design is None else design.to_dict("index")
    runs = {name: (row["animal"], row["run"]) for name, row in fields.items()}
    pairs = [
        f"{first} and {second}"
        for first, second in combinations(results.motions, 2)
        if not (first in runs and runs[first] == runs.get(second))
        and _is_one_run(results.motions[first], results.motions[second], files[first], files[second])
    ]
    if pairs:
        yield (
            "These results, with related folders, frames and paths, probably show the same run but count as separate "
            f"clips: {names_text(pairs)}. Give one result for each run, if possible the one from all its cameras."
        )


def _page(
    out: Path,
    clips: pd.DataFrame,
    groups: pd.DataFrame,
    results: _Results,
    notes: Sequence[str],
    by: str,
    experiment: Experiment | None,
) -> str:
    """Return the page of a comparison, with links to the existing pages of its clips.

    If there is a design, each row of `clips` is a run and links to the page of the run's first camera, and the groups'
    means come from the mixed models.
    """
    by_row = {name: name for name in results.motions}
    if experiment is not None:
        by_row = dict(zip(clips["clip"], clips["first_clip"], strict=True))
        groups = experiment.with_model_means(groups)
    links = {
        row: relative_path(out, results.folders[name].absolute() / PAGE)
        for row, name in by_row.items()
        if (results.folders[name] / PAGE).is_file()
    }
    errors_px = {row: median_error_px(results.motions[name]) for row, name in by_row.items()}
    titles = {name: title for name, (title, _) in QUANTITIES.items()}
    tables = {} if experiment is None else {"effects": experiment.effects, "variances": experiment.variances}
    return compare_page(out.absolute().name, clips, groups, titles, links, errors_px, notes, by, **tables)


def _copies(motions: Mapping[str, Motion], folders: Mapping[str, Path]) -> dict[str, str]:
    """Return the results that are copies of another result, each with the name of the result that it repeats.

    Two results are copies if they were made from the same keypoint and camera files, by their digests, for the same
    animal and at the same time. The copy with fewer frames is returned.
    """
    known: dict[tuple[Any, ...], list[str]] = {}
    copies = {}
    for name in sorted(motions, key=lambda name: -len(motions[name].frames)):
        motion = motions[name]
        files = _input_digests(folders[name])
        if files is None:
            continue
        key = *files, motion.keypoints.individual, tuple(source.camera.name for source in motion.sources)
        candidates = (
            candidate for candidate in known.get(key, ()) if np.isin(motions[candidate].frames, motion.frames).any()
        )
        if (original := next(candidates, None)) is not None:
            copies[name] = original
        else:
            known.setdefault(key, []).append(name)
    return {name: copies[name] for name in motions if name in copies}


def _input_digests(folder: Path) -> tuple[frozenset[str], frozenset[str]] | None:
    """Return the digests of a result's keypoint files and camera files, or None if they were not recorded."""
    try:
        digests = read_toml(folder / CONFIG)["recon"]["sha256"].items()
    except (InputError, KeyError, TypeError, AttributeError):
        return None
    keypoints = frozenset(str(sha256) for role, sha256 in digests if role.startswith("keypoints"))
    cameras = frozenset(str(sha256) for role, sha256 in digests if role.startswith("camera"))
    return (keypoints, cameras) if keypoints else None


_FilesByCamera = dict[tuple[Path, str], Path]


def _files_by_camera(motion: Motion, folder: Path) -> _FilesByCamera:
    """Return a result's keypoint files, keyed by calibration file and camera name."""
    cameras, files = (
        [(folder / path).resolve() for path in ([value] if isinstance(value, str) else value or ())]
        for value in map(motion.settings.get, ("camera", "keypoints"))
    )
    camera_by_file = cameras * len(files) if len(cameras) == 1 else cameras
    return {
        (path, source.camera.name): file
        for path, source, file in zip(camera_by_file, motion.sources, files, strict=False)
    }


def _is_one_run(first: Motion, second: Motion, first_files: _FilesByCamera, second_files: _FilesByCamera) -> bool:
    """Return whether two results probably show the same run.

    Two results show the same run if their calibrations lie in the same folder, they share frames, and their positions
    agree within the uncertainty. Two keypoint files of the same camera belong to different runs.
    """
    folders = {next(iter(files))[0].parent if files else None for files in (first_files, second_files)}
    high_m = [
        motion.verdict.position_m.high for motion in (first, second) if motion.verdict and motion.verdict.position_m
    ]
    differ = any(second_files.get(camera, file) != file for camera, file in first_files.items())
    if differ or None in folders or len(folders) > 1 or len(high_m) < 2 or first.fps != second.fps:
        return False
    times, first_rows, second_rows = np.intersect1d(
        first.frames[first.solved], second.frames[second.solved], return_indices=True
    )
    distance_m = first.root_m[first.solved][first_rows] - second.root_m[second.solved][second_rows]
    return bool(len(times) and np.linalg.norm(distance_m, axis=1).mean() <= sum(high_m))


def _groups(table: Path | None, by: str | None, names: Sequence[str]) -> dict[str, str]:
    if table is None or by is None:
        return dict.fromkeys(names, ALL)
    require_file(table, "a CSV table")
    try:
        rows = pd.read_csv(table, dtype=str)
    except (OSError, ValueError) as error:
        raise InputError(Problem(table, "file", " ".join(str(error).split())[:200], "a CSV table")) from None
    columns = ", ".join(map(str, rows.columns))
    raise_problems(
        Problem(
            table, "column", f"no column {c!r} among {columns}", f"the columns 'clip' and {by!r}, separated by commas"
        )
        for c in ("clip", by)
        if c not in rows
    )
    group_by_clip = dict(zip(rows["clip"], rows[by].astype(str), strict=True))
    raise_problems(
        Problem(table, "clip", f"no row for {name}", "one row for every clip")
        for name in names
        if name not in group_by_clip
    )
    return {name: group_by_clip[name] for name in names}


def _stride_rows(analysis: ClipAnalysis) -> Iterator[dict]:
    moved = analysis.moved(analysis.reference, with_size=False)
    for stride in () if analysis.gait is None else analysis.gait.strides:
        duration_s, events_s = stride.duration_s, event_sigma_s(stride)
        speed = stride.length_m / duration_s
        yield {
            "foot": stride.foot,
            "start_s": stride.start_s,
            "speed_m_s": speed,
            "speed_m_s_sigma": path_speed_sigma(analysis.errors, moved, stride.start_s, stride.end_s),
            "stride_length_m": stride.length_m,
            "stride_length_m_sigma": speed * events_s,
            "stride_frequency_hz": 1 / duration_s,
            "stride_frequency_hz_sigma": events_s / duration_s**2,
            "duty_factor": stride.duty_factor,
            "duty_factor_sigma": stride.duty_sigma,
        }


def _clip_row(analysis: ClipAnalysis, strides: Sequence[dict]) -> dict:
    """Return the quantities of a clip with the standard deviations that `recon analyse` gives.

    `_sigma` contains all errors. `_own_sigma` leaves out the error of the animal's size, which other clips share.
    `_measurement_sigma` also leaves out the scatter of the strides. `_run_sigma` is the part of `_measurement_sigma`
    that all cameras of a run share.
    """
    quantities, row = analysis.quantities, dict[str, object]({"strides": len(strides)})
    row |= shared_sigma_columns(analysis.motion)
    for name in QUANTITIES:
        quantity = quantities.get(name)
        value, sigma, unshared = (
            (np.nan,) * 3 if quantity is None else (quantity.value, quantity.sigma, quantity.own_sigma)
        )
        row |= {name: value, f"{name}_sigma": sigma, f"{name}_own_sigma": unshared}
        row[f"{name}_measurement_sigma"] = np.nan if quantity is None else measurement_sigma(quantity)
        row[f"{name}_run_sigma"] = 0.0 if quantity is None else _run_sigma(quantity, quantities.get("stride_s"))
        row[f"{name}_source"] = "" if quantity is None or np.isnan(value) else quantity.source
    return row


def measurement_sigma(quantity: GaitQuantity) -> float:
    """Return the standard deviation of a clip's mean without the errors that clips share and the scatter of strides."""
    scatter = quantity.between_sigma / quantity.count**0.5 if quantity.count > 1 else 0.0
    return float(np.sqrt(max(quantity.own_sigma**2 - scatter**2, 0.0)))


def _run_sigma(quantity: GaitQuantity, period: GaitQuantity | None) -> float:
    """Return the part of a standard deviation that all cameras of a run share.

    A clip of less than a stride takes the quantity from the period of the motion, whose error the cameras share.
    """
    if quantity.source != "period of the motion" or period is None or not period.value > 0:
        return 0.0
    return abs(quantity.value) * period.sigma / period.value


def _mean_of(values: Array, sigmas: Array, shared: float) -> tuple[float, float, float]:
    """Return the mean of clips, its standard deviation, and the standard deviation between clips.

    `values` and `sigmas` (n,) are the clips' means and their standard deviations without shared errors. `shared` is
    the relative standard deviation of an error common to all clips.
    """
    known = np.isfinite(values) & np.isfinite(sigmas)
    x, variance = values[known], np.maximum(sigmas[known], 1e-12) ** 2
    if not len(x):
        return np.nan, np.nan, np.nan
    # Method of moments (DerSimonian and Laird 1986). The first mean has weights without the variance between clips.
    w = 1 / variance
    fixed = np.average(x, weights=w)
    degrees_of_freedom = len(x) - 1
    scale = w.sum() - (w**2).sum() / w.sum()
    between = max(0.0, (float(w @ (x - fixed) ** 2) - degrees_of_freedom) / scale) if degrees_of_freedom else 0.0
    w = 1 / (variance + between)
    mean = float(np.average(x, weights=w))
    return mean, float(np.hypot(w.sum() ** -0.5, shared * mean)), between**0.5 if degrees_of_freedom else np.nan


def _group_rows(clips: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for group, group_clips in clips.groupby("group"):
        row: dict[str, object] = {"group": group, "clips": len(group_clips), "strides": group_clips["strides"].sum()}
        for name, (_, with_size) in QUANTITIES.items():
            shared_column = f"{name}_shared_sigma"
            size = (
                group_clips[shared_column if shared_column in group_clips else "size_sigma"].to_numpy(float) * with_size
            )
            shared = float(np.nanmin(size)) if np.isfinite(size).any() else 0.0
            means, own_sigmas = (group_clips[f"{name}{field}"].to_numpy(float) for field in ("", "_own_sigma"))
            # Clips whose size is less certain have an additional variance.
            excess = means**2 * np.maximum(size**2 - shared**2, 0.0)
            values = _mean_of(means, np.sqrt(own_sigmas**2 + excess), shared)
            row |= zip((name, f"{name}_sigma", f"{name}_spread"), values, strict=True)
        rows.append(row)
    return pd.DataFrame(rows)


def known_quantities(clips: pd.DataFrame) -> list[str]:
    """Return the columns of `QUANTITIES` that are known for at least one clip."""
    return [name for name in QUANTITIES if clips[name].notna().any()]


def _figure(clips: pd.DataFrame, groups: pd.DataFrame) -> Figure:
    """Draw the gait quantities of each clip or run with their 90 % intervals, in one panel for each quantity.

    A group of two or more clips or runs also has its mean and interval.
    """
    with drawing(62.0) as figure:
        quantities = known_quantities(clips)
        panels = figure.subplots(1, max(len(quantities), 1), squeeze=False)[0]
        for axes, name in zip(panels, quantities, strict=False):
            for x, group in enumerate(groups["group"]):
                group_clips, colour = clips[clips["group"] == group], COLOURS[x % len(COLOURS)]
                positions = (
                    x + np.linspace(-0.18, 0.18, len(group_clips)) if len(group_clips) > 1 else np.array([float(x)])
                )
                value, low, high = _intervals(group_clips, name)
                axes.errorbar(
                    positions,
                    value,
                    [value - low, high - value],
                    fmt="o",
                    ms=3,
                    lw=0.8,
                    color=colour,
                    alpha=0.7,
                )
                (mean,), low, high = _intervals(groups[groups["group"] == group], name)
                if np.isfinite(mean) and len(group_clips) > 1:
                    line = [x - 0.32, x + 0.32]
                    axes.fill_between(line, low, high, color=colour, alpha=0.25, lw=0)
                    axes.plot(line, [mean, mean], color=colour, lw=1.4)
            counts = [int(clips.loc[clips["group"] == group, name].notna().sum()) for group in groups["group"]]
            labels = [f"{fill(group, 14)}\nn = {count}" for group, count in zip(groups["group"], counts, strict=True)]
            axes.set_xticks(range(len(labels)), labels, rotation=30 if len(labels) > 3 else 0)
            axes.set_title(QUANTITIES[name][0])
        dots = "runs" if "first_clip" in clips else "clips"
        figure.supxlabel(f"dots: {dots}; lines: the groups' means; bars and bands: 90 %", fontsize=SMALL)
    return figure


def _intervals(rows: pd.DataFrame, name: str) -> Array:
    """Return the values of a quantity and the ends of their 90 % intervals, shape (3, rows)."""
    return np.array([value_with_interval(row, name) for row in rows.to_dict("records")]).T
