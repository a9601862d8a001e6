"""Compare several clips: their strides and speeds beside each other, by group, with the uncertainty of each.

A clip's mean has a standard deviation s of its own: of its strides' scatter, and of what the fit does not know. Clips
of a group differ by more than that, by tau. The group's mean weighs each clip by 1 / (s^2 + tau^2), with tau by the
method of moments (DerSimonian and Laird 1986). The animal's size is no clip's own: where it is the species', its error
is that of all clips and adds to the mean of lengths and speeds, however many clips there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
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
from recon.base.files import write_bytes
from recon.base.outputs import Output
from recon.base.progress import Progress, silent
from recon.base.settings import OneOrMore, Option, Settings, input_paths
from recon.base.tables import write_frame
from recon.check.codes import names_text
from recon.check.verdict import usable
from recon.fit.motion import Motion
from recon.fit.motion_forms import MOTION
from recon.fit.result import TrajectorySolution
from recon.gait.clip import ClipAnalysis, analyse
from recon.gait.kinematics import JointKinematics
from recon.show.plots.style import COLOURS, SMALL, drawing, png_of

STRIDES, CLIPS, GROUPS, FIGURE = "strides.csv", "clips.csv", "groups.csv", "comparison.png"
QUANTITIES = {
    "speed_m_s": ("speed (m/s)", True),
    "stride_length_m": ("stride length (m)", True),
    "stride_frequency_hz": ("stride frequency (Hz)", False),
    "duty_factor": ("duty factor", False),
}
"""By column its title, and whether it goes with the animal's size."""
ALL = "all"
"""The group, where there is no column to go by."""


class CompareSettings(Settings):
    """The settings of `recon compare`."""

    folders: Annotated[OneOrMore[Path], Option(argument="DIR")]
    """Folders of results, or of batches."""
    out: Path
    """Folder for the tables and the figure."""
    table: Path | None = None
    """CSV table with a column clip, the folders' names, and --by."""
    by: str | None = None
    """Column of the table to group the clips by, as in sex."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace an earlier comparison."""

    def problems(self) -> Iterator[Problem]:
        if (self.table is None) != (self.by is None):
            yield Problem("--by", "table", "one of --table and --by", "both: a table, and its column")


@dataclass(frozen=True)
class Comparison:
    """The clips and the groups of a comparison, and what was left out."""

    clips: pd.DataFrame
    groups: pd.DataFrame
    left_out: Sequence[str]
    """Names of the results that were not compared."""
    notes: Sequence[str]


def run_compare(settings: CompareSettings, progress: Progress = silent) -> Comparison:
    """Compare the strides and speeds of several clips, and write the tables and the figure. Raises InputError."""
    out = settings.out
    some = [path for path in settings.folders if not path.is_file()] or settings.folders  # all/* has files of the batch
    folders = []
    for given in some:  # the folder, or those in it, of a batch
        inside = [given / MOTION] if (given / MOTION).is_file() else sorted(given.glob(f"*/{MOTION}"))
        if not inside:
            raise InputError(Problem(given, "folder", "no results", "a folder of results, or of a batch"))
        folders += [path.parent for path in inside]
    names = [folder.absolute().name for folder in folders]
    raise_problems(
        Problem(n, "clip", f"{names.count(n)} folders of that name", "one") for n in {*names} if names.count(n) > 1
    )
    of_clip = _groups(settings.table, settings.by, names)
    written = [name for table in (GROUPS, STRIDES, CLIPS) for name in (table, table.replace(".csv", ".parquet"))]
    output = Output(out, "compare", settings.overwrite, input_paths(settings), content="a comparison")
    output.require([*written, FIGURE])
    loaded = dict(zip(names, collect_problems(*(lambda path=path: Motion.load(path) for path in folders)), strict=True))
    levels = {name: motion.verdict.level if motion.verdict else "" for name, motion in loaded.items()}
    usable_motions = {name: of for name, of in loaded.items() if settings.anyway or levels[name] != "do not use"}
    copies = _copies(usable_motions, dict(zip(names, folders, strict=True)))
    motions = {name: of for name, of in usable_motions.items() if name not in copies}
    if not motions:  # said of each
        collect_problems(
            *(lambda at=at: usable(*at, anyway=False) for at in zip(loaded.values(), folders, strict=True))
        )
    rows, clip_rows = [], []
    for i, (name, motion) in enumerate(motions.items()):
        progress("analysis", i / len(names))
        found = analyse(motion)
        head = {"group": of_clip[name], "clip": name, "verdict": levels[name]}
        own = [head | row for row in _stride_rows(found)]
        rows += own
        clip_rows.append(head | _clip_row(found, own))
    clips = pd.DataFrame(clip_rows)
    groups, strides = _group_rows(clips), pd.DataFrame(rows, columns=None if rows else [*clip_rows[0]][:3])
    progress("tables", 0.95)
    with output.staged() as staging:
        for name, table in ((STRIDES, strides), (CLIPS, clips), (GROUPS, groups)):
            write_frame(table, staging / name)
            table.to_parquet((staging / name).with_suffix(".parquet"), index=False)
        write_bytes(staging / FIGURE, png_of(_figure(clips, groups)))
    notes = []
    if copies:
        pairs = names_text([f"{copy} (of {kept})" for copy, kept in copies.items()])
        notes.append(f"Left out, as they have the same keypoints and cameras as another result: {pairs}.")
    if left_out := [name for name in loaded if name not in usable_motions]:
        notes.append(f'Left out, as their verdict is "do not use": {names_text(left_out)}. With --anyway they count.')
    seen = {name: _files_seen(motion, folder) for (name, motion), folder in zip(loaded.items(), folders, strict=True)}
    pairs = combinations(motions, 2)
    if twice := [f"{a} and {b}" for a, b in pairs if _one_run(motions[a], motions[b], seen[a], seen[b])]:
        notes.append(
            f"Probably of one run, by their cameras' folder, frames and paths, and yet each counted as a clip: "
            f"{names_text(twice)}. Give one result of each run, best that of all its cameras."
        )
    return Comparison(clips, groups, [*left_out, *copies], notes)


def _copies(motions: Mapping[str, Motion], folders: Mapping[str, Path]) -> dict[str, str]:
    """Return the results that repeat another one, by name, and the name of that one, which has as many frames or more.

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
        same = (other for other in known.get(key, ()) if np.isin(motions[other].frames, motion.frames).any())
        if (kept := next(same, None)) is not None:
            copies[name] = kept
        else:
            known.setdefault(key, []).append(name)
    return {name: copies[name] for name in motions if name in copies}


def _input_digests(folder: Path) -> tuple[frozenset[str], frozenset[str]] | None:
    """Return the digests of a result's keypoint files and of its camera files; None where they are not noted."""
    try:
        digests = read_toml(folder / CONFIG)["recon"]["sha256"].items()
    except (InputError, KeyError, TypeError, AttributeError):
        return None
    keypoints = frozenset(str(sha256) for role, sha256 in digests if role.startswith("keypoints"))
    cameras = frozenset(str(sha256) for role, sha256 in digests if role.startswith("camera"))
    return (keypoints, cameras) if keypoints else None


_Seen = dict[tuple[Path, str], Path]


def _files_seen(motion: Motion, folder: Path) -> _Seen:
    """A result's keypoint files, each by the calibration file and the name of its camera."""
    cameras, files = (
        [(folder / path).resolve() for path in ([given] if isinstance(given, str) else given or ())]
        for given in map(motion.settings.get, ("camera", "keypoints"))
    )
    each = cameras * len(files) if len(cameras) == 1 else cameras
    return {(path, of.camera.name): file for path, of, file in zip(each, motion.sources, files, strict=False)}


def _one_run(one: Motion, other: Motion, seen: _Seen, others: _Seen) -> bool:
    """Whether two results are probably of one run: with calibrations of one folder, at the same time, and at one place
    within what is expected of their positions. Other keypoints of one camera are of another run."""
    places = {next(iter(of))[0].parent if of else None for of in (seen, others)}
    high_m = [of.verdict.position_m.high for of in (one, other) if of.verdict and of.verdict.position_m]
    differ = any(others.get(camera, file) != file for camera, file in seen.items())
    if differ or None in places or len(places) > 1 or len(high_m) < 2 or one.fps != other.fps:
        return False
    times, of_one, of_other = np.intersect1d(one.frames[one.solved], other.frames[other.solved], return_indices=True)
    apart_m = one.root_m[one.solved][of_one] - other.root_m[other.solved][of_other]
    return bool(len(times) and np.linalg.norm(apart_m, axis=1).mean() <= sum(high_m))


def _groups(table: Path | None, by: str | None, names: Sequence[str]) -> dict[str, str]:
    if table is None or by is None:
        return dict.fromkeys(names, ALL)
    try:
        rows = pd.read_csv(table, dtype=str)
    except (OSError, ValueError) as error:
        raise InputError(Problem(table, "file", " ".join(str(error).split())[:200], "a CSV table")) from None
    columns = ", ".join(map(str, rows.columns))
    raise_problems(
        Problem(table, "column", f"no {c!r} ({columns})", "clip, and --by") for c in ("clip", by) if c not in rows
    )
    found = dict(zip(rows["clip"], rows[by].astype(str), strict=True))
    raise_problems(
        Problem(table, "clip", f"no row for {name}", "one for every clip") for name in names if name not in found
    )
    return {name: found[name] for name in names}


def _stride_rows(found: ClipAnalysis) -> Iterator[dict]:
    moved = found.moved(found.reference, with_size=False)
    for stride in () if found.gait is None else found.gait.strides:
        lasts_s = stride.duration_s
        events_s = stride.duty_sigma * lasts_s  # of two events, as of a stance's two
        speed = stride.length_m / lasts_s
        yield {
            "foot": stride.foot,
            "start_s": stride.start_s,
            "speed_m_s": speed,
            "speed_m_s_sigma": _speed_sigma(found, moved, stride.start_s, stride.end_s),
            "stride_length_m": stride.length_m,
            "stride_length_m_sigma": speed * events_s,
            "stride_frequency_hz": 1 / lasts_s,
            "stride_frequency_hz_sigma": events_s / lasts_s**2,
            "duty_factor": stride.duty_factor,
            "duty_factor_sigma": stride.duty_sigma,
        }


def _speed_sigma(found: ClipAnalysis, moved: JointKinematics, start_s: float, end_s: float) -> float:
    """The standard deviation of the mean speed in a time: errors of the path last on either side."""
    sigma = moved.speed_sigma_m_s[(moved.series.time_s >= start_s) & (moved.series.time_s <= end_s)]
    last_s = max(error.correlation_s for error in found.errors if error.correlation_s < np.inf)
    independent = max(1.0, (end_s - start_s) / (2 * last_s))
    return float(np.sqrt(np.nanmean(sigma**2) / independent)) if np.isfinite(sigma).any() else np.nan


def _clip_row(found: ClipAnalysis, strides: Sequence[dict]) -> dict:
    """Means over the strides; of the speed, over the clip. The animal's size is taken as given."""
    motion, table = found.motion, pd.DataFrame(strides)
    solution, row = motion.solution, dict[str, object]({"strides": len(strides)})
    row["size_sigma"] = solution.size_sigma / solution.size if isinstance(solution, TrajectorySolution) else np.nan
    for name in QUANTITIES:
        if name == "speed_m_s":
            known = found.why_no_speed is None
            moved = found.moved(found.reference, with_size=False)
            value = moved.mean_speed_m_s if known else np.nan
            sigma = _speed_sigma(found, moved, *motion.time_s[[0, -1]]) if known else np.nan
        elif len(table):
            feet = table["foot"].nunique()
            scatter = table[name].std() / np.sqrt(len(table)) if len(table) > 1 else 0.0
            value, sigma = table[name].mean(), np.hypot(scatter, np.sqrt((table[f"{name}_sigma"] ** 2).mean() / feet))
        else:
            value = sigma = np.nan
        row |= {name: value, f"{name}_sigma": sigma}
    return row


def _mean_of(values: Array, sigmas: Array, shared: float) -> tuple[float, float, float]:
    """Mean, its standard deviation, and the spread between clips (one standard deviation). shared: relative standard
    deviation of what all clips have in common."""
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
    for group, of in clips.groupby("group"):
        row: dict[str, object] = {"group": group, "clips": len(of), "strides": of["strides"].sum()}
        size = of["size_sigma"].to_numpy(float)
        common = float(np.nanmin(size)) if np.isfinite(size).any() else 0.0
        for name, (_, with_size) in QUANTITIES.items():
            shared = common if with_size else 0.0
            found = _mean_of(of[name].to_numpy(float), of[f"{name}_sigma"].to_numpy(float), shared)
            row |= zip((name, f"{name}_sigma", f"{name}_spread"), found, strict=True)
        rows.append(row)
    return pd.DataFrame(rows)


def known_quantities(clips: pd.DataFrame) -> list[str]:
    """The quantities that some clip has."""
    return [name for name in QUANTITIES if clips[name].notna().any()]


def _figure(clips: pd.DataFrame, groups: pd.DataFrame) -> Figure:
    """Each clip with one standard deviation, and each group's mean with that of the mean, by quantity that is known."""
    with drawing(62.0) as figure:
        known = known_quantities(clips)
        panels = figure.subplots(1, max(len(known), 1), squeeze=False)[0]
        for axes, name in zip(panels, known, strict=False):
            for at, group in enumerate(groups["group"]):
                own, colour = clips[clips["group"] == group], COLOURS[at % len(COLOURS)]
                beside = at + np.linspace(-0.18, 0.18, len(own)) if len(own) > 1 else np.array([float(at)])
                axes.errorbar(beside, own[name], own[f"{name}_sigma"], fmt="o", ms=3, lw=0.8, color=colour, alpha=0.7)
                mean, sigma = groups.loc[groups["group"] == group, [name, f"{name}_sigma"]].to_numpy(float)[0]
                if np.isfinite(mean):
                    wide = [at - 0.32, at + 0.32]
                    axes.fill_between(wide, mean - sigma, mean + sigma, color=colour, alpha=0.25, lw=0)
                    axes.plot(wide, [mean, mean], color=colour, lw=1.4)
            labels = [fill(name, 14) for name in groups["group"]]
            axes.set_xticks(range(len(labels)), labels, rotation=30 if len(labels) > 3 else 0)
            axes.set_title(QUANTITIES[name][0])
        figure.supxlabel("dots: clips; lines: the groups' means; each ± one standard deviation", fontsize=SMALL)
    return figure
