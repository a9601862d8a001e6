"""summary.csv: one row a clip, the whole file written again while clips finish; and summary.html, made of it."""

from __future__ import annotations

import csv
import hashlib
import json
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from recon.base.files import seen_from, staged_file
from recon.fit.result import LEVELS
from recon.show.page import SUMMARY_PAGE, require_own_page
from recon.show.report import warnings
from recon.workflows.batch.inputs import SUMMARY
from recon.workflows.batch.plan import ClipPlan

RESULTS = (
    *("verdict", "reason"),
    *(f"{error}{end}" for error in ("pose_mm", "position_m") for end in ("", "_low", "_high")),
    *("frames", "frames_with_pose", "warnings", "outliers", "mean_reprojection_px"),
    *("mean_speed_m_s", "peak_speed_m_s", "size"),
)
COLUMNS = (
    *("clip", "keypoints", "cameras", "out", "status", "error"),
    *RESULTS,
    *("seconds", "attempts", "settings_hash", "inputs_hash"),
)
STATUSES = ("done", "done earlier", "unsolved", "failed", "pending")
"""unsolved: fitted, but no frame has a pose. pending: not tried, because the batch was interrupted."""
WRITE_EVERY_S = 0.5
FORMULAS = ("=", "+", "-", "@", "\t", "\r")
"""A text that begins so would be run by a spreadsheet."""


def results_of(report: Mapping[str, Any]) -> dict[str, Any]:
    """The columns `RESULTS`. Speeds are the root's, without the jitter from frame to frame where that can be told;
    warnings is how many the report has; size is the factor on the skeleton's lengths, which only the trajectory method
    has."""
    summary, path, verdict = report["summary"], report["root_path"], report["verdict"] or {}
    speeds = path["smoothed"] or path["exact"]
    expected = {}
    for name, of, unit in (("pose_mm", "pose_m", 1000.0), ("position_m", "position_m", 1.0)):
        error = verdict.get(of)
        for end, key in (("", "expected"), ("_low", "low"), ("_high", "high")):
            expected[name + end] = None if error is None else float(f"{unit * error[key]:.4g}")
    return {
        "verdict": verdict.get("level"),
        "reason": verdict.get("reason"),
        **expected,
        **{name: summary[name] for name in ("frames", "frames_with_pose", "outliers")},
        "warnings": len(warnings(report)),
        "mean_reprojection_px": summary["reprojection_px"]["mean"],
        **{name: speeds[name] for name in ("mean_speed_m_s", "peak_speed_m_s")},
        "size": report["size"]["factor"] if report["method"] == "trajectory" else None,
    }


class Summary:
    """The rows of a batch, by clip, and their file. What was done earlier has its row already."""

    def __init__(self, plan: Sequence[ClipPlan], out: Path) -> None:
        self.path = out / SUMMARY
        self.rows: dict[str, dict[str, Any]] = {planned.clip.name: _row(planned, out) for planned in plan}
        self._written_s = -WRITE_EVERY_S

    def end(self, clip: str, outcome: Mapping[str, Any]) -> None:
        """outcome: some of the columns."""
        self.rows[clip] |= {column: outcome[column] for column in COLUMNS if column in outcome}

    def write_now_and_then(self) -> None:
        """Not all the time; a file that is open elsewhere can wait."""
        if time.monotonic() - self._written_s >= WRITE_EVERY_S:
            with suppress(PermissionError):
                self.write()

    def counts(self) -> dict[str, int]:
        """By status, in the order of `STATUSES`, without those that no clip has."""
        count = Counter(row["status"] for row in self.rows.values())
        return {status: count[status] for status in STATUSES if count[status]}

    def verdicts(self) -> dict[str, int]:
        """How many clips have each verdict, in the order of `LEVELS`, without those that none has."""
        count = Counter(row["verdict"] for row in self.rows.values() if row["status"].startswith("done"))
        return {level: count[level] for level in LEVELS if count[level]}

    def write(self) -> None:
        with staged_file(self.path) as staged, staged.open("w", encoding="utf-8", newline="") as f:
            writer = csv.DictWriter(f, COLUMNS, lineterminator="\n")
            writer.writeheader()
            for row in sorted(self.rows.values(), key=_rank):
                writer.writerow({name: f"'{x}" if _is_formula(x) else x for name, x in row.items()})
        self._written_s = time.monotonic()


def _is_formula(cell: Any) -> bool:
    """Whether a spreadsheet would take a text for a formula; it stands after an apostrophe in the file."""
    return isinstance(cell, str) and cell.lstrip("'").startswith(FORMULAS)


def _rank(row: Mapping[str, Any]) -> int:
    return LEVELS.index(row["verdict"]) if row["verdict"] in LEVELS else -1


def write_summary_page(out: Path) -> Path:
    """summary.html, of what summary.csv in the folder says. Raises InputError for another file in its place."""
    from recon.show.page.batch import batch_page  # needs matplotlib, which the processes that fit do not

    page = out / SUMMARY_PAGE
    require_own_page(page)
    html = batch_page(out, read_rows(out / SUMMARY))
    with staged_file(page) as staged:
        staged.write_text(html, encoding="utf-8")
    return page


def read_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a summary.csv as they were before `Summary.write` made texts of formulas."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [{name: x[1:] if x[:1] == "'" and _is_formula(x) else x for name, x in row.items()} for row in rows]


def _row(planned: ClipPlan, out: Path) -> dict[str, Any]:
    settings, known = planned.clip.settings, planned.identity
    row = dict.fromkeys(COLUMNS) | {
        "clip": planned.clip.name,
        "keypoints": ", ".join(settings.keypoints_from(out)),
        "cameras": len(settings.keypoints),
        "out": seen_from(out, planned.out),
        "status": "pending",
        "attempts": 0,
    }
    for name, part in (("settings", [known["settings"], known["version"]]), ("inputs", known["inputs"])):
        row[f"{name}_hash"] = hashlib.sha256(json.dumps(part, sort_keys=True).encode()).hexdigest()[:16]
    earlier = dict(planned.row or {})
    return row | earlier | ({"status": "done earlier"} if earlier.get("status") == "done" else {})
