"""The report of a fit, as plain JSON types. Every field is documented in docs/report.md.

common: what all methods have. trajectory: what that method adds, and its summary. A solution of another names the
module that does the same for it, `Solution.described_by`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from importlib import import_module
from typing import Any

from rich.table import Table
from rich.text import Text

from recon.base.package import version
from recon.check import Finding, sentences
from recon.fit.motion import Motion
from recon.fit.results import SCHEMA_NAME, SCHEMA_VERSION
from recon.show.report.plain import to_json, to_plain, write_report

__all__ = [
    "SCHEMA_NAME",
    "SCHEMA_VERSION",
    "build_report",
    "console_summary",
    "frames_with_pose",
    "is_unsolved",
    "summary_lines",
    "to_json",
    "to_plain",
    "warnings",
    "write_report",
]


def build_report(
    motion: Motion, settings: Mapping[str, Any] | None = None, timing: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """The report of one clip.

    settings: all that the fit was told, as plain types, the fields of the method's options among them (a missing one
    has its default). timing: seconds by name. Where these are None, the motion's own are taken. NaN becomes None,
    floats have nine significant digits.
    """
    settings = motion.settings if settings is None else settings
    timing = motion.timing_s if timing is None else timing
    method = import_module(motion.solution.described_by)
    seconds = {**timing, **motion.solution.stage_s} or None
    head = {
        "schema": {"name": SCHEMA_NAME, "version": SCHEMA_VERSION},
        "recon_version": version(),
        "method": motion.solution.method,
        "settings": settings,
        "timing_s": seconds,
        "findings": [_entry(one, text) for one, text in sentences(motion)],
    }
    plain = to_plain(head | method.sections(motion, settings))
    plain["lines"] = [list(line) for line in method.lines(plain)]
    plain["unsolved"] = method.is_unsolved(plain)
    return plain


def _entry(one: Finding, text: str) -> dict[str, Any]:
    return {field.name: getattr(one, field.name) for field in fields(Finding)} | {"text": text}


def warnings(report: Mapping[str, Any]) -> list[str]:
    """What is wrong or to be used with care, in words: the findings but for notes."""
    return [one["text"] for one in report["findings"] if one["severity"] != "note"]


def is_unsolved(report: Mapping[str, Any]) -> bool:
    """Whether there is no pose to look at."""
    return report["unsolved"]


def frames_with_pose(report: Mapping[str, Any]) -> int:
    return sum(None not in place for place in report["root_path"]["position_m"])


def summary_lines(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(label, value) of what one wants to see after a fit; the warnings come last."""
    return [*((label, text) for label, text in report["lines"]), *(("warning", text) for text in warnings(report))]


def console_summary(report: Mapping[str, Any]) -> Table:
    """`summary_lines` for a terminal, to be printed with rich."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    for label, value in summary_lines(report):
        warning = label == "warning"
        table.add_row(Text(label, style="bold yellow" if warning else "bold"), Text(value, "yellow" if warning else ""))
    return table
