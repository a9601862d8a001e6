"""The command `recon audit`: check keypoints or poses from any program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from recon.api.options import INDIVIDUAL
from recon.base.files import write_text
from recon.base.numbers import counted
from recon.base.outputs import Output, ReadResults
from recon.base.settings import Number, Option, Positive, Settings, input_paths
from recon.base.tables import write_frame
from recon.check.codes import sentence
from recon.cli.answers import Answer
from recon.fit.motion_forms import MOTION
from recon.io.columns import parse_map
from recon.show.console import finding_text

if TYPE_CHECKING:
    from recon.api.audit import Audit

TABLE, PAGE = "audit.csv", "audit.html"


class _AuditSettings(Settings):
    """Settings of `recon audit`."""

    source: Annotated[Path, Option(argument="FILE")]
    """2D keypoints or 3D poses from any program, such as clip.csv, or a results folder."""
    out: Path | None = None
    """Folder for a table and a page of the findings, such as audits/clip."""
    fps: Positive | None = None
    """Frames per second, such as 120, if the file does not state it."""
    unit: str | None = None
    """Unit of 3D positions, if the file does not state it: m, cm or mm."""
    up: str | None = None
    """Upward axis of 3D positions, if the file does not state it: y, z, or -y if y points down."""
    individual: Annotated[str | None, Option(INDIVIDUAL)] = None
    columns: str | None = None
    """Columns of a plain CSV, as for recon convert."""
    likelihood_min: Annotated[Number, Field(ge=0, le=1), Option(expected="a number from 0 to 1")] = 0.5
    """Leave out detections with a likelihood below this, 0 to 1."""
    overwrite: bool = False
    """Replace an earlier audit."""


def audit(settings: _AuditSettings) -> Answer:
    """Audit 2D keypoints or 3D poses from any program: copied, frozen and swapped points, lengths, unit, gravity, feet.

    Example: recon audit poses.csv --fps 120

    Each finding states the problem, the frames, and one thing to do. The file is not changed.
    """
    from recon.api.audit import audit_file

    output = None
    if settings.out is not None:
        made_from = ReadResults.read(settings.source) if (settings.source / MOTION).is_file() else None
        output = Output(settings.out, "audit", settings.overwrite, input_paths(settings), made_from, content="an audit")
        output.require((TABLE, PAGE))
    result = audit_file(
        settings.source,
        settings.fps,
        settings.unit,
        settings.up,
        settings.individual,
        None if settings.columns is None else parse_map(settings.columns),
        settings.likelihood_min,
    )
    files = []
    if output is not None and settings.out is not None:
        from recon.show.page.audit_page import audit_page

        with output.staged() as staging:
            write_frame(result.table(), staging / TABLE)
            write_text(
                staging / PAGE, audit_page(result.source, result.content, result.points, result.findings, result.notes)
            )
        files = [settings.out / TABLE, settings.out / PAGE]
    return _answer(result, files)


def _answer(result: Audit, files: list[Path]) -> Answer:
    from recon.check.audit import MIN_FRAMES

    points = result.points
    frames = counted(len(points.frames), "frame")
    head = f"{result.source}: {result.content}, {counted(len(points.names), 'point')}, {frames}"
    serious = [item for item in result.findings if item.severity != "note"]
    no_fault = "Not audited." if len(points.frames) < MIN_FRAMES else "No fault was found."
    summary = counted(len(serious), "finding") if serious else no_fault
    lines = [head, summary, *(finding_text(item.severity, sentence(item)) for item in result.findings)]
    lines += [f"Table and page: {', '.join(map(str, files))}"] if files else []
    data = {
        "source": result.source,
        "content": result.content,
        "points": list(points.names),
        "frames": [int(points.frames[0]), int(points.frames[-1])],
        "findings": [
            {
                "code": item.code,
                "severity": item.severity,
                "frames": item.frames,
                "numbers": item.numbers,
                "text": sentence(item),
            }
            for item in result.findings
        ],
        "notes": result.notes,
    }
    return Answer(data, lines, files=files, notes=result.notes)
