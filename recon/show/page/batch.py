"""The page of a batch: a table of its clips, the doubtful first."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.base.errors import InputError
from recon.fit.motion import Motion
from recon.fit.result import LEVELS
from recon.show.page import PAGE
from recon.show.page.render import rendered

FIRST = ("failed", "unsolved", "pending")
"""The statuses that stand above all others."""
NUMBERS = {
    "pose_mm": ("pose ± mm", ".0f"),
    "position_m": ("position ± m", ".2f"),
    "frames": ("frames", "d"),
    "outliers": ("outliers", "d"),
    "mean_reprojection_px": ("off by, px", ".1f"),
    "mean_speed_m_s": ("mean m/s", ".1f"),
    "peak_speed_m_s": ("peak m/s", ".1f"),
    "size": ("size", ".2f"),
}
"""Columns of summary.csv that the table has, with their headings and formats."""
THUMBNAIL_PX = (96, 60)
FOLDERS = re.compile(r"(?<![\w.])(?:[A-Za-z]:)?[/\\](?:[^/\\:]+[/\\])+")
"""The folders of a file that an error names: they stay in the house."""


@dataclass(frozen=True)
class _ClipRow:
    """One clip: its row of summary.csv, and what its results say."""

    cells: Mapping[str, str]
    page: str | None
    """Beside the summary, with forward slashes."""
    doubtful: int | None
    """Frames with a flag; None where there is no report."""
    thumbnail: Sequence[tuple[str, str]]
    """A pose as the camera saw it: its lines, each with its side, in a box of `THUMBNAIL_PX`."""

    @property
    def share(self) -> float:
        """The share of the frames that are doubtful; 0 where it is not known."""
        return (self.doubtful or 0) / max(1.0, float(self.cells["frames"] or 0))

    def number(self, column: str, spec: str) -> str:
        """A number of summary.csv, rounded; nothing where it has none."""
        cell = self.cells[column]
        return format(int(cell) if spec == "d" else float(cell), spec) if cell else ""

    @property
    def state(self) -> str:
        """The verdict, or what has kept the clip from one."""
        return self.cells["status"] if self.cells["status"] in FIRST else self.cells["verdict"]

    @property
    def rank(self) -> tuple[int, float]:
        """The smallest is the one to look at first."""
        order = (*FIRST, *LEVELS)
        return order.index(self.state) if self.state in order else 0, -float(self.cells["pose_mm"] or 0)


def batch_page(out: Path, rows: Sequence[Mapping[str, str]]) -> str:
    """HTML of the batch in a folder, whose summary.csv has these rows."""
    clips = sorted((_clip_row(out, row) for row in rows), key=lambda clip: clip.rank)
    counted = Counter(row["verdict"] or row["status"] for row in rows)
    counts = {name: counted[name] for name in dict.fromkeys((*FIRST, *LEVELS, *counted)) if counted[name]}
    return rendered(
        "summary.html",
        title=out.absolute().name or "batch",
        clips=clips,
        counts=", ".join(f"{count} {name}" for name, count in counts.items()),
        numbers=NUMBERS,
        pages=any(clip.page for clip in clips),
        box=THUMBNAIL_PX,
    )


def _clip_row(out: Path, cells: Mapping[str, str]) -> _ClipRow:
    folder = out / cells["clip"]
    cells = {**cells, "error": FOLDERS.sub("", cells["error"])}
    page = f"{cells['clip']}/{PAGE}" if (folder / PAGE).is_file() else None
    try:
        motion = Motion.load(folder)
        return _ClipRow(cells, page, sum(map(bool, motion.flags)), _thumbnail(motion))
    except (OSError, InputError):  # failed, or damaged since
        return _ClipRow(cells, page, None, ())


def _thumbnail(motion: Motion) -> list[tuple[str, str]]:
    """The picture of the frame with a pose that is nearest to the middle, by the first camera."""
    reprojected_px = motion.pictures[0].reprojected_px
    posed = np.flatnonzero(np.isfinite(reprojected_px).any(axis=(1, 2)))
    if not len(posed):
        return []
    points = reprojected_px[min(posed, key=lambda t: abs(t - len(reprojected_px) / 2))]
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    scale = float(np.min(0.9 * np.array(THUMBNAIL_PX) / np.maximum(high - low, 1.0)))
    places = (points - (low + high) / 2) * scale + np.array(THUMBNAIL_PX) / 2
    lines = [
        (str(motion.limb_sides[limb] or "middle"), " ".join(f"{x:.0f},{y:.0f}" for x, y in places[list(along)]))
        for limb, along in motion.limbs.items()
    ]
    return [line for line in lines if "nan" not in line[1]]
