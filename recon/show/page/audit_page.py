"""Make the page of an audit, with each finding and its frames, and the list of checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from recon.check.audit import LIMITS, MIN_FRAMES, POSES_ONLY, TRACKS_ONLY, measures_of
from recon.check.audited import AuditedPoints
from recon.check.codes import sentence
from recon.fit.result import Finding
from recon.show.page.pages import rendered


def audit_page(
    source: Path, content: str, points: AuditedPoints, findings: Sequence[Finding], notes: Sequence[str]
) -> str:
    """Return the HTML page of the audit of the file `source`, with its findings and the checks that were made."""
    first, last = (int(points.frames[0]), int(points.frames[-1])) if len(points.frames) else (0, 0)
    values: dict[str, float] = {}
    for measure in measures_of(points):
        values[measure.code] = max(measure.value, values.get(measure.code, measure.value))
    possible = [code for code in LIMITS if code not in (TRACKS_ONLY if points.in_space else POSES_ONLY)]
    checks = [
        {
            "code": code,
            "measure": f"{max(value, 0.0):.2g}",
            "limit": f"{LIMITS[code]:g}",
            "is_found": value > LIMITS[code],
        }
        for code in possible
        if (value := values.get(code, 0.0 if code in NEEDS_NOTHING else None)) is not None
    ]
    tested = {check["code"] for check in checks}
    return rendered(
        "audit.html",
        title=f"Audit of {source.name}",
        content=f"{content}, {len(points.names)} points, {len(points.frames)} frames",
        notes=notes,
        rows=[_row(item, first, last) for item in findings],
        first=first,
        last=last,
        checks=[] if len(points.frames) < MIN_FRAMES else checks,
        untested=", ".join(code for code in possible if code not in tested),
    )


NEEDS_NOTHING = (
    *("points_identical", "detections_frozen", "detections_repeated", "point_frozen", "points_interpolated"),
    "frames_dropped",
)
"""Codes of the checks that run on all points, but report a measured value only if something is suspicious."""


def _row(item: Finding, first: int, last: int) -> Mapping[str, object]:
    start, stop = item.frames or (first, last + 1)
    span = max(last + 1 - first, 1)
    some_text = f"frame {start}" if stop - start == 1 else f"frames {start} to {stop - 1}"
    frames_text = "the whole file" if item.frames is None else some_text
    return {
        "severity": item.severity,
        "code": item.code,
        "text": sentence(item),
        "where": frames_text,
        "left": f"{100 * (start - first) / span:.2f}",
        "width": f"{100 * (stop - start) / span:.2f}",
    }
