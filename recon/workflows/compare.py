"""Strides and speeds of several clips beside each other, by group, with the uncertainty of each.

A clip's mean has a standard deviation s of its own: of its strides' scatter, and of what the fit does not know. Clips
of a group differ by more than that, by tau. The group's mean weighs each clip by 1 / (s^2 + tau^2), with tau by the
method of moments (DerSimonian and Laird 1986). The animal's size is no clip's own: where it is the species', its error
is that of all clips and adds to the mean of lengths and speeds, however many clips there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import pandas as pd

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, all_of, refuse
from recon.base.files import staged_folder
from recon.base.progress import Progress, silent
from recon.base.settings import OneOrMore, Option, Settings
from recon.check import usable
from recon.fit import TrajectorySolution
from recon.fit.motion import MOTION, Motion
from recon.gait.clip import PLACE_LASTS_S, ClipAnalysis, analyse
from recon.workflows.settings import ANYWAY

STRIDES, CLIPS, GROUPS, FIGURE = "strides.csv", "clips.csv", "groups.csv", "comparison.png"
QUANTITIES = {"speed_m_s": True, "stride_length_m": True, "stride_frequency_hz": False, "duty_factor": False}
"""By column, whether it goes with the animal's size."""
ALL = "all"
"""The group, where there is no column to go by."""


class CompareSettings(Settings):
    """What `recon compare` is told."""

    folders: Annotated[
        OneOrMore[Path],
        Option("Folders of results, or of batches, as in results/a results/b.", argument="DIR"),
    ]
    out: Annotated[Path, Option("Folder for the tables and the figure.")]
    table: Annotated[
        Path | None, Option("CSV table with a column clip, the folders' names, and one to group them by.")
    ] = None
    by: Annotated[str | None, Option("Column of the table to group the clips by, as in sex.")] = None
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: Annotated[bool, Option("Replace an earlier comparison.")] = False

    def problems(self) -> Iterator[Problem]:
        if (self.table is None) != (self.by is None):
            yield Problem("--by", "table", "one of --table and --by", "both: a table, and its column")


@dataclass(frozen=True, eq=False)
class Comparison:
    """strides: a row for each, or one for a clip without; clips: means and standard deviations; groups: the same of
    groups, `_spread` between clips."""

    strides: pd.DataFrame
    clips: pd.DataFrame
    groups: pd.DataFrame
    out: Path


def run_compare(settings: CompareSettings, progress: Progress = silent) -> Comparison:
    """`recon compare`. Raises InputError with every folder that cannot be used."""
    folders = [folder for given in settings.folders for folder in _results_in(given)]
    names = [folder.absolute().name for folder in folders]
    refuse(Problem(n, "clip", f"{names.count(n)} folders of that name", "one") for n in {*names} if names.count(n) > 1)
    groups = _groups(settings.table, settings.by, names)
    if not settings.overwrite and (settings.out / GROUPS).exists():
        raise InputError(Problem(settings.out, "folder", "a comparison", "another folder, or --overwrite"))
    motions = all_of(
        *(lambda folder=folder: usable(Motion.load(folder), folder, settings.anyway) for folder in folders)
    )
    strides, clips = [], []
    for i, (name, motion) in enumerate(zip(names, motions, strict=True)):
        progress("analysis", i / len(names))
        found = analyse(motion, lean=True)
        head = {"group": groups[name], "clip": name, "verdict": motion.verdict.level if motion.verdict else ""}
        own = [head | row for row in _stride_rows(found)]
        strides += own
        clips.append(head | _clip_row(found, own))
    by_clip = pd.DataFrame(clips)
    made = Comparison(pd.DataFrame(strides), by_clip, _group_rows(by_clip), settings.out)
    progress("tables", 0.95)
    with staged_folder(settings.out) as staging:
        for name, table in ((STRIDES, made.strides), (CLIPS, made.clips), (GROUPS, made.groups)):
            table.to_csv(staging / name, index=False)
            if find_spec("pyarrow") is not None:  # of the extra [formats]
                table.to_parquet(staging / Path(name).with_suffix(".parquet"), index=False)
        from recon.show.plots.comparison import comparison  # matplotlib is slow to import

        comparison(made.clips, made.groups, list(QUANTITIES)).savefig(staging / FIGURE)
    return made


def _results_in(folder: Path) -> list[Path]:
    """The folder, or those in it, of a batch."""
    if (folder / MOTION).is_file():
        return [folder]
    inside = sorted(path.parent for path in folder.glob(f"*/{MOTION}"))
    if not inside:
        raise InputError(Problem(folder, "folder", "no results", "a folder of results, or of a batch"))
    return inside


def _groups(table: Path | None, by: str | None, names: Sequence[str]) -> dict[str, str]:
    if table is None or by is None:
        return dict.fromkeys(names, ALL)
    try:
        rows = pd.read_csv(table, dtype=str)
    except (OSError, ValueError) as error:
        raise InputError(Problem(table, "file", " ".join(str(error).split())[:200], "a CSV table")) from None
    columns = ", ".join(map(str, rows.columns))
    refuse(Problem(table, "column", f"no {c!r} ({columns})", "clip, and --by") for c in ("clip", by) if c not in rows)
    found = dict(zip(rows["clip"], rows[by].astype(str), strict=True))
    refuse(Problem(table, "clip", f"no row for {name}", "one for every clip") for name in names if name not in found)
    return {name: found[name] for name in names}


def _stride_rows(found: ClipAnalysis) -> Iterator[dict]:
    for stride in () if found.gait is None else found.gait.strides:
        lasts_s = stride.end_s - stride.start_s
        events_s = stride.duty_sigma * lasts_s  # of two events, as of a stance's two
        speed = stride.length_m / lasts_s
        yield {
            "foot": stride.foot,
            "start_s": stride.start_s,
            "speed_m_s": speed,
            "speed_m_s_sigma": _speed_sigma(found, stride.start_s, stride.end_s),
            "stride_length_m": stride.length_m,
            "stride_length_m_sigma": speed * events_s,
            "stride_frequency_hz": 1 / lasts_s,
            "stride_frequency_hz_sigma": events_s / lasts_s**2,
            "duty_factor": stride.duty_factor,
            "duty_factor_sigma": stride.duty_sigma,
        }


def _speed_sigma(found: ClipAnalysis, start_s: float, end_s: float) -> float:
    """Of the mean speed in a time: errors of the path last `PLACE_LASTS_S` on either side."""
    moved = found.joints[found.reference]
    if moved.speed_sigma_m_s is None:
        return np.nan
    sigma = moved.speed_sigma_m_s[(moved.series.time_s >= start_s) & (moved.series.time_s <= end_s)]
    independent = max(1.0, (end_s - start_s) / (2 * PLACE_LASTS_S))
    return float(np.sqrt(np.nanmean(sigma**2) / independent)) if np.isfinite(sigma).any() else np.nan


def _clip_row(found: ClipAnalysis, strides: Sequence[dict]) -> dict:
    """Means over the strides; of the speed, over the clip. The animal's size is taken as given."""
    motion, table = found.motion, pd.DataFrame(strides)
    solution, row = motion.solution, dict[str, object]({"strides": len(strides)})
    row["size_sigma"] = solution.size_sigma / solution.size if isinstance(solution, TrajectorySolution) else np.nan
    for name in QUANTITIES:
        if name == "speed_m_s":
            known = found.speed_doubt is None
            value = found.joints[found.reference].mean_speed_m_s if known else np.nan
            sigma = _speed_sigma(found, *motion.time_s[[0, -1]]) if known else np.nan
        elif len(table):
            feet = table["foot"].nunique()
            scatter = table[name].std() / np.sqrt(len(table)) if len(table) > 1 else 0.0
            value, sigma = table[name].mean(), np.hypot(scatter, np.sqrt((table[f"{name}_sigma"] ** 2).mean() / feet))
        else:
            value = sigma = np.nan
        row |= {name: value, f"{name}_sigma": sigma}
    return row


class _Mean(NamedTuple):
    mean: float
    sigma: float
    spread: float
    """Between clips, one standard deviation."""
    clips: int


def _mean_of(values: Array, sigmas: Array, shared: float) -> _Mean:
    """shared: relative standard deviation of what all clips have in common."""
    known = np.isfinite(values) & np.isfinite(sigmas)
    x, variance = values[known], np.maximum(sigmas[known], 1e-12) ** 2
    if not len(x):
        return _Mean(np.nan, np.nan, np.nan, 0)
    w = 1 / variance
    fixed = np.average(x, weights=w)
    freedom = len(x) - 1
    scale = w.sum() - (w**2).sum() / w.sum()
    between = max(0.0, (float(w @ (x - fixed) ** 2) - freedom) / scale) if freedom else 0.0
    w = 1 / (variance + between)
    mean = float(np.average(x, weights=w))
    return _Mean(mean, float(np.hypot(w.sum() ** -0.5, shared * mean)), between**0.5, len(x))


def _group_rows(clips: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for group, of in clips.groupby("group"):
        row: dict[str, object] = {"group": group, "clips": len(of), "strides": of["strides"].sum()}
        size = of["size_sigma"].to_numpy(float)
        common = float(np.nanmin(size)) if np.isfinite(size).any() else 0.0
        for name, with_size in QUANTITIES.items():
            shared = common if with_size else 0.0
            found = _mean_of(of[name].to_numpy(float), of[f"{name}_sigma"].to_numpy(float), shared)
            row |= {name: found.mean, f"{name}_sigma": found.sigma, f"{name}_spread": found.spread}
        rows.append(row)
    return pd.DataFrame(rows)
