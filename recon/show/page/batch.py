"""The page of a batch: a table of its clips, those to look at first."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

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
FOLDERS = re.compile(r"(?<![\w.])(?:[A-Za-z]:)?[/\\](?:[^/\\:]+[/\\])+")
"""The folders of a file that an error names: they stay in the house."""


@dataclass(frozen=True)
class _ClipRow:
    """One clip by its row of summary.csv."""

    cells: Mapping[str, str]
    page: str | None
    """Beside the summary, with forward slashes."""

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
    pages = (f"{row['clip']}/{PAGE}" for row in rows)
    clips = [
        _ClipRow({**row, "error": FOLDERS.sub("", row["error"])}, page if (out / page).is_file() else None)
        for row, page in zip(rows, pages, strict=True)
    ]
    counted = Counter(row["verdict"] or row["status"] for row in rows)
    counts = {name: counted[name] for name in dict.fromkeys((*FIRST, *LEVELS, *counted)) if counted[name]}
    return rendered(
        "summary.html",
        title=out.absolute().name or "batch",
        clips=sorted(clips, key=lambda clip: clip.rank),
        counts=", ".join(f"{count} {name}" for name, count in counts.items()),
        numbers=NUMBERS,
        pages=any(clip.page for clip in clips),
    )
