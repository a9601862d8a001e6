"""Compare the strides and speeds of several clips by group, with the uncertainty of each.

The mean of a clip has a standard deviation s, from the scatter of its strides and the uncertainty of the fit. Clips of
a group vary by a further standard deviation tau. The group's mean weighs each clip by 1 / (s^2 + tau^2), where tau
follows from the method of moments (DerSimonian and Laird 1986). If the animal's size is the average of the species, the
error of the size is common to all clips: it adds to the uncertainty of mean lengths and speeds, however many clips
there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from recon.api.clip_results import CONFIG
from recon.api.settings import ANYWAY
from recon.base.arrays import Array
from recon.base.documents import read_toml
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.files import seen_from, write_bytes
from recon.base.outputs import Output
from recon.base.progress import Progress, silent
from recon.base.settings import OneOrMore, Option, Settings, input_paths
from recon.base.tables import write_frame
from recon.check.codes import names_text
from recon.check.verdict import usable
from recon.fit.motion import Motion
from recon.fit.motion_forms import MOTION
from recon.gait.clip import ClipAnalysis, analyse
from recon.gait.quantities import event_sigma_s, path_speed_sigma, shared_sigma
from recon.show.page.compare_page import compare_page
from recon.show.page.own_page import COMPARE_PAGE, PAGE
from recon.show.page.pages import median_error_px
from recon.show.plots.style import COLOURS, SMALL, drawing, png_of

STRIDES, CLIPS, GROUPS, FIGURE = "strides.csv", "clips.csv", "groups.csv", "comparison.png"
QUANTITIES = {
    "speed_m_s": ("speed (m/s)", True),
    "stride_length_m": ("stride length (m)", True),
    "stride_frequency_hz": ("stride frequency (Hz)", False),
    "duty_factor": ("duty factor", False),
}
"""Title by column, and whether the quantity is proportional to the animal's size."""
ALL = "all"
"""Name of the only group if there is no table."""


class CompareSettings(Settings):
    """Settings of `recon compare`."""

    folders: Annotated[OneOrMore[Path], Option(argument="DIR")]
    """Results folders, or folders of batches."""
    out: Path
    """Folder for the tables, the figure and the page."""
    table: Path | None = None
    """CSV table with a column clip (the folders' names) and the column of --by."""
    by: str | None = None
    """Column of the table to group the clips by, such as sex."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace an earlier comparison."""

    def problems(self) -> Iterator[Problem]:
        """Yield a problem if only one of --table and --by is given."""
        if (self.table is None) != (self.by is None):
            yield Problem("--by", "table", "one of --table and --by", "both: a table, and its column")


@dataclass(frozen=True)
class Comparison:
    """Hold the clips and groups of a comparison, and the excluded results."""

    clips: pd.DataFrame
    groups: pd.DataFrame
    left_out: Sequence[str]
    """Names of the excluded results."""
    notes: Sequence[str]


def run_compare(settings: CompareSettings, progress: Progress = silent) -> Comparison:
    """Compare the strides and speeds of several clips, and write tables, a figure and a page.

    Raises InputError if the folders or the table cannot be used.
    """
    out = settings.out
    paths = [
        path for path in settings.folders if not path.is_file()
    ] or settings.folders  # a pattern such as all/* also matches the batch's own files
    folders = []
    for path in paths:  # the folder itself, or the results folders of a batch
        inside = [path / MOTION] if (path / MOTION).is_file() else sorted(path.glob(f"*/{MOTION}"))
        if not inside:
            raise InputError(Problem(path, "folder", "no results", "a folder of results, or of a batch"))
        folders += [path.parent for path in inside]
    names = [folder.absolute().name for folder in folders]
    raise_problems(
        Problem(n, "clip", f"{names.count(n)} folders of that name", "one") for n in {*names} if names.count(n) > 1
    )
    group_by_clip = _groups(settings.table, settings.by, names)
    written = [name for table in (GROUPS, STRIDES, CLIPS) for name in (table, table.replace(".csv", ".parquet"))]
    output = Output(out, "compare", settings.overwrite, input_paths(settings), content="a comparison")
    output.require([*written, FIGURE, COMPARE_PAGE])
    loaded = dict(zip(names, collect_problems(*(lambda path=path: Motion.load(path) for path in folders)), strict=True))
    levels = {name: motion.verdict.level if motion.verdict else "" for name, motion in loaded.items()}
    usable_motions = {
        name: motion for name, motion in loaded.items() if settings.anyway or levels[name] != "do not use"
    }
    copies = _copies(usable_motions, dict(zip(names, folders, strict=True)))
    motions = {name: motion for name, motion in usable_motions.items() if name not in copies}
    if not motions:  # an error that gives the reason for each folder
        collect_problems(
            *(
                partial(usable, *motion_and_folder, anyway=False)
                for motion_and_folder in zip(loaded.values(), folders, strict=True)
            )
        )
    rows, clip_rows = [], []
    for i, (name, motion) in enumerate(motions.items()):
        progress("analysis", i / len(names))
        analysis = analyse(motion)
        labels = {"group": group_by_clip[name], "clip": name, "verdict": levels[name]}
        clip_strides = [labels | row for row in _stride_rows(analysis)]
        rows += clip_strides
        clip_rows.append(labels | _clip_row(analysis, clip_strides))
    clips = pd.DataFrame(clip_rows)
    groups, strides = _group_rows(clips), pd.DataFrame(rows, columns=None if rows else [*clip_rows[0]][:3])
    notes = []
    if copies:
        pairs = names_text([f"{copy} (of {kept})" for copy, kept in copies.items()])
        notes.append(f"Left out, as they have the same keypoints and cameras as another result: {pairs}.")
    if left_out := [name for name in loaded if name not in usable_motions]:
        notes.append(f'Left out, as their verdict is "do not use": {names_text(left_out)}. With --anyway they count.')
    seen = {
        name: _files_by_camera(motion, folder) for (name, motion), folder in zip(loaded.items(), folders, strict=True)
    }
    pairs = combinations(motions, 2)
    if same_runs := [f"{a} and {b}" for a, b in pairs if _is_one_run(motions[a], motions[b], seen[a], seen[b])]:
        notes.append(
            f"Probably of one run, by their cameras' folder, frames and paths, and yet each counted as a clip: "
            f"{names_text(same_runs)}. Give one result of each run, best that of all its cameras."
        )
    progress("tables", 0.95)
    with output.staged() as staging:
        for name, table in ((STRIDES, strides), (CLIPS, clips), (GROUPS, groups)):
            write_frame(table, staging / name)
            table.to_parquet((staging / name).with_suffix(".parquet"), index=False)
        write_bytes(staging / FIGURE, png_of(_figure(clips, groups)))
        page = _page(out, clips, groups, motions, dict(zip(names, folders, strict=True)), notes, settings.by or "")
        write_bytes(staging / COMPARE_PAGE, page.encode())
    return Comparison(clips, groups, [*left_out, *copies], notes)


def _page(
    out: Path,
    clips: pd.DataFrame,
    groups: pd.DataFrame,
    motions: Mapping[str, Motion],
    folders: Mapping[str, Path],
    notes: Sequence[str],
    by: str,
) -> str:
    """Return the page of a comparison, with links to the clips' pages that are there."""
    links = {name: seen_from(out, folders[name].absolute() / PAGE) for name in motions}
    pages = {name: link for name, link in links.items() if (folders[name] / PAGE).is_file()}
    errors_px = {name: median_error_px(motion) for name, motion in motions.items()}
    titles = {name: title for name, (title, _) in QUANTITIES.items()}
    return compare_page(out.absolute().name, clips, groups, titles, pages, errors_px, notes, by)


def _copies(motions: Mapping[str, Motion], folders: Mapping[str, Path]) -> dict[str, str]:
    """Return the names of results that repeat another one with as many frames or more, each with the other's name.

    They were made from the same keypoint and camera files, by their digests, for the same animal and at the same time.
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
    """Return the digests of a result's keypoint files and camera files, or None where they were not recorded."""
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
    try:
        rows = pd.read_csv(table, dtype=str)
    except (OSError, ValueError) as error:
        raise InputError(Problem(table, "file", " ".join(str(error).split())[:200], "a CSV table")) from None
    columns = ", ".join(map(str, rows.columns))
    raise_problems(
        Problem(table, "column", f"no {c!r} ({columns})", "columns 'clip' and the one that --by names, between commas")
        for c in ("clip", by)
        if c not in rows
    )
    group_by_clip = dict(zip(rows["clip"], rows[by].astype(str), strict=True))
    raise_problems(
        Problem(table, "clip", f"no row for {name}", "one for every clip")
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
    """Return a clip's quantities with the standard deviations that `recon analyse` gives.

    `_sigma` has all errors, `_own_sigma` those that the clip does not share with others of the same animal's size.
    """
    quantities, row = analysis.quantities, dict[str, object]({"strides": len(strides)})
    row["size_sigma"] = shared_sigma(analysis.motion)
    for name in QUANTITIES:
        quantity = quantities.get(name)
        value, sigma, unshared = (
            (np.nan,) * 3 if quantity is None else (quantity.value, quantity.sigma, quantity.own_sigma)
        )
        row |= {name: value, f"{name}_sigma": sigma, f"{name}_own_sigma": unshared}
        row[f"{name}_source"] = "" if quantity is None or np.isnan(value) else quantity.source
    return row


def _mean_of(values: Array, sigmas: Array, shared: float) -> tuple[float, float, float]:
    """Return the mean of clips, its standard deviation, and the spread between clips (one standard deviation).

    `shared` is the relative standard deviation of an error common to all clips.
    """
    known = np.isfinite(values) & np.isfinite(sigmas)
    x, variance = values[known], np.maximum(sigmas[known], 1e-12) ** 2
    if not len(x):
        return np.nan, np.nan, np.nan
    w = 1 / variance
    fixed = np.average(x, weights=w)
    freedom = len(x) - 1
    scale = w.sum() - (w**2).sum() / w.sum()
    between = max(0.0, (float(w @ (x - fixed) ** 2) - freedom) / scale) if freedom else 0.0
    w = 1 / (variance + between)
    mean = float(np.average(x, weights=w))
    return mean, float(np.hypot(w.sum() ** -0.5, shared * mean)), between**0.5 if freedom else np.nan


def _group_rows(clips: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for group, group_clips in clips.groupby("group"):
        row: dict[str, object] = {"group": group, "clips": len(group_clips), "strides": group_clips["strides"].sum()}
        size = group_clips["size_sigma"].to_numpy(float)
        common = float(np.nanmin(size)) if np.isfinite(size).any() else 0.0
        for name, (_, with_size) in QUANTITIES.items():
            shared = common if with_size else 0.0
            values = _mean_of(
                group_clips[name].to_numpy(float), group_clips[f"{name}_own_sigma"].to_numpy(float), shared
            )
            row |= zip((name, f"{name}_sigma", f"{name}_spread"), values, strict=True)
        rows.append(row)
    return pd.DataFrame(rows)


def known_quantities(clips: pd.DataFrame) -> list[str]:
    """Return the quantities that at least one clip has."""
    return [name for name in QUANTITIES if clips[name].notna().any()]


def _figure(clips: pd.DataFrame, groups: pd.DataFrame) -> Figure:
    """Draw each clip with its standard deviation, and each group's mean with its own, one panel per quantity."""
    with drawing(62.0) as figure:
        quantities = known_quantities(clips)
        panels = figure.subplots(1, max(len(quantities), 1), squeeze=False)[0]
        for axes, name in zip(panels, quantities, strict=False):
            for x, group in enumerate(groups["group"]):
                group_clips, colour = clips[clips["group"] == group], COLOURS[x % len(COLOURS)]
                positions = (
                    x + np.linspace(-0.18, 0.18, len(group_clips)) if len(group_clips) > 1 else np.array([float(x)])
                )
                axes.errorbar(
                    positions,
                    group_clips[name],
                    group_clips[f"{name}_sigma"],
                    fmt="o",
                    ms=3,
                    lw=0.8,
                    color=colour,
                    alpha=0.7,
                )
                mean, sigma = groups.loc[groups["group"] == group, [name, f"{name}_sigma"]].to_numpy(float)[0]
                if np.isfinite(mean):
                    line = [x - 0.32, x + 0.32]
                    axes.fill_between(line, mean - sigma, mean + sigma, color=colour, alpha=0.25, lw=0)
                    axes.plot(line, [mean, mean], color=colour, lw=1.4)
            labels = [fill(name, 14) for name in groups["group"]]
            axes.set_xticks(range(len(labels)), labels, rotation=30 if len(labels) > 3 else 0)
            axes.set_title(QUANTITIES[name][0])
        figure.supxlabel("dots: clips; lines: the groups' means; each ± one standard deviation", fontsize=SMALL)
    return figure
